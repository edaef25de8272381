"""Deviation of what is flown from the tables, by one step of Newton's method on all pieces at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector
from perilune.proof.feasible.numerics import significant_size
from perilune.proof.feasible.phase_data import PhaseData
from perilune.proof.feasible.sample_points import BLOCK, ENDS, POINTS, UP_TO, WEIGHTS, Pieces

# Of no more use is a flight that multiplies its errors: what ends where it should is no longer known.
MOST_GROWTH = 1e3
_ROUNDS, _AT_ONCE = 5, 5  # of iterations that solve the equations of a piece
_SETTLED = 4 * np.finfo(float).eps  # of each solution: changes of the last one


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
    at, ends = (arc.read(pieces, shares)[0] / unit for shares in (POINTS, ENDS))
    first, over = start / arc.state_scale - ends[:, 0, 0], {}
    jumps = ends[:, :-1, 1] - ends[:, 1:, 0]
    for crossing in arc.crossings:
        over[np.searchsorted(pieces.left, crossing.time) - 1] = crossing.saltation
    maps = piece_maps(pieces, at, ends, slopes.state, slopes.matrix)
    return Passage.over_pieces(maps, PieceJoints(first, jumps, over), sizes).deviation(maps, still[:n])


def costate_deviation(arc: PhaseData) -> tuple[Deviation, Vector]:
    """Return costates integrated along the table of the state from their value at an end, less their table.

    Start at the end from which errors grow less: a descent through air forgets its speed, so that costates at its
    start follow from those at its end, and not the other way round. Also return their errors at the start, scaled,
    (n,): as grown from the end, or else 1.
    """
    pieces, slopes, still = arc.looked_at
    n, unit = len(arc.state_scale), arc.costate_scale[:, None, None]
    at, ends = (arc.read(pieces, shares)[2] / unit for shares in (POINTS, ENDS))
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
    maps = piece_maps(pieces, at, ends, slope, matrix)
    turned = maps.turned
    ahead, back = Passage.over_pieces(maps, joints, sizes), Passage.over_pieces(turned, joints.turned, sizes)
    backwards = back.growth.sum() < ahead.growth.sum() or not np.isfinite(ahead.growth).all()
    left, most = many * still[n:], MOST_GROWTH * sizes
    found = back.deviation(turned, left).turned if backwards else ahead.deviation(maps, left)
    begun = (np.minimum(back.at_end, most) if backwards else np.ones(n)) / many
    return replace(found, growth=np.minimum(found.growth, most), at_end=np.minimum(found.at_end, most)), begun


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


@dataclass(frozen=True)
class PieceMaps:
    """Newton's step of the collocation on each of N pieces by itself, from a deviation d at its begin.

    Attributes
    ----------
    own, through
        At the points own + through d, (N, n, 4) and (N, n, 4, n).
    over, past
        At the end over + past d, (N, n) and (N, n, n).
    """

    own: Matrix
    through: Any
    over: Matrix
    past: Any

    @property
    def turned(self) -> PieceMaps:
        """Return the same from the end of each piece, in the order from the last: Gauss's rule has no direction."""
        past = _inverses(self.past)
        over = -np.einsum("nij,nj->ni", past, self.over)
        own = self.own + np.einsum("nikl,nl->nik", self.through, over)
        through = self.through @ past[:, None]
        return PieceMaps(own[::-1, :, ::-1], through[::-1, :, ::-1], over[::-1], past[::-1])


def piece_maps(pieces: Pieces, at: Matrix, ends: Matrix, slopes: Matrix, matrix: Any) -> PieceMaps:
    """Solve the equations of the collocation, linearised about the table, on each piece.

    Parameters
    ----------
    pieces
        The N pieces.
    at, ends
        The table at their points (n, N, 4), and at both ends (n, N, 2).
    slopes, matrix
        f (n, N, 4) and its derivatives (N, 4, n, n) on the table.
    """
    defect = ends[:, :, :1] + pieces.width[:, None] * (slopes @ UP_TO.T) - at
    over = ends[:, :, 0] + pieces.width * (slopes @ WEIGHTS) - ends[:, :, 1]
    n, count = over.shape
    own, through = np.empty((count, n, 4)), np.empty((count, n, 4, n))
    for k in range(0, count, BLOCK):
        here = slice(k, k + BLOCK)
        own[here], through[here] = _piece_deviations(pieces.width[here], defect[:, here], matrix[here])
    # At a piece's right end, by the weights: what is the piece's own, and what comes through it.
    bent = (pieces.width[:, None, None, None] * WEIGHTS[:, None, None] * matrix).swapaxes(1, 2).reshape(count, n, 4 * n)
    over = over.T + (bent @ own.swapaxes(1, 2).reshape(count, 4 * n, 1))[:, :, 0]
    past = np.eye(n) + bent @ through.swapaxes(1, 2).reshape(count, 4 * n, n)
    return PieceMaps(own, through, over, past)


