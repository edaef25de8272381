"""Nothing that a saved file claims is repeated unless it is proved: files falsified one number at a time."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import perilune as pl
from command_line import HYBRID, ORDINARY, read_json
from perilune.cli import run_command_line
from perilune.core import Outcome, PeriluneError
from perilune.io.json_checks import LONGEST_TEXT
from perilune.io.save import save
from perilune.problem import Nature, Solution
from perilune.proof.cross_check import check_agreement
from perilune.proof.recheck import confirm_listed_extremals
from perilune.report.directory import REPORT_FILE
from perilune.report.summary import solution_markdown, solution_summary
from perilune.scenario import load_file
from perilune.solve import solve
from perilune.verify import verify

Change = Callable[[dict[str, Any]], Any]


def written(solution: Solution, directory: Path, text: str | None) -> Path:
    """As ``solve --out``, without the figures, which nobody compares."""
    save(solution, directory, text)
    (directory / REPORT_FILE).write_text(solution_markdown(solution, scenario_text=text or ""), encoding="utf-8")
    return directory


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The two landings of the paper, each in a directory."""
    place, found = tmp_path_factory.mktemp("answers"), {}
    for file in (HYBRID, ORDINARY):
        scenario = load_file(file)
        solution = solve(scenario.problem, verify=1)
        found[Path(file).stem] = written(solution, place / Path(file).stem, scenario.text)
    return found


