"""Passes over a site: secular rates against flights, passes against arithmetic, and what is listed is flown."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import perilune as pl
from perilune.cli import run_command_line
from perilune.core import NUMERIC, InfeasibleError, PeriluneError
from perilune.models.deorbit.initial_guess import impulsive_deorbit
from perilune.models.deorbit.opportunities import opportunities
from perilune.models.deorbit.orbit import orbit_state, plane_axes
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.records import Atmosphere, Interface, Landing, Returner, ReturnOrbit, Transition
from perilune.models.deorbit.secular_drift import drift
from perilune.models.deorbit.site_passes import find_passes, largest_plane_turn
from perilune.models.physics.bodies import Planet
from perilune.models.physics.rotating_frame import free_acceleration
from perilune.models.physics.vehicle import Throttle
from perilune.problem import preflight

MU, RADIUS, TURN = 3.986004418e14, 6378137.0, 7.292115e-5
EARTH = Planet(name="earth", gravitational_parameter=MU, radius=RADIUS, rotation_rate=TURN, j2=1.0826e-3)
VEHICLE = Returner(mass=500.0, thrust=500.0, exhaust_velocity=3000.0, drag_area=0.6, dry_mass=460.0)
ORBIT = ReturnOrbit(
    radius=6771e3, inclination=math.radians(51.6), node_longitude=math.radians(-27.0),
    argument_of_latitude=math.radians(120.0), longest_coast=1200.0,
)  # fmt: skip
SITE = Landing(longitude=math.radians(-98.0), latitude=math.radians(38.0), altitude=10e3)
SCENARIO = """
[problem]
kind = "deorbit_entry"
minimise = "propellant"
[body]
name = "earth"
[orbit]
radius = "6771 km"
inclination = "51.6 deg"
node_longitude = "-27 deg"
argument_of_latitude = "120 deg"
longest_coast = "1200 s"
[vehicle]
mass = "500 kg"
thrust = "500 N"
exhaust_velocity = "3000 m/s"
dry_mass = "460 kg"
drag_area = "0.6 m^2"
[transition]
longest_coast = "3000 s"
[interface]
altitude = "120 km"
angle = "-2 deg"
[atmosphere]
model = "exponential"
density = "1.225 kg/m^3"
scale_height = "7.2 km"
[site]
longitude = "-98 deg"
latitude = "38 deg"
altitude = "10 km"
"""


def returning(orbit: ReturnOrbit = ORBIT, vehicle: Returner = VEHICLE, **more: Any) -> pl.Problem:
    air = Atmosphere(model="exponential", density=1.225, scale_height=7200.0)
    made = {
        "interface": Interface(altitude=120e3, angle=math.radians(-2.0)), "body": EARTH, "air": air, "site": SITE,
        "transition": Transition(longest_coast=3000.0), "minimise": "propellant", **more,
    }  # fmt: skip
    return deorbit_entry(vehicle, orbit, **made)


@pytest.mark.parametrize("inclination", [28.5, 51.6, 97.0])
@pytest.mark.parametrize(("perigee", "apogee", "angle"), [(400e3, 400e3, 1.5), (350e3, 450e3, 2.0), (3e5, 15e5, 4.0)])
def test_secular_rates_are_those_of_the_flight(inclination: float, perigee: float, apogee: float, angle: float) -> None:
    """Two days under J2 by SciPy: never further off than the periods of a turn that are left out, 0.3 degrees."""
    p = SimpleNamespace(
        body_gravitational_parameter=MU, body_radius=RADIUS, body_rotation_rate=TURN, body_j2=1.0826e-3,
        orbit_perigee_altitude=perigee, orbit_apogee_altitude=apogee, orbit_argument_of_perigee=1.0,
        orbit_inclination=math.radians(inclination),
    )  # fmt: skip
    position, velocity = orbit_state(angle, 0.5, p, NUMERIC)

    def slope(t: float, y: Any) -> Any:
        return [*y[3:], *free_acceleration(y[:3], y[3:], (0.0, 0.0, 1.0), p, NUMERIC)]

    times = np.linspace(0.0, 2 * 86400.0, 100)
    flown = solve_ivp(
        slope, (0, times[-1]), [*position, *velocity], method="DOP853", rtol=1e-9, atol=1e-2, t_eval=times
    )
    truth = flown.y[:3] / np.linalg.norm(flown.y[:3], axis=0)
    found = np.array(plane_axes(*drift(position, velocity, p).at(times), p, NUMERIC)[0])
    assert np.degrees(np.linalg.norm(found - truth, axis=0)).max() < 0.3


def test_passes_of_a_polar_orbit_over_the_equator() -> None:
    """By hand: half turns apart, while the body turns under the plane; T and F are Milstead's, and those of the air."""
    p = returning().parameters({})
    for name, value in {"orbit_inclination": math.pi / 2, "site_latitude": 0.0, "body_j2": 0.0, "orbit_radius": 6.9e6,
                        "vehicle_thrust": 1e7, "site_longitude": 1.0}.items():  # fmt: skip
        setattr(p, name, value)
    n, entry = math.sqrt(MU / 6.9e6**3), (400.0, 0.3)
    node, angle = -0.4, 0.7
    down = impulsive_deorbit(6.9e6, RADIUS + 120e3, math.radians(-2.0), MU)
    lasts, sweeps = down.time + entry[0], down.swept + entry[1]
    found = find_passes(p, drift(*orbit_state(angle, node, p, NUMERIC), p), entry, drifts=True, until=86400.0)
    expected = []
    for half in range(60):
        ignition = (half * math.pi - angle - sweeps) / n
        to_site = math.remainder(1.0 + TURN * (ignition + lasts) - node, 2 * math.pi)
        northwards = half % 2 == 0
        # Over the node that is in front of the site, and on the other pass over that behind it.
        if 0 < ignition < 86400 and northwards == (abs(to_site) < math.pi / 2):
            off = to_site if northwards else math.remainder(math.pi - to_site, 2 * math.pi)
            expected.append((ignition, -math.asin(math.sin(off)), "ascending" if northwards else "descending"))
    assert len(found) == len(expected) > 12
    for one, (ignition, away, going) in zip(found, expected, strict=True):
        assert one.ignition == pytest.approx(ignition, abs=0.5) and one.going == going
        assert one.out_of_plane_angle == pytest.approx(away, abs=1e-4)
        sine = math.sin(abs(away)) / abs(math.sin(sweeps))
        if sine > 1:
            assert one.plane_change == math.inf == one.velocity_change
            continue
        turn, speed = math.asin(sine), math.sqrt(MU / 6.9e6)
        needs = np.hypot(speed - (speed - down.velocity_change) * math.cos(turn),
                         (speed - down.velocity_change) * math.sin(turn))  # fmt: skip
        assert one.plane_change == pytest.approx(turn, abs=1e-3) and one.velocity_change == pytest.approx(
            needs, rel=2e-3
        )


