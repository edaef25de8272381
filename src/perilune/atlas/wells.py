"""Other wells of J along free parameters between bounds, with the arcs of a chart.

Solves follow the families of what flies in one piece along such parameters; of arcs they list what may be the answer
there. A well in which the arcs are none at one point (one is shorter than nothing, say) is the answer at another, so
that here families are followed whatever the arcs are.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.chart import Chart, Extremals, Holds
from perilune.atlas.sheets import Borders, Sheet
from perilune.atlas.walking import MOST
from perilune.problem.extremal import Nature
from perilune.words.types import Matrix, Vector

_STEPS, _SHORTEST = 24, 2.0**-4  # of a family between its bounds, and the shortest of them
_APART, _NEAR = 0.5, 0.02  # how far a root may lie from the tangent: of the step there, and of 1 + |y|
_NOTHING = 1e-12  # of 1 + |J|: a slope that is none


def other_wells(
    chart: Chart, borders: Borders, sheet: Sheet, values: Matrix, y: Matrix
) -> Iterator[tuple[Vector, Vector, Sheet]]:
    """Minima of J along families through extremals of a sheet.

    Parameters
    ----------
    chart, borders, sheet
        Whose.
    values, y
        Where, and the unknowns there, canonical, (lanes, d) and (lanes, n).

    Yields
    ------
    values, y, sheet
        An extremal, and what it holds.
    """
    limits = borders.at(values)
    which = np.zeros(len(values), dtype=np.int64)
    for k in np.nonzero(borders.users)[0].tolist():
        low, high = limits[0][:, k], limits[1][:, k]
        lanes = np.nonzero(np.isfinite(high - low) & (high > low))[0]
        if not len(lanes):
            continue
        others = {name: side for name, side in sheet.holds.items() if name != borders.names[k]}
        alone = Sheet(holds=others, orientation=0.0, nature=Nature.UNPROVED)
        holds = borders.holds([alone], which[lanes], values[lanes])
        for side, ends in (("lower", low), ("upper", high)):
            family = _Family(chart, k, values[lanes], holds)
            at_bound = Sheet(holds={**others, borders.names[k]: side}, orientation=0.0, nature=Nature.UNPROVED)
            for inside, lane, found in family.minima(y[lanes], ends[lanes], (high - low)[lanes] / _STEPS):
                yield values[lanes[lane]], found, alone if inside else at_bound


class _Family:
    """Extremals in which one parameter is held, in lanes."""

    def __init__(self, chart: Chart, k: int, values: Matrix, holds: Holds) -> None:
        self._chart, self._k, self._values, self._holds = chart, k, values, holds

    def minima(self, y: Matrix, ends: Vector, steps: Vector) -> Iterator[tuple[bool, int, Vector]]:
        """Whether it lies between the bounds, its lane, and unknowns of each minimum on the way to some ends."""
        everywhere = np.arange(len(y))
        at = self._at(self._chart.at(self._values, y, self._holds))
        here, slope, tangent, there = self._held(everywhere, at, y)
        going, share = np.nonzero(there)[0], np.ones(len(y))
        way = np.where(ends >= at, 1.0, -1.0)
        while len(going):
            stride = np.minimum(share[going] * steps[going], np.abs(ends - at)[going])
            ahead = np.where(stride >= np.abs(ends - at)[going], ends[going], at[going] + way[going] * stride)
            step = (ahead - at[going])[:, None] * tangent[going]
            found, its_slope, its_tangent, good = self._held(going, ahead, here[going] + step)
            moved = np.linalg.norm(found - here[going] - step, axis=1)
            near = _APART * np.linalg.norm(step, axis=1) + _NEAR * (1.0 + np.linalg.norm(here[going], axis=1))
            with np.errstate(invalid="ignore"):
                good &= moved <= near
            some, rises = going[good], its_slope[good] * way[going[good]]
            falls = slope[some] * way[some]
            if len(turns := np.nonzero((falls < 0) & (rises > 0))[0]):
                weight = (-falls[turns] / (rises[turns] - falls[turns]))[:, None]
                guess = here[some[turns]] + weight * (found[good][turns] - here[some[turns]])
                between = np.column_stack([at[some[turns]], ahead[good][turns]])
                yield from self._let_go(some[turns], guess, between)
            here[some], slope[some], tangent[some] = found[good], its_slope[good], its_tangent[good]
            at[some] = ahead[good]
            share[going] = np.where(good, np.minimum(2.0 * share[going], 1.0), 0.5 * share[going])
            for lane in some[(at[some] == ends[some]) & (rises < 0)].tolist():
                yield False, lane, here[lane]
            going = going[(at[going] != ends[going]) & (share[going] >= _SHORTEST)]

    def _at(self, found: Extremals) -> Vector:
        return self._chart.shooting.held_values(found.roots)[0][:, self._k].copy()

    def _held(
        self, lanes: NDArray[np.int64], at: Vector, y: Matrix
    ) -> tuple[Matrix, Vector, Matrix, NDArray[np.bool_]]:
        """Unknowns where the parameter is held, dJ by it, their derivatives by it, and whether that was found."""
        shooting, plan = self._chart.shooting, self._chart.shooting.plan
        choice = self._holds.choice[lanes].copy()
        choice[:, self._k], choice[:, plan.held + self._k] = 1.0, at
        found = self._chart.solve(self._values[lanes], y, Holds(choice), limit=MOST)
        slope = shooting.held_values(found.roots)[1][:, self._k]
        columns = found.roots.plan.columns
        inverse = found.roots.rows[:, columns.inverse].reshape(-1, columns.n, columns.n)
        tangent = inverse[:, self._chart.places, plan.held_rows[self._k]]
        slope = np.where(np.abs(slope) > _NOTHING * (1.0 + np.abs(found.cost)), slope, 0.0)
        return found.y, slope, tangent, found.converged

    def _let_go(self, lanes: NDArray[np.int64], y: Matrix, between: Matrix) -> Iterator[tuple[bool, int, Vector]]:
        choice = self._holds.choice[lanes]
        found = self._chart.solve(self._values[lanes], y, Holds(choice), limit=MOST)
        at, (low, high) = self._at(found), np.sort(between, axis=1).T
        for i in np.nonzero(found.converged & (at >= low) & (at <= high))[0].tolist():
            yield True, int(lanes[i]), found.y[i]
