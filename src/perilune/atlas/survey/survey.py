"""Survey before the map: all branches, with an extremal of each at every corner of a block.

The problem is solved without a guess at the middle and at the corners of the region. Each extremal found there, best or
not, begins a branch, unless it lies on a known one; branches are continued to all corners of blocks by the tangent
plane and Newton's method, in lanes, halving steps that fail, and from corners that were reached on to others. Where
such a continuation ends at a fold it is followed around the fold to the branch on the other side.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from perilune.atlas.region import Region
from perilune.atlas.store.cells import WHOLE
from perilune.atlas.survey.corner_continuation import (
    continue_between_corners,
    continue_sheet_to,
    corners_reached,
    walks_from_one_extremal,
)
from perilune.atlas.survey.folds import around_folds, classify_behind_folds
from perilune.atlas.survey.initial_solves import RegionSolver, SolvedPoint, scanned_names, scanned_points
from perilune.atlas.survey.other_minima import minima_around, other_minima
from perilune.atlas.survey.surveyed_chart import (
    InteriorSeed,
    SurveyedChart,
    chart_entry,
    merge_surveyed_chart,
    with_expected_branches,
    with_minimum_found,
)
from perilune.charts import (
    MOST,
    ArcSequence,
    Borders,
    Chart,
    ChartReintegration,
    Extremals,
    Sheet,
    follow_sheets,
    held_at,
    same_unknowns,
)
from perilune.conditions import attainable_conditions
from perilune.core import Matrix, PeriluneError, Vector, Watch
from perilune.methods import Indirect
from perilune.problem import Extremal, Nature, Problem

_MOST_SHEETS = 64  # of a chart, in addition to those on which answers of solves lie
_AROUND = 4  # walks of a branch that are followed around the folds at which they ended
_BESIDE = 3  # corners from which it is tried whether an extremal lies on a branch
_AGAIN, _ROUNDING = 16, 1e-13  # extremals near one, and how far, relative, that are on its side of folds


@dataclass
class Survey:
    """Search for the branches of a region.

    Parameters
    ----------
    problem, region, method
        What is mapped, and how it is solved without an initial guess.
    watch
        Receives lines of text, and each iteration of what is solved.
    widths
        Lengths of ranges [SI] by which canonical units are chosen; those of the region if it is not given.

    Attributes
    ----------
    notes
        Where there was no answer, and why, and what is not mapped, in sentences.
    """

    problem: Problem
    region: Region
    method: Indirect
    watch: Watch
    widths: Vector | None = None
    notes: list[str] = field(default_factory=list)

    def run(self) -> list[SurveyedChart]:
        """Find all branches, by charts.

        Raises
        ------
        PeriluneError
            If no point has an extremal that can be followed.
        """
        solving = RegionSolver(self.problem, self.region, self.method, self.watch, self._widths, self.notes)
        solved, (_, corners) = solving.run(), self.region.corners()
        courses = _arc_sequences(self.problem, self.region.names, solved)
        if not (charts := [found for one in courses if (found := self._found(*one, corners)).sheets]):
            raise PeriluneError(
                "there is nothing to map",
                got="; ".join(self.notes)[:300]
                or "Newton's method does not converge from the extremals that are known",
                advice="solve the problem at one point of the region first: perilune solve",
            )
        return charts

    @property
    def _widths(self) -> Vector:
        return self.region.high - self.region.low if self.widths is None else self.widths

    def _found(self, course: ArcSequence, solved: Sequence[SolvedPoint], corners: Matrix) -> SurveyedChart:
        """Find the branches of one chart."""
        chart = Chart(self.problem, self.region.names, self._widths, course)
        empty = np.empty((0, len(corners), len(chart.places)))
        found = SurveyedChart(chart=chart, borders=Borders(chart), sheets=(), y=empty, widths=self._widths)
        for point in solved:
            if not point.held:
                found = self._with(found, corners, point.values, point.extremals)
        for one in self._minima_between_bounds(found, solved):
            found = self._with_these(found, corners, [one])
        if course.structure is not None:  # what flies in one piece has its families followed by each solve
            found = self._with_wells(found, corners)
        if not found.sheets:
            return found
        found = with_expected_branches(found, corners / chart.scale)
        at = np.nonzero(np.isfinite(found.y[:, :, 0]))
        values = np.vstack([corners[at[1]] / chart.scale, *(one.values for one in found.small)])
        y = chart.whole(values, np.vstack([found.y[at], *(one.y for one in found.small)]))
        return replace(found, times=ChartReintegration(chart).fine_enough(y, chart.p[None]))

    def _with(self, known: SurveyedChart, corners: Matrix, at: Vector, extremals: Sequence[Extremal]) -> SurveyedChart:
        """Add the branches on which extremals at a point lie, and those behind the folds of these."""
        chart, borders, left = known.chart, known.borders, list[tuple[Vector, Vector, Sheet]]()
        for extremal in extremals:
            if extremal.unknowns and len(extremal.unknowns) != len(chart.own.unknowns):
                self.notes.append(
                    f"at {self.region.format_point(at.tolist())}: '{chart.course.text}' is not mapped, as the last"
                    f" arc implies an end condition at these values but not at others"
                )
            elif extremal.unknowns:
                y = chart.from_problem_unknowns(np.array(extremal.unknowns))
                holds = held_at(borders, at / chart.scale, y)
                left.append((at / chart.scale, y, Sheet(holds=holds, orientation=0.0, nature=extremal.nature)))
        return self._with_these(known, corners, left)

    def _minima_between_bounds(
        self, known: SurveyedChart, solved: Sequence[SolvedPoint]
    ) -> Iterator[tuple[Vector, Vector, Sheet]]:
        """Yield minima of J along parameters between bounds, all over the region, from answers with a chart's arcs."""
        chart, borders, names = known.chart, known.borders, scanned_names(self.problem, self.region)
        begins = [
            (point.values, chart.from_problem_unknowns(np.array(extremal.unknowns)))
            for point in solved
            for extremal in point.extremals
            if len(extremal.unknowns or ()) == len(chart.own.unknowns)
        ]
        if names and begins:
            values, y = (np.array(rows) for rows in zip(*begins, strict=True))
            points = scanned_points(self.region)
            away = np.abs((points[:, None] - values) / (self.region.high - self.region.low)).sum(axis=2)
            near = away.argmin(axis=1)
            yield from minima_around(chart, borders, names, points / chart.scale, values[near] / chart.scale, y[near])

    def _with_wells(self, known: SurveyedChart, corners: Matrix) -> SurveyedChart:
        """Add the branches of other minima of J along parameters between bounds."""
        number = 0
        while number < len(known.sheets):
            reached = np.nonzero(np.isfinite(known.y[number, :, 0]))[0]
            if known.sheets[number].minimum and len(reached):
                values, y = corners[reached] / known.chart.scale, known.y[number, reached]
                for one in other_minima(known.chart, known.borders, known.sheets[number], values, y):
                    known = self._with_these(known, corners, [one])
            number += 1
        return known

    def _with_these(
        self, known: SurveyedChart, corners: Matrix, left: list[tuple[Vector, Vector, Sheet]]
    ) -> SurveyedChart:
        """Add the branches on which extremals, canonical, lie, and those behind the folds of these."""
        chart, borders, around = known.chart, known.borders, list[tuple[Vector, Vector, Sheet]]()
        while left or around:
            behind_a_fold = not left
            values, y, sheet = (left or around).pop(0)
            if sheet.nature is Nature.UNPROVED and len(known.sheets) >= _MOST_SHEETS:
                self._note_many(chart)
                continue
            holds = borders.holds([sheet], np.zeros(1, dtype=np.int64), values[None])
            start = chart.solve(values[None], y[None], holds, limit=MOST)
            if not start.converged[0]:
                continue
            if _sided_by_rounding(chart, start):
                said = f"'{chart.course.text or 'a flight of one arc'}' switches by rounding errors, and is not mapped"
                self.notes.append(f"at {self.region.format_point((values * chart.scale).tolist())}: {said}")
                continue
            sheet = replace(sheet, orientation=float(start.orientation[0]))
            if curved := chart.shooting.curving_down(start.roots[0], chart.p):
                sheet = replace(sheet, nature=Nature.WORST)
            number = self._known(known, sheet, corners / chart.scale, values, start.y[0])
            if number is not None:
                known = with_minimum_found(known, number, sheet)
            else:
                told_by_solve = sheet.nature is not Nature.UNPROVED
                if not told_by_solve:
                    said = chart_entry(replace(known, sheets=(sheet,)))
                    nature = classify_behind_folds(self.problem, self.region, said, values, start.y[0])
                    sheet = replace(sheet, nature=nature)
                left += _sheets_held_at_ends(borders, sheet, values, start.y[0], curved)
                y, behind = self._continue_to_corners(chart, borders, sheet, corners, values, start.y[0])
                if behind_a_fold and _has_negative_arc(borders, corners / chart.scale, y, values, start.y[0]):
                    continue
                count = np.isfinite(y[:, 0]).sum()
                self.watch(f"{sheet.label}: at {count} corners of bricks")
                known = (
                    merge_surveyed_chart(known, sheet, y)
                    if count
                    else self._with_small(known, sheet, values, start.y[0])
                )
                # Two that reach no corner, on both sides of a fold, would lead to one another for ever.
                around += behind if count or told_by_solve else []
        return known

    def _note_many(self, chart: Chart) -> None:
        """Note, once, that a chart has more branches than are mapped."""
        flown = f"'{chart.course.text or 'a flight of one arc'}' has more than {_MOST_SHEETS} sheets"
        if (said := f"{flown}: others, beyond folds and at bounds, are not mapped and may be better") not in self.notes:
            self.notes.append(said)

    def _with_small(self, known: SurveyedChart, sheet: Sheet, values: Vector, y: Vector) -> SurveyedChart:
        """Add a branch that reaches no corner, by an extremal at the nearest place in the lattice of its block."""
        if not sheet.minimum:
            return known
        chart, at = known.chart, values * known.chart.scale
        brick = self.region.brick_of(at)
        low, high = self.region.box(brick)
        place = np.rint((at - low) / (high - low) * WHOLE).astype(np.int64)
        there = (low + place * ((high - low) / WHOLE)) / chart.scale
        beside = continue_sheet_to(chart, known.borders, sheet, values, y, there[None])[0]
        if not np.isfinite(beside[0]):
            told = self.region.format_point(at.tolist())
            self.notes.append(f"at {told}: the sheet '{sheet.label}' cannot be followed from there, and is not mapped")
            return known
        one = InteriorSeed(len(known.sheets), brick, place, there, beside)
        none = np.full((1, *known.y.shape[1:]), np.nan)
        sheets = (*known.sheets, sheet)
        return replace(known, sheets=sheets, y=np.concatenate([known.y, none]), small=(*known.small, one))

    def _continue_to_corners(
        self, chart: Chart, borders: Borders, sheet: Sheet, corners: Matrix, values: Vector, y: Vector
    ) -> tuple[Matrix, list[tuple[Vector, Vector, Sheet]]]:
        """Continue a branch to all corners of blocks, NaN where it ends; also return extremals behind its folds."""
        targets, (places, _) = corners / chart.scale, self.region.corners()
        here, share = follow_sheets(chart, borders, [sheet], *walks_from_one_extremal(values, y, targets))
        ended = np.nonzero(share < 1.0)[0]
        ended = ended[np.linspace(0, len(ended) - 1, min(len(ended), _AROUND)).astype(np.int64)]
        starts = values + share[ended, None] * (targets[ended] - values)
        behind = [
            (at, there, replace(sheet, orientation=side, nature=Nature.UNPROVED))
            for at, there, side in around_folds(chart, borders, sheet, starts, here[ended], targets[ended])
        ]
        here[share < 1.0] = np.nan
        reached = continue_between_corners(chart, borders, sheet, places, corners, corners_reached(places, here))
        for i, place in enumerate(places.tolist()):
            here[i] = reached.get(tuple(place), here[i])
        return here, behind

    @staticmethod
    def _known(known: SurveyedChart, sheet: Sheet, corners: Matrix, values: Vector, y: Vector) -> int | None:
        """Return the branch on which an extremal lies, by continuation from nearest corners; None for a new one."""
        away = np.abs(corners - values).sum(axis=1)
        for number, (other, there) in enumerate(zip(known.sheets, known.y, strict=True)):
            if not other.alike(sheet):
                continue
            reached = np.nonzero(np.isfinite(there[:, 0]))[0]
            if any(away[i] == 0.0 and not same_unknowns(y, there[i]) for i in reached):
                continue  # it has another layer there
            starts = [(corners[i], there[i]) for i in reached[np.argsort(away[reached])][:_BESIDE]]
            starts += [(one.values, one.y) for one in known.small if one.sheet == number]
            for start, unknowns in starts:
                if same_unknowns(
                    y, continue_sheet_to(known.chart, known.borders, other, start, unknowns, values[None])[0]
                ):
                    return number
        return None


