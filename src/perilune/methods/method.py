"""Protocol of every method."""

from __future__ import annotations

from typing import Protocol

from perilune.core import Watch
from perilune.problem import Problem, Solution


class Method(Protocol):
    """A frozen record of settings with a `run`."""

    def run(self, problem: Problem, guess: Solution | None = None, callback: Watch | None = None) -> Solution:
        """Solve the problem, from a guess or without an initial guess.

        Parameters
        ----------
        problem
            The problem to solve.
        guess
            Trajectory to start from; None to start without one.
        callback
            Called with each iteration and with lines of text; None for silence.

        Raises
        ------
        InfeasibleError
            If no trajectory meets the conditions.
        NotConvergedError
            If none was found.
        """
        ...
