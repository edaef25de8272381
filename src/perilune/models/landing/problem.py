"""Planar landing from perilune with an optional impulsive retro burn: Cho, Kim, Leeghim 2015, equations (1)-(10).

Frame: inertial polar coordinates in the orbital plane, which is the equator: r from the centre, phi from the start of
the Hohmann transfer in the direction of flight and rotation, u transverse and v radial velocity, m mass. The thrust
direction is the unit vector (cos beta, sin beta) on (transverse, radial), so that beta = 180 deg is straight retro.

The retro burn is not a phase: it only moves the *free initial state* along the rocket equation (8),
u0 = V0 - delta_v, m0 = M exp(-delta_v / c_imp); (9) of the paper prints m for M there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import (
    NUMERIC,
    PeriluneError,
    Scales,
    Vector,
    check_call,
    comparison_fails,
    quantity,
    record,
    require_records,
)
from perilune.models.landing.presolve import compare_landing, perilune_speed
from perilune.models.physics.bodies import MOON, Body, catalogue_name
from perilune.models.physics.delta_v_bounds import braking_distance_and_time, exhaust_speed
from perilune.models.physics.delta_v_budget import FLIGHT_TIME, LANDED_MASS, PROPELLANT, SPENT, velocity_loss_rates
from perilune.models.physics.vehicle import Retro, Vehicle
from perilune.problem import (
    Check,
    Conditions,
    FreeParameter,
    Phase,
    Problem,
    Quantities,
    Solution,
    UnitVectorControl,
    Variable,
    given_of,
    views,
)


@record("orbit")
class Orbit:
    """Circular parking orbit and the perilune of the Hohmann transfer, altitudes above the body's radius.

    The transfer leaves the parking orbit, so that `parking_altitude` is its apolune. An orbit that is elliptic already
    is stated by its apolune there.
    """

    parking_altitude: float = quantity(
        "m", "100 km", also=("apolune_altitude", "apoapsis_altitude", "apogee_altitude"),
        about="of the circular parking orbit, above the body's radius: the apolune of the transfer to the perilune",
    )  # fmt: skip
    perilune_altitude: float = quantity(
        "m", "15 km", also=("periapsis_altitude", "perigee_altitude"),
        about="of the perilune, above the body's radius, where the burns begin",
    )  # fmt: skip


@record("landing")
class LandingSite:
    """Site of the landing."""

    altitude: float = quantity("m", "0 km", default=0.0, about="of the landing site, above the body's radius")


def _planar_dynamics(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Cho et al. (1)-(5)."""
    acceleration = p.vehicle_thrust / x.m
    return (
        x.v,
        x.u / x.r,
        -x.u * x.v / x.r + acceleration * u.transverse,
        x.u * x.u / x.r - p.body_gravitational_parameter / (x.r * x.r) + acceleration * u.radial,
        -p.vehicle_thrust / (p.vehicle_specific_impulse * p.vehicle_standard_gravity),
    )


def _perilune_state(p: Any, xp: Any) -> Sequence[Any]:
    """Cho et al. (8) and (9) with u0 = V0 - delta_v."""
    exhaust_speed = p.retro_specific_impulse * p.vehicle_standard_gravity
    return (
        p.body_radius + p.orbit_perilune_altitude,
        math.pi,
        perilune_speed(p, xp) - p.retro_delta_v,
        0.0,
        p.vehicle_mass * xp.exp(-p.retro_delta_v / exhaust_speed),
    )


