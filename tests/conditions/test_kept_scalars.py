"""Conditions of the path on scalar controls that the indirect method keeps: closed forms, the same said otherwise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given as given_by, strategies as st
from scipy.optimize import brentq

import perilune as pl
from perilune.conditions.canonical_equations import extremal_parameters
from perilune.conditions.pontryagin import attainable_conditions, derive
from perilune.conditions.scalar_minimum import _condition_zeros_on_line, minimise_interior_scalars
from perilune.conditions.scalar_regimes import Scalar, pivots
from perilune.methods.indirect.admissibility import AdmissibilityTest
from perilune.problem import Settled
from perilune.shooting.shooting_function import Shooting
from problems.entry import limited_entry
from test_control_law import given, slide, variables

BRAKES, WAY = 2.0, 3.0


def _proved(problem: pl.Problem) -> pl.Solution:
    solution = pl.solve(problem)
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 3)
    return solution


def test_a_limit_that_is_no_interval_holds_on_both_its_sides() -> None:
    """|u| <= 5 said as u^2 <= 25, of a control without bounds: a root of the condition for each of its sides."""
    bounded = slide("strength")
    phase = replace(
        bounded.phases[0],
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        path=pl.Conditions(lambda x, u, p, xp: (p.strength * p.strength - u.u * u.u,), weak="m^2/s^4"),
    )
    solution = _proved(replace(bounded, phases=(phase,)))
    first = 0.5 * (1 - math.sqrt(0.6))
    assert solution.objective == pytest.approx(25 * (first + (0.5 - first) / 3), abs=1e-10)
    time = solution.trajectories[0].control.time
    assert time[1:][np.diff(time) == 0] == pytest.approx([first, 1 - first], abs=1e-10)


def _pushed(*limits: str) -> pl.Problem:
    """From rest to rest in least time, u between -2 and 9: pushed no harder than `limits` of 1 + v and of 1.5 say."""
    every = {"by_speed": lambda x, u, p: p.push + p.gain * x.v - u.u, "by_size": lambda x, u, p: p.most - u.u}
    phase = pl.Phase(
        name="push",
        states=variables(x="m", v="m/s"),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=-BRAKES, upper=9.0),),
        dynamics=lambda x, u, p, xp: (x.v, u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.way, x.v), arrive="m", rest="m/s"),
        path=pl.Conditions(
            lambda x, u, p, xp: tuple(every[name](x, u, p) for name in limits),
            *variables(**dict.fromkeys(limits, "m/s^2")),
        ),
    )
    return pl.Problem(
        name="push",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0),
        given=given(way=(WAY, "m"), push=(1.0, "m/s^2"), gain=(1.0, "1/s"), most=(1.5, "m/s^2")),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.1, upper=20.0, guess=3.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
    )


@pytest.mark.parametrize("size", [math.inf, 1.5])
def test_a_bound_that_moves_with_the_state(size: float) -> None:
    """v' = 1 + v, and no more than 1.5, then brakes: of two conditions the one with less slack is held."""

    def flown(pushed: float) -> tuple[float, float]:
        alone = min(pushed, math.log(size))
        v, x = math.exp(alone) - 1, math.exp(alone) - 1 - alone
        rest = pushed - alone
        return x + v * rest + 0.75 * rest**2, v + 1.5 * rest

    until: Any = brentq(lambda t: flown(t)[0] + flown(t)[1] ** 2 / (2 * BRAKES) - WAY, 0.1, 3.0, xtol=1e-15)
    limits = ("by_speed",) if size == math.inf else ("by_speed", "by_size")
    solution = _proved(_pushed(*limits))
    assert solution.objective == pytest.approx(until + flown(until)[1] / BRAKES, abs=1e-10)
    held = derive(_pushed(*limits), limits).phases[0].held
    assert set(held) == {(), *((name,) for name in limits)}  # never two of one scalar


