"""Error of a mesh, measured by simulation.

Each segment is integrated again from its own start, by the user's numpy dynamics under the control that the solution
exports. The largest difference from the state polynomial X is the error of the segment, for each state, relative to
1 + max|x| in canonical units (Patterson, Rao 2014, section 4, but by simulation instead of one quadrature). What bounds
of states and path and held conditions are exceeded by *between* the points counts as an error as well.

All segments fly at once: with twice as many Gauss points as the segment has, Picard's iteration

    x <- X(start) + integral of f(x, u)

ends at the flight of order four times the degree (Bai, Junkins 2011), a handful of evaluations of whole arrays.
Where it does not, as along a steep entry in one segment, SciPy's DOP853 flies the segment step by step, as far as
`EVALUATIONS` lead: beyond them the polynomial of an answer that was not found says nothing of where it would fly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector
from perilune.direct.collocated_solution import Segment
from perilune.direct.collocation import Rule, rule
from perilune.problem import Phase, Problem, admissible, full, state_scales

# Most iterations of Picard's; the k-th adds (L h)^k/k! of the error, L the Lipschitz constant and h the length.
PICARD = 40
# Of its canonical unit: a state that stays as small is simulated no more closely than one of this size.
NOTHING = 1e-3
# Of the rates of one segment that is flown step by step: some thousand steps.
EVALUATIONS = 12_000


class _TooManySteps(Exception):
    """A segment that takes more steps than are given to it."""


@dataclass(frozen=True, kw_only=True)
class _QuadratureSegment:
    """One segment at the points it is flown through: [-1, Gauss points, 1]."""

    segment: Segment
    rule: Rule
    at: Vector
    x: Matrix
    u: Matrix

    @property
    def half(self) -> float:
        """Half its length [s]."""
        return 0.5 * (self.segment.end - self.segment.begin)

    def propagate(self, rates: Matrix) -> Matrix:
        """Return X(start) and the integrals of rates at the Gauss points, shape (points, states)."""
        inside = self.half * (self.rule.integration @ rates)
        return self.x[0] + np.vstack([np.zeros_like(inside[:1]), inside, self.half * (self.rule.weights @ rates)])


def _quadrature_segment(phase: Phase, segment: Segment, p: Any) -> _QuadratureSegment:
    fine = rule("gauss", 2 * len(segment.control.points))
    at = np.append(fine.support, 1.0)
    return _QuadratureSegment(
        segment=segment, rule=fine, at=at, x=segment.state(at),
        u=admissible(phase.controls, segment.control(at).T, p).T,
    )  # fmt: skip


def mesh_errors(problem: Problem, segments: Sequence[Sequence[Segment]], p: Any, tolerance: float) -> list[Matrix]:
    """Return the error of every segment [SI], for each phase an array (segments, states + conditions on the way).

    NaN where the simulation could not be flown to the end. `tolerance` is the relative accuracy that is asked of the
    mesh.

    Parameters
    ----------
    problem
        The problem.
    segments
        Segments of each phase in SI.
    p
        Record of all parameters in SI.
    tolerance
        Relative accuracy that is asked of the mesh.
    """
    fine = min(1e-8, max(1e-12, 1e-2 * tolerance))
    return [
        _phase_errors(phase, flown, p, fine, NOTHING * state_scales(problem, phase))
        for phase, flown in zip(problem.phases, segments, strict=True)
    ]


def _phase_errors(phase: Phase, flown: Sequence[Segment], p: Any, tolerance: float, least: Vector) -> Matrix:
    """Return the errors of one phase, whose states are flown no more closely than if they had the `least` sizes."""
    pieces = [_quadrature_segment(phase, segment, p) for segment in flown]
    lower, upper = np.array([s.limits(p) for s in phase.states]).T
    errors = []
    for piece, error in zip(pieces, _simulated(phase, pieces, p, tolerance, least), strict=True):
        x = piece.x
        outside = np.maximum(0.0, np.maximum(lower - x, x - upper)).max(axis=0)
        path, held = (phase.evaluate(name, list(x.T), list(piece.u.T), p) for name in ("path", "held"))
        excess = [np.maximum(0.0, -np.asarray(value)).max() for value in path]
        errors.append(np.concatenate([np.maximum(error, outside), excess, [np.abs(value).max() for value in held]]))
    return np.array(errors)


def _simulated(
    phase: Phase, pieces: Sequence[_QuadratureSegment], p: Any, tolerance: float, least: Vector
) -> list[Vector]:
    """Return the largest difference of each state from its polynomial on each piece."""
    fine = tolerance * np.maximum(np.max([np.abs(piece.x).max(axis=0) for piece in pieces], axis=0), least)
    x = [piece.x for piece in pieces]
    u = np.concatenate([piece.u[1:-1] for piece in pieces])
    left = [math.inf] * len(pieces)
    for _ in range(PICARD):
        inner = np.concatenate([values[1:-1] for values in x])
        with np.errstate(all="ignore"):  # where it leaves what the physics is defined for, it is flown step by step
            rates = phase.rates(list(inner.T), list(u.T), p)
            rates = np.column_stack([full(rate, inner[:, 0]) for rate in rates])
            split = np.split(rates, np.cumsum([len(piece.rule.points) for piece in pieces])[:-1])
            later = [piece.propagate(rate) for piece, rate in zip(pieces, split, strict=True)]
            left = [
                _last_relative_change(piece, before, after, fine)
                for piece, before, after in zip(pieces, x, later, strict=True)
            ]
        x = later
        if not max(left) > 1.0:
            break
    return [
        np.abs(values - piece.x).max(axis=0)
        if moved <= 1.0
        else _simulate_adaptively(phase, piece, p, tolerance, least)
        for piece, values, moved in zip(pieces, x, left, strict=True)
    ]


def _last_relative_change(piece: _QuadratureSegment, before: Matrix, after: Matrix, fine: Vector) -> float:
    """Return the last change of a flight, relative to what is asked of it, or to a thousandth of the error if more."""
    error = np.abs(after - piece.x).max(axis=0)
    return float(np.max(np.abs(after - before) / np.maximum(fine, 1e-3 * error)))


def _simulate_adaptively(phase: Phase, piece: _QuadratureSegment, p: Any, tolerance: float, least: Vector) -> Vector:
    """Return the largest difference of each state from its polynomial on one piece, by SciPy."""
    from scipy.integrate import solve_ivp

    segment = piece.segment
    if not segment.end > segment.begin:  # of an answer that runs backwards, or has no length: it cannot be flown
        return np.full(piece.x.shape[1], math.nan)

    left = iter(range(EVALUATIONS))

    def flow(t: float, x: Vector) -> Vector:
        if next(left, None) is None:
            raise _TooManySteps
        u = admissible(phase.controls, segment.control(segment.tau(np.array([t]))).T, p)[:, 0]
        return np.array(phase.rates(list(x), list(u), p), dtype=float)

    try:
        flown = solve_ivp(
            flow, (segment.begin, segment.end), piece.x[0], "DOP853",
            np.clip(segment.time(piece.at), segment.begin, segment.end),
            rtol=tolerance, atol=tolerance * np.maximum(np.abs(piece.x).max(axis=0), least),
        )  # fmt: skip
    except _TooManySteps:
        return np.full(piece.x.shape[1], math.nan)
    if len(flown.t) != len(piece.at):  # SciPy gives no array where not one step succeeds
        return np.full(piece.x.shape[1], math.nan)
    return np.abs(flown.y.T - piece.x).max(axis=0)


def relative_errors(problem: Problem, segments: Sequence[Sequence[Segment]], errors: Sequence[Matrix]) -> list[Matrix]:
    """Return errors relative to 1 + max|x| in canonical units; what cannot be flown counts as infinitely wrong.

    Parameters
    ----------
    problem, segments
        As for `mesh_errors`.
    errors
        What `mesh_errors` returns.
    """
    found = []
    for phase, flown, error in zip(problem.phases, segments, errors, strict=True):
        largest = np.max([np.abs(s.state.values).max(axis=0) for s in flown], axis=0)
        along = [problem.size_of(c) for c in (*phase.path_conditions, *phase.held_conditions)]
        relative = error / np.concatenate([state_scales(problem, phase) + largest, along])
        found.append(np.where(np.isnan(relative), math.inf, relative))
    return found


def error_text(problem: Problem, errors: Sequence[Matrix]) -> str:
    """Format the largest error of each state and condition on the way of each phase, in SI, as one line.

    Parameters
    ----------
    problem
        The problem, with the names and units of its states and conditions.
    errors
        For each phase the errors of its segments [SI], shape (segments, states and conditions).
    """
    return "; ".join(
        f"{phase.name}: " + ", ".join(
            f"{named.name} {value:.1e} {named.unit}".removesuffix(" 1")
            for named, value in zip(
                (*phase.states, *phase.path_conditions, *phase.held_conditions), error.max(axis=0), strict=True
            )
        )
        for phase, error in zip(problem.phases, errors, strict=True)
    )  # fmt: skip