def _planar_touchdown(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Rest on the rotating ground, Cho et al. (10)."""
    r_ground = p.body_radius + p.landing_altitude
    return (x.r - r_ground, x.u - r_ground * p.body_rotation_rate, x.v)


def _planar_altitude(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    return (x.r - p.body_radius - p.landing_altitude,)


def _planar_outputs(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    # beta in [0, 2 pi) would jump at 0; measured from straight retro (180 deg) it jumps only for pro-grade thrust.
    return (
        x.r - p.body_radius,
        xp.atan2(-u.radial, -u.transverse) + math.pi,
        p.vehicle_thrust / x.m,
    )


def _hybrid_results(first: Any, last: Any, p: Any, xp: Any) -> Sequence[Any]:
    return last.m, p.vehicle_mass - last.m, p.retro_delta_v, p.flight_time, perilune_speed(p, xp)


def _planar_loss_rates(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    omega = p.body_rotation_rate
    over_ground = (x.u - omega * x.r, x.v, 0.0)
    pull = (0.0, omega * omega * x.r - p.body_gravitational_parameter / (x.r * x.r), 0.0)
    return velocity_loss_rates(over_ground, p.vehicle_thrust / x.m, (u.transverse, u.radial, 0.0), pull, xp)


def _planar_inertial(x: Any, u: Any, t: Any, p: Any, xp: Any) -> Sequence[Any]:
    sine, cosine, push = xp.sin(x.phi), xp.cos(x.phi), p.vehicle_thrust / x.m
    vectors = ((0.0, x.r), (x.u, x.v), (push * u.transverse, push * u.radial))
    return tuple(
        value
        for across, up in vectors
        for value in (up * cosine - across * sine, up * sine + across * cosine, 0.0 * up)
    )


_VIEWS = views.Views(
    histories=(
        views.History(name="altitude", quantities=("altitude",), caption="Altitude"),
        views.History(name="horizontal_velocity", quantities=("u",), caption="Horizontal velocity"),
        views.History(name="vertical_velocity", quantities=("v",), caption="Vertical velocity"),
        views.History(
            name="thrust_angle",
            quantities=("thrust_angle",),
            caption="Thrust angle, from the direction of flight along the horizon",
        ),
        views.History(
            name="mass", quantities=("m",), caption="Mass; the propellant of a retro burn is gone before ignition"
        ),
    ),
    height="altitude",
    radius="body_radius",
    frame="inertial axes: x from the centre to the start of the Hohmann transfer, z along the body's rotation",
    label="hybrid, ΔV = {delta_v:.1f} m/s",
    comparison=views.ComparisonFlight(given=(("retro_delta_v", 0.0),), label="ordinary, no retro burn"),
)
_SPACE = views.Space(
    rotation="body_rotation_rate",
    chosen="The model is planar: its plane is the equator, flown along the rotation, and longitude 0 is where the "
    "Hohmann transfer starts, half a revolution before the start of the flight.",
)


def _hybrid_objective(x: Any, p: Any, xp: Any) -> Any:
    """Cho et al. (6)."""
    return -x.m


def mass_state(dry: bool) -> Variable:
    """The mass as a state: not below the dry mass where there is one."""
    lower = "vehicle_dry_mass" if dry else 0.0
    return Variable(name="m", unit="kg", lower=lower, description="mass", label="mass")


def _hybrid_end_guess(p: Any, xp: Any) -> Sequence[Any]:
    r_ground = p.body_radius + p.landing_altitude
    return (r_ground, math.pi + 0.3, r_ground * p.body_rotation_rate, 0.0, 0.5 * p.vehicle_mass)


def _hybrid_ranges(p: Any, xp: Any) -> dict[str, tuple[float, float, float]]:
    """Bounds and orders of magnitude of the free parameters; refuses given values that make no sense together."""
    lowest = xp.fmin(xp.fmin(p.landing_altitude, p.orbit_perilune_altitude), p.orbit_parking_altitude)
    if comparison_fails(lowest > -p.body_radius):
        raise PeriluneError(
            "an altitude lies below the centre of the body", expected=f"above {np.max(-p.body_radius):g} m"
        )
    speed = perilune_speed(p, xp)
    exhausted = p.vehicle_mass * exhaust_speed(p) / p.vehicle_thrust  # all mass gone: the longest burn there can be
    # To stop the whole speed (rocket equation), and to drop the height by a burn down and a burn up.
    _, stop = braking_distance_and_time(xp.fmax(speed - getattr(p, "retro_delta_v", 0.0), 0.0), p, xp)
    height = xp.fmax(p.orbit_perilune_altitude - p.landing_altitude, 0.0)
    drop = 2 * xp.sqrt(height * p.vehicle_mass / p.vehicle_thrust)
    return {
        "retro_delta_v": (0.0, speed, 0.5 * speed),
        "flight_time": (0.0, exhausted, xp.fmin(stop + drop, 0.9 * exhausted)),
    }


def _planar_descent(dry: bool) -> Phase:
    """Return the burn in the plane of the orbit; `dry` is True where the vehicle has a dry mass."""
    return Phase(
        name="descent",
        states=(
            Variable(name="r", unit="m", description="distance from the centre"),
            Variable(name="phi", unit="rad", description="position angle"),
            Variable(name="u", unit="m/s", description="transverse velocity", label="horizontal velocity"),
            Variable(name="v", unit="m/s", description="radial velocity", label="vertical velocity"),
            mass_state(dry),
        ),
        controls=(UnitVectorControl(names=("transverse", "radial")),),
        dynamics=_planar_dynamics,
        duration="flight_time",
        end=Conditions(
            _planar_touchdown,
            touchdown_altitude="m",
            touchdown_transverse_velocity="m/s",
            touchdown_radial_velocity="m/s",
        ),
        path=Conditions(_planar_altitude, height_above_site="m"),
        outputs=Quantities(
            _planar_outputs,
            Variable(name="altitude", unit="m"),
            Variable(
                name="thrust_angle",
                unit="rad",
                description="beta, from transverse towards radial",
                label="thrust angle β",
            ),
            thrust_acceleration="m/s^2",
        ),
        integrals=Quantities(_planar_loss_rates, *SPENT),
        inertial=_planar_inertial,
        end_guess=_hybrid_end_guess,
    )


@check_call
def hybrid_landing(
    vehicle: Vehicle, retro: Retro | None, orbit: Orbit, body: Body = MOON, landing_altitude: float = 0.0
) -> Problem:
    """Landing of maximum landed mass; with `retro` None, or its delta_v given, the retro burn is fixed.

    Parameters
    ----------
    vehicle, retro, orbit, body
        The lander, its impulsive engine, where it comes from and where it lands.
    landing_altitude
        Of the landing site above the body's radius [m].

    Returns
    -------
    Problem
        States r [m], phi [rad], u, v [m/s], m [kg]; free `retro_delta_v` [m/s] and `flight_time` [s]; J = -m(t_f) [kg],
        Cho et al. (6). Parameters are named like the scenario's keys with ``_`` for the dot.
    """
    require_records((vehicle, Vehicle), (orbit, Orbit), (body, Body))
    burn = Retro(specific_impulse=vehicle.specific_impulse, delta_v=0.0) if retro is None else retro
    require_records((burn, Retro))
    stated = (body, vehicle, replace(burn, delta_v=None), orbit, LandingSite(altitude=landing_altitude))
    given = given_of(*stated)
    p = SimpleNamespace(**{name: g.value for name, g in given.items()})
    ranges = _hybrid_ranges(p, NUMERIC)
    speed, time = ranges["retro_delta_v"][1], ranges["flight_time"][2]
    problem = Problem(
        name="hybrid_landing",
        title=f"{vehicle.mass:g} kg lander from {orbit.perilune_altitude / 1e3:g} km to {body.heading}",
        phases=(_planar_descent("vehicle_dry_mass" in given),),
        start=_perilune_state,
        given=given,
        free=(FreeParameter(name="retro_delta_v", unit="m/s"), FreeParameter(name="flight_time", unit="s")),
        objective=_hybrid_objective,
        objective_unit="kg",
        results=Quantities(
            _hybrid_results,
            LANDED_MASS,
            PROPELLANT,
            Variable(name="delta_v", unit="m/s", description="of the impulsive retro burn"),
            FLIGHT_TIME,
            Variable(name="perilune_speed", unit="m/s", description="before the retro burn"),
        ),
        maximised=LANDED_MASS.name,
        records=stated,
        parameter_bounds=_hybrid_ranges,
        preflight=partial(compare_landing, body=body),
        consistency_checks=mass_consistency_checks,
        views=replace(_VIEWS, space=replace(_SPACE, body=catalogue_name(body))),
        scales=Scales(length=speed * time, time=time, mass=float(vehicle.mass)),
    )
    return problem if burn.delta_v is None else problem.with_given(retro_delta_v=burn.delta_v)


@cache
def _quadrature() -> tuple[Vector, Vector]:
    """Return points and weights of Gauss's rule on [-1, 1], whose computation takes as long as all checks here."""
    return np.polynomial.legendre.leggauss(64)


def mass_consistency_checks(solution: Solution) -> tuple[Check, ...]:
    """The exported masses against the rocket equation, which integrates to closed form: nothing is flown.

    Parameters
    ----------
    solution
        Of a problem made here.

    Returns
    -------
    Checks of level 1: mass after the retro burn, Cho et al. (9); propellant at constant flow, (5); speed gained by
    the rocket equation against the thrust acceleration integrated along the arc.
    """
    p, scales, flown = solution.parameters, solution.problem.scales, solution.trajectories[0]
    mass = [x[-1] for x in (flown.state(0.0), flown.state(p.flight_time))]
    exhaust_speed = p.vehicle_specific_impulse * p.vehicle_standard_gravity
    node, weight = _quadrature()
    acceleration = solution.outputs(0, 0.5 * p.flight_time * (1 + node))["thrust_acceleration"]
    gained = 0.5 * p.flight_time * float(weight @ acceleration)
    retro_ratio = math.exp(-p.retro_delta_v / (p.retro_specific_impulse * p.vehicle_standard_gravity))
    found = (
        ("retro_mass", "kg", mass[0] - p.vehicle_mass * retro_ratio,
         "mass at ignition and mass after the retro burn"),
        ("propellant", "kg", mass[0] - mass[1] - p.vehicle_thrust / exhaust_speed * p.flight_time,
         "propellant burnt in the tables and thrust over exhaust speed times flight time"),
        ("rocket_equation", "m/s", exhaust_speed * float(np.log(mass[0] / mass[1])) - gained,
         "speed by the rocket equation and thrust acceleration integrated along the arc"),
    )  # fmt: skip
    return tuple(
        Check(
            name=name, level=1, value=abs(float(error)), limit=1e-11 * scales.of(unit), unit=unit,
            meaning=f"difference between {meaning}",
        )
        for name, unit, error, meaning in found
    )  # fmt: skip
