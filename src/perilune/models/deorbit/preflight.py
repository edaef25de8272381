"""What physics says of a return before it is solved.

*Down at all.* From a circular or elliptic orbit the least velocity change that lowers the flight to the radius r_a is
that of an impulse at the apogee r_2, against the velocity there, to an ellipse with its perigee at r_a:

    dV = sqrt(2 mu/r_2) (sqrt(r_1/(r_1 + r_2)) - sqrt(r_a/(r_a + r_2))),   r_1 the perigee of the orbit

No finite burn does better, and drag begins at the interface only. Oblateness moves the height of a flight by some
kilometres within a turn: `_SLACK` stands for that.

*Sideways.* All propellant at right angles to the orbit's plane turns it by no more than dV/V_a, V_a the least speed of
the orbit. Where a site stays further than that from the plane as long as the flight can last, it is out of reach of a
ballistic entry; lift may reach further, and is only warned.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from perilune.models.atmosphere import Air
from perilune.models.deorbit.orbit import plane
from perilune.models.deorbit.records import exhaust_speed
from perilune.models.deorbit.times import fall
from perilune.models.rotating import cross, dot, local_axes
from perilune.problem.preflight import Finding
from perilune.words.maths import NUMERIC
from perilune.words.types import Physics

_SLACK = 25e3  # m
_TIMES = 2001  # at which the plane and the site are looked at
_DAY = 86400.0  # s


def compare_return(p: Any, m: Any, *, angles: Physics, air: Air | None) -> tuple[Finding, ...]:
    """Every comparison of a return, for `Problem.preflight`."""
    low, high = _extremes(p)
    found = [_above_interface(p, low)]
    if hasattr(p, "vehicle_dry_mass"):
        found.append(_comes_down(p, m, low, high))
    if air is not None and _of_one(p, low):
        found += [*_slow_enough(p, air), *(_in_plane(p, angles, low, high) if hasattr(p, "site_longitude") else ())]
    return tuple(found)


def _extremes(p: Any) -> tuple[Any, Any]:
    """Distances [m] of perigee and apogee."""
    if hasattr(p, "orbit_radius"):
        return p.orbit_radius, p.orbit_radius
    return p.body_radius + p.orbit_perigee_altitude, p.body_radius + p.orbit_apogee_altitude


def _above_interface(p: Any, low: Any) -> Finding:
    return Finding(
        name="perigee above the interface",
        value=(low - p.body_radius - p.interface_altitude) / 1e3,
        limit=0.0,
        at_least=True,
        unit="km",
        binding=True,
        meaning="the orbit comes down into the air by itself, and there is no air above the interface here",
        advice="a higher orbit (its radius is from the centre of the body), or a lower interface.altitude",
    )


def _least_change(p: Any, m: Any, low: Any, high: Any, gate: Any) -> Any:
    """Least velocity change [m/s] from the orbit to a perigee at a distance."""
    left = m.sqrt(low / (low + high)) - m.sqrt(gate / (gate + high))
    return m.sqrt(2 * p.body_gravitational_parameter / high) * m.fmax(left, 0.0)


def _change(p: Any, m: Any) -> Any:
    """Velocity change [m/s] of all propellant."""
    return exhaust_speed(p) * m.log(p.vehicle_mass / p.vehicle_dry_mass)


def _comes_down(p: Any, m: Any, low: Any, high: Any) -> Finding:
    return Finding(
        name="velocity change that comes down to the interface",
        value=_least_change(p, m, low, high, p.body_radius + p.interface_altitude + _SLACK),
        limit=_change(p, m),
        at_least=False,
        unit="m/s",
        binding=True,
        meaning="the propellant cannot bring the vehicle down to the interface",
        advice="more propellant (a lower vehicle.dry_mass), a lower orbit, or a higher exhaust velocity",
    )


def _of_one(p: Any, low: Any) -> bool:
    """Whether it is one problem, all of it known: of many at once flights are not looked at."""
    numbers = [*vars(p).values(), low]
    return not any(np.ndim(number) for number in numbers) and math.isfinite(sum(map(float, numbers)))


def _slow_enough(p: Any, air: Air) -> tuple[Finding, ...]:
    """How fast a fall without lift arrives that begins at a typical angle; no proof of others, and so only said."""
    return (
        Finding(
            name="landing speed of a fall without lift",
            value=float(fall(p, air).rows[-1, 2]),
            limit=p.site_speed_upper,
            at_least=False,
            unit="m/s",
            binding=False,
            meaning="the vehicle may arrive faster than site.speed_upper, which a parachute can take",
            advice="more drag area, a higher site.altitude, or a greater site.speed_upper",
        ),
    )


def _in_plane(p: Any, angles: Physics, low: Any, high: Any) -> tuple[Finding, ...]:
    """How far the site stays from the plane of the orbit while the flight can last, against what propellant turns."""
    angle, node = (float(v) for v in angles(p, NUMERIC))
    rate = p.vehicle_thrust / exhaust_speed(p)
    burn = (p.vehicle_mass - getattr(p, "vehicle_dry_mass", 0.05 * p.vehicle_mass)) / rate
    longest = getattr(p, "orbit_longest_coast", 0.0) + getattr(p, "transition_longest_coast", 0.0)
    time = np.linspace(0.0, longest + min(burn, _DAY) + 3600.0, _TIMES)
    away = np.abs(_off_plane(p, angle, node, time))
    spent = np.minimum(time, burn) * rate  # what may be burnt by then
    slow = math.sqrt(2 * p.body_gravitational_parameter * low / (high * (low + high)))
    turned = exhaust_speed(p) * np.log(p.vehicle_mass / (p.vehicle_mass - spent)) / slow
    k = int(np.argmin(away - turned))
    lifts = hasattr(p, "vehicle_lift_to_drag")
    later = np.linspace(0.0, 3 * _DAY, 3 * 1441)
    good = later[np.abs(_off_plane(p, angle, node, later)) < math.radians(0.5)]
    passes = (
        f"the site is in the plane {good[0] / 3600:.1f} h after t = 0"
        if len(good)
        else ("the plane of the orbit never comes over its latitude: a higher orbit.inclination")
    )
    return (
        Finding(
            name="site out of the plane of the orbit", value=math.degrees(float(away[k])),
            limit=math.degrees(float(turned[k])) + 0.5, at_least=False, unit="deg", binding=not lifts,
            meaning=f"the site stays {float(away[k]) * p.body_radius / 1e3:.0f} km or more"
            " out of the plane of the orbit, which is further than the propellant can turn it",
            advice=f"{passes}; or another site",
        ),
    )  # fmt: skip


def _off_plane(p: Any, angle: float, node: float, time: Any) -> Any:
    """Angle [rad] of the site from the plane of the orbit, at times [s]."""
    up, ahead = plane(angle, node, p, NUMERIC)
    site, _, _ = local_axes(p.site_longitude + p.body_rotation_rate * time, p.site_latitude, NUMERIC)
    return np.arcsin(np.clip(dot(site, cross(up, ahead)), -1.0, 1.0))
