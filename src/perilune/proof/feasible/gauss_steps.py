"""Gauss's collocation of order 32, in steps of its own choice: the integrator of the proof, in plain NumPy.

On a step from t with h, at the 16 Gauss points t + c_j h and with Butcher's matrix a_jk, the states

    X_j = x + h sum_k a_jk f(t + c_k h, X_k)

are a fixed point, found by iteration from the rates of the step before, continued. All points are evaluated at once, as
columns. Rates are taken for resolved where the last two Legendre coefficients of h f, whose integral the end of the
step does not even contain, are below a tolerance; and so is what a jump next to an end of the step, where the
polynomial of the rates is not f, would change.
Source: Hairer, Lubich, Wanner, *Geometric Numerical Integration* (2006), II.1.3 and VIII.6.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

from perilune.core import Matrix, Vector

COUNT = 16  # points of a step
TOLERANCE = (
    2e-12  # of the last coefficients, in the scales of the states; ends of the examples are off by 3e-12 at most
)
MOST_PASSED = 2 * COUNT  # times of the grid in a step: nowhere is a control looked at more rarely than its table
_SETTLED = 1e-13  # change from one iteration to the next, in the scales, or what states round
_ROUNDS = 4 * np.finfo(float).eps
_ROUGHLY = 1e-5  # of the scales: so near the fixed point coefficients show whether the step is too long
_ITERATIONS = 30
_SHORTEST = 1e-13  # of the whole interval: a step
_ORDERS = COUNT, 4  # by which the last coefficients fall with the step; and after a failure, as where rates jump
_SHORTER, _LONGER = (0.1, 0.7), 2.0  # a step than the last one: after a failure, and at most


def gauss_rule(count: int) -> tuple[Vector, Vector, Matrix, Matrix]:
    """Return points, weights and integrals up to each point on [0, 1], and Legendre coefficients by values.

    The last two, (count, count), take values at the points, a row: Butcher's matrix is transposed.
    """
    node, weight = leggauss(count)
    values, degree = legvander(node, count), np.arange(count)
    coefficients = values[:, :count] * weight[:, None] * (degree + 0.5)
    integrals = np.column_stack([node + 1, (values[:, 2:] - values[:, :-2]) / (2 * degree[1:] + 1)])
    return 0.5 * (1 + node), 0.5 * weight, 0.5 * coefficients @ integrals.T, coefficients


POINT, WEIGHT, UP_TO_POINT, COEFFICIENTS = gauss_rule(COUNT)
_AT = np.array([0.0, *POINT, 1.0])  # of a step: where rates are computed
_LAST = COEFFICIENTS[:, -2:]
_TO_ENDS = COEFFICIENTS @ legvander(np.array([-1.0, 1.0]), COUNT - 1).T
_UP_TO = np.column_stack([np.zeros(COUNT), UP_TO_POINT, WEIGHT])
_POWERS = np.arange(10)  # that predict the next step: higher ones would grow too much
_FITTED = np.linalg.pinv((2 * POINT - 1)[:, None] ** _POWERS).T


def integrate_by_gauss(
    equations: Callable[[Vector], Callable[[Matrix], Any]], span: tuple[float, float], start: Vector, scale: Vector,
    grid: Vector,
) -> tuple[Vector, Matrix] | None:  # fmt: skip
    """Integrate smooth equations over an interval.

    Parameters
    ----------
    equations
        ``equations(times)`` returns the rates at fixed times, shape (k,): a function of the states there, (n, k).
    span
        Begin and end.
    start, scale
        Initial state and sizes of the states, (n,).
    grid
        Times at which the rates may bend, in order; a step ends at one, and passes no more than `MOST_PASSED`.

    Returns
    -------
    Vector, Matrix
        Times in the order flown, (k,), the last one the end, and the states there, (n, k); None where steps become
        too short.
    """
    (t, end), x = span, start
    nodes = [*grid[(grid > t) & (grid < end)].tolist(), end]
    h = longest = end - t
    before: tuple[Any, float] | None = None
    times, states, passed, failed = list[Vector](), list[Matrix](), 0, False
    while t < end:
        # To a node, as far as one is in reach: only there may rates bend.
        reached = min(bisect_right(nodes, t + h * (1 + 1e-9)), passed + MOST_PASSED, len(nodes))
        to = nodes[reached - 1] if reached > passed else t + h
        if not (h := to - t) > _SHORTEST * longest:
            return None
        rates_at = equations(t + h * _AT)
        found, factor = _collocate(rates_at, x, h, scale, before, _ORDERS[failed])
        if found is not None:
            X, rates = found
            times.append(t + h * POINT)
            states.append(X[:, :-1])
            x = X[:, -1]
            t, passed, before = to, reached, (rates, h)
        h, failed = h * factor, found is None
    return np.append(np.concatenate(times), end), np.column_stack([*states, x])


def _collocate(
    rates_at: Callable[[Matrix], Any], x: Vector, h: float, scale: Vector, before: tuple[Any, float] | None, order: int
) -> tuple[tuple[Matrix, Any] | None, float]:
    """Return states at the points of a step and its end, and rates; None where it is too long. And a factor on h."""
    rates = rates_at(np.repeat(x[:, None], COUNT + 2, axis=1))[:, 1:-1] if before is None else _continued(*before, h)
    unit, settled = scale[:, None], max(_SETTLED, _ROUNDS * float((np.abs(x) / scale).max(initial=0.0)))
    at, change = x[:, None] + h * (rates @ _UP_TO), np.inf
    for iteration in range(_ITERATIONS):
        every = rates_at(at)
        rates = every[:, 1:-1]
        nearer = x[:, None] + h * (rates @ _UP_TO)
        was, change, at = change, float((np.abs(nearer - at) / unit).max(initial=0.0)), nearer
        if not change < np.inf or (iteration > 5 and change > 0.9 * was > 10 * settled):
            break
        if iteration and change < _ROUGHLY:
            beyond = POINT[0] * (every[:, [0, -1]] - rates @ _TO_ENDS)
            left = float((np.abs(h * np.hstack([rates @ _LAST, beyond])) / unit).max(initial=1e-300))
            factor = 0.95 * (TOLERANCE / left) ** (1 / order)
            if left > (10 * TOLERANCE if change > settled else TOLERANCE):
                return None, min(max(factor, _SHORTER[0]), _SHORTER[1])
            if change <= settled:
                return (at[:, 1:], rates), min(factor, _LONGER if iteration < _ITERATIONS // 3 else 1.0)
    return None, 0.3


def _continued(rates: Any, length: float, h: float) -> Any:
    """Return the polynomial of rates over a step that was, at the points of the one of length h behind it."""
    return rates @ _FITTED @ ((1 + 2 * POINT * (h / length)) ** _POWERS[:, None])
