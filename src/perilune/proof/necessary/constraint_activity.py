"""Quick test, at a few points, of whether a flight may reach a condition or follow it: most flights do not.

Contact points are at an edge of the tables, where costates jump; boundary arcs lie between edges.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from perilune.core import Vector
from perilune.proof.feasible.phase_data import PhaseData

LEAST = 1e-3  # of its size: what a condition goes through at least; one that is active all along goes through nothing
_NEAR = 1e-4  # of what it is elsewhere: so near to it a condition is looked at all along


def table_edges(arc: PhaseData) -> Vector:
    """Return the times inside the phase at which a table has a break [s]."""
    found = [curve.time[1:][np.diff(curve.time) == 0] for curve in arc.curves]
    times = np.unique(np.concatenate(found))
    return times[(times > 0) & (times < arc.duration)]


def may_meet_condition(arc: PhaseData) -> bool:
    """Return True if a path condition or a bound of a state is active at an edge, or half way between two."""
    edges = table_edges(arc)
    some = np.union1d(edges, [0.5 * (a + b) for a, b in pairwise([0.0, *edges.tolist(), arc.duration])])
    return any(
        np.abs(S).min() <= _NEAR * max(float(np.abs(S).max()), LEAST * size) for S, size in _condition_values(arc, some)
    )


def _condition_values(arc: PhaseData, t: Vector) -> Iterator[tuple[Vector, float]]:
    """Yield the values of every condition at times, and its size."""
    x = arc.state(t)
    if arc.phase.path_conditions:
        yield from zip(arc.path(x, arc.control(t)), arc.path_scale.tolist(), strict=True)
    for state, size, values in zip(arc.phase.states, arc.state_scale.tolist(), x, strict=True):
        yield from ((values - limit, size) for limit in state.limits(arc.p) if np.isfinite(limit))
