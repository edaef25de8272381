"""Returns from orbit: the cases with a printed or a closed-form truth, solved without a guess and proved."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.cli import run_command_line
from perilune.core import InfeasibleError, PeriluneError
from perilune.io.model_records import model_document
from perilune.io.problem_json import physics_document
from perilune.models.deorbit.initial_guess import impulsive_deorbit
from perilune.models.deorbit.opportunities import opportunities
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.records import Atmosphere, Interface, Landing, Manoeuvre, Returner, ReturnOrbit, Transition
from perilune.models.physics import standard_atmosphere
from perilune.models.physics.atmosphere import tabulated
from perilune.models.physics.bodies import Planet
from perilune.problem import preflight
from perilune.report.summary import solution_markdown, solution_summary
from perilune.scenario import load_file, load_text, template

# Liu, Liu, Wu 2019, and what it leaves open: a blunt capsule, exponential air, and a site in the orbit's plane.
BODY = Planet(
    name="earth", gravitational_parameter=3.986005e14, radius=6371e3, rotation_rate=7.2921159e-5, j2=1.08263e-3
)
VEHICLE = Returner(mass=500.0, thrust=100.0, exhaust_velocity=3000.0, drag_area=0.6)
ORBIT = ReturnOrbit(radius=6678.14e3, inclination=math.radians(50.0))
PLACE = Manoeuvre(longitude=math.radians(16.0), latitude=math.radians(39.5), going="descending")
STEEP = Interface(altitude=120e3, angle=math.radians(-6.0))
BOUNDED = Interface(
    altitude=120e3,
    speed_lower=7500.0,
    speed_upper=8800.0,
    angle_lower=math.radians(-9.0),
    angle_upper=math.radians(-6.0),
)
AIR = Atmosphere(model="exponential", density=1.225, scale_height=7200.0)
QUIET = Atmosphere(model="nrlmsis", f107=150.0, f107a=150.0, ap=4.0)
SITE = Landing(longitude=math.radians(-98.0), latitude=math.radians(38.0), altitude=10e3)


def returning(vehicle: Returner = VEHICLE, orbit: ReturnOrbit = ORBIT, **more: Any) -> pl.Problem:
    return deorbit_entry(vehicle, orbit, STEEP, BODY, **{"manoeuvre": PLACE, "air": AIR, **more})


@pytest.mark.parametrize(
    ("going", "time", "mass", "speed"), [("descending", 2631.72, 412.28, 7348.2), ("ascending", 2609.31, 413.02, None)]
)
def test_the_least_time_to_the_interface(going: str, time: float, mass: float, speed: float | None) -> None:
    """Neighbour A: anywhere, 6 degrees down; found by another program to these digits."""
    problem = deorbit_entry(
        VEHICLE, ORBIT, STEEP, BODY, manoeuvre=replace(PLACE, going=going), minimise="transition_time"
    )
    solution = pl.solve(problem)
    assert solution.verification.passed and solution.verification.level == 3
    assert solution.objective == pytest.approx(time, abs=0.01)
    end = solution.trajectories[-1].state.values[-1]
    assert end[6] == pytest.approx(mass, abs=0.01)
    if speed is not None:
        assert np.linalg.norm(end[3:6]) == pytest.approx(speed, abs=0.1)


def test_a_return_to_a_place_touches_the_air_on_its_way() -> None:
    """Neighbour B: speed and angle on their bounds, and the way up between two visits at 120 km.

    The truth is `problems.constrained.deorbit`, another text of the same flight.
    """
    solution = pl.solve(deorbit_entry(VEHICLE, ORBIT, BOUNDED, BODY, manoeuvre=PLACE, air=AIR, site=SITE))
    assert solution.verification.passed and solution.verification.level == 3
    assert solution.objective == pytest.approx(4443.8964813, rel=1e-9)
    arc = next(arc for arc in solution.structure if arc.description == "contact point of height above interface")
    assert arc.begin == pytest.approx(1652.255, abs=1e-2)
    burn = solution.trajectories[0]
    x = burn.state(np.linspace(0.0, burn.duration, 4001))
    height = np.linalg.norm(x[:, :3], axis=1) - BODY.radius
    assert height.min() > 120e3 - 1e-3 and height.max() > 500e3
    assert np.linalg.norm(x[-1, 3:6]) == pytest.approx(7500.0, abs=1e-6)
    down = x[-1, :3] @ x[-1, 3:6] / (np.linalg.norm(x[-1, :3]) * 7500.0)
    assert math.degrees(math.asin(down)) == pytest.approx(-6.0, abs=1e-6)


def test_people_read_angles_in_degrees() -> None:
    problem = deorbit_entry(VEHICLE, ORBIT, STEEP, BODY, manoeuvre=PLACE, minimise="transition_time")
    solution = pl.solve(problem, verify=1)
    report = solution_markdown(solution)
    assert "| interface angle | -6.000000 | deg |" in report and " rad |" not in report.partition("## Proof")[0]


MILSTEAD = Planet(name="earth", gravitational_parameter=3.986004418e14, radius=6378137.0, rotation_rate=0.0)


def test_an_impulsive_deorbit_is_milsteads() -> None:
    for angle, change, time, swept in ((-1.5, 113.244, 1747.11, 115.26), (-6.0, 551.596, 693.21, 42.91)):
        found = impulsive_deorbit(6778137.0, 6498137.0, math.radians(angle), MILSTEAD.gravitational_parameter)
        assert found.velocity_change == pytest.approx(change, abs=1e-3)
        assert found.time == pytest.approx(time, abs=1e-2)
        assert math.degrees(found.swept) == pytest.approx(swept, abs=1e-2)


def test_a_finite_burn_becomes_an_impulse() -> None:
    """Thrust rising to 1000x: the time differs by half of the burn, the velocity change by its square."""
    truth = impulsive_deorbit(6778137.0, 6498137.0, math.radians(-1.5), MILSTEAD.gravitational_parameter)
    errors = []
    for thrust in (1e2, 1e3, 1e4, 1e5):
        problem = deorbit_entry(
            Returner(mass=500.0, thrust=thrust, exhaust_velocity=3000.0),
            ReturnOrbit(radius=6778137.0, inclination=math.radians(50.0)),
            Interface(altitude=120e3, angle=math.radians(-1.5)),
            MILSTEAD,
            manoeuvre=PLACE,
            transition=Transition(longest_coast=4000.0),
            minimise="propellant",
        )
        solution = pl.solve(problem)
        assert solution.verification.passed and solution.verification.level == 3
        change, whole = 3000.0 * math.log(500.0 / -solution.objective), sum(solution.free.values())
        errors.append((change / truth.velocity_change - 1, (whole - truth.time) / solution.free["burn_time"]))
    relative, shares = zip(*errors, strict=True)
    assert relative[-1] == pytest.approx(0.0, abs=2e-8)
    assert relative[1] / relative[2] == pytest.approx(100.0, rel=0.01)
    np.testing.assert_allclose(shares[1:], 0.5, atol=0.01)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: replace(ORBIT, radius=None), "orbit.radius is missing"),
        (lambda: replace(ORBIT, perigee_altitude=3e5), "state the same quantity"),
        (lambda: replace(ORBIT, radius=None, perigee_altitude=3e5, apogee_altitude=4e5), "argument_of_perigee is"),
        (lambda: replace(VEHICLE, specific_impulse=300.0), "state the same quantity"),
        (lambda: replace(VEHICLE, drag_area=None, base_radius=1.0), "a base_radius and a cone_angle"),
        (
            lambda: replace(VEHICLE, drag_area=None, base_radius=1.0, cone_angle=0.2, nose_radius=2.0),
            "not a sphere-cone",
        ),
        (lambda: replace(VEHICLE, bank="reversed"), "lift_to_drag is missing"),
        (lambda: replace(VEHICLE, bank="free"), "lift_to_drag is missing"),
        (lambda: replace(BODY, j2=1.0), "body.j2 is more than a body has"),
        (lambda: replace(BODY, j4=0.3), "body.j4 is more than a body has"),
        (lambda: returning(orbit=replace(ORBIT, inclination=0.0)), "above the equator has no ascending"),
        (lambda: returning(orbit=replace(ORBIT, inclination=math.pi)), "above the equator has no ascending"),
        (lambda: replace(STEEP, angle_lower=-0.2), "state the same quantity"),
        (lambda: replace(BOUNDED, speed_lower=9000.0), "are not a range"),
        (lambda: replace(BOUNDED, angle_lower=-0.01, angle_upper=-0.02), "-0.572958 deg to -1.14592 deg"),
        (lambda: replace(VEHICLE, mass=True), "must be a number in SI"),
        (lambda: replace(AIR, density=None), "atmosphere.density is missing"),
        (lambda: replace(AIR, model="us1976"),
         r"atmosphere.density belongs to another model[\s\S]*take out atmosphere\.density, atmosphere\.scale_height$"),
        (lambda: Atmosphere(model="nrlmsis", f107=150.0, f107a=150.0), "atmosphere.ap is missing"),
        (lambda: returning(air=QUIET), "epoch of the nrlmsis atmosphere is not stated"),
        (lambda: returning(epoch="tomorrow"), "problem.epoch is not a supported time"),
        (lambda: returning(epoch="2026-06-01T12:00:00.1234567Z"), "problem.epoch has more digits"),
        (lambda: replace(SITE, latitude=None), "a longitude and a latitude"),
        (lambda: returning(manoeuvre=replace(PLACE, latitude=0.95)), "never comes to the latitude"),
        (lambda: deorbit_entry(VEHICLE, ORBIT, STEEP, BODY), "position of the vehicle on its orbit"),
        (lambda: returning(replace(VEHICLE, drag_area=None)), "drag_area is missing"),
        (lambda: returning(air=None, site=SITE), "a site needs an atmosphere"),
        (lambda: returning(minimise="heat_load"), "nose_radius is missing"),
    ],
)  # fmt: skip
def test_what_is_stated_twice_or_not_at_all_is_refused(make: Any, said: str) -> None:
    with pytest.raises(PeriluneError, match=said):
        make()


def beside(folder: Path, stated: str) -> Path:
    """A scenario whose air is in a file, with exponential air beside it and above it."""
    text = template("deorbit_entry").replace('model = "us1976"', f'model = "file"\nfile = {stated}')
    (folder / "in" / "deep").mkdir(parents=True)
    rows = "".join(f"{h:g},{1.225 * math.exp(-h / 7200.0):.17g}\n" for h in np.linspace(0.0, 130e3, 66))
    for place in ("in/air.csv", "in/deep/air.csv", "air.csv"):
        (folder / place).write_text(rows, encoding="utf-8")
    (folder / "in" / "link.csv").symlink_to(folder / "air.csv")
    (folder / "in" / "return.toml").write_text(text, encoding="utf-8")
    return folder / "in" / "return.toml"


@pytest.mark.parametrize("stated", ["'air.csv'", "'deep/air.csv'"])
def test_air_of_a_file_beside_the_scenario(tmp_path: Path, stated: str) -> None:
    """Exponential air in a table is exponential air; what is saved has the table, and no way to a file."""
    scenario = load_file(beside(tmp_path, stated))
    assert scenario.text is None and scenario.problem.given.keys().isdisjoint({"atmosphere_density"})
    phase, p = scenario.problem.phases[-1], scenario.problem.parameters({})
    x = [6378137.0 + 50e3, 0.0, 0.0, -1000.0, 7000.0, 0.0, 500.0]
    pressure = phase.evaluate("outputs", np.array(x), (), p)[5]
    assert pressure == pytest.approx(0.5 * 1.225 * math.exp(-50e3 / 7200.0) * 5e7, rel=1e-9)
    saved = json.dumps(physics_document(scenario.problem))
    assert str(tmp_path) not in saved and "csv" not in saved.replace("air of air.csv", "")
    assert model_document(scenario.problem) is None


@pytest.mark.parametrize(
    "stated", ["'../air.csv'", "'deep/../../air.csv'", "'link.csv'", "'/etc/passwd'", "''", "'C:air.csv'", "'a\\b'"]
)
def test_a_scenario_reads_no_file_but_beside_itself(tmp_path: Path, stated: str) -> None:
    path = beside(tmp_path, stated)
    with pytest.raises(PeriluneError, match=r"atmosphere.file names no file in the scenario's folder"):
        load_file(path)
    with pytest.raises(PeriluneError, match="names no file"):
        load_text(path.read_text(encoding="utf-8"))


def test_a_failure_with_air_of_a_file_is_kept(tmp_path: Path) -> None:
    scenario, out = beside(tmp_path, "'air.csv'"), tmp_path / "out"
    code = run_command_line(["solve", str(scenario), "--set", "vehicle.dry_mass=499.9 kg", "--out", str(out), "--json"])
    assert code == 3 and json.loads((out / "failure.json").read_text(encoding="utf-8"))["scenario"] is None


def test_a_file_of_air_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(PeriluneError, match="there is no table of air here"):
        load_file(beside(tmp_path, "'none.csv'"))


@pytest.mark.parametrize(("low", "high", "said"), [(0.0, 100e3, "interface.altitude = 120"), (12e3, 130e3, "site.alt")])
def test_air_that_ends_before_the_flight_does_is_refused(low: float, high: float, said: str) -> None:
    heights = np.linspace(low, high, 60)
    table = tabulated(heights, 1.225 * np.exp(-heights / 7200.0), "air of mine")
    with pytest.raises(PeriluneError, match="air of mine ends before the flight does") as error:
        returning(air=table, site=SITE)
    assert said in error.value.got
    assert "rows" not in error.value.advice  # of a file there are none


def test_air_of_a_day_and_a_place() -> None:
    pytest.importorskip("pymsis")
    made = [returning(air=air, site=SITE, epoch="2026-06-01T12:00:00Z") for air in (QUIET, replace(QUIET, f107a=250.0))]
    x, p = np.array([6371e3 + 115e3, 0.0, 0.0, -1000.0, 7000.0, 0.0, 500.0]), made[0].parameters({})
    quiet, busy = (problem.phases[-1].evaluate("outputs", x, (), p)[5] for problem in made)
    standard = float(standard_atmosphere.density(np.array([115e3]))[0]) * 0.5 * 5e7
    assert quiet == pytest.approx(standard, rel=0.5) and quiet != busy


def refused(**more: Any) -> PeriluneError:
    problem = deorbit_entry(**{
        "vehicle": VEHICLE, "orbit_": ORBIT, "interface": BOUNDED, "body": BODY, "manoeuvre": PLACE, "air": AIR,
        "site": SITE, **more,
    })  # fmt: skip
    with pytest.raises(InfeasibleError) as error:
        pl.solve(problem)
    return error.value


def test_what_physics_forbids_is_refused_before_it_is_solved() -> None:
    assert "enters the atmosphere by itself" in refused(orbit_=replace(ORBIT, radius=6471e3)).what
    # To a perigee at 145 km, by the vis-viva law; a tenth of a per mille of propellant gives 0.3 m/s.
    mu, apogee, perigee = 3.986005e14, 6678.14e3, 6371e3 + 145e3
    needed = math.sqrt(mu / apogee) - math.sqrt(mu * (2 / apogee - 2 / (apogee + perigee)))
    short = refused(vehicle=replace(VEHICLE, dry_mass=499.95))
    assert "does not suffice to reach the interface" in short.what and "velocity change" in short.got
    assert float(short.got.split()[-2]) == pytest.approx(needed, abs=1e-3)


def test_a_site_out_of_plane_is_refused_with_the_next_pass() -> None:
    """The paper's own site lies 33 degrees or more off, with 100 kg of propellant for about 5."""
    printed = replace(SITE, longitude=math.radians(-158.0))
    error = refused(vehicle=replace(VEHICLE, dry_mass=400.0), site=printed)
    assert "from the plane of the orbit" in error.got and "km or more out of the plane" in error.what
    away = float(error.got.split()[-2])
    assert 25.0 < away < 40.0
    assert float(re.findall(r"stays (\d+) km", error.what)[0]) == pytest.approx(math.radians(away) * 6371.0, rel=2e-3)
    passes = opportunities(returning(vehicle=replace(VEHICLE, dry_mass=400.0), site=printed), 3.0)
    assert all(one.verdict != "reachable" for one in passes) and "no pass within 3 days is certainly" in error.advice
    nearest = min(passes, key=lambda one: abs(one.out_of_plane_angle))
    off, hours = (float(number) for number in re.findall(r"([\d.]+) (?:deg off|h after)", error.advice))
    assert off == pytest.approx(math.degrees(abs(nearest.out_of_plane_angle)), abs=0.05)
    assert hours == pytest.approx(nearest.ignition / 3600.0, abs=0.05)
    polar = refused(vehicle=replace(VEHICLE, dry_mass=400.0), site=replace(SITE, latitude=math.radians(75.0)))
    assert "never comes over its latitude" in polar.advice


