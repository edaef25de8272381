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

from perilune.problem.problem import Bounded, Direction
from perilune.problem.verification import Check
from perilune.proof.numerics import ON_BOUND, STEP, Arc, jacobian, just_before, normalised
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
    for at, control in placed(arc):
        if isinstance(control, Direction):
            value = np.abs(gradient[row : row + len(control.names) - 1])
            name, row = "stationary_direction_" + "_".join(control.names), row + len(control.names) - 1
            meaning = "largest derivative of the Hamiltonian as the direction turns (scaled)"
        else:
            slope, (lower, upper) = gradient[row], on_bounds(arc, at, control, u)
            value = np.where(lower, -slope, np.where(upper, slope, np.abs(slope)))
            name, row = f"switching_{control.name}", row + 1
            meaning = (
                f"largest derivative of the Hamiltonian in {control.name} of the wrong sign: it must be 0 between "
                "the bounds, not negative at the lower, not positive at the upper (scaled)"
            )
        yield Check(
            name=f"{arc.prefix}{name}", level=2, value=float(max(value.max(), 0.0)), unit="1",
            limit=SLOPE_LIMIT, meaning=meaning,
        )  # fmt: skip
    yield from _zeros(arc)


def placed(arc: Arc) -> Iterator[tuple[int, Any]]:
    """Each control with the place of its first component."""
    at = 0
    for control in arc.phase.controls:
        yield at, control
        at += len(control.names)


def on_bounds(arc: Arc, at: int, control: Bounded, u: Matrix) -> tuple[Vector, Vector]:
    """Where a scalar lies on its lower, and on its upper bound."""
    near = ON_BOUND * arc.control_scale[at]
    return u[at] <= control.lower + near, u[at] >= control.upper - near


def _zeros(arc: Arc) -> Iterator[Check]:
    """The switching function of each control at the times it jumps, on both sides."""
    for at, control in placed(arc):
        times = arc.breaks[arc.jumps[at] != 0]
        if isinstance(control, Bounded) and len(times):
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
    scalars = [(at, control) for at, control in placed(arc) if isinstance(control, Bounded)]
    if not scalars:
        return
    t = np.linspace(0.0, arc.duration, 1025)
    u, gradient = arc.control(t), control_gradient(arc, t)
    # S may vanish at a break, and at a joint of phases, whose times are chosen too; nowhere else.
    joints = [0.0] * (arc.index > 0) + [arc.duration] * (arc.index < len(arc.problem.phases) - 1)
    zeros = np.array([*arc.breaks, *joints])
    apart = np.abs(t[:, None] - zeros).min(axis=1) if len(zeros) else np.full(len(t), arc.duration)
    for at, control in scalars:
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
    return sum(len(c.names) - isinstance(c, Direction) for c in before)


def _samples(control: Any, u: Matrix, scale: float) -> list[Matrix]:
    """Admissible values of one control, all over its set and close to the exported: (components, N)."""
    close = (-1e-1, -1e-2, -1e-3, -1e-4, 1e-4, 1e-3, 1e-2, 1e-1)
    ones = np.ones((1, u.shape[1]))
    if not isinstance(control, Direction):
        lower, upper = max(control.lower, -10 * scale), min(control.upper, 10 * scale)
        near = [np.clip(u + scale * c, control.lower, control.upper) for c in close]
        return [u, *near, *(v * ones for v in np.linspace(lower, upper, 21))]
    if len(u) == 2:
        turns = [*close, *(2 * np.pi * (k + 0.5) / 90 for k in range(90))]
        return [
            u,
            *(np.array([u[0] * np.cos(a) - u[1] * np.sin(a), u[1] * np.cos(a) + u[0] * np.sin(a)]) for a in turns),
        ]
    index = np.arange(200) + 0.5  # a Fibonacci lattice covers the sphere evenly
    z, longitude = 1 - index / 100, np.pi * (1 + 5**0.5) * index
    lattice = np.array([np.sqrt(1 - z * z) * np.cos(longitude), np.sqrt(1 - z * z) * np.sin(longitude), z])
    near = [u + c * axis[:, None] for c in close for axis in np.eye(3)]
    return [u, *(v / np.sqrt((v * v).sum(axis=0)) for v in near), *(v[:, None] * ones for v in lattice.T)]


def _minimum(arc: Arc) -> Check:
    t = arc.times(65)
    x, u, lam = arc.state(t), arc.control(t), arc.costate(t)
    parts = [
        _samples(control, u[at : at + len(control.names)], float(arc.control_scale[at])) for at, control in placed(arc)
    ]
    tried = np.stack([np.concatenate(choice) for choice in product(*parts)], axis=1)  # (components, samples, times)
    samples = tried.shape[1]
    x_many = np.broadcast_to(x[:, None, :], (len(x), samples, len(t)))
    H = (lam[:, None, :] * arc.rates(x_many, tried).real).sum(axis=0)
    own = H[0].copy()
    for condition, value in zip(arc.phase.path_conditions, arc.path(x_many, tried), strict=True):
        H = np.where(value < -ADMISSIBLE * arc.problem.scales.of(condition.unit), np.inf, H)
    worst = float((own - H.min(axis=0)).max())
    return Check(
        name=f"{arc.prefix}minimum_of_hamiltonian", level=2, limit=HAMILTONIAN_LIMIT, unit="1",
        value=max(worst, 0.0) * arc.problem.scales.time / arc.objective_scale,
        meaning=f"most that any of {samples} controls at {len(t)} times lowers the Hamiltonian (scaled)",
    )  # fmt: skip


def tangents(arc: Arc, u: Matrix) -> Any:
    """Where the control can move, shape (components, k, N): a sphere's tangents, a scalar's axis."""
    columns, at = [], 0
    for control in arc.phase.controls:
        width = len(control.names)
        part = u[at : at + width]
        if not isinstance(control, Direction):
            found = [np.full((1, u.shape[1]), arc.control_scale[at])]
        elif width == 2:
            found = [np.array([-part[1], part[0]])]
        else:
            axis = np.eye(3)[:, np.argmin(np.abs(part), axis=0)]
            first = np.cross(part, axis, axis=0)
            first = first / np.sqrt((first * first).sum(axis=0))
            found = [first, np.cross(part, first, axis=0)]
        for vectors in found:
            column = np.zeros(u.shape)
            column[at : at + width] = vectors
            columns.append(column)
        at += width
    return np.stack(columns, axis=1)


def control_rates(arc: Arc, x: Matrix, u: Matrix, moves: Any) -> Any:
    """Derivatives of the dynamics as the control moves along `tangents`, (n, k, N), in SI."""
    moved = u[:, None, :] + 1j * STEP * moves
    x_many = np.broadcast_to(x[:, None, :], (len(x), *moved.shape[1:]))
    return arc.rates(x_many, normalised(arc.phase, moved)).imag / STEP


def control_gradient(arc: Arc, t: Vector) -> Matrix:
    """dH/d(control) along `tangents`, scaled, shape (k, N)."""
    x, u, lam = arc.state(t), arc.control(t), arc.costate(t)
    f = control_rates(arc, x, u, tangents(arc, u))
    return (lam[:, None, :] * f).sum(axis=0) * arc.problem.scales.time / arc.objective_scale
