"""Complex-step derivatives of the numpy text of the physics.

The derivative of a real-analytic f is Im f(x + ih)/h, exact to rounding for tiny h (Squire and Trapp 1998), so that
nothing symbolic is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core.arrays import Vector
from perilune.core.maths import NUMERIC

STEP = 1e-40  # of the complex step: its square vanishes against 1


def _complex_step_atan2(y: Any, x: Any) -> Any:
    y, x = np.asarray(y), np.asarray(x)
    turn = (y.imag * x.real - y.real * x.imag) / (x.real**2 + y.real**2)
    return np.arctan2(y.real, x.real) + 1j * turn


def _complex_step_fabs(x: Any) -> Any:
    return np.where(np.real(x) < 0, -np.asarray(x), x)


# The functions that numpy has for real numbers only, or not as analytic functions, replaced by ones that
# carry the step.
COMPLEX = SimpleNamespace(**{**vars(NUMERIC), "atan2": _complex_step_atan2, "fabs": _complex_step_fabs})
COMPLEX.fmin = lambda a, b: np.where(np.real(a) <= np.real(b), a, b)
COMPLEX.fmax = lambda a, b: np.where(np.real(a) >= np.real(b), a, b)


def stack_broadcast(values: Sequence[Any], shape: tuple[int, ...], dtype: Any = complex) -> Any:
    """Stack the values of a user's function into one array (len(values), *shape); constants are broadcast.

    Parameters
    ----------
    values
        One value or array for each component.
    shape
        Shape of each.
    dtype
        Type of the result.
    """
    out = np.empty((len(values), *shape), dtype=dtype)
    for i, value in enumerate(values):
        out[i] = value
    return out


def complex_step_jacobian(function: Callable[[Any], Any], z: Any, scale: Vector) -> Any:
    """Compute first derivatives by complex step with respect to z/scale, at many points at once.

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
