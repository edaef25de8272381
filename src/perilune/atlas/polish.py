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
from perilune.atlas.reflight import SLACK, Reflights, Reflown
from perilune.atlas.sheets import Borders, Sheet
from perilune.kernels import Map, compile_map
from perilune.shooting.function import Roots
from perilune.words.types import Matrix, Vector

_DONE = 1e-5  # relative: a step that leaves its own square; what is left of it the second flight tells
_MOST = 6  # steps
_SHRINKS = 0.25  # by so much at least from step to step
_CLOSE = 1e-10  # relative: farther from the extremal y makes another step
_FLOWN = 1e-6  # canonical, by which the second flight of what breaks the path may miss its ends
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
        holds = self.borders.holds(self.sheets, which, values, limits)
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
        inverse = roots.rows[:, plan.columns.inverse].reshape(-1, plan.columns.n, plan.columns.n)
        reached = shrinking & (length <= _DONE) & (orientation(inverse) == self.orientations[which])
        y[reached[:, None] & plan.moved] += roots.rows[reached, plan.columns.step].ravel()
        self._exactly(y, choice)
        flown = self.reflights(y, self._p, choice)
        left, (bound, away) = self._left(roots, y, guess, flown)
        good = flown.good
        if (poor := np.nonzero(reached & (flown.nearly | (bound > _CLOSE)))[0]).size:  # what it misses says where to
            y[poor[:, None], plan.active] -= left[poor]
            self._exactly(y, choice)
            flown.replace(poor, self.reflights.finer(y[poor], self._p, choice[poor]))
            left, (bound, away) = self._left(roots, y, guess, flown)
            good = flown.good
        at, rises, slopes = y[:, chart.conditions.free_at], flown.rates, flown.rates[:, chart.varied_at]
        if self._multipliers:
            at, rises = np.hstack([at, flown.ranges]), np.hstack([rises, -y[:, self._multipliers]])
        if holds.moves is not None:
            slopes = slopes + np.einsum("ldk,lk->ld", holds.moves, rises)
        margin = self.borders.margins(self.sheets, which, y, at, rises, choice, limits)
        inside = np.minimum(margin, flown.pays) >= -SLACK
        outside, sound = reached & ~inside, flown.residual <= _FLOWN
        beyond, allowed = np.zeros((count, len(self.borders.bounds)), dtype=bool), outside
        if outside.any():
            free = ~(choice[:, : plan.held] > 0)
            allowed = ~(free & ((at < limits[0] - SLACK) | (at > limits[1] + SLACK))).any(axis=1)
            some = np.nonzero(outside & sound & (np.minimum(flown.pays, flown.minimum) >= -SLACK))[0]
            here = limits[0][some], limits[1][some]
            within = np.clip(at[some], *here)
            others = self.borders.margins(self.sheets, which[some], y[some], within, rises[some], choice[some], here)
            beyond[some] = self.borders.beyond(at[some], choice[some], here) & (others >= -SLACK)[:, None]
        answers = reached & inside & good & (bound <= SLACK)
        breaking = reached & inside & (flown.path < -SLACK) & sound
        return Polished(
            y=y,
            choice=choice,
            cost=flown.cost,
            slopes=slopes,
            reached=reached,
            answers=answers,
            doubtful=~answers & ~outside & ~breaking,
            breaking=breaking,
            short=reached & self.borders.short(y, at, limits),
            beyond=beyond,
            gains=outside & allowed & (flown.path >= -SLACK) & sound,
            steps=steps,
            bound=bound,
            away=away,
            flown=flown,
        )

    def _exactly(self, y: Matrix, choice: Matrix) -> None:
        """Put free parameters that are held where they are held: the last bit of a step is Newton's."""
        plan = self.chart.shooting.plan
        held = choice[:, : plan.free] > 0
        np.copyto(y[:, self.chart.conditions.free_at], choice[:, plan.held : plan.held + plan.free], where=held)

    def _left(self, roots: Roots, y: Matrix, guess: Matrix, flown: Reflown) -> tuple[Matrix, Matrix]:
        """J^-1 h of what second flights leave; how far y can be from the extremal, and how far it was guessed."""
        inverse = roots.rows[:, roots.plan.columns.inverse]
        left, lengths = self._measured(inverse, flown.residuals, y, guess)
        return left, lengths.T

    @cached_property
    def _measured(self) -> Map:
        """(J^-1, residuals, unknowns, guess) -> J^-1 h, and relative to y: twice its length, and that of the change."""
        chart, plan = self.chart, self.chart.shooting.plan
        n = len(plan.active)
        inverse, residuals = ca.SX.sym("inverse", n * n), ca.SX.sym("h", len(chart.conditions.residuals))
        y, guess = ca.SX.sym("y", plan.size), ca.SX.sym("guess", len(chart.active))
        left = ca.mtimes(ca.reshape(inverse, n, n).T, residuals[plan.rows.tolist()])
        found = y[chart.active.tolist()]
        scale = 1.0 + ca.norm_2(found)
        lengths = ca.vertcat(2.0 * ca.norm_2(left), ca.norm_2(found - guess)) / scale
        return compile_map(ca.Function("measured", [inverse, residuals, y, guess], [left, lengths]))
