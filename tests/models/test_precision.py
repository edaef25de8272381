"""Precision landings: over flat ground, beside the statement of the paper; with a vertical end; and what is refused."""

from __future__ import annotations

import math
from bisect import bisect
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import perilune as pl
from perilune.cli import run_command_line
from perilune.core import NUMERIC, InfeasibleError, NotConvergedError, Outcome, PeriluneError
from perilune.models.descent.problem import Site
from perilune.models.physics.bodies import CERES, MOON, Body, UniformGravity
from perilune.models.physics.vehicle import Vehicle
from perilune.models.precision.final_descent import FinalDescent
from perilune.models.precision.problem import Approach, Corridor, precision_landing
from perilune.problem import Problem, Solution, preflight
from perilune.scenario import load_file, load_text
from perilune.solve import solve
from problems.constrained import mars_glide_slope

EXAMPLES = Path(__file__).parents[2] / "examples"
MARS = EXAMPLES / "mars_pinpoint.toml"
PRECISION = EXAMPLES / "precision_landing.toml"
LANDER = Vehicle(mass=2000.0, thrust=8000.0, specific_impulse=310.0, dry_mass=1200.0)
NEAR = Approach(east=-1800.0, north=300.0, up=1000.0, east_speed=50.0, up_speed=-30.0)
FLAT = UniformGravity(gravity=1.62)


def over_flat_ground(corridor: Corridor | None = None, **changes: Any) -> Problem:
    made: dict[str, Any] = {"vehicle": LANDER, "approach": NEAR, "site": None, "throttle": (0.3, 0.9), "body": FLAT}
    return precision_landing(**{**made, "corridor": corridor, **changes})


def without(*keys: str) -> Problem:
    """The landing on Mars less some lines of its file."""
    lines = MARS.read_text(encoding="utf-8").splitlines()
    return load_text("\n".join(line for line in lines if not line.startswith(keys)))


# -- flat ground


@pytest.fixture(scope="module")
def touching() -> Solution:
    """The landing on Mars, proved."""
    return solve(load_file(MARS).problem)


def test_the_landing_on_mars_is_the_papers(touching: Solution) -> None:
    """Proved, and the same to a milligram as the plane problem that is stated without any model."""
    assert touching.outcome is Outcome.PROVED and touching.verification.level == 3
    stated = solve(mars_glide_slope(), verify=0)
    assert touching.results["propellant"].value == pytest.approx(stated.results["propellant"].value, abs=1e-3)
    assert touching.results["propellant"].value == pytest.approx(398.0697, abs=1e-4)
    assert touching.results["flight_time"].value == pytest.approx(stated.results["time"].value, abs=1e-3)
    north = touching.trajectories[0].state.values[:, touching.problem.phases[0].state_names.index("north")]
    assert np.abs(north).max() < 1e-6  # m: nothing pulls out of the plane


def test_without_a_slope_the_ground_is_touched() -> None:
    """Proved, and what the direct method knows of it agrees to a gram or so of its mesh."""
    problem = without("slope", "pad_radius")
    found = solve(problem)
    assert found.outcome is Outcome.PROVED and found.verification.level == 3
    heights = found.trajectories[0].state.values[:, 2]
    inner = heights[5:-5]
    assert abs(inner.min()) < 1e-4 and heights.max() > 1e3  # m
    direct = solve(problem, pl.Pseudospectral(), verify=0)
    assert found.results["propellant"].value == pytest.approx(direct.results["propellant"].value, abs=2e-3)


def test_flat_ground_is_that_of_a_body_without_end() -> None:
    """Rates of every state, beside a round body of a million kilometres with the same gravity at its site."""
    huge = Body(name="body", gravitational_parameter=1.62e18, radius=1e9, rotation_rate=0.0)
    round_one = over_flat_ground(body=huge, site=Site(longitude=0.3, latitude=0.7))
    x, u = (-1800.0, 300.0, 1000.0, 50.0, -3.0, -30.0, 1900.0), (0.6, 0.0, 0.8, 0.7)
    flat, curved = (p.phases[0].rates(x, u, p.parameters({})) for p in (over_flat_ground(), round_one))
    assert flat == pytest.approx(curved, abs=1e-5)
    push = 0.7 * 8000.0 / 1900.0
    assert flat[3:6] == pytest.approx((0.6 * push, 0.0, 0.8 * push - 1.62), rel=1e-15)


