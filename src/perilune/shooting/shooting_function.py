"""Shooting function of a boundary value problem, for many problems of one form at once, and its roots.

Single shooting as in Cho et al. 2015 (20)-(24): fly every phase from its start, evaluate the residual at the ends.
With several segments to a phase, the states at the joints are further unknowns and continuity is a further residual
(multiple shooting), for arcs on which errors grow too much. One problem is a batch of one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.conditions import OptimalityConditions
from perilune.core import Iteration, Matrix, Vector, Watch
from perilune.shooting.integrate_plan import fleet, jacobians
from perilune.shooting.newton import FINEST, TOLERANCE, Ends, Lanes, newton
from perilune.shooting.plan import Plan
from perilune.shooting.propagate import propagate_arc

_FLOWN = 1e-11  # relative error of what a flight ends with
_LAST_DIGITS = 1e-12  # of |y|: a smaller change is rounding
_SINGULAR = 1e8  # by which singular values of J^-1 of open directions exceed all others at a root


@dataclass(frozen=True, kw_only=True)
class Root:
    """End of a Newton run.

    Attributes
    ----------
    y
        The iterate: all unknowns, canonical.
    residual
        Of every condition, canonical; zero for those of silent costates.
    inverse
        Of the Jacobian of the unknowns that are not silent.
    slopes
        dJ/dq of each free parameter q along the family of extremals, held or not, canonical.
    ranges
        Value of each end condition that is a range, canonical.
    cost
        J, canonical.
    choice
        The active set (`Shooting.holding`).
    """

    y: Vector
    residual: Vector
    inverse: Matrix
    slopes: Vector
    ranges: Vector
    cost: float
    choice: Vector
    converged: bool
    history: tuple[Iteration, ...] = ()

    @property
    def exact(self) -> bool:
        """Return True if the residual is as small as Newton's method asks for."""
        return bool(np.abs(self.residual).max() <= TOLERANCE)

    @property
    def open_directions(self) -> int:
        """Count the directions that lead from this root to others; none from one that is isolated."""
        return self.flat_directions(_SINGULAR)

    def flat_directions(self, beyond: float) -> int:
        """Count the singular values of J^-1 that exceed all others by `beyond`: in these the residual is flat.

        None are counted where J has no finite inverse.
        """
        if not np.isfinite(self.inverse).all():
            return 0
        s = np.linalg.svd(self.inverse, compute_uv=False)
        gaps = np.nonzero(s[:-1] > beyond * s[1:])[0]
        return int(gaps[0]) + 1 if len(gaps) else 0


@dataclass(frozen=True, kw_only=True)
class Roots:
    """Ends of the Newton runs of all lanes; `Root` has the names."""

    plan: Plan
    y: Matrix
    rows: Matrix
    choice: Matrix
    converged: NDArray[np.bool_]
    evaluations: NDArray[np.int64]
    history: tuple[Iteration, ...] = ()

    @property
    def residuals(self) -> Vector:
        """Largest residual of each lane."""
        return self.rows[:, 0]

    @property
    def costs(self) -> Vector:
        """J of each lane, canonical."""
        return self.rows[:, self.plan.columns.extras.stop - 1]

    def replaced(self, lanes: NDArray[np.int64], by: Roots) -> Roots:
        """Return the same with other ends of some lanes.

        Parameters
        ----------
        lanes
            Indices of the lanes, shape (m,).
        by
            Their other ends, m lanes of the same plan.
        """
        fields = {name: getattr(self, name).copy() for name in _BY_LANE}
        for name, array in fields.items():
            array[lanes] = getattr(by, name)
        return replace(self, **fields, history=self.history + by.history)

    def of(self, lanes: NDArray[np.int64]) -> Roots:
        """Return some of the lanes."""
        return replace(self, **{name: getattr(self, name)[lanes] for name in _BY_LANE})

    def failed(self, which: NDArray[np.bool_]) -> Roots:
        """Return the same with some lanes not converged."""
        return replace(self, converged=self.converged & ~which)

    def __len__(self) -> int:
        return len(self.y)

    def __iter__(self) -> Iterator[Root]:
        return (self[i] for i in range(len(self)))

    def __getitem__(self, lane: int) -> Root:
        """Return one lane."""
        columns, row, q = self.plan.columns, self.rows[lane], self.plan.free
        residual = np.zeros(self.plan.size)
        residual[self.plan.rows] = row[columns.residual]
        extra = row[columns.extras]
        return Root(
            y=self.y[lane],
            residual=residual,
            inverse=row[columns.inverse].reshape(columns.n, columns.n),
            slopes=extra[:q],
            ranges=extra[q:-1],
            cost=float(extra[-1]),
            choice=self.choice[lane],
            converged=bool(self.converged[lane]),
            history=self.history,
        )


