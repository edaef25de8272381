"""Coverage of extremals by the cells of a block (brick), and where its sheets are torn or end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.hermite import binary_digits, interpolated
from perilune.atlas.store.cells import Cells, Nodes, Status, Whole, select_cells
from perilune.core import Matrix, Vector

_TORN, _SMALL = 0.5, 1e-3  # by how much an edge may differ from a trapezoid: of what its slopes say, and of 1 + |y|
_ALIKE = 1e-3  # relative: what a cell gives, and an extremal that it has
_AT_ONCE = 64  # places, each of which is compared with all cells
Extremal = tuple[int, Whole, Vector]  # its sheet, its place, and its unknowns
ANSWERING = (Status.ONE_STEP, Status.MORE_STEPS, Status.NO_ANSWER, Status.BREAKS)


def arrays_of(extremals: Sequence[Extremal]) -> tuple[Whole, Whole, Matrix]:
    """Return sheets, places and unknowns of extremals, in lanes."""
    sheet, place, y = zip(*extremals, strict=True) if extremals else ((), (), ())
    return np.array(sheet, dtype=np.int64), np.array(place, dtype=np.int64), np.array(y)


def torn_edges(nodes: Nodes, corners: Whole, size: Matrix) -> tuple[Whole, Whole, Whole]:
    """Find edges of cells whose ends do not fit together.

    Parameters
    ----------
    nodes, corners
        Nodes, and which of them are at the corners of cells, -1 for none, (cells, 2^d).
    size
        Of the cells, canonical, (cells, d).

    Returns
    -------
    cell, one, other
        Numbers of the cells and of the corners at both ends.
    """
    found = list[tuple[Whole, Whole, Whole]]()
    for axis in range(size.shape[1]):
        low = np.nonzero(binary_digits(size.shape[1])[:, axis] == 0)[0]
        cell, at = np.nonzero((corners[:, low] >= 0) & (corners[:, low | 1 << axis] >= 0))
        one, other = low[at], low[at] | 1 << axis
        ends = [nodes.rows("terms", corners[cell, corner]) for corner in (one, other)]
        y, slopes = ([end[:, term, :-1] for end in ends] for term in (0, 1 << axis))
        half = 0.5 * size[cell, axis, None]
        away = np.linalg.norm(y[1] - y[0] - half * (slopes[0] + slopes[1]), axis=1)
        said = np.linalg.norm(half * slopes[0], axis=1) + np.linalg.norm(half * slopes[1], axis=1)
        torn = away > _TORN * said + _SMALL * (1.0 + np.linalg.norm(y[0], axis=1))
        found.append((cell[torn], one[torn], other[torn]))
    cell, one, other = (np.concatenate(part) for part in zip(*found, strict=True))
    return cell, one, other


def ending_layers(corners: Whole, torn: Iterable[tuple[int, int]], ends: Iterable[int]) -> NDArray[np.bool_]:
    """Return a mask of the corners of a cell that lie on layers ending in it.

    Parameters
    ----------
    corners
        Nodes at its corners, -1 for none, (2^d,).
    torn
        Its edges that are torn, by the numbers of their corners.
    ends
        Corners from which an edge led nowhere.
    """
    found, left = np.zeros(len(corners), dtype=bool), list(ends)
    apart = {frozenset(edge) for edge in torn}
    while left:
        corner = left.pop()
        if not found[corner]:
            found[corner] = True
            beside = (corner ^ 1 << axis for axis in range(len(corners).bit_length() - 1))
            left += [other for other in beside if corners[other] >= 0 and frozenset((corner, other)) not in apart]
    return found


def covered_by_branches(
    cells: Cells, nodes: Nodes, step: Vector, branches: Sequence[int], places: Whole, y: Matrix
) -> NDArray[np.bool_]:
    """Return a mask of the extremals that cells of some branches give at places; `step` of the lattice, canonical.

    Parameters
    ----------
    cells, nodes
        Cells and nodes of the block.
    step
        Lattice step, canonical, (d,).
    branches
        The branches.
    places
        Places in lattice steps, (points, d).
    y
        Unknowns of the extremals, canonical, (points, n).
    """
    found = np.zeros(len(places), dtype=bool)
    own = np.isin(cells.branch, branches) & np.isin(cells.status, ANSWERING)
    numbers = np.nonzero(own & (cells.corners >= 0).all(axis=1))[0]
    low, high = cells.low[numbers].T, (cells.low + cells.size)[numbers].T
    for start in range(0, len(places) if len(numbers) else 0, _AT_ONCE):
        inside = np.ones((len(numbers), len(places[start : start + _AT_ONCE])), dtype=bool)
        for at, begin, end in zip(places[start : start + _AT_ONCE].T, low, high, strict=True):
            inside &= (begin[:, None] <= at) & (at <= end[:, None])
        cell, here = np.nonzero(inside)
        if not len(cell):
            continue
        cell, here = numbers[cell], start + here
        found[here[cells_reproduce(select_cells(cells, cell), nodes, step, places[here], y[here])]] = True
    return found


def cells_reproduce(cells: Cells, nodes: Nodes, step: Vector, places: Whole, y: Matrix) -> NDArray[np.bool_]:
    """Return True for each cell, complete with corners, that gives the extremal at its place (one place a cell).

    Parameters
    ----------
    cells, nodes
        Cells with all their corners, and the nodes of the block.
    step
        Lattice step, canonical, (d,).
    places
        A place for each cell, in lattice steps, (cells, d).
    y
        Unknowns of the extremal there, canonical, (cells, n).
    """
    share = (places - cells.low) / cells.size
    there = interpolated(nodes.rows("terms", cells.corners), share, cells.size * step)[:, :-1]
    with np.errstate(over="ignore", invalid="ignore"):  # near a fold slopes may be anything
        return np.linalg.norm(there - y, axis=1) <= _ALIKE * (1.0 + np.linalg.norm(y, axis=1))


def found_in_branches(
    cells: Cells,
    nodes: Nodes,
    step: Vector,
    keys: Callable[[Whole, Whole], Whole],
    alike: Callable[[int], Sequence[int]],
    extremals: Sequence[Extremal],
) -> NDArray[np.bool_]:
    """Return a mask of the extremals that branches have, as nodes or in their cells.

    Parameters
    ----------
    cells, nodes, step
        As of `covered_by_branches`.
    keys, alike
        Keys of nodes, by branches and places; the branches of which extremals of a sheet may be layers.
    extremals
        The extremals to look for: sheet, place and unknowns of each.
    """
    which, places, y = arrays_of(extremals)
    found = np.zeros(len(extremals), dtype=bool)
    for sheet in np.unique(which).tolist():
        branches, mine = alike(sheet), which == sheet
        for branch in branches:
            found[mine] |= nodes.has(keys(np.array(branch), places[mine]), y[mine])
        left = np.nonzero(mine & ~found)[0]
        found[left] = covered_by_branches(cells, nodes, step, branches, places[left], y[left])
    return found
