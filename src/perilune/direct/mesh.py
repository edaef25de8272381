"""What a mesh costs in accuracy, measured by explicit simulation, and a better mesh.

Each segment is flown again from its own start, by SciPy's DOP853 on the user's numpy dynamics under the
control that the solution exports. The largest difference from the state polynomial is the error of the
segment, for each state, relative to 1 + max|x| in canonical units (Patterson, Rao 2014, section 4, but by
simulation instead of quadrature). What bounds of states and path and held conditions are exceeded by *between* the
points counts as an error as well.

A segment that is not accurate enough is split where a bounded control switches, and where a bound of a control
or a state is met or left: there arcs of another kind begin (Goddard's singular arc, a constrained arc). The new
joint is left free and a control that lies at a bound on one side is held there, so that the program finds the
time. Elsewhere
the decay of its Legendre coefficients, |a_i| ~ 10^(c - sigma i), tells what a higher degree would gain (Liu,
Hager, Rao 2015): the degree rises by log10(error/tolerance)/sigma, or the segment is halved where that would
exceed the largest degree in use, as it does at a kink.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from perilune.direct.collocation import Mesh
from perilune.direct.segments import Segment
from perilune.problem.controls import admissible, scalars
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.symbolic import state_scales
from perilune.words.types import Matrix, Vector

HIGHEST_DEGREE = 40
LOWEST_DEGREE = 5
HALVED_DEGREE = 10
SWITCHED_DEGREE = 8
# Legendre coefficients below this part of a curve's size are noise of the solve.
ROUNDING = 1e-11
# A control switches between two neighbouring points where it changes by more than this part of its range.
SWITCH = 0.4
# Within this part of its range from a bound a control is taken to be at it.
AT_BOUND = 0.02
# The same for a state, which the program holds to its bound far more closely.
STATE_AT_BOUND = 1e-5
# Of its canonical unit: a state that stays as small is simulated no more closely than one of this size.
NOTHING = 1e-3
# Distance to the next joint that a free joint may use up.
REACH = 0.45


def segment_error(phase: Phase, segment: Segment, p: Any, tolerance: float, sizes: Vector) -> Vector:
    """Error of each state and excess of each path and held condition [SI], shape (states + conditions,).

    `sizes` are the canonical units of the states. NaN where the simulation could not be flown to the end.
    """
    at = np.union1d(segment.state.points, np.linspace(-1.0, 1.0, 3 * len(segment.state.points)))
    x, u = segment.state(at), admissible(phase.controls, segment.control(at).T, p).T
    lower, upper = np.array([s.limits(p) for s in phase.states]).T
    outside = np.maximum(0.0, np.maximum(lower - x, x - upper)).max(axis=0)
    path = [np.maximum(0.0, -np.asarray(value)).max() for value in phase.evaluate("path", list(x.T), list(u.T), p)]
    held = [np.abs(value).max() for value in phase.evaluate("held", list(x.T), list(u.T), p)]
    return np.concatenate([np.maximum(_simulated(phase, segment, p, tolerance, at, x, sizes), outside), path, held])


def _simulated(
    phase: Phase, segment: Segment, p: Any, tolerance: float, at: Vector, expected: Matrix, sizes: Vector
) -> Vector:
    from scipy.integrate import solve_ivp

    def flow(t: float, x: Vector) -> Vector:
        u = admissible(phase.controls, segment.control(segment.tau(np.array([t]))).T, p)[:, 0]
        return np.array(phase.rates(list(x), list(u), p), dtype=float)

    flown = solve_ivp(
        flow, (segment.begin, segment.end), expected[0], "DOP853",
        np.clip(segment.time(at), segment.begin, segment.end),
        rtol=tolerance, atol=tolerance * np.maximum(np.abs(expected).max(axis=0), NOTHING * sizes),
    )  # fmt: skip
    if flown.y.shape[1] != len(at):
        return np.full(expected.shape[1], math.nan)
    return np.abs(flown.y.T - expected).max(axis=0)


def mesh_errors(problem: Problem, segments: Sequence[Sequence[Segment]], p: Any, tolerance: float) -> list[Matrix]:
    """Error of every segment [SI], for each phase an array (segments, states + conditions on the way).

    `tolerance` is the relative accuracy that is asked of the mesh.
    """
    fine = min(1e-8, max(1e-12, 1e-2 * tolerance))
    return [
        np.array([segment_error(phase, segment, p, fine, state_scales(problem, phase)) for segment in flown])
        for phase, flown in zip(problem.phases, segments, strict=True)
    ]


def relative_errors(problem: Problem, segments: Sequence[Sequence[Segment]], errors: Sequence[Matrix]) -> list[Matrix]:
    """The same relative to 1 + max|x| in canonical units; what cannot be flown counts as infinitely wrong."""
    found = []
    for phase, flown, error in zip(problem.phases, segments, errors, strict=True):
        largest = np.max([np.abs(s.state.values).max(axis=0) for s in flown], axis=0)
        along = [problem.size_of(c) for c in (*phase.path_conditions, *phase.held_conditions)]
        relative = error / np.concatenate([state_scales(problem, phase) + largest, along])
        found.append(np.where(np.isnan(relative), math.inf, relative))
    return found


def error_text(problem: Problem, errors: Sequence[Matrix]) -> str:
    """The largest error of each state and condition on the way of each phase, in SI, as one line."""
    return "; ".join(
        f"{phase.name}: " + ", ".join(
            f"{named.name} {value:.1e} {named.unit}".removesuffix(" 1")
            for named, value in zip(
                (*phase.states, *phase.path_conditions, *phase.held_conditions), error.max(axis=0), strict=True
            )
        )
        for phase, error in zip(problem.phases, errors, strict=True)
    )  # fmt: skip


def switches(phase: Phase, flown: Sequence[Segment], p: Any) -> list[float]:
    """Fractions of the phase, between neighbouring collocation points, where a control jumps or a bound is met or left.

    A bound of a control or a state is met or left where two points on it have two points off it as neighbours: there a
    singular arc, a saturated control or a constrained arc begins or ends.
    """
    time = np.concatenate([s.time(s.control.points) for s in flown])
    fraction = (time - flown[0].begin) / (flown[-1].end - flown[0].begin)
    control = np.concatenate([s.control.values for s in flown])
    state = np.concatenate([s.state(s.control.points) for s in flown])
    found = _met(state, [s.limits(p) for s in phase.states], STATE_AT_BOUND)
    for at, bounded in scalars(phase.controls):
        if bounded.bounded:
            share = bounded.share(control[:, [at]], p)
            jump = np.abs(np.diff(share[:, 0])) > SWITCH
            found |= _met(share, [(0.0, 1.0)], AT_BOUND) | set(np.nonzero(jump)[0].tolist())
    return [float(0.5 * (fraction[i] + fraction[i + 1])) for i in sorted(found)]


def _met(values: Matrix, limits: Sequence[tuple[float, float]], within: float) -> set[int]:
    """Indices i such that points i - 1, i lie at a bound and i + 1, i + 2 do not, or the other way round."""
    found: set[int] = set()
    for value, (lower, upper) in zip(values.T, limits, strict=True):
        reach = within * (upper - lower if math.isfinite(upper - lower) else float(np.ptp(value)))
        side = np.where(value > upper - reach, 1, np.where(value < lower + reach, -1, 0))
        met = (side[1:-2] != side[2:-1]) & (side[:-3] == side[1:-2]) & (side[2:-1] == side[3:])
        found |= set((np.nonzero(met)[0] + 1).tolist())
    return found


def refined(phase: Phase, mesh: Mesh, flown: Sequence[Segment], relative: Matrix, tolerance: float, p: Any) -> Mesh:
    """A mesh for the next solve; `relative` (segments, states) are the errors of the last one, p all parameters."""
    begin, total = flown[0].begin, flown[-1].end - flown[0].begin
    joints = [0.0] + [(s.end - begin) / total for s in flown[:-1]] + [1.0]
    movable = {j for j, reach in zip(joints[1:-1], mesh.free, strict=True) if reach > 0}
    at_switches = switches(phase, flown, p)
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
            pieces, degrees = _enriched(a, b, segment, float(error), tolerance)
        new_joints += pieces
        new_degrees += degrees
    return Mesh(
        degrees=tuple(new_degrees),
        joints=tuple(new_joints),
        free=_reaches(new_joints, movable),
        pinned=_pins(phase, flown, new_joints, movable, p),
    )


def _pins(
    phase: Phase, flown: Sequence[Segment], joints: Sequence[float], movable: set[float], p: Any
) -> tuple[tuple[int, ...], ...]:
    """Bound at which each segment next to a free joint holds each bounded control: that of its middle."""
    begin, total = flown[0].begin, flown[-1].end - flown[0].begin
    fraction = np.concatenate([(s.time(s.control.points) - begin) / total for s in flown])
    values = np.concatenate([s.control.values for s in flown])
    pins = []
    for a, b in pairwise(joints):
        # Points beside a switch hold values in between.
        inner = np.sort(np.abs(fraction - 0.5 * (a + b)))[: max(1, int(((a < fraction) & (fraction < b)).sum()) - 2)]
        near = np.abs(fraction - 0.5 * (a + b)) <= inner[-1]
        row = [0] * len(phase.control_names)
        for at, control in scalars(phase.controls):
            if (a in movable or b in movable) and control.bounded:
                part = control.share(values[near, at], p)
                row[at] = -1 if (part < AT_BOUND).all() else 1 if (part > 1 - AT_BOUND).all() else 0
        pins.append(tuple(row))
    return tuple(pins)


def _enriched(a: float, b: float, segment: Segment, error: float, tolerance: float) -> tuple[list[float], list[int]]:
    degree = len(segment.control.points)
    more = math.log10(min(error, 1.0) / tolerance) / max(decay_rate(segment), 1e-3)
    raised = degree + max(2, math.ceil(more))
    if raised <= HIGHEST_DEGREE:
        return [b], [raised]
    half = max(LOWEST_DEGREE, min(degree, HALVED_DEGREE))
    return [0.5 * (a + b), b], [half, half]


def decay_rate(segment: Segment) -> float:
    """Digits by which the slowest Legendre coefficients of state and control fall from degree to degree."""
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


def _reaches(joints: Sequence[float], movable: set[float]) -> tuple[float, ...]:
    return tuple(
        REACH * min(joints[i] - joints[i - 1], joints[i + 1] - joints[i]) if joints[i] in movable else 0.0
        for i in range(1, len(joints) - 1)
    )
