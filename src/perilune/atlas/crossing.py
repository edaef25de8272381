"""Which sheet goes on where another crosses a bound of the user's: the one that is held there, or is let go.

An extremal beyond a bound is none, and one that is held where leaving the bound pays is none either; what is there in
their place may lie between all points at which the survey solved. At a crossing both sheets have one extremal in
common, so that what the other will be is known before it is met: it holds one bound more, or one less; it is on the
side of folds on which J curves upwards along what is held or let go; and it is a minimum if the first one is.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.cells import Cells, Status, Whole
from perilune.atlas.chart import Chart, Extremals
from perilune.atlas.hermite import bits
from perilune.atlas.lattice import Lattice
from perilune.atlas.sheets import Borders, Sheet
from perilune.problem.extremal import Nature
from perilune.words.types import Matrix, Vector


def beside(borders: Borders, sheet: Sheet, values: Vector, y: Vector) -> Iterator[Sheet]:
    """The sheets that go on where one crosses bounds; `values` and `y` are an extremal of it, canonical."""
    chart, limits = borders.chart, borders.at(values[None])
    first = borders.holds([sheet], np.zeros(1, dtype=np.int64), values[None])
    choice = chart.choice(values[None], first)
    for k in np.nonzero(borders.users)[0].tolist():
        name = borders.names[k]
        if name in sheet.holds:
            sides, holds = [""], {other: side for other, side in sheet.holds.items() if other != name}
        else:
            bounds = zip(("lower", "upper"), limits, strict=True)
            sides, holds = [side for side, bound in bounds if np.isfinite(bound[0, k])], dict(sheet.holds)
        if not sides:
            continue
        free, fixed = _orientations(chart, values, y, choice, k)
        nature = Nature.LOCAL_OPTIMUM_AT_BOUND if holds or any(sides) else Nature.LOCAL_OPTIMUM
        if sheet.nature is Nature.UNPROVED:
            nature = Nature.UNPROVED
        for side in sides:
            more = {**holds, name: side} if side else holds
            yield Sheet(holds=more, orientation=fixed if side else free, nature=nature)


def _orientations(chart: Chart, values: Vector, y: Vector, choice: Matrix, k: int) -> tuple[float, float]:
    """Sign of det(dh/dy) where what can be held is free, on the side on which J curves upwards along it, and held."""
    shooting, plan = chart.shooting, chart.shooting.plan
    values, Y = values[None].repeat(2, axis=0), chart.whole(values[None], y[None]).repeat(2, axis=0)
    both = choice.repeat(2, axis=0)
    both[:, k] = 0.0, 1.0
    both[1, plan.held + k] = shooting.held_values(shooting.at(Y[:1], chart.p, choice))[0][0, k]
    roots = shooting.at(Y, chart.p, both)
    if k < plan.free:
        curvature = shooting.curvature(roots[0], k)
    else:  # dJ/d(value) = -nu
        nu = chart.conditions.ranges[k - plan.free][1]
        curvature = -roots[1].inverse[plan.active.searchsorted(nu), plan.held_rows[k]]
    free, fixed = chart.told_of(values, roots).orientation.tolist()
    return free * float(np.sign(curvature)), fixed


class Crossings:
    """Where sheets go on across bounds in one brick.

    Parameters
    ----------
    lattice
        Its extremals.
    """

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice
        self._bounds = lattice.borders.bounds
        self._seen = np.zeros(0, dtype=bool)  # nodes that were looked at
        self._lost = set[tuple[int, int]]()  # sheets and bounds behind which Newton's method led to nothing
        self._others = {
            (number, column): list(self._going_on(sheet, name, side))
            for number, sheet in enumerate(lattice.all_sheets) if sheet.minimum
            for column, (name, side) in enumerate(self._bounds)
        }  # fmt: skip

    def _going_on(self, sheet: Sheet, name: str, side: str) -> Iterator[int]:
        """The sheets that go on where one crosses a bound."""
        if sheet.holds.get(name) == side:
            holds = {other: its for other, its in sheet.holds.items() if other != name}
        else:
            holds = {**sheet.holds, name: side}
        for number, other in enumerate(self._lattice.all_sheets):
            if other.minimum and other.holds == holds:
                yield number

    def met(self, done: Cells) -> Iterator[tuple[int, Whole, Matrix]]:
        """Extremals that go on where cells have crossed bounds since this was asked, sheet by sheet.

        Parameters
        ----------
        done
            The cells that there are.

        Yields
        ------
        sheet, place, y
            Its number, and where it has which unknowns.
        """
        cell, inside, outside = self._borders(done)
        if not len(cell):
            return
        place, y, crossed = self._crossing(done, cell, inside, outside)
        own = np.array(self._lattice.own)[done.branch[cell]]
        for (sheet, column), others in self._others.items():
            here = np.nonzero(crossed[:, column] & (own == sheet))[0]
            if not len(here):
                continue
            found = np.zeros(len(here), dtype=bool)
            for other in others:
                root, good, answers = self._solved(other, place[here], y[here])
                found |= good
                if answers.any():
                    yield other, place[here[answers]], root.y[answers]
            if not found.all():
                self._lost.add((sheet, column))

    def _borders(self, done: Cells) -> tuple[Whole, Whole, Whole]:
        """Cells across a border, and of each a corner within it and one beyond, of those that were not looked at."""
        nodes = self._lattice.nodes
        cells = np.nonzero((done.status != Status.CUT) & self._lattice.minimum[done.branch])[0]
        corners = done.corners[cells]
        margins = np.where(corners >= 0, nodes.rows("margin", corners), np.nan)
        with np.errstate(invalid="ignore"):
            within, beyond = margins >= 0, margins < 0
        row, outside = np.nonzero(beyond & within.any(axis=1, keepdims=True))
        away = (bits(self._lattice.d)[outside][:, None] != bits(self._lattice.d)).sum(axis=2)
        inside = np.where(within[row], away, corners.shape[1]).argmin(axis=1)
        self._seen = np.append(self._seen, np.zeros(nodes.count - len(self._seen), dtype=bool))
        new = np.nonzero(~self._seen[corners[row, outside]])[0]
        new = new[np.unique(corners[row, outside][new], return_index=True)[1]]
        self._seen[corners[row, outside][new]] = True
        return cells[row[new]], inside[new], outside[new]

    def _crossing(
        self, done: Cells, cell: Whole, inside: Whole, outside: Whole
    ) -> tuple[Whole, Matrix, NDArray[np.bool_]]:
        """The first places beyond bounds on the ways from corners of cells to others, what there is, and which bounds.

        By halves: what a cell gives is as near its sheet as no step of the lattice is long.
        """
        lattice, nodes = self._lattice, self._lattice.nodes
        first = done.corners[cell, inside]
        near, far = nodes.rows("place", first), nodes.rows("place", done.corners[cell, outside])
        whole, branch = (done.corners[cell] >= 0).all(axis=1), done.branch[cell]

        def at(place: Whole) -> tuple[Matrix, NDArray[np.bool_]]:
            y, _ = nodes.along_slopes(first, place, lattice.step)
            if whole.any():
                y[whole] = nodes.guesses(done, cell[whole], place[whole], lattice.step)[0]
            values = lattice.values(place)
            here = lattice.chart.at(values, y, lattice.borders.holds(lattice.sheets, branch, values))
            return y, lattice.borders.crossed(lattice.sheets, branch, here)

        ends = at(far)[1].any(axis=1)  # or another border is crossed
        while (apart := ends & (np.abs(far - near).max(axis=1) > 1)).any():
            middle = np.where(apart[:, None], (near + far) // 2, far)
            crossed = at(middle)[1].any(axis=1)
            far = np.where((apart & crossed)[:, None], middle, far)
            near = np.where((apart & ~crossed)[:, None], middle, near)
        return far, *at(far)

    def _solved(self, sheet: int, place: Whole, y: Matrix) -> tuple[Extremals, NDArray[np.bool_], NDArray[np.bool_]]:
        """What there is of a sheet at places, from extremals of others, whether it is of it, and may be an answer."""
        which, anywhere = np.full(len(place), sheet), np.full(len(place), np.inf)
        found, good = self._lattice.led(which, place, y, anywhere)
        return found, good, good & (self._lattice.borders.margins_of(self._lattice.all_sheets, which, found) >= 0)

    def untold(self, done: Cells) -> Whole:
        """Numbers of cells without an answer of sheets that have crossed a bound behind which none was found.

        There an answer may be better that is not known.
        """
        cells = np.nonzero(done.status == Status.NO_ANSWER)[0]
        lost = [sheet for sheet, _ in self._lost]
        return cells[np.isin(np.array(self._lattice.own)[done.branch[cells]], lost)]