def listed(problem: pl.Problem, days: float = 2.0) -> dict[str, list[Any]]:
    found = opportunities(problem, days)
    return {verdict: [one for one in found if one.verdict == verdict] for verdict in ("reachable", "out of reach")}


def begun(one: Any) -> pl.Problem:
    """The return that begins at a pass, as its settings say."""
    degrees = {key: float(value.removesuffix(" deg")) for key, value in one.settings.items()}
    node, angle = degrees["orbit.node_longitude"], degrees["orbit.argument_of_latitude"]
    return returning(replace(ORBIT, node_longitude=math.radians(node), argument_of_latitude=math.radians(angle)))


def test_a_reachable_pass_is_flown() -> None:
    """Takes its seconds: a solve without a guess is what the list speaks of."""
    one = listed(returning())["reachable"][0]
    assert one.ignition > 10 * 3600.0
    solution = pl.solve(begun(one), verify=1)
    assert solution.verification.passed
    told = solution.results
    assert told["delta_v"].value == pytest.approx(one.velocity_change, rel=0.1)
    assert told["coast_time"].value + told["flight_time"].value == pytest.approx(
        0.5 * 1200.0 + one.landing - one.ignition, rel=0.1
    )


def test_a_pass_out_of_reach_is_refused() -> None:
    far = [one for one in listed(returning())["out of reach"] if abs(one.out_of_plane_angle) > math.radians(20.0)]
    assert len(far) > 5
    for one in far[:5]:
        with pytest.raises(InfeasibleError, match="out of the plane"):
            pl.solve(begun(one))


