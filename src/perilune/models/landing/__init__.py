"""Hybrid-engine landing from an orbit: problem and presolve."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.models.landing.problem import LandingSite, Orbit, hybrid_landing
    from perilune.models.physics.vehicle import Retro, Vehicle
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)

__all__ = ["LandingSite", "Orbit", "Retro", "Vehicle", "hybrid_landing"]
