"""Signs of costates known beforehand: zero where nothing depends on the state, positive where it is the cost.

A state that only counts (the energy that was used, a distance flown) stands in no condition, in no objective and in no
rate of a state that does. With H = lambda . f, lambda' = -dH/dx and lambda(T) = dPhi/dx the costates of all such states
solve a linear homogeneous equation from zero at the end, so that they are zero. A control that is nonlinear in
their rates only enters H linearly: u^2 in the rate of an energy adds no curvature to H.

A state that counts what it costs stands in no condition and no rate either, but in the objective, with a positive
factor: its costate is that factor all along, and a convex rate makes H convex.

Bounds of states do not count: a boundary arc along one, or an end on it, is stated as a condition of a problem with
more phases (`perilune.structures.multiphase`).

Source: transversality of free final states, Bryson and Ho (1975), section 2.4.
"""

from __future__ import annotations

from functools import lru_cache

from perilune.problem.problem import Problem
from perilune.problem.tracing.lie_derivatives import run_expression, total_derivative
from perilune.problem.tracing.tape import ROLES, Expression, Recorder, operands

_ASKING = ("end", "path", "held")  # functions of a phase that state requirements on a flight


def unpriced_states(problem: Problem) -> tuple[frozenset[str], ...]:
    """Return the states of each phase whose costate vanishes identically.

    Parameters
    ----------
    problem
        Whose functions are read; values of parameters do not matter.
    """
    expressions = problem.form.expressions
    found = list[frozenset[str]]()
    for k in reversed(range(len(problem.phases))):
        phase = problem.phases[k]
        priced = set[str]().union(*(_states_read(expressions.get((k, name))) for name in _ASKING))
        if k + 1 == len(problem.phases):
            priced |= _states_read(expressions["objective"])
        else:
            after = [s.name not in found[-1] for s in problem.phases[k + 1].states]
            priced |= _states_read(expressions["links", k], after)
        rates = _states_by_value(expressions[k, "dynamics"])
        while True:
            more = {x for s, own in zip(phase.state_names, rates, strict=True) if s in priced for x in own} - priced
            if not more:
                break
            priced |= more
        found.append(frozenset(phase.state_names) - priced)
    return tuple(reversed(found))


def cost_states(problem: Problem) -> tuple[frozenset[str], ...]:
    """Return the states of each phase whose costate is a positive number all along, the same on every extremal."""
    expressions, idle = problem.form.expressions, unpriced_states(problem)
    found = list[frozenset[str]]()
    for k in reversed(range(len(problem.phases))):
        phase = problem.phases[k]
        rates = zip(phase.state_names, _states_by_value(expressions[k, "dynamics"]), strict=True)
        read = set[str]().union(*(own for name, own in rates if name not in idle[k]))
        read = read.union(*(_states_read(expressions.get((k, name))) for name in _ASKING))
        last = k + 1 == len(problem.phases)
        after = [True] if last else [s not in idle[k + 1] for s in problem.phases[k + 1].state_names]
        onto = [True] if last else [s in found[-1] for s in problem.phases[k + 1].state_names]
        ahead = expressions["objective"] if last else expressions["links", k]
        own = set[str]()
        for name in {*phase.state_names} - read - idle[k]:
            slopes = [slope for slope, priced in zip(_numeric_slopes(ahead, name), after, strict=True) if priced]
            costs = [cost for cost, priced in zip(onto, after, strict=True) if priced]
            if all(
                slope == 0 or (slope is not None and slope > 0 and cost)
                for slope, cost in zip(slopes, costs, strict=True)
            ):
                own.add(name)
        found.append(frozenset(own))
    return tuple(reversed(found))


def priced_rates(problem: Problem, k: int) -> Expression:
    """Return the rates of the states of phase k whose costates do not vanish identically.

    Parameters
    ----------
    problem
        Traced problem.
    k
        Number of the phase.
    """
    dynamics, idle = problem.form.expressions[k, "dynamics"], unpriced_states(problem)[k]
    return (
        dynamics if not idle else _rates_without(dynamics, tuple(s not in idle for s in problem.phases[k].state_names))
    )


@lru_cache(maxsize=64)
def _rates_without(dynamics: Expression, priced: tuple[bool, ...]) -> Expression:
    recorder = Recorder()
    values = [rate for rate, own in zip(run_expression(dynamics, recorder), priced, strict=True) if own]
    return Expression(recorder.tape(values), dynamics.roles, origin=dynamics.origin)


@lru_cache(maxsize=256)
def _numeric_slopes(expression: Expression, state: str) -> tuple[float | None, ...]:
    """Return derivatives of the values of an expression by a state, as far as they are numbers."""
    names = sorted({op[1] for op in expression.tape.instructions if op[0] == "x"} | {state})
    recorder = Recorder()
    alone = Expression(recorder.tape([float(name == state) for name in names]), ("x", "u", "p"))
    tape = total_derivative(expression, alone, names).tape
    found = [tape.instructions[k] for k in tape.outputs]
    return tuple(float(op[1]) if op[0] == "const" else None for op in found)


def _states_read(expression: Expression | None, wanted: list[bool] | None = None) -> set[str]:
    """Return the names of the states that an expression reads, for its `wanted` values."""
    if expression is None:
        return set()
    each = _states_by_value(expression)
    return set().union(*(own for i, own in enumerate(each) if wanted is None or wanted[i]))


@lru_cache(maxsize=256)
def _states_by_value(expression: Expression) -> tuple[frozenset[str], ...]:
    """Return the names of the states that each value of an expression reads."""
    found = list[frozenset[str]]()
    for operation in expression.tape.instructions:
        name, *rest = operation
        own = frozenset({rest[0]}) if name == "x" else frozenset[str]()
        found.append(own if name in ROLES else own.union(*(found[i] for i in operands(operation))))
    return tuple(found[k] for k in expression.tape.outputs)
