"""Acceptance test of cells: their interpolation against extremals at their middle, and around it in large cells.

A test at the middle only would miss what comes and goes between there and the corners of a large cell, such as a price
that rises in a window of the parameters. Other tests are at quarters along each long axis, so that the halves of a cell
that is cut for them test the same points, until they are corners.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.cells import WHOLE, Cells, Whole, select_cells
from perilune.atlas.chart import Extremals, Holds
from perilune.atlas.hermite import interpolated, scaled_third_derivatives
from perilune.atlas.lattice import Lattice
from perilune.words.types import Matrix, Vector

FINEST = 2**6  # the shortest edge of a cell
_LONG = WHOLE // 4  # a longer edge is tried at its quarters
_AFAR, _COST = 0.1, 1e-4  # how far what a cell gives may be from its extremal, of 1 + |y|, and its J, of 1 + |J|
_STRAIGHT = 1e-15  # relative, for each lattice step: by so little an edge is bent by rounding


def accept_cells(
    lattice: Lattice, cells: Cells, tolerance: float, begun: Callable[[Cells], NDArray[np.bool_]]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], Whole]:
    """Test cells: return masks of those where one step is enough and of those without an answer, and axes to cut.

    Parameters
    ----------
    lattice, cells
        Cells with all their corners.
    tolerance
        Relative error to which a step has to lead.
    begun
        Returns a mask of the cells in which a sheet began.
    """
    minimum, size = lattice.minimum[cells.branch], cells.size * lattice.step
    given, stepped, near, margin = _test_places(lattice, cells, np.full(size.shape, 0.5), tolerance)
    beyond = np.maximum(margin, lattice.nodes.rows("margin", cells.corners).max(axis=1)) < 0.0
    beyond[beyond] = ~begun(select_cells(cells, beyond))
    unlike = scaled_third_derivatives(lattice.nodes.rows("terms", cells.corners), size) / (1.0 + np.abs(given))[:, None]
    unlike[~stepped, :, -1] = 0.0  # J is looked at where the unknowns are good
    passed = stepped & (near | beyond | ~minimum)
    lane, share = _test_locations(cells, passed & minimum)
    if len(lane):  # most are told without a step, which takes as long again
        told = _confirmed_places(lattice, select_cells(cells, lane), share, beyond[lane])
        lane, share = lane[~told], share[~told]
    if len(lane):
        _, stepped, near, margin = _test_places(lattice, select_cells(cells, lane), share, tolerance)
        passed[lane[~(stepped & np.where(beyond[lane], margin < 0.0, near))]] = False
    bent = unlike.max(axis=2) + _STRAIGHT * cells.size  # where none is bent the longest
    return passed, beyond, (bent * (cells.size > FINEST)).argmax(axis=1)


def _test_places(
    lattice: Lattice, cells: Cells, share: Matrix, tolerance: float
) -> tuple[Matrix, NDArray[np.bool_], NDArray[np.bool_], Vector]:
    """Test places in cells; return what cells give, masks of places where a step is enough and near, and margins."""
    values, given, holds, first = _interpolated_and_solved(lattice, cells, share)
    flown: NDArray[np.bool_] = np.all(np.isfinite(first.stepped), axis=1)
    second = lattice.chart.at(values, np.where(flown[:, None], first.stepped, given[:, :-1]), holds)
    sided = second.orientation == lattice.orientations[cells.branch]
    # Where the conditions are linear in the unknowns a step is enough from anywhere, and J of the cell still wrong.
    near = _agree_in_cost(first.length, second.cost, given[:, -1])
    margin = lattice.borders.margins_of(lattice.sheets, cells.branch, second)
    return given, flown & sided & (second.length <= tolerance), near, margin


def _interpolated_and_solved(lattice: Lattice, cells: Cells, share: Matrix) -> tuple[Matrix, Matrix, Holds, Extremals]:
    """Return parameters, interpolated y and J, held parameters, and evaluated points at places in cells."""
    values = lattice.values(cells.low + share * cells.size)
    given = interpolated(lattice.nodes.rows("terms", cells.corners), share, cells.size * lattice.step)
    holds = lattice.borders.holds(lattice.sheets, cells.branch, values)
    return values, given, holds, lattice.chart.at(values, given[:, :-1], holds)


def path_amid(lattice: Lattice, cells: Cells) -> Vector:
    """Return the least path condition of what cells give at their middle, after a step of Newton's method."""
    if not len(cells):
        return np.empty(0)
    chart = lattice.chart
    values, _, holds, first = _interpolated_and_solved(lattice, cells, np.full(cells.size.shape, 0.5))
    return lattice.reflights(chart.whole(values, first.stepped), chart.p[None], chart.choice(values, holds)).seen.path


def _confirmed_places(lattice: Lattice, cells: Cells, share: Matrix, beyond: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return True at places where what cells give is near an extremal and its J, or beyond a bound as expected."""
    _, given, _, here = _interpolated_and_solved(lattice, cells, share)
    margin = lattice.borders.margins_of(lattice.sheets, cells.branch, here)
    return np.where(beyond, margin < 0.0, _agree_in_cost(here.length, here.cost, given[:, -1]))


def _agree_in_cost(length: Vector, cost: Vector, given: Vector) -> NDArray[np.bool_]:
    """Return True for extremals that are near, and whose J agrees with the cell's."""
    return (length <= _AFAR) & (np.abs(given - cost) <= _COST * (1.0 + np.abs(cost)))


def _test_locations(cells: Cells, which: NDArray[np.bool_]) -> tuple[Whole, Matrix]:
    """Return where cells are tested in addition to their middle: (lanes,) numbers and (lanes, d) places in them."""
    long = cells.size > _LONG
    lanes, shares = list[Whole](), list[Matrix]()
    for i in np.nonzero(which & long.any(axis=1))[0].tolist():
        shares.append(_quarters(tuple(long[i].tolist())))
        lanes.append(np.full(len(shares[-1]), i))
    if not lanes:
        return np.empty(0, dtype=np.int64), np.empty((0, long.shape[1]))
    return np.concatenate(lanes), np.vstack(shares)


@lru_cache(maxsize=32)
def _quarters(long: tuple[bool, ...]) -> Matrix:
    """Return all places at quarters along the long axes, but the middle."""
    grid = np.array(list(product(*((0.25, 0.5, 0.75) if axis else (0.5,) for axis in long))))
    return grid[(grid != 0.5).any(axis=1)]
