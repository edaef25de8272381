"""Powered descent in three dimensions: coordinates, the paper's numbers, symmetries, a precision landing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from math import radians
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from perilune import Indirect, Pseudospectral
from perilune.core import NUMERIC, InfeasibleError, PeriluneError
from perilune.methods.indirect.violations import solution_violations
from perilune.models.descent.problem import Ignition, Site, Steering, powered_descent
from perilune.models.landing.problem import Vehicle
from perilune.models.physics.bodies import Body
from perilune.models.physics.rotating_frame import (
    heading_axes,
    local_axes,
    potential,
    spherical_coordinates,
    zonal_gravity,
)
from perilune.models.precision.problem import Approach, Corridor, precision_landing
from perilune.problem import Problem, Solution, preflight, refuse_impossible
from perilune.verify import verify
from problems.peng import LANDER, PENG_MOON, PENG_STEERING, POLE, SITE, peng


@pytest.fixture(scope="module")
def optimum() -> Solution:
    """The paper's descent in Cartesian coordinates by the indirect method, without a guess."""
    return Indirect().run(peng())


# -- the physics
# ------------------------------------------------------------------------------------------------------

# Turns a thousand times faster than the Moon and is as flat as Saturn: no term hides.
WILD = Body(name="wild", gravitational_parameter=4902.8e9, radius=1738e3, rotation_rate=-3e-4)
INCLINED = Ignition(
    altitude=40e3, longitude=0.7, latitude=0.6, heading=2.2, forward_speed=1200.0, sideways_speed=-90.0,
    vertical_speed=35.0,
)  # fmt: skip


def angles(t: float) -> tuple[float, float]:
    """A thrust history that exercises every component: elevation and azimuth."""
    return 0.4 * math.sin(t / 90.0), 2.5 + 0.8 * math.cos(t / 70.0)


def direction(t: float, position: Any, heading: float) -> np.ndarray:
    """The same history as a unit vector in the rotating Cartesian frame."""
    alpha, beta = angles(t)
    _, longitude, latitude = spherical_coordinates(tuple(position), NUMERIC)
    up, oy, oz = (np.array(axis) for axis in heading_axes(longitude, latitude, heading, NUMERIC))
    return math.sin(alpha) * up + math.cos(alpha) * (math.cos(beta) * oy + math.sin(beta) * oz)


def flown(
    problem: Problem, control: Callable[[float, np.ndarray], Any], span: tuple[float, float], x0: Any
) -> np.ndarray:
    """End state under a control law, by SciPy on the problem's own numpy functions."""
    p = problem.parameters({"flight_time": span[1]})
    phase = problem.phases[0]
    out = solve_ivp(
        lambda t, x: phase.rates(x, control(t, x), p), span, x0, method="DOP853", rtol=1e-13, atol=1e-9
    )  # fmt: skip
    assert out.success
    return out.y[:, -1]


def cartesian_of(spherical: np.ndarray, heading: float) -> np.ndarray:
    """Cartesian rotating state of a spherical one."""
    r, theta, phi, u, v, w, mass = spherical
    up, oy, oz = (np.array(axis) for axis in heading_axes(theta, phi, heading, NUMERIC))
    return np.array([*(r * up), *(u * oy + v * oz + w * up), mass])


def spherical_of(cartesian: np.ndarray, heading: float) -> np.ndarray:
    """Spherical state of a Cartesian rotating one."""
    r, theta, phi = spherical_coordinates(tuple(cartesian[:3]), NUMERIC)
    up, oy, oz = (np.array(axis) for axis in heading_axes(theta, phi, heading, NUMERIC))
    return np.array([r, theta, phi, *(cartesian[3:6] @ axis for axis in (oy, oz, up)), cartesian[6]])


