"""A steep entry with the least heat load: a cost of 1e7 J/m^2 beside kilometres and seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from perilune.core import Scales
from perilune.problem import Conditions, FreeParameter, Parameter, Phase, Problem, ScalarControl, Variable


def _rates(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Planar entry over a round planet at rest; stagnation heating after Sutton, Graves (1971)."""
    density = p.density * xp.exp(-x.h / p.scale_height)
    r = p.radius + x.h
    push = 0.5 * density * x.v * x.v * p.area / p.mass
    gravity = p.mu / (r * r)
    return (
        x.v * xp.sin(x.gamma),
        -push * (p.drag + p.polar * u.lift * u.lift) - gravity * xp.sin(x.gamma),
        push * u.lift / x.v + (x.v / r - gravity / x.v) * xp.cos(x.gamma),
        p.heating * xp.sqrt(density / p.nose) * x.v**3,
    )


def limited_entry(load: float, rate: float) -> Problem:
    """`cool_entry` with no more than a load [m/s^2], in which the lift is, and a rate of heating [W/m^2]."""

    def path(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
        density = p.density * xp.exp(-x.h / p.scale_height)
        push = 0.5 * density * x.v * x.v * p.area / p.mass
        drag = p.drag + p.polar * u.lift * u.lift
        return (
            1 - push * xp.sqrt(drag * drag + u.lift * u.lift) / p.most_load,
            1 - p.heating * xp.sqrt(density / p.nose) * x.v**3 / p.most_rate,
        )

    free = cool_entry(heat=1e7)
    limits = Variable(name="load", unit="1"), Variable(name="rate", unit="1")
    given = {"most_load": Parameter(value=load, unit="m/s^2"), "most_rate": Parameter(value=rate, unit="W/m^2")}
    return replace(
        free, phases=(replace(free.phases[0], path=Conditions(path, *limits)),), given={**free.given, **given}
    )


def cool_entry(heat: float | None = None) -> Problem:
    """From 60 km and 3 km/s to 30 km and 1.5 km/s; `heat` is the scale of the heat load [J/m^2]."""
    phase = Phase(
        name="entry",
        states=(
            Variable(name="h", unit="m"),
            Variable(name="v", unit="m/s"),
            Variable(name="gamma", unit="rad"),
            Variable(name="Q", unit="J/m^2", scale=heat),
        ),
        controls=(ScalarControl(name="lift", lower=-1.0, upper=1.0),),
        dynamics=_rates,
        duration="time",
        end=Conditions(lambda x, p, xp: (x.h - p.last_height, x.v - p.last_speed), height="m", speed="m/s"),
        end_guess=lambda p, xp: (p.last_height, p.last_speed, -0.1, p.typical_heat),
    )
    given = {
        "mu": (3.986e14, "m^3/s^2"), "radius": (6.371e6, "m"), "density": (1.225, "kg/m^3"),
        "scale_height": (7200.0, "m"), "area": (10.0, "m^2"), "mass": (2000.0, "kg"), "drag": (0.5, "1"),
        "polar": (3.0, "1"), "heating": (1.74e-4, "kg^0.5/m"), "nose": (1.0, "m"), "height": (60e3, "m"),
        "speed": (3000.0, "m/s"), "path_angle": (-0.15, "rad"), "last_height": (30e3, "m"),
        "last_speed": (1500.0, "m/s"), "typical_heat": (1e7, "J/m^2"),
    }  # fmt: skip
    return Problem(
        name="cool_entry",
        phases=(phase,),
        start=lambda p, xp: (p.height, p.speed, p.path_angle, 0.0 * p.typical_heat),
        given={name: Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        free=(FreeParameter(name="time", unit="s", lower=1.0, upper=2000.0, guess=60.0),),
        objective=lambda x, p, xp: x.Q,
        objective_unit="J/m^2",
        objective_scale=heat,
        scales=Scales(length=1e5, time=100.0, mass=2000.0),
    )
