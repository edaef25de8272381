"""What no return can do is refused before it is solved, and what one can do never is: bounds against solved flights."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.cli import run_command_line
from perilune.core import NUMERIC, InfeasibleError, PeriluneError
from perilune.models.deorbit.ballistic_fall import fall, slowest_arrival
from perilune.models.deorbit.initial_guess import impulsive_deorbit
from perilune.models.deorbit.interface_bounds import interface_speeds, largest_altitude_change, steepest_angle
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.records import Atmosphere, Interface, Landing, Manoeuvre, Returner, ReturnOrbit, Transition
from perilune.models.physics.bodies import EARTH, Planet
from perilune.problem import preflight
from perilune.scenario import load_file
from test_opportunities import SCENARIO

BALL = Planet(
    name="earth", gravitational_parameter=3.986005e14, radius=6371e3, rotation_rate=7.2921159e-5, j2=1.0826e-3
)
VEHICLE = Returner(mass=500.0, thrust=500.0, exhaust_velocity=3000.0, drag_area=0.6)
CIRCLE = ReturnOrbit(radius=6778e3, inclination=math.radians(50.0))
ELLIPSE = ReturnOrbit(
    perigee_altitude=300e3, apogee_altitude=900e3, argument_of_perigee=0.6, inclination=math.radians(98.0),
    longest_coast=5000.0,
)  # fmt: skip
PLACE = Manoeuvre(longitude=0.3, latitude=0.4, going="descending")
AIR = Atmosphere(model="exponential", density=1.225, scale_height=7200.0)


def returning(
    degrees: float,
    vehicle: Returner = VEHICLE,
    orbit: ReturnOrbit = CIRCLE,
    *,
    drifts: bool = True,
    body: Planet = BALL,
    **more: Any,
) -> pl.Problem:
    made = {
        "manoeuvre": PLACE,
        "transition": Transition(longest_coast=4000.0) if drifts else None,
        "minimise": "propellant",
        **more,
    }
    return deorbit_entry(vehicle, orbit, Interface(altitude=120e3, angle=math.radians(degrees)), body, **made)


@pytest.mark.parametrize(
    ("degrees", "thrust", "orbit", "drifts", "body"),
    [
        (-1.0, 500.0, CIRCLE, True, BALL),
        (-3.0, 500.0, CIRCLE, True, EARTH),
        (-8.0, 5000.0, CIRCLE, True, BALL),
        (-2.0, 300.0, ELLIPSE, True, BALL),
        (-5.0, 2000.0, ELLIPSE, True, EARTH),
        (-6.0, 100.0, CIRCLE, False, BALL),
    ],
)
def test_what_is_flown_is_never_refused(
    degrees: float, thrust: float, orbit: ReturnOrbit, drifts: bool, body: Planet
) -> None:
    """The least propellant for an angle, and no more than that on board: within all bounds, and not far within."""
    free = replace(VEHICLE, thrust=thrust)
    solution = pl.solve(returning(degrees, free, orbit, drifts=drifts, body=body), verify=1)
    assert solution.verification.passed
    left = solution.results["mass_at_interface"].value
    tight = returning(degrees, replace(free, dry_mass=left * (1 - 1e-9)), orbit, drifts=drifts, body=body)
    assert all(found.passed for found in preflight(tight))
    p = tight.parameters({})
    low, high = interface_speeds(p, NUMERIC)
    assert low < solution.results["interface_speed"].value < high
    assert steepest_angle(p, NUMERIC) > -math.radians(degrees)
    if drifts and degrees < -1.5:
        assert steepest_angle(p, NUMERIC) < 2.2 * -math.radians(degrees)


def test_an_orbit_that_comes_down_by_itself_is_left_before_it_does() -> None:
    """From 110 by 400 km a burn near the apogee leads to the interface at -1.5 degrees; from near the perigee none."""
    dips = ReturnOrbit(
        perigee_altitude=110e3, apogee_altitude=400e3, argument_of_perigee=-0.9, inclination=math.radians(50.0)
    )
    problem = returning(-1.5, orbit=dips)
    assert {f.name: f.verdict for f in preflight(problem)} == {
        "perigee above the interface": "warning", "ignition above the interface": "ok"
    }  # fmt: skip
    solution = pl.solve(problem, verify=1)
    assert solution.verification.passed
    assert solution.results["interface_angle"].value == pytest.approx(math.radians(-1.5), abs=1e-9)
    with pytest.raises(InfeasibleError, match="enters the atmosphere by itself"):
        pl.solve(returning(-1.5, orbit=replace(dips, argument_of_perigee=0.9 + math.pi / 2)))
    with pytest.raises(InfeasibleError, match="enters the atmosphere by itself"):
        pl.solve(returning(-1.5, orbit=replace(dips, longest_coast=5000.0)))


def test_the_bound_of_the_angle_beside_an_impulse() -> None:
    """About a round body at rest, with great thrust: a third more than Milstead's impulse, half more at one degree."""
    still = Planet(name="x", gravitational_parameter=3.986004418e14, radius=6378137.0, rotation_rate=0.0, j2=0.0)
    for degrees, most in ((1.0, 1.5), (2.0, 1.35), (6.0, 1.4)):
        change = impulsive_deorbit(6778e3, 6498137.0, math.radians(-degrees), 3.986004418e14).velocity_change
        vehicle = replace(VEHICLE, thrust=1e5, dry_mass=500.0 * math.exp(-change / 3000.0))
        p = returning(-degrees, vehicle, body=still).parameters({})
        assert 1.0 < steepest_angle(p, NUMERIC) / math.radians(degrees) < most


