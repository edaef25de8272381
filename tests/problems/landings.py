"""Landings: Meditch's in closed form, the two papers'."""

from __future__ import annotations

from functools import partial

from cho import cho_landing
from perilune.problem.controls import Bounded
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.variables import Free, Given, Variable
from problems.answered import Answered
from test_descent import peng


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
        controls=(Bounded(name="thrust", unit="N", lower=0.0, upper=1.227),),
        dynamics=lambda x, u, p, m: (x.v, -p.g + u.thrust / x.m, -u.thrust / p.c, u.thrust),
        duration="t_f",
        end=lambda x, p, m: (x.h, x.v),
        end_conditions=(Variable(name="touchdown", unit="m"), Variable(name="touchdown_speed", unit="m/s")),
        typical_end=lambda p, m: (0 * p.h, 0 * p.v, 0.6 * p.m, 0.4 * p.m * p.c),
    )
    return Problem(
        name="meditch",
        phases=(phase,),
        start=lambda p, m: (p.h, p.v, p.m, 0.0),
        given={
            "g": Given(value=1.0, unit="m/s^2"),
            "c": Given(value=2.349, unit="m/s"),
            "h": Given(value=1.0, unit="m"),
            "v": Given(value=-0.783, unit="m/s"),
            "m": Given(value=1.0, unit="kg"),
        },
        free=(Free(name="t_f", unit="s", lower=0.0, upper=10.0, typical=1.5),),
        objective=lambda x, p, m: x.effort,
        objective_unit="N*s",
    )


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
