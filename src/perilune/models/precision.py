"""Precision landing: the last kilometres, with a throttle range, a pointing limit and a glide slope.

Frame: east, north, up at the landing site, turning with the body; position from the site, velocity relative
to it. The rotation axis is (0, cos latitude, sin latitude) there, and the mechanics are those of
`perilune.models.rotating`.

    r'' = g + (throttle T/m) d - 2 Omega x r' - Omega x (Omega x r),   m' = -throttle T/(Isp g0)
    d_up >= cos(tilt)                                      pointing limit: the vehicle stays near upright
    up >= tan(slope) (sqrt(east^2 + north^2 + a^2) - a)    glide slope: the ground is not flown into

The glide slope is a hyperboloid with pad radius a. It lies between the cone from the site, whose tip has no
normal, and the cone from the rim of the pad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

from perilune.models.bodies import MOON, Body, oblate
from perilune.models.budget import LANDED_MASS, LANDING, SPENT, landing, spent
from perilune.models.coast import COAST_TIME, FREE, LONGEST, at_ignition, coast_range, with_coast
from perilune.models.descent import SPEED, THROTTLE, Site, with_dry_mass
from perilune.models.descent_frames import mass_rate, thrust, variables
from perilune.models.landing import mass_state
from perilune.models.limits import (
    above_site,
    air_left_out,
    engine_holds_dry_mass,
    propellant_stops,
    stopping_distance,
    thrust_against_weight,
)
from perilune.models.rotating import (
    INERTIAL_AXES,
    apparent_gravity,
    combine,
    free_acceleration,
    local_axes,
    seen_inertially,
)
from perilune.models.vehicle import Throttle, Vehicle
from perilune.problem.controls import Direction
from perilune.problem.declared import given_of
from perilune.problem.phase import Phase
from perilune.problem.preflight import Finding
from perilune.problem.problem import Problem
from perilune.problem.variables import Free, Variable
from perilune.problem.views import History, Views
from perilune.words.asked import demand_records
from perilune.words.declared import quantity, record
from perilune.words.maths import NUMERIC
from perilune.words.units import Scales


@record("approach")
class Approach:
    """Where a precision landing begins: position and velocity from the site."""

    east: float = quantity("m", "-1800 m", about="position from the site")
    north: float = quantity("m", "300 m", about="position from the site")
    up: float = quantity("m", "1 km", about="height above the site")
    east_speed: float = quantity("m/s", "50 m/s", **SPEED, default=0.0, about="relative to the site")
    north_speed: float = quantity("m/s", "0 m/s", **SPEED, default=0.0, about="relative to the site")
    up_speed: float = quantity("m/s", "-30 m/s", **SPEED, default=0.0, about="negative when it descends")
    longest_coast: float | None = LONGEST


@record("corridor")
class Corridor:
    """What the flight must keep to; it may be left out, and then nothing but the ground is in the way."""

    tilt: float = quantity(
        "rad", "50 deg", above=0.0, below=0.5 * math.pi, outside="is no angle",
        about="most angle of the thrust from the vertical; up to it the lander may touch down tilted",
    )  # fmt: skip
    slope: float = quantity(
        "rad", "20 deg", above=0.0, below=0.5 * math.pi, outside="is no angle",
        about="least elevation of the vehicle above the horizon as seen from the site",
    )  # fmt: skip
    pad_radius: float = quantity(
        "m", "10 m", default=10.0, above=0.0, outside="must be positive", about="where the glide slope begins"
    )


def _centre_to(x: Any, p: Any) -> tuple[Any, Any, Any]:
    return x.east, x.north, x.up + p.body_radius + p.site_altitude


def _axis(p: Any, m: Any) -> tuple[Any, Any, Any]:
    return 0.0, m.cos(p.site_latitude), m.sin(p.site_latitude)


def _dynamics(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    velocity = (x.v_east, x.v_north, x.v_up)
    acceleration = combine(
        (1, free_acceleration(_centre_to(x, p), velocity, _axis(p, m), p, m)),
        (thrust(u, p) / x.m, (u.toward_east, u.toward_north, u.toward_up)),
    )
    return (*velocity, *acceleration, mass_rate(u, p))


def _start(p: Any, m: Any) -> Sequence[Any]:
    position = (p.approach_east, p.approach_north, p.approach_up)
    return (*position, p.approach_east_speed, p.approach_north_speed, p.approach_up_speed, p.vehicle_mass)


def _touchdown(x: Any, p: Any, m: Any) -> Sequence[Any]:
    return x.east, x.north, x.up, x.v_east, x.v_north, x.v_up


def _above_slope(x: Any, p: Any, m: Any) -> Any:
    a = p.corridor_pad_radius
    return x.up - m.tan(p.corridor_slope) * (m.sqrt(x.east * x.east + x.north * x.north + a * a) - a)


def _in_corridor(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    return _above_slope(x, p, m), u.toward_up - m.cos(p.corridor_tilt)


def _falls_in_corridor(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    return (_above_slope(x, p, m),)


def _above_ground(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    return (x.up,)


def _spent(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    pull = apparent_gravity(_centre_to(x, p), _axis(p, m), p, m)
    direction = (u.toward_east, u.toward_north, u.toward_up)
    return spent((x.v_east, x.v_north, x.v_up), thrust(u, p) / x.m, direction, pull, m)


def _inertial(x: Any, u: Any, t: Any, p: Any, m: Any) -> Sequence[Any]:
    up, north, east = local_axes(p.site_longitude, p.site_latitude, m)
    vectors = (_centre_to(x, p), (x.v_east, x.v_north, x.v_up), (u.toward_east, u.toward_north, u.toward_up))
    position, velocity, direction = (combine((a, east), (b, north), (c, up)) for a, b, c in vectors)
    return seen_inertially(position, velocity, combine((thrust(u, p) / x.m, direction)), t, p, m)


def _track(x: Any, p: Any, m: Any) -> Sequence[Any]:
    """Along the line from the start to the site, left of it, height; the least height on the glide slope there.

    From straight above the site the line is to the east. Without a corridor there is no least height.
    """
    none = 1e-300  # m: below any distance
    away = m.sqrt(p.approach_east * p.approach_east + p.approach_north * p.approach_north)
    east = -p.approach_east / m.fmax(away, none) + (1 - m.fmin(away / none, 1.0))
    north = -p.approach_north / m.fmax(away, none)
    floor = (x.up - _above_slope(x, p, m),) if hasattr(p, "corridor_slope") else ()
    return east * x.east + north * x.north, east * x.north - north * x.east, x.up, *floor


_VIEWS = Views(
    histories=(
        History(name="mass", quantities=("m",), caption="Mass"),
        History(name="velocities", quantities=("v_east", "v_north", "v_up"), caption="Velocity relative to the body"),
        History(name="steering", quantities=("thrust_tilt", "throttle"), caption="Thrust direction, and throttle"),
    ),
    height="up",
    radius="body_radius",
    frame=INERTIAL_AXES,
)
# What of the burn holds, or means something, in a free fall as well.
_WITHOUT_THRUST = {
    "path_conditions": ("height_above_glide_slope", "height_above_site"),
    "output_variables": ("thrust_acceleration",),
}


def _outputs(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    horizontal = m.sqrt(u.toward_east * u.toward_east + u.toward_north * u.toward_north)
    return m.atan2(horizontal, u.toward_up), thrust(u, p) / x.m


def _minus_landed_mass(x: Any, p: Any, m: Any) -> Any:
    return -x.m


def _typical_end(p: Any, m: Any) -> Sequence[Any]:
    return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8 * p.vehicle_mass


def _preflight(p: Any, m: Any, *, body: Body = MOON) -> tuple[Finding, ...]:
    """Bounds of `perilune.models.limits`, the glide slope at the start, and the throttle's floor."""
    r_site, axis = p.body_radius + p.site_altitude, _axis(p, m)
    start = SimpleNamespace(east=p.approach_east, north=p.approach_north, up=p.approach_up)
    position, velocity = _centre_to(start, p), (p.approach_east_speed, p.approach_north_speed, p.approach_up_speed)
    found = [above_site(p.approach_up, 0.0)]
    found += [thrust_against_weight(p.site_altitude, p), *engine_holds_dry_mass(r_site, p, m)]
    if hasattr(p, "corridor_slope"):
        if not hasattr(p, "approach_longest_coast"):  # with its engine off it comes down all the same
            found.append(_throttle_floor(p, m))
        found.append(_above_slope_at_start(start, p, m))
    found.append(stopping_distance(position, velocity, axis, r_site, p, m))
    if hasattr(p, "vehicle_dry_mass"):
        found.append(propellant_stops(position, velocity, axis, r_site, p, m))
    return (*found, *air_left_out(body))