def test_what_floats_down_is_looked_at_at_once() -> None:
    """A square kilometre of drag: stiff equations, and a fall of hours, which is said."""
    problem = returning(-2.0, replace(VEHICLE, drag_area=1e6), air=AIR, site=Landing(altitude=10e3))
    begun = time.process_time()
    (said,) = (f for f in preflight(problem) if "three revolutions" in f.name)
    assert time.process_time() - begun < 1.0
    assert said.verdict == "warning" and 30.0 < float(said.value) < 40.0
    p: Any = problem.parameters({})
    fallen = fall(p, problem.preflight.keywords["air"])  # type: ignore[union-attr]
    height, _, speed, *_ = fallen.rows[-1]
    density, pull = 1.225 * math.exp(-height / 7200.0), 3.986005e14 / (6371e3 + height) ** 2
    assert speed == pytest.approx(math.sqrt(2 * 500.0 * pull / (density * 1e6)), rel=0.01)


def test_bounds_are_told_of_many_problems_at_once() -> None:
    problem = returning(-3.0, replace(VEHICLE, dry_mass=480.0))
    masses = np.array([490.0, 480.0, 450.0])
    found = {f.name: f for f in preflight(problem, {"vehicle_dry_mass": masses})}
    alone = [{f.name: f.limit for f in preflight(problem.with_given(vehicle_dry_mass=float(mass)))} for mass in masses]
    for name in ("path angle at the interface below the horizon", "velocity change to reach the interface"):
        np.testing.assert_allclose(found[name].limit, [one[name] for one in alone], rtol=1e-12)


def test_a_burn_moves_no_further_than_its_bound() -> None:
    """Against a burn straight along the radius in a plane, up and down, by small steps."""
    p = returning(-3.0, replace(VEHICLE, dry_mass=400.0)).parameters({})
    mu, time, steps = BALL.gravitational_parameter, 100.0 * 3000.0 / 500.0, 20000
    for upwards in (1.0, -1.0):
        r, rise, turn = 6778e3, 0.0, math.sqrt(mu * 6778e3)
        for k in range(steps):
            push = 500.0 / (500.0 - 500.0 / 3000.0 * time * k / steps)
            rise += (turn**2 / r**3 - mu / r**2 + upwards * push) * time / steps
            r += rise * time / steps
        moved = abs(r - 6778e3)
        assert 0.4 * (bound := largest_altitude_change(p, NUMERIC, 3000.0 * math.log(500 / 400))) < moved < bound


def landing(area: float, altitude: float = 10e3, **more: Any) -> pl.Problem:
    vehicle = replace(VEHICLE, drag_area=area, dry_mass=450.0)
    return returning(-2.0, vehicle, air=AIR, site=Landing(altitude=altitude), **more)


def test_who_arrives_too_fast_is_refused_and_who_may_not_is_warned() -> None:
    """833 kg/m^2 arrives at 10 km with 275 m/s; 1250 with 365 however it enters; with lift nothing is certain."""
    verdicts = {
        area: {f.verdict for f in preflight(landing(area)) if "entry" in f.name or "terminal" in f.name}
        for area in (0.6, 0.52, 0.4, 0.02)
    }
    assert verdicts[0.6] == {"ok"} and verdicts[0.52] == {"warning", "ok"}
    assert "impossible" in verdicts[0.4] and "impossible" in verdicts[0.02]
    with pytest.raises(InfeasibleError, match="no ballistic entry arrives as slowly") as error:
        pl.solve(landing(0.4))
    assert error.value.reason and "less a tenth" in error.value.got
    winged, site = replace(VEHICLE, drag_area=0.02, lift_to_drag=0.3), Landing(altitude=10e3)
    lifted = returning(-2.0, winged, air=AIR, site=site, minimise="flight_time")
    assert all(f.verdict != "impossible" for f in preflight(lifted))


