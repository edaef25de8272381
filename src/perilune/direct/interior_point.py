"""Primal-dual interior-point method for programs of moderate size.

With slacks s for the rows that are ranges, distances d > 0 from all bounds and their multipliers z, each step solves

    | H  A' | | dw |       | grad J - mu sum 1/d |    H: second derivatives of the Lagrangian, z/d of bounds and slacks
    | A  0  | | y  |  =  - |          c          |    A, c: slopes and values of the equations

by `perilune.direct.reduced_space`; where H is that of no minimum it is made larger. The barrier mu follows the affine
step (Mehrotra 1992). A step is taken where it gains in violation or in J with its barrier (a filter of one entry;
Waechter, Biegler 2006). There is no restoration and little patience here: what goes wrong ends with None, and is for a
solver that has both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import casadi as ca
import numpy as np

from perilune.core import Matrix, Vector, sign_of_life
from perilune.direct.assembly import Assembled
from perilune.direct.reduced_space import AddedWeights, ReducedEquations

# First points keep this distance from a bound, or this part of the range between two.
PUSH = 1e-2
# Steps halved before it is given up.
HALVINGS = 6
# Iterations after which a search that violates more than at its start is given up.
WANDERING = 8
# Least gain of a step: part of the violation.
GAIN = 1e-5
# Multipliers at the start beyond this say nothing; those of bounds are this much over the distance, and no more.
LARGEST, BARRIER = 1e3, 0.3
# Part of the tolerance at which a search that has converged ends without a further step.
CLOSER = 1e-2
# Multipliers of bounds stay within this of mu / d.
APART = 1e10


@dataclass(frozen=True, kw_only=True)
class PosedProgram:
    """A program with the numbers of one problem: given values, bounds of unknowns and rows.

    `states` are unknowns, `dynamics` the rows that determine them: in each of the `segments` of both from those before.
    `sizes` are those of the states. `lengths` are rows that hold directions at length one, with the unknowns in them.
    """

    program: Assembled
    given: Vector
    lower: Vector
    upper: Vector
    low: Vector
    high: Vector
    states: Vector
    dynamics: Vector
    segments: Sequence[slice]
    sizes: Vector
    lengths: Sequence[tuple[Vector, Matrix]]


class Optimum(NamedTuple):
    """Unknowns, J, rows, and multipliers of rows (L = J + multipliers . rows)."""

    w: Vector
    objective: float
    rows: Vector
    multipliers: Vector
    iterations: int


class _Point(NamedTuple):
    """Unknowns and slacks v, distances and multipliers of bounds, multipliers of equations and ranges."""

    v: Vector
    d: Vector
    z: Vector
    y: Vector
    ranged: Vector


class _InteriorPointStep(NamedTuple):
    """Changes of v and of the distances, and the new multipliers."""

    v: Vector
    d: Vector
    y: Vector
    ranged: Vector


def find_local_optimum(posed: PosedProgram, w: Vector, iterations: int, tolerance: float) -> Optimum | None:
    """Return the local optimum that the search reaches from w, or None.

    Parameters
    ----------
    posed
        The program with its numbers.
    w
        Unknowns to start from.
    iterations
        Most iterations.
    tolerance
        Largest violation of the optimality conditions.
    """
    fixed = posed.lower == posed.upper
    if fixed[posed.states].any() or any(fixed[columns].any() for _, columns in posed.lengths):
        return None
    with np.errstate(all="ignore"):  # what is not a number ends the search
        try:
            return _InteriorPointSearch(posed, tolerance).run(w, iterations)
        except ArithmeticError:
            return None


class _InteriorPointSearch:
    """The order of unknowns (states first) and equations (dynamics first), and what is evaluated in it."""

    def __init__(self, posed: PosedProgram, tolerance: float) -> None:
        self.tolerance, self.segments, self.sizes = tolerance, posed.segments, posed.sizes
        others = posed.lower < posed.upper
        others[posed.states] = False
        self.order = np.concatenate([posed.states, np.nonzero(others)[0]])
        equal = posed.low == posed.high
        self.ranged = np.nonzero(~equal)[0]
        first = np.concatenate([posed.dynamics, *(rows for rows, _ in posed.lengths)])
        equal[first] = False
        self.equal = np.concatenate([first, np.nonzero(equal)[0]])
        self.wanted = posed.low[self.equal]
        self.n = len(self.order)
        self.lower = np.concatenate([posed.lower[self.order], posed.low[self.ranged]])
        self.upper = np.concatenate([posed.upper[self.order], posed.high[self.ranged]])
        below, above = np.nonzero(np.isfinite(self.lower))[0], np.nonzero(np.isfinite(self.upper))[0]
        # Distances from bounds are sign (v - bound).
        self.at = np.concatenate([below, above])
        self.sign = np.concatenate([np.ones(len(below)), -np.ones(len(above))])
        self.bound = np.concatenate([self.lower[below], self.upper[above]])
        self.here = _Evaluated(posed, self.order, self.equal, self.ranged)
        self.directions_at = [self.here.place[columns] for _, columns in posed.lengths]

    def run(self, start: Vector, iterations: int) -> Optimum | None:
        """Run the search from a start; the fixed unknowns keep its values."""
        here, n = self.here, self.n
        self.here.all = start.copy()
        w = self.inside(np.concatenate([start[self.order], np.zeros(len(self.ranged))]))[:n]
        here.evaluate(w, np.zeros(len(self.equal)), np.zeros(len(self.ranged)))
        point = self.first_multipliers(self.inside(np.concatenate([w, here.g_ranged])))
        here.curve(point.y, point.ranged)
        found, best, missed = None, self.tolerance, self.missed(point.v)
        for iteration in range(iterations + 1):
            sign_of_life(f"direct method: iteration {iteration} of the nonlinear program")
            error, apart = self.errors(point)
            if max(error, apart) <= self.tolerance:
                # The last step is worth its while: the multipliers of states become costates.
                if found is None or error < best:
                    found, best = here.optimum(point.y, point.ranged, iteration), error
                if error <= CLOSER * self.tolerance or error > best:
                    break
            wandering = iteration > WANDERING and self.missed(point.v) > missed
            if iteration == iterations or wandering or not math.isfinite(error):
                break
            steps = self.directions(point)
            moved = steps and self.moved(point, *self.centred(point, *steps))
            if not moved:
                break
            point = moved
        return found

    def inside(self, v: Vector) -> Vector:
        """Return the point moved off its bounds."""
        low, high = (np.where(np.isfinite(b), PUSH * np.maximum(1.0, np.abs(b)), 0.0) for b in (self.lower, self.upper))
        width = PUSH * (self.upper - self.lower)
        return np.minimum(np.maximum(v, self.lower + np.minimum(low, width)), self.upper - np.minimum(high, width))

    def onto(self, values: Vector) -> Vector:
        """Return the sum of what belongs to the bounds of each unknown and slack."""
        return np.bincount(self.at, values, minlength=len(self.lower)) + 0.0

    def first_multipliers(self, v: Vector) -> _Point:
        """Return barrier multipliers of bounds, and of the others the least-squares fit to the slopes."""
        here, d = self.here, self.sign * (v[self.at] - self.bound)
        z = BARRIER / np.maximum(d, 1.0)
        pull = self.onto(self.sign * z)
        ranged = -pull[self.n :]
        slope = here.gradient - pull[: self.n] + here.multiplier_gradient(np.zeros(len(self.equal)), ranged)
        weighed = AddedWeights(np.ones(self.n), np.zeros(len(ranged)))
        found = self.reduced().step(None, weighed, np.column_stack([slope, slope]))
        y = np.zeros(len(self.equal)) if found is None else found[2][:, 1]
        y = y if np.abs(y).max() < LARGEST else np.zeros(len(y))
        return _Point(v, d, z, y, ranged)

    def errors(self, point: _Point) -> tuple[float, float]:
        """Return the largest violation of the optimality conditions, relative to large multipliers, and largest d z."""
        here, (_, d, z, y, ranged) = self.here, point
        dual = -self.onto(self.sign * z)
        dual[: self.n] += here.gradient + here.multiplier_gradient(y, ranged)
        dual[self.n :] -= ranged
        count = len(y) + len(ranged) + len(z)
        scale = max(1.0, (np.abs(y).sum() + np.abs(ranged).sum() + z.sum()) / (100.0 * count))
        c, missed = self.violations(here, point.v)
        error = float(max(np.abs(dual).max() / scale, c.max(), missed.max(initial=0.0)))
        return error, float((z * d).max(initial=0.0)) / scale

    def violations(self, here: _Evaluated, v: Vector) -> tuple[Vector, Vector]:
        """Return the violations of equations and of ranges, whose slacks are not their values yet."""
        return np.abs(here.g - self.wanted), np.abs(here.g_ranged - v[self.n :])

    def missed(self, v: Vector) -> float:
        """Return the sum of all violations."""
        return sum(float(part.sum()) for part in self.violations(self.here, v))

    def reduced(self) -> ReducedEquations:
        """Return the equations at the current point, solved for the states once."""
        here = self.here
        if here.reduced is None:
            c = here.g - self.wanted
            here.reduced = ReducedEquations(here.slopes, c, self.sizes, self.segments, self.directions_at)
        return here.reduced

    def directions(self, point: _Point) -> tuple[_InteriorPointStep, _InteriorPointStep] | None:
        """Return the affine step, and what each unit of mu adds to it."""
        here, n, d = self.here, self.n, point.d
        pull, sigma = self.onto(self.sign / d), self.onto(point.z / d)
        missed, right = here.g_ranged - point.v[n:], np.empty((n, 2))
        right[:, 0], right[:, 1] = here.gradient, -pull[:n]
        if len(missed):
            right += here.slopes[len(self.equal) :].T @ np.column_stack([sigma[n:] * missed, -pull[n:]])
        found = self.reduced().step(here.H, AddedWeights(sigma[:n], sigma[n:]), right)
        if found is None:
            return None
        dw, ds, y = found
        ds[:, 0] += missed
        ranged = sigma[n:, None] * ds
        ranged[:, 1] -= pull[n:]
        dv = np.vstack([dw, ds])
        change = self.sign[:, None] * dv[self.at]
        affine, by_mu = (_InteriorPointStep(dv[:, i], change[:, i], y[:, i], ranged[:, i]) for i in range(2))
        return affine, by_mu

    def centred(
        self, point: _Point, affine: _InteriorPointStep, by_mu: _InteriorPointStep
    ) -> tuple[_InteriorPointStep, float]:
        """Return the step with the barrier that the affine one asks for."""
        d, z = point.d, point.z
        if not len(d):
            return affine, 0.0
        now = float(d @ z) / len(d)
        change_z = -z - z / d * affine.d
        primal, dual = _longest_positive_step(d, affine.d, 1.0), _longest_positive_step(z, change_z, 1.0)
        ahead = float((d + primal * affine.d) @ (z + dual * change_z)) / len(d)
        mu = max(min((ahead / now) ** 3, 1.0) * now, 0.1 * self.tolerance)
        return _InteriorPointStep(*(a + mu * b for a, b in zip(affine, by_mu, strict=True))), mu

    def moved(self, point: _Point, step: _InteriorPointStep, mu: float) -> _Point | None:
        """Return the next point, evaluated, by the longest part of the step that gains."""
        here, (v, d, z, y, ranged) = self.here, point
        change_z = mu / d - z - z / d * step.d
        stay = max(0.99, 1.0 - mu)
        part = _longest_positive_step(d, step.d, stay)
        z = z + _longest_positive_step(z, change_z, stay) * change_z
        before = self.missed(v)
        worth = here.objective - mu * float(np.log(d).sum())
        rounding = 10.0 * np.finfo(float).eps * max(1.0, abs(worth))
        for _ in range(HALVINGS):
            new, far = v + part * step.v, d + part * step.d
            fresh = _Point(
                new, far, np.minimum(np.maximum(z, mu / (APART * far)), APART * mu / far),
                y + part * (step.y - y), ranged + part * (step.ranged - ranged),
            )  # fmt: skip
            here.evaluate(new[: self.n], fresh.y, fresh.ranged)
            after = self.missed(new)
            lost = here.objective - mu * float(np.log(far).sum()) - worth
            if after <= max((1 - GAIN) * before, self.tolerance) or lost <= rounding - GAIN * before:
                return fresh
            part *= 0.5
        return None


class _Evaluated:
    """Values and derivatives at the current point, dense and in the order of the search."""

    def __init__(self, posed: PosedProgram, order: Vector, equal: Vector, ranged: Vector) -> None:
        program, self.order, self.rows = posed.program, order, np.concatenate([equal, ranged])
        self._equations, n = len(equal), len(order)
        place, row = np.full(len(posed.lower), -1), np.empty(len(posed.low), dtype=int)
        place[order], row[self.rows] = np.arange(n), np.arange(len(self.rows))
        self.place = place
        of, by = program.jacobian_at
        known = np.nonzero(place[by] >= 0)[0]
        self._first, self._slots = known, (place[by] * len(self.rows) + row[of])[known]
        self._columns = np.zeros((n, len(self.rows)))
        self.slopes = self._columns.T  # as LAPACK has it
        of, by = (place[at] for at in program.hessian_at)
        self._second = np.nonzero((of >= 0) & (by >= 0))[0]
        self._upper, self._lower = ((a * n + b)[self._second] for a, b in ((of, by), (by, of)))
        self.H = np.zeros((n, n))
        self._call = _Call(program.everything)
        self._call.taken[1][:] = posed.given
        self._call.taken[2][:] = 1.0
        self.all = np.zeros(len(posed.lower))
        self.reduced: ReducedEquations | None = None

    def evaluate(self, w: Vector, y: Vector, ranged: Vector) -> None:
        """Evaluate J, rows and first derivatives at w, and the second ones of the Lagrangian."""
        self.all[self.order] = w
        self._call.taken[0][:] = self.all
        self.reduced = None
        J, g, gradient, jacobian = self.curve(y, ranged)
        self.objective, self.gradient = float(J[0]), gradient[self.order]
        self.g, self.g_ranged = np.split(g[self.rows], [self._equations])
        self._columns.ravel()[self._slots] = jacobian[self._first]

    def curve(self, y: Vector, ranged: Vector) -> list[Vector]:
        """Return the second derivatives of the Lagrangian with these multipliers, where it was evaluated last."""
        self._call.taken[3][self.rows] = np.concatenate([y, ranged])
        *others, hessian = self._call()
        H = self.H.ravel()
        H[self._upper] = H[self._lower] = hessian[self._second]
        return others

    def multiplier_gradient(self, y: Vector, ranged: Vector) -> Vector:
        """Return the slopes of equations and ranges with these multipliers."""
        return np.concatenate([y, ranged]) @ self.slopes

    def optimum(self, y: Vector, ranged: Vector, iterations: int) -> Optimum:
        """Return the current point as the answer."""
        rows, multipliers = np.empty(len(self.rows)), np.empty(len(self.rows))
        rows[self.rows] = np.concatenate([self.g, self.g_ranged])
        multipliers[self.rows] = np.concatenate([y, ranged])
        return Optimum(self.all.copy(), self.objective, rows, multipliers, iterations)


class _Call:
    """A CasADi function on arrays of nonzeros that stay where they are."""

    def __init__(self, function: ca.Function) -> None:
        buffer, self._evaluate = cast(Any, function).buffer()
        self._alive = buffer, function  # the call knows their addresses only
        self.taken = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        self._found = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        for i, array in enumerate(self.taken):
            buffer.set_arg(i, memoryview(cast(Any, array)))
        for i, array in enumerate(self._found):
            buffer.set_res(i, memoryview(cast(Any, array)))

    def __call__(self) -> list[Vector]:
        """Return the results, which the next call overwrites."""
        self._evaluate()
        return self._found


def _longest_positive_step(values: Vector, change: Vector, stay: float) -> float:
    """Return the longest step, at most 1, that leaves positive values at least `1 - stay` of what they are."""
    ratio = change / values
    steepest = -float(ratio.min(initial=0.0))
    return 1.0 if steepest <= stay else stay / steepest