def _arc_sequences(
    problem: Problem, varied: Sequence[str], solved: Sequence[SolvedPoint]
) -> Iterator[tuple[ArcSequence, list[SolvedPoint]]]:
    """Yield each course, and the answers that go through it.

    A control that keeps a condition equals one that does not wherever the condition is inactive, so that conditions
    that some answers keep are kept in all courses.
    """
    every = dict.fromkeys(name for one in solved for name in one.course.keep)
    for text in dict.fromkeys(one.course.text for one in sorted(solved, key=lambda one: bool(one.course.text))):
        alike = [one for one in solved if one.course.text == text]
        keepable = attainable_conditions(alike[0].course.restated(problem, varied)) if every else ()
        yield replace(alike[0].course, keep=tuple(name for name in every if name in keepable)), alike


def _has_negative_arc(borders: Borders, corners: Matrix, there: Matrix, values: Vector, y: Vector) -> bool:
    """Return True if a branch has a negative arc duration from the fold behind which it begins to all corners.

    Where an arc vanishes the flight continues with other arcs, around folds of their own. This fold lies beyond: no
    flight leads to the branch behind it, and none of its extremals there is a flight.
    """
    reached = np.isfinite(there[:, 0])
    return bool(borders.backwards(np.vstack([values, corners[reached]]), np.vstack([y, there[reached]])).all())