@pytest.mark.parametrize("known", [True, False])
def test_what_has_burnt_its_propellant_arrives_slower(known: bool) -> None:
    """Neighbour B burns a third of its mass on the way, and so lands with 222 m/s, not with the 270 of all its mass."""
    changes = ["site.speed_upper=225 m/s", *(["vehicle.dry_mass=358 kg"] if known else [])]
    problem = load_file(Path(__file__).parents[2] / "examples/minimum_duration_return.toml", changes).problem
    assert all(f.verdict != "impossible" for f in preflight(problem))
    solution = pl.solve(problem, verify=1)
    assert solution.verification.passed and solution.results["landing_speed"].value < 225.0


def test_no_fall_is_slower_than_the_slowest() -> None:
    """Falls at random speeds and the angles that are stated; the least of them is found to a tenth."""
    rng, problem = np.random.default_rng(5), landing(0.4)
    p = problem.parameters({})
    p.interface_angle_upper, p.interface_angle_lower = math.radians(-1.5), math.radians(-5.0)
    del p.interface_angle
    least = slowest_arrival(p, _air(), -0.2, (7000.0, 8000.0))
    tried = [fall(p, _air(), -math.radians(rng.uniform(1.5, 5.0)), rng.uniform(7000, 8000)) for _ in range(30)]
    assert all(one.rows[-1, 2] > 0.95 * least for one in tried if one.lands)
    assert min(one.rows[-1, 2] for one in tried if one.lands) < 1.2 * least


def _air() -> Any:
    from perilune.models.physics.atmosphere import exponential

    return exponential(1.225, 7200.0)


def test_a_slow_fall_is_followed_to_its_end() -> None:
    """500 kg below 100 m^2: 1500 s and more from 10 km to the ground, at its terminal speed there."""
    p = landing(100.0, 0.0).parameters({})
    fallen = fall(p, _air())
    assert fallen.lands and fallen.time > 1500.0
    assert fallen.rows[-1, 2] == pytest.approx(math.sqrt(2 * 5.0 * 9.82 / 1.225), rel=0.01)


def test_the_typical_fall_is_flown_once() -> None:
    """For the same numbers through the same air; what is kept cannot be written to."""
    p, air = landing(0.4).parameters({}), _air()
    fallen = fall(p, air)
    assert fall(p, air) is fallen and not fallen.rows.flags.writeable
    thin = SimpleNamespace(**{**vars(p), "atmosphere_density": 1.0})
    assert fall(thin, air).time != fallen.time
    assert fall(p, _air()) is not fallen and fall(p, _air()).time == fallen.time


