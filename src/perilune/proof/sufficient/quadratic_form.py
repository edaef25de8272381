"""Quadratic form of variations under linear conditions: whether it is positive, and the gain of a Newton step.

Source: Hestenes (1966), as `perilune.proof.sufficient.second_order`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perilune.core import Matrix, Vector

_NOTHING = 1e-10  # of the form: less is zero


@dataclass(frozen=True)
class QuadraticForm:
    """Variations of (parameters, switching times, controls of all pieces).

    In coordinates such that int du' H_uu du + sum D dt^2 is a sum of squares.

    Attributes
    ----------
    form, constraints
        Second variation, and linearised end conditions in rows.
    slope
        First variation of J, with the multipliers of what variations need not keep; flown, and so 0 on those that keep
        the conditions, whatever the costates say.
    m
        Number of the parameters, which come first.
    """

    form: Matrix
    constraints: Matrix
    slope: Vector
    m: int


@dataclass(frozen=True)
class _Reflection:
    """Symmetric orthogonal matrix I - W X', that takes orthonormal rows V (r, N) to the first r coordinates.

    W = V' + E B and X = W (I + B'E'V')^-1, where B is the orthogonal factor of the polar decomposition of E'V'. As r is
    small it is applied to a form by few products, and the other N - r coordinates are those of the kernel of V.
    """

    W: Matrix
    X: Matrix
    turn: Matrix

    @classmethod
    def of(cls, rows: Matrix) -> _Reflection:
        """Return the reflection of orthonormal rows."""
        r, W = len(rows), rows.T.copy()
        left, sizes, right = np.linalg.svd(W[:r])
        W[:r] += left @ right
        return cls(W, np.linalg.solve(np.eye(r) + right.T * sizes @ right, W.T).T, -left @ right)

    def form(self, form: Matrix) -> Matrix:
        """Return a symmetric form in the reflected coordinates."""
        moved = form @ self.X
        moved -= 0.5 * self.W @ (self.X.T @ moved)
        change = self.W @ moved.T
        return form - change - change.T

    def rows(self, rows: Matrix) -> Matrix:
        """Return rows (..., N) in the reflected coordinates."""
        return rows - (rows @ self.W) @ self.X.T


def _off_conditions(constraints: Matrix) -> tuple[int, _Reflection]:
    """Return the number of independent conditions, and the reflection behind which these are the first coordinates."""
    _, sizes, rows = np.linalg.svd(constraints, full_matrices=False)
    count = int((sizes > 1e-10 * sizes.max(initial=0.0)).sum())
    return count, _Reflection.of(rows[:count])


def destabilising_eigenvalue(form: Matrix, constraints: Matrix, m: int) -> tuple[float, int]:
    """Largest destabilising eigenvalue (above); and of how many.

    It is infinite where a free parameter by itself already gains, and NaN where it costs nothing to second order.

    Parameters
    ----------
    form, constraints, m
        Of a `QuadraticForm`.
    """
    count, free = _off_conditions(constraints)
    parameters = free.rows(np.eye(m, len(form)))[:, count:]
    form = free.form(form)[count:, count:]
    # The measure, 1 on controls and switching times and 0 on parameters, is 1 - q'q here, q the rows of the parameters.
    _, shares, vectors = np.linalg.svd(parameters, full_matrices=False)
    weights = 1.0 - np.pad(shares, (0, len(form) - len(shares))) ** 2
    along = _Reflection.of(vectors)
    form = along.form(form)
    form[: len(shares)] = along.turn.T @ form[: len(shares)]
    form[:, : len(shares)] = form[:, : len(shares)] @ along.turn
    alone = int((weights < 1e-10).sum())  # variations of parameters without any of the control
    if alone:
        own, mixed = form[:alone, :alone], form[:alone, alone:]
        least = float(np.linalg.eigvalsh(own)[0])
        if least <= _NOTHING * np.abs(form).max():
            return float("nan") if least >= -_NOTHING * np.abs(form).max() else float("inf"), len(weights)
        form = form[alone:, alone:] - mixed.T @ np.linalg.solve(own, mixed)
    if not form.size or alone == len(weights):
        return 0.0, len(weights)
    root = np.sqrt(weights[alone:])
    return float(1.0 - np.linalg.eigvalsh(form / root / root[:, None])[0]), len(weights)


def newton_gain(forms: QuadraticForm) -> float:
    """Return the gain of a Newton step over the size of J (its absolute value, where the form is none of a minimum)."""
    count, free = _off_conditions(forms.constraints)
    form, slope = free.form(forms.form)[count:, count:], free.rows(forms.slope)[count:]
    if not form.size:
        return 0.0
    sizes, vectors = np.linalg.eigh(form)
    told = np.abs(sizes) > _NOTHING * np.abs(sizes).max()
    return abs(0.5 * float(((slope @ vectors)[told] ** 2 / sizes[told]).sum()))
