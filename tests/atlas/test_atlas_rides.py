"""Atlases of answers that ride along a condition on states, against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import perilune as pl
from perilune import Indirect, Problem, Scales
from perilune.atlas.building import build as building
from perilune.atlas.building.tasks import Task, compute_brick
from perilune.atlas.query.query import open_atlas
from perilune.atlas.survey.initial_solves import RegionSolver
from perilune.atlas.survey.survey import _has_negative_arc
from perilune.charts.arc_sequence import PLAIN, arc_sequence_of
from perilune.charts.borders import Borders
from perilune.charts.chart import Chart, Holds
from perilune.charts.extrapolated_midpoint import _admissible_controls
from perilune.charts.reintegrate import SLACK, ChartReintegration
from perilune.charts.sheet import Sheet
from perilune.core import Matrix, PeriluneError, ignore_events
from perilune.methods.indirect.search import Search
from perilune.problem import Nature
from perilune.structures import revise_arcs
from problems.constrained import (
    brachistochrone,
    brachistochrone_truth,
    bryson_denham,
    bryson_denham_truth,
    drawn_off,
    parked,
    speed_limit,
    speed_limit_truth,
    timed_bryson_denham,
    timed_bryson_denham_truth,
    weak_bryson_denham,
    weak_bryson_denham_truth,
)
from problems.ridden import string, string_in_two_phases, two_strings
from problems.singular import nearest_to_zero, swinging, swinging_at_bounds

build = partial(building.build, sample=0)  # proofs have tests of their own


@pytest.mark.parametrize(
    ("problem", "axis", "low", "high", "truth", "arcs"),
    [
        (bryson_denham(0.2), "ceiling", 0.1, 0.45, bryson_denham_truth, {"", "t", "r"}),
        (parked(0.2), "ceiling", 0.15, 0.25, lambda l: 2 / (9 * l), {"r"}),  # up to the end
        (brachistochrone(), "offset", 0.08, 0.12, lambda offset: brachistochrone_truth(offset)[2], {"r"}),
        (speed_limit(40.0), "limit", 38.0, 42.0, lambda limit: -speed_limit_truth(limit)[2], {"r"}),  # by its throttle
        # A condition of the control is in the way of some that ride, and of others not.
        (weak_bryson_denham(0.12, 5.8), "most", 4.6, 7.0, lambda a: weak_bryson_denham_truth(0.12, a), {"r"}),
    ],
    ids=["bryson-denham", "parked", "brachistochrone", "speed limit", "weak bryson-denham"],
)
def test_answers_that_ride_along_a_condition_are_those_of_closed_forms(
    problem: Problem,
    axis: str,
    low: float,
    high: float,
    truth: Callable[[float], float],
    arcs: set[str],
    tmp_path: Path,
) -> None:
    """Free, touching and riding along, each where it is the answer: beyond, one goes through or leaves to gain."""
    atlas = open_atlas(build(problem, {axis: (low, high)}, tmp_path / "map"), lambda _: problem)
    points = np.random.default_rng(0).uniform(low, high, (300, 1))
    found = atlas.query_many(points)
    assert found.good.all()
    np.testing.assert_allclose(found.objective, [truth(value) for value in points[:, 0].tolist()], rtol=1e-10)
    labels = [label for charted in atlas.charted for label in charted.labels]
    met = {labels[number] for number in found.sheet}
    assert {"r" if "along" in label else "t" if "touches" in label else "" for label in met} == arcs
    alone = atlas.query(**{axis: float(points[0, 0])})
    assert alone.objective == pytest.approx(truth(float(points[0, 0])), rel=1e-10)
    assert alone.verification is not None


def test_a_survey_that_holds_a_duration_finds_the_rides_there(tmp_path: Path) -> None:
    """Rides at its other durations cast doubt on the touch that answers; such solves were taken for neighbours'."""
    problem = timed_bryson_denham(0.13, 0.5, 1.0, -1.0)
    atlas = open_atlas(build(problem, {"ceiling": (0.12, 0.15)}, tmp_path / "map", bricks=1), lambda _: problem)
    assert any("along room" in label for charted in atlas.charted for label in charted.labels)
    ceilings, T = np.random.default_rng(0).uniform(0.12, 0.15, 50), np.linspace(0.5, 1.0, 20_001)
    found = atlas.query_many(ceilings[:, None])
    truth = [min(timed_bryson_denham_truth(l, t, -1.0) for t in T.tolist()) for l in ceilings.tolist()]
    assert found.good.all()
    np.testing.assert_allclose(found.objective, truth, rtol=1e-7)  # to the square of a step of T


