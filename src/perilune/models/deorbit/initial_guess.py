"""Rough durations of the phases of a return and a rough trajectory: the start of methods without a guess.

The picture is a flight in the plane of the orbit, about a round body: coast, thrust straight against the velocity for
as long as the impulsive deorbit needs, coast down to the interface, and a fall through the air without lift. Where that
does not come down to the interface in the time that there is (a site is further, or the engine burns all the way), the
picture above the air is the orbit itself, bent down evenly. `perilune.direct.first_guess` makes a flight of it.

The impulsive deorbit leads from a circular orbit of radius r_o to the radius r_a at the angle gamma (Milstead 1966,
Journal of the Astronautical Sciences XIII(4)); with s = r_o/r_a

    dV = sqrt(mu/r_o) (1 - sqrt(2 (s - 1)/((s/cos gamma)^2 - 1)))
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.core import NUMERIC, Matrix, Physics, Vector
from perilune.models.deorbit import parachute
from perilune.models.deorbit.ballistic_fall import POINTS, fall, turning_speed, typical_angle
from perilune.models.deorbit.orbit import AXIS, plane_axes, radius_and_speeds
from perilune.models.deorbit.records import (
    LONGEST_COAST,
    engine_exhaust_speed,
    throttled,
    total_velocity_change,
)
from perilune.models.physics.atmosphere import Air
from perilune.models.physics.delta_v_bounds import greatest_thrust
from perilune.models.physics.rotating_frame import combine, cross_product, local_axes, scalar_product

_NEAR = 0.01  # of the distance: an end of the flight in the plane that is an end at the interface
_SHORTER = 0.1  # of a turn: by so much the way to a site may be shorter than the typical one
_LONG_BURN = 0.3  # rad, of the orbit: no longer is a burn like an impulse
_BURNS, _LONGER, _ALIKE = 8, 1.3, 0.03  # lengths that are tried, from one to the next, and an angle that is met
_LEAST_DRIFT, _WAITS = 0.04, 0.05  # of the way down; of a picture, for so long it may stay at its end
_EASIER = 0.05  # so many radians to the side are as hard as one along the way
_MOST_DRIFT = 0.9  # of the longest: what a later pass takes further is burnt
_TURNS = 50  # of a long coast, the passes after which are looked at


@dataclass(frozen=True, kw_only=True)
class Deorbit:
    """An impulsive deorbit: velocity change [m/s], time to the interface [s], angle swept until there [rad]."""

    velocity_change: float
    time: float
    swept: float


def impulsive_deorbit(radius: float, interface: float, angle: float, mu: float) -> Deorbit:
    """Single impulse against the velocity on a circular orbit, to a radius under an (inertial) path angle [rad].

    Milstead's closed form; the rest is Kepler's ellipse from its apogee.

    Parameters
    ----------
    radius, interface
        Radii of the orbit and of the interface [m], the latter the smaller.
    angle
        Inertial path angle at the interface [rad].
    mu
        Gravitational parameter of the body [m^3/s^2].
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


def integrate_planar_descent(p: Any, angle: float, coast: float, burn: float, drift: float) -> tuple[Matrix, Any]:
    """Flight in the plane of the orbit to the interface, thrust against the velocity.

    Parameters
    ----------
    p
        Parameters [SI].
    angle
        Argument of latitude at t = 0 [rad].
    coast, burn, drift
        Durations of the fall before the burn, of the burn and of the fall after it [s].

    Returns
    -------
    rows, function
        The last row, and the rows at times [s]: distance [m], angle swept [rad], speeds upwards and ahead [m/s].
    """
    from scipy.integrate import solve_ivp

    mu, exhaust, gate = p.body_gravitational_parameter, engine_exhaust_speed(p), p.body_radius + p.interface_altitude
    full = greatest_thrust(p)
    distance, rise, ahead = (float(v) for v in radius_and_speeds(angle, p, NUMERIC))
    row, begun, pieces = np.array([distance, 0.0, rise, ahead]), 0.0, []

    def slope(t: float, y: Any, burns: bool) -> list[float]:
        r, _, up, on = y
        push = full / (p.vehicle_mass - full / exhaust * t) if burns else 0.0
        speed = math.hypot(up, on)
        return [up, on / r, on * on / r - mu / (r * r) - push * up / speed, -up * on / r - push * on / speed]

    def low(_: float, y: Any, burns: bool) -> float:
        return y[0] - gate if y[2] < 0 else 1.0

    low.terminal = True  # type: ignore[attr-defined]
    for length, burns in ((coast, False), (burn, True), (drift, False)):
        if length > 0 and (not pieces or pieces[-1].status == 0):
            flown = solve_ivp(
                slope, (0.0, length), row, rtol=1e-8, atol=1e-3, args=(burns,), events=low, dense_output=True
            )
            pieces.append(flown)
            row, begun = flown.y[:, -1], begun + float(flown.t[-1])
    ends = np.cumsum([piece.t[-1] for piece in pieces])

    def at(t: float) -> Vector:
        k = min(int(np.searchsorted(ends, t)), len(pieces) - 1)
        return pieces[k].sol(min(t - (ends[k] - pieces[k].t[-1]), pieces[k].t[-1]))

    return np.array([begun, *row]), at


