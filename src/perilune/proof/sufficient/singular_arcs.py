"""Terms of level 3 on singular arcs: of Kelley's condition, and of the second variation as Goh transforms it.

Where H is linear in a scalar u and its slope vanishes for a while, the second variation has no du^2 in it and its
control du may be an impulse. With y the integral of du, and xi = dx - B y, B = f_u, by parts

    2 int du L_u.dx = [2 y L_ux xi + y^2 L_ux B] + int 2 y M xi + R y^2 (in addition to what is there already),
    xi' = f_x xi + (f_x B - B') y,        M = B' L_xx - (L_ux)' - L_ux f_x,
    R = B' L_xx B - 2 L_ux (f_x B - B') - (L_ux B)'

(a prime at B and L_ux is d/dt, at B before L_xx a transpose), so that y is a control whose curvature is R. That is
-d/du d^2(H_u)/dt^2, and R > 0 is Kelley's condition, the generalised Legendre-Clebsch condition. At both ends of the
arc u jumps to a bound; as the times of that are free, du may be an impulse there: y begins with any value, and the arc
is left with dx = xi + B h, h = y at the end and an impulse together, a free parameter. What has a parameter in it goes
as what has a state in it that is constant.

On the bounds next to the arc the slope leaves zero like t^2: it is measured by that.

Source: Goh, *Necessary conditions for singular extremals*, SIAM J. Control 4, 1966; Aronna, Bonnans, Dmitruk, Lotito,
*Quadratic order conditions for bang-singular extremals*, Numer. Algebra Control Optim. 2, 2012 (theorem 5.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from perilune.core import Vector
from perilune.problem import scalars
from perilune.proof.feasible.mixed_constraints import ON_BOUND
from perilune.proof.feasible.phase_data import PhaseData, once_for_phase

_LOOKS = 20  # times of a stretch between two edges
_INNER = (0.31, 0.5)  # of a range: where H is compared with its chord, which u^3 intersects in the middle
_LINEAR = 1e-9  # of its terms: H bends less in a control that is linear in it
_MIXED = 1e-7  # of the largest second derivative of L: less is none, as differences have it
STRETCH = 1e-3  # of a phase: nearer to a singular arc its slope, which leaves zero like t^2, is rounding


def singular_between(arc: PhaseData, left: float, right: float) -> int | None:
    """Place of the one scalar that is singular all along a stretch: strictly between bounds, H linear in it.

    Parameters
    ----------
    arc
        Phase with costates.
    left, right
        Begin and end of the stretch, from the start of the phase [s].

    Returns
    -------
    int or None
        Index among the components of the control; None if there is no such scalar or more than one.
    """
    t = np.linspace(left, right, _LOOKS + 2)[1:-1]
    x, u, lam = arc.state(t), arc.control(t), arc.costate(t)
    found = []
    for at, control in scalars(arc.phase.controls):
        lower, upper = (float(limit) for limit in control.limits(arc.p))
        if not np.isfinite(upper - lower) or upper <= lower:
            continue
        if np.logical_or(*control.on_bounds(u[at], ON_BOUND * arc.control_scale[at], arc.p)).any():
            continue
        values, held = [], []
        for share in (0.0, *_INNER, 1.0):
            moved = np.array(u)
            moved[at] = lower + share * (upper - lower)
            values.append(lam * arc.rates(x, moved).real)
            if arc.allowed:
                held.append(arc.allowed.values(x, moved).real)
        if arc.allowed:  # what the phase holds decides it, and so does a condition that is active all along
            always = arc.allowed.active(x, u).all(axis=1)
            if (np.abs(held[-1] - held[0])[always] > _LINEAR * arc.allowed.sizes[always, None]).any():
                continue
        low, *inner, high = values
        bends = [
            np.abs((value - (1 - share) * low - share * high).sum(axis=0))
            for share, value in zip(_INNER, inner, strict=True)
        ]
        if (np.max(bends, axis=0) <= _LINEAR * sum(np.abs(value).sum(axis=0) for value in values)).all():
            found.append(at)
    return found[0] if len(found) == 1 else None


@dataclass(frozen=True)
class Singular:
    """Singular arcs of a phase.

    Attributes
    ----------
    places
        For each stretch between the edges of the phase the place of its singular scalar, or None.
    junctions
        For each break whether a singular arc begins or ends there.
    """

    places: tuple[int | None, ...]
    junctions: Any

    @classmethod
    def of(cls, arc: PhaseData) -> Singular:
        """Read off the tables of a phase."""
        return _singular_arcs(arc)

    def ends(self, k: int) -> bool:
        """Return True if a singular arc ends with stretch k."""
        return self.places[k] is not None and (k + 1 == len(self.places) or self.places[k + 1] != self.places[k])


@once_for_phase
def _singular_arcs(arc: PhaseData) -> Singular:
    places = tuple(singular_between(arc, left, right) for left, right in pairwise(arc.edges.tolist()))
    inner = arc.edges[1:-1]
    beside = [places[i] != places[i + 1] for i in range(len(inner))]
    return Singular(places, np.isin(arc.breaks, inner[np.array(beside, dtype=bool)]))


@dataclass(frozen=True, kw_only=True)
class Leap:
    """Leap at the end of a singular arc, dx = xi + `by` h, and the terms that it adds to the form.

    Attributes
    ----------
    by
        B, (n,), scaled.
    mixed
        L_u,z by states and parameters, (n + m,).
    square
        L_ux B.
    """

    by: Vector
    mixed: Vector
    square: float


def goh_transform(F: Any, W: Any, column: int, sizes: tuple[int, int], length: float) -> tuple[Any, Any, Leap] | None:
    """Derivatives of a piece (`VariationPiece`) with y in the place of a singular control.

    Parameters
    ----------
    F, W
        First derivatives of rates (n, d, N) and second ones of L (d, d, N), at the middles of N equal steps.
    column
        Of the singular control.
    sizes
        Numbers of states and parameters.
    length
        Of the piece: the control is integrated over time.

    Returns
    -------
    The new F and W, and the leap at the end of the piece; None where L is curved in the control, by itself or with
    another.
    """
    from scipy.interpolate import CubicSpline

    n, m = sizes
    count, others = F.shape[2], [i for i in range(n + m, F.shape[1]) if i != column]
    if np.abs(W[[column, *others], column]).max() > _MIXED * np.abs(W).max():
        return None
    s = (np.arange(count) + 0.5) / count
    B, row = F[:, column] / length, W[column, : n + m] / length
    square = (row[:n] * B).sum(axis=0)
    bends = [CubicSpline(s, np.atleast_2d(value), axis=1) for value in (B, row, square)]
    B_rate, row_rate, square_rate = (bend(s, 1) for bend in bends)
    into = np.einsum("ijN,jN->iN", F[:, :n], B) - B_rate
    pulled = np.einsum("iN,ijN->jN", B, W[:n])
    new_F, new_W = F.copy(), W.copy()
    new_F[:, column] = into
    new_W[column] = new_W[:, column] = 0.0
    mixed = pulled - np.einsum("iN,ijN->jN", row[:n], F)
    mixed[: n + m] -= row_rate
    for i in (*range(n + m), *others):
        new_W[column, i] = new_W[i, column] = mixed[i]
    new_W[column, column] = (pulled[:n] * B).sum(axis=0) - 2 * (row[:n] * into).sum(axis=0) - square_rate[0]
    by, at_end, last = (bend(1.0) for bend in bends)
    return new_F, new_W, Leap(by=by, mixed=at_end, square=float(last[0]))


def distance_slopes(arc: PhaseData, at: int, S: Vector, t: Vector, apart: Vector, held: Any) -> Vector:
    """The slope S on a bound over its distance from zero: the time to a switch, or its square to a singular arc.

    Parameters
    ----------
    arc, at
        The phase, and the place of a scalar.
    S, t, apart, held
        |dH/du| at times, the time from each to the nearest break, and whether the scalar is on a bound there.

    Returns
    -------
    What of them counts, in units of S over the flight time.
    """
    breaks = arc.breaks[Singular.of(arc).junctions & (arc.jumps[at] != 0)]
    if not len(breaks):
        return S[held] / apart[held] * arc.duration
    beside = np.abs(t[:, None] - breaks).min(axis=1) <= apart * (1 + 1e-12)
    near, far = held & beside & (apart > STRETCH * arc.duration), held & ~beside
    return np.concatenate([S[far] / apart[far] * arc.duration, S[near] / apart[near] ** 2 * arc.duration**2])