def test_both_coordinate_systems_fly_alike() -> None:
    """Away from the poles, on a body where rotation and J2 matter: the same thrust history, the same end."""
    both = {
        name: powered_descent(LANDER, INCLINED, SITE, WILD, j2=0.016, target="anywhere", coordinates=name)
        for name in ("cartesian", "spherical")
    }
    starts = {name: np.array(p.start(p.parameters({}), NUMERIC), dtype=float) for name, p in both.items()}
    assert cartesian_of(starts["spherical"], INCLINED.heading) == pytest.approx(
        starts["cartesian"], rel=1e-14, abs=1e-9
    )
    span = (0.0, 400.0)
    one = flown(both["cartesian"], lambda t, x: direction(t, x[:3], INCLINED.heading), span, starts["cartesian"])
    other = flown(both["spherical"], lambda t, x: angles(t), span, starts["spherical"])
    other = cartesian_of(other, INCLINED.heading)
    # Measured: 1e-13 and 4e-13.
    assert np.linalg.norm(one[:3] - other[:3]) < 1e-11 * np.linalg.norm(one[:3])
    assert np.linalg.norm(one[3:6] - other[3:6]) < 1e-11 * np.linalg.norm(one[3:6])
    assert one[6] == pytest.approx(other[6], rel=1e-13)


def test_start_over_the_pole() -> None:
    """Cartesian from the pole; the spherical flight joins it where tan(phi) is finite, and ends with it."""
    cartesian, spherical = peng(), peng(coordinates="spherical")
    x0 = np.array(cartesian.start(cartesian.parameters({}), NUMERIC), dtype=float)
    assert x0[:6] == pytest.approx([0, 0, 1753e3, 1694.3, 0, 0], abs=1e-9)
    law = lambda t, x: direction(t, x[:3], POLE.heading)  # noqa: E731
    at_20, end = (flown(cartesian, law, (0.0, t), x0) for t in (20.0, 470.0))
    joined = flown(spherical, lambda t, x: angles(t), (20.0, 470.0), spherical_of(at_20, POLE.heading))
    assert cartesian_of(joined, POLE.heading) == pytest.approx(end, rel=1e-9, abs=1e-5)


def test_rotating_frame_against_inertial_flight() -> None:
    """Coriolis and centrifugal terms against a flight in inertial axes, where there are none."""
    problem = powered_descent(LANDER, INCLINED, SITE, WILD, target="anywhere")
    x0 = np.array(problem.start(problem.parameters({}), NUMERIC), dtype=float)
    omega, T = np.array([0.0, 0.0, WILD.rotation_rate]), 300.0
    push = np.array([-0.6, 0.64, 0.48])  # fixed in the rotating frame

    def turned(t: float) -> np.ndarray:
        c, s = math.cos(omega[2] * t), math.sin(omega[2] * t)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def inertial(t: float, x: np.ndarray) -> np.ndarray:
        r = x[:3]
        mass = LANDER.mass - LANDER.thrust / (LANDER.specific_impulse * LANDER.standard_gravity) * t
        gravity_there = -WILD.gravitational_parameter * r / np.linalg.norm(r) ** 3
        return np.concatenate([x[3:], gravity_there + LANDER.thrust / mass * turned(t) @ push])

    seen = flown(problem, lambda t, x: push, (0.0, T), x0)
    start = np.concatenate([x0[:3], x0[3:6] + np.cross(omega, x0[:3])])
    truth = solve_ivp(inertial, (0.0, T), start, method="DOP853", rtol=1e-13, atol=1e-9).y[:, -1]
    r = turned(T) @ seen[:3]
    v = turned(T) @ (seen[3:6] + np.cross(omega, seen[:3]))
    assert np.concatenate([r, v]) == pytest.approx(truth, rel=1e-10, abs=1e-6)


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.0, 0.6, 0.8)])
def test_gravity_is_the_gradient_of_its_potential(axis: tuple[float, float, float]) -> None:
    """By complex steps, exact to rounding; and without J2 it is that of a point mass."""
    p = SimpleNamespace(body_gravitational_parameter=4902.8e9, body_radius=1738e3, body_j2=0.1)
    rng = np.random.default_rng(3)
    for position in rng.normal(size=(6, 3)) * 2e6:
        slopes = [
            np.imag(potential([c + 1e-20j * (i == j) for j, c in enumerate(position)], axis, p, NUMERIC)) / 1e-20
            for i in range(3)
        ]
        assert zonal_gravity(tuple(position), axis, p, NUMERIC) == pytest.approx([-s for s in slopes], rel=1e-12)
    p.body_j2 = 0.0
    position = np.array([1e6, -2e6, 0.5e6])
    point = -p.body_gravitational_parameter * position / np.linalg.norm(position) ** 3
    assert zonal_gravity(tuple(position), axis, p, NUMERIC) == pytest.approx(point, rel=1e-14)


