"""Trace of the user's physics on CasADi SX: the same text that the verifier integrates becomes expressions.

Everything is traced in canonical units: because the physics is dimensionally homogeneous (tested by `Problem`), the
same text holds when states and parameters are divided by their `Scales`; what has a scale of its own is brought to them
in `Problem.canonical`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from perilune.core import NUMPY_NAMES, PeriluneError, Table, Vector
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.variables import FreeParameter


def _read_table(table: Table, value: Any) -> Any:
    return table.chosen(value, ca.if_else)


SYMBOLIC = SimpleNamespace(**{name: getattr(ca, name) for name in NUMPY_NAMES}, where=ca.if_else, table=_read_table)


@dataclass(frozen=True, eq=False)
class Unnumbered:
    """A problem as the key of what is derived from it: equal where the form is, and what is given, free and bounded.

    Values and bounds do not count, so that a whole family shares one derivation. Trace from `problem`, whose functions
    are expressions here: a cache then keeps none of the user's objects alive.
    """

    stated: Problem

    @cached_property
    def problem(self) -> Problem:
        """The problem with its functions as expressions of canonical values."""
        return self.stated.canonical.expressed

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Unnumbered) and self.stated.structure == other.stated.structure

    def __hash__(self) -> int:
        return hash(self.stated.structure)


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """Symbols of a problem's parameters: `given` in the order of `Problem.given`, `free` in that of `Problem.free`."""

    given: ca.SX
    free: ca.SX
    record: SimpleNamespace


def trace_parameters(problem: Problem) -> Parameters:
    """Create one symbol for each given and each free parameter."""
    given = ca.SX.sym("given", len(problem.given))
    free = ca.SX.sym("free", len(problem.free))
    record = SimpleNamespace(
        **{name: given[i] for i, name in enumerate(problem.given)},
        **{name: free[i] for i, name in enumerate(problem.free_names)},
    )
    return Parameters(given=given, free=free, record=record)


def column(values: Any) -> ca.SX:
    """Return a user's returned sequence as one column of expressions."""
    return ca.vertcat(ca.SX(0, 1), *[ca.SX(v) for v in values])


def elements(vector: ca.SX) -> list[ca.SX]:
    """Return the entries of a column, as the user's functions receive them."""
    return [vector[i] for i in range(vector.numel())]


def trace_rates(phase: Phase, x: ca.SX, u: ca.SX, p: SimpleNamespace) -> ca.SX:
    """Trace the phase's dynamics as a column.

    Parameters
    ----------
    phase
        The phase.
    x, u
        Symbols of its states and controls, in the units of the phase's functions.
    p
        Record of symbols of all parameters.

    Returns
    -------
    casadi.SX
        x', a column of the length of x.
    """
    return column(phase.rates(elements(x), elements(u), p, SYMBOLIC))


MOST_CONDITIONS = 4  # in the xp.where of one phase
MOST_SIDES = 64  # sides of tables and the like; each multiplies the modes


@dataclass(frozen=True, kw_only=True)
class Choice:
    """A choice in the dynamics: between which of its `knots` an expression of the states lies.

    Parameters
    ----------
    argument
        The expression.
    knots
        Its values where the choice changes, in increasing order.
    steady
        Whether the rates go on there without a jump, as those of a table do.
    bent
        Whether their slopes jump all the same, and with them the rates of the costates.
    """

    argument: ca.SX
    knots: tuple[float, ...]
    steady: bool
    bent: bool


@dataclass(frozen=True, kw_only=True)
class Kinked:
    """The dynamics of a phase side by side.

    Parameters
    ----------
    choices
        The choices that change in flight.
    sides
        Each combination of places: for each choice how many of its knots lie below.
    rates
        The rates on each of `sides`.
    """

    choices: tuple[Choice, ...]
    sides: tuple[tuple[int, ...], ...]
    rates: tuple[ca.SX, ...]


def trace_sides(phase: Phase, x: ca.SX, u: ca.SX, p: SimpleNamespace) -> Kinked:
    """Trace the phase's dynamics on each side of each ``xp.where``, kink and end of a smooth table.

    What depends on a control, or would make too many sides, stays a choice inside the rates.

    Parameters
    ----------
    phase, x, u, p
        As for `trace_rates`.

    Raises
    ------
    PeriluneError
        If the condition of an ``xp.where`` depends on a control, compares for equality, or there are too many.
    """
    choices = list[Choice]()
    most = 1  # the jumps first, so that they find room
    while True:
        known = len(choices)
        sides = tuple(product(*(range(len(choice.knots) + 1) for choice in choices)))
        rates = tuple(_on_side(phase, x, u, p, side, choices, most) for side in sides)
        if len(choices) == known:  # a choice inside another may show on one side only
            if most == MOST_SIDES:
                return Kinked(choices=tuple(choices), sides=sides, rates=rates)
            most = MOST_SIDES