@dataclass(frozen=True, kw_only=True)
class DescentEstimate:
    """A way from the orbit down to the interface: velocity change [m/s], burn and all of it [s], angle swept [rad]."""

    velocity_change: float
    burn: float
    whole: float
    swept: float


def mean_rate(p: Any, angle: float) -> float:
    """Rate [rad/s] of a circular orbit through the place at an argument of latitude.

    Parameters
    ----------
    p
        Parameters [SI].
    angle
        Argument of latitude [rad].
    """
    return math.sqrt(p.body_gravitational_parameter / float(radius_and_speeds(angle, p, NUMERIC)[0]) ** 3)


def estimate_descent(p: Any, angle: float, *, drifts: bool, coast: float = 0.0) -> DescentEstimate:
    """A typical way down that begins with a coast, which is not counted, at an argument of latitude [rad].

    Parameters
    ----------
    p
        Parameters [SI].
    angle
        Argument of latitude at which the coast begins [rad].
    drifts
        Let a fall without thrust follow the burn; the burn lasts to the interface otherwise.
    coast
        Duration of the coast [s].
    """
    radius, gate = float(radius_and_speeds(angle, p, NUMERIC)[0]), p.body_radius + p.interface_altitude
    down = impulsive_deorbit(max(radius, 1.0001 * gate), gate, typical_angle(p), p.body_gravitational_parameter)
    mean, change = mean_rate(p, angle), down.velocity_change
    burn = _burn_time_of(p, change)
    whole = down.time + 0.5 * burn
    if not drifts:
        return DescentEstimate(velocity_change=change, burn=whole, whole=whole, swept=mean * whole)
    burn = min(burn, 0.8 * whole)
    if whole < LONGEST_COAST:
        burn, last = _find_burn_length(p, angle, coast, burn, whole)
        if last is not None:
            whole, swept = float(last[0]) - coast, float(last[2]) - mean * coast
            return DescentEstimate(velocity_change=change, burn=burn, whole=whole, swept=swept)
    return DescentEstimate(velocity_change=change, burn=burn, whole=whole, swept=mean * whole)


def _burn_time_of(p: Any, change: float) -> float:
    """Return the burn time [s] of a velocity change [m/s]."""
    exhaust = engine_exhaust_speed(p)
    return p.vehicle_mass * exhaust / greatest_thrust(p) * (1 - math.exp(-change / exhaust))


def _find_burn_length(p: Any, angle: float, coast: float, burn: float, whole: float) -> tuple[float, Matrix | None]:
    """Find the length of a burn against the velocity that leads down at about the typical angle, and its last row.

    An impulse of the same velocity change leads down more steeply than a burn that goes round a part of the body.
    """
    gate, wanted = p.body_radius + p.interface_altitude, typical_angle(p)
    short, long, best = 0.0, math.inf, None
    for _ in range(_BURNS if burn * mean_rate(p, angle) > _LONG_BURN else 1):
        last = integrate_planar_descent(p, angle, coast, burn, 2 * whole)[0]
        flat = True
        if abs(last[1] / gate - 1) < _NEAR:
            best, steep = (
                (min(burn, float(last[0]) - coast), last),
                math.atan2(last[3], last[4] - turning_speed(p, gate)) / wanted,
            )
            if abs(steep - 1) < _ALIKE or last[0] < coast + burn:
                break
            flat = steep < 1
        short, long = (burn, long) if flat else (short, burn)
        burn = 0.5 * (short + long) if long < math.inf else _LONGER * burn
    return best or (burn, None)


