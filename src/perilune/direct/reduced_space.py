"""Newton step in the null space of the dynamics.

Of the unknowns the first m, the states, are determined by the first m equations, the dynamics: block after block, as
their square part B is lower block triangular. The next equations hold the lengths of directions at one; each gives the
largest component of its direction from the others. With the unknowns u that are left,

    dw = P + Z du,   Z = (-B^-1 N U, U),   P = (-B^-1 (c + N V), V),

where N are the slopes of the dynamics in all but the states, and U du + V is what the lengths leave of these. Then the
conditions of a minimum in du are a small dense system (Nocedal, Wright 2006, section 16.2), whose inertia shows whether
the step goes down.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import get_lapack_funcs

from perilune.core import Matrix, Vector

_getrf, _getrs, _sytrf, _sytrs = get_lapack_funcs(("getrf", "getrs", "sytrf", "sytrs"))

# A component of a direction that is as small is none to divide by.
SHORT = 1e-6
# The first addition to H where it is that of no minimum, by how much the next ones are larger, and how many there are.
LEAST, STEEPER, LARGER = 1e-4, 8.0, 12


class BlockFactors:
    """The factors of a lower block triangular matrix, whose rows and columns have these sizes.

    Pivots are chosen between rows relative to what they are about: a state in absurd units does not spoil the others.

    Raises
    ------
    ArithmeticError
        If a block is singular.
    """

    def __init__(self, B: Matrix, sizes: Vector, blocks: Sequence[slice]) -> None:
        self.B, self.sizes, self.blocks = B * sizes, sizes[:, None], blocks
        self.B /= self.sizes
        self.factors = [self._factored(self.B[b, b]) for b in blocks]

    @staticmethod
    def _factored(block: Matrix) -> tuple[Any, Any]:
        lu, pivots, failed = _getrf(block)
        if failed:
            raise ArithmeticError("a segment does not determine its states")
        return lu, pivots

    def solved(self, right: Matrix) -> Matrix:
        """Return B^-1 right."""
        found = np.divide(right, self.sizes, order="F")
        for b, (lu, pivots) in zip(self.blocks, self.factors, strict=True):
            here = found[b]
            if b.start:
                here -= self.B[b, : b.start] @ found[: b.start]
            found[b] = _getrs(lu, pivots, here)[0]
        found *= self.sizes
        return found

    def transposed(self, right: Matrix) -> Matrix:
        """Return B^-T right."""
        found = np.multiply(right, self.sizes, order="F")
        for b, (lu, pivots) in zip(reversed(self.blocks), reversed(self.factors), strict=True):
            here = found[b]
            if b.stop < len(found):
                here -= self.B[b.stop :, b].T @ found[b.stop :]
            found[b] = _getrs(lu, pivots, here, trans=1)[0]
        found /= self.sizes
        return found


class LengthEquations:
    """Equations, one for each direction, in only its components: the largest of these from the others.

    Parameters
    ----------
    slopes
        In the components, shape (directions, components).
    values
        Of the equations.
    columns
        Which unknowns the components are, of those that are no states.

    Raises
    ------
    ArithmeticError
        If a direction has no length.
    """

    def __init__(self, slopes: Matrix, values: Vector, columns: Matrix) -> None:
        rows = np.arange(len(slopes))
        largest = np.abs(slopes).argmax(axis=1)
        self.of, self.slope = columns[rows, largest], slopes[rows, largest]
        if not np.abs(self.slope).min(initial=1.0) > SHORT:
            raise ArithmeticError("a direction has no length")
        self.columns, self.parts, self.rest = columns, -slopes / self.slope[:, None], -values / self.slope


class AddedWeights(NamedTuple):
    """Weights added to the second derivatives H: of the unknowns themselves, and of the ranges."""

    unknowns: Vector
    ranges: Vector


class ReducedEquations:
    """The equations at a point, solved for the states.

    Parameters
    ----------
    slopes
        Of all equations, those of the dynamics first, then those of lengths, and then of the ranges, (rows, n).
    c
        Values of all equations.
    sizes, blocks
        Of the states, and of B.
    directions
        For each length the unknowns in it; one array for all directions of as many components.
    """

    def __init__(
        self, slopes: Matrix, c: Vector, sizes: Vector, blocks: Sequence[slice], directions: Sequence[Matrix] = ()
    ) -> None:
        m, n = blocks[-1].stop, slopes.shape[1]
        self.chain, self.slopes, self.m = BlockFactors(slopes[:m, :m], sizes, blocks), slopes, m
        self.lengths = list[LengthEquations]()
        at = m
        for columns in directions:
            rows = slice(at, at + len(columns))
            at = rows.stop
            self.lengths.append(
                LengthEquations(slopes[np.arange(rows.start, at)[:, None], columns], c[rows], columns - m)
            )
        left = self._left(n - m)
        right = slopes[:m, m:] @ left
        right[:, -1] += c[:m]
        self.both = np.empty((n, left.shape[1]))  # Z and P
        np.negative(self.chain.solved(right), out=self.both[:m])
        self.both[m:] = left
        self.Z, self.P = self.both[:, :-1], self.both[:, -1]
        self.others, self.rows = slopes[at:], len(c) - at
        of_others = self.others @ self.both
        self.rest, self.c = of_others[: self.rows, :-1], c[at:] + of_others[: self.rows, -1]
        self.ranged = of_others[self.rows :]

    def _left(self, count: int) -> Matrix:
        """Return U and V side by side: what the lengths leave of `count` unknowns."""
        free = np.ones(count, dtype=bool)
        for lengths in self.lengths:
            free[lengths.of] = False
        place = np.cumsum(free) - 1
        found = np.zeros((count, int(free.sum()) + 1))
        found[free, place[free]] = 1.0
        for lengths in self.lengths:
            others = lengths.columns != lengths.of[:, None]
            found[np.repeat(lengths.of, others.sum(axis=1)), place[lengths.columns[others]]] = lengths.parts[others]
            found[lengths.of, -1] = lengths.rest
        return found

    def step(self, H: Any, weighed: AddedWeights, right: Matrix) -> tuple[Matrix, Matrix, Matrix] | None:
        """Return two steps side by side, one for A dw = -c and one for A dw = 0, each with a column of `right`.

        Parameters
        ----------
        H
            Second derivatives, or None for none.
        weighed
            What is added to them; more is added where H has no minimum along A dw = 0.
        right
            Slopes, shape (n, 2).

        Returns
        -------
        tuple
            The changes of the unknowns and of the ranges' values, and the multipliers of the equations; None where
            all that is added is not enough.
        """
        rows, q, both = self.rows, self.Z.shape[1], self.both
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
            if not failed and count_negative_eigenvalues(factor, places) == rows:
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
        return dw, ds, np.concatenate([*self._multipliers(slope), y_rest])

    def _multipliers(self, slope: Matrix) -> Iterator[Matrix]:
        """Yield the multipliers of the dynamics and of lengths, for what is not balanced yet."""
        y = self.chain.transposed(-slope[: self.m])
        yield y
        for lengths in self.lengths:
            of = self.m + lengths.of
            yield -(slope[of] + self.slopes[: self.m, of].T @ y) / lengths.slope[:, None]


def count_negative_eigenvalues(factor: Matrix, places: Vector) -> int:
    """Count negative eigenvalues of a symmetric matrix from its factors: two rows pivoted together have one.

    Parameters
    ----------
    factor
        Triangular factor with the pivots on its diagonal, (n, n).
    places
        Pivots as LAPACK's ``sytrf`` returns them, (n,): not positive for two rows pivoted together.
    """
    alone = places > 0
    return int((~alone).sum()) // 2 + int((factor.diagonal()[alone] < 0).sum())
