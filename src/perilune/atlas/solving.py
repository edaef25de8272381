"""Cold starts of a survey, and the arcs of their answers.

The problem is solved at the middle and at the corners of the region, and between points whose answers have different
arcs. An answer shows only the arcs of its own basin. So with conditions of the path, flights with known arcs are also
followed along free parameters between bounds, and where extremals with such a parameter held break the path, and no
flight keeps it, the problem is solved with the parameter held.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from perilune.atlas.course import ArcSequence, arc_sequence_of
from perilune.atlas.region import Region
from perilune.atlas.scanning import Scan
from perilune.methods.indirect import Indirect
from perilune.methods.search import Search
from perilune.problem.extremal import Extremal
from perilune.problem.neighbours import narrow_free_parameters
from perilune.problem.preflight import preflight, refuse_impossible
from perilune.problem.problem import Problem
from perilune.problem.wording import free_name
from perilune.words.outcome import PeriluneError
from perilune.words.types import Vector
from perilune.words.watch import Watch

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
        As of `perilune.atlas.survey.Survey`.
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
            self.watch("survey: between points whose answers have different arcs")
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
            self.watch(f"survey: with {called} held where no flight that is known keeps the path")
            answer = self._solved(values, name, share)
            if answer is not None and scan.add(answer.values, answer.course, answer.extremals, place):
                found.append(answer)
            else:
                failed += 1
        return found

    def _solved(self, values: Vector, name: str | None = None, share: float = 0.0) -> SolvedPoint | None:
        """Solve at a point, with a parameter held at a share of its range; None without an answer."""
        at = f"at {self.region.told(values.tolist())}"
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