def test_who_falls_too_fast_for_a_parachute_is_told_before() -> None:
    """Down to the ground with 125 kg/m^2 or 5000: a fall ends near its terminal speed, or far above 300 m/s."""
    light, heavy = (returning(replace(VEHICLE, drag_area=area)) for area in (4.0, 0.1))
    name = "landing speed of a ballistic entry"
    said = [[f for f in preflight(problem) if f.name == name] for problem in (light, heavy)]
    assert [found[0].passed for found in said] == [True, False] and not said[1][0].binding
    terminal = math.sqrt(2 * 125.0 * 9.82 / 1.225)
    assert said[0][0].value == pytest.approx(terminal, rel=0.02)
    # The mass that falls steadily at 300 m/s at the site itself: rho V^2 S/(2 g).
    enough = 1.225 * 300.0**2 * 0.1 / (2 * 3.986005e14 / 6371e3**2)
    assert f"low enough below {enough:.0f} kg of its 500 kg" in said[1][0].meaning
    named = returning(replace(VEHICLE, drag_area=0.1), site=replace(SITE, speed_upper=2000.0))
    assert all(f.passed for f in preflight(named) if f.name.startswith("landing speed"))


def test_a_drift_that_costs_time_is_left_out_from_the_beginning() -> None:
    """No random start came near with one; without it the least time is 1773.6364 s."""
    text = template("deorbit_entry").replace('minimise = "propellant"', 'minimise = "flight_time"')
    solution = pl.solve(load_text(text), verify=2)
    assert solution.verification.passed and solution.objective == pytest.approx(1773.6364, abs=2e-3)
    assert solution.free["drift_time"] == pytest.approx(1e-3, rel=1e-6)
    assert solution.statistics.initialization == "random costates"


