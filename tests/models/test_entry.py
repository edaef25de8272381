"""What entry is made of: gravity, coordinates, altitude, drag, heat; each against what is not this library."""

from __future__ import annotations

import math
from collections import namedtuple
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from perilune.core import NUMERIC
from perilune.models.deorbit import orbit
from perilune.models.deorbit.dynamics import entry_rates
from perilune.models.physics import aerodynamics, ellipsoid
from perilune.models.physics.aerodynamics import sphere_cone_drag_area
from perilune.models.physics.atmosphere import exponential
from perilune.models.physics.rotating_frame import (
    combine,
    free_acceleration,
    local_axes,
    potential,
    scalar_product,
    zonal_gravity,
)
from perilune.problem import SYMBOLIC
from perilune_papers.liu2019.flight_path import FlightPath, flight_path, flight_path_rates, path_axes, to_cartesian

AXIS = (0.0, 0.0, 1.0)
MU, RADIUS, TURN, J2 = 3.986004418e14, 6378137.0, 7.292115e-5, 1.08262668e-3
EARTH = SimpleNamespace(
    body_gravitational_parameter=MU, body_radius=RADIUS, body_rotation_rate=TURN, body_j2=J2,
    body_flattening=1 / 298.257223563,
)  # fmt: skip
PEAR = SimpleNamespace(**vars(EARTH), body_j3=-2.53241e-6, body_j4=-1.6199e-6)
WHERE = FlightPath(speed=7300.0, angle=-0.11, course=-0.6, distance=6.5e6, longitude=0.4, latitude=0.7)


def flown(y: Any, time: float, p: Any, pushed: Any = lambda t, y: (0.0, 0.0, 0.0), **more: Any) -> Any:
    """Cartesian flight in turning axes by SciPy."""

    def slope(t: float, y: Any) -> Any:
        return [*y[3:], *combine((1, free_acceleration(y[:3], y[3:], AXIS, p, NUMERIC)), (1, pushed(t, y)))]

    return solve_ivp(slope, (0, time), y, method="DOP853", rtol=1e-13, atol=1e-7, **more)


def test_gravity_of_higher_harmonics_is_the_gradient_of_its_potential() -> None:
    position = (3.1e6, -4.2e6, 4.6e6)
    gradient = [
        np.imag(potential([c + 1e-20j * (i == j) for j, c in enumerate(position)], AXIS, PEAR, NUMERIC)) / 1e-20
        for i in range(3)
    ]
    np.testing.assert_allclose(zonal_gravity(position, AXIS, PEAR, NUMERIC), np.negative(gradient), rtol=1e-12)
    # Pear shape: the pulls at the poles differ by 8 J3 (R/r)^3, from P'_4(1) - P'_3(1) = 10 - 6 on each side.
    north, south = (zonal_gravity((0.0, 0.0, z), AXIS, PEAR, NUMERIC)[2] for z in (7e6, -7e6))
    assert (north + south) / (MU / 49e12) == pytest.approx(8 * PEAR.body_j3 * (RADIUS / 7e6) ** 3, rel=1e-9)


def test_a_coasting_flight_keeps_its_energy_and_momentum() -> None:
    """Jacobi's integral in turning axes, and the angular momentum about the axis, over two days."""
    start = np.array([*combine((6.8e6, (0.6, 0.0, 0.8))), 3000.0, 6200.0, -1500.0])
    flight = flown(start, 2 * 86400.0, PEAR, t_eval=np.linspace(0, 2 * 86400.0, 50))
    x, v = flight.y[:3], flight.y[3:]
    along = x[0] * x[0] + x[1] * x[1]
    jacobi = 0.5 * scalar_product(v, v) + potential(x, AXIS, PEAR, NUMERIC) - 0.5 * TURN**2 * along
    momentum = x[0] * v[1] - x[1] * v[0] + TURN * along
    np.testing.assert_allclose(jacobi, jacobi[0], rtol=1e-10)
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-10)