def test_a_condition_that_is_broken_between_two_steps_is_seen(tmp_path: Path) -> None:
    """Just below l = 1/3 the flight without a ride is over its ceiling in its last 0.7 %, by 2e-8: J 2e-8 too low."""
    problem = parked(0.33)
    atlas = open_atlas(build(problem, {"ceiling": (0.325, 0.34)}, tmp_path / "map", bricks=1), lambda _: problem)
    ceilings = np.linspace(0.33, 0.3333, 40)
    found = atlas.query_many(ceilings[:, None])
    assert found.good.sum() > 30
    np.testing.assert_allclose(found.objective[found.good], 2 / (9 * ceilings[found.good]), rtol=1e-9)


@pytest.mark.parametrize(
    ("problem", "name"),
    [(drawn_off(), "T"), (string(1.2, 0.8, 1.0, 0.9).problem, "k"), (bryson_denham(0.12), "ceiling")],
    ids=["drawn off", "string", "bryson-denham"],
)
@pytest.mark.parametrize(("arc", "later"), [(0, -1e-3), (0, 1e-3), (1, -1e-3), (1, 1e-3), (0, -1e-6), (1, 1e-6)])
def test_who_meets_or_leaves_what_is_ridden_at_another_time_is_no_answer(
    problem: Problem, name: str, arc: int, later: float
) -> None:
    """A ms or a us off, all else solved for, something speaks against it: the path, the control, a jump or mu."""
    search = Search(Indirect(), problem, ignore_events)
    course, extremals = arc_sequence_of(Indirect().answer(search), search.answering.keep)
    value = problem.given[name].value
    chart = Chart(problem, [name], np.array([0.1 * value]), course)
    again, held = ChartReintegration(chart), chart.shooting.plan.held
    y, values = chart.from_problem_unknowns(np.array(extremals[0].unknowns))[None], np.array([[value]]) / chart.scale
    here = chart.solve(values, y, Holds(_nothing(chart)))
    flown = again(here.roots.y, chart.p[None], here.roots.choice)
    assert flown.margins.good[0] and flown.margins.least_multiplier[0] >= 0
    holds = _nothing(chart)
    at = chart.free.free_names.index(f"T-{arc + 1}")
    holds[0, at], holds[0, held + at] = 1.0, here.roots.y[0, chart.conditions.free_at][at] + later
    moved = chart.solve(values, here.y, Holds(holds), limit=40)
    assert moved.converged[0]
    flown = again(moved.roots.y, chart.p[None], moved.roots.choice)
    assert not flown.margins.good[0] or flown.margins.least_multiplier[0] < -SLACK


def test_behind_a_fold_nothing_is_mapped_that_flies_an_arc_backwards_everywhere() -> None:
    """Of a ride 1 - 6 l long; corners that its sheet does not reach say nothing.

    Such sheets refused 113 of 156 precision landings over slopes of 18 to 32 deg and sink rates of 20 to 45 m/s.
    """
    problem = bryson_denham(0.12)
    search = Search(Indirect(), problem, ignore_events)
    course, extremals = arc_sequence_of(Indirect().answer(search), search.answering.keep)
    chart = Chart(problem, ["ceiling"], np.array([0.1]), course)
    y, values = (
        chart.from_problem_unknowns(np.array(extremals[0].unknowns))[None],
        np.array([[0.12], [0.16], [0.18], [0.3]]) / chart.scale,
    )
    nothing, found = _nothing(chart), [y]
    for at in values[1:]:
        found.append(chart.solve(at[None], found[-1], Holds(nothing), limit=40).y)
    borders, y = Borders(chart), np.vstack(found)
    assert borders.backwards(values, y).tolist() == [False, False, True, True]
    assert not Borders(Chart(problem, ["ceiling"], np.array([0.1]), PLAIN)).backwards(values, y).any()
    assert _has_negative_arc(borders, values[2:], y[2:], values[3], y[3])
    assert not _has_negative_arc(borders, values, y, values[3], y[3])
    y[:2] = np.nan
    assert _has_negative_arc(borders, values, y, values[3], y[3])


