"""Level 3, locally optimal: strict Legendre conditions, and a positive second variation: no conjugate point.

Among all admissible small variations of control, initial state, durations and switching times, those that keep
the end conditions, the second variation

    d2J = [dx, dp]' (d2 Phi) [dx, dp] at the end + lam(0).d2x0[dp, dp] + int [dx, dp, du]' (d2 H) [dx, dp,
    du] dt, dx' = f_x dx + f_u du + f_p dp,     psi_x dx(t_f) + psi_p dp = 0

must be positive. Measured against int du' H_uu du it is 1 - kappa, with kappa the largest eigenvalue of the
rest. By the Morse index theorem the eigenvalues beyond 1 count the conjugate
points of the arc, and kappa = 1 is one exactly at the start: for x'' = -x, kappa = (T/pi)^2. In contrast to
the determinant of the field of extremals this has no singular end, sees double conjugate points, and takes
free parameters along.

Where a bounded control switches the phase is cut into pieces, and the times t_k of the cuts join p: time is
normalised on each piece, so they enter f and H as durations do. They have a curvature of their own: the measure
becomes int du' H_uu du + sum D_k dt_k^2 with D_k > 0 of `strict`. Where no control varies otherwise (bang-bang)
d2J is the Hessian of the Lagrangian of the finite-dimensional problem in switching times and free parameters, whose
positivity on the critical cone is sufficient together with the strict conditions of `strict`. A switch may lie at an
end of the flight, with an arc of no length beyond it. Where the end
conditions leave no variation at all, only these are needed, and kappa is 0.

On a singular arc the integral of its control has the control's place (`singular`). The control jumps at both ends, the
times of which have no curvature of their own; what is left of its impulse at the end is a free parameter.

Where the flight crosses a jump of the physics, s(x) = 0, the time of that joins p as well, without a curvature of its
own: s = 0 there is one more condition to be kept, and nu s of `switch_slopes` one more term of the Lagrangian.

On which side of 1 kappa lies does not depend on how time is normalised; how far from it does, where u varies.

The form is discretised on equal steps with a constant control each (implicit midpoint rule), what of the control
varies as `variations` says. Source:
Gelfand and Fomin (1963), sections 27-29; Bryson and Ho (1975), chapter 6; Hestenes (1966); Maurer, Buskens, Kim,
Kaya (2005) and Osmolovskii and Maurer (2012), chapters 5-7, for switching times, without and with a regular control.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from perilune.core.arrays import Matrix, Vector
from perilune.core.callbacks import sign_of_life
from perilune.core.complex_step import COMPLEX, complex_step_jacobian, stack_broadcast
from perilune.problem.controls import scalars
from perilune.problem.results.solution import Solution
from perilune.problem.verification import Check
from perilune.proof.feasible.branch_guards import watched_rates
from perilune.proof.feasible.numerics import hessian
from perilune.proof.feasible.phase_data import PhaseData
from perilune.proof.feasible.sample_points import time_just_before
from perilune.proof.necessary.first_order import (
    INSIDE,
    STATIONARY_LIMIT,
    all_multipliers,
    end_sides,
    unbounded_parameters,
)
from perilune.proof.necessary.minimum_principle import HAMILTONIAN_LIMIT
from perilune.proof.sufficient.active_controls import check_strict_conditions
from perilune.proof.sufficient.quadratic_form import QuadraticForm, destabilising_eigenvalue, newton_gain
from perilune.proof.sufficient.second_variation import KeptConditions, VariationPiece, variation_pieces
from perilune.proof.sufficient.singular_arcs import Leap, Singular
from perilune.proof.sufficient.strict_complementarity import check_strictness, end_switches, switch_slopes

CURVATURE_LIMIT = -1e-4
# Discretisation lowers kappa by 1.6e-4 of itself (oscillator).
KAPPA_LIMIT = 0.999
# Of J. What the steps leave of a first variation that is 0 gains 3e-8 at most on good answers.
GAIN_LIMIT = 1e-6
_FINER, _BY_STEPS = (2, 4), 1.0  # times as many steps, where they may be what leaves it
# Times as many steps for kappa, where it is between its limit and this; how near to 1 rounding leaves it open.
_LEVELS, _DOUBTFUL, _ROUNDED = (2, 3, 4), 1.1, 1e-8
_SAID_TWICE = 1e-7  # of a linearised condition: by so much others that say the same may differ


def check_local_optimality(solution: Solution, kept: Mapping[int, KeptConditions] | None = None) -> Iterator[Check]:
    """Checks of level 3 that need no other solve.

    Parameters
    ----------
    solution
        An extremal with costates.
    kept
        Of `BoundaryArcs.kept`, where it has boundary arcs.
    """
    arcs = [PhaseData(solution=solution, index=k) for k in range(len(solution.problem.phases))]
    inner = unbounded_parameters(solution, arcs)
    durations = [name for name in inner if name in solution.problem.duration_names]
    pieces = variation_pieces(arcs, inner, kept or {})
    for arc in arcs:
        own = [piece for piece in pieces if piece.arc is arc]
        yield _check_legendre_clebsch(arc, own)
        yield from _check_kelley(arc, own)
        if own[0].kept.rides:
            yield _check_legendre_on_arcs(arc, own)
        yield from check_strictness(arc)
        yield from check_strict_conditions(arc, [(*piece.span, piece.held) for piece in pieces if piece.arc is arc])
    regular = all(piece.regular for piece in pieces) and not any(_has_unsupported_switch(arc) for arc in arcs)
    form_of = cache(
        lambda finer: _assemble_form(pieces if finer == 1 else variation_pieces(arcs, inner, kept or {}, finer))
    )
    forms = form_of if regular else None
    others = [name for name in inner if name not in durations]
    yield _check_positive(forms, [inner.index(name) for name in others], name="conjugate_point",
        meaning="how far the arc reaches towards a conjugate point: 1 means there is one at its start, beyond 1 a "
        "better arc lies close by",
    )  # fmt: skip
    if others:
        yield _check_positive(forms, [], name="second_variation",
            meaning=f"the same with {', '.join(others)} varied together with the control: beyond 1 a better choice "
            "is near",
        )  # fmt: skip
    if forms is not None:
        gain = newton_gain(forms(1))
        for finer in _FINER:  # what the steps owe falls with the fourth power of their number
            if GAIN_LIMIT < gain < _BY_STEPS:
                gain = newton_gain(forms(finer))
        yield Check(
            name="nothing_gained", level=3, value=gain, limit=GAIN_LIMIT, unit="1",
            meaning="by how much a step of Newton's method on the second variation lowers J, over its size: what is "
            "flown is the minimum that it tells of, whatever sizes the costates and slopes were judged by",
        )  # fmt: skip


def _check_positive(
    forms: Callable[[int], QuadraticForm] | None, fixed: Sequence[int], *, name: str, meaning: str
) -> Check:
    value, limit = float("nan"), KAPPA_LIMIT
    if forms is None:
        meaning += (
            "; not available: H is not strictly convex in a control between its bounds, a scalar reaches its bound "
            "without a switch in the table, a path condition takes hold of the control without a break in it, or what "
            "jumps there is not one scalar that crosses its switch by more than rounding (that of an instant does not)"
        )
    else:
        value, variations = _kappa_with_fixed(forms(1), fixed)
        if KAPPA_LIMIT < value < _DOUBTFUL:
            value, limit = _extrapolate_kappa(lambda finer: _kappa_with_fixed(forms(finer), fixed)[0])
            meaning += "; extrapolated to steps of no length, the limit being 1 less what that leaves open"
        if np.isnan(value):
            meaning += "; not available: a free parameter alone, or an impulse as a singular arc ends, costs nothing"
        if not variations:
            meaning += "; the end conditions leave nothing to vary, so that strict switching suffices for a minimum"
    return Check(name=name, level=3, value=value, limit=limit, unit="1", meaning=meaning)


def _kappa_with_fixed(form: QuadraticForm, fixed: Sequence[int]) -> tuple[float, int]:
    """Return `destabilising_eigenvalue` of a form with some of its parameters fixed."""
    without = np.delete(np.delete(form.form, fixed, axis=0), fixed, axis=1)
    return destabilising_eigenvalue(without, np.delete(form.constraints, fixed, axis=1), form.m - len(fixed))


def _extrapolate_kappa(kappa_of: Callable[[int], float]) -> tuple[float, float]:
    """Return kappa of steps of no length, and the limit below which it is said to be less than 1.

    Its error falls with the square of the number of steps: Richardson's extrapolation takes that out, and what two of
    these differ by is many times what the better one leaves.
    """
    coarse, middle, fine = (kappa_of(finer) for finer in _LEVELS)
    rough, value = (
        (after * n**2 - before * k**2) / (n**2 - k**2)
        for before, after, k, n in ((coarse, middle, *_LEVELS[:2]), (middle, fine, *_LEVELS[1:]))
    )
    return value, min(1.0 - abs(value - rough), 1.0 - _ROUNDED)


def _has_unsupported_switch(arc: PhaseData) -> bool:
    """Return True if not just a single scalar jumps at a break, or its switching function does not cross zero there."""
    places = [at for at, _ in scalars(arc.phase.controls)]
    jumps = arc.jumps != 0
    alone = bool((jumps.sum(axis=0) <= 1).all()) and not np.delete(jumps, places, axis=0).any()
    switches = jumps.any(axis=0) & ~(singular := Singular.of(arc).junctions)
    smooth = singular & ~jumps.any(axis=0)  # a junction without a jump is no end of an impulse
    bends = [*switch_slopes(arc)[switches], *(end.slope for end in end_switches(arc))]
    return not alone or bool(smooth.any() or (np.array(bends) <= HAMILTONIAN_LIMIT).any())


def _check_legendre_clebsch(arc: PhaseData, pieces: Sequence[VariationPiece]) -> Check:
    curvature = [np.linalg.eigvalsh(piece.bends) for piece in pieces if piece.bends.shape[1]]
    value = max((-float(c.min() / np.abs(c).max()) for c in curvature), default=-1.0)
    return Check(
        name=f"{arc.prefix}legendre_clebsch", level=3, value=value, limit=CURVATURE_LIMIT, unit="1",
        meaning="minus the smallest second derivative of the Hamiltonian in the control, over its largest: below 0 "
        "when a control that is not on a bound is a strict minimum all along (-1: there is none)",
    )  # fmt: skip


def _check_kelley(arc: PhaseData, pieces: Sequence[VariationPiece]) -> Iterator[Check]:
    """Check Kelley's condition on singular arcs."""
    own = [piece.kelley for piece in pieces if len(piece.kelley)]
    if own:
        yield Check(
            name=f"{arc.prefix}kelley", level=3, limit=CURVATURE_LIMIT, unit="1",
            value=max(-float(along.min() / np.abs(along).max()) for along in own),
            meaning="minus the smallest curvature of H in the integral of a singular control, over its largest: below "
            "0 where Kelley's condition holds strictly, -d/du d^2(H_u)/dt^2 > 0",
        )  # fmt: skip


