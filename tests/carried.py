"""Every step that a scenario may go through, from its file to what others read of its flight."""

from __future__ import annotations

import csv
import io
import json
import math
import pickle
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import perilune as pl
from perilune import Family, FamilyPoint, export, save
from perilune.app.messages import flight_message as frame, opening_message
from perilune.app.source import subject_of
from perilune.cli import run_command_line
from perilune.direct.first_guess import first_guesses
from perilune.io import json_text, solution_document
from perilune.io.exports.writing import FORMATS, to_dataframe, to_xarray
from perilune.problem import Curve
from perilune.report.family import family_csv, family_document, family_figure
from perilune.report.figures import solution_drawings
from perilune.report.notebook import solution_page
from perilune.report.summary import solution_markdown, solution_summary
from perilune.scenario import load_file
from perilune.scenario.text import parse

EPOCH = "2026-06-01T12:00:00Z"
AIR = "0,1.225\n20e3,0.0889\n60e3,3.1e-4\n100e3,5.6e-7\n130e3,8.2e-9\n"


def said(*arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command."""
    out, error = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(error):
        code = run_command_line(list(arguments))
    return code, out.getvalue(), error.getvalue()


def rough_flight(problem: pl.Problem) -> pl.Solution:
    """A flight from which a direct method would start, with curves in the place of costates: none, but whole."""
    _, lines, _ = next(iter(first_guesses(problem, None)))
    free = {f.name: min(max(f.guess, f.lower), f.upper) for f in problem.free}
    times, states, controls = [], [], []
    for phase, line in zip(problem.phases, lines, strict=True):
        share = np.linspace(0.0, 1.0, 21)
        x, u = line(share)
        times.append(share * float(getattr(problem.parameters(free), str(phase.duration))))
        states.append(x)
        controls.append(u)
    rows = (times, states, controls) if len(problem.phases) > 1 else (times[0], states[0], controls[0])
    others = {name: value for name, value in free.items() if name not in problem.duration_names}
    made = pl.guess(problem, *rows, **others)
    flown = [replace(t, costate=Curve(time=t.state.time, values=np.cos(t.state.values), rates=np.sin(t.state.values)))
             for t in made.trajectories]  # fmt: skip
    return replace(made, trajectories=tuple(flown), objective=1.0)


class Carried:
    """One scenario, carried step by step; the names of the steps are counted."""

    def __init__(self, folder: Path, text: str) -> None:
        self.folder, self.text, self.steps = folder, text, list[str]()
        self.file = folder / "scenario.toml"
        folder.mkdir(parents=True, exist_ok=True)
        self.file.write_text(text, encoding="utf-8")
        (folder / "air.csv").write_text(AIR, encoding="utf-8")
        self.loaded = load_file(self.file)
        self.problem = self.loaded.problem

    def step(self, name: str) -> None:
        self.steps.append(name)

    def check(self) -> None:
        """Possible, or refused by physics; never a fault."""
        code, out, error = said("check", str(self.file))
        assert code in (0, 3) and self.problem.heading in (out if code == 0 else error), error
        code, out, _ = said("check", str(self.file), "--json")
        assert code in (0, 3) and json.loads(out)["findings"] is not None
        self.step("check")

    def solved(self) -> pl.Solution:
        """Solved from nothing, without a proof."""
        found = pl.solve(self.problem, verify=0)
        assert found.outcome is pl.Outcome.SOLVED
        self.step("solve")
        return found

    def proved(self, back: pl.Solution) -> None:
        """What was loaded is proved to level 1, its files compared with it."""
        verification = pl.verify(back, level=1).verification
        assert verification.passed and verification.level == 1, verification.failed
        self.step("verify")

    def swept(self, solution: pl.Solution) -> None:
        """Two members along a mass, in words and as a table."""
        mass = solution.problem.given["vehicle_mass"].value
        self.listed(pl.sweep(solution.problem, {"vehicle_mass": [mass, 1.001 * mass]}, verify=0))
        self.step("sweep")

    def listed(self, family: Family) -> None:
        """A family of two as table, document and figure."""
        assert [point.outcome for point in family.points] == [pl.Outcome.SOLVED] * 2
        table = list(csv.reader(io.StringIO(family_csv(family))))
        assert len(table) == 3 and len({len(row) for row in table}) == 1
        assert len(family_document(family)["points"]) == 2 and family_figure(family).axes
        self.step("table and figure of a family")

    def paired(self, solution: pl.Solution) -> None:
        """The same of a family that was not swept."""
        members = tuple(FamilyPoint(values=(value,), solution=solution) for value in (1.0, 2.0))
        mass = next(name for name in solution.problem.given if name.endswith("_mass"))
        self.listed(Family(problem=solution.problem, parameters=(mass,), points=members))

    def by_command(self) -> None:
        """All of it by the command line: solved with all files, proved again, exported, swept; no fault anywhere."""
        out = str(self.folder / "out")
        code, text, error = said("solve", str(self.file), "--level", "0", "--out", out)
        assert code == 5 and self.problem.heading in text and "not" not in text.rpartition("written to")[2], error
        drawn = {path.stem for path in (self.folder / "out" / "figures").iterdir()}
        assert drawn and drawn == set(solution_drawings(pl.load(out))), "a figure is missing"
        code, text, error = said("verify", out, "--level", "1")
        assert code == 0 and "level 1: feasible" in text, error
        code, _, error = said("export", out, "--out", str(self.folder / "out.nc"))
        assert code == 0, error
        mass = self.problem.given["vehicle_mass"].value
        vary = f"vehicle.mass={mass!r}:{1.001 * mass!r}:{0.001 * mass!r} kg"
        code, text, error = said("sweep", str(self.file), "--vary", vary, "--level", "0", "--out", f"{out}_family")
        assert code == 0 and len(list(csv.reader(io.StringIO(text)))) == 3, error
        self.step("by command: solve --out, verify, export, sweep --out")

    def told(self, solution: pl.Solution) -> None:
        """In words, as JSON and on a page; the same through a process border."""
        results = solution.results
        assert results and all(isinstance(found.value, float) for found in results.values())
        assert solution.problem.heading in solution_summary(solution)
        assert "nan" not in json_text(solution_document(solution)).lower().replace("nanometre", "")
        markdown = solution_markdown(solution, ["path"], self.text)
        assert "## Results" in markdown and "```toml" in markdown
        assert "<img" in solution_page(solution)
        assert pickle.loads(pickle.dumps(solution)) == solution
        self.step("summary, JSON, report, notebook, pickle")

    def saved(self, solution: pl.Solution) -> pl.Solution:
        """Saved and loaded: the same problem, flight and results."""
        save(solution, self.folder / "saved", self.loaded.text, force=True)
        back = pl.load(self.folder / "saved")
        assert back.problem == solution.problem
        same = {name: (found.value, back.results[name].value) for name, found in solution.results.items()}
        for one, other in same.values():
            assert one == other or (math.isnan(one) and math.isnan(other)) or math.isclose(one, other, rel_tol=1e-9)
        for one, other in zip(solution.trajectories, back.trajectories, strict=True):
            np.testing.assert_array_equal(one.state.values, other.state.values)
        self.step("save, load")
        return back

    def exported(self, solution: pl.Solution, *, timed: bool = True) -> None:
        """Every format; those of places in space, where there is one, and refused where there is none.

        Of a flight that is none, such places are made ever finer in vain: `timed` leaves them out.
        """
        for form in FORMATS if timed else FORMATS[:3]:
            file = self.folder / f"flight.{form}"
            if form in ("oem", "czml") and solution.problem.views.space is None:
                with pytest.raises(pl.PeriluneError, match="needs a position in space"):
                    export(solution, file, form, epoch=EPOCH, force=True)
                continue
            export(solution, file, form, epoch=EPOCH, scenario_text=self.text, force=True)
            assert file.stat().st_size > 100
            self.step(f"export {form}")
        table = list(
            csv.reader(line for line in (self.folder / "flight.csv").read_text().splitlines() if line[:1] != "#")
        )
        assert len(table) > 3 and len({len(row) for row in table}) == 1
        rows, times = to_dataframe(solution).index, to_xarray(solution).time  # the latter a microsecond apart
        assert 0 <= len(rows) - len(times) <= np.count_nonzero(np.diff(rows) < 1e-6)
        self.step("xarray, pandas")

    def drawn(self, solution: pl.Solution) -> None:
        """Every figure, as far as it is drawn without laying it out."""
        for name, draw in solution_drawings(solution).items():
            assert draw().axes, name
            self.step(f"figure {name}")

    def explored(self, solution: pl.Solution) -> None:
        """The page of the explorer with one frame, from the scenario and from its directory."""
        for subject in (subject_of(self.file), subject_of(self.folder / "saved")):
            assert json.dumps(opening_message(subject), allow_nan=False)
            if subject.text:
                parse(subject.scenario({knob.name: knob.value * 1.001 for knob in subject.knobs[:1]}))
        page = frame(solution)
        assert len(page["phases"]) == len(solution.problem.phases) and json.dumps(page, allow_nan=False)
        self.step("explorer")
