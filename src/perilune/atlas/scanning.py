"""Scan for flights that keep the path, with one free parameter held over all of its range, with known arcs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.cells import same_unknowns
from perilune.atlas.chart import Chart
from perilune.atlas.charted import OpenChart
from perilune.atlas.course import ArcSequence
from perilune.atlas.held import HeldFamilies
from perilune.atlas.region import Region
from perilune.problem.extremal import Extremal
from perilune.problem.problem import Problem
from perilune.structures.structure import margins
from perilune.words.types import Matrix, Vector

_STEPS = 16  # from bound to bound
_MOST = 256  # points


def scanned_names(problem: Problem, region: Region) -> list[str]:
    """Return free parameters and durations between bounds, without axes, along which J may have several minima."""
    return [f.name for f in problem.free if math.isfinite(f.upper - f.lower) and f.name not in region.names]


def scanned_points(region: Region) -> Matrix:
    """Return corners and middles of bricks [SI]; a selection all over the region if there are very many."""
    middles = [0.5 * (np.array(axis.edges[:-1]) + np.array(axis.edges[1:])) for axis in region.axes]
    points = np.vstack([region.corners()[1], list(product(*middles))])
    return points[np.linspace(0, len(points) - 1, min(len(points), _MOST)).astype(np.int64)]


class Scan:
    """Flights over all ranges, at points all over a region.

    Parameters
    ----------
    problem, region
        What is mapped.
    widths
        Of charts [SI].

    Attributes
    ----------
    names
        Of what is scanned; none where there are no conditions of the path that an arc could keep.
    """

    def __init__(self, problem: Problem, region: Region, widths: Vector) -> None:
        self._problem, self._region, self._widths = problem, region, widths
        held_back = any(margins(problem, k) for k in range(len(problem.phases)))
        self.names: list[str] = scanned_names(problem, region) if held_back else []
        self._points = scanned_points(region)
        shape = (len(self.names), len(self._points), _STEPS + 1)
        self._met: NDArray[np.bool_] = np.zeros(shape, dtype=bool)  # by extremals
        self._flown: NDArray[np.bool_] = np.zeros(shape, dtype=bool)
        self._known: dict[str, NDArray[np.float64]] = {}  # unknowns of what was met, by what it goes through

    def add(
        self,
        values: Vector,
        course: ArcSequence,
        extremals: Sequence[Extremal],
        place: tuple[int, int, int] | None = None,
    ) -> bool:
        """Follow the arcs of an answer where no flight is known; return True if more flights were found.

        `place` is that of an answer solved within a `gap`, where earlier extremals lead nowhere else.
        """
        chart = Chart(self._problem, self._region.names, self._widths, course)
        first = next((e for e in extremals if len(e.unknowns or ()) == len(chart.own.unknowns)), None)
        if first is None:
            return False
        y = chart.told(np.array(first.unknowns))
        known = self._known.setdefault(course.text, np.full((*self._met.shape, len(y)), np.nan))
        before = np.count_nonzero(self._flown)
        said = {**course.document(), "widths": self._widths.tolist(), "times": [], "sheets": []}
        charted = OpenChart(self._problem, self._region, {**said, "unknowns": len(chart.places)})
        with np.errstate(invalid="ignore"):  # of several arcs a duration may have no bound that is held
            lower, upper = charted.borders.at(self._points / chart.scale)
            bounded: list[bool] = np.isfinite(upper - lower).min(axis=0).tolist()
        own = [name for name, both in zip(charted.borders.names, bounded, strict=True) if both and name in self.names]
        families = HeldFamilies(charted, own)
        if place is not None and same_unknowns(known[place], families.held_there(values[None], y[None])[0]):
            return False
        begin = np.concatenate([values / chart.scale, y])
        for at, name in enumerate(own):
            k = self.names.index(name)
            lanes = np.nonzero(~self._flown[k].all(axis=1))[0]
            if len(lanes):
                points, begins = self._points[lanes], begin[None].repeat(len(lanes), axis=0)
                lower, upper = families.bounds(points)
                starts = families.clipped(points, begins[:, len(values) :], (lower, upper))
                ends = starts.copy()
                starts[:, at], ends[:, at] = lower[:, at], upper[:, at]
                found, cost, _ = families.along(points, begins, starts, ends, _STEPS)
                self._met[k, lanes] |= (met := np.isfinite(found[:, :, 0]))
                known[k, lanes] = np.where(met[:, :, None], found, known[k, lanes])
                self._flown[k, lanes] |= np.isfinite(cost)
        return bool(np.count_nonzero(self._flown) > before)

    def gap(self) -> tuple[tuple[int, int, int], Vector, str, float] | None:
        """Return the middle of the longest range part with extremals but no flight: place, point [SI], name, share.

        Each gap is returned once.
        """
        gaps, best = self._met & ~self._flown, (0, 0, 0, 0)
        for k, lane in zip(*np.nonzero(gaps.any(axis=2)), strict=True):
            ends = np.flatnonzero(np.diff(np.concatenate([[0], gaps[k, lane], [0]])))
            length, first = max((end - begin, -begin) for begin, end in ends.reshape(-1, 2).tolist())
            best = max(best, (length, int(k), int(lane), -first))
        length, k, lane, first = best
        if not length:
            return None
        self._flown[k, lane, first : first + length] = True
        amid = first + (length - 1) // 2
        return (k, lane, amid), self._points[lane], self.names[k], amid / _STEPS
