"""Damped Newton for shooting: Cho et al. 2015 (23), (24) with alpha chosen by the natural monotonicity test.

The step is dy = -J^-1 h. Damping alpha is accepted when the *simplified* correction |J^-1 h(y + alpha dy)| shrinks.
That test does not change when rows of h are scaled, so metres and radians may stand side by side (Deuflhard, Newton
Methods for Nonlinear Problems, 2004, section 3.3).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from perilune.words.types import Matrix, Vector
from perilune.words.watch import Iteration, Watch

Residual = Callable[[Vector], tuple[Vector, Matrix]]  # y -> (h, J); NaN where undefined

_ASTRAY = 1e200  # squares beyond this are of a lost iterate; a NaN compares as lost too


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
        Residual and Jacobian.
    y
        Start, shape (n,), canonical units.
    tolerance
        On the largest component of the residual. The last correction must besides be undamped and below 1e-7, so that
        the error, which Newton squares, is at round-off.
    max_step
        Largest component of one step; keeps a far start from leaving where arcs can be flown.
    watch
        Called after each iteration.
    """
    history: list[Iteration] = []
    y = np.array(y, dtype=float)
    h, jacobian = function(y)
    alpha = 1.0
    for number in range(1, max_iterations + 1):
        inverse = _inverse(h, jacobian)
        if inverse is None:
            break
        step = -inverse @ h
        length = _length(step)
        if not length < _ASTRAY:
            break
        alpha = min(1.0, 2.0 * alpha, max_step / max(float(np.abs(step).max()), 1e-300))
        settled = length <= 1e-7 * (1.0 + _length(y))
        taken = _damp(function, y, step, inverse, alpha)
        if taken is None:
            # At round-off no step is an improvement: that is a root, if the residual says so.
            done = settled and float(np.abs(h).max()) <= tolerance
            return Root(y=y, residual=h, jacobian=jacobian, converged=done, history=tuple(history))
        y, h, jacobian, alpha = taken
        iteration = Iteration(number=number, residual=float(np.abs(h).max()), step=length, damping=alpha)
        history.append(iteration)
        if watch is not None:
            watch(iteration)
        if alpha == 1.0 and iteration.residual <= tolerance and settled:
            return Root(y=y, residual=h, jacobian=jacobian, converged=True, history=tuple(history))
    return Root(y=y, residual=h, jacobian=jacobian, converged=False, history=tuple(history))


def _damp(
    function: Residual, y: Vector, step: Vector, inverse: Matrix, alpha: float
) -> tuple[Vector, Vector, Matrix, float] | None:
    """(y, h, J, alpha) after the longest step that passes the natural monotonicity test; None where none does."""
    length, size = _length(step), _length(y)
    while alpha > 1e-4:
        trial = y + alpha * step
        h, jacobian = function(trial)
        if h @ h < _ASTRAY:
            simplified = _length(inverse @ h)
            if simplified <= (1.0 - 0.5 * alpha) * length or length < 1e-12 * (1 + size):
                return trial, h, jacobian, alpha
        alpha *= 0.5
    return None


def _length(v: Vector) -> float:
    return math.sqrt(v @ v)


def _inverse(h: Vector, jacobian: Matrix) -> Matrix | None:
    """J^-1, used for the step and again for each simplified correction; None where anything is lost or singular."""
    entries = jacobian.ravel()
    if not (h @ h < _ASTRAY and entries @ entries < _ASTRAY):
        return None
    try:
        return np.linalg.inv(jacobian)
    except np.linalg.LinAlgError:
        return None
