"""Arcs along a condition on states, to level 3: closed forms that are minima, and constructed ones that are not."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import perilune as pl
from perilune.problem import Curve, Solution
from perilune.proof.cross_check import check_agreement
from perilune.proof.necessary.contact_points import restate_with_contacts
from perilune.proof.sufficient.boundary_arcs import BoundaryArcs
from perilune.structures.split_join import split_solution
from problems.by_hand import by_hand, parted
from problems.constrained import (
    OFFSET,
    brachistochrone,
    brachistochrone_truth,
    bryson_denham,
    speed_limit,
    speed_limit_truth,
)
from problems.ridden import (
    CLAMPED,
    beam,
    bryson_denham_ridden,
    ditch,
    floor,
    parked_ridden,
    string,
    string_in_two_phases,
    string_pieces,
    two_strings,
)


@lru_cache(maxsize=1)  # a test asks of one solution what failed, and then for a value
def verified(solution: Solution, level: int) -> pl.Verification:
    return pl.verify(solution, level=level).verification


def failed(solution: Solution, level: int) -> set[str]:
    return {check.name for check in verified(solution, level).failed}


def value(solution: Solution, name: str) -> float:
    return next(check.value for check in verified(solution, 3).checks if check.name == name)


def test_a_bound_is_ridden_like_a_condition() -> None:
    """J = 4/(9 l); mu is 0 along the arc, and what is kept of it are the two jumps alone."""
    solution = pl.solve(bryson_denham(1 / 9, as_bound=True))
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert "swing-2_along_sufficient" in {check.name for check in solution.verification.checks}


@pytest.mark.parametrize("rise", [0.5, 0.9])
def test_a_string_held_down_is_a_minimum_up_to_its_conjugate_point(rise: float) -> None:
    """In units of pi; its fall is no longer than half of that. The whole flight is longer than pi."""
    solution = string(2.0, rise * math.pi, 1.0, 0.5 * math.pi)
    assert not failed(solution, 3)
    assert value(solution, "conjugate_point") == pytest.approx(rise**2, rel=1e-3)


@pytest.mark.parametrize("length", [2.0, 4.5])
def test_a_beam_held_down_is_a_minimum_up_to_its_conjugate_point(length: float) -> None:
    solution = beam(1.0, length, 1.0)
    assert not failed(solution, 3)
    assert value(solution, "conjugate_point") == pytest.approx((length / CLAMPED) ** 4, rel=1e-3)


@pytest.mark.parametrize(
    ("solution", "kappa"),
    [(string(1.0, 1.2 * math.pi, 1.0, 0.5 * math.pi), 1.44), (beam(1.0, 4.9, 1.0), (4.9 / CLAMPED) ** 4)],
)
def test_beyond_its_conjugate_point_an_extremal_that_rides_is_none(solution: Solution, kappa: float) -> None:
    """All of level 2 holds, and all of the multiplier's signs."""
    assert failed(solution, 3) == {"conjugate_point"}
    assert value(solution, "conjugate_point") == pytest.approx(kappa, rel=1e-3)


@pytest.mark.parametrize("ride", [1.0, 2.5, 4.0])
def test_an_arc_whose_own_multiplier_is_nought_may_be_left_everywhere(ride: float) -> None:
    """What is kept is l at its two ends: kappa lies between that of a beam clamped there and one that turns freely."""
    solution = beam(1.0, 1.0, ride, level=1.0)
    assert not failed(solution, 3)
    assert (ride / CLAMPED) ** 4 < value(solution, "conjugate_point") < (ride / math.pi) ** 4


def test_an_arc_whose_own_multiplier_is_nought_is_none_where_it_would_buckle() -> None:
    """S'' = 0 along it leaves nothing to vary there, and would hide that; a bump below l is better."""
    solution = beam(1.0, 1.0, 5.0, level=1.0)
    assert failed(solution, 3) == {"conjugate_point"}
    assert value(solution, "conjugate_point") > (5.0 / CLAMPED) ** 4


@pytest.mark.parametrize(("bent", "passes"), [(1.0, True), (0.0, False), (-0.1, False)])
def test_how_long_it_rides_has_to_be_a_minimum(bent: float, passes: bool) -> None:
    """J over the duration, which only the ride takes up, is bent upwards, level, or bent downwards."""
    assert ("conjugate_point" not in failed(string(1.0, 1.0, 1.0, 1.0, bent=bent), 3)) is passes


