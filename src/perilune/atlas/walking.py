"""Carrying one sheet over the region: along straight lines, and from corner to corner of bricks.

Each walk goes by the tangent plane and Newton's method, in lanes; its step is halved where that fails.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.cells import same
from perilune.atlas.chart import Chart
from perilune.atlas.sheets import Borders, Sheet
from perilune.words.types import Matrix, Vector

Corners = dict[tuple[int, ...], NDArray[np.float64]]  # unknowns of a sheet by the numbers of corners

MOST = 20  # evaluations of a step
_SHORTEST, _ROUNDS = 2.0**-7, 200  # step of a walk, and how many there may be
_APART, _NEAR = 0.5, 0.02  # how far a root may lie from the tangent plane: of the step there, and of 1 + |y|


def carried(chart: Chart, borders: Borders, sheet: Sheet, start: Vector, y: Vector, targets: Matrix) -> Matrix:
    """Unknowns of a sheet at other values of the parameters, (targets, n); NaN where it does not lead to."""
    here, share = walked(chart, borders, [sheet], *from_one(start, y, targets))
    here[share < 1.0] = np.nan
    return here


def walked(
    chart: Chart,
    borders: Borders,
    sheets: Sequence[Sheet],
    which: NDArray[np.int64],
    starts: Matrix,
    y: Matrix,
    targets: Matrix,
    shortest: float = _SHORTEST,
    near: float = _NEAR,
    astray: float | None = None,
) -> tuple[Matrix, Vector]:
    """Follow sheets along straight lines.

    Parameters
    ----------
    chart, borders, sheets, which
        Whose, and the number of each walk's.
    starts, y
        An extremal of each: values, and unknowns there, canonical.
    targets
        Values to which the lines lead, (walks, d), canonical.
    shortest
        Share of its way by which a walk goes at least.
    near
        How far a root may lie from the tangent plane, of 1 + |y|, beside half of the step.
    astray
        Times as far Newton's method may lead on the way; anywhere if None.

    Returns
    -------
    y, share
        Unknowns where each walk ended, (walks, n), and which share of its way that is, (walks,).
    """
    first = chart.solve(starts, y, borders.holds(sheets, which, starts), limit=MOST)
    here, slopes = first.y.copy(), first.slopes.copy()
    share, stride = np.zeros(len(targets)), np.where(first.converged, 1.0, 0.0)
    way, orientations = targets - starts, np.array([sheet.orientation for sheet in sheets])
    for _ in range(_ROUNDS):
        lanes = np.nonzero((share < 1.0) & (stride >= shortest))[0]
        if not len(lanes):
            break
        ahead = np.minimum(1.0, share[lanes] + stride[lanes])
        values = starts[lanes] + ahead[:, None] * way[lanes]
        values[ahead == 1.0] = targets[lanes[ahead == 1.0]]
        step = np.einsum("ld,ldn->ln", values - (starts[lanes] + share[lanes, None] * way[lanes]), slopes[lanes])
        guess = here[lanes] + step
        within = _APART * np.linalg.norm(step, axis=1) + near * (1.0 + np.linalg.norm(here[lanes], axis=1))
        reach = {} if astray is None else {"reach": astray * within}
        found = chart.solve(values, guess, borders.holds(sheets, which[lanes], values), limit=MOST, **reach)
        with np.errstate(invalid="ignore", over="ignore"):  # of what is lost
            moved = np.linalg.norm(found.y - guess, axis=1)
        good = found.converged & (found.orientation == orientations[which[lanes]]) & (moved <= within)
        far = np.nonzero(good & (moved > near * (1.0 + np.linalg.norm(here[lanes], axis=1))))[0]
        if len(far):  # another layer may lie where a steep one was to lead; from there no way leads back
            back, own = starts[lanes[far]] + share[lanes[far], None] * way[lanes[far]], which[lanes[far]]
            guess = found.y[far] + np.einsum("ld,ldn->ln", back - values[far], found.slopes[far])
            again = chart.solve(back, guess, borders.holds(sheets, own, back), limit=MOST)
            good[far] = again.converged & same(here[lanes[far]], again.y)
        reached = lanes[good]
        here[reached], slopes[reached], share[reached] = found.y[good], found.slopes[good], ahead[good]
        stride[lanes] *= np.where(good, 2.0, 0.5)
    return here, share


def from_one(start: Vector, y: Vector, targets: Matrix) -> tuple[NDArray[np.int64], Matrix, Matrix, Matrix]:
    """`which`, `starts`, `y` and `targets` of walks that begin at one extremal of one sheet."""
    count = len(targets)
    return np.zeros(count, dtype=np.int64), np.tile(start, (count, 1)), np.tile(y, (count, 1)), targets


def reached_at(places: NDArray[np.int64], y: Matrix) -> Corners:
    """What a sheet is at the corners that it reaches."""
    return {tuple(corner): row for corner, row in zip(places.tolist(), y, strict=True) if np.isfinite(row[0])}


def carried_on(
    chart: Chart, borders: Borders, sheet: Sheet, places: NDArray[np.int64], values: Matrix, known: Corners
) -> Corners:
    """A sheet at corners to which it was not carried yet, from corner to neighbouring corner.

    On from where it can be an answer alone: beyond its border it may turn back, and come to the same place with others.
    """
    reached, canonical = dict(known), values / chart.scale
    numbers = {tuple(corner): i for i, corner in enumerate(places.tolist())}
    border = list(known)
    while border := _within(chart, borders, sheet, canonical, numbers, {corner: reached[corner] for corner in border}):
        ahead = list[tuple[int, ...]]()
        for corner in border:
            beside = [
                (*corner[:axis], corner[axis] + way, *corner[axis + 1 :])
                for axis in range(len(corner))
                for way in (-1, 1)
            ]
            beside = [other for other in beside if other in numbers and other not in reached]
            if beside:
                targets = canonical[[numbers[other] for other in beside]]
                rows = carried(chart, borders, sheet, canonical[numbers[corner]], reached[corner], targets)
                new = {other: row for other, row in zip(beside, rows, strict=True) if np.isfinite(row[0])}
                reached |= new
                ahead += new
        border = ahead
    return reached


def _within(
    chart: Chart,
    borders: Borders,
    sheet: Sheet,
    canonical: Matrix,
    numbers: Mapping[tuple[int, ...], int],
    corners: Corners,
) -> list[tuple[int, ...]]:
    """Those of the corners at which a sheet can be an answer."""
    if not corners:
        return []
    values, which = canonical[[numbers[corner] for corner in corners]], np.zeros(len(corners), dtype=np.int64)
    found = chart.at(values, np.array(list(corners.values())), borders.holds([sheet], which, values))
    good = borders.margins_of([sheet], which, found) >= 0
    return [corner for corner, here in zip(corners, good.tolist(), strict=True) if here]
