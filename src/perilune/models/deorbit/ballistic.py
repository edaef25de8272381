"""What every ballistic entry bears at least: limits that none of them keeps, said before anything is solved.

Without lift nothing is chosen below the interface: an entry is told by its speed and its path angle there. The angle
lies between its bounds. The speed lies between its own, and between those that the propellant leaves
(`perilune.models.deorbit.bounds`). Over this box the greatest load, heat rate and dynamic pressure of falls in a plane
are computed. What none of them bears less than is the least over the box, less the most by which two neighbours on the
grid differ, less `_LEFT_OUT` for what falls in a plane about a sphere leave out: oblateness, and air that turns.
A fall that leaves the air and is not down three turns later is none that an entry may last.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np

from perilune.models import aerodynamics
from perilune.models.atmosphere import Air
from perilune.models.deorbit.bounds import interface_speeds
from perilune.models.deorbit.fall import Fall, fall
from perilune.problem.preflight import Finding
from perilune.words.maths import NUMERIC
from perilune.words.types import Vector
from perilune.words.units import STANDARD_GRAVITY

_ANGLES, _SPEEDS = 5, 3  # of the grid over the box
_LEFT_OUT = 0.1
_POINTS = 4001  # of a fall, which may leave the air and come back
_SAID = {  # of each limit: what is compared, its unit, and what one of it is in SI
    "load": ("peak load of every fall without lift", "g0", STANDARD_GRAVITY),
    "heat_rate": ("peak heat rate of every fall without lift", "W/m^2", 1.0),
    "dynamic_pressure": ("peak dynamic pressure of every fall without lift", "Pa", 1.0),
}


def borne_at_least(p: Any, air: Air) -> Iterator[Finding]:
    """Each limit beside what every ballistic entry bears at least; nothing where the box of entries is not known.

    Parameters
    ----------
    p, air
        Parameters [SI], numbers all of them, and the air.
    """
    limited = [name for name in _SAID if hasattr(p, f"limits_{name}")]
    angles, speeds = _angles(p), box_of_speeds(p)
    if not limited or angles is None or speeds is None:
        return
    falls = [fall(p, air, steep, speed, _POINTS) for steep, speed in product(angles.tolist(), speeds.tolist())]
    lands = np.array([fallen.lands for fallen in falls]).reshape(_ANGLES, _SPEEDS)
    if not lands.any():
        return
    for name in limited:
        what, unit, one = _SAID[name]
        peaks = np.array([peak(name, fallen, p, air) for fallen in falls]).reshape(_ANGLES, _SPEEDS)
        peaks = np.where(lands, peaks, np.nan)
        apart = max(float(np.nanmax(np.abs(np.diff(peaks, axis=axis)), initial=0.0)) for axis in (0, 1))
        yield Finding(
            name=what, value=(1 - _LEFT_OUT) * (float(np.nanmin(peaks)) - apart) / one,
            limit=float(getattr(p, f"limits_{name}")) / one, at_least=False, unit=unit, binding=True,
            meaning=f"no ballistic entry that the interface allows keeps limits.{name}: at the angles and speeds that"
            f" it can have there they peak at {np.nanmin(peaks) / one:.3g} to {np.nanmax(peaks) / one:.3g} {unit}",
            advice=f"a lift (vehicle.lift_to_drag), another interface.angle, or a greater limits.{name}",
        )  # fmt: skip


def _angles(p: Any) -> Vector | None:
    """Angles [rad] at the interface; None where a bound is not known or not below the horizon."""
    if hasattr(p, "interface_angle"):
        return np.full(_ANGLES, p.interface_angle) if p.interface_angle < 0 else None
    lower, upper = (getattr(p, f"interface_angle_{side}", math.nan) for side in ("lower", "upper"))
    return np.linspace(lower, upper, _ANGLES) if lower < upper < 0 else None


def box_of_speeds(p: Any) -> Vector | None:
    """Speeds [m/s] beside the body at the interface; None where neither bounds nor the propellant tell them."""
    if hasattr(p, "interface_speed"):
        return np.full(_SPEEDS, p.interface_speed)
    low, high = (getattr(p, f"interface_speed_{side}", math.nan) for side in ("lower", "upper"))
    if hasattr(p, "vehicle_dry_mass"):
        least, most = (float(speed) for speed in interface_speeds(p, NUMERIC))
        low, high = np.fmax(low, least), np.fmin(high, most)
    return np.linspace(low, high, _SPEEDS) if 0 < low <= high else None


def peak(name: str, fallen: Fall, p: Any, air: Air) -> float:
    """Greatest value of what is limited, at the points of a fall: no more than it is."""
    height, speed = fallen.rows[:, 0], fallen.rows[:, 2]
    density, mass = air.density(height, p, NUMERIC), getattr(p, "separation_mass", p.vehicle_mass)
    velocity = (speed, 0.0 * speed, 0.0 * speed)
    if name == "load":
        found = aerodynamics.load(density, velocity, mass, p, NUMERIC)
    elif name == "heat_rate":
        found = aerodynamics.heat_rate(density, velocity, p, NUMERIC)
    else:
        found = aerodynamics.dynamic_pressure(density, velocity)
    return float(np.max(found))
