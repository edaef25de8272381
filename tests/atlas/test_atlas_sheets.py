"""Sheets of an atlas that fold and lie over one another: Thom's cusp, whose extremals are the roots of a cubic."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from cho import cho_landing
from perilune import Indirect
from perilune.atlas.building import build as building
from perilune.atlas.building.tasks import Task, compute_brick
from perilune.atlas.query.batch_answers import Answered
from perilune.atlas.query.query import open_atlas
from perilune.atlas.region import region_of
from perilune.atlas.store.cell_coverage import cells_reproduce
from perilune.atlas.store.cells import WHOLE, Cells, Nodes, Status
from perilune.atlas.survey.folds import around_folds
from perilune.atlas.survey.initial_solves import RegionSolver
from perilune.atlas.survey.survey import Survey
from perilune.atlas.survey.surveyed_chart import SurveyedChart
from perilune.charts.arc_sequence import ArcSequence
from perilune.charts.borders import Borders
from perilune.charts.chart import Chart
from perilune.charts.sheet import Sheet
from perilune.core import ignore_events
from perilune.problem import Nature
from perilune.solve import solve
from problems.folded import cusp, cusp_cost, cusp_ends, two_cusps, two_cusps_cost

build = partial(building.build, sample=0)  # proofs have tests of their own


@pytest.mark.parametrize(
    ("axes", "bricks"),
    [
        ({"a": (-2.0, 1.0), "b": (-0.9, 1.1)}, None),  # around the cusp a sheet comes back on another layer
        ({"a": (-1.0, 0.6), "b": (-0.2, 0.3)}, 1),
        ({"a": (-2.0, -0.5), "b": (-1.5, -0.3)}, None),  # across the fold alone
    ],
)
def test_where_sheets_lie_over_one_another_the_answer_is_the_least_of_all(
    axes: dict[str, tuple[float, float]], bricks: int | None, tmp_path: Path
) -> None:
    """Thom's cusp, whose extremals are the roots of a cubic: two minima, and a fold where one of them ends."""
    atlas = open_atlas(build(cusp(-1.0, 0.1), axes, tmp_path / "cusp", bricks=bricks))
    points = np.random.default_rng(1).uniform(atlas.region.low, atlas.region.high, (1000, 2))
    found = atlas.query_many(points)
    truth = np.array([cusp_cost(*point) for point in points.tolist()])
    assert found.good.mean() > (0.9 if bricks == 1 else 0.97)
    assert set(found.answered[~found.good].tolist()) <= {Answered.ENDS}
    np.testing.assert_allclose(found.objective[found.good], truth[found.good], rtol=0, atol=1e-11)
    alone = atlas.query(**dict(zip("ab", points[found.good][0].tolist(), strict=True)))
    assert alone.objective == pytest.approx(truth[found.good][0], abs=1e-11)


def test_where_layers_meet_none_of_them_ends(tmp_path: Path) -> None:
    """Two cusps at once: between layers corners that either leads to are found from its own side."""
    axes = {"a": (-1.0, 1.0), "b": (-0.6, 0.5)}
    atlas = open_atlas(build(two_cusps(0.0, 0.0), axes, tmp_path / "cusps", bricks=2))
    points = np.random.default_rng(0).uniform(atlas.region.low, atlas.region.high, (400, 2))
    found = atlas.query_many(points)
    truth = np.array([two_cusps_cost(*point) for point in points.tolist()])
    assert found.good.mean() > 0.9
    np.testing.assert_allclose(found.objective[found.good], truth[found.good], rtol=0, atol=1e-11)


def test_a_layer_is_one_branch(tmp_path: Path) -> None:
    """What a branch leads to where it has nothing is its own: 34 branches with the same nodes would be too many."""
    axes = {"vehicle.thrust": (700.0, 900.0), "retro.specific_impulse": (303.0, 313.0)}
    axes |= {"orbit.perilune_altitude": (25e3, 35e3)}
    atlas = open_atlas(build(cho_landing(), axes, tmp_path / "layers", bricks=1, tolerance=1e-4))
    brick = atlas.brick(0, (0, 0, 0))
    assert brick is not None and len(brick.minima) <= 10
    points = np.random.default_rng(0).uniform(atlas.region.low, atlas.region.high, (500, 3))
    found = atlas.query_many(points)
    assert found.good.mean() > 0.97
    for number in np.nonzero(found.good)[0][:8].tolist():
        at = dict(zip(atlas.region.names, points[number].tolist(), strict=True))
        alone = solve(cho_landing().with_given(**at), verify=0)
        assert found.objective[number] == pytest.approx(alone.objective, rel=1e-10)


