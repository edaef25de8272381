"""Goddard's rocket with drag: full thrust, a singular arc, and a coast to the greatest altitude.

Bryson 1999, section 6.5; the constants of Betts 2010, example 4.9, who has 18550.872 ft by three phases. Along the
singular arc H does not depend on the thrust, so that a direct method in one phase finds a control that chatters.
"""

from __future__ import annotations

from perilune.core import Scales
from perilune.problem import Conditions, FreeParameter, Parameter, Phase, Problem, ScalarControl, Variable
from problems.answered import Answered

FOOT = 0.3048
SLUG = 14.593902937206
POUND = SLUG * FOOT  # force


def goddard() -> Problem:
    """Greatest altitude of a rocket that burns 2 of its 3 slugs."""
    phase = Phase(
        name="ascent",
        states=(
            Variable(name="h", unit="m", lower=0.0),
            Variable(name="v", unit="m/s", lower=0.0),
            Variable(name="m", unit="kg", lower=1.0 * SLUG, upper=3.0 * SLUG),
        ),
        controls=(ScalarControl(name="thrust", unit="N", lower=0.0, upper=193.044 * POUND),),
        dynamics=lambda x, u, p, xp: (
            x.v,
            (u.thrust - p.drag * x.v * x.v * xp.exp(-x.h / p.scale_height)) / x.m - p.g,
            -u.thrust / p.c,
        ),
        duration="t_f",
        end=Conditions(lambda x, p, xp: (x.m - p.dry_mass,), dry="kg"),
        end_guess=lambda p, xp: (p.scale_height, 0 * p.c, p.dry_mass),
    )
    return Problem(
        name="goddard",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, p.mass),
        given={
            "g": Parameter(value=32.174 * FOOT, unit="m/s^2"),
            "c": Parameter(value=1580.9425279876559 * FOOT, unit="m/s"),
            "drag": Parameter(value=5.49153484923381010e-5 * SLUG / FOOT, unit="kg/m"),
            "scale_height": Parameter(value=23800.0 * FOOT, unit="m"),
            "mass": Parameter(value=3.0 * SLUG, unit="kg"),
            "dry_mass": Parameter(value=1.0 * SLUG, unit="kg"),
        },
        free=(FreeParameter(name="t_f", unit="s", lower=0.0, upper=200.0, guess=40.0),),
        objective=lambda x, p, xp: -x.h,
        objective_unit="m",
        scales=Scales(length=23800.0 * FOOT, time=25.0, mass=3.0 * SLUG),
    )


ANSWERED = (
    Answered(
        name="Goddard's rocket with a singular arc",
        make=goddard,
        objective=-18550.872 * FOOT,
        uncertainty=0.005 * FOOT,
        source="Betts 2010, example 4.9",
    ),
)