def typical_times(p: Any, angles: Physics, air: Air | None, *, coasts: bool, drifts: bool) -> dict[str, float]:
    """Rough lengths [s] of the phases, by the names of their durations.

    Parameters
    ----------
    p
        Parameters [SI].
    angles
        ``angles(p, xp)`` returns the argument of latitude and the longitude of the node at t = 0 [rad].
    air
        Density of the air against altitude; None where the flight ends at the interface.
    coasts, drifts
        Let a fall without thrust come before the burn, and after it.
    """
    angle, node = (float(v) for v in angles(p, NUMERIC))
    times = {"coast_time": 0.3 * p.orbit_longest_coast} if coasts else {}
    down = estimate_descent(p, angle, drifts=drifts, coast=times.get("coast_time", 0.0))
    times["burn_time"] = down.burn
    if drifts:
        times["drift_time"] = max(down.whole - down.burn, _LEAST_DRIFT * down.whole)
    if air is None:
        return times
    entry = fall(p, air)
    times["entry_time"] = entry.time
    if hasattr(p, "parachute_altitude"):
        times["parachute_time"] = parachute.typical_parachute_time(p, air)
    if hasattr(p, "site_longitude"):
        whole, swept = down.whole + entry.time, down.swept + float(entry.rows[-1, 1])
        longest = p.orbit_longest_coast if coasts else 0.0
        drifted = times.get("drift_time", 0.0)
        drift = max(_MOST_DRIFT * p.transition_longest_coast, drifted) if drifts else 0.0
        room = drift - drifted + max(_burn_time_of(p, total_velocity_change(p)) - down.burn, 0.0)
        spare = total_velocity_change(p) - down.velocity_change
        more = _delay_to_site(p, angle, node, whole, swept, (longest, longest + room), spare)
        if coasts:
            times["coast_time"] = min(more, longest)
        late = max(more - longest, 0.0)
        if drifts:
            times["drift_time"] = min(drifted + late, drift)
        times["burn_time"] += max(late - (drift - drifted), 0.0)
    return times


def _delay_to_site(
    p: Any, angle: float, node: float, whole: float, swept: float, latest: tuple[float, float], spare: float
) -> float:
    """Return the delay [s] after which a flight that lasts `whole` and sweeps an angle ends at the site.

    At the first pass; of those within the longest coast, about, the first of `latest` [s], at that which comes nearest
    to the site: a way that is not as long as the typical one is easier to fly than one to the side. Where all of them
    are further aside than a `spare` velocity change [m/s] turns the orbit, at the next one if that is not, and is not
    later than the second of `latest`, up to which burn and drift may last longer.
    """
    (up, ahead), mean = plane_axes(angle, node, p, NUMERIC), mean_rate(p, angle)
    aside, found = cross_product(up, ahead), list[tuple[float, float, float]]()
    longest, last = latest
    reach = math.sin(max(0.0, min(spare / (mean * float(radius_and_speeds(angle, p, NUMERIC)[0])), 0.5 * math.pi)))
    turns = min(int(longest * mean / (2 * math.pi) + _SHORTER), _TURNS)
    for turn in range(turns + 2):
        more = 0.0
        for _ in range(30):  # the body carries the site along
            turned = p.body_rotation_rate * (whole + more)
            site, _, _ = local_axes(p.site_longitude + turned, p.site_latitude, NUMERIC)
            away = math.atan2(scalar_product(site, ahead), scalar_product(site, up)) - swept
            more = (away - 2 * math.pi * (math.floor(away / (2 * math.pi) + _SHORTER) - turn)) / mean
        beyond = max(more - longest, -more, 0.0) * mean
        far = abs(scalar_product(site, aside))
        found.append((far + _EASIER * beyond, far, max(more, 0.0)))
    *within, (_, far, after) = found
    later = far <= reach < min(far for _, far, _ in within) and after <= last
    return after if later else min(within)[2]


