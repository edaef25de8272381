"""Verification of a directory: the solution, its derived files, and its report.

A reader may take any of the files for the answer. The proof of a loaded solution compares its derived content
(`perilune.io.repeated`); here the results and extremals of ``report.md`` are compared too, a failed check naming the
place. Pictures and foreign files are named as not compared.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

from perilune.io.format import SOLUTION_FILE
from perilune.io.reload import load
from perilune.io.repeated import compared, is_table
from perilune.problem.extremal import Nature
from perilune.problem.solution import Solution
from perilune.report import REPORT_FILE
from perilune.report.summary import extremal_cells, quantity, spoken
from perilune.solve import as_far_as, judged, prove
from perilune.words.watch import Watch

_MOST_NAMES = 8
_NUMBER = re.compile(r"-?\d+\.\d+")


def proved_directory(directory: str | Path, level: int = 3, watch: Watch | None = None) -> Solution:
    """Load the solution in a directory, prove it, and compare its report.

    Parameters
    ----------
    directory
        As `perilune.save` and ``perilune solve --out`` write it; or the file ``solution.json`` alone.
    level
        Verification level, 1 to 5.
    watch
        Is told of what takes long.

    Returns
    -------
    Solution
        With its verification; of each file that was compared this has a check of level 1.

    Raises
    ------
    PeriluneError
        As `perilune.load`.
    """
    loaded, place = load(directory), Path(directory)
    solution = prove(loaded, level, watch=watch)
    found = solution.verification
    if not found.passed or not place.is_dir():
        return solution
    checks, left = found.checks, []
    for name in sorted(path.name for path in place.iterdir()):
        if name == REPORT_FILE:
            whole = len(solution.extremals) == len(loaded.listed)
            checks += (compared(name, place, lambda text, whole=whole: _report_slips(solution, text, whole)),)
            left.append(f"{name} beyond its results" + (" and extremals" if whole else ""))
        elif name != SOLUTION_FILE and not is_table(name):
            left.append(repr(name)[1:-1][:60])
    more = f" and {len(left) - _MOST_NAMES} more" if len(left) > _MOST_NAMES else ""
    notes = (f"not compared with what was proved: {', '.join(left[:_MOST_NAMES])}{more}",) if left else ()
    return judged(solution, replace(found, checks=checks, notes=(*found.notes, *notes)), level)


# -- the report -----------------------------------------------------------------------------------------------------


def _report_slips(solution: Solution, text: str, whole: bool) -> Iterator[str]:
    """Yield differing rows in the table of results and, if all extremals are confirmed, in theirs."""
    found = {told: tuple(cells) for told, *cells in (spoken(n, r) for n, r in solution.results.items())}
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
        if number <= len(solution.extremals):  # as older reports have it, where a result stands for J today
            unit, value = solution.problem.objective_unit, solution.extremals[number - 1].objective
            known = {f"objective ({unit})".removesuffix(" (1)"): quantity(value, unit)[0], **known}
        for name, said in zip_longest(head, cells, fillvalue=""):
            right = known.get(name, "nothing")
            same = _same_nature(said, right, len(listed)) if name == "nature" else _same_cell(said, right)
            if not same:
                yield f"Extremals, row {number}, {name[:40]}: {said[:40]} in place of {right}"


def _rows(markdown: str, heading: str) -> list[list[str]]:
    """Return the cells of the table below a heading, its head first."""
    section = markdown.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines[:1] + lines[2:]]


def _same_cell(said: str, known: str) -> bool:
    """Return True if two cells are equal but for the last digit."""
    if not (_NUMBER.fullmatch(said) and _NUMBER.fullmatch(known)):
        return said == known
    return abs(float(said) - float(known)) <= 1.01 * 10.0 ** -len(known.partition(".")[2])


def _same_nature(said: str, known: str, count: int) -> bool:
    """Return True if an extremal is called by its nature or a weaker one; a single one may omit it and its bounds."""
    try:
        named, right = Nature(said), Nature(known)
    except ValueError:
        return False
    own, *allowed = (n.value.partition(", at a bound")[0] for n in (named, right, as_far_as(right, 3), Nature.UNPROVED))
    return own in allowed or (count == 1 and Nature.WORST not in (named, right))
