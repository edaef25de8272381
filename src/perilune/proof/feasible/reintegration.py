"""Independent re-integration of every phase by its exported control: SciPy's DOP853, and Gauss's collocation.

By SciPy's DOP853 from break to break, with steps of its own choice: an integrator that knows nothing of the tables.
And by Gauss's collocation of order 8 on all pieces of the tables at once: one Newton step from the tables themselves.
With y the table and y + d what is flown, on a piece from a with Butcher's matrix a_jk at its points

    d_j = d(a) + [y(a) + h sum_k a_jk f(y_k) - y_j] + h sum_k a_jk f_y(y_k) d_k

in which the bracket is the defect of the table by quadrature; d at the end of the piece, with what the table itself
jumps there, begins the next. So a thousand gaps, each too small to see, add up as they do in flight. What Newton's step
leaves is of order d^2, below rounding where d passes. The costates lam' = -dH/dx are carried along likewise.
Source: Hairer, Noersett, Wanner (1993), II.7 and II.1.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count, pairwise
from typing import Any

import numpy as np

from perilune.core import COMPLEX, NUMERIC, Matrix, Vector, sign_of_life
from perilune.problem import Curve, Phase, Solution, directions
from perilune.proof.feasible.branch_guards import watched_rates
from perilune.proof.feasible.deviations import MOST_GROWTH, state_deviation
from perilune.proof.feasible.phase_data import PhaseData, slopes_at_end
from perilune.proof.feasible.sample_points import ENDS, cubics, time_just_before

_TOLERANCE = 1e-13  # of SciPy's integrator, relative and in canonical units
MOST_EVALUATIONS = 300_000  # of the equations of motion in one phase; the examples take 130 to 250
_ALIVE = 256  # evaluations from one sign of life to the next


@dataclass(frozen=True, kw_only=True)
class Reintegration:
    """Re-integration of one phase.

    Attributes
    ----------
    ends
        Final states [SI], by SciPy and by collocation: NaN where there is none.
    inside
        States at the points of the pieces, by collocation [SI], (n, N, 4).
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
    for k in range(len(solution.problem.phases)):
        arc = PhaseData(solution=solution, index=k)
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
    pieces, curve = arc.looked_at[0], arc.trajectory.state
    inside, at_ends = (
        pieces.read(curve, *shares) + scale[:, None, None] * d
        for shares, d in (((), deviation.inside), ((ENDS,), deviation.ends))
    )
    return Reintegration(
        ends=(end, at_ends[:, -1, 1]), inside=inside, at_ends=at_ends,
        difference=np.maximum(apart, deviation.largest),
        growth=np.minimum(deviation.growth, MOST_GROWTH), grown=np.minimum(deviation.at_end, MOST_GROWTH),
        begun=np.ones(len(scale)) if before is None else before,
    )  # fmt: skip


def integrate_by_steps(arc: PhaseData, x0: Vector) -> tuple[Vector, Vector]:
    """The end of SciPy's flight [SI], and the largest difference to the table at its steps, scaled; both (n,).

    The integrator restarts at each break of the control and each kink of the physics; NaN where it gives up.

    Parameters
    ----------
    arc
        The phase.
    x0
        Initial state [SI], (n,).
    """
    from scipy.integrate import solve_ivp

    phase, p, x, scale = arc.phase, arc.p, x0, arc.state_scale
    apart, evaluations = np.zeros(len(x0)), count()
    controls = smooth_pieces(arc.trajectory.control)
    for left, right in pairwise(arc.edges):
        control = exported_control(phase, controls[int(np.searchsorted(arc.breaks, left, side="right"))])
        held = arc.answers(0.5 * (left + right))

        def rates(t: float, x: Vector, control: Any = control, held: Vector = held) -> Any:
            if (number := next(evaluations)) % _ALIVE == 0:
                sign_of_life("proof: independent re-integration")
            if number > MOST_EVALUATIONS:
                raise ArithmeticError(f"the re-integration needs more than {MOST_EVALUATIONS} evaluations")
            if not len(held):
                return phase.rates(x.tolist(), control(t), p)
            # From kink to kink on its own side, which goes on smoothly where a step looks beyond.
            return watched_rates(phase, x, np.array(control(t)), p, held)[0].real

        if not np.isfinite(x).all():
            raise ArithmeticError("the flight starts at a state that is not a number")
        with np.errstate(all="ignore"):
            flown = solve_ivp(rates, (left, right), x, method="DOP853", rtol=_TOLERANCE, atol=_TOLERANCE * scale)
        if not flown.success:
            return np.full(len(x0), np.nan), np.full(len(x0), np.nan)
        table = arc.state(np.append(flown.t[:-1], time_just_before(flown.t[-1:])))
        apart, x = np.maximum(apart, (np.abs(flown.y - table) / scale[:, None]).max(axis=1)), flown.y[:, -1]
    return x, apart


def smooth_pieces(curve: Curve) -> list[Curve]:
    """The parts of a table between the times that stand in it twice, with the values of either side."""
    cut = np.nonzero(np.diff(curve.time) == 0)[0] + 1
    parts = (np.split(a, cut) for a in (curve.time, curve.values, curve.rates))
    return [Curve(time=t, values=v, rates=r) for t, v, r in zip(*parts, strict=True)]


def exported_control(phase: Phase, curve: Curve) -> Callable[[float], list[float]]:
    """The control as a piece of its file describes it: cubic Hermite, then a direction normalised.

    Plain floats, as the flight calls it a thousand times for one value each.

    Parameters
    ----------
    phase
        Phase with the controls.
    curve
        Table of the control [SI] over the time from the start of the phase [s].

    Returns
    -------
    callable
        ``control_at(t)``, with t in seconds, returns the components of the control [SI].
    """
    pieces = cubics(curve, np.arange(len(curve.time) - 1)).swapaxes(0, 1).tolist()
    nodes, widths = curve.time.tolist(), np.diff(curve.time).tolist()
    interior, groups = nodes[1:-1], directions(phase.controls)

    def control_at(t: float) -> list[float]:
        i = bisect_right(interior, t)
        s = (t - nodes[i]) / widths[i]
        u = [a + s * (b + s * (c + s * d)) for a, b, c, d in pieces[i]]
        for first, last in groups:
            length = sum(v * v for v in u[first:last]) ** 0.5 or math.nan  # no direction at all fails every check
            u[first:last] = [v / length for v in u[first:last]]
        return u

    return control_at