def _check_legendre_on_arcs(arc: PhaseData, pieces: Sequence[VariationPiece]) -> Check:
    """Check the Legendre-Clebsch condition in the control's free moves on boundary arcs of conditions on states."""
    if pieces[0].kept.pays is not None:
        return Check(
            name=f"{arc.prefix}along_sufficient", level=3, value=-pieces[0].kept.pays, limit=CURVATURE_LIMIT, unit="1",
            meaning="minus the least multiplier of what is ridden over its largest, where H is linear in the control: "
            "below 0 where flights that leave it for a moment pay to first order",
        )  # fmt: skip
    value, loose = float("nan"), [piece.loosened for piece in pieces]
    if all(piece.regular for piece in loose) and pieces[0].kept.steady:
        curvature = [np.linalg.eigvalsh(piece.H_uu) for piece in loose if piece.sizes[2]]
        value = max((-float(c.min() / np.abs(c).max()) for c in curvature), default=float("nan"))
    return Check(
        name=f"{arc.prefix}along_sufficient", level=3, value=value, limit=CURVATURE_LIMIT, unit="1",
        meaning="minus the smallest second derivative of the Hamiltonian of what is ridden, in all of the control that "
        "may leave it, over the largest: below 0 where flights that leave it for a moment are worse to second order; "
        "not available where it is linear in a control, or one reaches a bound or jumps as the arc begins or ends",
    )  # fmt: skip


