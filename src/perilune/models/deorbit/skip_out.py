"""Skip-out check: entries that leave the air again, as the fall rises above the interface once more.

A fall that is shallow and fast passes its lowest point before drag has slowed it, and climbs out. How high it rises
again is computed over the box of all masses, angles and speeds at the interface
(`perilune.models.deorbit.ballistic_limits`), each fall pulled down by as much as anything may that one in a plane
leaves out: oblateness and the flattening make the body pull harder, and the air goes along as slowly as in the most
westerly plane to which the propellant turns the orbit. Where every one of them leaves, no ballistic entry stays in the
air.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import Matrix
from perilune.models.deorbit.ballistic_fall import Fall, fall
from perilune.models.deorbit.ballistic_limits import (
    LEFT_OUT,
    angle_interval,
    cell_minima,
    mass_interval,
    speed_interval,
    with_mass,
)
from perilune.models.deorbit.records import is_something_left, total_velocity_change
from perilune.models.deorbit.site_passes import largest_plane_turn
from perilune.models.physics.atmosphere import Air
from perilune.problem import Finding

_POINTS = 2001  # of a fall, which takes up to three turns


def compare_skip_out(p: Any, air: Air, typical: Fall) -> Iterator[Finding]:
    """Compare the rise of all ballistic entries above the interface (skip-out), or else that of a typical one.

    Parameters
    ----------
    p, air
        Parameters [SI], numbers all of them, and the air.
    typical
        A fall of them.
    """
    if (tops := _rebound_heights(p, air)) is not None:
        least = (1 - LEFT_OUT) * cell_minima(tops)
        if least > 0:
            yield _compare_with_interface(
                "every entry", least, binding=True,
                meaning="every ballistic entry allowed at the interface leaves the atmosphere again (skip-out): over"
                f" all masses, angles and speeds there they rise to {np.min(tops) / 1e3:.3g} km above it or more",
            )  # fmt: skip
            return
    yield _compare_with_interface(
        "a typical entry", rebound_height(typical, p.interface_altitude), binding=False,
        meaning="a typical ballistic entry leaves the atmosphere again (skip-out)",
    )  # fmt: skip


def _compare_with_interface(which: str, top: float, *, binding: bool, meaning: str) -> Finding:
    return Finding(
        name=f"skip-out: altitude above the interface regained by {which} without lift",
        value=max(top, 0.0) / 1e3,
        limit=0.0, at_least=False, unit="km", binding=binding, meaning=meaning,
        advice="a steeper interface.angle, or a lower speed at the interface",
    )  # fmt: skip


def _rebound_heights(p: Any, air: Air) -> Matrix | None:
    """Return how far [m] falls rise again above the interface, on a grid over their box; None where any does not."""
    masses, angles, speeds = mass_interval(p), angle_interval(p), speed_interval(p)
    if angles is None or speeds is None:
        return None
    down, found = with_downward_bound(p), list[float]()
    # The steepest and slowest leave last.
    for mass, steep, speed in product(masses, angles, speeds):
        found.append(
            rebound_height(fall(with_mass(down, mass), air, float(steep), float(speed), _POINTS), p.interface_altitude)
        )
        if not found[-1] > 0:
            return None
    return np.array(found).reshape(len(masses), len(angles), len(speeds))


def rebound_height(fallen: Fall, interface: float) -> float:
    """Return how far [m] a fall rises above the interface after its lowest point; -inf where it never climbs.

    Parameters
    ----------
    fallen
        Fall whose rows begin with the height [m].
    interface
        Altitude of the interface [m].
    """
    heights = fallen.rows[:, 0]
    climbs = np.nonzero(np.diff(heights) > 0)[0]
    return float(np.max(heights[climbs[0] + 1 :])) - interface if len(climbs) else -math.inf


def with_downward_bound(p: Any) -> Any:
    """Return the same problem with every effect that planar falls neglect taken at its most downwards."""
    oblate = sum((k + 1) * abs(getattr(p, f"body_j{k}", 0.0)) for k in (2, 3, 4))
    turned = float(largest_plane_turn(p, total_velocity_change(p))) if is_something_left(p) else math.pi
    along = math.copysign(1.0, p.body_rotation_rate)  # the way that the air goes
    away = min(math.acos(along * math.cos(p.orbit_inclination)) + turned, math.pi)
    changed = {
        "body_gravitational_parameter": p.body_gravitational_parameter
        * (1 + oblate + 2 * getattr(p, "body_flattening", 0.0)),
        "orbit_inclination": math.acos(along * math.cos(away)),
    }
    return SimpleNamespace(**{**vars(p), **changed})
