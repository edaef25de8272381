"""Minimum principle: the control minimises H all over its set, in its slope, and where it switches.

For a scalar u between bounds S = dH/du is its switching function: 0 between the bounds, >= 0 on the lower, <= 0
on the upper; where u jumps S is 0, or where H bends in u H is the same before and after. Where a path condition is
active that the control appears in, L = H - mu.c has the place of H in it (`allowed`), and mu >= 0. That much is
necessary (level 2); `strict_complementarity` is more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from perilune.core import STEP, Matrix, Vector
from perilune.problem import (
    Check,
    ScalarControl,
    UnitVectorControl,
    control_scales,
    control_slices,
    normalised,
    scalars,
    tangents,
)
from perilune.proof.feasible.mixed_constraints import KEPT, ON_BOUND, MixedConstraints, Multipliers
from perilune.proof.feasible.numerics import significant_size
from perilune.proof.feasible.phase_data import PhaseData, once_for_phase
from perilune.proof.feasible.sample_points import time_just_before

# In canonical units. Measured on good answers: H 7e-11, slopes of directions 2e-11, at switches 2e-12.
HAMILTONIAN_LIMIT = 1e-9
SLOPE_LIMIT = 1e-9
_AT_ONCE = 100_000  # samples of the control, so that they stay in the processor's cache
_NO_EFFECT = 1e-300
_LOOKS = 100  # pieces at which slopes of H are sized
_EVERY = 4  # of the samples, moved onto each condition that is active
ADMISSIBLE = 1e-9  # by how much, in canonical units, a sampled control may leave a path condition


def check_minimality(arc: PhaseData) -> Iterator[Check]:
    """Checks of level 2 of one phase with controls."""
    yield _check_minimum(arc)
    _, u, gradient, found = gradient_along(arc)
    if arc.allowed and found:
        yield from _check_multiplier_signs(arc, arc.allowed, found)
    row = 0
    for here, control in control_slices(arc.phase.controls):
        rows, name = slice(row, row + control.freedom), "_".join(control.names)
        row = rows.stop
        if isinstance(control, UnitVectorControl):
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
    yield from _check_switching_function(arc)


def _check_multiplier_signs(arc: PhaseData, allowed: MixedConstraints, found: Multipliers) -> Iterator[Check]:
    for condition, falls, equal in zip(allowed.conditions, found.falls, allowed.equal, strict=True):
        if equal:  # its multiplier may have either sign
            continue
        yield Check(
            name=f"{arc.prefix}multiplier_{condition.name}", level=2, unit="1", limit=SLOPE_LIMIT,
            value=float(np.maximum(-falls, 0.0).max() * _size_factors(arc).max()) / arc.rate_scale,
            meaning=f"largest decrease of the Hamiltonian as the control moves inside from {condition.name} = 0: a"
            f" multiplier of the wrong sign (scaled)",
        )  # fmt: skip


def on_bounds(arc: PhaseData, at: int, control: ScalarControl, u: Matrix) -> tuple[Vector, Vector]:
    """Return True where a scalar lies on its lower, and where on its upper bound.

    Parameters
    ----------
    arc
        The phase.
    at, control
        Place of the scalar among the components of the control, and itself.
    u
        Controls [SI], (k, ...).
    """
    return control.on_bounds(u[at], ON_BOUND * arc.control_scale[at], arc.p)


def limit_derivatives(arc: PhaseData, u: Matrix, parameter: str) -> Matrix:
    """Return the derivatives of the control by a parameter that is the bound on which it lies: 1 or 0, shaped as u.

    Parameters
    ----------
    arc
        The phase.
    u
        Controls [SI], (k, ...).
    parameter
        Name of the parameter.
    """
    moves = np.zeros(u.shape)
    for at, control in scalars(arc.phase.controls):
        for limit, held in zip((control.lower, control.upper), on_bounds(arc, at, control, u), strict=True):
            if limit == parameter:
                moves[at] += held
    return moves


def _check_switching_function(arc: PhaseData) -> Iterator[Check]:
    """The switching function of each control at the times it jumps, on both sides."""
    for at, control in scalars(arc.phase.controls):
        times = arc.breaks[arc.jumps[at] != 0]
        if len(times):
            row = row_of(arc, control)
            t = np.concatenate([time_just_before(times), times])
            S = control_gradient(arc, arc.state(t), arc.control(t), arc.costate(t))[0][row]
            S = np.abs(S).reshape(2, -1).max(axis=0)
            before, after = arc.control(time_just_before(times)), arc.control(times)
            chord = np.abs(hamiltonian_chords(arc, at, control, arc.state(times), (before, after), arc.costate(times)))
            bent = S > SLOPE_LIMIT
            S = np.where(bent, np.minimum(S, chord), S)
            told = (
                ", or, where the Hamiltonian is nonlinear in it, the difference quotient across the jump"
                if bent.any()
                else ""
            )
            yield Check(
                name=f"{arc.prefix}switch_{control.name}", level=2, value=float(S.max()), unit="1",
                limit=SLOPE_LIMIT,
                meaning=f"largest switching function, dH/d({control.name}){told}, at the {len(times)} "
                f"time{'s' if len(times) > 1 else ''} at which {control.name} jumps: it must be 0 (scaled)",
            )  # fmt: skip


def hamiltonian_chords(
    arc: PhaseData, at: int, control: ScalarControl, x: Matrix, sides: tuple[Matrix, Matrix], lam: Matrix
) -> Vector:
    """Return the change of H from one control to another over that of one scalar, scaled as `control_gradient` is.

    Parameters
    ----------
    arc, at, control
        The phase; the place of the scalar among the components of the control, and itself.
    x, sides, lam
        States, both controls, and costates, (..., N).
    """
    one, other = sides
    with np.errstate(all="ignore"):  # where the scalar does not move there is no chord
        found = (arc.hamiltonian(x, other, lam) - arc.hamiltonian(x, one, lam)).real / (other[at] - one[at])
    return found * arc.control_scale[at] * _size_factors(arc)[row_of(arc, control)] / arc.rate_scale


def row_of(arc: PhaseData, control: ScalarControl) -> int:
    """Place of a scalar in `tangents`.

    Parameters
    ----------
    arc
        Phase with the controls.
    control
        Scalar control of the phase.

    Returns
    -------
    int
        Index of its tangent among those of all controls; a direction of d components has d - 1.
    """
    before = arc.phase.controls[: arc.phase.controls.index(control)]
    return sum(c.freedom for c in before)


def _check_minimum(arc: PhaseData) -> Check:
    """Inside every piece: at its first point against samples all over the set, at each against those at the others.

    The second is what sees a control that follows the minimum at one point and some other stationary value at the next.
    """
    pieces = arc.looked_at[0]
    x, u, lam = arc.read(pieces)
    count = len(pieces)
    worst = hamiltonian_gain(arc, x[:, :, :, None], u[:, :, :, None], u[:, :, None, :], lam[:, :, :, None])
    parts = [
        control.samples(u[here, :, 0], float(control_sizes(arc)[here.start]), arc.p)
        for here, control in control_slices(arc.phase.controls)
    ]
    if arc.allowed:
        parts, joint = _samples_on_conditions(arc.allowed, x[:, :, 0], u[:, :, 0], parts)
        for tried in joint:
            worst = np.maximum(
                worst, hamiltonian_gain(arc, x[:, None, :, 0], u[:, None, :, 0], tried, lam[:, None, :, 0])
            )
    samples = math.prod(len(part) for part in parts)
    # The longest axis last: what is done along it is done at once.
    axes = np.argsort(np.argsort([len(part) for part in parts], kind="stable")).tolist()
    width, tables = max(1, _AT_ONCE // samples), [np.stack(part, axis=2) for part in parts]
    for k in range(0, count, width):
        here = (slice(None), slice(k, k + width), 0, *(None,) * len(parts))
        tried = [
            component[:, *(slice(None) if j == axis else None for j in range(len(parts)))]
            for axis, table in zip(axes, tables, strict=True)
            for component in table[:, k : k + width]
        ]
        worst = np.maximum(worst, hamiltonian_gain(arc, x[here], u[here], tried, lam[here]))
    return Check(
        name=f"{arc.prefix}minimum_of_hamiltonian", level=2, limit=HAMILTONIAN_LIMIT, unit="1",
        value=float(worst) / arc.rate_scale,
        meaning=f"largest decrease of the Hamiltonian by any of {samples} controls inside each of {count} intervals"
        f" (scaled)",
    )  # fmt: skip


def _samples_on_conditions(
    allowed: MixedConstraints, x: Matrix, u: Matrix, parts: list[list[Matrix]]
) -> tuple[list[list[Matrix]], Any]:
    """Return samples of each control with more on the conditions that only it changes; and those of several controls.

    They are moved onto what is held all along, and to each condition that is active in addition.
    """
    controls, active = allowed.phase.controls, allowed.active(x, u)
    slopes, joint = np.abs(allowed.slopes(x, u)).max(axis=2), []
    more = [list(part) for part in parts]
    owner = np.repeat(np.arange(len(controls)), [control.freedom for control in controls])
    held = np.nonzero(allowed.equal)[0].tolist()
    others = np.nonzero(active.any(axis=1) & ~allowed.equal)[0].tolist()
    for rows in ([held] if held else []) + [[*held, row] for row in others]:
        changes, at = {int(i) for i in owner[(slopes[rows] > 0).any(axis=0)]}, active[rows].all(axis=0)
        thinned = [np.stack(part[::_EVERY] if i in changes else part[:1], axis=1) for i, part in enumerate(parts)]
        tried = product_of([part[:, :, at] for part in thinned])
        moved, reached = allowed.onto(rows, x[:, at], tried, np.isin(owner, list(changes)).astype(float))
        tried = np.repeat(u[:, None], tried.shape[1], axis=1)
        tried[:, :, at] = np.where(reached, moved, tried[:, :, at])
        if len(changes) == 1:
            (i,) = changes
            more[i] += list(tried[[here for here, _ in control_slices(controls)][i]].swapaxes(0, 1))
        else:
            joint.append(tried)
    return more, joint


def with_own_axes(parts: Sequence[Any]) -> list[Any]:
    """Return all components of the samples (components, S, N) of each control, which broadcast to (S, S', ..., N)."""
    return [
        component.reshape(*(component.shape[0] if j == i else 1 for j in range(len(parts))), -1)
        for i, part in enumerate(parts)
        for component in part
    ]


def product_of(parts: Sequence[Any]) -> Any:
    """Return every combination of the samples (components, S, N) of each control, (all components, product of S, N)."""
    every = np.broadcast_arrays(*with_own_axes(parts))
    return np.stack([component.reshape(-1, component.shape[-1]) for component in every])


def hamiltonian_gain(arc: PhaseData, x: Matrix, u: Matrix, tried: Any, lam: Matrix, *, leaving: bool = False) -> float:
    """Return the most that admissible controls of `tried` lower H below its value with u; shapes broadcast.

    Parameters
    ----------
    arc
        The phase.
    x, u, lam
        States, controls [SI] and costates [J per state], (components, ...).
    tried
        Other controls [SI], (k, ...), or k arrays.
    leaving
        True to admit controls that violate the held conditions.

    Returns
    -------
    float
        Largest decrease of H over all samples and times [J/s], at least 0.
    """
    H = arc.hamiltonian(x, tried, lam)
    slack = ADMISSIBLE * np.concatenate([arc.path_scale, arc.held_scale])
    if arc.allowed:  # what a condition gives away times its multiplier is no gain
        places = list(arc.allowed.places)
        slack[places] = np.minimum(slack[places], KEPT * arc.allowed.sizes)
    count = len(arc.path_scale)
    path, held = (arc.phase.evaluate(each, list(x), list(tried), arc.p) for each in ("path", "held"))
    broken = [np.less(value, -near) for near, value in zip(slack[:count], path, strict=True)]
    if not leaving:
        broken += [np.abs(value) > near for near, value in zip(slack[count:], held, strict=True)]
    for bad in broken:
        if np.any(bad):
            H = np.where(bad, np.inf, H)
    return float(np.maximum(np.max(arc.hamiltonian(x, u, lam) - H), 0.0))


@once_for_phase
def control_sizes(arc: PhaseData) -> Vector:
    """Return the sizes of the control components by which slopes of H are judged [SI].

    `PhaseData.control_scale`, unless a component reaches less than its unit: then what is `significant_size`, between
    these two.
    """
    scale, reached = arc.control_scale, _reachable_change(arc)
    units, least = _control_units(arc), np.where(reached > 0, np.minimum(scale, reached), scale)
    return (
        scale
        if (units <= least).all()
        else least * significant_size(units / least, _slope_weights(arc) * least / scale)
    )


@once_for_phase
def varied_sizes(arc: PhaseData) -> Vector:
    """Return the change of each control component that changes H by as much as J over the flight's time [SI].

    At most their unit, or what they reach. So the curvatures of H in controls of several units, and in those that
    hardly move, can be compared.
    """
    told = arc.control_scale / np.maximum(_slope_weights(arc), _NO_EFFECT)
    return np.minimum(told, np.maximum(_control_units(arc), _reachable_change(arc)))


def _reachable_change(arc: PhaseData) -> Vector:
    return np.abs(arc.trajectory.control.values).max(axis=0)


def _control_units(arc: PhaseData) -> Vector:
    """Canonical units of the control components, at least the size of any of the same unit [SI]."""
    units = control_scales(arc.phase.controls, arc.problem.scales)
    names = np.array([control.unit for control in arc.phase.controls for _ in control.names])
    alike = [arc.control_scale[names == name].max() for name in names]
    return np.maximum(units, alike) if len(alike) else units


@once_for_phase
def _slope_weights(arc: PhaseData) -> Vector:
    """The terms of the slope of H in each control component, by their amounts, over J and the time of the flight."""
    scale, t = arc.control_scale, arc.cut.left[:: len(arc.cut) // _LOOKS + 1]
    f_u = control_rates(arc, arc.state(t), arc.control(t), np.repeat(np.diag(scale)[:, :, None], len(t), axis=2))
    return np.abs(arc.costate(t)[:, None] * f_u).sum(axis=0).max(axis=1) / arc.rate_scale


def control_rates(arc: PhaseData, x: Matrix, u: Matrix, moves: Any) -> Any:
    """Derivatives of the dynamics as the control moves along `tangents`, (n, k, N), in SI.

    Parameters
    ----------
    arc
        The phase.
    x, u
        States (n, N) and controls (k, N) [SI].
    moves
        Tangents (components, k, N).
    """
    moved = u[:, None, :] + 1j * STEP * moves
    x_many = np.broadcast_to(x[:, None, :], (len(x), *moved.shape[1:]))
    return arc.rates(x_many, normalised(arc.phase.controls, moved)).imag / STEP


def control_gradient(arc: PhaseData, x: Matrix, u: Matrix, lam: Matrix) -> tuple[Matrix, Multipliers | None]:
    """dL/d(control) along the tangents, scaled, shape (k, N); multipliers where conditions have the control in them.

    Parameters
    ----------
    arc
        The phase.
    x, u, lam
        States (n, N) and controls (k, N) [SI], costates (n, N) [J per state].
    """
    f = control_rates(arc, x, u, tangents(arc.phase.controls, arc.control_scale, u))
    gradient, found = (lam[:, None, :] * f).sum(axis=0), None
    if arc.allowed:
        found = arc.allowed.multipliers(x, u, lam)
        gradient = gradient - found.pull
    return gradient * _size_factors(arc)[:, None] / arc.rate_scale, found


def _size_factors(arc: PhaseData) -> Vector:
    """Return the factor of each tangent over `PhaseData.control_scale`, shape (k,); 1 for a direction."""
    more = control_sizes(arc) / arc.control_scale
    rows = [
        more[here] if control.scalar else np.ones(control.freedom)
        for here, control in control_slices(arc.phase.controls)
    ]
    return np.concatenate(rows)


@once_for_phase
def gradient_along(arc: PhaseData) -> tuple[Vector, Matrix, Matrix, Multipliers | None]:
    """Times inside all pieces, at its ends and on both sides of breaks; control and `control_gradient` there."""
    breaks = np.setdiff1d(arc.breaks, arc.crossed)
    t = np.concatenate([time_just_before(breaks), breaks, arc.ends])
    inside = arc.sampled
    x, u, lam = (
        np.hstack([inside_, at(t)])
        for inside_, at in ((inside.x, arc.state), (inside.u, arc.control), (inside.lam, arc.costate))
    )
    return np.append(inside.t, t), u, *control_gradient(arc, x, u, lam)
