"""Query of an atlas: the answer at a point of the region, polished by Newton's method and re-integrated.

The cells around a point give the unknowns of each branch there, to the fourth order in their size; a step or two of
Newton's method makes that exact. The extremal reached has to be of its branch and keep its bounds, and it is integrated
again by another method. Of several branches the best is the answer. No answer is extrapolated: outside of the region,
in a cell in which a possibly better branch ends, or where Newton's method fails, a query is refused with the reason.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from pathlib import Path

import numpy as np

from perilune.atlas.query.answer import Mapped, Query
from perilune.atlas.query.batch import answer_points
from perilune.atlas.query.batch_answers import Answers, clearly_worse, equal_cost
from perilune.atlas.query.candidates import Candidate, candidates_in_doubt, dominates_known
from perilune.atlas.query.minimum_search import KnownExtremals
from perilune.atlas.query.reader import SERVING, AtlasReader, are_possible_answers
from perilune.atlas.store.cells import WHOLE, Status
from perilune.charts import MarchedMargins
from perilune.core import (
    Matrix,
    NotConvergedError,
    PeriluneError,
    Vector,
    check_call,
    parameter_name,
    require_path,
    unknown_name,
)
from perilune.methods import ExtremalRoot
from perilune.problem import Problem, Solution, Statistics, preflight, refuse_impossible, with_given_unchecked

_NEAREST = 64  # nodes that are asked where there is an answer


class Atlas(AtlasReader):
    """Atlas that answers queries. Use `perilune.atlas.open`."""

    @check_call
    def query(self, **values: float) -> Mapped:
        """Return the answer at values of the axes.

        Parameters
        ----------
        **values
            Of every axis, SI.

        Returns
        -------
        Mapped
            A solution, its trajectories and results made when they are looked at; unverified but for the independent
            re-integration.

        Raises
        ------
        PeriluneError
            If a value is missing or outside of the region, or its part of the map is not built or damaged.
        NotConvergedError
            If the map has no answer there: why, and what is near.
        InfeasibleError
            If physics refuses the point.
        """
        began = time.perf_counter()
        at = self._point(values)
        if not self.allowed(at[None])[0]:
            self._refuse_impossible(at)
        offers = self._offers(at)
        tried, doubts, breaking, outside, gaining = (list[Candidate]() for _ in range(5))
        best = None
        for offer in offers:
            # Next to an answer that is better by more than what the cells can be wrong by, the others need no polish.
            if best is not None and clearly_worse(offer.cost, best.cost):
                break
            if offer.breaks:
                breaking.append(offer)
                continue
            if offer.y is None:
                doubts.append(offer)
                continue
            canonical = (at / offer.charted.chart.scale)[None]
            polished = offer.polished = offer.charted.polish(canonical, np.array([offer.number]), offer.y[None])
            if polished.reached[0] and isfinite(cost := float(polished.cost[0])):
                offer.cost = cost
            if polished.answers[0]:
                tried.append(offer)
                best = offer if best is None or offer.cost < best.cost else best
                continue
            offer.short = bool(polished.short[0])
            if polished.breaking[0] or offer.short:
                breaking.append(offer)
            elif polished.doubtful[0]:
                doubts.append(offer)
            elif polished.beyond[0].any():
                outside.append(offer)
            elif polished.gains[0]:
                gaining.append(offer)
        if breaking or outside or gaining:
            turns = [one for one in outside if best is None or one.cost < best.cost] + gaining
            doubts += self._doubts(at, offers, tried, turns, breaking)
        best = min(tried, key=lambda one: one.cost, default=None)
        if len(tried) > 1 and best is not None:
            alike = [one for one in tried if equal_cost(one.cost, best.cost)]
            best = min(alike, key=lambda one: (one.charted.rank, one.cost))
        doubt = min(doubts, key=lambda one: one.cost, default=None)
        damaged = bool(self.damaged) and bool(self.damage(self.region.brick_of(at)))  # it might have held a better one
        in_doubt = best is None or (
            doubt is not None and doubt.cost < best.cost and not equal_cost(doubt.cost, best.cost)
        )
        if best is None or damaged or in_doubt or (self.unbuilt and self.missing(self.region.brick_of(at))):
            raise self._nothing(at, doubt)
        return self._answer(at, best, sorted(tried, key=lambda one: one.cost), offers, began)

    @check_call
    def query_many(self, points: Matrix) -> Answers:
        """Return the answers at many points at once.

        Parameters
        ----------
        points
            Values of the axes [SI], (points, d), in the order of `region.names`.

        Returns
        -------
        Answers
            As arrays; what has no answer says so.
        """
        return answer_points(self, points)

    # -- where it is ----------------------------------------------------------------------------------------------

    def _point(self, given: Mapping[str, float]) -> Vector:
        told, names = dict[str, float](), self.region.names
        for key, value in given.items():
            if (name := parameter_name(key)) not in names:
                raise unknown_name("axis", name, [axis.key for axis in self.region.axes])
            if name in told:
                raise PeriluneError("an axis is given twice", got=f"{key} = {told[name]!s:.40} and {value!s:.40}")
            told[name] = value
        if missing := [axis.key for axis in self.region.axes if axis.name not in told]:
            raise PeriluneError(
                "a value of every axis is needed", got=f"none of {', '.join(missing)}",
                expected=", ".join(axis.key for axis in self.region.axes),
            )  # fmt: skip
        try:
            if any(isinstance(told[name], str | bool | np.bool_) for name in names):  # of which Python makes floats
                raise TypeError
            values = [float(told[name]) for name in names]
        except (TypeError, ValueError, OverflowError):
            raise PeriluneError("values of the axes as numbers in SI", got=str(told)[:80]) from None
        if not all(map(isfinite, values)):
            raise PeriluneError("finite values of the axes", got=str(told)[:80])
        at = np.array(values)
        if (outside := self.region.outside(values)) is not None:
            inside = np.clip(at, self.region.low, self.region.high)
            there = self.query_many(inside[None]).good[0]
            near = self.region.format_point(inside.tolist()) if there else self._nearest(inside)
            raise PeriluneError(
                "the point lies outside the atlas", got=outside, expected=f"for instance {near}" if near else "",
                advice="use perilune solve, or build an atlas over a larger region",
            )  # fmt: skip
        return at

    def _offers(self, at: Vector) -> list[Candidate]:
        """Return the candidates of the cells around a point, of branches that can answer, the least J first."""
        place, offers = self.region.brick_of(at), list[Candidate]()
        low, width, part = self._extents(place)
        inside = (at - low) / width * WHOLE
        where = inside.tolist()
        for number, charted in enumerate(self.charted):
            if (brick := self.brick(number, place)) is None:
                continue
            canonical = (at / charted.chart.scale)[None]
            for sheet, root in brick.minima:
                cell = brick.leaf(root, where)
                status = brick.status[cell]
                if status in SERVING:
                    given = brick.given(cell, inside)
                    y, missed = charted.at_bounds(sheet, canonical, given[None, :-1])
                    cost = -np.inf if missed[0] else float(given[-1])  # then it is polished in any case
                    offers.append(Candidate(charted, sheet, y[0], cost, brick.cell(cell).size * part))
                elif status in (Status.BREAKS, Status.ENDS):
                    breaks = status == Status.BREAKS
                    y = brick.given(cell, inside)[:-1] if breaks else None
                    least = brick.least(np.array([cell]), inside[None]).item()
                    offers.append(Candidate(charted, sheet, y, least, low, breaks=breaks))
                elif status == Status.NO_ANSWER and charted.borders.of_arcs:
                    given = brick.given(cell, inside)
                    if charted.short(canonical, given[None, :-1])[0]:
                        offers.append(
                            Candidate(charted, sheet, given[:-1], float(given[-1]), low, breaks=True, short=True)
                        )
        return sorted(offers, key=lambda offer: offer.cost)

    def _extents(self, place: tuple[int, ...]) -> tuple[Vector, Vector, Vector]:
        """Return the low corner of a block, its width, and a lattice step as a share of the region."""
        if place not in self._boxes:
            low, high = self.region.box(place)
            self._boxes[place] = low, high - low, (high - low) / (self.region.high - self.region.low) / WHOLE
        return self._boxes[place]

    def _doubts(
        self,
        at: Vector,
        offers: Sequence[Candidate],
        tried: list[Candidate],
        turns: Sequence[Candidate],
        breaking: list[Candidate],
    ) -> list[Candidate]:
        """Return the extremals beyond bounds, and those that break the path, which leave the answer in doubt."""
        best, settles = min(tried, key=lambda one: one.cost, default=None), self.descents.settles
        alike = [] if best is None else [one for one in tried if equal_cost(one.cost, best.cost)]
        ways = {"follows": bool(self.descents.names), "settles": settles}
        left, followed = candidates_in_doubt(breaking, alike, offers, **ways)
        if not left and self._best_lies_at_each(at, followed, best):
            followed = []
        else:
            outdoes = np.inf if best is None else best.cost
            breaking = [one for one in breaking if dominates_known(one.charted, self._polished_cost(at, one), outdoes)]
            left, followed = candidates_in_doubt(breaking, alike, offers, **ways)
        doubts = self._become(at, best, turns, [], tried)
        if not settles:
            doubts, left = doubts + left, []
        left += self._become(at, best, [], followed, tried)
        return doubts + self._unanswered(at, min(tried, key=lambda one: one.cost, default=None), left, tried)

    def _polished_cost(self, at: Vector, one: Candidate) -> float:
        """Return J, reached by Newton's method, of a candidate that breaks the path all over its cell."""
        if one.breaks and not one.short and one.y is not None:
            values = (at / one.charted.chart.scale)[None]
            one.cost = float(one.charted.polished_cost(one.number, values, one.y[None], np.array([one.cost]))[0])
        return one.cost

    def _best_lies_at_each(self, at: Vector, followed: Sequence[Candidate], best: Candidate | None) -> bool:
        """Return True if the best answer lies at each extremal that would be followed, so that none need be."""
        return all(
            self.descents.best_lies_at(at[None], self._known(one, -1), self._known(best, -1))[0] for one in followed
        )

    def _become(
        self,
        at: Vector,
        best: Candidate | None,
        turns: Sequence[Candidate],
        breaking: Sequence[Candidate],
        tried: list[Candidate],
    ) -> list[Candidate]:
        """Follow inadmissible extremals to the minima of their basins; return those that cast doubt.

        An extremal beyond a bound, one that gains by leaving a bound, and one that breaks the path lead to a minimum
        that does not. A known or worse minimum settles it; a better one joins `tried`.
        """
        doubts = list[Candidate]()
        if not (turns or breaking):
            return doubts
        known, begins = self._known(best, -1), self.begins(at[None])
        for one, sheet in [(one, one.number) for one in turns] + [(one, -1) for one in breaking]:
            becomes = self.descents.become(at[None], self._known(one, sheet), begins, known)
            if not self._settled(at, becomes, best, one, tried):
                doubts.append(one)
        return doubts

    def _unanswered(
        self, at: Vector, best: Candidate | None, doubts: list[Candidate], tried: list[Candidate]
    ) -> list[Candidate]:
        """Return the extremals that cast doubt after a search along all parameters between bounds."""
        if not doubts or best is None or not self.descents.names:
            return doubts
        begins, known = self.begins(at[None]), self._known(best, -1)
        for one in [None, *({id(one): one for one in doubts}.values() if len(self.descents.names) > 1 else ())]:
            first = None if one is None else self._known(one, -1)
            better = self.descents.all_over(at[None], begins, known, first)
            if not self._settled(at, better, best, doubts[0], tried):
                return doubts
        return []

    def _settled(
        self, at: Vector, becomes: KnownExtremals, best: Candidate | None, one: Candidate, tried: list[Candidate]
    ) -> bool:
        """Return True if the minimum reached is no better, or joins `tried` as an answer; else set the J of `one`."""
        if (number := int(becomes.chart[0])) < 0:
            return False
        if best is None or (becomes.cost[0] < best.cost and not equal_cost(becomes.cost[0], best.cost)):
            charted, other, y = self.charted[number], int(becomes.sheet[0]), becomes.y[number]
            polished = charted.polish((at / charted.chart.scale)[None], np.array([other]), y)
            if not polished.answers[0]:
                one.cost = float(becomes.cost[0])
                return False
            tried.append(Candidate(charted, other, y[0], float(polished.cost[0]), one.cell, polished=polished))
        return True

    def _known(self, one: Candidate | None, sheet: int) -> KnownExtremals:
        """Return a candidate in the form that the search for minima takes."""
        known = KnownExtremals.none(self.charted, 1)
        if one is not None:
            number = self.charted.index(one.charted)
            known.chart[0], known.sheet[0], known.cost[0] = number, sheet, one.cost
            known.y[number][0] = one.y if one.polished is None else one.polished.y[0, one.charted.chart.active]
        return known

    # -- the answer, or why there is none -------------------------------------------------------------------------

    def _answer(
        self, at: Vector, best: Candidate, tried: list[Candidate], offers: list[Candidate], began: float
    ) -> Mapped:
        polished = best.polished
        assert polished is not None
        values = dict(zip(self.region.names, at.tolist(), strict=True))
        charted, steps = best.charted, int(polished.steps[0])
        problem, beside = self.problem, [o.polished for o in tried if o.charted is charted and o.polished is not None]

        def solution() -> Solution:
            roots = [ExtremalRoot(root=charted.root(*own.row(0)), minimum=True) for own in beside]
            statistics = Statistics(initialization="atlas", iterations=steps, arcs=steps + 1)
            return charted.solution(with_given_unchecked(problem, values), roots, statistics)

        slopes = polished.slopes[0] * problem.objective_size / charted.chart.scale
        shown = MarchedMargins(*polished.reintegrated.shown[0].tolist())
        query = Query(
            sheet=best.label,
            candidates=tuple(offer.label for offer in offers),
            cell=tuple(best.cell.tolist()),
            guess_error=float(polished.relative_error[0]),
            steps=steps,
            error_bound=float(polished.bound[0]),
            residual=shown.residual,
            path=shown.path,
            minimum=shown.minimum,
            drift=shown.drift,
            sample_level=self.sample_level,
            slopes=dict(zip(values, slopes.tolist(), strict=True)),
            latency=time.perf_counter() - began,
        )
        return Mapped.deferred(best.cost * problem.objective_size, query, solution)

    def _refuse_impossible(self, at: Vector) -> None:
        """Refuse a point that physics refuses, as `solve` does, by comparisons that may include whole flights."""
        refuse_impossible(preflight(self.problem, dict(zip(self.region.names, at.tolist(), strict=True))))

    def _nothing(self, at: Vector, doubt: Candidate | None) -> PeriluneError:
        """Return the error for a point of the region without an answer."""
        self._refuse_impossible(at)
        place, got = self.region.brick_of(at), self.region.format_point(at.tolist())
        if broken := self.damage(place):
            return PeriluneError(
                broken[0], got=got, advice="perilune atlas verify DIR lists everything that is damaged"
            )
        if self.missing(place):
            order = "extend DIR" if self.survey["charts"] else "build ... --resume"
            return PeriluneError(
                "this part of the atlas is not built yet",
                got=got,
                advice=f"perilune atlas {order} builds what is missing",
            )
        near = self._nearest(at)
        why = "no sheet has an answer in this cell" if doubt is None else doubt.why
        return NotConvergedError(
            f"the atlas has no answer here: {why}",
            got=got,
            expected=f"for instance {near}" if near else "another point",
            advice="use perilune solve here; an atlas of more bricks may answer here (--bricks)",
        )

    def _nearest(self, at: Vector) -> str:
        """Describe the nearest node around that has an answer."""
        place, found = self.region.brick_of(at), list[Matrix]()
        for number, charted in enumerate(self.charted):
            if (brick := self.brick(number, place)) is not None:
                found.append(np.array(brick.nodes["values"][are_possible_answers(brick.nodes, charted.sheets)]))
        values = np.unique(np.concatenate([np.empty((0, len(at))), *found]), axis=0)
        away = np.abs((values - at) / (self.region.high - self.region.low)).max(axis=1)
        near = values[np.argsort(away)[:_NEAREST]]
        good = self.query_many(near).good  # another branch may cast doubt on what is one of its own
        return self.region.format_point(near[good][0].tolist()) if good.any() else ""


@check_call
def open_atlas(directory: str | Path, problem_from_scenario: Callable[[str], Problem] | None = None) -> Atlas:
    """Read an atlas.

    Parameters
    ----------
    directory
        As `perilune.atlas.build` made it.
    problem_from_scenario
        Makes the problem of a scenario's text; `perilune.scenario.load_text` if None.

    Raises
    ------
    PeriluneError
        If there is none, or it is of another format.
    """
    if problem_from_scenario is None:
        from perilune.scenario import load_text as problem_from_scenario
    return Atlas(require_path(directory, "the directory of an atlas"), problem_from_scenario)
