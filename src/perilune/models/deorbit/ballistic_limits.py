"""Least loads of all ballistic entries: limits that none of them keeps are found before anything is solved.

Without lift nothing is chosen below the interface: an entry is given by its mass, its speed and its path angle there.
The angle lies between its bounds, the mass between all propellant and none, and the speed between its own bounds and
those that the propellant leaves (`perilune.models.deorbit.interface_bounds`). Over this box the greatest load, heat
rate and dynamic pressure of falls in a plane are computed, each held up by as much as anything may that such a fall
leaves out:

- the air goes along as fast as in the most easterly plane to which the propellant turns the orbit;
- of the body's pull are missing 3 |J2| + 4 |J3| + 5 |J4| of it, as above its oblate places, the centrifugal
  acceleration, and twice the flattening, by which an ellipsoid is flatter than its equator;
- what the vertical leans above an ellipsoid, by its flattening [rad] at most, widens the box of angles.

*The least over the box.* Between the points of a grid, h apart, a smooth function lies below those at the corners by no
more than h^2/8 of its second derivative along each axis, and one with a kink by no more than h/4 of the jump of its
slope there. Both are less than a quarter of the second differences on the grid. Where some fall of a cell does not
land, nothing is said of what is between, but that it differs by no more than neighbours do. A fall that leaves the air
and is not down three turns later lasts longer than an entry may.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from perilune.core import NUMERIC, STANDARD_GRAVITY, Matrix, Vector
from perilune.models.deorbit.ballistic_fall import Fall, fall
from perilune.models.deorbit.interface_bounds import interface_speeds
from perilune.models.deorbit.records import is_something_left, total_velocity_change
from perilune.models.deorbit.site_passes import largest_plane_turn, least_burnout_mass
from perilune.models.physics import aerodynamics
from perilune.models.physics.atmosphere import Air
from perilune.problem import Finding

_GRIDS = ((7, 5, 3), (13, 17, 3))  # angles, speeds and masses of the box; the finer where the first leaves it open
_BENDS = 0.25  # times second differences
LEFT_OUT = 0.01  # of the second order of what the plane leaves out
_LEAST_PULL = 0.01  # of the body's pull
_POINTS = 4001  # of a fall, which may leave the air and come back


class _ReportedLimit(NamedTuple):
    """Name of a compared quantity, its unit, and the SI value of one such unit."""

    what: str
    unit: str
    one: float


_SAID = {
    "load": _ReportedLimit("peak load", "g0", STANDARD_GRAVITY),
    "heat_rate": _ReportedLimit("peak heat rate", "W/m^2", 1.0),
    "dynamic_pressure": _ReportedLimit("peak dynamic pressure", "Pa", 1.0),
}


def compare_least_loads(p: Any, air: Air, typical: Fall) -> Iterator[Finding]:
    """Compare each limit with the least load of every ballistic entry, or of a typical one where the box is not known.

    Parameters
    ----------
    p, air
        Parameters [SI], numbers all of them, and the air.
    typical
        A fall of them.
    """
    limited = [name for name in _SAID if hasattr(p, f"limits_{name}")]
    if angle_interval(p) is None or speed_interval(p) is None:
        yield from (_compare_typical_load(name, typical, p, air) for name in limited if typical.lands)
        return
    found = list[tuple[Finding, bool]]()
    for grid in _GRIDS if limited else ():
        found = list(_over_box(p, air, limited, *grid))
        if not any(beside.passed and is_open for beside, is_open in found):
            break
    yield from (beside for beside, _ in found)


def _over_box(
    p: Any, air: Air, limited: list[str], angle_count: int, speed_count: int, mass_count: int
) -> Iterator[tuple[Finding, bool]]:
    """Compare each limit with the least over the box, and tell whether all falls of the grid break what it keeps."""
    angles, speeds, masses = (
        angle_interval(p, angle_count),
        speed_interval(p, speed_count),
        mass_interval(p, mass_count),
    )
    assert angles is not None and speeds is not None
    held = with_upward_bound(p)
    entries = [(with_mass(held, mass), steep, speed) for mass, steep, speed in product(masses, angles, speeds)]
    falls = [fall(light, air, float(steep), float(speed), _POINTS) for light, steep, speed in entries]
    shape = len(masses), len(angles), len(speeds)
    lands = np.array([fallen.lands for fallen in falls])
    if not lands.any():
        return
    for name in limited:
        one = _SAID[name].one
        peaks = np.array(
            [peak_load(name, fallen, light, air) for fallen, (light, *_) in zip(falls, entries, strict=True)]
        )
        least = (1 - LEFT_OUT) * cell_minima(np.where(lands, peaks, np.nan).reshape(shape)) / one
        mildest, hardest = np.min(peaks[lands]) / one, np.max(peaks[lands]) / one
        beside = _compare_with_limit(
            name, "every fall", least, p, binding=True,
            meaning=f"no ballistic entry allowed at the interface keeps limits.{name}: over"
            f" all masses, angles and speeds there they peak at {mildest:.3g} to {hardest:.3g} {_SAID[name].unit}",
        )  # fmt: skip
        yield beside, mildest > beside.limit


def _compare_typical_load(name: str, fallen: Fall, p: Any, air: Air) -> Finding:
    return _compare_with_limit(
        name, "a fall", peak_load(name, fallen, p, air) / _SAID[name].one, p, binding=False,
        meaning=f"a typical ballistic entry does not keep limits.{name}; whether any does can be decided if the"
        f" speeds and angles at the interface are bounded (interface.speed_lower, vehicle.dry_mass)",
    )  # fmt: skip


def _compare_with_limit(name: str, which: str, value: float, p: Any, *, binding: bool, meaning: str) -> Finding:
    said = _SAID[name]
    return Finding(
        name=f"{said.what} of {which} without lift", value=value, limit=float(getattr(p, f"limits_{name}")) / said.one,
        at_least=False, unit=said.unit, binding=binding, meaning=meaning,
        advice=f"a lift (vehicle.lift_to_drag), another interface.angle, or a greater limits.{name}",
    )  # fmt: skip


def cell_minima(peaks: Matrix) -> float:
    """Return the least of a function in the cells of a grid, from its values there, which are nan where undefined."""
    bends = np.zeros_like(peaks)
    for axis, count in enumerate(peaks.shape):
        if count > 2:
            aside = [(1, 1) if other == axis else (0, 0) for other in range(peaks.ndim)]
            bends += np.pad(np.abs(np.diff(peaks, 2, axis=axis)), aside, mode="edge")
    least = math.inf
    for cell in product(*(range(max(count - 1, 1)) for count in peaks.shape)):
        corners = tuple(slice(k, k + 2) for k in cell)
        if not np.isfinite(peaks[corners]).any():
            continue
        below = _BENDS * float(np.max(bends[corners]))
        if not math.isfinite(below):
            around = peaks[tuple(slice(max(k - 1, 0), k + 3) for k in cell)]
            below = sum(float(np.nanmax(np.abs(np.diff(around, axis=axis)), initial=0.0)) for axis in range(peaks.ndim))
        least = min(least, float(np.nanmin(peaks[corners])) - below)
    return least


def with_upward_bound(p: Any) -> Any:
    """Return the same problem with every effect that planar falls neglect taken at its most upwards."""
    gate, mu = p.body_radius + p.interface_altitude, p.body_gravitational_parameter
    oblate = sum((k + 1) * abs(getattr(p, f"body_j{k}", 0.0)) for k in (2, 3, 4))
    centrifugal = (p.body_rotation_rate * gate) ** 2 * gate / mu
    missing = oblate + centrifugal + 2 * getattr(p, "body_flattening", 0.0)
    turned = float(largest_plane_turn(p, total_velocity_change(p)))
    along = math.copysign(1.0, p.body_rotation_rate)  # the way that the air goes
    away = max(math.acos(along * math.cos(p.orbit_inclination)) - turned, 0.0)
    changed = {
        "body_gravitational_parameter": mu * max(1 - missing, _LEAST_PULL),
        "orbit_inclination": math.acos(along * math.cos(away)),
    }
    return SimpleNamespace(**{**vars(p), **changed})


def with_mass(p: Any, mass: float) -> Any:
    """Return the parameters with another mass [kg] at the interface.

    Parameters
    ----------
    p
        Parameters [SI].
    mass
        Mass that enters the air [kg].
    """
    name = "separation_mass" if hasattr(p, "separation_mass") else "vehicle_mass"
    return SimpleNamespace(**{**vars(p), name: mass})


def mass_interval(p: Any, count: int = _GRIDS[0][2]) -> Vector:
    """Masses [kg] at the interface.

    Parameters
    ----------
    p
        Parameters [SI].
    count
        Number of masses, where more than one is possible.
    """
    if hasattr(p, "separation_mass"):
        return np.array([p.separation_mass])
    return np.linspace(least_burnout_mass(p), p.vehicle_mass, count)


def angle_interval(p: Any, count: int = _GRIDS[0][0]) -> Vector | None:
    """Angles [rad] at the interface; None where a bound is not known or not below the horizon.

    Parameters
    ----------
    p
        Parameters [SI].
    count
        Number of angles, where more than one is possible.
    """
    stated = getattr(p, "interface_angle", math.nan)
    lower, upper = (getattr(p, f"interface_angle_{side}", stated) for side in ("lower", "upper"))
    leans = getattr(p, "body_flattening", 0.0)
    lower, upper = lower - leans, upper + leans
    return np.linspace(lower, upper, count if lower < upper else 1) if lower <= upper < 0 else None


def speed_interval(p: Any, count: int = _GRIDS[0][1]) -> Vector | None:
    """Speeds [m/s] relative to the body at the interface; None where neither bounds nor the propellant give them.

    Parameters
    ----------
    p
        Parameters [SI].
    count
        Number of speeds, where more than one is possible.
    """
    if hasattr(p, "interface_speed"):
        return np.array([p.interface_speed])
    low, high = (getattr(p, f"interface_speed_{side}", math.nan) for side in ("lower", "upper"))
    if is_something_left(p):
        least, most = (float(speed) for speed in interface_speeds(p, NUMERIC))
        low, high = np.fmax(low, least), np.fmin(high, most)
    return np.linspace(low, high, count) if 0 < low <= high else None


def peak_load(name: str, fallen: Fall, p: Any, air: Air) -> float:
    """Return the greatest value of a limited quantity at the points of a fall, a lower bound of its true peak.

    Parameters
    ----------
    name
        "load" [m/s^2], "heat_rate" [W/m^2] or "dynamic_pressure" [Pa].
    fallen
        Fall whose rows are evaluated.
    p, air
        Parameters [SI], with the mass that falls, and the density of the air against altitude.
    """
    height, speed = fallen.rows[:, 0], fallen.rows[:, 2]
    density, mass = air.density(height, p, NUMERIC), getattr(p, "separation_mass", p.vehicle_mass)
    velocity = (speed, 0.0 * speed, 0.0 * speed)
    if name == "load":
        found = aerodynamics.aerodynamic_load(density, velocity, mass, p, NUMERIC)
    elif name == "heat_rate":
        found = aerodynamics.heat_rate(density, velocity, p, NUMERIC)
    else:
        found = aerodynamics.dynamic_pressure(density, velocity)
    return float(np.max(found))
