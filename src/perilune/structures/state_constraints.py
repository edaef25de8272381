"""Constraints S >= 0 on the state of a phase: path conditions and bounds, with their derivatives along the flight.

Of order q (`perilune.problem.tracing.lie_derivatives`) S^(q) is the first derivative in which a control appears.

Source: Bryson, Ho, *Applied Optimal Control*, 1975, sections 3.11 to 3.13.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

from perilune.core import quotient_unit, unknown_name
from perilune.problem import (
    Expression,
    Parameter,
    Phase,
    Problem,
    Recorder,
    Variable,
    component,
    depends_on_control,
    derivatives_to_control,
    run_expression,
)

SIDES = ("lower", "upper")


@dataclass(frozen=True, kw_only=True)
class Condition:
    """A condition that may have boundary arcs or contact points: a path condition, or the bound of a state.

    Parameters
    ----------
    name
        Of the path condition; of a bound ``state.lower`` or ``state.upper``.
    variable
        Unit and scale of S, and a name that is an identifier.
    values
        (S, S', ..., S^(q)) as functions of (x, u, p); the last is the first with a control in it, or S'' where none is
        in any. A bound that is a number is among the parameters as `plain_bounds` has it.
    bound
        (number of the state, side) of a bound; None for a path condition.
    """

    name: str
    variable: Variable
    values: tuple[Expression, ...]
    bound: tuple[int, str] | None = None

    @property
    def order(self) -> int:
        """Return the number of derivatives until a control appears; 2 where none does."""
        return len(self.values) - 1

    @property
    def steered(self) -> bool:
        """Return True if a control moves it. Else its phase's start determines it: it has contact points only."""
        return depends_on_control(self.values[-1])

    @property
    def steering_controls(self) -> set[str]:
        """Names of the components of the control that keep the condition along its boundary arc."""
        return {op[1] for op in self.values[-1].tape.instructions if op[0] == "u"}

    def with_sums(self, sums: Mapping[str, Sequence[str]]) -> Condition:
        """Return the condition with sums of new durations in place of the user's."""
        return replace(self, values=tuple(with_sums(value, sums) for value in self.values)) if sums else self

    def rated(self, i: int, prefix: str, time: float) -> Variable:
        """Return the i-th derivative as a variable: name, unit and scale; `time` is the size of a second.

        Parameters
        ----------
        i
            Order of the time derivative, 0 for the condition itself.
        prefix
            Beginning of the name of the variable.
        time
            Canonical unit of time [s].
        """
        own, unit = self.variable, self.variable.unit
        for _ in range(i):
            unit = quotient_unit(unit, "s")
        name = prefix + own.name + ("_rate" if i else "") + (f"_{i}" if i > 1 else "")
        return Variable(name=name, unit=unit, scale=None if own.scale is None else own.scale / time**i)


Margins = Mapping[str, tuple[Variable, Expression, tuple[int, str] | None]]


def margins(problem: Problem, k: int) -> Margins:
    """Return every S >= 0 of phase k by its name: path conditions, then finite bounds of states.

    Parameters
    ----------
    problem
        The problem.
    k
        Index of the phase.
    """
    phase = problem.phases[k]
    path = problem.form.expressions.get((k, "path"))
    return _margins(path, phase.name, tuple(phase.path_conditions), tuple(phase.states))


@lru_cache(maxsize=64)
def _margins(
    path: Expression | None, phase: str, path_conditions: tuple[Variable, ...], states: tuple[Variable, ...]
) -> Margins:
    found = {}
    for i, variable in enumerate(path_conditions):
        assert path is not None, "stated with its conditions"
        found[variable.name] = (variable, component(path, i), None)
    for i, state in enumerate(states):
        for side in SIDES:
            limit = getattr(state, side)
            if isinstance(limit, str) or math.isfinite(limit):
                own = Variable(name=f"{state.name}_{side}", unit=state.unit, scale=state.scale)
                held = limit if isinstance(limit, str) else plain_bound(phase, state, side)
                found[f"{state.name}.{side}"] = (own, _bound_margin(state, side, held), (i, side))
    return MappingProxyType(found)


def conditions_of(problem: Problem, k: int, names: Sequence[str]) -> dict[str, Condition]:
    """Return the conditions of phase k that have these names, with their derivatives along the flight.

    Parameters
    ----------
    problem, k
        The problem and the number of the phase.
    names
        Names of conditions, as `margins` has them.

    Raises
    ------
    PeriluneError
        If there is no such condition.
    """
    phase, known, found = problem.phases[k], margins(problem, k), {}
    dynamics = problem.form.expressions[k, "dynamics"]
    for name in names:
        if name not in known:
            raise unknown_name(f"condition of {phase.name}", name, sorted(known))
        variable, value, bound = known[name]
        values = derivatives_to_control(value, dynamics, phase.state_names)
        found[name] = Condition(name=name, variable=variable, values=values, bound=bound)
    return found


def plain_bound(phase: str, state: Variable, side: str) -> str:
    """Return the given parameter, by name, that holds a numeric bound: formulas hold no numbers with a unit.

    Parameters
    ----------
    phase
        Name of the phase.
    state
        The bounded state.
    side
        "lower" or "upper".
    """
    return f"{phase}.{state.name}.{side}"


def plain_bounds(problem: Problem) -> dict[str, Parameter]:
    """Return the parameters, of all states, that hold a bound which is a number."""
    return {
        plain_bound(phase.name, state, side): Parameter(value=limit, unit=state.unit)
        for phase in problem.phases
        for state in phase.states
        for side in SIDES
        if not isinstance(limit := getattr(state, side), str) and math.isfinite(limit)
    }


def _bound_margin(state: Variable, side: str, limit: str) -> Expression:
    """Return the margin of a state to its bound, positive inside."""
    recorder = Recorder()
    x: Any = recorder.input("x", state.name)
    bound = recorder.input("p", limit)
    room = x - bound if side == "lower" else bound - x
    return Expression(recorder.tape([room]), ("x", "u", "p"), origin="a bound")


def without_bounds(phase: Phase, bounds: Sequence[tuple[int, str]]) -> tuple[Variable, ...]:
    """Return the states of a phase without some of their bounds.

    Parameters
    ----------
    phase
        The phase.
    bounds
        (number of the state, "lower" or "upper") of each bound to leave out.
    """
    states = list(phase.states)
    for i, side in bounds:
        states[i] = replace(states[i], **{side: -math.inf if side == "lower" else math.inf})
    return tuple(states)


def state_conditions(problem: Problem, k: int) -> list[str]:
    """Return the names of the conditions of phase k on states only.

    Parameters
    ----------
    problem
        The problem.
    k
        Index of the phase.
    """
    return [name for name, (_, value, _) in margins(problem, k).items() if not depends_on_control(value)]


def sum_of_parameters(recorder: Recorder, names: Sequence[str]) -> Any:
    """Record the sum of some parameters.

    Parameters
    ----------
    recorder
        Tape that the additions are recorded on.
    names
        Names of the parameters, at least one.

    Returns
    -------
    Any
        The recorder's number of the sum.
    """
    total, *others = [recorder.input("p", name) for name in names]
    for other in others:
        total = recorder.do("add", total, other)
    return total


def with_sums(expression: Expression, sums: Mapping[str, Sequence[str]]) -> Expression:
    """Return an expression with sums of new durations in place of the user's.

    Parameters
    ----------
    expression
        Traced function of the user's problem.
    sums
        Names of the new durations by the name of the duration that they sum up to (`sums_of`).
    """
    inside = [name for name in sums if ("p", name) in expression.tape.instructions]
    if not inside:
        return expression
    recorder = Recorder()
    values = run_expression(
        expression, recorder, {("p", name): sum_of_parameters(recorder, sums[name]) for name in inside}
    )
    return Expression(recorder.tape(values), expression.roles, expression.scalar, expression.origin)