def test_comparisons_over_flat_ground() -> None:
    """Each with its value by hand."""
    found = {f.name: f for f in preflight(over_flat_ground())}
    assert found["thrust-to-weight ratio at ignition"].value == pytest.approx(7200.0 / (2000.0 * 1.62))
    assert found["landed mass that the thrust can hold"].value == pytest.approx(7200.0 / 1.62)
    fall = math.sqrt(50.0**2 + 30.0**2 + 2 * 1.62 * 1000.0)
    assert found["speed to be removed"].value == pytest.approx(fall)
    # Full thrust straight up, until the fall of 30 m/s ends: no less than its way, and nearly all of it.
    c, tau = 310.0 * 9.80665, 2000.0 * 310.0 * 9.80665 / 7200.0
    t: Any = brentq(lambda t: 30.0 + 1.62 * t + c * math.log(1 - t / tau), 1.0, 60.0)
    way = (30.0 - c) * t + 0.81 * t * t - (tau - t) * c * math.log(1 - t / tau)
    assert 0.98 * way < found["stopping distance at full thrust"].value <= way


def test_the_bound_of_stopping_is_sharp_over_flat_ground() -> None:
    """The fastest fall from 500 m that full thrust stops is let through, and none that is much faster."""
    c, a = 310.0 * 9.80665, 7200.0 / 2000.0

    def stops(speed: float) -> bool:
        t = np.linspace(0.0, 100.0, 400_001)
        v = -speed - c * np.log1p(-a / c * t) - 1.62 * t
        at = int(np.argmax(v >= 0))
        return bool(500.0 + np.trapezoid(v[:at], t[:at]) > 0)

    def passed(speed: float) -> bool:
        start = Approach(east=0.0, north=0.0, up=500.0, up_speed=-speed)
        found = preflight(over_flat_ground(approach=start))
        return bool(next(f for f in found if f.name == "stopping distance at full thrust").passed)

    truth, bound = (max(s for s in range(20, 120) if may(float(s))) for may in (stops, passed))
    assert truth <= bound < 1.03 * truth


@pytest.mark.parametrize(
    ("change", "what", "also"),
    [
        ("body.name=mars", "body.gravity replaces other quantities", "omit body.gravity"),
        ("body.radius=3389.5 km", "body.gravity replaces other quantities", "body.gravity, body.radius"),
        ("body.gravity=3.7114", "body.gravity - this is not a quantity", "3.7114 m/s^2"),
        ("body.gravity=3.7114 m/s", "body.gravity - the unit has the wrong dimension", "the Earth has 9.8 m/s^2"),
        ("throttle.lower=5 kN", "throttle.lower - the unit has the wrong dimension", "divide a thrust in newtons"),
        ("body.gravity=3.7114 km/s^2", "body.gravity is out of range", "the Earth has 9.8 m/s^2"),
        ("body.gravity=-3.7114 m/s^2", "body.gravity is out of range", "the Earth has 9.8 m/s^2"),
        ("body.gravitiy=3.7 m/s^2", "no key of this name in [body]", "gravity"),
        ("site.latitude=4 deg", "site.longitude is missing", "perilune new"),
        ("approach.east=2000 km", "so far away that no ground is flat", "km in place of m"),
        ("corridor.pad_radius=0 m", "corridor.pad_radius must be positive", "0 m"),
    ],
)  # fmt: skip
def test_a_slip_is_named(change: str, what: str, also: str) -> None:
    with pytest.raises(PeriluneError) as caught:
        load_file(MARS, [change])
    assert what in caught.value.what
    assert also in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_site_over_flat_ground_is_refused() -> None:
    with pytest.raises(PeriluneError, match="flat ground has no longitude") as caught:
        load_file(MARS, ["site.latitude=4 deg", "site.longitude=3 deg"])
    assert "[site]" in caught.value.advice
    with pytest.raises(PeriluneError, match="flat ground has no longitude"):
        over_flat_ground(j2=1e-3)


def test_a_round_body_needs_its_site() -> None:
    text = PRECISION.read_text(encoding="utf-8")
    with pytest.raises(PeriluneError, match="site is missing"):
        load_text(text.replace("[site]", "").replace('longitude = "0 deg"', "").replace('latitude = "-85 deg"', ""))
    with pytest.raises(PeriluneError, match="site is missing"):
        over_flat_ground(body=MOON)


def test_a_body_with_nothing_stated_offers_all_ways() -> None:
    with pytest.raises(PeriluneError, match=r"body\.gravitational_parameter is missing") as caught:
        without("gravity")
    assert "only gravity" in caught.value.expected


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("approach.up=100 m", "starts below the glide slope"),
        ("approach.up=-1 m", "does not start above its site"),
        ("vehicle.thrust=6 kN", "cannot stop the descent"),
        ("approach.up_speed=-200 m/s", "descent is too fast"),
        ("vehicle.dry_mass=1800 kg", "propellant cannot remove"),
    ],
)
def test_the_impossible_is_infeasible(change: str, what: str) -> None:
    with pytest.raises(InfeasibleError, match=what):
        solve(load_file(MARS, [change]).problem)