# -- the paper's landing
# ----------------------------------------------------------------------------------------------


def test_peng_2012(optimum: Solution) -> None:
    """Flight time and fuel; the printed 472.74 s and 5947.2 kg are 0.06 s and 0.7 kg away."""
    time, fuel = optimum.free["flight_time"], LANDER.mass - optimum.trajectories[0].state.values[-1, -1]
    assert time == pytest.approx(472.796, abs=2e-3)
    assert fuel == pytest.approx(5947.95, abs=0.03)
    assert time == pytest.approx(472.74, abs=0.10)
    assert fuel == pytest.approx(5947.2, abs=1.2)
    end = optimum.outputs(0, np.array([time]))
    assert math.degrees(float(end["latitude"][0])) == pytest.approx(76.0, abs=1e-9)
    assert math.degrees(float(end["longitude"][0])) == pytest.approx(5.0, abs=1e-9)
    assert float(end["altitude"][0]) == pytest.approx(2e3, abs=1e-5)


def test_without_rotation() -> None:
    """The other published value: 472.73 s on a Moon that does not turn."""
    still = Indirect().run(peng(replace(PENG_MOON, rotation_rate=0.0)))
    assert still.free["flight_time"] == pytest.approx(472.73, abs=5e-3)


def test_least_time_is_least_propellant(optimum: Solution) -> None:
    """The two objectives share their optimum; H is -1 for time and 0 for mass."""
    fastest = Indirect().run(peng(minimise="flight_time"))
    assert fastest.objective == pytest.approx(optimum.free["flight_time"], rel=1e-11)
    for solution, required in ((fastest, -1.0), (optimum, 0.0)):
        problem, trajectory = solution.problem, solution.trajectories[0]
        t = np.linspace(0.0, trajectory.duration, 40)
        assert trajectory.costate is not None
        x, u, lam = (curve(t).T for curve in (trajectory.state, trajectory.control, trajectory.costate))
        rates = problem.phases[0].rates(list(x), list(u), solution.parameters)
        H = sum(a * b for a, b in zip(lam, rates, strict=True))
        # One canonical unit of H: that of J over that of time.
        unit = problem.scales.of(problem.objective_unit) / problem.scales.time
        assert np.abs(H - required).max() < 1e-8 * unit


def test_the_paper_s_own_coordinates(optimum: Solution) -> None:
    """Gauss points in the singular coordinates with bounded angles, from the pole: the same time."""
    problem = peng(coordinates="spherical", steering=PENG_STEERING)
    direct = Pseudospectral(nodes=30, refine=0).run(problem)
    assert direct.free["flight_time"] == pytest.approx(optimum.free["flight_time"], abs=1e-6)
    t = np.linspace(0.05, 0.95, 19) * direct.free["flight_time"]
    one, other = direct.outputs(0, t), optimum.outputs(0, t)
    for name in ("altitude", "latitude", "longitude", "forward_speed", "sideways_speed", "vertical_speed"):
        assert one[name] == pytest.approx(other[name], rel=1e-5, abs=1e-4), name
    for name in ("thrust_elevation", "thrust_azimuth"):
        assert one[name] == pytest.approx(other[name], abs=1e-4), name


def test_freedom_costs_nothing_and_is_used_rightly(optimum: Solution) -> None:
    """Anywhere <= downrange <= the site; and the free site, named, takes the same time."""
    anywhere, downrange = (Indirect().run(peng(target=target)) for target in ("anywhere", "downrange"))
    times = [s.free["flight_time"] for s in (anywhere, downrange, optimum)]
    assert times[0] < times[1] < times[2]
    end = anywhere.outputs(0, np.array([times[0]]))
    found = Site(altitude=2e3, longitude=float(end["longitude"][0]), latitude=float(end["latitude"][0]))
    assert Indirect().run(peng(site=found)).free["flight_time"] == pytest.approx(times[0], rel=1e-9)
    landed = downrange.trajectories[0].state.values[-1, :3]
    starts = [np.array(local_axes(s.longitude, s.latitude, NUMERIC)[0]) for s in (POLE, SITE)]
    assert landed @ np.cross(starts[0], starts[1]) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("coordinates", ["cartesian", "spherical"])
