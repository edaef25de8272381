"""Non-unique controls: H is the same for all of their values, all along a phase.

Nothing that is minimised or has to be met changes with such a control, and extremals are not isolated: a lift of which
the cheapest flight needs only that it arrives.
"""

from __future__ import annotations

import numpy as np

from perilune.problem.controls import control_scales, control_slices
from perilune.problem.solution import Solution

_LOOKS = 40  # times of a phase
_FLAT = 1e-6  # of the largest sum of the parts of H on the flight; what counts for little still has some 1e-4


def undetermined_controls(flight: Solution) -> tuple[str, ...]:
    """Name the controls of a flight with costates that nothing determines, each with its phase before it."""
    found, size = list[tuple[float, str]](), 0.0
    for k, (phase, flown) in enumerate(zip(flight.problem.phases, flight.trajectories, strict=True)):
        if flown.costate is None:
            return ()
        t = np.linspace(0.0, flown.duration, _LOOKS)
        x, u = flight.flown(k, t)
        costate, p = flown.costate(t).T, flight.parameters
        rates = np.array(np.broadcast_arrays(*phase.rates(x, u, p), t)[:-1])
        size = max(size, float(np.abs(costate * rates).sum(axis=0).max()))
        scales = control_scales(phase.controls, flight.problem.scales)
        for at, control in control_slices(phase.controls):
            changes = [0.0]
            for values in control.samples(u[at], float(scales[at.start]), p):
                other = u.copy()
                other[at] = values
                changed = np.array(np.broadcast_arrays(*phase.rates(x, other, p), t)[:-1])
                changes.append(float(np.abs((costate * (changed - rates)).sum(axis=0)).max()))
            found.append((max(changes), f"{phase.name}.{', '.join(phase.control_names[at])}"))
    return tuple(name for change, name in found if change <= _FLAT * size)
