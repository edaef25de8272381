"""Charts: extremals as functions of parameters, by Newton's method in lanes, with exact derivatives.

A parameter that varies is a free one that is held (`perilune.problem.parametric`). So its value is a lane's own,
its column of the inverse Jacobian is dY/dp, and its row of the stationarity conditions dJ/dp along the family of
extremals. Derivatives by several parameters are differences of these, at points near the extremal on its tangent
plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.charts.arc_sequence import PLAIN, ArcSequence
from perilune.charts.parametric import parametric_problem, sizes_of
from perilune.conditions import OptimalityConditions, derive, extremal_parameters
from perilune.core import Matrix, Vector
from perilune.problem import Problem
from perilune.shooting import FINEST, Roots, Shooting


@dataclass(frozen=True, kw_only=True)
class Extremals:
    """Roots at values of the parameters, all canonical.

    Attributes
    ----------
    values
        Of the parameters, (lanes, d).
    y
        The other unknowns that Newton moves, (lanes, n).
    slopes
        dy/dp, (lanes, d, n).
    cost, cost_slopes
        J (lanes,) and dJ/dp (lanes, d).
    converged
        True for roots, (lanes,).
    length
        |J^-1 h| over 1 + |y|: the step that Newton's method would make from here, (lanes,).
    stepped
        y behind that step, (lanes, n).
    """

    values: Matrix
    y: Matrix
    slopes: NDArray[np.float64]
    cost: Vector
    cost_slopes: Matrix
    converged: NDArray[np.bool_]
    length: Vector
    stepped: Matrix
    roots: Roots

    @cached_property
    def orientation(self) -> Vector:
        """Return the sign of det(dh/dy), (lanes,): it changes only where two families of extremals meet, at a fold."""
        columns = self.roots.plan.columns
        return orientation(self.roots.rows[:, columns.inverse].reshape(-1, columns.n, columns.n))

    def of(self, lanes: NDArray[np.int64]) -> Extremals:
        """Return some of the lanes."""
        named = {f.name: getattr(self, f.name)[lanes] for f in fields(self) if f.name != "roots"}
        return Extremals(**named, roots=self.roots.of(lanes))


@dataclass(frozen=True)
class Holds:
    """Parameters held in each lane in addition to those that vary.

    Attributes
    ----------
    choice
        Masks of what can be held, then its values, (lanes, 2 k), canonical.
    moves
        Derivatives of the values that are held by the parameters, (lanes, d, k); None where they stay.
    """

    choice: Matrix
    moves: NDArray[np.float64] | None = None


def orientation(inverse: NDArray[np.float64]) -> Vector:
    """Return the sign of det J, given J^-1."""
    with np.errstate(all="ignore"):
        return np.linalg.slogdet(inverse)[0]


class Chart:
    """Extremals of a problem over some of its parameters.

    Parameters
    ----------
    problem
        What varies, at any values.
    names
        Of the parameters that vary.
    widths
        Length of the range of each [SI].
    course
        What its extremals go through.

    Attributes
    ----------
    problem
        That of which they are smooth extremals: restated, where they have several arcs.
    scale
        SI size of the canonical unit of each parameter, (d,).
    """

    def __init__(self, problem: Problem, names: Sequence[str], widths: Vector, course: ArcSequence = PLAIN) -> None:
        self.user: Problem = problem
        self.names: tuple[str, ...] = tuple(names)
        self.course: ArcSequence = course
        self.problem: Problem = course.restated(problem, names)
        self._sizes = sizes = sizes_of(self.problem, names, np.asarray(widths, dtype=float).tolist())
        self.free: Problem = parametric_problem(self.problem, names, sizes)
        self.conditions: OptimalityConditions = derive(self.free, course.keep)
        self.p: Vector = extremal_parameters(self.free)
        self.shooting: Shooting = Shooting(self.conditions)
        self.scale: Vector = np.array([sizes.get(name, problem.scales.of(problem.unit_of(name))) for name in names])
        self.widths: Vector = np.asarray(widths, dtype=float) / self.scale

    @cached_property
    def user_free(self) -> Problem:
        """Return the user's problem with the parameters free, as in the problem of the chart."""
        return parametric_problem(self.user, self.names, self._sizes)

    @cached_property
    def varied_at(self) -> list[int]:
        """Return the places of the varied parameters among the free ones."""
        return [self.free.free_names.index(name) for name in self.names]

    @cached_property
    def chosen(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the places of masks and of values of the varied parameters in a choice."""
        at = np.array(self.varied_at)
        return at, self.shooting.plan.held + at

    @cached_property
    def held_at(self) -> NDArray[np.int64]:
        """Return the places of the parameters among the unknowns that Newton's method moves."""
        return self.shooting.plan.at_free + np.array(self.varied_at)

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """Return the places of the other unknowns among those that Newton's method moves."""
        return np.setdiff1d(np.arange(len(self.shooting.plan.active)), self.held_at)

    @cached_property
    def active(self) -> NDArray[np.int64]:
        """Return the places of the other unknowns among all unknowns."""
        return self.shooting.plan.active[self.places]

    @cached_property
    def _held(self) -> NDArray[np.int64]:
        """Return the places of the parameters among all unknowns."""
        return self.shooting.plan.active[self.held_at]

    @cached_property
    def _rows(self) -> NDArray[np.int64]:
        """Return the rows of the parameters' stationarity conditions among the remaining residuals."""
        return self.shooting.plan.held_rows[self.varied_at]

    def choice(self, values: Matrix, holds: Holds) -> Matrix:
        """Return the choice of each lane, (lanes, 2 k): parameters held at their values, others as `holds` states.

        Parameters
        ----------
        values
            Values of the varied parameters, canonical, (lanes, d).
        holds
            Other parameters that are held.
        """
        choice = np.empty((len(values), 2 * self.shooting.plan.held))
        choice[:] = holds.choice
        choice[:, self.chosen[0]], choice[:, self.chosen[1]] = 1.0, values
        return choice

    def whole(self, values: Matrix, y: Matrix) -> Matrix:
        """Return all unknowns of lanes.

        Parameters
        ----------
        values
            Values of the parameters, canonical, (lanes, d).
        y
            Unknowns of the chart, canonical, (lanes, n).
        """
        Y = np.zeros((len(values), self.shooting.plan.size))
        Y[:, self.active], Y[:, self._held] = y, values
        return Y

    @cached_property
    def own(self) -> OptimalityConditions:
        """Return the optimality conditions of the problem itself, whose parameters do not vary."""
        return derive(self.problem, self.course.keep)

    def from_problem_unknowns(self, unknowns: Vector) -> Vector:
        """Return the unknowns of this chart, given those of the problem itself."""
        named = dict(zip(self.own.unknowns, unknowns, strict=True))
        names = [self.conditions.unknowns[i] for i in self.active]
        return np.array([named.get(name, 0.0) for name in names])

    def solve(self, values: Matrix, y: Matrix, holds: Holds, **settings: Any) -> Extremals:
        """Solve by Newton's method in each lane; settings as for `Shooting`.

        Parameters
        ----------
        values
            Values of the parameters, canonical, (lanes, d).
        y
            Unknowns to begin with, canonical, (lanes, n).
        holds
            Parameters held in addition.
        """
        settings = {"limit": 12, "accuracy": FINEST, **settings}
        roots = self.shooting.solve(self.whole(values, y), self.p, self.choice(values, holds), **settings)
        return self.extremals_from(values, roots, holds.moves)

    def at(self, values: Matrix, y: Matrix, holds: Holds) -> Extremals:
        """Evaluate conditions and derivatives at points that need not be roots.

        Parameters
        ----------
        values
            Values of the parameters, canonical, (lanes, d).
        y
            Unknowns, canonical, (lanes, n).
        holds
            Parameters held in addition.
        """
        roots = self.shooting.at(self.whole(values, y), self.p, self.choice(values, holds))
        return self.extremals_from(values, roots, holds.moves)

    def extremals_from(self, values: Matrix, roots: Roots, moves: NDArray[np.float64] | None = None) -> Extremals:
        """Return extremals with their derivatives from evaluated points, roots or not.

        The slopes of a parameter that moves held values (`Holds`) include the columns and dJ/d(value) of those.

        Parameters
        ----------
        values
            Values of the parameters, canonical, (lanes, d).
        roots
            The evaluated points.
        moves
            Derivatives of held values by the parameters, (lanes, d, k); None for constant ones.
        """
        plan, columns, rows = roots.plan, roots.plan.columns, roots.rows
        inverse = rows[:, columns.inverse].reshape(-1, columns.n, columns.n)
        slopes = inverse[:, self.places[:, None], self._rows[None]].transpose(0, 2, 1)
        cost_slopes = rows[:, columns.extras][:, self.varied_at]
        if moves is not None:
            slopes += np.einsum("ldk,lnk->ldn", moves, inverse[:, self.places[:, None], plan.held_rows[None]])
            cost_slopes += np.einsum("ldk,lk->ld", moves, self.shooting.held_values(roots)[1])
        return Extremals(
            values=values,
            y=roots.y[:, self.active],
            slopes=slopes,
            cost=roots.costs,
            cost_slopes=cost_slopes,
            converged=roots.converged & np.isfinite(rows).all(axis=1),
            length=rows[:, 2] / (1.0 + rows[:, 3]),
            stepped=(roots.y[:, plan.active] + rows[:, columns.step])[:, self.places],
            roots=roots,
        )
