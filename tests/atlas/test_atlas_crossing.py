"""Sheets that come and go inside a brick: at a bound that another crosses there, held or let go, or between folds."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import perilune as pl
from perilune import PeriluneError
from perilune.atlas import extend
from perilune.atlas.building import build as building
from perilune.atlas.grid import nodes as trying
from perilune.atlas.query import reader as read
from perilune.atlas.query.batch_answers import Answered, Answers
from perilune.atlas.query.minimum_search import KnownExtremals, MinimumSearch
from perilune.atlas.query.query import Atlas, open_atlas
from perilune.atlas.store.cells import WHOLE
from perilune.atlas.survey import survey
from perilune.core import Matrix, Vector
from perilune.problem import Parameter, Variable

build = partial(building.build, sample=0)  # proofs have tests of their own

WHERE, WIDE = 0.31, 0.02  # of the window
OUT, IN = (0.97, 0.05), (1.05, -0.12)  # the better well beside it, and how far it moves there


def priced(price: Callable[[Any, Any], Any], *more: pl.FreeParameter) -> pl.Problem:
    """x(1) = q with the least int u^2/2, which is taken off again, and a price of q."""
    phase = pl.Phase(
        name="way",
        states=(Variable(name="x", unit="1"), Variable(name="c", unit="1/s")),
        controls=(pl.ScalarControl(name="u", unit="1/s"),),
        dynamics=lambda x, u, p, xp: (u.u, 0.5 * u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.q,), there="1"),
    )

    values = {"T": (1.0, "s"), "a": (0.5, "1"), "b": (0.5, "1"), "one": (1.0, "s")}
    return pl.Problem(
        name="wells",
        phases=(phase,),
        start=lambda p, xp: (0.0 * p.a, 0.0 * p.a / p.one),
        given={name: Parameter(value=value, unit=unit) for name, (value, unit) in values.items()},
        free=(pl.FreeParameter(name="q", unit="1", lower=0.0, upper=1.0, guess=0.5), *more),
        objective=lambda x, p, xp: p.one * x.c - 0.5 * p.q * p.q + price(p, xp),
        objective_unit="1",
    )


def wells(well: tuple[float, float], b: bool = False) -> pl.Problem:
    """Two wells, the better one at a bound or beside it."""

    def price(p: Any, xp: Any) -> Any:
        s = well[0] + well[1] * xp.exp(-(((p.a - WHERE) / WIDE) ** 2) - (((p.b - 0.64) / 0.05) ** 2 if b else 0.0))
        return 8.0 * (p.q - 0.2) ** 2 * (p.q - s) ** 2 - 0.3 * p.q

    return priced(price)


def truth(well: tuple[float, float], a: float, b: float | None = None) -> float:
    """J, over q on a grid: exact at a bound, and in a well to the square of a step."""
    away = ((a - WHERE) / WIDE) ** 2 + (0.0 if b is None else ((b - 0.64) / 0.05) ** 2)
    s, q = well[0] + well[1] * np.exp(-away), np.linspace(0.0, 1.0, 20_001)
    return float((8.0 * (q - 0.2) ** 2 * (q - s) ** 2 - 0.3 * q).min())


def windows(count: int, d: int) -> Vector:
    """Points of which a third lie in the window."""
    rng = np.random.default_rng(5)
    near = np.array([WHERE, 0.64])[:d] + 2.0 * WIDE * rng.uniform(-1.0, 1.0, (count // 3, d))
    return np.vstack([near, rng.uniform(0.0, 1.0, (count - len(near), d))])


@pytest.mark.parametrize("well", [OUT, IN], ids=["out over its bound", "in from its bound"])
def test_what_goes_on_behind_a_bound_is_found_inside_bricks(tmp_path: Path, well: tuple[float, float]) -> None:
    """The worse well was the answer there, or the one that the bound cuts off was."""
    problem, points = wells(well), windows(150, 1)
    atlas = open_atlas(build(problem, {"a": (0.0, 1.0)}, tmp_path / "atlas"), lambda _: problem)
    found = atlas.query_many(points)
    assert found.good.all() and len(set(found.sheet.tolist())) == 2
    assert found.objective == pytest.approx([truth(well, a) for a in points[:, 0].tolist()], abs=1e-7)


def test_where_what_a_bound_cuts_off_would_gain_by_leaving_it_nothing_worse_is_the_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cells of the sheet that is held are larger than the window: what is free in it is not met."""
    monkeypatch.setattr(trying, "_LONG", WHOLE)  # at quarters of its cells it would be
    problem, points = wells(IN, b=True), windows(300, 2)
    atlas = open_atlas(build(problem, {"a": (0.0, 1.0), "b": (0.0, 1.0)}, tmp_path / "atlas"), lambda _: problem)
    found, least = atlas.query_many(points), [truth(IN, *point) for point in points.tolist()]
    assert found.objective == pytest.approx(np.array(least), abs=1e-7)
    monkeypatch.setattr(
        MinimumSearch, "become", lambda self, at, *_: KnownExtremals.none(atlas.charted, len(at))
    )  # or it is found
    found = atlas.query_many(points)
    assert found.objective[found.good] == pytest.approx(np.array(least)[found.good], abs=1e-7)
    assert (found.good | (found.answered == Answered.ENDS)).all() and 0.8 < found.good.mean() < 1.0
    a, b = points[np.argmin(found.good)].tolist()
    with pytest.raises(PeriluneError, match="has a multiplier of the wrong sign") as told:
        atlas.query(a=a, b=b)
    near = re.findall(r"[ab] ([\d.]+)", told.value.expected)
    assert atlas.query(a=float(near[0]), b=float(near[1]))  # what is named has an answer


