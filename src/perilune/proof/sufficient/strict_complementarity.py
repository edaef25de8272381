"""Strict complementarity, level 3: scalars strictly on their bounds, left where the switching function crosses zero.

The strict form of what `minimum_principle` checks is the Legendre condition of bang-bang controls, one of the two
sufficient conditions of level 3:

    |S| > 0 on a bound, and dS/dt != 0 where u jumps.

There f+, H_x+ belong to the control after the jump, f-, H_x- to the one before (L_x likewise), and with lam' = -H_x

    D = -d(H+ - H-)/dt = f+.H_x- - f-.H_x+ = -dS/dt (u+ - u-) > 0.

**H that bends in u.** Where it is concave u jumps without passing S = 0: H is the same at both bounds, and so is the
chord [H(other) - H]/|other - u| what vanishes there and nowhere else. No control between them makes H rise by less
than its share of that, so that the chord has the place of |S| wherever it is less.

**Ends of the flight.** S vanishes where the flight ends if nothing there says what u moves, as a lift does the velocity
of a flight that may arrive at any. That is a switch at the end: beyond it u is on its other bound, for no time. A
flight that switches tau before the end costs D tau^2/2 as one near any other switch, and moves its end as far. So an
end with S = 0 is strict where dS/dt != 0, and its arc of length 0 belongs to the second variation (`second_variation`),
which must be positive whatever the sign of tau: that is more than is needed, as tau cannot be negative. A jump to any
other value between the bounds moves less at the same price. The same holds at the start, and where |S| is almost 0 at
an end: what it adds to the price of tau is positive.

**Brief arcs.** Between two switches a time tau apart S is a parabola, and D = |S''| tau/2 at both: where tau goes to 0
as a burn becomes an impulse, D does too, and D/tau stays. That is the curvature of the primer vector at the impulse,
which has to be above 0 (Lawden 1963, chapter 5). So beside an arc of less than a hundredth of the flight D counts over
that share, but a hundred times at most: a D still nearer to 0 is none.

Source: Maurer and Osmolovskii (2004), Second order sufficient conditions for time-optimal bang-bang control;
Osmolovskii and Maurer (2012), chapter 6, for the problem in switching times that this is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from perilune.core import Matrix, Vector, complex_step_jacobian
from perilune.problem import Check, ScalarControl, scalars
from perilune.proof.feasible.phase_data import PhaseData, once_for_phase
from perilune.proof.feasible.sample_points import time_just_before
from perilune.proof.necessary.minimum_principle import (
    HAMILTONIAN_LIMIT,
    SLOPE_LIMIT,
    control_gradient,
    gradient_along,
    hamiltonian_chords,
    on_bounds,
    row_of,
)
from perilune.proof.sufficient.singular_arcs import Singular, distance_slopes

STRICT_LIMIT = -1e-4
_BRIEF = 1e-6  # of the flight: as near to a switch as that |S| says nothing
_LOOKS = 101  # times at which |S| is sized
_SHORT, _LEAST_SHARE = (
    1e-2,
    1e-2,
)  # of the flight: arcs that are brief; the least unit in which slopes beside these count
_CHORD_ROUNDING = 1e-6  # of the slope: where H is a straight line in u its chord differs by rounding


@dataclass(frozen=True, kw_only=True)
class EndSwitch:
    """A scalar on its bound whose switching function vanishes at an end of the flight.

    Attributes
    ----------
    time
        0 or the duration of its phase [s].
    at, across
        Its place among the components of the control, and the bound on which it is not [SI].
    slope
        D, scaled.
    """

    time: float
    at: int
    across: float
    slope: float


@once_for_phase
def end_switches(arc: PhaseData) -> tuple[EndSwitch, ...]:
    """Return switches at the flight's ends in a phase; none if several vanish at once, or H bends between bounds."""
    found = list[EndSwitch]()
    for time in arc.ends.tolist() if any(control.scalar for control in arc.phase.controls) else ():
        first, last = arc.index == 0, arc.index == len(arc.problem.phases) - 1
        if (time == 0.0 and first) or (time > 0.0 and last):
            here = list(_vanishing_switches(arc, time))
            found += here if len(here) == 1 else []
    return tuple(found)


