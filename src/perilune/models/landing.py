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
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.models.bodies import MOON, Body
from perilune.models.budget import FLIGHT_TIME, LANDED_MASS, PROPELLANT, SPENT, spent
from perilune.problem.controls import Direction
from perilune.problem.problem import Free, Given, Phase, Problem, Variable
from perilune.problem.solution import Solution
from perilune.problem.verification import Check
from perilune.problem.views import Beside, History, Views
from perilune.words.maths import NUMERIC
from perilune.words.outcome import PeriluneError
from perilune.words.units import Scales

STANDARD_GRAVITY = 9.80665  # m/s^2, exact: 3rd CGPM (1901); the paper uses 9.81


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A lander at the end of the Hohmann coast: mass [kg], constant thrust [N], specific impulse [s]."""

    mass: float
    thrust: float
    specific_impulse: float
    standard_gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        _positive("vehicle", self, "mass", "thrust", "specific_impulse", "standard_gravity")


@dataclass(frozen=True, kw_only=True)
class Retro:
    """The impulsive retro burn: specific impulse [s]; delta_v [m/s] is free unless it is given here."""

    specific_impulse: float
    delta_v: float | None = None

    def __post_init__(self) -> None:
        _positive("retro", self, "specific_impulse")
        if self.delta_v is not None and not (math.isfinite(self.delta_v) and self.delta_v >= 0):
            raise PeriluneError("retro delta_v must not be negative", got=f"{self.delta_v} m/s", expected=">= 0 m/s")


@dataclass(frozen=True, kw_only=True)
class Orbit:
    """Circular parking orbit and the perilune of the Hohmann transfer: altitudes [m] above the body's radius."""

    parking_altitude: float
    perilune_altitude: float

    def __post_init__(self) -> None:
        _positive("orbit", self, "parking_altitude", "perilune_altitude")
        if self.perilune_altitude > self.parking_altitude:
            raise PeriluneError(
                "the perilune lies above the parking orbit",
                got=f"perilune {self.perilune_altitude / 1e3:g} km, parking orbit {self.parking_altitude / 1e3:g} km",
                expected="perilune_altitude <= parking_altitude",
                advice="exchange the two, or raise the parking orbit",
            )


def _positive(section: str, record: Any, *names: str) -> None:
    for name in names:
        value = getattr(record, name)
        if not (math.isfinite(value) and value > 0):
            raise PeriluneError(f"{section} {name} must be positive and finite", got=str(value), expected="> 0")


def perilune_speed(p: Any, m: Any) -> Any:
    """Inertial speed at the perilune of the Hohmann transfer, Cho et al. (7). `p` as in `hybrid_landing`."""
    r0 = p.body_radius + p.orbit_perilune_altitude
    r_parking = p.body_radius + p.orbit_parking_altitude
    return m.sqrt(p.body_gravitational_parameter * (2 / r0 - 2 / (r0 + r_parking)))