def test_a_sheet_that_reaches_no_corner_of_a_brick_is_mapped_from_where_it_was_met(tmp_path: Path) -> None:
    """A well that is there around the middle alone, between folds, and is the better one in a part of that."""

    def dent(q: Any, a: Any, b: Any, exp: Callable[[Any], Any]) -> Any:
        away = ((a - 0.5) / 0.1) ** 2 + ((b - 0.5) / 0.15) ** 2 + ((q - 0.8) / 0.1) ** 2
        return 2.0 * (q - 0.2) ** 2 - 1.2 * exp(-away)

    problem = priced(lambda p, xp: dent(p.q, p.a, p.b, xp.exp))
    store = build(problem, {"a": (0.0, 1.0), "b": (0.0, 1.0)}, tmp_path / "atlas", bricks=1)
    atlas, rng = open_atlas(store, lambda _: problem), np.random.default_rng(3)
    points = np.vstack([0.5 + 0.15 * rng.uniform(-1.0, 1.0, (200, 2)), rng.uniform(0.0, 1.0, (100, 2))])
    found, q = atlas.query_many(points), np.linspace(0.0, 1.0, 20_001)
    least = np.array([dent(q, a, b, np.exp).min() for a, b in points.tolist()])
    assert found.objective[found.good] == pytest.approx(least[found.good], abs=1e-7)
    assert found.good.mean() > 0.9 and (found.free["q"][found.good] > 0.7).sum() > 50


def least_over_q(price: Callable[[Any, Any], Any], points: Matrix) -> Vector:
    """J, over q on a grid: `price` takes what has a, b and q, and exp."""
    q, few = np.linspace(0.0, 1.0, 20_001), SimpleNamespace(exp=np.exp)
    rows = np.column_stack([points, np.zeros(len(points))])
    return np.array([price(SimpleNamespace(q=q, a=row[0], b=row[1]), few).min() for row in rows])


@pytest.mark.parametrize("deep", [-0.08, -0.12])
def test_a_sheet_that_bends_does_not_end(tmp_path: Path, deep: float) -> None:
    """Slopes foretell neither the next corner of a cell, nor that a long step ends in the other well."""

    def price(p: Any, xp: Any) -> Any:
        s = 0.92 + deep * xp.exp(-(((p.a - 0.46) / 0.03) ** 2)) + 0.02 * p.a
        return 8.0 * (p.q - 0.2) ** 2 * (p.q - s) ** 2 - 0.3 * p.q

    problem, points = priced(price), np.random.default_rng(5).uniform(0.0, 1.0, (200, 1))
    atlas = open_atlas(build(problem, {"a": (0.0, 1.0)}, tmp_path / "atlas", bricks=1), lambda _: problem)
    found = atlas.query_many(points)
    assert found.good.mean() > 0.95
    assert found.objective[found.good] == pytest.approx(least_over_q(price, points)[found.good], abs=1e-7)


