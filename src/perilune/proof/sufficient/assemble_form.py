"""The quadratic form of the second variation of a flight, phase by phase, with the rows of its boundary conditions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from perilune.core import COMPLEX, Matrix, Vector, complex_step_jacobian, sign_of_life, stack_broadcast
from perilune.proof.feasible.branch_guards import watched_rates
from perilune.proof.feasible.numerics import hessian
from perilune.proof.feasible.phase_data import phase_data_of
from perilune.proof.feasible.sample_points import time_just_before
from perilune.proof.necessary.first_order import INSIDE, STATIONARY_LIMIT, all_multipliers, end_sides
from perilune.proof.sufficient.quadratic_form import QuadraticForm
from perilune.proof.sufficient.second_variation import VariationPiece
from perilune.proof.sufficient.singular_arcs import Leap

_PARTS = 8  # of a piece, worked on at once: the more, the fewer columns that are 0 are multiplied
_SAID_TWICE = 1e-7  # of a linearised condition: by so much others that say the same may differ


def assemble_second_variation(pieces: Sequence[VariationPiece]) -> QuadraticForm:
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
            held = _vanishing_rows(piece, piece.kept.holds, dx, parameters, 0.0)
            constraints += [_tied_length_row(piece, parameters), _independent_rows(held, known)]
        begun, own = np.vstack([dx, parameters]), slice(at, at + piece.sizes[2] * piece.steps)
        at, first = own.stop, len(begun)
        along, yielded, after = _form_along(piece)
        form += begun.T @ along[:first, :first] @ begun
        form[:, own] += begun.T @ along[:first, first:]
        form[own] += along[first:, :first] @ begun
        form[own, own] += along[first:, first:]
        slope += yielded[:first] @ begun
        slope[own] += yielded[first:]
        dx = after[:, :first] @ begun
        dx[:, own] += after[:, first:]
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


def _form_along(piece: VariationPiece) -> tuple[Matrix, Vector, Matrix]:
    """Form and slope of one piece over (state as it begins, parameters, its controls), and its final state (n, ...)."""
    n, m, k = piece.sizes
    identity, step = np.eye(n), piece.lengths[:, None, None]
    half = 0.5 * step * piece.F[:, :n].transpose(2, 0, 1)
    inverse = np.linalg.inv(identity - half)
    through = inverse @ (identity + half)
    into = step * inverse @ piece.F[:, n:].transpose(2, 0, 1)
    shape = np.zeros((piece.steps, 0, 0))
    if k:
        shape = np.linalg.inv(np.linalg.cholesky(step * piece.H_uu)).transpose(0, 2, 1)
    weights, yields = step * piece.W.transpose(2, 0, 1), piece.lengths * piece.yields
    columns = n + m + k * piece.steps
    form, slope, dx = np.zeros((columns, columns)), np.zeros(columns), np.eye(n, columns)
    for some in np.array_split(np.arange(piece.steps), _PARTS):
        reached = n + m + k * (some[-1] + 1)  # of the columns: controls further on change nothing here
        path = np.zeros((len(some), n + m + k, reached))
        path[:, n : n + m] = np.eye(m, reached, n)
        for row, j in zip(path, some.tolist(), strict=True):
            sign_of_life("proof: level 3, the second variation")
            row[n + m :, n + m + j * k : n + m + (j + 1) * k] = shape[j]
            after = through[j] @ dx[:, :reached] + into[j] @ row[n:]
            row[:n] = 0.5 * (dx[:, :reached] + after)
            dx[:, :reached] = after
        flat = (len(some) * (n + m + k), reached)
        form[:reached, :reached] += path.reshape(flat).T @ (weights[some] @ path).reshape(flat)
        slope[:reached] -= yields[:, some].T.ravel() @ path.reshape(flat)
    return form, slope, dx


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
    arcs = phase_data_of(piece.arc.solution)[piece.arc.index - 1 : piece.arc.index + 1] if piece.kept.tied else []
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
        before = phase_data_of(arc.solution)[arc.index - 1]
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
    held &= np.array([c.name not in piece.kept.dropped_ends for c in arc.phase.end_conditions], dtype=bool)
    return first[1:][held] / arc.end_scale[held, None], second, first[0]