def test_the_kinds_own_template_is_solved_and_proved() -> None:
    """Ellipsoid, J2 to J4, the US Standard Atmosphere: slow, as all of it together is flown nowhere else."""
    problem = load_text(template("deorbit_entry"))
    solution = pl.solve(problem)
    assert solution.verification.passed and solution.verification.level == 3
    told = {name: result.value for name, result in solution.results.items()}
    # Milstead's impulse on a sphere, 113.2 m/s and 1747 s, and half of the burn; the air costs no propellant.
    assert told["delta_v"] == pytest.approx(113.6, abs=0.5)
    assert told["transition_time"] == pytest.approx(1747.1 + 0.5 * told["burn_time"], rel=0.04)
    assert told["interface_angle"] == pytest.approx(math.radians(-1.5), abs=1e-9)
    # Aerodynamics there, by the standard itself and no table.
    entry = solution.trajectories[-1]
    p, phase = solution.parameters, problem.phases[-1]
    t = np.linspace(0.0, entry.duration, 40)
    x = solution.evaluate(2, t)[0]
    density = standard_atmosphere.density(solution.outputs(2, t)["altitude"])
    pressure = 0.5 * density * (x[3] ** 2 + x[4] ** 2 + x[5] ** 2)
    np.testing.assert_allclose(solution.outputs(2, t)["dynamic_pressure"], pressure, rtol=1.1e-3)
    np.testing.assert_allclose(
        solution.outputs(2, t)["load"], pressure * p.vehicle_drag_area / x[6] / 9.80665, rtol=1.1e-3
    )
    assert phase.name == "entry" and told["peak_load"] == pytest.approx(8.346, abs=0.02)
    assert told["peak_load_time"] > told["transition_time"]
    # As people read it: angles in degrees, loads in g0.
    words = solution_summary(solution)
    assert re.search(r"interface angle +-1\.500000 deg\n", words)
    assert re.search(r"peak load \(g0\) +8\.3\d+\n", words)
    assert re.search(r"peak heat rate +\d+\.\d W/m\^2\n", words) and " rad\n" not in words
