"""What casts doubt on an answer of an atlas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune import Indirect, Problem
from perilune.atlas.building import build as building
from perilune.atlas.query import batch as many
from perilune.atlas.query.candidates import dominates_known, without_admissible_answer
from perilune.atlas.query.query import open_atlas
from perilune.atlas.region import region_of
from perilune.atlas.store.cells import Status
from perilune.atlas.survey.initial_solves import RegionSolver, Scan
from perilune.core import PeriluneError, ignore_events
from problems.constrained import bryson_denham, bryson_denham_truth

build = partial(building.build, sample=0)  # proofs have tests of their own


class _Chart:
    breaks_controls_alone = False

    def __init__(self, of_arcs: bool) -> None:
        self.of_arcs = of_arcs


def test_each_well_vouches_for_one_extremal_that_breaks_the_path() -> None:
    """Lane by lane: one of each of two charts beside one answer, two of one chart beside one, beside two, and none."""
    one: Any = _Chart(False)
    other: Any = _Chart(True)
    no, yes = np.zeros(4, dtype=bool), np.ones(4, dtype=bool)
    better = [(one, np.array([0, 1, 2, 3]), no), (one, np.array([1, 2]), no[:2]), (other, np.array([0]), no[:1])]
    vouching = [
        (one, yes),
        (other, np.array([True, True, True, False])),
        (other, np.array([False, False, True, False])),
    ]
    told = without_admissible_answer(better, vouching, np.array([True, True, True, False]))
    assert [left.tolist() for left in told] == [[False, True, False, True], [True, False], [True]]


def test_what_has_an_arc_shorter_than_nothing_may_become_an_answer_of_no_arcs() -> None:
    """Beside a plain answer, beside one of its own chart, beside both."""
    plain: Any = _Chart(False)
    rides: Any = _Chart(True)
    vouching = [(plain, np.array([True, False, True])), (rides, np.array([False, True, True]))]
    told = without_admissible_answer([(rides, np.arange(3), np.ones(3, dtype=bool))], vouching, np.zeros(3, dtype=bool))
    assert told[0].tolist() == [False, True, False]


def test_what_is_no_better_or_breaks_bounds_of_singular_controls_outdoes_no_answer() -> None:
    """Beside no answer at all everything outdoes what is known."""
    chart: Any = _Chart(False)
    singular: Any = type("Singular", (), {"breaks_controls_alone": True})()
    best = np.array([2.0, 1.0, np.inf])
    assert dominates_known(chart, np.array([1.0, 1.0, 9.0]), best).tolist() == [True, False, True]
    assert dominates_known(singular, np.array([1.0, 1.0, 9.0]), best).tolist() == [False, False, True]


def test_cells_that_give_no_answer_promise_the_least_j_that_there_may_be() -> None:
    """What breaks the path all over its cell, and what ends in it; not what lies beyond a bound, or is not there."""
    status = np.array([Status.BREAKS, Status.ENDS, Status.NO_ANSWER, Status.ABSENT])
    brick: Any = SimpleNamespace(
        leaves=lambda root, inside: np.arange(4), arrays=[None, None, None, status],
        given=lambda cell, inside: np.array([7.0, 3.0]), least=lambda cells, places: 10.0 + cells,
    )  # fmt: skip
    charted: Any = SimpleNamespace(unknowns=1, borders=SimpleNamespace(of_arcs=False))
    offer, at = many._no_candidate(charted, 0, 0, 4), np.zeros((4, 1))
    many._fill_candidates(offer, brick, 0, np.arange(4), at, at)
    assert offer.cost.tolist() == [10.0, 11.0, np.inf, np.inf]
    assert offer.breaks.tolist() == [True, False, False, False] and not offer.short.any()
    assert offer.broken[0] == 7.0 and np.isnan(offer.broken[1:]).all() and np.isnan(offer.y).all()


def two_wells(
    steep: float, slow: float, fast: float, paid: float, crossed: float, beside: bool = False, **bounds: float
) -> tuple[Problem, Callable[[float], float]]:
    """Bryson and Denham's problem at a speed that is free and has two wells of its price, and the least J.

    With another free parameter `beside` it, between bounds, if that is asked for, which has to do with nothing else.
    """

    def price(v: Any, l: Any) -> Any:
        return steep * (v - slow) ** 2 * (v - fast) ** 2 - paid * v + crossed * l * v

    plain, v = bryson_denham(0.2), np.linspace(0.6, 1.6, 2001)
    given = {name: one for name, one in plain.given.items() if name != "speed"}
    units = {"one": plain.objective_unit, "pace": "m/s", "far": "m"}
    problem = replace(
        plain,
        free=(
            pl.FreeParameter(name="speed", unit="m/s", guess=1.0, **bounds),
            *[pl.FreeParameter(name="other", lower=0.0, upper=1.0, guess=0.5)] * beside,
        ),
        given={**given, **{name: pl.Parameter(value=1.0, unit=unit) for name, unit in units.items()}},
        objective=lambda x, p, xp: (
            plain.objective(x, p, xp)
            + p.one * (price(p.speed / p.pace, p.ceiling / p.far) + ((p.other - 0.4) ** 2 if beside else 0.0))
        ),
    )

    def least(ceiling: float) -> float:
        flown = np.array([bryson_denham_truth(ceiling / speed) for speed in v.tolist()])
        return float((v**2 * flown + price(v, ceiling)).min())

    return problem, least


@pytest.mark.parametrize(
    ("steep", "slow", "fast", "paid", "crossed", "high"),
    [
        (168.8, 0.792, 1.355, 4.715, -13.921, 0.45),
        (105.356, 0.564, 1.215, 8.995, -1.953, 0.45),
        (105.356, 0.564, 1.215, 8.995, -1.953, 0.14),
        (96.749, 0.746, 1.304, 6.045, -7.581, 0.45),
    ],
)
def test_an_answer_of_arcs_does_not_vouch_for_what_breaks_the_path_in_another_well(
    tmp_path: Path, steep: float, slow: float, fast: float, paid: float, crossed: float, high: float
) -> None:
    """Of two wells of the speed one was mapped with its touch alone, where the ride is; any arcs did for an answer.

    In the second case the ride of the better well was found, and lost: followed beyond a bound it led to the other. In
    the third no solve has the touch of the better well, in the fourth that well is at no corner of a brick.
    """
    problem, least = two_wells(steep, slow, fast, paid, crossed, lower=0.6, upper=1.6)
    ceilings = np.linspace(0.1, high, 100)
    store = build(problem, {"ceiling": (0.1, high)}, tmp_path / "wells", bricks=1)
    atlas = open_atlas(store, lambda _: problem)
    found = atlas.query_many(ceilings[:, None])
    alone = [bool(atlas.query_many(np.array([[l]])).good[0]) for l in ceilings[::10].tolist()]
    assert alone == found.good[::10].tolist()  # whatever else is asked for at once
    truth = np.array([least(l) for l in ceilings.tolist()])
    assert found.good.mean() > 0.9 and found.objective[found.good] == pytest.approx(truth[found.good], abs=1e-4)


@pytest.mark.parametrize("beside", [False, True])
def test_what_is_kept_amid_a_cell_and_broken_alike_at_its_corners_is_an_answer(tmp_path: Path, beside: bool) -> None:
    """Under an arch, whose ends are as low; the parameter beside it follows it to a bound, where the path is broken."""
    plain = bryson_denham(0.2)
    [phase] = plain.phases
    given = {name: one for name, one in plain.given.items() if name != "ceiling"}
    units = {"one": plain.objective_unit, "far": "m", "top": "m", "off": "1"}
    problem = replace(
        plain,
        phases=(
            replace(
                phase,
                path=pl.Conditions.of(lambda x, u, p, xp: (p.top - p.far * p.off**2 - x.x,), phase.path_conditions),
            ),
        ),
        given={**given, **{n: pl.Parameter(value=0.3 if n == "top" else 1.0, unit=unit) for n, unit in units.items()}},
        free=(pl.FreeParameter(name="other", lower=0.0, upper=1.0, guess=0.5),) * beside,
        objective=lambda x, p, xp: (
            plain.objective(x, p, xp) + (p.one * (p.other - 0.2 - p.off) ** 2 if beside else 0.0)
        ),
    )
    atlas = open_atlas(build(problem, {"off": (-0.4, 0.4)}, tmp_path / "arch", bricks=1), lambda _: problem)
    off = np.linspace(-0.39, 0.39, 40)
    truth = np.array([bryson_denham_truth(0.3 - x * x) + beside * max(-0.2 - x, 0.0) ** 2 for x in off.tolist()])
    assert atlas.query_many(off[:, None]).objective == pytest.approx(truth, rel=1e-8)
    assert [atlas.query(off=x).objective for x in off[::8].tolist()] == pytest.approx(truth[::8], rel=1e-8)


@pytest.mark.parametrize("beside", [False, True])
def test_where_an_arc_is_shorter_than_nothing_what_follows_it_has_to_be_known(tmp_path: Path, beside: bool) -> None:
    """The ride of the slower well becomes a touch that no solve met; the ride of the faster one is no better than that.

    The speed lies between no bounds, along which it would be looked for: another parameter that does says nothing of
    it. Where the faster well is the better one, or its touch is known, such rides cast no doubt.
    """
    problem, least = two_wells(121.981, 0.795, 1.365, 8.885, -10.91, beside)
    atlas = open_atlas(build(problem, {"ceiling": (0.1, 0.45)}, tmp_path / "wells", bricks=4), lambda _: problem)
    ceilings = np.sort(np.append(np.random.default_rng(0).uniform(0.1, 0.45, 80), [0.145, 0.15]))
    found = atlas.query_many(ceilings[:, None])
    truth = np.array([least(l) for l in ceilings.tolist()])
    assert found.objective[found.good] == pytest.approx(truth[found.good], abs=1e-4)
    assert 0.145 in ceilings[~found.good] and ((ceilings > 0.14) & (ceilings < 0.155))[~found.good].all()
    with pytest.raises(PeriluneError, match="negative duration"):
        atlas.query(ceiling=0.145)


def test_ranges_of_several_parameters_are_looked_over_in_turn(tmp_path: Path) -> None:
    """Where arcs of the better well are missed, flights with speed and q held tell that nothing there is better.

    What breaks the path there leads nowhere on the straight way to the answer; these points were refused.
    """
    problem, least = two_wells(96.749, 0.746, 1.304, 6.045, -7.581, lower=0.6, upper=1.6)
    priced, q = problem.objective, pl.FreeParameter(name="q", unit="1", lower=0.0, upper=1.0, guess=0.5)
    several = replace(
        problem, free=(*problem.free, q), objective=lambda x, p, xp: priced(x, p, xp) + p.one * (p.q - 0.4) ** 2
    )
    atlas = open_atlas(build(several, {"ceiling": (0.1, 0.45)}, tmp_path / "wells", bricks=1), lambda _: several)
    ceilings = np.linspace(0.18, 0.21, 4)
    found = atlas.query_many(ceilings[:, None])
    assert found.good.all()
    assert found.objective == pytest.approx([least(l) for l in ceilings.tolist()], abs=1e-4)
    alone = atlas.query(ceiling=float(ceilings[1]))
    assert alone.objective == pytest.approx(found.objective[1], rel=1e-10)


def test_durations_between_bounds_are_followed_over_their_ranges_too() -> None:
    """A duration of several arcs is held by their sum."""
    plain = bryson_denham(0.12)
    given = {name: one for name, one in plain.given.items() if name != "T"}
    units = {"one": plain.objective_unit, "second": "s"}
    problem = replace(
        plain,
        free=(pl.FreeParameter(name="T", unit="s", lower=0.9, upper=1.2, guess=1.0),),
        given={**given, **{name: pl.Parameter(value=1.0, unit=unit) for name, unit in units.items()}},
        objective=lambda x, p, xp: plain.objective(x, p, xp) + p.one * (p.T / p.second - 1) ** 2,
    )
    region = region_of(problem, {"ceiling": (0.1, 0.14)}, bricks=1)
    scan = Scan(problem, region, widths := np.array([0.04]))
    solved = RegionSolver(problem, region, Indirect(), ignore_events, widths).run()
    assert scan.names == ["T"] and "along" in solved[0].course.text
    assert scan.add(solved[0].values, solved[0].course, solved[0].extremals) and scan.gap() is None
