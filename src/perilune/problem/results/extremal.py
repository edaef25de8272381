"""Extremal as a solution lists it: one root of the necessary conditions, and its classification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from perilune.core import check_call


class Nature(Enum):
    """The kind of an extremal with respect to J and its free parameters (the control being optimal along each).

    Nothing shows that the best extremal found is the global one. An answer whose proof fails is not called an optimum.
    """

    BEST = "best of the extremals found"
    BEST_AT_BOUND = "best of the extremals found, at a bound"
    LOCAL_OPTIMUM = "local optimum"
    LOCAL_OPTIMUM_AT_BOUND = "local optimum, at a bound"
    WORST = "locally worst"
    NEAR_GUESS = "an extremal near the guess"
    NEAR_GUESS_AT_BOUND = "an extremal near the guess, at a bound"
    UNPROVED = "not proved an optimum"

    @property
    def dominated(self) -> Nature:
        """Return the kind that the best extremal found takes where a better one is known."""
        return {Nature.BEST: Nature.LOCAL_OPTIMUM, Nature.BEST_AT_BOUND: Nature.LOCAL_OPTIMUM_AT_BOUND}.get(self, self)

    @property
    def unguided(self) -> Nature:
        """Return the kind of an extremal near a guess where the guess was a method's own and no other was found."""
        ranked = {Nature.NEAR_GUESS: Nature.BEST, Nature.NEAR_GUESS_AT_BOUND: Nature.BEST_AT_BOUND}
        return ranked.get(self, self)

    @classmethod
    def _missing_(cls, value: object) -> Nature | None:
        """Return the nature for the words of older files."""
        return {"global optimum": cls.BEST, "global optimum, at a bound": cls.BEST_AT_BOUND}.get(str(value))


@check_call
@dataclass(frozen=True, kw_only=True)
class Extremal:
    """One root of the necessary conditions: free parameters [SI], objective, and classification.

    `unknowns` are those of the indirect method there, canonical, so that it can be found again; empty where not known.
    """

    free: Mapping[str, float]
    objective: float
    nature: Nature
    unknowns: tuple[float, ...] = field(default=(), repr=False)
