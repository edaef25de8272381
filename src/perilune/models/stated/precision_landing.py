"""Statement of a precision landing in a file."""

from __future__ import annotations

from perilune.models.descent.problem import Site
from perilune.models.kind import Kind, Section, Undecided
from perilune.models.physics.bodies import BODIES, OblateBody, UniformGravity
from perilune.models.physics.vehicle import Throttle, Vehicle
from perilune.models.precision.final_descent import FinalDescent
from perilune.models.precision.problem import Approach, Corridor, precision_landing
from perilune.problem import Problem


def _make_precision(
    problem: Undecided,
    body: OblateBody | UniformGravity,
    vehicle: Vehicle,
    throttle: Throttle,
    approach: Approach,
    site: Site | None,
    corridor: Corridor | None,
    final: FinalDescent | None,
) -> Problem:
    shares, j2 = (throttle.lower, throttle.upper), getattr(body, "j2", 0.0)
    return precision_landing(vehicle, approach, site, corridor, shares, body, final=final, j2=j2)


STATED = Kind(
    name="precision_landing",
    about="The last kilometres: to a given point with the least propellant, within a corridor.",
    sections={
        "problem": Section(record=Undecided),
        "body": Section(record=OblateBody, known=BODIES, instead=UniformGravity),
        "vehicle": Section(record=Vehicle),
        "throttle": Section(record=Throttle),
        "approach": Section(record=Approach),
        "site": Section(record=Site, required=False, absent="omitted over flat ground"),
        "corridor": Section(record=Corridor, required=False),
        "final": Section(record=FinalDescent, required=False),
    },
    make=_make_precision,
    example={
        "vehicle.mass": "2 t",
        "vehicle.thrust": "8 kN",
        "vehicle.dry_mass": "1200 kg",
        "approach.east_speed": "50 m/s",
        "approach.up_speed": "-30 m/s",
        "site.longitude": "0 deg",
        "site.latitude": "-85 deg",
        "corridor.tilt": "50 deg",
        "corridor.slope": "20 deg",
    },
)
