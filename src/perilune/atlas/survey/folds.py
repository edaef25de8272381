"""Continuation around a fold by arc length, from one branch to the other that joins it there.

Along a straight line of the parameters, p = a + s (b - a), extremals are a curve of (y, s). At a fold s turns back, and
dy/ds is infinite; by the length of the curve it goes on. A step goes along its tangent, and Newton's method back to the
curve across the tangent (pseudo-arclength). With h_y the Jacobian, its tangent is (dy/ds, 1) = (-h_y^-1 h_s, 1), and a
correction (h_y^-1 (-h - h_s ds), ds): what shooting gives anywhere but at the fold itself.

Source: H. B. Keller, *Numerical solution of bifurcation and nonlinear eigenvalue problems*, in Applications of
Bifurcation Theory, Academic Press 1977, 359-384; E. L. Allgower, K. Georg, *Introduction to Numerical Continuation
Methods*, SIAM 2003, chapters 2 and 10.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.region import Region
from perilune.atlas.store.schema import open_chart
from perilune.charts import Borders, Chart, Sheet
from perilune.core import Matrix, PeriluneError, Vector
from perilune.methods import ExtremalRoot
from perilune.problem import Nature, Problem, Statistics
from perilune.proof import check_local_optimality

_FIRST, _LONGEST, _SHORTEST = 0.01, 0.1, 1e-6  # steps, in lengths of (y / (1 + |y|), s)
_STEPS, _CORRECTIONS = 60, 6
_CLOSE = 1e-9  # relative: a correction that is the last
_BENT = 0.9  # the least cosine between tangents at both ends of a step
_CLEAR = 0.05  # of s: how far behind a fold an extremal is distinguished
_BACK = 0.1  # of s, behind the start, which may lie before a fold at once


def around_folds(
    chart: Chart, borders: Borders, sheet: Sheet, start: Matrix, y: Matrix, targets: Matrix
) -> Iterator[tuple[Vector, Vector, float]]:
    """Yield extremals behind the folds at which a branch ends on the way to some values.

    Parameters
    ----------
    chart, borders, sheet
        Whose.
    start, y
        Extremals of it: values (lanes, d) and unknowns (lanes, n), canonical.
    targets
        Where the ways lead to, (lanes, d), which the branch does not reach.

    Yields
    ------
    values, y, orientation
        Of an extremal a little behind the fold, canonical, and its side of it: one of each way at most.
    """
    way, weight = targets - start, 1.0 / (1.0 + np.linalg.norm(y, axis=1))

    def seen(lanes: NDArray[np.int64], share: Vector, u: Matrix) -> tuple[Matrix, Matrix, Vector]:
        """Return dy/ds, Newton's step at this s and the side of the fold for some lanes."""
        values = start[lanes] + share[:, None] * way[lanes]
        found = chart.at(values, u, borders.holds([sheet], np.zeros(len(lanes), dtype=np.int64), values))
        return np.einsum("ld,ldn->ln", way[lanes], found.slopes), found.stepped - u, found.orientation

    if not len(start):
        return
    every = np.arange(len(start))
    u, share, length = y.copy(), np.zeros(len(start)), np.full(len(start), _FIRST)
    tangent = _unit_tangents(seen(every, share, u)[0] * weight[:, None])
    side, turned = np.full(len(start), sheet.orientation), np.full(len(start), np.nan)
    for _ in range(_STEPS):
        lanes = np.nonzero((length >= _SHORTEST) & (share >= -_BACK) & (share <= 1.0))[0]
        if not len(lanes):
            return
        along, rise = tangent[lanes, :-1] * weight[lanes, None], tangent[lanes, -1]
        new = u[lanes] + length[lanes, None] * tangent[lanes, :-1] / weight[lanes, None]
        at = share[lanes] + length[lanes] * rise
        good = _correct_in_place(
            lambda at, new, lanes=lanes: seen(lanes, at, new), at, new, (along, rise), length[lanes], weight[lanes]
        )
        slope, _, orientation = seen(lanes, at, new)
        onward = _unit_tangents(slope * weight[lanes, None])
        with np.errstate(invalid="ignore"):
            bend = (onward * tangent[lanes]).sum(axis=1)
        good &= np.abs(bend) >= _BENT
        length[lanes] *= np.where(good, np.minimum(2.0, _LONGEST / length[lanes]), 0.25)
        done = lanes[good]
        u[done], share[done], tangent[done] = new[good], at[good], onward[good] * np.sign(bend[good])[:, None]
        for lane, now in zip(done.tolist(), orientation[good].tolist(), strict=True):
            if now != side[lane]:
                side[lane], turned[lane] = now, share[lane]
            elif abs(share[lane] - turned[lane]) >= _CLEAR:
                length[lane] = 0.0  # what lies behind is followed from there
                yield start[lane] + share[lane] * way[lane], u[lane].copy(), now


