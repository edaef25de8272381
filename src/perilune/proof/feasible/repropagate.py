"""Independent re-integration of every phase by its exported control, twice.

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
from dataclasses import dataclass, replace
from itertools import count, pairwise
from typing import Any

import numpy as np

from perilune.core.arrays import Matrix, Vector
from perilune.core.callbacks import sign_of_life
from perilune.core.complex_step import COMPLEX
from perilune.core.maths import NUMERIC
from perilune.problem.controls import directions
from perilune.problem.phase import Phase
from perilune.problem.results.solution import Curve, Solution
from perilune.proof.feasible.branch_guards import watched_rates
from perilune.proof.feasible.numerics import significant_size
from perilune.proof.feasible.phase_data import PhaseData, slopes_at_end
from perilune.proof.feasible.sample_points import BLOCK, ENDS, UP_TO, WEIGHTS, Pieces, cubics, time_just_before

_TOLERANCE = 1e-13  # of SciPy's integrator, relative and in canonical units
# Of no more use is a flight that multiplies its errors: what ends where it should is no longer known.
MOST_GROWTH = 1e3
MOST_EVALUATIONS = 300_000  # of the equations of motion in one phase; the examples take 130 to 250
_ALIVE = 256  # evaluations from one sign of life to the next


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """Difference of a re-integrated curve from its table, scaled.

    `inside` holds it at the points of the pieces (n, N, 4), `ends` at their ends (n, N, 2); `largest` of each component
    is the largest of all, plus what quadrature leaves `still_open`. `growth` is the most that errors of all components
    at one time, each of its size, become in it, from the start to anywhere or from anywhere to the end; `at_end` the
    most that they become there; for limits up to `MOST_GROWTH` times their sizes.
    """

    inside: Matrix
    ends: Matrix
    still_open: Vector
    growth: Vector
    at_end: Vector

    @property
    def largest(self) -> Vector:
        """Return the largest deviation of each component, (n,)."""
        every = np.concatenate([self.inside, self.ends], axis=2)
        return np.abs(every).max(axis=(1, 2)) + self.still_open

    @property
    def turned(self) -> Deviation:
        """Return the same of a flight from the end to the start, in order of time."""
        return replace(self, inside=self.inside[:, ::-1, ::-1], ends=self.ends[:, ::-1, ::-1])


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
    """Return the errors of the phases so far as the next one begins, at least 1, scaled by its sizes."""
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


def state_deviation(arc: PhaseData, start: Vector, sizes: Vector | None = None) -> Deviation:
    """Return the re-integrated states from a start [SI] less their table; `sizes` are of errors at the start.

    Parameters
    ----------
    arc
        The phase.
    start
        Initial state [SI], (n,).
    sizes
        Of errors at the start, scaled, (n,); 1 where None.
    """
    pieces, slopes, still = arc.looked_at
    n, unit = len(arc.state_scale), arc.state_scale[:, None, None]
    at, ends = (pieces.read(arc.trajectory.state, *shares) / unit for shares in ((), (ENDS,)))
    first, over = start / arc.state_scale - ends[:, 0, 0], {}
    jumps = ends[:, :-1, 1] - ends[:, 1:, 0]
    for crossing in arc.crossings:
        over[np.searchsorted(pieces.left, crossing.time) - 1] = crossing.saltation
    return newton_correction(
        pieces, at, ends, slopes.state, slopes.matrix, PieceJoints(first, jumps, over), still[:n], sizes
    )


def costate_deviation(arc: PhaseData) -> tuple[Deviation, Vector]:
    """Return costates integrated along the table of the state from their value at an end, less their table.

    Start at the end from which errors grow less: a descent through air forgets its speed, so that costates at its
    start follow from those at its end, and not the other way round. Also return their errors at the start, scaled,
    (n,): as grown from the end, or else 1.
    """
    pieces, slopes, still = arc.looked_at
    n, unit = len(arc.state_scale), arc.costate_scale[:, None, None]
    curve = arc.trajectory.costate
    assert curve is not None, "asked for where there is one"
    at, ends = (pieces.read(curve, *shares) / unit for shares in ((), (ENDS,)))
    jumps, over = ends[:, :-1, 1] - ends[:, 1:, 0], {}
    for crossing in arc.crossings:
        joint = np.searchsorted(pieces.left, crossing.time) - 1
        over[joint] = crossing.adjoint
        jumps[:, joint] = crossing.adjoint @ ends[:, joint, 1] - ends[:, joint + 1, 0]
    most = np.abs(ends).max(axis=(1, 2))
    # A state is scaled by what it reaches, unless it hardly moves.
    many = significant_size(arc.units / arc.state_scale, most + np.abs(slopes.costate @ WEIGHTS) @ pieces.width)
    joints = PieceJoints(
        np.zeros(n), many[:, None] * jumps, {k: _rescale_matrix(each, many) for k, each in over.items()}
    )
    # What its costate reaches is that of J, or more where J is a difference.
    sizes, at, ends, slope = (
        np.maximum(1.0, many * most),
        *(many[:, None, None] * v for v in (at, ends, slopes.costate)),
    )
    matrix = -_rescale_matrix(slopes.matrix.swapaxes(2, 3), many)
    ahead = newton_correction(pieces, at, ends, slope, matrix, joints, many * still[n:], sizes)
    turned = at[:, ::-1, ::-1], ends[:, ::-1, ::-1], -slope[:, ::-1, ::-1], -matrix[::-1, ::-1]
    back = newton_correction(pieces[::-1], *turned, joints.turned, many * still[n:], sizes).turned
    backwards = back.growth.sum() < ahead.growth.sum() or not np.isfinite(ahead.growth).all()
    chosen, most = back if backwards else ahead, MOST_GROWTH * sizes
    begun = (np.minimum(back.at_end, most) if backwards else np.ones(n)) / many
    return replace(chosen, growth=np.minimum(chosen.growth, most), at_end=np.minimum(chosen.at_end, most)), begun


def _rescale_matrix(matrix: Any, many: Vector) -> Any:
    """A matrix (..., n, n) for vectors whose components are so many times as large."""
    return many[:, None] * matrix / many


@dataclass(frozen=True)
class PieceJoints:
    """Defects at the joints between pieces, and the matrices by which deviations pass them.

    Attributes
    ----------
    first
        Deviation at the start, (n,).
    jumps
        Value that should follow less that of the table, at each joint, (n, N - 1).
    over
        By joint, the matrix by which a deviation passes where it is not the identity.
    """

    first: Vector
    jumps: Matrix
    over: dict[int, Matrix]

    @property
    def turned(self) -> PieceJoints:
        """Return the same from the end to the start, where nothing deviates: d- = M^-1 (d+ - jump)."""
        last = self.jumps.shape[1] - 1
        over = {last - i: np.linalg.inv(matrix) for i, matrix in self.over.items()}
        jumps = -self.jumps[:, ::-1]
        for i, matrix in over.items():
            jumps[:, i] = matrix @ jumps[:, i]
        return PieceJoints(np.zeros_like(self.first), jumps, over)


def newton_correction(
    pieces: Pieces, at: Matrix, ends: Matrix, slopes: Matrix, matrix: Any, joints: PieceJoints, still: Vector,
    sizes: Vector | None = None,
) -> Deviation:  # fmt: skip
    """Newton's step of the collocation, from piece to piece.

    Parameters
    ----------
    pieces
        The N pieces.
    at, ends
        The table at their points (n, N, 4), and at both ends (n, N, 2).
    slopes, matrix
        f (n, N, 4) and its derivatives (N, 4, n, n) on the table.
    joints
        What happens between the pieces.
    still
        What quadrature leaves open, (n,).
    sizes
        Of the components, each at least 1; 1 where they are left out.
    """
    defect = ends[:, :, :1] + pieces.width[:, None] * (slopes @ UP_TO.T) - at
    over = ends[:, :, 0] + pieces.width * (slopes @ WEIGHTS) - ends[:, :, 1]
    n, count = over.shape
    own, through = np.empty((count, n, 4)), np.empty((count, n, 4, n))
    for k in range(0, count, BLOCK):
        here = slice(k, k + BLOCK)
        own[here], through[here] = _piece_deviations(pieces.width[here], defect[:, here], matrix[here])
    # At a piece's right end, by the weights: what is the piece's own, and what comes through it.
    bent = pieces.width[:, None, None, None] * WEIGHTS[:, None, None] * matrix
    over = over.T + np.einsum("nkij,njk->ni", bent, own)
    past = np.eye(n) + np.einsum("nkij,njkl->nil", bent, through)
    starts, finals, d = np.empty((count, n)), np.empty((count, n)), joints.first
    for i in range(count):
        starts[i] = d
        finals[i] = d = past[i] @ d + over[i]
        if i + 1 < count:
            d = (joints.over[i] @ d if i in joints.over else d) + joints.jumps[:, i]
    inside = own + np.einsum("nikl,nl->nik", through, starts)
    growth, at_end = _error_growth(past, joints.over, sizes)
    return Deviation(
        inside=inside.transpose(1, 0, 2), ends=np.stack([starts.T, finals.T], axis=2), still_open=still,
        growth=growth, at_end=at_end,
    )  # fmt: skip


def _error_growth(past: Any, over: dict[int, Matrix], sizes: Vector | None = None) -> tuple[Vector, Vector]:
    """Return `growth` and `at_end` of `Deviation`, from the matrices by which it passes each piece (N, n, n)."""
    sizes = np.ones(past.shape[1]) if sizes is None else sizes
    passed = [over[i] @ each if i in over else each for i, each in enumerate(past)]
    most = at_end = sizes
    ahead = behind = np.eye(past.shape[1])
    for first, last in zip(passed, reversed(passed), strict=True):
        ahead, behind = first @ ahead, behind @ last
        at_end = np.maximum(at_end, np.abs(behind) @ sizes)
        most = np.maximum(most, np.maximum(np.abs(ahead) @ sizes, at_end))
    return most, at_end


def _piece_deviations(width: Vector, defect: Matrix, matrix: Any) -> tuple[Matrix, Matrix]:
    """Deviations at the points of each piece from its defect (N, n, 4), and from each component at its start."""
    n, count = defect.shape[:2]
    bent = width[:, None, None, None, None] * UP_TO[:, None, :, None] * matrix.swapaxes(1, 2)[:, None]
    system = np.eye(4 * n) - bent.reshape(count, 4 * n, 4 * n)
    right = np.zeros((count, 4, n, n + 1))
    right[..., 0] = defect.transpose(1, 2, 0)
    right[..., 1:] = np.eye(n)
    try:
        found = np.linalg.solve(system, right.reshape(count, 4 * n, n + 1)).reshape(right.shape)
    except np.linalg.LinAlgError:  # of no solution that could pass
        found = np.full(right.shape, np.nan)
    return found[..., 0].swapaxes(1, 2), found[..., 1:].swapaxes(1, 2)


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
                sign_of_life("proof: the flight is flown again")
            if number > MOST_EVALUATIONS:
                raise ArithmeticError(f"the flight takes more than {MOST_EVALUATIONS} evaluations")
            if not len(held):
                return phase.rates(x.tolist(), control(t), p)
            # From kink to kink on its own side, which goes on smoothly where a step looks beyond.
            return watched_rates(phase, x, np.array(control(t)), p, held)[0].real

        if not np.isfinite(x).all():
            raise ArithmeticError("the flight starts where there is no number")
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
