"""Extremals that are not isolated: curves of roots along which J is constant.

Where a problem leaves something open that costs nothing (with spare time and a free angle at the end, how long to wait
before the first burn), the Jacobian is singular at every root. Newton's step is then as long as round-off makes it
along the curve, and no run ends. The shortest of the steps that the residual asks for goes straight to the curve: J^-1
is assembled without its few largest singular values, which stand far beyond the others. The root reached lies on such a
curve, and is no double root, if a move along it leads to another root with the same J.

Source: Deuflhard, *Newton Methods for Nonlinear Problems*, Springer 2011, section 4.4 (underdetermined systems).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from perilune.core import Matrix
from perilune.shooting.newton import AMPLIFIED, LAST_DIGITS, ROUND_OFF, SETTLED, Lanes
from perilune.shooting.shooting_function import Root, Roots, Shooting

_NEAR = 1e-5  # largest residual from which the shortest steps are tried
_MOST = 8  # lanes tried; many starts end near one curve
_OPEN = 1e3  # by which singular values of J^-1 of an open direction stand beyond all others
_FLAT = 1e6  # the same of J itself, which is known better than its inverse
_ROUNDS = 12
_TOLERANCE = 1e-11  # on the largest residual, as for Newton's method
_ALONG = 1e-4  # relative move along the curve that shows it
_SAME = 1e-9  # relative change of J by it


def nearly_open(root: Root) -> bool:
    """Return True if Newton's method ended near roots that are not isolated, without reaching one."""
    return float(np.abs(root.residual).max()) < _NEAR and root.flat_directions(_OPEN) > 0


def complete_open_roots(shooting: Shooting, roots: Roots, p: Matrix) -> Roots:
    """Return the roots, with those where Newton's method did not converge moved onto the nearby curve.

    Parameters
    ----------
    shooting, p
        Whose roots, and the given parameters, (np,) or (lanes, np).
    roots
        Results of Newton's method, converged or not.
    """
    residuals = np.where(roots.converged | ~np.isfinite(roots.rows).all(axis=1), np.inf, roots.residuals)
    near = np.argsort(residuals)[:_MOST]
    near = near[residuals[near] < _NEAR]
    leave = np.array([roots[lane].flat_directions(_OPEN) for lane in near.tolist()], dtype=int)
    near, leave = near[leave > 0], leave[leave > 0]
    if not len(near):
        return roots
    return roots.replaced(
        near, reach_open_roots(shooting, roots.y[near], _lane_parameters(p, near), roots.choice[near], leave)
    )


def reach_open_roots(shooting: Shooting, Y: Matrix, p: Matrix, choice: Matrix, leave: Lanes) -> Roots:
    """Return roots on curves, by the shortest steps; not converged where there is none, or no curve.

    Parameters
    ----------
    shooting, Y, p, choice
        Starting points, as for `Shooting.solve`.
    leave
        How many directions are open in each lane.
    """
    roots = _shortest_steps(shooting, Y, p, choice, leave)
    finite: NDArray[np.bool_] = np.all(np.isfinite(roots.rows), axis=1)
    roots = roots.failed(~finite)  # for others no direction is known
    curve = np.zeros(len(Y), dtype=bool)
    for way in (_ALONG, -_ALONG):  # it may end here on one side
        lanes = np.nonzero(roots.converged & ~curve)[0]
        if not len(lanes):
            break
        here = roots.of(lanes)
        moved = here.y.copy()
        for row, root in enumerate(here):
            along = np.linalg.svd(root.inverse)[0][:, 0]
            moved[row, here.plan.active] += way * (1 + np.linalg.norm(root.y)) * along
        again = _shortest_steps(shooting, moved, _lane_parameters(p, lanes), here.choice, leave[lanes])
        went, left = (np.linalg.norm(y - here.y, axis=1) for y in (moved, again.y))
        same = np.abs(again.costs - here.costs) <= _SAME * (1 + np.abs(here.costs))
        curve[lanes] = again.converged & same & (left > 0.5 * went)
    return roots.failed(~curve)


def _shortest_steps(shooting: Shooting, Y: Matrix, p: Matrix, choice: Matrix, leave: Lanes) -> Roots:
    """Step without so many directions until the residual is round-off, in all lanes; keep each lane's best iterate."""
    Y, roots = Y.copy(), shooting.at(Y, p, choice)
    best, active = roots, roots.plan.active
    converged = np.zeros(len(Y), dtype=bool)
    for _ in range(_ROUNDS):
        moving = np.isfinite(roots.rows).all(axis=1) & ~(converged & (best.residuals <= ROUND_OFF))
        lanes = np.nonzero(moving)[0]
        if not len(lanes):
            break
        for lane, J in zip(lanes, shooting.jacobians(Y[lanes], _lane_parameters(p, lanes), choice[lanes]), strict=True):
            h, (U, s, Vt) = roots.rows[lane, roots.plan.columns.residual], np.linalg.svd(J)
            keep = len(s) - leave[lane]
            step = -(Vt[:keep].T / s[:keep]) @ (U[:, :keep].T @ h)
            length, residual = np.linalg.norm(step) / (1 + np.linalg.norm(Y[lane])), np.abs(h).max()
            ended = length <= SETTLED and residual <= _TOLERANCE
            ended |= length <= LAST_DIGITS and residual <= AMPLIFIED * _TOLERANCE
            converged[lane] |= ended and s[keep - 1] > _FLAT * s[keep]
            Y[lane, active] += step
        roots = shooting.at(Y, p, choice)
        better = np.nonzero(roots.residuals < best.residuals)[0]
        best = best.replaced(better, roots.of(better))
    return replace(best, converged=converged)


def _lane_parameters(p: Matrix, lanes: Lanes) -> Matrix:
    return p if p.ndim == 1 or len(p) == 1 else p[lanes]