def _dynamics(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    """Cho et al. (1)-(5)."""
    acceleration = p.vehicle_thrust / x.m
    return (
        x.v,
        x.u / x.r,
        -x.u * x.v / x.r + acceleration * u.transverse,
        x.u * x.u / x.r - p.body_gravitational_parameter / (x.r * x.r) + acceleration * u.radial,
        -p.vehicle_thrust / (p.vehicle_specific_impulse * p.vehicle_standard_gravity),
    )


def _start(p: Any, m: Any) -> Sequence[Any]:
    """Cho et al. (8) and (9) with u0 = V0 - delta_v."""
    exhaust_speed = p.retro_specific_impulse * p.vehicle_standard_gravity
    return (
        p.body_radius + p.orbit_perilune_altitude,
        math.pi,
        perilune_speed(p, m) - p.retro_delta_v,
        0.0,
        p.vehicle_mass * m.exp(-p.retro_delta_v / exhaust_speed),
    )


def _touchdown(x: Any, p: Any, m: Any) -> Sequence[Any]:
    """Rest on the rotating ground, Cho et al. (10)."""
    r_ground = p.body_radius + p.landing_altitude
    return (x.r - r_ground, x.u - r_ground * p.body_rotation_rate, x.v)


def _above_ground(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    return (x.r - p.body_radius - p.landing_altitude,)


def _outputs(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    # beta in [0, 2 pi) would jump at 0; measured from straight retro (180 deg) it jumps only for pro-grade thrust.
    return (
        x.r - p.body_radius,
        m.atan2(-u.radial, -u.transverse) + math.pi,
        p.vehicle_thrust / x.m,
    )


def _results(first: Any, last: Any, p: Any, m: Any) -> Sequence[Any]:
    return last.m, p.vehicle_mass - last.m, p.retro_delta_v, p.flight_time, perilune_speed(p, m)


def _spent(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    omega = p.body_rotation_rate
    over_ground = (x.u - omega * x.r, x.v, 0.0)
    pull = (0.0, omega * omega * x.r - p.body_gravitational_parameter / (x.r * x.r), 0.0)
    return spent(over_ground, p.vehicle_thrust / x.m, (u.transverse, u.radial, 0.0), pull, m)


def _inertial(x: Any, u: Any, t: Any, p: Any, m: Any) -> Sequence[Any]:
    sine, cosine, push = m.sin(x.phi), m.cos(x.phi), p.vehicle_thrust / x.m
    vectors = ((0.0, x.r), (x.u, x.v), (push * u.transverse, push * u.radial))
    return tuple(
        value
        for across, up in vectors
        for value in (up * cosine - across * sine, up * sine + across * cosine, 0.0 * up)
    )


_VIEWS = Views(
    histories=(
        History(name="altitude", quantities=("altitude",), caption="Altitude"),
        History(name="horizontal_velocity", quantities=("u",), caption="Horizontal velocity"),
        History(name="vertical_velocity", quantities=("v",), caption="Vertical velocity"),
        History(
            name="thrust_angle",
            quantities=("thrust_angle",),
            caption="Thrust angle, from the direction of flight along the horizon",
        ),
        History(name="mass", quantities=("m",), caption="Mass; the propellant of a retro burn is gone before ignition"),
    ),
    height="altitude",
    radius="body_radius",
    frame="inertial axes: x from the centre to the start of the Hohmann transfer, z along the body's rotation",
    label="hybrid, ΔV = {delta_v:.1f} m/s",
    beside=Beside(given=(("retro_delta_v", 0.0),), label="ordinary, no retro burn"),
)


def _minus_landed_mass(x: Any, p: Any, m: Any) -> Any:
    """Cho et al. (6)."""
    return -x.m


def _typical_end(p: Any, m: Any) -> Sequence[Any]:
    r_ground = p.body_radius + p.landing_altitude
    return (r_ground, math.pi + 0.3, r_ground * p.body_rotation_rate, 0.0, 0.5 * p.vehicle_mass)


def _check_given(p: Any) -> None:
    """The records' own checks, for values that a sweep sets, and what no record can see alone."""
    Vehicle(
        mass=p.vehicle_mass,
        thrust=p.vehicle_thrust,
        specific_impulse=p.vehicle_specific_impulse,
        standard_gravity=p.vehicle_standard_gravity,
    )
    Retro(specific_impulse=p.retro_specific_impulse, delta_v=getattr(p, "retro_delta_v", None))
    Orbit(parking_altitude=p.orbit_parking_altitude, perilune_altitude=p.orbit_perilune_altitude)
    if not -p.body_radius < p.landing_altitude < p.orbit_perilune_altitude:
        raise PeriluneError(
            "the perilune lies below the landing site",
            got=f"perilune {p.orbit_perilune_altitude / 1e3:g} km, landing site {p.landing_altitude / 1e3:g} km",
            expected="perilune_altitude > landing altitude",
            advice="raise the perilune or lower the site",
        )


def _ranges(p: Any, m: Any) -> dict[str, tuple[float, float, float]]:
    """Bounds and orders of magnitude of the free parameters; refuses given values that are no landing."""
    _check_given(p)
    speed = perilune_speed(p, m)
    exhaust_speed = p.vehicle_specific_impulse * p.vehicle_standard_gravity
    exhausted = p.vehicle_mass * exhaust_speed / p.vehicle_thrust  # all propellant gone: the longest burn there can be
    # To stop the whole speed (rocket equation), and to drop the height by a burn down and a burn up.
    stop = exhausted * (1 - m.exp(-speed / exhaust_speed))
    drop = 2 * m.sqrt((p.orbit_perilune_altitude - p.landing_altitude) * p.vehicle_mass / p.vehicle_thrust)
    return {
        "retro_delta_v": (0.0, speed, 0.5 * speed),
        "flight_time": (0.0, exhausted, m.fmin(stop + drop, 0.9 * exhausted)),
    }


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
    given = {
        "body_gravitational_parameter": Given(value=body.gravitational_parameter, unit="m^3/s^2"),
        "body_radius": Given(value=body.radius, unit="m"),
        "body_rotation_rate": Given(value=body.rotation_rate, unit="rad/s"),
        "vehicle_mass": Given(value=vehicle.mass, unit="kg"),
        "vehicle_thrust": Given(value=vehicle.thrust, unit="N"),
        "vehicle_specific_impulse": Given(value=vehicle.specific_impulse, unit="s"),
        "vehicle_standard_gravity": Given(value=vehicle.standard_gravity, unit="m/s^2"),
        "retro_specific_impulse": Given(value=(retro or vehicle).specific_impulse, unit="s"),
        "orbit_parking_altitude": Given(value=orbit.parking_altitude, unit="m"),
        "orbit_perilune_altitude": Given(value=orbit.perilune_altitude, unit="m"),
        "landing_altitude": Given(value=landing_altitude, unit="m"),
    }
    descent = Phase(
        name="descent",
        states=(
            Variable(name="r", unit="m", description="distance from the centre"),
            Variable(name="phi", unit="rad", description="position angle"),
            Variable(name="u", unit="m/s", description="transverse velocity", label="horizontal velocity"),
            Variable(name="v", unit="m/s", description="radial velocity", label="vertical velocity"),
            Variable(name="m", unit="kg", lower=0.0, description="mass", label="mass"),
        ),
        controls=(Direction(names=("transverse", "radial")),),
        dynamics=_dynamics,
        duration="flight_time",
        end=_touchdown,
        end_conditions=(
            Variable(name="touchdown_altitude", unit="m"),
            Variable(name="touchdown_transverse_velocity", unit="m/s"),
            Variable(name="touchdown_radial_velocity", unit="m/s"),
        ),
        path=_above_ground,
        path_conditions=(Variable(name="height_above_site", unit="m"),),
        outputs=_outputs,
        output_variables=(
            Variable(name="altitude", unit="m"),
            Variable(
                name="thrust_angle",
                unit="rad",
                description="beta, from transverse towards radial",
                label="thrust angle β",
            ),
            Variable(name="thrust_acceleration", unit="m/s^2"),
        ),
        integrals=_spent,
        integral_variables=SPENT,
        inertial=_inertial,
        typical_end=_typical_end,
    )
    p = SimpleNamespace(**{name: g.value for name, g in given.items()})
    _, speed, _ = _ranges(p, NUMERIC)["retro_delta_v"]
    _, _, time = _ranges(p, NUMERIC)["flight_time"]
    problem = Problem(
        name="hybrid_landing",
        title=f"{vehicle.mass:g} kg lander from {orbit.perilune_altitude / 1e3:g} km to the {body.name}",
        phases=(descent,),
        start=_start,
        given=given,
        free=(Free(name="retro_delta_v", unit="m/s"), Free(name="flight_time", unit="s")),
        objective=_minus_landed_mass,
        objective_unit="kg",
        results=_results,
        result_variables=(
            LANDED_MASS,
            PROPELLANT,
            Variable(name="delta_v", unit="m/s", description="of the impulsive retro burn"),
            FLIGHT_TIME,
            Variable(name="perilune_speed", unit="m/s", description="before the retro burn"),
        ),
        maximised=LANDED_MASS.name,
        ranges=_ranges,
        bookkeeping=bookkeeping,
        views=_VIEWS,
        scales=Scales(length=speed * time, time=time, mass=vehicle.mass),
    )
    if retro is None or retro.delta_v is not None:
        problem = problem.with_given(retro_delta_v=retro.delta_v if retro and retro.delta_v else 0.0)
    return problem


def bookkeeping(solution: Solution) -> tuple[Check, ...]:
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
    node, weight = np.polynomial.legendre.leggauss(64)
    acceleration = solution.outputs(0, 0.5 * p.flight_time * (1 + node))["thrust_acceleration"]
    gained = 0.5 * p.flight_time * float(weight @ acceleration)
    retro_ratio = math.exp(-p.retro_delta_v / (p.retro_specific_impulse * p.vehicle_standard_gravity))
    found = (
        ("retro_mass", "kg", mass[0] - p.vehicle_mass * retro_ratio,
         "mass at ignition and the one the retro burn leaves"),
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
