"""A directory of a solution, proved: the solution first, then everything in the directory that repeats its numbers.

What a reader takes for the answer is not only what was flown: ``solution.json`` states results beside its curves,
``trajectory.csv`` repeats the curves, ``report.md`` the results. Each number of these is computed again from what was
proved and compared with what stands there. A file that differs is a failed check, which names the place; pictures and
files of others are named as not compared.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from io import StringIO
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from perilune.io.columns import columns
from perilune.io.export import trajectory_name, whole_document
from perilune.io.reload import LARGEST_FILE, SOLUTION_FILE, read_document, solution_of
from perilune.problem.solution import Nature, Solution
from perilune.problem.verification import Check
from perilune.report import REPORT_FILE
from perilune.report.summary import extremal_cells, quantity
from perilune.solve import as_far_as, judged, prove
from perilune.words.bounded import bounded_text
from perilune.words.outcome import PeriluneError

ROUNDING = 1e-12  # relative to one canonical unit plus the largest of a column: that of other machines
AGREEMENT = 1e-10  # the same of results, which are integrals and differences of large numbers
_MOST_NAMES = 8
_CURVES = ("state", "control", "costate")
_REPEATED = ("objective", "free", "results", "multipliers")  # parts of `solution.json` that follow from the others
_NUMBER = re.compile(r"-?\d+\.\d+")


def proved_directory(directory: str | Path, level: int = 3) -> Solution:
    """Load the solution in a directory, prove it, and compare what lies beside it.

    Parameters
    ----------
    directory
        As `perilune.save` and ``perilune solve --out`` write it; or the file ``solution.json`` alone.
    level
        Verification level, 1 to 4.

    Returns
    -------
    Solution
        With its verification; of each file that was compared this has a check of level 1.

    Raises
    ------
    PeriluneError
        As `perilune.load`.
    """
    place, document = Path(directory), read_document(directory)
    solution = prove(solution_of(document), level)
    found = solution.verification
    if not found.passed:
        note = "what lies beside the solution was not compared, as it is not proved itself"
        return replace(solution, verification=replace(found, notes=(*found.notes, note)))
    checks = [_answer(solution, document)]
    notes = found.notes
    if place.is_dir():
        beside, told = _beside(solution, document, place)
        checks, notes = [*checks, *beside], (*notes, *told)
    return judged(solution, replace(found, checks=(*found.checks, *checks), notes=notes), level)


def _beside(solution: Solution, document: Mapping[str, Any], place: Path) -> tuple[list[Check], list[str]]:
    """Checks of the other files in the directory, and what was not looked at."""
    tables = {trajectory_name(solution, k): k for k in range(len(solution.trajectories))}
    checks, left, notes = [], [], []
    for name in sorted(path.name for path in place.iterdir()):
        if name in tables:
            checks.append(_compared(name, place, lambda text, k=tables[name]: _table_slips(solution, k, text)))
        elif name.startswith("trajectory") and name.endswith(".csv"):
            checks.append(_check(name, ["no phase of this solution has this file"]))
        elif name == REPORT_FILE:
            whole = len(solution.extremals) == len(document["extremals"])
            checks.append(_compared(name, place, lambda text, whole=whole: _report_slips(solution, text, whole)))
            left.append(f"{name} beyond its results" + (" and extremals" if whole else ""))
        elif name != SOLUTION_FILE:
            left.append(repr(name)[1:-1][:60])
    if left:
        more = f" and {len(left) - _MOST_NAMES} more" if len(left) > _MOST_NAMES else ""
        notes.append(f"not compared with what was proved: {', '.join(left[:_MOST_NAMES])}{more}")
    return checks, notes


def _compared(name: str, place: Path, slips: Callable[[str], Iterator[str]]) -> Check:
    """The check of one file of text; one that cannot be read repeats nothing that was proved."""
    try:
        text = bounded_text(place / name, "file", LARGEST_FILE, expected="as it was written", advice="remove it")
        return _check(name, list(slips(text)))
    except (PeriluneError, csv.Error) as error:
        return _check(name, [f"it cannot be read: {getattr(error, 'what', error)}"])


def _check(name: str, slips: list[str]) -> Check:
    first = f"; the first: {slips[0]}" if slips else ""
    return Check(
        name=name, level=1, value=float(len(slips)), limit=0.0, unit="1",
        meaning=f"how many entries of {name} are not what was proved{first}",
    )  # fmt: skip


# -- the document ---------------------------------------------------------------------------------------------------


def _answer(solution: Solution, document: Mapping[str, Any]) -> Check:
    """Results, units and names that the file states beside its curves."""
    known = whole_document(solution)
    slips = [slip for part in _REPEATED for slip in _differences(document.get(part, {}), known[part], part, solution)]
    for k, (said, phase) in enumerate(zip(document["phases"], known["phases"], strict=True)):
        rest = {name: value for name, value in said.items() if name not in _CURVES}
        slips += _differences(rest, phase, f"phases[{k}]", solution)
    return _check(SOLUTION_FILE, slips)


def _differences(said: Any, known: Any, where: str, solution: Solution) -> Iterator[str]:
    """Entries that a file has and that are others, or none, in what is known."""
    if isinstance(said, dict) and isinstance(known, dict):
        for name, value in said.items():
            if name not in known:
                yield f"{where}.{name}"[:80] + " is nothing that the problem has"
            elif name == "value":
                near = _near(value, known[name], _scale(solution, known["unit"]))
                yield from () if near else [f"{where} is {_shown(known[name])}, not {_shown(value)}"]
            elif name != "description":
                yield from _differences(value, known[name], f"{where}.{name}", solution)
    elif isinstance(said, list) and isinstance(known, list) and len(said) == len(known):
        for i, (one, other) in enumerate(zip(said, known, strict=True)):
            yield from _differences(one, other, f"{where}[{i}]", solution)
    elif said != known:
        yield f"{where} is {_shown(known)}, not {_shown(said)}"


def _near(said: Any, known: Any, scale: float) -> bool:
    if said is None or known is None:
        return said is known
    number = isinstance(said, int | float) and not isinstance(said, bool)
    return number and abs(said - known) <= AGREEMENT * (scale + abs(known))


def _scale(solution: Solution, unit: str) -> float:
    """Size of the canonical unit in a unit as tables write it: degrees, and costates per compound unit in brackets."""
    over, _, under = unit.replace("deg", "rad").partition("/(")
    of = solution.problem.scales.of
    return of(over) / (of(under.rstrip(")")) if under else 1.0)


def _shown(value: Any) -> str:
    return f"{value:.12g}" if isinstance(value, float) else repr(value)[:60]


# -- the table ------------------------------------------------------------------------------------------------------


def _table_slips(solution: Solution, k: int, text: str) -> Iterator[str]:
    """Cells of a table that are not those of the solution, by row (the heading is row 1) and column."""
    table = columns(solution, k)
    rows = list(csv.reader(StringIO(text)))
    headings = [column.heading for column in table.values()]
    if not rows or rows[0] != headings:
        pairs = zip_longest(rows[0] if rows else [], headings, fillvalue="nothing")
        said, known = next((a, b) for a, b in pairs if a != b)
        yield f"row 1: a column {said[:40]!r} in place of {known!r}"
        return
    values = np.array([column.values for column in table.values()])
    scale = np.array([_scale(solution, column.unit) for column in table.values()])
    limit = ROUNDING * (scale + np.nanmax(np.abs(values), axis=1, initial=0.0))
    count = values.shape[1]
    if len(rows) - 1 != count:
        yield f"{len(rows) - 1} rows below the heading in place of {count}"
    for number, (row, known) in enumerate(zip(rows[1:], values.T, strict=False), 2):
        if len(row) != len(headings):
            yield f"row {number}: {len(row)} cells in place of {len(headings)}"
            continue
        said = np.array([_number(cell) for cell in row])
        alike = (np.abs(said - known) <= limit) | (np.isnan(known) & np.array([cell == "" for cell in row]))
        for at in np.nonzero(~alike)[0]:
            yield f"row {number}, {headings[at]}: {row[at][:40]} in place of {float(known[at])!r}"


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


# -- the report -----------------------------------------------------------------------------------------------------


def _report_slips(solution: Solution, text: str, whole: bool) -> Iterator[str]:
    """Rows of the tables of results and, where all of them are confirmed, of extremals that are others."""
    found = {name.replace("_", " "): (quantity(r.value, r.unit), r.unit) for name, r in solution.results.items()}
    for name, *cells in _rows(text, "Results")[1:]:
        known = found.get(name, ("nothing", ""))
        if len(cells) < 2 or not all(map(_same_cell, cells, known)):
            yield f"Results, {name[:40]}: {' '.join(cells[:2])[:40]} in place of {' '.join(known)}"
    if not whole:
        return
    head, *rows = _rows(text, "Extremals") or [[]]
    listed = extremal_cells(solution)
    for number, cells in enumerate(rows, 1):
        known = listed[number - 1] if number <= len(listed) else {}
        for name, said in zip_longest(head, cells, fillvalue=""):
            right = known.get(name, "nothing")
            same = _same_nature(said, right, len(listed)) if name == "nature" else _same_cell(said, right)
            if not same:
                yield f"Extremals, row {number}, {name[:40]}: {said[:40]} in place of {right}"


def _rows(markdown: str, heading: str) -> list[list[str]]:
    """Cells of the table below a heading, its head first."""
    section = markdown.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines[:1] + lines[2:]]


def _same_cell(said: str, known: str) -> bool:
    """Whether two cells are the same but for the last digit."""
    if not (_NUMBER.fullmatch(said) and _NUMBER.fullmatch(known)):
        return said == known
    return abs(float(said) - float(known)) <= 1.01 * 10.0 ** -len(known.partition(".")[2])


def _same_nature(said: str, known: str, count: int) -> bool:
    """Whether an extremal is called what it is, or less; of one alone there is no best, bounds are not always named."""
    try:
        named, right = Nature(said), Nature(known)
    except ValueError:
        return False
    own, *allowed = (n.value.partition(", at a bound")[0] for n in (named, right, as_far_as(right, 3), Nature.UNPROVED))
    return own in allowed or (count == 1 and Nature.WORST not in (named, right))
