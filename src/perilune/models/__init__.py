"""Bodies, vehicles and the landing problems made of them."""

from perilune.models.bodies import BODIES, CERES, EUROPA, MARS, MERCURY, MOON, Body
from perilune.models.landing import Orbit, Retro, Vehicle, hybrid_landing

__all__ = [
    "BODIES",
    "CERES",
    "EUROPA",
    "MARS",
    "MERCURY",
    "MOON",
    "Body",
    "Orbit",
    "Retro",
    "Vehicle",
    "hybrid_landing",
]
