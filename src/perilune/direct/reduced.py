"""One step of Newton's method in the space that the dynamics leave.

Of the unknowns the first m, the states, are determined by the first m equations, the dynamics: segment after segment,
as their square part B is lower block triangular. With the other unknowns u and equations,

    dx = p + T du,   T = -B^-1 N,   p = -B^-1 c,

and the conditions of a minimum in du are a small dense system (Nocedal, Wright 2006, section 16.2), whose inertia tells
whether the step goes down.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import get_lapack_funcs

from perilune.words.types import Matrix, Vector

_getrf, _getrs, _sytrf, _sytrs = get_lapack_funcs(("getrf", "getrs", "sytrf", "sytrs"))


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


class Reduced:
    """The equations A dw = -c at a point, solved for the states, which have these sizes."""

    def __init__(self, A: Matrix, c: Vector, sizes: Vector, blocks: Sequence[slice]) -> None:
        m = blocks[-1].stop
        self.chain = Chain(A[:m, :m], sizes, blocks)
        self.A, self.m = A, m
        found = self.chain.solved(np.column_stack([A[:m, m:], c[:m]]))
        self.T, self.p = -found[:, :-1], -found[:, -1]
        self.rest = A[m:, :m] @ self.T + A[m:, m:]
        self.c = c[m:] + A[m:, :m] @ self.p

    def step(self, H: Matrix, right: Matrix) -> tuple[Matrix, Matrix] | None:
        """Two solutions (dw, y) of H dw + A' y = -right, side by side: of A dw = -c, and of A dw = 0.

        None if H is that of no minimum along A dw = 0.
        """
        m, T, (rows, q) = self.m, self.T, self.rest.shape
        HZ = H[:, :m] @ T + H[:, m:]
        small = np.zeros((q + rows, q + rows))
        small[:q, :q] = T.T @ HZ[:m] + HZ[m:]
        small[:q, q:] = self.rest.T
        factor, places, failed = _sytrf(small)
        if failed or negative(factor, places) != rows:
            return None
        wanted = np.zeros((q + rows, 2))
        wanted[:q] = T.T @ right[:m] + right[m:]
        wanted[:q, 0] += self.p @ HZ[:m]
        wanted[q:, 0] = self.c
        found = _sytrs(factor, places, -wanted)[0]
        dw = np.empty_like(right)
        dw[m:] = found[:q]
        dw[:m] = T @ dw[m:]
        dw[:m, 0] += self.p
        y = np.empty((m + rows, 2))
        y[m:] = found[q:]
        y[:m] = self.chain.transposed(-(right[:m] + H[:m] @ dw + self.A[m:, :m].T @ y[m:]))
        return dw, y


def negative(factor: Matrix, places: Vector) -> int:
    """Negative eigenvalues of a symmetric matrix from its factors: two rows that were pivoted together have one."""
    alone = places > 0
    return int((~alone).sum()) // 2 + int((factor.diagonal()[alone] < 0).sum())
