"""The extremal of a solution at other values of parameters, in lanes: each what a solve from that solution gives."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import perilune as pl
from perilune.core import PeriluneError
from perilune.methods.indirect.neighboring import Nearby
from perilune.problem import Solution
from problems.constrained import bryson_denham, bryson_denham_truth, timed_bryson_denham
from problems.ridden import string
from test_atlas_limits import haul


@pytest.fixture(scope="module")
def touching() -> Solution:
    return pl.solve(bryson_denham(1 / 5), verify=0)


def test_a_family_of_touches_in_lanes(touching: Solution) -> None:
    """J = 2 + 6 (1 - 4 l)^2 (Bryson, Denham, Dreyfus 1963), for ceilings at which the flight touches."""
    nearby, ceilings = Nearby(touching), np.linspace(0.17, 0.24, 15)
    roots = nearby.roots({"ceiling": ceilings})
    assert roots.converged.all()
    assert roots.costs == pytest.approx([bryson_denham_truth(ceiling) for ceiling in ceilings], rel=1e-11)
    for lane in (0, 14):
        found = nearby.at(roots[lane], {"ceiling": float(ceilings[lane])})
        alone = pl.solve(found.problem, guess=touching, verify=0)
        assert found.objective == alone.objective and found.structure == alone.structure
        assert found.statistics.initialization == alone.statistics.initialization
        assert pl.verify(found).outcome is pl.Outcome.PROVED


def test_a_landing_in_lanes_is_each_alone(landing: pl.Problem, hybrid: Solution) -> None:
    """To the last bit; two parameters at once, one of them the same for all."""
    nearby, names = Nearby(hybrid), ("vehicle_thrust", "vehicle_mass")
    thrust, mass = (landing.given[name].value for name in names)
    shares = np.linspace(0.99, 1.01, 7)
    roots = nearby.roots({"vehicle_thrust": thrust * shares, "vehicle_mass": 1.001 * mass})
    assert roots.converged.all()
    for lane in (0, 3, 6):
        values = dict(zip(names, (thrust * float(shares[lane]), 1.001 * mass), strict=True))
        found = nearby.at(roots[lane], values)
        alone = pl.solve(landing.with_given(**values), guess=hybrid, verify=0)
        assert found.objective == pytest.approx(alone.objective, rel=1e-13)
        assert found.extremals[0].nature is alone.extremals[0].nature
        for name, value in alone.free.items():
            assert found.free[name] == pytest.approx(value, rel=1e-10)
    again = nearby.roots({"vehicle_thrust": thrust * shares, "vehicle_mass": 1.001 * mass}, begin=roots.y)
    assert again.converged.all() and again.evaluations.max() <= roots.evaluations.max()


def test_nothing_is_derived_or_compiled_again(touching: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    """Were it, there would be nothing to do it with."""
    from perilune.conditions import pontryagin
    from perilune.shooting import plan

    nearby = Nearby(touching)
    for module, name in ((pontryagin, "canonical_equations"), (plan, "_Tracing"), (plan, "arc_engine")):
        monkeypatch.setattr(module, name, None)
    assert nearby.roots({"ceiling": [0.18, 0.19]}).converged.all()


def test_what_cannot_be_taken_is_said(touching: Solution) -> None:
    """A name that is none, and a solution that was sent away."""
    with pytest.raises(PeriluneError, match="no given parameter of this name"):
        Nearby(touching).roots({"cieling": 0.2})
    with pytest.raises(PeriluneError, match="only the curves of this solution are known"):
        Nearby(pickle.loads(pickle.dumps(touching)))


def test_an_end_off_the_arc_that_said_it_is_not_left_out() -> None:
    """At x1 = l the ride says the end; at another x1 a flight that ends at l is none of the problem's."""
    problem = string(1.2, 0.8, 1.0, 0.0).problem
    riding = pl.solve(problem, verify=0)
    nearby = Nearby(riding)
    with pytest.raises(PeriluneError, match="there is no longer implied by the arc along room"):
        nearby.roots({"x1": 0.8})
    with pytest.raises(PeriluneError, match="no longer"):
        nearby.roots({"l": [1.0, 1.01]})  # neither at the l that is known: it varies
    assert nearby.roots({"k": [1.19, 1.21]}).converged.all()
    lower = pl.solve(problem.with_given(x1=0.8), guess=riding)
    assert lower.trajectories[0].state(np.array([1.5]))[0, 0] == pytest.approx(0.8, abs=1e-9)
    assert lower.outcome is pl.Outcome.NOT_PROVED or lower.objective == pytest.approx(-0.8017714156, rel=1e-9)


@pytest.mark.parametrize("rides", [True, False])
def test_bounds_that_follow_from_what_varies_are_those_of_each_lane(rides: bool) -> None:
    """T is at its longest: along a ceiling, where it is a sum of arcs, and without one."""
    base = timed_bryson_denham(0.1, 0.5, 1.0, 0.5) if rides else haul(True)
    longest = "longest" if rides else "patience"
    given = {**base.given, "longest": pl.Parameter(value=1.0, unit="s")}
    ranges = (lambda p, xp: {"T": (0.5 * p.longest, p.longest, 0.9)}) if rides else base.parameter_bounds
    problem = replace(base, given=given, parameter_bounds=ranges)
    nearby = Nearby(pl.solve(problem, verify=0))
    assert (nearby.arcs is not None) == rides
    factors = np.array([1.0, 1.05, 0.95])
    roots = nearby.roots({longest: factors})
    assert roots.converged.all()
    for root, factor in zip(roots, factors.tolist(), strict=True):
        found, alone = nearby.at(root, {longest: factor}), pl.solve(problem.with_given(**{longest: factor}), verify=0)
        assert found.free["T"] == pytest.approx(factor if rides else factor**2, abs=1e-12)
        assert found.objective == pytest.approx(alone.objective, rel=1e-11)


def test_a_sum_of_arcs_whose_range_becomes_one_value_is_solved_anew() -> None:
    """That is another formula, and no other number."""
    base = timed_bryson_denham(0.1, 0.5, 1.0, 0.5)
    given = {**base.given, "least": pl.Parameter(value=0.5, unit="s")}
    problem = replace(base, given=given, parameter_bounds=lambda p, xp: {"T": (p.least, 1.0, 0.9)})
    nearby = Nearby(pl.solve(problem, verify=0))
    with pytest.raises(PeriluneError, match="range of T changes its kind"):
        nearby.roots({"least": 1.0})
