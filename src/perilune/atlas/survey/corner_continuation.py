"""Continuation of one branch to other points of a region: from an extremal, and between the corners of blocks."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
from numpy.typing import NDArray

from perilune.charts import Borders, Chart, Sheet, follow_sheets
from perilune.core import Matrix, Vector

Corners = dict[tuple[int, ...], NDArray[np.float64]]  # unknowns of a branch by the numbers of corners


def continue_sheet_to(
    chart: Chart, borders: Borders, sheet: Sheet, start: Vector, y: Vector, targets: Matrix
) -> Matrix:
    """Continue a branch to other values of the parameters; return unknowns, (targets, n), NaN where it does not lead.

    Parameters
    ----------
    chart, borders, sheet
        The branch, with its chart and bounds.
    start, y
        Values of the parameters, (d,), and unknowns, (n,), to begin with, canonical.
    targets
        Values of the parameters to reach, canonical, (targets, d).
    """
    here, share = follow_sheets(chart, borders, [sheet], *walks_from_one_extremal(start, y, targets))
    here[share < 1.0] = np.nan
    return here


def walks_from_one_extremal(
    start: Vector, y: Vector, targets: Matrix
) -> tuple[NDArray[np.int64], Matrix, Matrix, Matrix]:
    """Return `which`, `starts`, `y` and `targets` of `follow_sheets` from one extremal of one branch.

    Parameters
    ----------
    start, y
        Values of the parameters, (d,), and unknowns, (n,), canonical.
    targets
        Values of the parameters to reach, canonical, (targets, d).
    """
    count = len(targets)
    return np.zeros(count, dtype=np.int64), np.tile(start, (count, 1)), np.tile(y, (count, 1)), targets


def corners_reached(places: NDArray[np.int64], y: Matrix) -> Corners:
    """Return the unknowns of a branch at the corners that it reaches.

    Parameters
    ----------
    places
        Numbers of the corners, (corners, d).
    y
        Unknowns there, canonical, (corners, n); NaN where the branch does not reach.
    """
    return {tuple(corner): row for corner, row in zip(places.tolist(), y, strict=True) if np.isfinite(row[0])}


def continue_between_corners(
    chart: Chart, borders: Borders, sheet: Sheet, places: NDArray[np.int64], values: Matrix, known: Corners
) -> Corners:
    """Continue a branch to further corners, from corner to neighbouring corner.

    It continues only from corners at which it can be an answer: beyond its border it may turn back, and come to the
    same place with other extremals.

    Parameters
    ----------
    chart, borders, sheet
        The branch, with its chart and bounds.
    places, values
        Numbers of all corners, and their values [SI], (corners, d) each.
    known
        Unknowns at the corners with which to begin.

    Returns
    -------
    Corners
        Unknowns at all corners that the branch reaches, the known ones included.
    """
    reached, canonical = dict(known), values / chart.scale
    numbers = {tuple(corner): i for i, corner in enumerate(places.tolist())}
    border = list(known)
    while border := _admissible_corners(
        chart, borders, sheet, canonical, numbers, {corner: reached[corner] for corner in border}
    ):
        ways = dict[tuple[int, ...], list[tuple[int, ...]]]()  # to a corner, from those beside it in turn
        for corner, axis, way in product(border, range(len(border[0])), (-1, 1)):
            other = (*corner[:axis], corner[axis] + way, *corner[axis + 1 :])
            if other in numbers and other not in reached:
                ways.setdefault(other, []).append(corner)
        border = list[tuple[int, ...]]()
        while ways:
            firsts = [of.pop(0) for of in ways.values()]
            starts, targets = (canonical[[numbers[corner] for corner in some]] for some in (firsts, ways))
            y, own = np.array([reached[corner] for corner in firsts]), np.zeros(len(ways), dtype=np.int64)
            there, share = follow_sheets(chart, borders, [sheet], own, starts, y, targets)
            new = {other: row for other, row, all_of_it in zip(ways, there, share == 1.0, strict=True) if all_of_it}
            reached |= new
            border += new
            ways = {other: of for other, of in ways.items() if of and other not in new}
    return reached


def _admissible_corners(
    chart: Chart,
    borders: Borders,
    sheet: Sheet,
    canonical: Matrix,
    numbers: Mapping[tuple[int, ...], int],
    corners: Corners,
) -> list[tuple[int, ...]]:
    """Return the corners at which a branch can be an answer."""
    if not corners:
        return []
    values, which = canonical[[numbers[corner] for corner in corners]], np.zeros(len(corners), dtype=np.int64)
    found = chart.at(values, np.array(list(corners.values())), borders.holds([sheet], which, values))
    good = borders.margins_of([sheet], which, found) >= 0
    return [corner for corner, here in zip(corners, good.tolist(), strict=True) if here]