@pytest.mark.parametrize(
    "solution",
    [
        string(2.0, 0.0, 1.0, 0.5 * math.pi),  # begins on its arc
        string(1.0, 1.0, 1.0, 0.0),  # ends on it, where an end condition is
        string(1.0, 1.0, 1.0, 0.0, push=0.0),  # ends on it, free
        string(1.0, 1.0, 1.0, 0.0, push=-0.5),  # ends on it, and J would have it beyond
    ],
)
def test_an_arc_may_begin_or_end_with_its_phase(solution: Solution) -> None:
    assert not failed(solution, 3)


@pytest.mark.parametrize("limit", [30.0, 50.0])
def test_a_lander_with_a_speed_limit_is_locally_optimal(limit: float) -> None:
    """H is linear in its thrust, which keeps the speed along the arc; by the rocket equation."""
    met, left, mass = speed_limit_truth(limit)
    solution = pl.solve(speed_limit(limit))
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert solution.objective == pytest.approx(-mass, rel=1e-9)
    along = next(arc for arc in solution.structure if arc.description == "along room")
    assert (along.begin, along.end) == (pytest.approx(met, rel=1e-6), pytest.approx(left, rel=1e-6))


def test_a_condition_may_hold_the_duration_that_is_free() -> None:
    """The line falls by 1 cm for each second that the slide takes: the least time is that of the line as it is then."""
    fixed = brachistochrone()
    phase = replace(
        fixed.phases[0],
        path=pl.Conditions.of(
            lambda x, u, p, xp: (p.slope * x.x + p.offset + p.falls * (p.T - p.T0) - x.y,),
            fixed.phases[0].path_conditions,
        ),
    )
    falls = {"falls": pl.Parameter(value=0.01, unit="m/s"), "T0": pl.Parameter(value=1.8, unit="s")}
    problem = pl.Problem(
        name="falling", phases=(phase,), start=fixed.start, given={**fixed.given, **falls}, free=fixed.free,
        objective=lambda x, p, xp: p.T, objective_unit="s",
    )  # fmt: skip
    solution = pl.solve(problem)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    least = brachistochrone_truth(OFFSET + 0.01 * (solution.objective - 1.8))[2]
    assert solution.objective == pytest.approx(least, abs=1e-9)


@pytest.mark.parametrize(("pull", "passes"), [(0.0, True), (0.5, True), (1.5, False)])
def test_to_leave_an_arc_when_it_does_has_to_be_a_minimum(pull: float, passes: bool) -> None:
    """J over the time of leaving bends by 1 - pull; all of level 2 holds at the maximum, and mu is 1."""
    assert failed(ditch(0.8, 0.5, pull=pull), 3) == (set() if passes else {"conjugate_point"})


@pytest.mark.parametrize(("load", "failing"), [
    ((0.5, 1.0), set()),
    ((-0.2, 1.0), {"ditch-2_along"}),
    ((0.0, 1.0), {"ditch-2_along_sufficient"}),  # x may rise half way at no first-order cost
])  # fmt: skip
def test_what_is_linear_pays_all_along_the_arc(load: tuple[float, float], failing: set[str]) -> None:
    wrong = failed(ditch(0.8, 0.5, load=load), 3)
    assert failing <= wrong and bool(wrong) is bool(failing)


@pytest.mark.parametrize(
    ("solution", "kappa"),
    [
        (two_strings((1.0, 1.0, 1.0, 1.0), (2.0, 1.0, 2.0, 3.0)), (3.0 / math.pi) ** 2),
        (two_strings((1.0, 1.0, 1.0, 1.0), (2.0, 1.0, 3.5, 1.5)), (1.5 / math.pi) ** 2),
        (two_strings((1.0, 1.0, 1.0, 1.0), (2.0, 1.0, 1.2, 3.8)), (3.8 / math.pi) ** 2),
    ],
)
def test_two_conditions_are_ridden_at_once(solution: Solution, kappa: float) -> None:
    """One begins while the other is ridden, and ends after or before it."""
    assert failed(solution, 3) == ({"conjugate_point"} if kappa > 1 else set())
    assert value(solution, "conjugate_point") == pytest.approx(kappa, rel=1e-3)


