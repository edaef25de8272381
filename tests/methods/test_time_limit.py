"""A computation says what it does for as long as it takes, and ends when its time is over, with what is known."""

from __future__ import annotations

import json
import math
import time
from collections import deque
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest

import perilune as pl
from cho import cho_landing
from perilune.cli import progress as shown, run_command_line
from perilune.cli.progress import progress
from perilune.core import (
    NotConvergedError,
    PeriluneError,
    TimeLimitReached,
    enter_computation,
    remember_best,
    sign_of_life,
)
from perilune.methods.direct.pseudospectral import Pseudospectral
from perilune.solve import TIME_LIMIT
from problems.ascents import tangent_steering

EXAMPLES = Path(__file__).parents[2] / "examples"
PRECISION = str(EXAMPLES / "precision_landing.toml")


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes on by a second whenever it is looked at, so that ends depend on no machine."""
    clock = count()
    monkeypatch.setattr("perilune.core.callbacks.time", SimpleNamespace(monotonic=lambda: float(next(clock))))


# -- the parts


def test_signs_of_life_are_told_once_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    now, lines = [0.0], list[object]()
    monkeypatch.setattr("perilune.core.callbacks.time", SimpleNamespace(monotonic=lambda: now[0]))
    with enter_computation(lines.append):
        for now[0] in (0.5, 0.9, 1.5, 2.0, 2.6, 9.0):
            sign_of_life(f"at {now[0]}")
    assert lines == ["at 1.5", "at 2.6", "at 9.0"]


def test_without_a_computation_there_is_nobody_to_tell() -> None:
    sign_of_life("nothing")
    remember_best(None, 0.0, lambda: pytest.fail("words that nobody reads"), lambda: None, extremal=True)


@pytest.mark.usefixtures("steps")
def test_the_end_comes_once_and_is_no_error_that_a_method_would_mend() -> None:
    with enter_computation(None, limit=3.0) as work, pytest.raises(TimeLimitReached) as caught:
        for _ in range(9):
            sign_of_life("")
    assert not isinstance(caught.value, Exception)
    work("what is said of the end takes time as well")


@pytest.mark.usefixtures("steps")
def test_the_limit_of_the_whole_holds_for_its_parts() -> None:
    with enter_computation(None, limit=4.0), enter_computation(None, limit=1e9), pytest.raises(TimeLimitReached):
        for _ in range(9):
            sign_of_life("")


def test_of_two_flights_the_better_is_kept_and_an_extremal_before_a_rough_one() -> None:
    problem, other, lines = object(), object(), list[object]()
    with enter_computation(lines.append, problem) as work:
        work("start")
        assert work.flight() is None
        remember_best(other, -9.0, lambda: "another problem", lambda: "other", extremal=True)
        remember_best(problem, -1.0, lambda: "rough", lambda: "rough", extremal=False)
        remember_best(problem, -0.5, lambda: "rougher", lambda: "rougher", extremal=False)
        assert work.flight() == ("rough", False)
        remember_best(problem, 2.0, lambda: "exact", lambda: "exact", extremal=True)
        remember_best(problem, -3.0, lambda: "rough again", lambda: "rough again", extremal=False)
        assert work.flight() == ("exact", True)
        assert work.stage == "start"
    assert lines == ["start", "best so far: rough", "best so far: exact"]


# -- the verb


@pytest.mark.usefixtures("steps")
def test_a_limit_that_is_over_at_once_ends_with_nothing_known() -> None:
    with pytest.raises(NotConvergedError) as caught:
        pl.solve(tangent_steering(), time_limit=1e-3)
    error = caught.value
    assert (error.exit_code, error.flight) == (4, None)
    assert error.what == "the time limit of 0.001 s is reached"
    assert error.got.startswith("no flight is known yet; at work on: ")


@pytest.mark.usefixtures("steps")
@pytest.mark.parametrize("limit", range(20, 400, 60))
def test_wherever_the_time_is_over_the_flight_that_is_known_is_kept(limit: int) -> None:
    """The optimum of linear tangent steering is known: what is kept is that one, or nothing."""
    try:
        found = pl.solve(tangent_steering(), time_limit=float(limit))
    except NotConvergedError as error:
        assert f"the time limit of {limit} s" in error.what
        if error.flight is None:
            assert "no flight is known yet" in error.got
        else:
            assert error.flight.objective == pytest.approx(0.554570878334603, rel=1e-9)
            assert error.flight.outcome is pl.Outcome.SOLVED
            assert "not proved" in error.got
    else:
        assert found.outcome is pl.Outcome.PROVED


def test_a_limit_that_is_not_met_changes_nothing() -> None:
    problem = cho_landing()
    free, limited = pl.solve(problem, time_limit=math.inf), pl.solve(problem, time_limit=3600.0)
    assert (limited.objective, limited.free, limited.outcome) == (free.objective, free.free, free.outcome)
    assert limited.unknowns == pytest.approx(free.unknowns, abs=0.0)


@pytest.mark.usefixtures("steps")
def test_the_end_passes_through_ipopt_and_the_next_solve_is_as_ever() -> None:
    direct = Pseudospectral(nodes=40, polish=False)  # of so many states that IPOPT solves it
    usual = direct.run(tangent_steering())
    with enter_computation(None, limit=6.0), pytest.raises(TimeLimitReached):
        direct.run(tangent_steering())
    assert direct.run(tangent_steering()).objective == usual.objective


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan, "60 s", True])
def test_what_is_no_time_limit_is_refused(limit: object) -> None:
    with pytest.raises(PeriluneError, match="time limit"):
        pl.solve(tangent_steering(), time_limit=limit)  # type: ignore[arg-type]


def test_the_proof_tells_of_itself_and_of_the_answer_before_it(steps: None) -> None:
    lines = list[object]()
    pl.solve(tangent_steering(), callback=lines.append, time_limit=math.inf)
    told = [line for line in lines if isinstance(line, str)]
    best = next(i for i, line in enumerate(told) if line.startswith("best so far: J = 0.554570878"))
    proofs = [i for i, line in enumerate(told) if line.startswith("proof: ")]
    assert proofs and best < max(proofs)
    assert "proof: neighbouring problems are solved" in told


def test_the_usual_limit_is_five_times_what_the_hardest_answers_take() -> None:
    assert TIME_LIMIT == 600.0


@pytest.mark.parametrize("others", [{}, {"vehicle.thrust": [440.0]}])  # continued from a neighbour, or by itself
def test_each_member_of_a_sweep_has_a_time_limit(
    others: dict[str, list[float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An hour goes by at each line of the second member: it is not found, and the others are."""
    now, member = [0.0], [""]
    monkeypatch.setattr("perilune.core.callbacks.time", SimpleNamespace(monotonic=lambda: now[0]))

    def watch(event: object) -> None:
        if isinstance(event, str) and event.endswith(" of 3)"):
            member[0] = event
        now[0] += 3600.0 * ("(2 of 3)" in member[0])

    over = {"vehicle.mass": [290.0, 300.0, 310.0], **others}
    points = pl.sweep(cho_landing().with_given(retro_delta_v=0.0), over, callback=watch).points
    assert [point.outcome.name for point in points] == ["SOLVED", "NOT_CONVERGED", "SOLVED"]
    assert points[1].message.startswith("the time limit of 600 s is reached")


