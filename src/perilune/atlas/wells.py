"""Other local minima of J along free parameters between bounds, with the arcs of a chart.

Solves follow families of extremals of a single arc along such parameters; of several arcs they list only candidates of
the point solved. A minimum whose arcs are not admissible at one point (one has a negative duration, say) is the answer
at another, so families are followed here whatever their arcs are.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from perilune.atlas.chart import Chart, Holds
from perilune.atlas.held import BARE
from perilune.atlas.sheets import Borders, Sheet
from perilune.atlas.walking import MOST, Lanes, StraightContinuation
from perilune.problem.extremal import Nature
from perilune.words.types import Matrix, Vector

_STEPS, _SHORTEST = 24, 2.0**-4  # of a family to one of its bounds, and the shortest of them
_WAY = 8  # steps to another point
_NOTHING = 1e-12  # of 1 + |J|: a slope that is none


def other_minima(
    chart: Chart, borders: Borders, sheet: Sheet, values: Matrix, y: Matrix, among: Collection[str] | None = None
) -> Iterator[tuple[Vector, Vector, Sheet]]:
    """Yield minima of J along families through extremals of a sheet.

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
    walk.along(np.hstack([points, begins]), _WAY, _SHORTEST)
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
        found, cost, slopes = walk.along(last, _STEPS, _SHORTEST)
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
