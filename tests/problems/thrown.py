"""A push and a throw below a ceiling: a condition on a phase in which nothing is steered, with its closed form."""

from __future__ import annotations

import numpy as np

import perilune as pl
from perilune.problem import Parameter, Variable

LATE = 1.0  # m^2/s^4: what a second in the air is worth


def thrown(ceiling: float) -> pl.Problem:
    """Pushed up from rest for 1 s, then thrown against 1 m/s^2 down to 0: least int u^2/2 less LATE for each second.

    The throw from (h, v) rises to h + v^2/2 and lasts v + sqrt(v^2 + 2 h); to push there takes 6 h^2 - 6 h v + 2 v^2.
    """

    def of(**units: str) -> tuple[Variable, ...]:
        return tuple(Variable(name=name, unit=unit) for name, unit in units.items())

    states = of(h="m", v="m/s", c="m^2/s^3")
    push = pl.Phase(
        name="push",
        states=states,
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u),
        duration="T",
    )
    throw = pl.Phase(
        name="throw",
        states=states,
        controls=(),
        dynamics=lambda x, u, p, xp: (x.v, -p.g, -p.late),
        duration="air_time",
        end=pl.Conditions(lambda x, p, xp: (x.h,), *of(down="m")),
        path=pl.Conditions(lambda x, u, p, xp: (p.ceiling - x.h,), *of(room="m")),
    )
    given = {"T": (1.0, "s"), "g": (1.0, "m/s^2"), "late": (LATE, "m^2/s^4"), "ceiling": (ceiling, "m")}
    return pl.Problem(
        name="thrown",
        phases=(push, throw),
        links=(lambda x, p, xp: (x.h, x.v, x.c),),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given={name: Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        free=(pl.FreeParameter(name="air_time", unit="s", guess=3.0),),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s^3",
    )


def thrown_truth(ceiling: float) -> tuple[float, float, float]:
    """J [m^2/s^3] of the throw that rises to the ceiling, v where it begins, and dJ/dceiling.

    With h = l - v^2/2 the throw lasts v + sqrt(2 l), and J' (v) = 0 is a cubic.
    """
    v = np.polynomial.Polynomial([0.0, 1.0])
    h = ceiling - 0.5 * v * v
    J = 6 * h * h - 6 * h * v + 2 * v * v - LATE * (v + np.sqrt(2 * ceiling))
    roots = J.deriv().roots()
    best = min((float(z.real) for z in roots if abs(z.imag) < 1e-12), key=lambda z: float(J(z)))
    return float(J(best)), best, float(12 * h(best) - 6 * best - LATE / np.sqrt(2 * ceiling))