@pytest.mark.parametrize("length", [3.0, 0.3])
def test_bounds_of_states_that_are_numbers_are_kept_in_any_units(length: float, tmp_path: Path) -> None:
    """Bryson and Denham's with x <= 0.2 m and another speed: J = v^2 times that of l/v."""
    problem = replace(bryson_denham(0.2, as_bound=True), scales=Scales(length=length, time=1.0, mass=1.0))
    atlas = open_atlas(build(problem, {"speed": (0.7, 1.3)}, tmp_path / "map"), lambda _: problem)
    points = np.random.default_rng(0).uniform(0.7, 1.3, (300, 1))
    found = atlas.query_many(points)
    assert found.good.all()
    truth = [v * v * bryson_denham_truth(0.2 / v) for v in points[:, 0].tolist()]
    np.testing.assert_allclose(found.objective, truth, rtol=1e-10)


@pytest.mark.parametrize(("low", "high"), [(21.0, 75.0), (61.0, 63.0)])
def test_arcs_that_would_switch_by_rounding_say_at_which_bound_they_are(
    low: float, high: float, tmp_path: Path
) -> None:
    """Below 64 m/s a solve rides, and between 60 and 64 it does not say which bounds its other arcs are at."""
    problem = speed_limit(40.0)
    atlas = open_atlas(build(problem, {"limit": (low, high)}, tmp_path / "map"), lambda _: problem)
    points = np.random.default_rng(0).uniform(low, high, (100, 1))
    found, rides = atlas.query_many(points), points[:, 0] < 64.0
    assert found.good.all() and not atlas.survey["notes"]
    truth = [-speed_limit_truth(limit)[2] for limit in points[rides, 0].tolist()]
    np.testing.assert_allclose(found.objective[rides], truth, rtol=1e-10)


def test_a_brick_in_which_no_extremal_is_of_its_sheet_is_empty() -> None:
    """As where the sign of det dh/dy is rounding: here it is asked to be 0. So it is once more, from that."""
    sheet, one = Sheet(holds={}, orientation=0.0, nature=Nature.LOCAL_OPTIMUM), np.zeros(1, dtype=np.int64)
    y = np.zeros((1, len(Chart(bryson_denham(0.4), ["ceiling"], np.array([0.1])).places)))
    task = Task(
        problem=bryson_denham(0.4), names=("ceiling",), widths=np.array([0.1]), course=PLAIN, times=(1,),
        sheets=(sheet,), low=np.array([0.4]), high=np.array([0.5]), sheet=one, place=one[:, None], y=y, tolerance=1e-9,
    )  # fmt: skip
    nodes, cells = compute_brick(task)
    assert len(nodes) == len(cells) == 0
    assert not any(map(len, compute_brick(replace(task, before=(nodes, cells)))))


def test_between_an_answer_and_none_is_looked_as_well(tmp_path: Path) -> None:
    """The brachistochrone from one that begins on its line, where a solve finds none, to those that do not ride."""
    problem = brachistochrone()
    atlas = open_atlas(build(problem, {"offset": (0.0, 0.6)}, tmp_path / "map"), lambda _: problem)
    points = np.random.default_rng(0).uniform(0.02, 0.28, (100, 1))
    found = atlas.query_many(points)
    assert found.good.all()
    truth = [brachistochrone_truth(offset)[2] for offset in points[:, 0].tolist()]
    np.testing.assert_allclose(found.objective, truth, rtol=1e-10)


def test_an_end_that_lies_on_the_bound_by_its_values_alone_is_kept_where_it_varies(tmp_path: Path) -> None:
    """The string to x1, which is l in the problem as it is passed: elsewhere it leaves l to come down to x1."""
    problem = string(1.2, 0.8, 1.0, 0.9).problem.with_given(x1=1.0)
    atlas = open_atlas(build(problem, {"x1": (0.5, 1.0)}, tmp_path / "map"), lambda _: problem)
    points = np.random.default_rng(0).uniform(0.5, 0.99, (100, 1))
    found = atlas.query_many(points)
    assert found.good.all()
    truth = [_string_truth(1.2, problem.given["T"].value, math.cos(0.8), end) for end in points[:, 0].tolist()]
    np.testing.assert_allclose(found.objective, truth, rtol=1e-9)