def _assemble_form(pieces: Sequence[VariationPiece]) -> QuadraticForm:
    """`QuadraticForm` of all pieces."""
    m, curvature = pieces[0].sizes[1], np.array(pieces[0].curvature)
    multipliers = all_multipliers([piece.arc for piece in pieces if piece.first])
    columns = m + sum(piece.sizes[2] * piece.steps for piece in pieces)
    form, constraints, at = np.zeros((columns, columns)), [np.zeros((0, columns))], m
    slope = np.zeros(columns)
    parameters = np.eye(m, columns)
    parameters[m - len(curvature) :] /= np.sqrt(curvature)[:, None]
    dx = known = np.zeros((0, columns))
    for piece in pieces:
        if piece.first:
            dx, curved = _start_variation(piece, dx, parameters)
            form += curved
            begun = _vanishing_rows(piece, piece.kept.holds, dx, parameters, 0.0)
            constraints += [_tied_length_row(piece, parameters), _independent_rows(begun, known)]
        n, _, k = piece.sizes
        identity, step = np.eye(n), piece.lengths[:, None, None]
        half = 0.5 * step * piece.F[:, :n].transpose(2, 0, 1)
        inverse = np.linalg.inv(identity - half)
        through = inverse @ (identity + half)
        into = step * inverse @ piece.F[:, n:].transpose(2, 0, 1)
        shape = np.zeros((piece.steps, 0, 0))
        if k:
            shape = np.linalg.inv(np.linalg.cholesky(step * piece.H_uu)).transpose(0, 2, 1)
        path = np.zeros((piece.steps, n + m + k, columns))
        for j in range(piece.steps):
            sign_of_life("proof: level 3, the second variation")
            path[j, n : n + m] = parameters
            path[j, n + m :, at + j * k : at + (j + 1) * k] = shape[j]
            after = through[j] @ dx + into[j] @ path[j, n:]
            path[j, :n] = 0.5 * (dx + after)
            dx = after
        at += k * piece.steps
        weighted = step * piece.W.transpose(2, 0, 1) @ path
        flat = (piece.steps * (n + m + k), columns)  # which may be none
        form += path.reshape(flat).T @ weighted.reshape(flat)
        slope -= (piece.lengths * piece.yields).T.ravel() @ path.reshape(flat)
        if piece.leap is not None:
            dx, curved = _leap_variation(piece.leap, dx, parameters)
            form += curved
        if piece.crossing:
            rows, curved = _crossing_variation(piece, dx, parameters)
            form += curved
            constraints.append(rows)
        if piece.last:
            rows, curved, end_slope = _end_variation(piece, multipliers[piece.arc.index], dx, parameters)
            form += curved
            slope += end_slope
            left = _vanishing_rows(piece, piece.kept.end, dx, parameters, piece.arc.duration)
            held = _vanishing_rows(piece, piece.kept.holds, dx, parameters, piece.arc.duration)
            constraints.append(_independent_rows(np.vstack([rows, left]), held))
            known = np.vstack([held, rows])
    return QuadraticForm(0.5 * (form + form.T), np.vstack(constraints), slope, m - len(curvature))


