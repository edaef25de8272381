"""Return of Liu, Liu, Wu 2019, section 4, as data: what it prints, and the neighbours that are flown instead.

`PRINTED_SITE` and the tables of `printed` are for comparison only. **Neighbour A** takes (12) at its word: the landing
point is free, and the flight ends at the interface under a fixed angle. **Neighbour B** moves the site into the plane
of the orbit and flies on to it. The paper prints neither drag coefficient nor a usable drag, so that B has a blunt
capsule's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune import Problem, Solution
from perilune.core import NUMERIC, Vector
from perilune.models import Atmosphere, Interface, Landing, Manoeuvre, Planet, Returner, ReturnOrbit, deorbit_entry
from perilune_papers.liu2019.flight_path import FlightPath, flight_path, to_cartesian

STEP = 1e-30  # of derivatives by a complex step


@dataclass(frozen=True, kw_only=True)
class LiuCase:
    """Section 4.1; the rate of the Earth, air and drag area are not printed."""

    earth: Planet
    orbit: ReturnOrbit
    mass: float = 500.0  # kg
    thrust: float = 100.0  # N
    exhaust_velocity: float = 3000.0  # m/s
    interface_altitude: float = 120e3  # m
    angles: tuple[float, float] = (math.radians(-9), math.radians(-6))
    speeds: tuple[float, float] = (7500.0, 8800.0)  # m/s
    site_latitude: float = math.radians(38)
    place: tuple[float, float] = (math.radians(16), math.radians(39.5))  # ours, inside the region


CASE = LiuCase(
    earth=Planet(
        name="earth", gravitational_parameter=3.986005e14, radius=6371e3, rotation_rate=7.2921159e-5, j2=1.08263e-3
    ),
    orbit=ReturnOrbit(radius=6678.14e3, inclination=math.radians(50)),
)
PRINTED_SITE = math.radians(-158)  # longitude
NEIGHBOUR_SITE = math.radians(-98)
PRINTED_TIMES = {"hybrid method": 1680.4, "fast method": 49.34}  # s, a solution


def site_free(going: str) -> Problem:
    """Neighbour A: to the interface at the steepness of -6 degrees, in the least time, and anywhere."""
    return deorbit_entry(
        _vehicle(), CASE.orbit, Interface(altitude=CASE.interface_altitude, angle=CASE.angles[1]), CASE.earth,
        manoeuvre=_manoeuvre_place(going), minimise="transition_time",
    )  # fmt: skip


def site_fixed() -> Problem:
    """Neighbour B: to a site in the plane of the orbit, on a descending pass."""
    return _to_site(_vehicle(drag_area=0.6), NEIGHBOUR_SITE, "descending")


def fixed_sweep() -> Problem:
    """Neighbour B with the speed and the angle at the interface that its answer has."""
    at = Interface(altitude=CASE.interface_altitude, speed=CASE.speeds[0], angle=CASE.angles[1])
    return _to_site(_vehicle(drag_area=0.6), NEIGHBOUR_SITE, "descending", at)


def as_printed(going: str, left: float) -> Problem:
    """Return the problem to the printed site, with a mass [kg] that is to be left.

    Parameters
    ----------
    going
        Sense in which the orbit crosses the latitude of the manoeuvre point, "ascending" or "descending".
    left
        Mass to be left [kg].
    """
    return _to_site(_vehicle(drag_area=0.6, dry_mass=left), PRINTED_SITE, going)


def _vehicle(*, drag_area: float | None = None, dry_mass: float | None = None) -> Returner:
    return Returner(
        mass=CASE.mass,
        thrust=CASE.thrust,
        exhaust_velocity=CASE.exhaust_velocity,
        drag_area=drag_area,
        dry_mass=dry_mass,
    )


def _manoeuvre_place(going: str) -> Manoeuvre:
    return Manoeuvre(longitude=CASE.place[0], latitude=CASE.place[1], going=going)


def _to_site(vehicle: Returner, longitude: float, going: str, at: Interface | None = None) -> Problem:
    between = Interface(
        altitude=CASE.interface_altitude, speed_lower=CASE.speeds[0], speed_upper=CASE.speeds[1],
        angle_lower=CASE.angles[0], angle_upper=CASE.angles[1],
    )  # fmt: skip
    return deorbit_entry(
        vehicle, CASE.orbit, at or between, CASE.earth, manoeuvre=_manoeuvre_place(going),
        air=Atmosphere(model="exponential", density=1.225, scale_height=7200.0),
        site=Landing(longitude=longitude, latitude=CASE.site_latitude, altitude=10e3),
    )  # fmt: skip


# -- the paper's units and coordinates ------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Units:
    """References of (3)."""

    length: float  # m
    speed: float  # m/s
    time: float  # s
    gravity: float  # m/s^2


def paper_units() -> Units:
    """References of the paper's dimensionless quantities."""
    earth = CASE.earth
    speed = math.sqrt(earth.gravitational_parameter / earth.radius)
    return Units(length=earth.radius, speed=speed, time=earth.radius / speed, gravity=speed * speed / earth.radius)


def dimensionless_constants() -> SimpleNamespace:
    """Parameters of the dimensionless equations: those of the body, thrust T and exhaust speed V_e."""
    unit = paper_units()
    return SimpleNamespace(
        body_gravitational_parameter=1.0, body_radius=1.0, body_j2=CASE.earth.j2,
        body_rotation_rate=CASE.earth.rotation_rate * unit.time,
        thrust=CASE.thrust / (CASE.mass * unit.gravity), exhaust=CASE.exhaust_velocity / unit.speed,
    )  # fmt: skip


def paper_state(x: Vector) -> Vector:
    """V, gamma, psi, r, Theta, Phi, m of the paper, of a Cartesian state in SI."""
    unit, path = paper_units(), flight_path(tuple(x[:3]), tuple(x[3:6]), NUMERIC)
    return np.array([
        path.speed / unit.speed, path.angle, path.course, path.distance / unit.length, path.longitude, path.latitude,
        x[6] / CASE.mass,
    ])  # fmt: skip


def paper_costates(solution: Solution, phase: int, t: float) -> Vector:
    """Costates of `paper_state` in the paper's units, at a time [s] of a phase.

    They are those of the Cartesian state, carried by the transposed derivatives of that state.

    Parameters
    ----------
    solution
        Extremal with costates, of the Cartesian state.
    phase
        Index of the phase.
    t
        Time from the start of the phase [s].

    Returns
    -------
    Vector
        Shape (7,), in the order of `paper_state`, dimensionless.

    Raises
    ------
    ValueError
        If the solution has no costates.
    """
    unit, trajectory = paper_units(), solution.trajectories[phase]
    if trajectory.costate is None:
        raise ValueError("a solution of the indirect method has costates")
    state = paper_state(trajectory.state(t))
    found = trajectory.costate(t)[:7] / unit.time
    turned = [float(found @ np.imag(_from_paper_state(state + 1j * STEP * np.eye(7)[i]))) / STEP for i in range(7)]
    return np.array(turned)


def _from_paper_state(state: Vector) -> Vector:
    """Cartesian state in SI of `paper_state`."""
    unit = paper_units()
    speed, angle, course, distance, longitude, latitude, mass = state
    position, velocity = to_cartesian(
        FlightPath(speed=speed, angle=angle, course=course, distance=distance, longitude=longitude, latitude=latitude),
        NUMERIC,
    )  # fmt: skip
    found: list[Any] = [unit.length * v for v in position] + [unit.speed * v for v in velocity] + [CASE.mass * mass]
    return np.array(found)