def test_a_node_goes_back_at_its_secular_rate() -> None:
    """Node -3/2 J2 n (R/p)^2 cos i (Vallado 2013, 9-37), which leaves out J2^2; over 50 turns of a circular orbit."""
    radius, inclination = 7.0e6, math.radians(50.0)
    mean = math.sqrt(MU / radius**3)
    still = SimpleNamespace(**{**vars(EARTH), "body_rotation_rate": 0.0})
    speed = math.sqrt(MU / radius)
    start = [radius, 0.0, 0.0, 0.0, speed * math.cos(inclination), speed * math.sin(inclination)]
    end = 50 * 2 * math.pi / mean
    up = flown(start, end, still, events=_upwards, max_step=600.0).y_events[0][1:]
    node = np.unwrap([math.atan2(y[1], y[0]) for y in up])
    between = end / 50 * (len(node) - 1)  # nodal periods differ from Kepler's by J2 alone
    rate = (node[-1] - node[0]) / between
    assert rate == pytest.approx(-1.5 * J2 * mean * (RADIUS / radius) ** 2 * math.cos(inclination), rel=3 * J2)


def _upwards(t: float, y: Any) -> float:
    return y[2]


_upwards.direction = 1  # type: ignore[attr-defined]


def test_flight_path_coordinates_and_back() -> None:
    position, velocity = to_cartesian(WHERE, NUMERIC)
    found = flight_path(position, velocity, NUMERIC)
    for name, value in vars(WHERE).items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-13)


def test_flight_path_coordinates_fly_as_newton_does() -> None:
    """Each rate of Liu et al. (1), corrected, is the derivative of its coordinate along the Cartesian flight."""
    rng, p = np.random.default_rng(3), EARTH
    for _ in range(50):
        path = FlightPath(
            speed=rng.uniform(500, 9000), angle=rng.uniform(-1.4, 1.4), course=rng.uniform(-3.1, 3.1),
            distance=rng.uniform(6.4e6, 8e6), longitude=rng.uniform(-3, 3), latitude=rng.uniform(-1.4, 1.4),
        )  # fmt: skip
        pushed = rng.normal(size=3).tolist()
        position, velocity = to_cartesian(path, NUMERIC)
        acceleration = combine(
            (1, free_acceleration(position, velocity, AXIS, p, NUMERIC)),
            *zip(pushed, path_axes(path, NUMERIC), strict=True),
        )
        step: Any = 1e-20j
        moved = flight_path(
            combine((1, position), (step, velocity)), combine((1, velocity), (step, acceleration)), _COMPLEX
        )
        exact = [np.imag(value) / 1e-20 for value in vars(moved).values()]
        sizes = [1.0, *[1e-3] * 2, path.speed, *[1e-3] * 2]
        np.testing.assert_allclose(
            np.divide(flight_path_rates(path, pushed, p, NUMERIC), sizes),
            np.divide(exact, sizes),
            rtol=1e-10,
            atol=1e-10,
        )


def _turned(y: Any, x: Any) -> Any:
    """atan2 of complex steps, which NumPy has not."""
    over = (x.real * y.imag - y.real * x.imag) / (x.real**2 + y.real**2)
    return np.arctan2(y.real, x.real) + 1j * over


_COMPLEX = SimpleNamespace(**{**vars(NUMERIC), "atan2": _turned})


def test_a_flight_in_either_coordinates_ends_alike() -> None:
    """Burn and drag over 1500 s from the paper's manoeuvre point, to 1e-10."""
    start = FlightPath(speed=7250.0, angle=-0.01, course=-0.55, distance=6678.14e3, longitude=0.28, latitude=0.69)

    def pushed(t: float, path: FlightPath) -> Any:
        thin = 1e-11 * math.exp(-(path.distance - 6.5e6) / 5e4)
        return -0.3 - thin * path.speed**2, 0.05 * math.sin(t / 300), 0.1

    def slope(t: float, y: Any) -> Any:
        path = FlightPath(**dict(zip(vars(start), y, strict=True)))
        return flight_path_rates(path, pushed(t, path), EARTH, NUMERIC)

    by_path = solve_ivp(slope, (0, 1500), list(vars(start).values()), method="DOP853", rtol=1e-13, atol=1e-13)

    def turned(t: float, y: Any) -> Any:
        path = flight_path(y[:3], y[3:], NUMERIC)
        return combine(*zip(pushed(t, path), path_axes(path, NUMERIC), strict=True))

    position, velocity = to_cartesian(start, NUMERIC)
    by_newton = flown([*position, *velocity], 1500, EARTH, turned)
    found = flight_path(by_newton.y[:3, -1], by_newton.y[3:, -1], NUMERIC)
    np.testing.assert_allclose(list(vars(found).values()), by_path.y[:, -1], rtol=1e-10)