_BY_LANE = ("y", "rows", "choice", "converged", "evaluations")


class Shooting:
    """Shooting function of `conditions` over Y = (y, states at the joints).

    Parameters
    ----------
    conditions
        The boundary value problem.
    segments
        Arcs for each phase; 1 is single shooting.

    Attributes
    ----------
    arcs, iterations
        How many arcs were flown so far, and how many steps of Newton's method were made, in all lanes together.
    """

    def __init__(self, conditions: OptimalityConditions, segments: int = 1) -> None:
        self.conditions: OptimalityConditions = conditions
        self.segments: int = segments
        self.arcs: int = 0
        self.iterations: int = 0
        self._fleet = fleet(conditions, segments)
        self.plan: Plan = self._fleet.plan

    def holding(self, parameters: Mapping[int, float], ranges: Mapping[int, float] | None = None) -> Vector:
        """Return a choice: masks of which free parameters and ranges (by index) are held, then their values.

        Parameters
        ----------
        parameters
            Values of the free parameters held, canonical, by their index.
        ranges
            Values of the ranges held, canonical, by their index.

        Returns
        -------
        Vector
            Shape (2 k,), k the number of free parameters and ranges.
        """
        choice = np.zeros(2 * self.plan.held)
        for index, value in (*parameters.items(), *((self.plan.free + i, v) for i, v in (ranges or {}).items())):
            self.plan.hold(choice, index, value)
        return choice

    def held_values(self, roots: Roots) -> tuple[Matrix, Matrix]:
        """Return values of what can be held, free parameters, then ranges, and dJ/d(value) of each, (lanes, k)."""
        extra = roots.rows[:, self.plan.columns.extras]
        if not self.conditions.ranges:
            return roots.y[:, self.conditions.free_at], extra[:, : self.plan.free]
        nu = roots.y[:, [unknown for _, unknown in self.conditions.ranges]]
        values = np.hstack([roots.y[:, self.conditions.free_at], extra[:, self.plan.free : -1]])
        return values, np.hstack([extra[:, : self.plan.free], -nu])

    def solve(self, Y: Matrix, p: Matrix, choice: Matrix, watch: Watch | None = None, **settings: Any) -> Roots:
        """Solve by Newton's method in every lane.

        Parameters
        ----------
        Y
            First guesses, (lanes, unknowns), canonical.
        p
            Parameters of the canonical equations (`extremal_parameters`), (np,) or (lanes, np).
        choice
            Active set (`holding`), (k,) or (lanes, k): at the end its values are exact.
        watch
            Receives the iterations of a single lane.
        **settings
            Of `newton`.
        """
        p, choice, count = _as_rows(p), _as_rows(choice), len(Y)

        def of(array: Matrix, lanes: Lanes) -> Matrix:
            return array if len(array) == 1 or len(lanes) == count else array[lanes]

        def evaluate(lanes: Lanes, y: Matrix, accuracy: Vector, inverse: Matrix) -> Matrix:
            return self._fleet.fly(y, of(choice, lanes), of(p, lanes), accuracy, inverse)

        start = self._exactly(Y.take(self.plan.active, axis=1), choice)
        ends = newton(evaluate, start, self.plan.columns, watch=watch, **settings)
        self.arcs += int(ends.evaluations.sum()) * len(self.plan.legs)
        self.iterations += int(ends.iterations.sum())
        ends.y = self._exactly(ends.y, choice)
        return self._roots(ends, choice)

    def root(self, Y: Vector, p: Vector, choice: Vector, watch: Watch | None = None, **settings: Any) -> Root:
        """Solve by Newton's method from one Y: a batch of one.

        Parameters
        ----------
        Y
            Initial unknowns, shape (unknowns,), canonical.
        p, choice, watch, **settings
            As for `solve`, of one lane.
        """
        return self.solve(Y[None], p, choice, watch, **settings)[0]

    def at(self, Y: Matrix, p: Matrix, choice: Matrix) -> Roots:
        """Evaluate the shooting function at full accuracy; NaN where an arc could not be flown.

        Parameters
        ----------
        Y
            Unknowns, shape (lanes, unknowns), canonical.
        p, choice
            As for `solve`.
        """
        p, choice, count = _as_rows(p), _as_rows(choice), len(Y)
        y = self._exactly(Y.take(self.plan.active, axis=1), choice)
        rows = self._fleet.fly(y, choice, p, np.full(count, FINEST), np.zeros((count, self.plan.columns.n**2)))
        self.arcs += count * len(self.plan.legs)
        once, none = np.ones(count, dtype=np.int64), np.zeros(count, dtype=bool)
        return self._roots(Ends(y=y, rows=rows, converged=none, evaluations=once, iterations=1 - once), choice)

    def bind(self, y: Matrix, p: Matrix, choice: Matrix) -> Callable[[], Matrix]:
        """Bind `at` to arrays that are read at each call; a call returns the rows of an evaluation, (lanes, width).

        Parameters
        ----------
        y
            The unknowns that Newton's method moves, (lanes, n), with what is held where it is held.
        p, choice
            As for `at`, (lanes, ...) or (1, ...).
        """
        return self._fleet.bind(y, choice, p, np.full(len(y), FINEST), np.zeros((len(y), self.plan.columns.n**2)))

    def jacobians(self, Y: Matrix, p: Matrix, choice: Matrix) -> NDArray[np.float64]:
        """Return the Jacobians by the unknowns that are not silent, (lanes, n, n); NaN where an arc was lost.

        Parameters
        ----------
        Y
            Unknowns, shape (lanes, unknowns), canonical.
        p, choice
            As for `solve`.
        """
        p, choice = _as_rows(p), _as_rows(choice)
        return jacobians(self.conditions, self.segments, Y.take(self.plan.active, axis=1), p, choice)

    def joints(self, y: Vector, p: Vector) -> Vector | None:
        """Return Y for this number of segments from y: the states at the joints are those of a flight in one piece.

        Parameters
        ----------
        y
            Unknowns of single shooting, shape (unknowns,), canonical.
        p
            Parameters of the canonical equations, shape (np,), canonical.

        Returns
        -------
        Vector or None
            None where the flight has values that are not finite.
        """
        before, nodes = np.zeros(0), [y]
        for extremal, start in zip(self.conditions.phases, self.conditions.starts, strict=True):
            z0, duration = (np.array(out).ravel() for out in start(y, before, p))
            curve = propagate_arc(extremal, z0, p, float(duration[0]))
            at = curve(np.linspace(0.0, float(duration[0]), self.segments + 1))
            if not np.all(np.isfinite(at)):
                return None
            nodes.extend(at[1:-1])
            before = at[-1]
        return np.concatenate(nodes)

    def tangent(self, root: Root, index: int) -> Vector:
        """Return dY/dvalue at a root in which free parameter `index` is held.

        Parameters
        ----------
        root
            Root in whose active set the parameter is.
        index
            Index of the free parameter.
        """
        tangent = np.zeros(self.plan.size)
        tangent[self.plan.active] = root.inverse[:, self.plan.held_rows[index]]
        return tangent

    def shift(self, root: Root, ahead: Vector, behind: Vector, choices: Matrix | None = None) -> Vector:
        """Return the first-order change of Y at a root when the parameters p change from `behind` to `ahead`.

        With `choices` what is held changes as well: the choice there, and behind, (2, k).

        Parameters
        ----------
        root
            Root at the parameters `behind`.
        ahead, behind
            Parameters of the canonical equations, shape (np,), canonical.
        choices
            Active sets at `ahead` and at `behind`; None for that of the root.
        """
        held = root.choice if choices is None else choices
        rows = self.at(np.tile(root.y, (2, 1)), np.stack([ahead, behind]), held).rows
        change = rows[0, self.plan.columns.residual] - rows[1, self.plan.columns.residual]
        shift = np.zeros(self.plan.size)
        shift[self.plan.active] = -root.inverse @ change
        return shift

    def curvature(self, root: Root, index: int) -> float:
        """Return d2J/dq2 along the family in which free parameter `index` is held, at a root in which it is not.

        With J' the Jacobian in which q is held, e its row and g the row of dJ/dq, the tangent is t = J'^-1 e and the
        curvature g.t; J t = (g.t) e, so that the entry of J^-1 in q's column and row is 1/(g.t).

        Parameters
        ----------
        root
            Root in which the parameter is free.
        index
            Index of the free parameter q.
        """
        at = int(self.plan.active.searchsorted(self.conditions.free_at.start + index))
        return 1.0 / float(root.inverse[at, self.plan.held_rows[index]])

    def curved_upwards(self, root: Root, indices: Iterable[int]) -> bool:
        """Return True if J is least over several free parameters, except those that a root holds.

        As for one of them, the block of J^-1 in their columns and rows is the inverse of the second derivatives of J.

        Parameters
        ----------
        root
            Root with its inverse Jacobian.
        indices
            Indices of the free parameters.
        """
        free = np.array([i for i in indices if root.choice[i] == 0.0], dtype=np.int64)
        at = self.plan.active.searchsorted(self.conditions.free_at.start + free)
        block = root.inverse[np.ix_(at, self.plan.held_rows[free])]
        return bool(np.isfinite(block).all() and (np.linalg.eigvalsh(block + block.T) > 0.0).all())

    def curving_down(self, root: Root, p: Vector) -> list[int]:
        """Return the inactive ranges at ends of a root, by number, along which J has a maximum there.

        With the value v of one held, dJ/dv = -nu, and dnu/dv is an entry of the inverse Jacobian. Where nothing that
        the unknowns may do moves v by more than errors of a flight, as the speed of a fall through thick air, its sign
        is chance and there is nothing to go along.

        Parameters
        ----------
        root
            Root with its active set.
        p
            Parameters of the canonical equations, shape (np,), canonical.
        """
        found, first = list[int](), self.plan.free
        for k, (_, nu) in enumerate(self.conditions.ranges):
            if root.choice[first + k] == 0.0:
                held = root.choice.copy()
                self.plan.hold(held, first + k, root.ranges[k])
                inverse = self.at(root.y[None], p, held)[0].inverse
                along = inverse[:, self.plan.held_rows[first + k]]
                least = _FLOWN * (1.0 + abs(root.ranges[k]))  # change of v
                moves = np.linalg.norm(along) * least <= 1.0 + np.linalg.norm(root.y)
                if moves and along[self.plan.active.searchsorted(nu)] > 0.0:
                    found.append(k)
        return found

    def rounding(self, root: Root) -> bool:
        """Return True if the residual is no more than amplified errors in the last digits of y, or of states."""
        if not np.isfinite(root.inverse).all():
            return False
        step = root.inverse @ root.residual[self.plan.rows]
        if np.linalg.norm(step) <= _LAST_DIGITS * (1.0 + np.linalg.norm(root.y)):
            return True
        least = np.linalg.norm(root.inverse, -2)  # inverse of the largest growth of an error
        return bool(np.abs(root.residual).max() * least <= FINEST)

    def with_corrected_cost(self, root: Root) -> Root:
        """Return the root with J as if nothing were left at the ends: J + nu.psi is stationary, J to second order."""
        nu = root.y[self.conditions.free_at.stop : len(self.conditions.unknowns)]
        return replace(root, cost=root.cost + float(nu @ root.residual[: len(nu)]))

    def in_one(self, root: Root, pieces: Root) -> Root:
        """Return a root in pieces as one of single shooting.

        Where errors grow so much that its one flight misses only by rounding, it is a root as its pieces are, and has
        their residual and J.

        Parameters
        ----------
        root
            What single shooting reached from the unknowns of `pieces`.
        pieces
            Root of multiple shooting.
        """
        if root.converged or not self.rounding(root):
            return root
        y, residual = pieces.y[: len(root.y)], pieces.residual[: len(root.residual)]
        return replace(root, y=y, residual=residual, cost=pieces.cost, converged=True)

    def _exactly(self, y: Matrix, choice: Matrix) -> Matrix:
        """Return the root with held free parameters exact: Newton's method leaves an error in their last bit."""
        plan = self.plan
        held = choice[:, : plan.free] > 0
        if held.any():
            own, values = y[:, plan.at_free : plan.at_free + plan.free], choice[:, plan.held : plan.held + plan.free]
            np.copyto(own, values, where=held)
        return y

    def _roots(self, ends: Ends, choice: Matrix) -> Roots:
        plan, count = self.plan, len(ends.y)
        found = np.zeros((count, plan.size))
        found[:, plan.active] = ends.y
        return Roots(
            plan=plan,
            y=found,
            rows=ends.rows,
            choice=choice if len(choice) == count else np.tile(choice, (count, 1)),
            converged=ends.converged,
            evaluations=ends.evaluations,
            history=ends.history,
        )


def _as_rows(array: Vector | Matrix) -> Matrix:
    """Return one row for all lanes, where there are none."""
    return array if array.ndim == 2 else array[None]
