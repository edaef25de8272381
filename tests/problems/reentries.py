"""Re-entries with lift: Apollo's with the least heating, the space shuttle's with the greatest cross range."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import perilune as pl
from perilune.problem import Parameter, Variable
from problems.answered import Answered

FOOT, SLUG = 0.3048, 14.593902937206
DEGREE = math.pi / 180
BTU = 1055.05585262 / FOOT**2  # of heat in a second on a square foot [W/m^2]


def _variables(**units: str) -> tuple[Variable, ...]:
    return tuple(Variable(name=name, unit=unit) for name, unit in units.items())


def _given(**values: tuple[float, str]) -> dict[str, Parameter]:
    return {name: Parameter(value=value, unit=unit) for name, (value, unit) in values.items()}


def apollo() -> pl.Problem:
    """Least heating on the way to a height, speed and level flight; lift and drag follow the angle of attack.

    Stoer, Bulirsch, Introduction to Numerical Analysis, 7.3.7: a boundary value problem so sensitive that it is the
    classical one for multiple shooting. Their unit of length, 1e5 ft, stands for the metre here.
    """

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
        density = p.density * xp.exp(-p.decay * p.radius * x.xi)
        push = 0.5 * p.area * density * x.v
        gravity = p.gravity / (1 + x.xi) ** 2
        return (
            -push * x.v * (1.174 - 0.9 * u.c) - gravity * xp.sin(x.gamma),
            push * 0.6 * u.s + (x.v / (p.radius * (1 + x.xi)) - gravity / x.v) * xp.cos(x.gamma),
            x.v * xp.sin(x.gamma) / p.radius,
            p.heating * x.v**3 * xp.sqrt(density),
        )

    phase = pl.Phase(
        name="entry",
        states=_variables(v="m/s", gamma="rad", xi="1", heat="1"),
        controls=(pl.UnitVectorControl(names=("c", "s")),),
        dynamics=rates,
        duration="time",
        end=pl.Conditions(
            lambda x, p, xp: (x.v - p.last_speed, x.gamma, x.xi - p.last_height),
            speed="m/s",
            angle="rad",
            height="1",
        ),
        end_guess=lambda p, xp: (p.last_speed, 0.0 * p.height, p.last_height, 0.03 + 0.0 * p.height),
    )
    return pl.Problem(
        name="apollo",
        phases=(phase,),
        start=lambda p, xp: (p.speed, p.angle, p.height, 0.0 * p.height),
        given=_given(
            radius=(209.0, "m"), decay=(4.26, "1/m"), density=(2.704e-3, "kg/m^3"), gravity=(3.2172e-4, "m/s^2"),
            area=(53200.0, "m^2/kg"), heating=(10.0, "s^2/kg^0.5/m^1.5"), speed=(0.36, "m/s"),
            angle=(-8.1 * DEGREE, "rad"), height=(4 / 209, "1"), last_speed=(0.27, "m/s"),
            last_height=(2.5 / 209, "1"),
        ),
        free=(pl.FreeParameter(name="time", unit="s", lower=0.0, upper=1000.0, guess=230.0),),
        objective=lambda x, p, xp: x.heat,
        scales=pl.Scales(length=20.0, time=60.0, mass=1.0),
    )  # fmt: skip


def shuttle(hottest: float | None = None) -> pl.Problem:
    """Greatest cross range of a glide over a round Earth at rest (Betts 2010, section 6.1); angle of attack and bank.

    `hottest` is the most heat that the leading edge may take [BTU/ft^2/s]. The longitude follows from the rest.
    """

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
        attack = u.attack / DEGREE
        lift = -0.20704 + 0.029244 * attack
        drag = 0.07854 - 0.61592e-2 * attack + 0.621408e-3 * attack * attack
        push = 0.5 * p.density * xp.exp(-x.h / p.decay) * x.v * p.area / p.mass
        r = p.radius + x.h
        gravity, level = p.mu / (r * r), xp.cos(x.gamma)
        return (
            x.v * xp.sin(x.gamma),
            x.v / r * level * xp.cos(x.heading),
            -push * drag * x.v - gravity * xp.sin(x.gamma),
            push * lift * xp.cos(u.bank) + level * (x.v / r - gravity / x.v),
            push * lift * xp.sin(u.bank) / level + x.v / r * level * xp.sin(x.heading) * xp.tan(x.latitude),
        )

    def cool(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
        attack = u.attack / DEGREE
        edge = 1.0672181 - 0.19213774e-1 * attack + 0.21286289e-3 * attack**2 - 0.10117249e-5 * attack**3
        thin = xp.exp(-0.5 * x.h / p.decay)
        return (1 - edge * p.heating * thin * (x.v / p.fast) ** 3.07 / p.hottest,)

    limited: dict[str, Any] = {} if hottest is None else {"path": pl.Conditions(cool, *_variables(cool="1"))}
    phase = pl.Phase(
        name="entry",
        states=(
            Variable(name="h", unit="m", scale=3e4),
            *_variables(latitude="rad", v="m/s", gamma="rad", heading="rad"),
        ),
        controls=(
            pl.ScalarControl(name="attack", unit="rad", lower=-90 * DEGREE, upper=90 * DEGREE),
            pl.ScalarControl(name="bank", unit="rad", lower=-89 * DEGREE, upper=1 * DEGREE),
        ),
        dynamics=rates,
        duration="time",
        end=pl.Conditions(
            lambda x, p, xp: (x.h - p.last_height, x.v - p.last_speed, x.gamma - p.last_angle),
            height="m",
            speed="m/s",
            angle="rad",
        ),
        end_guess=lambda p, xp: (p.last_height, 0.5 - 0.0 * p.angle, p.last_speed, p.last_angle, 0.0 * p.angle),
        **limited,
    )
    given = _given(
        radius=(20902900 * FOOT, "m"), mu=(0.14076539e17 * FOOT**3, "m^3/s^2"), area=(2690 * FOOT**2, "m^2"),
        density=(0.002378 * SLUG / FOOT**3, "kg/m^3"), decay=(23800 * FOOT, "m"), mass=(203000 / 32.174 * SLUG, "kg"),
        height=(260e3 * FOOT, "m"), speed=(25600 * FOOT, "m/s"), angle=(-1 * DEGREE, "rad"),
        heading=(90 * DEGREE, "rad"), last_height=(80e3 * FOOT, "m"), last_speed=(2500 * FOOT, "m/s"),
        last_angle=(-5 * DEGREE, "rad"),
    )  # fmt: skip
    if hottest is not None:
        given |= _given(
            hottest=(hottest * BTU, "W/m^2"),
            heating=(17700 * math.sqrt(0.002378) * BTU, "W/m^2"),
            fast=(1e4 * FOOT, "m/s"),
        )
    return pl.Problem(
        name="shuttle",
        phases=(phase,),
        start=lambda p, xp: (p.height, 0.0 * p.angle, p.speed, p.angle, p.heading),
        given=given,
        free=(pl.FreeParameter(name="time", unit="s", lower=100.0, upper=5000.0, guess=2000.0),),
        objective=lambda x, p, xp: -x.latitude,
        objective_unit="rad",
        scales=pl.Scales(length=20902900 * FOOT, time=20902900 / 25600, mass=9e4),
    )


# As they are printed: lambda(0) of speed, angle and height, and the control at both ends.
PRINTED_COSTATE = (-0.51143251, -0.6912051, -2.41246816)
PRINTED_CONTROL = (68.2206, -67.3773)
# The range [deg] and the time [s] of `shuttle(70.0)` by the direct method, on a mesh refined to 1e-4.
COOL_RANGE, COOL_TIME = 30.6255, 2198.67

ANSWERED = (
    Answered(
        name="Apollo re-entry",
        make=apollo,
        objective=0.0277824088,
        uncertainty=5e-11,
        source="Stoer, Bulirsch, Introduction to Numerical Analysis, 7.3.7",
    ),
    Answered(
        name="shuttle's cross range",
        make=shuttle,
        objective=-34.1412 * DEGREE,
        uncertainty=0.00005 * DEGREE,
        source="Betts 2010, section 6.1",
    ),
)
