"""A free fall before ignition, whose length is chosen: beside the same landing from where SciPy falls to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from perilune.models.descent.problem import Ignition, Site, powered_descent
from perilune.models.physics.bodies import MOON
from perilune.models.physics.coast import SHORTEST
from perilune.models.physics.vehicle import Vehicle
from perilune.models.precision.problem import Approach, Corridor, precision_landing
from perilune.problem import Problem, Solution, preflight, refuse_impossible
from perilune.report.figures import solution_figures
from perilune.scenario import load_file
from perilune.solve import solve

EXAMPLES = Path(__file__).parents[2] / "examples"
LANDER = Vehicle(mass=2000.0, thrust=8000.0, specific_impulse=310.0, dry_mass=1200.0)
HIGH = Approach(east=-2500.0, north=300.0, up=3000.0, east_speed=50.0, up_speed=-30.0)
NEAR = Approach(east=-1800.0, north=300.0, up=1000.0, east_speed=50.0, up_speed=-30.0)
SITE = Site(longitude=0.0, latitude=np.radians(-85.0))
CORRIDOR = Corridor(tilt=np.radians(50.0), slope=np.radians(20.0))


def landing(approach: Approach, corridor: Corridor | None = CORRIDOR) -> Problem:
    return precision_landing(LANDER, approach, SITE, corridor, (0.3, 0.9), MOON)


@pytest.fixture(scope="module")
def falls() -> Solution:
    """The high approach with its ignition free, proved."""
    return solve(landing(replace(HIGH, longest_coast=100.0)))


def fallen(time: float) -> Approach:
    """The approach after a fall, by SciPy in inertial axes with the Moon's point mass alone."""
    assert SITE.latitude is not None and SITE.longitude is not None
    mu, omega, R = MOON.gravitational_parameter, MOON.rotation_rate, MOON.radius
    sine, cosine = np.sin(SITE.latitude), np.cos(SITE.latitude)
    # Rows: east, north, up of the site at the first moment; the axis is z.
    axes = np.array([[0.0, 1.0, 0.0], [-sine, 0.0, cosine], [cosine, 0.0, sine]])
    spin = np.array([0.0, 0.0, omega])
    place = np.array([HIGH.east, HIGH.north, HIGH.up + R]) @ axes
    speed = np.array([HIGH.east_speed, HIGH.north_speed, HIGH.up_speed]) @ axes + np.cross(spin, place)

    def rates(t: float, y: Any) -> Any:
        return [*y[3:], *(-mu / np.linalg.norm(y[:3]) ** 3 * y[:3])]

    flown = solve_ivp(rates, (0.0, time), [*place, *speed], method="DOP853", rtol=1e-13, atol=1e-9).y[:, -1]
    c, s = np.cos(omega * time), np.sin(omega * time)
    turned = axes @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    position, velocity = turned @ flown[:3], turned @ (flown[3:] - np.cross(spin, flown[:3]))
    return Approach(
        east=position[0], north=position[1], up=position[2] - R,
        east_speed=velocity[0], north_speed=velocity[1], up_speed=velocity[2],
    )  # fmt: skip


def test_ignition_is_where_it_lands_most(falls: Solution) -> None:
    assert falls.outcome.name == "PROVED" and falls.verification.level == 3
    best, time = falls.results["landed_mass"].value, falls.free["coast_time"]
    assert falls.results["coast_time"].value == time > 10.0
    # Later is too late: the burn is at full throttle from ignition on.
    assert np.all(falls.trajectories[1].control(np.linspace(1.0, falls.free["flight_time"], 50))[:, 3] == 0.9)
    earlier, sooner, then = (
        solve(landing(fallen(time - ahead), None), verify=0).results["landed_mass"].value for ahead in (4.0, 2.0, 0.0)
    )
    assert then == pytest.approx(best, abs=1e-6)
    assert earlier < sooner < best - 1e-3
    assert solve(landing(HIGH, None), verify=0).results["landed_mass"].value < best - 1.0


def test_velocity_change_is_split_over_fall_and_burn(falls: Solution) -> None:
    spent = {name: falls.results[name].value for name in ("main_delta_v", "gravity_loss", "steering_loss")}
    speed = np.hypot(HIGH.east_speed, HIGH.up_speed)
    assert spent["main_delta_v"] - spent["gravity_loss"] - spent["steering_loss"] == pytest.approx(speed, abs=1e-6)


