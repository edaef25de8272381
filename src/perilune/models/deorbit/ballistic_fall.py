"""Ballistic falls through the air, in a plane: a typical one, and whether any arrives slowly enough.

Relative to the rotating body, with the speed V, the path angle g, the height h and the distance r,

    h' = V sin g,   V' = -drag - mu/r^2 sin g,   g' = ((V + turning)^2/r - mu/r^2) cos g / V

*Whether any arrives slowly enough* is flown from the angles and speeds that there can be at the interface, where these
are steep enough to lead down at once, by the lightest vehicle that a burn leaves. It is also flown backwards, from the
site, where the vehicle is as slow as a parachute bears, at each angle. Back in time the air makes it faster, or gravity
makes it slower until it climbs and turns, below the interface, from where it would have had to be thrown. If it does so
from every angle, no entry ends there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from perilune.core import NUMERIC, Matrix
from perilune.models.physics.aerodynamics import drag_acceleration, heat_rate
from perilune.models.physics.atmosphere import Air

POINTS = 81  # of a phase's picture
_STEEP = math.radians(-2.0)  # a path angle at the interface of no statement
_FLATTEST, _STEEPEST = math.radians(-0.2), math.radians(-89.0)
_LONGEST = 16_000.0  # s, some three turns
_ANGLES = np.radians(np.linspace(-2.0, -90.0, 23))
_SHARES = (1.05, 0.8, 0.5)  # of a speed; the first with some to spare for what a plane leaves out
_FLOATING = 30.0  # m/s, of a steady fall
_STILL, _SLOWEST, _FASTEST = 5.0, 100.0, 2e4  # m/s
_SURELY_DOWN = math.radians(-1.0)  # a path angle from which no vehicle leaves the air again
_ANGLES_TRIED, _SPEEDS_TRIED = 6, 4
_KEPT = 64  # falls
_BEYOND = 10e3  # m
# What a speed of zero, or air that stops like a wall, makes of the equations: such a fall comes nowhere.
_NO_NUMBERS = (ArithmeticError, ValueError)


def typical_angle(p: Any) -> float:
    """A path angle [rad] at the interface within what is stated, below the horizon."""
    angle = getattr(p, "interface_angle", _STEEP)
    lower, upper = getattr(p, "interface_angle_lower", -math.inf), getattr(p, "interface_angle_upper", math.inf)
    return max(min(max(angle, lower), upper, _FLATTEST), _STEEPEST)


def typical_speed(p: Any, radius: float) -> float:
    """Return a speed [m/s] relative to the body at the interface, within the stated range, coming from a radius.

    Parameters
    ----------
    p
        Parameters [SI].
    radius
        Distance from the centre at which the fall from the orbit begins [m].
    """
    gate = p.body_radius + p.interface_altitude
    inertial = math.sqrt(2 * p.body_gravitational_parameter / gate * radius / (radius + gate))
    speed = getattr(p, "interface_speed", inertial - turning_speed(p, gate))
    return min(max(speed, getattr(p, "interface_speed_lower", 0.0)), getattr(p, "interface_speed_upper", math.inf))


def turning_speed(p: Any, distance: float) -> float:
    """Speed [m/s] of the body's turning along the orbit.

    Parameters
    ----------
    p
        Parameters [SI].
    distance
        Distance from the centre [m].
    """
    return p.body_rotation_rate * distance * math.cos(p.orbit_inclination)


@dataclass(frozen=True, kw_only=True)
class Fall:
    """A fall through the air in a plane: its time [s], whether it comes to the site, and rows evenly apart in it.

    A row is height [m], angle swept [rad], speed [m/s] and path angle [rad] relative to the body, heat load [J/m^2].
    """

    time: float
    lands: bool
    rows: Matrix


def _fall_rates(p: Any, air: Air) -> Callable[[float, Any], list[float]]:
    """Rates of a row."""
    heats, mass = hasattr(p, "vehicle_nose_radius"), getattr(p, "separation_mass", p.vehicle_mass)
    floor = (
        entry_end_altitude(p) - _BEYOND
    )  # below it the air is no denser, so that trial steps beyond the end stay numbers

    def slope(_: float, y: Any) -> list[float]:
        height, _, v, gamma, _ = y
        r, density = p.body_radius + height, float(air.density(max(height, floor), p, NUMERIC))
        pull, velocity = p.body_gravitational_parameter / (r * r), (v, 0.0, 0.0)
        slowed = drag_acceleration(density, velocity, mass, p, NUMERIC)
        level = v + turning_speed(p, r)
        return [
            v * math.sin(gamma), v * math.cos(gamma) / r, -slowed - pull * math.sin(gamma),
            (level * level / r - pull) / v * math.cos(gamma),
            heat_rate(density, velocity, p, NUMERIC) if heats else 0.0,
        ]  # fmt: skip

    return slope


def entry_end_altitude(p: Any) -> Any:
    """Return the altitude [m] at which the entry ends: of the site, or of the opening parachute."""
    return getattr(p, "parachute_altitude", p.site_altitude)


def fall(p: Any, air: Air, angle: float | None = None, speed: float | None = None, points: int = POINTS) -> Fall:
    """Return the fall from the interface to the end of the entry; from a typical path angle and speed by default.

    Parameters
    ----------
    p
        Parameters [SI].
    air
        Density of the air against altitude.
    angle, speed
        Path angle, above the horizon [rad], and speed [m/s] at the interface, relative to the body.
    points
        Number of rows, evenly apart in time.
    """
    if angle is None and speed is None:  # which a problem, its rough flight and its preflight ask for, one by one
        return _typical_falls_of(_IdentityKey(air), points).of({name: float(value) for name, value in vars(p).items()})
    return _integrate_fall(p, air, angle, speed, points)


@dataclass(frozen=True, eq=False)
class _IdentityKey:
    """Air as a key, equal only to itself."""

    air: Air

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _IdentityKey) and self.air is other.air

    def __hash__(self) -> int:
        return id(self.air)


class _RecordedParameters:
    """Parameters that record which of them were read."""

    def __init__(self, numbers: Mapping[str, float]) -> None:
        self._numbers, self.names = numbers, set[str]()

    def __getattr__(self, name: str) -> Any:
        self.names.add(name)
        if name not in self._numbers:
            raise AttributeError(name)
        return self._numbers[name]


class _TypicalFalls:
    """Falls through one air at typical values, the last ones kept by the numbers on which they depend."""

    def __init__(self, air: Air, points: int) -> None:
        self.air, self.points = air, points
        self._names, self._known = set[str](), dict[tuple[Any, ...], Fall]()

    def of(self, numbers: Mapping[str, float]) -> Fall:
        """The fall with these parameters."""
        if (found := self._known.get(self._key(numbers))) is not None:
            return found
        read = _RecordedParameters(numbers)
        found = _integrate_fall(read, self.air, None, None, self.points)
        if not read.names <= self._names or len(self._known) >= _KEPT:
            self._names = self._names | read.names
            self._known = {}
        self._known[self._key(numbers)] = found
        return found

    def _key(self, numbers: Mapping[str, float]) -> tuple[Any, ...]:
        return tuple((name, numbers.get(name)) for name in sorted(self._names))


@lru_cache(maxsize=8)
def _typical_falls_of(of: _IdentityKey, points: int) -> _TypicalFalls:
    return _TypicalFalls(of.air, points)


def _integrate_fall(p: Any, air: Air, angle: float | None, speed: float | None, points: int) -> Fall:
    from scipy.integrate import solve_ivp

    radius = float(p.body_radius + p.interface_altitude)
    angle = typical_angle(p) if angle is None else angle
    speed = typical_speed(p, radius + 3e5) if speed is None else speed

    def landed(_: float, y: Any) -> float:
        return y[0] - entry_end_altitude(p)

    landed.terminal = True  # type: ignore[attr-defined]
    start = [p.interface_altitude, 0.0, speed, angle, 0.0]
    floats = terminal_speed(p, air) < _FLOATING  # and its equations are stiff
    try:
        with np.errstate(all="ignore"):
            flown = solve_ivp(
                _fall_rates(p, air),
                (0.0, _LONGEST),
                start,
                method="LSODA" if floats else "RK45",
                rtol=1e-6,
                atol=1e-6,
                events=landed,
                dense_output=True,
            )
    except _NO_NUMBERS:
        rows = np.tile(start, (points, 1))
        rows.flags.writeable = False
        return Fall(time=_LONGEST, lands=False, rows=rows)
    time = float(flown.t[-1])
    rows = flown.sol(np.linspace(0.0, time, points)).T
    rows.flags.writeable = False
    return Fall(time=time, lands=flown.status == 1, rows=rows)


def terminal_speed(p: Any, air: Air, altitude: float | None = None) -> float:
    """Speed [m/s] of a steady vertical fall at an altitude, without bound where there is no air.

    Parameters
    ----------
    p
        Parameters [SI].
    air
        Density of the air against altitude.
    altitude
        Altitude [m]; by default that at which the entry ends.
    """
    altitude = entry_end_altitude(p) if altitude is None else altitude
    radius, mass = p.body_radius + altitude, getattr(p, "separation_mass", p.vehicle_mass)
    slowed = drag_acceleration(air.density(altitude, p, NUMERIC), (1.0, 0.0, 0.0), mass, p, NUMERIC)
    pull = p.body_gravitational_parameter / (radius * radius)
    return math.sqrt(pull / float(slowed)) if slowed > 0 else math.inf


def slowest_arrival(p: Any, air: Air, steepest: float, speeds: tuple[float, float]) -> float:
    """Least speed [m/s] at which falls arrive, of path angles that are stated and of speeds at the interface.

    Where no angle is stated that surely leads down at once there may be any speed, and so it is 0.

    Parameters
    ----------
    p, air
        The return and its air.
    steepest
        Path angle [rad], negative, below which none comes.
    speeds
        Least and greatest [m/s].
    """
    flattest = getattr(p, "interface_angle", getattr(p, "interface_angle_upper", 0.0))
    if flattest > _SURELY_DOWN:
        return 0.0
    steepest = getattr(p, "interface_angle", max(getattr(p, "interface_angle_lower", -math.inf), steepest))
    angles = np.linspace(flattest, min(steepest, flattest), 1 if steepest >= flattest else _ANGLES_TRIED)
    least = max(speeds[0], getattr(p, "interface_speed", getattr(p, "interface_speed_lower", 0.0)), _SLOWEST)
    most = min(speeds[1], getattr(p, "interface_speed", getattr(p, "interface_speed_upper", math.inf)), _FASTEST)
    tried = np.linspace(least, max(most, least), _SPEEDS_TRIED)
    falls = [fall(p, air, float(angle), float(speed)) for angle in angles for speed in tried]
    return min((float(one.rows[-1, 2]) for one in falls if one.lands), default=math.inf)


def all_falls_too_fast(p: Any, air: Air) -> bool:
    """Return True if no fall without lift from the interface arrives as slowly as ``site_speed_upper``.

    Parameters
    ----------
    p
        Parameters [SI].
    air
        Density of the air against altitude.
    """
    speeds = [share * p.site_speed_upper for share in _SHARES]
    return all(_turned_below_interface(p, air, speed, float(angle)) for speed in speeds for angle in _ANGLES)


def _turned_below_interface(p: Any, air: Air, speed: float, angle: float) -> bool:
    """Return True if a fall with this speed and path angle at its end has turned below the interface."""
    from scipy.integrate import solve_ivp

    forward = _fall_rates(p, air)

    def turns(_: float, y: Any) -> float:
        return min(-y[3] - 1e-3, y[2] - _STILL)

    def comes(_: float, y: Any) -> float:
        return min(p.interface_altitude - y[0], _FASTEST - y[2])

    turns.terminal = comes.terminal = True  # type: ignore[attr-defined]
    start = [entry_end_altitude(p), 0.0, speed, angle, 0.0]
    try:
        with np.errstate(all="ignore"):
            flown = solve_ivp(
                lambda t, y: [-rate for rate in forward(t, y)], (0.0, _LONGEST), start, rtol=1e-4, atol=1e-4,
                events=(turns, comes),
            )  # fmt: skip
    except _NO_NUMBERS:
        return False
    return bool(len(flown.t_events[0])) and not len(flown.t_events[1])
