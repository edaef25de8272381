"""Continuation of branches across the user's bounds, by one on which the bound becomes active, or inactive.

An extremal beyond a bound is not admissible, nor is one held at a bound that it gains by leaving; the sheet in their
place may lie between all points at which the survey solved. At a crossing both sheets have one extremal in common, so
that the other is known in advance: it has one active bound more, or one less; it is on the side of folds on which J
curves upwards along the parameter that is held or let go; and it is a minimum if the first one is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.grid.nodes import Lattice
from perilune.atlas.hermite import binary_digits
from perilune.atlas.store.cells import Cells, Status, Whole
from perilune.charts import Borders, Chart, Extremals, Sheet
from perilune.core import Matrix, Vector
from perilune.problem import Nature

_MOST = 32  # sheets that may go on where one crosses bounds, if they are more than one bound away


def continuing_sheets(borders: Borders, sheet: Sheet, values: Vector, y: Vector) -> Iterator[Sheet]:
    """Yield the sheets that may continue one across bounds, and across further bounds in turn, nearest first.

    Parameters
    ----------
    borders, sheet
        Which sheet.
    values, y
        An extremal of it, canonical.

    Yields
    ------
    sheet
        What holds other bounds of one parameter or range of the user's, or of several, as long as these are few.
    """
    users, limits = np.nonzero(borders.users)[0].tolist(), borders.at(values[None])
    sides = {
        k: ["", *(side for side, bound in zip(("lower", "upper"), limits, strict=True) if np.isfinite(bound[0, k]))]
        for k in users
    }
    first = borders.holds([sheet], np.zeros(1, dtype=np.int64), values[None])
    choice = borders.chart.choice(values[None], first)
    told = 0
    for far in range(1, len(users) + 1):
        ways = [
            dict(zip(changed, way, strict=True))
            for changed in combinations(users, far)
            for way in product(*([s for s in sides[k] if s != sheet.holds.get(borders.names[k], "")] for k in changed))
        ]
        told += len(ways)
        if far > 1 and told > _MOST:
            return
        for way in ways:
            both = {**sheet.holds, **{borders.names[k]: side for k, side in way.items()}}
            holds = {name: side for name, side in both.items() if side}
            nature = Nature.LOCAL_OPTIMUM_AT_BOUND if holds else Nature.LOCAL_OPTIMUM
            if sheet.nature is Nature.UNPROVED:
                nature = Nature.UNPROVED
            held, let_go = [k for k, side in way.items() if side], [k for k, side in way.items() if not side]
            orientation = _orientation_across_bounds(borders.chart, values, y, choice, held, let_go)
            yield Sheet(holds=holds, orientation=orientation, nature=nature)


def _orientation_across_bounds(
    chart: Chart, values: Vector, y: Vector, choice: Matrix, held: list[int], let_go: list[int]
) -> float:
    """Return the sign of det(dh/dy) with other active bounds, where J curves upwards along released ones.

    J curves upwards along all of them if the determinant of its second derivatives has the sign of a minimum; this is
    the product of the curvatures as one after the other is released.
    """
    shooting, plan, lanes = chart.shooting, chart.shooting.plan, 1 + len(let_go)
    values, Y = values[None].repeat(lanes, axis=0), chart.whole(values[None], y[None]).repeat(lanes, axis=0)
    each, at = choice.repeat(lanes, axis=0), shooting.held_values(shooting.at(Y[:1], chart.p, choice))[0][0]
    each[:, held] = 1.0
    each[:, [plan.held + k for k in held]] = at[held]
    for number, k in enumerate(let_go, 1):
        each[number:, k] = 0.0
    roots = shooting.at(Y, chart.p, each)
    sign = float(chart.extremals_from(values, roots).orientation[-1])
    for number, k in enumerate(let_go, 1):
        if k < plan.free:
            curvature = shooting.curvature(roots[number], k)
        else:  # dJ/d(value) = -nu
            nu = chart.conditions.ranges[k - plan.free][1]
            curvature = -roots[number - 1].inverse[plan.active.searchsorted(nu), plan.held_rows[k]]
        sign *= float(np.sign(curvature))
    return sign


class _PlacesBeyondBounds(NamedTuple):
    """Places beyond bounds: of which sheet, its unknowns, bounds that it crossed, and sheets that were there before."""

    sheet: Whole
    place: Whole
    y: Matrix
    crossed: NDArray[np.bool_]
    been: NDArray[np.bool_]


class Crossings:
    """Continuation of sheets across bounds in one block.

    Parameters
    ----------
    lattice
        The extremals of the block.
    """

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice
        self._bounds = lattice.borders.bounds
        self._examined = np.empty(0, dtype=np.int64)  # ways that were looked at, from nodes to others
        self._lost = set[tuple[int, int]]()  # sheets and bounds behind which Newton's method led to nothing
        self._others = {
            (number, column): list(self._going_on(sheet, name, side))
            for number, sheet in enumerate(lattice.all_sheets) if sheet.minimum
            for column, (name, side) in enumerate(self._bounds)
        }  # fmt: skip

    def _going_on(self, sheet: Sheet, name: str, side: str) -> Iterator[int]:
        """Yield the sheets that continue one across a bound."""
        if sheet.holds.get(name) == side:
            holds = {other: its for other, its in sheet.holds.items() if other != name}
        else:
            holds = {**sheet.holds, name: side}
        for number, other in enumerate(self._lattice.all_sheets):
            if other.minimum and other.holds == holds:
                yield number

    def continuations(self, done: Cells) -> Iterator[tuple[int, Whole, Matrix]]:
        """Yield extremals that continue cells across bounds, sheet by sheet, for crossings since the last call.

        Parameters
        ----------
        done
            The cells that there are.

        Yields
        ------
        sheet, place, y
            Its number, and where it has which unknowns.
        """
        sheets, borders = self._lattice.all_sheets, self._lattice.borders
        reached = self._reached(done, *self._borders(done))
        while reached is not None:
            onward = list[_PlacesBeyondBounds]()
            for (sheet, column), others in self._others.items():
                if not len(here := np.nonzero(reached.crossed[:, column] & (reached.sheet == sheet))[0]):
                    continue
                found = np.zeros(len(here), dtype=bool)
                for other in others:
                    root, good, answers = self._solved(other, reached.place[here], reached.y[here])
                    found |= good
                    if answers.any():
                        yield other, reached.place[here[answers]], root.y[answers]
                    # Where two bounds are crossed at one place what holds one of them lies beyond the other.
                    if len(on := np.nonzero(good & ~answers & ~reached.been[here, other])[0]):
                        which, at = np.full(len(on), other), here[on]
                        crossed = borders.crossed(sheets, which, root.of(on))
                        been = reached.been[at] | (np.arange(len(sheets)) == other)
                        onward.append(_PlacesBeyondBounds(which, reached.place[at], root.y[on], crossed, been))
                if not found.all():
                    self._lost.add((sheet, column))
            rows = zip(*onward, strict=True)
            reached = _PlacesBeyondBounds(*(np.concatenate(parts) for parts in rows)) if onward else None

    def _borders(self, done: Cells) -> tuple[Whole, Whole, Whole]:
        """Return new cells across a border, with a corner within it and one beyond for each."""
        nodes = self._lattice.nodes
        cells = np.nonzero((done.status != Status.CUT) & self._lattice.minimum[done.branch])[0]
        corners = done.corners[cells]
        margins = np.where(corners >= 0, nodes.rows("margin", corners), np.nan)
        with np.errstate(invalid="ignore"):
            within, beyond = margins >= 0, margins < 0
        row, outside = np.nonzero(beyond & within.any(axis=1, keepdims=True))
        away = (binary_digits(self._lattice.d)[outside][:, None] != binary_digits(self._lattice.d)).sum(axis=2)
        inside = np.where(within[row], away, corners.shape[1]).argmin(axis=1)
        way, new = np.unique((corners[row, inside] << 32) + corners[row, outside], return_index=True)
        new = new[~np.isin(way, self._examined)]
        self._examined = np.union1d(self._examined, way)
        return cells[row[new]], inside[new], outside[new]

    def _reached(self, done: Cells, cell: Whole, inside: Whole, outside: Whole) -> _PlacesBeyondBounds | None:
        """Find extremals at the first places beyond bounds on the lines between corners of cells.

        Bisects on what cells give there; where Newton's method leads elsewhere, on what it leads to.
        """
        lattice, nodes, borders = self._lattice, self._lattice.nodes, self._lattice.borders
        first, branch = done.corners[cell, inside], done.branch[cell]
        whole: NDArray[np.bool_] = np.all(done.corners[cell] >= 0, axis=1)

        def given(ways: Whole, place: Whole) -> tuple[Matrix, NDArray[np.bool_]]:
            y, _ = nodes.extrapolate(first[ways], place, lattice.step)
            if (full := whole[ways]).any():
                y[full] = nodes.guesses(done, cell[ways[full]], place[full], lattice.step)[0]
            values = lattice.values(place)
            here = lattice.chart.at(values, y, borders.holds(lattice.sheets, branch[ways], values))
            return y, borders.crossed(lattice.sheets, branch[ways], here)

        def met(ways: Whole, place: Whole) -> tuple[Matrix, NDArray[np.bool_]]:
            y, crossed = given(ways, place)
            root, good = lattice.solve_near(branch[ways], place, y, np.full(len(ways), np.inf))
            beyond = borders.crossed(lattice.sheets, branch[ways], root)
            return np.where(good[:, None], root.y, y), np.where(good[:, None], beyond, crossed)

        near, far = nodes.rows("place", first), nodes.rows("place", done.corners[cell, outside])
        ways = np.arange(len(cell))
        if len(ways):
            ways = np.nonzero(given(ways, far)[1].any(axis=1))[0]  # or another border is crossed
        if not len(ways):
            return None
        begin, end = near[ways], far[ways]
        before, beyond = _bisect_to_bounds(given, ways, begin, end)
        early, (y, crossed) = met(ways, before)[1].any(axis=1), met(ways, beyond)
        if len(again := np.nonzero(early | ~crossed.any(axis=1))[0]):
            _, beyond[again] = _bisect_to_bounds(met, ways[again], begin[again], end[again])
            y[again], crossed[again] = met(ways[again], beyond[again])
        own = np.array(lattice.own)[branch[ways]]
        return _PlacesBeyondBounds(own, beyond, y, crossed, own[:, None] == np.arange(len(lattice.all_sheets)))

    def _solved(self, sheet: int, place: Whole, y: Matrix) -> tuple[Extremals, NDArray[np.bool_], NDArray[np.bool_]]:
        """Solve a sheet at places from extremals of others; return extremals, and masks of its own and of answers."""
        which, anywhere = np.full(len(place), sheet), np.full(len(place), np.inf)
        found, good = self._lattice.solve_near(which, place, y, anywhere)
        return found, good, good & (self._lattice.borders.margins_of(self._lattice.all_sheets, which, found) >= 0)

    def unanswered_cells(self, done: Cells) -> Whole:
        """Return the numbers of unanswered cells of sheets that crossed a bound behind which no sheet was found.

        An unknown answer there may be better.
        """
        cells = np.nonzero(done.status == Status.NO_ANSWER)[0]
        lost = [sheet for sheet, _ in self._lost]
        return cells[np.isin(np.array(self._lattice.own)[done.branch[cells]], lost)]


def _bisect_to_bounds(
    at: Callable[[Whole, Whole], tuple[Matrix, NDArray[np.bool_]]], lanes: Whole, near: Whole, far: Whole
) -> tuple[Whole, Whole]:
    """Bisect between places before and beyond bounds; return the last before and the first beyond."""
    while (apart := np.abs(far - near).max(axis=1, initial=0) > 1).any():
        middle = np.where(apart[:, None], (near + far) // 2, far)
        crossed = at(lanes, middle)[1].any(axis=1)
        far = np.where((apart & crossed)[:, None], middle, far)
        near = np.where((apart & ~crossed)[:, None], middle, near)
    return near, far