def test_flat_ground_is_saved_as_it_was_made(touching: Solution, tmp_path: Path) -> None:
    pl.save(touching, tmp_path / "out")
    back = pl.load(tmp_path / "out")
    assert back.problem == touching.problem
    assert isinstance(back.problem.records[0], UniformGravity)
    assert preflight(back.problem) == preflight(touching.problem)


# -- parts of the corridor


def test_parts_of_the_corridor_may_be_left_out() -> None:
    """The ground alone, a slope, a tilt, and both: as conditions of the path and as parameters."""
    tilt, slope = math.radians(50.0), math.radians(20.0)
    cases = [
        (None, ["height_above_site"], set()),
        (Corridor(), ["height_above_site"], set()),
        (Corridor(slope=slope), ["height_above_glide_slope"], {"corridor_slope", "corridor_pad_radius"}),
        (Corridor(tilt=tilt), ["height_above_site", "pointing_margin"], {"corridor_tilt"}),
        (
            Corridor(tilt=tilt, slope=slope, pad_radius=5.0),
            ["height_above_glide_slope", "pointing_margin"],
            {"corridor_tilt", "corridor_slope", "corridor_pad_radius"},
        ),
    ]
    at = SimpleNamespace(east=30.0, north=40.0, up=60.0), SimpleNamespace(toward_up=0.9)
    for corridor, names, parameters in cases:
        problem = over_flat_ground(corridor)
        assert [c.name for c in problem.phases[0].path_conditions] == names
        assert {name for name in problem.given if name.startswith("corridor")} == parameters
        p = problem.parameters({})
        values = problem.phases[0].path(*at, p, math) if problem.phases[0].path else ()
        pad = 5.0 if corridor and corridor.tilt and corridor.slope else 10.0
        truth = {
            "height_above_site": 60.0,
            "height_above_glide_slope": 60.0 - math.tan(slope) * (math.sqrt(2500.0 + pad * pad) - pad),
            "pointing_margin": 0.9 - math.cos(tilt),
        }
        assert values == pytest.approx([truth[name] for name in names])


# -- a vertical, upright end


@pytest.fixture(scope="module")
def upright() -> Solution:
    """The example with a final descent from 50 m to a touchdown at 1 m/s, proved."""
    return solve(load_file(PRECISION, ["final.height=50 m", "final.touchdown_speed=1 m/s"]).problem)


def test_the_last_metres_are_vertical(upright: Solution) -> None:
    assert upright.outcome is Outcome.PROVED and upright.verification.level == 3
    gate, touchdown = (t.state.values[-1] for t in upright.trajectories)
    assert gate[:5] == pytest.approx([0.0, 0.0, 50.0, 0.0, 0.0], abs=1e-6)
    assert gate[5] < -5.0  # m/s: the speed at the gate is chosen
    assert touchdown[:2] == pytest.approx([0.0, -1.0], abs=1e-6)
    assert (upright.trajectories[0].state.values[:, 2] >= 50.0 - 1e-6).all()
    tilt = upright.problem.phases[1].evaluate("outputs", touchdown, (0.9,), upright.parameters)[0]
    assert tilt == 0.0
    times = {name: upright.results[name].value for name in ("flight_time", "gate_time", "final_time")}
    assert times["flight_time"] == pytest.approx(times["gate_time"] + times["final_time"])
    assert upright.results["landed_mass"].value == pytest.approx(1912.957305, abs=1e-5)


def test_the_vertical_part_is_newtons(upright: Solution) -> None:
    """The last phase flown by SciPy with the throttle's switch and nothing of the model but its numbers."""
    p, flown = upright.parameters, upright.trajectories[1]
    switches = np.unique(flown.time[1:][np.diff(flown.time) == 0])
    assert len(switches) == 1
    x, c, axis = flown.state.values[0], 310.0 * 9.80665, math.cos(p.site_latitude)
    for begin, end, share in ((0.0, switches[0], 0.3), (switches[0], flown.duration, 0.9)):

        def rates(t: float, x: Any, share: float = share) -> Any:
            r = MOON.radius + x[0]
            lifted = MOON.rotation_rate**2 * r * axis * axis
            return x[1], share * 8000.0 / x[2] - MOON.gravitational_parameter / r**2 + lifted, -share * 8000.0 / c

        x = solve_ivp(rates, (begin, end), x, "DOP853", rtol=1e-12, atol=1e-10).y[:, -1]
    assert x == pytest.approx([0.0, -1.0, upright.results["landed_mass"].value], abs=1e-6)