@pytest.mark.parametrize(
    ("changes", "code", "said"),
    [
        (["interface.angle=-20 deg"], 3, "cannot make the flight so steep"),
        (["interface.angle=-1.5 rad"], 3, "cannot make the flight so steep"),
        (["interface.angle=6 deg"], 2, "points upwards, but the vehicle arrives from above"),
        (["interface.angle=-2"], 2, "not a quantity"),
        (["interface.angle=-2 km"], 2, "wrong dimension"),
        (["interface.angel=-2 deg"], 2, "did you mean 'angle'"),
        (["interface.speed=7.5 m/s"], 2, "is it in m/s, or in km/s?"),
        (["interface.speed=7500 km/s"], 2, "is it in m/s, or in km/s?"),
        (["interface.speed_lower=9 km/s"], 3, "cannot give this speed at the interface"),
        (["interface.speed_upper=5 km/s"], 3, "cannot give this speed at the interface"),
        (["interface.altitude=120 m"], 2, "lower than mountains"),
        (["site.altitude=10000 km"], 2, "site.altitude is not below interface.altitude"),
        (["vehicle.drag_area=0.02 m^2"], 3, "arrives as slowly as site.speed_upper"),
        (["vehicle.drag_area=0.6 cm^2"], 3, "arrives as slowly as site.speed_upper"),
        (["site.speed_upper=100 m/s"], 3, "arrives as slowly as site.speed_upper"),
        (["vehicle.dry_mass=499 kg"], 3, "does not suffice to reach the interface"),
        (["vehicle.dry_mass=600 kg"], 2, "leaves no propellant"),
        (["problem.epoch=9999-12-31T23:59:59Z"], 2, "problem.epoch is not a supported time"),
        (["problem.epoch=0001-01-01T00:00:00+14:00"], 2, "problem.epoch is not a supported time"),
        (["interface.angle=-90 deg"], 3, "cannot make the flight so steep"),
        (["orbit.longest_coast=1e9 s"], 2, "longest_coast is out of range"),
        (["transition.longest_coast=1e9 s"], 2, "longest_coast is out of range"),
        (["separation.mass=600 kg"], 2, "not below the mass of the vehicle"),
        (["separation.mass=500 kg"], 2, "not below the mass of the vehicle"),
        (["separation.mass=310 kg", "vehicle.dry_mass=300 kg"], 2, "exceeds the mass that the burn may leave"),
        (["separation.mass=499 kg"], 2, "exceeds the mass that the burn may leave"),
        (["orbit.radius=6778.14 m"], 3, "enters the atmosphere by itself"),
        (["vehicle.thrust=1e-9 N", "interface.angle=-20 deg"], 3, "cannot make the flight so steep"),
        (["vehicle.thrust=500 kN"], 2, "more than a lander withstands"),
        (["orbit.radius=400 km"], 3, "enters the atmosphere by itself"),
    ],
)
def test_a_slip_is_answered_at_once(
    changes: list[str], code: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "return.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    words = [word for change in changes for word in ("--set", change)]
    assert run_command_line(["check", str(file), *words]) == code
    told = "".join(capsys.readouterr())
    assert said in told
    if code == 3:
        reason, refused, _ = told.partition("\n  reason: cannot be flown")
        assert refused and said in reason.splitlines()[-1]


def test_a_burn_longer_than_the_propellant_is_refused() -> None:
    """The engine burns all the way: 60 kg last 180 s, in which 2 m/s^2 bring anything down by 280 km."""
    short = returning(-3.0, replace(VEHICLE, thrust=1000.0, dry_mass=440.0), drifts=False)
    with pytest.raises(InfeasibleError, match="longer than the propellant") as error:
        pl.solve(short)
    assert "time to the interface" in error.value.got and "longest_coast" in error.value.advice
    with pytest.raises(InfeasibleError, match="does not suffice to reach the interface"):
        pl.solve(returning(-3.0, replace(VEHICLE, dry_mass=499.0)))


def test_a_site_above_the_interface_is_refused() -> None:
    with pytest.raises(PeriluneError, match=r"site\.altitude is not below interface\.altitude"):
        landing(0.6, 130e3)


@pytest.mark.parametrize(
    ("example", "change", "words"),
    [
        ("capsule_return", "orbit.radius=26 m", "enters the atmosphere by itself"),
        ("minimum_duration_return", "atmosphere.scale_height=2 km", "as slowly as site.speed_upper"),
    ],
)
def test_an_orbit_within_the_body_and_air_like_a_wall_are_refused_in_words(
    example: str, change: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(__file__).parents[2] / "examples" / f"{example}.toml"
    assert run_command_line(["check", str(path), "--set", change]) == 3
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(("orbit", "radii"), [(CIRCLE, (6778e3, 6778e3)), (ELLIPSE, (6671e3, 7271e3))])
def test_a_burn_of_more_than_a_turn_is_warned_of(orbit: ReturnOrbit, radii: tuple[float, float]) -> None:
    """By Hohmann's impulse at the apogee to 120 km, Tsiolkovsky's burn for it, and Kepler's period."""
    low, high = radii
    gate, mu = 6371e3 + 120e3, 3.986005e14
    change = math.sqrt(mu * (2 / high - 2 / (low + high))) - math.sqrt(mu * (2 / high - 2 / (gate + high)))
    period = 2 * math.pi * math.sqrt(((low + high) / 2) ** 3 / mu)
    burn = (1 - math.exp(-change / 3000.0)) * 500.0 * 3000.0  # seconds, for a newton
    for turns in (0.99, 1.01, 4.0):
        weak = replace(VEHICLE, thrust=burn / (turns * period))
        found = [f for f in preflight(returning(-1.5, weak, orbit)) if f.name.startswith("revolutions during the burn")]
        assert [f.verdict for f in found] == ["warning"] * (turns > 1)
        assert all(float(f.value) == pytest.approx(turns, rel=1e-9) for f in found)
        assert all(f"{change:.0f} m/s or more" in f.meaning for f in found)
