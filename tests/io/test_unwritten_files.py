"""A file that cannot be written takes nothing with it: neither the flight, nor other files, nor what is printed."""

from __future__ import annotations

import errno
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import perilune as pl
from command_line import ORDINARY, read_json, snapshot
from perilune import Family, FamilyPoint
from perilune.cli import run_command_line
from perilune.io import save as export
from perilune.io.atomic_files import NotWrittenError, fresh_directory
from perilune.problem import Problem, Solution
from perilune.report import write_all
from perilune.report.family import write_family

FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
FIGURES = {f"figures/{name}.{ending}" for ending in ("png", "svg") for name in (
    "altitude", "costates", "hamiltonian", "horizontal_velocity", "mass", "path", "thrust_angle", "vertical_velocity",
)}  # fmt: skip
WHOLE = {"solution.json", "trajectory.csv", "report.md", *FIGURES}


def failing(error: Exception) -> Any:
    def fails(*_: Any, **__: Any) -> Any:
        raise error

    return fails


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn, and not made pictures of: that takes a second each time."""

    def save(figure: Any, directory: Path, name: str) -> None:
        for ending in ("png", "svg"):
            (directory / f"{name}.{ending}").write_text("<dc:title>perilune</dc:title>")

    monkeypatch.setattr("perilune.report.figures.save_figure", save)


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch, ordinary: Solution) -> None:
    """What the command line solves is known already."""

    def solve(problem: Problem, method: Any = None, **_: Any) -> Solution:
        return replace(ordinary, problem=problem)

    monkeypatch.setattr(pl, "solve", solve)


@pytest.mark.parametrize(
    ("broken", "error", "lost", "said"),
    [
        (
            "perilune.report.figures.costate_figure",
            AttributeError("_asdict"),
            {"figures/costates"},
            "AttributeError: _asdict",
        ),
        ("perilune.report.figures.path_over_limb", pl.PeriluneError("no way"), {"figures/path"}, "no way"),
        ("perilune.report.figures.save_figure", FULL, {*FIGURES}, "No space left"),
        ("perilune.report.summary.solution_markdown", KeyError("x"), {"report.md"}, "report it with solution.json"),
        ("perilune.io.save.trajectory_csv", ZeroDivisionError("x"), {"trajectory.csv"}, "ZeroDivisionError: x"),
    ],
)
@pytest.mark.usefixtures("solved")
def test_one_writer_that_fails_is_told_and_all_others_write(
    broken: str,
    error: Exception,
    lost: set[str],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    ordinary: Solution,
    tmp_path: Path,
) -> None:
    """The exit code is that of the flight, which is printed; the report shows no figure that is not there."""
    monkeypatch.setattr(broken, failing(error))
    out, gone = tmp_path / "out", {name for name in WHOLE if any(name.startswith(part) for part in lost)}
    assert run_command_line(["solve", ORDINARY, "--out", str(out)]) == 5  # of SOLVED, as without --out
    told = capsys.readouterr()
    assert "154.541347 kg" in told.out and f"written to {out}, except" in told.out
    assert (
        ("is not written" in told.err or "is not drawn" in told.err or "is drawn" in told.err)
        and said in told.err
        and "Traceback" not in told.err
    )
    assert snapshot(out).keys() == WHOLE - gone
    if "report.md" not in gone:
        report = (out / "report.md").read_text(encoding="utf-8")
        assert {f"figures/{name}" in report for name in ("costates.png",)} == {"figures/costates.png" not in gone}
    assert run_command_line(["solve", ORDINARY, "--out", str(out), "--force", "--json"]) == 5
    document = read_json(capsys.readouterr().out)
    assert document["outcome"] == "SOLVED" and said in json.dumps(document["not_written"])
    assert pl.load(out).objective == ordinary.objective
    with pytest.raises(NotWrittenError) as raised:  # and from Python, after all others are written
        write_all(ordinary, tmp_path / "again", scenario_text=None)
    assert snapshot(tmp_path / "again").keys() == WHOLE - gone
    assert raised.value.__cause__ is error and said in str(raised.value)


def test_a_solution_saved_from_python_is_there_where_its_table_is_not(
    monkeypatch: pytest.MonkeyPatch, ordinary: Solution, tmp_path: Path
) -> None:
    monkeypatch.setattr(export, "trajectory_csv", failing(TypeError("no row")))
    with pytest.raises(pl.PeriluneError, match=r"(?s)trajectory\.csv is not written.*TypeError: no row"):
        pl.save(ordinary, tmp_path / "flight")
    assert snapshot(tmp_path / "flight").keys() == {"solution.json"}
    assert pl.load(tmp_path / "flight").objective == ordinary.objective


@pytest.mark.parametrize(("error", "code"), [(FULL, 5), (AttributeError("x"), 5)])
@pytest.mark.usefixtures("solved")
def test_the_answer_is_printed_where_nothing_can_be_written(
    error: Exception, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(export, "whole_document", failing(error))
    out = tmp_path / "out"
    assert run_command_line(["solve", ORDINARY, "--out", str(out)]) == code
    told = capsys.readouterr()
    assert "154.541347 kg" in told.out and "written to" not in told.out and (error.args[-1] in told.err)
    assert "report.md" in snapshot(out) and "solution.json" not in snapshot(out)


@pytest.mark.usefixtures("solved")
def test_a_proved_answer_whose_solution_is_not_kept_is_no_success(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], ordinary: Solution, tmp_path: Path
) -> None:
    """Whoever asked for files and looks at the exit code alone has to learn of it; of a figure it need not."""
    proved = pl.verify(ordinary, 1)
    monkeypatch.setattr(pl, "solve", lambda *_, **__: proved)
    monkeypatch.setattr("perilune.report.figures.costate_figure", failing(TypeError("x")))
    assert run_command_line(["solve", ORDINARY, "--out", str(tmp_path / "whole")]) == 0
    monkeypatch.setattr(export, "whole_document", failing(FULL))
    assert run_command_line(["solve", ORDINARY, "--out", str(tmp_path / "out")]) == 2
    monkeypatch.setattr(export, "whole_document", failing(TypeError("x")))
    assert run_command_line(["solve", ORDINARY, "--out", str(tmp_path / "other")]) == 1
    assert capsys.readouterr().out.count("154.541347 kg") >= 3


@pytest.mark.usefixtures("solved")
def test_a_flight_whose_results_cannot_be_told_is_told_by_what_was_chosen(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], ordinary: Solution
) -> None:
    monkeypatch.setattr(export, "extremals_document", failing(AttributeError("_asdict")))
    assert run_command_line(["solve", ORDINARY]) == 1
    told = capsys.readouterr()
    assert "SOLVED" in told.out and "flight_time: 1005.35" in told.out and "fault of the program" in told.err
    assert run_command_line(["solve", ORDINARY, "--json"]) == 1
    document = read_json(capsys.readouterr().out)
    assert document["values"]["flight_time"] == ordinary.free["flight_time"] and "_asdict" in json.dumps(document)


def test_a_family_is_printed_where_its_figure_is_not_drawn(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], ordinary: Solution, tmp_path: Path
) -> None:
    point = FamilyPoint(values=(310.0,), solution=ordinary)
    family = Family(problem=ordinary.problem, parameters=("retro_specific_impulse",), points=(point,))
    monkeypatch.setattr("perilune.report.family.family_figure", failing(ValueError("no axis")))
    with pytest.raises(NotWrittenError, match="family is not drawn"):
        write_family(family, tmp_path / "f")
    assert snapshot(tmp_path / "f").keys() == {"family.json", "family.csv"}
    monkeypatch.setattr("perilune.sweep", lambda *_, **__: family)
    vary = ["--vary", "vehicle.thrust=440:440:1 N", "--out", str(tmp_path / "out")]
    assert run_command_line(["sweep", ORDINARY, *vary]) == 5
    told = capsys.readouterr()
    assert "1005.3507046" in told.out and "no axis" in told.err


def test_a_refusal_is_told_where_its_record_cannot_be_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def refused(*_: Any, **__: Any) -> Solution:
        raise pl.InfeasibleError("too weak an engine")

    monkeypatch.setattr(pl, "solve", refused)
    monkeypatch.setattr(export, "program_versions", failing(TypeError("no version")))
    assert run_command_line(["solve", ORDINARY, "--out", str(tmp_path / "out")]) == 3
    told = capsys.readouterr().err
    assert "too weak an engine" in told and "no version" in told


@pytest.mark.usefixtures("solved")
def test_who_writes_the_program_is_shown_what_failed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("PERILUNE_TRACEBACK", "1")
    monkeypatch.setattr("perilune.report.figures.costate_figure", failing(TypeError("x")))
    assert run_command_line(["solve", ORDINARY, "--out", str(tmp_path / "out")]) == 5
    told = capsys.readouterr()
    assert "Traceback" in told.err and "154.541347 kg" in told.out


def test_a_certificate_that_is_there_already_is_refused_before_the_proof(
    capsys: pytest.CaptureFixture[str], ordinary: Solution, tmp_path: Path
) -> None:
    pl.save(ordinary, tmp_path / "flight")
    (tmp_path / "c.json").write_text("mine")
    assert (
        run_command_line(
            ["verify", str(tmp_path / "flight"), "--level", "1", "--certificate", str(tmp_path / "c.json")]
        )
        == 2
    )
    assert "already exists" in capsys.readouterr().err and (tmp_path / "c.json").read_text() == "mine"


def test_a_folder_in_the_place_of_a_file_takes_no_other_file_with_it(tmp_path: Path) -> None:
    """The place that could not be filled is named, and not the folder beside it in which files are written first."""
    target = tmp_path / "out"
    (target / "report.md").mkdir(parents=True)
    (target / "figures").write_text("mine")
    with pytest.raises(OSError) as error, fresh_directory(target, force=True) as work:
        (work / "figures").mkdir()
        for name in ("figures/mass.svg", "report.md", "solution.json"):
            (work / name).write_text(name)
    assert Path(error.value.filename) == target / "figures"
    assert (target / "solution.json").read_text() == "solution.json"
    assert (target / "figures").read_text() == "mine"
    (target / "figures").unlink()
    with pytest.raises(OSError) as error, fresh_directory(target, force=True) as work:
        (work / "report.md").write_text("report")
    assert Path(error.value.filename) == target / "report.md"
    assert {path.name for path in tmp_path.iterdir()} == {"out"}
