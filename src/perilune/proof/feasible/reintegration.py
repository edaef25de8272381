"""Independent re-integration of every phase by its exported control, twice by Gauss's collocation.

In steps of its own choice from break to break (`gauss_steps`): an integrator that knows nothing of the states that are
claimed. And on all pieces of the tables at once, with order 8: one Newton step from the tables themselves.
With y the table and y + d what is flown, on a piece from a with Butcher's matrix a_jk at its points

    d_j = d(a) + [y(a) + h sum_k a_jk f(y_k) - y_j] + h sum_k a_jk f_y(y_k) d_k

in which the bracket is the defect of the table by quadrature; d at the end of the piece, with what the table itself
jumps there, begins the next. So a thousand gaps, each too small to see, add up as they do in flight. What Newton's step
leaves is of order d^2, below rounding where d passes. The costates lam' = -dH/dx are carried along likewise.
Source: Hairer, Noersett, Wanner (1993), II.7.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count, pairwise
from typing import Any

import numpy as np

from perilune.core import COMPLEX, NUMERIC, Matrix, Vector, sign_of_life, stack_broadcast
from perilune.problem import Curve, Solution, normalised
from perilune.proof.feasible.branch_guards import watched_rates
from perilune.proof.feasible.deviations import MOST_GROWTH, state_deviation
from perilune.proof.feasible.gauss_steps import integrate_by_gauss
from perilune.proof.feasible.phase_data import PhaseData, phase_data_of, slopes_at_end
from perilune.proof.feasible.sample_points import ENDS, POINTS, cubics, polynomial, time_just_before

MOST_EVALUATIONS = 30_000  # in a phase, of all points of a step at once: the examples take 30 to 600
_ALIVE = 64  # evaluations from one sign of life to the next


@dataclass(frozen=True, kw_only=True)
class Reintegration:
    """Re-integration of one phase.

    Attributes
    ----------
    ends
        Final states [SI], by steps and on the pieces of the tables: NaN where there is none.
    inside
        States at the points of the pieces, by the second [SI], (n, N, 4).
    at_ends
        The same at both ends of all pieces, (n, N, 2).
    difference
        Largest difference of each state to its table, scaled, of both flights, (n,).
    growth
        By how much the flight multiplies errors of its states, (n,), each at least 1: the conditioning of the problem,
        which the limits follow.
    grown
        The same at the end of the phase.
    begun
        What errors of the phases before are as it begins, (n,), each at least 1.
    """

    ends: tuple[Vector, Vector]
    inside: Matrix
    at_ends: Matrix
    difference: Vector
    growth: Vector
    grown: Vector
    begun: Vector


def initial_state(solution: Solution, index: int, before: Vector | None) -> Vector:
    """Return the initial state of a phase: from `start`, or by the link from the end state of the phase before.

    Parameters
    ----------
    solution
        A solution with trajectories.
    index
        Number of the phase.
    before
        End state of the phase before [SI], (n,); None for the first phase.

    Returns
    -------
    Vector
        State [SI], (n,).
    """
    problem, p = solution.problem, solution.parameters
    if before is None:
        values = problem.start(p, NUMERIC)
    else:
        values = problem.links[index - 1](problem.phases[index - 1].state_record(*before), p, NUMERIC)
    return np.array([float(v) for v in values])


def reintegrate(solution: Solution) -> list[tuple[PhaseData, Reintegration]]:
    """Re-integrate every phase, each from the end of the one before."""
    flown: list[tuple[PhaseData, Reintegration]] = []
    ends: tuple[Vector | None, Vector | None] = None, None
    for k, arc in enumerate(phase_data_of(solution)):
        by_steps, by_pieces = (initial_state(solution, k, end) for end in ends)
        before = error_growth_at_end(*flown[-1], arc) if flown else np.ones(len(arc.state_scale))
        flight = reintegrate_phase(arc, by_steps, by_pieces, before)
        flown.append((arc, flight))
        ends = flight.ends
    return flown


def error_growth_at_end(arc: PhaseData, flight: Reintegration, after: PhaseData) -> Vector:
    """Return the errors of the phases so far as the next one begins, at least 1, scaled by its sizes.

    Parameters
    ----------
    arc
        Phase that ends at a link.
    flight
        Its re-integration, with the growth of errors over it.
    after
        The next phase, whose start the link gives.
    """
    link, record = arc.problem.links[arc.index], arc.phase.state_record
    slopes = slopes_at_end(arc, lambda z: link(record(*z), arc.p, COMPLEX)) / after.state_scale[:, None]
    return np.clip(np.abs(slopes) @ flight.grown, 1.0, MOST_GROWTH)


def reintegrate_phase(
    arc: PhaseData, by_steps: Vector, by_pieces: Vector, before: Vector | None = None
) -> Reintegration:
    """Fly a phase by the exported control.

    Parameters
    ----------
    arc
        The phase.
    by_steps, by_pieces
        Initial states in SI, shape (n,), of the one flight and of the other.
    before
        What errors of the phases before are as it begins, (n,).
    """
    scale = arc.state_scale
    end, apart = integrate_by_steps(arc, by_steps)
    deviation = state_deviation(arc, by_pieces, before)
    inside, at_ends = (
        arc.read(arc.looked_at[0], shares)[0] + scale[:, None, None] * d
        for shares, d in ((POINTS, deviation.inside), (ENDS, deviation.ends))
    )
    return Reintegration(
        ends=(end, at_ends[:, -1, 1]), inside=inside, at_ends=at_ends,
        difference=np.maximum(apart, deviation.largest),
        growth=np.minimum(deviation.growth, MOST_GROWTH), grown=np.minimum(deviation.at_end, MOST_GROWTH),
        begun=np.ones(len(scale)) if before is None else before,
    )  # fmt: skip


def integrate_by_steps(arc: PhaseData, x0: Vector) -> tuple[Vector, Vector]:
    """Return the end of the flight [SI] and its largest difference to the table, scaled; both (n,).

    The integrator restarts at each break of the control and each kink of the physics; NaN where it gives up, as its
    steps are too short or too many. Compared are the points of all its steps.

    Parameters
    ----------
    arc
        The phase.
    x0
        Initial state [SI], (n,).
    """
    phase, p, x, scale = arc.phase, arc.p, x0, arc.state_scale
    apart, evaluations = np.zeros(len(x0)), count()
    controls = smooth_pieces(arc.trajectory.control)
    for left, right in pairwise(arc.edges.tolist()):
        curve = controls[int(np.searchsorted(arc.breaks, left, side="right"))]
        control_at, held = read_often(curve), arc.answers(0.5 * (left + right))

        def equations(t: Vector, control_at: Any = control_at, held: Vector = held) -> Callable[[Matrix], Any]:
            u = normalised(phase.controls, control_at(t))

            def rates(X: Matrix) -> Any:
                if (number := next(evaluations)) % _ALIVE == 0:
                    sign_of_life("proof: independent re-integration")
                if number > MOST_EVALUATIONS:
                    return np.full(X.shape, np.nan)  # which no step is short enough for
                if len(held):
                    # From kink to kink on its own side, which goes on smoothly where a step looks beyond.
                    return watched_rates(phase, X, u, p, held)[0].real
                return stack_broadcast(phase.rates(X, u, p), t.shape, float)

            return rates

        if not np.isfinite(x).all():
            raise ArithmeticError("the flight starts at a state that is not a number")
        with np.errstate(all="ignore"):
            flown = integrate_by_gauss(equations, (left, right), x, scale, curve.time)
        if flown is None:
            return np.full(len(x0), np.nan), np.full(len(x0), np.nan)
        (t, states), x = flown, flown[1][:, -1]
        table = arc.state(np.append(t[:-1], time_just_before(t[-1:])))
        apart = np.maximum(apart, (np.abs(states - table) / scale[:, None]).max(axis=1))
    return x, apart


def smooth_pieces(curve: Curve) -> list[Curve]:
    """The parts of a table between the times that stand in it twice, with the values of either side."""
    cut = np.nonzero(np.diff(curve.time) == 0)[0] + 1
    parts = (np.split(a, cut) for a in (curve.time, curve.values, curve.rates))
    return [Curve(time=t, values=v, rates=r) for t, v, r in zip(*parts, strict=True)]


def read_often(curve: Curve) -> Callable[[Vector], Matrix]:
    """Return a function of times that reads a table without breaks, (components, times): cubics are made once."""
    nodes, widths = curve.time, np.diff(curve.time)
    own = cubics(curve, np.arange(len(widths)))

    def read(t: Vector) -> Matrix:
        i = np.minimum(np.maximum(nodes.searchsorted(t, side="right") - 1, 0), len(widths) - 1)
        return polynomial(own[:, i], (t - nodes[i]) / widths[i])

    return read
