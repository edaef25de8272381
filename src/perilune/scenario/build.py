"""From the checked sections of a file to its problem."""

from __future__ import annotations

from perilune.models.descent import Ignition, Site, Steering, powered_descent
from perilune.models.landing import Orbit, Retro, Vehicle, hybrid_landing
from perilune.models.precision import Approach, Corridor, precision_landing
from perilune.problem.problem import Problem
from perilune.scenario.plausible import body_of, check_altitudes, check_vehicle
from perilune.scenario.sections import (
    DescentDocument,
    Document,
    LandingDocument,
    PrecisionDocument,
    SteeringSection,
    ThrottleSection,
    VehicleSection,
)


def problem_of(sections: Document) -> Problem:
    """Build the problem that a file states; errors of its model, and of values that cannot be right together."""
    if isinstance(sections, LandingDocument):
        return _landing(sections)
    return _descent(sections) if isinstance(sections, DescentDocument) else _precision(sections)


def _landing(sections: LandingDocument) -> Problem:
    body, orbit, vehicle = body_of(sections.body), sections.orbit, sections.vehicle
    check_altitudes(orbit, sections.landing, body)
    return hybrid_landing(
        _vehicle(vehicle),
        None if sections.retro is None else Retro(**sections.retro.model_dump()),
        Orbit(**orbit.model_dump()),
        body,
        sections.landing.altitude,
    )


def _descent(sections: DescentDocument) -> Problem:
    return powered_descent(
        _vehicle(sections.vehicle),
        Ignition(**sections.start.model_dump()),
        Site(**sections.site.model_dump()),
        body_of(sections.body),
        **sections.problem.model_dump(exclude={"kind"}),
        steering=_steering(sections.steering),
        throttle=None if sections.throttle is None else _throttle(sections.throttle),
        j2=sections.body.j2,
    )


def _precision(sections: PrecisionDocument) -> Problem:
    return precision_landing(
        _vehicle(sections.vehicle),
        Approach(**sections.approach.model_dump()),
        Site(**sections.site.model_dump()),
        Corridor(**sections.corridor.model_dump()),
        _throttle(sections.throttle),
        body_of(sections.body),
        j2=sections.body.j2,
    )


def _vehicle(section: VehicleSection) -> Vehicle:
    check_vehicle(section)
    return Vehicle(**section.model_dump())


def _steering(section: SteeringSection | None) -> Steering | None:
    if section is None:
        return None
    return Steering(
        elevation=(section.elevation_lower, section.elevation_upper),
        azimuth=(section.azimuth_lower, section.azimuth_upper),
    )


def _throttle(section: ThrottleSection) -> tuple[float, float]:
    return section.lower, section.upper