def _sheets_held_at_ends(
    borders: Borders, sheet: Sheet, values: Vector, y: Vector, ranges: list[int]
) -> list[tuple[Vector, Vector, Sheet]]:
    """Return starts of branches held at the ends of ranges within which J has a maximum: values, unknowns, branch."""
    first, limits = borders.chart.shooting.plan.free, borders.at(values[None])
    return [
        (values, y, Sheet(holds={**sheet.holds, borders.names[k]: side}, orientation=0.0, nature=Nature.UNPROVED))
        for k in (first + number for number in ranges)
        for side, bound in zip(("lower", "upper"), limits, strict=True)
        if np.isfinite(bound[0, k])
    ]


def _sided_by_rounding(chart: Chart, found: Extremals) -> bool:
    """Return True if rounding decides an extremal's side of folds, as with a switch exactly at a joint."""
    rng, again = np.random.default_rng(0), np.zeros(_AGAIN, dtype=np.int64)
    y = found.y[again] * (1.0 + _ROUNDING * rng.uniform(-1.0, 1.0, (_AGAIN, found.y.shape[1])))
    choice = found.roots.choice[again]
    beside = chart.extremals_from(
        found.values[again], chart.shooting.at(chart.whole(found.values[again], y), chart.p, choice)
    )
    return bool((beside.orientation != found.orientation[0]).any())
