"""The paper's fast method on neighbour B, and ours: extremals kept over the region, and answers read from them.

The paper keeps costates at ignition and values at the interface at the points of a grid, predicts those of another
manoeuvre point by a polynomial of ten coefficients through the ten nearest (16), and searches within 2 % of that. Its
search is a genetic one; here Newton's method begins at the prediction, which is all that a search so near can end with.
Ours is an atlas over the box around the region.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from perilune.atlas.building import build
from perilune.atlas.query import Atlas, open_atlas
from perilune.methods.nearby import Nearby
from perilune.problem.problem import Problem
from perilune.reproductions.liu2019.members import Member, by_cubic
from perilune.solve import solve
from perilune.words.outcome import PeriluneError
from perilune.words.types import Vector
from perilune.words.watch import Watch

_BESIDE = math.radians(0.05)  # by which the box is wider than the points
AXES: tuple[str, ...] = ("manoeuvre_longitude", "manoeuvre_latitude")


@dataclass(frozen=True, kw_only=True)
class Fast:
    """What the fast methods do at the manoeuvre points of Table 1; processor times [s], NaN for what failed.

    Parameters
    ----------
    built, nodes, arcs
        How long the atlas took, how many extremals it has, and of how many kinds they are.
    predicted
        Newton's method from the prediction (16).
    queried
        A query of the atlas, flown again.
    refused
        Why those points have no answer from the atlas.
    alone
        Some of the points solved from nothing.
    apart
        The largest relative difference of the time of flight between these two.
    """

    built: float
    nodes: int
    kinds: tuple[str, ...]
    predicted: Vector
    queried: Vector
    refused: tuple[str, ...]
    alone: Vector
    apart: float


def fast(
    problem: Problem, grid: Sequence[Member], experiments: Sequence[Member], alone: int, directory: Path, watch: Watch
) -> Fast:
    """Build the atlas and ask it.

    Parameters
    ----------
    problem
        Neighbour B.
    grid
        Of Table 2, solved.
    experiments
        Where the methods are asked.
    alone
        At how many of them the problem is solved from nothing as well.
    directory
        Where the atlas is built.
    watch
        Receives lines of text.
    """
    places = np.radians([(m.longitude, m.latitude) for m in (*grid, *experiments)])
    low, high = places.min(axis=0) - _BESIDE, places.max(axis=0) + _BESIDE
    box = dict(zip(AXES, zip(low.tolist(), high.tolist(), strict=True), strict=True))
    began = time.process_time()
    atlas = open_atlas(build(problem, box, directory, sample=0, watch=watch))
    built = time.process_time() - began
    points = np.radians([(m.longitude, m.latitude) for m in experiments])
    queried, refused, found = _queried(atlas, points)
    kinds = tuple(charted.chart.course.text or "one arc in each phase" for charted in atlas.charted)
    nodes = sum(int(line["nodes"]["rows"]) for line in atlas.said.values())
    every = np.unique(np.linspace(0, len(points) - 1, min(alone, len(points))).astype(int))
    took, apart = list[float](), 0.0
    for number in every.tolist():
        watch(f"from nothing at {len(took) + 1} of {len(every)} points")
        began = time.process_time()
        solution = solve(problem.with_given(**dict(zip(AXES, points[number].tolist(), strict=True))), level=0)
        took.append(time.process_time() - began)
        if math.isfinite(found[number]):
            apart = max(apart, float(abs(solution.objective / found[number] - 1.0)))
    return Fast(
        built=built, nodes=nodes, kinds=kinds, predicted=_predicted(grid, experiments), queried=queried,
        refused=refused, alone=np.array(took), apart=apart,
    )  # fmt: skip


def _queried(atlas: Atlas, points: np.ndarray) -> tuple[Vector, tuple[str, ...], Vector]:
    """Times of queries, what was refused, and J."""
    took, found, refused = np.full(len(points), math.nan), np.full(len(points), math.nan), list[str]()
    for once in (False, True):  # the first round makes what is made once
        for i, point in enumerate(points.tolist()):
            began = time.process_time()
            try:
                found[i] = atlas.query(**dict(zip(AXES, point, strict=True))).objective
                took[i] = time.process_time() - began
            except PeriluneError as error:
                refused += [" ".join(str(error).split())] * once
    return took, tuple(refused), found


def _predicted(grid: Sequence[Member], experiments: Sequence[Member]) -> Vector:
    """Times of Newton's method from what (16) predicts of all unknowns."""
    took, known = np.full(len(experiments), math.nan), [m for m in grid if m.solution is not None]
    arcs = [Nearby(m.solution) for m in known if m.solution is not None]
    alike = [i for i, one in enumerate(arcs) if one.arcs is not None and len(one.root.y) == len(arcs[0].root.y)]
    if len(alike) < 10:
        return took
    unknowns = np.array([arcs[i].root.y for i in alike]).T
    for i, member in enumerate(experiments):
        guess = by_cubic([known[k] for k in alike], member, unknowns)
        values = dict(zip(AXES, (math.radians(member.longitude), math.radians(member.latitude)), strict=True))
        for _ in range(2):  # the first makes what is made once
            began = time.process_time()
            roots = arcs[alike[0]].roots(values, begin=guess[None])
            took[i] = time.process_time() - began if roots.converged[0] else math.nan
    return took
