"""Landings: Meditch's in closed form, the two papers'."""

from __future__ import annotations

import math
from functools import partial

from cho import cho_landing
from perilune.problem import Conditions, FreeParameter, Parameter, Phase, Problem, ScalarControl, Variable
from problems.answered import Answered
from problems.peng import peng


def meditch() -> Problem:
    """Vertical soft landing with the least integral of thrust, throttle off and then full: Meditch 1964."""
    phase = Phase(
        name="descent",
        states=(
            Variable(name="h", unit="m"),
            Variable(name="v", unit="m/s"),
            Variable(name="m", unit="kg", lower=0.1),
            Variable(name="effort", unit="N*s"),
        ),
        controls=(ScalarControl(name="thrust", unit="N", lower=0.0, upper=1.227),),
        dynamics=lambda x, u, p, xp: (x.v, -p.g + u.thrust / x.m, -u.thrust / p.c, u.thrust),
        duration="t_f",
        end=Conditions(lambda x, p, xp: (x.h, x.v), touchdown="m", touchdown_speed="m/s"),
        end_guess=lambda p, xp: (0 * p.h, 0 * p.v, 0.6 * p.m, 0.4 * p.m * p.c),
    )
    return Problem(
        name="meditch",
        phases=(phase,),
        start=lambda p, xp: (p.h, p.v, p.m, 0.0),
        given={
            "g": Parameter(value=1.0, unit="m/s^2"),
            "c": Parameter(value=2.349, unit="m/s"),
            "h": Parameter(value=1.0, unit="m"),
            "v": Parameter(value=-0.783, unit="m/s"),
            "m": Parameter(value=1.0, unit="kg"),
        },
        free=(FreeParameter(name="t_f", unit="s", lower=0.0, upper=10.0, guess=1.5),),
        objective=lambda x, p, xp: x.effort,
        objective_unit="N*s",
    )


def constant_mass(gravity: float, height: float, speed: float, most: float) -> Problem:
    """Meditch's landing where the engine takes nothing of the mass: u between 0 and `most` m/s^2, least int u."""
    phase = Phase(
        name="descent",
        states=(Variable(name="h", unit="m"), Variable(name="v", unit="m/s"), Variable(name="effort", unit="m/s")),
        controls=(ScalarControl(name="push", unit="m/s^2", lower=0.0, upper=most),),
        dynamics=lambda x, u, p, xp: (x.v, u.push - p.g, u.push),
        duration="t_f",
        end=Conditions(lambda x, p, xp: (x.h, x.v), touchdown="m", touchdown_speed="m/s"),
        end_guess=lambda p, xp: (0 * p.h, 0 * p.v, 1.5 * p.g * p.t_f),
    )
    given = {"g": (gravity, "m/s^2"), "h": (height, "m"), "v": (speed, "m/s")}
    return Problem(
        name="constant_mass",
        phases=(phase,),
        start=lambda p, xp: (p.h, p.v, 0.0),
        given={name: Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        free=(FreeParameter(name="t_f", unit="s", lower=0.0, upper=50.0, guess=5.0),),
        objective=lambda x, p, xp: x.effort,
        objective_unit="m/s",
    )


def constant_mass_effort(gravity: float, height: float, speed: float, most: float) -> float:
    """It falls to a speed w, and what it fell and what it brakes make up the height."""
    brake = most - gravity  # height + (speed^2 - w^2)/(2 gravity) = w^2/(2 brake)
    fastest = math.sqrt((2 * gravity * height + speed * speed) / (1 + gravity / brake))
    return most * fastest / brake


def ordinary() -> Problem:
    """Cho et al. 2015 without a retro burn."""
    return cho_landing().with_given(retro_delta_v=0.0)


ANSWERED = (
    Answered(
        name="Meditch's lander",
        make=meditch,
        objective=1.42031259905,
        uncertainty=5e-12,
        source="Meditch 1964, closed form",
        costate=(0.267592863436, -0.209525212070, 1.70643283042, 1.0),
        free={"t_f": 1.39680808911},
        switches=(0.239259108626,),
    ),
    *(
        Answered(
            name=f"lander of constant mass, {duration:.2f} s",
            make=partial(constant_mass, *numbers),
            objective=effort,
            source="closed form",
            free={"t_f": duration},
            switches=(switch,),
            truth=partial(constant_mass_effort, *numbers),
        )
        for numbers, effort, duration, switch in (
            ((1.5, 10.0, -2.0, 3.0), 8.24621125124, 4.16414083416, 1.41540375041),
            ((1.625, 20.0, -2.5, 4.0), 10.9544511501, 5.20273916929, 2.46412638177),
        )
    ),
    Answered(
        name="ordinary landing",
        make=ordinary,
        objective=-154.54135,
        uncertainty=1e-5,
        source="Cho, Kim, Leeghim 2015, table 1: 154.5413 kg; further digits by independent computation",
    ),
    Answered(
        name="hybrid landing",
        make=cho_landing,
        objective=-160.618584,
        uncertainty=1e-6,
        source="Cho, Kim, Leeghim 2015, table 1: 160.6186 kg; further digits by independent computation",
    ),
    Answered(
        name="descent to a site in three dimensions",
        make=partial(peng, minimise="flight_time"),
        objective=472.796,
        uncertainty=5e-4,
        source="Peng, Li, Shen, Tang 2012, (26): 472.74 s; with its constants decoded, by independent computation",
    ),
)
