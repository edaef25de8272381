"""Powered descent in three dimensions to a place on a rotating body: Peng, Li, Shen, Tang 2012, section 4.

From a state over the body to rest at a named site, anywhere on the great circle towards it, or anywhere. With
constant thrust, as in the paper, minimum time (19) is maximum landed mass (29), and the two objectives differ
in the costates only. The coordinates, and the equations in them, are those of
`perilune.models.descent.coordinates`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np

from perilune.core import (
    NUMERIC,
    PeriluneError,
    Physics,
    Scales,
    check_call,
    comparison_fails,
    quantity,
    record,
    require_records,
    span,
    text_field,
)
from perilune.models.descent.cartesian import CARTESIAN, steered_path
from perilune.models.descent.coordinates import AXIS, OUTPUTS, variables_of_unit
from perilune.models.descent.rough_landing import rough_landing
from perilune.models.descent.spherical import SPHERICAL
from perilune.models.landing.problem import mass_state
from perilune.models.physics.bodies import MOON, Body, catalogue_name, with_j2
from perilune.models.physics.coast import COAST_TIME, FREE, LONGEST, at_ignition, coast_range, with_coast
from perilune.models.physics.delta_v_bounds import (
    SLACK,
    braking_distance_and_time,
    compare_dry_mass,
    compare_late_ignition,
    compare_neglected_air,
    compare_propellant,
    compare_start_height,
    compare_stopping_distance,
    compare_thrust_and_weight,
    largest_mass_stopped,
    longest_burn,
    speed_of_ground,
    speed_to_lose,
    velocity_change,
)
from perilune.models.physics.delta_v_budget import FLIGHT_TIME, LANDED_MASS, LANDING, SPENT, landing_results
from perilune.models.physics.one_burn import one_burn_wastes
from perilune.models.physics.rotating_frame import INERTIAL_AXES, local_axes, scalar_product
from perilune.models.physics.vehicle import THROTTLE, Throttle, Vehicle
from perilune.problem import (
    Conditions,
    Control,
    Finding,
    FreeParameter,
    Parameter,
    Phase,
    Problem,
    Quantities,
    ScalarControl,
    UnitVectorControl,
    given_of,
    views,
)

_FRAMES = {"cartesian": CARTESIAN, "spherical": SPHERICAL}

SPEED: dict[str, Any] = {"least": -1e5, "most": 1e5, "hint": "check for km/s in place of m/s"}
_TURNS: dict[str, Any] = {"least": -4 * math.pi, "most": 4 * math.pi}
_LATITUDE: dict[str, Any] = {
    "least": -0.5 * math.pi - 1e-12,
    "most": 0.5 * math.pi + 1e-12,
    "outside": "lies beyond the pole",
    "hint": "is it in radians, and are longitude and latitude exchanged?",
    "about": "north",
}

_VIEWS = views.Views(
    histories=(
        views.History(name="altitude", quantities=("altitude",), caption="Altitude"),
        views.History(name="mass", quantities=("m",), caption="Mass"),
        views.History(
            name="velocities",
            quantities=("forward_speed", "sideways_speed", "vertical_speed"),
            caption="Velocity relative to the body",
        ),
        views.History(
            name="steering",
            quantities=("thrust_elevation", "thrust_azimuth", "throttle"),
            caption="Thrust direction, and throttle where there is one",
        ),
    ),
    height="altitude",
    radius="body_radius",
    frame=INERTIAL_AXES,
)
_SPACE = views.Space(rotation="body_rotation_rate", longitude="longitude", latitude="latitude", height="altitude")


# What of the burn holds, or means something, in a free fall as well.
_WITHOUT_THRUST = {
    "path": ("height_above_site",),
    "outputs": tuple(v.name for v in OUTPUTS if v.name not in ("thrust_elevation", "thrust_azimuth")),
}


@record("problem")
class Choices:
    """Choices of coordinates, target and objective of a descent."""

    coordinates: str = text_field(
        "cartesian", *_FRAMES, default="cartesian",
        about="cartesian; or spherical: that of the paper, singular over a pole, for the direct method",
    )  # fmt: skip
    target: str = text_field(
        "site", *CARTESIAN.ends, default="site",
        about="site, downrange (on the great circle towards it) or anywhere, at its altitude",
    )  # fmt: skip
    minimise: str = text_field(
        "propellant", "propellant", "flight_time", default="propellant",
        about="propellant or flight_time; equivalent at constant thrust",
    )  # fmt: skip


@record("start")
class Ignition:
    """State at the begin of the powered descent, relative to the turning body."""

    altitude: float = quantity("m", "15 km", about="above the body's radius")
    longitude: float = quantity(
        "rad", "0 deg", **_TURNS, about="east; over a pole it states the meridian from which the heading is measured"
    )  # fmt: skip
    latitude: float = quantity("rad", "90 deg", **_LATITUDE)
    heading: float = quantity(
        "rad", "180 deg", **_TURNS, hint="from north towards east", about="of oy, from north towards east"
    )  # fmt: skip
    forward_speed: float = quantity("m/s", "1694.3 m/s", **SPEED, about="along oy, at the heading")
    sideways_speed: float = quantity("m/s", "0 m/s", **SPEED, default=0.0, about="along oz, up x oy")
    vertical_speed: float = quantity("m/s", "0 m/s", **SPEED, default=0.0, about="up")
    longest_coast: float | None = LONGEST


@record("site")
class Site:
    """Site at which the flight ends at rest."""

    altitude: float = quantity("m", "2 km", default=0.0, about="above the body's radius")
    longitude: float | None = quantity(
        "rad", "5 deg", default=None, **_TURNS, about='east; needed unless target = "anywhere"'
    )  # fmt: skip
    latitude: float | None = quantity(
        "rad", "76 deg", default=None, **{**_LATITUDE, "about": 'north; needed unless target = "anywhere"'}
    )  # fmt: skip

    def __post_init__(self) -> None:
        if (self.longitude is None) != (self.latitude is None):
            refuse_unplaced(self)


def refuse_unplaced(site: Site, advice: str = "state both of them, as `perilune new` writes them") -> None:
    """Refuse a site without a longitude or a latitude.

    Parameters
    ----------
    site
        Its longitude and latitude are None where not stated.
    advice
        Last words of the message.

    Raises
    ------
    PeriluneError
        If one of them is missing.
    """
    for name in ("longitude", "latitude"):
        if getattr(site, name) is None:
            raise PeriluneError(
                f"site.{name} is missing", expected="site.longitude and site.latitude of the place", advice=advice
            )


@record("steering")
class Steering:
    """Bounds of the thrust's elevation alpha and azimuth beta [rad], Peng et al. (24)."""

    elevation: tuple[float, float] = span(
        "rad", "-50 deg", "50 deg", default=(-0.5 * math.pi, 0.5 * math.pi), name="the thrust's elevation",
        about="angle of the thrust above the horizon",
    )  # fmt: skip
    azimuth: tuple[float, float] = span(
        "rad", "150 deg", "220 deg", default=(0.0, 2 * math.pi), name="the thrust's azimuth",
        about="angle of the thrust from oy towards oz",
    )  # fmt: skip


