"""Returns whose engine has a throttle: each beside one at full thrust that must be the same flight."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.core import PeriluneError
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.records import Interface, Landing, Returner, ReturnOrbit, Separation, Transition
from perilune.models.physics.vehicle import Throttle
from perilune.problem import preflight
from perilune.scenario import load_text
from test_opportunities import SCENARIO
from test_return_refusals import AIR, BALL, PLACE, VEHICLE

BARE = replace(VEHICLE, drag_area=None)


def returning(degrees: float = -1.5, vehicle: Returner = BARE, **more: Any) -> pl.Problem:
    made = {"manoeuvre": PLACE, "minimise": "propellant", **more}
    orbit = ReturnOrbit(radius=6778e3, inclination=math.radians(50.0))
    return deorbit_entry(vehicle, orbit, Interface(altitude=120e3, angle=math.radians(degrees)), BALL, **made)


def proved(problem: pl.Problem) -> pl.Solution:
    solution = pl.solve(problem)
    assert solution.verification.passed and solution.verification.level == 3
    return solution


@cache
def burn_and_drift() -> pl.Solution:
    return proved(returning(transition=Transition(longest_coast=4000.0)))


def same(one: pl.Solution, other: pl.Solution) -> None:
    for name in ("delta_v", "propellant", "transition_time", "mass_at_interface", "interface_speed"):
        assert one.results[name].value == pytest.approx(other.results[name].value, rel=1e-8)


def test_a_throttle_to_nothing_makes_a_drift_of_its_own() -> None:
    """One phase that burns all the way and may go down to no thrust: full thrust, then none, as two phases have it."""
    whole = proved(returning(throttle=Throttle(lower=0.0, upper=1.0)))
    same(whole, burn_and_drift())
    burn, length = whole.trajectories[0], burn_and_drift().results["burn_time"].value
    share = burn.control(np.array([0.5 * length, 0.99 * length, 1.01 * length, 1.5 * length]))[:, 3]
    np.testing.assert_allclose(share, [1.0, 1.0, 0.0, 0.0], atol=1e-9)
    assert whole.results["main_delta_v"].value == pytest.approx(whole.results["delta_v"].value, rel=1e-7)


def test_a_throttle_that_no_flight_needs_changes_nothing() -> None:
    throttle = Throttle(lower=0.2, upper=1.0)
    same(proved(returning(throttle=throttle, transition=Transition(longest_coast=4000.0))), burn_and_drift())


def test_what_the_throttle_holds_back_is_as_if_it_were_not_there() -> None:
    """Least time at 0.9 of 500 N is that of an engine of 450 N."""
    held = proved(returning(-6.0, throttle=Throttle(lower=0.2, upper=0.9), minimise="transition_time"))
    same(held, proved(returning(-6.0, replace(BARE, thrust=450.0), minimise="transition_time")))


def test_an_engine_that_never_stops_costs_more() -> None:
    least = proved(returning(throttle=Throttle(lower=0.02, upper=1.0)))
    told, drifted = least.results, burn_and_drift().results
    assert drifted["propellant"].value * 1.05 < told["propellant"].value
    longest = told["burn_time"].value
    assert told["propellant"].value > 0.02 * 500.0 / 3000.0 * longest
    # With no more than that on board the bounds before the flight still let it go.
    tight = replace(BARE, dry_mass=told["mass_at_interface"].value * (1 - 1e-9))
    assert all(found.passed for found in preflight(returning(vehicle=tight, throttle=Throttle(lower=0.02, upper=1.0))))


def test_the_dry_mass_holds_with_a_throttle() -> None:
    """Least time, with 30 kg on board: all of them are burnt at full thrust, as without a throttle."""
    vehicle, more = replace(BARE, dry_mass=470.0), dict[str, Any](minimise="transition_time")
    drifts = Transition(longest_coast=4000.0)
    held = proved(returning(vehicle=vehicle, throttle=Throttle(lower=0.1, upper=1.0), transition=drifts, **more))
    assert held.results["mass_at_interface"].value == pytest.approx(470.0, abs=1e-8)
    same(held, proved(returning(vehicle=vehicle, transition=drifts, **more)))


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ('lower = "0.5"\nupper = "0.3"', "not a range of fractions"),
        ('lower = "100 N"\nupper = "1"', "throttle.lower"),
        ('lower = "0.2"', "throttle.upper is missing"),
        ('lower = "0.2"\nupper = "1.5"', "throttle.upper is out of range"),
        ('lower = "0.2"\nhigher = "1"', "no key of this name in [throttle]"),
    ],
)
def test_a_throttle_that_cannot_be_is_refused(section: str, said: str) -> None:
    with pytest.raises(PeriluneError) as error:
        load_text(f"{SCENARIO}\n[throttle]\n{section}\n")
    assert said in str(error.value)


def test_a_scenario_has_a_throttle() -> None:
    problem = load_text(f'{SCENARIO}\n[throttle]\nlower = "0.2"\nupper = "1"\n')
    assert problem.phases[1].control_names == ("toward_x", "toward_y", "toward_z", "throttle")
    assert [c.name for c in problem.phases[2].end_conditions][-1] == "mass_left"


def test_what_is_left_behind_was_throttled() -> None:
    """Least propellant with a throttle that no flight needs, and 300 kg that go on: the flight at full thrust."""
    parts: dict[str, Any] = {
        "vehicle": VEHICLE, "air": AIR, "site": Landing(altitude=5e3), "separation": Separation(mass=300.0),
        "transition": Transition(longest_coast=4000.0),
    }  # fmt: skip
    throttled = pl.solve(returning(**parts, throttle=Throttle(lower=0.2, upper=1.0)), verify=2)
    full = pl.solve(returning(**parts), verify=1)
    assert throttled.verification.passed and full.verification.passed
    same(throttled, full)
    for name in ("entry_time", "landing_speed", "peak_load"):
        assert throttled.results[name].value == pytest.approx(full.results[name].value, rel=1e-7)
    whole = throttled.trajectories[2].state.values[:, throttled.problem.phases[2].state_names.index("whole")]
    np.testing.assert_allclose(whole, throttled.results["mass_at_interface"].value, rtol=1e-12)
    assert throttled.results["propellant"].value == pytest.approx(500.0 - whole[-1], rel=1e-12)


@pytest.mark.parametrize("throttle", [None, Throttle(lower=0.3, upper=0.9)])
@pytest.mark.parametrize(("dry", "left"), [(None, 490.0), (495.0, 495.0)])
def test_what_enters_the_air_is_not_burnt(throttle: Throttle | None, dry: float | None, left: float) -> None:
    """A burn that takes a sixth of the vehicle was proved best, though nearly all of it was to enter the air."""
    vehicle = replace(VEHICLE, dry_mass=dry)
    parts: dict[str, Any] = {"air": AIR, "site": Landing(altitude=5e3), "separation": Separation(mass=490.0)}
    problem = returning(vehicle=vehicle, throttle=throttle, minimise="flight_time", **parts)
    exhaust = vehicle.exhaust_velocity or 0.0
    longest = (vehicle.mass - left) * exhaust / vehicle.thrust / (1.0 if throttle is None else 0.3)
    assert next(f.upper for f in problem.free if f.name == "burn_time") == pytest.approx(longest, rel=1e-12)
    kept = [c for c in problem.phases[0].end_conditions if c.name == "mass_left"]
    if throttle is not None:
        assert kept[0].limits(problem.parameters({}))[0] == left
    assert any(f.binding and not f.passed for f in preflight(problem))
