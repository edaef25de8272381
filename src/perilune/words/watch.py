"""What a long computation tells while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """One iteration of Newton's method or of a mesh: norms are scaled, damping is alpha of Cho et al. 2015 (23)."""

    number: int
    residual: float
    step: float
    damping: float


# Receives each iteration, and lines of text.
Watch = Callable[[Iteration | str], None]


def silent(event: Iteration | str) -> None:
    """Watch nothing."""
