"""Boundary arcs that no optimal flight follows, since chattering next to the boundary always lowers J.

Along S = 0 a control keeps S^(q) = 0. Where H is concave in a scalar u that does so, a flight that switches between
both bounds of u and keeps S^(q) = 0 in the mean stays as near to the arc as it switches fast, and has

    H(u) - [(1 - s) H(lower) + s H(upper)] > 0,       s = (u - lower)/(upper - lower),

less of H: the faster the better, without end. The arc is then no extremal, whatever its multipliers are, and the least
J is approached by flights that chatter and reached by none (Zelikin, Borisov 1994; relaxed controls: Young 1969).
"""

from __future__ import annotations

import numpy as np

from perilune.problem.controls import scalars
from perilune.problem.results.solution import Solution

_ARC_TIMES = 100  # times along an arc
_CONCAVE_BY, _HELD_STRAIGHT = 1e-6, 1e-6  # of the terms of H, and of those of what is held


def find_chattering_arc(solution: Solution) -> str | None:
    """Return the name of a scalar that would better switch back and forth along an arc; None where there is none.

    Parameters
    ----------
    solution
        A restated problem's, whose phases hold the conditions of their boundary arcs; with costates.
    """
    for phase, flown in zip(solution.problem.phases, solution.trajectories, strict=True):
        if not phase.held_conditions or flown.costate is None or flown.duration <= 0:
            continue
        t, p = np.linspace(0.0, flown.duration, _ARC_TIMES + 2)[1:-1], solution.parameters
        x, u, lam = flown.state(t).T, flown.control(t).T, flown.costate(t).T
        for at, control in scalars(phase.controls):
            lower, upper = control.limits(p)
            if not (np.isfinite(upper - lower) and lower < upper):
                continue
            share, sides = (u[at] - lower) / (upper - lower), []
            for value in (u[at], lower + 0 * t, upper + 0 * t):
                moved = np.array(u)
                moved[at] = value
                rates = [np.broadcast_to(r, t.shape) for r in phase.rates(list(x), list(moved), p)]
                held = [np.broadcast_to(h, t.shape) for h in phase.evaluate("held", list(x), list(moved), p)]
                sides.append((lam * np.array(rates), np.array(held)))
            (H, S), (H_low, S_low), (H_high, S_high) = sides
            drop = (H - (1 - share) * H_low - share * H_high).sum(axis=0)
            bend = np.abs(S - (1 - share) * S_low - share * S_high)
            concave = drop > _CONCAVE_BY * np.abs(H).sum(axis=0)
            kept = bend <= _HELD_STRAIGHT * (np.abs(S_low) + np.abs(S_high))
            if bool((concave & kept.all(axis=0) & (share > 0) & (share < 1)).all()):
                return control.name
    return None
