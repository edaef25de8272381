"""Thousands of boundary value problems at once: Newton in lanes.

Each lane seeks y with R(y, z(T; z0(y)), p) = 0. An iteration is three calls of machine code for all lanes
that are still at work: start (z0, T, dz0/dy), arcs with the columns that y moves, and the correction (R,
dR/dy by the chain rule with dz_f/dy = S + f(z_f) dT/dy, and the Newton step by an orthogonal factorisation).
Damping and outcome belong to the lane: a step is halved until the residual falls. Early iterates are flown
with a tolerance fitted to their residual (an inexact Newton method); none counts as converged before it is
flown at the full one.

Source: Deuflhard, *Newton Methods for Nonlinear Problems*, Springer 2011, sections 2.1 (inexact) and 3.1
(damping).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perilune.kernels.code.mapped import compile_map
from perilune.kernels.flight.engine import compile_arcs
from perilune.words.outcome import PeriluneError
from perilune.words.types import Matrix, Vector

_LOOSEST = 1e-6  # tolerance of the first flights
_SMALLEST_STEP = 2.0**-12


class ShootingStatus(IntEnum):
    """How a lane ended."""

    CONVERGED = 0
    STALLED = 1  # no damped step lowered the residual
    ITERATION_LIMIT = 2
    NON_FINITE = 3  # the first arc was lost, or the Jacobian is singular


@dataclass(frozen=True, kw_only=True)
class Shots:
    """Solutions of a batch.

    Attributes
    ----------
    y
        Unknowns, (lanes, ny): the best found where a lane did not converge.
    z0, z
        States at start and end of the arcs, (lanes, nz).
    residual
        Largest entry of |R|, (lanes,).
    status
        `ShootingStatus` of each lane, (lanes,).
    iterations
        Arcs flown by each lane, (lanes,).
    """

    y: Matrix
    z0: Matrix
    z: Matrix
    residual: Vector
    status: NDArray[np.int64]
    iterations: NDArray[np.int64]

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Lanes that are solved."""
        return self.status == ShootingStatus.CONVERGED


