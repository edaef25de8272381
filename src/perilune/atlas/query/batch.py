"""Batch query: answers at many points of an atlas at once, in lanes (`Atlas.query` for arrays)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.hermite import interpolated
from perilune.atlas.query.batch_answers import Answered, Answers, clearly_worse, equal_cost
from perilune.atlas.query.candidates import casting_doubt, dominates_known, without_admissible_answer
from perilune.atlas.query.minimum_search import KnownExtremals
from perilune.atlas.query.reader import SERVING, AtlasReader, LoadedBrick
from perilune.atlas.store.cells import WHOLE, Status
from perilune.charts import Lanes, OpenChart, Polished
from perilune.core import Matrix, PeriluneError, Vector, require_numbers

_TOGETHER = 4096  # points, so that what lies at the corners of their cells fits into a cache


def answer_points(atlas: AtlasReader, points: Matrix) -> Answers:
    """Return the answers of an atlas at points [SI], (points, d).

    Parameters
    ----------
    atlas
        Atlas that is read.
    points
        Values of the axes, (points, d).

    Raises
    ------
    PeriluneError
        If these are not numbers in rows of d.
    """
    points, d = np.asarray(require_numbers(points, "points of an atlas")), len(atlas.region.axes)
    if points.ndim != 2 or points.shape[1] != d:
        raise PeriluneError(
            "points are rows of the values of all axes", got=f"shape {points.shape}", expected=f"(points, {d})"
        )
    work = _AnswerArrays(atlas, points)
    work.place()
    for start in range(0, len(points), _TOGETHER):
        work.answer(np.arange(start, min(start + _TOGETHER, len(points))))
    return work.answers()


@dataclass(frozen=True)
class _BranchCandidates:
    """J and y that one branch of a sheet gives at points; inf and NaN where none, only J where it `breaks`.

    `first` is the number of the first sheet of its chart; `broken` has y where it breaks, and `short` is True where it
    does so by a negative arc duration.
    """

    charted: OpenChart
    sheet: int
    first: int
    y: Matrix
    cost: Vector
    breaks: NDArray[np.bool_]
    broken: Matrix
    short: NDArray[np.bool_]


@dataclass(frozen=True)
class _InadmissibleExtremals:
    """Inadmissible extremals of an offer: lanes, J, unknowns, and True for those with a negative arc duration."""

    number: int
    lanes: Lanes
    cost: Vector
    y: Matrix
    short: NDArray[np.bool_]

    def of(self, its: NDArray[np.bool_]) -> _InadmissibleExtremals:
        """Return some of them."""
        return _InadmissibleExtremals(self.number, self.lanes[its], self.cost[its], self.y[its], self.short[its])


class _AnswerArrays:
    """Arrays of the answers while they are computed."""

    def __init__(self, atlas: AtlasReader, points: Matrix) -> None:
        count = len(points)
        self.atlas, self.points = atlas, points
        self.answered = np.full(count, Answered.NONE, dtype=np.int64)
        self.cost, self.bound, self.relative_error = (
            np.full(count, np.inf),
            np.full(count, np.nan),
            np.full(count, np.nan),
        )
        self.free = np.full((count, len(atlas.problem.free)), np.nan)
        self.sheet, self.steps = np.full(count, -1), np.zeros(count, dtype=np.int64)
        self.slopes, self.of_arcs = np.full(points.shape, np.nan), np.zeros(count, dtype=bool)
        self.charts = sorted(atlas.charted, key=lambda charted: charted.rank)
        self.rank = np.full(count, len(self.charts))  # of the chart of each answer among them

    def place(self) -> None:
        """Determine the points that lie in the region, and those of them that physics allows."""
        region = self.atlas.region
        inside = ((self.points >= region.low) & (self.points <= region.high)).all(axis=1)
        self.answered[~inside] = Answered.OUTSIDE
        self.allowed = np.ones(len(self.points), dtype=bool)
        self.allowed[inside] = self.atlas.allowed(self.points[inside])
        self.bricks = region.bricks_of(self.points)

    def answer(self, some: NDArray[np.int64]) -> None:
        """Polish the candidates of some points, best first, until the others are clearly worse."""
        some = some[self.answered[some] != Answered.OUTSIDE]
        atlas, offers = self.atlas, self._offers(some)
        cost = np.array([offer.cost for offer in offers]).reshape(len(offers), len(some))
        order = np.argsort(cost, axis=0)
        doubt, going = np.full(len(some), np.inf), np.ones(len(some), dtype=bool)
        breaking = list[_InadmissibleExtremals]()
        vouching = [np.isfinite(offer.y[:, 0]) for offer in offers]
        turning = list[tuple[int, NDArray[np.int64], Matrix]]()
        self.some, self.known = some, KnownExtremals.none(atlas.charted, len(some))
        for rank in range(len(offers)):
            chosen = order[rank]
            here = cost[chosen, np.arange(len(some))]
            best = self.cost[some]
            with np.errstate(invalid="ignore"):
                going &= (here < np.inf) & ~clearly_worse(here, best)
            for number, offer in enumerate(offers):
                lanes = np.nonzero(going & (chosen == number))[0]
                ends, breaks = np.isnan(offer.y[lanes, 0]), offer.breaks[lanes]
                which = lanes[ends & ~breaks]
                doubt[which] = np.minimum(doubt[which], here[which])
                at = lanes[breaks]
                breaking.append(_InadmissibleExtremals(number, at, here[at], offer.broken[at], offer.short[at]))
                if len(lanes := lanes[~ends]):
                    active = offer.charted.chart.active
                    polished = self._polished(some[lanes], offer, offer.y[lanes])
                    sound = polished.reached & np.isfinite(polished.cost)
                    here[lanes] = cost[number, lanes] = np.where(sound, polished.cost, here[lanes])
                    outside = polished.beyond.any(axis=1) & (polished.cost < self.cost[some[lanes]])
                    if (turns := outside | (polished.gains & ~polished.beyond.any(axis=1))).any():
                        turning.append((number, lanes[turns], polished.y[turns][:, active]))
                    which = lanes[polished.doubtful]
                    doubt[which] = np.minimum(doubt[which], here[which])
                    own = _InadmissibleExtremals(number, lanes, here[lanes], polished.y[:, active], polished.short)
                    breaking.append(own.of(polished.breaking | polished.short))
                    vouching[number][lanes] = polished.answers
        left, followed = self._doubted(breaking, offers, vouching)
        if not atlas.descents.settles:
            doubt, left = np.minimum(doubt, left), np.full(len(some), np.inf)
        best = self.known.of(np.arange(len(some)))
        for number, lanes, y in turning:
            self._become(doubt, offers[number], lanes, cost[number, lanes], y, best, turns=True)
        standing = list[_InadmissibleExtremals]()
        for one, which in followed:
            stands = self._become(left, offers[one.number], one.lanes, one.cost, one.y, best, turns=False)
            standing.append(one.of(which | stands))
        best = self.known.of(np.arange(len(some)))
        with np.errstate(invalid="ignore"):
            lanes = np.nonzero((left < best.cost) & ~equal_cost(left, best.cost))[0]
        if atlas.descents.names and len(lanes):
            left[lanes] = self._looked_over(lanes, best.of(lanes), left[lanes], offers, standing)
        doubt = np.minimum(doubt, left)
        self._decide(some, doubt)

    def _decide(self, some: NDArray[np.int64], doubt: Vector) -> None:
        """Decide which points have an answer, given the least J that an unresolved extremal might have there."""
        found, doubtful = np.isfinite(self.cost[some]), doubt < self.cost[some]
        with np.errstate(invalid="ignore"):
            doubtful &= ~(found & equal_cost(doubt, self.cost[some]))
        # What is damaged might have held a better one.
        damaged = self._where(some, lambda place: bool(self.atlas.damage(place)))
        self.answered[some[found]] = Answered.YES
        self.answered[some[doubtful]] = Answered.ENDS
        self.answered[some[damaged | self._where(some, self.atlas.missing)]] = Answered.NOT_BUILT
        self.answered[some[~self.allowed[some]]] = Answered.IMPOSSIBLE

    def _doubted(
        self,
        breaking: Sequence[_InadmissibleExtremals],
        offers: Sequence[_BranchCandidates],
        vouching: Sequence[NDArray[np.bool_]],
    ) -> tuple[Vector, list[tuple[_InadmissibleExtremals, NDArray[np.bool_]]]]:
        """Return the least J, or inf, of better inadmissible extremals that cast doubt, (lanes,), and those to follow.

        The latter come with a mask of those that cast doubt in any case.
        """
        doubt, of = np.full(len(self.some), np.inf), [offer.charted for offer in offers]
        better = [self._better_than_known(one, offers[one.number]) for one in breaking]
        told, answers = [(of[one.number], one.lanes, one.short) for one in better], list(zip(of, vouching, strict=True))
        followed, follows = list[tuple[_InadmissibleExtremals, NDArray[np.bool_]]](), bool(self.atlas.descents.names)
        for one, left in zip(better, without_admissible_answer(told, answers, self.of_arcs[self.some]), strict=True):
            which, its = casting_doubt(one.short, left, follows=follows, settles=self.atlas.descents.settles)
            doubt[one.lanes[which]] = np.minimum(doubt[one.lanes[which]], one.cost[which])
            followed.append((one.of(its), which[its]))
        return doubt, followed

    def _better_than_known(self, one: _InadmissibleExtremals, offer: _BranchCandidates) -> _InadmissibleExtremals:
        """Return the extremals that are better than the known answers, by J as Newton's method reaches it."""
        known, charted = self.cost[self.some], offer.charted
        one = one.of(dominates_known(charted, one.cost, known[one.lanes]))
        its = np.nonzero(~one.short)[0]
        values = self.points[self.some[one.lanes[its]]] / charted.chart.scale
        one.cost[its] = charted.polished_cost(offer.sheet, values, one.y[its], one.cost[its])
        return one.of(dominates_known(charted, one.cost, known[one.lanes]))

    def _become(
        self,
        doubt: Vector,
        offer: _BranchCandidates,
        lanes: Lanes,
        cost: Vector,
        y: Matrix,
        best: KnownExtremals,
        *,
        turns: bool,
    ) -> NDArray[np.bool_]:
        """Let inadmissible extremals cast doubt, or their minima answer; return a mask of those that leave doubt."""
        if not len(lanes):
            return np.zeros(0, dtype=bool)
        atlas, points = self.atlas, self.points[self.some[lanes]]
        extremals = self._extremals(offer, y, cost)
        extremals.sheet[:] = offer.sheet if turns else -1
        becomes = atlas.descents.become(points, extremals, atlas.begins(points), best.of(lanes))
        cost, best = self._settled(lanes, becomes, cost), self.known.of(lanes)
        doubt[lanes] = np.minimum(doubt[lanes], cost)
        return (cost < best.cost) & ~equal_cost(cost, best.cost)

    def _looked_over(
        self,
        lanes: Lanes,
        best: KnownExtremals,
        cost: Vector,
        offers: Sequence[_BranchCandidates],
        standing: Sequence[_InadmissibleExtremals],
    ) -> Vector:
        """Search along all parameters between bounds; return the J that still casts doubt, inf for none, (lanes,)."""
        atlas, points = self.atlas, self.points[self.some[lanes]]
        begins, doubt, known = atlas.begins(points), np.full(len(lanes), np.inf), np.ones(len(lanes), dtype=bool)
        for one in [None, *(standing if len(atlas.descents.names) > 1 else [])]:
            here, its = np.nonzero(known)[0], known
            if one is not None:
                here, its = np.nonzero(known[:, None] & (lanes[:, None] == one.lanes))
            if not len(here):
                continue
            first = None if one is None else self._extremals(offers[one.number], one.y[its], one.cost[its])
            better = atlas.descents.all_over(points[here], [y[here] for y in begins], best.of(here), first)
            doubt[here] = np.minimum(doubt[here], self._settled(lanes[here], better, cost[here]))
            known[here] = better.chart >= 0
        return doubt

    def _extremals(self, offer: _BranchCandidates, y: Matrix, cost: Vector) -> KnownExtremals:
        """Return extremals of an offer in the form that the search for minima takes."""
        number, found = self.atlas.charted.index(offer.charted), KnownExtremals.none(self.atlas.charted, len(y))
        found.chart[:], found.y[number][:], found.cost[:] = number, y, cost
        return found

    def _settled(self, lanes: NDArray[np.int64], becomes: KnownExtremals, cost: Vector) -> Vector:
        """Polish better minima as answers; return the J that casts doubt, `cost` where no minimum was reached."""
        atlas, found, known = self.atlas, becomes.chart >= 0, self.cost[self.some[lanes]]
        better = found & (becomes.cost < known) & ~(np.isfinite(known) & equal_cost(becomes.cost, known))
        for chart, sheet in np.unique(np.column_stack([becomes.chart, becomes.sheet])[better], axis=0).tolist():
            charted, its = atlas.charted[chart], better & (becomes.chart == chart) & (becomes.sheet == sheet)
            first = sum(len(other.sheets) for other in atlas.charted[:chart])
            self._polished(self.some[lanes[its]], _no_candidate(charted, sheet, first, 0), becomes.y[chart][its])
        return np.where(found, becomes.cost, cost)

    def _where(self, some: NDArray[np.int64], says: Callable[[tuple[int, ...]], bool]) -> NDArray[np.bool_]:
        """Return True for points in blocks that satisfy a predicate, which is called once for each block."""
        rows, which = np.unique(self.bricks[some], axis=0, return_inverse=True)
        return np.array([says(tuple(row)) for row in rows.tolist()], dtype=bool)[which.reshape(-1)]

    def _polished(self, points: NDArray[np.int64], offer: _BranchCandidates, y: Matrix) -> Polished:
        """Polish unknowns of an offer, and keep answers that are better than known ones."""
        atlas, charted, chart = self.atlas, offer.charted, offer.charted.chart
        polished = charted.polish(self.points[points] / chart.scale, np.full(len(points), offer.sheet), y)
        known, rank, of_arcs = self.cost[points], self.charts.index(charted), charted.of_arcs
        with np.errstate(invalid="ignore"):
            alike = polished.answers & equal_cost(polished.cost, known)
        self.of_arcs[points[alike]] |= of_arcs
        better = polished.answers & np.where(alike, rank < self.rank[points], polished.cost < known)
        kept, problem = points[better], atlas.problem
        self.cost[kept] = polished.cost[better]
        self.bound[kept], self.steps[kept] = polished.bound[better], polished.steps[better]
        self.sheet[kept], self.relative_error[kept] = offer.first + offer.sheet, polished.relative_error[better]
        self.free[kept] = charted.free(polished.y[better])
        self.slopes[kept] = polished.slopes[better] * problem.objective_size / chart.scale
        self.rank[kept], self.of_arcs[points[better & ~alike]] = rank, of_arcs
        number, lanes = self.atlas.charted.index(charted), np.searchsorted(self.some, kept)
        self.known.chart[lanes], self.known.sheet[lanes] = number, offer.sheet
        self.known.y[number][lanes], self.known.cost[lanes] = polished.y[better][:, chart.active], self.cost[kept]
        return polished

    def _offers(self, some: NDArray[np.int64]) -> list[_BranchCandidates]:
        """Return the candidates of all sheets at some points."""
        atlas, found, first, count = self.atlas, list[_BranchCandidates](), 0, len(some)
        bricks = np.unique(self.bricks[some], axis=0)
        for number, charted in enumerate(atlas.charted):
            offers = dict[
                tuple[int, int], _BranchCandidates
            ]()  # by sheets, and how many branches of it there are already
            for row in bricks:
                lanes = np.nonzero((self.bricks[some] == row).all(axis=1))[0]
                place = tuple(row.tolist())
                brick = atlas.brick(number, place)
                if brick is None:
                    continue
                low, high = atlas.region.box(place)
                inside = (self.points[some[lanes]] - low) / (high - low) * WHOLE
                met = Counter[int]()
                for sheet, root in brick.minima:
                    met[sheet] += 1
                    offer = offers.setdefault((sheet, met[sheet]), _no_candidate(charted, sheet, first, count))
                    _fill_candidates(offer, brick, root, lanes, self.points[some[lanes]] / charted.chart.scale, inside)
            for offer in offers.values():
                given = np.nonzero(np.isfinite(offer.y[:, 0]))[0]
                values = self.points[some[given]] / charted.chart.scale
                offer.y[given], missed = charted.at_bounds(offer.sheet, values, offer.y[given])
                offer.cost[given[missed]] = -np.inf  # it is polished in any case
            found += offers.values()
            first += len(charted.sheets)
        return found

    def answers(self) -> Answers:
        """Return the answers in SI."""
        good, problem = self.answered == Answered.YES, self.atlas.problem
        for rows in (self.free, self.slopes):
            rows[~good] = np.nan
        return Answers(
            answered=self.answered,
            objective=np.where(good, self.cost * problem.objective_size, np.nan),
            free=dict(zip(problem.free_names, self.free.T, strict=True)),
            sheet=np.where(good, self.sheet, -1),
            steps=self.steps,
            guess_error=np.where(good, self.relative_error, np.nan),
            error_bound=np.where(good, self.bound, np.nan),
            slopes=self.slopes,
        )


