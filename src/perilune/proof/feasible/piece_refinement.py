"""Refinement of the pieces of a table: they are halved until the integrals of all rates along them settle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from perilune.core import Vector
from perilune.proof.feasible.sample_points import IN_HALVES, WEIGHTS, Pieces, Slopes, interpolating_cubics, polynomial

# Halves of a piece may differ from the whole by so much, scaled, before they are looked at apart; by how much they
# still do is no error that is forgotten, but part of every difference that is reported.
_SETTLED = 1e-13
_BENT = 1e-10  # rates times the width of a piece, scaled: how far they may be from a cubic
_HALVINGS, _MOST_OPEN = 60, 4000


def halve_until_settled(
    slopes_of: Callable[[Pieces], Slopes], pieces: Pieces
) -> tuple[list[Pieces], list[Slopes], Vector]:
    """Halve pieces until the integrals of all rates along them settle.

    Parameters
    ----------
    slopes_of
        The equations of motion on pieces.
    pieces
        The pieces to begin with.

    Returns
    -------
    list of Pieces, list of Slopes, Vector
        The settled pieces, the rates on them, and what is still open in the integrals, scaled, (rows,).
    """
    own, found, slopes, still = slopes_of(pieces), [], [], np.zeros(())
    for left in range(_HALVINGS, -1, -1):
        finer = slopes_of(halves := pieces.halves)
        whole, parts = (s.rows() @ WEIGHTS * p.width for s, p in ((own, pieces), (finer, halves)))
        difference = np.abs(whole - parts.reshape(*whole.shape, 2).sum(axis=-1))
        # What vanishes at the points, and integrates to nothing over either half, shows at those of the halves.
        bent = polynomial(interpolating_cubics(own.rows())[:, :, None], IN_HALVES) - finer.rows().reshape(
            *whole.shape, 8
        )
        again = (difference > _SETTLED).any(axis=0) | (np.abs(bent).max(axis=2) * pieces.width > _BENT).any(axis=0)
        again &= (left > 0) & (len(pieces) < _MOST_OPEN)
        found.append(pieces[~again])
        slopes.append(own[~again])
        still = still + difference[:, ~again].sum(axis=1)
        if not again.any():
            break
        pieces, own = halves[np.repeat(again, 2)], finer[np.repeat(again, 2)]
    return found, slopes, still