@pytest.mark.parametrize(
    "solution",
    [
        string_in_two_phases(2.0, 1.0, 1.0, 1.0, 0.5),
        string_in_two_phases(2.0, 1.0, 1.0, 1.0, 1.0),
        string_in_two_phases(2.0, 1.0, 1.0, 1.0, 0.5, stop=True),
        string_in_two_phases(2.0, 1.0, 1.0, 1.0, 0.0, stop=True),
    ],
)
def test_an_arc_may_go_on_in_the_next_phase(solution: Solution) -> None:
    """Or end with a phase, or begin with the next where an end condition says so."""
    assert not failed(solution, 3)
    assert value(solution, "conjugate_point") == pytest.approx(1 / math.pi**2, rel=1e-3)


def test_what_is_said_twice_of_a_variation_is_said_once() -> None:
    """A phase that ends on its arc, where an end condition says so too, and the next begins: the conjugate point."""
    solution = string_in_two_phases(1.0, 1.0, 1.0, 3.5, 0.5, stop=True)
    assert failed(solution, 3) == {"conjugate_point"}
    assert value(solution, "conjugate_point") == pytest.approx((3.5 / math.pi) ** 2, rel=1e-3)


def test_an_arc_that_begins_with_a_phase_unsaid_is_not_proved() -> None:
    """No end condition of the phase before brings the flight to it: its costates may not jump there."""
    assert "two-1_along_ends" in failed(string_in_two_phases(2.0, 1.0, 1.0, 1.0, 0.0), 2)


@pytest.mark.parametrize(("push", "passes"), [(0.0, True), (-0.3, True), (0.3, False)])
def test_an_arc_may_fill_its_phase(push: float, passes: bool) -> None:
    """J asks for its end beyond l, or for less; tables of a whole phase have no edge."""
    wrong = failed(string(1.0, 0.0, 1.0, 0.0, push=push), 3)
    assert not wrong if passes else "along_ends" in wrong


def test_an_arc_that_fills_its_phase_between_given_ends_has_no_neighbours() -> None:
    assert failed(string(1.0, 0.0, 1.0, 0.0), 3) == {"initial_costate_x", "initial_costate_c"}


@pytest.mark.parametrize(
    ("solution", "check"),
    [
        (string(1.0, 1.0, 1.0, 0.0, push=0.5), "string-2_along_ends"),  # J would have its end away from the arc
        (string(1.0, 0.0, 1.0, 1.0, bait=1.0, start_is_free=True), "string-1_along_ends"),  # its start likewise
        (bryson_denham_ridden(1 / 9, 0.3), "swing-2_along_ends"),  # ridden for longer than is best
        (bryson_denham_ridden(1 / 5, 0.45), "swing-2_along_ends"),  # ridden where a touch is best
        (parked_ridden(1 / 9, 0.3), "swing-2_along_ends"),  # met too early, and ridden to the end
        (floor(0.3), "along"),  # a multiplier that is negative on the way
    ],
)
def test_what_rides_and_would_better_leave_is_no_extremal(solution: Solution, check: str) -> None:
    assert pl.verify(solution, level=1).verification.passed
    assert check in failed(solution, 2)


def test_the_best_of_the_rides_by_hand_is_the_one() -> None:
    assert not failed(bryson_denham_ridden(1 / 9, 1 / 3), 3)
    assert not failed(parked_ridden(1 / 9, 1 / 3), 3)


def test_a_bait_at_a_given_start_changes_nothing() -> None:
    assert not failed(string(1.0, 0.0, 1.0, 1.0, bait=1.0), 3)


@pytest.mark.parametrize("problem", [bryson_denham(1 / 5), bryson_denham(1 / 9), brachistochrone()])
def test_another_method_agrees_where_both_tell_costates_in_one_way(problem: pl.Problem) -> None:
    """Along the arc the direct method's own differ by all of their size: there is another multiplier in them."""
    solution = pl.solve(problem, verify=4)
    assert solution.verification.level == 4
    names = {check.name for check in solution.verification.checks}
    assert f"{problem.phases[0].name}-2_cross_costate_x" in names