def _propellant_objective(x: Any, p: Any, xp: Any) -> Any:
    """Peng et al. (29): H = 0 along the optimum."""
    return -x.m


def _time_objective(x: Any, p: Any, xp: Any) -> Any:
    """Peng et al. (19): H = -1 along the optimum."""
    return p.flight_time


def _compare_descent(
    p: Any, xp: Any, *, to_site: bool, waits: bool = False, burns_once: bool = False, body: Body = MOON
) -> tuple[Finding, ...]:
    """Bounds of `perilune.models.physics.delta_v_bounds`, and how far the propellant reaches."""
    r_site = p.body_radius + p.site_altitude
    position, velocity = CARTESIAN.start(p, xp)[:3], CARTESIAN.start(p, xp)[3:6]
    found = [compare_start_height(p.start_altitude, p.site_altitude), compare_thrust_and_weight(r_site, p)]
    found += compare_dry_mass(largest_mass_stopped(r_site, p, xp), p)
    found.append(compare_stopping_distance(position, velocity, AXIS, r_site, p, xp))
    if hasattr(p, "vehicle_dry_mass"):
        found.append(compare_propellant(position, velocity, AXIS, r_site, p, xp))
        if to_site and not hasattr(p, "throttle_lower") and not hasattr(p, "start_longest_coast"):
            found.append(_compare_reach(position, velocity, r_site, p, xp))
    if waits:
        found.append(compare_late_ignition(position, velocity, p, xp))
    if burns_once:
        found.append(one_burn_wastes(position, velocity, AXIS, r_site, p, xp))
    return (*found, *compare_neglected_air(body))


