"""Continuation of extremals along straight lines of parameters.

Each step goes along the tangent plane and is corrected by Newton's method, in lanes; a step that fails is halved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.charts.borders import Borders
from perilune.charts.chart import Chart, Extremals, Holds
from perilune.charts.sheet import Sheet
from perilune.core import Matrix, Vector

Lanes = NDArray[np.int64]

MOST = 20  # evaluations of a step
_SHORTEST, _ROUNDS = 2.0**-7, 200  # step of a walk, and how many there may be
_SAME = 1e-6  # relative: one extremal
_APART, _NEAR = 0.5, 0.02  # how far a root may lie from the tangent plane: of the step there, and of 1 + |y|


def same_unknowns(y: Matrix | Vector, other: Matrix | Vector) -> NDArray[np.bool_]:
    """Return True where unknowns, (n,) or (lanes, n), are those of one extremal to rounding.

    Parameters
    ----------
    y, other
        Unknowns, canonical, (n,) or (lanes, n).
    """
    return np.linalg.norm(y - other, axis=-1) <= _SAME * (1.0 + np.linalg.norm(y, axis=-1))


class StraightContinuation:
    """Extremals continued along straight lines, in lanes, each at its present place.

    Parameters
    ----------
    chart
        Whose.
    holds
        What lanes hold at places: values of the axes, and behind them of the free parameters that `at` counts.
    places, y
        Where they begin, and unknowns there, canonical, (lanes, d + k) and (lanes, n).
    at
        Numbers of the free parameters that are held where the ways have them.
    sides
        On which side of folds each lane stays; either, if None. With them it is asked whether a long step leads back.
    near
        How far a root may lie from the tangent plane, of 1 + |y|, in addition to half of the step.
    astray
        Times as far Newton's method may lead on the way; anywhere if None.
    rough
        A residual and a last step, of 1 + |y|, that will do where errors of a sensitive flight leave no less.
    limit
        Most evaluations of a step.

    Attributes
    ----------
    y, cost, rises
        Unknowns, J and its derivatives by what is held (lanes, k), where each lane is.
    good
        Which lanes began at an extremal.
    """

    def __init__(
        self,
        chart: Chart,
        holds: Callable[[Lanes, Matrix], Holds],
        places: Matrix,
        y: Matrix,
        *,
        at: Sequence[int] = (),
        sides: Vector | None = None,
        near: float = _NEAR,
        astray: float | None = None,
        rough: float = 0.0,
        limit: int = MOST,
    ) -> None:
        self._chart, self._holds, self._at, self._d = chart, holds, list(at), len(chart.names)
        self._sides, self._near, self._astray, self._rough, self._limit = sides, near, astray, rough, limit
        count, n = y.shape
        self.y: Matrix = y.copy()
        self.cost: Vector = np.full(count, np.nan)
        self.rises: Matrix = np.full((count, len(at)), np.nan)
        self._places, self._tangents = places.copy(), np.zeros((count, places.shape[1], n))
        self.good: NDArray[np.bool_] = np.all(np.isfinite(y), axis=1)
        lanes = np.nonzero(self.good)[0]
        if len(lanes):
            found = self._solved(lanes, places[lanes], y[lanes])
            self.good[lanes] = found.converged
            self._put(lanes, places[lanes], found)

    def go(self, lanes: Lanes, targets: Matrix, shortest: float = _SHORTEST) -> Vector:
        """Lead some lanes to other places, (lanes, d + k), in steps of at least `shortest`; return their shares.

        Parameters
        ----------
        lanes
            Numbers of the lanes, (lanes,).
        targets
            Places to reach, canonical: values of the parameters, then of the held ones.
        shortest
            Least step, as a share of the way.

        Returns
        -------
        Vector
            Share of the way that each lane went, (lanes,); 1 where it arrived.
        """
        starts = self._places[lanes]
        way, share, stride = targets - starts, np.zeros(len(lanes)), np.where(self.good[lanes], 1.0, 0.0)
        for _ in range(_ROUNDS):
            some = np.nonzero((share < 1.0) & (stride >= shortest))[0]
            if not len(some):
                break
            ahead, own = np.minimum(1.0, share[some] + stride[some]), lanes[some]
            there = starts[some] + ahead[:, None] * way[some]
            there[ahead == 1.0] = targets[some[ahead == 1.0]]
            step = np.einsum("lk,lkn->ln", there - self._places[own], self._tangents[own])
            guess, length = self.y[own] + step, 1.0 + np.linalg.norm(self.y[own], axis=1)
            within = _APART * np.linalg.norm(step, axis=1) + self._near * length
            reach = {} if self._astray is None else {"reach": self._astray * within}
            found = self._solved(own, there, guess, **reach)
            with np.errstate(invalid="ignore", over="ignore"):  # of what is lost
                moved = np.linalg.norm(found.y - guess, axis=1)
            good = found.converged & (moved <= within)
            if self._sides is not None:
                good &= found.orientation == self._sides[own]
                far = np.nonzero(good & (moved > self._near * length))[0]
                good[far] = self._leads_back(own[far], there[far], found.of(far))
            self._put(own[good], there[good], found.of(np.nonzero(good)[0]))
            share[some[good]] = ahead[good]
            stride[some] *= np.where(good, 2.0, 0.5)
        return share

    def follow(
        self, targets: Matrix, steps: int, shortest: float
    ) -> tuple[NDArray[np.float64], Matrix, NDArray[np.float64]]:
        """Lead all lanes to other places; return `y`, `cost` and `rises` at all steps, NaN once a lane is lost.

        Parameters
        ----------
        targets
            Places to reach, canonical, (lanes, d + k).
        steps
            Number of equal parts of the way, at whose ends values are returned.
        shortest
            Least step, as a share of a part.

        Returns
        -------
        tuple[NDArray[np.float64], Matrix, NDArray[np.float64]]
            Unknowns (lanes, steps + 1, n), J (lanes, steps + 1), and dJ by what is held (lanes, steps + 1, k).
        """
        places, lanes = line_places(self._places, targets, steps), np.nonzero(self.good)[0]
        seen = [np.full((len(rows), steps + 1, *rows.shape[1:]), np.nan) for rows in (self.y, self.cost, self.rises)]
        for number in range(steps + 1):
            if number and len(lanes):
                self.good[lanes] = self.go(lanes, places[lanes, number], shortest) == 1.0
                lanes = lanes[self.good[lanes]]
            for out, rows in zip(seen, (self.y, self.cost, self.rises), strict=True):
                out[lanes, number] = rows[lanes]
        return seen[0], seen[1], seen[2]

    def _leads_back(self, lanes: Lanes, there: Matrix, found: Extremals) -> NDArray[np.bool_]:
        """Return True for steps that can be reversed: one that jumped to another layer from a steep one cannot."""
        if not len(lanes):
            return np.zeros(0, dtype=bool)
        back = self._places[lanes]
        guess = found.y + np.einsum("lk,lkn->ln", back - there, self._slopes(found))
        again = self._solved(lanes, back, guess)
        return again.converged & same_unknowns(self.y[lanes], again.y)

    def _solved(self, lanes: Lanes, places: Matrix, y: Matrix, **settings: Any) -> Extremals:
        found = self._chart.solve(places[:, : self._d], y, self._holds(lanes, places), limit=self._limit, **settings)
        if not self._rough:
            return found
        with np.errstate(invalid="ignore"):
            will_do = (found.roots.residuals <= self._rough) & (found.length <= self._rough)
        return replace(found, converged=found.converged | will_do)

    def _slopes(self, found: Extremals) -> NDArray[np.float64]:
        """Return derivatives of unknowns by places, (lanes, d + k, n)."""
        if not self._at:
            return found.slopes
        columns, plan = found.roots.plan.columns, self._chart.shooting.plan
        inverse = found.roots.rows[:, columns.inverse].reshape(-1, columns.n, columns.n)
        by_held = inverse[:, self._chart.places[:, None], plan.held_rows[self._at][None]]
        return np.concatenate([found.slopes, by_held.transpose(0, 2, 1)], axis=1)

    def _put(self, lanes: Lanes, places: Matrix, found: Extremals) -> None:
        self._places[lanes], self.y[lanes], self._tangents[lanes] = places, found.y, self._slopes(found)
        if self._at:
            self.cost[lanes] = found.cost
            self.rises[lanes] = self._chart.shooting.held_values(found.roots)[1][:, self._at]


def follow_sheets(
    chart: Chart,
    borders: Borders,
    sheets: Sequence[Sheet],
    which: Lanes,
    starts: Matrix,
    y: Matrix,
    targets: Matrix,
    shortest: float = _SHORTEST,
    near: float = _NEAR,
    astray: float | None = None,
    limit: int = MOST,
) -> tuple[Matrix, Vector]:
    """Follow branches along straight lines.

    Parameters
    ----------
    chart, borders, sheets, which
        Whose, and the number of each walk's.
    starts, y
        An extremal of each: values, and unknowns there, canonical.
    targets
        Values to which the lines lead, (walks, d), canonical.
    shortest, near, astray, limit
        Of `StraightContinuation`.

    Returns
    -------
    y, share
        Unknowns where each walk ended, (walks, n), and which share of its way that is, (walks,).
    """
    sides = np.array([sheet.orientation for sheet in sheets])[which]

    def holds(lanes: Lanes, values: Matrix) -> Holds:
        return borders.holds(sheets, which[lanes], values)

    walk = StraightContinuation(chart, holds, starts, y, sides=sides, near=near, astray=astray, limit=limit)
    share = walk.go(np.arange(len(starts)), targets, shortest)
    return walk.y, share


def line_places(starts: Matrix, ends: Matrix, steps: int) -> NDArray[np.float64]:
    """Return places on straight lines, (lanes, steps + 1, k).

    Parameters
    ----------
    starts, ends
        Ends of the lines, (lanes, k).
    steps
        Number of equal parts.
    """
    share = np.linspace(0.0, 1.0, steps + 1)[None, :, None]
    return starts[:, None] + share * (ends - starts)[:, None]