@pytest.mark.parametrize("curve", ["state", "costate"])
def test_another_method_does_not_agree_with_other_curves(curve: str) -> None:
    """By 1e-3 of the costate of x, or of x, along the arc."""
    solution = bryson_denham_ridden(1 / 9, 1 / 3)
    wrong = changed_along(solution, curve, 1e-3)
    for answer, agrees in ((solution, True), (wrong, False)):
        parts, structure = restate_with_contacts(solution)
        if answer is wrong:
            parts = split_solution(wrong, structure)
        checks = {check.name: check for check in check_agreement(answer, None, (parts, structure))}
        assert checks[f"swing-2_cross_{curve}_x"].passed is agrees
        assert checks["cross_objective"].passed


def changed_along(solution: Solution, curve: str, amount: float) -> Solution:
    """The first row of a table changed along the arc by a share of what it is."""
    flown = solution.trajectories[0]
    table: Curve = getattr(flown, curve)
    first, last = np.nonzero(np.diff(table.time) == 0)[0]
    values, rates = table.values.copy(), table.rates.copy()
    here = slice(first + 1, last + 1)
    values[here, 0] *= 1 + amount
    rates[here, 0] *= 1 + amount
    changed = replace(flown, **{curve: Curve(time=table.time, values=values, rates=rates)})
    return replace(solution, trajectories=(changed,))


@pytest.mark.parametrize("amount", [1e-4, -1e-4, -2.0])
def test_another_multiplier_along_the_arc_is_none(amount: float) -> None:
    assert failed(changed_along(string(2.0, 1.0, 1.0, 1.0), "costate", amount), 2)


@pytest.mark.parametrize("amount", [1e-6, 1e-3, -1e-3])
def test_a_multiplier_that_jumps_on_the_way_is_none(amount: float) -> None:
    """The costate of x jumps along the slope of S half way along the arc, where the tables have an edge."""
    solution = string(2.0, 1.0, 1.0, 1.0)
    rise, early, late, fall = parted(string_pieces(2.0, 1.0, 1.0, 1.0), [0.75])
    before, rate = early.costate[0]
    early = replace(early, costate=[(lambda t: before(t) - amount, rate), early.costate[1]])
    wrong = failed(by_hand(solution.problem, [rise, early, late, fall]), 2)
    assert "string-2_costate_x" in wrong
    assert abs(amount) < 1e-4 or {"string-2_along", "string-2_along_ends"} <= wrong  # what has no value fails


def test_an_arc_that_is_missed_by_little_is_none() -> None:
    """The flight along x = 1 shown as one along x = 1 + 1e-8."""
    solution = string(2.0, 1.0, 1.0, 1.0)
    wrong = replace(solution, problem=solution.problem.with_given(l=1 + 1e-8))
    assert failed(wrong, 2)


@pytest.mark.parametrize("condition", ["there", "still"])
@pytest.mark.parametrize("claim", [0.0, 1e-6, -1.0])
def test_a_multiplier_of_an_end_that_the_arc_says_already_is_compared(condition: str, claim: float) -> None:
    """It ends at rest on the ceiling that it rides along: its costates end at 0, and so do both multipliers."""
    solution = replace(parked_ridden(1 / 9, 1 / 3), multipliers={f"swing.{condition}": claim})
    assert failed(solution, 3) == ({"multipliers"} if claim else set())


@pytest.mark.parametrize(("slope", "left"), [(1.0, 0.0), (-1.0, 4.0)])
def test_an_end_condition_that_no_state_moves_explains_no_jump(slope: float, left: float) -> None:
    """Of a jump of (-3, -4) the user's condition takes the first, and nu dS/dx with nu <= 0 the second or nothing."""
    ridden = SimpleNamespace(
        edge=lambda s: None, reach=lambda s: 1.0, condition=SimpleNamespace(order=1),
        costates=lambda s: np.array([3.0, 4.0]), slope=lambda i, at: np.array([[0.0], [slope]]),
    )  # fmt: skip
    rides: Any = SimpleNamespace(
        boundary_arcs=[(), (ridden,)], _back=lambda joint: np.eye(2), entered=lambda ridden: {},
        _explained=lambda joint: [np.zeros(2), np.array([2.0, 0.0])],
    )  # fmt: skip
    assert BoundaryArcs.jump(cast("BoundaryArcs", rides), 1) == pytest.approx(left, abs=1e-12)