def _above_slope_at_start(start: Any, p: Any, m: Any) -> Finding:
    return Finding(
        name="height above the glide slope",
        value=_above_slope(start, p, m),
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
    centre = (0.0, 0.0, p.body_radius + p.site_altitude)
    weight = -free_acceleration(centre, (0.0, 0.0, 0.0), _axis(p, m), p, m)[2]
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


def _ranges(p: Any, m: Any) -> dict[str, tuple[float, float, float]]:
    """Bounds and orders of magnitude of the times."""
    ranges = {"flight_time": (0.0, math.inf, _typical_time(p))}
    if hasattr(p, "approach_longest_coast"):
        ranges[FREE.name] = coast_range(p.approach_longest_coast)
    return ranges


def _phase(*, dry: bool, corridor: bool) -> Phase:
    path, conditions = _above_ground, variables("m", "height_above_site")
    if corridor:
        margin = Variable(
            name="pointing_margin", description="cosine of the thrust's tilt less that of corridor.tilt"
        )  # fmt: skip
        path, conditions = _in_corridor, (*variables("m", "height_above_glide_slope"), margin)
    return Phase(
        name="landing",
        states=(
            *variables("m", "east", "north", "up"),
            Variable(name="v_east", unit="m/s", label="east"),
            Variable(name="v_north", unit="m/s", label="north"),
            Variable(name="v_up", unit="m/s", label="up"),
            mass_state(dry),
        ),
        controls=(Direction(names=("toward_east", "toward_north", "toward_up")), THROTTLE),
        dynamics=_dynamics,
        duration="flight_time",
        end=_touchdown,
        end_conditions=(
            *variables("m", "site_east", "site_north", "site_up"),
            *variables("m/s", "rest_east", "rest_north", "rest_up"),
        ),
        path=path,
        path_conditions=conditions,
        outputs=_outputs,
        output_variables=(
            Variable(name="thrust_tilt", unit="rad", description="of the thrust from the vertical", label="tilt"),
            *variables("m/s^2", "thrust_acceleration"),
        ),
        integrals=_spent,
        integral_variables=SPENT,
        inertial=_inertial,
        track=_track,
        typical_end=_typical_end,
    )


def precision_landing(
    vehicle: Vehicle,
    approach: Approach,
    site: Site,
    corridor: Corridor | None,
    throttle: tuple[float, float],
    body: Body = MOON,
    *,
    dry_mass: float | None = None,
    j2: float = 0.0,
) -> Problem:
    """Landing on a named point with the least propellant, within a corridor.

    Parameters
    ----------
    vehicle, approach, site, corridor, body
        The lander, where it begins, where it lands, what it must keep to (None: the ground alone), and on what body.
    throttle
        Least and greatest share of full thrust.
    dry_mass
        The vehicle's dry mass [kg], where it is not stated in its record.
    j2
        Second zonal harmonic of the body, unnormalised.

    Returns
    -------
    Problem
        States east, north, up [m], v_east, v_north, v_up [m/s], m [kg]; free `flight_time` [s], and `coast_time` [s]
        before it where the approach has a `longest_coast`; J = -m(t_f) [kg].

    Raises
    ------
    PeriluneError
        If the given values make no sense together. What physics forbids, `Problem.preflight` says.
    """
    demand_records((vehicle, Vehicle), (approach, Approach), (site, Site), (body, Body))
    lander, shares = with_dry_mass(vehicle, dry_mass), Throttle(lower=throttle[0], upper=throttle[1])
    stated = [oblate(body, j2), lander, site, approach, shares]
    if corridor is not None:
        stated.insert(4, corridor)
    given, coasts = given_of(*stated), approach.longest_coast is not None
    time = _ranges(SimpleNamespace(**{name: g.value for name, g in given.items()}), NUMERIC)["flight_time"][2]
    way = math.hypot(approach.east, approach.north, approach.up)
    burn = _phase(dry="vehicle_dry_mass" in given, corridor=corridor is not None)
    falls = _above_ground if corridor is None else _falls_in_corridor
    return Problem(
        name="precision_landing",
        title=f"{vehicle.mass:g} kg lander, {way / 1e3:.3g} km from its site on {body.titled}",
        phases=with_coast(burn, falls, _WITHOUT_THRUST) if coasts else (burn,),
        links=(at_ignition,) if coasts else (),
        start=_start,
        given=given,
        free=(Free(name="flight_time", unit="s"), *((FREE,) if coasts else ())),
        objective=_minus_landed_mass,
        objective_unit="kg",
        results=landing,
        result_variables=(*LANDING, COAST_TIME) if coasts else LANDING,
        maximised=LANDED_MASS.name,
        declared=tuple(stated),
        ranges=_ranges,
        preflight=partial(_preflight, body=body),
        views=_VIEWS if corridor is None else replace(_VIEWS, floor="glide slope"),
        scales=Scales(length=way or 1.0, time=time, mass=float(vehicle.mass)),
    )


def _typical_time(p: Any) -> float:
    """Time in which the mean of start and end speed covers the way, or a fall from rest does."""
    way = math.hypot(p.approach_east, p.approach_north, p.approach_up)
    speed = math.hypot(p.approach_east_speed, p.approach_north_speed, p.approach_up_speed)
    height = abs(p.approach_up) or way or 1.0  # on its site, which the pre-flight refuses
    gravity = p.body_gravitational_parameter / p.body_radius**2
    fall = math.sqrt(2 * height / gravity)
    if hasattr(p, "approach_longest_coast"):
        speed = math.hypot(speed, gravity * fall)  # which it gains before ignition
    return min(2 * way / speed, 3 * fall) if speed * way > 0 else 2 * fall