def test_altitude_is_above_the_ellipsoid() -> None:
    rng = np.random.default_rng(4)
    longitude, latitude = rng.uniform(-3.1, 3.1, 4000), rng.uniform(-0.5, 0.5, 4000) * math.pi
    latitude[:4] = 0.0, math.pi / 2, -math.pi / 2, 1e-9
    height = rng.uniform(-10e3, 2000e3, 4000)
    # A place by its definition: where the normal from the axis passes, of length N, and the height on top.
    flat = EARTH.body_flattening
    normal = RADIUS / np.sqrt(1 - flat * (2 - flat) * np.sin(latitude) ** 2)
    level = (normal + height) * np.cos(latitude)
    position = (
        level * np.cos(longitude), level * np.sin(longitude),
        ((1 - flat) ** 2 * normal + height) * np.sin(latitude),
    )  # fmt: skip
    np.testing.assert_allclose(
        ellipsoid.geodetic_position(longitude, latitude, height, EARTH, NUMERIC), position, atol=1e-8
    )
    np.testing.assert_allclose(ellipsoid.altitude(position, EARTH, NUMERIC), height, atol=1e-7)
    np.testing.assert_allclose(ellipsoid.latitude(position, EARTH, NUMERIC), latitude, atol=1e-10)


@pytest.mark.parametrize(
    "shape",
    [{"orbit_radius": 6.8e6},
     {"orbit_perigee_altitude": 3e5, "orbit_apogee_altitude": 3e6, "orbit_argument_of_perigee": 1.0}],
)  # fmt: skip
@pytest.mark.parametrize(
    ("latitude", "going"),
    [(0.6, "ascending"), (-0.85, "descending"), (0.0, "ascending"), (0.902, "ascending")],
)  # the last lies beyond the inclination, which counts from the centre
def test_a_manoeuvre_is_above_its_geodetic_place(shape: Any, latitude: float, going: str) -> None:
    place = {"manoeuvre_latitude": latitude, "manoeuvre_longitude": 0.3, "orbit_inclination": 0.9}
    p = SimpleNamespace(**vars(EARTH), **shape, **place)
    angles: Any = orbit.angles_of_place(going)
    angle, node = angles(p, NUMERIC)
    position, velocity = orbit.orbit_state(angle, node, p, NUMERIC)
    assert ellipsoid.latitude(position, p, NUMERIC) == pytest.approx(latitude, abs=1e-9)
    assert math.atan2(position[1], position[0]) == pytest.approx(0.3, abs=1e-12)
    assert (velocity[2] > 0) == (going == "ascending")
    # By its definition: the normal from the axis through the place, at this distance from the centre.
    tangent = position[2] / math.hypot(*position[:2])
    assert math.atan(tangent) == pytest.approx(
        ellipsoid.geocentric(latitude, math.hypot(*position), p, NUMERIC), abs=1e-10
    )
    if latitude > p.orbit_inclination:
        return
    sphere = SimpleNamespace(**{k: v for k, v in vars(p).items() if k != "body_flattening"})
    angle, node = angles(sphere, NUMERIC)
    round_ = orbit.orbit_state(angle, node, sphere, NUMERIC)[0]
    assert math.asin(round_[2] / math.hypot(*round_)) == pytest.approx(latitude, abs=1e-12)


