"""The control minimises H: all over its set, in its slope, and where it switches.

For a scalar u between bounds S = dH/du is its switching function: 0 between the bounds, >= 0 on the lower, <= 0
on the upper; where u jumps S is 0. That much is necessary (level 2). The strict form of the same, the
Legendre condition of bang-bang controls, is one of the two sufficient conditions of level 3:

    |S| > 0 on a bound, up to both ends of the flight, and dS/dt != 0 where u jumps.

There f+, H_x+ belong to the control after the jump, f-, H_x- to the one before, and with lam' = -H_x

    D = -d(H+ - H-)/dt = f+.H_x- - f-.H_x+ = -dS/dt (u+ - u-) > 0.

Source: Maurer and Osmolovskii (2004), Second order sufficient conditions for time-optimal bang-bang control;
Osmolovskii and Maurer (2012), chapter 6.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np

from perilune.problem.controls import Bounded, Direction, normalised, placed, scalars
from perilune.problem.verification import Check
from perilune.proof.numerics import ON_BOUND, STEP, Arc, jacobian, just_before
from perilune.words.types import Matrix, Vector

# In canonical units. Measured on good answers: H 7e-11, slopes of directions 2e-11, at switches 2e-12.
HAMILTONIAN_LIMIT = 1e-9
SLOPE_LIMIT = 1e-9
STRICT_LIMIT = -1e-4
ADMISSIBLE = 1e-9  # by how much, in canonical units, a sampled control may leave a path condition


def minimality(arc: Arc) -> Iterator[Check]:
    """Checks of level 2 of one phase with controls."""
    yield _minimum(arc)
    t = arc.times(257)
    gradient, u = control_gradient(arc, t), arc.control(t)
    row = 0
    for here, control in placed(arc.phase.controls):
        rows, name = slice(row, row + control.freedom), "_".join(control.names)
        row = rows.stop
        if isinstance(control, Direction):
            value, name = np.abs(gradient[rows]), f"stationary_direction_{name}"
            meaning = "largest derivative of the Hamiltonian as the direction turns (scaled)"
        else:
            slope, (lower, upper) = gradient[rows][0], on_bounds(arc, here.start, control, u)
            value = np.where(lower, -slope, np.where(upper, slope, np.abs(slope)))
            name = f"switching_{control.name}"
            meaning = (
                f"largest derivative of the Hamiltonian in {control.names[0]} of the wrong sign: it must be 0 between "
                "the bounds, not negative at the lower, not positive at the upper (scaled)"
            )
        yield Check(
            name=f"{arc.prefix}{name}", level=2, value=float(max(value.max(), 0.0)), unit="1",
            limit=SLOPE_LIMIT, meaning=meaning,
        )  # fmt: skip
    yield from _zeros(arc)


def on_bounds(arc: Arc, at: int, control: Bounded, u: Matrix) -> tuple[Vector, Vector]:
    """Where a scalar lies on its lower, and on its upper bound."""
    return control.on_bounds(u[at], ON_BOUND * arc.control_scale[at], arc.p)


def _zeros(arc: Arc) -> Iterator[Check]:
    """The switching function of each control at the times it jumps, on both sides."""
    for at, control in scalars(arc.phase.controls):
        times = arc.breaks[arc.jumps[at] != 0]
        if len(times):
            row = _row(arc, control)
            S = control_gradient(arc, np.concatenate([just_before(times), times]))[row]
            yield Check(
                name=f"{arc.prefix}switch_{control.name}", level=2, value=float(np.abs(S).max()), unit="1",
                limit=SLOPE_LIMIT,
                meaning=f"largest switching function, dH/d({control.name}), at the {len(times)} "
                f"time{'s' if len(times) > 1 else ''} at which {control.name} jumps: it must be 0 (scaled)",
            )  # fmt: skip


def strictness(arc: Arc) -> Iterator[Check]:
    """Checks of level 3: each scalar on a bound is there strictly, and leaves it by a jump at a finite slope of S."""
    if not any(control.scalar for control in arc.phase.controls):
        return
    t = np.linspace(0.0, arc.duration, 1025)
    u, gradient = arc.control(t), control_gradient(arc, t)
    # S may vanish at a break, and at a joint of phases, whose times are chosen too; nowhere else.
    joints = [0.0] * (arc.index > 0) + [arc.duration] * (arc.index < len(arc.problem.phases) - 1)
    zeros = np.array([*arc.breaks, *joints])
    apart = np.abs(t[:, None] - zeros).min(axis=1) if len(zeros) else np.full(len(t), arc.duration)
    for at, control in scalars(arc.phase.controls):
        held = np.logical_or(*on_bounds(arc, at, control, u)) & (apart > 1e-6 * arc.duration)
        if not held.any():
            continue
        S = np.abs(gradient[_row(arc, control)])
        jumps = arc.jumps[at] != 0
        crossing = crossings(arc)[jumps] / np.abs(arc.jumps[at, jumps]) / arc.problem.scales.time
        slopes = np.append(S[held] / apart[held], crossing)
        yield Check(
            name=f"{arc.prefix}strict_{control.name}", level=3, limit=STRICT_LIMIT, unit="1",
            value=-float(slopes.min()) * arc.duration / float(S.max()),
            meaning=f"minus the least switching function of {control.name} on a bound, over the time to the nearest "
            "switch, and its slope at each switch (in units of its largest value over the flight time): below 0 "
            "when it vanishes at switches only and crosses zero there",
        )  # fmt: skip


def crossings(arc: Arc) -> Vector:
    """D (above) at each break, scaled: 0 where nothing jumps."""
    times, before = arc.breaks, just_before(arc.breaks)
    lam, x, scale = arc.costate(times), arc.state(times), arc.state_scale

    def side(u: Matrix) -> tuple[Matrix, Matrix]:
        """Rates, and dH/dx."""
        f_x = jacobian(lambda z: arc.rates(z, u.reshape(len(u), *(1,) * (z.ndim - 2), len(times))), x, scale)
        return arc.rates(x, u).real, (lam[:, None] * f_x).sum(axis=0) / scale[:, None]

    (f_before, h_before), (f_after, h_after) = side(arc.control(before)), side(arc.control(times))
    D = (f_after * h_before - f_before * h_after).sum(axis=0)
    return np.where(arc.jumps.any(axis=0), D * arc.problem.scales.time**2 / arc.objective_scale, 0.0)


def _row(arc: Arc, control: Bounded) -> int:
    """Place of a scalar in `tangents`."""
    before = arc.phase.controls[: arc.phase.controls.index(control)]
    return sum(c.freedom for c in before)


def _minimum(arc: Arc) -> Check:
    t = arc.times(65)
    x, u, lam = arc.state(t), arc.control(t), arc.costate(t)
    parts = [
        control.samples(u[here], float(arc.control_scale[here.start]), arc.p)
        for here, control in placed(arc.phase.controls)
    ]
    tried = np.stack([np.concatenate(choice) for choice in product(*parts)], axis=1)  # (components, samples, times)
    samples = tried.shape[1]
    x_many = np.broadcast_to(x[:, None, :], (len(x), samples, len(t)))
    H = (lam[:, None, :] * arc.rates(x_many, tried).real).sum(axis=0)
    own = H[0].copy()
    for condition, value in zip(arc.phase.path_conditions, arc.path(x_many, tried), strict=True):
        H = np.where(value < -ADMISSIBLE * arc.problem.size_of(condition), np.inf, H)
    worst = float((own - H.min(axis=0)).max())
    return Check(
        name=f"{arc.prefix}minimum_of_hamiltonian", level=2, limit=HAMILTONIAN_LIMIT, unit="1",
        value=max(worst, 0.0) * arc.problem.scales.time / arc.objective_scale,
        meaning=f"most that any of {samples} controls at {len(t)} times lowers the Hamiltonian (scaled)",
    )  # fmt: skip


def tangents(arc: Arc, u: Matrix) -> Any:
    """Where the control can move, shape (components, k, N): a sphere's tangents, a scalar's axis."""
    columns = []
    for here, control in placed(arc.phase.controls):
        for vectors in control.tangents(u[here], float(arc.control_scale[here.start])):
            column = np.zeros(u.shape)
            column[here] = vectors
            columns.append(column)
    return np.stack(columns, axis=1)


def control_rates(arc: Arc, x: Matrix, u: Matrix, moves: Any) -> Any:
    """Derivatives of the dynamics as the control moves along `tangents`, (n, k, N), in SI."""
    moved = u[:, None, :] + 1j * STEP * moves
    x_many = np.broadcast_to(x[:, None, :], (len(x), *moved.shape[1:]))
    return arc.rates(x_many, normalised(arc.phase.controls, moved)).imag / STEP


def control_gradient(arc: Arc, t: Vector) -> Matrix:
    """dH/d(control) along `tangents`, scaled, shape (k, N)."""
    x, u, lam = arc.state(t), arc.control(t), arc.costate(t)
    f = control_rates(arc, x, u, tangents(arc, u))
    return (lam[:, None, :] * f).sum(axis=0) * arc.problem.scales.time / arc.objective_scale
