"""Nodes of a curve, enough of them for cubic Hermite interpolation of values and rates within a tolerance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from perilune.core import Matrix, Vector


def hermite_nodes(
    evaluate: Callable[[Vector], tuple[Matrix, Matrix]],
    duration: float,
    tolerance: Vector,
    limit: int = 6401,
    shortest: float = 0.0,
    together: Callable[[Matrix, Matrix], Vector] | None = None,
) -> tuple[Vector, Matrix, Matrix]:
    """Return nodes on [0, duration] where cubic Hermite interpolation meets a tolerance at every mid-point, and values.

    Parameters
    ----------
    evaluate
        Values and rates, each (n, k), at times (n,).
    duration
        Length [s].
    tolerance
        Largest error of each of the k components.
    limit
        Most nodes; reached only by curves with a kink.
    shortest
        Width of pieces that are not halved any more [s]: about a jump there would be no end to it.
    together
        Joint measure of the errors of all components, from errors and rates (n, k) at mid-points, (n,): at most 1.

    Returns
    -------
    tuple
        The nodes (n,), values and rates there (n, k).
    """
    time = np.linspace(0.0, duration, 101)
    first = time, *evaluate(time)
    found, count = [first], len(time)
    left, right = tuple(part[:-1] for part in first), tuple(part[1:] for part in first)
    while count < limit:
        width = right[0] - left[0]
        middle = 0.5 * (right[0] + left[0])
        exact, slopes = evaluate(middle)
        interpolated = 0.5 * (left[1] + right[1]) + 0.125 * width[:, None] * (left[2] - right[2])
        missed = (np.abs(interpolated - exact) / tolerance).max(axis=1)
        if together is not None:
            missed = np.maximum(missed, together(interpolated - exact, slopes))
        bad = (missed > 1.0) & (width > shortest)
        if not bad.any():
            break
        # Intervals within the tolerance stay so: only the halves of the others are checked again.
        new = middle[bad], exact[bad], slopes[bad]
        left = tuple(np.concatenate([a[bad], b]) for a, b in zip(left, new, strict=True))
        right = tuple(np.concatenate([b, a[bad]]) for a, b in zip(right, new, strict=True))
        found.append(new)
        count += len(new[0])
    time, values, rates = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.argsort(time, kind="stable")
    return time[order], values[order], rates[order]