def rough_trajectory(p: Any, *, angles: Physics, air: Air | None, names: tuple[str, ...], heat: bool) -> list[Matrix]:
    """States (points, states) [SI] of each phase, given the durations in `p`.

    Parameters
    ----------
    p
        Parameters [SI], durations included.
    angles
        ``angles(p, xp)`` returns the argument of latitude and the longitude of the node at t = 0 [rad].
    air
        Density of the air against altitude; None where the flight ends at the interface.
    names
        Phases in order of flight.
    heat
        Add the heat load [J/m^2] to the states in the air.
    """
    angle, node = (float(v) for v in angles(p, NUMERIC))
    gate, rate = p.body_radius + p.interface_altitude, greatest_thrust(p) / engine_exhaust_speed(p)
    lengths = {name: float(getattr(p, f"{name}_time")) for name in names}
    parts = [lengths.get(name, 0.0) for name in ("coast", "burn", "drift")]
    long = sum(parts) > LONGEST_COAST
    last, at = integrate_planar_descent(p, angle, *((0.0, 0.0, 1.0) if long else parts))
    flies = not long and last[0] >= (1 - _WAITS) * sum(parts) and abs(last[1] / gate - 1) < _NEAR
    found, time, mass = list[Matrix](), 0.0, p.vehicle_mass
    weighed = throttled(p) and hasattr(p, "separation_mass")
    turned = 0.0
    for name in (name for name in names if name not in ("entry", "parachute")):
        rows = []
        for since in np.linspace(0.0, lengths[name], POINTS):
            row = at(time + since) if flies else _deflected_row(p, angle, time + since, parts, gate)
            rows.append(
                [*_state_of_row(p, angle, node, time + since, row), mass - (rate * since if name == "burn" else 0.0)]
            )
            turned = row[1]
        time, mass = time + lengths[name], rows[-1][-1]
        found.append(np.array(rows, dtype=float))
    if air is not None:
        fallen, rows = fall(p, air), []
        for share, (height, swept, speed, gamma, load) in zip(np.linspace(0, 1, POINTS), fallen.rows, strict=True):
            distance = p.body_radius + height
            level = speed * math.cos(gamma) + turning_speed(p, distance)
            row = distance, turned + swept, speed * math.sin(gamma), level
            moved = _state_of_row(p, angle, node, time + share * fallen.time, row)
            kept = *((load,) if heat else ()), *((mass,) if weighed else ())
            rows.append([*moved, getattr(p, "separation_mass", mass), *kept])
        found.append(np.array(rows, dtype=float))
    if "parachute" in names:
        sunk = (p.parachute_altitude - p.site_altitude) * np.linspace(0.0, 1.0, POINTS)[:, None]
        opened = np.array(found[-1][-1])
        shrinking = 1 - sunk / np.linalg.norm(opened[:3])
        found.append(np.hstack([opened[:3] * shrinking, np.repeat([opened[6:]], POINTS, axis=0)]))
    return found


def _deflected_row(p: Any, angle: float, time: float, parts: list[float], gate: float) -> Any:
    """A row of the orbit, bent down evenly from the end of the coast on."""
    radius, mean = float(radius_and_speeds(angle, p, NUMERIC)[0]), mean_rate(p, angle)
    share = max(time - parts[0], 0.0) / sum(parts[1:])
    return radius + share * (gate - radius), mean * time, 0.0, mean * radius


def _state_of_row(p: Any, angle: float, node: float, time: float, row: Any) -> list[float]:
    """Position, and velocity relative to the body, of a row in the plane of the orbit."""
    distance, swept, rise, level = row
    up, ahead = plane_axes(angle + swept, node - p.body_rotation_rate * time, p, NUMERIC)
    position = combine((distance, up))
    return [*position, *combine((rise, up), (level, ahead), (-p.body_rotation_rate, cross_product(AXIS, position)))]