def test_straight_above_the_site_a_gate_costs_nothing() -> None:
    """Over flat ground the best way down is vertical anyway: with and without a gate the same mass lands."""
    start = Approach(east=0.0, north=0.0, up=1000.0, up_speed=-30.0)
    plain, gated = (
        solve(over_flat_ground(approach=start, final=final), verify=0).results["landed_mass"].value
        for final in (None, FinalDescent(height=50.0))
    )
    assert gated == pytest.approx(plain, rel=1e-9)


def test_the_touch_of_the_slope_and_a_final_descent() -> None:
    """On Mars both are kept; the vertical end takes more than the 400 kg of propellant: by a search, not by a bound."""
    final = ["final.height=50 m", "final.touchdown_speed=1 m/s"]
    found = solve(load_file(MARS, [*final, "vehicle.dry_mass=1400 kg"]).problem)
    assert found.outcome is Outcome.PROVED and found.verification.level == 3
    assert any("contact point of height above glide slope" in arc.description for arc in found.structure)
    assert 400.0 < found.results["propellant"].value < 420.0
    with pytest.raises(NotConvergedError):
        solve(load_file(MARS, final).problem)


def test_a_fall_before_ignition_and_a_final_descent() -> None:
    """Three phases; the end is as vertical."""
    changes = ["final.height=50 m", "approach.up=3 km", "approach.east=-2500 m", "approach.longest_coast=100 s"]
    found = solve(load_file(PRECISION, changes).problem)
    assert found.outcome is Outcome.PROVED
    assert [phase.name for phase in found.problem.phases] == ["coast", "landing", "final_descent"]
    assert found.results["coast_time"].value > 5.0
    assert found.trajectories[2].state.values[-1][:2] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_final_descent_is_saved_and_drawn(upright: Solution, tmp_path: Path) -> None:
    """One table for each part, as their states are not the same; all of it is proved again from the file."""
    pl.save(upright, tmp_path / "out")
    back = pl.load(tmp_path / "out")
    assert back.problem == upright.problem
    assert pl.verify(back).outcome is Outcome.PROVED
    out = tmp_path / "drawn"
    assert run_command_line(["solve", str(PRECISION), "--set", "final.height=50 m", "--out", str(out)]) == 0
    assert (out / "trajectory_2_final_descent.csv").exists()
    assert {path.stem for path in (out / "figures").glob("*.png")} >= {"track", "steering", "velocities"}


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("final.height=1 km", "starts below the height from which the final descent is vertical"),
        ("final.height=50 km", "starts below the height from which the final descent is vertical"),
        ("vehicle.thrust=2 kN", "cannot stop the descent"),
        ("approach.up_speed=-300 m/s", "descent is too fast"),
    ],
)
def test_a_final_descent_that_cannot_be_flown(change: str, what: str) -> None:
    with pytest.raises(InfeasibleError, match=what):
        solve(load_file(PRECISION, ["final.height=50 m", "final.touchdown_speed=1 m/s", change]).problem)


@pytest.mark.parametrize(
    ("change", "what", "also"),
    [
        ("final.height=50", "final.height - this is not a quantity", "50 m"),
        ("final.height=50 s", "final.height - the unit has the wrong dimension", "50 m"),
        ("final.height=0 m", "final.height must be positive", "0 m"),
        ("final.touchdown_speed=-1 m/s", "final.touchdown_speed is out of range", "without a sign"),
        ("final.touchdown_speed=1 km/s", "final.touchdown_speed is out of range", "between 0 and 30 m/s"),
        ("final.tilt=1 deg", "no key of this name in [final]", "height"),
        ("final.touchdown_speed=1 m/s", "final.height is missing", "perilune new"),
    ],
)
def test_a_slip_in_the_final_descent_is_named(change: str, what: str, also: str) -> None:
    changes = [change] if "is missing" in what else ["final.height=50 m", change]
    with pytest.raises(PeriluneError) as caught:
        load_file(PRECISION, changes)
    assert what in caught.value.what
    assert also in str(caught.value)


def test_what_falls_gently_enough_may_be_heavy() -> None:
    """A weak engine lets no more land than it holds, but where a fast touchdown is allowed from low down."""

    def held(height: float, speed: float) -> float:
        final = FinalDescent(height=height, touchdown_speed=speed)
        return float(next(f for f in preflight(over_flat_ground(final=final)) if "can hold" in f.name).value)

    assert held(50.0, 0.0) == pytest.approx(7200.0 / 1.62)
    # Falling 2 m with b m/s^2 ends at 1 m/s where b = 1/4.
    assert held(2.0, 1.0) == pytest.approx(7200.0 / (1.62 - 0.25))
    assert held(0.3, 1.0) == math.inf


