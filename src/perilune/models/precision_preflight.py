"""What physics says of a precision landing before it is solved.

The bounds of `perilune.models.limits`, the glide slope at the start, and the throttle's floor.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from perilune.models.bodies import MOON, Body, UniformGravity
from perilune.models.corridor import above_slope
from perilune.models.ground import over_ground, without_thrust
from perilune.models.limits import (
    above_site,
    air_left_out,
    engine_holds_dry_mass,
    propellant_stops,
    stopping_distance,
    thrust_against_weight,
)
from perilune.problem.preflight import Finding


def compare_precision(p: Any, m: Any, *, body: Body | UniformGravity = MOON) -> tuple[Finding, ...]:
    """Every comparison of a precision landing, for `Problem.preflight`."""
    start = SimpleNamespace(east=p.approach_east, north=p.approach_north, up=p.approach_up)
    velocity = (p.approach_east_speed, p.approach_north_speed, p.approach_up_speed)
    position, axis, r_site = over_ground(start, p, m)
    found = [above_site(p.approach_up, 0.0)]
    found += [thrust_against_weight(r_site, p), *engine_holds_dry_mass(r_site, p, m)]
    if hasattr(p, "corridor_tilt") and not hasattr(p, "approach_longest_coast"):
        found.append(_throttle_floor(p, m))  # with its engine off it comes down all the same
    if hasattr(p, "corridor_slope"):
        found.append(_above_slope_at_start(start, p, m))
    found.append(stopping_distance(position, velocity, axis, r_site, p, m))
    if hasattr(p, "vehicle_dry_mass"):
        found.append(propellant_stops(position, velocity, axis, r_site, p, m))
    return (*found, *(air_left_out(body) if isinstance(body, Body) else ()))


def _above_slope_at_start(start: Any, p: Any, m: Any) -> Finding:
    return Finding(
        name="height above the glide slope",
        value=above_slope(start, p, m),
        limit=0.0,
        at_least=True,
        unit="m",
        binding=True,
        meaning="the approach begins below the glide slope",
        advice="a higher or nearer start, or a flatter corridor.slope",
    )


def _throttle_floor(p: Any, m: Any) -> Finding:
    """Whether the engine can let the vehicle down.

    Within the pointing limit the throttle's floor lifts by at least this much, more on a lighter vehicle and more
    higher up, and ends the descent on the way v^2/(2 a). A hundredth is left to the Coriolis acceleration.
    """
    site = SimpleNamespace(east=0.0, north=0.0, up=0.0)
    weight = -without_thrust(site, (0.0, 0.0, 0.0), p, m)[2]
    lift = p.throttle_lower * p.vehicle_thrust * m.cos(p.corridor_tilt) / p.vehicle_mass - weight
    return Finding(
        name="speed of descent against the lift of the throttle floor",
        value=m.fmax(-p.approach_up_speed, 0.0),
        limit=m.sqrt(2 * m.fmax(lift, 0.0) * p.approach_up * 0.99),
        at_least=True,
        unit="m/s",
        binding=True,
        meaning="the throttle floor hovers or climbs: the vehicle cannot come down to the site",
        advice="a lower throttle floor, or a heavier vehicle",
    )
