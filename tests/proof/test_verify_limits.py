"""Limits follow the sizes in a problem: right answers pass in any units, and what lies just beyond a limit fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune import Indirect
from perilune.problem import Curve, fix_free_parameters
from perilune.proof.feasible.phase_data import PhaseData
from problems.ascents import lunar_ascent
from problems.landings import meditch, ordinary
from problems.orbit_raising import orbit_raising
from problems.reentries import apollo
from test_flown import saddle

BEYOND = 10.0  # times a limit


def unstable() -> pl.Problem:
    """Errors of states and costates together grow by e^20."""
    return saddle(20.0)


PROBLEMS = (meditch, ordinary, orbit_raising, apollo, unstable)


@lru_cache
def solved(make: Callable[[], pl.Problem]) -> pl.Solution:
    return Indirect().run(make())


@lru_cache
def checks_of(solution: pl.Solution) -> tuple[pl.Check, ...]:
    """Of a right answer, whose limits many tests ask for."""
    return tuple(pl.verify(solution, level=2).verification.checks)


def limit_of(solution: pl.Solution, name: str) -> float:
    return next(c.limit for c in checks_of(solution) if c.name == name)


def failed(solution: pl.Solution) -> set[str]:
    return {c.name for c in pl.verify(solution, level=2).verification.failed}


def bumped(curve: Curve, row: int, size: float) -> Curve:
    """With one component off by `size` on the middle quarter of the flight, smoothly."""
    share = (curve.time - curve.time[0]) / np.ptp(curve.time)
    inside = np.clip((share - 0.375) / 0.25, 0.0, 1.0)
    values, rates = curve.values.copy(), curve.rates.copy()
    values[:, row] += size * 16 * (inside * (1 - inside)) ** 2
    rates[:, row] += size * 32 * inside * (1 - inside) * (1 - 2 * inside) / (0.25 * np.ptp(curve.time))
    return replace(curve, values=values, rates=rates)


def with_curve(solution: pl.Solution, **curve: Any) -> pl.Solution:
    first, *others = solution.trajectories
    return replace(solution, trajectories=(replace(first, **curve), *others))


UNITS = ((100.0, 1.0), (1.0, 100.0), (1.0, 0.01))


@pytest.mark.parametrize(
    ("make", "units"), [(make, units) for make in PROBLEMS for units in UNITS if make is not apollo or units[1] > 1.0]
)
def test_right_answers_pass_in_any_units(make: Callable[[], pl.Problem], units: tuple[float, float]) -> None:
    """In units of length and time a hundred times too large or too small for the flight."""
    problem = make()
    length, time = units
    scales = replace(problem.scales, length=problem.scales.length * length, time=problem.scales.time * time)
    solution = pl.solve(replace(problem, scales=scales), verify=2)
    assert solution.verification.passed, str(solution.verification)
    assert solution.objective == pytest.approx(solved(make).objective, rel=1e-9)


@pytest.mark.parametrize("make", PROBLEMS)
def test_a_state_beyond_its_limit_is_seen(make: Callable[[], pl.Problem]) -> None:
    solution = solved(make)
    for row, state in enumerate(solution.problem.phases[0].states):
        size = BEYOND * limit_of(solution, f"state_{state.name}")
        wrong = with_curve(solution, state=bumped(solution.trajectories[0].state, row, size))
        assert f"state_{state.name}" in failed(wrong), state.name


@pytest.mark.parametrize("make", PROBLEMS)
def test_a_costate_beyond_its_limit_is_seen(make: Callable[[], pl.Problem]) -> None:
    solution = solved(make)
    arc = PhaseData(solution=solution, index=0)
    assert solution.trajectories[0].costate is not None
    for row, state in enumerate(solution.problem.phases[0].states):
        size = BEYOND * limit_of(solution, f"costate_{state.name}") * float(arc.costate_scale[row])
        wrong = with_curve(solution, costate=bumped(solution.trajectories[0].costate, row, size))
        assert f"costate_{state.name}" in failed(wrong), state.name


@pytest.mark.parametrize("make", PROBLEMS)
def test_costates_that_end_beside_are_seen(make: Callable[[], pl.Problem]) -> None:
    """All of them off by a factor: they keep their equations, and the ends show it."""
    solution = solved(make)
    curve = solution.trajectories[0].costate
    assert curve is not None
    factor = 1 + BEYOND * limit_of(solution, "transversality")
    wrong = with_curve(solution, costate=replace(curve, values=curve.values * factor, rates=curve.rates * factor))
    assert failed(wrong) & {"transversality", "multipliers"}


@pytest.mark.parametrize("make", PROBLEMS)
def test_a_claimed_multiplier_beyond_its_limit_is_seen(make: Callable[[], pl.Problem]) -> None:
    """Each alone, by ten times what errors of the costates at the end may make of it."""
    from perilune.proof.necessary.first_order import _multiplier_sizes

    solution = solved(make)
    arc = PhaseData(solution=solution, index=0)
    sizes = _multiplier_sizes(arc, 1.0) * arc.objective_scale / arc.end_scale
    for condition, size in zip(arc.phase.end_conditions, sizes.tolist(), strict=True):
        name = f"{arc.phase.name}.{condition.name}"
        claimed = solution.multipliers[name]
        off = BEYOND * 1e-9 * max(size, abs(claimed))
        wrong = replace(solution, multipliers={**solution.multipliers, name: claimed + off})
        assert failed(wrong) == {"multipliers"}, name


@pytest.mark.parametrize("make", PROBLEMS)
def test_a_claimed_objective_beyond_its_limit_is_seen(make: Callable[[], pl.Problem]) -> None:
    solution = solved(make)
    wrong = replace(solution, objective=solution.objective + BEYOND * limit_of(solution, "objective"))
    assert "objective" in failed(wrong)


@pytest.mark.parametrize("beside", [1e-6, -1e-6])
def test_a_duration_beside_its_optimum_is_seen(beside: float) -> None:
    """An extremal of the same problem with the duration held beside its optimum: feasible, and nothing else."""
    problem, best = apollo(), solved(apollo)
    found = Indirect().run(fix_free_parameters(problem, time=best.free["time"] * (1 + beside)), guess=best)
    wrong = pl.verify(replace(found, problem=problem), level=2).verification
    assert wrong.level == 1, str(wrong)
    assert "stationary_time" in {c.name for c in wrong.failed}


def test_one_costate_does_not_hide_behind_a_larger_one() -> None:
    """That of the heat is 1, as J is the heat, beside one of 13: off by 1e-8 all along it keeps its equation."""
    solution = solved(apollo)
    curve = solution.trajectories[0].costate
    assert curve is not None and np.abs(curve.values[-1]).max() > 10
    wrong = with_curve(solution, costate=replace(curve, values=curve.values + np.array([0.0, 0.0, 0.0, 1e-8])))
    assert failed(wrong) == {"transversality"}


@pytest.mark.parametrize("off", [1e-8, -1e-8])
def test_the_flight_of_another_start_is_seen(off: float) -> None:
    """An entry from an angle that is 1e-8 rad off ends 800 times as far off."""
    problem = apollo()
    other = problem.with_given(angle=problem.given["angle"].value + off)
    wrong = pl.verify(replace(Indirect().run(other, guess=solved(apollo)), problem=problem), level=2).verification
    assert wrong.level == 0
    assert {"angle", "state_gamma"} <= {c.name for c in wrong.failed}


@pytest.mark.parametrize(("height", "speed"), [(100.0, 1.0), (1000.0, 1.0)])
def test_an_ascent_that_nearly_hovers_is_proved(height: float, speed: float) -> None:
    """Its engine gives 2 % more than gravity takes, and many times the speed that is left."""
    solution = pl.solve(lunar_ascent(1.02 * 1.62, 1.62, height, speed))
    assert solution.verification.level == 3, str(solution.verification)
    curve = solution.trajectories[0].control
    wrong = with_curve(solution, control=replace(curve, values=curve.values @ np.array([[1.0, 1e-8], [-1e-8, 1.0]])))
    assert "state_vx" in failed(wrong)