def test_cells_are_cut_where_J_alone_bends(tmp_path: Path) -> None:
    """Along b, by which no unknown of what is held changes; they were cut along a, and the worse well answered."""

    def price(p: Any, xp: Any) -> Any:
        gain = 0.3 * p.q * (1.0 - xp.exp(-(((p.b - 0.5) / 0.2) ** 2)))
        return 8.0 * (p.q - 0.2) ** 2 * (p.q - 1.1) ** 2 - gain + 0.0 * p.a

    problem, points = priced(price), np.random.default_rng(5).uniform(0.0, 1.0, (200, 2))
    store = build(problem, {"a": (0.0, 1.0), "b": (0.0, 1.0)}, tmp_path / "atlas", bricks=2)
    found = open_atlas(store, lambda _: problem).query_many(points)
    assert found.good.all() and found.objective == pytest.approx(least_over_q(price, points), abs=1e-7)


def test_a_layer_that_enters_a_brick_through_a_part_of_its_side_is_mapped(tmp_path: Path) -> None:
    """A well leaves another with a; its layer comes to the middle of a side, and one cell has the other's all over."""

    def price(p: Any, xp: Any) -> Any:
        away = ((p.b - 0.62) / 0.07) ** 2 + ((p.a - 0.1) / 0.4) ** 2 + ((p.q - 0.2 - 1.4 * p.a) / 0.1) ** 2
        return 2.0 * (p.q - 0.2) ** 2 - xp.exp(-away)

    problem, rng = priced(price), np.random.default_rng(5)
    store = build(problem, {"a": (0.0, 1.0), "b": (0.0, 1.0)}, tmp_path / "atlas")
    points = rng.uniform([0.2, 0.5], [0.4, 0.75], (150, 2))
    found = open_atlas(store, lambda _: problem).query_many(points)
    assert found.good.mean() > 0.95 and (found.free["q"] > 0.4).sum() > 20
    assert found.objective[found.good] == pytest.approx(least_over_q(price, points)[found.good], abs=1e-7)


def test_of_what_enters_a_brick_the_layer_that_its_first_cell_passes_over_is_mapped(tmp_path: Path) -> None:
    """A well was met on a side of two bricks alone; the other layer is at all corners of the second."""

    def price(p: Any, xp: Any) -> Any:
        away = ((p.a - 0.5) / 0.1) ** 2 + ((p.b - 0.5) / 0.15) ** 2 + ((p.q - 0.8) / 0.1) ** 2
        return 2.0 * (p.q - 0.2) ** 2 - 1.2 * xp.exp(-away)

    problem, of = priced(price), {"problem_from_scenario": lambda _: problem, "sample": 0}
    store = build(problem, {"a": (0.0, 0.5), "b": (0.0, 1.0)}, tmp_path / "atlas", bricks=1)
    extend(store, {"a": (0.0, 1.0)}, **of)
    points = np.random.default_rng(5).uniform([0.4, 0.4], [0.6, 0.6], (150, 2))
    found = open_atlas(store, lambda _: problem).query_many(points)
    assert found.good.mean() > 0.95 and (found.free["q"] > 0.7).sum() > 60
    assert found.objective[found.good] == pytest.approx(least_over_q(price, points)[found.good], abs=1e-7)


@pytest.mark.parametrize(
    ("width", "late", "tied"),
    [(0.4, 0.04, 0.6), (0.4, 0.04, -0.9), (0.4, 0.0, 0.0)],
    ids=["one after the other", "a way to each", "both at one place"],
)
def test_two_bounds_are_crossed_inside_a_brick(tmp_path: Path, width: float, late: float, tied: float) -> None:
    """What holds both was not foretold, nor found where it begins and what holds one of them is no answer anywhere."""

    def price(p: Any, xp: Any) -> Any:
        q = p.q - 0.8 - width * xp.exp(-(((p.a - 0.4) / 0.05) ** 2))
        r = p.r - 0.8 - width * xp.exp(-(((p.a - 0.4 - late) / 0.05) ** 2))
        return q * q + r * r + 2.0 * tied * q * r

    def least(a: float) -> float:
        far = minimize(lambda x: price(SimpleNamespace(q=x[0], r=x[1], a=a), few), (0.9, 0.9), bounds=[(0.0, 1.0)] * 2)
        return float(far.fun)

    problem, few = (
        priced(price, pl.FreeParameter(name="r", unit="1", lower=0.0, upper=1.0, guess=0.5)),
        SimpleNamespace(exp=np.exp),
    )
    points = np.append(np.random.default_rng(5).uniform(0.25, 0.6, 99), 0.42)[:, None]
    found = open_atlas(build(problem, {"a": (0.0, 1.0)}, tmp_path / "atlas"), lambda _: problem).query_many(points)
    assert found.good.all() and (found.free["q"] + found.free["r"] == 2.0).any()
    assert found.objective == pytest.approx([least(a) for a in points[:, 0].tolist()], abs=1e-7)


