"""From what cells give to extremals: one step of Newton's method or a few, and whether what is reached is an answer.

Each lane is a point with a sheet of its own. After the last evaluation one more step is made that is not evaluated: it
is what is left, and by the law of squares it leaves nothing. The second flight (`perilune.atlas.reflight`) begins
there.

How far the root can be follows from there: with h the residual of the second flight, Newton's method would step by
J^-1 h, and by Kantorovich's theorem a root lies within twice that where the steps shrink as squares do, as those before
did. It is as good as the numbers that it is computed with are. Source: Deuflhard, *Newton Methods for Nonlinear
Problems*, Springer 2011, section 2.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.atlas.chart import Chart, orientation
from perilune.atlas.march import Seen
from perilune.atlas.reflight import Reflights, Reflown
from perilune.atlas.sheets import Borders, Sheet
from perilune.atlas.standing import SLACK, all_of
from perilune.kernels import Map, compile_map
from perilune.words.types import Matrix, Vector

_DONE = 1e-5  # relative: a step that leaves its own square; what is left of it the second flight tells
_MOST = 6  # steps
_SHRINKS = 0.25  # by so much at least from step to step
_CLOSE = 1e-10  # relative: farther from the extremal y makes another step
_FLOWN = 1e-6  # canonical, by which the second flight of what breaks the path may miss its ends
# Columns of what is told: answers, doubtful, breaking, short and gains; whether to fly once more; `bound` and `away`.
_FLAGS, _POOR, _BOUND, _AWAY = slice(5), 5, 6, 7
_LOST = 0.5  # of 1 + |y|: a longer step is of no use


@dataclass(frozen=True, kw_only=True)
class Polished:
    """Extremals at points, in lanes.

    Attributes
    ----------
    y
        All unknowns of the chart behind the last step, (lanes, size).
    choice
        What they hold.
    cost, slopes
        J there, and dJ/dp of the axes, canonical, as the second flight has them.
    reached
        Whether Newton's method converged to an extremal of the sheet.
    answers
        Whether that keeps its bounds and the path, and its second flight ends where it should.
    steps
        Of Newton's method.
    bound
        How far y can be from the extremal, relative.
    away
        How far what the cell gave was from it, relative.
    doubtful
        Whether it might be an answer all the same: not reached, or within its sheet but not borne out by its second
        flight.
    breaking
        Whether it is an extremal of its sheet but for breaking the path: a flight that keeps that may still be better
        than other sheets.
    short
        Whether it is an extremal but for an arc that is shorter than nothing: it becomes another there.
    beyond
        Which bounds of what the user states it lies beyond, being an extremal but for that, as `Borders.beyond` has
        them: a flight that is held there may still be better.
    gains
        Whether it can be flown, but would gain by leaving what it holds: there is a flight that is better still.
    flown
        Its second flight.
    """

    y: Matrix
    choice: Matrix
    cost: Vector
    slopes: Matrix
    reached: NDArray[np.bool_]
    answers: NDArray[np.bool_]
    doubtful: NDArray[np.bool_]
    breaking: NDArray[np.bool_]
    short: NDArray[np.bool_]
    beyond: NDArray[np.bool_]
    gains: NDArray[np.bool_]
    steps: NDArray[np.int64]
    bound: Vector
    away: Vector
    flown: Reflown


class Polisher:
    """Newton's method from guesses, for one chart."""

    def __init__(self, chart: Chart, borders: Borders, reflights: Reflights, sheets: Sequence[Sheet]) -> None:
        self.chart: Chart = chart
        self.borders: Borders = borders
        self.reflights: Reflights = reflights
        self.sheets: Sequence[Sheet] = sheets
        self.orientations: Vector = np.array([sheet.orientation for sheet in sheets])
        self._sides: Matrix = borders.sides(sheets)
        self._p, self._multipliers = chart.p[None], [nu for _, nu in chart.conditions.ranges]

    def __call__(self, values: Matrix, which: NDArray[np.int64], guess: Matrix) -> Polished:
        """Polish.

        Parameters
        ----------
        values
            Of the axes, (lanes, d), canonical.
        which
            Number of each lane's sheet.
        guess
            Unknowns, (lanes, n).
        """
        chart, plan, count = self.chart, self.chart.shooting.plan, len(values)
        limits = self.borders.at(values)
        sides = self._sides[which]
        holds = self.borders.held(sides, values, limits)
        choice = chart.choice(values, holds)
        y, length, steps = chart.whole(values, guess), np.full(count, _LOST), np.zeros(count, dtype=np.int64)
        going = shrinking = np.ones(count, dtype=bool)
        for number in range(1, _MOST + 1):  # a lane that is done stands still
            roots = chart.shooting.at(y, chart.p, choice)
            steps[going] = number
            now = roots.rows[:, 2] / (1.0 + roots.rows[:, 3])
            shrinking = shrinking & (~going | (now <= _SHRINKS * length))
            length, going = now, going & shrinking & (now > _DONE)
            if not going.any():
                break
            y[going[:, None] & plan.moved] += roots.rows[going, plan.columns.step].ravel()
        inverse = roots.rows[:, plan.columns.inverse]
        turned = orientation(inverse.reshape(-1, plan.columns.n, plan.columns.n))
        reached = shrinking & (length <= _DONE) & (turned == self.orientations[which])
        y[reached[:, None] & plan.moved] += roots.rows[reached, plan.columns.step].ravel()
        self._exactly(y, choice)
        flown = self.reflights(y, self._p, choice)
        known = inverse, guess, reached[:, None].astype(float), sides, *limits
        left, told, beyond = self._told(y, choice, *flown.rows, *known)
        if (poor := np.nonzero(told[:, _POOR])[0]).size:  # what it misses says where to
            y[poor[:, None], plan.active] -= left[poor]
            self._exactly(y, choice)
            flown.replace(poor, self.reflights.finer(y[poor], self._p, choice[poor]))
            left, told, beyond = self._told(y, choice, *flown.rows, *known)
        slopes = flown.rates[:, chart.varied_at]
        if holds.moves is not None:
            rises = np.hstack([flown.rates, -y[:, self._multipliers]])
            slopes = slopes + np.einsum("ldk,lk->ld", holds.moves, rises)
        answers, doubtful, breaking, short, gains = (told[:, _FLAGS] > 0.0).T
        return Polished(
            y=y,
            choice=choice,
            cost=flown.seen.cost,
            slopes=slopes,
            reached=reached,
            answers=answers,
            doubtful=doubtful,
            breaking=breaking,
            short=short,
            beyond=beyond > 0.0,
            gains=gains,
            steps=steps,
            bound=told[:, _BOUND],
            away=told[:, _AWAY],
            flown=flown,
        )

    def _exactly(self, y: Matrix, choice: Matrix) -> None:
        """Put free parameters that are held where they are held: the last bit of a step is Newton's."""
        plan = self.chart.shooting.plan
        held = choice[:, : plan.free] > 0
        np.copyto(y[:, self.chart.conditions.free_at], choice[:, plan.held : plan.held + plan.free], where=held)

    @cached_property
    def _told(self) -> Map:
        """What second flights and inverse Jacobians say of lanes.

        (y, choice, rows of `Reflown`, J^-1, guess, reached, sides, lower and upper bounds) -> J^-1 h of what is left,
        numbers at `_BOUND` and so on, and which `Borders.bounds` it lies beyond.
        """
        chart, plan, borders, s = self.chart, self.chart.shooting.plan, self.borders, self.borders.symbols
        n = len(plan.active)
        y, choice = ca.SX.sym("y", plan.size), ca.SX.sym("choice", 2 * plan.held)
        sizes = {"residuals": len(chart.conditions.residuals), "shown": len(Seen._fields)}
        sizes |= {"rates": plan.free, "ranges": len(self._multipliers)}
        rows = [ca.SX.sym(name, size) for name, size in sizes.items()]
        residuals, seen, rates, ranges = rows[0], Seen(*ca.vertsplit(rows[1])), *rows[2:]
        inverse, guess = ca.SX.sym("inverse", n * n), ca.SX.sym("guess", len(chart.active))
        reached = ca.SX.sym("reached")
        left = ca.mtimes(ca.reshape(inverse, n, n).T, residuals[plan.rows.tolist()])
        found = y[chart.active.tolist()]
        scale = 1.0 + ca.norm_2(found)
        bound, away = 2.0 * ca.norm_2(left) / scale, ca.norm_2(found - guess) / scale
        free = chart.conditions.free_at
        at, rises = ca.vertcat(y[free.start : free.stop], ranges), ca.vertcat(rates, -y[self._multipliers])
        s = s._replace(at=at, rises=rises, held=choice[: plan.held], touched=y[borders.touched])
        sound = seen.residual <= _FLOWN
        paying, kept = seen.pays >= -SLACK, seen.path >= -SLACK
        inside = ca.logic_and(s.margin >= -SLACK, paying)
        own, outside = ca.logic_and(reached, inside), ca.logic_and(reached, ca.logic_not(inside))
        answers = all_of(own, seen.good, bound <= SLACK)
        breaking = all_of(own, seen.path < -SLACK, sound)
        none = ca.logic_not(ca.logic_or(answers, ca.logic_or(outside, breaking)))
        gains = all_of(outside, ca.logic_not(s.free_outside), kept, sound)
        short = ca.logic_and(reached, s.short(borders.users)) if borders.of_arcs else ca.SX(0)
        poor = ca.logic_and(reached, ca.logic_or(seen.nearly, bound > _CLOSE))
        flies = all_of(outside, sound, paying, seen.minimum >= -SLACK, s.within().margin >= -SLACK)
        beyond = ca.logic_and(flies, s.beyond(borders.users))
        told = ca.vertcat(answers, none, breaking, short, gains, poor, bound, away)
        given = [y, choice, *rows, inverse, guess, reached, s.side, s.lower, s.upper]
        return compile_map(ca.Function("told", given, [ca.cse(ca.densify(x)) for x in (left, told, beyond)]))
