"""The main verb: check the problem, run a method, prove the answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from perilune.methods.indirect import Indirect
from perilune.outcome import Outcome
from perilune.problem import Problem
from perilune.solution import Iteration, Solution


class Method(Protocol):
    """What every method is: a frozen record of settings with a `run`."""

    def run(
        self,
        problem: Problem,
        guess: Solution | None = None,
        watch: Callable[[Iteration | str], None] | None = None,
    ) -> Solution:
        """Solve the problem, from a guess or from nothing."""
        ...


def solve(
    problem: Problem,
    method: Method | None = None,
    *,
    guess: Solution | None = None,
    level: int = 3,
    watch: Callable[[Iteration | str], None] | None = None,
) -> Solution:
    """Solve a problem and prove the answer.

    Parameters
    ----------
    problem
        What to solve.
    method
        ``Indirect()`` unless another is given.
    guess
        A solution of any method for this or a similar problem. None is needed.
    level
        Verification level to prove, 0 for none; 4 solves the problem by another method too.
    watch
        Receives each iteration, and lines of text.

    Returns
    -------
    Solution
        With `verification` and outcome PROVED or NOT_PROVED; SOLVED at level 0.

    Raises
    ------
    NotConvergedError, InfeasibleError
        As the method says.
    """
    return prove((method or Indirect()).run(problem, guess, watch), level)


def prove(solution: Solution, level: int) -> Solution:
    """The same solution with its verification up to `level`, and the outcome that follows; level 0 changes nothing."""
    if level == 0:
        return solution
    from perilune.verify import verify

    verification = verify(solution, level=level)
    proved = verification.passed and verification.level >= level
    return replace(solution, verification=verification, outcome=Outcome.PROVED if proved else Outcome.NOT_PROVED)
