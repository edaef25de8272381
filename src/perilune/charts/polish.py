"""Polish of interpolated cells to extremals: a few steps of Newton's method, and a test of the result.

Each lane is a point with a branch of its own. After the last evaluation one more step is made that is not evaluated: by
quadratic convergence it leaves no residual. The independent re-integration (`perilune.charts.reintegrate`)
begins there.

It bounds the distance of the root: with h the residual of the independent re-integration, Newton's method would step by
J^-1 h, and by Kantorovich's theorem a root lies within twice that if the steps shrink quadratically, as those before
did. The bound is as good as the arithmetic that computes it. Source: Deuflhard, *Newton Methods for Nonlinear
Problems*, Springer 2011, section 2.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.charts.borders import Borders
from perilune.charts.bound_status import SLACK, conjunction
from perilune.charts.chart import Chart, orientation
from perilune.charts.extrapolated_midpoint import MarchedMargins
from perilune.charts.reintegrate import BoundReintegration, ChartReintegration, ReintegratedExtremals
from perilune.charts.sheet import Sheet
from perilune.core import Matrix, Vector
from perilune.kernels import Map, compile_map

_DONE = 1e-5  # relative: a step that leaves its own square; what is left of it the independent re-integration measures
_MOST = 6  # steps
_SHRINKS = 0.25  # by so much at least from step to step
_CLOSE = 1e-10  # relative: farther from the extremal y makes another step
_FLOWN = 1e-6  # canonical, by which the independent re-integration of what breaks the path may miss its ends
# Of Newton's method: its last step, whether all have shrunk, whether it goes on, and how many there were.
_LENGTH, _SHRINKING, _GOING, _STEPS = range(4)
# What is stated of an extremal: see `Polished`; whether to integrate once more.
_ANSWERS, _DOUBTFUL, _BREAKING, _SHORT, _GAINS, _POOR, _BOUND, _AWAY = range(8)
_COST = MarchedMargins._fields.index("cost")
_LOST = 0.5  # of 1 + |y|: a longer step is of no use
_AGAIN, _NEAR = 2, 1e-2  # times that it is tried from where it stopped, and relative steps up to which it is near


@dataclass(frozen=True, kw_only=True)
class Polished:
    """Extremals at points, in lanes.

    Attributes
    ----------
    y
        All unknowns of the chart behind the last step, (lanes, size).
    choice
        What they hold, as of `Chart.choice`.
    course
        Course of Newton's method: columns `_LENGTH` and so on.
    verdicts
        Verdicts: columns `_ANSWERS` and so on.
    passed
        1 for bounds that they lie beyond.
    slopes
        dJ/dp of the axes, canonical, as the independent re-integration has them.
    reached
        True if Newton's method converged to an extremal of the branch.
    reintegrated
        Their independent re-integrations.
    """

    y: Matrix
    choice: Matrix
    course: Matrix
    verdicts: Matrix
    passed: Matrix
    slopes: Matrix
    reached: NDArray[np.bool_]
    reintegrated: ReintegratedExtremals

    @property
    def rough(self) -> NDArray[np.int64]:
        """Return the lanes in which Newton's method stopped near an extremal.

        If second derivatives are large, as where a switch is about to appear, steps shrink less at first, or the last
        one leaves more.
        """
        stopped = ~self.reached & (self.course[:, _LENGTH] <= _NEAR)
        missed = np.maximum(self.reintegrated.margins.residual, self.bound) > SLACK
        return np.nonzero(stopped | self.reached & missed)[0]

    def put(self, lanes: NDArray[np.int64], by: Polished) -> None:
        """Replace some lanes by others, which begin where they stopped.

        Parameters
        ----------
        lanes
            Numbers of the lanes that are replaced, (lanes,).
        by
            Their extremals, polished further, in that order.
        """
        by.course[:, _STEPS] += self.course[lanes, _STEPS]
        for name in ("y", "choice", "course", "verdicts", "passed", "slopes", "reached"):
            getattr(self, name)[lanes] = getattr(by, name)
        self.reintegrated.replace(lanes, by.reintegrated)

    def copy(self) -> Polished:
        """In arrays of its own."""
        return Polished(
            y=self.y.copy(), choice=self.choice.copy(), course=self.course.copy(), verdicts=self.verdicts.copy(),
            passed=self.passed.copy(), slopes=self.slopes, reached=self.reached, reintegrated=self.reintegrated.copy(),
        )  # fmt: skip

    def row(self, lane: int) -> tuple[Matrix, Matrix, Vector, Vector]:
        """Return y, choice, residual and J of a lane, as `OpenChart.root` takes them."""
        its = slice(lane, lane + 1)
        return self.y[its], self.choice[its], self.reintegrated.margins.residual[its], self.cost[its]

    @property
    def cost(self) -> Vector:
        """Return J of the independent re-integration, canonical."""
        return self.reintegrated.shown[:, _COST]

    @property
    def steps(self) -> Vector:
        """Return the number of Newton steps, (lanes,)."""
        return self.course[:, _STEPS]

    @property
    def answers(self) -> NDArray[np.bool_]:
        """Return True for those that keep bounds and path and, integrated independently, meet the end conditions."""
        return self.verdicts[:, _ANSWERS] > 0.0

    @property
    def doubtful(self) -> NDArray[np.bool_]:
        """Return True for those that might still be answers.

        They were not reached, or lie within their branch but are not confirmed by their independent re-integrations.
        """
        return self.verdicts[:, _DOUBTFUL] > 0.0

    @property
    def breaking(self) -> NDArray[np.bool_]:
        """Return True for those that are extremals of their branches but for breaking the path.

        A flight that keeps the path may still be better than other branches.
        """
        return self.verdicts[:, _BREAKING] > 0.0

    @property
    def short(self) -> NDArray[np.bool_]:
        """Return True for those that are extremals but for a negative arc duration."""
        return self.verdicts[:, _SHORT] > 0.0

    @property
    def gains(self) -> NDArray[np.bool_]:
        """Return True for those that can be flown, but gain by leaving an active bound: a better flight exists."""
        return self.verdicts[:, _GAINS] > 0.0

    @property
    def beyond(self) -> NDArray[np.bool_]:
        """Return True for bounds, stated by the user, that otherwise valid extremals lie beyond, as `Borders.beyond`.

        A flight that is held there may still be better.
        """
        return self.passed > 0.0

    @property
    def bound(self) -> Vector:
        """Return the bound on the error of y relative to the extremal, (lanes,)."""
        return self.verdicts[:, _BOUND]

    @property
    def relative_error(self) -> Vector:
        """Return the relative error of what the cell gave, (lanes,)."""
        return self.verdicts[:, _AWAY]


class Polisher:
    """Newton's method from guesses, for one chart."""

    def __init__(self, chart: Chart, borders: Borders, reflights: ChartReintegration, sheets: Sequence[Sheet]) -> None:
        self.chart: Chart = chart
        self.borders: Borders = borders
        self.reflights: ChartReintegration = reflights
        self.sheets: Sequence[Sheet] = sheets
        self.orientations: Vector = np.array([sheet.orientation for sheet in sheets])
        self.sides: Matrix = borders.sides(sheets)
        self.moving: NDArray[np.bool_] = borders.moving(self.sides)
        self.multipliers: list[int] = [nu for _, nu in chart.conditions.ranges]
        self._idle = list[_BoundPolisher]()

    def __call__(self, values: Matrix, which: NDArray[np.int64], guess: Matrix, finer: int = 1) -> Polished:
        """Polish guesses.

        Parameters
        ----------
        values
            Of the axes, (lanes, d), canonical.
        which
            Number of each lane's branch.
        guess
            Unknowns, (lanes, n).
        finer
            Times as many steps that the independent re-integration makes.
        """
        polished = self._polished(values, which, guess, finer)
        for _ in range(_AGAIN):
            if polished.answers.all() or not (rough := polished.rough).size:
                break
            active = self.chart.active
            begins, lanes = polished.y[rough][:, active], which[rough]
            polished.put(rough, again := self._polished(values[rough], lanes, begins, finer))
            away = np.linalg.norm(again.y[:, active] - guess[rough], axis=1)
            polished.verdicts[rough, _AWAY] = away / (1.0 + np.linalg.norm(again.y[:, active], axis=1))
        return polished

    def _polished(self, values: Matrix, which: NDArray[np.int64], guess: Matrix, finer: int) -> Polished:
        if len(values) != 1 or finer != 1:
            return _BoundPolisher(self, len(values), finer)(values, which, guess)
        try:
            one = self._idle.pop()  # of one lane, which is asked again and again; pop and append are atomic
        except IndexError:
            one = _BoundPolisher(self, 1, 1)
        polished = one(values, which, guess).copy()
        self._idle.append(one)
        return polished

    @cached_property
    def opening(self) -> Map:
        """Compile the start of Newton's method.

        (values, guess, sides, lower and upper bounds) -> what is held, unknowns that Newton moves, `Polished.course`.
        """
        chart, plan, s = self.chart, self.chart.shooting.plan, self.borders.symbols
        values, guess = ca.SX.sym("values", len(chart.names)), ca.SX.sym("guess", len(chart.active))
        masks, at = ca.fabs(s.side), ca.if_else(s.side > 0, s.lower, ca.if_else(s.side < 0, s.upper, 0))
        places = chart.varied_at
        masks[places], at[places] = 1.0, values
        choice, y = ca.vertcat(masks, at), ca.SX.zeros(len(plan.active))
        y[chart.places.tolist()], y[chart.held_at.tolist()] = guess, values
        first = ca.DM([_LOST, 1.0, 1.0, 0.0])
        found = choice, self._exactly(y, choice), first
        given = [values, guess, s.side, s.lower, s.upper]
        return compile_map(ca.Function("opening", given, [ca.densify(x) for x in found]))

    @cached_property
    def advance(self) -> Map:
        """Compile the step that follows an evaluation.

        (row, unknowns that Newton moves, what is held, `Polished.course`) -> unknowns and course behind its step, where
        it goes on; and all unknowns behind the last step, with 1 if it has converged.
        """
        plan = self.chart.shooting.plan
        row, y = ca.SX.sym("row", plan.columns.width), ca.SX.sym("y", len(plan.active))
        choice, course = ca.SX.sym("choice", 2 * plan.held), ca.SX.sym("course", 4)
        length, shrinking, going, steps = ca.vertsplit(course)
        now = row[2] / (1.0 + row[3])
        shrinks = ca.logic_and(shrinking, ca.logic_or(ca.logic_not(going), now <= _SHRINKS * length))
        goes = conjunction(going, shrinks, now > _DONE)
        close = ca.logic_and(shrinks, now <= _DONE)
        stepped = self._exactly(y + row[plan.columns.step], choice)
        whole = ca.SX.zeros(plan.size)
        whole[plan.active.tolist()] = self._exactly(ca.if_else(close, stepped, y), choice)
        found = ca.if_else(goes, stepped, y), ca.vertcat(now, shrinks, goes, steps + going), whole, close
        return compile_map(ca.Function("advance", [row, y, choice, course], [ca.cse(ca.densify(x)) for x in found]))

    def _exactly(self, y: ca.SX, choice: ca.SX) -> ca.SX:
        """Return unknowns with held free parameters exactly at their values, as a step is off in the last bit."""
        plan, found = self.chart.shooting.plan, ca.SX(y)
        for i in range(plan.free):
            at = plan.at_free + i
            found[at] = ca.if_else(choice[i] > 0, choice[plan.held + i], y[at])
        return found

    @cached_property
    def judgement(self) -> Map:
        """Compile the judgement of lanes by their independent re-integrations and inverse Jacobians.

        (y, choice, rows of `ReintegratedExtremals`, J^-1, guess, reached, sides, lower and upper bounds) -> y behind a
        step of what is left, `Polished.verdicts`, and `Polished.passed`.
        """
        chart, plan, borders, s = self.chart, self.chart.shooting.plan, self.borders, self.borders.symbols
        n = len(plan.active)
        y, choice = ca.SX.sym("y", plan.size), ca.SX.sym("choice", 2 * plan.held)
        sizes = {"residuals": len(chart.conditions.residuals), "shown": len(MarchedMargins._fields)}
        sizes |= {"rates": plan.free, "ranges": len(self.multipliers)}
        rows = [ca.SX.sym(name, size) for name, size in sizes.items()]
        residuals, seen, rates, ranges = rows[0], MarchedMargins(*ca.vertsplit(rows[1])), *rows[2:]
        inverse, guess = ca.SX.sym("inverse", n * n), ca.SX.sym("guess", len(chart.active))
        reached = ca.SX.sym("reached")
        left, mended = ca.mtimes(ca.reshape(inverse, n, n).T, residuals[plan.rows.tolist()]), ca.SX.zeros(plan.size)
        mended[plan.active.tolist()] = self._exactly(y[plan.active.tolist()] - left, choice)
        found = y[chart.active.tolist()]
        scale = 1.0 + ca.norm_2(found)
        bound, away = 2.0 * ca.norm_2(left) / scale, ca.norm_2(found - guess) / scale
        free = chart.conditions.free_at
        at, rises = ca.vertcat(y[free.start : free.stop], ranges), ca.vertcat(rates, -y[self.multipliers])
        s = s._replace(at=at, rises=rises, held=choice[: plan.held], touched=y[borders.touched])
        sound = seen.residual <= _FLOWN
        paying, kept = seen.least_multiplier >= -SLACK, seen.path >= -SLACK
        inside = ca.logic_and(s.margin >= -SLACK, paying)
        own, outside = ca.logic_and(reached, inside), ca.logic_and(reached, ca.logic_not(inside))
        answers = conjunction(own, seen.good, bound <= SLACK)
        breaking = conjunction(own, seen.path < -SLACK, sound)
        none = ca.logic_not(ca.logic_or(answers, ca.logic_or(outside, breaking)))
        gains = conjunction(outside, ca.logic_not(s.free_outside), kept, sound)
        short = ca.logic_and(reached, s.short(borders.users)) if borders.of_arcs else ca.SX(0)
        poor = ca.logic_and(reached, ca.logic_or(seen.nearly, bound > _CLOSE))
        flies = conjunction(outside, sound, paying, seen.minimum >= -SLACK, s.within().margin >= -SLACK)
        beyond = ca.logic_and(flies, s.beyond(borders.users))
        told = ca.vertcat(answers, none, breaking, short, gains, poor, bound, away)
        given = [y, choice, *rows, inverse, guess, reached, s.side, s.lower, s.upper]
        return compile_map(ca.Function("told", given, [ca.cse(ca.densify(x)) for x in (mended, told, beyond)]))