def test_a_fast_turning_body_warns_of_the_tilt() -> None:
    """Half way to the pole of Ceres the centrifugal acceleration alone asks for 1.9 degrees."""
    final = FinalDescent(height=50.0)
    turning = over_flat_ground(final=final, body=CERES, site=Site(longitude=0.0, latitude=math.pi / 4))
    found = next(f for f in preflight(turning) if f.name == "tilt that keeps it on the vertical")
    sideways = 0.5 * CERES.rotation_rate**2 * CERES.radius
    down = CERES.gravitational_parameter / CERES.radius**2 - sideways
    assert found.verdict == "warning"
    assert found.value == pytest.approx(math.degrees(math.atan2(sideways, down)), rel=0.05)


# -- a slope that is approached too fast


def closing_in(speed: float, body: Any = FLAT, site: Site | None = None) -> Problem:
    """Straight towards a slope of 25 degrees that is 100 m away, at a speed, from 1 km beside the site."""
    slope = math.radians(25.0)
    corridor = Corridor(slope=slope, pad_radius=1.0)
    up = math.tan(slope) * (math.hypot(1000.0, 1.0) - 1.0) + 100.0 / math.cos(slope)
    start = Approach(
        east=-1000.0, north=0.0, up=up, east_speed=-speed * math.sin(slope), up_speed=-speed * math.cos(slope)
    )
    return over_flat_ground(corridor, approach=start, body=body, site=site)


@pytest.mark.parametrize("body", [FLAT, MOON], ids=["flat", "round"])
def test_the_bound_of_the_glide_slope_is_sharp(body: Any) -> None:
    """What full thrust straight away from the slope stops is let through, and nothing that is much faster."""
    site = None if body is FLAT else Site(longitude=0.0, latitude=1.2)

    def stops(speed: float) -> bool:
        problem = closing_in(speed, body, site)
        p, phase, away = problem.parameters({}), problem.phases[0], math.radians(25.0)
        control = (math.sin(away), 0.0, math.cos(away), 0.9)
        start = np.array(problem.start(p, NUMERIC), dtype=float)
        flown = solve_ivp(lambda t, x: phase.rates(x.tolist(), control, p), (0.0, 60.0), start, rtol=1e-9, max_step=0.1)
        heights = phase.evaluate("path", list(flown.y), control, p)[0]
        return bool(np.min(heights) > 0.0)

    def passed(speed: float) -> bool:
        found = preflight(closing_in(speed, body, site))
        return bool(
            next(
                f for f in found if f.name.startswith("stopping distance at full thrust towards the glide slope")
            ).passed
        )

    speeds = range(2, 80)
    truth, bound = (speeds[bisect(speeds, False, key=lambda s: not may(float(s))) - 1] for may in (stops, passed))
    assert truth <= bound < 1.15 * truth
    with pytest.raises(InfeasibleError, match="full thrust straight away from the glide slope crosses it"):
        solve(closing_in(1.2 * truth, body, site))


def test_a_family_of_landings_touches_its_slope() -> None:
    """Each member of a sweep has what a solve without a guess has; more gravity costs more."""
    problem = load_file(MARS).problem
    family = pl.sweep(problem, {"body.gravity": [3.5, 3.6, 3.65, 3.7]}, verify=1)
    found = [point.solution for point in family.points]
    assert all(solution is not None and solution.outcome is Outcome.PROVED for solution in found)
    assert all(
        "contact point of height above glide slope" in solution.structure[1].description
        for solution in found
        if solution
    )
    spent = [solution.results["propellant"].value for solution in found if solution]
    assert spent == sorted(spent)
    alone = solve(problem.with_given(body_gravity=3.65), verify=0)
    assert spent[2] == pytest.approx(alone.results["propellant"].value, rel=1e-9)


def test_a_touch_that_a_rough_mesh_does_not_lead_to_is_found_by_a_finer_one() -> None:
    """Solved from 40 points of a mesh it was refused: every extremal found violates the glide slope."""
    approach = {"approach_east": -1843.0, "approach_up": 1045.0, "approach_up_speed": -32.4}
    problem = load_file(PRECISION).problem
    found = solve(problem.with_given(corridor_slope=0.42, **approach), verify=1)
    assert found.outcome is Outcome.PROVED and "contact point" in found.structure[-1].description