def test_rides_go_on_over_a_joint_of_the_users_or_lie_on_one_side(tmp_path: Path) -> None:
    """The string in two phases, from none that rides to a ride of both: as if there were one."""
    problem = string_in_two_phases(1.2, 0.8, 1.0, 0.9, 0.4).problem
    atlas = open_atlas(build(problem, {"T1": (0.05, 1.2)}, tmp_path / "map"), lambda _: problem)
    points = np.random.default_rng(0).uniform(0.05, 1.2, (200, 1))
    found, second = atlas.query_many(points), problem.given["T2"].value
    assert found.good.mean() > 0.98  # between two of the three one may be refused
    truth = [_string_truth(1.2, first + second, math.cos(0.8), math.cos(0.9)) for first in points[:, 0].tolist()]
    np.testing.assert_allclose(found.objective[found.good], np.array(truth)[found.good], rtol=1e-9)
    assert len({label for label, n in enumerate(np.bincount(found.sheet[found.good])) if n}) == 3


def test_what_is_ridden_at_once_is_one_chart_in_whichever_order_it_was_found(tmp_path: Path) -> None:
    """Two strings that do not know of each other: one of k = 1.2, one of h, which leaves the bound before the other."""
    string = (1.2, 0.8, 1.0, 0.9)
    problem = two_strings(string, string).problem
    atlas = open_atlas(build(problem, {"h": (1.02, 1.18)}, tmp_path / "map"), lambda _: problem)
    points = np.random.default_rng(0).uniform(1.02, 1.18, (100, 1))
    found, T = atlas.query_many(points), problem.given["T"].value
    assert found.good.all() and len(atlas.charted) == 1
    truth = [sum(_string_truth(k, T, math.cos(0.8), math.cos(0.9)) for k in (1.2, h)) for h in points[:, 0].tolist()]
    np.testing.assert_allclose(found.objective, truth, rtol=1e-10)


def _string_truth(k: float, T: float, start: float, end: float) -> float:
    """J of the string with l = 1 in one phase."""
    rise, fall = math.acos(start), math.acos(end)
    if (left := k * T - rise - fall) >= 0:
        return -k * (math.sin(2 * rise) + math.sin(2 * fall)) / 4 - 0.5 * k * left
    return 0.5 * k * ((start**2 + end**2) * math.cos(k * T) - 2 * start * end) / math.sin(k * T)


def test_singular_arcs_are_mapped(tmp_path: Path) -> None:
    """Down to 0 at full speed, along it, and up: J = (start^3 + end^3)/3."""
    problem = nearest_to_zero()
    atlas = open_atlas(build(problem, {"start": (0.8, 1.2)}, tmp_path / "map"), lambda _: problem)
    points = np.random.default_rng(0).uniform(0.8, 1.2, (100, 1))
    found = atlas.query_many(points)
    assert found.good.all()
    np.testing.assert_allclose(found.objective, (points[:, 0] ** 3 + 0.125) / 3, rtol=1e-10)
    assert pl.verify(atlas.query(start=1.1), 3).outcome is pl.Outcome.PROVED  # a guess of arcs for its neighbours