def test_an_orbit_that_comes_down_by_itself_has_no_passes() -> None:
    """Nothing is left of it hours later."""
    dips = ReturnOrbit(
        perigee_altitude=100e3, apogee_altitude=400e3, argument_of_perigee=0.0, inclination=ORBIT.inclination,
        node_longitude=0.0, argument_of_latitude=math.pi,
    )  # fmt: skip
    with pytest.raises(InfeasibleError, match="enters the atmosphere by itself"):
        opportunities(returning(dips), 2)


@pytest.mark.parametrize(
    "more",
    [
        {"transition": None},
        {"vehicle": replace(VEHICLE, thrust=25.0)},
        {"interface": Interface(altitude=120e3, angle=math.radians(-2.0), speed_lower=7700.0)},
    ],
)
def test_a_descent_that_the_problem_does_not_allow_is_no_reachable_pass(more: dict[str, Any]) -> None:
    """A burn all the way, one too weak to be over before the interface, and a speed there that the descent has not."""
    assert listed(returning())["reachable"] and not listed(returning(**more))["reachable"]


@pytest.mark.parametrize(("lower", "binding"), [(0.0, False), (0.9, True)])
def test_a_burn_down_to_nothing_may_wait_for_the_site(lower: float, binding: bool) -> None:
    """At full thrust it is over before the site comes below; throttled down it lasts until the body has turned."""
    site = replace(SITE, longitude=math.radians(60.0))
    problem = returning(site=site, throttle=Throttle(lower=lower, upper=1.0))
    found = next(f for f in preflight(problem) if f.name == "distance of the site from the plane of the orbit")
    assert (found.verdict == "impossible") is binding


def test_no_thrust_changes_the_speed_at_the_apogee_by_more_than_three_times_as_much() -> None:
    """By differences, on ellipses of all shapes, anywhere, in any direction; at the perigee of a circle 3."""

    def slowest(r: float, across: float, up: float) -> float:
        momentum, energy = r * across, (across * across + up * up) / 2 - 1 / r
        return (1 - math.sqrt(1 + 2 * energy * momentum**2)) / momentum

    rng, rates = np.random.default_rng(3), list[float]()
    for e, true in zip(rng.uniform(1e-3, 0.99, 400), rng.uniform(-math.pi, math.pi, 400), strict=True):
        r, across, up = 1 / (1 + e * math.cos(true)), 1 + e * math.cos(true), e * math.sin(true)
        slopes = [
            (slowest(r, across + h, up + k) - slowest(r, across - h, up - k)) / 2e-6 for h, k in ((1e-6, 0), (0, 1e-6))
        ]
        rates.append(math.hypot(*slopes))
    assert 2.5 < max(rates) < 3 + 1e-5


def test_the_bound_of_the_turn_holds_for_one_that_raises_the_apogee_before() -> None:
    """At the perigee by a, at the apogee by the rest: never beyond the bound, for any a."""
    p = SimpleNamespace(orbit_radius=6678e3, body_gravitational_parameter=3.986e14)
    speed = math.sqrt(3.986e14 / 6678e3)
    for share in (0.05, 0.2, 0.33, 0.36, 0.4):
        bound = largest_plane_turn(p, share * speed)
        for a in np.linspace(0.0, share, 50):
            slow = 2 / (1 + a) - (1 + a)
            assert bound > math.asin(min((share - a) / slow, 1.0))
        assert share < bound and (bound < 1.1 * share or share > 0.25)
    assert largest_plane_turn(p, math.inf) == math.pi


def test_a_turn_high_up_is_not_refused() -> None:
    """3.6 km/s turn the plane by 28 degrees at once, and by 60 where 2.7 km/s raise the apogee to ten radii before."""
    vehicle = replace(VEHICLE, dry_mass=VEHICLE.mass * math.exp(-3600.0 / 3000.0))
    more: dict[str, Any] = {"throttle": Throttle(lower=0.0, upper=1.0), "transition": Transition(longest_coast=8e4)}
    found = preflight(returning(vehicle=vehicle, site=replace(SITE, latitude=math.radians(85.0)), **more))
    assert all(one.passed for one in found if one.binding)


