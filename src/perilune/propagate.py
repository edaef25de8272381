"""Arcs of state, costate and state-transition columns: adaptive DOP853 over a traced right-hand side.

Z = (z, S) with z' = rhs(z, p) and S' = (drhs/dz) S. One whole Runge-Kutta step is one CasADi function, evaluated by
CasADi's interpreter. Coefficients: Hairer, Norsett, Wanner, Solving ODEs I (1993), as tabulated by SciPy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import casadi as ca
import numpy as np

from perilune.types import Matrix, Vector


class ArcStatus(IntEnum):
    """How an arc ended."""

    REACHED = 0
    STEP_LIMIT = 1
    NON_FINITE = 2


@dataclass(frozen=True, kw_only=True)
class Arc:
    """End of one arc: z (nz,), columns (nz, nc), its status and the number of steps."""

    z: Vector
    columns: Matrix
    status: ArcStatus
    steps: int


@lru_cache(maxsize=128)
def propagator(rhs: ca.Function, columns: int) -> Propagator:
    """Propagator of a right-hand side, made once for each number of columns."""
    return Propagator(rhs, columns)


class Propagator:
    """Integrates one phase's canonical equations with `columns` variational columns.

    Parameters
    ----------
    rhs
        (z, p) -> z', an SX function.
    columns
        Number of columns of S.
    """

    def __init__(self, rhs: ca.Function, columns: int) -> None:
        from scipy.integrate._ivp import dop853_coefficients as table

        self.size, self.count = rhs.size1_in(0), columns
        z = ca.SX.sym("z", self.size)
        p = ca.SX.sym("p", rhs.size1_in(1))
        seeds = ca.SX.sym("S", self.size, columns)
        rate = rhs(z, p)
        joined = ca.horzcat(rate, ca.jtimes(rate, z, seeds)) if columns else rate
        field = ca.Function("field", [ca.horzcat(z, seeds), p], [ca.cse(joined)])
        whole, h = ca.SX.sym("Z", self.size, columns + 1), ca.SX.sym("h")
        stages: list[ca.SX] = []
        for i in range(16):
            point = whole + h * sum((table.A[i, j] * stages[j] for j in range(i) if table.A[i, j]), ca.SX(0))
            if i == 12:
                new = whole + h * sum((table.B[j] * stages[j] for j in range(12) if table.B[j]), ca.SX(0))
                point = new
            stages.append(field(point, p))
        fifth = sum((table.E5[j] * stages[j] for j in range(13)), ca.SX(0))
        third = sum((table.E3[j] * stages[j] for j in range(13)), ca.SX(0))
        self._step = ca.Function("step", [whole, h, p], [new, h * fifth, h * third])
        self._stages = ca.Function("stages", [whole, h, p], [ca.horzcat(*[s[:, 0] for s in stages])])
        self._dense = table.D

    def _steps(self, start: Matrix, p: Vector, duration: float, rtol: float, atol: float, max_steps: int):  # noqa: ANN202
        """Yield (t, h, Z before, Z after) for each accepted step; NaN in Z after says the arc is lost."""
        t, state = 0.0, np.array(start, dtype=float)
        h, rejected = duration / 25.0, False
        for _ in range(max_steps):
            if abs(h) >= abs(duration - t):
                h = duration - t
            new, fifth, third = (np.asarray(out) for out in self._step(state, h, p))
            scale = atol + rtol * np.maximum(np.abs(state), np.abs(new))
            e5, e3 = np.sum((fifth / scale) ** 2), np.sum((third / scale) ** 2)
            error = e5 / np.sqrt((e5 + 0.01 * e3) * scale.size) if e5 or e3 else 0.0
            if not np.isfinite(error):
                h, rejected = 0.1 * h, True
                if abs(h) < 1e-10 * abs(duration):
                    yield t, h, state, np.full_like(state, np.nan)
                    return
                continue
            factor = min(10.0, 0.9 * error**-0.125) if error else 10.0
            if error >= 1.0:
                h, rejected = h * max(0.2, factor), True
                continue
            yield t, h, state, new
            t, state = t + h, new
            if t == duration or abs(duration - t) < 1e-15 * abs(duration):
                return
            h, rejected = h * (min(1.0, factor) if rejected else factor), False

    def propagate(
        self, z0: Vector, p: Vector, duration: float, columns: Matrix, *, rtol: float = 1e-12, atol: float = 1e-12, max_steps: int = 2000
    ) -> Arc:
        """Fly one arc.

        Parameters
        ----------
        z0, p
            Shape (nz,), (np,), canonical.
        duration
            Length of the arc; may be negative.
        columns
            S(0), shape (nz, columns).
        """
        state = np.column_stack([z0, columns])
        steps, reached = 0, duration == 0.0
        for t, h, _, new in self._steps(state, p, duration, rtol, atol, max_steps):
            state, steps = new, steps + 1
            reached = abs(t + h - duration) <= 1e-15 * abs(duration)
        finite = bool(np.all(np.isfinite(state)))
        status = ArcStatus.NON_FINITE if not finite else ArcStatus.REACHED if reached else ArcStatus.STEP_LIMIT
        return Arc(z=state[:, 0], columns=state[:, 1:], status=status, steps=steps)

    def dense(self, z0: Vector, p: Vector, duration: float, *, rtol: float = 1e-13, atol: float = 1e-13) -> Callable[[Vector], Matrix]:
        """Fly one arc and return z(t), (n,) -> (n, nz), from DOP853's seventh-order dense output."""
        times, steps, before, after, slopes = [], [], [], [], []
        start = np.column_stack([z0, np.zeros((self.size, self.count))])
        for t, h, old, new in self._steps(start, p, duration, rtol, atol, 4000):
            times.append(t)
            steps.append(h)
            before.append(old[:, 0])
            after.append(new[:, 0])
            slopes.append(np.asarray(self._stages(old, h, p)))
        t0, h, z_old, z_new = np.array(times), np.array(steps), np.array(before), np.array(after)
        K = np.array(slopes)  # (steps, nz, 16)
        jump = z_new - z_old
        f_old, f_new = h[:, None] * K[:, :, 0], h[:, None] * K[:, :, 12]
        F = [jump, f_old - jump, 2 * jump - (f_new + f_old)]
        F += [h[:, None] * (K @ row) for row in self._dense]

        def evaluate(t: Vector) -> Matrix:
            i = np.clip(np.searchsorted(t0, t, side="right") - 1, 0, len(t0) - 1)
            s = ((t - t0[i]) / h[i])[:, None]
            y = np.zeros((len(t), self.size))
            for k, f in enumerate(reversed(F)):  # SciPy's Dop853DenseOutput: alternate factors s and 1 - s
                y = (y + f[i]) * (s if k % 2 == 0 else 1 - s)
            return y + z_old[i]

        return evaluate
