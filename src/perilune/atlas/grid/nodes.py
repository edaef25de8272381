"""Nodes of a block (brick): extremals by Newton's method at the places of its lattice, and cells between them.

An extremal is a node, identified by its branch and its place. A root belongs to a branch if it is near the guess that
led to it, and on the branch's side of folds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.hermite import binary_digits, corner_terms, interpolated, scaled_third_derivatives
from perilune.atlas.store.cell_coverage import Extremal, found_in_branches
from perilune.atlas.store.cells import WHOLE, Cells, Cut, Nodes, Whole, select_cells
from perilune.charts import Borders, Chart, ChartReintegration, Extremals, Holds, Sheet, follow_sheets
from perilune.core import Matrix, Vector

_SEEN = ("residual", "path", "minimum", "drift")  # of independent re-integrations: columns of nodes
_BITS = 13  # of a place along one axis, so that 4 of them and a branch make one number
_APART, _NEAR = 0.5, 1e-3  # how far a root may lie from what led to it: of what the corners differ by, and of 1 + |y|
_STRIDE = 2.0**-3  # of an edge of a cell: the shortest step of a walk along it
_ASTRAY = 1.5  # times as far Newton's method may lead on the way: from farther it does not come back
_MOST = 16  # evaluations for a new corner


class Lattice:
    """Nodes of all branches in one box of the region.

    Parameters
    ----------
    chart, borders, reflights, sheets
        What is mapped, and what flies it a second time.
    low, high
        Corners of the box, canonical.
    before
        What is known already.
    """

    def __init__(
        self,
        chart: Chart,
        borders: Borders,
        reflights: ChartReintegration,
        sheets: Sequence[Sheet],
        low: Vector,
        high: Vector,
        before: Cut | None,
    ) -> None:
        self.chart: Chart = chart
        self.borders: Borders = borders
        self.reflights: ChartReintegration = reflights
        self.all_sheets: Sequence[Sheet] = sheets
        self.origin: Vector = low
        self.step: Vector = (high - low) / WHOLE
        self.d: int = len(low)
        self.nodes: Nodes = Nodes()
        self.own: list[int] = list(range(len(sheets)))
        self._walked = set[tuple[int, int]]()  # from which node to where
        if before is not None:
            self.nodes.add(self.keys(before.nodes["branch"], before.nodes["place"]), **before.nodes)
            self.own = list(before.own)
        self._update_branches()

    # -- branches -------------------------------------------------------------------------------------------------

    def _update_branches(self) -> None:
        """Update the sheet, side of folds and minimality of each branch."""
        self.sheets: list[Sheet] = [self.all_sheets[number] for number in self.own]
        self.orientations: Vector = np.array([sheet.orientation for sheet in self.sheets])
        self.minimum: NDArray[np.bool_] = np.array([sheet.minimum for sheet in self.sheets])

    def another_branch(self, sheet: int) -> int:
        """Add a branch of a sheet and return its number."""
        self.own.append(sheet)
        self._update_branches()
        return len(self.own) - 1

    def alike(self, sheet: int) -> list[int]:
        """Return the branches with the active bounds of a sheet, on the same side of folds."""
        mine = self.all_sheets[sheet]
        return [branch for branch, sheet in enumerate(self.sheets) if sheet.alike(mine)]

    def had(self, cells: Cells, some: Sequence[Extremal]) -> NDArray[np.bool_]:
        """Return a mask of the extremals that branches have, as nodes or in their cells.

        Parameters
        ----------
        cells
            All cells of the branches.
        some
            Extremals: sheet, place in lattice steps, and unknowns of each.

        Returns
        -------
        NDArray[np.bool_]
            (extremals,).
        """
        return found_in_branches(cells, self.nodes, self.step, self.keys, self.alike, some)

    # -- cells ----------------------------------------------------------------------------------------------------

    def halves(self, cells: Cells, axis: Whole) -> Cells:
        """Return both halves of cells, one after the other.

        Parameters
        ----------
        cells
            Cells of the block.
        axis
            Axis along which each is cut, (cells,).

        Returns
        -------
        Cells
            2 cells in place of each, with the nodes at their corners.
        """
        count = np.arange(len(cells))
        size, far = cells.size.copy(), cells.low.copy()
        size[count, axis] //= 2
        far[count, axis] += size[count, axis]
        low = np.stack([cells.low, far], axis=1).reshape(-1, self.d)
        return self._cells(np.repeat(cells.branch, 2), low, np.repeat(size, 2, axis=0))

    def wholes(self, branch: Whole) -> Cells:
        """Return the whole block as a cell of each branch."""
        return self._cells(
            branch, np.zeros((len(branch), self.d), dtype=np.int64), np.full((len(branch), self.d), WHOLE)
        )

    def _cells(self, branch: Whole, low: Whole, size: Whole) -> Cells:
        none = np.full(len(branch), -1)
        corners = self.corners(branch, low, size)
        return Cells(branch=branch, low=low, size=size, corners=corners, axis=none, child=none, status=none)

    def filled(self, cells: Cells, wholes: Cells | None = None, near: Sequence[Whole] | None = None) -> Cells:
        """Solve missing corners of cells from the corners of the cells that they halve, or their own.

        `near` are nodes of each cell to begin with in place of corners.

        Parameters
        ----------
        cells
            Cells whose corners may be missing.
        wholes
            Cells of which they are the halves, in order; None to begin at their own corners.
        near
            Nodes of each cell to begin with in place of corners.
        """
        lacking = cells.corners < 0
        if wholes is None and near is None:  # where there is no corner at all the sheet comes in from nodes around
            lacking &= ~lacking.all(axis=1, keepdims=True)
        cell, corner = np.nonzero(lacking)
        if not len(cell):
            return cells
        places = cells.low[cell] + binary_digits(self.d)[corner] * cells.size[cell]
        keys = self.keys(cells.branch[cell], places)
        if wholes is not None or near is not None:
            keys, once = np.unique(keys, return_index=True)
            cell, places = cell[once], places[once]
        if near is not None:
            begin = [self.nodes.nearest(near[i], at) for i, at in zip(cell.tolist(), places, strict=True)]
            guess, spread = self.nodes.extrapolate(np.array(begin), places, self.step)
        elif wholes is not None:
            guess, spread = self.nodes.guesses(wholes, cell // 2, places, self.step)
        else:
            guess, spread = self.nodes.guesses(cells, cell, places, self.step)
        waiting = np.arange(len(keys))
        while len(waiting):  # from one cell there may be a way to a place, and from another none
            once = waiting[np.unique(keys[waiting], return_index=True)[1]]
            self.solved(cells.branch[cell[once]], places[once], guess[once], spread[once])
            waiting = np.setdiff1d(waiting, once)
            waiting = waiting[self.nodes.numbers(keys[waiting]) < 0]
        return replace(cells, corners=self.corners(cells.branch, cells.low, cells.size))

    def walked_on(self, cells: Cells) -> Cells:
        """Solve missing corners of cells by continuation from the nearest corner with an answer.

        A sheet that bends more from one to the next than its slopes predict does not end there.
        """
        sound = (
            (cells.corners >= 0) & self.minimum[cells.branch][:, None] & ~np.isin(cells.corners, self.nodes.run_into)
        )
        sound &= self.nodes.rows("margin", cells.corners) >= 0
        cell, corner = np.nonzero((cells.corners < 0) & sound.any(axis=1, keepdims=True))
        if not len(cell):
            return cells
        away = np.where(
            sound[cell], (binary_digits(self.d)[corner][:, None] != binary_digits(self.d)).sum(axis=2), self.d + 1
        )
        begin, far = cells.corners[cell, away.argmin(axis=1)], away.min(axis=1)
        branch, places = cells.branch[cell], cells.low[cell] + binary_digits(self.d)[corner] * cells.size[cell]
        keys, order = self.keys(branch, places), np.argsort(far, kind="stable")
        once = order[np.unique(keys[order], return_index=True)[1]]
        walks = list(zip(begin[once].tolist(), keys[once].tolist(), strict=True))
        once = once[[walk not in self._walked for walk in walks]]
        self._walked.update(walks)
        if not len(once):
            return cells
        begin, branch, places = begin[once], branch[once], places[once]
        starts, y = self.values(self.nodes.rows("place", begin)), self.nodes.rows("terms", begin)[:, 0, :-1]
        here, share = follow_sheets(
            self.chart, self.borders, self.sheets, branch, starts, y, self.values(places), _STRIDE, _NEAR, _ASTRAY
        )
        there = np.nonzero((share == 1.0) & ~self._of_another(branch, places, here))[0]
        self.solved(branch[there], places[there], here[there], np.full(len(there), np.inf))
        return replace(cells, corners=self.corners(cells.branch, cells.low, cells.size))

    def _of_another(self, branch: Whole, places: Whole, y: Matrix) -> NDArray[np.bool_]:
        """Return True where a later branch reaches a node of another, beyond which it would only repeat that one."""
        found = np.zeros(len(branch), dtype=bool)
        for own in np.unique(branch[branch >= len(self.all_sheets)]).tolist():
            mine = np.nonzero(branch == own)[0]
            for other in (other for other in self.alike(self.own[own]) if other != own):
                found[mine] |= self.nodes.has(self.keys(np.array(other), places[mine]), y[mine])
        return found

    # -- nodes ----------------------------------------------------------------------------------------------------

    def solve_near(
        self, branch: Whole, places: Whole, guess: Matrix, spread: Vector
    ) -> tuple[Extremals, NDArray[np.bool_]]:
        """Solve by Newton's method at places; return the extremals, and True for those of their branch.

        Parameters
        ----------
        branch
            Branch of each lane, (lanes,).
        places
            Places in lattice steps, (lanes, d).
        guess
            Unknowns to begin with, canonical, (lanes, n).
        spread
            Length of the move that the slopes predict, canonical, (lanes,); a larger one leaves the branch.
        """
        values = self.values(places)
        holds = self.borders.holds(self.sheets, branch, values)
        within = _APART * spread + _NEAR * (1.0 + np.linalg.norm(guess, axis=1))
        found = self.chart.solve(values, guess, holds, limit=_MOST, reach=_ASTRAY * within)
        with np.errstate(invalid="ignore", over="ignore"):  # of what is lost
            moved = np.linalg.norm(found.y - guess, axis=1)
        return found, found.converged & (found.orientation == self.orientations[branch]) & (moved <= within)

    def solved(self, branch: Whole, places: Whole, guess: Matrix, spread: Vector) -> None:
        """Solve by Newton's method at places, and add the extremals of their branch to the nodes.

        Parameters
        ----------
        branch
            Branch of each lane, (lanes,).
        places
            Places in lattice steps, (lanes, d).
        guess
            Unknowns to begin with, canonical, (lanes, n).
        spread
            As of `solve_near`.
        """
        if not len(branch):
            return
        found, good = self.solve_near(branch, places, guess, spread)
        if not good.any():
            return
        here, branch, places = found.of(np.nonzero(good)[0]), branch[good], places[good]
        flown = self.reflights.finer(here.roots.y, self.chart.p[None], here.roots.choice)
        seen = flown.margins

        def held(values: Matrix) -> Holds:
            return self.borders.holds(self.sheets, branch.repeat(len(values) // len(branch)), values)

        self.nodes.add(
            self.keys(branch, places),
            branch=branch,
            place=places,
            terms=corner_terms(
                self.chart,
                here,
                lambda values: self.borders.holds(self.sheets, branch.repeat(len(values) // len(branch)), values),
            ),
            margin=np.minimum(self.borders.margins_of(self.sheets, branch, here), seen.least_multiplier),
            length=here.length,
            sequence=flown.sequence,
            **{name: getattr(seen, name) for name in _SEEN},
        )

    def corners(self, branch: Whole, low: Whole, size: Whole) -> Whole:
        """Return the nodes at the corners of cells, -1 for missing ones.

        Parameters
        ----------
        branch
            Branch of each cell, (cells,).
        low, size
            Low corner and lengths in lattice steps, (cells, d).

        Returns
        -------
        Whole
            (cells, 2^d).
        """
        return self.nodes.numbers(
            self.keys(branch[:, None], low[:, None] + binary_digits(self.d)[None] * size[:, None])
        )

    def values(self, places: Whole) -> Matrix:
        """Return the values of the parameters at places, canonical."""
        return self.origin + places * self.step

    def keys(self, branch: Whole, places: Whole) -> Whole:
        """Return the keys of nodes, given their branches and places.

        Parameters
        ----------
        branch
            Branch of each node, (...).
        places
            Places in lattice steps, (..., d).
        """
        return (branch << _BITS * self.d) + (places << _BITS * np.arange(self.d)).sum(axis=-1)


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
    if len(lane):  # most are decided without a step, which takes as long again
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
    """Return the least path condition of what cells give at their middle, after a step of Newton's method.

    Parameters
    ----------
    lattice
        Nodes of the block.
    cells
        Cells with all their corners.

    Returns
    -------
    Vector
        Canonical, (cells,); below zero where a condition is violated.
    """
    if not len(cells):
        return np.empty(0)
    chart = lattice.chart
    values, _, holds, first = _interpolated_and_solved(lattice, cells, np.full(cells.size.shape, 0.5))
    return lattice.reflights(
        chart.whole(values, first.stepped), chart.p[None], chart.choice(values, holds)
    ).margins.path


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
