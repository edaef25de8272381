"""Statement of a powered descent in a file."""

from __future__ import annotations

from perilune.models.descent.problem import Choices, Ignition, Site, Steering, powered_descent
from perilune.models.kind import Kind, Section
from perilune.models.physics.bodies import BODIES, OblateBody
from perilune.models.physics.vehicle import Throttle, Vehicle
from perilune.problem import Problem


def _make_descent(
    problem: Choices,
    body: OblateBody,
    vehicle: Vehicle,
    start: Ignition,
    site: Site,
    steering: Steering | None,
    throttle: Throttle | None,
) -> Problem:
    shares = None if throttle is None else (throttle.lower, throttle.upper)
    return powered_descent(
        vehicle, start, site, body, **vars(problem), steering=steering, throttle=shares, j2=body.j2
    )  # fmt: skip


STATED = Kind(
    name="powered_descent",
    about="A descent in three dimensions from a state over a body to rest above it.",
    sections={
        "problem": Section(record=Choices),
        "body": Section(record=OblateBody, known=BODIES),
        "vehicle": Section(record=Vehicle),
        "start": Section(record=Ignition),
        "site": Section(record=Site, required=False, otherwise=Site(), absent='may be omitted if target = "anywhere"'),
        "steering": Section(record=Steering, required=False),
        "throttle": Section(record=Throttle, required=False),
    },
    make=_make_descent,
    example={
        "problem.target": "site",
        "vehicle.mass": "15 t",
        "vehicle.thrust": "45 kN",
        "vehicle.specific_impulse": "365 s",
        "vehicle.dry_mass": "8 t",
        "site.altitude": "2 km",
        "site.longitude": "5 deg",
        "site.latitude": "76 deg",
    },
)