def _plane(size: bool) -> pl.Problem:
    """Least int a^2/2 in the plane with |a| <= 5.2: by components and a condition, or by size and direction."""
    states = variables(x="m", y="m", vx="m/s", vy="m/s", c="m^2/s^3")

    def by_components(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
        return x.vx, x.vy, u.a, u.b, 0.5 * (u.a * u.a + u.b * u.b)

    def by_size(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
        return x.vx, x.vy, u.size * u.e, u.size * u.n, 0.5 * u.size * u.size

    common: dict[str, Any] = {
        "name": "plane",
        "states": states,
        "duration": "T",
        "end": pl.Conditions(
            lambda x, p, xp: (x.x - p.way, x.vx, x.y - p.up, x.vy), there="m", rest="m/s", height="m", level="m/s"
        ),
    }
    if size:
        controls = (
            pl.ScalarControl(name="size", unit="m/s^2", lower=0.0, upper="most"),
            pl.UnitVectorControl(names=("e", "n")),
        )
        phase = pl.Phase(**common, controls=controls, dynamics=by_size)
    else:
        phase = pl.Phase(
            **common,
            controls=(pl.ScalarControl(name="a", unit="m/s^2"), pl.ScalarControl(name="b", unit="m/s^2")),
            dynamics=by_components,
            path=pl.Conditions(lambda x, u, p, xp: (p.most * p.most - u.a * u.a - u.b * u.b,), weak="m^2/s^4"),
        )
    return pl.Problem(
        name="plane",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, p.across, 0.0, 0.0),
        given=given(T=(1.0, "s"), way=(1.0, "m"), up=(0.5, "m"), across=(0.3, "m/s"), most=(5.2, "m/s^2")),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s^3",
    )


def test_a_condition_that_two_controls_hold_together() -> None:
    """A circle of components is a size and a direction."""
    solution = _proved(_plane(size=False))
    assert solution.objective == pytest.approx(pl.solve(_plane(size=True), verify=0).objective, abs=1e-10)
    u = solution.trajectories[0].control(np.linspace(0.0, 1.0, 200))
    assert 0.1 < np.mean(np.hypot(*u.T) > 5.2 - 1e-9) < 0.9  # on the circle for a part of the time


@given_by(
    st.integers(1, 4).flatmap(lambda n: st.lists(st.sets(st.integers(0, n - 1)), max_size=n).map(lambda h: (n, h)))
)
def test_each_condition_is_held_by_a_control_of_its_own(drawn: tuple[int, list[set[int]]]) -> None:
    """Against all ways to give each condition another control, tried one by one."""
    count, acting = drawn
    symbols = [ca.SX.sym(f"u{i}") for i in range(count)]
    holding = pivots(symbols, [sum((symbols[i] for i in sorted(some)), ca.SX(1.0)) for some in acting])
    ways = [way for way in permutations(range(count), len(acting)) if all(map(set.__contains__, acting, way))]
    assert (holding is None) if not ways else (tuple(holding or ()) in ways)


def _least(H: Any, held: Any, *ranges: tuple[float, float]) -> list[float]:
    """Where H is least over two scalars of some ranges that hold a condition, by the program."""
    (phase,), u = _plane(size=False).phases, ca.SX.sym("u", 2)
    free = [
        Scalar(phase, at, pl.ScalarControl(name="ab"[at], unit="m/s^2", lower=low, upper=high), H(*ca.vertsplit(u)), u,
               (ca.SX(low), ca.SX(high)), acts=True)
        for at, (low, high) in enumerate(ranges)
    ]  # fmt: skip
    control, w, at = minimise_interior_scalars(phase, H(*ca.vertsplit(u)), u, free, ca.SX(held(*ca.vertsplit(u))))
    return np.array(ca.evalf(ca.substitute(control, w, at))).ravel().tolist()


@pytest.mark.parametrize(
    ("square", "ranges"),
    [
        (0.9, ((0.0, 1.0), (-1.0, 1.0))),  # all that holds it lies beside the upper bound of the first
        (0.01, ((0.0, 1.0), (-0.2, 0.2))),  # and beside its lower one
        (0.9, ((-1.0, 0.0), (-1.0, 1.0))),
    ],
)
def test_what_holds_an_ellipse_beside_a_bound_is_found(square: float, ranges: tuple[tuple[float, float], ...]) -> None:
    """The farthest point of x^2 + y^2/10 = s along (a, b) is (a, 10 b) sqrt(s / (a^2 + 10 b^2)) (Lagrange)."""
    a, b = math.copysign(1.0, sum(ranges[0])), 0.05
    far = math.sqrt(square / (a * a + 10 * b * b))
    found = _least(lambda x, y: -a * x - b * y, lambda x, y: x**2 + 0.1 * y**2 - square, *ranges)
    assert found == pytest.approx([a * far, 10 * b * far], abs=1e-12)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_what_holds_a_condition_on_a_bound_may_by_rounding_lie_beyond(side: float) -> None:
    """It vanishes 1e-12 beyond the near bound; to its other root, which Newton's method meets from 0, x cannot go."""
    near, far = side * (0.3 + 1e-12), side * 0.9
    x_range = (min(near, far), max(near, far))
    found = _least(lambda x, y: (y - 0.5) ** 2, lambda x, y: (side * x - 0.3) * (side * x + 0.1), x_range, (0.0, 2.0))
    assert found == pytest.approx([side * 0.3, 0.5], abs=1e-12)


def test_a_scalar_that_a_condition_tells_outright() -> None:
    """The nearest point to the origin on x + y^2 = 1: (1/2, sqrt(1/2))."""
    found = _least(lambda x, y: x**2 + y**2, lambda x, y: x + y**2 - 1.0, (-2.0, 2.0), (0.1, 1.0))
    assert found == pytest.approx([0.5, math.sqrt(0.5)], abs=1e-12)


@pytest.mark.parametrize("regime", ["lower", "upper"])
def test_what_stays_on_a_bound_may_bend_the_hamiltonian(regime: Any) -> None:
    """Which it does not need to be linear in, as along a singular arc."""
    (phase,), u = _plane(size=False).phases, ca.SX.sym("u", 2)
    bounds, limits = {"name": "a", "unit": "m/s^2", "lower": -1.0, "upper": 1.0}, (ca.SX(-1.0), ca.SX(1.0))
    on = Scalar(phase, 0, Settled(**bounds, regime=regime), ca.sumsqr(u), u, limits, acts=False)
    assert on.regimes == (regime,)
    with pytest.raises(pl.PeriluneError, match="no control law for a"):
        Scalar(phase, 0, Settled(**bounds, regime="singular"), ca.sumsqr(u), u, limits, acts=False)


def test_what_knows_a_direction_too_is_not_kept() -> None:
    problem = _plane(size=True)
    phase = replace(
        problem.phases[0],
        path=pl.Conditions(lambda x, u, p, xp: (p.most - u.size * u.e,), across="m/s^2"),
    )
    assert attainable_conditions(replace(problem, phases=(phase,))) == ()


def test_an_entry_under_limits_of_load_and_of_heating() -> None:
    """From its bound the lift goes along the load, in which it is, and later along the heating, by a square of it."""
    problem = limited_entry(load=55.0, rate=93.2e3)
    solution = _proved(problem)
    assert [arc.description for arc in solution.structure if arc.description.startswith("along")] == [
        "along load",
        "along rate",
    ]
    rough = pl.Pseudospectral(nodes=6, segments=16, refine=0).near(solution)
    assert solution.objective == pytest.approx(rough.objective, rel=1e-5)


def test_a_load_that_is_broken_for_a_moment_alone_is_seen() -> None:
    """By 0.7 % in 0.17 s of 45 s, where the lift leaves its bound: between two looks, and the answer was not proved."""
    free = pl.solve(limited_entry(load=80.0, rate=150e3), verify=0)
    problem, conditions = free.problem.with_given(most_load=60.7), derive(free.problem)
    p, shooting = extremal_parameters(problem), Shooting(conditions)
    root = shooting.root(np.array(free.unknowns), p, np.zeros(2 * shooting.plan.held))
    breach = AdmissibilityTest(problem, conditions, p).breach(root)
    assert breach is not None and breach.name == "load"
    assert breach.miss == pytest.approx(0.0066, abs=1e-4)
    kept = problem.with_given(most_load=61.2)
    assert AdmissibilityTest(kept, conditions, extremal_parameters(kept)).breach(root) is None


@pytest.mark.parametrize("rate", [2.0, -0.5])
def test_along_a_line_a_condition_that_is_linear_is_met_at_once(rate: float) -> None:
    """At its root, whatever the grid; one that bends where a chord of the grid between two signs leads."""
    u = ca.SX.sym("u", 2)
    [(point, met)] = _condition_zeros_on_line(
        u, [ca.SX(7.0), ca.SX(1.0)], ca.SX(1.0), rate * u[0] + 3.0 * u[1] - 9.0, 0, [ca.SX(0.0)]
    )
    assert [float(ca.evalf(value)) for value in point] == [6.0 / rate, 1.0] and float(met) == 1.0
    grid = [ca.SX(value) for value in (0.0, 1.0, 3.0)]
    both = list(_condition_zeros_on_line(u, [ca.SX(7.0), ca.SX(1.0)], ca.SX(1.0), u[0] ** 2 - 4.0 * u[1], 0, grid))
    assert [float(ca.evalf(met)) for _, met in both] == [0.0, 1.0]
    assert float(ca.evalf(both[1][0][0])) == pytest.approx(1.0 + 3.0 * 2.0 / 8.0)
