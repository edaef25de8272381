"""Legendre-Gauss and Legendre-Gauss-Radau collocation: points, weights, differentiation, interpolation.

On [-1, 1] a state is a polynomial of degree n through n + 1 *support* points; its derivative is held equal to
the dynamics at the n *collocation* points tau_i, the roots of

    P_n(tau)                   (gauss: both ends excluded; Peng et al. 2012, (5)-(11); Benson 2005)
    P_n(tau) + P_(n-1)(tau)    (radau: -1 included, +1 not; Garg et al. 2010)

The Gauss support adds -1 to the points, and the end state follows by quadrature, Peng et al. (13); the Radau
support adds +1, which is the end state itself. All interpolation is barycentric (Berrut, Trefethen 2004), so
that no degree in use is ill-conditioned.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from perilune.core import Matrix, PeriluneError, Vector

Scheme = Literal["gauss", "radau"]


@dataclass(frozen=True, kw_only=True)
class Rule:
    """One collocation rule.

    Parameters
    ----------
    scheme
        ``"gauss"`` or ``"radau"``.
    points, weights
        Collocation points in increasing order and quadrature weights, shape (n,); exact to degree 2n - 1
        (gauss) or 2n - 2 (radau).
    support
        Interpolation points of the state, shape (n + 1,).
    differentiation
        Derivatives at the collocation points from values at the support, shape (n, n + 1).
    """

    scheme: Scheme
    points: Vector
    weights: Vector
    support: Vector
    differentiation: Matrix

    @property
    def degree(self) -> int:
        """Number n of collocation points, the degree of the state polynomial."""
        return len(self.points)

    @property
    def first(self) -> int:
        """Index of the first collocation point in the support."""
        return 1 if self.scheme == "gauss" else 0

    @cached_property
    def integration(self) -> Matrix:
        """Integrals from -1 to each later support point, from values at the points, shape (n, n)."""
        return np.linalg.inv(self.differentiation[:, 1:])

    @property
    def stride(self) -> int:
        """State points of one segment, its end (the next segment's start) not counted."""
        return self.degree + 1 if self.scheme == "gauss" else self.degree


@lru_cache(maxsize=256)
def rule(scheme: Scheme, degree: int) -> Rule:
    """Return the rule with `degree` collocation points.

    Parameters
    ----------
    scheme
        "gauss" (Legendre-Gauss) or "radau" (Legendre-Gauss-Radau).
    degree
        Number of collocation points of a segment.

    Raises
    ------
    PeriluneError
        If the scheme is unknown or the degree is below 2.
    """
    if scheme not in ("gauss", "radau"):
        raise PeriluneError("unknown collocation scheme", got=repr(scheme), expected="'gauss' or 'radau'")
    if degree < 2:
        raise PeriluneError("a segment needs at least two collocation points", got=str(degree), expected=">= 2")
    if scheme == "gauss":
        points, weights = _gauss_nodes(degree)
        support = np.concatenate([[-1.0], points])
    else:
        points, weights = _radau_nodes(degree)
        support = np.concatenate([points, [1.0]])
    matrix = differentiation_matrix(support)
    return Rule(
        scheme=scheme,
        points=points,
        weights=weights,
        support=support,
        differentiation=matrix[1:] if scheme == "gauss" else matrix[:-1],
    )


def _gauss_nodes(n: int) -> tuple[Vector, Vector]:
    from scipy.special import roots_legendre

    points, weights = roots_legendre(n)
    return points, weights


def _radau_nodes(n: int) -> tuple[Vector, Vector]:
    """Return -1 and the roots of the Jacobi polynomial P^(0,1)_(n-1); w = (1 - tau)/(n P_(n-1)(tau))^2."""
    from scipy.special import eval_legendre, roots_jacobi

    points = np.concatenate([[-1.0], roots_jacobi(n - 1, 0.0, 1.0)[0]])
    return points, (1.0 - points) / (n * eval_legendre(n - 1, points)) ** 2


def barycentric_weights(points: Vector) -> Vector:
    """Return weights 1/prod(x_j - x_k), scaled by the interval's capacity so that no product under- or overflows."""
    return _compute_barycentric_weights(points.tobytes())


@lru_cache(maxsize=512)
def _compute_barycentric_weights(of: bytes) -> Vector:
    points = np.frombuffer(of)
    capacity = 0.25 * (points[-1] - points[0]) if len(points) > 1 else 1.0
    difference = (points[:, None] - points[None, :]) / capacity
    np.fill_diagonal(difference, 1.0)
    return 1.0 / difference.prod(axis=1)


def differentiation_matrix(points: Vector) -> Matrix:
    """Return derivatives at the points of the polynomial through values at the points, shape (n, n)."""
    return _differentiation(points.tobytes())


@lru_cache(maxsize=512)
def _differentiation(of: bytes) -> Matrix:
    points = np.frombuffer(of)
    w = barycentric_weights(points)
    difference = points[:, None] - points[None, :]
    np.fill_diagonal(difference, 1.0)
    matrix = (w[None, :] / w[:, None]) / difference
    np.fill_diagonal(matrix, 0.0)
    # Rows sum to 0, the derivative of a constant: exact by construction rather than by rounding.
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return matrix


def interpolation_matrix(points: Vector, at: Vector) -> Matrix:
    """Return values at `at` of the polynomial through values at the points, shape (len(at), len(points)).

    Parameters
    ----------
    points
        Points of [-1, 1], (n,).
    at
        Places of [-1, 1], (m,).
    """
    difference = np.asarray(at, dtype=float)[:, None] - points[None, :]
    hit = np.abs(difference) < 1e-200  # its inverse would overflow
    difference[hit] = 1.0
    terms = barycentric_weights(points)[None, :] / difference
    rows = hit.any(axis=1)
    terms[rows] = hit[rows]
    return terms / terms.sum(axis=1, keepdims=True)


@dataclass(frozen=True, kw_only=True)
class Polynomial:
    """A vector polynomial by its values (n, k) at points (n,) of [-1, 1]."""

    points: Vector
    values: Matrix

    def __call__(self, tau: Vector) -> Matrix:
        """Return the values at tau, shape (len(tau), k)."""
        return interpolation_matrix(self.points, tau) @ self.values

    def with_slopes(self, tau: Vector) -> tuple[Matrix, Matrix]:
        """Return the values at tau and derivatives with respect to it."""
        matrix = interpolation_matrix(self.points, tau)
        return matrix @ self.values, matrix @ self.derivative.values

    @cached_property
    def derivative(self) -> Polynomial:
        """Its derivative with respect to tau."""
        return Polynomial(points=self.points, values=differentiation_matrix(self.points) @ self.values)


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """The mesh of one phase.

    Parameters
    ----------
    degrees
        Collocation points of each segment.
    joints
        Ends of the segments as fractions of the phase, from 0 to 1, one more than segments.
    free
        Fractions by which each inner joint may move either way; 0 holds it. A joint at a switch is free, so
        that the program finds the switching time itself.
    pinned
        For each segment, and in it each control component, -1 or 1 where the control is held at its lower or
        upper bound, else 0. Next to a free joint this is what makes the switching time count: a control that
        may take any value at the points hides a switch between them at no cost (Agamawi, Hager, Rao 2020).
        Empty: none.
    """

    degrees: tuple[int, ...]
    joints: tuple[float, ...]
    free: tuple[float, ...] = ()
    pinned: tuple[tuple[int, ...], ...] = ()

    @staticmethod
    def uniform(segments: int, degree: int) -> Mesh:
        """Return a mesh of equal segments of equal degree.

        Parameters
        ----------
        segments
            Number of segments of the phase.
        degree
            Number of collocation points of each segment.
        """
        return Mesh(
            degrees=(degree,) * segments,
            joints=tuple(float(s) for s in np.linspace(0.0, 1.0, segments + 1)),
            free=(0.0,) * (segments - 1),
        )

    @property
    def nodes(self) -> int:
        """Number of collocation points."""
        return sum(self.degrees)
