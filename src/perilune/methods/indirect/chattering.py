"""Detection of chattering controls, which no mesh follows, and a message with their usual cause.

Where the set of admissible rates is not convex, as that of a thrust that cannot fall below a floor, the infimum of J
may be reached by no control: the best are sequences that switch ever faster between far values, whose mean is what
the flight would need (Gamkrelidze, Principles of Optimal Control Theory, 1978, chapter 8). Around a singular arc of
even order switches pile up too (Fuller 1963). From a mesh the two look alike, and like a flight of many switches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perilune.core.arrays import Vector
from perilune.core.units import format_quantity
from perilune.problem.controls import scalars
from perilune.problem.display.quantity_names import limit_name, quantity_name
from perilune.problem.phase import Phase
from perilune.problem.results.solution import Solution

_LOOKS = 400  # times of a phase, between which a change is a jump
_FAR = 0.5  # of the range of a component along the flight
_WIDE = 0.3  # canonical or of its bounds: what moves in a narrower range is not counted
_OFTEN = 5  # jumps in a phase; fewer are an ordinary structure
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
