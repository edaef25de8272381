"""Problem with the objective negated, whose solution maximises J.

The flight that meets the end conditions in the least time has a counterpart that takes the longest: between the two
lie all flight times in which these can be met. Both are extremals, with the multiplier of J of either sign, and
conditions that leave that sign open, as with costates of length one, are met by both.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from perilune.core import Physics, check_call, require_type
from perilune.problem.problem import Problem


@check_call
def opposite(problem: Problem) -> Problem:
    """Return the same problem with its objective negated.

    Parameters
    ----------
    problem
        Whose maximum is asked for.

    Returns
    -------
    Problem
        With the same phases, parameters and results. Where what it asks for has no bound, it has no answer.

    Raises
    ------
    PeriluneError
        If it is no problem.
    """
    require_type(problem, Problem, "a problem")
    return replace(
        problem,
        objective=partial(_negated_objective, of=problem.objective),
        maximised="",
        minimised="",
        switching_guesses=None,
        title=f"{problem.title}, maximised instead of minimised",
    )


def _negated_objective(x: Any, p: Any, xp: Any, *, of: Physics) -> Any:
    return -of(x, p, xp)