@dataclass(frozen=True)
class Passage:
    """Deviations at the begin of each of N pieces, (N, n), and `growth` and `at_end` of `Deviation`."""

    starts: Matrix
    growth: Vector
    at_end: Vector

    @classmethod
    def over_pieces(cls, maps: PieceMaps, joints: PieceJoints, sizes: Vector | None = None) -> Passage:
        """Carry the deviation from piece to piece.

        Parameters
        ----------
        maps
            Of each piece.
        joints
            What happens between the pieces.
        sizes
            Of the components, each at least 1; 1 where they are left out.
        """
        n = maps.past.shape[1]
        sizes = np.ones(n) if sizes is None else sizes
        passed, added = np.array(maps.past), np.array(maps.over)
        for i, matrix in joints.over.items():
            passed[i], added[i] = matrix @ passed[i], matrix @ added[i]
        added[:-1] += joints.jumps.T
        ahead, moved = running_products(passed, added)
        starts = np.concatenate([joints.first[None], moved[:-1] + ahead[:-1] @ joints.first])
        behind, _ = running_products(passed.swapaxes(1, 2)[::-1])
        at_end = np.maximum(sizes, (np.abs(behind.swapaxes(1, 2)) @ sizes).max(axis=0, initial=1.0))
        return cls(starts, np.maximum(at_end, (np.abs(ahead) @ sizes).max(axis=0, initial=1.0)), at_end)

    def deviation(self, maps: PieceMaps, still: Vector) -> Deviation:
        """Return the deviation inside all pieces.

        Parameters
        ----------
        maps
            Of each piece.
        still
            What quadrature leaves open, (n,).
        """
        inside = maps.own + (maps.through @ self.starts[:, None, :, None])[..., 0]
        finals = maps.over + (maps.past @ self.starts[:, :, None])[..., 0]
        return Deviation(
            inside=inside.transpose(1, 0, 2), ends=np.stack([self.starts.T, finals.T], axis=2), still_open=still,
            growth=self.growth, at_end=self.at_end,
        )  # fmt: skip


def running_products(matrices: Any, added: Matrix | None = None) -> tuple[Any, Matrix]:
    """Return the products of matrices up to each, M_i ... M_0, and what x -> M x + b one after the other makes of 0.

    All of a row of blocks at once, then block by block.

    Parameters
    ----------
    matrices
        M, shape (N, n, n).
    added
        b, (N, n); 0 where None.
    """
    count, n, _ = matrices.shape
    length = max(1, math.isqrt(count))
    blocks = -(-count // length)
    M, b = np.zeros((blocks * length, n, n)), np.zeros((blocks * length, n))
    M[:count], M[count:] = matrices, np.eye(n)
    b[:count] = 0.0 if added is None else added
    M, b = M.reshape(blocks, length, n, n), b.reshape(blocks, length, n)
    own = np.empty((blocks, length, n, n + 1))
    own[:, 0, :, :n], own[:, 0, :, n] = M[:, 0], b[:, 0]
    for k in range(1, length):
        own[:, k] = M[:, k] @ own[:, k - 1]
        own[:, k, :, n] += b[:, k]
    before = np.zeros((blocks, n, n + 1))
    before[0, :, :n] = np.eye(n)
    for k in range(1, blocks):
        before[k] = own[k - 1, -1, :, :n] @ before[k - 1]
        before[k, :, n] += own[k - 1, -1, :, n]
    every = own[..., :n] @ before[:, None]
    every[..., n] += own[..., n]
    found = every.reshape(-1, n, n + 1)[:count]
    return found[..., :n], found[..., n]


def _piece_deviations(width: Vector, defect: Matrix, matrix: Any) -> tuple[Matrix, Matrix]:
    """Deviations at the points of each piece from its defect (N, n, 4), and from each component at its start."""
    n, count = defect.shape[:2]
    bent = np.empty((count, 4, n, 4, n))  # in this order: a product would have another
    np.multiply(width[:, None, None, None, None] * UP_TO[:, None, :, None], matrix.swapaxes(1, 2)[:, None], out=bent)
    right = np.zeros((count, 4, n, n + 1))
    right[..., 0] = defect.transpose(1, 2, 0)
    right[..., 1:] = np.eye(n)
    found = fixed_points(bent.reshape(count, 4 * n, 4 * n), right.reshape(count, 4 * n, n + 1)).reshape(right.shape)
    return found[..., 0].swapaxes(1, 2), found[..., 1:].swapaxes(1, 2)


def fixed_points(B: Any, right: Any) -> Any:
    """Solve X = R + B X for small B by iteration, to rounding, and by elimination where that does not settle.

    Parameters
    ----------
    B, right
        Matrices B, (pieces, n, n), and R, (pieces, n, k).
    """
    X, before, settled = np.array(right), np.empty_like(right), np.zeros(len(right), dtype=bool)
    for _ in range(_ROUNDS):
        for _ in range(_AT_ONCE):
            X, before = np.matmul(B, X, out=before), X
            X += right
        settled = (np.abs(X - before).max(axis=1) <= _SETTLED * np.abs(X).max(axis=1)).all(axis=1)
        if settled.all():
            return X
    X[~settled] = _solutions(np.eye(B.shape[1]) - B[~settled], right[~settled])
    return X


def _solutions(systems: Any, right: Any) -> Any:
    """Solve linear systems; NaN where one has no solution, as none that could pass."""
    try:
        return np.linalg.solve(systems, right)
    except np.linalg.LinAlgError:
        return np.full(right.shape, np.nan)


def _inverses(matrices: Any) -> Any:
    """Invert matrices (N, n, n), as `_solutions`."""
    return _solutions(matrices, np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape))
