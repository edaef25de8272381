"""Values that are possible one by one and cannot be right together.

Slips of units that no single key shows.
"""

from __future__ import annotations

import math
from typing import NoReturn

from perilune.models import bodies
from perilune.scenario.schema import quantity_of
from perilune.scenario.sections import BodySection, LandingSection, OrbitSection, VehicleSection
from perilune.words.outcome import PeriluneError, unknown_name

GRAVITATIONAL_CONSTANT = 6.6743e-11  # m^3/(kg s^2), CODATA 2018; only for the plausibility of a body's density
# Comets have about 500 kg/m^3 and Mercury and the Earth 5500; a slip between km and m changes the density
# 1e9-fold.
DENSITIES = (50.0, 50_000.0)
DEEPEST_SITE = 0.1  # of the radius; the deepest basin known, on Vesta, has about 0.08


def body_of(section: BodySection) -> bodies.Body:
    """Body of a section: by its name or by its three quantities."""
    given = section.model_dump(include={"gravitational_parameter", "radius", "rotation_rate"})
    if section.name is not None:
        if any(value is not None for value in given.values()):
            _refuse(
                "body has a name and quantities of its own",
                got=section.name,
                expected="one or the other",
                advice="leave out body.name to use the three quantities",
            )
        if section.name.lower() not in bodies.BODIES:
            raise unknown_name("body", section.name, list(bodies.BODIES))
        return bodies.BODIES[section.name.lower()]
    missing = [name for name, value in given.items() if value is None]
    if missing:
        _refuse(
            f"body.{missing[0]} is missing",
            expected="a name, or " + ", ".join(given),
            advice=f'{missing[0]} = "{quantity_of(f"body.{missing[0]}").example}", or name = "moon" alone',
        )
    like = next((b for b in bodies.BODIES.values() if _close(b.radius, given["radius"], 0.02)), None)
    body = bodies.Body(name=like.name if like else "body", **given)
    _check_body(body, like)
    return body


def _check_body(body: bodies.Body, like: bodies.Body | None) -> None:
    """Density and rotation that no body has are slips of units."""
    density = body.gravitational_parameter / GRAVITATIONAL_CONSTANT / (4 / 3 * math.pi * body.radius**3)
    if not DENSITIES[0] < density < DENSITIES[1]:
        _refuse(
            "body.gravitational_parameter and body.radius do not belong together",
            got=f"a mean density of {density:.3g} kg/m^3",
            expected="about 500 to 6000 kg/m^3",
            advice="look for m in place of km, or km in place of m",
        )
    break_up = math.sqrt(body.gravitational_parameter / body.radius**3)
    degrees = math.degrees(1.0)
    if like is not None and any(
        _close(body.rotation_rate, like.rotation_rate * f, 0.02) for f in (degrees, 1 / degrees)
    ):
        _refuse(
            "body.rotation_rate mixes degrees and radians",
            got=f"{body.rotation_rate:.5g} rad/s",
            expected=f"{like.rotation_rate:.5g} rad/s for the {like.name}",
            advice="write the unit the number is in: rad/s or deg/s",
        )
    if abs(body.rotation_rate) >= break_up:
        _refuse(
            "body.rotation_rate would throw the ground into space",
            got=f"{body.rotation_rate:.5g} rad/s",
            expected=f"less than {break_up:.3g} rad/s",
            advice="look for rad/s in place of deg/s",
        )


def check_altitudes(orbit: OrbitSection, landing: LandingSection, body: bodies.Body) -> None:
    """Refuse altitudes that a slip between km and m makes; what is not above the surface is another matter."""
    terrain = 1e-4 * body.radius
    for name, altitude in orbit:
        if 0.0 < altitude < terrain:
            _refuse(
                f"orbit.{name} is lower than the terrain",
                got=f"{altitude:g} m",
                expected=f"at least {terrain:.3g} m",
                advice="look for m in place of km",
            )
    if orbit.parking_altitude > 50 * body.radius:
        _refuse(
            "orbit.parking_altitude is so high that the body no longer rules the orbit",
            got=f"{orbit.parking_altitude / 1e3:g} km",
            expected=f"at most {50 * body.radius / 1e3:.3g} km, 50 radii",
            advice="look for km in place of m",
        )
    if landing.altitude < -DEEPEST_SITE * body.radius:
        _refuse(
            "landing.altitude is deeper than any valley",
            got=f"{landing.altitude / 1e3:g} km",
            expected=f"at least {-DEEPEST_SITE * body.radius / 1e3:.3g} km",
            advice="altitudes are above the radius of the body; look for km in place of m",
        )


def check_vehicle(vehicle: VehicleSection) -> None:
    """Refuse a thrust that is out of proportion, and a vehicle without propellant."""
    acceleration = vehicle.thrust / vehicle.mass
    if acceleration > 500.0:
        _refuse(
            "vehicle.thrust is more than a lander withstands",
            got=f"{acceleration:.3g} m/s^2",
            expected="below 500 m/s^2",
            advice="look for kN in place of N, or g in place of kg",
        )
    if vehicle.dry_mass is not None and vehicle.dry_mass >= vehicle.mass:
        _refuse(
            "vehicle.dry_mass leaves no propellant",
            got=f"{vehicle.dry_mass:g} kg of {vehicle.mass:g} kg",
            expected="vehicle.dry_mass < vehicle.mass",
            advice="vehicle.mass is that before the retro burn, propellant included; look for g in place of kg",
        )


def _refuse(what: str, *, got: str = "", expected: str = "", advice: str = "") -> NoReturn:
    raise PeriluneError(what, got=got, expected=expected, advice=advice)


def _close(a: float, b: float, relative: float) -> bool:
    return abs(a - b) <= relative * abs(b)