@pytest.mark.parametrize("latitude", [0.0, 0.7, math.pi / 2, -math.pi / 2])
def test_altitude_is_smooth_everywhere(latitude: float) -> None:
    """Its gradient is the upward normal, at the equator and at the poles too, where other formulas have a corner."""
    position = ellipsoid.geodetic_position(0.3, latitude, 120e3, EARTH, NUMERIC)
    x = ca.SX.sym("x", 3)
    height = ellipsoid.altitude([x[i] for i in range(3)], EARTH, SYMBOLIC)
    gradient = ca.Function("g", [x], [ca.gradient(height, x)])
    second = ca.Function("h", [x], [ca.hessian(height, x)[0]])
    up, _, _ = local_axes(0.3, latitude, NUMERIC)
    np.testing.assert_allclose(gradient(ca.DM(position)).full().ravel(), up, atol=1e-9)
    assert np.isfinite(second(ca.DM(position)).full()).all()


def test_without_a_flattening_it_is_a_sphere() -> None:
    sphere = SimpleNamespace(body_radius=6371e3)
    position = ellipsoid.geodetic_position(0.3, -0.8, 10e3, sphere, NUMERIC)
    assert ellipsoid.altitude(position, sphere, NUMERIC) == pytest.approx(10e3, abs=1e-8)
    assert ellipsoid.latitude(position, sphere, NUMERIC) == pytest.approx(-0.8)


@pytest.mark.parametrize(
    ("nose", "base", "angle"), [(0.0, 1.0, 0.4), (0.4, 1.0, 0.3), (1.0, 1.0, 0.0), (0.66, 1.32, 1.2)]
)
def test_drag_of_a_sphere_cone_is_that_of_its_pressures(nose: float, base: float, angle: float) -> None:
    """Newton's pressures summed over the surface: 2 cos^2 of the angle to the stream, on what it faces."""
    cap = quad(
        lambda a: 2 * math.cos(a) ** 2 * 2 * math.pi * nose**2 * math.sin(a) * math.cos(a), 0, math.pi / 2 - angle
    )
    cone = quad(lambda r: 2 * math.sin(angle) ** 2 * 2 * math.pi * r, nose * math.cos(angle), base)
    assert sphere_cone_drag_area(nose, base, angle, NUMERIC) == pytest.approx(cap[0] + cone[0], rel=1e-12)


def test_heat_rate_is_near_that_of_detra_kemp_and_riddell() -> None:
    """Their 11030 W/cm^2 sqrt(rho/(rho0 R)) (V/7925)^3.15 stands 15 % above at orbital speed, as is known."""
    p = SimpleNamespace(heating_constant=aerodynamics.SUTTON_GRAVES, vehicle_nose_radius=2.2)
    density = 3e-4
    rate = aerodynamics.heat_rate(density, (0.0, 7500.0, 0.0), p, NUMERIC)
    other = 11030e4 * math.sqrt(density / 1.225 / 2.2) * (7500.0 / 7925.0) ** 3.15
    assert 0.8 < rate / other < 0.95
    twice = aerodynamics.heat_rate(4 * density, (0.0, 15000.0, 0.0), p, NUMERIC)
    assert twice == pytest.approx(16 * rate, rel=1e-12)


def test_lift_is_across_the_velocity() -> None:
    position, velocity = to_cartesian(WHERE, NUMERIC)
    upward, right = aerodynamics.lift_axes(position, velocity, NUMERIC)
    _, expected, left = path_axes(WHERE, NUMERIC)
    np.testing.assert_allclose(upward, expected, atol=1e-12)
    np.testing.assert_allclose(right, np.negative(left), atol=1e-12)


