"""Deviation of what is flown from the tables, by one step of Newton's method on all pieces at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector
from perilune.proof.feasible.numerics import significant_size
from perilune.proof.feasible.phase_data import PhaseData
from perilune.proof.feasible.sample_points import BLOCK, ENDS, UP_TO, WEIGHTS, Pieces

# Of no more use is a flight that multiplies its errors: what ends where it should is no longer known.
MOST_GROWTH = 1e3


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
