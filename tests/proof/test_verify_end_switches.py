"""A switching function that vanishes at an end of the flight: closed forms in which its slope there decides."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from perilune.core import Outcome
from perilune.problem import Curve, Parameter, Phase, Problem, ScalarControl, Solution, Trajectory, Variable
from perilune.proof.sufficient import second_variation as variations
from perilune.solve import solve
from perilune.verify import verify

LENGTH = 2.0
ENDS = {"begin": 0.0, "end": LENGTH}


def tugged(where: str, pull: float, power: int = 1, weight: float = 1.0) -> Problem:
    """Least J = w int (t - b)^n u dt - pull/2 y(2)^2 with y' = u, |u| <= 1, where b is the beginning or the end.

    S = w (t - b)^n + lam_y, lam_y = -pull y(2). y(0) is such that y(2) = 0, where u does not change sign: S vanishes at
    b alone. A flight on the other bound for a time tau beside b has y(2) = +-2 tau, and costs w tau^2 - 2 pull tau^2
    more for n = 1: D = 2 w and kappa = 2 pull/w. For n = 3 the slope of S at b is 0.
    """
    phase = Phase(
        name="arc",
        states=tuple(Variable(name=n) for n in ("clock", "y", "cost")),
        controls=(ScalarControl(name="u", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (
            1 / p.second, u.u / p.second, p.weight * (x.clock - p.at) ** power * u.u / p.second
        ),
        duration="duration",
    )  # fmt: skip
    return Problem(
        name="tugged",
        phases=(phase,),
        start=lambda p, xp: (0.0, p.begun, 0.0),
        given={
            "duration": Parameter(value=LENGTH, unit="s"),
            "second": Parameter(value=1.0, unit="s"),
            "pull": Parameter(value=pull),
            "weight": Parameter(value=weight),
            "at": Parameter(value=ENDS[where]),
            "begun": Parameter(value=LENGTH if where == "begin" else -LENGTH),
        },
        objective=lambda x, p, xp: x.cost - 0.5 * p.pull * x.y * x.y,
    )


def flown(where: str, pull: float, power: int = 1, weight: float = 1.0, u: float | None = None) -> Solution:
    """With u on one bound all along: 1 up to the end, -1 from the beginning."""
    t, at = np.linspace(0.0, LENGTH, 401), ENDS[where]
    best = -1.0 if where == "begin" else 1.0
    u, one = best if u is None else u, np.ones_like(t)
    late, begun = t - at, -LENGTH * best
    y, lam_y = begun + u * t, -pull * (begun + u * LENGTH)
    cost = weight * u * (late ** (power + 1) - (-at) ** (power + 1)) / (power + 1)
    lam_clock = -weight * u * (late**power - (LENGTH - at) ** power)
    rows = (
        (t, one), (y, u * one), (cost, weight * u * late**power),
        (lam_clock, -weight * u * power * late ** (power - 1)), (lam_y * one, 0 * t), (one, 0 * t),
        (u * one, 0 * t),
    )  # fmt: skip
    values, rates = (np.array([row[i] for row in rows]).T for i in (0, 1))
    state, costate, control = (
        Curve(time=t, values=values[:, here], rates=rates[:, here]) for here in (slice(3), slice(3, 6), slice(6, 7))
    )
    return Solution(
        problem=tugged(where, pull, power, weight), method="closed form", outcome=Outcome.SOLVED, free={},
        objective=float(cost[-1] - 0.5 * pull * y[-1] ** 2),
        trajectories=(Trajectory(phase="arc", state=state, costate=costate, control=control),),
    )  # fmt: skip


def again(problem: Problem, guess: Solution) -> Solution:
    """J in closed form (n = 1, w = 1, the end) for a shifted start: a switch before the end, or none."""
    p = problem.parameters({})
    late, y_end = p.offset_clock, p.offset_y
    tau = max(0.0, (late - p.pull * y_end) / (1 - 2 * p.pull))
    cost = 2 * late - 2 - 2 * late * tau + tau**2
    return replace(guess, objective=p.offset_cost + cost - 0.5 * p.pull * (y_end - 2 * tau) ** 2)


def level_3(solution: Solution) -> dict[str, Any]:
    verification = verify(solution, resolve=lambda problem, guess: guess).verification
    assert verification.level >= 2, str(verification)
    return {check.name: check for check in verification.checks if check.level == 3}


@pytest.mark.parametrize("where", ENDS)
@pytest.mark.parametrize("pull", [-0.4, 0.1, 0.49, 0.51, 0.8])
def test_a_switch_at_an_end_has_the_curvature_of_the_closed_form(where: str, pull: float) -> None:
    """And it is part of the second variation: strict as it is, beyond kappa = 1 a flight that switches is better."""
    checks = level_3(flown(where, pull))
    strict, conjugate = checks["strict_u"], checks["conjugate_point"]
    assert strict.passed and strict.value == pytest.approx(-1.0, rel=1e-9)  # |S| = |t - b|, at most 2, over 2 s
    assert f"its zero where the flight {where}s counts as a switch" in strict.meaning
    assert conjugate.value == pytest.approx(2 * pull, abs=1e-9)
    assert conjugate.passed == (pull < 0.5)
    better = flown_with_switch(where, pull, tau=0.1) < flown(where, pull).objective
    assert better == (pull > 0.5)


def flown_with_switch(where: str, pull: float, tau: float) -> float:
    """J, by quadrature, of a flight that is on the other bound for a time beside its end."""
    t, at = np.linspace(0.0, LENGTH, 200_001), ENDS[where]
    t = 0.5 * (t[1:] + t[:-1])
    best = -1.0 if where == "begin" else 1.0
    u = np.where(np.abs(t - at) < tau, -best, best)
    step = LENGTH / len(t)
    return float(((t - at) * u).sum() * step - 0.5 * pull * (-LENGTH * best + u.sum() * step) ** 2)


def test_a_flight_to_a_switch_at_its_end_is_proved() -> None:
    verification = verify(flown("end", 0.1), resolve=again).verification
    assert verification.level == 3 and verification.passed, str(verification)


@pytest.mark.parametrize("where", ENDS)
def test_a_switching_function_that_leaves_the_end_without_a_slope_is_not_strict(where: str) -> None:
    checks = level_3(flown(where, 0.1, power=3))
    assert not checks["strict_u"].passed
    assert math.isnan(checks["conjugate_point"].value)


def test_one_that_vanishes_all_along_is_not_strict() -> None:
    checks = level_3(flown("end", 0.1, weight=0.0))
    assert not checks["strict_u"].passed and not checks["conjugate_point"].passed


def test_one_that_vanishes_at_the_end_from_the_wrong_side_is_no_extremal() -> None:
    wrong = flown("end", 0.0, u=-1.0)
    failed = {check.name for check in verify(wrong, level=2).verification.failed}
    assert {"switching_u", "minimum_of_hamiltonian"} <= failed


@pytest.mark.parametrize("off", [1e-7, 1e-5])
def test_one_that_is_small_at_the_end_and_not_zero_is_no_switch(off: float) -> None:
    """y(2) = -off leaves S = off/10 at the end, of the wrong sign."""
    assert "switching_u" in {check.name for check in verify(beside_the_end(0.1, -off), level=2).verification.failed}


@pytest.mark.parametrize("pull", [-0.4, 0.1, 0.49, 0.51, 0.8])
def test_one_that_almost_vanishes_at_the_end_is_judged_as_if_it_did(pull: float) -> None:
    """y(2) = off leaves |S| = |pull| off: what is a switch beyond it, if it paid, would pay next to it as well."""
    checks = level_3(beside_the_end(pull, math.copysign(1e-5, pull)))
    strict, conjugate = checks["strict_u"], checks["conjugate_point"]
    assert strict.passed and strict.value == pytest.approx(-1.0, rel=1e-4)
    assert conjugate.value == pytest.approx(2 * pull, abs=1e-4)
    assert conjugate.passed == (pull < 0.5)


def test_one_that_is_well_above_zero_at_the_end_is_no_switch() -> None:
    """|S| = 2e-3 is a thousandth of its largest value, which strictness sees."""
    strict = level_3(beside_the_end(0.1, 2e-2))["strict_u"]
    assert strict.passed and strict.value == pytest.approx(-1e-3, rel=1e-2)
    assert "counts as a switch" not in strict.meaning


def beside_the_end(pull: float, off: float) -> Solution:
    """Return the flight of `flown` to y(2) = off, where S = -pull off."""
    solution = flown("end", pull)
    given = {**solution.problem.given, "begun": Parameter(value=-LENGTH + off)}
    path = solution.trajectories[0]
    assert path.costate is not None
    values = path.state.values + np.array([0.0, off, 0.0])
    costates = path.costate.values - np.array([0.0, pull * off, 0.0])
    moved = replace(path, state=replace(path.state, values=values), costate=replace(path.costate, values=costates))
    objective = solution.objective - 0.5 * pull * off**2
    return replace(solution, problem=replace(solution.problem, given=given), trajectories=(moved,), objective=objective)


def test_the_solvers_own_answer_is_proved() -> None:
    solution = solve(tugged("end", 0.1))
    assert solution.outcome is Outcome.PROVED and solution.verification.level == 3
    assert solution.objective == pytest.approx(-2.0, abs=1e-9)


def test_a_switch_at_an_end_of_the_flight_has_a_stretch_of_no_length_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """With its own name between it and what is beside it, from which the time of the switch is varied."""
    ends = [SimpleNamespace(time=0.0, at=0, across=1.5), SimpleNamespace(time=2.0, at=0, across=-1.5)]
    monkeypatch.setattr(variations, "end_switches", lambda arc: ends)
    arc = SimpleNamespace(edges=np.array([0.0, 1.0, 2.0]), phase=SimpleNamespace(duration="T"))
    found = variations._stretches(cast(Any, arc), {0.0: "first", 1.0: "inner", 2.0: "last"})
    assert [(s.span, s.edges, s.place, s.across) for s in found] == [
        ((0.0, 0.0), (0.0, "first"), None, (0, 1.5)),
        ((0.0, 1.0), ("first", "inner"), 0, None),
        ((1.0, 2.0), ("inner", "last"), 1, None),
        ((2.0, 2.0), ("last", "T"), None, (0, -1.5)),
    ]
    assert [(s.first, s.last) for s in found] == [(True, False), (False, False), (False, False), (False, True)]
