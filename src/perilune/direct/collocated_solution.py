"""Segments of a collocated answer: polynomials of state, control and costate, in SI, and the covector mapping.

Covector mapping, from the Lagrangian J + Lambda.(defects) + M.(quadrature) + rho.(start) + nu.(end):

    lam_i = -(Lambda_i / w_i + M),   lam(end) = -M                    gauss  (Benson et al. 2006)
    lam_i = -Lambda_i / w_i,         lam(end) = -sum_i D_i,end Lambda_i   radau  (Garg et al. 2010)
    lam(start of phase) = -rho,      nu as it is

which is the sign convention of `perilune.conditions.pontryagin`, lambda(t0) = dJ*/dx(t0).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector
from perilune.direct.collocation import Polynomial, Rule
from perilune.direct.layout import PhaseValues
from perilune.direct.nlp import ProgramSolution, TranscribedProgram
from perilune.problem import (
    Curve,
    Phase,
    Problem,
    Trajectory,
    admissible,
    admissible_rates,
    control_scales,
    hermite_nodes,
    state_scales,
)

# Curves are never asked for more than this, canonical: rounding of the polynomials is near.
FINEST = 1e-11
# State and control [SI] at fractions of a phase: what a first guess is read from.
Sampler = Callable[[Vector], tuple[Matrix, Matrix]]


@dataclass(frozen=True, kw_only=True)
class Segment:
    """One segment of a solution in SI: times [s] and polynomials in tau of state, control and costate."""

    begin: float
    end: float
    state: Polynomial
    control: Polynomial
    costate: Polynomial

    def tau(self, t: Vector) -> Vector:
        """Return the place of times t on [-1, 1]."""
        # A segment of no length (a phase that the optimum does without) has its start only.
        width = self.end - self.begin or 1.0
        return 2.0 * (np.asarray(t, dtype=float) - self.begin) / width - 1.0

    def time(self, tau: Vector) -> Vector:
        """Return the times of places on [-1, 1]."""
        return self.begin + 0.5 * (np.asarray(tau) + 1.0) * (self.end - self.begin)


def _costate(r: Rule, rows: dict[str, Vector], states: int, segment: int, node: int) -> Polynomial:
    """Return the canonical costate of one segment, whose points start at `node`, from the multipliers of its rows."""
    Lambda = rows["defect"].reshape(-1, states)[node : node + r.degree]
    if r.scheme == "gauss":
        M = rows["quadrature"].reshape(-1, states)[segment]
        inner, end = -(Lambda / r.weights[:, None] + M), -M
    else:
        inner, end = -Lambda / r.weights[:, None], -r.differentiation[:, -1] @ Lambda
    return Polynomial(points=np.append(r.points, 1.0), values=np.vstack([inner, end]))


def flown_segments(program: TranscribedProgram, answer: ProgramSolution) -> list[list[Segment]]:
    """Return segments of every phase in SI, with costates in J per unit.

    Parameters
    ----------
    program
        The transcribed problem.
    answer
        Its solution with multipliers, canonical.
    """
    problem, found = program.problem, []
    p = problem.parameters(answer.free_si(problem))
    objective_scale = problem.objective_size
    for k, (phase, layout, values) in enumerate(zip(problem.phases, program.layouts, answer.phases, strict=True)):
        x_scale, u_scale = state_scales(problem, phase), control_scales(phase.controls, problem.scales)
        rows = {kind: answer.rows[k, kind] for kind in ("defect", "quadrature")}
        times, node, segments = values.joints * getattr(p, phase.duration), 0, []
        for i, (r, first) in enumerate(zip(layout.rules, layout.starts, strict=False)):
            lam = _costate(r, rows, layout.states, i, node)
            segments.append(
                Segment(
                    begin=float(times[i]),
                    end=float(times[i + 1]),
                    state=Polynomial(points=r.support, values=values.state[first : first + r.degree + 1] * x_scale),
                    control=Polynomial(points=r.points, values=values.control[node : node + r.degree] * u_scale),
                    costate=Polynomial(points=lam.points, values=lam.values * objective_scale / x_scale),
                )
            )
            node += r.degree
        found.append(segments)
    return found


def sampler(flown: Sequence[Segment]) -> Sampler:
    """Return a function for state and control [SI] at fractions of the phase: the first guess on another mesh."""
    ends = np.array([s.end for s in flown])
    begin, total = flown[0].begin, flown[-1].end - flown[0].begin

    def sample(fraction: Vector) -> tuple[Matrix, Matrix]:
        time = begin + np.asarray(fraction) * total
        which = np.clip(np.searchsorted(ends, time, side="left"), 0, len(flown) - 1)
        state = np.empty((len(time), flown[0].state.values.shape[1]))
        control = np.empty((len(time), flown[0].control.values.shape[1]))
        for k, segment in enumerate(flown):
            here = which == k
            tau = segment.tau(time[here])
            state[here], control[here] = segment.state(tau), segment.control(tau)
        return state, control

    return sample


def sample_guess(program: TranscribedProgram, samplers: Sequence[Sampler]) -> tuple[PhaseValues, ...]:
    """Return the first values of a program's unknowns from one sampler for each phase.

    Parameters
    ----------
    program
        The program.
    samplers
        State and control [SI] at fractions of each phase.
    """
    problem, p, found = program.problem, program.problem.parameters({}), []
    for phase, mesh, layout, sample in zip(problem.phases, program.meshes, program.layouts, samplers, strict=True):
        joints = np.array(mesh.joints)
        ends = list(zip(joints[:-1], joints[1:], layout.rules, strict=True))
        # All points of a segment but its end, which is the next segment's start.
        at_state = [a + 0.5 * (b - a) * (np.concatenate([[-1.0], r.points[1 - r.first :]]) + 1.0) for a, b, r in ends]
        at_control = [a + 0.5 * (b - a) * (r.points + 1.0) for a, b, r in ends]
        state = sample(np.concatenate([*at_state, [1.0]]))[0] / state_scales(problem, phase)
        control = sample(np.concatenate(at_control))[1]
        found.append(
            PhaseValues(
                joints=joints,
                state=state,
                control=admissible(phase.controls, control.T, p).T / control_scales(phase.controls, problem.scales),
            )
        )
    return tuple(found)


def interpolate_segments(problem: Problem, k: int, flown: Sequence[Segment], tolerance: float) -> Trajectory:
    """Return curves of phase k, interpolated within `tolerance` (canonical; costates ten times that).

    A joint at which a curve is not smooth is there twice, with the values of either side.

    Parameters
    ----------
    problem, k
        The problem and the number of the phase.
    flown
        Its segments in SI, in order.
    tolerance
        Largest error of interpolation, canonical.
    """
    phase = problem.phases[k]
    n, width = len(phase.states), len(phase.control_names)
    x_scale = state_scales(problem, phase)
    lam_scale = problem.objective_size / x_scale
    fine = max(tolerance, FINEST) * np.concatenate(
        [x_scale, np.full(n, 10.0) * lam_scale, control_scales(phase.controls, problem.scales)]
    )
    # A free joint may have moved all the way to the next.
    lasting = [segment for segment in flown if segment.end > segment.begin] or flown[:1]
    pieces = [_hermite_segment_nodes(phase, segment, fine, problem.parameters({})) for segment in lasting]
    time = np.concatenate([t for t, _, _ in pieces])
    values, rates = (np.concatenate([piece[i] for piece in pieces]) for i in (1, 2))
    keep = np.ones(len(time), dtype=bool)
    for left in np.cumsum([len(t) for t, _, _ in pieces])[:-1] - 1:
        jump = np.abs(values[left + 1] - values[left]) > fine
        keep[left] = bool(jump.any())
        time[left] = time[left + 1]
    time, values, rates = time[keep], values[keep], rates[keep]
    state, costate, control = (
        Curve(time=time, values=values[:, at], rates=rates[:, at])
        for at in np.split(np.arange(2 * n + width), [n, 2 * n])
    )
    return Trajectory(phase=phase.name, state=state, control=control, costate=costate)


def _hermite_segment_nodes(phase: Phase, segment: Segment, fine: Vector, p: Any) -> tuple[Vector, Matrix, Matrix]:
    """Return times, values and rates of state, costate and control along one segment."""
    slope = 2.0 / (segment.end - segment.begin or 1.0)
    parts = (segment.state, segment.costate, segment.control)

    def evaluate(t: Vector) -> tuple[Matrix, Matrix]:
        tau = segment.tau(segment.begin + t)
        values, slopes = (list(both) for both in zip(*(part.with_slopes(tau) for part in parts), strict=True))
        rates = [slope * rate for rate in slopes]
        values[2], rates[2] = (a.T for a in admissible_rates(phase.controls, values[2].T, rates[2].T, p))
        return np.hstack(values), np.hstack(rates)

    t, *_ = hermite_nodes(evaluate, segment.end - segment.begin, fine)
    return segment.begin + t, *evaluate(t)  # all at once: products of matrices round by how many points there are