class BatchShooter:
    """Solves one boundary value problem for many parameters at once.

    Parameters
    ----------
    rhs
        SX ``casadi.Function`` (z, p) -> z'.
    start
        SX function (y, p) -> (z0, duration).
    residual
        SX function (y, z_f, p) -> R, as many as y.
    cache, backend
        As for `compile_arcs`.

    Raises
    ------
    PeriluneError
        If there are not as many conditions as unknowns.
    """

    def __init__(self, rhs: Any, start: Any, residual: Any, *, cache: bool = True, backend: str | None = None) -> None:
        import casadi as ca

        self.ny, self.nz = start.size1_in(0), rhs.size1_in(0)
        if residual.size1_out(0) != self.ny:
            raise PeriluneError(
                "a boundary value problem needs as many conditions as unknowns",
                got=f"{residual.size1_out(0)} conditions, {self.ny} unknowns",
            )
        y, p = ca.SX.sym("y", self.ny), ca.SX.sym("p", rhs.size1_in(1))
        z0, duration = start(y, p)
        moved = ca.jacobian(z0, y)
        columns = sorted(set(moved.sparsity().get_triplet()[1]))
        seeds = ca.densify(moved[:, columns])
        pattern = np.asarray(ca.DM.ones(moved[:, columns].sparsity()).full(), dtype=bool)
        self._nc = len(columns)
        self.arcs = compile_arcs(rhs, columns=pattern, cache=cache, backend=backend)
        flat = ca.vertcat(ca.densify(z0), duration, ca.vec(seeds.T))  # row by row, as the engine takes them
        self._start = compile_map(ca.Function("start", [y, p], [flat]), cache=cache, backend=backend)

        zf, flown = ca.SX.sym("zf", self.nz), ca.SX.sym("S", self.nz * self._nc)
        conditions = ca.densify(residual(y, zf, p))
        spread = ca.SX.zeros(self.nz, self.ny)
        reached = self.arcs.system.pattern
        matrix = ca.project(ca.reshape(flown, self._nc, self.nz).T, reached)  # ignore what is zero for every arc
        spread[:, columns] = matrix
        spread = ca.sparsify(spread) + ca.mtimes(rhs(zf, p), ca.jacobian(duration, y))
        slope = ca.jacobian(conditions, y) + ca.mtimes(ca.jacobian(conditions, zf), spread)
        step = ca.densify(-ca.solve(ca.densify(slope), conditions))
        correct = ca.Function("correct", [y, zf, flown, p], [ca.vertcat(conditions, step)])
        self._correct = compile_map(correct, cache=cache, backend=backend)

    def _evaluate(self, y: Matrix, p: Matrix, rtol: Vector) -> tuple[Matrix, Matrix, Vector, Matrix]:
        """Return z0, z_f, |R| and the Newton step of each lane."""
        opening = self._start(y, p)
        z0, duration = opening[:, : self.nz], opening[:, self.nz]
        seeds = opening[:, self.nz + 1 :].reshape(-1, self.nz, self._nc)
        arcs = self.arcs.propagate(z0, p, duration, seeds, rtol=rtol, atol=rtol)
        closing = self._correct(y, arcs.z, arcs.columns.reshape(len(y), -1), p)
        size = np.abs(closing[:, : self.ny]).max(axis=1)
        size[~arcs.succeeded | ~np.all(np.isfinite(closing), axis=1)] = np.inf
        return z0, arcs.z, size, closing[:, self.ny :]

    def solve(
        self,
        y: ArrayLike,
        p: ArrayLike,
        *,
        tolerance: float = 1e-10,
        rtol: float = 1e-12,
        max_iterations: int = 60,
    ) -> Shots:
        """Solve every lane.

        Parameters
        ----------
        y
            First guesses, (lanes, ny) or one for all, (ny,).
        p
            Parameters, (lanes, np).
        tolerance
            Largest entry of |R| that counts as solved.
        rtol
            Tolerance of the arcs.
        max_iterations
            Arcs allowed to a lane.
        """
        parameters = np.ascontiguousarray(np.atleast_2d(np.asarray(p, dtype=float)))
        lanes = len(parameters)
        best = np.array(np.broadcast_to(np.asarray(y, dtype=float), (lanes, self.ny)))
        trial, step = best.copy(), np.zeros((lanes, self.ny))
        z0, z = np.full((lanes, self.nz), np.nan), np.full((lanes, self.nz), np.nan)
        size, fraction = np.full(lanes, np.inf), np.ones(lanes)
        accuracy = np.full(lanes, max(rtol, _LOOSEST))
        status = np.full(lanes, int(ShootingStatus.ITERATION_LIMIT))
        iterations = np.zeros(lanes, dtype=np.int64)
        work = np.arange(lanes)
        for _ in range(max_iterations):
            iterations[work] += 1
            start, end, new, correction = self._evaluate(trial[work], parameters[work], accuracy[work])
            first = ~np.isfinite(size[work])
            floor = np.maximum((1 - 1e-4 * fraction[work]) * size[work], np.maximum(tolerance, 100 * accuracy[work]))
            better = np.isfinite(new) & (first | (new <= floor))
            lost, taken = work[first & ~better], work[better]
            best[taken], step[taken], size[taken] = trial[taken], correction[better], new[better]
            z0[taken], z[taken] = start[better], end[better]
            done = better & (new <= tolerance) & (accuracy[work] <= rtol)
            fraction[taken] = np.minimum(1.0, 2 * fraction[taken])
            refused = work[~better]
            fraction[refused] /= 2
            stalled = refused[fraction[refused] < _SMALLEST_STEP]
            status[work[done]] = ShootingStatus.CONVERGED
            status[stalled], status[lost] = ShootingStatus.STALLED, ShootingStatus.NON_FINITE
            work = work[~done & ~np.isin(work, lost) & ~np.isin(work, stalled)]
            if not len(work):
                break
            # A full Newton step squares the residual: fly it well below what is expected of it.
            accuracy[work] = np.clip(1e-2 * size[work] ** 2, rtol, max(rtol, _LOOSEST))
            trial[work] = best[work] + fraction[work, None] * step[work]
        return Shots(y=best, z0=z0, z=z, residual=size, status=status, iterations=iterations)
