"""What a search lists: every extremal once, and the better one among them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import perilune as pl
from problems.circles import to_circle
from problems.constrained import brachistochrone


def test_mirror_images_are_listed_once() -> None:
    """Cycloids from rest to the line x = 1 m, free of the slope: T = sqrt((2k + 1) pi) s, and v may be negative."""
    problem = brachistochrone()
    free = replace(problem, phases=(replace(problem.phases[0], path=None, path_conditions=()),))
    times = [extremal.free["T"] for extremal in pl.solve(free, level=0).extremals]
    assert times[0] == pytest.approx(np.sqrt(np.pi), abs=1e-9) and len(times) > 2
    turns = np.square(times) / np.pi
    assert turns == pytest.approx(np.round(turns), abs=1e-8)
    assert len(set(np.round(turns))) == len(turns)


def mass(time: float, **orbits: float) -> float:
    return -pl.solve(to_circle(time, **orbits), level=0).objective


def test_more_time_is_no_loss_on_the_way_to_a_circle() -> None:
    """Who has arrived may wait there: 0.87905 in 15 s; random costates alone find 0.548 in 30 s."""
    orbits = {"radius": 3.0, "exhaust_speed": 2.0, "eccentricity": 0.3}
    quick = pl.solve(to_circle(15.0, **orbits), level=3)
    assert quick.outcome is pl.Outcome.PROVED
    slow = pl.solve(to_circle(30.0, **orbits), level=0)
    assert -slow.objective >= -quick.objective - 1e-9
    assert slow.statistics.rung == "continuation in the duration"
    assert any("shares of the duration" in line for line in slow.statistics.tried)
    listed = [extremal.objective for extremal in slow.extremals]
    assert listed == sorted(listed) and len(listed) > 1


def test_from_circle_to_circle_it_may_wait_at_both_ends() -> None:
    """Extremals that are not isolated are found, listed once, and said to be such."""
    orbits = {"radius": 2.0, "exhaust_speed": 1.0, "eccentricity": 0.0}
    solution = pl.solve(to_circle(10.0, **orbits), level=2)
    assert -solution.objective == pytest.approx(mass(9.0, **orbits), abs=1e-9)
    assert len(solution.extremals) == 1
    assert any("not isolated" in line for line in solution.statistics.tried)
    assert mass(20.0, **orbits) >= -solution.objective - 1e-9
