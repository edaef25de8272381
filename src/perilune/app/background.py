"""Idle-time work of the explorer: a flight is compared with a cold start, and proved.

A flight followed from neighbour to neighbour stays on its family of extremals, even across a jump of the best.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from perilune import Extremal, Nature, Outcome, Problem, Solution, Verification, solve, verify
from perilune.app.answers import cost_along_free_parameter
from perilune.app.messages import proof_message
from perilune.core import Watch
from perilune.problem import objective_text

LEVEL = 3
_SAME = 1e-7  # of J: far above what Newton's method leaves, far below what anybody would change a flight for


@dataclass(frozen=True, kw_only=True)
class ColdStartComparison:
    """Better flight of a followed one and a cold start, with the relation between the two.

    Parameters
    ----------
    solution
        The better one, with all extremals of both.
    jumped
        True if it is not the one that was followed.
    words
        The same for people.
    family
        Of another one, and of one as it was saved: J along its free parameter
        (`perilune.app.answers.cost_along_free_parameter`), which needs it as it was found.
    """

    solution: Solution
    jumped: bool
    words: str
    family: dict[str, object] | None = None


@dataclass(frozen=True, kw_only=True)
class TimedProof:
    """Proof of a solution: outcome, checks, and time that it took [s]."""

    outcome: Outcome
    verification: Verification
    took: float

    @property
    def document(self) -> dict[str, Any]:
        """Return the message to a page."""
        level, shown = self.verification.level, proof_message(self.verification)
        return {"outcome": self.outcome.name, "level": level, "proof": shown, "took": self.took}

    def of(self, solution: Solution) -> Solution:
        """Return the solution with the proof."""
        return replace(solution, outcome=self.outcome, verification=self.verification)


def compare_with_cold_start(followed: Solution, watch: Watch) -> ColdStartComparison:
    """Solve the problem of a followed flight by a cold start, and take the better of both.

    Parameters
    ----------
    followed
        Flight that was followed from a neighbour.
    watch
        Called with each iteration and with lines of text.

    Raises
    ------
    PeriluneError
        If the cold start finds no solution.
    """
    found = solve(followed.problem, verify=0, callback=watch)
    room, best = _SAME * (1.0 + abs(found.objective)), found.extremals
    own = _followed_extremal(followed)
    if found.objective < followed.objective - room:
        if all(abs(own.objective - other.objective) > room for other in best):
            best = (*best, *_mark_dominated([own]))
        words = (
            f"the optimum has jumped: {objective_in_words(found)}, best of {len(best)} found; "
            f"{objective_in_words(followed)} where it was"
        )
        found = replace(found, extremals=best)
        return ColdStartComparison(solution=found, jumped=True, words=words, family=cost_along_free_parameter(found))
    same = abs(found.objective - followed.objective) <= room
    saved = not followed.extremals  # of which nobody has looked yet what it is: what it was found to be
    best = (*(best[:1] if same and saved else [own]), *(best[1:] if same else _mark_dominated(best)))
    words = f"best of {len(best)} found" + ("" if same else ", the others without an initial guess")
    shown = replace(followed, extremals=best, unverified_extremals=())
    return ColdStartComparison(
        solution=shown, jumped=False, words=words, family=cost_along_free_parameter(found) if same and saved else None
    )


def solve_without_guess(problem: Problem, watch: Watch) -> ColdStartComparison:
    """Solve by a cold start where no flight is near.

    Parameters
    ----------
    problem
        The problem at the values of the page.
    watch
        Called with each iteration and with lines of text.

    Raises
    ------
    PeriluneError
        If there is none.
    """
    found = solve(problem, verify=0, callback=watch)
    words = f"found without an initial guess, as none is near; best of {len(found.extremals)} found"
    return ColdStartComparison(solution=found, jumped=True, words=words, family=cost_along_free_parameter(found))


def prove_timed(solution: Solution, watch: Watch) -> TimedProof:
    """Prove a solution, and take the time.

    Parameters
    ----------
    solution
        The solution to prove, to level `LEVEL`.
    watch
        The last argument of all work of `WorkerProcess`.
    """
    began = time.perf_counter()
    found = verify(solution, LEVEL)
    return TimedProof(outcome=found.outcome, verification=found.verification, took=time.perf_counter() - began)


def objective_in_words(solution: Solution) -> str:
    """Return the objective in words."""
    return objective_text(solution).replace("J = ", "J ")


def _followed_extremal(followed: Solution) -> Extremal:
    """Return the extremal that was followed; of a saved flight its nature is not proved."""
    if not followed.extremals:
        return Extremal(free=followed.free, objective=followed.objective, nature=Nature.UNPROVED)
    return replace(followed.extremals[0], nature=followed.extremals[0].nature.unguided)


def _mark_dominated(extremals: Iterable[Extremal]) -> list[Extremal]:
    return [replace(e, nature=e.nature.dominated) for e in extremals]
