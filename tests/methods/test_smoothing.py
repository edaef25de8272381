"""Flights of many switches: found by way of controls that do not jump; and one way like another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import perilune as pl
from perilune.conditions.pontryagin import derive
from perilune.core import NUMERIC, PeriluneError, ignore_events
from perilune.methods.indirect.continuation.homotopy import Smoothing
from perilune.methods.indirect.continuation.regularized import RATE, smooth_problem
from perilune.methods.indirect.newton_trials import Trials
from perilune.problem import Problem
from problems.circles import meeting
from problems.constrained import brachistochrone
from problems.landings import meditch


def smooth(problem: Problem, share: float = 0.3) -> Problem:
    found = smooth_problem(problem, share)
    assert found is not None
    return found


def test_more_than_thirty_switches_without_a_guess() -> None:
    """Sixteen revolutions. It takes its ten seconds: the ladder is climbed to its end, and what is found is proved."""
    solution = pl.solve(meeting(16, thrust=0.0095))
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert solution.statistics.initialization == "smoothed controls"
    assert (np.diff(solution.trajectories[0].time) == 0).sum() == 33
    assert -solution.objective == pytest.approx(0.86674964015, abs=1e-10)


def test_a_direct_answer_of_many_switches_is_made_exact() -> None:
    """Newton's method from it fails; by way of smooth controls 17 switches, and J as by the indirect method."""
    solution = pl.solve(meeting(8, thrust=0.02), pl.Pseudospectral(segments=8, nodes=8, refine=0), verify=0)
    assert solution.statistics.initialization.endswith("then smoothed controls")
    assert (np.diff(solution.trajectories[0].time) == 0).sum() == 17
    assert -solution.objective == pytest.approx(0.866970829931, abs=1e-10)


@pytest.mark.parametrize("size", [None, 7.0])
def test_a_smoothed_way_to_a_known_answer(size: float | None) -> None:
    """Meditch's landing: with the smoothing removed the bang-bang answer in closed form is left.

    What is called the size of J may be far from what the throttle can change of it.
    """
    problem = replace(meditch(), objective_scale=size)
    trials = Trials(problem, ignore_events)
    root = Smoothing(trials=trials, segments=6).root(trials.shooting.holding({}))
    assert root is not None
    assert root.cost * problem.objective_size == pytest.approx(1.42031259905, abs=1e-10)


def test_a_smooth_control_follows_its_formula() -> None:
    """(s, c) = (rate, -S half) / |(rate, S half)|: one mode, no events, and proved like any other problem."""
    problem = smooth(meditch())
    (extremal,) = derive(problem).phases
    assert len(extremal.modes) == 1 and not extremal.events
    solution = pl.solve(problem)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    flown, p = solution.trajectories[0], solution.parameters
    t = np.linspace(0.0, flown.duration, 7)
    assert flown.costate is not None
    mass, (_, speed, burnt, effort, _) = flown.state(t)[:, 2], flown.costate(t).T
    slope = 0.5 * 1.227 * (speed / mass - burnt / p.c + effort)
    expected = np.array([np.full(7, getattr(p, RATE)), -slope]) / np.hypot(getattr(p, RATE), slope)
    np.testing.assert_allclose(flown.control(t).T, expected, atol=1e-7)


def test_several_phases_hand_on_what_is_gained() -> None:
    """A landing in two phases, the first of 0.1 s: what is gained on it is counted on, and the answer is the same."""
    whole = meditch()
    first, last = (
        replace(whole.phases[0], name=name, duration=duration)
        for name, duration in (("first", "t_first"), ("descent", "t_f"))
    )
    first = replace(first, end=None)
    problem = replace(
        whole,
        phases=(first, last),
        links=(lambda x, p, xp: (x.h, x.v, x.m, x.effort),),
        given={**whole.given, "t_first": pl.Parameter(value=0.1, unit="s")},
    )
    both = smooth(problem)
    values = dict(zip(both.phases[0].state_names, (1.0, 2.0, 3.0, 4.0, 5.0), strict=True))
    p = both.parameters({"t_f": 1.0})
    handed = both.phases[0].state_record(**values)
    assert list(both.links[0](handed, p, NUMERIC)) == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert both.objective(handed, p, NUMERIC) == 4.0 - 5.0
    trials = Trials(problem, ignore_events)
    root = Smoothing(trials=trials, segments=2).root(trials.shooting.holding({}))
    assert root is not None
    assert root.cost * problem.objective_size == pytest.approx(1.42031259905, abs=1e-10)


def test_what_does_not_jump_is_not_smoothed() -> None:
    """An angle, in which the Hamiltonian bends."""
    assert smooth_problem(brachistochrone(), 0.3) is None
    trials = Trials(brachistochrone(), ignore_events)
    assert Smoothing(trials=trials, segments=6).root(trials.shooting.holding({})) is None


def test_directions_that_turn_each_other_have_no_law() -> None:
    """One that only scales another is placed after it; two that are multiplied with each other are refused."""
    phase = replace(
        meditch().phases[0],
        controls=(pl.UnitVectorControl(names=("a", "b")), pl.UnitVectorControl(names=("c", "d"))),
        dynamics=lambda x, u, p, xp: (x.v, -p.g + p.g * (u.a * u.c + u.b * u.d), 0 * p.m_rate, 0 * p.g * x.m),
    )
    problem = replace(
        meditch(), phases=(phase,), given={**meditch().given, "m_rate": pl.Parameter(value=0.0, unit="kg/s")}
    )
    with pytest.raises(PeriluneError, match="a direction that depends on another one"):
        derive(problem)
