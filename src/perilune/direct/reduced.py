"""One step of Newton's method in the space that the dynamics leave.

Of the unknowns the first m, the states, are determined by the first m equations, the dynamics: block after block, as
their square part B is lower block triangular. With the other unknowns u,

    dw = P + Z du,   Z = (-B^-1 N, 1),   P = (-B^-1 c, 0),

and the conditions of a minimum in du are a small dense system (Nocedal, Wright 2006, section 16.2), whose inertia tells
whether the step goes down.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import get_lapack_funcs

from perilune.words.types import Matrix, Vector

_getrf, _getrs, _sytrf, _sytrs = get_lapack_funcs(("getrf", "getrs", "sytrf", "sytrs"))

# The first addition to H where it is that of no minimum, by how much the next ones are larger, and how many there are.
LEAST, STEEPER, LARGER = 1e-4, 8.0, 12


class Chain:
    """The factors of a lower block triangular matrix, whose rows and columns have these sizes.

    Pivots are chosen between rows relative to what they are about: a state in absurd units does not spoil the others.

    Raises
    ------
    ArithmeticError
        If a block is singular.
    """

    def __init__(self, B: Matrix, sizes: Vector, blocks: Sequence[slice]) -> None:
        self.B, self.sizes, self.blocks = B * (sizes / sizes[:, None]), sizes[:, None], blocks
        self.factors = [self._factored(self.B[b, b]) for b in blocks]

    @staticmethod
    def _factored(block: Matrix) -> tuple[Any, Any]:
        lu, pivots, failed = _getrf(block)
        if failed:
            raise ArithmeticError("a segment does not determine its states")
        return lu, pivots

    def solved(self, right: Matrix) -> Matrix:
        """B^-1 right."""
        right = right / self.sizes
        found = np.empty_like(right, order="F")
        for b, (lu, pivots) in zip(self.blocks, self.factors, strict=True):
            here = right[b] - self.B[b, : b.start] @ found[: b.start] if b.start else right[b]
            found[b] = _getrs(lu, pivots, here)[0]
        return found * self.sizes

    def transposed(self, right: Matrix) -> Matrix:
        """B^-T right."""
        right = right * self.sizes
        found = np.empty_like(right, order="F")
        for b, (lu, pivots) in zip(reversed(self.blocks), reversed(self.factors), strict=True):
            here = right[b] - self.B[b.stop :, b].T @ found[b.stop :] if b.stop < len(found) else right[b]
            found[b] = _getrs(lu, pivots, here, trans=1)[0]
        return found / self.sizes


class Weighed(NamedTuple):
    """What is added to the second derivatives H: weights of the unknowns themselves, and of the ranges."""

    unknowns: Vector
    ranges: Vector


class Reduced:
    """The equations at a point, solved for the states.

    Parameters
    ----------
    slopes
        Of all equations, those of the dynamics first, and then of the ranges, shape (rows, n).
    c
        Values of all equations.
    sizes, blocks
        Of the states, and of B.
    """

    def __init__(self, slopes: Matrix, c: Vector, sizes: Vector, blocks: Sequence[slice]) -> None:
        m, n = blocks[-1].stop, slopes.shape[1]
        self.chain, self.others, self.m, self.rows = Chain(slopes[:m, :m], sizes, blocks), slopes[m:], m, len(c) - m
        right = np.empty((m, n - m + 1), order="F")
        right[:, :-1], right[:, -1] = slopes[:m, m:], c[:m]
        both = np.zeros((n, n - m + 1))  # Z and P
        np.negative(self.chain.solved(right), out=both[:m])
        both[m:].ravel()[:: n - m + 2] = 1.0
        self.both, self.Z, self.P = both, both[:, :-1], both[:, -1]
        of_others = self.others @ both
        self.rest, self.c = of_others[: self.rows, :-1], c[m:] + of_others[: self.rows, -1]
        self.ranged = of_others[self.rows :]

    def step(self, H: Any, weighed: Weighed, right: Matrix) -> tuple[Matrix, Matrix, Matrix] | None:
        """Two steps side by side, one for A dw = -c and one for A dw = 0, each with a column of `right`.

        Parameters
        ----------
        H
            Second derivatives, or None for none.
        weighed
            What is added to them; more is added where H is that of no minimum along A dw = 0.
        right
            Slopes, shape (n, 2).

        Returns
        -------
        tuple
            The changes of the unknowns and of the ranges' values, and the multipliers of the equations; None where
            all that is added is not enough.
        """
        m, rows, q, both = self.m, self.rows, self.Z.shape[1], self.both
        curved = weighed.unknowns[:, None] * both
        if H is not None:
            curved += H @ both
        G = self.Z.T @ curved
        if len(weighed.ranges):
            G += (self.ranged[:, :-1].T * weighed.ranges) @ self.ranged
        small, wanted = np.zeros((q + rows, q + rows)), np.zeros((q + rows, 2))
        small[:q, :q], small[:q, q:] = G[:, :-1], self.rest.T
        wanted[:q], wanted[q:, 0] = self.Z.T @ right, self.c
        wanted[:q, 0] += G[:, -1]
        more, larger = 0.0, LEAST
        while True:
            factor, places, failed = _sytrf(small)
            if not failed and negative(factor, places) == rows:
                break
            if larger > LEAST * STEEPER**LARGER:
                return None
            added = larger * (self.Z.T @ both)
            small[:q, :q] += added[:, :-1]
            wanted[:q, 0] += added[:, -1]
            more, larger = more + larger, larger * STEEPER
        found = _sytrs(factor, places, -wanted)[0]
        du, y_rest = found[:q], found[q:]
        dw, ds = self.Z @ du, self.ranged[:, :-1] @ du
        dw[:, 0] += self.P
        ds[:, 0] += self.ranged[:, -1]
        slope = right + (weighed.unknowns + more)[:, None] * dw
        if H is not None:
            slope += H @ dw
        slope += self.others.T @ np.concatenate([y_rest, weighed.ranges[:, None] * ds])
        y = np.empty((m + rows, 2))
        y[m:] = y_rest
        y[:m] = self.chain.transposed(-slope[:m])
        return dw, ds, y


def negative(factor: Matrix, places: Vector) -> int:
    """Negative eigenvalues of a symmetric matrix from its factors: two rows that were pivoted together have one."""
    alone = places > 0
    return int((~alone).sum()) // 2 + int((factor.diagonal()[alone] < 0).sum())
