"""Two burns without gravity, the empty first stage dropped between them: the rocket equation is the answer."""

from __future__ import annotations

import math

from perilune import Indirect, Pseudospectral
from perilune.core import Scales
from perilune.problem import FreeParameter, Parameter, Phase, Problem, Variable
from problems.answered import Answered


def staged_burns() -> Problem:
    """Greatest final speed with fixed thrusts and free burning times; what may be burnt are bounds of the masses."""

    def burn(name: str, duration: str, thrust: str, floor: float) -> Phase:
        return Phase(
            name=name,
            states=(Variable(name="v", unit="m/s"), Variable(name="m", unit="kg", lower=floor)),
            dynamics=lambda x, u, p, xp: (getattr(p, thrust) / x.m, -getattr(p, thrust) / p.c),
            duration=duration,
            end_guess=lambda p, xp: (p.c, 0.5 * p.mass),
        )

    return Problem(
        name="staged_burns",
        phases=(burn("first", "t_1", "F_1", 60.0), burn("second", "t_2", "F_2", 15.0)),
        start=lambda p, xp: (0.0, p.mass),
        links=(lambda x, p, xp: (x.v, p.second_mass),),
        given={
            "c": Parameter(value=3000.0, unit="m/s"),
            "F_1": Parameter(value=2000.0, unit="N"),
            "F_2": Parameter(value=500.0, unit="N"),
            "mass": Parameter(value=100.0, unit="kg"),
            "second_mass": Parameter(value=40.0, unit="kg"),
        },
        free=(
            FreeParameter(name="t_1", unit="s", lower=0.0, upper=1000.0, guess=40.0),
            FreeParameter(name="t_2", unit="s", lower=0.0, upper=1000.0, guess=100.0),
        ),
        objective=lambda x, p, xp: -x.v,
        objective_unit="m/s",
        scales=Scales(length=3e5, time=100.0, mass=100.0),
    )


def rocket_equation() -> float:
    """Minus the speed that both stages give."""
    return -3000 * (math.log(100 / 60) + math.log(40 / 15))


ANSWERED = (
    Answered(
        name="two burns with a mass drop",
        make=staged_burns,
        objective=rocket_equation(),
        source="rocket equation",
        costate=(-1.0, -30.0),
        free={"t_1": 60.0, "t_2": 150.0},
        methods=(Pseudospectral(),),
        refused=((Indirect(), r"no extremal was found[\s\S]*m of first reaches its bound[\s\S]*end condition"),),
    ),
)
