"""Fast method of the paper on neighbour B, and ours: extremals kept over the region, and answers read from them.

The paper keeps costates at ignition and values at the interface at the points of a grid, predicts those of another
manoeuvre point by a polynomial of ten coefficients through the ten nearest (16), and searches within 2 % of that by a
genetic algorithm. So it is done here, and without the search: Newton's method from the prediction, which is all that a
search so near can end with. Ours is an atlas over the box around the region.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from perilune import Genetic, PeriluneError, Problem, solve
from perilune.atlas import Atlas, build, open as open_atlas
from perilune.core import Matrix, Vector, Watch
from perilune.methods import Nearby
from perilune_papers.liu2019.members import ManoeuvreMember, predict_by_cubic

WITHIN = 0.02  # the neighbourhood of a prediction in which the paper searches
_BESIDE = math.radians(0.05)  # by which the box is wider than the points
_LEAST = 1e-9  # of an unknown that is predicted to be 0, canonical
AXES: tuple[str, ...] = ("manoeuvre_longitude", "manoeuvre_latitude")


@dataclass(frozen=True, kw_only=True)
class Fast:
    """Results of the fast methods at the manoeuvre points of Table 1; processor times [s], NaN for what failed.

    Parameters
    ----------
    built, nodes, kinds
        Time to build the atlas [s], the number of its extremals, and their kinds.
    searched
        The paper's method at some of the points: a genetic search within 2 % of the prediction (16), then Newton's.
    predicted
        Newton's method from the prediction.
    queried
        A query of the atlas, independently re-integrated.
    refused
        Why those points have no answer from the atlas.
    alone
        The points solved without an initial guess.
    apart
        The largest relative difference of the time of flight between these two.
    """

    built: float
    nodes: int
    kinds: tuple[str, ...]
    searched: Vector
    predicted: Vector
    queried: Vector
    refused: tuple[str, ...]
    alone: Vector
    apart: float


def time_fast_methods(
    problem: Problem,
    grid: Sequence[ManoeuvreMember],
    experiments: Sequence[ManoeuvreMember],
    seeds: int,
    directory: Path,
    watch: Watch,
) -> Fast:
    """Build the atlas and ask it.

    Parameters
    ----------
    problem
        Neighbour B.
    grid
        Of Table 2, solved.
    experiments
        Points at which the methods are asked, and the problem is solved without an initial guess.
    seeds
        At how many of them the paper's search is made.
    directory
        Where the atlas is built.
    watch
        Receives lines of text.
    """
    places = np.radians([(m.longitude, m.latitude) for m in (*grid, *experiments)])
    low, high = places.min(axis=0) - _BESIDE, places.max(axis=0) + _BESIDE
    box = dict(zip(AXES, zip(low.tolist(), high.tolist(), strict=True), strict=True))
    began = time.process_time()
    atlas = open_atlas(build(problem, box, directory, sample=0, callback=watch))
    built = time.process_time() - began
    points = np.radians([(m.longitude, m.latitude) for m in experiments])
    queried, refused, found = _query_points(atlas, points)
    kinds = tuple(charted.chart.course.text or "one arc in each phase" for charted in atlas.charted)
    alone, apart = list[float](), 0.0
    for at, known in zip(points.tolist(), found, strict=True):
        watch(f"without an initial guess at {len(alone) + 1} of {len(points)} points")
        began = time.process_time()
        solution = solve(problem.with_given(**dict(zip(AXES, at, strict=True))), verify=0)
        alone.append(time.process_time() - began)
        if math.isfinite(known):
            apart = max(apart, float(abs(solution.objective / known - 1.0)))
    predictions = _predictions(grid, experiments)
    some = np.unique(np.linspace(0, len(predictions) - 1, min(seeds, len(predictions))).astype(int)).tolist()
    searched = list[float]()
    for number in some:
        watch(f"the paper's fast method at {len(searched) + 1} of {len(some)} points")
        searched.append(_newton_time(predictions[number], _by_search))
    return Fast(
        built=built, nodes=atlas.rows, kinds=kinds, searched=np.array(searched), queried=queried,
        predicted=np.array([_newton_time(one, lambda _, guess: guess) for one in predictions]),
        refused=refused, alone=np.array(alone), apart=apart,
    )  # fmt: skip


def _query_points(atlas: Atlas, points: np.ndarray) -> tuple[Vector, tuple[str, ...], Vector]:
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


@dataclass(frozen=True)
class _Prediction:
    """Unknowns predicted by (16) at a manoeuvre point, and an extremal of these arcs."""

    near: Nearby
    values: dict[str, float]
    guess: Vector

    def missed(self, Y: Matrix) -> Vector:
        """Return the largest residual of flights with such unknowns: how far each is from an extremal."""
        return self.near.shooting.at(Y, self.near.numbers(self.values), self.near.root.choice[None]).residuals


def _predictions(grid: Sequence[ManoeuvreMember], experiments: Sequence[ManoeuvreMember]) -> list[_Prediction]:
    """Predictions at all points; none where fewer than ten of the grid are known."""
    known = [m for m in grid if m.solution is not None]
    arcs = [Nearby(m.solution) for m in known if m.solution is not None]
    alike = [i for i, one in enumerate(arcs) if one.arcs is not None and len(one.root.y) == len(arcs[0].root.y)]
    if len(alike) < 10:
        return []
    unknowns, found = np.array([arcs[i].root.y for i in alike]).T, list[_Prediction]()
    for member in experiments:
        guess = predict_by_cubic([known[k] for k in alike], member, unknowns)
        values = dict(zip(AXES, (math.radians(member.longitude), math.radians(member.latitude)), strict=True))
        found.append(_Prediction(arcs[alike[0]], values, guess))
    return found


def _by_search(one: _Prediction, guess: Vector) -> Vector:
    """The best of a genetic search within 2 % of a prediction."""
    away = np.maximum(WITHIN * np.abs(guess), _LEAST)
    return Genetic(best=1).search(one.missed, guess - away, guess + away).points[0]


def _newton_time(one: _Prediction, begin: Callable[[_Prediction, Vector], Vector]) -> float:
    """Return the processor time [s] of Newton's method and of its initial guess; NaN where it fails."""
    took = math.nan
    for _ in range(2):  # the first makes what is made once
        began = time.process_time()
        roots = one.near.roots(one.values, begin=begin(one, one.guess)[None])
        took = time.process_time() - began if roots.converged[0] else math.nan
    return took