@pytest.fixture
def hybrid_dir(answers: dict[str, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(answers["hybrid_lander"], tmp_path / "hybrid"))


@pytest.fixture
def ordinary_dir(answers: dict[str, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(answers["ordinary_lander"], tmp_path / "ordinary"))


def edited(directory: Path, change: Change) -> Path:
    file = directory / "solution.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    change(document)
    file.write_text(json.dumps(document), encoding="utf-8")
    return directory


def told(directory: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[int, str]:
    """Exit code and all that is said."""
    code = run_command_line(["verify", str(directory), "--level", "1", *more])
    said = capsys.readouterr()
    return code, said.out + said.err


def natures(solution: Solution) -> list[Nature]:
    return [e.nature for e in solution.extremals]


# -- the list of extremals ------------------------------------------------------------------------------------------


def test_what_is_true_is_confirmed(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each listed extremal is found again, to the last digit that is printed, and is what it was."""
    code, said = told(hybrid_dir, capsys, "--json")
    document = read_json(said)
    assert code == 0
    rows = [(round(e["landed_mass"], 6), round(e["delta_v"]), e["nature"]) for e in document["extremals"]]
    assert rows == [
        (160.618584, 1201, "best of the extremals found"),
        (154.541347, 0, "local optimum, at a bound"),
        (154.501974, 129, "locally worst"),
    ]
    assert document["unverified_claims"] == ["method", "statistics"]


def test_a_loaded_list_is_no_list_of_extremals(hybrid_dir: Path) -> None:
    """Until `verify` has found them again."""
    loaded = pl.load(edited(hybrid_dir, lambda d: d["extremals"][1].update(objective=-999.0)))
    assert loaded.extremals == () and len(loaded.unverified_extremals) == 3
    assert loaded.statistics.from_file
    proved = pl.verify(loaded, level=2)
    assert proved.outcome is Outcome.PROVED and proved.unverified_extremals == ()
    assert [round(e.objective, 3) for e in proved.extremals] == [-160.619, -154.502]
    (note,) = proved.verification.notes
    assert note == "1 of the 3 extremals listed in the file is not confirmed, and left out"


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["extremals"][1].update(objective=-999.0),
        lambda d: d["extremals"][2]["free"].update(retro_delta_v=999.0),
        lambda d: d["extremals"][1]["free"].update(flight_time=999.0),
        lambda d: d["extremals"][1]["free"].pop("flight_time"),
        lambda d: d["extremals"][1].update(unknowns=[1e300] * 10, objective=-999.0),
        lambda d: d["extremals"][1].update(unknowns=[0.0] * 3, objective=-999.0),
        lambda d: d["extremals"].append({**d["extremals"][1], "objective": -999.0}),
        lambda d: d["extremals"].append(d["extremals"][1]),  # the same twice is one
        lambda d: d.update(extremals=[d["extremals"][0], *d["extremals"][1:] * 400]),
    ],
)
def test_an_extremal_that_is_not_confirmed_is_left_out(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], change: Change
) -> None:
    """And the command says how many."""
    code, said = told(edited(hybrid_dir, change), capsys)
    assert code == 0
    assert "999" not in said
    assert re.search(r"note: \d+ of the \d+ extremals listed in the file (is|are) not confirmed, and left out", said)


@pytest.mark.parametrize("unknowns", [[1e300] * 10, [0.0] * 10, [0.0] * 3, []])
def test_of_a_solution_whose_unknowns_were_changed_the_curves_remain(hybrid_dir: Path, unknowns: list[float]) -> None:
    """They are a start and no more."""

    def change(document: dict[str, Any]) -> None:
        document["unknowns"] = unknowns

    proved = verify(pl.load(edited(hybrid_dir, change)), 3)
    assert proved.outcome is Outcome.PROVED
    assert natures(proved) in ([], [Nature.BEST, Nature.LOCAL_OPTIMUM_AT_BOUND, Nature.WORST])


def test_natures_follow_from_what_was_found(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def change(document: dict[str, Any]) -> None:
        words = ("locally worst", "best of the extremals found", "best of the extremals found, at a bound")
        for entry, word in zip(document["extremals"], words, strict=True):
            entry["nature"] = word

    found = verify(pl.load(edited(hybrid_dir, change)), 1)
    assert natures(found) == [Nature.BEST, Nature.LOCAL_OPTIMUM_AT_BOUND, Nature.WORST]
    assert told(hybrid_dir, capsys)[0] == 0


@pytest.mark.parametrize("word", ["locally worst", "best of the extremals found", "an extremal near the guess"])
def test_a_lone_extremal_is_called_what_it_is(
    ordinary_dir: Path, capsys: pytest.CaptureFixture[str], word: str
) -> None:
    """And of one alone there is no best."""
    code, said = told(edited(ordinary_dir, lambda d: d["extremals"][0].update(nature=word)), capsys)
    assert code == 0
    assert word not in said and "local optimum" in said


def test_the_best_may_be_left_out_of_a_list_but_is_not_invented(landing: Any, ordinary: Solution, hybrid: Solution,
                                                                tmp_path: Path) -> None:  # fmt: skip
    """A local optimum whose file claims to be the best of two is none; one that lists a better one says so."""
    lower = solve(landing, guess=ordinary, verify=0)
    claims = replace(lower, extremals=(replace(hybrid.extremals[1], nature=Nature.BEST), hybrid.extremals[2]))
    save(claims, tmp_path / "without")
    beside_the_worst = verify(pl.load(tmp_path / "without"), 1)
    assert natures(beside_the_worst) == [Nature.LOCAL_OPTIMUM_AT_BOUND, Nature.WORST]
    alone = verify(pl.load(edited(tmp_path / "without", lambda d: d["extremals"].pop())), 1)
    assert natures(alone) == [Nature.LOCAL_OPTIMUM_AT_BOUND]
    save(replace(lower, extremals=(*lower.extremals, hybrid.extremals[0])), tmp_path / "with")
    beaten = verify(pl.load(tmp_path / "with"), 1)
    assert natures(beaten) == [Nature.LOCAL_OPTIMUM_AT_BOUND, Nature.LOCAL_OPTIMUM]
    assert any("a better extremal than this solution is known" in note for note in beaten.verification.notes)
    assert beaten.extremals[0].objective == lower.objective


def test_an_extremal_that_breaks_a_bound_is_not_confirmed(landing: Any, hybrid: Solution, tmp_path: Path) -> None:
    """Roots of the necessary conditions they are, but with less of a retro burn than the problem allows."""
    stricter = replace(landing, free=tuple(
        replace(f, lower=800.0) if f.name == "retro_delta_v" else f for f in landing.free
    ), parameter_bounds=None)  # fmt: skip
    solution = replace(solve(stricter, verify=0), extremals=hybrid.extremals)
    save(solution, tmp_path / "s")
    proved = verify(pl.load(tmp_path / "s"), 1)
    assert len(proved.extremals) == 1
    assert "2 of the 3 extremals" in " ".join(proved.verification.notes)


def test_files_from_before_extremals_had_unknowns(hybrid_dir: Path) -> None:
    """What Newton reaches from the solution itself is confirmed; the rest is left out."""

    def change(document: dict[str, Any]) -> None:
        for entry in document["extremals"]:
            del entry["unknowns"]

    proved = verify(pl.load(edited(hybrid_dir, change)), 1)
    assert proved.outcome is Outcome.PROVED
    left = 3 - len(proved.extremals)
    assert natures(proved)[0] is (Nature.BEST if left < 2 else Nature.LOCAL_OPTIMUM)
    assert not left or f"{left} of the 3 extremals" in proved.verification.notes[0]


def reached(solution: Solution, *said: tuple[float, Nature]) -> tuple[Solution, Callable[..., Solution]]:
    """A solution whose file lists extremals of these objectives, and a Newton's method that reaches each of them."""
    entries = [
        replace(solution.extremals[0], objective=objective, nature=nature, unknowns=(float(k),))
        for k, (objective, nature) in enumerate(said)
    ]

    def resolve(problem: Any, guess: Solution) -> Solution:
        k = 0 if guess is listing else int(guess.unknowns[0])  # type: ignore[index]
        return replace(solution, extremals=(entries[k],))

    listing = replace(solution, extremals=(), unverified_extremals=tuple(entries))
    return listing, resolve


def test_listed_extremals_stand_in_order_whatever_the_order_of_the_file(hybrid: Solution) -> None:
    """The solution itself, then the better before the worse, and last what is locally worst, however good its J."""
    itself = (hybrid.objective, Nature.LOCAL_OPTIMUM)
    others = [(-120.0, Nature.LOCAL_OPTIMUM), (-155.0, Nature.WORST), (-140.0, Nature.LOCAL_OPTIMUM_AT_BOUND),
              (-130.0, Nature.LOCAL_OPTIMUM), (-150.0, Nature.WORST)]  # fmt: skip
    extremals, notes = confirm_listed_extremals(*reached(hybrid, itself, *others))
    assert [round(e.objective) for e in extremals] == [-161, -140, -130, -120, -155, -150]
    assert extremals[0].nature is Nature.BEST and notes == ()
    extremals, notes = confirm_listed_extremals(*reached(hybrid, itself, *others, (-200.0, Nature.WORST)))
    assert extremals[0].nature is Nature.LOCAL_OPTIMUM and len(notes) == 1  # beside it something better still is near
    extremals, notes = confirm_listed_extremals(*reached(hybrid, itself, (-200.0, Nature.LOCAL_OPTIMUM)))
    assert extremals[0].nature is Nature.LOCAL_OPTIMUM and len(notes) == 1


@pytest.mark.parametrize("which", ["state", "costate"])
def test_what_newton_reaches_is_proved_before_it_is_listed(hybrid: Solution, which: str) -> None:
    """An entry that is reached to the last digit, by a flight or costates that are wrong by a millionth."""
    itself, other = (hybrid.objective, Nature.LOCAL_OPTIMUM), (-150.0, Nature.LOCAL_OPTIMUM)
    listing, resolve = reached(hybrid, itself, other)
    assert len(confirm_listed_extremals(listing, resolve)[0]) == 2
    (flown,) = hybrid.trajectories
    curve = getattr(flown, which)
    wrong = replace(flown, **{which: replace(curve, values=curve.values * (1 + 1e-6))})

    def misled(problem: Any, guess: Solution) -> Solution:
        return replace(resolve(problem, guess), trajectories=(wrong,))

    extremals, notes = confirm_listed_extremals(listing, misled)
    assert len(extremals) == 1 and "1 of the 2 extremals" in notes[0]


# -- statistics, method, words --------------------------------------------------------------------------------------


def test_how_it_was_found_is_not_repeated(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def change(document: dict[str, Any]) -> None:
        document["statistics"].update(
            iterations=77777, initialization="an oracle", wall_time=0.001, attempts=["magic", "more magic"]
        )
        document["method"] = "clairvoyance"
        document["verification"] = {"level": 4, "text": "everything", "checks": []}
        document["outcome"] = {"name": "SOLVED", "advice": "land here"}

    code, said = told(edited(hybrid_dir, change), capsys)
    assert code == 0
    for word in ("77777", "oracle", "magic", "clairvoyance", "everything", "land here", "level 4"):
        assert word not in said
    document = read_json(told(hybrid_dir, capsys, "--json")[1])
    assert document["unverified_claims"] == ["method", "statistics"]  # what is repeated is marked
    assert document["verification"]["level"] == 1


def test_a_claimed_mesh_error_opens_no_limit(hybrid: Solution) -> None:
    """Level 4 compares within the mesh error, which a file may not choose; nor which method is "another"."""
    from perilune import Pseudospectral

    told_error = replace(hybrid.statistics, residual=1e6, from_file=True)
    claimed = replace(hybrid, method="pseudospectral", statistics=told_error, extremals=())
    checks = list(check_agreement(claimed, None))
    assert all(c.limit < 1e-3 * claimed.problem.scales.of(c.unit) for c in checks if np.isfinite(c.limit))
    assert all(c.passed for c in checks), [c for c in checks if not c.passed]
    assert "by the file" in checks[1].meaning and "by pseudospectral" in checks[1].meaning
    assert Pseudospectral  # the rival


@pytest.mark.parametrize(
    "title",
    [
        "landing\n\n  landed mass           999.000000 kg",
        "landing\n\n## Results\n\n| quantity | value | unit | |\n|---|---|---|---|\n| landed mass | 999 | kg | |",
        "landing\r  landed mass           999.000000 kg\x1b[2A",
        "landing\u2028999\u202egk 999\x85\x00",
        "landing 999 " * 1_000_000,
    ],
)
def test_titles_forge_no_lines(hybrid: Solution, title: str, tmp_path: Path) -> None:
    """Whatever a problem is called, its name is one short line of what can be printed."""
    named = replace(hybrid, problem=replace(hybrid.problem, title=title))
    told = [solution_summary(named), solution_markdown(named)]
    for text, plain in zip(told, (solution_summary(hybrid), solution_markdown(hybrid)), strict=True):
        (head, *rest), (_, *others) = text.split("\n"), plain.split("\n")
        assert rest == others
        assert head.isprintable() and 20 < len(head) < 200 and "landing" in head
    if len(title) > LONGEST_TEXT:
        save(named, tmp_path / "long")
        with pytest.raises(PeriluneError, match=r"title(.|\n)*12000000 characters"):
            pl.load(edited(tmp_path / "long", lambda d: d.update(made=None)))


@pytest.mark.parametrize(
    ("place", "name"), [((), "method"), (("problem",), "title"), (("statistics",), "initialization")]
)
def test_control_characters_are_refused(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], place: tuple[str, ...], name: str
) -> None:
    """They would move the cursor of a terminal over what was printed."""

    def change(document: dict[str, Any]) -> None:
        for step in place:
            document = document[step]
        document[name] = "\x1b[2Aall is well"

    code, said = told(edited(hybrid_dir, change), capsys)
    assert code == 2 and "\x1b" not in said


# -- any entry at all ------------------------------------------------------------------------------------------------


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Places of all entries but those of the curves, which the proof is about."""
    if path[:1] == ("phases",) and path[2:3] in (("state",), ("control",), ("costate",)):
        return
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    yield path
    for name, child in children:
        yield from leaves(child, (*path, name))


@pytest.fixture(scope="module")
def true(answers: dict[str, Path]) -> tuple[str, Solution]:
    """A document and what is proved of it."""
    file = answers["hybrid_lander"] / "solution.json"
    return file.read_text(encoding="utf-8"), pl.verify(pl.load(file), 2)


OTHER = [999.0, -999.0, 0, 1e300, 10**400, True, None, "", "kg", "PROVED", [], {}, [[0]]]


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_entry_of_a_file_is_believed(true: tuple[str, Solution], tmp_path: Path, data: st.DataObject) -> None:
    """Whatever one entry is changed to: refused, not proved, or every number that is said is the one without it."""
    document, right = json.loads(true[0]), true[1]
    part = data.draw(st.sampled_from(list(document)))  # each as often as the others, however many entries it has
    path = data.draw(st.sampled_from(list(leaves(document[part], (part,)))))
    other = data.draw(st.sampled_from(OTHER))
    place = document
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = other
    (tmp_path / "solution.json").write_text(json.dumps(document), encoding="utf-8")
    try:
        found = pl.verify(pl.load(tmp_path), 2)
    except PeriluneError:
        return
    if found.outcome is Outcome.PROVED:
        assert found.results == right.results
        assert found.objective == right.objective and found.free == right.free
        assert found.verification.level == right.verification.level
        known = [(pytest.approx(e.objective), e.nature) for e in right.extremals]
        for e in found.extremals[1:]:
            assert (e.objective, e.nature) in known
        assert len(found.extremals) in (0, 3) or found.verification.notes
    else:
        assert found.outcome is Outcome.NOT_PROVED and found.verification.failed


# -- what is derived from the solution, in solution.json and beside it, is not read -----------------------------------


def test_files_beside_the_solution_are_named_as_not_read(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever they say, the answer is that of the curves; a name moves no cursor."""
    (hybrid_dir / "trajectory.csv").write_text("nonsense", encoding="utf-8")
    (hybrid_dir / "x\x1b[2J.txt").write_text("")
    code, said = told(hybrid_dir, capsys)
    assert code == 0 and "\x1b" not in said and "160.618584" in said
    assert "note: not read, as only solution.json is evidence: report.md, trajectory.csv, x" in said


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["results"]["landed_mass"].update(value=999.0),
        lambda d: d["results"]["landed_mass"].update(unit="t"),
        lambda d: d["results"].update(bounty={"value": 999.0, "unit": "kg"}),
        lambda d: d["phases"][0]["duration"].update(value=999.0),
        lambda d: d["multipliers"]["descent.touchdown_altitude"].update(unit="t"),
        lambda d: d.update(results=[]),
    ],
)
def test_what_follows_from_the_curves_is_computed_again(hybrid_dir: Path, hybrid: Solution, change: Change) -> None:
    proved = pl.verify(pl.load(edited(hybrid_dir, change)), 1)
    assert proved.outcome is Outcome.PROVED
    assert set(proved.results) == set(hybrid.results)
    assert proved.results["landed_mass"].unit == "kg"
    assert proved.results["landed_mass"].value == pytest.approx(160.618583613, abs=1e-8)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda d: d["objective"].update(value=-160.618584), 5),
        (lambda d: d["objective"].update(value=-999.0), 2),
        (lambda d: d["free"]["retro_delta_v"].update(value=1201.0), 2),  # its own extremal is another
        (lambda d: d["free"]["flight_time"].update(value=286.8637), 5),
        (lambda d: d["multipliers"]["descent.touchdown_altitude"].update(value=1.0), 5),
        (lambda d: d["multipliers"].update({"descent.none": {"value": 0.0, "unit": ""}}), 2),
        (lambda d: d["multipliers"].pop("descent.touchdown_altitude"), 0),
        (lambda d: d["phases"][0].update(name="ascent"), 2),
        (lambda d: d["phases"].append(d["phases"][0]), 2),
        (lambda d: d["given"]["vehicle_thrust"].update(value=880.0), 2),
        (lambda d: d["scenario"].update(text=d["scenario"]["text"].replace("440", "880")), 2),
        (lambda d: d.update(scenario=None), 0),  # the expressions say the same
        (lambda d: d.pop("results"), 0),  # what is not said need not be proved
        (lambda d: d.update(extremals=[]), 0),
        (lambda d: d["extremals"].reverse(), 2),
        (lambda d: d["outcome"].update(name="INFEASIBLE"), 0),
    ],
)
def test_every_part_is_refused_recomputed_or_not_repeated(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], change: Change, code: int
) -> None:
    """At level 2, of which the multipliers are part."""
    assert run_command_line(["verify", str(edited(hybrid_dir, change)), "--level", "2"]) == code
    said = capsys.readouterr()
    assert "999" not in said.out and "Traceback" not in said.err
    assert said.err == "" or code == 2


