"""Feasibility checks of a precision landing, before it is solved.

The bounds of `perilune.models.physics.delta_v_bounds`, the glide slope at the start, and the throttle's floor.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

from perilune.models.physics.bodies import MOON, Body, UniformGravity
from perilune.models.physics.delta_v_bounds import (
    braking_distance_and_time,
    compare_dry_mass,
    compare_neglected_air,
    compare_propellant,
    compare_start_height,
    compare_stopping_distance,
    compare_thrust_and_weight,
    gravity_at,
    greatest_thrust,
    is_flat,
    largest_mass_stopped,
)
from perilune.models.physics.rotating_frame import scalar_product
from perilune.models.precision.ground import ground_free_acceleration, over_ground
from perilune.models.precision.path_constraints import above_slope
from perilune.problem import Finding


def compare_precision(p: Any, xp: Any, *, body: Body | UniformGravity = MOON) -> tuple[Finding, ...]:
    """Return every comparison of a precision landing, for `Problem.preflight`.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.
    body
        Body of the site, whose air the model neglects; flat ground under uniform gravity has none.
    """
    start = SimpleNamespace(east=p.approach_east, north=p.approach_north, up=p.approach_up)
    velocity = (p.approach_east_speed, p.approach_north_speed, p.approach_up_speed)
    position, axis, r_site = over_ground(start, p, xp)
    left = getattr(p, "final_touchdown_speed", 0.0)
    held = _largest_mass_to_touchdown(p, xp) if hasattr(p, "final_height") else largest_mass_stopped(r_site, p, xp)
    found = [compare_start_height(p.approach_up, 0.0), compare_thrust_and_weight(r_site, p), *compare_dry_mass(held, p)]
    if hasattr(p, "corridor_tilt") and not hasattr(p, "approach_longest_coast"):
        found.append(_compare_throttle_floor(p, xp))  # with its engine off it comes down all the same
    if hasattr(p, "corridor_slope"):
        found.append(_compare_start_with_slope(start, p, xp))
    if hasattr(p, "final_height"):
        found += [_compare_start_with_gate(p), _compare_vertical_tilt(p, xp)]
    found.append(compare_stopping_distance(position, velocity, axis, r_site, p, xp, left))
    if hasattr(p, "corridor_slope"):
        found.append(_compare_stop_above_slope(start, velocity, left, p, xp))
    if hasattr(p, "vehicle_dry_mass"):
        found.append(compare_propellant(position, velocity, axis, r_site, p, xp, left))
    return (*found, *(compare_neglected_air(body) if isinstance(body, Body) else ()))


def _compare_start_with_slope(start: Any, p: Any, xp: Any) -> Finding:
    return Finding(
        name="height above the glide slope",
        value=above_slope(start, p, xp),
        limit=0.0,
        at_least=True,
        unit="m",
        binding=True,
        meaning="the approach starts below the glide slope",
        advice="a higher or nearer start, or a flatter corridor.slope",
    )


def _compare_stop_above_slope(start: Any, velocity: Any, left: Any, p: Any, xp: Any) -> Finding:
    """Compare the distance in which full thrust stops the approach with that to the glide slope.

    The room above a slope is convex: it lies above the tangent plane below the start, whose normal (-, -, 1) has the
    length L. Thrust changes the height above that plane by L T/m at most, so that the argument at the head of
    `perilune.models.physics.delta_v_bounds` holds for it as for the height above the site.
    """
    away = xp.sqrt(start.east * start.east + start.north * start.north)
    steep = xp.tan(p.corridor_slope) / xp.sqrt(away * away + p.corridor_pad_radius * p.corridor_pad_radius)
    normal = (-steep * start.east, -steep * start.north, 1.0)
    lever = xp.sqrt(scalar_product(normal, normal))
    closing = xp.fmax(-scalar_product(normal, velocity) - left, 0.0)
    distance, time = braking_distance_and_time(closing, p, xp, lever)
    pull = -scalar_product(normal, ground_free_acceleration(start, velocity, p, xp))
    if not is_flat(p):
        pull -= lever * _change_of_gravity(velocity, closing / lever, time, p, xp)
    return Finding(
        name="stopping distance at full thrust towards the glide slope",
        value=distance + 0.5 * pull * time * time,
        limit=above_slope(start, p, xp),
        at_least=False,
        unit="m",
        binding=True,
        meaning="the approach is too fast: even full thrust straight away from the glide slope crosses it",
        advice="a slower, higher or nearer start, a flatter corridor.slope, or more thrust",
    )


def _change_of_gravity(velocity: Any, gained: Any, time: Any, p: Any, xp: Any) -> Any:
    """Return the most [m/s^2] that the acceleration without thrust changes in a time, with a speed gained by thrust.

    By the gradient of gravity, 2 mu/r^3 (and half as much again for J2), and by the turning of the body.
    """
    r, omega = p.body_radius + p.site_altitude, xp.fabs(p.body_rotation_rate)
    gained += 1.1 * gravity_at(r, p) * time
    way = (xp.sqrt(scalar_product(velocity, velocity)) + gained) * time
    return 3 * gravity_at(r, p) / r * way + 2 * omega * gained + omega * omega * way


def _largest_mass_to_touchdown(p: Any, xp: Any) -> Any:
    """Largest mass [kg] that comes down the vertical from the gate with no more than the touchdown speed u.

    Where full thrust leaves an acceleration b downwards, the way h from the gate makes it as fast as sqrt(2 b h).
    """
    weight = -ground_free_acceleration(_on_vertical(p.final_height), (0.0, 0.0, 0.0), p, xp)[2]
    u = p.final_touchdown_speed
    return greatest_thrust(p) / xp.fmax(weight - 0.5 * u * u / p.final_height, 0.0)


def _on_vertical(up: Any) -> Any:
    return SimpleNamespace(east=0.0, north=0.0, up=up)


def _compare_start_with_gate(p: Any) -> Finding:
    return Finding(
        name="height above the final descent",
        value=p.approach_up - p.final_height,
        limit=1e-3,  # m: strictly above
        at_least=True,
        unit="m",
        binding=True,
        meaning="the approach starts below the height from which the final descent is vertical",
        advice="a lower final.height, or a higher start",
    )


def _compare_vertical_tilt(p: Any, xp: Any) -> Finding:
    """Compare the tilt that keeps the vehicle on the vertical, hovering and at the speed of a fall from the gate."""
    fall = xp.sqrt(2 * gravity_at(getattr(p, "body_radius", 0.0), p) * p.final_height)
    tilts = []
    for speed in (0.0, fall):
        east, north, up = ground_free_acceleration(_on_vertical(0.0), (0.0, 0.0, -speed), p, xp)
        tilts.append(xp.atan2(xp.sqrt(east * east + north * north), -up) * (180.0 / math.pi))
    return Finding(
        name="tilt that keeps it on the vertical",
        value=xp.fmax(*tilts),
        limit=1.0,
        at_least=False,
        unit="deg",
        binding=False,
        meaning="the rotation of the body requires a tilt in the final descent, which is neglected",
        advice="a lower final.height, or no [final]",
    )


def _compare_throttle_floor(p: Any, xp: Any) -> Finding:
    """Compare the descent speed with the most that the throttle floor lets come down to the site.

    Within the pointing limit the throttle's floor lifts by at least this much, more on a lighter vehicle and more
    higher up, and ends the descent on the way v^2/(2 a). A hundredth is left to the Coriolis acceleration.
    """
    weight = -ground_free_acceleration(_on_vertical(0.0), (0.0, 0.0, 0.0), p, xp)[2]
    lift = p.throttle_lower * p.vehicle_thrust * xp.cos(p.corridor_tilt) / p.vehicle_mass - weight
    return Finding(
        name="descent speed that reaches the site with the throttle at its floor",
        value=xp.fmax(-p.approach_up_speed, 0.0),
        limit=xp.sqrt(2 * xp.fmax(lift, 0.0) * p.approach_up * 0.99),
        at_least=True,
        unit="m/s",
        binding=True,
        meaning="at its throttle floor the vehicle hovers or climbs and cannot descend to the site",
        advice="a lower throttle floor, or a heavier vehicle",
    )
