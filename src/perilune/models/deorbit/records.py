"""Records of a return: the sections of its file, with unit, range, meaning and source of each number.

A key of a section is the parameter with both names in the problem: `constant` of ``[heating]`` is `heating_constant`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import datetime
from typing import Any

from perilune.core import NUMERIC, PeriluneError, format_quantity, instant, quantity, record, renamed_names, text_field
from perilune.models.physics.aerodynamics import SUTTON_GRAVES
from perilune.models.physics.coast import SHORTEST

MINIMISED = ("flight_time", "transition_time", "propellant", "heat_load")
AIRS: dict[str, tuple[str, ...]] = {
    "exponential": ("density", "scale_height"), "us1976": (), "nrlmsis": ("f107", "f107a", "ap"), "file": ("file",),
}  # fmt: skip
BANKS = ("free", "reversed")
PASSES = ("ascending", "descending")
LONGEST_COAST = 10 * 86400.0  # s; what is longer is flown by no method, and begins better from a newer orbit
_TURNS: dict[str, Any] = {"least": -4 * math.pi, "most": 4 * math.pi}
_LATITUDE: dict[str, Any] = {
    "least": -0.5 * math.pi - 1e-12, "most": 0.5 * math.pi + 1e-12, "outside": "lies beyond the pole",
    "hint": "are longitude and latitude exchanged?",
}  # fmt: skip
_SPEED: dict[str, Any] = {"above": 0.0, "most": 1e5, "hint": "check for km/s in place of m/s"}
_ANGLE: dict[str, Any] = {"least": -0.5 * math.pi, "most": 0.5 * math.pi, "hint": "negative is below the horizon"}
_DOWN: dict[str, Any] = {**_ANGLE, "most": 0.0, "outside": "points upwards, but the vehicle arrives from above"}
_ENTERING: dict[str, Any] = {"least": 100.0, "most": 1e5, "hint": "is it in m/s, or in km/s?"}


def _one_of(section: str, stated: dict[str, Any], *, needed: bool) -> None:
    """Refuse two ways of saying one thing, and none where one is needed."""
    found = [name for name, value in stated.items() if value is not None]
    if len(found) > 1 or (needed and not found):
        names = [f"{section}.{name}" for name in stated]
        raise PeriluneError(
            f"{' and '.join(f'{section}.{n}' for n in found)} state the same quantity"
            if found
            else f"{names[0]} is missing",
            got=f"{len(found)} of them",
            expected="one of " + ", ".join(names),
            advice="leave the others out" if found else f"state {' or '.join(names)}",
        )


@record("problem")
class Aim:
    """Objective of a return, and its epoch."""

    minimise: str = text_field(
        "flight_time", *MINIMISED, default="flight_time",
        about="flight_time (from ignition to the end), transition_time (to the interface), propellant or heat_load",
    )  # fmt: skip
    epoch: str | None = text_field(
        "2026-06-01T12:00:00Z", default=None, about="time at t = 0, UTC unless stated otherwise; nrlmsis needs it"
    )

    def __post_init__(self) -> None:
        self.instant()

    def instant(self) -> datetime | None:
        """Return the epoch in UTC; refuse any other text."""
        return None if self.epoch is None else instant(self.epoch, "problem.epoch")


@record("orbit")
class ReturnOrbit:
    """Orbit before the return: a circle by its radius, or an ellipse by its perigee and apogee."""

    radius: float | None = quantity("m", "6678.14 km", default=None, above=0.0, about="of a circular orbit")
    perigee_altitude: float | None = quantity("m", "350 km", default=None, about="above the body's radius")
    apogee_altitude: float | None = quantity("m", "400 km", default=None, about="above the body's radius")
    argument_of_perigee: float | None = quantity(
        "rad", "30 deg", default=None, **_TURNS, about="from the ascending node to the perigee"
    )  # fmt: skip
    inclination: float = quantity("rad", "50 deg", least=0.0, most=math.pi, about="against the equator")
    node_longitude: float | None = quantity(
        "rad", "-27 deg", default=None, **_TURNS,
        about="of the ascending node at t = 0, if no [manoeuvre] states where ignition is",
    )  # fmt: skip
    argument_of_latitude: float | None = quantity(
        "rad", "120 deg", default=None, **_TURNS, about="from the ascending node to the vehicle at t = 0"
    )  # fmt: skip
    longest_coast: float | None = quantity(
        "s", "5600 s", default=None, above=SHORTEST, most=LONGEST_COAST,
        about="longest coast before ignition, whose length is then optimised; default: ignition at the start",
    )  # fmt: skip

    def __post_init__(self) -> None:
        if self.perigee_altitude is None and self.apogee_altitude is None:
            _one_of("orbit", {"radius": self.radius, "perigee_altitude": None}, needed=True)
            return
        missing = [
            n for n in ("perigee_altitude", "apogee_altitude", "argument_of_perigee") if getattr(self, n) is None
        ]
        _one_of("orbit", {"radius": self.radius, "perigee_altitude": self.perigee_altitude}, needed=True)
        low, high = self.perigee_altitude, self.apogee_altitude
        if missing or low is None or high is None or low > high:
            raise PeriluneError(
                f"orbit.{missing[0]} is missing"
                if missing
                else "orbit.perigee_altitude is above orbit.apogee_altitude",
                expected="an ellipse: perigee_altitude <= apogee_altitude, and argument_of_perigee",
                advice="or state only orbit.radius, of a circular orbit",
            )


@record("manoeuvre")
class Manoeuvre:
    """The place on the orbit at which the flight begins, and with it ignition unless there is a coast."""

    longitude: float = quantity("rad", "16 deg", **_TURNS, about="east")
    latitude: float = quantity("rad", "39.5 deg", **_LATITUDE, about="north; geodetic above an ellipsoid")
    going: str = text_field("descending", *PASSES, called="pass", about="ascending (northwards) or descending there")


@record("vehicle")
class Returner:
    """A vehicle before its burn, and what the air does to it."""

    mass: float = quantity("kg", "500 kg", above=0.0, about="before the burn", also=("wet_mass", "initial_mass"))
    thrust: float = quantity("N", "100 N", above=0.0, about="of the engine, which burns at full thrust")
    exhaust_velocity: float | None = quantity("m/s", "3000 m/s", default=None, **_SPEED, about="of the engine")
    specific_impulse: float | None = quantity(
        "s", "306 s", default=None, above=20.0, most=1000.0, hint="an exhaust velocity in m/s has its own key",
        about="of the engine, in place of its exhaust velocity",
    )  # fmt: skip
    dry_mass: float | None = quantity(
        "kg",
        "300 kg",
        default=None,
        above=0.0,
        about="mass that must be left after the burn; default: the mass that enters the atmosphere",
    )
    drag_area: float | None = quantity("m^2", "0.6 m^2", default=None, above=0.0, about="drag coefficient times area")
    ballistic_coefficient: float | None = quantity(
        "kg/m^2", "300 kg/m^2", default=None, above=0.0, about="mass over drag area, in place of drag_area"
    )
    base_radius: float | None = quantity(
        "m", "0.5 m", default=None, above=0.0, about="of a sphere-cone in Newtonian flow, in place of a drag area"
    )
    cone_angle: float | None = quantity(
        "rad", "20 deg", default=None, least=0.0, below=0.5 * math.pi, about="half angle of the sphere-cone"
    )
    nose_radius: float | None = quantity(
        "m", "0.3 m", default=None, above=0.0, about="at the stagnation point; needed for heat rate and heat load"
    )
    lift_to_drag: float | None = quantity(
        "1", "0.25", default=None, above=0.0, most=10.0, about="if stated there is a lift, turned by the bank angle"
    )
    bank: str | None = text_field(
        "reversed", *BANKS, default=None,
        about="free (default): the whole lift, at any bank angle; reversed: bank reversals cancel the lateral lift"
        " and leave a fraction of the lift up or down",
    )  # fmt: skip

    def __post_init__(self) -> None:
        engine = {"exhaust_velocity": self.exhaust_velocity, "specific_impulse": self.specific_impulse}
        _one_of("vehicle", engine, needed=True)
        names = ("drag_area", "ballistic_coefficient", "base_radius")
        _one_of("vehicle", {name: getattr(self, name) for name in names}, needed=False)
        if (self.base_radius is None) != (self.cone_angle is None):
            raise PeriluneError(
                "a sphere-cone has a base_radius and a cone_angle", expected="both of them in [vehicle], or neither"
            )
        if (
            self.base_radius is not None
            and (self.nose_radius or 0.0) * math.cos(self.cone_angle or 0.0) > self.base_radius
        ):
            raise PeriluneError(
                "this is not a sphere-cone", got=f"a nose of {self.nose_radius:g} m on a base of {self.base_radius:g}"
                f" m",
                expected="nose_radius cos(cone_angle) <= base_radius, where the nose meets the cone",
            )  # fmt: skip
        if self.bank is not None and self.lift_to_drag is None:
            raise PeriluneError(
                "vehicle.lift_to_drag is missing", got="a bank, and no lift", expected="both, or neither"
            )
        if self.dry_mass is not None and self.dry_mass >= self.mass:
            raise PeriluneError(
                "vehicle.dry_mass leaves no propellant", got=f"{self.dry_mass:g} kg of {self.mass:g} kg",
                expected="vehicle.dry_mass < vehicle.mass",
            )  # fmt: skip

    @property
    def flies_through_air(self) -> bool:
        """Return True if drag is known, by drag area, ballistic coefficient or sphere-cone."""
        return any(v is not None for v in (self.drag_area, self.ballistic_coefficient, self.base_radius))


@record("transition")
class Transition:
    """The way from the end of the burn to the interface."""

    longest_coast: float | None = quantity(
        "s", "3000 s", default=None, above=SHORTEST, most=LONGEST_COAST,
        about="longest coast from the end of the burn to the interface; default: the engine burns all the way",
    )  # fmt: skip


@record("interface")
class Interface:
    """Entry interface, above which there is no air. Speed and angle are relative to the turning body."""

    altitude: float = quantity("m", "120 km", above=0.0, about="of the entry interface")
    speed: float | None = quantity("m/s", "7.5 km/s", default=None, **_ENTERING, about="fixes the speed there")
    speed_lower: float | None = quantity("m/s", "7.5 km/s", default=None, **_ENTERING, about="least speed there")
    speed_upper: float | None = quantity("m/s", "8.8 km/s", default=None, **_ENTERING, about="greatest speed there")
    angle: float | None = quantity("rad", "-6 deg", default=None, **_DOWN, about="fixes the path angle there")
    angle_lower: float | None = quantity("rad", "-9 deg", default=None, **_DOWN, about="steepest path angle there")
    angle_upper: float | None = quantity("rad", "-6 deg", default=None, **_ANGLE, about="flattest path angle there")

    def __post_init__(self) -> None:
        for name, unit in (("speed", "m/s"), ("angle", "rad")):
            fixed, lower, upper = (getattr(self, name + ending) for ending in ("", "_lower", "_upper"))
            bounds = lower if upper is None else upper
            _one_of("interface", {name: fixed, f"{name}_lower": bounds}, needed=False)
            if lower is not None and upper is not None and not lower < upper:
                raise PeriluneError(
                    f"bounds of the {name} at the interface are not a range",
                    got=f"{format_quantity(lower, unit)} to {format_quantity(upper, unit)}",
                    expected=f"interface.{name}_lower < interface.{name}_upper",
                )  # fmt: skip


@record("atmosphere")
class Atmosphere:
    """The air below the interface, which turns with the body."""

    model: str = text_field(
        "exponential", *AIRS,
        about="exponential; us1976 (US Standard Atmosphere); nrlmsis (2.1, by pymsis, along the flight); or file",
    )  # fmt: skip
    density: float | None = quantity(
        "kg/m^3", "1.225 kg/m^3", default=None, above=0.0, about="of an exponential atmosphere at altitude 0"
    )
    scale_height: float | None = quantity(
        "m",
        "7.2 km",
        default=None,
        above=0.0,
        about="of an exponential atmosphere: height over which the density falls by a factor of e",
    )
    file: str | None = text_field(
        "my_air.csv", default=None, file=True,
        about="columns of altitude and density in the units of their headings, else m and kg/m^3; at most 1 MB,"
        " in the scenario's folder",
    )  # fmt: skip
    f107: float | None = quantity(
        "1", "150", default=None, above=0.0, most=1000.0, about="solar flux of the day before [1e-22 W/m^2/Hz]"
    )
    f107a: float | None = quantity("1", "150", default=None, above=0.0, most=1000.0, about="its mean of 81 days")
    ap: float | None = quantity("1", "4", default=None, least=0.0, most=400.0, about="daily geomagnetic index")

    def __post_init__(self) -> None:
        own, known = AIRS.get(self.model, ()), [name for names in AIRS.values() for name in names]
        stated = [name for name in known if getattr(self, name) is not None]
        missing, others = [n for n in own if n not in stated], [n for n in stated if n not in own]
        if missing or others:
            wrong = "is missing" if missing else "belongs to another model"
            raise PeriluneError(
                f"atmosphere.{(missing or others)[0]} {wrong}",
                got=f'model = "{self.model}"',
                expected="with it " + (", ".join(own) or "nothing else"),
                advice="take out " + ", ".join(f"atmosphere.{name}" for name in others) if others else "",
            )


@record("separation")
class Separation:
    """Part of the vehicle that enters the air."""

    mass: float = quantity(
        "kg", "2900 kg", above=0.0, about="mass that enters the atmosphere; the rest is dropped at the interface"
    )


@record("limits")
class Limits:
    """Limits on load, heat rate and dynamic pressure during the entry."""

    load: float | None = quantity(
        "m/s^2", "4.5 g0", default=None, above=0.0, hint="write it in g0 or m/s^2", about="greatest load"
    )  # fmt: skip
    heat_rate: float | None = quantity(
        "W/m^2", "2 MW/m^2", default=None, above=0.0, about="greatest heat rate at the stagnation point"
    )
    dynamic_pressure: float | None = quantity(
        "Pa", "60 kPa", default=None, above=0.0, about="greatest dynamic pressure"
    )


@record("heating")
class Heating:
    """The heat of the air at the stagnation point."""

    constant: float = quantity(
        "kg^0.5/m", "1.7415e-4 kg^0.5/m", default=SUTTON_GRAVES, above=0.0,
        about="of Sutton and Graves: heat rate = constant sqrt(density/nose_radius) V^3; default: that of air",
    )  # fmt: skip


@record("parachute")
class Parachute:
    """Parachute that opens at the end of the entry, and falls steadily to the altitude of the site."""

    altitude: float = quantity(
        "m", "10 km", above=0.0, about="at which it opens; the speed there is limited by site.speed_upper"
    )
    drag_area: float = quantity("m^2", "1000 m^2", above=0.0, about="drag coefficient times area of the canopy")


@record("site")
class Landing:
    """Site at which the flight ends."""

    longitude: float | None = quantity("rad", "-98 deg", default=None, **_TURNS, about="east; free by default")
    latitude: float | None = quantity("rad", "38 deg", default=None, **_LATITUDE, about="north; free by default")
    altitude: float = quantity(
        "m",
        "10 km",
        default=0.0,
        about="of the end of the flight, where a parachute takes over or lands the vehicle",
    )
    speed_upper: float = quantity(
        "m/s", "300 m/s", default=300.0, **_SPEED, about="greatest speed there, or where the [parachute] opens"
    )

    def __post_init__(self) -> None:
        if (self.longitude is None) != (self.latitude is None):
            raise PeriluneError("a site has a longitude and a latitude", expected="both of them in [site], or neither")


def throttled(p: Any) -> bool:
    """Return True if the engine has a throttle."""
    return hasattr(p, "throttle_upper")


def engine_exhaust_speed(p: Any) -> Any:
    """Exhaust speed [m/s] of the engine."""
    if hasattr(p, "vehicle_exhaust_velocity"):
        return p.vehicle_exhaust_velocity
    return p.vehicle_specific_impulse * p.standard_gravity


def total_velocity_change(p: Any, xp: Any = NUMERIC) -> Any:
    """Velocity change [m/s] of all that may be burnt; infinite where nothing is said to be left.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.
    """
    if not is_something_left(p):
        return math.inf
    return engine_exhaust_speed(p) * xp.log(p.vehicle_mass / least_mass_left(p, xp))


def is_something_left(p: Any) -> bool:
    """Return True if a mass that the burn must leave is stated."""
    return hasattr(p, "vehicle_dry_mass") or hasattr(p, "separation_mass")


def least_mass_left(p: Any, xp: Any = NUMERIC) -> Any:
    """Return the mass [kg] that the burn must leave: the larger of dry mass and entering mass; 0 without both.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.
    """
    return xp.fmax(getattr(p, "vehicle_dry_mass", 0.0), getattr(p, "separation_mass", 0.0))


__getattr__: Callable[[str], Any] = renamed_names(__name__, {"Orbit": f"{__name__}.ReturnOrbit"})