def test_anywhere_needs_no_place(coordinates: str) -> None:
    """The same flight as beside a place that does not matter, by the direct method too, whose guess ends there."""
    settings = {"target": "anywhere", "coordinates": coordinates, "start": INCLINED}
    named, free = (peng(site=site, **settings) for site in (SITE, Site(altitude=2e3)))
    assert "site_longitude" in named.given and "site_longitude" not in free.given
    direct = [Pseudospectral(nodes=12).run(problem).objective for problem in (named, free)]
    assert direct[1] == pytest.approx(direct[0], rel=1e-6)
    if coordinates == "cartesian":
        one, other = (Indirect().run(problem) for problem in (named, free))
        assert other.objective == pytest.approx(one.objective, rel=1e-10)
        assert verify(other).verification.level == 3


def test_a_guess_of_a_landing_anywhere_lies_ahead() -> None:
    """On the ground, by the way that full throttle needs, and without a jump of the longitude."""
    start = replace(INCLINED, longitude=radians(179.9), heading=radians(90.0), latitude=0.1, sideways_speed=0.0)
    for coordinates in ("cartesian", "spherical"):
        problem = peng(site=Site(), start=start, target="anywhere", coordinates=coordinates)
        p, typical_end = problem.parameters({"flight_time": 400.0}), problem.phases[0].end_guess
        assert typical_end is not None
        end = np.array(typical_end(p, NUMERIC), dtype=float)
        if coordinates == "cartesian":
            end = spherical_of(end, start.heading)
            end[1] = end[1] % (2 * math.pi)
        assert end[0] == pytest.approx(PENG_MOON.radius, rel=1e-12)
        ahead = (end[1] - start.longitude) * PENG_MOON.radius
        assert 0.3 < ahead / (0.5 * start.forward_speed * 400.0) < 2.0


def test_symmetries(optimum: Solution) -> None:
    """Turned about the axis, and mirrored together with the rotation: the same flight time."""
    turn = radians(37.0)
    assert SITE.longitude is not None
    turned = peng(
        start=replace(POLE, longitude=POLE.longitude + turn),
        site=replace(SITE, longitude=SITE.longitude + turn),
    )
    mirrored = peng(
        replace(PENG_MOON, rotation_rate=-PENG_MOON.rotation_rate),
        site=replace(SITE, longitude=-SITE.longitude),
    )
    for problem in (turned, mirrored):
        assert Indirect().run(problem).free["flight_time"] == pytest.approx(optimum.free["flight_time"], rel=1e-10)


def test_steering_bounds_are_kept(optimum: Solution) -> None:
    """The paper's do not bind. Where others do, the thrust is held at them, as the direct method holds it."""
    free = Indirect().run(peng(steering=PENG_STEERING))
    assert free.free["flight_time"] == pytest.approx(optimum.free["flight_time"], rel=1e-11)
    tight = Steering(elevation=(radians(-50), radians(25)), azimuth=PENG_STEERING.azimuth)
    held = Indirect().run(peng(steering=tight))
    ridden = Pseudospectral(nodes=30, refine=0).run(peng(coordinates="spherical", steering=tight))
    assert ridden.trajectories[0].control.values[:, 0].max() == pytest.approx(radians(25), abs=1e-6)
    assert ridden.free["flight_time"] > optimum.free["flight_time"] + 0.01
    assert held.free["flight_time"] == pytest.approx(ridden.free["flight_time"], rel=1e-7)
    steepest = held.outputs(0, np.linspace(0.0, held.free["flight_time"], 500))["thrust_elevation"].max()
    assert steepest == pytest.approx(radians(25), abs=1e-9)


def test_margins_of_the_steering_are_those_of_its_angles(optimum: Solution) -> None:
    """At bounds on both sides: of the elevation differences of sines, of the azimuth of the angles themselves."""
    tight = Steering(elevation=(radians(-50), radians(25)), azimuth=(radians(100), radians(250)))
    problem = peng(steering=tight)
    t = np.linspace(0.0, optimum.free["flight_time"], 20)
    angles = optimum.outputs(0, t)
    elevation, azimuth = angles["thrust_elevation"], angles["thrust_azimuth"]
    _, low, high, right, left = problem.phases[0].evaluate(
        "path", *optimum.evaluate(0, t), problem.parameters(optimum.free)
    )
    assert low == pytest.approx(np.sin(elevation) - np.sin(radians(-50)), abs=1e-12)
    assert high == pytest.approx(np.sin(radians(25)) - np.sin(elevation), abs=1e-12)
    assert right == pytest.approx(azimuth - radians(100), abs=1e-12)
    assert left == pytest.approx(radians(250) - azimuth, abs=1e-12)