class _BoundPolisher:
    """Polish of a fixed number of lanes, bound to arrays."""

    def __init__(self, own: Polisher, lanes: int, finer: int) -> None:
        chart, plan = own.chart, own.chart.shooting.plan
        self._own, p = own, chart.p[None]
        sizes = len(chart.names), len(chart.active), plan.held, plan.columns.width, 1
        arrays = [np.empty((lanes, size)) for size in sizes]
        self._values, self._guess, self._sides, self._row, self._reached = values, guess, sides, row, reached = arrays
        limits, self._limits = own.borders.bind(values)
        self._opening = own.opening.bind(values, guess, sides, *limits)
        self._choice, self._y, self._course = self._opening.outputs
        self._flight = chart.shooting.bind(self._y, p, self._choice)
        self._advance = own.advance.bind(row, self._y, self._choice, self._course)
        whole, self._inverse = self._advance.outputs[2], row[:, plan.columns.inverse]
        times = [finer * times for times in own.reflights.times]
        self._reflight = BoundReintegration(own.reflights, whole, p, self._choice, times)
        known = self._inverse, guess, reached, sides, *limits
        self._judgement = own.judgement.bind(whole, self._choice, *self._reflight.rows[:4], *known)
        self._going, self._close = self._advance.outputs[1][:, _GOING], self._advance.outputs[3][:, 0]
        self._poor, self._varied = self._judgement.outputs[1][:, _POOR], np.array(chart.varied_at)
        self._moves = bool(own.moving.any())

    def __call__(self, values: Matrix, which: NDArray[np.int64], guess: Matrix) -> Polished:
        """Polish as `Polisher` does; the next call may overwrite the result."""
        own = self._own
        self._values[:], self._guess[:], self._sides[:] = values, guess, own.sides[which]
        self._limits()
        self._opening()
        y, course, whole, _ = self._advance.outputs
        for number in range(_MOST):  # a lane that is done stands still
            if number:
                self._y[:], self._course[:] = y, course
            self._row[:] = self._flight()
            self._advance()
            if not self._going.any():
                break
        n = own.chart.shooting.plan.columns.n
        turned = orientation(self._inverse.reshape(-1, n, n))
        reached = (self._close > 0.0) & (turned == own.orientations[which])
        self._reached[:, 0] = reached
        flown = self._reflight()
        self._judgement()
        mended, told, passed = self._judgement.outputs
        if self._poor.any():  # what it misses says where to
            poor = np.nonzero(self._poor)[0]
            whole[poor] = mended[poor]
            flown.replace(poor, own.reflights.finer(whole[poor], own.chart.p[None], self._choice[poor]))
            self._judgement()
        slopes = flown.rates[:, self._varied]
        if self._moves and own.moving[which].any() and (moves := own.borders.moves(self._sides, values)) is not None:
            rises = np.hstack([flown.rates, -whole[:, own.multipliers]])
            slopes = slopes + np.einsum("ldk,lk->ld", moves, rises)
        return Polished(
            y=whole, choice=self._choice, course=course, verdicts=told, passed=passed, slopes=slopes, reached=reached,
            reintegrated=flown,
        )  # fmt: skip
