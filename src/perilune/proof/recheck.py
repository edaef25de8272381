"""Recheck of the extremals that a file lists in addition to its answer: each is found again and proved, or left out.

Newton's method starts from the unknowns that the file holds of an extremal. What it reaches must have the objective and
the free parameters that are listed, and must pass levels 1 and 2 as any solution does. The numbers that remain are
those reached; what each extremal *is* follows only from them: its curvature, the bounds that it sits on, and its place
among those that were found again. A single optimum is not called the best.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from perilune.core import PeriluneError
from perilune.methods import Indirect
from perilune.problem import Extremal, Nature, Solution
from perilune.proof.levels import examine
from perilune.proof.sufficient.sensitivities import Resolve

SAME = 1e-6  # canonical, relative to one plus the size: nearer than this, what is listed is what was reached
MOST_LISTED = 32  # that are looked at; a problem has a handful
_ALONE = {Nature.NEAR_GUESS: Nature.LOCAL_OPTIMUM, Nature.NEAR_GUESS_AT_BOUND: Nature.LOCAL_OPTIMUM_AT_BOUND}
_BEST = {Nature.LOCAL_OPTIMUM: Nature.BEST, Nature.LOCAL_OPTIMUM_AT_BOUND: Nature.BEST_AT_BOUND}


def confirm_listed_extremals(solution: Solution, resolve: Resolve) -> tuple[tuple[Extremal, ...], tuple[str, ...]]:
    """Return the `Solution.unverified_extremals` that are confirmed, this solution the first, with notes on them.

    Parameters
    ----------
    solution
        Whose file lists extremals, itself the first.
    resolve
        ``resolve(problem, guess)`` returns the extremal next to a guess.
    """
    claims, listed = len(solution.unverified_extremals), solution.unverified_extremals[:MOST_LISTED]
    own = _find_again(solution, solution, listed[0], resolve)
    if own is None:
        return (), (f"none of the {claims} extremals listed in the file is confirmed; they are left out",)
    itself = replace(own, free=solution.free, objective=solution.objective)
    others: list[Extremal] = []
    for entry in listed[1:]:
        unknowns = np.array(entry.unknowns) if entry.unknowns else None
        guess = replace(solution, method=Indirect.name, free=entry.free, unknowns=unknowns)
        found = _find_again(solution, guess, entry, resolve, proved=True)
        if found is not None and not any(_is_same_extremal(solution, found, known) for known in (itself, *others)):
            others.append(found)
    others.sort(key=lambda e: (e.nature is Nature.WORST, e.objective))
    notes = []
    if left := len(solution.unverified_extremals) - 1 - len(others):
        total = len(solution.unverified_extremals)
        notes.append(f"{left} of the {total} extremals listed in the file {_are(left)} not confirmed, and left out")
    if any(e.objective < itself.objective for e in others):
        notes.append("a better extremal than this solution is known; it is listed below it")
    elif any(e.nature is not Nature.WORST for e in others):
        itself = replace(itself, nature=_BEST.get(itself.nature, itself.nature))
    return (itself, *others), tuple(notes)


def _find_again(
    solution: Solution, guess: Solution, entry: Extremal, resolve: Resolve, *, proved: bool = False
) -> Extremal | None:
    """Return the extremal that Newton reaches from a guess, if it is the listed one and, where asked, is proved."""
    try:
        with np.errstate(all="ignore"):  # of unknowns that were not checked before
            found = resolve(solution.problem, guess)
    except (PeriluneError, ArithmeticError, np.linalg.LinAlgError):
        return None
    reached = replace(found.extremals[0], nature=_ALONE.get(found.extremals[0].nature, found.extremals[0].nature))
    if not _is_same_extremal(solution, reached, entry) or (proved and not examine(found, 2, resolve).passed):
        return None
    return reached


def _is_same_extremal(solution: Solution, one: Extremal, other: Extremal) -> bool:
    """Return True if two extremals are the same one, by their objective and their free parameters."""
    problem = solution.problem
    pairs = [(problem.objective_size, one.objective, other.objective)]
    pairs += [(problem.size_of(f), one.free[f.name], other.free.get(f.name, np.nan)) for f in problem.free]
    return all(abs(a - b) <= SAME * (size + abs(a)) for size, a, b in pairs)


def _are(count: int) -> str:
    return "is" if count == 1 else "are"
