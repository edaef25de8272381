"""Derived content of saved files, compared with the solution itself.

``solution.json`` states results beside its curves, and ``trajectory.csv`` repeats the curves. Each number of these is
computed again and compared with what stands there; a file that differs is a failed check of level 1, which names the
place. A number may differ by no more than a change of each state, control and costate by rounding makes of it: so
nothing is loose for being small, and nothing is asked for that another machine's rounding takes away.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from io import StringIO
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from perilune.io.columns import columns
from perilune.io.export import answer_document, phases_document, trajectory_name
from perilune.io.format import LARGEST_FILE, SOLUTION_FILE
from perilune.problem.solution import Curve, Solution
from perilune.problem.verification import Check
from perilune.words.bounded import bounded_text
from perilune.words.outcome import PeriluneError
from perilune.words.types import Matrix, Vector

ROUNDING = 1e-12  # of each component of the curves: that of other machines
AGREEMENT = 1e-10  # the same for results, which are integrals and differences of large numbers
_WRITTEN = 1e-14  # relative: angles are written with 15 digits
_CURVES = ("state", "control", "costate")
_PARTS = ("objective", "free", "results", "multipliers")  # of `solution.json`, which follow from the others


@dataclass(frozen=True)
class Repeated:
    """Derived content of the files of one solution, which repeats the solution.

    Attributes
    ----------
    place
        The directory that it was loaded from; None where it was a file alone, beside which nothing lies.
    said
        Those parts of ``solution.json`` that follow from the others.
    """

    place: Path | None
    said: Mapping[str, Any]

    @classmethod
    def of(cls, path: Path, document: Mapping[str, Any]) -> Repeated:
        """Return the derived content of a loaded document and the place of its files."""
        phases = [{name: value for name, value in p.items() if name not in _CURVES} for p in document["phases"]]
        parts = {name: document[name] for name in _PARTS if name in document}
        return cls(path if path.is_dir() else None, {**parts, "phases": phases})

    def __call__(self, solution: Solution) -> tuple[Check, ...]:
        """Return a check of level 1 for each file."""
        checks = [file_check(SOLUTION_FILE, list(_document_slips(solution, self.said)))]
        if self.place is None or not self.place.is_dir():
            return tuple(checks)
        tables = {trajectory_name(solution, k): k for k in range(len(solution.trajectories))}
        for name in sorted(path.name for path in self.place.iterdir() if is_table(path.name)):
            if name in tables:
                checks.append(compared(name, self.place, lambda text, k=tables[name]: _table_slips(solution, k, text)))
            else:
                checks.append(file_check(name, ["no phase of this solution has this file"]))
        return tuple(checks)


def is_table(name: str) -> bool:
    """Return True if a file would be taken for the trajectory of a phase."""
    return name.startswith("trajectory") and name.endswith(".csv")


def compared(name: str, place: Path, slips: Callable[[str], Iterator[str]]) -> Check:
    """Return the check of a file of text, failed if it cannot be read."""
    try:
        text = bounded_text(place / name, "file", LARGEST_FILE, expected="as it was written", advice="remove it")
        return file_check(name, list(slips(text)))
    except (PeriluneError, csv.Error) as error:
        return file_check(name, [f"it cannot be read: {getattr(error, 'what', error)}"])


def file_check(name: str, slips: list[str]) -> Check:
    """Return the check of a file with these differences."""
    first = f"; the first: {slips[0]}" if slips else ""
    return Check(
        name=name, level=1, value=float(len(slips)), limit=0.0, unit="1",
        meaning=f"how many entries of {name} are not what was proved{first}",
    )  # fmt: skip


def _moved(solution: Solution, k: int, share: float) -> Iterator[Solution]:
    """Yield the solution with one component of one curve of phase k enlarged by a share of it, for each component."""
    flown = solution.trajectories[k]
    for kind in _CURVES:
        curve: Curve | None = getattr(flown, kind)
        if curve is None:
            continue
        count = curve.values.shape[1]
        for i in range(count):
            factors = np.where(np.arange(count) == i, 1.0 + share, 1.0)
            moved = replace(flown, **{kind: replace(curve, values=curve.values * factors, rates=curve.rates * factors)})
            yield replace(solution, trajectories=(*solution.trajectories[:k], moved, *solution.trajectories[k + 1 :]))


# -- the document ---------------------------------------------------------------------------------------------------


def _document_slips(solution: Solution, said: Mapping[str, Any]) -> Iterator[str]:
    """Yield the entries of the document that differ from the solution."""
    known = {**answer_document(solution), "phases": phases_document(solution)}
    slips = [slip for part in said for slip in _differences(said[part], known[part], part, {})]
    if slips:  # they may be rounding
        limits = {f"results.{name}": limit for name, limit in _result_limits(solution).items()}
        slips = [slip for part in said for slip in _differences(said[part], known[part], part, limits)]
    yield from slips


def _result_limits(solution: Solution) -> dict[str, float]:
    """Return the limit by which each result may differ."""
    found = {name: result.value for name, result in solution.results.items()}
    limits = {name: AGREEMENT * abs(value) for name, value in found.items()}
    for k in range(len(solution.trajectories)):
        for other in _moved(solution, k, AGREEMENT):
            for name, result in other.results.items():
                limits[name] += abs(result.value - found[name])
    return limits


def _differences(said: Any, known: Any, where: str, limits: Mapping[str, float]) -> Iterator[str]:
    """Yield the entries of a file that are different, or missing, in the known tree."""
    if isinstance(said, dict) and isinstance(known, dict):
        for name, value in said.items():
            if name not in known:
                yield f"{where}.{name}"[:80] + " is nothing that the problem has"
            elif name == "value":
                if not _near(value, known[name], limits.get(where, 0.0)):
                    yield f"{where} is {_shown(known[name])}, not {_shown(value)}"
            elif name != "description":
                yield from _differences(value, known[name], f"{where}.{name}", limits)
    elif isinstance(said, list) and isinstance(known, list) and len(said) == len(known):
        for i, (one, other) in enumerate(zip(said, known, strict=True)):
            yield from _differences(one, other, f"{where}[{i}]", limits)
    elif said != known:
        yield f"{where} is {_shown(known)}, not {_shown(said)}"


def _near(said: Any, known: Any, limit: float) -> bool:
    if said is None or known is None:
        return said is known
    number = isinstance(said, int | float) and not isinstance(said, bool)
    return number and abs(said - known) <= limit


def _shown(value: Any) -> str:
    return f"{value:.12g}" if isinstance(value, float) else repr(value)[:60]


# -- the table ------------------------------------------------------------------------------------------------------


def _table_slips(solution: Solution, k: int, text: str) -> Iterator[str]:
    """Yield the cells of a table that differ from the solution, by row (the heading is row 1) and column."""
    headings = [column.heading for column in columns(solution, k).values()]
    rows = list(csv.reader(StringIO(text)))
    first = [*headings[:-1], f"H [{solution.problem.objective_unit}/s]"]  # as the first tables called it: [s/s], too
    if not rows or rows[0] not in (headings, first):
        pairs = zip_longest(rows[0] if rows else [], headings, fillvalue="nothing")
        said, known = next((a, b) for a, b in pairs if a != b)
        yield f"row 1: a column {said[:40]!r} in place of {known!r}"
        return
    values, behind = _values(solution, k), _values(solution, k, solution.trajectories[k].time)
    if len(rows) - 1 != values.shape[1]:
        yield f"{len(rows) - 1} rows below the heading in place of {values.shape[1]}"
    # The first tables had angles begin again where their range ends.
    angles = np.isin(headings, [f"{v.name} [deg]" for v in solution.problem.phases[k].output_variables])
    limits: Matrix | None = None
    for number, (row, known, after) in enumerate(zip(rows[1:], values.T, behind.T, strict=False)):
        if len(row) != len(headings):
            yield f"row {number + 2}: {len(row)} cells in place of {len(headings)}"
            continue
        said, blank = np.array([_number(cell) for cell in row]), np.array([cell == "" for cell in row])
        said += np.where(angles & np.isfinite(said), 360.0 * np.round(np.nan_to_num(known - said) / 360.0), 0.0)
        alike = (np.abs(said - known) <= _WRITTEN * np.abs(known)) | (np.isnan(known) & blank)
        if not alike.all():  # it may be rounding
            limits = _cell_limits(solution, k) if limits is None else limits
            near = [np.abs(said - value) <= limits[:, number] for value in (known, after)]
            alike |= near[0] | near[1]  # the first tables had what is behind a switch in both rows of it
        for at in np.nonzero(~alike)[0]:
            yield f"row {number + 2}, {headings[at]}: {row[at][:40]} in place of {float(known[at])!r}"


def _values(solution: Solution, k: int, t: Vector | None = None) -> Matrix:
    """Return the table of phase k, (columns, nodes)."""
    return np.array([column.values for column in columns(solution, k, t).values()])


def _cell_limits(solution: Solution, k: int) -> Matrix:
    """Return the limit by which each cell of it may differ."""
    values = _values(solution, k)
    limits = np.zeros(values.shape) + ROUNDING * np.nanmax(np.abs(values), axis=1, initial=0.0)[:, None]
    for other in _moved(solution, k, ROUNDING):
        limits += np.nan_to_num(np.abs(_values(other, k) - values))
    return limits


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