# -- the command line


@pytest.mark.parametrize("begins", ["start", "best so far"])
def test_the_command_line_ends_with_exit_4_and_keeps_the_flight(
    begins: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An hour goes by at the first line that begins so."""
    now = [0.0]
    monkeypatch.setattr("perilune.core.callbacks.time", SimpleNamespace(monotonic=lambda: now[0]))

    def hear(_: object, line: str, **__: object) -> None:
        now[0] += 3600.0 * line.startswith(begins)

    monkeypatch.setattr(shown.WorkClock, "hear", hear)
    code = run_command_line(["solve", PRECISION, "--time-limit", "20 min", "--json", "--out", str(tmp_path / "out")])
    document = json.loads(capsys.readouterr().out)
    assert (code, document["outcome"]) == (4, "NOT_CONVERGED")
    assert document["error"]["what"] == "the time limit of 1200 s is reached"
    kept = json.loads((tmp_path / "out" / "failure.json").read_text(encoding="utf-8"))
    knows = begins == "best so far"
    assert ("flight" in kept) == ("best so far" in document["error"]["got"]) == knows
    if knows:
        assert kept["flight"]["objective"]["value"] == pytest.approx(-1920.260735, rel=1e-6)


@pytest.mark.parametrize("command", [["solve", PRECISION], ["sweep", PRECISION, "--vary", "vehicle.mass=2000,2001 kg"]])
@pytest.mark.parametrize("limit", ["60", "5 kg", "0 s", "-3 s", "soon", "inf s"])
def test_a_time_limit_of_the_command_line_has_a_unit_of_time(
    command: list[str], limit: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line([*command, "--time-limit", limit]) == 2
    said = capsys.readouterr().err
    assert "time" in said
    assert said.count("\n") >= 2


def test_what_takes_long_says_so_on_stderr(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(shown, "_FIRST_WORD", 0.2)
    monkeypatch.setattr(shown, "_NEXT_WORD", 0.2)
    with progress(False, deque()) as watch:
        watch("start: random costates")
        watch("best so far: J = 3 s")
        time.sleep(1.8)  # as in foreign code, which tells nothing
    told = capsys.readouterr()
    assert told.out == ""
    lines = told.err.splitlines()
    assert 2 <= len(lines) <= 4
    assert all(line.startswith("perilune: running for ") for line in lines)
    assert lines[-1].endswith(" s: start: random costates; best so far: J = 3 s")
    assert told.err.replace("\n", "").isprintable()


def test_what_is_at_work_says_of_how_many_and_no_word_on_what_is_over() -> None:
    """Once an answer is proved and written, and once the next member begins, no flight is "not proved yet"."""
    clock = shown.WorkClock(began=time.monotonic() - 9.0, printed=time.monotonic() - 9.0)
    for line in ("start: random costates", "best so far: J = 3 s, which is not proved yet", "proof: level 1"):
        clock.hear(line)
    assert clock.text().endswith("proof: level 1; best so far: J = 3 s, which is not proved yet")
    clock.hear(shown.WRITING)
    assert clock.text() == "9 s: writing figures and the report"


def test_lines_of_a_sweep_say_how_many_are_done(capsys: pytest.CaptureFixture[str]) -> None:
    clock = shown.WorkClock(began=time.monotonic() - 9.0, printed=time.monotonic() - 9.0)
    clock.hear("best so far: J = 3 s, which is not proved yet")
    clock.hear("thrust = 6000 N (7 of 401): PROVED")
    clock.hear("round 8: 0 of 24 converged")
    clock.print_line()
    assert capsys.readouterr().err == "perilune: running for 9 s, 7 of 401: round 8: 0 of 24 converged\n"


def test_what_is_quick_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress(False, deque()) as watch:
        watch("start: random costates")
    assert capsys.readouterr().err == ""