def test_a_round_in_which_nothing_is_new_is_the_last(tmp_path: Path) -> None:
    """Neighbours may offer extremals that lead nowhere in a brick, again and again."""
    store = build(cusp(-1.0, 0.1), {"a": (-1.5, 0.6), "b": (0.0, 0.7)}, tmp_path / "cusp", bricks=2)
    lines = [json.loads(line) for line in (store / "manifest.jsonl").read_text().splitlines()]
    rounds = [[line for line in lines if line["kind"] == "brick" and line.get("round", 0) == n] for n in range(5)]
    known, news = dict[tuple[int, ...], list[str]](), list[bool]()
    for number in rounds:
        now = {tuple(line["brick"]): [line[kind]["sha256"] for kind in ("nodes", "cells")] for line in number}
        news.append(any(known.get(brick) != shards for brick, shards in now.items()))
        known |= now
    assert news[0] and not news[-1]
    assert len([number for number in rounds if number]) == sum(news) + 1


def test_a_sheet_is_followed_around_its_fold() -> None:
    """The minimum with x > 0 ends where b rises; behind the fold it is the maximum, and at the start, -x is known."""
    chart = Chart(cusp(-1.5, -0.5), ["a", "b"], np.array([3.0, 2.0]))
    start = np.array([[-1.5, -0.5]]) / chart.scale
    y = np.array([[-cusp_ends(-1.5, -0.5)[-1], 1.0]])
    sheet = Sheet(holds={}, orientation=1.0, nature=Nature.BEST)
    for target in ([-1.5, 1.0], [-0.2, 0.9]):
        found = list(around_folds(chart, Borders(chart), sheet, start, y, np.array([target]) / chart.scale))
        assert len(found) == 1
        values, unknowns, side = found[0]
        ends = cusp_ends(*(values * chart.scale).tolist())
        assert side == -1.0 and len(ends) == 3
        assert -unknowns[0] == pytest.approx(ends[1], abs=1e-8)
    nothing = around_folds(chart, Borders(chart), sheet, start, y, np.array([[-1.8, -0.6]]) / chart.scale)
    assert not list(nothing)


def test_what_no_solve_has_found_is_met_behind_folds(monkeypatch: pytest.MonkeyPatch) -> None:
    """One extremal at the middle of the region leads to the maximum behind its fold, and that to the other minimum."""
    solved = RegionSolver._solved
    middle = np.array([-1.25, 0.1])

    def one_of(solving: RegionSolver, values: np.ndarray) -> object:
        found = solved(solving, middle) if np.allclose(values, middle) else None
        return None if found is None else type(found)(found.values, found.course, found.extremals[:1])

    monkeypatch.setattr(RegionSolver, "_solved", one_of)
    problem = cusp(-1.0, 0.1)
    region = region_of(problem, {"a": (-2.0, -0.5), "b": (-1.5, 1.7)})
    (found,) = Survey(problem=problem, region=region, method=Indirect(), watch=ignore_events).run()
    assert [(sheet.nature, sheet.orientation) for sheet in found.sheets] == [
        (Nature.BEST, 1.0),
        (Nature.WORST, -1.0),
        (Nature.LOCAL_OPTIMUM, 1.0),
    ]


