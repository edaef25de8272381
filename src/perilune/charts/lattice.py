"""Lattice of extremals of one sheet, from which points near its nodes are reached along tangent planes.

Its nodes lie around one known extremal, and each is continued from there along a straight line when it is first asked
for; those of a finer level from the nearest node of the coarser one, if there is one. No point enters, so that a point
begins with the same numbers whatever others are asked for with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from perilune.charts.continuation import Lanes, follow_sheets
from perilune.charts.open_chart import OpenChart
from perilune.core import Matrix, Vector

_EDGE, _FINER = 2.0**-3, 2.0**-3  # of the coarsest level, as a share of the widths of the chart; of each finer level
_KEPT = 8192  # nodes of a level, which are found again where they are asked for again
_SHORTEST, _LIMIT = 2.0**-5, 8  # step to a node, as a share of the way, and evaluations of a step


@dataclass(frozen=True)
class LatticeNodes:
    """Extremals to begin with, in lanes: values of the parameters, y, dy/dp, J and dJ/dp, canonical; NaN for none."""

    values: Matrix
    y: Matrix
    slopes: NDArray[np.float64]
    cost: Vector
    cost_slopes: Matrix

    @classmethod
    def joined(cls, rows: Sequence[LatticeNodes]) -> LatticeNodes:
        """Return several as one."""
        return cls(*(np.concatenate([getattr(row, f.name) for row in rows]) for f in fields(cls)))

    @property
    def known(self) -> NDArray[np.bool_]:
        """Return True for lanes with an extremal."""
        return np.isfinite(self.cost)

    def of(self, lanes: Lanes) -> LatticeNodes:
        """Return some of the lanes."""
        return LatticeNodes(*(getattr(self, f.name)[lanes] for f in fields(LatticeNodes)))

    def otherwise(self, other: LatticeNodes) -> LatticeNodes:
        """Return the same with those of another, lane by lane, where there is no extremal."""
        none, found = ~self.known, self.of(np.arange(len(self.cost)))
        for f in fields(LatticeNodes):
            getattr(found, f.name)[none] = getattr(other, f.name)[none]
        return found

    # Axis by axis: a product of matrices rounds as its shape says.
    def unknowns_at(self, values: Matrix) -> Matrix:
        """Return y on the tangent planes at values of the parameters, canonical, (lanes, d)."""
        y = self.y.copy()
        for k, step in enumerate((values - self.values).T):
            y += step[:, None] * self.slopes[:, k]
        return y

    def cost_at(self, values: Matrix) -> Vector:
        """Return J on the tangent planes at values of the parameters, canonical, (lanes, d)."""
        cost = self.cost.copy()
        for k, step in enumerate((values - self.values).T):
            cost += step * self.cost_slopes[:, k]
        return cost


class SheetLattice:
    """Lattice of a sheet.

    Parameters
    ----------
    open_chart, number
        The chart, and the number of the sheet in it.
    first
        The known extremal, a single lane.
    levels
        How many levels there are.
    """

    def __init__(self, open_chart: OpenChart, number: int, first: LatticeNodes, levels: int) -> None:
        self._open, self._number, self._first = open_chart, number, first
        self._known: list[dict[tuple[float, ...], LatticeNodes]] = [{} for _ in range(levels)]
        self._edges = [_EDGE * _FINER**level * open_chart.chart.widths for level in range(levels)]

    def nearest(self, values: Matrix, level: int) -> Matrix:
        """Return the values of the parameters at the node next to each of some, (lanes, d), canonical.

        Parameters
        ----------
        values
            Values of the parameters, canonical, (lanes, d).
        level
            Level of the lattice, 0 for the coarsest.
        """
        start, edges = self._first.values, self._edges[level]
        return start + np.rint((values - start) / edges) * edges

    def __call__(self, values: Matrix, level: int = 0) -> LatticeNodes:
        """Return the node of a level nearest to each of some values of the parameters, canonical, (lanes, d)."""
        known = self._known[level]
        places, which = np.unique(self.nearest(values, level), axis=0, return_inverse=True)
        keys = [tuple(place) for place in places.tolist()]
        if len(known) + len(keys) > _KEPT:
            known.clear()
        new = [i for i, key in enumerate(keys) if key not in known]
        if new:
            found = self._found(places[new], level)
            known.update({keys[i]: found.of(np.array([k])) for k, i in enumerate(new)})
        return LatticeNodes.joined([known[key] for key in keys]).of(which.reshape(-1))

    def _found(self, values: Matrix, level: int) -> LatticeNodes:
        """Continue the sheet to the values of nodes."""
        chart, borders, sheets = self._open.chart, self._open.borders, self._open.sheets
        first = self._first.of(np.zeros(len(values), dtype=np.int64))
        begin = self(values, level - 1).otherwise(first) if level else first
        own = np.full(len(values), self._number)
        y, share = follow_sheets(
            chart, borders, sheets, own, begin.values, begin.y, values, shortest=_SHORTEST, limit=_LIMIT
        )
        found = chart.solve(values, y, borders.holds(sheets, own, values))
        good = (share == 1.0) & found.converged & (found.orientation == self._open.polish.orientations[own])
        cost = np.where(good, found.cost, np.nan)
        return LatticeNodes(values, found.y, found.slopes, cost, found.cost_slopes)
