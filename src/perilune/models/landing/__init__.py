"""Hybrid-engine landing from an orbit: problem and presolve."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.models.landing.problem import LandingSite, Orbit, hybrid_landing
    from perilune.models.physics.vehicle import Retro, Vehicle

__all__ = ["LandingSite", "Orbit", "Retro", "Vehicle", "hybrid_landing"]

__getattr__: Callable[[str], Any] = deferred(
    __name__, {"problem": "LandingSite Orbit hybrid_landing", ".physics.vehicle": "Retro Vehicle"}
)
