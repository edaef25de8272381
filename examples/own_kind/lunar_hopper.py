"""A hop over flat Moon as a kind of its own: `kind = "lunar_hop"` in a file, once this package is installed."""

from __future__ import annotations

from typing import Any

import perilune as pl
from perilune.core import quantity, record
from perilune.models import Kind, Section
from perilune.problem import given_of


@record("problem")
class Aim:
    """What is flown: nothing to choose."""


@record("hopper")
class Hopper:
    """The vehicle."""

    mass: float = quantity("kg", "1000 kg", above=0.0, outside="must be positive", about="at lift-off")
    thrust: float = quantity("N", "4000 N", above=0.0, outside="must be positive", about="at full throttle")
    exhaust_speed: float = quantity("m/s", "3000 m/s", above=0.0, outside="must be positive", about="of the engine")


@record("hop")
class Hop:
    """The way."""

    distance: float = quantity("m", "2 km", above=0.0, outside="must be positive", about="from rest to rest")
    gravity: float = quantity("m/s^2", "1.62 m/s^2", default=1.62, above=0.0, outside="must be positive", about="g")


def _variables(**units: str) -> tuple[pl.Variable, ...]:
    return tuple(pl.Variable(name=name, unit=unit) for name, unit in units.items())


def _rates(x: Any, u: Any, p: Any, xp: Any) -> tuple[Any, ...]:
    push = u.thrust / x.m
    return x.vx, x.vy, push * u.along, push * u.up - p.hop_gravity, -u.thrust / p.hopper_exhaust_speed


def lunar_hop(problem: Aim, hopper: Hopper, hop: Hop) -> pl.Problem:
    """The problem of the records of a file's sections; each key is the parameter ``section_key``."""
    phase = pl.Phase(
        name="hop",
        states=_variables(x="m", y="m", vx="m/s", vy="m/s", m="kg"),
        controls=(
            pl.UnitVectorControl(names=("along", "up")),
            pl.ScalarControl(name="thrust", unit="N", lower=0.0, upper="hopper_thrust"),
        ),
        dynamics=_rates,
        duration="flight_time",
        end=pl.Conditions(
            lambda x, p, xp: (x.x - p.hop_distance, x.y, x.vx, x.vy),
            place="m",
            ground="m",
            speed_along="m/s",
            speed_up="m/s",
        ),
        end_guess=lambda p, xp: (p.hop_distance, 0.0, 0.0, 0.0, 0.9 * p.hopper_mass),
    )
    return pl.Problem(
        name="lunar_hop",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0, 0.0, p.hopper_mass),
        given=given_of(hopper, hop),
        records=(hopper, hop),  # whose ranges hold for values that are given later, too
        free=(pl.FreeParameter(name="flight_time", unit="s", lower=0.0, upper=300.0, guess=60.0),),
        objective=lambda x, p, xp: -x.m,
        objective_unit="kg",
        scales=pl.Scales(length=1000.0, time=30.0, mass=1000.0),
        results=pl.Quantities(lambda start, end, p, xp: (end.m,), landed_mass="kg"),
    )


LUNAR_HOP = Kind(
    name="lunar_hop",
    about="A hop over flat Moon from rest to rest, with the least propellant.",
    sections={"problem": Section(record=Aim), "hopper": Section(record=Hopper), "hop": Section(record=Hop)},
    make=lunar_hop,
    example={},
)
