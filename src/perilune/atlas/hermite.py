"""Cubic Hermite interpolation in a box of any dimension, from values and derivatives at its corners.

At a corner stand 2^d *terms*: the derivative once by each parameter of a set, for every set; number b of them has the
bits of that set, so that 0 is the value itself and 2^i the slope along axis i. With all of them a tensor product of
cubics is matched, whose error is of the fourth order in the size of the box; without the mixed ones it would be of the
second.

Source: G. Birkhoff, M. H. Schultz, R. S. Varga, *Piecewise Hermite interpolation in one and two variables with
applications to partial differential equations*, Numer. Math. 11 (1968) 232-256.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.charts import Chart, Extremals, Holds
from perilune.core import Matrix, Vector
from perilune.kernels import Map, compile_map

_BESIDE = 1e-4  # of the range of a parameter: where its mixed derivatives are taken; errors are of its square


@lru_cache(maxsize=8)
def binary_digits(d: int) -> NDArray[np.int64]:
    """Return the bits of the numbers below 2^d, (2^d, d): the side of a corner, or the derivatives of a term."""
    digits = np.arange(2**d)[:, None] >> np.arange(d)[None] & 1
    digits.flags.writeable = False
    return digits


def hermite_weights(at: Matrix, size: Matrix) -> NDArray[np.float64]:
    """Compute the weights of the terms at points of boxes.

    Parameters
    ----------
    at
        Places in the boxes, 0 to 1 along each axis, (points, d).
    size
        Lengths of the boxes, (points, d) or (1, d), in the units in which the derivatives are.

    Returns
    -------
    ndarray, shape (points, corners, terms)
    """
    points, d = at.shape
    return _products(d)(at, size)[0].reshape(points, 2**d, 2**d)


@lru_cache(maxsize=8)
def _products(d: int) -> Map:
    """Compile the map from place and size to weights: products, over the axes, of those of a cubic."""
    at, size = ca.SX.sym("at", d), ca.SX.sym("size", d)
    t, s = at, 1.0 - at
    # Along one axis: value and slope at the low side, then at the high one.
    along = ca.horzcat(s**2 * (1 + 2 * t), size * t * s**2, t**2 * (1 + 2 * s), -size * s * t**2)
    digits, found = 2 * binary_digits(d)[:, None] + binary_digits(d)[None], ca.SX.ones(4**d, 1)
    for axis in range(d):
        found *= along[axis, digits[..., axis].ravel().tolist()].T
    return compile_map(ca.Function("weights", [at, size], [ca.cse(found)]))


def interpolated(terms: NDArray[np.float64], at: Matrix, size: Matrix) -> Matrix:
    """Interpolate at points of boxes, (points, k), from the terms at their corners, (points, corners, terms, k).

    Parameters
    ----------
    terms
        Terms at the corners of boxes, (points, corners, terms, k).
    at
        Places in the boxes, 0 to 1 along each axis, (points, d).
    size
        Lengths of the boxes, (points, d) or (1, d).
    """
    points, k = len(at), terms.shape[-1]
    flat = hermite_weights(at, size).reshape(points, 1, -1)
    return np.matmul(flat, terms.reshape(points, -1, k))[:, 0]


def interpolated_at(terms: Matrix, at: Vector, size: Vector) -> Vector:
    """Interpolate at one point of one box, (k,), from (corners * terms, k).

    Parameters
    ----------
    terms
        Terms at the corners of the box, (corners * terms, k).
    at
        Place in the box, 0 to 1 along each axis, (d,).
    size
        Lengths of the box, (d,).
    """
    return _products(len(at))(at[None], size[None])[0][0] @ terms


def scaled_third_derivatives(terms: NDArray[np.float64], size: Matrix) -> NDArray[np.float64]:
    """Compute the largest h^3 f''' of the edges of boxes along each axis, (boxes, d, k): zero for quadratics.

    For two values and two slopes on an edge it is 12 (f0 - f1) + 6 h (f0' + f1').

    Parameters
    ----------
    terms
        Terms at the corners of boxes, (boxes, corners, terms, k).
    size
        Lengths of the boxes, (boxes, d).
    """
    d = size.shape[1]
    found = np.empty((len(terms), d, terms.shape[-1]))
    for axis in range(d):
        low = np.nonzero(binary_digits(d)[:, axis] == 0)[0]
        high = low | 1 << axis
        jump = terms[:, low, 0] - terms[:, high, 0]
        slopes = terms[:, low, 1 << axis] + terms[:, high, 1 << axis]
        found[:, axis] = np.abs(12.0 * jump + 6.0 * size[:, axis, None, None] * slopes).max(axis=1)
    return found


def corner_terms(chart: Chart, found: Extremals, holds: Callable[[Matrix], Holds]) -> NDArray[np.float64]:
    """Return y and J of extremals with their terms, (lanes, 2^d, n + 1).

    Parameters
    ----------
    chart
        Chart of the extremals.
    found
        Extremals whose mixed derivatives are differences of slopes near them.
    holds
        Returns the parameters held in addition at values of the parameters, canonical, (lanes 2^(d-1), d).
    """
    lanes, d = found.values.shape
    n = found.y.shape[1]
    out = np.zeros((lanes, 2**d, n + 1))
    out[:, 0, :n], out[:, 0, n] = found.y, found.cost
    slopes = np.concatenate([found.slopes, found.cost_slopes[:, :, None]], axis=2)
    for i in range(d):
        out[:, 1 << i] = slopes[:, i]
    if d == 1:
        return out
    # Slopes at all points a little off along the axes but the first give every mixed derivative.
    beside, step = np.hstack([np.zeros((2 ** (d - 1), 1)), 2.0 * binary_digits(d - 1) - 1.0]), _BESIDE * chart.widths
    values = found.values[:, None] + step * beside
    y = found.y[:, None] + np.einsum("ki,lin->lkn", step * beside, found.slopes)
    values = values.reshape(-1, d)
    near = chart.at(values, y.reshape(-1, n), holds(values))
    slopes = np.concatenate([near.slopes, near.cost_slopes[:, :, None]], axis=2).reshape(lanes, len(beside), d, n + 1)
    for term in range(3, 2**d):
        axes = np.nonzero(binary_digits(d)[term])[0]
        if len(axes) > 1:
            first, others = axes[0], axes[1:]
            signs = beside[:, others].prod(axis=1) / len(beside) / step[others].prod()
            out[:, term] = np.einsum("k,lkn->ln", signs, slopes[:, :, first])
    return out
