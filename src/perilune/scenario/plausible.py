"""Plausibility of values that are possible one by one and cannot be right together.

Slips of units that no single key shows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NoReturn, cast

from perilune.core import PeriluneError, record_values
from perilune.models import Body, UniformGravity, matching_known_body

if TYPE_CHECKING:
    from perilune.models import Interface, Orbit, Returner, Vehicle

GRAVITATIONAL_CONSTANT = 6.6743e-11  # m^3/(kg s^2), CODATA 2018; only for the plausibility of a body's density
# Comets have about 500 kg/m^3 and Mercury and the Earth 5500; a slip between km and m changes the density
# 1e9-fold.
DENSITIES = (50.0, 50_000.0)
FURTHEST_FLAT = 1e6  # m; over a hundredth of that the ground of the Earth falls by 8 m
HIGHEST_GROUND = 1e-3  # of the radius
DEEPEST_SITE = 0.1  # of the radius; the deepest basin known, on Vesta, has about 0.08


def refuse_slips(records: Mapping[str, Any]) -> None:
    """Raise PeriluneError for the first slip in the records of a file; records of other packages are not checked."""
    body, orbit, start, approach, interface, vehicle = (
        cast("Any", records.get(name)) for name in ("body", "orbit", "start", "approach", "interface", "vehicle")
    )
    if isinstance(body, Body):
        _check_body(body)
    if is_stock(orbit, "Orbit"):
        _check_orbit(orbit, body)
    if is_stock(start, "Ignition"):
        _check_away("start.altitude", start.altitude, body)
    if is_stock(approach, "Approach"):
        for name in ("east", "north", "up"):
            _check_away(f"approach.{name}", getattr(approach, name), body)
    for name, kinds in (("landing", ("LandingSite",)), ("site", ("Site", "Landing"))):
        place: Any = records.get(name)
        if is_stock(place, *kinds) and isinstance(body, Body):
            _check_site(f"{name}.altitude", place.altitude, body)
    if is_stock(interface, "Interface"):
        _check_interface(interface, body)
    if is_stock(vehicle, "Vehicle", "Returner"):
        _check_vehicle(vehicle)


def is_stock(value: Any, *names: str) -> bool:
    """Return True if a value is a record of ours by one of these names: asked by name, as classes would be imported.

    Parameters
    ----------
    value
        Anything.
    names
        Names of classes in `perilune.models`.
    """
    return type(value).__name__ in names and type(value).__module__.startswith("perilune.models.")


def _check_body(body: Body) -> None:
    """Refuse a density or rotation that no body has, as a slip of units."""
    like = matching_known_body(body)
    density = body.gravitational_parameter / GRAVITATIONAL_CONSTANT / (4 / 3 * math.pi * body.radius**3)
    if not DENSITIES[0] < density < DENSITIES[1]:
        _refuse_implausible(
            "body.gravitational_parameter and body.radius do not belong together",
            got=f"a mean density of {density:.3g} kg/m^3",
            expected="about 500 to 6000 kg/m^3",
            advice="check for m in place of km, or km in place of m",
        )
    break_up = math.sqrt(body.gravitational_parameter / body.radius**3)
    degrees = math.degrees(1.0)
    if like is not None and any(
        _relatively_close(body.rotation_rate, like.rotation_rate * f, 0.02) for f in (degrees, 1 / degrees)
    ):
        _refuse_implausible(
            "body.rotation_rate mixes degrees and radians",
            got=f"{body.rotation_rate:.5g} rad/s",
            expected=f"{like.rotation_rate:.5g} rad/s for the {like.name}",
            advice="write the unit the number is in: rad/s or deg/s",
        )
    if abs(body.rotation_rate) >= break_up:
        _refuse_implausible(
            "body.rotation_rate exceeds the break-up rate of the body",
            got=f"{body.rotation_rate:.5g} rad/s",
            expected=f"less than {break_up:.3g} rad/s",
            advice="check for rad/s in place of deg/s",
        )


def _check_orbit(orbit: Orbit, body: Body) -> None:
    """Refuse altitudes that a slip between km and m makes; one below the surface is checked elsewhere."""
    terrain = 1e-4 * body.radius
    for name, altitude in record_values(orbit).items():
        if 0.0 < altitude < terrain:
            _refuse_implausible(
                f"orbit.{name} is lower than the terrain",
                got=f"{altitude:g} m",
                expected=f"at least {terrain:.3g} m",
                advice="check for m in place of km",
            )
    _check_away("orbit.parking_altitude", orbit.parking_altitude, body)


def _check_away(key: str, way: float, body: Body | UniformGravity) -> None:
    if isinstance(body, UniformGravity):
        if abs(way) > FURTHEST_FLAT:
            _refuse_implausible(
                f"{key} is so far away that no ground is flat",
                got=f"{way / 1e3:g} km",
                expected=f"at most {FURTHEST_FLAT / 1e3:g} km",
                advice="check for km in place of m, or state a round body",
            )
    elif abs(way) > 50 * body.radius:
        _refuse_implausible(
            f"{key} is so far away that the body no longer rules the flight",
            got=f"{way / 1e3:g} km",
            expected=f"at most {50 * body.radius / 1e3:.3g} km, 50 radii",
            advice="check for km in place of m",
        )


def _check_site(key: str, altitude: float, body: Body) -> None:
    if altitude < -DEEPEST_SITE * body.radius:
        _refuse_implausible(
            f"{key} is deeper than any valley",
            got=f"{altitude / 1e3:g} km",
            expected=f"at least {-DEEPEST_SITE * body.radius / 1e3:.3g} km",
            advice="altitudes are above the radius of the body; check for km in place of m",
        )


def _check_interface(interface: Interface, body: Body) -> None:
    """Refuse an interface as low as mountains."""
    if interface.altitude < HIGHEST_GROUND * body.radius:
        _refuse_implausible(
            "interface.altitude is lower than mountains",
            got=f"{interface.altitude:g} m",
            expected=f"at least {HIGHEST_GROUND * body.radius / 1e3:.3g} km",
            advice="check for m in place of km",
        )


def _check_vehicle(vehicle: Vehicle | Returner) -> None:
    """Refuse a thrust that is out of proportion."""
    acceleration = vehicle.thrust / vehicle.mass
    if acceleration > 500.0:
        _refuse_implausible(
            "vehicle.thrust is more than a lander withstands",
            got=f"{acceleration:.3g} m/s^2",
            expected="below 500 m/s^2",
            advice="check for kN in place of N, or g in place of kg",
        )
    if is_stock(vehicle, "Vehicle") and acceleration < 1e-8:  # the light of the Sun does more
        _refuse_implausible(
            "vehicle.thrust is too small for a lander",
            got=f"{acceleration:.3g} m/s^2",
            expected="above 1e-8 m/s^2",
            advice="check for N in place of kN",
        )


def _refuse_implausible(what: str, *, got: str = "", expected: str = "", advice: str = "") -> NoReturn:
    raise PeriluneError(what, got=got, expected=expected, advice=advice)


def _relatively_close(a: float, b: float, relative: float) -> bool:
    return abs(a - b) <= relative * abs(b)