def test_where_two_branches_change_places_in_one_cell_none_of_their_layers_is_passed_over(tmp_path: Path) -> None:
    """A window turns the wells by half a turn on the way to one side; of both branches a cell is torn, at one place."""

    def price(p: Any, xp: Any) -> Any:
        turned = 8.05 * p.q + 5.61 - 2.0 * xp.exp(-(((p.a - 0.947) / 0.064) ** 2))
        return xp.sin(turned) * (1.0 + 0.48 * xp.exp(-(((p.a - 0.81) / 0.076) ** 2)))

    problem, points = priced(price), np.linspace(0.0, 1.0, 400)[:, None]
    store = build(problem, {"a": (0.0, 1.0)}, tmp_path / "atlas", bricks=1)
    found = open_atlas(store, lambda _: problem).query_many(points)
    assert found.good.mean() > 0.95 and (found.good | (found.answered == Answered.ENDS)).all()
    few = SimpleNamespace(exp=np.exp, sin=np.sin)
    least = [price(SimpleNamespace(q=np.linspace(0.0, 1.0, 20_001), a=a), few).min() for a in points[:, 0].tolist()]
    assert found.objective[found.good] == pytest.approx(np.array(least)[found.good], abs=1e-7)


def test_a_bound_that_goes_and_comes_back_inside_a_cell_is_where_it_is_at_the_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """J has a maximum between both bounds; the upper one is the better where it is far away, which no corner knows."""

    def upper(p: Any, xp: Any) -> Any:
        return 0.7 + 0.3 * xp.exp(-(((p.a - 0.3) / 0.04) ** 2))

    base = priced(lambda p, xp: 0.5 * p.q * (0.8 - p.q) + 0.0 * p.a)
    problem = replace(base, parameter_bounds=lambda p, xp: {"q": (0.0, upper(p, xp), 0.5)})
    monkeypatch.setattr(building, "refuse_moving_ranges", lambda *_: None)  # a model's are kept with its records
    monkeypatch.setattr(read, "read_problem", lambda *_: problem)
    atlas = open_atlas(build(problem, {"a": (0.0, 1.0)}, tmp_path / "atlas", bricks=1))
    a = np.linspace(0.2, 0.4, 60)
    found, most = atlas.query_many(a[:, None]), upper(SimpleNamespace(a=a), np)
    assert found.good.all() and 20 < (found.free["q"] > 0.7).sum() < 40
    assert found.objective == pytest.approx(np.minimum(0.0, 0.5 * most * (0.8 - most)), abs=1e-9)
    assert atlas.query(a=0.3).objective == pytest.approx(-0.1, abs=1e-9)


def two_wells(p: Any) -> Any:
    """A price of q, the wells at 0.895 and at a place that moves."""
    first = 0.118 + 0.136 * (p.a - 0.5)
    return 16.6 * (p.q - first) ** 2 * (p.q - 0.895) ** 2 - 0.0565 * p.q


def wanted(p: Any, xp: Any, windows: tuple[tuple[float, float, float], ...]) -> Any:
    """The r that each well wants, moved in windows: by how much, where and how wide."""
    s = 0.6 + 0.24 * (p.a - 0.5) + 0.551 * p.q
    for high, at, wide in windows:
        s = s + high * xp.exp(-(((p.a - at) / wide) ** 2))
    return s