def _correct_in_place(
    seen: Callable[[Vector, Matrix], tuple[Matrix, Matrix, Vector]],
    at: Vector,
    new: Matrix,
    tangent: tuple[Matrix, Vector],
    length: Vector,
    weight: Vector,
) -> NDArray[np.bool_]:
    """Correct s and y on the plane across the tangent by Newton's method; return True for the lanes that came close."""
    (along, rise), good = tangent, np.zeros(len(at), dtype=bool)
    for _ in range(_CORRECTIONS):
        slope, step, _ = seen(at, new)
        with np.errstate(all="ignore"):
            ds = -(along * step).sum(axis=1) / (rise + (along * slope).sum(axis=1))
            dy = step + slope * ds[:, None]
            moved = np.linalg.norm(dy, axis=1) * weight + np.abs(ds)
        sound = np.isfinite(moved) & (moved < length)
        new[sound], at[sound] = new[sound] + dy[sound], at[sound] + ds[sound]
        good = sound & (moved <= _CLOSE)
        if (good | ~sound).all():
            break
    return good


def _unit_tangents(slope: Matrix) -> Matrix:
    """Return unit tangents of curves with given slopes."""
    with np.errstate(invalid="ignore", over="ignore"):
        tangent = np.column_stack([slope, np.ones(len(slope))])
        return tangent / np.linalg.norm(tangent, axis=1)[:, None]


_TOLD_BY = ("conjugate_point", "second_variation")  # checks of the proof


def classify_behind_folds(
    problem: Problem, region: Region, said: Mapping[str, Any], values: Vector, y: Vector
) -> Nature:
    """Classify an extremal behind a fold, at which no solve has been, by its second variation.

    Parameters
    ----------
    problem, region
        The problem, and the region that is mapped.
    said
        Its chart, as the survey's line has it, with its branch only.
    values, y
        Of the axes and its unknowns, canonical.

    Returns
    -------
    Nature
        A local optimum or locally worst; `UNPROVED` where its second variation does not decide.
    """
    charted = open_chart(problem, region, said)
    polished = charted.polish(values[None], np.zeros(1, dtype=np.int64), y[None])
    if not polished.reached[0]:
        return Nature.UNPROVED
    at = dict(zip(region.names, (values * charted.chart.scale).tolist(), strict=True))
    root = ExtremalRoot(root=charted.root(*polished.row(0)), minimum=True)
    try:
        solution = charted.solution(problem.with_given(**at), [root], Statistics(initialization="atlas"))
        told = [check for check in check_local_optimality(solution) if check.name in _TOLD_BY]
    except (PeriluneError, ArithmeticError):
        return Nature.UNPROVED
    if any(check.value > check.limit for check in told):
        return Nature.WORST
    if not told or any(np.isnan(check.value) for check in told):
        return Nature.UNPROVED
    return Nature.LOCAL_OPTIMUM_AT_BOUND if charted.sheets[0].holds else Nature.LOCAL_OPTIMUM