# -- a precision landing
# ----------------------------------------------------------------------------------------------


def approach(corridor: Corridor | None = None, **changes: Any) -> Problem:
    """From 2.4 km away and 1 km up, near the south pole, in a corridor that binds unless another is given."""
    settings: dict[str, Any] = {
        "vehicle": Vehicle(mass=2000.0, thrust=8000.0, specific_impulse=310.0),
        "approach": Approach(east=-2400.0, north=300.0, up=1000.0, east_speed=50.0, up_speed=-30.0),
        "site": Site(altitude=0.0, longitude=0.0, latitude=radians(-85)),
        "corridor": corridor or Corridor(tilt=radians(45), slope=radians(21)),
        "throttle": (0.3, 0.9),
        "dry_mass": 1200.0,
    }
    return precision_landing(**{**settings, **changes})


def test_precision_landing_keeps_its_corridor() -> None:
    """Re-flown by SciPy under the exported control: at rest on the site, within every limit, at a price."""
    problem = approach()
    wide = Indirect().run(approach(Corridor(tilt=radians(80), slope=radians(5))))
    kept = Pseudospectral(nodes=12, segments=4, tolerance=1e-3).run(problem)
    assert wide.objective + 0.01 < kept.objective < wide.objective + 1.0
    t = np.linspace(0.0, kept.free["flight_time"], 301)
    state, control = kept.trajectories[0].state(t), kept.trajectories[0].control(t)
    tilt = np.degrees(np.arccos(control[:, 2]))
    assert tilt.max() == pytest.approx(45.0, abs=0.1)  # rides the limit; measured 45.014
    assert np.sum(tilt > 44.9) > 20
    assert control[:, 3].min() == pytest.approx(0.3, abs=1e-6)
    assert control[:, 3].max() == pytest.approx(0.9, abs=1e-6)
    above_slope = problem.phases[0].evaluate("path", list(state.T), list(control.T), kept.parameters)[0]
    assert np.min(above_slope) > -1e-6
    x0 = np.array(problem.start(kept.parameters, NUMERIC), dtype=float)
    landed = reflown(problem, kept, x0)
    assert np.abs(landed[:3]).max() < 0.01  # measured 6e-4 m, 2e-5 m/s
    assert np.abs(landed[3:6]).max() < 1e-3
    assert landed[6] == pytest.approx(-kept.objective, abs=1e-4)


def test_a_bound_of_the_throttle_is_a_parameter() -> None:
    """Given anew it is the same problem as one stated so: less thrust at most, more propellant."""
    wide = Corridor(tilt=radians(80), slope=radians(5))
    stated = Indirect().run(approach(wide, throttle=(0.3, 0.7)))
    changed = Indirect().run(approach(wide).with_given(throttle_upper=0.7))
    assert changed.objective == pytest.approx(stated.objective, abs=1e-6)
    assert changed.trajectories[0].control.values[:, 3].max() == pytest.approx(0.7, abs=1e-9)
    full = Indirect().run(approach(wide))
    assert full.objective < stated.objective - 0.1
    assert not list(solution_violations(full, 1e-8)) and not list(solution_violations(changed, 1e-8))
    (breach,) = solution_violations(replace(full, problem=changed.problem), 1e-8)
    assert breach.text == "throttle rises to 0.9, above throttle.upper of 0.7"


def reflown(problem: Problem, solution: Solution, x0: np.ndarray) -> np.ndarray:
    """End of a re-flight under an exported control, which has kinks."""
    law = solution.trajectories[0].control
    out = solve_ivp(
        lambda t, x: problem.phases[0].rates(x, law(t), solution.parameters),
        (0.0, solution.free["flight_time"]), x0, method="DOP853", rtol=1e-8, atol=1e-6, max_step=0.5,
    )  # fmt: skip
    return out.y[:, -1]