def test_where_the_engine_should_light_at_once_it_does() -> None:
    at_once = solve(landing(NEAR), verify=0).results["landed_mass"].value
    free = solve(landing(replace(NEAR, longest_coast=100.0)))
    assert free.outcome.name == "PROVED"
    assert free.free["coast_time"] == SHORTEST
    assert free.extremals[0].nature.value.endswith("at a bound")
    assert free.results["landed_mass"].value == pytest.approx(at_once, abs=1e-3)


def test_a_site_far_downrange_needs_a_fall_first(tmp_path: Path) -> None:
    # With constant thrust the burn has one length, so that a fixed site is near only one place of ignition.
    lander = Vehicle(mass=15e3, thrust=45e3, specific_impulse=365.0)
    start = Ignition(
        altitude=15e3, longitude=0.0, latitude=np.pi / 2, heading=np.pi, forward_speed=1694.3, longest_coast=3000.0
    )  # fmt: skip
    site = Site(altitude=2000.0, longitude=np.radians(5.0), latitude=np.radians(60.0))
    solution = solve(powered_descent(lander, start, site, MOON), verify=2)
    assert solution.outcome.name == "PROVED"
    assert 200.0 < solution.free["coast_time"] < 400.0


def test_figures_show_the_fall_and_the_burn(falls: Solution) -> None:
    drawn = solution_figures(falls)
    assert {"steering", "mass", "velocities", "track", "costates", "hamiltonian"} == drawn.keys()
    assert drawn["mass"].axes[0].get_xlabel() == "time from the start (s)"
    time = falls.free["coast_time"]
    begins = {name: np.asarray(drawn[name].axes[0].lines[0].get_xdata())[0] for name in ("steering", "mass")}
    assert begins == {"steering": pytest.approx(time), "mass": 0.0}


def test_a_fall_is_not_refused_for_what_only_a_burn_cannot() -> None:
    def stated(**changes: str) -> Problem:
        pairs = [f"{key.replace('__', '.')}={value}" for key, value in changes.items()]
        return load_file(EXAMPLES / "precision_landing.toml", pairs).problem

    hovers = [f.name for f in preflight(stated(throttle__lower="0.85")) if f.verdict == "impossible"]
    assert hovers == ["descent speed that reaches the site with the throttle at its floor"]
    refuse_impossible(preflight(stated(throttle__lower="0.85", approach__longest_coast="60 s")))
    far = ["vehicle.dry_mass=9 t", "site.latitude=-20 deg"]
    polar = EXAMPLES / "polar_descent.toml"
    assert "distance to the site" in {f.name for f in preflight(load_file(polar, far).problem)}
    falling = load_file(polar, [*far, "start.longest_coast=3000 s"]).problem
    assert "distance to the site" not in {f.name for f in preflight(falling)}
    assert falling.with_given(start_longest_coast=100.0).free[1].upper == 100.0


def test_without_a_corridor_only_the_ground_is_in_the_way() -> None:
    free, held = solve(landing(NEAR, None), verify=1), solve(landing(NEAR), verify=0)
    assert free.outcome.name == "PROVED"
    assert [c.name for c in free.problem.phases[0].path_conditions] == ["height_above_site"]
    assert free.results["landed_mass"].value >= held.results["landed_mass"].value - 1e-9
    side = solution_figures(free)["track"].axes[0]
    assert "glide slope" not in [line.get_label() for line in side.lines]


def test_what_is_read_off_the_fall_is_what_a_burn_without_thrust_says(falls: Solution) -> None:
    fall, burn = falls.problem.phases
    flown = falls.trajectories[0]
    t = np.linspace(0.0, flown.duration, 5)
    x, off = list(flown.state(t).T), [np.zeros(len(t))] * len(burn.control_names)
    with np.errstate(all="ignore"):  # the angles of a thrust that there is none of
        whole = burn.evaluate("outputs", x, off, falls.parameters)
    known = dict(zip((v.name for v in burn.output_variables), whole, strict=True))
    read = dict(
        zip((v.name for v in fall.output_variables), fall.evaluate("outputs", x, [], falls.parameters), strict=True)
    )
    assert read and read.keys() < known.keys()
    for name, value in read.items():
        assert np.asarray(value) == pytest.approx(np.asarray(known[name]), rel=1e-12)
