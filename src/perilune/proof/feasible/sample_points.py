"""Sample points of the proof: inside every piece of every table.

Between two neighbouring nodes of any of its tables a solution is a handful of cubics. Four points inside such a piece
determine a cubic, and bound it all over the piece (Lebesgue constant below 6): what is right at all of them hides
nothing in between, however a file chooses its nodes. Gauss's points also integrate over the piece, with order 8.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector
from perilune.problem import Curve


def _collocation_rule(count: int) -> tuple[Vector, Vector, Matrix]:
    """Points and weights on [0, 1], and the integrals of the Lagrange polynomials up to each point (Butcher's a)."""
    node, weight = np.polynomial.legendre.leggauss(count)
    point, power = 0.5 * (1 + node), np.arange(count)
    moments = point[:, None] ** (power + 1) / (power + 1)
    return point, 0.5 * weight, moments @ np.linalg.inv(point[:, None] ** power)


POINTS, WEIGHTS, UP_TO = _collocation_rule(4)
ENDS = np.array([0.0, 1.0])
IN_HALVES = np.concatenate([0.5 * POINTS, 0.5 + 0.5 * POINTS])
BLOCK = 400  # pieces worked on at a time: their numbers stay in the processor's cache


def time_just_before(t: Any) -> Any:
    """Times at which a table still has the values from before a break at t."""
    return np.nextafter(t, -np.inf)


@dataclass(frozen=True)
class Pieces:
    """Intervals of time [s] in order, each shape (N,)."""

    left: Vector
    width: Vector

    @classmethod
    def between(cls, times: Iterable[Vector], duration: float) -> Pieces:
        """Return the pieces from 0 to the duration, cut at all of the times inside.

        Parameters
        ----------
        times
            Times at which to cut [s], arrays of any length; those outside the interval are ignored.
        duration
            End of the interval [s].
        """
        inside = np.concatenate([np.asarray(t) for t in times])
        edges = np.unique(np.append(inside[(inside > 0) & (inside < duration)], [0.0, duration]))
        return cls(edges[:-1], np.diff(edges))

    @classmethod
    def joined(cls, parts: Sequence[Pieces]) -> Pieces:
        """Several as one, in the order given."""
        return cls(np.concatenate([p.left for p in parts]), np.concatenate([p.width for p in parts]))

    def __len__(self) -> int:
        return len(self.left)

    def __getitem__(self, chosen: Vector | slice) -> Pieces:
        return Pieces(self.left[chosen], self.width[chosen])

    @property
    def halves(self) -> Pieces:
        """Twice as many, half as wide."""
        half = 0.5 * self.width
        return Pieces(np.column_stack([self.left, self.left + half]).ravel(), np.repeat(half, 2))

    def times(self, shares: Vector = POINTS) -> Matrix:
        """Times (N, len(shares)) at shares of each piece."""
        return self.left[:, None] + self.width[:, None] * shares

    def read(self, curve: Curve, shares: Vector = POINTS) -> Matrix:
        """Values (components, N, shares) of a table, at the ends of a piece its own sides of a break.

        `shares` has the shape (count,), or (N, count) where they differ.

        Parameters
        ----------
        curve
            Table of values over time [s].
        shares
            Fractions of each piece, 0 to 1.
        """
        i = np.minimum(np.maximum(curve.time.searchsorted(self.left, side="right") - 1, 0), len(curve.time) - 2)
        # The last cubic goes on where a table ends too early; that it does is another check's.
        h = (curve.time[i + 1] - curve.time[i])[:, None]
        s = ((self.left - curve.time[i])[:, None] + self.width[:, None] * shares) / h
        return polynomial(cubics(curve, i)[:, :, None], s)


@dataclass(frozen=True, kw_only=True)
class Slopes:
    """The equations of motion at `POINTS` of pieces, read off the tables; scaled, per second.

    Attributes
    ----------
    state, costate
        f, and -dL/dx (`allowed`), shape (n, N, 4); the costate's are empty where there is none.
    matrix
        df/dx, shape (N, 4, n, n).
    """

    state: Matrix
    costate: Matrix
    matrix: Matrix

    def __getitem__(self, chosen: Any) -> Slopes:
        return Slopes(state=self.state[:, chosen], costate=self.costate[:, chosen], matrix=self.matrix[chosen])

    def rows(self) -> Matrix:
        """Return all rates, (rows, N, 4)."""
        return np.concatenate([self.state, self.costate])


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """Times and weights of a quadrature [s], shape (P,), with state, control and costate there, (components, P)."""

    t: Vector
    weights: Vector
    x: Matrix
    u: Matrix
    lam: Matrix


def slopes_joined(parts: Sequence[Slopes]) -> Slopes:
    """Slopes of several pieces as one."""
    return Slopes(
        state=np.concatenate([p.state for p in parts], axis=1),
        costate=np.concatenate([p.costate for p in parts], axis=1),
        matrix=np.concatenate([p.matrix for p in parts]),
    )


def polynomial(c: Matrix, s: Matrix) -> Matrix:
    """c0 + c1 s + c2 s^2 + c3 s^3 for coefficients (..., 4).

    Parameters
    ----------
    c
        Coefficients from the constant up, shape (..., 4).
    s
        Arguments, of a shape that broadcasts with (...).
    """
    return c[..., 0] + s * (c[..., 1] + s * (c[..., 2] + s * c[..., 3]))


def cubics(curve: Curve, i: Vector) -> Matrix:
    """Coefficients (components, len(i), 4) of the pieces of a table after its nodes i, over shares of each.

    Parameters
    ----------
    curve
        Table of values and rates over time [s].
    i
        Indices of the nodes at which the pieces begin, integers, shape (pieces,).
    """
    h = (curve.time[i + 1] - curve.time[i])[:, None]
    left, slope, slope_right = curve.values[i], curve.rates[i] * h, curve.rates[i + 1] * h
    jump = curve.values[i + 1] - left
    found = np.stack([left, slope, 3 * jump - 2 * slope - slope_right, slope + slope_right - 2 * jump])
    return found.transpose(2, 1, 0)  # in memory each coefficient by itself, as polynomials are evaluated


_FROM_VALUES = np.linalg.inv(POINTS[:, None] ** np.arange(4)).T


def interpolating_cubics(values: Matrix) -> Matrix:
    """Coefficients (..., 4) of the cubics through values (..., 4) at `POINTS`."""
    return values @ _FROM_VALUES


def cubic_turning_points(c: Matrix) -> Matrix:
    """Return the turning points of cubics of coefficients (..., 4): two shares of [0, 1], (..., 2); else the middle."""
    _, b, c, d = np.moveaxis(c, -1, 0)
    # The roots of b + 2 c s + 3 d s^2 by the form that loses no digits.
    q = -(c + np.copysign(np.sqrt(np.maximum(c * c - 3 * b * d, 0.0)), c))
    with np.errstate(divide="ignore", invalid="ignore"):  # no root is none inside
        roots = np.stack([q / (3 * d), b / q], axis=-1)
    inside = (c * c >= 3 * b * d)[..., None] & (roots > 0) & (roots < 1)
    return np.where(inside, roots, 0.5)


def ends_and_turning_points(c: Matrix) -> Matrix:
    """Return shares (..., 4) that include those of least and largest value of cubics of coefficients (..., 4)."""
    return np.concatenate([np.broadcast_to(ENDS, (*c.shape[:-1], 2)), cubic_turning_points(c)], axis=-1)


def extreme_values(curve: Curve) -> Matrix:
    """Values (components, pieces, 4) among which are the least and the largest of each piece of a table."""
    found = cubics(curve, np.nonzero(np.diff(curve.time) > 0)[0])
    return polynomial(found[:, :, None], ends_and_turning_points(found))
