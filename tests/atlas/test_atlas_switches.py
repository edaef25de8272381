"""Atlases of flights through choices and kinks of the dynamics."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

import perilune as pl
from perilune.atlas.building import build as building
from perilune.atlas.building.verify import verify_atlas
from perilune.atlas.query.query import open_atlas
from test_verify_kinks import SLOPES, push

build = partial(building.build, sample=0)  # proofs have tests of their own


def test_flights_through_a_bent_table_are_answered_between_nodes(tmp_path: Path) -> None:
    """Costates turn at its knots, and the sensitivities with them: without that one step leads nowhere near enough."""
    slope = pl.Table((0.0, 0.3, 0.6, 1.0), (0.0, 0.4, 0.1, 0.3), "linear")
    problem = push(lambda x, p, xp: p.k * xp.table(slope, x.x / p.L))
    atlas = open_atlas(build(problem, {"k": (0.2, 0.4)}, tmp_path / "map", bricks=1))
    answers = atlas.query_many(np.linspace(0.2, 0.4, 40)[:, None])
    assert answers.good.all()
    alone = pl.solve(problem.with_given(k=0.4), verify=0)
    assert abs(answers.objective[-1] / alone.objective - 1.0) < 1e-10


def test_where_the_dynamics_jump_every_point_is_answered(tmp_path: Path) -> None:
    """H is looked at on the side that is flown: the rounded place of the jump lies on the other one of each fifth."""
    problem = push(SLOPES["jump"])
    atlas = open_atlas(build(problem, {"k": (0.1, 0.5), "xs": (20.0, 60.0)}, tmp_path / "map", bricks=1))
    points = np.random.default_rng(0).uniform([0.1, 20.0], [0.5, 60.0], (300, 2))
    answers = atlas.query_many(points)
    assert answers.good.all()
    alone = pl.solve(problem.with_given(k=points[0, 0], xs=points[0, 1]), verify=0)
    assert abs(answers.objective[0] / alone.objective - 1.0) < 1e-10


def test_no_node_lies_beyond_the_region_by_a_rounding(tmp_path: Path) -> None:
    """0.56 times 100 m is more than 56 m: what was drawn there had no answer, as it lay outside."""
    problem = push(SLOPES["jump"])
    atlas = open_atlas(build(problem, {"xs": (40.0, 56.0)}, tmp_path / "map", bricks=1))
    (line,) = atlas.said.values()
    values = np.load(tmp_path / "map" / line["nodes"]["file"])["values"]
    assert values.min() == 40.0 and values.max() == 56.0
    assert verify_atlas(atlas, sample=2).refused == 0
