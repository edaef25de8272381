"""The double integrator x'' = u: least energy, least time, and least energy under a ceiling; closed forms."""

from __future__ import annotations

import math
from functools import partial

from perilune import Indirect, Pseudospectral
from perilune.problem import Conditions, FreeParameter, Parameter, Phase, Problem, ScalarControl, Variable
from problems.answered import Answered


def least_energy(ceiling: float = math.inf) -> Problem:
    """Least integral of u^2/2 over 1 s from v = 1 back to v = -1 at the same place, x <= ceiling.

    Without ceiling J = 2 with u = -2; with one <= 1/6 J = 4/(9 ceiling) and an arc on it: Bryson, Denham, Dreyfus 1963.
    """
    phase = Phase(
        name="swing",
        states=(
            Variable(name="x", unit="m", upper=ceiling),
            Variable(name="v", unit="m/s"),
            Variable(name="cost", unit="m^2/s^3"),
        ),
        controls=(ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u),
        duration="T",
        end=Conditions(lambda x, p, xp: (x.x, x.v + p.v0), place="m", speed="m/s"),
        end_guess=lambda p, xp: (0 * p.v0 * p.T, -p.v0, p.v0 * p.v0 / p.T),
    )
    return Problem(
        name="least_energy",
        phases=(phase,),
        start=lambda p, xp: (0.0, p.v0, 0.0),
        given={"T": Parameter(value=1.0, unit="s"), "v0": Parameter(value=1.0, unit="m/s")},
        objective=lambda x, p, xp: x.cost,
        objective_unit="m^2/s^3",
    )


def least_time() -> Problem:
    """From rest to rest over 1 m with |u| <= 1 m/s^2: u = 1 for 1 s, then -1 for 1 s."""
    phase = Phase(
        name="move",
        states=(Variable(name="x", unit="m"), Variable(name="v", unit="m/s")),
        controls=(ScalarControl(name="u", unit="m/s^2", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (x.v, u.u),
        duration="t_f",
        end=Conditions(lambda x, p, xp: (x.x - p.distance, x.v), place="m", speed="m/s"),
        end_guess=lambda p, xp: (p.distance, 0 * p.distance),
    )
    return Problem(
        name="least_time",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0),
        given={"distance": Parameter(value=1.0, unit="m")},
        free=(FreeParameter(name="t_f", unit="s", lower=0.0, guess=1.0),),
        objective=lambda x, p, xp: p.t_f,
        objective_unit="s",
    )


CEILING = 0.1

ANSWERED = (
    Answered(
        name="least energy",
        make=least_energy,
        objective=2.0,
        source="Bryson, Ho 1975, section 3.11: u = -2, x = t - t^2",
        costate=(0.0, 2.0, 1.0),
    ),
    Answered(
        name="least time, bang-bang",
        make=least_time,
        objective=2.0,
        source="Bryson, Ho 1975, section 3.9: lambda = (-1, t - 1), so that H + 1 = 0 at both ends",
        costate=(-1.0, -1.0),
        free={"t_f": 2.0},
        switches=(1.0,),
    ),
    Answered(
        name="least energy, active state bound",
        make=partial(least_energy, CEILING),
        objective=4 / (9 * CEILING),
        source="Bryson, Denham, Dreyfus 1963: x = l from 3 l to 1 - 3 l",
        methods=(Indirect(), Pseudospectral()),
        mesh_gain=10.0,  # the mesh holds x below the ceiling to its accuracy, and dJ/dl = -J/l
    ),
)
