"""How far the landing point moves by disturbances: against flights that are flown with them, by SciPy.

Those flights know nothing of the derivatives. They are not optimal either: what is told is true of any flight.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune import load, save
from perilune.core import PeriluneError
from perilune.models import (
    EARTH,
    Atmosphere,
    Interface,
    Landing,
    Parachute,
    Returner,
    ReturnOrbit,
    Separation,
    Transition,
    deorbit_entry,
)
from perilune.models.physics.atmosphere import tabulated
from perilune.problem.display.views import Disturbance
from perilune.problem.results.solution import Solution
from perilune.problem.results.trajectory import Curve
from return_by_scipy import backwards, fly

ORBIT = ReturnOrbit(
    perigee_altitude=380e3, apogee_altitude=400e3, argument_of_perigee=0.3, inclination=math.radians(51.6),
    node_longitude=0.2, argument_of_latitude=2.0,
)  # fmt: skip
CAPSULE = Returner(mass=7000.0, thrust=3190.0, specific_impulse=302.0, drag_area=5.8)
INTERFACE = Interface(altitude=100e3, angle_lower=-0.1)
COASTS = {"coast_time": 200.0, "burn_time": 280.0, "drift_time": 1.0, "entry_time": 1.0}


def returning(vehicle: Returner = CAPSULE, **more: Any) -> pl.Problem:
    known: dict[str, Any] = {
        "transition": Transition(longest_coast=3000.0), "air": Atmosphere(model="us1976"),
        "site": Landing(altitude=30e3),
        "separation": Separation(mass=2900.0), "minimise": "flight_time",
    }  # fmt: skip
    return deorbit_entry(vehicle, replace(ORBIT, longest_coast=3000.0), INTERFACE, EARTH, **{**known, **more})


def steering(phase: Any, t: float, x: Any, p: Any) -> Any:
    """Against the velocity and a little sideways, swinging back and forth; a bank that turns."""
    if phase.name == "burn":
        back = backwards(x, p)
        sideways = np.cross(x[:3], back)
        d = back + 0.2 * math.sin(0.02 * t) * sideways / np.linalg.norm(sideways)
        return d / np.linalg.norm(d)
    return np.array([math.cos(0.01 * t), math.sin(0.01 * t)])[: len(phase.control_names)]


def by_hand(problem: pl.Problem, free: Any) -> Solution:
    """A flight as a solution: `steering`, and durations as they come."""
    p = problem.parameters(free)
    flown = fly(problem, free, lambda k, t, x: steering(problem.phases[k], t, x, p))
    trajectories = []
    for phase, (t, x, slope) in zip(problem.phases, flown, strict=True):
        u = np.array([steering(phase, *at, p) for at in zip(t, x, strict=True)]).reshape(len(t), -1)
        rates = np.array([slope(*at) for at in zip(t, x, strict=True)])
        state = Curve(time=t, values=x, rates=rates)
        control = Curve(time=t, values=u, rates=np.array(np.gradient(u, t, axis=0, edge_order=2)))
        trajectories.append(pl.Trajectory(phase=phase.name, state=state, control=control))
    lengths = {phase.duration: float(t[-1]) for phase, (t, *_) in zip(problem.phases, flown, strict=True)}
    return Solution(
        problem=problem, method="by hand", outcome=pl.Outcome.SOLVED, objective=0.0, free={**free, **lengths},
        trajectories=tuple(trajectories),
    )  # fmt: skip


def differences(solution: Solution) -> dict[str, float]:
    """What the results say, by flights with a hundredth of each disturbance to either side; of drag, in denser air."""
    problem, p = solution.problem, solution.parameters

    def law(k: int, t: float, x: Any) -> Any:
        flown = solution.trajectories[k]
        u = flown.control(min(t, flown.duration))
        return u / np.linalg.norm(u) if len(u) else u

    def landed(**more: Any) -> Any:
        return fly(problem, solution.free, law, **more)[-1][1][-1, :3]

    x = next(t for t in solution.trajectories if t.phase == "entry").state.values[0]
    normal, up = np.cross(x[:3], x[3:6]), solution.trajectories[-1].state.values[-1, :3]
    along = np.cross(normal, up)
    across = np.cross(up, along)
    found = {}
    changes: dict[str, Any] = {"second_late": lambda s: {"late": s}}
    for name, by in (("percent_thrust", "vehicle_thrust"), ("percent_drag", "air_density")):
        changes[name] = lambda s, by=by: {"changed": {by: getattr(p, by) * (1 + 0.01 * s)}}
    for name, change in changes.items():
        moved = (landed(**change(0.01)) - landed(**change(-0.01))) / 0.02
        for way, axis in (("along", along), ("across", across)):
            found[f"{way}_track_per_{name}"] = float(moved @ axis) / np.linalg.norm(axis)
    return found


VEHICLES = {
    "drag area": CAPSULE,
    "ballistic coefficient": replace(CAPSULE, drag_area=None, ballistic_coefficient=400.0, lift_to_drag=0.25),
    "sphere-cone": replace(CAPSULE, drag_area=None, base_radius=1.1, cone_angle=0.4, nose_radius=0.5),
}


@pytest.mark.parametrize("vehicle", [*VEHICLES, "parachute"])
def test_what_is_told_is_what_flights_do(vehicle: str) -> None:
    """With a coast and a drift, a separation, lift, J2 and an ellipsoid; on the ground below a parachute too.

    Below that the density changes how fast it comes down, and not where: its drag needs no part in a percent of drag.
    """
    last: dict[str, Any] = {"parachute": Parachute(altitude=10e3, drag_area=1000.0), "site": Landing(altitude=0.0)}
    solution = by_hand(returning(VEHICLES.get(vehicle, CAPSULE), **(last if vehicle == "parachute" else {})), COASTS)
    found, right = solution.results, differences(solution)
    assert len(right) == 6
    for name, value in right.items():
        _, _, by = name.partition("_track_per_")
        size = math.hypot(*(right[f"{way}_track_per_{by}"] for way in ("along", "across")))
        assert found[name].value == pytest.approx(value, abs=2e-5 * size), name
        assert found[name].unit == ("m/s" if by == "second_late" else "m")


def test_a_file_tells_the_same(tmp_path: Path) -> None:
    """Also one that no model makes again, as with air of a table. A flight that ends above the air tells nothing."""
    heights = np.linspace(0.0, 130e3, 66)
    air = tabulated(heights, 1.225 * np.exp(-heights / 7200.0), "air of mine")
    solution = by_hand(returning(air=air), COASTS)
    save(solution, tmp_path)
    told = json.loads((tmp_path / "solution.json").read_text(encoding="utf-8"))["results"]
    again = load(tmp_path).results
    for name in (f"{way}_track_per_{by}" for way in ("along", "across") for by in ("second_late", "percent_drag")):
        assert told[name]["value"] == pytest.approx(solution.results[name].value, rel=1e-12)
        assert again[name].value == pytest.approx(solution.results[name].value, rel=1e-9)
    assert returning(air=None, site=None, separation=None).views.dispersion is None


def test_disturbances_of_what_is_not_there_are_refused() -> None:
    problem = returning()
    stated = problem.views.dispersion
    assert stated is not None
    wrong = [
        replace(stated, disturbances=(Disturbance(name="luck", shares=(("vehicle_luck", 1.0),)),)),
        replace(stated, disturbances=(Disturbance(name="late", begins="landing"),)),
        replace(stated, position=("x", "y", "up")),
        replace(stated, track="air"),
    ]
    for spoilt, name in zip(wrong, ("vehicle_luck", "landing", "up", "air"), strict=True):
        with pytest.raises(PeriluneError, match=rf"unknown \w+.*{name}|{name}"):
            replace(problem, views=replace(problem.views, dispersion=spoilt))