def _leap_variation(leap: tuple[int, Leap], dx: Matrix, parameters: Matrix) -> tuple[Matrix, Matrix]:
    """Return dx behind a singular arc, and the term that its impulse adds to the form."""
    place, own = leap
    h, slopes = parameters[place], own.mixed @ np.vstack([dx, parameters])
    curved = np.outer(h, slopes) + np.outer(slopes, h) + own.square * np.outer(h, h)
    return dx + np.outer(own.by, h), curved


def _derivatives_along(
    piece: VariationPiece, function: Any, x: Vector, scale: Vector, moves: Matrix
) -> tuple[Matrix, Matrix]:
    """Return along `moves` first derivatives (rows, columns) of function(z, p), and second ones of its first row."""
    z = np.concatenate([x, piece.parameter_values])[:, None]
    scale = np.concatenate([scale, piece.parameter_scale])

    def split(w: Any) -> Any:
        return stack_broadcast(function(w[: len(x)], piece.parameters(w[len(x) :])), w.shape[1:])

    first = complex_step_jacobian(split, z, scale)[:, :, 0] @ moves
    second = hessian(lambda w: split(w)[0], z, scale)[:, :, 0]
    return first, moves.T @ second @ moves


def _tied_length_row(piece: VariationPiece, parameters: Matrix) -> Matrix:
    """Return the row that ties a phase's length in proportion to that of the one before, if stated (rows, columns)."""
    arcs = (
        [PhaseData(solution=piece.arc.solution, index=piece.arc.index - step) for step in (1, 0)]
        if piece.kept.tied
        else []
    )
    places = [piece.names.index(arc.phase.duration) for arc in arcs if arc.phase.duration in piece.names]
    if len(places) < 2:
        return np.zeros((0, parameters.shape[1]))
    one, other = (piece.parameter_scale[at] / piece.parameter_values[at] * parameters[at] for at in places)
    return (one - other)[None]


def _vanishing_rows(piece: VariationPiece, values: Sequence[Any], dx: Matrix, parameters: Matrix, t: float) -> Matrix:
    """First derivatives of values of the state at one end of a phase, (rows, columns), each over its size."""
    if not values:
        return np.zeros((0, parameters.shape[1]))
    arc = piece.arc
    u = arc.phase.control_record(*arc.control(np.array([t]))[:, 0].tolist())

    def rows(z: Any, p: Any) -> list[Any]:
        return [0.0 * z[0], *(value(arc.phase.state_record(*z), u, p, COMPLEX)[0] for value in values)]

    first, _ = _derivatives_along(
        piece, rows, arc.state(np.array([t]))[:, 0], arc.state_scale, np.vstack([dx, parameters])
    )
    sizes = np.abs(first[1:]).max(axis=1, initial=0.0, keepdims=True)
    return np.divide(first[1:], sizes, out=np.zeros_like(first[1:]), where=sizes > 0)