def test_a_sheet_that_enters_through_a_side_alone_begins_at_its_nodes_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """No corner of the brick is known, and what has no node says nothing: its place in memory holds anything."""
    rows = Nodes.rows

    def known(nodes: Nodes, name: str, numbers: np.ndarray) -> np.ndarray:
        assert name != "terms" or (numbers >= 0).all()
        return rows(nodes, name, numbers)

    monkeypatch.setattr(Nodes, "rows", known)
    problem = cusp(-1.5, -0.5)
    low, high = np.array([-1.5, -0.5]), np.array([-1.0, 0.0])
    task = Task(
        problem=problem,
        names=("a", "b"),
        widths=high - low,
        course=ArcSequence(()),
        times=(2,),
        sheets=(Sheet(holds={}, orientation=1.0, nature=Nature.BEST),),
        low=low,
        high=high,
        sheet=np.zeros(1, dtype=np.int64),
        place=np.array([[0, WHOLE // 2]]),
        y=np.array([[-cusp_ends(-1.5, -0.25)[-1], 1.0]]),
        tolerance=1e-9,
    )
    nodes, cells = compute_brick(task)
    ends = np.array([cusp_ends(*values)[-1] for values in nodes["values"].tolist()])
    np.testing.assert_allclose(nodes["terms"][:, 0, 0], -ends, rtol=0, atol=1e-8)
    assert (cells["status"] == Status.ONE_STEP).any()


@pytest.mark.parametrize("size", [0.0, 1e3])
def test_a_cell_gives_an_extremal_by_its_size(size: float) -> None:
    """A line from corner to corner, off which an unknown of a thousand may be by one."""
    line, there = size + np.array([0.0, 1.0]), size + 0.25
    terms = np.array([[[value, 0.0], [1.0, 0.0]] for value in line])  # value and slope; of the unknown, and of J
    nodes, one = Nodes(), np.zeros(1, dtype=np.int64)
    unread = {name: np.zeros(2) for name in ("margin", "sequence", "path", "branch", "place")}
    nodes.add(np.arange(2), terms=terms, **unread)
    cells = Cells(branch=one, low=one[:, None], size=one[:, None] + 4, corners=np.array([[0, 1]]),
                  axis=one - 1, child=one, status=one)  # fmt: skip
    place, near = np.array([[1]]), 1e-3 * (1.0 + there)
    for off, has in ((0.9 * near, True), (-0.9 * near, True), (1.2 * near, False)):
        assert cells_reproduce(cells, nodes, np.array([0.25]), place, np.array([[there + off]])).tolist() == [has]


@pytest.fixture
def beside() -> tuple[Survey, SurveyedChart]:
    """A survey in units of 2 and 3 that knows no sheets, where Newton's method stays where it is."""
    problem = cusp(-1.0, 0.1)
    known = SurveyedChart(
        chart=cast("Chart", SimpleNamespace(
            scale=np.array([2.0, 3.0]), course=SimpleNamespace(text=""),
            solve=lambda values, y, holds, limit: SimpleNamespace(converged=[True]),
        )),
        borders=cast("Borders", SimpleNamespace(holds=lambda *of: None)),
        sheets=(), y=np.empty((0, 4, 1)), widths=np.ones(2),
    )  # fmt: skip
    region = region_of(problem, {"a": (-2.0, -0.5), "b": (1.5, 2.5)})
    return Survey(problem=problem, region=region, method=Indirect(), watch=ignore_events), known


SMALL = Sheet(holds={}, orientation=1.0, nature=Nature.BEST)
INSIDE = np.array([-1.234, 1.789])


def test_a_sheet_that_reaches_no_corner_begins_beside_where_it_was_met(
    beside: tuple[Survey, SurveyedChart], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the lattice of its brick, wherever that lies: within half a step."""
    survey, known = beside
    monkeypatch.setattr("perilune.atlas.survey.survey.continue_sheet_to", lambda *of: np.array([[7.0]]))
    (one,) = survey._with_small(known, SMALL, INSIDE / known.chart.scale, np.array([7.0])).small
    low, high = survey.region.box(one.brick)
    assert (np.abs(one.values * known.chart.scale - INSIDE) <= 0.5001 * (high - low) / WHOLE).all()
    np.testing.assert_allclose(low + one.place * (high - low) / WHOLE, one.values * known.chart.scale, rtol=1e-14)


def test_what_switches_by_rounding_is_said_with_its_place(
    beside: tuple[Survey, SurveyedChart], monkeypatch: pytest.MonkeyPatch
) -> None:
    survey, known = beside
    monkeypatch.setattr("perilune.atlas.survey.survey._sided_by_rounding", lambda chart, start: True)
    corners: Any = np.zeros((4, 2))
    assert survey._with_these(known, corners, [(INSIDE / known.chart.scale, np.array([7.0]), SMALL)]) is known
    (note,) = survey.notes
    assert note.startswith("at a -1.234, b 1.789: ") and note.endswith("switches by rounding errors, and is not mapped")
