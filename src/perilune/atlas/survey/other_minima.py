"""Search for other local minima: one chart's extremals with free parameters held, along lines of the axes.

If they keep the path and have no negative arc duration, they are flights, and J with these parameters held is theirs.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from perilune.charts import (
    MOST,
    SLACK,
    Borders,
    Chart,
    Holds,
    Lanes,
    OpenChart,
    Sheet,
    StraightContinuation,
    line_places,
)
from perilune.core import Matrix, Vector
from perilune.methods import SIGNED
from perilune.problem import Nature
from perilune.structures import margins

_STEPS = 8  # at least to where a way begins
_SHORTEST = 2.0**-2  # of a step
_NEAR = 0.05  # how far a root may lie from the tangent, of 1 + |y|
_ROUGH = 1e-9  # of a root on the way, where errors of a flight leave no less
_FLOWN = 1e-6  # canonical, by which the independent re-integration on the way may miss its ends
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

        Parameters
        ----------
        points
            Values of the axes [SI], (lanes, d).
        y
            Unknowns, canonical, (lanes, n).
        bounds
            Lower and upper bounds of the held parameters, canonical.
        within
            Mask of the lanes whose extremals lie within all bounds, (lanes,).
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
        """Return the unknowns of extremals with their own parameters held, (lanes, n).

        Parameters
        ----------
        points
            Values of the axes [SI], (lanes, d).
        y
            Unknowns, canonical, (lanes, n).
        """
        values = points / self._chart.scale
        places = np.hstack([values, self._at_extremals(values, y)])
        return self._chart.solve(values, y, self._held(np.arange(len(y)), places)).y

    def follow_lines(
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
            walk.follow(first, max(steps, _STEPS), _SHORTEST)
        found, cost, slopes = walk.follow(last, steps, _SHORTEST)
        for rows in (found, cost, slopes):
            rows[back] = rows[back, ::-1]
        rises = np.einsum("lpk,lk->lp", slopes, ends - starts)
        if not self._plain:
            each, own = np.repeat(points, steps + 1, axis=0), found.reshape(-1, found.shape[2])
            cost[
                ~self._admissible(each, own, line_places(starts, ends, steps).reshape(len(each), -1)).reshape(
                    cost.shape
                )
            ] = np.nan
        return found, cost, rises

    def _held(self, _: Lanes, places: Matrix) -> Holds:
        held = self._chart.shooting.plan.held
        choice = np.zeros((len(places), 2 * held))
        choice[:, self._at], choice[:, [held + k for k in self._at]] = 1.0, places[:, len(self._chart.names) :]
        return Holds(choice)

    def _admissible(self, points: Matrix, y: Matrix, at: Matrix) -> NDArray[np.bool_]:
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
        seen = one.polish.reflights(chart.whole(values, y[lanes]), chart.p[None], choices).margins
        with np.errstate(invalid="ignore"):
            good[lanes] = (
                np.minimum(np.minimum(margin, seen.least_multiplier), np.minimum(seen.path, seen.minimum)) >= -SLACK
            )
            good[lanes] &= seen.residual <= _FLOWN
        return good


_STEPS, _SHORTEST = 24, 2.0**-4  # of a family to one of its bounds, and the shortest of them
_WAY = 8  # steps to another point
_NOTHING = 1e-12  # of 1 + |J|: a slope that is none


def other_minima(
    chart: Chart, borders: Borders, sheet: Sheet, values: Matrix, y: Matrix, among: Collection[str] | None = None
) -> Iterator[tuple[Vector, Vector, Sheet]]:
    """Yield minima of J along families through extremals of a branch.

    Parameters
    ----------
    chart, borders, sheet
        Whose.
    values, y
        Where, and the unknowns there, canonical, (lanes, d) and (lanes, n).
    among
        Names of what is followed; of all that lies between bounds if None.

    Yields
    ------
    values, y, sheet
        An extremal, and what it holds.
    """
    limits = borders.at(values)
    which = np.zeros(len(values), dtype=np.int64)
    for k in np.nonzero(borders.users)[0].tolist():
        if among is not None and borders.names[k] not in among:
            continue
        low, high = limits[0][:, k], limits[1][:, k]
        lanes = np.nonzero(np.isfinite(high - low) & (high > low))[0]
        if not len(lanes):
            continue
        others = {name: side for name, side in sheet.holds.items() if name != borders.names[k]}
        alone = Sheet(holds=others, orientation=0.0, nature=Nature.UNPROVED)
        family = _HeldParameterFamily(chart, k, values[lanes], borders.holds([alone], which[lanes], values[lanes]))
        for side, ends in (("lower", low), ("upper", high)):
            at_bound = Sheet(holds={**others, borders.names[k]: side}, orientation=0.0, nature=Nature.UNPROVED)
            for inside, lane, found in family.minima(y[lanes], ends[lanes]):
                yield values[lanes[lane]], found, alone if inside else at_bound


def minima_around(
    chart: Chart, borders: Borders, names: Collection[str], points: Matrix, values: Matrix, y: Matrix
) -> Iterator[tuple[Vector, Vector, Sheet]]:
    """Yield minima at points (lanes, d) along the parameters `names`, of families through extremals at other points.

    The extremals, at `values` with unknowns `y`, are continued there with these parameters held, so that none of them
    need be a minimum there.

    Parameters
    ----------
    chart, borders
        Chart of the families, and the bounds of its parameters.
    names
        Free parameters that are held; what the chart does not have is left out.
    points
        Values of the axes to reach, canonical, (lanes, d).
    values, y
        Values of the axes, (lanes, d), and unknowns, (lanes, n), of the extremals, canonical.
    """
    at = [borders.names.index(name) for name in names if name in borders.names]
    held = chart.shooting.plan.held
    nothing = Holds(np.zeros((len(y), 2 * held)))
    begins = chart.shooting.held_values(chart.at(values, y, nothing).roots)[0][:, at]

    def holds(_: Lanes, places: Matrix) -> Holds:
        choice = np.zeros((len(places), 2 * held))
        choice[:, at], choice[:, [held + k for k in at]] = 1.0, places[:, values.shape[1] :]
        return Holds(choice)

    walk = StraightContinuation(chart, holds, np.hstack([values, begins]), y, at=at)
    walk.follow(np.hstack([points, begins]), _WAY, _SHORTEST)
    there = np.nonzero(walk.good)[0]
    yield from other_minima(chart, borders, BARE, points[there], walk.y[there], names)


class _HeldParameterFamily:
    """Extremals with one parameter held, in lanes."""

    def __init__(self, chart: Chart, k: int, values: Matrix, holds: Holds) -> None:
        self._chart, self._k, self._values, self._holds = chart, k, values, holds

    def minima(self, y: Matrix, ends: Vector) -> Iterator[tuple[bool, int, Vector]]:
        """Yield each minimum on the way to some ends: True if it lies between the bounds, its lane, and unknowns."""
        begins, last = self._at(self._values, y, self._holds), np.column_stack([self._values, ends])
        walk = StraightContinuation(self._chart, self._held, np.column_stack([self._values, begins]), y, at=[self._k])
        found, cost, slopes = walk.follow(last, _STEPS, _SHORTEST)
        rises = slopes[:, :, 0] * np.sign(ends - begins)[:, None]
        with np.errstate(invalid="ignore"):
            rises = np.where(np.abs(rises) > _NOTHING * (1.0 + np.abs(cost)), rises, 0.0)
            lanes, turns = np.nonzero((rises[:, :-1] < 0) & (rises[:, 1:] > 0))
            falling = np.nonzero(rises[:, -1] < 0)[0]
        weight = rises[lanes, turns] / (rises[lanes, turns] - rises[lanes, turns + 1])
        guess = found[lanes, turns] + weight[:, None] * (found[lanes, turns + 1] - found[lanes, turns])
        share = np.stack([turns, turns + 1]) / _STEPS
        if len(lanes):
            yield from self._let_go(lanes, guess, begins[lanes] + share * (ends - begins)[lanes])
        for lane in falling.tolist():
            yield False, lane, found[lane, -1]

    def _at(self, values: Matrix, y: Matrix, holds: Holds) -> Vector:
        found = self._chart.at(values, y, holds)
        return self._chart.shooting.held_values(found.roots)[0][:, self._k].copy()

    def _held(self, lanes: Lanes, places: Matrix) -> Holds:
        choice = self._holds.choice[lanes].copy()
        choice[:, self._k], choice[:, self._chart.shooting.plan.held + self._k] = 1.0, places[:, -1]
        return Holds(choice)

    def _let_go(self, lanes: Lanes, y: Matrix, between: Matrix) -> Iterator[tuple[bool, int, Vector]]:
        holds = Holds(self._holds.choice[lanes])
        found = self._chart.solve(self._values[lanes], y, holds, limit=MOST)
        at, (low, high) = self._at(self._values[lanes], found.y, holds), np.sort(between, axis=0)
        for i in np.nonzero(found.converged & (at >= low) & (at <= high))[0].tolist():
            yield True, int(lanes[i]), found.y[i]
