"""Numbers without the solver's tools: derivatives by complex steps.

The derivative of a real-analytic f is Im f(x + ih)/h, exact to rounding for tiny h (Squire and Trapp 1998),
so the numpy text of the physics is differentiated without a symbolic engine. Everything is computed in SI;
derivatives are taken with respect to *scaled* coordinates (a state divided by its canonical unit), which
makes matrices comparable.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.words.maths import NUMERIC
from perilune.words.types import Matrix, Vector

STEP = 1e-40  # of the complex step: its square vanishes against 1
DIFFERENCE = 1e-4  # of gradients, in canonical units: truncation 1e-8, rounding 1e-12


def _atan2(y: Any, x: Any) -> Any:
    y, x = np.asarray(y), np.asarray(x)
    turn = (y.imag * x.real - y.real * x.imag) / (x.real**2 + y.real**2)
    return np.arctan2(y.real, x.real) + 1j * turn


def _fabs(x: Any) -> Any:
    return np.where(np.real(x) < 0, -np.asarray(x), x)


# The functions that numpy has for real numbers only, or not as analytic functions, replaced by ones that
# carry the step.
COMPLEX = SimpleNamespace(**{**vars(NUMERIC), "atan2": _atan2, "fabs": _fabs})
COMPLEX.fmin = lambda a, b: np.where(np.real(a) <= np.real(b), a, b)
COMPLEX.fmax = lambda a, b: np.where(np.real(a) >= np.real(b), a, b)


def stacked(values: Sequence[Any], shape: tuple[int, ...], dtype: Any = complex) -> Any:
    """Values of a user's function as one array (len(values), *shape); constants are broadcast."""
    out = np.empty((len(values), *shape), dtype=dtype)
    for i, value in enumerate(values):
        out[i] = value
    return out


def jacobian(function: Callable[[Any], Any], z: Any, scale: Vector) -> Any:
    """First derivatives by complex step with respect to z/scale, at many points at once.

    Parameters
    ----------
    function
        Maps a complex array (d, ...) to (m, ...).
    z
        Points, shape (d, *shape).
    scale
        Size of the coordinates, shape (d,).

    Returns
    -------
    Array (m, d, *shape).
    """
    shape = np.shape(z)[1:]
    steps = (1j * STEP * np.diag(scale)).reshape(len(scale), len(scale), *(1,) * len(shape))
    return np.imag(function(z[:, None] + steps)) / STEP


def hessian(function: Callable[[Any], Any], z: Matrix, scale: Vector) -> Any:
    """Second derivatives of a scalar function: central differences of its complex-step gradient.

    Parameters
    ----------
    function
        Maps a complex array (d, d, 2d, N) to (d, 2d, N); the last axis counts the points.
    z
        Points, shape (d, N).
    scale
        Size of the coordinates, shape (d,).

    Returns
    -------
    Array (d, d, N), symmetric.
    """
    size = len(scale)
    moves = DIFFERENCE * np.hstack([np.diag(scale), -np.diag(scale)])
    gradient = jacobian(lambda w: function(w)[None], z[:, None, :] + moves[:, :, None], scale)[0]
    out = (gradient[:, :size] - gradient[:, size:]) / (2 * DIFFERENCE)
    return 0.5 * (out + out.transpose(1, 0, 2))


def telling(unit: Any, weight: Any) -> Any:
    """How many of its sizes a quantity has to change by to tell in J, where the flight hardly moves in it; at least 1.

    What stands still, or drifts by a billionth of its unit, says nothing of how far it could go: by its own size no
    slope would be seen in it. So it is judged by what changes J by all of itself, and by its unit at most.

    Parameters
    ----------
    unit
        Its canonical unit, in sizes: more than 1 only where the flight reaches less than a thousandth of that.
    weight
        By how much of J each size changes it.
    """
    return np.clip(1.0 / np.maximum(weight, 1e-300), 1.0, np.maximum(unit, 1.0))
