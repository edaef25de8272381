"""Terminal state bounds that end a phase, as the mass of a stage that burns out: their multiplier.

A flight keeps x >= b at the end too, so that a range x(T) >= b there asks nothing new: restated with it the problem has
the same flights. For one that is on the bound only at the end, the multiplier of the bound is that of the range,

    lam(T) = dPhi/dx + mu e,    mu <= 0 at a lower bound, >= 0 at an upper one,

and is judged as any other (`first_order`, `second_order`, `sensitivities`). A bound that the end conditions meet anyway
has no multiplier of its own.

Source: Hartl, Sethi, Vickson (1995), section 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from perilune.problem import Conditions, Phase, Solution
from perilune.proof.feasible.phase_data import PhaseData, phase_data_of
from perilune.proof.necessary.first_order import INSIDE, end_gradients, end_sides

_ON = 1e-7  # of a state: on its bound
_BEFORE = 1e-2  # of a phase: there it is not on it yet
_FELT = 1e-6  # of the largest costate: a multiplier; and of 1, what of a bound no end condition says


def end_bound_multipliers(arc: PhaseData) -> dict[str, float]:
    """Return the states held by a bound at the end of a phase, each with its multiplier, if the costates give it."""
    on = list(_bounds_reached(arc))
    if not on or arc.trajectory.costate is None:
        return {}
    psi, ahead = end_gradients(arc)
    wanted = arc.trajectory.costate.values[-1] * arc.state_scale - ahead
    met = psi[end_sides(arc) != INSIDE]
    units = np.eye(len(wanted))
    gradients = met / np.maximum(np.linalg.norm(met, axis=1, keepdims=True), np.finfo(float).tiny)
    count, own = len(gradients), list[tuple[int, int]]()
    for i, sign in on:
        unsaid = units[i] - gradients.T @ np.linalg.lstsq(gradients.T, units[i], rcond=None)[0]
        if np.linalg.norm(unsaid) > _FELT:
            gradients = np.vstack([gradients, units[i]])
            own.append((i, sign))
    mu = np.linalg.lstsq(gradients.T, wanted, rcond=None)[0][count:]
    least = _FELT * max(np.abs(wanted).max(), np.abs(ahead).max())
    return {
        arc.phase.states[i].name: float(value / arc.state_scale[i])
        for (i, sign), value in zip(own, mu, strict=True)
        if sign * value > least
    }


def _bounds_reached(arc: PhaseData) -> Iterator[tuple[int, int]]:
    """The states that are on a bound where a phase ends, and not before: which, and -1 at the lower, 1 at the upper."""
    before, end = arc.state(np.array([1 - _BEFORE, 1.0]) * arc.duration).T.tolist()
    for i, state in enumerate(arc.phase.states):
        for sign, limit in zip((-1, 1), state.limits(arc.p), strict=True):
            near = _ON * max(abs(end[i]), arc.state_scale[i])
            if abs(end[i] - limit) <= near < abs(before[i] - limit):
                yield i, sign


def with_end_bounds(solution: Solution) -> Solution:
    """Return the solution as one of the problem with such bounds as end conditions; itself where there is none."""
    problem = solution.problem
    held = [end_bound_multipliers(arc) for arc in phase_data_of(solution)]
    if not any(held):
        return solution
    phases = tuple(
        _add_end_conditions(phase, own) if own else phase for phase, own in zip(problem.phases, held, strict=True)
    )
    # Its values and ranges are not judged again: those of a neighbour are its own.
    return replace(solution, problem=problem.changed(phases=phases, form=None))


def _add_end_conditions(phase: Phase, held: dict[str, float]) -> Phase:
    taken, added = {c.name for c in phase.end_conditions}, []
    for state in phase.states:
        if state.name in held:
            name = f"{state.name}_at_end"
            while name in taken:
                name += "_"
            other = {"lower": -math.inf} if held[state.name] > 0 else {"upper": math.inf}
            added.append(replace(state, name=name, **other))

    def end(x: Any, p: Any, xp: Any) -> tuple[Any, ...]:
        stated = () if phase.end is None else phase.end(x, p, xp)
        return (*stated, *(getattr(x, name) for name in phase.state_names if name in held))

    return replace(phase, end=Conditions(end, *phase.end_conditions, *added))