def _no_candidate(charted: OpenChart, sheet: int, first: int, count: int) -> _BranchCandidates:
    y, cost = np.full((count, charted.unknowns), np.nan), np.full(count, np.inf)
    no = np.zeros(count, dtype=bool)
    return _BranchCandidates(charted, sheet, first, y, cost, no, y.copy(), no.copy())


def _fill_candidates(
    offer: _BranchCandidates, brick: LoadedBrick, root: int, lanes: Lanes, values: Matrix, inside: Matrix
) -> None:
    """Fill in what the cells of a branch give at points of a block.

    Parameters
    ----------
    offer
        The candidates to fill.
    brick, root
        The block, and the first cell of the branch.
    lanes
        Rows of the candidates.
    values
        Values of the axes, canonical, (lanes, d).
    inside
        Places in the block, in lattice steps, (lanes, d).
    """
    cells = brick.leaves(root, inside)
    status = brick.arrays[3][cells]
    serving, short = np.isin(status, SERVING), (status == Status.NO_ANSWER) & offer.charted.borders.of_arcs
    if (some := np.nonzero(serving | short)[0]).size:
        said = brick.cells[cells[some]]
        share = (inside[some] - said["low"]) / said["size"]
        given = interpolated(brick.nodes["terms"][said["corners"]], share, said["size"] * brick.step)
        short[some] &= offer.charted.short(values[some], given[:, :-1])
        offer.y[lanes[serving]], offer.broken[lanes[short]] = given[serving[some], :-1], given[short[some], :-1]
        offer.cost[lanes[some]] = np.where((serving | short)[some], given[:, -1], np.inf)
    offer.short[lanes] = short
    breaks = status == Status.BREAKS
    offer.breaks[lanes] = breaks | short
    for i in np.nonzero(breaks)[0].tolist():
        offer.broken[lanes[i]] = brick.given(int(cells[i]), inside[i])[:-1]
    if (some := np.nonzero((status == Status.ENDS) | (status == Status.BREAKS))[0]).size:
        offer.cost[lanes[some]] = brick.least(cells[some], inside[some])
