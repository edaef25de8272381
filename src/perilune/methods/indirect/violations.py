"""Constraint violations along a flight: bounds of states, controls and free parameters, and path conditions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector, format_bound, format_quantity
from perilune.problem import (
    FreeParameter,
    Phase,
    Problem,
    ScalarControl,
    Solution,
    Variable,
    limit_name,
    quantity_name,
    scalars,
)
from perilune.structures import Structure

_LOOKS = 201  # times of a phase, in addition to the nodes of its tables
# Of a bound: how it is broken, and beyond it; what keeps it, and what makes it wider.
_SIDES = {"lower": ("falls", "below", "at least", "lower"), "upper": ("rises", "above", "at most", "raise")}
_BROKEN = 1e-8  # canonical, of tables: what is broken by less the proof may judge, which flies them again


@dataclass(frozen=True, kw_only=True)
class ConstraintViolation:
    """A condition or bound that a flight breaks.

    Parameters
    ----------
    name, text
        Of the condition, and what happens to it, in the user's words.
    miss, unit
        By how much it is broken, SI.
    canonical
        The same in canonical units, to compare breaches of different kinds.
    path
        Whether it is a path condition, which an extremal knows nothing of, and not a bound.
    limit
        What the limit is called in a message.
    kept, enough
        What keeps a bound, and what to do with the bound so that this flight keeps it, in words.
    """

    name: str
    text: str
    miss: float
    unit: str
    canonical: float
    path: bool = False
    limit: str = ""
    kept: str = ""
    enough: str = ""


def violation_by_control(structure: Structure, whole: Solution) -> ConstraintViolation | None:
    """Return what the control of an extremal of arcs breaks that its law does not keep to, or None.

    Such are conditions of the path that the law cannot hold, and the bounds of a scalar that keeps a boundary arc.

    Parameters
    ----------
    structure
        Arcs of each phase.
    whole
        Extremal found with them, in the user's phases.
    """
    may_break = structure.may_break_controls(whole.problem, whole.parameters)
    return next(solution_violations(whole, _BROKEN), None) if may_break else None


def solution_violations(solution: Solution, slack: float) -> Iterator[ConstraintViolation]:
    """Yield what a solution breaks by more than a slack [canonical], by its tables; bounds of its control too.

    Parameters
    ----------
    solution
        A solution of any method.
    slack
        What may be broken, canonical.
    """
    problem, p = solution.problem, solution.parameters
    for k, (phase, flown) in enumerate(zip(problem.phases, solution.trajectories, strict=True)):
        nodes = (flown.state.time, flown.control.time)
        t = np.unique(np.concatenate([*nodes, np.linspace(0.0, flown.duration, _LOOKS)]))
        x, u = solution.evaluate(k, t)
        yield from violations_along(problem, phase, x, u, p, slack)
        for at, control in scalars(phase.controls):
            yield from bound_violations(problem, control, u[at], control.limits(p), slack)


def violations_along(
    problem: Problem, phase: Phase, x: Matrix, u: Matrix, p: Any, slack: float
) -> Iterator[ConstraintViolation]:
    """Yield what states and controls of a phase, at the points given, break by more than a slack [canonical].

    Parameters
    ----------
    problem, phase
        The problem and its phase.
    x
        States [SI], (n, points).
    u
        Controls [SI], (components, points).
    p
        Record of all parameters in SI.
    slack
        What may be broken, canonical.
    """
    for state, along in zip(phase.states, x, strict=True):
        yield from bound_violations(problem, state, along, state.limits(p), slack)
    for condition, along in phase.path_along(x, u, p):
        least, scale = float(np.min(along)), problem.size_of(condition)
        if not least >= -slack * scale:
            called, miss, unit = quantity_name(condition), -least, condition.unit
            text = f"{called} falls to {format_quantity(least, unit)} on the way"
            yield ConstraintViolation(
                name=condition.name, text=text, miss=miss, unit=unit, canonical=miss / scale, path=True, limit=called
            )


def bound_violations(
    problem: Problem,
    named: Variable | FreeParameter | ScalarControl,
    values: Vector,
    limits: tuple[float, float],
    slack: float,
) -> Iterator[ConstraintViolation]:
    """Yield values beyond their bounds. What is no number lies within none, not even where there are none.

    Parameters
    ----------
    problem
        The problem.
    named
        State, free parameter or scalar control.
    values
        Its values [SI].
    limits
        Lower and upper bound [SI].
    slack
        What may be broken, canonical.
    """
    (lower, upper), name, unit, scale = limits, named.name, named.unit, problem.size_of(named)
    least, most = float(np.min(values)), float(np.max(values))
    for side, limit, reached, miss in (("lower", lower, least, lower - least), ("upper", upper, most, most - upper)):
        if not miss <= slack * scale:
            way, beyond, keeps, change = _SIDES[side]
            bound, called = limit_name(problem, named, side), quantity_name(named)
            stated = "its bound" if bound.startswith("the ") else bound
            here, there = _format_distinguishably(reached, limit, unit)
            yield ConstraintViolation(
                name=name,
                text=f"{called} {way} to {here}, {beyond} {stated} of {there}",
                miss=miss,
                unit=unit,
                canonical=miss / scale,
                limit=bound,
                kept=f"{called} {keeps} {there}",
                enough=f"{change} {bound} to {format_bound(reached, unit, side)}",
            )


def _format_distinguishably(one: float, other: float, unit: str) -> tuple[str, str]:
    """Format two values with as many digits as it takes to distinguish them, but six at least."""
    texts = ((format_quantity(one, unit, digits), format_quantity(other, unit, digits)) for digits in range(6, 18))
    return next(
        (pair for pair in texts if pair[0] != pair[1]), (format_quantity(one, unit), format_quantity(other, unit))
    )
