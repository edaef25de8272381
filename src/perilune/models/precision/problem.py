"""Precision landing: the last kilometres, with a throttle range, a pointing limit and a glide slope.

Frame: east, north, up at the landing site (`perilune.models.precision.ground`, over a round body or flat ground).

    r'' = g + (throttle T/m) d - 2 Omega x r' - Omega x (Omega x r),   m' = -throttle T/(Isp g0)

What is kept to on the way is in `perilune.models.precision.path_constraints`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

from perilune.core import NUMERIC, PeriluneError, Scales, check_call, quantity, record, require_records
from perilune.models.descent.coordinates import descent_thrust, mass_rate, variables_of_unit
from perilune.models.descent.problem import SPEED, Site, refuse_unplaced, with_dry_mass
from perilune.models.landing.problem import mass_state
from perilune.models.physics.bodies import MOON, Body, UniformGravity, catalogue_name, with_j2
from perilune.models.physics.coast import COAST_TIME, FREE, LONGEST, at_ignition, coast_range, with_coast
from perilune.models.physics.delta_v_bounds import gravity_at
from perilune.models.physics.delta_v_budget import LANDED_MASS, LANDING, SPENT, landing_results, velocity_loss_rates
from perilune.models.physics.rotating_frame import INERTIAL_AXES, combine
from perilune.models.physics.vehicle import THROTTLE, Throttle, Vehicle
from perilune.models.precision.final_descent import (
    FINAL_TIME,
    GATE_TIME,
    TIMES,
    FinalDescent,
    at_gate,
    final_ranges,
    with_final_descent,
)
from perilune.models.precision.ground import ground_free_acceleration, inertial_over_round_body
from perilune.models.precision.path_constraints import (
    NONE,
    Corridor,
    above_slope,
    corridor_conditions,
    corridor_margins,
    height_margins,
)
from perilune.models.precision.presolve import compare_precision
from perilune.problem import (
    Conditions,
    FreeParameter,
    Phase,
    Problem,
    Quantities,
    UnitVectorControl,
    Variable,
    given_of,
    views,
)


@record("approach")
class Approach:
    """State at the begin of a precision landing: position and velocity relative to the site."""

    east: float = quantity("m", "-1800 m", about="position from the site")
    north: float = quantity("m", "300 m", about="position from the site")
    up: float = quantity("m", "1 km", about="height above the site")
    east_speed: float = quantity("m/s", "50 m/s", **SPEED, default=0.0, about="relative to the site")
    north_speed: float = quantity("m/s", "0 m/s", **SPEED, default=0.0, about="relative to the site")
    up_speed: float = quantity("m/s", "-30 m/s", **SPEED, default=0.0, about="negative in descent")
    longest_coast: float | None = LONGEST


def _precision_dynamics(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    velocity = (x.v_east, x.v_north, x.v_up)
    acceleration = combine(
        (1, ground_free_acceleration(x, velocity, p, xp)),
        (descent_thrust(u, p) / x.m, (u.toward_east, u.toward_north, u.toward_up)),
    )
    return (*velocity, *acceleration, mass_rate(u, p))


def _approach_state(p: Any, xp: Any) -> Sequence[Any]:
    position = (p.approach_east, p.approach_north, p.approach_up)
    return (*position, p.approach_east_speed, p.approach_north_speed, p.approach_up_speed, p.vehicle_mass)


def _site_touchdown(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    return x.east, x.north, x.up, x.v_east, x.v_north, x.v_up


def _precision_loss_rates(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    pull = ground_free_acceleration(x, (0.0, 0.0, 0.0), p, xp)
    direction = (u.toward_east, u.toward_north, u.toward_up)
    return velocity_loss_rates((x.v_east, x.v_north, x.v_up), descent_thrust(u, p) / x.m, direction, pull, xp)


def _approach_track(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Return the distances along the line from start to site and left of it, height, and the glide slope's height.

    From straight above the site the line is to the east. Without a glide slope there is no least height.
    """
    none = 1e-300  # m: below any distance
    away = xp.sqrt(p.approach_east * p.approach_east + p.approach_north * p.approach_north)
    east = -p.approach_east / xp.fmax(away, none) + (1 - xp.fmin(away / none, 1.0))
    north = -p.approach_north / xp.fmax(away, none)
    floor = (x.up - above_slope(x, p, xp),) if hasattr(p, "corridor_slope") else ()
    return east * x.east + north * x.north, east * x.north - north * x.east, x.up, *floor


