"""Cold starts of a survey, and the arc sequences of their answers.

The problem is solved at the middle and at the corners of the region, and between points whose answers have different
arcs. An answer shows only the arcs of its own basin. So with conditions of the path, flights with known arcs are also
followed along free parameters between bounds, and where extremals with such a parameter held break the path, and no
flight keeps it, the problem is solved with the parameter held.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.region import Region
from perilune.atlas.survey.other_minima import HeldFamilies
from perilune.charts import ArcSequence, Chart, OpenChart, arc_sequence_of, same_unknowns
from perilune.core import Matrix, PeriluneError, Vector, Watch
from perilune.methods import Indirect, Search
from perilune.problem import Extremal, Problem, free_name, narrow_free_parameters, preflight, refuse_impossible
from perilune.structures import margins

_NONE = "no answer"  # where other points have the arcs of theirs
_HALVINGS = 3  # times that a point is looked at between answers of two kinds
_MOST_HELD, _MOST_FAILED = 16, 3  # solves with a parameter held, and those that find nothing more


@dataclass(frozen=True)
class SolvedPoint:
    """Extremals at a point [SI], with their arcs, and a parameter that is held there, if any."""

    values: Vector
    course: ArcSequence
    extremals: Sequence[Extremal]
    held: bool = False


@dataclass
class RegionSolver:
    """Solves of a region.

    Parameters
    ----------
    problem, region, method, widths
        As of `perilune.atlas.survey.survey.Survey`.
    watch
        Receives lines of text, and each iteration of what is solved.

    Attributes
    ----------
    notes
        Where there was no answer, and why, in sentences.
    """

    problem: Problem
    region: Region
    method: Indirect
    watch: Watch
    widths: Vector
    notes: list[str] = field(default_factory=list)

    def run(self) -> list[SolvedPoint]:
        """Solve and return all answers."""
        _, corners = self.region.corners()
        low, high = self.region.low, self.region.high
        ends = (corners == low) | (corners == high)
        tried = np.vstack([0.5 * (low + high), corners[ends.all(axis=1)]])
        solved, failed = list[SolvedPoint](), list[Vector]()
        for number, values in enumerate(tried):
            self.watch(f"survey: point {number + 1} of {len(tried)}")
            if (answer := self._solved(values)) is not None:
                solved.append(answer)
            else:
                failed.append(values)
        solved += self._between(solved, failed)
        return [*solved, *self._held(solved)]

    def _between(self, solved: Sequence[SolvedPoint], failed: Sequence[Vector]) -> list[SolvedPoint]:
        """Solve halfway between points whose answers have different arcs, as others may lie between these.

        So they may between an answer and a point at which none was found.
        """
        points = [(one.values, one.course.text) for one in solved] + [(values, _NONE) for values in failed]
        pairs, looked, found = list(combinations(points, 2)), Counter[frozenset[str]](), list[SolvedPoint]()
        while pairs:
            (one, kind), (other, its) = pairs.pop(0)
            kinds = frozenset((kind, its))
            if len(kinds) < 2 or looked[kinds] >= _HALVINGS:
                continue
            looked[kinds] += 1
            self.watch("survey: between points whose answers have different arc structures")
            values = 0.5 * (one + other)
            if (answer := self._solved(values)) is not None:
                found.append(answer)
            middle = values, _NONE if answer is None else answer.course.text
            pairs = [((one, kind), middle), (middle, (other, its)), *pairs]
        return found

    def _held(self, solved: Sequence[SolvedPoint]) -> list[SolvedPoint]:
        """Solve with a parameter held where no flight with known arcs keeps the path."""
        scan, found, failed = Scan(self.problem, self.region, self.widths), list[SolvedPoint](), 0
        if not scan.names:
            return found
        ended = set[str]()  # what goes through this leads to nothing more
        for one in solved:
            if one.course.text not in ended and not scan.add(one.values, one.course, one.extremals):
                ended.add(one.course.text)
        while len(found) < _MOST_HELD and failed < _MOST_FAILED and (gap := scan.gap()) is not None:
            place, values, name, share = gap
            called = free_name(self.problem, name)
            self.watch(f"survey: with {called} held where no known flight keeps the path conditions")
            answer = self._solved(values, name, share)
            if answer is not None and scan.add(answer.values, answer.course, answer.extremals, place):
                found.append(answer)
            else:
                failed += 1
        return found

    def _solved(self, values: Vector, name: str | None = None, share: float = 0.0) -> SolvedPoint | None:
        """Solve at a point, with a parameter held at a share of its range; None without an answer."""
        at = f"at {self.region.format_point(values.tolist())}"
        try:
            problem = self.problem.with_given(**dict(zip(self.region.names, values.tolist(), strict=True)))
            refuse_impossible(preflight(problem))
            if name is not None:
                free = problem.free[problem.free_names.index(name)]
                problem = narrow_free_parameters(problem, **{name: free.lower + share * (free.upper - free.lower)})
            search = Search(self.method, problem, self.watch)
            return SolvedPoint(
                values, *arc_sequence_of(self.method.answer(search), search.answering.keep), name is not None
            )
        except PeriluneError as error:
            if name is None:
                self.notes.append(f"{at}: {error.what}" + (f"; got {error.got}" if error.got else ""))
            return None


_STEPS = 16  # from bound to bound
_MOST = 256  # points


def scanned_names(problem: Problem, region: Region) -> list[str]:
    """Return free parameters and durations between bounds, without axes, along which J may have several minima.

    Parameters
    ----------
    problem
        Problem that is mapped.
    region
        Region whose axes are left out.
    """
    return [f.name for f in problem.free if math.isfinite(f.upper - f.lower) and f.name not in region.names]


def scanned_points(region: Region) -> Matrix:
    """Return corners and middles of blocks [SI]; a selection all over the region if there are very many."""
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
        self._extremals_found: NDArray[np.bool_] = np.zeros(shape, dtype=bool)  # by extremals
        self._propagated: NDArray[np.bool_] = np.zeros(shape, dtype=bool)
        self._known: dict[str, NDArray[np.float64]] = {}  # unknowns of the extremals found, by what they go through

    def add(
        self,
        values: Vector,
        course: ArcSequence,
        extremals: Sequence[Extremal],
        place: tuple[int, int, int] | None = None,
    ) -> bool:
        """Follow the arcs of an answer where no flight is known; return True if more flights were found.

        `place` is that of an answer solved within a `gap`, where earlier extremals lead nowhere else.

        Parameters
        ----------
        values
            Values of the axes [SI], (d,).
        course
            Arcs of the answer.
        extremals
            Extremals of the answer, of which the first that the chart can hold is followed.
        place
            Numbers of parameter, point and step of the gap; None for an answer solved without one.
        """
        chart = Chart(self._problem, self._region.names, self._widths, course)
        first = next((e for e in extremals if len(e.unknowns or ()) == len(chart.own.unknowns)), None)
        if first is None:
            return False
        y = chart.from_problem_unknowns(np.array(first.unknowns))
        known = self._known.setdefault(course.text, np.full((*self._extremals_found.shape, len(y)), np.nan))
        before = np.count_nonzero(self._propagated)
        charted = OpenChart(chart, ())
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
            lanes = np.nonzero(~self._propagated[k].all(axis=1))[0]
            if len(lanes):
                points, begins = self._points[lanes], begin[None].repeat(len(lanes), axis=0)
                lower, upper = families.bounds(points)
                starts = families.clipped(points, begins[:, len(values) :], (lower, upper))
                ends = starts.copy()
                starts[:, at], ends[:, at] = lower[:, at], upper[:, at]
                found, cost, _ = families.follow_lines(points, begins, starts, ends, _STEPS)
                self._extremals_found[k, lanes] |= (met := np.isfinite(found[:, :, 0]))
                known[k, lanes] = np.where(met[:, :, None], found, known[k, lanes])
                self._propagated[k, lanes] |= np.isfinite(cost)
        return bool(np.count_nonzero(self._propagated) > before)

    def gap(self) -> tuple[tuple[int, int, int], Vector, str, float] | None:
        """Return the middle of the longest range part with extremals but no flight: place, point [SI], name, share.

        Each gap is returned once.
        """
        gaps, best = self._extremals_found & ~self._propagated, (0, 0, 0, 0)
        for k, lane in zip(*np.nonzero(gaps.any(axis=2)), strict=True):
            ends = np.flatnonzero(np.diff(np.concatenate([[0], gaps[k, lane], [0]])))
            length, first = max((end - begin, -begin) for begin, end in ends.reshape(-1, 2).tolist())
            best = max(best, (length, int(k), int(lane), -first))
        length, k, lane, first = best
        if not length:
            return None
        self._propagated[k, lane, first : first + length] = True
        amid = first + (length - 1) // 2
        return (k, lane, amid), self._points[lane], self.names[k], amid / _STEPS
