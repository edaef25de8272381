"""Branches: layers of one sheet that lie over one another.

Around a cusp a sheet turns from one layer into another without a fold, so that it comes to one place with several
extremals. A branch has one extremal at a place, as cells need it. Where the corners of a cell lie on different layers,
extremals at its corners do not fit together along its edges: what each of them leads to at the other end of such an
edge begins a branch, unless there is one that has it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.cells import Cells, Nodes, Status, Whole
from perilune.atlas.hermite import bits, interpolated
from perilune.words.types import Matrix, Vector

_TORN, _SMALL = 0.5, 1e-3  # by how much an edge may differ from a trapezoid: of what its slopes say, and of 1 + |y|
_ALIKE = 1e-3  # relative: what a cell gives, and an extremal that it has
SAME = 1e-6  # relative: one extremal

_ANSWERING = (Status.ONE_STEP, Status.MORE_STEPS, Status.NO_ANSWER, Status.BREAKS)


def torn_edges(nodes: Nodes, corners: Whole, size: Matrix) -> tuple[Whole, Whole, Whole]:
    """Edges of cells whose ends do not fit together.

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
        low = np.nonzero(bits(size.shape[1])[:, axis] == 0)[0]
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


def covered(
    cells: Cells, nodes: Nodes, step: Vector, branches: Sequence[int], places: Whole, y: Matrix
) -> NDArray[np.bool_]:
    """Which extremals at places the cells of some branches have; `step` is that of the lattice, canonical."""
    found = np.zeros(len(places), dtype=bool)
    own = np.isin(cells.branch, branches) & np.isin(cells.status, _ANSWERING)
    for number in np.nonzero(own & (cells.corners >= 0).all(axis=1))[0].tolist() if len(places) else ():
        low, size = cells.low[number], cells.size[number]
        here = np.nonzero(~found & ((places >= low) & (places <= low + size)).all(axis=1))[0]
        if len(here):
            terms = nodes.rows("terms", np.broadcast_to(cells.corners[number], (len(here), cells.corners.shape[1])))
            share, length = (places[here] - low) / size, np.broadcast_to(size * step, (len(here), len(step)))
            given = interpolated(terms, share, length)[:, :-1]
            away = np.linalg.norm(given - y[here], axis=1)
            found[here] = away <= _ALIKE * (1.0 + np.linalg.norm(y[here], axis=1))
    return found
