"""Feasibility checks of a return, before it is solved.

*Down at all.* From a circular or elliptic orbit the least velocity change that lowers the flight to the radius r_a is
that of an impulse at the apogee r_2, against the velocity there, to an ellipse with its perigee at r_a:

    dV = sqrt(2 mu/r_2) (sqrt(r_1/(r_1 + r_2)) - sqrt(r_a/(r_a + r_2))),   r_1 the perigee of the orbit

No finite burn does better, and drag begins at the interface only. Oblateness moves the height of a flight by some
kilometres within a turn: `oblateness_height_shift` stands for that.

*At the interface.* What `interface_bounds` says of its speed and its angle.

*Limits* of a ballistic entry. What `ballistic_limits` says that every one bears.

*Weak thrust.* How many turns a burn of that change lasts: of more than one it is warned, as it winds down.

*In the air.* What `skip_out` says of entries that leave it again.

*Slow enough.* What `ballistic_fall` says of arriving at the site.

*A file of air.* Its densities and those of the standard atmosphere of the body, which differ by less than a factor of
three between solar minimum and maximum where they are compared: beyond ten a unit is wrong.

*Sideways.* What `find_passes` says of a site that is out of the plane of the orbit; with lift it is warned, and beyond
what any entry reaches to the side (`perilune.models.physics.crossrange`) refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import NUMERIC, Physics
from perilune.models.deorbit.ballistic_fall import (
    Fall,
    all_falls_too_fast,
    entry_end_altitude,
    fall,
    slowest_arrival,
    terminal_speed,
)
from perilune.models.deorbit.ballistic_limits import compare_least_loads
from perilune.models.deorbit.duration_ranges import LONGEST_ENTRY
from perilune.models.deorbit.interface_bounds import (
    gate_radius,
    interface_speeds,
    largest_altitude_change,
    oblateness_height_shift,
    orbital_speed_at,
    steepest_angle,
)
from perilune.models.deorbit.orbit import orbit_state
from perilune.models.deorbit.records import (
    engine_exhaust_speed,
    is_something_left,
    total_velocity_change,
)
from perilune.models.deorbit.secular_drift import drift
from perilune.models.deorbit.site_passes import (
    Pass,
    apsis_radii,
    find_passes,
    least_burnout_mass,
    nearest_approach_to_plane,
)
from perilune.models.deorbit.skip_out import compare_skip_out
from perilune.models.physics import ellipsoid
from perilune.models.physics.atmosphere import Air
from perilune.models.physics.crossrange import glide_limits
from perilune.models.physics.delta_v_bounds import greatest_thrust
from perilune.models.physics.standard_atmosphere import LOWEST, density as standard_density
from perilune.problem import Finding

_DEGREE = math.degrees(1.0)
OFF_PLANE = math.radians(0.5)  # of oblateness and of what the air does
_DAY = 86400.0  # s
_LEVELS = 101  # altitudes, from the site to the interface
_LOW_ORBIT = 1.1  # speeds at the interface over the circular one, below which a site aside is refused by a bound
_ONE_TURN = 1.0  # of the orbit: a burn that lasts longer winds down
_AHEAD = 3 * _DAY  # looked at for a pass that can be made
_COMPARED_TO, _COMPARED_AT = 200e3, 401  # m, above which the Sun changes densities by more; altitudes
_OTHER_AIR = 10.0  # times a density


def compare_return(
    p: Any, xp: Any, *, angles: Physics, air: Air | None, drifts: bool, standard: bool
) -> tuple[Finding, ...]:
    """Return every comparison of a return, for `Problem.preflight`.

    Parameters
    ----------
    p, xp
        Parameters [SI] and the maths namespace.
    angles
        Argument of latitude and node at t = 0 [rad].
    air
        Air below the interface, or None.
    drifts
        Whether a coast follows the burn.
    standard
        True if the U.S. Standard Atmosphere, 1976, is the body's.
    """
    low, high = apsis_radii(p)
    found = _compare_lowest_altitude(p, xp, low, angles)
    enters = all(np.all(f.passed) for f in found if f.binding)  # what is within the air already falls from no interface
    if air is not None and air.said and standard:
        found += _compare_with_standard_air(air)
    if is_something_left(p):
        found += [_compare_deorbit_change(p, xp, low, high), *_compare_interface_values(p, xp)]
        if not hasattr(p, "transition_longest_coast"):
            found.append(_compare_burn_descent(p, xp, low))
    if _is_single_problem(p, low) and low > p.body_radius and enters:
        found += _compare_burn_with_turn(p, low, high)
    if air is not None and _is_single_problem(p, low) and low > p.body_radius and enters:
        fallen = fall(p, air)
        if not hasattr(p, "vehicle_lift_to_drag"):
            found += (*compare_least_loads(p, air, fallen), *compare_skip_out(p, air, fallen))
        found += _compare_arrival_speed(p, air, fallen)
        found += _compare_plane_turn(p, air, angles, fallen, drifts=drifts) if hasattr(p, "site_longitude") else ()
    return tuple(found)


def _compare_with_standard_air(air: Air) -> list[Finding]:
    """Compare the air of a file with the standard, by the largest factor between their densities."""
    low, high = max(air.bottom, LOWEST), min(air.top, _COMPARED_TO)
    if low >= high:
        return []
    altitude = np.linspace(low, high, _COMPARED_AT)
    own = SimpleNamespace(**{name: given.value for name, given in air.given.items()})
    share = air.density(altitude, own, NUMERIC) / standard_density(altitude)
    factor = np.maximum(share, 1 / share)
    worst = int(factor.argmax())
    return [
        Finding(
            name="factor between its densities and the US Standard Atmosphere 1976", value=float(factor[worst]),
            limit=_OTHER_AIR, at_least=False, unit="1", binding=False,
            meaning=f"at {altitude[worst] / 1e3:.3g} km the {air.name} has {share[worst]:.3g} times the density of the"
            f" US Standard Atmosphere 1976; its file was read as {air.said}",
            advice="check the units in its headings and the order of its columns",
        )
    ]  # fmt: skip


def _compare_lowest_altitude(p: Any, xp: Any, low: Any, angles: Physics) -> list[Finding]:
    """Compare perigee and ignition with the interface: a burn from high up may leave the ellipse before its perigee."""
    leaves = not hasattr(p, "orbit_radius") and not hasattr(p, "orbit_longest_coast")
    heights = {"perigee": (low - p.body_radius, not leaves)}
    if leaves:
        angle, node = angles(p, xp)
        position, _ = orbit_state(angle, node, p, xp)
        heights["ignition"] = ellipsoid.altitude(position, p, xp), True
    return [
        Finding(
            name=f"{name} above the interface", value=(height - p.interface_altitude) / 1e3, limit=0.0, at_least=True,
            unit="km", binding=binding,
            meaning="the orbit enters the atmosphere by itself, but the model has no atmosphere above the interface",
            advice="a higher orbit (its radius is from the centre of the body), or a lower interface.altitude",
        )
        for name, (height, binding) in heights.items()
    ]  # fmt: skip


def _least_change(p: Any, xp: Any, low: Any, high: Any, gate: Any) -> Any:
    """Least velocity change [m/s] from the orbit to a perigee at a distance."""
    left = xp.sqrt(low / (low + high)) - xp.sqrt(gate / (gate + high))
    return xp.sqrt(2 * p.body_gravitational_parameter / high) * xp.fmax(left, 0.0)


def _compare_deorbit_change(p: Any, xp: Any, low: Any, high: Any) -> Finding:
    return Finding(
        name="velocity change to reach the interface",
        value=_least_change(p, xp, low, high, p.body_radius + p.interface_altitude + oblateness_height_shift(p, xp)),
        limit=total_velocity_change(p, xp),
        at_least=False,
        unit="m/s",
        binding=True,
        meaning="the propellant does not suffice to reach the interface",
        advice="more propellant (a lower vehicle.dry_mass or separation.mass), a lower orbit, or another engine",
    )


def _compare_burn_with_turn(p: Any, low: float, high: float) -> list[Finding]:
    """Compare the burn of the least velocity change with one turn: a search seldom follows a spiral."""
    mu, exhaust = p.body_gravitational_parameter, engine_exhaust_speed(p)
    change = _least_change(p, NUMERIC, low, high, p.body_radius + p.interface_altitude)
    burn = -math.expm1(-change / exhaust) * p.vehicle_mass * exhaust / greatest_thrust(p)
    turns = burn * math.sqrt(mu / ((low + high) / 2) ** 3) / (2 * math.pi)
    if turns <= _ONE_TURN:
        return []
    return [
        Finding(
            name="revolutions during the burn", value=turns, limit=_ONE_TURN, at_least=False, unit="1",
            binding=False,
            meaning=f"the engine is so weak that reaching the interface takes {change:.0f} m/s or more, a burn of"
            f" {burn / 3600:.1f} h: a spiral, which the search may not find and which arrives almost horizontally",
            advice="more vehicle.thrust, less mass, or a lower orbit",
        )
    ]  # fmt: skip


def _compare_burn_descent(p: Any, xp: Any, low: Any) -> Finding:
    return Finding(
        name="time to the interface",
        value=(low - p.body_radius - p.interface_altitude - oblateness_height_shift(p, xp)) / 1e3,
        limit=largest_altitude_change(p, xp, total_velocity_change(p, xp)) / 1e3,
        at_least=False,
        unit="km",
        binding=True,
        meaning="the burn lasts all the way to the interface, longer than the propellant",
        advice="transition.longest_coast, for a coast after the burn; or more propellant, less thrust",
    )


def _compare_interface_values(p: Any, xp: Any) -> list[Finding]:
    """Compare stated speed and angle at the interface with the range that the velocity change allows."""
    found = list[Finding]()
    slowest, fastest = interface_speeds(p, xp)
    for ending, limit, at_least in (("upper", slowest, True), ("lower", fastest, False)):
        stated = getattr(p, "interface_speed", getattr(p, f"interface_speed_{ending}", None))
        if stated is not None:
            found.append(
                Finding(
                    name=f"{'greatest' if at_least else 'least'} speed at the interface", value=stated, limit=limit,
                    at_least=at_least, unit="m/s", binding=True,
                    meaning="all propellant together cannot give this speed at the interface",
                    advice="another interface.speed, relative to the rotating body; check for m/s in place of km/s",
                )
            )  # fmt: skip
    stated = getattr(p, "interface_angle", getattr(p, "interface_angle_upper", None))
    if stated is not None:
        found.append(
            Finding(
                name="path angle at the interface below the horizon", value=-stated * _DEGREE,
                limit=steepest_angle(p, xp) * _DEGREE, at_least=False, unit="deg", binding=True,
                meaning="all propellant together cannot make the flight so steep at the interface",
                advice="a flatter interface angle, or more propellant (a lower vehicle.dry_mass or separation.mass)",
            )
        )  # fmt: skip
    return found


def _is_single_problem(p: Any, low: Any) -> bool:
    """Return True for one problem with finite numbers; for many at once or for symbols no flights are computed."""
    return all(isinstance(number, int | float) and math.isfinite(number) for number in (*vars(p).values(), low))


def _compare_arrival_speed(p: Any, air: Air, fallen: Fall) -> tuple[Finding, ...]:
    """Compare the arrival speeds of a typical fall without lift (not binding) and of the slowest fall (binding)."""
    advice = "more drag area, a higher site.altitude, or a greater site.speed_upper"
    found, light = list[Finding](), ""
    if fallen.lands and hasattr(p, "vehicle_drag_area") and not hasattr(p, "separation_mass"):
        enough = p.vehicle_mass * (p.site_speed_upper / terminal_speed(p, air)) ** 2
        light = f"; its terminal speed is low enough below {enough:.0f} kg of its {p.vehicle_mass:g} kg"
    if fallen.lands:
        found.append(
            Finding(
                name="landing speed of a ballistic entry", value=float(fallen.rows[-1, 2]), limit=p.site_speed_upper,
                at_least=False, unit="m/s", binding=False,
                meaning=f"the vehicle may arrive faster than site.speed_upper, the speed a parachute can take{light}",
                advice=advice,
            )
        )  # fmt: skip
    else:
        found.append(
            Finding(
                name="altitude of a ballistic entry after three revolutions", value=float(fallen.rows[-1, 0]) / 1e3,
                limit=entry_end_altitude(p) / 1e3, at_least=False, unit="km", binding=False,
                meaning="the vehicle may float, or leave the atmosphere again",
                advice="a smaller drag area, or a steeper interface.angle",
            )
        )  # fmt: skip
    if hasattr(p, "vehicle_lift_to_drag") or not fallen.lands or found[0].passed:
        return tuple(found)
    steep = steepest_angle(p, NUMERIC) if is_something_left(p) else math.inf
    speeds = interface_speeds(p, NUMERIC) if is_something_left(p) else (0.0, math.inf)
    light = SimpleNamespace(
        **{**vars(p), "vehicle_mass": least_burnout_mass(p)}
    )  # the less is left the slower it falls
    slowest = slowest_arrival(light, air, -float(steep), (float(speeds[0]), float(speeds[1])))
    steady = terminal_speed(light, air)
    for name, value, sure in (
        ("landing speed of the slowest entry, less a tenth", 0.9 * slowest, True),
        ("terminal speed at the site", steady, steady > p.site_speed_upper and all_falls_too_fast(light, air)),
    ):
        if sure:
            found.append(
                Finding(
                    name=name, value=value, limit=p.site_speed_upper, at_least=False, unit="m/s", binding=True,
                    meaning="no ballistic entry arrives as slowly as site.speed_upper, the speed a parachute can take",
                    advice=advice,
                )
            )  # fmt: skip
    return tuple(found)


def _compare_plane_turn(p: Any, air: Air, angles: Physics, fallen: Fall, *, drifts: bool) -> tuple[Finding, ...]:
    """Compare the site's least distance from the plane of the orbit during a flight with what turns the plane.

    That is all propellant (not binding with lift), and the most that lift does as well.
    """
    angle, node = (float(v) for v in angles(p, NUMERIC))
    orbit = drift(*orbit_state(angle, node, p, NUMERIC), p)
    entry = fallen.time, float(fallen.rows[-1, 1])
    away, turned = nearest_approach_to_plane(p, orbit, entry)
    lifts, advice = hasattr(p, "vehicle_lift_to_drag"), "another site"
    if away > turned + OFF_PLANE:
        advice = f"{_describe_next_pass(p, find_passes(p, orbit, entry, drifts=drifts, until=_AHEAD))}; or another site"

    def compare(away: float, turned: float, by: str, *, binding: bool) -> Finding:
        return Finding(
            name="distance of the site from the plane of the orbit", value=math.degrees(away),
            limit=math.degrees(turned + OFF_PLANE), at_least=False, unit="deg", binding=binding,
            meaning=f"the site stays {away * p.body_radius / 1e3:.0f} km or more out of the plane of the orbit, which"
            f" is further than {by}",
            advice=advice,
        )  # fmt: skip

    found = compare(away, turned, "the propellant can turn this plane", binding=not lifts)
    if found.passed or not lifts:
        return (found,)
    altitudes = np.linspace(entry_end_altitude(p), p.interface_altitude, _LEVELS)
    steady = np.array([terminal_speed(p, air, float(altitude)) for altitude in altitudes])
    gate = gate_radius(p)
    fastest = float(orbital_speed_at(p, NUMERIC, gate) + total_velocity_change(p))
    if fastest > _LOW_ORBIT * math.sqrt(
        p.body_gravitational_parameter / gate
    ):  # what skips out goes round once more, for hours
        return (found,)
    aside, behind = glide_limits(p, altitudes, steady, fastest)
    away, turned = nearest_approach_to_plane(p, orbit, entry, glide=(LONGEST_ENTRY * fallen.time, behind))
    surely = compare(
        away, turned + aside, "the propellant can turn this plane and lift moves to the side", binding=True
    )
    return (found,) if surely.passed else (surely,)


def _describe_next_pass(p: Any, found: Sequence[Pass]) -> str:
    """Describe the first pass that can be made; where there is none, the one that needs the least turn."""
    available = total_velocity_change(p)
    good = next((one for one in found if one.velocity_change <= available), None)
    if good is not None:
        return f"the first pass that can be flown has its ignition {good.ignition / 3600:.1f} h after t = 0"
    if abs(p.site_latitude) > math.asin(math.sin(p.orbit_inclination)):
        return "the plane of the orbit never comes over its latitude: a higher orbit.inclination"
    days = _AHEAD / _DAY
    if not found:
        return f"no pass within {days:g} days is certainly within reach"
    least = min(found, key=lambda one: abs(one.out_of_plane_angle))
    return (
        f"no pass within {days:g} days is certainly within reach; the nearest is"
        f" {math.degrees(abs(least.out_of_plane_angle)):.1f} deg off, {least.ignition / 3600:.1f} h after t = 0"
    )