def test_the_peak_load_of_a_steep_entry_is_that_of_allen_and_eggers() -> None:
    """V^2 sin g/(2 e H g0) for any ballistic coefficient (NACA TR 1381): exact without gravity over flat ground."""
    speed, angle, height = 7000.0, math.radians(-30.0), 7200.0
    p = SimpleNamespace(vehicle_ballistic_coefficient=300.0)
    huge = SimpleNamespace(**{**vars(EARTH), "body_gravitational_parameter": 1.0, "body_rotation_rate": 0.0,
                              "body_radius": 6.4e12, "body_j2": 0.0})  # fmt: skip

    def slowed(y: Any) -> Any:
        density = 1.225 * np.exp(-(y[0] - 6.4e12) / height)
        return aerodynamics.drag(density, y[3:], 1.0, p, NUMERIC)

    start = [6.4e12 + 150e3, 0.0, 0.0, speed * math.sin(angle), speed * math.cos(angle), 0.0]
    flight = flown(start, 42.0, huge, lambda t, y: slowed(y), max_step=0.05)
    loads = np.linalg.norm(slowed(flight.y), axis=0)
    assert loads.max() == pytest.approx(speed**2 * math.sin(-angle) / (2 * math.e * height), rel=1e-4)
    at_peak = np.linalg.norm(flight.y[3:, loads.argmax()])
    assert at_peak == pytest.approx(speed / math.sqrt(math.e), rel=1e-2)


@pytest.mark.parametrize("lift_to_drag", [1.0, 2.0])
def test_a_glide_in_equilibrium_is_that_of_its_closed_form(lift_to_drag: float) -> None:
    """Lift and centrifugal force bear the weight, the path being nearly level; exact as the scale height H goes to 0.

    With v = V/sqrt(g R): rho V^2 (L/D)/(2 B) = g (1 - v^2), sin gamma = -2 H/(R (L/D) v^2), and from v_1 to v_2

        way/R = (L/D)/2 ln[(1 - v_2^2)/(1 - v_1^2)]
        time sqrt(g/R) = (L/D)/2 ln[(1 + v_1)(1 - v_2)/((1 - v_1)(1 + v_2))]

    (Eggers, Allen, Neice, NACA TR 1382, 1957). What is left out is of first order in H/R.
    """
    circular, first, last = math.sqrt(MU / RADIUS), 0.9, 0.3
    ballistic, vehicle = 300.0, namedtuple("Flight", "x y z vx vy vz m")
    up = SimpleNamespace(lift_up=1.0, lift_right=0.0)

    def off(scale_height: float) -> list[float]:
        """Errors of the way and of the time."""
        p = SimpleNamespace(
            body_gravitational_parameter=MU, body_radius=RADIUS, body_j2=0.0, body_rotation_rate=0.0,
            vehicle_ballistic_coefficient=ballistic, vehicle_lift_to_drag=lift_to_drag,
            atmosphere_density=1.225, atmosphere_scale_height=scale_height,
        )  # fmt: skip
        air = exponential(1.225, scale_height)
        density = 2 * ballistic * (1 - first**2) / (RADIUS * lift_to_drag * first**2)
        angle = math.asin(-2 * scale_height / (RADIUS * lift_to_drag * first**2))
        height, speed = scale_height * math.log(1.225 / density), first * circular
        start = [RADIUS + height, 0.0, 0.0, speed * math.sin(angle), speed * math.cos(angle), 0.0]

        def slow(t: float, y: Any) -> float:
            return math.hypot(y[3], y[4]) - last * circular

        slow.terminal = True  # type: ignore[attr-defined]
        flight = solve_ivp(
            lambda t, y: entry_rates(vehicle._make([*y, 1.0]), up, p, NUMERIC, air=air)[:6], (0.0, 1e4), start,
            method="DOP853", rtol=1e-10, atol=1e-3, events=slow,
        )  # fmt: skip
        way = 0.5 * lift_to_drag * math.log((1 - last**2) / (1 - first**2))
        whole = 0.5 * lift_to_drag * math.log((1 + first) * (1 - last) / ((1 - first) * (1 + last)))
        swept = math.atan2(flight.y[1, -1], flight.y[0, -1]) % (2 * math.pi)
        return [swept / way - 1, flight.t[-1] * circular / RADIUS / whole - 1]

    errors = np.array([off(7200.0 / part) for part in (1, 2, 4, 8)])
    assert (errors[0] < 0.065).all()
    np.testing.assert_allclose(errors[:-1] / errors[1:], 2.0, rtol=0.03)
