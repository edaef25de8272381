"""The indirect method on problems with closed forms, and its parts one by one."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from cho import cho_landing
from newton_toys import toy
from perilune.conditions.canonical_equations import extremal_parameters
from perilune.conditions.pontryagin import derive
from perilune.core import Iteration, NotConvergedError, Outcome, PeriluneError
from perilune.methods.indirect.exported_phases import _reconcile_switch_values
from perilune.methods.indirect.indirect import Indirect
from perilune.problem import Conditions, Curve, FreeParameter, Parameter, Problem, Solution, Variable, hermite_nodes
from perilune.shooting.continuation import Member, follow_family
from perilune.shooting.newton import Columns, newton
from perilune.shooting.shooting_function import Root, Shooting
from perilune.solve import solve
from problems.ascents import tangent_steering


@pytest.mark.parametrize("split", [False, True])
def test_linear_tangent_steering(split: bool) -> None:
    """One phase, and the same cut in two by a link that passes the state on."""
    solution = solve(tangent_steering(split), verify=0)
    assert solution.objective == pytest.approx(0.554570878334603, rel=1e-11)
    u = solution.trajectories[0].control(np.linspace(0.0, 0.2, 5))
    slopes = u[:, 1] / u[:, 0]
    assert np.diff(slopes, 2) == pytest.approx(0.0, abs=1e-7)  # the tangent is linear in time


def test_a_free_parameter_in_the_dynamics() -> None:
    """It becomes a constant state: the acceleration that minimises time plus its own price, against a scalar search."""
    base = tangent_steering()

    def least_time(a: float) -> float:
        return solve(base.with_given(a=a), verify=0).objective

    priced = replace(
        base,
        given={**{n: g for n, g in base.given.items() if n != "a"}, "price": Parameter(value=2e-3, unit="s^3/m")},
        free=(*base.free, FreeParameter(name="a", unit="m/s^2", guess=90.0)),
        objective=lambda x, p, xp: p.t2 + p.price * p.a,
    )
    solution = solve(priced, verify=0)
    a, step = solution.free["a"], 1e-3
    slope = (least_time(a + step) - least_time(a - step)) / (2 * step)
    assert slope == pytest.approx(-2e-3, rel=1e-6)


def test_multiple_shooting_agrees(landing: Problem, hybrid: Solution) -> None:
    """From disturbed joints to the same root."""
    p = extremal_parameters(landing)
    shooting = Shooting(derive(landing), segments=4)
    assert hybrid.unknowns is not None
    y = shooting.joints(hybrid.unknowns, p)
    assert y is not None
    y[len(hybrid.unknowns) :] += 1e-3
    root = shooting.root(y, p, shooting.holding({}))
    assert root.converged
    assert root.y[: len(hybrid.unknowns)] == pytest.approx(hybrid.unknowns, abs=1e-9)


def test_iterations_are_shown(landing: Problem, ordinary: Solution) -> None:
    """Number, residual, step and damping of each."""
    seen: list[Iteration | str] = []
    solve(
        landing.with_given(retro_delta_v=0.0, vehicle_thrust=450.0),
        guess=ordinary,
        verify=0,
        callback=seen.append,
    )
    iterations = [i for i in seen if isinstance(i, Iteration)]
    assert [i.number for i in iterations] == list(range(1, len(iterations) + 1))
    assert iterations[-1].residual < 1e-11
    assert all(0 < i.damping <= 1 for i in iterations)


def test_the_search_shows_how_far_it_is_and_counts_its_iterations(landing: Problem) -> None:
    """Many starts at once: how many of how many have converged, and the least residual of those at work."""
    seen: list[Iteration | str] = []
    found = solve(landing, verify=0, callback=seen.append)
    lines = [line for line in seen if isinstance(line, str) and line.startswith("round ")]
    starts = [line for line in lines if "of 72 converged" in line]
    assert starts[0].startswith("round 1: 0 of 72 converged, ")
    assert "at work, least residual" in starts[0]
    assert re.fullmatch(r"round \d+: [1-9]\d* of 72 converged", starts[-1])
    assert any("of 33 converged" in line for line in lines)  # the family along the retro burn
    # A start, a member of the family and the answer itself need a few iterations each; no arc is flown without one.
    assert 72 < found.statistics.iterations < found.statistics.arcs
    assert solve(landing, verify=0).statistics.iterations == found.statistics.iterations


def test_continuation_halves_steps_and_reports() -> None:
    """The family y^3 = v, whose tangent is infinite at 0; and y^2 = v, which ends there."""

    def root(power: int, y: np.ndarray, v: float) -> Root:
        ends = newton(toy(lambda x: x**power - v, lambda x: power * x ** (power - 1)), y[None], Columns(n=1))
        return Root(
            y=ends.y[0], residual=ends.rows[0, 4:5], inverse=ends.rows[:, 6:7], slopes=y, ranges=y, cost=0.0, choice=y,
            converged=bool(ends.converged[0]),
        )  # fmt: skip

    def tangent(power: int, r: Root, v: float) -> np.ndarray:
        return r.inverse[0]

    first = Member(value=1.0, root=root(2, np.ones(1), 1.0))
    found = list(follow_family(first, [0.5, 0.01, -1.0], lambda y, v: root(2, y, v), lambda r, v: tangent(2, r, v)))
    assert found[0] is not None and found[0].root.y[0] == pytest.approx(math.sqrt(0.5))
    assert found[1] is not None and found[1].root.y[0] == pytest.approx(0.1)
    assert found[2] is None


def impossible_steering() -> Problem:
    """Tangent steering with an end condition that nothing can meet."""
    base = tangent_steering()
    stuck = replace(
        base.phases[0],
        end=Conditions(
            lambda x, p, xp: (x.y - p.height, x.vx * x.vx + p.speed * p.speed, x.vy),
            *tuple(Variable(name=n, unit=u) for n, u in (("height", "m"), ("impossible", "m^2/s^2"), ("up", "m/s"))),
        ),
    )
    return replace(base, phases=(stuck,))


def test_failure_names_the_residual() -> None:
    """A target that cannot be met: the message names the condition in its unit, and what was tried is kept."""
    with pytest.raises(NotConvergedError) as caught:
        solve(impossible_steering(), Indirect(starts=3), verify=0)
    assert caught.value.partial["attempts"]
    assert any("impossible" in name for name in caught.value.partial["residuals"])


def test_guess_of_another_form_is_refused(hybrid: Solution) -> None:
    """A landing is no guess for a tangent-steering problem."""
    with pytest.raises(PeriluneError, match="other states"):
        solve(tangent_steering(), guess=hybrid, verify=0)


def test_solve_without_proof_says_so(hybrid: Solution) -> None:
    """An unverified answer is SOLVED, not PROVED."""
    assert hybrid.outcome is Outcome.SOLVED
    assert hybrid.verification.level == 0


def test_derivation_is_shared(landing: Problem) -> None:
    """Landers that differ in numbers only are derived and compiled once."""
    assert derive(landing) is derive(cho_landing(300.0))
    assert derive(landing) is not derive(landing.with_given(retro_delta_v=0.0))


def test_it_is_said_that_conditions_are_derived_when_they_are() -> None:
    """Of a capsule that takes many seconds, in which nothing else is told."""
    said: list[Iteration | str] = []
    known = tangent_steering()
    new = replace(known, given={**known.given, "of_no_use": Parameter(value=1.0, unit="m")})
    for problem in (new, new.with_given(a=99.0)):
        Indirect(starts=4).run(problem, callback=said.append)
    assert said[0] == "deriving the optimality conditions" and said.count(said[0]) == 1


def test_curves_interpolate_what_they_promise() -> None:
    """Cubic Hermite is exact on cubics, and nodes are placed where a curve needs them."""
    t = np.linspace(0, 2, 5)
    cubic = Curve(time=t, values=(t**3 - t)[:, None], rates=(3 * t**2 - 1)[:, None])
    at = np.linspace(0, 2, 41)
    assert cubic(at)[:, 0] == pytest.approx(at**3 - at, abs=1e-13)
    assert cubic(0.3).shape == (1,)

    def fast(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.tanh(50 * (t - 1))[:, None], (50 / np.cosh(50 * (t - 1)) ** 2)[:, None]

    nodes, values, rates = hermite_nodes(fast, 2.0, np.array([1e-9]))
    curve = Curve(time=nodes, values=values, rates=rates)
    dense = np.linspace(0, 2, 5001)
    assert np.abs(curve(dense) - fast(dense)[0]).max() < 2e-9
    assert np.diff(nodes)[0] > 4 * np.diff(nodes).min()


def test_a_control_that_goes_on_through_a_switch_is_told_by_the_side_that_turns_less() -> None:
    """Rounding of the switch moves what turns at once; a jump stays one, and so does what has no common time."""

    def piece(time: float, control: float, rate: float) -> list[np.ndarray]:
        return [np.full(1, time), np.array([[7.0, control]]), np.array([[1.0, rate]])]

    for step, gone, told in ((3e-10, 0.0, 0.5), (1e-3, 0.0, None), (3e-10, 0.1, None)):
        for slow, fast in ((0, 1), (1, 0)):
            pieces = [piece(2.0, 0.5, 0.1), piece(2.0 + gone, 0.5 + step, -600.0)][:: 1 if slow == 0 else -1]
            pieces[1][0], pieces[0][0] = np.full(1, 2.0 + gone), np.full(1, 2.0)
            _reconcile_switch_values(pieces, slice(1, None))
            assert pieces[fast][1][0, 1] == (told or 0.5 + step)
            assert pieces[slow][1][0].tolist() == [7.0, 0.5] and pieces[fast][2][0, 1] == -600.0


def test_a_piece_without_length_is_its_end() -> None:
    """What an arc shorter than rounding leaves behind at the end of a phase: three nodes at one time."""
    t = np.array([0.0, 1.0, 1.0, 1.0])
    curve = Curve(time=t, values=np.array([[0.0], [1.0], [5.0], [6.0]]), rates=np.ones((4, 1)))
    assert curve(np.array([0.5, 1.0]))[:, 0] == pytest.approx([0.5, 6.0])
    assert curve(1.0) == pytest.approx([6.0])


def test_nodes_about_a_jump_come_to_an_end() -> None:
    def jump(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.where(t < 2.0 - 1e-15, 1.0, -1.0)[:, None], np.zeros((len(t), 1))

    nodes, *_ = hermite_nodes(jump, 2.0, np.array([1e-9]), shortest=1e-12)
    assert len(nodes) < 200
    assert 2e-13 < np.diff(nodes).min() <= 1e-12