def _compare_reach(position: Any, velocity: Any, r_site: Any, p: Any, xp: Any) -> Finding:
    """Compare the distance to the site with that of a burn at full thrust, which ends with the propellant.

    The speed w of `perilune.models.physics.delta_v_bounds` gains and loses at most the velocity change B that all
    propellant gives, and ends at the speed of the ground, so that it never exceeds (w(0) + w(t_f) + B)/2; the ground
    moves as well.
    """
    start, site = (local_axes(*where, xp)[0] for where in (
        (p.start_longitude, p.start_latitude), (p.site_longitude, p.site_latitude)
    ))  # fmt: skip
    way = r_site * xp.acos(xp.fmin(1.0, xp.fmax(-1.0, scalar_product(start, site))))
    to_lose, ground = speed_to_lose(position, velocity, AXIS, r_site, p, xp), speed_of_ground(r_site, p, xp)
    fastest = 0.5 * (to_lose + 2 * ground + velocity_change(p, xp)) + ground
    return Finding(
        name="distance to the site",
        value=way / 1e3,
        limit=SLACK * longest_burn(p) * fastest / 1e3,
        at_least=False,
        unit="km",
        binding=True,
        meaning="the site cannot be reached with this propellant",
        advice="a nearer site, more propellant, or the target 'downrange' or 'anywhere'",
    )


def _descent_ranges(p: Any, xp: Any) -> dict[str, tuple[float, float, float]]:
    """Bounds and orders of magnitude of the times; refuses given values that make no sense together."""
    if comparison_fails(xp.fmin(p.site_altitude, p.start_altitude) > -p.body_radius):
        raise PeriluneError(
            "an altitude lies below the centre of the body", expected=f"above {np.max(-p.body_radius):g} m"
        )
    speed = xp.sqrt(p.start_forward_speed**2 + p.start_sideways_speed**2 + p.start_vertical_speed**2)
    # To stop the whole speed (rocket equation), and part of the time to drop the height by burns down and up.
    _, stop = braking_distance_and_time(speed, p, xp)
    drop = xp.sqrt(xp.fabs(p.start_altitude - p.site_altitude) * p.vehicle_mass / p.vehicle_thrust)
    longest = math.inf if hasattr(p, "throttle_lower") else longest_burn(p)
    ranges = {"flight_time": (0.0, longest, xp.fmin(stop + drop, 0.9 * longest_burn(p)))}
    if hasattr(p, "start_longest_coast"):
        ranges[FREE.name] = coast_range(p.start_longest_coast)
    return ranges


def _descent_controls(coordinates: str, throttled: bool) -> tuple[Control, ...]:
    controls: tuple[Control, ...] = (UnitVectorControl(names=("toward_x", "toward_y", "toward_z")),)
    if coordinates == "spherical":
        controls = tuple(
            ScalarControl(name=name, unit="rad", lower=f"steering_{angle}_lower", upper=f"steering_{angle}_upper")
            for name, angle in (("alpha", "elevation"), ("beta", "azimuth"))
        )
    return (*controls, THROTTLE) if throttled else controls


def _descent_phase(
    coordinates: str, target: str, steering: Steering | None, controls: tuple[Control, ...], *, dry: bool
) -> Phase:
    frame = _FRAMES[coordinates]
    end, end_conditions = frame.ends[target]
    path, path_conditions = frame.path, variables_of_unit("m", "height_above_site")
    if coordinates == "cartesian" and steering is not None:
        path = steered_path
        path_conditions += variables_of_unit("1", "elevation_above_lower", "elevation_below_upper")
        path_conditions += variables_of_unit("rad", "azimuth_above_lower", "azimuth_below_upper")
    return Phase(
        name="descent",
        states=(*frame.states, mass_state(dry)),
        controls=controls,
        dynamics=frame.dynamics,
        duration="flight_time",
        end=Conditions(end, *end_conditions),
        path=Conditions(path, *path_conditions),
        outputs=Quantities(frame.outputs, *OUTPUTS),
        integrals=Quantities(frame.spent, *SPENT),
        inertial=frame.inertial,
        track=frame.track,
        end_guess=frame.end_guess,
    )


def with_dry_mass(vehicle: Vehicle, dry_mass: float | None) -> Vehicle:
    """Return the vehicle with a separately stated dry mass, if there is one.

    Parameters
    ----------
    vehicle
        The vehicle as declared.
    dry_mass
        Mass without propellant [kg]; None where not stated.
    """
    return vehicle if dry_mass is None else replace(vehicle, dry_mass=dry_mass)


def _ranges_of_given(given: Mapping[str, Parameter], ranges: Physics) -> Any:
    return ranges(SimpleNamespace(**{name: g.value for name, g in given.items()}), NUMERIC)


