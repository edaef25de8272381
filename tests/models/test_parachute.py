"""Returns that end below a parachute: beside the full equations of motion, which no shooting bears, and to a place."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import perilune as pl
from perilune.core import NUMERIC, PeriluneError, Vector
from perilune.models.deorbit import dynamics as flight, parachute
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.records import Interface, Landing, Parachute, Returner, ReturnOrbit, Transition
from perilune.models.physics.atmosphere import exponential
from perilune.report.figures import solution_figures
from perilune.report.style import save_figure as draw
from perilune.scenario import load_text
from test_opportunities import EARTH, SCENARIO
from test_return_refusals import AIR, BALL, PLACE, VEHICLE

CANOPY = Parachute(altitude=8e3, drag_area=200.0)
BELOW = '\n[parachute]\naltitude = "8 km"\ndrag_area = "200 m^2"\n'


def scenario(text: str = SCENARIO + BELOW) -> pl.Problem:
    """To a place at altitude 0, from a pass that comes there."""
    pass_ = {'"-27 deg"': '"131.859 deg"', '"120 deg"': '"-36.826 deg"', '"10 km"': '"0 km"'}
    for old, new in pass_.items():
        text = text.replace(old, new)
    return load_text(text)


@cache
def solved() -> pl.Solution:
    return pl.solve(scenario())


def returning(parachute: Parachute | None = CANOPY, **more: Any) -> pl.Problem:
    made = {"manoeuvre": PLACE, "air": AIR, "site": Landing(), "transition": Transition(longest_coast=4000.0), **more}
    return deorbit_entry(
        made.pop("vehicle", VEHICLE), ReturnOrbit(radius=6778e3, inclination=math.radians(50.0)),
        Interface(altitude=120e3, angle=math.radians(-2.0)), BALL, parachute=parachute, minimise="propellant", **made,
    )  # fmt: skip


def test_a_return_below_a_parachute_is_proved() -> None:
    """Takes its seconds: five phases, from a pass of the orbit to the ground of a place."""
    solution = solved()
    assert solution.verification.passed and solution.verification.level == 3
    told = {name: result.value for name, result in solution.results.items()}
    assert [trajectory.phase for trajectory in solution.trajectories][-2:] == ["entry", "parachute"]
    assert told["landing_longitude"] == pytest.approx(math.radians(-98.0), abs=1e-9)
    assert told["landing_latitude"] == pytest.approx(math.radians(38.0), abs=1e-9)
    parts = sum(told[f"{name}_time"] for name in ("burn", "drift", "entry", "parachute"))
    assert told["flight_time"] == pytest.approx(parts, abs=1e-9)
    # On the ground: the weight, with the centrifugal part, on the drag area in air of sea level.
    distance = math.hypot(*solution.trajectories[-1].state.values[-1][:3])
    felt = EARTH.gravitational_parameter / distance**2 - EARTH.rotation_rate**2 * distance * math.cos(0.663) ** 2
    steady = math.sqrt(2 * told["mass_at_interface"] * felt / (1.225 * 200.0))
    assert told["landing_speed"] == pytest.approx(steady, rel=2e-3)
    assert 200.0 < told["opening_speed"] < 300.0


def test_it_is_what_the_full_equations_do_but_for_seconds() -> None:
    """From the state at which it opens, with all accelerations: 3 s and 20 m beside, of 1000 s and 8 km."""
    solution = solved()
    p, air = solution.parameters, exponential(1.225, 7200.0)
    below = SimpleNamespace(**{**vars(p), "vehicle_drag_area": p.parachute_drag_area})
    record = solution.problem.phases[-2].state_record

    def slope(t: float, y: Vector) -> Any:
        return flight.entry_rates(record(*y), (), below, NUMERIC, air=air)

    def lands(t: float, y: Vector) -> float:
        return float(flight.offset_from_site(record(*y), below, NUMERIC)[0])

    lands.terminal = True  # type: ignore[attr-defined]
    opened = solution.trajectories[-2].state.values[-1]
    full = solve_ivp(slope, (0.0, 3000.0), opened, method="Radau", rtol=1e-9, atol=1e-6, events=lands)
    time = solution.results["parachute_time"].value
    assert 0.0 < time - full.t[-1] < 0.005 * time
    down = solution.trajectories[-1].state.values[-1]
    beside = np.linalg.norm(full.y[:3, -1] - down[:3])
    assert 5.0 < beside < 40.0
    assert np.linalg.norm(full.y[3:6, -1]) == pytest.approx(solution.results["landing_speed"].value, rel=1e-3)
    # And why: along a descent by the full equations a costate grows by the integral of 2 g/V.
    x = solution.trajectories[-1].state(np.linspace(0.0, time, 200))
    speeds = [
        np.linalg.norm(parachute.sinking_velocity(SimpleNamespace(x=r[0], y=r[1], z=r[2], m=r[3]), p, NUMERIC, air=air))
        for r in x
    ]
    assert np.mean(2 * 9.8 / np.array(speeds)) * time > 1000.0  # and e^709 is the largest double


def test_the_parachute_is_part_of_the_optimum() -> None:
    """The place is below the point at which it opens: a site that is reached there at once is reached the same way."""
    without = scenario(SCENARIO.replace('altitude = "10 km"', 'altitude = "8 km"'))
    assert len(without.phases) == 4
    bare = pl.solve(without, verify=1)
    assert bare.results["propellant"].value == pytest.approx(solved().results["propellant"].value, rel=1e-3)
    assert bare.results["landing_speed"].value == pytest.approx(solved().results["opening_speed"].value, rel=1e-3)


def test_a_figure_of_the_air_ends_where_the_parachute_opens(tmp_path: Path) -> None:
    """Its panels have nothing of the parachute, whose name stood far outside of them once."""
    draw(solution_figures(solved())["air"], tmp_path, "air")


def test_least_heat_below_a_parachute() -> None:
    problem = returning(vehicle=replace(VEHICLE, nose_radius=0.3))
    assert [phase.name for phase in problem.phases] == ["burn", "drift", "entry", "parachute"]
    heated = deorbit_entry(
        Returner(mass=500.0, thrust=500.0, exhaust_velocity=3000.0, drag_area=0.6, nose_radius=0.3),
        ReturnOrbit(radius=6778e3, inclination=math.radians(50.0)),
        Interface(altitude=120e3, angle=math.radians(-2.0)),
        BALL,
        manoeuvre=PLACE,
        air=AIR,
        site=Landing(),
        parachute=CANOPY,
        minimise="heat_load",
    )
    assert heated.phases[-1].state_names == ("x", "y", "z", "m", "heat")
    ended = heated.phases[-2].state_record(6.379e6, 0.0, 0.0, -200.0, 0.0, 0.0, 400.0, 5e7)
    p = heated.parameters({free.name: 1000.0 for free in heated.free})
    assert heated.links[-1](ended, p, NUMERIC) == (6.379e6, 0.0, 0.0, 400.0, 5e7)
    assert heated.objective(heated.phases[-1].state_record(6.379e6, 0.0, 0.0, 400.0, 5e7), p, NUMERIC) == 5e7


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: returning(air=None, site=None), r"\[parachute\] needs an atmosphere"),
        (lambda: returning(Parachute(altitude=130e3, drag_area=9.0)), "parachute.altitude is not below interface"),
        (lambda: returning(site=Landing(altitude=9e3)), "site.altitude is not below parachute.altitude"),
        (lambda: scenario(SCENARIO + BELOW.replace("m^2", "m")), "parachute.drag_area.*wrong dimension"),
        (lambda: scenario(SCENARIO + BELOW.replace("drag_area", "area")), "no key of this name in .parachute"),
        (lambda: scenario(SCENARIO + '\n[parachute]\naltitude = "8 km"\n'), "parachute.drag_area is missing"),
        (lambda: scenario(SCENARIO + BELOW.replace("8 km", "-8 km")), "parachute.altitude is out of range"),
    ],
)
def test_a_parachute_that_cannot_be_is_refused(make: Any, said: str) -> None:
    with pytest.raises(PeriluneError) as error:
        make()
    assert re.search(said, str(error.value))


def test_who_is_too_fast_where_it_opens_is_refused() -> None:
    """Heavy as it is, 300 m/s at 8 km is not to be had, whatever the canopy below."""
    with pytest.raises(PeriluneError, match=r"arrives as slowly as site\.speed_upper"):
        pl.solve(returning(vehicle=replace(VEHICLE, drag_area=0.05, dry_mass=400.0)))
