"""Conditions that are held along a phase: stated, solved by the direct method, looked at by the proof, saved."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import perilune as pl
from perilune.conditions.active_constraints import minimising_direction
from perilune.core import PeriluneError
from perilune.problem import Curve, Solution
from test_control_law import given, variables


def level_flight(scale: float | None = None) -> pl.Problem:
    """From rest over 100 m in least time without leaving the height: thrust a = 5 m/s^2 against g = 3 m/s^2.

    Held is y'' = a s - g, so the thrust points at sin = 3/5 and T = sqrt(2 d/(4 m/s^2)). The end
    is stated roughly, as backwards is level flight too, at every point anew.
    """
    phase = pl.Phase(
        name="level",
        states=variables(x="m", y="m", vx="m/s", vy="m/s"),
        controls=(pl.UnitVectorControl(names=("c", "s")),),
        dynamics=lambda x, u, p, xp: (x.vx, x.vy, p.a * u.c, p.a * u.s - p.g),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.d,), reach="m"),
        held=pl.Conditions(
            lambda x, u, p, xp: (p.a * u.s - p.g,), pl.Variable(name="climb", unit="m/s^2", scale=scale)
        ),
        end_guess=lambda p, xp: (p.d, 0.0, xp.sqrt(p.a * p.d), 0.0),
    )
    return pl.Problem(
        name="level",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0, 0.0),
        given=given(a=(5.0, "m/s^2"), g=(3.0, "m/s^2"), d=(100.0, "m")),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.1, upper=100.0, guess=10.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
        scales=pl.Scales(length=100.0, time=10.0),
    )


def test_of_two_conditions_on_a_direction_the_best_that_keeps_both_is_taken() -> None:
    """d.x = 0.3 and (d.x + d.y)/sqrt 2 = 0.5 leave two directions; gradient . d is least on the one with d.z < 0."""
    d, gradient = ca.SX.sym("d", 3), ca.SX.sym("g", 3)
    held = (d[0] - 0.3, (d[0] + d[1]) / math.sqrt(2.0) - 0.5)
    best, room = ca.Function("best", [gradient], minimising_direction(gradient, d, held))([0.2, -0.1, 3.0])
    y = 0.5 * math.sqrt(2.0) - 0.3
    below = math.sqrt(1.0 - 0.09 - y * y)
    assert np.array(best).ravel() == pytest.approx([0.3, y, -below], abs=1e-14)
    assert float(room) == pytest.approx(below**2, abs=1e-14)


@pytest.fixture(scope="module")
def level() -> Solution:
    return pl.solve(level_flight(), pl.Pseudospectral(), verify=1)


@pytest.mark.parametrize("scale", [None, 40.0])
def test_what_is_held_says_what_the_control_does(scale: float | None) -> None:
    solution = pl.solve(level_flight(scale), pl.Pseudospectral(), verify=1)
    assert solution.outcome is pl.Outcome.PROVED
    assert solution.objective == pytest.approx(math.sqrt(50.0), rel=1e-10)
    assert solution.trajectories[0].control.values[:, 1] == pytest.approx(0.6, abs=1e-10)
    assert "held_climb" in {c.name for c in solution.verification.checks}


def test_the_proof_sees_what_is_not_held(level: Solution) -> None:
    """A thrust that sways between two nodes and is right at both."""
    flown = level.trajectories[0]
    rates = flown.control.rates.copy()
    rates[len(rates) // 2] += (0.0, 1e-3)
    swaying = Curve(time=flown.control.time, values=flown.control.values, rates=rates)
    proof = pl.verify(replace(level, trajectories=(replace(flown, control=swaying),)), level=1).verification
    assert "held_climb" in {c.name for c in proof.failed}


def test_a_held_condition_is_saved(level: Solution, tmp_path: Path) -> None:
    pl.save(level, tmp_path / "level")
    back = pl.load(tmp_path / "level")
    assert back.problem == level.problem
    assert back.problem.phases[0].held_conditions == level.problem.phases[0].held_conditions
    assert pl.verify(back, level=1).verification.passed
    x, u = np.zeros(4), (0.0, 1.0)
    assert back.problem.phases[0].evaluate("held", x, u, back.parameters) == [2.0]


def test_problems_that_hold_nothing_are_saved_as_before(tmp_path: Path) -> None:
    phase = replace(level_flight().phases[0], held=None)
    free = replace(level_flight(), phases=(phase,))
    pl.save(pl.solve(free, pl.Pseudospectral(), verify=0), tmp_path / "free")
    document = json.loads((tmp_path / "free" / "solution.json").read_text(encoding="utf-8"))
    assert "held_conditions" not in document["problem"]["phases"][0]
    assert pl.load(tmp_path / "free").problem == free


def test_what_cannot_be_held_is_named() -> None:
    problem = level_flight()
    with pytest.raises(PeriluneError, match=r"dimensionally homogeneous: held of level, climb"):
        replace(
            problem,
            phases=(
                replace(
                    problem.phases[0],
                    held=pl.Conditions.of(lambda x, u, p, xp: (u.s - p.g,), problem.phases[0].held_conditions),
                ),
            ),
        )
    with pytest.raises(PeriluneError, match=r"the held condition level\.climb is missed"):
        pl.solve(problem.with_given(a=2.0), pl.Pseudospectral(), verify=0)


def test_the_indirect_method_flies_level_too() -> None:
    solution = pl.solve(level_flight(), pl.Indirect(), verify=1)
    assert solution.outcome is pl.Outcome.PROVED
    assert solution.objective == pytest.approx(math.sqrt(50.0), rel=1e-12)
