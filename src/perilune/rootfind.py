"""Damped Newton for shooting: Cho et al. 2015 (23), (24) with alpha chosen by the natural monotonicity test.

The step is dy = -J^-1 h. Damping alpha is accepted when the *simplified* correction |J^-1 h(y + alpha dy)| shrinks. That
test does not change when rows of h are scaled, so metres and radians may stand side by side (Deuflhard, Newton
Methods for Nonlinear Problems, 2004, section 3.3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from perilune.solution import Iteration
from perilune.types import Matrix, Vector

Residual = Callable[[Vector, bool], tuple[Vector, Matrix]]  # (y, with Jacobian) -> (h, J); NaN where undefined
Watch = Callable[[Iteration], None]


@dataclass(frozen=True, kw_only=True)
class Root:
    """End of a Newton run: the iterate, its residual and Jacobian, and whether it converged."""

    y: Vector
    residual: Vector
    jacobian: Matrix
    converged: bool
    history: tuple[Iteration, ...]


def damped_newton(
    function: Residual,
    y: Vector,
    *,
    tolerance: float = 1e-11,
    max_iterations: int = 60,
    max_step: float = np.inf,
    watch: Watch | None = None,
) -> Root:
    """Find a root of `function` from y.

    Parameters
    ----------
    function
        Residual and Jacobian; not evaluated with Jacobian on trial points.
    y
        Start, shape (n,), canonical units.
    tolerance
        On the largest component of the residual and, ten times wider, of the last undamped correction (relative).
    max_step
        Largest component of one step; keeps a far start from leaving where arcs can be flown.
    watch
        Called after each iteration.
    """
    history: list[Iteration] = []
    y = np.array(y, dtype=float)
    h, jacobian = function(y, True)
    alpha, polish = 1.0, 0
    for number in range(1, max_iterations + 1):
        factors = _factor(h, jacobian)
        if factors is None:
            break
        step = -dgetrs(*factors, h)[0]
        length = float(np.linalg.norm(step))
        if not np.isfinite(length):
            break
        alpha = min(1.0, 2.0 * alpha, max_step / max(float(np.max(np.abs(step))), 1e-300))
        accepted = None
        while alpha > 1e-4:
            trial = y + alpha * step
            h_trial, _ = function(trial, False)
            if np.all(np.isfinite(h_trial)):
                simplified = float(np.linalg.norm(dgetrs(*factors, h_trial)[0]))
                if simplified <= (1.0 - 0.5 * alpha) * length or length < 1e-12 * (1 + float(np.linalg.norm(y))):
                    accepted = trial
                    break
            alpha *= 0.5
        small = length <= 10 * tolerance * (1.0 + float(np.linalg.norm(y)))
        if accepted is None:
            if small and float(np.max(np.abs(h))) <= tolerance:  # already at round-off: nothing left to gain
                return Root(y=y, residual=h, jacobian=jacobian, converged=True, history=tuple(history))
            break
        y = accepted
        h, jacobian = function(y, True)
        iteration = Iteration(number=number, residual=float(np.max(np.abs(h))), step=length, damping=alpha)
        history.append(iteration)
        if watch is not None:
            watch(iteration)
        if alpha == 1.0 and iteration.residual <= tolerance:
            polish += 1
            if small or polish >= 3:
                return Root(y=y, residual=h, jacobian=jacobian, converged=True, history=tuple(history))
    return Root(y=y, residual=h, jacobian=jacobian, converged=False, history=tuple(history))


def _factor(h: Vector, jacobian: Matrix) -> tuple[Matrix, Vector] | None:
    """LAPACK's LU factors and pivots; None where anything is not finite or the matrix is singular."""
    if not (np.all(np.isfinite(h)) and np.all(np.isfinite(jacobian))):
        return None
    lu, pivots, info = dgetrf(jacobian)
    return (lu, pivots) if info == 0 else None
