"""How long the phases of a return last roughly, and a rough picture of it: what methods without a guess start from.

The picture is the orbit itself, bent down: the distance falls evenly from the orbit to the interface and to the site,
while the vehicle goes on around the body. It flies nothing; `perilune.direct.first_guess` makes a flight of it.

The times are those of the impulsive deorbit from a circular orbit of radius r_o to the radius r_a at the angle gamma
(Milstead 1966, Journal of the Astronautical Sciences XIII(4)), with s = r_o/r_a:

    dV = sqrt(mu/r_o) (1 - sqrt(2 (s - 1)/((s/cos gamma)^2 - 1)))
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.models.deorbit.orbit import plane, shape, state
from perilune.models.deorbit.records import exhaust_speed
from perilune.models.rotating import dot, local_axes
from perilune.words.maths import NUMERIC
from perilune.words.types import Matrix, Physics

_STEEP = math.radians(-2.0)  # a path angle at the interface of no statement
_POINTS = 41  # of a phase's picture


@dataclass(frozen=True, kw_only=True)
class Deorbit:
    """An impulsive deorbit: velocity change [m/s], time to the interface [s], angle swept until there [rad]."""

    velocity_change: float
    time: float
    swept: float


def impulsive(radius: float, interface: float, angle: float, mu: float) -> Deorbit:
    """Single impulse against the velocity on a circular orbit, to a radius under an (inertial) path angle [rad].

    Milstead's closed form; the rest is Kepler's ellipse from its apogee.
    """
    ratio = radius / interface
    left = math.sqrt(2 * (ratio - 1) / ((ratio / math.cos(angle)) ** 2 - 1))
    circular = math.sqrt(mu / radius)
    semi = 1 / (2 / radius - (left * circular) ** 2 / mu)
    eccentricity = radius / semi - 1
    # Eccentric anomaly from the perigee; the way down begins at pi and ends before 2 pi.
    half = math.acos(max(-1.0, min(1.0, (1 - interface / semi) / eccentricity)))
    there = 2 * math.pi - half
    time = math.sqrt(semi**3 / mu) * ((there - eccentricity * math.sin(there)) - math.pi)
    swept = 2 * math.atan(math.sqrt((1 + eccentricity) / (1 - eccentricity)) * math.tan(there / 2)) + math.pi
    return Deorbit(velocity_change=(1 - left) * circular, time=time, swept=swept)


def typical_angle(p: Any) -> float:
    """A path angle [rad] at the interface within what is stated."""
    if hasattr(p, "interface_angle"):
        return p.interface_angle
    lower, upper = getattr(p, "interface_angle_lower", -math.inf), getattr(p, "interface_angle_upper", math.inf)
    return min(max(_STEEP, lower), upper)


def typical_times(p: Any, angles: Physics, *, coasts: bool, drifts: bool, air: bool) -> dict[str, float]:
    """Rough lengths [s] of the phases, by the names of their durations."""
    angle, node = angles(p, NUMERIC)
    radius, interface = float(shape(angle, p, NUMERIC)[0]), p.body_radius + p.interface_altitude
    steep = -math.fabs(typical_angle(p)) or _STEEP
    down = impulsive(max(radius, 1.0001 * interface), interface, steep, p.body_gravitational_parameter)
    rate = p.vehicle_thrust / exhaust_speed(p)
    burn = p.vehicle_mass / rate * (1 - math.exp(-down.velocity_change / exhaust_speed(p)))
    whole = down.time + 0.5 * burn
    if not drifts or burn > 0.8 * whole:
        burn = 0.8 * whole if drifts else whole
    height = p.interface_altitude - getattr(p, "site_altitude", 0.0)
    fall = 100.0 + 1.5 * height / (math.sqrt(p.body_gravitational_parameter / interface) * math.sin(-steep))
    times = {"burn_time": burn, "drift_time": whole - burn, "entry_time": min(fall, 900.0), "coast_time": 0.0}
    if hasattr(p, "site_longitude"):
        _to_the_site(p, times, angle, node, whole + (0.5 * times["entry_time"] if air else 0.0), coasts=coasts)
    if coasts and not times["coast_time"]:
        times["coast_time"] = 0.3 * p.orbit_longest_coast
    kept = {"burn_time": True, "drift_time": drifts, "entry_time": air, "coast_time": coasts}
    return {name: value for name, value in times.items() if kept[name]}


def _to_the_site(p: Any, times: dict[str, float], angle: float, node: float, least: float, *, coasts: bool) -> None:
    """Lengthen the burn, or the coast before it, until the orbit is over the site, which the body carries along."""
    mean = math.sqrt(p.body_gravitational_parameter / shape(angle, p, NUMERIC)[0] ** 3)
    up, ahead = plane(angle, node, p, NUMERIC)
    time = least
    for _ in range(20):
        site, _, _ = local_axes(p.site_longitude + p.body_rotation_rate * time, p.site_latitude, NUMERIC)
        away = math.atan2(dot(site, ahead), dot(site, up)) % (2 * math.pi)
        turns = max(0, math.ceil((least * mean - away) / (2 * math.pi) - 0.1))
        time = (away + 2 * math.pi * turns) / mean
    more = max(time - least, 0.0)
    if coasts:
        times["coast_time"] = min(more, p.orbit_longest_coast)
    else:
        times["drift_time" if times["drift_time"] > 0 else "burn_time"] += more


def picture(p: Any, angles: Physics, names: tuple[str, ...], heat: bool) -> list[Matrix]:
    """States (points, states) [SI] of each phase, given the durations in `p`."""
    angle, node = (float(v) for v in angles(p, NUMERIC))
    radius = float(shape(angle, p, NUMERIC)[0])
    mean = math.sqrt(p.body_gravitational_parameter / radius**3)
    gate = p.body_radius + p.interface_altitude
    down = sum(getattr(p, f"{name}_time") for name in names if name in ("burn", "drift"))
    found, time, mass, turned = list[Matrix](), 0.0, p.vehicle_mass, 0.0
    rate, since = p.vehicle_thrust / exhaust_speed(p), 0.0
    for name in names:
        length = getattr(p, f"{name}_time")
        rows = []
        for share in np.linspace(0.0, 1.0, _POINTS):
            at = share * length
            if name == "entry":
                low = p.body_radius + getattr(p, "site_altitude", 0.0)
                distance, pace = gate + share * (low - gate), 1 - 0.95 * share**2
                swept = mean * length * (share - 0.95 * share**3 / 3)
            else:
                part = (since + at) / down if name in ("burn", "drift") else 0.0
                distance, pace, swept = radius + part * (gate - radius), 1.0, mean * at
            rows.append(_row(p, angle + turned + swept, node - p.body_rotation_rate * (time + at), distance, pace))
            rows[-1].append(mass - (rate * at if name == "burn" else 0.0))
            if name == "entry" and heat:
                rows[-1].append(1e7 * share)
        turned, time = turned + swept, time + length
        since += length if name in ("burn", "drift") else 0.0
        mass -= rate * length if name == "burn" else 0.0
        found.append(np.array(rows))
    return found


def _row(p: Any, angle: float, node: float, distance: float, pace: float) -> list[float]:
    """Position and velocity beside the body over a place of the orbit, at another distance and a share of its speed."""
    circle = SimpleNamespace(**{k: v for k, v in vars(p).items() if not k.startswith("orbit_p")})
    circle.orbit_radius = distance
    position, velocity = state(angle, node, circle, NUMERIC)
    return [*map(float, position), *(pace * float(v) for v in velocity)]