def test_solutions_exchanged_under_their_scenarios(
    hybrid_dir: Path, ordinary_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = json.loads((ordinary_dir / "solution.json").read_text(encoding="utf-8"))

    def change(document: dict[str, Any]) -> None:
        document["phases"] = other["phases"]

    assert told(edited(hybrid_dir, change), capsys)[0] == 2  # the curves end at another time

    def whole(document: dict[str, Any]) -> None:
        for name in ("phases", "objective", "results", "multipliers", "unknowns"):
            document[name] = other[name]
        document["free"]["flight_time"] = other["free"]["flight_time"]
        document["extremals"] = []

    code, said = told(edited(hybrid_dir, whole), capsys)
    assert code == 5 and "NOT_PROVED" in said


def test_without_a_scenario_what_was_not_checked_is_said(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loaded = pl.load(edited(hybrid_dir, lambda d: d.update(scenario=None)))
    hooks = [loaded.problem.consistency_checks, loaded.problem.preflight]
    said = [note for note in pl.verify(loaded, level=1).verification.notes if note.startswith("not checked")]
    assert len(said) == (None in hooks)
    assert all("rocket equation" in note for note in said) or loaded.problem.consistency_checks is not None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("vehicle_mass", 0.0),
        ("vehicle_mass", 1e300),
        ("vehicle_thrust", 1e300),
        ("vehicle_standard_gravity", 9.81e-6),
        ("retro_specific_impulse", 0.00031),
        ("retro_specific_impulse", 1e-300),
    ],
)
def test_physics_that_cannot_be_computed_is_not_proved(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], name: str, value: float
) -> None:
    """A file without a scenario may state any; no fault of the program comes of it."""

    def change(document: dict[str, Any]) -> None:
        document["scenario"] = None
        document["given"][name]["value"] = value

    code, said = told(edited(hybrid_dir, change), capsys)
    assert code == 5 and "NOT_PROVED, level 0" in said and "FAIL 1" in said


def test_a_flight_without_end_is_not_proved(hybrid: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perilune.proof.feasible.reintegration.MOST_EVALUATIONS", 20)
    failed = {c.name: c.value for c in pl.verify(hybrid, level=1).verification.failed}
    assert {"state_r", "state_v", "touchdown_altitude", "objective"} <= set(failed)
    assert np.isnan(list(failed.values())).all()


def test_verify_has_no_such_notes_of_a_problem_in_python(hybrid: Solution) -> None:
    assert pl.verify(hybrid, level=1).verification.notes == ()


def test_solution_json_alone(hybrid_dir: Path) -> None:
    """A file instead of the directory: nothing lies beside it."""
    (hybrid_dir / "trajectory.csv").write_text("nonsense")
    proved = pl.verify(pl.load(hybrid_dir / "solution.json"), 1)
    assert proved.outcome is Outcome.PROVED and proved.verification.notes == ()
    with pytest.raises(PeriluneError, match="no saved solution here"):
        pl.load(hybrid_dir / "nowhere")
    with pytest.raises(PeriluneError, match=r"(?s)is a scenario.*perilune solve .*hybrid_lander.toml --out DIR"):
        pl.load(HYBRID)
