"""Roots near an extremal of a nearly singular Jacobian, with the unknowns held along the flat direction.

The wait of a lander before the first of two burns may change J by its curvature only, 1e-9 canonical. A step
of Newton's method that corrects a residual of 1e-9 is then of length 1 along the wait, where first derivatives no
longer describe the residual: the step is damped to nothing. With u.h = 0 replaced by v.dy = 0, where u and v are the
singular vectors of the Jacobian's smallest singular value, the rest is as well-conditioned as any other problem:

    J dy + h = t u,   v.dy = 0:     dy = -J^-1 h + t J^-1 u,   t = (v.J^-1 h) / (v.J^-1 u).

J is stationary along v at the extremal, so that holding the unknowns there does not change the derivatives of J by the
start (envelope theorem), and changes J itself by the square of the shift, alike to both sides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from perilune.core import Vector
from perilune.shooting.newton import AMPLIFIED, LAST_DIGITS, SETTLED, TOLERANCE
from perilune.shooting.shooting_function import Root, Shooting

_FLAT = 1e3  # by which the largest singular value of J^-1 stands beyond all others
_ROUNDS = 8


def root_across(shooting: Shooting, like: Root, p: Vector) -> Root | None:
    """Return the root near another, with the unknowns held along its flat direction; None where that has not one.

    Parameters
    ----------
    shooting, p
        The shooting function, and the given parameters of the root, canonical.
    like
        Where the search begins: an extremal of other parameters, with the inverse of its Jacobian.

    Returns
    -------
    Root or None
        Its residual keeps what is left along the flat direction.
    """
    if not np.isfinite(like.inverse).all():
        return None
    V, s, Ut = np.linalg.svd(like.inverse)
    if len(s) < 2 or not s[0] > _FLAT * s[1]:
        return None
    v, u, active, least = V[:, 0], Ut[0], shooting.plan.active, np.inf
    here = best = shooting.at(like.y[None], p, like.choice)[0]
    for _ in range(_ROUNDS):
        h = here.residual[shooting.plan.rows]
        towards, along = here.inverse @ h, here.inverse @ u
        step = (v @ towards) / (v @ along) * along - towards
        length = float(np.linalg.norm(step)) / (1 + float(np.linalg.norm(here.y)))
        if not length < least:  # also true of NaN
            break
        left = float(np.abs(h - (u @ h) * u).max())
        ended = (length <= SETTLED and left <= TOLERANCE) or (length <= LAST_DIGITS and left <= AMPLIFIED * TOLERANCE)
        best, least = replace(here, converged=ended), length
        Y = here.y.copy()
        Y[active] += step
        here = shooting.at(Y[None], p, like.choice)[0]
    return best
