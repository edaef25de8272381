"""Statement of a landing from a circular orbit in a file."""

from __future__ import annotations

from perilune.models.kind import Kind, Section, Undecided
from perilune.models.landing.problem import LandingSite, Orbit, hybrid_landing
from perilune.models.physics.bodies import BODIES, Body
from perilune.models.physics.vehicle import Retro, Vehicle
from perilune.problem import Problem


def _make_hybrid(
    problem: Undecided, body: Body, vehicle: Vehicle, retro: Retro | None, orbit: Orbit, landing: LandingSite
) -> Problem:
    return hybrid_landing(vehicle, retro, orbit, body, landing.altitude)


STATED = Kind(
    name="hybrid_landing",
    about="A lander on its way from a circular parking orbit to the ground: an impulsive retro burn, then thrust.",
    sections={
        "problem": Section(record=Undecided, required=False, otherwise=Undecided()),
        "body": Section(record=Body, known=BODIES),
        "vehicle": Section(record=Vehicle),
        "retro": Section(record=Retro, required=False),
        "orbit": Section(record=Orbit),
        "landing": Section(record=LandingSite, required=False, otherwise=LandingSite()),
    },
    make=_make_hybrid,
    example={"retro.specific_impulse": "310 s", "landing.altitude": "0 km"},
)
