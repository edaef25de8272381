"""Passes of an orbit over a site, relative to a descent to it, and how far the propellant turns the orbit.

A typical descent lasts T and sweeps an angle F along the orbit, from ignition to the site's altitude. It ends abeam of
the site where the argument of latitude of the vehicle at ignition, and F, is that of the site's foot in the plane of
the orbit T later; the body turns below the plane meanwhile. The angle d of the site from the plane is what must be
turned away: by a plane that is turned by a at ignition,

    sin d = sin a sin F

To do so in the burn of the descent takes, from the speed V on the orbit to V - D in the other plane, the velocity
change sqrt(V^2 + (V - D)^2 - 2 V (V - D) cos a). A lift L/D, banked by 45 degrees, reaches an angle pi^2/48 (L/D)^2 to
the side (Eggers, Allen, Neice, NACA TN 4046, 1957), which is taken off d.

*What is out of reach for certain.* Thrust across the plane turns it by dV/w, w the speed along the horizon. That is
least at the apogee, V_a, which may be raised first, to turn for less there (a bi-elliptic turn). Of an ellipse with the
eccentricity e thrust in the plane at the true anomaly f, c = cos f, changes V_a by

    |dV_a/dV| <= sqrt(1 - c^2 + ((1 + 2 c + e c^2)/(1 + e c))^2) <= 3,

the most at the perigee of an ellipse that is nearly a circle. With this rate wherever it thrusts, and w = V_a, it would
be turned the furthest, as a function of dV and V_a: by A with (dA/d dV)^2 = 9 (dA/dV_a)^2 + 1/V_a^2, and so by

    A = asin(3 x)/3,     x = dV/V_a <= 1/3,

and by any angle beyond. Oblateness turns the plane of another orbit otherwise: by 7 x of its secular rate at another
size, and by x at another inclination. Along the orbit a velocity change moves the vehicle by no more than
(dV/V)(3 n t + 4) (Clohessy and Wiltshire's equations), and air holds it back. Where the site is further from the plane
whenever the vehicle can be abeam of it, no flight without lift comes there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from perilune.core import (
    NUMERIC,
    RenamedAttribute,
)
from perilune.models.deorbit.initial_guess import estimate_descent
from perilune.models.deorbit.orbit import plane_axes, radius_and_speeds
from perilune.models.deorbit.records import (
    LONGEST_COAST,
    engine_exhaust_speed,
    is_something_left,
    least_mass_left,
)
from perilune.models.deorbit.secular_drift import Drift
from perilune.models.physics import ellipsoid
from perilune.models.physics.delta_v_bounds import greatest_thrust
from perilune.models.physics.rotating_frame import cross_product, scalar_product

_STEP = 30.0  # s, between looks at where the vehicle and the site are
_AROUND = 24  # places on an ellipse from which the way down is looked at
_NOTHING = 1e-9  # of full thrust: a burn down to nothing may wait
_LEFT = 0.05  # of the mass, of which a vehicle that says no more of it could burn all else
_LONGEST_ENTRY = 3600.0  # s
_SURELY = 1.2  # times what linear equations say of a path that is bent
_APART, _MOST_APART = 8.0, 2.0  # of secular rates: times dV/V, but not more than lost and doubled
_ROUGHLY = 0.1  # rad, of oblateness and what the air does


@dataclass(frozen=True, kw_only=True)
class Pass:
    """Pass of the orbit over the site; SI units and radians.

    Parameters
    ----------
    ignition, landing
        Times after t = 0.
    going
        Ascending or descending where it comes to the site.
    out_of_plane_angle
        Angle of the site from the plane of the orbit, positive to the left of the way.
    plane_change, velocity_change
        Angle by which the plane is turned at ignition, and what that takes together with the way down; infinite where
        no turn there leads to the site.
    """

    ignition: float
    landing: float
    going: str
    out_of_plane_angle: float
    plane_change: float
    velocity_change: float
    away: ClassVar[RenamedAttribute] = RenamedAttribute("out_of_plane_angle")
    turn: ClassVar[RenamedAttribute] = RenamedAttribute("plane_change")


def site_relative_to_plane(p: Any, node: Any) -> tuple[Any, Any]:
    """Locate the site relative to a plane of this node [rad]: argument of latitude of its foot, angle left [rad].

    Parameters
    ----------
    p
        Parameters [SI].
    node
        Longitude of the ascending node [rad], a number or an array of any shape.
    """
    to_node, beyond = plane_axes(0.0, node, p, NUMERIC)
    site = ellipsoid.geodetic_position(p.site_longitude, p.site_latitude, p.site_altitude, p, NUMERIC)
    distance = math.sqrt(scalar_product(site, site))
    left = scalar_product(site, cross_product(to_node, beyond)) / distance
    return np.arctan2(scalar_product(site, beyond), scalar_product(site, to_node)), np.arcsin(np.clip(left, -1.0, 1.0))


def find_passes(p: Any, orbit: Drift, entry: tuple[float, float], *, drifts: bool, until: float) -> list[Pass]:
    """Return all passes whose ignition is not later than a time.

    Parameters
    ----------
    p
        Given parameters of the return.
    orbit
        Where the vehicle is.
    entry
        Time [s] from the interface to the site, and angle swept [rad].
    drifts
        Whether the vehicle coasts to the interface after its burn.
    until
        Time [s].
    """
    count = 1 if hasattr(p, "orbit_radius") else _AROUND
    around = np.linspace(-math.pi, math.pi, count + 1)
    downs = [estimate_descent(p, float(angle), drifts=drifts) for angle in around[:-1]]
    rows = np.array([[down.whole + entry[0], down.swept + entry[1], down.velocity_change] for down in downs])
    rows = np.vstack([rows, rows[:1]])

    def descent(time: Any) -> tuple[Any, ...]:
        angle, _ = orbit.at(time)
        lasts, sweeps, change = (np.interp(_wrap_to_pi(angle), around, row) for row in rows.T)
        _, node = orbit.at(time + lasts)
        foot, left = site_relative_to_plane(p, node)
        return _wrap_to_pi(angle + sweeps - foot), lasts, sweeps, change, left, angle, foot

    times = np.arange(0.0, until + _STEP, _STEP)
    past = descent(times)[0]
    before = np.flatnonzero((past[:-1] < 0) & (past[1:] >= 0) & (past[1:] - past[:-1] < 1))
    ignition = times[before] - _STEP * past[before] / (past[before + 1] - past[before])
    ignition = ignition[ignition <= until]
    _, lasts, sweeps, change, left, angle, foot = descent(ignition)
    missed = np.maximum(np.abs(left) - crossrange_angle(p), 0.0)
    with np.errstate(divide="ignore"):
        sine = np.sin(missed) / np.abs(np.sin(sweeps))
    turn = np.where(sine <= 1, np.arcsin(np.minimum(sine, 1.0)), math.inf)
    speed = np.array([math.hypot(*(float(v) for v in radius_and_speeds(a, p, NUMERIC)[1:])) for a in angle])
    slower, cosine = speed - change, np.cos(np.where(sine <= 1, turn, 0.0))
    needs = np.sqrt(speed * speed + slower * slower - 2 * speed * slower * cosine)
    return [
        Pass(
            ignition=float(ignition[k]), landing=float(ignition[k] + lasts[k]),
            going="ascending" if math.cos(foot[k]) > 0 else "descending",
            out_of_plane_angle=float(left[k]), plane_change=float(turn[k]),
            velocity_change=float(needs[k]) if sine[k] <= 1 else math.inf,
        )
        for k in range(len(ignition))
    ]  # fmt: skip


def crossrange_angle(p: Any) -> float:
    """Angle [rad] that lift reaches to the side in the air."""
    return math.pi**2 / 48 * getattr(p, "vehicle_lift_to_drag", 0.0) ** 2


def least_burnout_mass(p: Any) -> Any:
    """Mass [kg] below which the burn leaves none."""
    return least_mass_left(p) if is_something_left(p) else _LEFT * p.vehicle_mass


def largest_plane_turn(p: Any, change: Any, xp: Any = NUMERIC) -> Any:
    """Angle [rad] by which a velocity change [m/s] turns the plane of the orbit at most, its apogee raised before.

    Parameters
    ----------
    p
        Parameters [SI].
    change
        Velocity change [m/s], a number or an array of any shape.
    xp
        Maths namespace.
    """
    share = change / _apogee_speed(p, xp)
    return xp.where(3 * share < 1, xp.asin(xp.fmin(3 * share, 1.0)) / 3, math.pi)


def _apogee_speed(p: Any, xp: Any) -> Any:
    """Speed [m/s] at the apogee."""
    low, high = apsis_radii(p)
    return xp.sqrt(2 * p.body_gravitational_parameter * low / (high * (low + high)))


def nearest_approach_to_plane(
    p: Any, orbit: Drift, entry: tuple[float, float], landing: float | None = None, glide: tuple[float, float] = (0, 0)
) -> tuple[float, float]:
    """Return the least angle from site to plane while a flight from t = 0 can last, and the turn possible by then.

    Both [rad], at the time of nearest approach among those at which the site can be reached; if there are none, at the
    time at which the least turn is missing; less than half a turn from a landing [s] where that is given.

    Parameters
    ----------
    p
        Parameters [SI].
    orbit
        Drift of the orbit from t = 0.
    entry
        Typical duration of the entry [s], and the angle that it sweeps [rad].
    landing
        Time from t = 0 [s]; None for any.
    glide
        Longest duration of an entry with lift [s], and the angle [rad] by which it stays behind the orbit at most.
    """
    rate = greatest_thrust(p) / engine_exhaust_speed(p)
    burn = (p.vehicle_mass - least_burnout_mass(p)) / rate
    longest = getattr(p, "orbit_longest_coast", 0.0) + getattr(p, "transition_longest_coast", 0.0)
    least = max(getattr(p, "throttle_lower", 1.0), _NOTHING) / getattr(p, "throttle_upper", 1.0)  # of its thrust
    time = np.arange(0.0, longest + min(burn / least, LONGEST_COAST) + max(_LONGEST_ENTRY, glide[0]), 0.1 * _STEP)
    if landing is not None:
        time = time[np.abs(time - landing) * orbit.turn_rate < math.pi]
    angle, node = orbit.at(time)
    foot, left = site_relative_to_plane(p, node)
    spent = np.minimum(time, burn) * rate  # what may be burnt by then
    change = engine_exhaust_speed(p) * np.log(p.vehicle_mass / (p.vehicle_mass - spent))
    low, high = apsis_radii(p)
    slow = _apogee_speed(p, NUMERIC)
    fast = slow * high / low
    oblate = 1.5 * abs(p.body_j2) * (p.body_radius / low) ** 2 * orbit.turn_rate * time
    moved = _SURELY * change / slow * (3 * orbit.turn_rate * time + 4) + _ROUGHLY + 2 * orbit.eccentricity
    behind = max(2 * max(fast / low * entry[0] - entry[1], 0.0), glide[1])
    ahead = _wrap_to_pi(angle - foot - behind / 2)  # of the site, by as much as half of what the air may hold back
    away = np.abs(left)
    turned = largest_plane_turn(p, change) + np.minimum(_APART * change / slow, _MOST_APART) * oblate
    turned = np.minimum(turned, math.pi)
    short = away - turned + np.where(np.abs(ahead) <= moved + behind / 2, 0.0, 2 * math.pi)
    k = int(np.argmin(np.where(short <= 0, away - math.pi, short)))  # what is away is no more than half a turn
    return float(away[k]), float(turned[k])


def apsis_radii(p: Any) -> tuple[Any, Any]:
    """Distances [m] of perigee and apogee."""
    if hasattr(p, "orbit_radius"):
        return p.orbit_radius, p.orbit_radius
    return p.body_radius + p.orbit_perigee_altitude, p.body_radius + p.orbit_apogee_altitude


def _wrap_to_pi(angle: Any) -> Any:
    """Return the same direction between -pi and pi."""
    return angle - 2 * math.pi * np.round(angle / (2 * math.pi))