def _on_side(
    phase: Phase, x: ca.SX, u: ca.SX, p: SimpleNamespace, sides: tuple[int, ...], choices: list[Choice], most: int
) -> ca.SX:
    """Return the rates with every choice held on its side; add new choices, steady ones up to `most` sides."""

    def side(argument: Any, knots: tuple[float, ...], *, steady: bool = True, bent: bool = True) -> int | None:
        argument = ca.SX(argument)
        if not ca.depends_on(argument, x) or ca.depends_on(argument, u):
            return None
        number = _place_of_choice(Choice(argument=argument, knots=knots, steady=steady, bent=bent), choices, most)
        return None if number is None else sides[number] if number < len(sides) else 0

    def where(condition: Any, yes: Any, no: Any) -> Any:
        if not ca.depends_on(ca.SX(condition), ca.vertcat(x, u)):
            return ca.if_else(condition, yes, no)
        held = side(_margin(phase, condition, u), (0.0,), steady=False)
        if sum(not choice.steady for choice in choices) > MOST_CONDITIONS:
            raise PeriluneError(
                f"too many switches in the dynamics of {phase.name}",
                got=f"more than {MOST_CONDITIONS} different conditions in xp.where",
                advice="xp.table for tabulated data; separate phases for what follows in a known order",
            )
        return yes if held else no

    def either(above: Any, below: Any, argument: Any, whole: Any) -> Any:
        here = side(argument, (0.0,))
        return whole if here is None else above if here else below

    def table(of: Table, value: Any) -> Any:
        return of.chosen(value, ca.if_else, side(value, of.kinks, bent=of.kind == "linear"))

    namespace = SimpleNamespace(
        **{
            **vars(SYMBOLIC),
            "where": where,
            "table": table,
            "fmax": lambda a, b: either(a, b, a - b, ca.fmax(a, b)),
            "fmin": lambda a, b: either(b, a, a - b, ca.fmin(a, b)),
            "fabs": lambda a: either(a, -a, a, ca.fabs(a)),
        }
    )
    return column(phase.rates(elements(x), elements(u), p, namespace))


def _place_of_choice(new: Choice, choices: list[Choice], most: int) -> int | None:
    """Return the place of a choice among all; None where it cannot be held."""
    for number, known in enumerate(choices):
        if known.knots == new.knots and ca.is_equal(known.argument, new.argument, 30):
            choices[number] = replace(known, steady=known.steady and new.steady, bent=known.bent or new.bent)
            return number
    if new.steady and math.prod(len(choice.knots) + 1 for choice in (*choices, new)) > most:
        return None
    choices.append(new)
    return len(choices) - 1


def _margin(phase: Phase, condition: Any, u: ca.SX) -> ca.SX:
    """Return an expression that is positive where the condition of an ``xp.where`` holds."""
    condition = ca.SX(condition)
    order = condition.is_op(ca.OP_LT) or condition.is_op(ca.OP_LE)
    if ca.depends_on(condition, u) or not order:
        raise PeriluneError(
            f"xp.where in the dynamics of {phase.name} has a condition that cannot be detected in flight",
            got="one that depends on a control" if order else "a condition that is not < or >",
            expected="a comparison by < or > of functions of the states and parameters",
            advice="xp.where(x.h > p.h1, above, below); a dependence on a control belongs in its bounds",
        )
    return condition.dep(1) - condition.dep(0)


def trace_at_end(phase: Phase, x: ca.SX, p: SimpleNamespace) -> ca.SX:
    """Trace the phase's end conditions as a column.

    Parameters
    ----------
    phase
        The phase.
    x
        Symbols of its states at the end.
    p
        Record of symbols of all parameters.

    Returns
    -------
    casadi.SX
        One entry for each end condition.
    """
    return column(phase.evaluate("end", elements(x), [], p, SYMBOLIC))


def canonical_given(problem: Problem) -> Vector:
    """Return the values of the given parameters in canonical units."""
    return np.array([g.value / problem.scales.of(g.unit) for g in problem.given.values()])


def canonical_free(problem: Problem, free: Mapping[str, float]) -> Vector:
    """Return the values of the free parameters in canonical units, from SI.

    Parameters
    ----------
    problem
        The problem.
    free
        Values [SI] by name.

    Returns
    -------
    Vector
        Canonical values in the order of `Problem.free`.
    """
    return np.array([free[f.name] / problem.scales.of(f.unit) for f in problem.free])


def free_scales(parameters: tuple[FreeParameter, ...], problem: Problem) -> Vector:
    """Return the SI size of the canonical unit of each free parameter.

    Parameters
    ----------
    parameters
        Free parameters of the problem.
    problem
        Problem whose `scales` are used.

    Returns
    -------
    Vector
        (parameters,).
    """
    return np.array([problem.scales.of(f.unit) for f in parameters])


def state_scales(problem: Problem, phase: Phase) -> Vector:
    """Return the SI size of the canonical unit of each state.

    Parameters
    ----------
    problem
        Problem whose `scales` are used.
    phase
        One of its phases.

    Returns
    -------
    Vector
        (states,).
    """
    return np.array([problem.size_of(s) for s in phase.states])
