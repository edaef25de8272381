"""Level 3 with active control constraints: the variations left free, and strictly positive multipliers.

On a piece along which conditions c(x, u, p) >= 0 with multipliers mu > 0 are active, only variations count that stay on
them, c_x dx + c_u du + c_p dp = 0, and L = H - mu.c has the place of H in the second variation. The controls tried
are therefore

    u + Z z - C^+ c(x, u + Z z, p),

Z a basis of the tangents along which no held condition changes, C^+ the pseudo-inverse of the conditions' slopes along
the tangents, both as on the extremal. That keeps the conditions to first order, which is enough: L is stationary in u.

As the control is continuous where a condition takes hold or lets go, mu is 0 there; the times at which it happens have
no curvature of their own. Everywhere else mu must be positive, with a slope at those times (strict complementarity).
Source: Hartl, Sethi, Vickson (1995), section 4; Maurer and Pickenhain (1995), Second-order sufficient conditions for
control problems with mixed control-state constraints, J. Optim. Theory Appl. 86, theorem 5.2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector
from perilune.problem import Check
from perilune.proof.feasible.mixed_constraints import MixedConstraints
from perilune.proof.feasible.phase_data import PhaseData
from perilune.proof.necessary.minimum_principle import SLOPE_LIMIT, gradient_along
from perilune.proof.sufficient.strict_complementarity import STRICT_LIMIT, time_to_switch

_DEPENDENT = 1e-6  # of the largest slope: conditions whose slopes are closer are not distinguished


@dataclass(frozen=True, kw_only=True)
class ActiveConditions:
    """Conditions that hold all along a piece, at N times.

    Attributes
    ----------
    allowed, rows
        The conditions of the phase, and which of them.
    keeps
        Which of those variations keep: numbers among `rows`.
    mu
        J per second and unit of each, (r, N).
    at
        What they are on the extremal, 0 but for the tables' rounding, (r, N).
    back
        How the control gives way to each that is kept, (components, kept, N).
    """

    allowed: MixedConstraints
    rows: list[int]
    keeps: list[int]
    mu: Matrix
    at: Matrix
    back: Any

    def values(self, x: Any, u: Any, p: Any) -> Any:
        """Return by how much the conditions are left, (r, ..., N).

        Parameters
        ----------
        x, u
            States, shape (n, ..., N), and controls, shape (components, ..., N) [SI].
        p
            Record of all parameters [SI].
        """
        return self.allowed.values(x, u, p)[self.rows] - _insert_axes(self.at, x)

    def kept(self, x: Any, u: Any, p: Any) -> Any:
        """A control (components, ..., N) on which they hold to first order.

        Parameters
        ----------
        x, u
            States, shape (n, ..., N), and controls to correct, shape (components, ..., N) [SI].
        p
            Record of all parameters [SI].
        """
        return u - (_insert_axes(self.back, x) * self.values(x, u, p)[self.keeps]).sum(axis=1)

    def work(self, x: Any, u: Any, p: Any) -> Any:
        """mu.c, J per second, (..., N).

        Parameters
        ----------
        x, u
            States, shape (n, ..., N), and controls, shape (components, ..., N) [SI].
        p
            Record of all parameters [SI].
        """
        return (_insert_axes(self.mu, x) * self.values(x, u, p)).sum(axis=0)


def _insert_axes(rows: Any, x: Any) -> Any:
    """An array (..., N) with axes of length 1 before its last one, to go with x (n, ..., N)."""
    return rows.reshape(*rows.shape[:-1], *(1,) * (x.ndim - 2), rows.shape[-1])


def active_conditions_along(
    arc: PhaseData, x: Matrix, u: Matrix, lam: Matrix, basis: Any, released: Sequence[str] = ()
) -> tuple[ActiveConditions | None, Any, bool]:
    """Conditions that hold at all of N times, the moves that they leave, and whether that is how it is all along.

    Parameters
    ----------
    arc, x, u, lam
        The phase, and states, controls and costates (components, N).
    basis
        Moves of the control (components, k, N) that its own bounds leave.
    released
        Names of conditions that variations need not keep, though L has their multipliers.

    Returns
    -------
    The third is False where a condition holds only at some of the times, or the moves do not distinguish conditions.
    """
    if arc.allowed is None:
        return None, basis, True
    allowed, found = arc.allowed, arc.allowed.multipliers(x, u, lam)
    pulls = np.abs(found.falls) / arc.rate_scale > SLOPE_LIMIT
    always = allowed.active(x, u).all(axis=1)
    rows = np.nonzero(pulls.any(axis=1) | allowed.equal)[0].tolist()
    if not rows or not always[rows].all():
        return None, basis, not rows
    keeps = [i for i, row in enumerate(rows) if allowed.conditions[row].name not in released]
    ways = _split_moves(allowed, [rows[i] for i in keeps], x, u, basis)
    if ways is None:
        return None, basis, False
    back, moves = ways
    at = allowed.values(x, u)[rows].real
    return ActiveConditions(allowed=allowed, rows=rows, keeps=keeps, mu=found.mu[rows], at=at, back=back), moves, True


def _split_moves(
    allowed: MixedConstraints, rows: list[int], x: Matrix, u: Matrix, basis: Any
) -> tuple[Any, Any] | None:
    """Return the control's moves per unit of each condition, and the moves that change none; None where not known."""
    count, size = len(rows), allowed.sizes[rows]
    if not count:
        return np.zeros((len(u), 0, u.shape[1])), basis
    slopes = allowed.slopes(x, u, basis)[rows].transpose(2, 0, 1) / size[:, None]
    if count > slopes.shape[2]:
        return None
    left, sizes, right = np.linalg.svd(slopes)
    if (sizes[:, -1] <= _DEPENDENT).any():
        return None
    inverse = np.einsum("nrk,nr,nsr->nks", right[:, :count], 1 / sizes, left) / size
    return np.einsum("ckn,nkr->crn", basis, inverse), np.einsum("ckn,njk->cjn", basis, right[:, count:])


def check_strict_conditions(
    arc: PhaseData, spans: Sequence[tuple[float, float, ActiveConditions | None]]
) -> Iterator[Check]:
    """Checks of level 3 of the conditions that hold on pieces from one time to another: with strict multipliers.

    Parameters
    ----------
    arc
        Phase whose path conditions are checked.
    spans
        Begin and end of each piece [s], and the conditions that are active along it, if any.
    """
    if arc.allowed is None:
        return
    rows = sorted({row for _, _, held in spans if held for row in held.rows if not arc.allowed.equal[row]})
    if not rows:
        return
    t, _, _, found = gradient_along(arc)
    assert found is not None, "where conditions depend on the control"
    apart = time_to_switch(arc, t)
    for row in rows:
        name, pull = arc.allowed.conditions[row].name, found.falls[row]
        here = np.zeros(len(t), dtype=bool)
        for left, right, held in spans:
            if held and row in held.rows:
                here |= (t >= left) & (t <= right) & (apart > 1e-6 * arc.duration)
        slopes: Vector = np.append(pull[here] / apart[here], [] if here.any() else [0.0])
        yield Check(
            name=f"{arc.prefix}strict_{name}", level=3, limit=STRICT_LIMIT, unit="1",
            value=-float(slopes.min()) * arc.duration / float(np.abs(pull).max()),
            meaning=f"minus the least multiplier of {name} where it is active, over the time to the nearest break of"
            f" the table (in units of its largest value over the flight time): below 0 if it vanishes only where the"
            f" condition becomes active or inactive",
        )  # fmt: skip
