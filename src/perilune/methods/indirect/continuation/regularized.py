"""Regularized problem, its switched controls smoothed: a scalar becomes the height of a point on a circle.

A scalar u in which the Hamiltonian is linear jumps from bound to bound wherever its slope S = dH/du changes its sign.
Written as u = middle + half c, with (s, c) a unit vector, and with J less by the integral of rate s,

    H = ... + S half c - rate s     is least at     (s, c) = (rate, -S half) / sqrt(rate^2 + S^2 half^2):

it follows S smoothly, and goes over into the switched one as the rate goes to zero. With a large rate a flight of many
revolutions burns gently all along, which a coarse mesh follows and Newton's method finds; then the rate is made small.

Sources: Bertrand, Epénoy, *New smoothing techniques for solving bang-bang optimal control problems*, Optimal Control
Applications and Methods 23 (4), 2002; for the circle Mall, Grant, Taheri, *Uniform trigonometrization method for
optimal control problems with control and state constraints*, J. Spacecraft and Rockets 57 (5), 2020.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from perilune.core import Matrix
from perilune.problem import (
    PHASE_FUNCTIONS,
    Control,
    Expression,
    Parameter,
    Phase,
    Problem,
    Recorder,
    ScalarControl,
    UnitVectorControl,
    Variable,
    limit_value,
    run_expression,
)
from perilune.structures import linear_scalars

RATE = "smoothing_rate"  # the given parameter that goes to zero
_GAINED = "smoothing_gain"  # the state that counts what is taken from J


def smooth_problem(problem: Problem, share: float) -> Problem | None:
    """Return the problem with smooth controls; None where no control is switched.

    Parameters
    ----------
    problem
        As the user states it.
    share
        Of the size of J that a flight of the typical duration could gain by s = 1 all along: the given parameter `RATE`
        is this by the duration.

    Returns
    -------
    Problem
        With a state more in each phase, which is the last, and without outputs and results.
    """
    turned = [_switched_scalars(problem, k) for k in range(len(problem.phases))]
    if not any(turned):
        return None
    own, unit = problem.form.expressions, problem.objective_unit
    p = problem.parameters({f.name: f.guess for f in problem.free})
    whole = sum(float(getattr(p, phase.duration)) for phase in problem.phases)
    given = {
        name: Parameter(value=float(limit_value(limit, p)), unit=c.unit)
        for k, scalars in enumerate(turned)
        for c in scalars
        for name, limit in zip(_limit_parameters(k, c), (c.lower, c.upper), strict=True)
    }
    given[RATE] = Parameter(value=share * problem.objective_size / whole, unit=f"{unit}/s")
    return problem.changed(
        phases=tuple(_smoothed_phase(problem, k, scalars) for k, scalars in enumerate(turned)),
        start=_extend_expression(own["start"], lambda recorder: 0.0),
        links=tuple(
            _extend_expression(own["links", k], lambda recorder: recorder.input("x", _GAINED))
            for k in range(len(problem.links))
        ),
        objective=_objective_less_gain(own["objective"]),
        given=MappingProxyType({**problem.given, **given}),
        switching_guesses=None,
        initial_guess=None if problem.initial_guess is None else partial(_guess_without_gain, problem.initial_guess),
        results=None,
        maximised="",
        minimised="",
        preflight=None,
        consistency_checks=None,
        form=None,
    )


def _guess_without_gain(initial_guess: Callable[[Any], Sequence[Matrix]], p: Any) -> list[Matrix]:
    """Return the user's picture of the flight with a state more."""
    return [np.column_stack([states, np.zeros(len(states))]) for states in initial_guess(p)]


def _switched_scalars(problem: Problem, k: int) -> list[ScalarControl]:
    """Return the scalars of phase k that are switched: those whose limits are numbers or given."""
    return [
        control
        for _, control in linear_scalars(problem, k)
        if type(control) is ScalarControl and not {control.lower, control.upper} & {*problem.free_names}
    ]


def _limit_parameters(k: int, control: ScalarControl) -> tuple[str, str]:
    """Return the names of the given parameters that hold the limits of a scalar."""
    return f"least_{control.name}_{k}", f"greatest_{control.name}_{k}"


def _circle_axes(control: ScalarControl) -> tuple[str, str]:
    """Return the names of s and c. Where nothing is known its first component is 1: the middle of the range."""
    return f"{control.name}_smooth", f"{control.name}_height"


def _smoothed_phase(problem: Problem, k: int, scalars: list[ScalarControl]) -> Phase:
    phase, own = problem.phases[k], problem.form.expressions
    controls: list[Control] = [UnitVectorControl(names=_circle_axes(c)) if c in scalars else c for c in phase.controls]
    functions: dict[str, Any] = {name: None for name in PHASE_FUNCTIONS}
    for name in ("dynamics", "end", "path", "held", "end_guess"):
        if (k, name) in own:
            functions[name] = _smoothed_function(own[k, name], k, scalars, name, phase.duration)
    return replace(
        phase.with_functions(functions),
        controls=tuple(controls),
        states=(*phase.states, Variable(name=_GAINED, unit=problem.objective_unit, scale=problem.objective_scale)),
    )


def _smoothed_function(
    expression: Expression, k: int, scalars: list[ScalarControl], name: str, duration: str
) -> Expression:
    """Return a function of a phase with the scalars on their circles, and with a rate or a value of what is gained."""
    recorder = Recorder()
    inputs = dict(_circle_heights(recorder, k, scalars)) if "u" in expression.roles else {}
    values = run_expression(expression, recorder, inputs)
    if name == "dynamics":
        gained: Any = 0.0
        for control in scalars:
            gained = gained + recorder.input("u", _circle_axes(control)[0])
        values.append(recorder.input("p", RATE) * gained)
    if name == "end_guess":  # so that a straight line leads through the middle of the ranges
        rate: Any = recorder.input("p", RATE)
        values.append(rate * recorder.input("p", duration) * float(len(scalars)))
    return Expression(recorder.tape(values), expression.roles, origin=expression.origin)


def _circle_heights(recorder: Any, k: int, scalars: list[ScalarControl]) -> Iterator[tuple[tuple[str, str], Any]]:
    for control in scalars:
        least, greatest = (recorder.input("p", name) for name in _limit_parameters(k, control))
        height = recorder.input("u", _circle_axes(control)[1])
        yield ("u", control.name), 0.5 * (greatest + least) + 0.5 * (greatest - least) * height


def _extend_expression(expression: Expression, more: Any) -> Expression:
    recorder = Recorder()
    values = run_expression(expression, recorder)
    return Expression(recorder.tape([*values, more(recorder)]), expression.roles, origin=expression.origin)


def _objective_less_gain(objective: Expression) -> Expression:
    recorder = Recorder()
    (value,) = run_expression(objective, recorder)
    return Expression(recorder.tape([value - recorder.input("x", _GAINED)]), objective.roles, True, objective.origin)
