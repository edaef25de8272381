"""Numerical tools independent of the solver's: second derivatives, and the size of negligible numbers.

The numpy text of the physics is differentiated without a symbolic engine (`perilune.core.complex_step`). Everything is
computed in SI; derivatives are taken with respect to *scaled* coordinates (a state divided by its canonical unit),
which makes matrices comparable.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector, complex_step_jacobian

DIFFERENCE = 1e-4  # of gradients, in canonical units: truncation 1e-8, rounding 1e-12


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
    gradient = complex_step_jacobian(lambda w: function(w)[None], z[:, None, :] + moves[:, :, None], scale)[0]
    out = (gradient[:, :size] - gradient[:, size:]) / (2 * DIFFERENCE)
    return 0.5 * (out + out.transpose(1, 0, 2))


def significant_size(unit: Any, weight: Any) -> Any:
    """Return by how many of its sizes a quantity must change to show in J, where the flight hardly moves in it; >= 1.

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
