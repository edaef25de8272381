"""A brick: one box of the region, each sheet in it cut into cells until every cell answers from its corners.

A cell is cut in two where Newton's method, from what its corners give at its middle, would need more than one step to
the tolerance; along the axis along which they are least like a quadratic. New corners begin at what the old ones give
there. A sheet that does not reach all corners of a cell ends inside it; the cell is cut further, down to a least size,
and what is left there answers nothing. A cell that has no corner of a sheet is looked at again when all others are
done: where some of them have nodes on its border the sheet may go on from there, and the cell is cut after all.

All cells of one wave are computed together, in lanes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.chart import Chart
from perilune.atlas.hermite import bits, interpolated, unlike_quadratics
from perilune.atlas.reflight import SLACK, Reflights
from perilune.atlas.sheets import Borders, Sheet
from perilune.words.types import Matrix, Vector
from perilune.words.watch import Watch, silent

WHOLE = 2**12  # lattice steps along an edge of a brick
_BITS = 13  # of a place along one axis, so that 4 of them and a sheet make one number
_FINEST = 2**6  # the shortest edge of a cell
ENDING = 2**8  # the same where a sheet ends, and of sheets that are no minima
_KINKED = 2**9  # the same where the switches on the way change
_APART, _NEAR = 0.5, 1e-3  # how far a root may lie from what led to it: of what the corners differ by, and of 1 + |y|
_CLEARLY = 3.0  # times as far below zero as it differs at the corners of a cell
_MOST = 16  # evaluations for a new corner

FLOWN = ("sequence", "residual", "path", "minimum", "drift")  # columns of a node that its second flight fills

Whole = NDArray[np.int64]


class Status(IntEnum):
    """What a cell is."""

    CUT = 0  # its children are what counts
    ONE_STEP = 1  # answers by one step of Newton's method
    MORE_STEPS = 2  # answers, but at the least size a step is not enough
    ENDS = 3  # the sheet ends inside
    NO_ANSWER = 4  # its extremals lie beyond a bound, or gain by leaving one
    BREAKS = 5  # its extremals break the path
    ABSENT = 6  # the sheet does not come here: no corner has it, and none of the nodes around


@dataclass(frozen=True, kw_only=True)
class Cells:
    """Cells of all sheets of a brick; the first of each sheet is the whole brick.

    Attributes
    ----------
    sheet
        Whose, (cells,).
    low, size
        Low corner and lengths, in lattice steps, (cells, d).
    corners
        Nodes at its corners, -1 where there is none, (cells, 2^d).
    axis, child
        Along which axis it was cut, -1 for none; the first of its two children, which follow each other.
    status
        `Status`.
    """

    sheet: Whole
    low: Whole
    size: Whole
    corners: Whole
    axis: Whole
    child: Whole
    status: Whole

    def __len__(self) -> int:
        return len(self.sheet)


@dataclass(frozen=True, kw_only=True)
class Cut:
    """A brick that was cut.

    Attributes
    ----------
    nodes
        Of each node its ``sheet``, its ``place`` in the lattice (nodes, d), values and derivatives ``terms``
        (nodes, 2^d, n + 1), by how much it is an answer (``margin``), the step that Newton's method would make
        there (``length``), and of its second flight ``sequence``, ``residual``, ``path``, ``minimum`` and ``drift``.
    cells
        Its cells.
    """

    nodes: dict[str, NDArray[Any]]
    cells: Cells


class _Nodes:
    """What was computed; a node is known by its sheet and its place."""

    def __init__(self) -> None:
        self.known: dict[int, int] = {}
        self.parts: dict[str, list[NDArray]] = {}
        self._rows: dict[str, NDArray[Any]] = {
            name: np.empty(0) for name in ("terms", "margin", "sequence", "path", "sheet", "place")
        }
        self.count = 0

    def add(self, keys: Whole, **columns: NDArray) -> None:
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

    def numbers(self, keys: Whole) -> Whole:
        """Of the nodes, -1 for those that are not there."""
        known = self.known
        return np.array([known.get(key, -1) for key in keys.ravel().tolist()], dtype=np.int64).reshape(keys.shape)

    def rows(self, name: str, numbers: Whole) -> NDArray[Any]:
        """A column of nodes."""
        return self._rows[name][numbers]

    def within(self, sheet: int, low: Whole, high: Whole) -> Whole:
        """The nodes of a sheet in a box or on its border from which it may go on: beyond its own it may turn back."""
        place = self._rows["place"][: self.count]
        inside = (self._rows["sheet"][: self.count] == sheet) & (self._rows["margin"][: self.count] >= 0)
        inside &= ((place >= low) & (place <= high)).all(axis=1)
        return np.nonzero(inside)[0]


class Brick:
    """Cuts one box of the region.

    Parameters
    ----------
    chart, borders, reflights, sheets
        What is mapped, and what flies it a second time.
    low, high
        Corners of the box, canonical.
    tolerance
        Relative, to which one step of Newton's method has to lead.
    watch
        Receives a line of text for each wave.
    """

    def __init__(
        self,
        chart: Chart,
        borders: Borders,
        reflights: Reflights,
        sheets: Sequence[Sheet],
        low: Vector,
        high: Vector,
        tolerance: float,
        watch: Watch = silent,
    ) -> None:
        self.chart, self.borders, self.reflights, self.sheets, self.watch = chart, borders, reflights, sheets, watch
        self.origin, self.step, self.tolerance = low, (high - low) / WHOLE, tolerance
        self.d = len(low)
        self.orientations = np.array([sheet.orientation for sheet in sheets])
        self._minimum = np.array([sheet.minimum for sheet in sheets])
        self.nodes = _Nodes()

    def cut(self, sheet: Whole, place: Whole, y: Matrix, before: Cut | None = None) -> Cut:
        """Compute everything.

        Parameters
        ----------
        sheet, place, y
            Extremals to begin with, and where they are, in lattice steps.
        before
            What is known already, without these.
        """
        waves = list[Cells]()
        if before is not None:
            self.nodes.add(self._keys(before.nodes["sheet"], before.nodes["place"]), **before.nodes)
            waves.append(before.cells)
        self._solved(sheet, place, y, np.full(len(sheet), np.inf))
        here = np.setdiff1d(sheet, before.cells.sheet if before is not None else ())
        whole = np.full((len(here), self.d), WHOLE)
        cells = self._filled(self._cells(here, np.zeros_like(whole), whole))
        while True:
            while len(cells):
                first = sum(map(len, waves))
                status, axis = self._judged(cells)
                cut = status == Status.CUT
                child = np.where(cut, first + len(cells) + 2 * (np.cumsum(cut) - 1), -1)
                waves.append(replace(cells, status=status, axis=np.where(cut, axis, -1), child=child))
                self.watch(f"{self.nodes.count} nodes, {first + len(cells)} cells, {2 * np.count_nonzero(cut)} at work")
                cells = self._halved(_some(cells, cut), axis[cut])
            waves, cells = self._reached(_joined(waves))
            if not len(cells):
                nodes = {name: np.concatenate(rows) for name, rows in self.nodes.parts.items()}
                return Cut(nodes=nodes, cells=waves[0])

    def _reached(self, done: Cells) -> tuple[list[Cells], Cells]:
        """What was done, and halves of cells without a corner into which a sheet may go on from nodes around them."""
        bare = np.nonzero(np.isin(done.status, (Status.ENDS, Status.ABSENT)) & (done.corners < 0).all(axis=1))[0]
        within = [self.nodes.within(int(done.sheet[i]), done.low[i], done.low[i] + done.size[i]) for i in bare]
        status, axis, child = done.status.copy(), done.axis.copy(), done.child.copy()
        known = np.array([len(nodes) > 0 for nodes in within], dtype=bool)
        status[bare] = np.where(known, Status.ENDS, Status.ABSENT)
        again = known & (done.size[bare].max(axis=1, initial=0) > ENDING)
        cut = bare[again]
        axis[cut], status[cut] = done.size[cut].argmax(axis=1), Status.CUT
        child[cut] = len(done) + 2 * np.arange(len(cut))
        done = replace(done, status=status, axis=axis, child=child)
        near = [nodes for nodes, cutting in zip(within, again, strict=True) if cutting]
        return [done], self._halved(_some(done, cut), axis[cut], near)

    def _judged(self, cells: Cells) -> tuple[Whole, Whole]:
        """What each cell is, and along which axis it would be cut."""
        complete: NDArray[np.bool_] = np.all(cells.corners >= 0, axis=1)
        status, axis = np.where(complete, Status.CUT, Status.ENDS), cells.size.argmax(axis=1)
        if complete.any():
            passed, beyond, axis[complete] = self._tried(_some(cells, complete))
            here = np.nonzero(complete)[0]
            status[here[passed]] = Status.ONE_STEP
            status[here[passed & beyond]] = Status.NO_ANSWER
            # What is clear at all corners is not looked at more closely; but not of the first, which know little.
            clear = here[passed | (cells.size[here] < WHOLE).all(axis=1)]
            status[clear[self._clearly_below("path", cells.corners[clear])]] = Status.BREAKS
        along = np.take_along_axis(cells.size, axis[:, None], axis=1)[:, 0]
        # Beyond a change of what an extremal goes through its unknowns go on with a kink, which no cell follows.
        sequence = self.nodes.rows("sequence", cells.corners)
        kinked = (sequence != sequence[:, :1]).any(axis=1)
        finest = np.where(self._minimum[cells.sheet], np.where(kinked, _KINKED, _FINEST), ENDING)
        status[(status == Status.CUT) & (along <= finest)] = Status.MORE_STEPS
        none = (cells.corners < 0).all(axis=1)
        status[(status == Status.ENDS) & ~none & (along > ENDING)] = Status.CUT
        return status, axis

    def _tried(self, cells: Cells) -> tuple[NDArray[np.bool_], NDArray[np.bool_], Whole]:
        """At the middle of cells: whether one step is enough, whether nothing there is an answer, where to cut."""
        terms, size = self.nodes.rows("terms", cells.corners), cells.size * self.step
        values = self.origin + (cells.low + 0.5 * cells.size) * self.step
        guess = interpolated(terms, np.full(size.shape, 0.5), size)[:, :-1]
        holds = self.borders.holds(self.sheets, cells.sheet, values)
        first = self.chart.at(values, guess, holds)
        flown: NDArray[np.bool_] = np.all(np.isfinite(first.stepped), axis=1)
        second = self.chart.at(values, np.where(flown[:, None], first.stepped, guess), holds)
        same = second.orientation == self.orientations[cells.sheet]
        passed: NDArray[np.bool_] = flown & same & (second.length <= self.tolerance)
        margin = self.borders.margins_of(self.sheets, cells.sheet, second)
        beyond = np.maximum(margin, self.nodes.rows("margin", cells.corners).max(axis=1)) < 0.0
        unlike = unlike_quadratics(terms[..., :-1], size) / (1.0 + np.abs(guess))[:, None]
        return passed, beyond, (unlike.max(axis=2) * (cells.size > _FINEST)).argmax(axis=1)

    def _clearly_below(self, name: str, corners: Whole) -> NDArray[np.bool_]:
        """Whether what should not be below zero is so at all corners of cells, by far more than it differs there."""
        rows = self.nodes.rows(name, corners)
        most, least = rows.max(axis=1), rows.min(axis=1)
        with np.errstate(invalid="ignore"):  # where nothing limits them
            return most < -_CLEARLY * (most - least) - SLACK

    def _halved(self, cells: Cells, axis: Whole, near: Sequence[Whole] | None = None) -> Cells:
        """Both halves of cells, one after the other; `near` are nodes to begin with in place of their corners."""
        count = np.arange(len(cells))
        size, far = cells.size.copy(), cells.low.copy()
        size[count, axis] //= 2
        far[count, axis] += size[count, axis]
        low = np.stack([cells.low, far], axis=1).reshape(-1, self.d)
        return self._filled(self._cells(np.repeat(cells.sheet, 2), low, np.repeat(size, 2, axis=0)), cells, near)

    def _cells(self, sheet: Whole, low: Whole, size: Whole) -> Cells:
        none = np.full(len(sheet), -1)
        return Cells(
            sheet=sheet, low=low, size=size, corners=self._corners(sheet, low, size), axis=none, child=none, status=none
        )

    def _filled(self, cells: Cells, wholes: Cells | None = None, near: Sequence[Whole] | None = None) -> Cells:
        """The same with the corners solved for that are not there, from those of their `wholes`, or their own."""
        cell, corner = np.nonzero(cells.corners < 0)
        if not len(cell):
            return cells
        places = cells.low[cell] + bits(self.d)[corner] * cells.size[cell]
        _, once = np.unique(self._keys(cells.sheet[cell], places), return_index=True)
        cell, places = cell[once], places[once]
        if near is not None:
            guess, spread = self._from(
                np.array([self._nearest(near[i // 2], at) for i, at in zip(cell, places, strict=True)]), places
            )
        elif wholes is not None:
            guess, spread = self._guesses(wholes, cell // 2, places)
        else:
            guess, spread = self._guesses(cells, cell, places)
        self._solved(cells.sheet[cell], places, guess, spread)
        return replace(cells, corners=self._corners(cells.sheet, cells.low, cells.size))

    def _guesses(self, cells: Cells, cell: Whole, places: Whole) -> tuple[Matrix, Vector]:
        """y at places of cells, and how much it changes there: by all corners, or along the slopes of the nearest."""
        corners, size = cells.corners[cell], cells.size[cell] * self.step
        at = (places - cells.low[cell]) / cells.size[cell]
        away = np.abs(at[:, None] - bits(self.d)[None]).sum(axis=2)
        nearest = np.where(corners >= 0, away, np.inf).argmin(axis=1)
        guess, spread = self._from(corners[np.arange(len(cell)), nearest], places)
        full = (corners >= 0).all(axis=1)
        if full.any():
            terms = self.nodes.rows("terms", corners[full])
            guess[full] = interpolated(terms, at[full], size[full])[:, :-1]
            spread[full] = np.linalg.norm(np.ptp(terms[:, :, 0, :-1], axis=1), axis=1)
        return guess, spread

    def _from(self, nodes: Whole, places: Whole) -> tuple[Matrix, Vector]:
        """y at places along the slopes of nodes, and how much it changes on the way."""
        terms = self.nodes.rows("terms", nodes)
        move = (places - self.nodes.rows("place", nodes)) * self.step
        guess = terms[:, 0, :-1] + sum(move[:, [i]] * terms[:, 1 << i, :-1] for i in range(self.d))
        return guess, np.linalg.norm(guess - terms[:, 0, :-1], axis=1)

    def _nearest(self, nodes: Whole, place: Whole) -> int:
        """Which of some nodes is the nearest to a place."""
        return int(nodes[np.abs(self.nodes.rows("place", nodes) - place).sum(axis=1).argmin()])

    def _solved(self, sheet: Whole, places: Whole, guess: Matrix, spread: Vector) -> None:
        """Newton's method at places; what of it belongs to its sheet comes among the nodes."""
        values = self.origin + places * self.step
        holds = self.borders.holds(self.sheets, sheet, values)
        found = self.chart.solve(values, guess, holds, limit=_MOST)
        moved = np.linalg.norm(found.y - guess, axis=1)
        good = found.converged & (found.orientation == self.orientations[sheet])
        good &= moved <= _APART * spread + _NEAR * (1.0 + np.linalg.norm(guess, axis=1))
        if not good.any():
            return
        some, holds, sheet, places = found.of(np.nonzero(good)[0]), holds[good], sheet[good], places[good]
        flown = self.reflights.finer(some.roots.y, self.chart.p[None], some.roots.choice)
        self.nodes.add(
            self._keys(sheet, places),
            sheet=sheet,
            place=places,
            terms=self.chart.terms(some, holds),
            margin=self.borders.margins_of(self.sheets, sheet, some),
            length=some.length,
            **{name: getattr(flown, name) for name in FLOWN},
        )

    def _corners(self, sheet: Whole, low: Whole, size: Whole) -> Whole:
        """Nodes at the corners of cells, -1 where there is none."""
        return self.nodes.numbers(self._keys(sheet[:, None], low[:, None] + bits(self.d)[None] * size[:, None]))

    def _keys(self, sheet: Whole, places: Whole) -> Whole:
        return (sheet << _BITS * self.d) + (places << _BITS * np.arange(self.d)).sum(axis=-1)


def _joined(waves: Sequence[Cells]) -> Cells:
    return Cells(**{f.name: np.concatenate([getattr(w, f.name) for w in waves]) for f in fields(Cells)})


def _some(cells: Cells, which: NDArray[np.bool_] | NDArray[np.intp]) -> Cells:
    return Cells(**{f.name: getattr(cells, f.name)[which] for f in fields(Cells)})