def test_every_pass_is_found_on_an_ellipse_too() -> None:
    """An ellipse that is nearly a circle has the passes of the circle, as each place is looked at by itself."""
    nearly = replace(
        ORBIT, radius=None, perigee_altitude=6771e3 - RADIUS - 10, apogee_altitude=6771e3 - RADIUS + 10,
        argument_of_perigee=0.3,
    )  # fmt: skip
    circle, ellipse = (opportunities(returning(orbit), 1.0) for orbit in (ORBIT, nearly))
    assert len(circle) == len(ellipse)
    for one, other in zip(circle, ellipse, strict=True):
        assert other.ignition == pytest.approx(one.ignition, abs=5.0)
        assert other.out_of_plane_angle == pytest.approx(one.out_of_plane_angle, abs=1e-3)


def test_lift_reaches_to_the_side() -> None:
    """L/D 0.5 by Eggers, 3 degrees: passes that are nearer than that need no turn, and nothing is certain beyond."""
    found = opportunities(returning(vehicle=replace(VEHICLE, lift_to_drag=0.5)), 2.0)
    reach = math.pi**2 / 48 * 0.25
    near = [one for one in found if abs(one.out_of_plane_angle) < reach]
    assert near and all(one.plane_change == 0 and one.verdict == "reachable" for one in near)
    assert all(one.verdict != "out of reach" for one in found)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: opportunities(returning(site=Landing(altitude=10e3)), 1), "opportunities need a site"),
        (lambda: opportunities(returning(vehicle=replace(VEHICLE, dry_mass=None)), 1), "amount of propellant"),
        (lambda: opportunities(returning(), 0), "number of days"),
        (lambda: opportunities(returning(), 1e6), "number of days"),
        (lambda: opportunities(returning(), math.nan), "number of days"),
        (lambda: opportunities(object(), 1), "a problem to list opportunities of"),  # type: ignore[arg-type]
    ],
)
def test_what_has_no_opportunities_is_refused(make: Any, said: str) -> None:
    with pytest.raises(PeriluneError, match=said):
        make()


def test_the_command_lists_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "return.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    assert run_command_line(["opportunities", str(file), "--days", "2"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"13\.3\d\d h +13\.\d+ h  descending +0\.4\d deg \d+ km right", text) and "out of reach:" in text
    assert (
        run_command_line(
            ["opportunities", str(file), "--days", "2", "--json", "--set", "problem.epoch=2026-06-01T12:00:00Z"]
        )
        == 0
    )
    rows = json.loads(capsys.readouterr().out)["opportunities"]
    assert len(rows) > 25 and {row["verdict"] for row in rows} == {"reachable", "doubtful", "out of reach"}
    good = next(row for row in rows if row["verdict"] == "reachable")
    assert good["utc"].startswith("2026-06-02T01:2") and good["settings"]["problem.epoch"] < good["utc"]
    # With the changes that it names, the pass is the first, half of the longest coast ahead.
    changes = [word for key, value in good["settings"].items() for word in ("--set", f"{key}={value}")]
    assert run_command_line(["opportunities", str(file), "--days", "0.1", "--json", *changes]) == 0
    again = json.loads(capsys.readouterr().out)["opportunities"][0]
    assert again["ignition"] == pytest.approx(600.0, abs=15.0) and again["utc"][:16] == good["utc"][:16]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--days", "0.2"], 3, "out of reach on every pass within 0.2 days"),
        (["--days", "soon"], 2, "invalid number value"),
        (["--days", "-1"], 2, "number of days is out of range"),
        (["--set", "vehicle.dry_mass=450"], 2, "vehicle.dry_mass"),
        (["--day", "2"], 2, "did you mean '--days'"),
    ],
)
def test_the_command_refuses(
    words: list[str], code: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "return.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    assert run_command_line(["opportunities", str(file), *words]) == code
    assert said in capsys.readouterr().err


def test_a_landing_from_orbit_has_no_opportunities(capsys: pytest.CaptureFixture[str]) -> None:
    example = Path(__file__).parents[2] / "examples" / "hybrid_lander.toml"
    assert run_command_line(["opportunities", str(example)]) == 2
    assert "only a return from orbit" in capsys.readouterr().err
