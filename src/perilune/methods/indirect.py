"""The indirect method without a guess: Pontryagin's conditions, shooting, and a ladder of ways to start it.

Rungs, in order, each tried only where the one before failed:

1. *costates on the unit sphere*: the conditions are linear in the costates up to a factor, and `Problem.scales` make
   their components comparable, so random directions of length one cover the possibilities;
2. *direct transcription*: a coarse pseudospectral solution and the costates that its multipliers give;
3. *multiple shooting* from the same, for arcs too unstable to fly in one piece.

A free parameter between finite bounds (the retro burn) is held at first; then the whole family along it is followed
and every extremal on it found (`perilune.shooting.extremals`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from perilune.methods.search import Search
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution
from perilune.words.watch import Watch, silent

if TYPE_CHECKING:
    from perilune.methods.pseudospectral import Pseudospectral


@dataclass(frozen=True, kw_only=True)
class Indirect:
    """Settings of the indirect method.

    Parameters
    ----------
    starts
        Random starts of the first rung.
    seed
        Of the random starts; the same seed gives the same answer.
    scan_points
        Values visited along a free parameter between finite bounds.
    segments
        Arcs for each phase in multiple shooting (third rung).
    transcription
        The direct method of the second rung; its mesh need not be fine. None: 40 nodes, not refined.
    """

    starts: int = 24
    seed: int = 0
    scan_points: int = 33
    segments: int = 6
    transcription: Pseudospectral | None = None

    name = "indirect"

    def run(self, problem: Problem, guess: Solution | None = None, watch: Watch | None = None) -> Solution:
        """Solve.

        Parameters
        ----------
        problem
            What to solve.
        guess
            A solution of any method for this problem or one of the same form; without it the ladder is climbed.
        watch
            Receives each Newton iteration, and a line of text at each rung.

        Returns
        -------
        Solution
            Unverified; its `extremals` list every extremal found, best first, itself the first.

        Raises
        ------
        NotConvergedError
            If every rung failed.
        InfeasibleError
            If extremals were found and every one breaks a path condition.
        """
        return Search(self, problem, watch or silent).solve(guess)
