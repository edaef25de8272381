"""Level 3, locally optimal: strict Legendre-Clebsch, and a positive second variation: no conjugate point.

Among all admissible small variations of control, initial state and durations, those that keep the end
conditions, the second variation

    d2J = [dx, dp]' (d2 Phi) [dx, dp] at the end + lam(0).d2x0[dp, dp] + int [dx, dp, du]' (d2 H) [dx, dp,
    du] dt, dx' = f_x dx + f_u du + f_p dp,     psi_x dx(t_f) + psi_p dp = 0

must be positive. Measured against int du' H_uu du it is 1 - kappa, with kappa the largest eigenvalue of the
part that does not come from H_uu. By the Morse index theorem the eigenvalues beyond 1 count the conjugate
points of the arc, and kappa = 1 is one exactly at the start: for x'' = -x, kappa = (T/pi)^2. In contrast to
the determinant of the field of extremals this has no singular end, sees double conjugate points, and takes
free parameters along.

The form is discretised on equal pieces with a constant control each (implicit midpoint rule); a direction
moves in its tangent plane. A scalar on its bound all along does not vary; one that switches has no such
test. Source: Gelfand and Fomin (1963), sections 27-29; Bryson and Ho (1975), chapter 6; Hestenes (1966).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.problem import Bounded
from perilune.solution import Solution
from perilune.types import Matrix, Vector
from perilune.verification import Check
from perilune.verify.extremal import at_bound, end_multipliers, tangents
from perilune.verify.numerics import COMPLEX, Arc, hessian, jacobian, normalised, stacked

PIECES = 100
CURVATURE_LIMIT = -1e-4
# Discretisation lowers kappa by 1.6e-4 of itself (oscillator).
KAPPA_LIMIT = 0.999


def local_optimality(solution: Solution) -> Iterator[Check]:
    """Checks of level 3 that need no other solve.

    Parameters
    ----------
    solution
        An extremal with costates.
    """
    arcs = [Arc(solution=solution, index=k) for k in range(len(solution.problem.phases))]
    inner = [f.name for f in solution.problem.free if not any(at_bound(solution, f))]
    durations = [name for name in inner if name in solution.problem.duration_names]
    pieces = [_Pieces(arc, inner) for arc in arcs]
    for piece in pieces:
        yield _legendre_clebsch(piece)
    regular = all(piece.regular for piece in pieces)
    yield Check(
        name="conjugate_point", level=3, unit="1", limit=KAPPA_LIMIT,
        value=kappa([_Pieces(arc, durations) for arc in arcs]) if regular else float("nan"),
        meaning="how far the arc reaches towards a conjugate point: 1 means there is one at its start, "
        "beyond 1 a "
        "better arc lies close by (not available where a control switches between its bounds)",
    )  # fmt: skip
    if len(inner) > len(durations):
        others = ", ".join(name for name in inner if name not in durations)
        yield Check(
            name="second_variation", level=3, unit="1", limit=KAPPA_LIMIT,
            value=kappa(pieces) if regular else float("nan"),
            meaning=f"the same with {others} varied together with the control: beyond 1 a better choice is "
            "near",
        )  # fmt: skip


class _Pieces:
    """First and second derivatives of one phase at the middles of equal pieces, time divided by its duration.

    `F` (n, d, N): derivatives of the duration times f; `W` (d, d, N): of the duration times H; d counts
    states, the parameters `names` and the tangent directions of the control that may vary.
    """

    def __init__(self, arc: Arc, names: Sequence[str]) -> None:
        self.arc, self.names = arc, tuple(names)
        t = (np.arange(PIECES) + 0.5) * arc.duration / PIECES
        x, u, self.lam = arc.state(t), arc.control(t), arc.costate(t)
        varying, self.switches = _varying(arc, u)
        self.basis = tangents(arc, u)[:, varying] if arc.phase.controls else np.zeros((0, 0, PIECES))
        self.u = u
        n, m, k = len(x), len(names), self.basis.shape[1]
        self.sizes = n, m, k
        self.parameter_scale = np.array([arc.problem.scales.of(arc.problem.unit_of(name)) for name in names])
        self.scale = np.concatenate([arc.state_scale, self.parameter_scale, np.ones(k)])
        self.parameter_values = np.array([float(getattr(arc.p, name)) for name in names])
        z = np.concatenate(
            [x, np.repeat(self.parameter_values[:, None], PIECES, axis=1), np.zeros((k, PIECES))]
        )
        self.F = jacobian(self._rates, z, self.scale)
        self.W = hessian(self._hamiltonian, z, self.scale)
        self.H_uu = self.W[n + m :, n + m :].transpose(2, 0, 1)

    @property
    def regular(self) -> bool:
        """Whether H is strictly convex in the control all along."""
        return not self.switches and bool(np.all(np.linalg.eigvalsh(self.H_uu) > 0))

    def parameters(self, values: Any) -> SimpleNamespace:
        """All parameters in SI with `names` replaced."""
        return SimpleNamespace(**{**vars(self.arc.p), **dict(zip(self.names, values, strict=True))})

    def _f(self, z: Any) -> Any:
        n, m, _ = self.sizes
        p = self.parameters(z[n : n + m])
        middle = (1,) * (z.ndim - 2)
        u = self.u.reshape(len(self.u), *middle, PIECES) + 0 * z[0]
        for column in range(self.basis.shape[1]):
            u = u + self.basis[:, column].reshape(len(self.u), *middle, PIECES) * z[n + m + column]
        u = normalised(self.arc.phase, u) if len(self.u) else u
        return getattr(p, self.arc.phase.duration) * self.arc.rates(z[:n], u, p)

    def _rates(self, z: Any) -> Any:
        return self._f(z) / self.arc.state_scale.reshape(-1, *(1,) * (z.ndim - 1))

    def _hamiltonian(self, z: Any) -> Any:
        lam = self.lam.reshape(len(self.lam), *(1,) * (z.ndim - 2), PIECES)
        return (lam * self._f(z)).sum(axis=0) / self.arc.objective_scale


def _varying(arc: Arc, u: Matrix) -> tuple[list[int], bool]:
    """Tangent directions not held at a bound, and whether a control is on its bound for a part of the arc."""
    varying, switches, row, at = [], False, 0, 0
    for control in arc.phase.controls:
        if isinstance(control, Bounded):
            near = 1e-7 * arc.control_scale[at]
            active = (u[at] <= control.lower + near) | (u[at] >= control.upper - near)
            jumps = np.ptp(u[at][active]) > 2 * near if active.any() else False
            switches |= bool(active.any() and not active.all()) or bool(jumps)
            varying += [] if active.all() else [row]
            row += 1
        else:
            width = len(control.names) - 1
            varying += range(row, row + width)
            row += width
        at += len(control.names)
    return varying, switches


def _legendre_clebsch(piece: _Pieces) -> Check:
    arc, value = piece.arc, float("nan")
    if piece.sizes[2] and not piece.switches:
        curvature = np.linalg.eigvalsh(piece.H_uu)
        value = -float(curvature.min() / np.abs(curvature).max())
    elif not piece.switches:
        value = -1.0
    return Check(
        name=f"{arc.prefix}legendre_clebsch", level=3, value=value, limit=CURVATURE_LIMIT, unit="1",
        meaning="minus the smallest second derivative of the Hamiltonian in the control, over its largest: "
        "below 0 "
        "when the control is a strict minimum all along (-1: no control can vary; NaN: one switches)",
    )  # fmt: skip


def kappa(pieces: Sequence[_Pieces]) -> float:
    """Largest destabilising eigenvalue (above); infinite where a free parameter alone already gains.

    Parameters
    ----------
    pieces
        One for each phase, with positive H_uu and the same parameter names.
    """
    form, constraints, m = _form(pieces)
    _, sizes, rows = np.linalg.svd(constraints, full_matrices=True)
    free = rows[int((sizes > 1e-10 * sizes.max(initial=0.0)).sum()) :].T
    form = free.T @ form @ free
    # The metric, 1 on controls and 0 on parameters, is 1 - q'q here, q the rows of the parameters.
    _, shares, vectors = np.linalg.svd(free[:m], full_matrices=True)
    weights = 1.0 - np.pad(shares, (0, len(form) - len(shares))) ** 2
    vectors = vectors.T
    form = vectors.T @ form @ vectors
    alone = int((weights < 1e-10).sum())  # variations of parameters without any of the control
    if alone:
        own, mixed = form[:alone, :alone], form[:alone, alone:]
        if np.linalg.eigvalsh(own)[0] <= 0:
            return float("inf")
        form = form[alone:, alone:] - mixed.T @ np.linalg.solve(own, mixed)
    if not form.size or alone == len(weights):
        return 0.0
    root = np.sqrt(weights[alone:])
    return float(1.0 - np.linalg.eigvalsh(form / root / root[:, None])[0])


def _form(pieces: Sequence[_Pieces]) -> tuple[Matrix, Matrix, int]:
    """Second variation and linearised end conditions as functions of (parameters, controls of all pieces).

    The controls' coordinates are such that int du' H_uu du is their sum of squares.
    """
    m, step = pieces[0].sizes[1], 1.0 / PIECES
    columns = m + sum(piece.sizes[2] for piece in pieces) * PIECES
    form, constraints, at = np.zeros((columns, columns)), [np.zeros((0, columns))], m
    parameters = np.eye(m, columns)
    dx = np.zeros((0, columns))
    for piece in pieces:
        dx, curved = _begin(piece, dx, parameters, pieces)
        form += curved
        n, _, k = piece.sizes
        identity = np.eye(n)
        half = 0.5 * step * piece.F[:, :n].transpose(2, 0, 1)
        inverse = np.linalg.inv(identity - half)
        through = inverse @ (identity + half)
        into = step * inverse @ piece.F[:, n:].transpose(2, 0, 1)
        shape = (
            np.linalg.inv(np.linalg.cholesky(step * piece.H_uu)).transpose(0, 2, 1)
            if k
            else np.zeros((PIECES, 0, 0))
        )
        path = np.zeros((PIECES, n + m + k, columns))
        for j in range(PIECES):
            path[j, n : n + m] = parameters
            path[j, n + m :, at + j * k : at + (j + 1) * k] = shape[j]
            after = through[j] @ dx + into[j] @ path[j, n:]
            path[j, :n] = 0.5 * (dx + after)
            dx = after
        at += k * PIECES
        weighted = step * piece.W.transpose(2, 0, 1) @ path
        form += path.reshape(-1, columns).T @ weighted.reshape(-1, columns)
        rows, curved = _finish(piece, dx, parameters)
        form += curved
        constraints.append(rows)
    return 0.5 * (form + form.T), np.vstack(constraints), m


def _curved(piece: _Pieces, function: Any, x: Vector, scale: Vector, moves: Matrix) -> tuple[Matrix, Matrix]:
    """Along `moves`: first derivatives (rows, columns) of function(z, p), second ones of its first row."""
    z = np.concatenate([x, piece.parameter_values])[:, None]
    scale = np.concatenate([scale, piece.parameter_scale])

    def split(w: Any) -> Any:
        return stacked(function(w[: len(x)], piece.parameters(w[len(x) :])), w.shape[1:])

    first = jacobian(split, z, scale)[:, :, 0] @ moves
    second = hessian(lambda w: split(w)[0], z, scale)[:, :, 0]
    return first, moves.T @ second @ moves


def _begin(
    piece: _Pieces, dx: Matrix, parameters: Matrix, pieces: Sequence[_Pieces]
) -> tuple[Matrix, Matrix]:
    """Variation of the phase's initial state, and lam(0) times its second derivative."""
    arc, problem = piece.arc, piece.arc.problem
    lam = arc.costate(np.zeros(1))[:, 0] / arc.objective_scale
    if arc.index == 0:
        x, scale, moves = np.zeros(0), np.zeros(0), parameters

        def values(z: Any, p: Any) -> Any:
            return problem.start(p, COMPLEX)
    else:
        before = pieces[arc.index - 1].arc
        x, scale = before.state(np.array([before.duration]))[:, 0], before.state_scale
        moves = np.vstack([dx, parameters])

        def values(z: Any, p: Any) -> Any:
            return problem.links[arc.index - 1](before.phase.state_record(*z), p, COMPLEX)

    if not len(moves):
        return np.zeros((len(lam), parameters.shape[1])), np.zeros((parameters.shape[1],) * 2)

    def weighted(z: Any, p: Any) -> list[Any]:
        out = values(z, p)
        return [sum(a * b for a, b in zip(lam, out, strict=True)), *out]

    first, second = _curved(piece, weighted, x, scale, moves)
    return first[1:] / arc.state_scale[:, None], second


def _finish(piece: _Pieces, dx: Matrix, parameters: Matrix) -> tuple[Matrix, Matrix]:
    """Linearised end conditions (scaled) and the second derivative of phi + nu.psi at the phase's end."""
    arc = piece.arc
    nu, _ = end_multipliers(arc)
    last = arc.index == len(arc.problem.phases) - 1

    def values(z: Any, p: Any) -> list[Any]:
        psi = arc.phase.evaluate("end", z, (), p, COMPLEX)
        total = sum(a * b for a, b in zip(nu, psi, strict=True))
        total = total + arc.problem.objective(arc.phase.state_record(*z), p, COMPLEX) if last else total
        return [total / arc.objective_scale, *psi]

    x = arc.state(np.array([arc.duration]))[:, 0]
    first, second = _curved(piece, values, x, arc.state_scale, np.vstack([dx, parameters]))
    size = np.array([arc.problem.scales.of(v.unit) for v in arc.phase.end_conditions])
    return first[1:] / size[:, None], second
