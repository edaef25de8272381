"""Detection of chattering controls, which no mesh follows, and a message with their usual cause.

Where the set of admissible rates is not convex, as that of a thrust that cannot fall below a floor, the infimum of J
may be reached by no control: the best are sequences that switch ever faster between far values, whose mean is what
the flight would need (Gamkrelidze, Principles of Optimal Control Theory, 1978, chapter 8). Around a singular arc of
even order switches pile up too (Fuller 1963). From a mesh the two look alike, and like a flight of many switches.

Boundary arcs that no optimal flight follows, since chattering next to the boundary always lowers J.

Along S = 0 a control keeps S^(q) = 0. Where H is concave in a scalar u that does so, a flight that switches between
both bounds of u and keeps S^(q) = 0 in the mean stays as near to the arc as it switches fast, and has

    H(u) - [(1 - s) H(lower) + s H(upper)] > 0,       s = (u - lower)/(upper - lower),

less of H: the faster the better, without end. The arc is then no extremal, whatever its multipliers are, and the least
J is approached by flights that chatter and reached by none (Zelikin, Borisov 1994; relaxed controls: Young 1969).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perilune.core import Vector, format_quantity
from perilune.problem import Phase, Solution, limit_name, quantity_name, scalars

_LOOKS = 400  # times of a phase, between which a change is a jump
_FAR = 0.5  # of the range of a component along the flight
_WIDE = 0.3  # canonical or of its bounds: what moves in a narrower range is not counted
_OFTEN = 5  # jumps in a phase; fewer are an ordinary structure
_ARC_TIMES = 100  # times along a boundary arc
_CONCAVE_BY, _HELD_STRAIGHT = 1e-6, 1e-6  # of the terms of H, and of those of what is held
_ON_FLOOR = 0.05  # of the range of a scalar


@dataclass(frozen=True, kw_only=True)
class ChatteringControl:
    """A control component that jumps so often in a phase, and what holds the flight back meanwhile."""

    text: str
    advice: str


def detect_chattering(flight: Solution) -> ChatteringControl | None:
    """Return what chatters in a flight that no mesh has followed; None where no control jumps often.

    Parameters
    ----------
    flight
        As a direct method has it, with a mesh error that is far from what was asked for.

    Returns
    -------
    Chatter or None
        What is said of it, and what to try.
    """
    for k, phase in enumerate(flight.problem.phases):
        t = np.linspace(0.0, flight.trajectories[k].duration, _LOOKS)
        _, u = flight.evaluate(k, t)
        for i, name in enumerate(phase.control_names):
            jumps = _jump_samples(u[i])
            if len(jumps) >= _OFTEN:
                return _describe_chattering(flight, phase, name, jumps, u)
    return None


def _jump_samples(along: Vector) -> Vector:
    """Return the samples before which a component jumps."""
    reach = float(np.ptp(along))
    return np.nonzero(np.abs(np.diff(along)) > _FAR * reach)[0] if reach > _WIDE else np.zeros(0, dtype=int)


def _describe_chattering(flight: Solution, phase: Phase, name: str, jumps: Vector, u: Vector) -> ChatteringControl:
    text = f"{name.replace('_', ' ')} of {phase.name} jumps {len(jumps)} times, and no mesh resolves it"
    for at, control in scalars(phase.controls):
        lower, _ = control.limits(flight.parameters)
        on_floor = control.bounded and lower > 0 and control.share(u[at], flight.parameters) < _ON_FLOOR
        if control.bounded and lower > 0 and np.mean(np.asarray(on_floor)[jumps]) > _FAR:
            floor = limit_name(flight.problem, control, "lower")
            return ChatteringControl(
                text=f"{text}, while {quantity_name(control)} is at its floor "
                f"({format_quantity(float(lower), control.unit)}): "
                "the engine pushes more than the flight needs, and turning it back and forth wastes the excess",
                advice=f"lower {floor}, or free the time of ignition (a coast before the burn), so that it burns"
                f" later; or narrow the limit of the thrust direction",
            )
    return ChatteringControl(
        text=text,
        advice="the usual cause is a thrust that cannot be as small as the flight needs (a throttle floor, a fixed"
        " ignition time): relax it; or a control that J does not depend on: add a small cost of it",
    )


def find_chattering_arc(solution: Solution) -> str | None:
    """Return the name of a scalar that would better switch back and forth along an arc; None where there is none.

    Parameters
    ----------
    solution
        A restated problem's, whose phases hold the conditions of their boundary arcs; with costates.
    """
    for phase, flown in zip(solution.problem.phases, solution.trajectories, strict=True):
        if not phase.held_conditions or flown.costate is None or flown.duration <= 0:
            continue
        t, p = np.linspace(0.0, flown.duration, _ARC_TIMES + 2)[1:-1], solution.parameters
        x, u, lam = flown.state(t).T, flown.control(t).T, flown.costate(t).T
        for at, control in scalars(phase.controls):
            lower, upper = control.limits(p)
            if not (np.isfinite(upper - lower) and lower < upper):
                continue
            share, sides = (u[at] - lower) / (upper - lower), []
            for value in (u[at], lower + 0 * t, upper + 0 * t):
                moved = np.array(u)
                moved[at] = value
                rates = [np.broadcast_to(r, t.shape) for r in phase.rates(list(x), list(moved), p)]
                held = [np.broadcast_to(h, t.shape) for h in phase.evaluate("held", list(x), list(moved), p)]
                sides.append((lam * np.array(rates), np.array(held)))
            (H, S), (H_low, S_low), (H_high, S_high) = sides
            drop = (H - (1 - share) * H_low - share * H_high).sum(axis=0)
            bend = np.abs(S - (1 - share) * S_low - share * S_high)
            concave = drop > _CONCAVE_BY * np.abs(H).sum(axis=0)
            kept = bend <= _HELD_STRAIGHT * (np.abs(S_low) + np.abs(S_high))
            if bool((concave & kept.all(axis=0) & (share > 0) & (share < 1)).all()):
                return control.name
    return None