def test_precision_frame_is_the_cartesian_one() -> None:
    """The site's frame against rotating Cartesian axes: the same constant thrust, the same end."""
    p = approach(body=WILD, j2=0.016, throttle=(0.0, 1.0))
    given = {name: g.value for name, g in p.given.items()}
    x0 = np.array(p.start(p.parameters({}), NUMERIC), dtype=float)
    push = np.array([0.48, -0.6, 0.64])
    local = flown(p, lambda t, x: (*push, 1.0), (0.0, 60.0), x0)
    up, north, east = (np.array(a) for a in local_axes(given["site_longitude"], given["site_latitude"], NUMERIC))
    basis = np.column_stack([east, north, up])
    vehicle = Vehicle(mass=2000.0, thrust=8000.0, specific_impulse=310.0)
    far = powered_descent(vehicle, INCLINED, SITE, WILD, j2=0.016, target="anywhere")
    there = np.array([*(basis @ (x0[:3] + np.array([0.0, 0.0, WILD.radius]))), *(basis @ x0[3:6]), x0[6]])
    end = flown(far, lambda t, x: basis @ push, (0.0, 60.0), there)
    assert basis @ (local[:3] + np.array([0.0, 0.0, WILD.radius])) == pytest.approx(end[:3], rel=1e-12, abs=1e-6)
    assert basis @ local[3:6] == pytest.approx(end[3:6], abs=1e-8)


# -- what is refused
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: replace(POLE, latitude=radians(91)), "latitude lies beyond the pole"),
        (lambda: replace(POLE, forward_speed=math.nan), "forward_speed is not finite"),
        (lambda: replace(SITE, latitude=90.0), "latitude lies beyond the pole"),
        (lambda: Steering(elevation=(0.5, 0.1)), "elevation are not a range"),
        (lambda: Steering(azimuth=(2.0, 7.0)), "azimuth are not a range"),
        (lambda: peng(dry_mass=15e3), "leaves no propellant"),
        (lambda: peng(throttle=(0.5, 1.2)), "throttle.upper is out of range"),
        (lambda: peng(throttle=(0.6, 0.5)), "throttle's bounds"),
        (lambda: approach().with_given(throttle_lower=0.95), "throttle's bounds"),
        (lambda: peng(steering=PENG_STEERING).with_given(steering_azimuth_upper=1.0), "azimuth are not a range"),
        (lambda: peng(site=Site()), "site.longitude is missing"),
        (lambda: peng(site=Site(altitude=2e3), target="downrange"), 'the target "anywhere"'),
        (lambda: Site(latitude=1.0), "site.longitude is missing"),
        (lambda: Site(longitude=1.0), "site.latitude is missing"),
        (lambda: peng(coordinates="polar"), "unknown coordinates"),
        (lambda: peng(target="crater"), "unknown target"),
        (lambda: peng(minimise="cost"), "unknown minimise"),
        (lambda: peng(site=replace(SITE, altitude=-2e9)), "below the centre"),
        (lambda: Corridor(tilt=radians(95), slope=0.5), "tilt is not an angle"),
        (lambda: Corridor(tilt=0.5, slope=0.5, pad_radius=0.0), "pad_radius must be positive"),
    ],
)
def test_bad_input_is_named(make: Callable[[], object], text: str) -> None:
    """By what is wrong, before anything is solved."""
    with pytest.raises(PeriluneError, match=text):
        make()


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: peng(site=replace(SITE, altitude=16e3)), "does not start above its site"),
        (lambda: peng().with_given(site_altitude=20e3), "does not start above its site"),
        (lambda: approach().with_given(approach_up=-1.0), "does not start above its site"),
        (lambda: peng(dry_mass=10e3), "propellant cannot remove the initial speed"),
        (lambda: peng(dry_mass=9000.0, site=replace(SITE, latitude=radians(-20))), "site cannot be reached"),
        (lambda: approach(Corridor(tilt=radians(40), slope=radians(60))), "starts below the glide slope"),
        (lambda: approach(throttle=(0.85, 0.9)), "hovers or climbs"),
        (lambda: approach(throttle=(0.1, 0.2)), "cannot stop the descent"),
    ],
)  # fmt: skip
def test_the_impossible_is_refused(make: Callable[[], Problem], text: str) -> None:
    """By the limit and by how much it is missed; the problem itself may be stated."""
    problem = make()
    with pytest.raises(InfeasibleError, match=text):
        refuse_impossible(preflight(problem))
