"""A flight made by hand, as a guess."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.scenario import load_file

HYBRID = load_file("examples/hybrid_lander.toml").problem
TIMES = np.linspace(0.0, 280.0, 15)
RADIUS = HYBRID.given["body_radius"].value


def straight_down() -> Any:
    """From the perilune straight to the ground."""
    begin = np.array([RADIUS + 15e3, np.pi, 600.0, 0.0, 200.0])
    end = np.array([RADIUS, np.pi + 0.05, 0.0, 0.0, 160.0])
    return begin + (TIMES / TIMES[-1])[:, None] * (end - begin)


def test_the_paper_s_landing_from_a_straight_line() -> None:
    """160.618584 kg, as from nothing; the times are the phase's length."""
    made = pl.guess(HYBRID, TIMES, straight_down(), np.tile([-1.0, 0.0], (15, 1)), retro_delta_v=1100.0)
    assert made.free == {"retro_delta_v": 1100.0, "flight_time": 280.0}
    rough = pl.solve(HYBRID, pl.Pseudospectral(nodes=12), guess=made, verify=0)
    assert rough.statistics.attempts[0].startswith("start from a guess (by hand)")
    assert -pl.solve(HYBRID, guess=rough, verify=0).objective == pytest.approx(160.618584, abs=1e-6)


def test_the_indirect_method_begins_with_what_the_direct_one_makes_of_it() -> None:
    """A table of the answer, rounded to metres and without costates, leads back to it."""
    answer = pl.solve(HYBRID, verify=0)
    t = np.linspace(0.0, answer.free["flight_time"], 12)
    state, control = answer.evaluate(0, t)
    made = pl.guess(HYBRID, t, np.round(state.T, 2), np.round(control.T, 2), retro_delta_v=1200.0)
    again = pl.solve(HYBRID, guess=made, verify=0)
    assert again.objective == pytest.approx(answer.objective, abs=1e-9)
    assert again.statistics.attempts[0].startswith("direct transcription: start from a guess")


def test_controls_may_be_left_out() -> None:
    made = pl.guess(HYBRID, TIMES, straight_down())
    assert (made.trajectories[0].control.values == [1.0, 0.0]).all()


def test_a_guess_of_several_phases() -> None:
    problem = load_file("examples/precision_landing.toml", ("approach.longest_coast=20 s",)).problem
    x = np.zeros((2, 7))
    x[:, 6] = 2000.0
    made = pl.guess(problem, [[0.0, 5.0], [0.0, 50.0]], [x, x])
    assert made.free["coast_time"] == 5.0 and made.free["flight_time"] == 50.0
    assert made.trajectories[1].control.values.shape == (2, 4)


@pytest.mark.parametrize(
    ("times", "states", "controls", "free", "said"),
    [
        (TIMES[::-1], straight_down(), None, {}, "do not describe a flight"),
        ([0.0], straight_down()[:1], None, {}, "do not describe a flight"),
        (TIMES, straight_down()[:, :4], None, {}, r"wrong shape: states of descent \(r, phi"),
        (TIMES, straight_down(), np.zeros((15, 3)), {}, "wrong shape: controls of descent"),
        (TIMES, np.full((15, 5), np.nan), None, {}, "not a number: states"),
        ("yesterday", straight_down(), None, {}, "wrong shape: times"),
        (TIMES, straight_down(), None, {"retro_delta": 1.0}, "retro_delta"),
        (TIMES, straight_down(), None, {"retro_delta_v": "fast"}, "not a number: retro_delta_v"),
        (TIMES, straight_down(), None, {"flight_time": [1.0, 2.0]}, "wrong shape: flight_time"),
    ],
)
def test_what_is_no_guess(times: Any, states: Any, controls: Any, free: dict[str, Any], said: str) -> None:
    with pytest.raises(pl.PeriluneError, match=said):
        pl.guess(HYBRID, times, states, controls, **free)


def test_phases_are_given_one_by_one() -> None:
    problem = load_file("examples/precision_landing.toml", ("approach.longest_coast=20 s",)).problem
    with pytest.raises(pl.PeriluneError, match="list of 2 arrays"):
        pl.guess(problem, TIMES, [])


def test_a_guess_of_far_other_values_is_followed_where_newton_fails_from_it() -> None:
    """From 440 to 2000 N: each extremal is predicted by the sensitivity of the one before."""
    problem, said = load_file("examples/ordinary_lander.toml").problem, list[str]()
    strong = problem.with_given(vehicle_thrust=2000.0)
    near = pl.solve(strong, guess=pl.solve(problem, verify=0), verify=0, callback=lambda event: said.append(str(event)))
    assert "following the guess: 100% of the way" in said and not any("direct" in line for line in said)
    assert near.objective == pytest.approx(pl.solve(strong, verify=0).objective, rel=1e-10)
