"""Dense output of DOP853: one arc as a function of time, of order 7, step by step.

The stages of all steps are computed at once from their starts, so that the stepping loop has nothing to
store but the starts; the same text serves both backends.

Source: Hairer, Norsett, Wanner, *Solving ODEs I*, section II.6; coefficients in `tableau`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from perilune.core import Matrix, Stack, Vector
from perilune.kernels.flight import tableau
from perilune.kernels.flight.records import Arcs

Rates = Callable[[Matrix, Vector], Matrix]

_MOMENT, _TURNED = 1e-12, 1e-3  # of a step, and of a rate


def _dense_rows(rows: tuple[dict[int, float], ...]) -> Matrix:
    result = np.zeros((len(rows), tableau.DENSE_STAGES))
    for i, row in enumerate(rows):
        result[i, list(row)] = list(row.values())
    return result


@cache
def _tableau_arrays() -> tuple[Matrix, Vector, Matrix]:
    return _dense_rows(tableau.A), _dense_rows((tableau.B,))[0], _dense_rows(tableau.D)


@dataclass(frozen=True, kw_only=True)
class DenseArc:
    """An arc that can be called.

    Attributes
    ----------
    t
        Times of the nodes, (nodes,): the ends of the steps, events among them.
    z
        States there, (nodes, nz); at an event with a jump, the state after it.
    mode
        Mode of each step, (nodes - 1,).
    end
        How and where the flight ended.
    """

    t: Vector
    z: Matrix
    mode: Vector
    end: Arcs
    _pieces: Stack  # (8, steps, nz): start, and the seven terms of the interpolant
    _lengths: Vector

    def __call__(self, t: ArrayLike, count: int | None = None) -> Matrix:
        """Return z, or its first entries, at times, (nz,) for a number and (n, nz) for (n,).

        Outer pieces go on beyond the ends.
        """
        times = np.atleast_1d(np.asarray(t, dtype=float))
        if not len(self._lengths):
            values = np.repeat(self.z[:1, :count], len(times), axis=0)
        else:
            sign = 1.0 if self.t[-1] >= self.t[0] else -1.0
            i = np.clip(np.searchsorted(sign * self.t, sign * times, side="right") - 1, 0, len(self._lengths) - 1)
            lengths = self._lengths[i]  # of an arc of no length, 0
            s = np.divide(times - self.t[i], lengths, out=np.zeros(len(times)), where=lengths != 0)[:, None]
            pieces = self._pieces[:, :, :count]
            values = np.zeros((len(times), pieces.shape[2]))
            for k in range(7, 0, -1):
                values = (values + pieces[k][i]) * (s if k % 2 else 1.0 - s)
            values += pieces[0][i]
        return values if np.ndim(t) else values[0]


def _inside(slopes: Matrix, start: Matrix, after: Matrix, mode: Vector, rates: Rates) -> Matrix:
    """Return slopes at the ends of steps, the last of them a moment before where it is another there.

    Where what points a control vanishes as the arc ends, rounding may turn it.
    """
    if not len(slopes):
        return slopes
    near = rates(after[-1:] - _MOMENT * (after[-1:] - start[-1:]), mode[-1:])
    turned = np.abs(near - slopes[-1:]) > _TURNED * (np.abs(near) + np.abs(slopes[-1:]))
    return np.vstack([slopes[:-1], near]) if turned.any() else slopes


def dense_arc(end: Arcs, nodes: Matrix, rates: Rates) -> DenseArc:
    """Build the interpolant.

    Parameters
    ----------
    end
        The flight, of one lane.
    nodes
        Start of each step taken: time, length, mode, z; (steps, 3 + nz).
    rates
        (points (n, nz), modes (n,)) -> z' (n, nz).
    """
    t, h, mode, start = nodes[:, 0], nodes[:, 1][:, None], np.ascontiguousarray(nodes[:, 2]), nodes[:, 3:]
    slopes = np.zeros((tableau.DENSE_STAGES, *start.shape))
    weights, final, interpolant = _tableau_arrays()
    flat = slopes.reshape(tableau.DENSE_STAGES, -1)
    slopes[0] = rates(start, mode)
    for stage in range(1, tableau.STAGES):
        slopes[stage] = rates(start + h * (weights[stage] @ flat).reshape(start.shape), mode)
    slopes[11] = _inside(slopes[11], start, start + h * (weights[11] @ flat).reshape(start.shape), mode, rates)
    after = start + h * (final @ flat).reshape(start.shape)
    slopes[12] = _inside(rates(after, mode), start, after, mode, rates)
    for stage in range(13, tableau.DENSE_STAGES):
        slopes[stage] = rates(start + h * (weights[stage] @ flat).reshape(start.shape), mode)
    change = after - start
    low = [start, change, h * slopes[0] - change, 2 * change - h * (slopes[0] + slopes[12])]
    high = h * np.tensordot(interpolant, slopes, 1)
    return DenseArc(
        t=np.append(t, end.time[0]),
        z=np.vstack([start, end.z]),
        mode=mode,
        end=end,
        _pieces=np.concatenate([np.array(low), high]),
        # An event at the very end leaves a step without length, which is asked for its start only.
        _lengths=np.where(h[:, 0] == 0.0, 1.0, h[:, 0]),
    )
