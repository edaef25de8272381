"""Blocks (bricks): boxes of the region, each sheet in it cut into cells until every cell answers from its corners.

A cell is cut in two if Newton's method, begun at its middle with what its corners give, would need more than one step
to the tolerance; along the axis along which they are least like a quadratic. New corners begin with what the old ones
give there. A sheet that does not reach all corners of a cell ends inside it; the cell is cut further, down to a least
size, and smaller remainders do not answer. A cell without a corner on a sheet is examined again when all others are
done: if some of them have nodes on its border the sheet may go on from there, and the cell is cut after all.

Where a sheet comes to one place with several extremals it has several branches (`perilune.atlas.store.cells`), each
with cells of its own. The first branch of a sheet begins with the whole block; a later one goes on from a node in the
smallest cells in which a sheet may end, until it runs into another. It begins with an extremal to which no branch
without a node there leads; if one does, that branch goes on from there instead.

All cells of one wave are computed together, in lanes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.grid.bound_crossing import Crossings
from perilune.atlas.grid.nodes import FINEST, Lattice, accept_cells, path_amid
from perilune.atlas.hermite import binary_digits
from perilune.atlas.store.cell_coverage import (
    ANSWERING,
    Extremal,
    arrays_of,
    cells_reproduce,
    covered_by_branches,
    ending_layers,
    torn_edges,
)
from perilune.atlas.store.cells import (
    WHOLE,
    Cells,
    Cut,
    Nodes,
    Status,
    Whole,
    clearly_below,
    concatenate_cells,
    leaves_of,
    select_cells,
    shortest_ending_edge,
)
from perilune.charts import SLACK, same_unknowns
from perilune.core import Matrix, Vector, Watch, ignore_events

_KINKED = 2**9  # the shortest edge of a cell where the switches on the way change
_WORST = 2**8  # the same of sheets that are no minima
_MOST_BRANCHES = 32  # of all sheets together, in addition to the first of each


class BrickSubdivision:
    """Subdivision of one box of the region into cells.

    Parameters
    ----------
    lattice
        Its places, and what is known of them already.
    tolerance
        Relative, to which one step of Newton's method has to lead.
    watch
        Receives a line of text for each wave.
    """

    def __init__(self, lattice: Lattice, tolerance: float, watch: Watch = ignore_events) -> None:
        self.lattice: Lattice = lattice
        self.tolerance: float = tolerance
        self.watch: Watch = watch
        self.nodes: Nodes = lattice.nodes
        self.step: Vector = lattice.step
        self.ending: int = shortest_ending_edge(lattice.d)
        self.count: int = len(lattice.all_sheets)
        self._left = list[Extremal]()
        self._looked_at = self._cells_looked_at = 0
        self._crossings = Crossings(lattice)
        self._inside = dict[int, Whole]()  # places other than corners at which sheets began
        self._entered = list[Extremal]()  # what first branches were given there
        self._ending = dict[tuple[int, ...], NDArray[np.bool_]]()  # of torn cells the corners whose layers end there

    def cut(self, sheet: Whole, place: Whole, y: Matrix, before: Cells | None = None) -> Cut:
        """Cut the block and compute all nodes and cells.

        Parameters
        ----------
        sheet, place, y
            Extremals to begin with, and where they are, in lattice steps.
        before
            Cells that are known already, without these.
        """
        waves = [] if before is None else [before]
        new = self._sown(sheet, place, y, before)
        self.lattice.solved(sheet[new], place[new], y[new], np.full(len(new), np.inf))
        self._note_interior_starts(sheet[new], place[new])
        self._entered = [(int(sheet[i]), place[i], y[i]) for i in new]
        if not self.nodes.count:  # where the side of a fold is rounding, none may be of its sheet
            return Cut(nodes={}, cells=self.lattice.wholes(np.empty(0, dtype=np.int64)), own=tuple(self.lattice.own))
        here = np.setdiff1d(sheet[new], before.branch if before is not None else ())
        cells = self.lattice.filled(self.lattice.wholes(here))
        while True:
            while len(cells):
                first = sum(map(len, waves))
                status, axis = self._decide_splits(cells)
                cut = status == Status.CUT
                child = np.where(cut, first + len(cells) + 2 * (np.cumsum(cut) - 1), -1)
                waves.append(replace(cells, status=status, axis=np.where(cut, axis, -1), child=child))
                self.watch(f"{self.nodes.count} nodes, {first + len(cells)} cells, {2 * np.count_nonzero(cut)} at work")
                cells = self._halved(select_cells(cells, cut), axis[cut])
            done, cells = self._reached(concatenate_cells(waves))
            waves = [done]
            if not len(cells):
                if (branch := self._branched(done)) is not None:
                    waves.append(branch)
                elif (on := self._continue_beyond_bounds(done)) is not None:
                    waves, cells = [on[0]], on[1]
                else:
                    return self._finished(done)

    def _finished(self, done: Cells) -> Cut:
        """Turn torn cells into ends, as other branches have the layers that go on, if so many branches are allowed.

        A cell that crosses a bound gives what lies beyond it if the sheet that goes on there is not known: it casts
        doubt on answers that are worse.
        """
        status, corners = done.status.copy(), done.corners.copy()
        status[self._crossings.unanswered_cells(done)] = Status.ONE_STEP
        for i in np.nonzero(status == Status.TORN)[0].tolist():
            layers = self._ending[done.box(i)] | bool(self._left) | self._given_by_none(done, i)
            status[i] = Status.ENDS if layers.any() else Status.ABSENT
            corners[i] = np.where(layers, corners[i], -1) if layers.any() else corners[i]
        done = replace(done, status=status, corners=corners)
        nodes = {name: np.concatenate(rows) for name, rows in self.nodes.parts.items()}
        return Cut(nodes=nodes, cells=done, own=tuple(self.lattice.own))

    def _given_by_none(self, done: Cells, number: int) -> NDArray[np.bool_]:
        """Return a mask of the corners of a torn cell with answers that no other branch gives in it.

        Two branches that change places on their layers in one cell know all that is around it, and are torn both.
        """
        corners, low, high = done.corners[number], done.low[number], done.low[number] + done.size[number]
        answers = (corners >= 0) & (self.nodes.rows("margin", corners) >= 0)
        here = ((done.low < high) & (done.low + done.size > low)).all(axis=1)
        places, y = self.nodes.rows("place", corners), self.nodes.rows("terms", corners)[:, 0, :-1]
        others = self.lattice.alike(self.lattice.own[int(done.branch[number])])
        return answers & ~covered_by_branches(select_cells(done, here), self.nodes, self.step, others, places, y)

    # -- branches -------------------------------------------------------------------------------------------------

    def _sown(self, sheet: Whole, place: Whole, y: Matrix, before: Cells | None) -> list[int]:
        """Return the numbers of extremals that begin or continue the first branch of their sheet; others wait."""
        new, taken = list[int](), list[tuple[int, list[int], Vector]]()
        for i, (number, at, row) in enumerate(zip(sheet.tolist(), place.tolist(), y, strict=True)):
            alike = self.lattice.alike(number)
            here = [(b, self.nodes.at(self.lattice.keys(np.array(b), place[i]))) for b in alike]
            known = [(self.lattice.own[b], known) for b, known in here if known is not None]
            known += [(other, told) for other, there, told in taken if other in alike and there == at]
            if any(same_unknowns(told, row) for _, told in known):
                continue
            if before is not None and self.lattice.had(before, [(number, place[i], row)])[0]:
                continue
            if any(other == number for other, _ in known):
                self._left.append((number, place[i], row))
            else:
                new.append(i)
                taken.append((number, at, row))
        return new

    def _grow_branches(self) -> bool:
        """Grow branches by waiting extremals to which one leads where it has no node; return True if any grew."""
        which, places, y = arrays_of(self._left)
        waiting = np.ones(len(which), dtype=bool)
        for branch, own in enumerate(self.lattice.sheets):
            mine = waiting & np.array([sheet.alike(own) for sheet in self.lattice.all_sheets])[which]
            keys = self.lattice.keys(np.array(branch), places)
            lanes = np.nonzero(mine & (self.nodes.numbers(keys) < 0))[0]
            begin = self.nodes.nearest_continuable(branch, places[lanes], self.ending)
            lanes, begin = lanes[begin >= 0], begin[begin >= 0]
            if len(lanes):
                guess, spread = self.nodes.extrapolate(begin, places[lanes], self.step)
                led, good = self.lattice.solve_near(np.full(len(lanes), branch), places[lanes], guess, spread)
                lanes = lanes[good & same_unknowns(y[lanes], led.y)]
                lanes = lanes[np.unique(keys[lanes], return_index=True)[1]]
                self.lattice.solved(np.full(len(lanes), branch), places[lanes], y[lanes], np.full(len(lanes), np.inf))
                waiting[lanes] = False
        self._left = [one for one, still in zip(self._left, waiting.tolist(), strict=True) if still]
        return not waiting.all()

    def _branched(self, done: Cells) -> Cells | None:
        """Return first cells for waiting extremals: none if branches grow, else the whole block for a new branch.

        None if no extremal waits, or there are too many branches.
        """
        self._left += self._passed_over(done)
        had = self.lattice.had(done, self._left).tolist()
        self._left = [one for one, known in zip(self._left, had, strict=True) if not known]
        if self._left and self._grow_branches():
            return select_cells(done, np.zeros(0, dtype=np.int64))
        if not self._left or len(self.lattice.own) >= self.count + _MOST_BRANCHES:
            return None
        sheet, place, y = self._left.pop(0)
        return self._whole_block_cell(self.lattice.another_branch(sheet), place[None], y[None])

    def _whole_block_cell(self, branch: int, place: Whole, y: Matrix) -> Cells:
        """Return the whole block as a cell of a branch that is known only at places inside it."""
        which = np.full(len(place), branch)
        self.lattice.solved(which, place, y, np.full(len(place), np.inf))
        root = self.lattice.wholes(which[:1])
        return replace(root, corners=np.full_like(root.corners, -1), status=np.array([Status.ABSENT]))

    def _passed_over(self, done: Cells) -> list[Extremal]:
        """Return extremals given to a first branch that its cells do not reproduce: they lie on another layer."""
        found, kept = list[Extremal](), list[Extremal]()
        for sheet, place, y in self._entered:
            if not np.isin(done.status[leaves_of(done, sheet, place[None])], ANSWERING).any():
                kept.append((sheet, place, y))
            elif not covered_by_branches(done, self.nodes, self.step, [sheet], place[None], y[None])[0]:
                self.nodes.forget(self.lattice.keys(np.array(sheet), place))
                found.append((sheet, place, y))
        self._entered = kept  # what a cell gives it goes on to give
        return found

    # -- across bounds --------------------------------------------------------------------------------------------

    def _note_interior_starts(self, sheet: Whole, place: Whole) -> None:
        """Note where sheets begin other than at corners."""
        inside = ((place != 0) & (place != WHOLE)).any(axis=1)
        for number in np.unique(sheet[inside]).tolist():
            known = self._inside.get(number, np.empty((0, self.lattice.d), dtype=np.int64))
            self._inside[number] = np.vstack([known, place[inside & (sheet == number)]])

    def _continue_beyond_bounds(self, done: Cells) -> tuple[Cells, Cells] | None:
        """Return finished cells and cells to look at, with sheets that continue others across bounds; None without any.

        A cell that says that there is no answer of a sheet where there is one is halved.
        """
        first, wrong, count = list[Cells](), [np.empty(0, dtype=np.int64)], len(self._left)
        for sheet, place, y in self._crossings.continuations(done):
            self._note_interior_starts(np.full(len(place), sheet), place)
            if sheet not in done.branch:
                first.append(self._whole_block_cell(sheet, place, y))
                continue
            self._left += zip([sheet] * len(place), place, y, strict=True)
            for branch in self.lattice.alike(sheet):
                cell = leaves_of(done, branch, place)
                none = np.nonzero((cell >= 0) & (done.status[cell] == Status.NO_ANSWER))[0]
                if len(none):
                    here = cells_reproduce(select_cells(done, cell[none]), self.nodes, self.step, place[none], y[none])
                    wrong.append(cell[none[here]])
        cut = np.unique(np.concatenate(wrong))
        if not first and not len(cut) and len(self._left) == count:
            return None
        done = _cut_longest_edges(concatenate_cells([done, *first]), cut)
        return done, self._halved(select_cells(done, cut), done.axis[cut])

    def _with_beginnings(self, cells: Cells) -> NDArray[np.bool_]:
        """Return a mask of the cells in which a sheet began."""
        out = np.zeros(len(cells), dtype=bool)
        for sheet, place in self._inside.items():
            for i in np.nonzero(np.isin(cells.branch, self.lattice.alike(sheet)))[0].tolist():
                out[i] = ((place >= cells.low[i]) & (place <= cells.low[i] + cells.size[i])).all(axis=1).any()
        return out

    def _torn(self, cells: Cells) -> Whole:
        """Return the status `TORN` for each cell whose corners lie on different layers, else -1."""
        found = np.full(len(cells), -1)
        torn = cell, one, other = torn_edges(self.nodes, cells.corners, cells.size * self.step)
        cell, begin, end = np.tile(cell, 2), np.append(one, other), np.append(other, one)
        leads = self.nodes.rows("margin", cells.corners[cell, begin]) >= 0
        cell, begin, end = cell[leads], begin[leads], end[leads]
        if not len(cell):
            return found
        places, branch = cells.low[cell] + binary_digits(self.lattice.d)[end] * cells.size[cell], cells.branch[cell]
        led, good = self.lattice.solve_near(
            branch, places, *self.nodes.extrapolate(cells.corners[cell, begin], places, self.step)
        )
        there = self.nodes.rows("terms", cells.corners[cell, end])[:, 0, :-1]
        differs = good & ~same_unknowns(there, led.y)
        found[cell[differs]] = Status.TORN
        for number in np.unique(cell[differs]).tolist():
            edges, ends = np.column_stack(torn[1:])[torn[0] == number], begin[~good & (cell == number)]
            self._ending[cells.box(number)] = ending_layers(cells.corners[number], edges.tolist(), ends.tolist())
        for i in np.nonzero(differs)[0].tolist():
            self._left.append((self.lattice.own[int(branch[i])], places[i], led.y[i]))
        return found

    # -- cells ----------------------------------------------------------------------------------------------------

    def _reached(self, done: Cells) -> tuple[Cells, Cells]:
        """Return finished cells, and halves of cells without corners into which nodes around them may continue."""
        first = self._meet(done)
        bare = np.isin(done.status, (Status.ENDS, Status.ABSENT)) & (done.corners < 0).all(axis=1)
        # Around one that was looked at before there is nothing but new nodes, if it has not ended.
        before = np.arange(len(done)) < self._cells_looked_at
        bare = np.nonzero(bare & ~(before & ((done.status == Status.ENDS) | (first == self.nodes.count))))[0]
        self._cells_looked_at = len(done)
        within = [
            self.nodes.within(int(done.branch[i]), done.low[i], done.low[i] + done.size[i], first if before[i] else 0)
            for i in bare
        ]
        status, known = done.status.copy(), np.array([len(nodes) > 0 for nodes in within], dtype=bool)
        status[bare] = np.where(known, Status.ENDS, Status.ABSENT)
        again = known & (done.size[bare].max(axis=1, initial=0) > self.ending)
        cut = bare[again]
        done = _cut_longest_edges(replace(done, status=status), cut)
        halves = self.lattice.halves(select_cells(done, cut), done.axis[cut])
        # Layers that lie near one another are distinguished only in small cells.
        fine = np.nonzero((halves.branch < self.count) | (halves.size.max(axis=1, initial=0) <= 2 * self.ending))[0]
        near = [nodes for nodes, cutting in zip(within, again, strict=True) if cutting]
        corners = np.where(np.isin(np.arange(len(halves)), fine)[:, None], halves.corners, -1)
        filled = self.lattice.filled(select_cells(halves, fine), near=[near[i // 2] for i in fine.tolist()])
        corners[fine] = self._looked_around(filled).corners
        return done, replace(halves, corners=corners)

    def _meet(self, done: Cells) -> int:
        """Note the new nodes at which a later branch has run into another, from which it does not go on.

        Returns the number of the first new node.
        """
        new = np.arange(first := self._looked_at, self.nodes.count)
        self._looked_at = self.nodes.count
        branch = self.nodes.rows("branch", new)
        for own in np.unique(branch[branch >= self.count]).tolist():
            mine, others = new[branch == own], [b for b in self.lattice.alike(self.lattice.own[own]) if b != own]
            y, places = self.nodes.rows("terms", mine)[:, 0, :-1], self.nodes.rows("place", mine)
            met = covered_by_branches(done, self.nodes, self.step, others, places, y)
            for other in others:  # which may have no cell there, but the very node
                met |= self.nodes.has(
                    self.lattice.keys(np.array(other), places), y, self.nodes.count if other < own else first
                )
            self.nodes.run_into = np.append(self.nodes.run_into, mine[met])
        return first

    def _decide_splits(self, cells: Cells) -> tuple[Whole, Whole]:
        """Return the status of each cell, and the axis along which it would be cut."""
        complete: NDArray[np.bool_] = np.all(cells.corners >= 0, axis=1)
        status, axis = np.where(complete, Status.CUT, Status.ENDS), cells.size.argmax(axis=1)
        if complete.any():
            passed, beyond, axis[complete] = accept_cells(
                self.lattice, select_cells(cells, complete), self.tolerance, self._with_beginnings
            )
            here = np.nonzero(complete)[0]
            status[here[passed]] = Status.ONE_STEP
            status[here[passed & beyond]] = Status.NO_ANSWER
            # What is clear at all corners is not looked at more closely; but not of the first, which know little.
            clear = here[passed | (cells.size[here] < WHOLE).all(axis=1)]
            path = self.nodes.rows("path", cells.corners[clear])
            path, clear = path[below := clearly_below(path, SLACK)], clear[below]
            amid = path_amid(
                self.lattice, select_cells(cells, clear)
            )  # it may be kept there, and broken alike at all corners
            status[clear[clearly_below(np.column_stack([path, amid]), SLACK)]] = Status.BREAKS
        along = np.take_along_axis(cells.size, axis[:, None], axis=1)[:, 0]
        # Beyond a change of what an extremal goes through its unknowns go on with a kink, which no cell follows.
        sequence = self.nodes.rows("sequence", cells.corners)
        kinked = (sequence != sequence[:, :1]).any(axis=1)
        finest = np.where(self.lattice.minimum[cells.branch], np.where(kinked, _KINKED, FINEST), _WORST)
        none = (cells.corners < 0).all(axis=1)
        torn = np.full(len(cells), -1)
        small = np.nonzero((along <= self.ending) & ((status == Status.CUT) | (status == Status.ENDS) & ~none))[0]
        torn[small] = self._torn(select_cells(cells, small))
        status[(status == Status.CUT) & (along <= finest)] = Status.MORE_STEPS
        status[(status == Status.ENDS) & ~none & (along > self.ending)] = Status.CUT
        return np.where(torn >= 0, torn, status), axis

    def _halved(self, cells: Cells, axis: Whole) -> Cells:
        """Return both halves of cells, one after the other, with their new corners solved."""
        return self._looked_around(self.lattice.filled(self.lattice.halves(cells, axis), cells))

    def _looked_around(self, cells: Cells) -> Cells:
        """Solve missing corners of small cells from each of their own corners.

        A guess from corners on several layers leads to none of these, though none of them ends there.
        """
        before, known = self.nodes.count, -1
        small = self.lattice.filled(select_cells(cells, cells.size.max(axis=1, initial=0) <= self.ending))
        while known < self.nodes.count:
            known = self.nodes.count
            small = self.lattice.walked_on(small)
        if known == before:
            return cells
        return replace(cells, corners=self.lattice.corners(cells.branch, cells.low, cells.size))


def _cut_longest_edges(done: Cells, cut: Whole) -> Cells:
    """Cut some cells along their longest edges; their halves follow all others."""
    status, axis, child = done.status.copy(), done.axis.copy(), done.child.copy()
    axis[cut], status[cut] = done.size[cut].argmax(axis=1), Status.CUT
    child[cut] = len(done) + 2 * np.arange(len(cut))
    return replace(done, status=status, axis=axis, child=child)
