"""Solution branches (sheets): families of extremals, each smooth in the parameters, and where they may be optimal.

A branch is identified by its active bounds (free parameters or ranges at a bound) and by the sign of det(dh/dy), which
changes only at a fold, where two branches meet. Its conditions have roots beyond the border within which they are
answers (a retro burn below zero): such nodes are kept too, so that a cell reaches across the border of its branch, and
the root at the point itself decides if it is an answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from perilune.problem import Nature


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """Family of extremals.

    Parameters
    ----------
    holds
        Names of free parameters (or end conditions) that are held, and at which side: ``{"retro_delta_v": "lower"}``.
    orientation
        Sign of det(dh/dy).
    nature
        What its extremals were where it was found.
    """

    holds: Mapping[str, str]
    orientation: float
    nature: Nature

    @property
    def minimum(self) -> bool:
        """Return True unless its extremals are locally worst, which are no answers."""
        return self.nature is not Nature.WORST

    def alike(self, other: Sheet) -> bool:
        """Return True if extremals of another can be layers of this one: same active bounds, same side of folds."""
        return self.holds == other.holds and self.orientation == other.orientation

    @property
    def label(self) -> str:
        """Return its active bounds and nature in words."""
        held = ", ".join(f"{name} at its {side} bound" for name, side in self.holds.items())
        return f"{held or 'nothing at a bound'}: {self.nature.dominated.value}"
