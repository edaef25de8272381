"""Answers at many points of an atlas as arrays, and when two of their costs count as equal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.core import Matrix, Vector

_CLEARLY = 1e-3  # relative: cells give J to 1e-6 where one step is enough, and are never so wrong
_SAME = 1e-10  # relative: J of one flight by way of two charts


def clearly_worse(cost: Any, best: Any) -> Any:
    """Return True where the J that a cell gives cannot be better than what was found; numbers or arrays.

    Parameters
    ----------
    cost, best
        J of the cell and of the best answer, canonical; numbers or arrays.
    """
    return cost > best + _CLEARLY * (1.0 + abs(best))


def equal_cost(cost: Any, best: Any) -> Any:
    """Return True where two J are equal to rounding; numbers or arrays.

    Parameters
    ----------
    cost, best
        J, canonical; numbers or arrays.
    """
    return abs(cost - best) <= _SAME * (1.0 + abs(best))


class Answered(IntEnum):
    """Reason why a point has an answer or none."""

    YES = 0
    OUTSIDE = 1  # of the region, or no number
    IMPOSSIBLE = 2  # physics refuses it
    NOT_BUILT = 3  # its block is not there, or damaged
    NONE = 4  # no sheet has an answer there
    ENDS = 5  # a sheet that might be better ends in its cell, breaks the path there, or is not borne out


@dataclass(frozen=True, kw_only=True, repr=False)
class Answers:
    """Answers at many points, (points,) each; NaN where there is none.

    Attributes
    ----------
    answered
        `Answered` of each.
    objective
        J [SI].
    free
        Free parameters by name [SI].
    sheet
        Number of the sheet, counted through all charts.
    steps
        Number of Newton steps.
    guess_error, error_bound
        As of `perilune.atlas.query.answer.Query`.
    slopes
        dJ/dp [SI], (points, d).
    """

    answered: NDArray[np.int64]
    objective: Vector
    free: Mapping[str, Vector]
    sheet: NDArray[np.int64]
    steps: NDArray[np.int64]
    guess_error: Vector
    error_bound: Vector
    slopes: Matrix

    def __repr__(self) -> str:
        return f"<Answers at {np.count_nonzero(self.good)} of {len(self.good)} points>"

    @property
    def good(self) -> NDArray[np.bool_]:
        """Return a mask of the points that have an answer."""
        return self.answered == Answered.YES