def _vanishing_switches(arc: PhaseData, time: float) -> Iterator[EndSwitch]:
    t = np.array([time])
    x, u, lam = arc.state(t), arc.control(t), arc.costate(t)
    gradient, _ = control_gradient(arc, x, u, lam)
    for at, control in scalars(arc.phase.controls):
        lower, upper = on_bounds(arc, at, control, u)
        S = _steepness(arc, at, control, t, np.abs(gradient[row_of(arc, control)]))
        if not (lower | upper).any() or not S.max() <= _switch_threshold(arc, at, control, time):
            continue
        across = np.array(u)
        across[at] = control.limits(arc.p)[1 if lower.any() else 0]
        if not math.isfinite(across[at, 0]) or (arc.allowed and arc.allowed.active(x, u).any()):
            continue
        change = arc.hamiltonian(x, across, lam) - arc.hamiltonian(x, u, lam)
        if np.abs(change).max() <= HAMILTONIAN_LIMIT * arc.rate_scale or S.max() > SLOPE_LIMIT:
            sides = (across, u) if time == 0.0 else (u, across)
            yield EndSwitch(
                time=time, at=at, across=float(across[at, 0]), slope=float(_switch_slope_at(arc, t, *sides)[0])
            )


def _switch_threshold(arc: PhaseData, at: int, control: ScalarControl, time: float) -> float:
    """Return the |S| at an end below which `check_strictness` would take it for 0; negative next to a switch.

    Parameters
    ----------
    arc, at, control
        The phase; the place of the scalar among the components of the control, and itself.
    time
        Of the end [s].
    """
    apart = float(time_to_switch(arc, np.array([time]))[0])
    if apart <= _BRIEF * arc.duration:
        return -1.0
    t = np.linspace(0.0, arc.duration, _LOOKS)
    gradient, _ = control_gradient(arc, arc.state(t), arc.control(t), arc.costate(t))
    S = _steepness(arc, at, control, t, np.abs(gradient[row_of(arc, control)]))
    return max(SLOPE_LIMIT, -STRICT_LIMIT * float(S.max()) * apart / arc.duration)


def check_strictness(arc: PhaseData) -> Iterator[Check]:
    """Checks of level 3: each scalar on a bound is there strictly, and leaves it by a jump at a finite slope of S."""
    if not any(control.scalar for control in arc.phase.controls):
        return
    t, u, gradient, _ = gradient_along(arc)
    ends = end_switches(arc)
    for at, control in scalars(arc.phase.controls):
        own = [end for end in ends if end.at == at]
        apart = time_to_switch(arc, t, [end.time for end in own])
        held = np.logical_or(*on_bounds(arc, at, control, u)) & (apart > _BRIEF * arc.duration)
        if not held.any():
            continue
        S = _steepness(arc, at, control, t, np.abs(gradient[row_of(arc, control)]))
        jumps = (arc.jumps[at] != 0) & ~Singular.of(arc).junctions
        steps = [np.abs(arc.jumps[at, jumps]), [_size_of_jump(arc, end) for end in own]]
        crossing = np.concatenate([switch_slopes(arc)[jumps], [end.slope for end in own]]) / np.concatenate(steps)
        crossing = crossing / arc.time_scale**2 * arc.objective_scale / arc.rate_scale
        crossing /= _slope_units(arc, at, np.array([*arc.breaks[jumps], *(end.time for end in own)]), own)
        slopes = distance_slopes(arc, at, S / _slope_units(arc, at, t, own), t, apart, held)
        slopes = np.append(slopes, crossing * arc.duration)
        yield Check(
            name=f"{arc.prefix}strict_{control.name}", level=3, limit=STRICT_LIMIT, unit="1",
            value=float(-slopes.min() / S.max()),
            meaning=f"minus the least switching function of {control.name} on a bound, over the time to the nearest"
            f" switch, and its slope at each switch (in units of its largest value over the flight time): below 0 if"
            f" it vanishes only at switches and crosses zero there; next to a singular arc, over the square of that"
            f" time; next to an arc shorter than a hundredth of the flight between two switches, over that share"
            + "".join(f"; its zero where the flight {'ends' if end.time else 'begins'} counts as a switch"
                      for end in own),
        )  # fmt: skip


