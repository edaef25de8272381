"""The shooting function: its derivative, one lane against many, one piece against several, and what is held."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from many_problems import KINDS, Kind
from perilune import Indirect
from perilune.conditions.canonical_equations import extremal_parameters
from perilune.conditions.pontryagin import derive
from perilune.methods.indirect.continuation.parameter_scan import (
    HeldFamily,
    _connected_members,
    _extremal_pairs,
    distinct_roots,
    same_vector,
)
from perilune.problem import Problem, Solution
from perilune.shooting import plan as planning
from perilune.shooting.continuation import Member
from perilune.shooting.integrate_plan import Code, FewLanes, PlanIntegrator, fleet
from perilune.shooting.newton import FINEST
from perilune.shooting.plan import plan
from perilune.shooting.shooting_function import Root, Shooting
from test_bounds import push, shove
from test_language import transfer

kinds = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)


def jacobian(root: Root) -> np.ndarray:
    return np.linalg.inv(root.inverse)


def near(shooting: Shooting, Y: np.ndarray, size: float = 1e-3, seed: int = 1) -> np.ndarray:
    """Y moved at random in the unknowns that Newton moves."""
    moved = Y.copy()
    moved[shooting.plan.active] += size * np.random.default_rng(seed).normal(size=len(shooting.plan.active))
    return moved


BENT = Kind(name="spring met on the way", make=partial(transfer, "fmax"), spread={})


@pytest.mark.parametrize("kind", [*KINDS, BENT], ids=lambda kind: kind.name)
def test_the_derivative_is_that_of_differences(kind: Kind) -> None:
    """Links, switches, durations, joints and kinks included: each column against central differences."""
    shooting, guesses, p = kind.batch(1)
    plan, nothing = shooting.plan, shooting.holding({})
    Y = near(shooting, guesses[0])
    J, step = jacobian(shooting.at(Y[None], p, nothing)[0]), 1e-5
    moved = np.zeros((len(plan.active), plan.size))
    moved[np.arange(len(plan.active)), plan.active] = step
    ahead, behind = (shooting.at(Y + sign * moved, p[0], nothing) for sign in (1, -1))
    residual = plan.columns.residual
    slope = (ahead.rows[:, residual] - behind.rows[:, residual]).T / (2 * step)
    assert J == pytest.approx(slope, abs=2e-7 * np.abs(slope).max())


@kinds
def test_a_lane_of_many_is_a_lane_alone(kind: Kind) -> None:
    """To the last bit, for residual, derivative and cost, and for the roots."""
    shooting, guesses, p = kind.batch(7)
    nothing = shooting.holding({})
    Y = np.array([near(shooting, guesses[0], seed=i) for i in range(7)])
    many = shooting.at(Y, p, nothing)
    roots = shooting.solve(Y, p, nothing)
    assert roots.converged.all()
    for i in range(7):
        np.testing.assert_array_equal(shooting.at(Y[i : i + 1], p[i], nothing).rows[0], many.rows[i])
        alone = shooting.root(Y[i], p[i], nothing)
        assert alone.converged
        np.testing.assert_array_equal(alone.y, roots.y[i])
        assert alone.cost == roots[i].cost


@kinds
def test_dispersed_problems_all_converge(kind: Kind) -> None:
    shooting, guesses, p = kind.batch(256)
    roots = shooting.solve(guesses, p, shooting.holding({}))
    assert roots.converged.all()
    assert roots.residuals.max() <= 1e-11
    assert np.ptp([root.cost for root in roots]) > 1e-3  # they are different problems


@pytest.mark.parametrize("kind", KINDS[:3], ids=lambda kind: kind.name)
def test_several_pieces_find_what_one_finds(kind: Kind) -> None:
    """From disturbed joints, for two phases with a link and for switches as well; many lanes at once."""
    one, guesses, p = kind.batch(5)
    several, joined, _ = replace(kind, segments=3).batch(5)
    single = one.solve(guesses, p, one.holding({}))
    multiple = several.solve(np.array([near(several, Y, 1e-4) for Y in joined]), p, several.holding({}))
    assert multiple.converged.all()
    assert multiple.y[:, : one.plan.size] == pytest.approx(single.y, abs=1e-9)
    assert [r.cost for r in multiple] == pytest.approx([r.cost for r in single], rel=1e-11)


@pytest.mark.parametrize("kind", KINDS[:3], ids=lambda kind: kind.name)
def test_later_segments_of_a_phase_begin_by_one_function(kind: Kind) -> None:
    """It takes the start of the segment, and would else be compiled for each of them."""
    made = plan(derive(kind.make()), 4)
    for first in range(0, len(made.legs), 4):
        assert len({leg.opening for leg in made.legs[first + 1 : first + 4]}) == 1
        assert made.legs[first].opening != made.legs[first + 1].opening


@pytest.mark.parametrize("kind", KINDS[:3], ids=lambda kind: kind.name)
def test_the_step_compiled_is_the_step_of_lapack(kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    """For many lanes and for one."""
    shooting, guesses, p = kind.batch(3)
    Y, nothing = near(shooting, guesses[0])[None, shooting.plan.active], shooting.holding({})[None]
    old = np.eye(Y.shape[1]).ravel()[None]
    found = []
    for limit in (0, 1000):
        monkeypatch.setattr(planning, "COMPILED", limit)
        own = plan(shooting.conditions, kind.segments)
        assert own.compiled == (limit > 0)
        code = Code(own)
        found.append(PlanIntegrator(code, np.tile(Y, (3, 1)), nothing, p, np.full(3, FINEST), np.tile(old, (3, 1)))())
        alone = FewLanes(code, 1)(Y, nothing, p[:1], np.full(1, FINEST), old)
        np.testing.assert_array_equal(alone, found[-1][:1])
    assert found[1] == pytest.approx(found[0], rel=1e-8, abs=1e-9)


def test_what_is_held_is_there_and_the_rest_is_stationary(landing: Problem, hybrid: Solution) -> None:
    """Each lane holds another value of the retro burn; dJ/dq is the slope of J over these values."""
    shooting, p = Shooting(derive(landing)), extremal_parameters(landing)
    assert hybrid.unknowns is not None
    values = hybrid.unknowns[shooting.conditions.free_at.start] + np.array([-1e-3, 0.0, 1e-3])
    choices = np.array([shooting.holding({0: value}) for value in values])
    roots = shooting.solve(np.tile(hybrid.unknowns, (3, 1)), p, choices)
    assert roots.converged.all()
    assert roots.y[:, shooting.conditions.free_at.start].tolist() == values.tolist()
    costs = [root.cost for root in roots]
    assert abs(roots[1].slopes[0]) < 1e-10
    assert roots[2].slopes[0] - roots[0].slopes[0] == pytest.approx(
        2 * (costs[0] - 2 * costs[1] + costs[2]) / 1e-3, rel=1e-4
    )
    tangent = (roots.y[2] - roots.y[0]) / 2e-3
    assert shooting.tangent(roots[1], 0) == pytest.approx(tangent, abs=1e-4 * np.abs(tangent).max())
    free = shooting.root(hybrid.unknowns, p, shooting.holding({}))
    curvature = (costs[0] - 2 * costs[1] + costs[2]) / 1e-6
    assert shooting.curvature(free, 0) == pytest.approx(curvature, rel=1e-3)


def test_any_subset_is_held() -> None:
    """Two of three free parameters in one lane, none in the next; a range at its bound in the third."""
    problem = shove((-1.0, 1.0), (-1.0, 2.0), (0.2, 5.0))
    shooting, p = Shooting(derive(problem)), extremal_parameters(problem)
    answer = Indirect().run(problem)
    assert answer.unknowns is not None
    choices = np.array([shooting.holding({0: 0.1, 2: 0.9}), shooting.holding({}), shooting.holding({}, {0: 1.2})])
    roots = shooting.solve(np.tile(answer.unknowns, (3, 1)), p, choices)
    assert roots.converged.all()
    first = shooting.conditions.free_at.start
    assert roots.y[0, [first, first + 2]].tolist() == [0.1, 0.9]
    assert abs(roots[0].slopes[1]) < 1e-11 < abs(roots[0].slopes[0])
    assert np.abs(roots[1].slopes).max() < 1e-11
    assert roots[2].ranges[0] == pytest.approx(1.2, abs=1e-12)


def test_first_order_changes_with_given_parameters() -> None:
    problem, moved = push(0.0, 1.0), push(0.0, 1.0, length=1.0001)
    shooting, p = Shooting(derive(problem)), extremal_parameters(problem)
    answer, other = Indirect().run(problem), Indirect().run(moved)
    assert answer.unknowns is not None and other.unknowns is not None
    root = shooting.root(answer.unknowns, p, shooting.holding({}, {0: 1.0}))
    shift = shooting.shift(root, extremal_parameters(moved), p)
    assert root.y + shift == pytest.approx(other.unknowns, abs=1e-9)  # the equations are linear


def test_a_lost_arc_is_not_a_number() -> None:
    """A mass that runs out on the way: that lane alone is lost."""
    shooting, guesses, p = KINDS[0].batch(3)
    guesses[1, shooting.conditions.free_at] = 3.0
    roots = shooting.at(guesses, p, shooting.holding({}))
    assert np.isnan(roots.rows[1]).all()
    assert np.isfinite(roots.rows[[0, 2]]).all()
    assert shooting.solve(guesses, p, shooting.holding({})).converged.tolist() == [True, False, True]


def test_threads_share_a_fleet() -> None:
    """What flies one lane is lent to one thread at a time: all get their own answers."""
    shooting, guesses, p = KINDS[0].batch(40)
    expected = shooting.solve(guesses, p, shooting.holding({}))

    def solve(lane: int) -> np.ndarray:
        own = Shooting(shooting.conditions)
        return own.root(guesses[lane], p[lane], own.holding({})).y

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(solve, range(40)))
    np.testing.assert_array_equal(found, expected.y)


def test_few_lanes_fly_as_many_do() -> None:
    """In arrays that are kept from one flight to the next: what was given before is not overwritten."""
    shooting, guesses, p = KINDS[0].batch(40)
    Y, nothing = guesses[:, shooting.plan.active], shooting.holding({})[None]
    own, old = fleet(shooting.conditions, shooting.segments), np.zeros((40, Y.shape[1] ** 2))
    whole = own.fly(Y, nothing, p, np.full(40, FINEST), old)
    parts = [own.fly(Y[i : i + 4], nothing, p[i : i + 4], np.full(4, FINEST), old[:4]) for i in range(0, 40, 4)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


def root_at(*y: float, inverse: np.ndarray | None = None) -> Root:
    none = np.zeros(0)
    return Root(y=np.array(y), residual=none, inverse=np.eye(len(y)) if inverse is None else inverse, slopes=none,
                ranges=none, cost=0.0, choice=none, converged=True)  # fmt: skip


@pytest.mark.parametrize(
    ("slopes", "near"),
    [
        ((6.0, 1.0, 1.05), True),  # the parabola's least value is 0.393
        ((3.0, 1.0, 1.05), False),  # 0.768
        ((6.0, -1.0, 2.0), False),  # a change of sign is not looked for here
        ((6.0, 1.0, 0.5), False),  # nor an end of the range
        ((-6.0, -1.0, -1.05), True),
        ((3.0, 1.0, 3.0), False),
        ((4.8, 1.0, 1.05), False),  # 0.543
        ((1.02, 6.0, 1.0, 1.05), True),  # of the last three again
    ],
)
def test_two_roots_are_looked_for_where_slopes_come_near_zero(slopes: tuple[float, ...], near: bool) -> None:
    """Where the least value of the parabola through three slopes is under half of the middle one."""
    asked: list[np.ndarray] = []

    def released(Y: np.ndarray, first: Root) -> list[Root]:
        asked.append(Y)
        return [replace(first, converged=False)] * len(Y)

    family = cast("HeldFamily", SimpleNamespace(released=released))
    members = [Member(value=value, root=root_at(10 * value)) for value in (-2.0, -1.0, 0.0, 1.0)[-len(slopes) :]]
    assert _extremal_pairs(family, members, list(slopes)) == []
    assert [Y.tolist() for Y in asked] == ([[[-5.0], [5.0]]] if near else [])


def test_unknowns_are_the_same_by_their_size() -> None:
    """Of costates of a thousand the sixth digit is a thousandth."""
    large = np.array([1e3, 0.0])
    assert same_vector(large, large + 9e-4, 1e-6) and not same_vector(large, large + 2e-3, 1e-6)
    assert not same_vector(0.0 * large, 0.0 * large + 2e-6, 1e-6)


def test_an_isolated_extremal_met_twice_is_one_and_those_of_equal_j_are_two() -> None:
    """Mirror images have the same J; only where both are of a continuum does that make them one."""
    left, right = root_at(-1.0, 2.0), root_at(1.0, 2.0)
    assert distinct_roots([left, right, left]) == [left, right]
    flat = np.diag([1e20, 1.0])
    assert len(distinct_roots([root_at(-1.0, 2.0, inverse=flat), root_at(1.0, 2.0, inverse=flat)])) == 1


def test_large_unknowns_may_change_faster_along_a_family() -> None:
    """The lanes' roots are taken, and nobody walks, though the family bends; another branch is not."""
    walked: list[float] = []
    family = cast("HeldFamily", SimpleNamespace(reach=lambda here, value: walked.append(value)))
    lanes = [(1.0, root_at(100.5)), (2.0, root_at(104.0)), (3.0, root_at(200.0))]
    members = _connected_members(family, Member(value=0.0, root=root_at(100.0)), lanes)
    assert [member.value for member in members] == [1.0, 2.0] and walked == [3.0]
