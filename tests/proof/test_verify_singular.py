"""Level 3 of singular arcs: Kelley's condition and Goh's second variation against closed forms."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
from scipy.optimize import brentq

import perilune as pl
from perilune.problem import Check, Curve, Parameter, Solution, Variable, Verification
from problems.goddard import goddard
from problems.singular import aly, nearest_to_zero, swinging


def check(verification: Verification, name: str) -> Check:
    return next(c for c in verification.checks if c.name == name)


@lru_cache
def swung(duration: float, end: float | None, bent: float) -> Solution:
    return pl.Indirect().run(swinging(duration, end, bent))


def kappa_truth(solution: Solution, end: float | None) -> float:
    """Of y on the singular arc, with s'' + mu s = 0 and s = 0 at its beginning.

    What is left of s at its end stays as it is for the rest of the flight: tan(sqrt(mu) T) = 1/(sqrt(mu) rest); where
    it has to vanish, mu = (pi/T)^2.
    """
    begin, until = solution.structure[1].begin, solution.structure[1].end
    length, rest = until - begin, solution.trajectories[0].duration - until
    if end is not None:
        return (length / math.pi) ** 2
    root = brentq(lambda q: math.cos(q * length) - q * rest * math.sin(q * length), 1e-6, math.pi / 2 / length)
    return float(np.asarray(root)) ** -2


@pytest.mark.parametrize(
    ("duration", "end", "bent"), [(1.2, None, 0.0), (1.2, 0.5, 0.0), (2.5, 0.5, 0.0), (1.2, None, 0.3), (1.2, 0.5, 0.3)]
)
def test_the_second_variation_has_its_closed_form(duration: float, end: float | None, bent: float) -> None:
    """In straight and in bent states, where every term of the transformation is at work."""
    solution = swung(duration, end, bent)
    verification = pl.verify(solution, level=3).verification
    assert verification.passed
    value = check(verification, "conjugate_point").value
    assert value == pytest.approx(kappa_truth(solution, end), rel=3e-4)  # measured 2.2e-4
    assert check(verification, "kelley").value == pytest.approx(-1.0, abs=1e-6)  # R = 1 all along


@pytest.mark.parametrize(("duration", "end", "like"), [(2.6, None, (1.2, None)), (4.0, -0.3, (2.5, 0.5))])
def test_beyond_its_conjugate_point_an_extremal_is_no_minimum(
    duration: float, end: float | None, like: tuple[float, float | None]
) -> None:
    """Quarter a swing is 1.57 s, which s may take that is free at the end; half of one 3.14 s."""
    solution = pl.Indirect().run(swinging(duration, end), guess=swung(*like, 0.0))
    verification = pl.verify(solution, level=3).verification
    assert {c.name for c in verification.failed} == {"conjugate_point"}
    value = check(verification, "conjugate_point").value
    assert value > 1.2 and value == pytest.approx(kappa_truth(solution, end), rel=3e-4)


@pytest.mark.parametrize("make", [goddard, nearest_to_zero])
def test_they_are_proved_locally_optimal(make) -> None:
    """As is that in a plane, where `test_singular` solves it."""
    solution = pl.solve(make())
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert not any(c.name.endswith("_along") for c in solution.verification.checks)  # an empty tank holds nothing back


def standing(sign: float) -> Solution:
    """At x = 0 with int sign x^2: singular all along, a minimum or a maximum."""
    phase = pl.Phase(
        name="stand",
        states=(Variable(name="x", unit="m"), Variable(name="c", unit="m^2*s")),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (u.u, sign * x.x * x.x),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x,), there="m"),
    )
    problem = pl.Problem(
        name="standing", phases=(phase,), start=lambda p, xp: (0 * p.far, 0 * p.far * p.far * p.T),
        given={"T": Parameter(value=1.0, unit="s"), "far": Parameter(value=1.0, unit="m")},
        objective=lambda x, p, xp: x.c, objective_unit="m^2*s",
    )  # fmt: skip
    time = np.array([0.0, 1.0])
    still = Curve(time=time, values=np.zeros((2, 2)), rates=np.zeros((2, 2)))
    costate = Curve(time=time, values=np.tile([0.0, 1.0], (2, 1)), rates=np.zeros((2, 2)))
    control = Curve(time=time, values=np.zeros((2, 1)), rates=np.zeros((2, 1)))
    flown = pl.Trajectory(phase="stand", state=still, control=control, costate=costate)
    return Solution(
        problem=problem, method="by hand", outcome=pl.Outcome.SOLVED, objective=0.0, free={}, trajectories=(flown,)
    )


def test_kelleys_condition_tells_a_minimum_from_a_maximum() -> None:
    least, most = (pl.verify(standing(sign), level=3).verification for sign in (1.0, -1.0))
    assert pl.verify(standing(-1.0), level=2).verification.passed  # to first order there is no difference
    assert check(least, "kelley").value == pytest.approx(-1.0)
    assert check(least, "conjugate_point").passed
    assert check(most, "kelley").value == pytest.approx(1.0)
    assert not check(most, "kelley").passed and not check(most, "conjugate_point").passed


def test_a_last_impulse_that_costs_nothing_is_said() -> None:
    """Aly's problem is singular to its free end: no theorem counts the control of its last moment."""
    solution = pl.solve(aly())
    assert solution.outcome is pl.Outcome.NOT_PROVED and solution.verification.level == 2
    (failed,) = solution.verification.failed
    assert failed.name == "conjugate_point" and np.isnan(failed.value)
    assert "an impulse at the end of a singular arc" in failed.meaning
