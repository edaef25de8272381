"""Atlases of flights through choices and kinks of the dynamics."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

import perilune as pl
from perilune.atlas import building
from perilune.atlas.query import open_atlas
from test_verify_kinks import push

build = partial(building.build, sample=0)  # proofs have tests of their own


def test_flights_through_a_bent_table_are_answered_between_nodes(tmp_path: Path) -> None:
    """Costates turn at its knots, and the sensitivities with them: without that one step leads nowhere near enough."""
    slope = pl.Table((0.0, 0.3, 0.6, 1.0), (0.0, 0.4, 0.1, 0.3), "linear")
    problem = push(lambda x, p, m: p.k * m.table(slope, x.x / p.L))
    atlas = open_atlas(build(problem, {"k": (0.2, 0.4)}, tmp_path / "map", bricks=1))
    answers = atlas.query_many(np.linspace(0.2, 0.4, 40)[:, None])
    assert answers.good.all()
    alone = pl.solve(problem.with_given(k=0.4), level=0)
    assert abs(answers.objective[-1] / alone.objective - 1.0) < 1e-10
