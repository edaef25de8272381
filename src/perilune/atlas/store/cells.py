"""Content of a block (brick): nodes at places of its lattice, and cells with nodes at their corners.

A solution branch over the whole region is called a *sheet* here and on disk; *branches* are the parts of a sheet within
one block, each with cells of its own, where it comes to one place with several extremals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.hermite import binary_digits, interpolated
from perilune.charts import same_unknowns
from perilune.core import Matrix, Vector

WHOLE = 2**12  # lattice steps along an edge of a block
_CLEARLY = 1.5  # times as far below zero as it differs at the corners and in the middle of a cell
_ENDING = {1: 2**6, 2: 2**7}  # the shortest edge of a cell in which a sheet ends, by axes; of more 2**8

Whole = NDArray[np.int64]


def shortest_ending_edge(d: int) -> int:
    """Return the shortest edge of a cell in which a sheet ends, for d axes; with each the border has more cells."""
    return _ENDING.get(d, 2**8)


class Status(IntEnum):
    """Status of a cell."""

    CUT = 0  # its children are what counts
    ONE_STEP = 1  # answers by one step of Newton's method
    MORE_STEPS = 2  # answers, but at the least size a step is not enough
    ENDS = 3  # the sheet ends inside
    NO_ANSWER = 4  # its extremals lie beyond a bound, or gain by leaving one
    BREAKS = 5  # its extremals break the path
    ABSENT = 6  # the branch does not come here: no corner has it, and none of the nodes around
    TORN = 7  # its corners lie on different layers of its sheet


@dataclass(frozen=True, kw_only=True)
class Cells:
    """Cells of all branches of a block; the first of each branch is the whole block.

    Attributes
    ----------
    branch
        Branch of each cell, (cells,).
    low, size
        Low corner and lengths, in lattice steps, (cells, d).
    corners
        Nodes at its corners, -1 where there is none, (cells, 2^d).
    axis, child
        Along which axis it was cut, -1 for none; the first of its two children, which follow each other.
    status
        `Status`.
    """

    branch: Whole
    low: Whole
    size: Whole
    corners: Whole
    axis: Whole
    child: Whole
    status: Whole

    def __len__(self) -> int:
        return len(self.branch)

    def box(self, number: int) -> tuple[int, ...]:
        """Return the identity of a cell: its branch, and its box."""
        return (int(self.branch[number]), *self.low[number].tolist(), *self.size[number].tolist())


@dataclass(frozen=True, kw_only=True)
class Cut:
    """Brick that was cut.

    Attributes
    ----------
    nodes
        Of each node its ``branch``, its ``place`` in the lattice (nodes, d), values and derivatives ``terms``
        (nodes, 2^d, n + 1), by how much it is an answer (``margin``), the step that Newton's method would make
        there (``length``), and of its independent re-integration ``sequence``, ``residual``, ``path``, ``minimum`` and
        ``drift``.
    cells
        Its cells.
    own
        The number of the sheet of each branch; the first branch of a sheet has the number of the sheet.
    """

    nodes: dict[str, NDArray[Any]]
    cells: Cells
    own: tuple[int, ...]


class Nodes:
    """Nodes of a block; a node is identified by its branch and its place."""

    def __init__(self) -> None:
        self.known: dict[int, int] = {}
        self.parts: dict[str, list[NDArray[Any]]] = {}
        self._rows: dict[str, NDArray[Any]] = {
            name: np.empty(0) for name in ("terms", "margin", "sequence", "path", "branch", "place")
        }
        self.count: int = 0
        self.run_into: Whole = np.empty(0, dtype=np.int64)  # those where a later branch has run into another

    def add(self, keys: Whole, **columns: NDArray[Any]) -> None:
        """Add nodes by their keys."""
        new = len(keys)
        self.known |= dict(zip(keys.tolist(), range(self.count, self.count + new), strict=True))
        for name, rows in columns.items():
            self.parts.setdefault(name, []).append(rows)
        for name, before in self._rows.items():
            if len(before) < self.count + new:  # room is doubled, so that it is seldom made
                more = np.empty((2 * (self.count + new), *columns[name].shape[1:]), dtype=columns[name].dtype)
                more[: self.count] = before[: self.count] if self.count else 0
                self._rows[name] = before = more
            before[self.count : self.count + new] = columns[name]
        self.count += new

    def forget(self, key: Whole) -> None:
        """Remove a node that is not of its branch from its place; no branch goes on from it."""
        if (number := self.known.pop(int(key), None)) is not None:
            self.run_into = np.append(self.run_into, number)

    def numbers(self, keys: Whole) -> Whole:
        """Return the numbers of nodes by their keys, -1 for missing ones; shape of `keys`."""
        numbers = map(self.known.get, keys.ravel().tolist(), repeat(-1))
        return np.fromiter(numbers, np.int64, keys.size).reshape(keys.shape)

    def at(self, key: Whole) -> Vector | None:
        """Return the unknowns of one node, None for a missing one."""
        number = self.known.get(int(key))
        return None if number is None else self._rows["terms"][number, 0, :-1]

    def has(self, keys: Whole, y: Matrix, before: int | None = None) -> NDArray[np.bool_]:
        """Return True where nodes, all or only the first `before`, hold these extremals.

        Parameters
        ----------
        keys
            Keys of the nodes, (lanes,).
        y
            Unknowns of the extremals, canonical, (lanes, n).
        before
            Number of first nodes to compare with; None for all.
        """
        numbers = self.numbers(keys)
        found = (numbers >= 0) & (numbers < (self.count if before is None else before))
        found[found] = same_unknowns(self.rows("terms", numbers[found])[:, 0, :-1], y[found])
        return found

    def rows(self, name: str, numbers: Whole) -> NDArray[Any]:
        """Return a column of nodes.

        Parameters
        ----------
        name
            Name of the column.
        numbers
            Numbers of the nodes, of any shape.
        """
        return self._rows[name][numbers]

    def extrapolate(self, numbers: Whole, places: Whole, step: Vector) -> tuple[Matrix, Vector]:
        """Extrapolate unknowns to places along the slopes of nodes; returns also their change; `step` is canonical.

        Parameters
        ----------
        numbers
            Nodes from which to extrapolate, (lanes,).
        places
            Places in lattice steps, (lanes, d).
        step
            Lattice step, canonical, (d,).
        """
        terms, move = self.rows("terms", numbers), (places - self.rows("place", numbers)) * step
        guess = terms[:, 0, :-1] + sum(move[:, [i]] * terms[:, 1 << i, :-1] for i in range(len(step)))
        return guess, np.linalg.norm(guess - terms[:, 0, :-1], axis=1)

    def guesses(self, cells: Cells, cell: Whole, places: Whole, step: Vector) -> tuple[Matrix, Vector]:
        """Return y and its change at places of cells: interpolated from all corners, or along slopes of the nearest.

        Parameters
        ----------
        cells, cell
            Cells, and the number of one for each lane, (lanes,).
        places
            Places in lattice steps, (lanes, d).
        step
            Lattice step, canonical, (d,).
        """
        corners, size = cells.corners[cell], cells.size[cell] * step
        at = (places - cells.low[cell]) / cells.size[cell]
        away = np.abs(at[:, None] - binary_digits(len(step))[None]).sum(axis=2)
        nearest = np.where(corners >= 0, away, np.inf).argmin(axis=1)
        guess, spread = self.extrapolate(corners[np.arange(len(cell)), nearest], places, step)
        full = (corners >= 0).all(axis=1)
        if full.any():
            terms = self.rows("terms", corners[full])
            guess[full] = interpolated(terms, at[full], size[full])[:, :-1]
            spread[full] = np.linalg.norm(np.ptp(terms[:, :, 0, :-1], axis=1), axis=1)
        return guess, spread

    def nearest(self, some: Whole, place: Whole) -> int:
        """Return the number of the node, of some, that is nearest to a place.

        Parameters
        ----------
        some
            Numbers of the nodes, (k,).
        place
            Place in lattice steps, (d,).
        """
        return int(some[np.abs(self.rows("place", some) - place).sum(axis=1).argmin()])

    def nearest_continuable(self, branch: int, places: Whole, reach: int) -> Whole:
        """Return the node nearest to each place, (lanes,), from which a branch can go on; -1 with none within reach.

        Parameters
        ----------
        branch
            Number of the branch.
        places
            Places in lattice steps, (lanes, d).
        reach
            Greatest distance along any axis [lattice steps].
        """
        goes_on = (self._rows["branch"][: self.count] == branch) & (self._rows["margin"][: self.count] >= 0)
        goes_on[self.run_into] = False
        numbers = np.nonzero(goes_on)[0]
        if not len(numbers):
            return np.full(len(places), -1)
        there, found = self.rows("place", numbers), np.empty(len(places), dtype=np.int64)
        for i, place in enumerate(places):
            away = np.abs(there - place)
            far = np.where(away.max(axis=1) <= reach, away.sum(axis=1), WHOLE * len(place))
            found[i] = numbers[far.argmin()] if far.min() < WHOLE * len(place) else -1
        return found

    def within(self, branch: int, low: Whole, high: Whole, first: int) -> Whole:
        """Return the nodes of a branch, from number `first` on, in a box or on its border from which it goes on.

        Beyond the border of its sheet it may turn back, and does not go on.

        Parameters
        ----------
        branch
            Number of the branch.
        low, high
            Corners of the box in lattice steps, (d,).
        first
            Number of the first node that counts.
        """
        here = slice(first, self.count)
        place = self._rows["place"][here]
        inside = (self._rows["branch"][here] == branch) & (self._rows["margin"][here] >= 0)
        inside &= ((place >= low) & (place <= high)).all(axis=1)
        found = first + np.nonzero(inside)[0]
        return found[~np.isin(found, self.run_into)] if len(self.run_into) else found


def clearly_below(rows: Matrix, slack: float) -> NDArray[np.bool_]:
    """Return True for cells whose values, (cells, places), are all below zero by more than they vary.

    Parameters
    ----------
    rows
        Values at places of cells, (cells, places), that should not be below zero.
    slack
        Tolerated violation.
    """
    most, least = rows.max(axis=1), rows.min(axis=1)
    with np.errstate(invalid="ignore"):  # where nothing limits them
        return most < -_CLEARLY * (most - least) - slack


def halved_at(low: Whole, axis: Whole, child: Whole) -> Whole:
    """Return the places at which cells are split, in lattice steps along their axis; arbitrary for uncut cells.

    Parameters
    ----------
    low
        Low corners in lattice steps, (cells, d).
    axis, child
        Axis along which each cell was cut, and the first of its children; -1 for uncut cells, (cells,).
    """
    second = np.where(child >= 0, child + 1, 0)
    return np.take_along_axis(low[second], np.maximum(axis, 0)[:, None], axis=1)[:, 0]


def leaves(axis: Whole, child: Whole, split: Whole, root: int, places: Matrix) -> Whole:
    """Return the leaf cells below one in which places lie, (points,).

    Parameters
    ----------
    axis, child, split
        Of each cell: axis along which it was cut, first child, place of the cut in lattice steps, (cells,).
    root
        Number of the cell at which the search begins.
    places
        Places in lattice steps, (points, d).
    """
    cell = np.full(len(places), root)
    while (going := np.nonzero(child[cell] >= 0)[0]).size:
        here = cell[going]
        cell[going] = child[here] + (places[going, axis[here]] >= split[here])
    return cell


def leaves_of(cells: Cells, branch: int, places: Whole) -> Whole:
    """Return the leaf cells of a branch in which places lie, -1 where it has none.

    Parameters
    ----------
    cells, branch
        The cells of a block, and a branch.
    places
        Places in lattice steps, (points, d).
    """
    root = np.nonzero((cells.size == WHOLE).all(axis=1) & (cells.branch == branch))[0]
    if not len(root):
        return np.full(len(places), -1)
    split = halved_at(cells.low, cells.axis, cells.child)
    return leaves(cells.axis, cells.child, split, int(root[0]), places.astype(float))


def concatenate_cells(waves: Sequence[Cells]) -> Cells:
    """Concatenate cells."""
    return Cells(**{f.name: np.concatenate([getattr(w, f.name) for w in waves]) for f in fields(Cells)})


def select_cells(cells: Cells, which: NDArray[np.bool_] | NDArray[np.intp]) -> Cells:
    """Return some of the cells.

    Parameters
    ----------
    cells
        Cells of a block.
    which
        Mask of the cells, (cells,), or their numbers.
    """
    return Cells(**{f.name: getattr(cells, f.name)[which] for f in fields(Cells)})