def _independent_rows(rows: Matrix, known: Matrix) -> Matrix:
    """Return the combinations of rows that are independent of known ones but for the error of the steps."""
    if not len(rows) or not len(known):
        return rows
    rows = rows / np.maximum(np.abs(rows).max(axis=1, keepdims=True, initial=0.0), 1e-300)
    left = rows - rows @ np.linalg.pinv(known, rcond=1e-10) @ known
    combined, sizes, _ = np.linalg.svd(left, full_matrices=False)
    return combined[:, sizes > _SAID_TWICE].T @ rows


def _start_variation(piece: VariationPiece, dx: Matrix, parameters: Matrix) -> tuple[Matrix, Matrix]:
    """Variation of the phase's initial state, and lam(0) times its second derivative."""
    arc, problem = piece.arc, piece.arc.problem
    lam = arc.costate(np.zeros(1))[:, 0] / arc.objective_scale
    if arc.index == 0:
        x, scale, moves = np.zeros(0), np.zeros(0), parameters

        def values(z: Any, p: Any) -> Any:
            return problem.start(p, COMPLEX)
    else:
        before = PhaseData(solution=arc.solution, index=arc.index - 1)
        x, scale = before.state(np.array([before.duration]))[:, 0], before.state_scale
        moves = np.vstack([dx, parameters])

        def values(z: Any, p: Any) -> Any:
            return problem.links[arc.index - 1](before.phase.state_record(*z), p, COMPLEX)

    if not len(moves):
        return np.zeros((len(lam), parameters.shape[1])), np.zeros((parameters.shape[1],) * 2)

    def weighted(z: Any, p: Any) -> list[Any]:
        out = values(z, p)
        return [sum(a * b for a, b in zip(lam, out, strict=True)), *out]

    first, second = _derivatives_along(piece, weighted, x, scale, moves)
    return first[1:] / arc.state_scale[:, None], second


def _crossing_variation(piece: VariationPiece, dx: Matrix, parameters: Matrix) -> tuple[Matrix, Matrix]:
    """The linearised condition s = 0 at the end of a piece (scaled), and the second derivative of nu s."""
    arc, met = piece.arc, piece.crossing
    assert met is not None, "asked for where there is one"
    before = np.array([time_just_before(met.time)])
    x, u, lam = arc.state(before)[:, 0], arc.control(before), arc.costate(before)[:, 0]
    nu = met.multiplier(lam / arc.costate_scale)

    def values(z: Any, p: Any) -> list[Any]:
        s = watched_rates(arc.phase, z, u.reshape(-1, *(1,) * (z.ndim - 1)), p, met.before)[1][met.guard] / met.size
        return [nu * s, s]

    first, second = _derivatives_along(piece, values, x, arc.state_scale, np.vstack([dx, parameters]))
    return first[1:], second


def _end_variation(piece: VariationPiece, nu: Vector, dx: Matrix, parameters: Matrix) -> tuple[Matrix, Matrix, Vector]:
    """Linearised end conditions (scaled), and the second and first derivatives of phi + nu.psi at the phase's end."""
    arc = piece.arc
    last = arc.index == len(arc.problem.phases) - 1

    def values(z: Any, p: Any) -> list[Any]:
        psi = arc.phase.evaluate("end", z, (), p, COMPLEX)
        total = sum(a * b for a, b in zip(nu, psi, strict=True))
        total = total + arc.problem.objective(arc.phase.state_record(*z), p, COMPLEX) if last else total
        return [total / arc.objective_scale, *psi]

    x = arc.state(np.array([arc.duration]))[:, 0]
    first, second = _derivatives_along(piece, values, x, arc.state_scale, np.vstack([dx, parameters]))
    # A range is free to vary where it is not at a bound, or where that bound holds nothing back.
    slack = np.abs(nu) * arc.end_scale <= STATIONARY_LIMIT * arc.objective_scale
    held = np.where(slack, end_sides(arc) == 0, end_sides(arc) != INSIDE)
    held &= np.array([c.name not in piece.kept.left for c in arc.phase.end_conditions], dtype=bool)
    return first[1:][held] / arc.end_scale[held, None], second, first[0]
