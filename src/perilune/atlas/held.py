"""Extremals of one chart with some free parameters held, along straight lines of the axes and of these.

If they keep the path and have no negative arc duration, they are flights, and J with these parameters held is theirs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.chart import Holds
from perilune.atlas.charted import OpenChart
from perilune.atlas.reflight import SLACK
from perilune.atlas.sheets import Sheet
from perilune.atlas.walking import Lanes, StraightContinuation, line_places
from perilune.methods.starts import SIGNED
from perilune.problem.extremal import Nature
from perilune.structures.structure import margins
from perilune.words.types import Matrix

_STEPS = 8  # at least to where a way begins
_SHORTEST = 2.0**-2  # of a step
_NEAR = 0.05  # how far a root may lie from the tangent, of 1 + |y|
_ROUGH = 1e-9  # of a root on the way, where errors of a flight leave no less
_FLOWN = 1e-6  # canonical, by which the second flight on the way may miss its ends
Bounds = tuple[Matrix, Matrix]  # lower and upper, (lanes, k) each
BARE = Sheet(holds={}, orientation=0.0, nature=Nature.UNPROVED)


class HeldFamilies:
    """Extremals of one chart with some free parameters held.

    Parameters
    ----------
    charted
        The chart.
    names
        Of what is held; all else is free.
    """

    def __init__(self, charted: OpenChart, names: Sequence[str]) -> None:
        self._charted, self._chart = charted, charted.chart
        self._at = [charted.borders.names.index(name) for name in names]
        user = charted.chart.user
        self._plain = not charted.of_arcs and not any(margins(user, k) for k in range(len(user.phases)))

    def bounds(self, points: Matrix) -> Bounds:
        """Return lower and upper bounds of the held parameters, (lanes, k) each."""
        lower, upper = self._charted.borders.at(points / self._chart.scale)
        return lower[:, self._at], upper[:, self._at]

    def clipped(self, points: Matrix, y: Matrix, bounds: Bounds, within: NDArray[np.bool_] | bool = False) -> Matrix:
        """Return values of the held parameters at extremals, clipped to `bounds`, (lanes, k).

        Extremals `within` all bounds, which gain by leaving none, are flown only if their unknowns do not give them: a
        range with a multiplier is at its bound.
        """
        values, free = points / self._chart.scale, self._chart.shooting.plan.free
        whole, conditions = self._chart.whole(values, y), self._chart.conditions
        own, at = whole[:, conditions.free_at], np.full((len(y), len(self._at)), np.nan)
        for column, k in enumerate(self._at):
            if k < free:
                at[:, column] = own[:, k]
            else:
                nu = whole[:, conditions.ranges[k - free][1]]
                bound = np.where(nu < 0.0, bounds[0][:, column], bounds[1][:, column])
                at[:, column] = np.where(within & (np.abs(nu) > SIGNED), bound, np.nan)
        if len(left := np.nonzero(np.isnan(at).any(axis=1))[0]):
            at[left] = self._at_extremals(values[left], y[left])
        return np.clip(at, *bounds)

    def _at_extremals(self, values: Matrix, y: Matrix) -> Matrix:
        found = self._chart.at(values, y, Holds(np.zeros((len(y), 2 * self._chart.shooting.plan.held))))
        return self._chart.shooting.held_values(found.roots)[0][:, self._at]

    def held_there(self, points: Matrix, y: Matrix) -> Matrix:
        """Return the unknowns of extremals with their own parameters held, (lanes, n)."""
        values = points / self._chart.scale
        places = np.hstack([values, self._at_extremals(values, y)])
        return self._chart.solve(values, y, self._held(np.arange(len(y)), places)).y

    def along(
        self, points: Matrix, begins: Matrix, starts: Matrix, ends: Matrix, steps: int
    ) -> tuple[NDArray[np.float64], Matrix, Matrix]:
        """Return unknowns, J and dJ along lines from starts to ends; J is NaN where no flight keeps the path.

        Parameters
        ----------
        points
            Values of the axes [SI], (lanes, d).
        begins
            Extremals to begin with, canonical: values of the axes and unknowns, (lanes, d + n).
        starts, ends
            Values of the held parameters at the ends of the lines, canonical, (lanes, k).
        steps
            Number of steps.
        """
        there, first, last = (np.hstack([points / self._chart.scale, at]) for at in (ends, starts, ends))
        values, y = np.hsplit(begins, [points.shape[1]])
        begin = np.hstack([values, self._at_extremals(values, y)])
        back = np.linalg.norm(begin - there, axis=1) < np.linalg.norm(begin - first, axis=1)
        first[back], last[back] = last[back], first[back]
        walk = StraightContinuation(self._chart, self._held, begin, y, at=self._at, near=_NEAR, rough=_ROUGH)
        if (begin != first).any():
            walk.along(first, max(steps, _STEPS), _SHORTEST)
        found, cost, slopes = walk.along(last, steps, _SHORTEST)
        for rows in (found, cost, slopes):
            rows[back] = rows[back, ::-1]
        rises = np.einsum("lpk,lk->lp", slopes, ends - starts)
        if not self._plain:
            each, own = np.repeat(points, steps + 1, axis=0), found.reshape(-1, found.shape[2])
            cost[
                ~self._kept(each, own, line_places(starts, ends, steps).reshape(len(each), -1)).reshape(cost.shape)
            ] = np.nan
        return found, cost, rises

    def _held(self, _: Lanes, places: Matrix) -> Holds:
        held = self._chart.shooting.plan.held
        choice = np.zeros((len(places), 2 * held))
        choice[:, self._at], choice[:, [held + k for k in self._at]] = 1.0, places[:, len(self._chart.names) :]
        return Holds(choice)

    def _kept(self, points: Matrix, y: Matrix, at: Matrix) -> NDArray[np.bool_]:
        """Return True for flights that keep the path and have no negative arc duration."""
        one, chart = self._charted, self._chart
        good: NDArray[np.bool_] = np.all(np.isfinite(y), axis=1)
        lanes = np.nonzero(good)[0]
        if not len(lanes):
            return good
        values = points[lanes] / chart.scale
        holds = self._held(lanes, np.hstack([values, at[lanes]]))
        choices, found = chart.choice(values, holds), chart.at(values, y[lanes], holds)
        held, rises = chart.shooting.held_values(found.roots)
        margin = one.borders.margins(
            [BARE], np.zeros(len(lanes), dtype=np.int64), found.roots.y, held, rises, choices, one.borders.at(values)
        )
        seen = one.polish.reflights(chart.whole(values, y[lanes]), chart.p[None], choices).seen
        with np.errstate(invalid="ignore"):
            good[lanes] = np.minimum(np.minimum(margin, seen.pays), np.minimum(seen.path, seen.minimum)) >= -SLACK
            good[lanes] &= seen.residual <= _FLOWN
        return good
