"""Exit from boundary arcs: where the multiplier of S >= 0 itself is negative, the flight gains by leaving.

Along an arc of order q the control minimises L = H - eta S^(q) with S^(q) = 0, and S >= 0 has the multiplier

    mu = (-1)^q d^q eta/dt^q.

Where it is negative J falls as S grows, and nothing but the statement of the arc keeps the flight there. Eta is read
off dH/du along the tangents of the control, by least squares with all that is held or active there, and differentiated
as a polynomial between any two breaks of the control's table.

Source: Bryson and Ho (1975), section 3.11.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.polynomial.chebyshev import chebpts1

from perilune.core import Matrix, Vector
from perilune.problem import ScalarControl, Solution, control_scales, control_slices, full, normalised, tangents
from perilune.structures.detect_regimes import runs_by_kind
from perilune.structures.state_constraints import Condition

_DEGREE, _NODES = 12, 33  # of a polynomial, and where eta is read for it
_ROUGH = 1e-5  # of the largest eta: farther off a polynomial shows nothing
_STEP, _ON = 1e-6, 1e-6  # of the size of a control: a difference, and as near to a bound or a condition as counts
_LOOKS = 400  # times of a piece
WRONG = (
    1e-4  # of the largest eta over the time of the arc, as the proof has it: mu that is so little below zero is none
)


def paying_intervals(solved: Solution, index: int, condition: Condition) -> list[tuple[float, float]] | None:
    """Return the intervals in which an arc along a condition pays [s of the arc]; None where that is not known.

    Parameters
    ----------
    solved
        An extremal of a problem restated.
    index
        Number of the phase that is the boundary arc of the condition.
    condition
        The condition; the answer is known for those of order 1 and 2.
    """
    flown, q = solved.trajectories[index], condition.order
    if q > 2 or flown.costate is None or not flown.duration > 0:
        return None
    nodes = flown.control.time
    edges = np.unique([0.0, *nodes[1:][np.diff(nodes) == 0], flown.duration])
    shares = 0.5 * (1.0 + chebpts1(_NODES))
    pieces = [begin + (end - begin) * shares for begin, end in pairwise(edges)]
    read = [_multiplier(solved, index, condition.rated(q, "", 1.0).name, t) for t in pieces]
    size, t, pays = float(np.abs(read).max()), list[Vector](), list[Vector]()
    if not np.isfinite(size):
        return None
    for begin, end, times, eta in zip(edges, edges[1:], pieces, read, strict=False):
        curve = Chebyshev.fit(times, eta, _DEGREE, domain=[begin, end])
        if np.abs(curve(times) - eta).max() > _ROUGH * size:
            return None
        t.append(np.linspace(begin, end, _LOOKS))
        pays.append((-1) ** q * curve.deriv(q)(t[-1]) * flown.duration**q >= -WRONG * size)
    every, worth = np.concatenate(t), np.concatenate(pays)
    return [(float(every[first]), float(every[last])) for first, last in runs_by_kind(worth) if last > first]


def _multiplier(solved: Solution, index: int, rate: str, t: Vector) -> Vector:
    """Return eta of the held condition of that name at times of a phase, J/s per unit; NaN where unknown."""
    phase, costate, p = solved.problem.phases[index], solved.trajectories[index].costate, solved.parameters
    assert costate is not None, "asked for where there is one"
    x, u = solved.evaluate(index, t)
    lam, scales = costate(t).T, control_scales(phase.controls, solved.problem.scales)

    def at(u: Matrix) -> Matrix:
        """Return what is held, what is kept, and H, in rows."""
        held, kept = (phase.evaluate(which, list(x), list(u), p) for which in ("held", "path"))
        H = sum(a * np.asarray(b) for a, b in zip(lam, phase.rates(list(x), list(u), p), strict=True))
        return np.array([full(value, t) for value in (*held, *kept, H)])

    moves = tangents(phase.controls, scales, u) * _movable_components(solved, index, u)[:, None]
    steps = [_STEP * moves[:, i] for i in range(moves.shape[1])]
    slopes = np.array(
        [(at(normalised(phase.controls, u + d)) - at(normalised(phase.controls, u - d))) / (2 * _STEP) for d in steps]
    )
    names, values = [c.name for c in phase.held_conditions], at(u)[:-1]
    acting = np.abs(slopes[:, :-1]).max(axis=(0, 2))
    met = np.abs(values) <= _ON * acting[:, None]
    met[: len(names)] = True
    met &= acting[:, None] > 0
    eta = np.full(len(t), np.nan)
    for i in range(len(t)):
        rows = np.nonzero(met[:, i])[0].tolist()
        if names.index(rate) in rows and np.isfinite(slopes[..., i]).all():
            found = np.linalg.lstsq(slopes[:, rows, i], slopes[:, -1, i], rcond=None)[0]
            eta[i] = found[rows.index(names.index(rate))]
    return eta


def _movable_components(solved: Solution, index: int, u: Matrix) -> Matrix:
    """Return 1 for each component of the control that can move both ways, 0 for scalars on a bound."""
    phase, p, moving = solved.problem.phases[index], solved.parameters, np.ones(u.shape)
    for here, control in control_slices(phase.controls):
        if isinstance(control, ScalarControl):
            low, high = control.on_bounds(u[here], _ON * solved.problem.scales.of(control.unit), p)
            moving[here] = ~(low | high)
    return moving