_VIEWS = views.Views(
    histories=(
        views.History(name="mass", quantities=("m",), caption="Mass"),
        views.History(
            name="velocities", quantities=("v_east", "v_north", "v_up"), caption="Velocity relative to the body"
        ),
        views.History(
            name="steering", quantities=("thrust_tilt", "throttle"), caption="Thrust direction, and throttle"
        ),
    ),
    height="up",
    radius="body_radius",
    frame=INERTIAL_AXES,
)
# What of the burn holds, or means something, in a free fall as well.
_WITHOUT_THRUST = {
    "path": ("height_above_glide_slope", "height_above_gate", "height_above_site"),
    "outputs": ("thrust_acceleration",),
}


def _precision_outputs(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    horizontal = xp.sqrt(u.toward_east * u.toward_east + u.toward_north * u.toward_north)
    return xp.atan2(horizontal, u.toward_up), descent_thrust(u, p) / x.m


def _precision_objective(x: Any, p: Any, xp: Any) -> Any:
    return -x.m


def _precision_end_guess(p: Any, xp: Any) -> Sequence[Any]:
    return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8 * p.vehicle_mass


def _precision_ranges(p: Any, xp: Any) -> dict[str, tuple[float, float, float]]:
    """Bounds and orders of magnitude of the times."""
    ranges = {_FLIGHT_TIME.name: (0.0, math.inf, _typical_approach_time(p))}
    if hasattr(p, "final_height"):
        ranges = final_ranges(p, _typical_approach_time(p))
    if hasattr(p, "approach_longest_coast"):
        ranges[FREE.name] = coast_range(p.approach_longest_coast)
    return ranges


_FLIGHT_TIME = FreeParameter(name="flight_time", unit="s")


def _approach_burn(corridor: Corridor, *, dry: bool, flat: bool) -> Phase:
    """Return the phase from ignition to rest on the site."""
    return Phase(
        name="landing",
        states=(
            *variables_of_unit("m", "east", "north", "up"),
            Variable(name="v_east", unit="m/s", label="east"),
            Variable(name="v_north", unit="m/s", label="north"),
            Variable(name="v_up", unit="m/s", label="up"),
            mass_state(dry),
        ),
        controls=(UnitVectorControl(names=("toward_east", "toward_north", "toward_up")), THROTTLE),
        dynamics=_precision_dynamics,
        duration=_FLIGHT_TIME.name,
        end=Conditions(
            _site_touchdown,
            site_east="m",
            site_north="m",
            site_up="m",
            rest_east="m/s",
            rest_north="m/s",
            rest_up="m/s",
        ),
        path=Conditions(corridor_margins, *corridor_conditions(corridor)),
        outputs=Quantities(
            _precision_outputs,
            Variable(name="thrust_tilt", unit="rad", description="of the thrust from the vertical", label="tilt"),
            thrust_acceleration="m/s^2",
        ),
        integrals=Quantities(_precision_loss_rates, *SPENT),
        inertial=None if flat else inertial_over_round_body,
        track=_approach_track,
        end_guess=_precision_end_guess,
    )


@check_call
def precision_landing(
    vehicle: Vehicle,
    approach: Approach,
    site: Site | None,
    corridor: Corridor | None,
    throttle: tuple[float, float],
    body: Body | UniformGravity = MOON,
    *,
    final: FinalDescent | None = None,
    dry_mass: float | None = None,
    j2: float = 0.0,
) -> Problem:
    """Landing on a named point with the least propellant, within a corridor.

    Parameters
    ----------
    vehicle, approach, site, corridor, body
        The lander, where it begins, where it lands, what it must keep to (None: only the ground), and on what body.
        Flat ground (`UniformGravity`) is everywhere the same: there the site is None.
    throttle
        Least and greatest fraction of full thrust.
    final
        A vertical, upright end of the landing; None comes to rest on the site from anywhere.
    dry_mass
        The vehicle's dry mass [kg], where it is not stated in its record.
    j2
        Second zonal harmonic of a round body, unnormalised.

    Returns
    -------
    Problem
        States east, north, up [m], v_east, v_north, v_up [m/s], m [kg]; free `flight_time` [s], and `coast_time` [s]
        before it where the approach has a `longest_coast`; where there is a final descent, `gate_time` and `final_time`
        [s] in its place. J = -m(t_f) [kg].

    Raises
    ------
    PeriluneError
        If the given values make no sense together. What physics forbids, `Problem.preflight` says.
    """
    corridor = NONE if corridor is None else corridor
    require_records((vehicle, Vehicle), (approach, Approach), (corridor, Corridor))
    lander, shares = with_dry_mass(vehicle, dry_mass), Throttle(lower=throttle[0], upper=throttle[1])
    stated = (
        *_ground_records(body, site, j2),
        lander,
        approach,
        corridor,
        shares,
        *(() if final is None else (final,)),
    )
    given, flat = given_of(*stated), isinstance(body, UniformGravity)
    if corridor.slope is None:
        del given["corridor_pad_radius"]  # it is the tip of nothing
    ranges = _precision_ranges(SimpleNamespace(**{name: g.value for name, g in given.items()}), NUMERIC)
    way = math.hypot(approach.east, approach.north, approach.up)
    burn = _approach_burn(corridor, dry="vehicle_dry_mass" in given, flat=flat)
    phases, links, free = (burn,), (), (_FLIGHT_TIME,)
    if final is not None:
        phases, links, free = with_final_descent(burn, corridor), (at_gate,), (GATE_TIME, FINAL_TIME)
    if approach.longest_coast is not None:
        fall = with_coast(phases[0], height_margins, _WITHOUT_THRUST)
        phases, links, free = (*fall, *phases[1:]), (at_ignition, *links), (*free, FREE)
    views = _precision_views(body)
    return Problem(
        name="precision_landing",
        title=f"{vehicle.mass:g} kg lander, {way / 1e3:.3g} km from its site on {body.heading}",
        phases=phases,
        links=links,
        start=_approach_state,
        given=given,
        free=free,
        objective=_precision_objective,
        objective_unit="kg",
        results=Quantities(
            landing_results, *LANDING, *(v for v in (COAST_TIME, *TIMES) if v.name in {f.name for f in free})
        ),
        maximised=LANDED_MASS.name,
        records=stated,
        parameter_bounds=_precision_ranges,
        preflight=partial(compare_precision, body=body),
        views=views if corridor.slope is None else replace(views, floor="glide slope"),
        scales=Scales(length=way or 1.0, time=ranges[free[0].name][2], mass=float(vehicle.mass)),
    )


_FAR = 10e3  # m
# On the Moon the ground falls by d^2/(2 R) = 29 m over this distance, and gravity by 2 h/R = 1.1 % over this height.
_FLAT = tuple(
    views.ValidRange(
        quantity=name,
        lower=-math.inf if name == "up" else -_FAR,
        upper=_FAR,
        title="height" if name == "up" else f"distance {name}",
        because="flat ground and uniform gravity, which are valid within some 10 km of the site (on the Moon the"
        " ground "
        "curves away by 29 m over them, and gravity falls by 1 % above them); state a round body instead",
    )
    for name in ("east", "north", "up")
)


def _precision_views(body: Body | UniformGravity) -> views.Views:
    """The views; flat ground is nowhere in space."""
    if isinstance(body, UniformGravity):
        return replace(_VIEWS, radius="", frame="", meant_for=_FLAT)
    return replace(_VIEWS, space=views.Space(body=catalogue_name(body), rotation="body_rotation_rate"))


def _ground_records(body: Body | UniformGravity, site: Site | None, j2: float) -> tuple[Any, ...]:
    """The records that state where the site is."""
    if not isinstance(body, UniformGravity):
        if site is None:
            raise PeriluneError(
                "site is missing",
                expected="the place on the body where the landing ends: a section [site], or Site(...)",
                advice="only flat ground (body.gravity) is the same everywhere",
            )
        require_records((site, Site), (body, Body))
        refuse_unplaced(site)
        return with_j2(body, j2), site
    if site is not None or j2:
        raise PeriluneError(
            "flat ground has no longitude, latitude or oblateness",
            got="a site in addition to body.gravity"
            if site is not None
            else f"j2 = {j2:g} in addition to body.gravity",
            expected="only uniform gravity; positions are relative to the site",
            advice="omit the site ([site], or site=None), or state a round body in place of body.gravity",
        )
    return (body,)


def _typical_approach_time(p: Any) -> float:
    """Time in which the mean of start and end speed covers the way, or a fall from rest does."""
    way = math.hypot(p.approach_east, p.approach_north, p.approach_up)
    speed = math.hypot(p.approach_east_speed, p.approach_north_speed, p.approach_up_speed)
    height = abs(p.approach_up) or way or 1.0  # on its site, which the pre-flight refuses
    gravity = gravity_at(getattr(p, "body_radius", 0.0), p)
    fall = math.sqrt(2 * height / gravity)
    if hasattr(p, "approach_longest_coast"):
        speed = math.hypot(speed, gravity * fall)  # which it gains before ignition
    return min(2 * way / speed, 3 * fall) if speed * way > 0 else 2 * fall