def _scales(start: Ignition, vehicle: Vehicle, ranges: Mapping[str, tuple[float, float, float]]) -> Scales:
    time = float(ranges["flight_time"][2]) or 1.0  # at rest at its site, which the pre-flight refuses
    speed = max(math.hypot(start.forward_speed, start.sideways_speed, start.vertical_speed), abs(start.altitude) / time)
    return Scales(length=(speed or 1.0) * time, time=time, mass=float(vehicle.mass))


@check_call
def powered_descent(
    vehicle: Vehicle,
    start: Ignition,
    site: Site,
    body: Body = MOON,
    *,
    coordinates: Literal["cartesian", "spherical"] = "cartesian",
    target: Literal["site", "downrange", "anywhere"] = "site",
    steering: Steering | None = None,
    throttle: tuple[float, float] | None = None,
    minimise: Literal["propellant", "flight_time"] = "propellant",
    dry_mass: float | None = None,
    j2: float = 0.0,
) -> Problem:
    """Powered descent of Peng et al. (17)-(24).

    Parameters
    ----------
    vehicle, start, site, body
        The lander, where the burn begins, where it ends at rest, and on what body. A site without longitude and
        latitude is only for the target ``"anywhere"``.
    coordinates
        ``"cartesian"`` (thrust direction free on the sphere; no singular point) or ``"spherical"`` (the
        paper's; bounded angles; singular at the poles).
    target
        ``"site"``; ``"downrange"``: anywhere on the great circle from the point under the start to the site,
        at the site's altitude; ``"anywhere"`` at that altitude.
    steering
        Bounds of elevation and azimuth (24); in Cartesian coordinates they are path conditions.
    throttle
        Least and greatest fraction of full thrust; None is constant full thrust.
    minimise
        ``"propellant"``: J = -m(t_f) (29); ``"flight_time"``: J = t_f (19).
    dry_mass
        The vehicle's dry mass [kg], where it is not stated in its record.
    j2
        Second zonal harmonic of the body, unnormalised.

    Returns
    -------
    Problem
        States and units as in `perilune.models.descent.coordinates`; free `flight_time` [s], and `coast_time` [s]
        before it where the start has a `longest_coast`. Parameters are named like the scenario's keys with ``_`` for
        the dot.

    Raises
    ------
    PeriluneError
        If the given values make no sense together. What physics forbids, `Problem.preflight` says.
    """
    require_records((vehicle, Vehicle), (start, Ignition), (site, Site), (body, Body))
    choices = Choices(coordinates=coordinates, target=target, minimise=minimise)
    if target != "anywhere":
        refuse_unplaced(site, 'state both of them, or the target "anywhere" for any place at site.altitude')
    stated = [with_j2(body, j2), with_dry_mass(vehicle, dry_mass), start, site]
    if steering is not None or coordinates == "spherical":
        stated.append(steering or Steering())
    if throttle is not None:
        stated.append(Throttle(lower=throttle[0], upper=throttle[1]))
    given = given_of(*stated)
    controls = _descent_controls(coordinates, throttle is not None)
    burn = _descent_phase(coordinates, target, steering, controls, dry="vehicle_dry_mass" in given)
    coasts = start.longest_coast is not None
    free_flight = coordinates == "cartesian" and target == "anywhere" and not coasts and steering is None
    waits = free_flight and throttle is not None and minimise == "propellant"
    burns_once = target == "anywhere" and not coasts and throttle is None and minimise == "propellant"
    return Problem(
        name="powered_descent",
        title=f"{vehicle.mass:g} kg lander from {start.altitude / 1e3:g} km over {body.heading}",
        phases=with_coast(burn, _FRAMES[coordinates].path, _WITHOUT_THRUST) if coasts else (burn,),
        links=(at_ignition,) if coasts else (),
        start=_FRAMES[coordinates].start,
        given=given,
        free=(FreeParameter(name="flight_time", unit="s"), *((FREE,) if coasts else ())),
        objective=_propellant_objective if minimise == "propellant" else _time_objective,
        objective_unit="kg" if minimise == "propellant" else "s",
        results=Quantities(landing_results, *LANDING, *((COAST_TIME,) if coasts else ())),
        maximised=LANDED_MASS.name if minimise == "propellant" else "",
        minimised="" if minimise == "propellant" else FLIGHT_TIME.name,
        views=replace(_VIEWS, space=replace(_SPACE, body=catalogue_name(body))),
        records=(choices, *stated),
        switching_guesses=rough_landing if waits else None,
        parameter_bounds=_descent_ranges,
        preflight=partial(_compare_descent, to_site=target == "site", waits=waits, burns_once=burns_once, body=body),
        scales=_scales(start, vehicle, _ranges_of_given(given, _descent_ranges)),
    )