def _slope_units(arc: PhaseData, at: int, t: Vector, ends: Sequence[EndSwitch]) -> Vector:
    """Return the units in which slopes of S count: below 1 beside brief arcs between two switches (above).

    Parameters
    ----------
    arc, at
        The phase, and the place of a scalar.
    t
        Times [s], (N,).
    ends
        Its switches at ends of the flight.
    """
    inside = arc.breaks[(arc.jumps[at] != 0) & ~Singular.of(arc).junctions]
    switches = np.sort([*inside, *(end.time for end in ends)])
    if len(switches) < 2:
        return np.ones(len(t))
    between = np.diff(switches)
    brief = np.minimum(np.append(between, np.inf), np.append(np.inf, between))
    away = np.abs(t[:, None] - switches)
    nearest = away.argmin(axis=1)
    share = np.maximum(brief[nearest], away.min(axis=1)) / (_SHORT * arc.duration)
    return np.clip(share, _LEAST_SHARE, 1.0)


def _steepness(arc: PhaseData, at: int, control: ScalarControl, t: Vector, S: Vector) -> Vector:
    """Return |dH/du| of a scalar at times, or by how much H rises to its other bound over the range where that is less.

    Parameters
    ----------
    arc, at, control
        The phase; the place of the scalar among the components of the control, and itself.
    t, S
        Times, and |dH/du| there, scaled.
    """
    low, high = (float(limit) for limit in control.limits(arc.p))
    if arc.allowed or not (math.isfinite(high - low) and low < high):
        return S
    x, lam = arc.state(t), arc.costate(t)
    sides = arc.control(t), arc.control(t)
    sides[0][at], sides[1][at] = low, high
    chord = np.abs(hamiltonian_chords(arc, at, control, x, sides, lam))
    return np.where(chord < (1 - _CHORD_ROUNDING) * S, chord, S)


def _size_of_jump(arc: PhaseData, end: EndSwitch) -> float:
    """Return by how much a scalar would jump, canonical."""
    own = arc.control(np.array([end.time]))[end.at, 0]
    return abs(end.across - own) / float(arc.control_scale[end.at])


def time_to_switch(arc: PhaseData, t: Vector, ends: list[float] | None = None) -> Vector:
    """Time to the nearest break, or joint of phases, whose time is chosen too: S may vanish there, and nowhere else.

    But at `ends` of the flight that are switches.

    Parameters
    ----------
    arc
        The phase.
    t
        Times [s], (N,).
    ends
        Times of ends of the flight that are switches [s].
    """
    joints = [0.0] * (arc.index > 0) + [arc.duration] * (arc.index < len(arc.problem.phases) - 1)
    zeros = np.array([*arc.breaks, *joints, *(ends or [])])
    return np.abs(t[:, None] - zeros).min(axis=1) if len(zeros) else np.full(len(t), arc.duration)


@once_for_phase
def switch_slopes(arc: PhaseData) -> Vector:
    """D (above) at each break, scaled: 0 where nothing jumps."""
    times, before = arc.breaks, time_just_before(arc.breaks)
    return np.where(arc.jumps.any(axis=0), _switch_slope_at(arc, times, arc.control(before), arc.control(times)), 0.0)


def _switch_slope_at(arc: PhaseData, times: Vector, u_before: Matrix, u_after: Matrix) -> Vector:
    """D (above) at times, between two controls there; 0 where it is rounding of the terms that it is the sum of."""
    lam, x, scale = arc.costate(times), arc.state(times), arc.state_scale

    def side(u: Matrix) -> tuple[Matrix, Matrix]:
        """Rates, and dL/dx."""
        f_x = complex_step_jacobian(
            lambda z: arc.rates(z, u.reshape(len(u), *(1,) * (z.ndim - 2), len(times))), x, scale
        )
        pushed = arc.allowed.push(x, u, lam) if arc.allowed else 0.0
        return arc.rates(x, u).real, ((lam[:, None] * f_x).sum(axis=0) - pushed) / scale[:, None]

    (f_before, h_before), (f_after, h_after) = side(u_before), side(u_after)
    ahead, behind = f_after * h_before, f_before * h_after
    slope, size = (ahead - behind).sum(axis=0), (np.abs(ahead) + np.abs(behind)).sum(axis=0)
    return np.where(np.abs(slope) > HAMILTONIAN_LIMIT * size, slope, 0.0) * arc.time_scale**2 / arc.objective_scale