def answered(
    tmp_path: Path, bricks: int, windows: tuple[tuple[float, float, float], ...]
) -> tuple[Atlas, Vector, Answers]:
    """An atlas of both wells, and its answers; each that it gives is looked at."""
    r = pl.FreeParameter(name="r", unit="1", lower=0.0, upper=1.0, guess=0.5)
    problem = priced(lambda p, xp: two_wells(p) + 2.06 * (p.r - wanted(p, xp, windows)) ** 2, r)
    atlas = open_atlas(build(problem, {"a": (0.0, 1.0)}, tmp_path / "atlas", bricks=bricks), lambda _: problem)
    a = np.random.default_rng(5).uniform(0.0, 1.0, 150)
    found, p = atlas.query_many(a[:, None]), SimpleNamespace(a=a[:, None], q=np.linspace(0.0, 1.0, 40_001))
    best = wanted(p, np, windows)
    least = (two_wells(p) + 2.06 * (np.clip(best, 0.0, 1.0) - best) ** 2).min(axis=1)
    assert found.objective[found.good] == pytest.approx(least[found.good], abs=1e-7)
    return atlas, a, found


def test_an_extremal_beyond_a_bound_is_told_from_another_that_is_held_there(tmp_path: Path) -> None:
    """Of two wells the better one needs an r beyond its bound; the worse one is held there, and was the answer."""
    windows = ((0.215, 0.651, 0.488), (-0.346, 0.057, 0.05), (-0.069, 0.857, 0.066), (0.084, 0.866, 0.152))
    atlas, a, found = answered(tmp_path, 2, windows)
    assert found.good.all()
    for k in range(5):
        assert atlas.query(a=float(a[k])).objective == pytest.approx(found.objective[k], abs=1e-9)


def test_a_later_branch_is_followed_over_a_steep_window_as_a_first_one_is(tmp_path: Path) -> None:
    """It ended there in one cell, and behind it, where nothing told of it, the worse well was the answer."""
    found = answered(tmp_path, 1, ((0.215, 0.651, 0.488), (-0.346, 0.057, 0.03)))[2]
    assert found.good.mean() > 0.98 and (found.good | (found.answered == Answered.ENDS)).all()


def test_a_price_that_falls_between_the_corners_and_the_middle_of_a_large_cell_is_seen(tmp_path: Path) -> None:
    """What is held is so in one cell all over; where it was the better, the well inside was the answer."""

    def price(p: Any, xp: Any) -> Any:
        return 8.0 * (p.q - 0.2) ** 2 * (p.q - 1.05) ** 2 - 0.5 * p.q**8 * xp.exp(-(((p.a - 0.26) / 0.03) ** 2))

    problem, a = priced(price), np.linspace(0.2, 0.32, 100)
    atlas = open_atlas(build(problem, {"a": (0.0, 1.0)}, tmp_path / "atlas", bricks=1), lambda _: problem)
    found, p = atlas.query_many(a[:, None]), SimpleNamespace(a=a[:, None], q=np.linspace(0.0, 1.0, 20_001))
    assert found.good.all() and len(set(found.sheet.tolist())) == 2
    assert found.objective == pytest.approx(price(p, np).min(axis=1), abs=1e-7)


def rippled(p: Any, xp: Any) -> Any:
    return 0.1 * xp.sin(107.0 * p.q + 9.0 * p.a) + 0.5 * (p.q - p.a) ** 2


def test_of_many_wells_none_is_left_out(tmp_path: Path) -> None:
    """There are more than thirty sheets, of which those behind the sixteenth were not mapped, and nothing said so."""
    problem = priced(rippled)
    atlas = open_atlas(build(problem, {"a": (0.0, 1.0)}, tmp_path / "atlas"), lambda _: problem)
    a = np.random.default_rng(5).uniform(0.0, 1.0, (100, 1))
    found, p = atlas.query_many(a), SimpleNamespace(a=a, q=np.linspace(0.0, 1.0, 100_001))
    assert found.good.all() and not atlas.survey["notes"]
    assert found.objective == pytest.approx(rippled(p, np).min(axis=1), abs=1e-7)


def test_where_there_are_too_many_sheets_it_is_said_and_those_of_solves_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(survey, "_MOST_SHEETS", 3)
    problem = priced(rippled)
    atlas = open_atlas(build(problem, {"a": (0.0, 1.0)}, tmp_path / "atlas"), lambda _: problem)
    said = "'a flight of one arc' has more than 3 sheets: others, beyond folds and at bounds, are not mapped"
    assert [note.startswith(said) for note in atlas.survey["notes"]] == [True]
    for a in (0.0, 0.5, 1.0):
        solved = pl.solve(problem.with_given(a=a), verify=0)
        assert atlas.query(a=a).objective == pytest.approx(solved.objective, rel=1e-9)
