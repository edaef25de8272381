"""What trips a new user: streams that are closed or full, used directories, the same key twice, the order of words."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import perilune as pl
from command_line import COMMAND, ENVIRONMENT, HYBRID, ORDINARY, ROOT, read_json, snapshot
from perilune.cli import run_command_line
from perilune.cli.progress import SpinnerText
from perilune.core import InfeasibleError, PeriluneError
from perilune.io import fresh_directory
from perilune.problem import Problem, Solution
from perilune.scenario import template

PRECISION = str(ROOT / "examples" / "precision_landing.toml")
THRUST = "vehicle.thrust=440:441:1 N"
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/dev/full and a shell are needed")


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch, ordinary: Solution) -> None:
    """A solver that answers every problem of one form with the paper's landing."""

    def solve(problem: Problem, method: Any = None, *, callback: Any = None, **_: Any) -> Solution:
        return replace(ordinary, problem=problem)

    monkeypatch.setattr(pl, "solve", solve)


def in_a_shell(redirected: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command line with its streams redirected as a shell does."""
    return subprocess.run(
        ["sh", "-c", f'exec "$@" {redirected}', "sh", *COMMAND, *arguments],
        capture_output=True, text=True, env=ENVIRONMENT, timeout=60, check=False,
    )  # fmt: skip


# --- streams


@linux
def test_a_closed_stream_is_no_fault(tmp_path: Path) -> None:
    refused = in_a_shell("2>&-", "solve", "nowhere.toml", "--json")
    assert refused.returncode == 2
    assert read_json(refused.stdout)["outcome"] == "REFUSED"  # and not the refusal in words before it
    assert in_a_shell("2>&-", "solve", HYBRID, "--level", "0").returncode == 5
    assert in_a_shell(">&- 2>&- <&-", "check", HYBRID).returncode == 0
    told = in_a_shell(">&-", "new", str(tmp_path / "written"), "--json")
    assert "Traceback" not in told.stderr


@linux
@pytest.mark.parametrize(
    ("redirected", "arguments", "code"),
    [
        (">/dev/full", ("--help",), 2),
        (">/dev/full", ("solve", "--help"), 2),
        (">/dev/full", ("--version",), 2),
        (">/dev/full", ("check", "nowhere.toml", "--json"), 2),
        ("2>/dev/full", ("check", "nowhere.toml"), 2),
        ("2>/dev/full", (), 2),
        ("2>/dev/full", ("solve", ORDINARY, "--level", "0", "--verbose"), 5),
    ],
)
def test_a_full_disk_is_told_where_it_can_be(redirected: str, arguments: tuple[str, ...], code: int) -> None:
    done = in_a_shell(redirected, *arguments)
    assert done.returncode == code
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr
    assert ("cannot be written" in done.stderr) == (redirected == ">/dev/full")


def test_a_spinner_says_how_many_in_one_line() -> None:
    told = SpinnerText()
    first = told.line("vehicle_thrust = 440 N, vehicle_mass = 300 kg (3 of 17)", 38)
    assert str(first).startswith("3 of 17: vehicle_thrust = 440 N")
    assert first.cell_len <= 38
    assert str(told.line("iteration  12  residual 1.0e-03", 58)) == "3 of 17: iteration  12  residual 1.0e-03"
    assert str(told.line("x = 1 m (5 of 17): PROVED, 4 of 17 done", 58)) == "4 of 17: x = 1 m"
    assert str(SpinnerText().line("[odd] markup", 58)) == "[odd] markup"


# --- values


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("file", "change"),
    [
        (HYBRID, "vehicle.mass=1e308 kg"),
        (HYBRID, "vehicle.mass=1e-308 kg"),
        (HYBRID, "retro.delta_v=1e300 m/s"),
        (str(ROOT / "examples" / "polar_descent.toml"), "start.forward_speed=1e300 km/s"),
        (str(ROOT / "examples" / "polar_descent.toml"), "start.altitude=1e29 m"),
        (PRECISION, "approach.up=1e300 km"),
        (PRECISION, "approach.east=1e29 m"),
        (PRECISION, "site.longitude=1e29 rad"),
    ],
)
def test_a_number_of_no_ordinary_size_is_refused(capsys: pytest.CaptureFixture[str], file: str, change: str) -> None:
    assert run_command_line(["check", file, "--set", change]) == 2
    assert change.partition("=")[0] in capsys.readouterr().err


# --- the words of a command line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--vary", THRUST, "--vary", "vehicle.thrust = 450:451:1 N"], "--vary names vehicle.thrust twice"),
        (["--vary", THRUST, "--set", "vehicle.thrust=500 N"], "vehicle.thrust is both varied and set"),
        (["--vary", "vehicle.thrst=440:441:1 N"], "one of vehicle.thrust, vehicle."),
        (["--vary", "orbit.perilune=10:11:1 km"], "one of orbit.perilune_altitude, "),
    ],
)
def test_a_sweep_says_what_is_wrong_with_its_keys(
    capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert run_command_line(["sweep", ORDINARY, *arguments]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "corridor" not in told and "approach" not in told  # keys of other kinds


def test_a_sweep_knows_the_keys_of_its_own_kind(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["sweep", PRECISION, "--vary", "orbit.perilune_altitude=10:11:1 km"]) == 2
    told = capsys.readouterr().err
    assert "no key with a quantity of this name" in told and "approach.up" in told


def test_new_takes_its_words_in_any_order(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("mine")
    for order in (["powered_descent", "--force", str(path)], ["--force", "powered_descent", str(path)]):
        assert run_command_line(["new", *order, "--json"]) == 0
        assert path.read_text(encoding="utf-8") == template("powered_descent")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["slove", HYBRID], ("no command of this name", "did you mean 'solve'")),
        (["solve", HYBRID, "--leve", "2"], ("no option of this name", "did you mean '--level'")),
        (["solve", HYBRID, "--quiet"], ("no option of this name", "--verbose")),
        (["solve", HYBRID, "more"], ("unexpected argument", "'more'", "perilune solve --help")),
        (["atlas", "query", "map", "vehicle.thrust=440 N"], ("unexpected argument", '--at "vehicle.thrust=440 N"')),
        (["solve"], ("FILE", "perilune solve --help")),
        (["sweep", HYBRID], ("--vary", "perilune sweep --help")),
        (["--Version"], ("no option", "did you mean '--version'")),
        (["solve", HYBRID, "--level", "x"], ("--level", "'x'", "perilune solve --help")),
    ],
)
def test_a_misspelt_word_is_offered_the_nearest(
    capsys: pytest.CaptureFixture[str], arguments: list[str], said: tuple[str, ...]
) -> None:
    assert run_command_line(arguments) == 2
    told = capsys.readouterr().err
    assert all(word in told for word in said), told


@pytest.mark.parametrize("arguments", [["help"], ["-h"], ["--help"]])
def test_help_may_be_asked_for_in_any_way(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    assert run_command_line(arguments) == 0
    assert "Commands:" in capsys.readouterr().out
    for command in (["solve", "-h"], ["help", "solve"], ["solve", "--help"]):
        assert run_command_line(command) == 0
        assert capsys.readouterr().out.startswith("usage: perilune solve ")


# --- directories


def test_an_older_run_leaves_nothing_beside_the_new_one(
    solved: None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert run_command_line(["solve", ORDINARY, "--out", str(out)]) == 5
    new = snapshot(out)
    figures = out / "figures"
    # Figures of another kind of problem, a report of a family, and what the user put there.
    for ending in ("png", "svg"):
        (figures / f"track.{ending}").write_bytes(new[f"figures/mass.{ending}"])
    (out / "family.json").write_text("{}")
    (out / "trajectory_1_ascent.csv").write_text("time")
    kept = {"notes.txt": b"mine", "figures/mine.svg": b"<svg/>", "figures/mine.png": b"mine"}
    for name, content in kept.items():
        (out / name).write_bytes(content)
    assert run_command_line(["solve", ORDINARY, "--out", str(out), "--force"]) == 5
    assert snapshot(out).keys() == {*new, *kept}

    # A second run that only looks at the directory removes nothing, whatever becomes of it.
    def stopped(*_: Any, **__: Any) -> Solution:
        raise KeyboardInterrupt

    monkeypatch.setattr(pl, "solve", stopped)
    before = snapshot(out)
    assert run_command_line(["solve", ORDINARY, "--out", str(out), "--force"]) == 130
    assert snapshot(out) == before


@pytest.mark.parametrize("ending", [KeyboardInterrupt(), ValueError("no font"), PeriluneError("no such quantity")])
def test_what_was_solved_is_kept_where_its_figures_are_not_finished(
    ending: BaseException,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    ordinary: Solution,
    tmp_path: Path,
) -> None:
    def solve(problem: Problem, method: Any = None, **_: Any) -> Solution:
        return replace(ordinary, problem=problem)

    def drawn(*_: Any) -> None:
        raise ending

    monkeypatch.setattr(pl, "solve", solve)
    monkeypatch.setattr("perilune.report.figures.solution_drawings", drawn)
    out = tmp_path / "out"
    out.mkdir()
    (out / "solution.json").write_text("{}")  # what an earlier run left
    (out / "figures").mkdir()
    (out / "figures" / "mass.svg").write_text("<svg><dc:title>perilune</dc:title></svg>")
    stopped = isinstance(ending, KeyboardInterrupt)
    assert run_command_line(["solve", ORDINARY, "--out", str(out), "--force"]) == (130 if stopped else 5)
    assert pl.load(out).objective == ordinary.objective
    assert snapshot(out).keys() == {"solution.json", "trajectory.csv", *([] if stopped else ["report.md"])}
    said = capsys.readouterr()
    assert (f"the solution is in {out}; its figures" in said.err) == stopped
    assert ("no figure is drawn" in said.err and str(ending) in said.err) == (not stopped)
    assert ("154.541347 kg" in said.out) == (not stopped)


def test_a_report_that_is_not_ours_stays(tmp_path: Path) -> None:
    (tmp_path / "report.md").write_text("# My report\n\n## Results\n\nFine.\n")
    with fresh_directory(tmp_path, force=True) as work:
        (work / "solution.json").write_text("{}")
    assert snapshot(tmp_path).keys() == {"report.md", "solution.json"}


def test_a_failure_does_not_block_its_directory(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, ordinary: Solution, tmp_path: Path
) -> None:
    endings: list[Any] = [KeyboardInterrupt(), InfeasibleError("too weak")]

    def solve(problem: Problem, method: Any = None, **_: Any) -> Solution:
        ending = endings.pop(0) if endings else None
        if ending is not None:
            raise ending
        return replace(ordinary, problem=problem)

    monkeypatch.setattr(pl, "solve", solve)
    out = tmp_path / "out"
    for code, outcome in ((130, "INTERRUPTED"), (3, "INFEASIBLE")):
        assert run_command_line(["solve", ORDINARY, "--out", str(out)]) == code
        assert read_json((out / "failure.json").read_text(encoding="utf-8"))["outcome"] == outcome
    assert run_command_line(["solve", ORDINARY, "--out", str(out)]) == 5
    assert "solution.json" in snapshot(out) and "failure.json" not in snapshot(out)


@pytest.mark.skipif(sys.platform == "win32", reason="directories cannot be locked there")
def test_what_a_killed_writer_left_is_removed_by_the_next(tmp_path: Path) -> None:
    program = (
        "import sys, time\n"
        "from perilune.io.atomic_files import fresh_directory\n"
        "with fresh_directory(sys.argv[1]) as work:\n"
        "    (work / 'half.txt').write_text('half'); print('there', flush=True); time.sleep(60)"
    )
    writers = []
    for _ in range(2):
        writers.append(
            subprocess.Popen(
                [sys.executable, "-c", program, str(tmp_path / "out")], stdout=subprocess.PIPE, env=ENVIRONMENT
            )
        )
        assert writers[-1].stdout is not None and writers[-1].stdout.readline()
    killed, alive = writers
    (tmp_path / ".out-of-mind").mkdir()
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert len(list(tmp_path.glob(".out-writing-*"))) == 2
    with fresh_directory(tmp_path / "out") as work:
        (work / "whole.txt").write_text("whole")
        assert len(list(tmp_path.glob(".out-writing-*"))) == 2  # that of the living writer, and this one
    assert {p.name for p in tmp_path.iterdir()} >= {"out", ".out-of-mind"}
    alive.send_signal(signal.SIGKILL)
    alive.communicate()


def test_a_sweep_in_a_used_directory_names_the_ways_on(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "family"
    sweep = ["sweep", ORDINARY, "--vary", "vehicle.thrust=440:441:1 N", "--level", "0", "--out", str(out)]
    assert run_command_line(sweep) == 0
    assert run_command_line(sweep) == 2
    told = capsys.readouterr().err
    assert "--resume" in told and "--force" in told
    assert run_command_line([*sweep, "--resume"]) == 0
    other = tmp_path / "notes"
    other.mkdir()
    (other / "mine.txt").write_text("mine")
    assert run_command_line([*sweep[:-1], str(other), "--resume"]) == 2
    assert "no sweep" in capsys.readouterr().err
    assert snapshot(other) == {"mine.txt": b"mine"}


def test_a_directory_that_may_not_be_written_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)  # root may write everywhere
    with pytest.raises(PeriluneError, match="cannot be written"), fresh_directory(tmp_path):
        pytest.fail("the work was begun")


def test_a_full_disk_names_the_place(tmp_path: Path) -> None:
    with pytest.raises(OSError) as caught, fresh_directory(tmp_path / "out"):
        raise OSError(28, "No space left on device")
    assert caught.value.filename == str(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_line_that_is_no_toml_is_shown(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "unquoted.toml"
    path.write_text(template().replace('"300 kg"', "300 kg"), encoding="utf-8")
    assert run_command_line(["check", str(path)]) == 2
    assert "mass = 300 kg" in capsys.readouterr().err
