"""Limits on states that only fall, such as energy or propellant, restated as conditions at the end of the phase.

Where S(x) >= 0 falls along every flight, S' = dS/dx . f <= 0 whatever the control does, a flight keeps S >= 0 where it
keeps S(x(T)) >= 0 at the end of its phase. The problem with this range among its end conditions has the same flights,
and is an isoperimetric problem: the multiplier of the limit is one number, and the costates are continuous. Without it
the costate of a state that only counts would be zero (`perilune.problem.tracing.costate_signs`), and no arc of the
flight has a boundary arc or contact point of the limit on the way.

Limits on what an end condition reads stay as they are, and those on what only the objective reads, such as the dry
mass where the least propellant is asked for.

Source: isoperimetric constraints, Bryson and Ho (1975), section 3.1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import NUMERIC
from perilune.problem import (
    ROLES,
    Conditions,
    Control,
    Expression,
    Phase,
    Problem,
    Recorder,
    Variable,
    depends_linearly_on_control,
    depends_on_control,
    gather_expressions,
    total_derivative,
)
from perilune.structures.state_constraints import margins, plain_bounds

AT_END = "_at_end"  # follows the name of a limit in that of the end condition that says the same
_DRAWN, _FEWEST = 400, 40  # points at which S' is computed, and those at which it has to be a number
_FAR = 3.0  # canonical: states without bounds, and such controls, are drawn so far from zero
_ROUNDED = 1e-12  # of the largest |S'|


def with_budgets(problem: Problem, *, linear: bool) -> Problem:
    """Return the problem with limits that can only be used up as end conditions too; itself where there is none.

    Parameters
    ----------
    problem
        As it is stated.
    linear
        Whether limits count whose rate is linear in every control. These hold a flight back as a switched control does,
        and are mostly far away, such as the dry mass.
    """
    phases = [_limited_at_end(problem, k, linear) for k in range(len(problem.phases))]
    same = all(new is old for new, old in zip(phases, problem.phases, strict=True))
    return problem if same else problem.changed(phases=tuple(phases), form=None)


def _limited_at_end(problem: Problem, k: int, linear: bool) -> Phase:
    phase, known = problem.phases[k], problem.form.expressions.get((k, "end"))
    after = set(_monotone_limits(problem, k + 1, linear)) if k + 1 < len(problem.phases) else set[str]()
    names = [
        name
        for name in _monotone_limits(problem, k, linear)
        if not (name in after and _is_tighter_in_next_phase(problem, k, name))
    ]
    limits = [_end_range_of_limit(phase, *margins(problem, k)[name]) for name in names]
    if not limits:
        return phase
    values = [*([] if known is None else [known]), *(value for _, value in limits)]
    taken, conditions = {c.name for c in phase.end_conditions}, list(phase.end_conditions)
    for condition, _ in limits:
        while condition.name in taken:
            condition = replace(condition, name=f"{condition.name}_")
        conditions.append(condition)
    return replace(phase, end=Conditions(gather_expressions(values, ("x", "p")), *conditions))


def _end_range_of_limit(
    phase: Phase, variable: Variable, value: Expression, bound: tuple[int, str] | None
) -> tuple[Variable, Expression]:
    """Return the range that says at the end what a limit says on the way, and its value."""
    if bound is None:
        return replace(variable, name=f"{variable.name}{AT_END}", lower=0.0, upper=math.inf), value
    place, side = bound
    other, recorder, state = {"lower": "upper", "upper": "lower"}[side], Recorder(), phase.states[place]
    tape = recorder.tape([recorder.input("x", state.name)])
    open_side = {other: math.inf if other == "upper" else -math.inf}
    return replace(state, name=f"{state.name}{AT_END}", **open_side), Expression(tape, ("x", "p"), origin="a bound")


def _monotone_limits(problem: Problem, k: int, linear: bool) -> Iterator[str]:
    """Yield the names of the limits of phase k that only fall, as the control has them."""
    form, phase = problem.form.expressions, problem.phases[k]
    ends, objective = _read_components(form.get((k, "end"))), _read_components(form["objective"])
    chosen = {("p", name) for name in problem.free_names}
    for name, (_, value, _) in margins(problem, k).items():
        own = {of for of in _read_components(value) if of[0] == "x"}
        alone = objective & (chosen | {of for of in objective if of[0] == "x"}) <= own
        if depends_on_control(value) or own & ends or alone:
            continue
        change = total_derivative(value, form[k, "dynamics"], phase.state_names)
        acting = [name for name in phase.control_names if ("u", name) in change.tape.instructions]
        wanted = linear or not all(depends_linearly_on_control(change, name) for name in acting)
        if acting and wanted and _is_monotone(problem, phase, change):
            yield name


def _is_tighter_in_next_phase(problem: Problem, k: int, name: str) -> bool:
    """Return True if phase k + 1 begins with no more left of this limit, as far as points drawn at random show.

    Then the end of phase k need not say it. One that is tighter before, or that starts again, is a budget of its own.
    """
    own, following = problem.phases[k : k + 2]
    bounds = {given: number.value for given, number in plain_bounds(problem).items()}
    p = SimpleNamespace(**vars(problem.parameters({})), **bounds)
    x = own.state_record(*_points_between(problem, own.states, p, np.random.default_rng(0)))
    with np.errstate(all="ignore"):
        begun = following.state_record(*problem.links[k](x, p, NUMERIC))
        here, there = (
            np.asarray(margins(problem, at)[name][1](z, None, p, NUMERIC)[0], dtype=float)
            for at, z in ((k, x), (k + 1, begun))
        )
    return bool(np.all(there <= here))


def _read_components(expression: Expression | None) -> set[tuple[str, str]]:
    """Return role and name of each component that an expression reads."""
    return set() if expression is None else {(op[0], op[1]) for op in expression.tape.instructions if op[0] in ROLES}


def _is_monotone(problem: Problem, phase: Phase, change: Expression) -> bool:
    """Return True if S' is nowhere positive, as far as points drawn at random show.

    That it is asks for nothing: the range at the end says what holds anyway.
    """
    rng, p = np.random.default_rng(0), problem.parameters({})
    x = _points_between(problem, phase.states, p, rng)
    u = list[Any]()
    for control in phase.controls:
        value = np.array([_points_between(problem, [control], p, rng)[0] for _ in control.names])
        u += list(value if control.scalar else control.normalised(value))
    with np.errstate(all="ignore"):
        found = change(phase.state_record(*x), phase.control_record(*u), p, NUMERIC)[0]
    known = np.broadcast_to(np.asarray(found, dtype=float), _DRAWN)
    known = known[np.isfinite(known)]
    return len(known) >= _FEWEST and bool(known.min() < 0 and known.max() <= -_ROUNDED * known.min())


def _points_between(problem: Problem, of: Sequence[Variable | Control], p: Any, rng: np.random.Generator) -> list[Any]:
    """Return values of states or controls between their bounds, those that have none within `_FAR` sizes of zero."""
    found = list[Any]()
    for one in of:
        size, (lower, upper) = problem.size_of(one), one.limits(p)
        low = lower if math.isfinite(lower) else min(upper, 0.0) - _FAR * size
        high = upper if math.isfinite(upper) else max(lower, 0.0) + _FAR * size
        found.append(rng.uniform(low, high, _DRAWN))
    return found
