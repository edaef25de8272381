"""Descent of Peng, Li, Shen, Tang 2012, section 4, as data: its case, what it prints, other readings of it.

`PRINTED` is for comparison only. The paper does not print the Moon's gravitational parameter, and its g0 is not the one
that its results were made with: `CASE` holds what serves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from perilune import Problem
from perilune.models import Body, Ignition, Site, Steering, Vehicle, powered_descent
from perilune_papers.paper import Printed


@dataclass(frozen=True, kw_only=True)
class PengCase:
    """(25)-(27) as decoded; neither mu nor the g0 of the results is printed."""

    body: Body
    vehicle: Vehicle
    start: Ignition
    site: Site
    steering: Steering


CASE = PengCase(
    body=Body(name="moon", gravitational_parameter=4902.8e9, radius=1738e3, rotation_rate=2.6617e-6),
    vehicle=Vehicle(mass=15e3, thrust=45e3, specific_impulse=365.0, standard_gravity=9.80),
    start=Ignition(
        altitude=15e3, longitude=0.0, latitude=math.radians(90), heading=math.radians(180), forward_speed=1694.3
    ),
    site=Site(altitude=2e3, longitude=math.radians(5), latitude=math.radians(76)),
    steering=Steering(
        elevation=(math.radians(-50), math.radians(50)), azimuth=(math.radians(150), math.radians(220))
    ),
)  # fmt: skip

PRINTED: Printed = Printed({"flight time": (472.74, "s", "text"), "fuel": (5947.2, "kg", "text")})
PRINTED_GRAVITY = 9.81  # m/s^2, the appendix
PRINTED_TIME_LIMIT = 120.0  # s, "less than 2 minutes" on a Pentium 4 with 3.0 GHz
PRINTED_POINTS = 50  # Legendre-Gauss points
# The axes of Fig 4 [deg], the only part of a figure that is legible.
PRINTED_AXES = {"thrust_elevation": (-10.0, 30.0), "thrust_azimuth": (160.0, 190.0)}


def peng_descent(case: PengCase = CASE, **settings: Any) -> Problem:
    """State the paper's descent in Cartesian coordinates; settings as of `powered_descent`."""
    return powered_descent(case.vehicle, case.start, case.site, case.body, **settings)


def problem_of_the_paper(**settings: Any) -> Problem:
    """State it in the paper's coordinates, with bounded angles."""
    return peng_descent(coordinates="spherical", steering=CASE.steering, **settings)


def other_readings() -> dict[str, PengCase]:
    """Cases that differ in one thing that the paper leaves open or prints otherwise."""
    start, site = CASE.start, CASE.site
    return {
        "a Moon that does not turn": replace(CASE, body=replace(CASE.body, rotation_rate=0.0)),
        "g0 = 9.81 m/s², as the appendix prints": replace(
            CASE, vehicle=replace(CASE.vehicle, standard_gravity=PRINTED_GRAVITY)
        ),
        "start at longitude 5°, site at 0°": replace(
            CASE, start=replace(start, longitude=site.longitude), site=replace(site, longitude=start.longitude)
        ),
    }


def implied_gravity() -> float:
    """g0 [m/s^2] with which the printed flight time burns the printed fuel."""
    vehicle = CASE.vehicle
    return vehicle.thrust * PRINTED["flight time"][0] / (vehicle.specific_impulse * PRINTED["fuel"][0])


def parking_altitude() -> float:
    """Altitude [m] of the circular orbit whose Hohmann descent has the printed speed at 15 km.

    v^2 = 2 mu r_a/(r_p (r_a + r_p)), solved for r_a.
    """
    r, v = CASE.body.radius + CASE.start.altitude, CASE.start.forward_speed
    excess = v * v * r / CASE.body.gravitational_parameter
    return r * excess / (2.0 - excess) - CASE.body.radius