def test_bounds_that_singular_controls_break_cast_no_doubt_on_flights_at_bounds(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """From 1.84 s on the singular arc of the swing asks for more than there is, and from 2 s on there is none."""
    monkeypatch.setattr(RegionSolver, "_between", lambda *_: [])
    problem = swinging(2.0)
    atlas = open_atlas(build(problem, {"T": (1.75, 2.25)}, tmp_path / "map", bricks=2), lambda _: problem)
    points = np.linspace(2.01, 2.24, 50)[:, None]
    found = atlas.query_many(points)
    assert found.good.all() and len(atlas.charted) == 2
    truth = [swinging_at_bounds(duration) for duration in points[:, 0].tolist()]
    np.testing.assert_allclose(found.objective, truth, rtol=1e-9)
    assert atlas.query(T=2.1).objective == pytest.approx(swinging_at_bounds(2.1), rel=1e-9)
    with pytest.raises(
        PeriluneError,
        match=r"u singular, .*violates a condition, and an unknown flight that keeps it"
        " may be",
    ):
        atlas.query(T=1.9)


def test_of_a_ride_and_touches_of_the_same_cost_the_ride_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Below 1/6 parabolas from touch to touch have the J of Bryson and Denham's ride; no proof of level 3 is theirs."""
    problem = bryson_denham(0.2)
    # Which takes them for the ride that they are.
    monkeypatch.setattr(revise_arcs, "_join_contacts", lambda *known: known[-1])
    atlas = open_atlas(build(problem, {"ceiling": (0.09, 0.15)}, tmp_path / "map", bricks=2), lambda _: problem)
    points = np.random.default_rng(0).uniform(0.09, 0.15, (100, 1))
    found, labels = atlas.query_many(points), [label for charted in atlas.charted for label in charted.labels]
    assert any(label.count("touches") == 2 for label in labels)
    assert all("along" in labels[number] for number in found.sheet)
    assert pl.verify(atlas.query(ceiling=0.11), 3).outcome is pl.Outcome.PROVED


def test_a_singular_control_that_is_the_worst_is_told() -> None:
    """Farthest from zero in its place: the same arcs are an extremal, and Kelley's condition has the other sign."""
    for way in (1.0, -1.0):
        problem = nearest_to_zero(way=way)
        search = Search(Indirect(), nearest_to_zero(), ignore_events)
        course, extremals = arc_sequence_of(Indirect().answer(search), search.answering.keep)
        chart = Chart(problem, ["start"], np.array([0.1]), course)
        y = chart.from_problem_unknowns(np.array(extremals[0].unknowns))[None]
        flown = ChartReintegration(chart)(
            chart.whole(np.array([[1.0]]) / chart.scale, y), chart.p[None], _nothing(chart)
        )
        assert bool(flown.margins.least_multiplier[0] > 0) is (way > 0)


def _nothing(chart: Chart) -> Matrix:
    return np.zeros((1, 2 * chart.shooting.plan.held))


def test_wells_of_a_parameter_are_looked_for_with_the_arcs_of_an_answer_too(tmp_path: Path) -> None:
    """Along q, whose price changes nothing of the flight; with arcs the first well that was met alone was known."""

    def price(q: Any) -> Any:
        return 8.0 * (q - 0.2) ** 2 * (q - 0.97) ** 2 - 0.3 * q

    plain = bryson_denham(0.2)
    unit = plain.objective_unit
    problem = replace(
        plain,
        free=(*plain.free, pl.FreeParameter(name="q", unit="1", lower=0.0, upper=1.0, guess=0.5)),
        given={**plain.given, "one": pl.Parameter(value=1.0, unit=unit)},
        objective=lambda x, p, xp: plain.objective(x, p, xp) + p.one * price(p.q),
    )
    least = float(price(np.linspace(0.0, 1.0, 10_001)).min())
    for ceiling in (0.15, 0.2, 0.3):  # ridden, touched, free
        solved = pl.solve(problem.with_given(ceiling=ceiling), verify=3)
        assert solved.outcome is pl.Outcome.PROVED and len(solved.extremals) >= 3
        assert solved.objective == pytest.approx(bryson_denham_truth(ceiling) + least, abs=1e-7)
    store = build(problem, {"ceiling": (0.1, 0.45)}, tmp_path / "wells")
    ceilings = np.random.default_rng(1).uniform(0.1, 0.45, 100)
    found = open_atlas(store, lambda _: problem).query_many(ceilings[:, None])
    assert found.good.all()
    assert found.objective == pytest.approx([bryson_denham_truth(c) + least for c in ceilings.tolist()], abs=1e-7)


@pytest.mark.parametrize(("flown", "tried"), [(5.0, [4.9, 5.1]), (0.04, [0.0, 0.14]), (0.0, [0.0, 0.1])])
def test_a_control_without_an_end_is_tried_close_by_and_within_its_bound(flown: float, tried: list[float]) -> None:
    """By a tenth, canonical, to either side."""
    (phase,) = bryson_denham(1 / 9).phases
    phase = replace(phase, controls=(pl.ScalarControl(name="u", lower=0.0),))
    found = _admissible_controls(phase, ca.SX(flown), ca.SX([0.0, float("inf")]))
    assert [float(one) for one in found] == pytest.approx(tried, abs=1e-15)
