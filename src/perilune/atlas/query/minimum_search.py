"""Descent from an inadmissible extremal to the admissible minimum of its basin.

An extremal that breaks the path, or lies beyond a bound, has free parameters between bounds. With these held at its
values, or at the bound, flights of one of the charts keep the path; from there J falls to an answer in the same basin.
It is the right one if J rises all along the straight line back from the answer, over charts whose flights keep the path
there; where J first turns on the line another answer lies, which may be known or not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.query.keeping import correct_active_set
from perilune.atlas.survey.other_minima import BARE, Bounds, HeldFamilies
from perilune.charts import SLACK, Borders, Lanes, OpenChart
from perilune.core import Matrix, Vector

_STEPS = 16  # of a way from bound to bound
_ROUNDS = 2  # over the ranges of several parameters
_BETWEEN = 8  # parts of a step in which J is looked for where it is less than at both ends
_NOTHING = 1e-9  # of 1 + |J|: a slope that is none
_BESIDE = 2.0**-10  # of a range: within that no other minimum is looked for


@dataclass
class KnownExtremals:
    """Extremal of a chart in each lane: number of the chart, -1 for none, unknowns by charts, and J."""

    chart: Lanes
    y: list[Matrix]
    cost: Vector
    sheet: Lanes

    @classmethod
    def none(cls, charted: Sequence[OpenChart], count: int) -> KnownExtremals:
        """Return lanes without extremals.

        Parameters
        ----------
        charted
            Charts of the atlas.
        count
            Number of lanes.
        """
        y = [np.full((count, one.unknowns), np.nan) for one in charted]
        return cls(np.full(count, -1), y, np.full(count, np.nan), np.full(count, -1))

    def put(self, lanes: Lanes, others: KnownExtremals, its: Lanes) -> None:
        """Take over some lanes of others.

        Parameters
        ----------
        lanes
            Numbers of the lanes that are replaced, (k,).
        others, its
            Extremals that replace them, and the lanes of these, (k,).
        """
        for name in ("chart", "cost", "sheet"):
            getattr(self, name)[lanes] = getattr(others, name)[its]
        for own, other in zip(self.y, others.y, strict=True):
            own[lanes] = other[its]

    def of(self, lanes: Lanes) -> KnownExtremals:
        """Some of the lanes."""
        return KnownExtremals(self.chart[lanes], [y[lanes] for y in self.y], self.cost[lanes], self.sheet[lanes])


@dataclass
class _StraightPaths:
    """Flights on straight lines, (lanes, places): number of the chart, unknowns by charts, J, and dJ along the line."""

    chart: Lanes
    y: list[NDArray[np.float64]]
    cost: Matrix
    rises: Matrix

    def lowest(self) -> tuple[Vector, Lanes]:
        """Return the least J of the cubics between neighbouring places, and the numbers of these, (lanes,)."""
        t = np.linspace(0.0, 1.0, _BETWEEN + 1)[1:-1, None, None]
        J, step = self.cost, self.rises / (self.cost.shape[1] - 1)
        with np.errstate(invalid="ignore"):
            between = (
                (1 + 2 * t) * (1 - t) ** 2 * J[:, :-1] + t * (1 - t) ** 2 * step[:, :-1]
                + t**2 * (3 - 2 * t) * J[:, 1:] + t**2 * (t - 1) * step[:, 1:]
            ).min(axis=0)  # fmt: skip
        least = np.where(np.isfinite(J), J, np.inf)
        least[:, 1:] = np.fmin(least[:, 1:], between)
        return least.min(axis=1), least.argmin(axis=1)


class MinimumSearch:
    """Search for minima over all charts of an atlas.

    Attributes
    ----------
    names
        Names of the parameters to search: those between two bounds, in each chart.
    settles
        True if nothing else is free; otherwise basins may differ in other parameters, and the search ends no doubt.
    """

    def __init__(self, charted: Sequence[OpenChart]) -> None:
        self._charted = charted
        each = [_bounded(one.borders) for one in charted]
        self.names: list[str] = [name for name in each[0] if all(name in own for own in each)] if each else []
        free = {n for one in charted for n in one.chart.user.free_names if n not in one.chart.names}
        self.settles: bool = bool(self.names) and free <= set(self.names)
        self._of = [HeldFamilies(one, self.names) for one in charted]

    def best_lies_at(self, points: Matrix, outdoing: KnownExtremals, best: KnownExtremals) -> NDArray[np.bool_]:
        """Return True where the best answer lies at the extremal that breaks the path: there is no line to follow.

        Parameters
        ----------
        points
            Values of the axes [SI], (lanes, d).
        outdoing, best
            The extremals that break the path, and the best answers.
        """
        bounds, none = self._bounds(points), np.zeros((len(points), len(self.names)))
        places = [self._places(points, bounds, known, none) for known in (outdoing, best)]
        return (best.chart >= 0) & (_scaled_distance(bounds, *places) <= _BESIDE)

    def become(
        self, points: Matrix, outdoing: KnownExtremals, begins: Sequence[Matrix], best: KnownExtremals
    ) -> KnownExtremals:
        """Follow inadmissible extremals to the admissible minimum of their basin; of chart -1 where none is found.

        Parameters
        ----------
        points
            Values of the axes [SI], (lanes, d).
        outdoing
            The extremals; those of a branch lie beyond bounds, or gain by leaving one.
        begins
            An extremal of each chart, near or far, NaN where none is known: canonical values of the axes, unknowns.
        best
            The best answer that is known, if any.
        """
        target = self._places(points, self._bounds(points), outdoing, np.zeros((len(points), len(self.names))))
        found, held = KnownExtremals.none(self._charted, len(points)), np.nonzero(outdoing.sheet >= 0)[0]
        led = self._settled(points[held], outdoing.of(held))
        if self.names:  # what would be better at a bound, and breaks the path there, is followed as well
            with np.errstate(invalid="ignore"):
                better = np.nonzero((led.chart >= 0) & (led.cost < best.cost[held]))[0]
            led.chart[better[~self._keep_the_path(points[held[better]], led.of(better))]] = -1
        here = (
            self._confirmed(points[held], target[held], [y[held] for y in begins], led)
            if self.names
            else led.chart >= 0
        )
        found.put(held[here], led, np.nonzero(here)[0])
        if not self.names:
            return found
        left = np.nonzero(found.chart < 0)[0]
        known, turned = self._down(points[left], target[left], [y[left] for y in begins], best.of(left))
        found.put(left[known], best, left[known])
        lanes = np.nonzero((turned.chart >= 0) & ~known)[0]
        candidates, lanes = self._settled(points[left[lanes]], turned.of(lanes)), left[lanes]
        here = self._confirmed(points[lanes], target[lanes], [y[lanes] for y in begins], candidates)
        found.put(lanes[here], candidates, np.nonzero(here)[0])
        return found

    def all_over(
        self, points: Matrix, begins: Sequence[Matrix], best: KnownExtremals, outdoing: KnownExtremals | None = None
    ) -> KnownExtremals:
        """Search along each of the parameters between bounds, beginning at the answers, for lower minima of J.

        Returns the answers themselves where there is none, and chart -1 where no flight is known in part of a range or
        the lower minimum is not found. Several parameters are searched in turn, the others held, from the least J found
        so far.

        Parameters
        ----------
        points, begins
            As of `become`.
        best
            The answers.
        outdoing
            Extremals from which to begin in place of the answers, with several parameters; the minimum reached is
            returned whether better or not.
        """
        found, known = best.of(np.arange(len(points))), best.chart >= 0
        bounds = self._bounds(points)
        places = self._places(points, bounds, best, np.zeros((len(points), len(self.names))))
        bottom, least = KnownExtremals.none(self._charted, len(points)), best.cost.copy()
        if outdoing is not None:
            places, least = self._places(points, bounds, outdoing, places), np.full(len(points), np.inf)
        for _ in range(1 if len(self.names) == 1 else _ROUNDS):
            before = least.copy()
            for k in range(len(self.names)):
                lanes = np.nonzero(known)[0]
                some = [y[lanes] for y in begins]
                known[lanes] = self._lowered(k, points[lanes], places, some, best.of(lanes), lanes, bottom, least)
            with np.errstate(invalid="ignore"):
                if not (known & (least < before)).any():
                    break
        lanes = np.nonzero(known & (bottom.chart >= 0))[0]
        led = self._settled(points[lanes], bottom.of(lanes))
        if outdoing is None:
            led.chart[~(led.cost < best.cost[lanes])] = -1
        else:
            here = self._confirmed(points[lanes], places[lanes], [y[lanes] for y in begins], led)
            led.chart[~here] = -1
        found.put(lanes, led, np.arange(len(lanes)))
        found.chart[~known] = -1
        return found

    def _lowered(
        self,
        k: int,
        points: Matrix,
        places: Matrix,
        begins: Sequence[Matrix],
        best: KnownExtremals,
        lanes: Lanes,
        bottom: KnownExtremals,
        least: Vector,
    ) -> NDArray[np.bool_]:
        """Search for the least J along one parameter, from bound to bound; return True where its whole range is flown.

        Fills in `places`, extremals at the `bottom`, and the `least` J of `lanes`.
        """
        known, starts = np.ones(len(lanes), dtype=bool), places[lanes]
        for bounds in self._bounds(points):
            ends = starts.copy()
            ends[:, k] = bounds[:, k]
            way = self._best_along_lines(points, starts, ends, begins, best, _STEPS)
            known &= (way.chart >= 0).all(axis=1)
            lowest, at = way.lowest()
            for row, lane in enumerate(lanes.tolist()):
                bar = least[lane]
                if known[row] and (np.isinf(bar) or lowest[row] < bar - _NOTHING * (1.0 + abs(bar))):
                    least[lane], number = lowest[row], int(way.chart[row, at[row]])
                    bottom.chart[lane], bottom.y[number][lane] = number, way.y[number][row, at[row]]
                    places[lane] = starts[row] + at[row] / _STEPS * (ends[row] - starts[row])
        return known

    def _bounds(self, points: Matrix) -> Bounds:
        """Return the bounds of the followed parameters, which the user states, so that they hold for each chart."""
        return self._of[0].bounds(points)

    def _places(self, points: Matrix, bounds: Bounds, known: KnownExtremals, otherwise: Matrix) -> Matrix:
        """Return values of the searched parameters at extremals, within bounds, (lanes, k); `otherwise` without one."""
        at = otherwise.copy()
        for number, family in enumerate(self._of):
            if (lanes := np.nonzero(known.chart == number)[0]).size:
                own = bounds[0][lanes], bounds[1][lanes]
                at[lanes] = family.clipped(points[lanes], known.y[number][lanes], own, known.sheet[lanes] < 0)
        return at

    def _confirmed(
        self, points: Matrix, target: Matrix, begins: Sequence[Matrix], answers: KnownExtremals
    ) -> NDArray[np.bool_]:
        """Return True where the target lies in the basin of the answer, (lanes,)."""
        lanes = np.nonzero(answers.chart >= 0)[0]
        found = np.zeros(len(points), dtype=bool)
        if len(lanes):
            some = [y[lanes] for y in begins]
            found[lanes] = self._down(points[lanes], target[lanes], some, answers.of(lanes))[0]
        return found

    def _settled(self, points: Matrix, guesses: KnownExtremals) -> KnownExtremals:
        """Solve from guesses by Newton's method with active-set correction of bounds; chart -1 where it fails."""
        found = KnownExtremals.none(self._charted, len(points))
        for number, sheet in np.unique(np.column_stack([guesses.chart, guesses.sheet]), axis=0).tolist():
            if number >= 0:
                one, lanes = self._charted[number], np.nonzero((guesses.chart == number) & (guesses.sheet == sheet))[0]
                first, values = one.sheets[sheet] if sheet >= 0 else BARE, points[lanes] / one.chart.scale
                led = correct_active_set(one.chart, one.borders, one.sheets, first, values, guesses.y[number][lanes])
                good = led.sheet >= 0
                found.chart[lanes[good]], found.sheet[lanes[good]] = number, led.sheet[good]
                found.y[number][lanes[good]], found.cost[lanes[good]] = led.y[good], led.cost[good]
        return found

    def _keep_the_path(self, points: Matrix, known: KnownExtremals) -> NDArray[np.bool_]:
        """Return True for extremals of branches that keep the path, (lanes,)."""
        found = np.zeros(len(points), dtype=bool)
        for number, one in enumerate(self._charted):
            if (lanes := np.nonzero(known.chart == number)[0]).size:
                values = points[lanes] / one.chart.scale
                choice = one.chart.choice(values, one.borders.holds(one.sheets, known.sheet[lanes], values))
                y = one.chart.whole(values, known.y[number][lanes])
                found[lanes] = one.polish.reflights(y, one.chart.p[None], choice).margins.path >= -SLACK
        return found

    def _down(
        self, points: Matrix, target: Matrix, begins: Sequence[Matrix], best: KnownExtremals
    ) -> tuple[NDArray[np.bool_], KnownExtremals]:
        """Return True where J falls all along from targets to answers, and elsewhere the first minimum on the way."""
        if not len(points):
            return np.zeros(0, dtype=bool), KnownExtremals.none(self._charted, 0)
        bounds = self._bounds(points)
        starts = self._places(points, bounds, best, target)
        far = _scaled_distance(bounds, target, starts)
        steps = 2 ** np.ceil(np.log2(np.clip(_STEPS * far, 2, _STEPS))).astype(np.int64)  # of a lane, in any company
        known, turned = (best.chart >= 0) & (far <= _BESIDE), KnownExtremals.none(self._charted, len(points))
        for last in np.unique(steps[~known]).tolist():
            lanes = np.nonzero(~known & (steps == last))[0]
            own = points[lanes], starts[lanes], target[lanes], [y[lanes] for y in begins], best.of(lanes)
            way = self._best_along_lines(*own, last)
            for row, lane in enumerate(lanes.tolist()):
                none = np.nonzero(way.chart[row] < 0)[0]
                falls = np.nonzero(way.rises[row] < -_NOTHING * (1.0 + np.abs(way.cost[row])))[0]
                until = max(none.max(initial=-1), falls.max(initial=-1))
                known[lane] = until < 0 and best.chart[lane] >= 0
                at = min(until + 1, last) if falls.max(initial=-1) > none.max(initial=-1) else -1
                if best.chart[lane] < 0 and not len(none):
                    at = last
                if not known[lane] and at >= 0 and (number := int(way.chart[row, at])) >= 0:
                    turned.chart[lane], turned.y[number][lane] = number, way.y[number][row, at]
        return known, turned

    def _best_along_lines(
        self, points: Matrix, starts: Matrix, ends: Matrix, begins: Sequence[Matrix], best: KnownExtremals, steps: int
    ) -> _StraightPaths:
        """Return the best flights of all charts that keep the path, on straight lines from starts to ends."""
        shape, n = (len(points), steps + 1), range(len(self._charted))
        way = _StraightPaths(
            np.full(shape, -1), [np.full((*shape, self._charted[i].unknowns), np.nan) for i in n],
            np.full(shape, np.inf), np.full(shape, np.nan),
        )  # fmt: skip
        own = best.chart
        for number, family in enumerate(self._of):  # first that of the answer, which most often says all
            begin = np.hstack([points / self._charted[number].chart.scale, best.y[number]])
            self._fill_in_flights(number, family, np.nonzero(own == number)[0], points, starts, ends, begin, way)
        for number, family in enumerate(self._of):
            left = np.nonzero((own != number) & (way.chart < 0).any(axis=1) & np.isfinite(begins[number][:, 0]))[0]
            self._fill_in_flights(number, family, left, points, starts, ends, begins[number], way)
        return way

    @staticmethod
    def _fill_in_flights(
        number: int,
        family: HeldFamilies,
        lanes: Lanes,
        points: Matrix,
        starts: Matrix,
        ends: Matrix,
        begins: Matrix,
        way: _StraightPaths,
    ) -> None:
        """Fill in flights of one chart on some lines where they keep the path and are better than others."""
        if not len(lanes):
            return
        found, cost, rises = family.follow_lines(
            points[lanes], begins[lanes], starts[lanes], ends[lanes], way.chart.shape[1] - 1
        )
        with np.errstate(invalid="ignore"):
            better = np.isfinite(cost) & (cost < way.cost[lanes])
        way.y[number][lanes] = found
        way.chart[lanes] = np.where(better, number, way.chart[lanes])
        way.rises[lanes] = np.where(better, rises, way.rises[lanes])
        way.cost[lanes] = np.where(better, cost, way.cost[lanes])


def _scaled_distance(bounds: Bounds, target: Matrix, starts: Matrix) -> Vector:
    """Return the largest distance of targets from starts over the parameters, as a share of their ranges."""
    spread = np.maximum(bounds[1] - bounds[0], np.finfo(float).tiny)
    return (np.abs(target - starts) / spread).max(axis=1, initial=0.0)


def _bounded(borders: Borders) -> list[str]:
    """Return the names of the user's parameters and ranges that lie between two bounds."""
    chart = borders.chart
    given = np.array([[chart.user.given[name].value for name in chart.names]])
    lower, upper = borders.at(given / chart.scale)
    return [borders.names[k] for k in np.nonzero(borders.users & np.isfinite(upper[0] - lower[0]))[0].tolist()]
