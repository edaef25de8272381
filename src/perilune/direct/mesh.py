"""Mesh refinement from the errors of the last mesh (`perilune.direct.mesh_error`).

A segment that is not accurate enough is split where a bounded control switches, and where a bound of a control
or a state becomes active or inactive: there arcs of another kind begin (Goddard's singular arc, a constrained arc). The
new joint is left free and a control that lies at a bound on one side is held there, so that the program finds the time.
Elsewhere the decay of its Legendre coefficients, |a_i| ~ 10^(c - sigma i), shows what a higher degree would gain (Liu,
Hager, Rao 2015): the degree rises by log10(error/tolerance)/sigma, or the segment is halved where that would exceed the
largest degree in use, as it does at a kink.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector
from perilune.direct.collocated_solution import Segment
from perilune.direct.collocation import Mesh
from perilune.problem import Phase, scalars

HIGHEST_DEGREE = 40
LOWEST_DEGREE = 5
HALVED_DEGREE = 10
SWITCHED_DEGREE = 12
# Legendre coefficients below this part of a curve's size are noise of the solve.
ROUNDING = 1e-11
# A control switches between two neighbouring points where it changes by more than this part of its range.
SWITCH = 0.4
# Within this part of its range from a bound a control is taken to be at it.
AT_BOUND = 0.02
# The same for a state, which the program holds to its bound far more closely.
STATE_AT_BOUND = 1e-5
# Distance to the next joint that a free joint may use up.
REACH = 0.45


def find_switches(phase: Phase, flown: Sequence[Segment], known: set[float], p: Any) -> list[float]:
    """Return fractions of the phase where a control jumps or a bound becomes active or inactive, as far as points show.

    What happens between two points that a `known` joint lies between happens there, and is not listed.

    A bound of a control or a state becomes active or inactive where two points on it have two points off it as
    neighbours: there a singular arc, a saturated control or a constrained arc begins or ends.

    Parameters
    ----------
    phase
        The phase.
    flown
        Its segments in SI, in order.
    known
        Fractions of the phase at which joints lie already.
    p
        Record of all parameters in SI.
    """
    time = np.concatenate([s.time(s.control.points) for s in flown])
    fraction = (time - flown[0].begin) / (flown[-1].end - flown[0].begin)
    control = np.concatenate([s.control.values for s in flown])
    state = np.concatenate([s.state(s.control.points) for s in flown])
    # Places in the order of the points: i + 1/2 is between point i and the next.
    found = _bound_junctions(state, [s.limits(p) for s in phase.states], STATE_AT_BOUND)
    for at, bounded in scalars(phase.controls):
        if bounded.bounded:
            share = bounded.share(control[:, [at]], p)
            found |= _bound_junctions(share, [(0.0, 1.0)], AT_BOUND) | _control_jumps(share[:, 0])
    between = {int(np.searchsorted(fraction, joint)) - 0.5 for joint in known}
    return np.interp(sorted(found - between), np.arange(len(fraction)), fraction).tolist()


def _control_jumps(share: Vector) -> set[float]:
    """Return places where a control jumps, from its share of its range; two jumps to one side are one, at a point."""
    change = np.diff(share)
    jump = np.where(np.abs(change) > SWITCH, np.sign(change), 0.0)
    found, before = set[float](), -1
    for i in np.nonzero(jump)[0].tolist():
        if before == i - 1 and jump[before] == jump[i]:
            found = found - {before + 0.5} | {float(i)}
        else:
            found.add(i + 0.5)
        before = i
    return found


def _bound_junctions(values: Matrix, limits: Sequence[tuple[float, float]], within: float) -> set[float]:
    """Return places i + 1/2 where points i - 1, i lie at a bound and i + 1, i + 2 do not, or the other way round."""
    found: set[float] = set()
    for value, (lower, upper) in zip(values.T, limits, strict=True):
        reach = within * (upper - lower if math.isfinite(upper - lower) else float(np.ptp(value)))
        side = np.where(value > upper - reach, 1, np.where(value < lower + reach, -1, 0))
        met = (side[1:-2] != side[2:-1]) & (side[:-3] == side[1:-2]) & (side[2:-1] == side[3:])
        found |= set((np.nonzero(met)[0] + 1.5).tolist())
    return found


def refine_mesh(phase: Phase, mesh: Mesh, flown: Sequence[Segment], relative: Matrix, tolerance: float, p: Any) -> Mesh:
    """Refine the mesh of a phase for the next solve, by the errors of the last one.

    The mesh of a phase without length, which the optimum does without, stays as it is.

    Parameters
    ----------
    phase, mesh
        The phase and its last mesh.
    flown
        Its segments in SI, in order.
    relative
        Relative errors of the segments, (segments, states + conditions).
    tolerance
        Relative error that is asked for.
    p
        Record of all parameters in SI.
    """
    begin, total = flown[0].begin, flown[-1].end - flown[0].begin
    if not total > 0:
        return mesh
    joints = [0.0] + [(s.end - begin) / total for s in flown[:-1]] + [1.0]
    movable = {j for j, reach in zip(joints[1:-1], mesh.free, strict=True) if reach > 0}
    at_switches = find_switches(phase, flown, movable, p)
    new_joints, new_degrees = [0.0], []
    for a, b, segment, error in zip(joints[:-1], joints[1:], flown, relative.max(axis=1), strict=True):
        degree = len(segment.control.points)
        inside = [s for s in at_switches if a < s < b]
        if error <= tolerance:
            pieces, degrees = [b], [degree]
        elif inside:
            pieces = [*inside, b]
            degrees = [max(SWITCHED_DEGREE, math.ceil(degree / len(pieces)))] * len(pieces)
            movable |= set(inside)
        else:
            pieces, degrees = _enrich_segment(a, b, segment, float(error), tolerance)
        new_joints += pieces
        new_degrees += degrees
    return Mesh(
        degrees=tuple(new_degrees),
        joints=tuple(new_joints),
        free=_joint_reaches(new_joints, movable),
        pinned=_pinned_bounds(phase, flown, new_joints, movable, p),
    )


def _pinned_bounds(
    phase: Phase, flown: Sequence[Segment], joints: Sequence[float], movable: set[float], p: Any
) -> tuple[tuple[int, ...], ...]:
    """Return the bound at which each segment next to a free joint holds each bounded control: that of its middle."""
    begin, total = flown[0].begin, flown[-1].end - flown[0].begin
    fraction = np.concatenate([(s.time(s.control.points) - begin) / total for s in flown])
    values = np.concatenate([s.control.values for s in flown])
    pins = []
    for a, b in pairwise(joints):
        # A point next to a switch may hold a value in between.
        inside = np.nonzero((a < fraction) & (fraction < b))[0]
        near = inside[int(a in movable) : len(inside) - int(b in movable)]
        near = near if len(near) else np.argmin(np.abs(fraction - 0.5 * (a + b)), keepdims=True)
        row = [0] * len(phase.control_names)
        for at, control in scalars(phase.controls):
            if (a in movable or b in movable) and control.bounded:
                part = control.share(values[near, at], p)
                row[at] = -1 if (part < AT_BOUND).all() else 1 if (part > 1 - AT_BOUND).all() else 0
        pins.append(tuple(row))
    return tuple(pins)


def _enrich_segment(
    a: float, b: float, segment: Segment, error: float, tolerance: float
) -> tuple[list[float], list[int]]:
    degree = len(segment.control.points)
    more = math.log10(min(error, 1.0) / tolerance) / max(decay_rate(segment), 1e-3)
    raised = degree + max(2, math.ceil(more))
    if raised <= HIGHEST_DEGREE:
        return [b], [raised]
    half = max(LOWEST_DEGREE, min(degree, HALVED_DEGREE))
    return [0.5 * (a + b), b], [half, half]


def decay_rate(segment: Segment) -> float:
    """Return the digits by which the slowest Legendre coefficients of state and control fall from degree to degree."""
    slowest = math.inf
    for curve in (segment.state, segment.control):
        size = np.abs(curve.values).max(axis=0)
        kept = curve.values[:, size > 0] / size[size > 0]
        coefficients = np.abs(np.polynomial.legendre.legfit(curve.points, kept, len(curve.points) - 1))
        for a in coefficients.T:
            # The envelope from above, down to rounding, without the mean and slope that every curve has.
            envelope = np.maximum.accumulate(a[::-1])[::-1][1:]
            seen = np.nonzero(envelope > ROUNDING)[0]
            if len(seen) > 2:
                slowest = min(slowest, -float(np.polyfit(seen, np.log10(envelope[seen]), 1)[0]))
    return slowest if math.isfinite(slowest) else 1.0


def _joint_reaches(joints: Sequence[float], movable: set[float]) -> tuple[float, ...]:
    return tuple(
        REACH * min(joints[i] - joints[i - 1], joints[i + 1] - joints[i]) if joints[i] in movable else 0.0
        for i in range(1, len(joints) - 1)
    )
