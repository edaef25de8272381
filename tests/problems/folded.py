"""Problems whose extremals fold and cross, with all of them in closed form."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import perilune as pl
from perilune.problem import Variable
from perilune.problem.problem import Parameter


def cusp(a: float, b: float) -> pl.Problem:
    """From x = 0 in 1 s with the least int u^2/2 + x(1)^4/4 + (a - 1) x(1)^2/2 + b x(1).

    u is constant, so J = x^4/4 + a x^2/2 + b x of the end x: the cusp of R. Thom. Its extremals are the roots of
    x^3 + a x + b = 0: three where 4 a^3 + 27 b^2 < 0, of which the middle one is a maximum; the least J is the one
    with x b < 0, and jumps at b = 0. Around the cusp at a = b = 0 the two minima are one smooth family.
    """
    phase = pl.Phase(
        name="way",
        states=(Variable(name="x", unit="1"), Variable(name="c", unit="1/s")),
        controls=(pl.ScalarControl(name="u", unit="1/s"),),
        dynamics=lambda x, u, p, xp: (u.u, 0.5 * u.u * u.u),
        duration="T",
    )
    return pl.Problem(
        name="cusp",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0),
        given={
            "T": Parameter(value=1.0, unit="s"),
            "a": Parameter(value=a, unit="1"),
            "b": Parameter(value=b, unit="1"),
            "rate": Parameter(value=1.0, unit="1/s"),
        },
        objective=lambda x, p, xp: x.c / p.rate + x.x**4 / 4 + (p.a - 1.0) * x.x**2 / 2 + p.b * x.x,
        objective_unit="1",
    )


def cusp_ends(a: float, b: float) -> NDArray[np.float64]:
    """The ends x of all extremals, rising."""
    roots = np.roots([1.0, 0.0, a, b])
    return np.sort(roots[np.abs(roots.imag) < 1e-9].real).astype(np.float64)


def cusp_cost(a: float, b: float) -> float:
    """The least J."""
    x = cusp_ends(a, b)
    return float((x**4 / 4 + a * x**2 / 2 + b * x).min())


def two_cusps(a: float, b: float) -> pl.Problem:
    """Two of them at once, along x and y: J = x^4/4 + (a - 0.3) x^2/2 + b x + y^4/4 - a y^2/2 + (b + 0.1) y.

    Layers of minima begin and end at folds of saddles, and at a maximum of the same sign of det dh/dy.
    """
    one = cusp(a, b)
    phase = pl.Phase(
        name="way",
        states=(Variable(name="x", unit="1"), Variable(name="y", unit="1"), Variable(name="c", unit="1/s")),
        controls=(pl.ScalarControl(name="u", unit="1/s"), pl.ScalarControl(name="v", unit="1/s")),
        dynamics=lambda x, u, p, xp: (u.u, u.v, 0.5 * (u.u * u.u + u.v * u.v)),
        duration="T",
    )

    def objective(x: Any, p: Any, xp: Any) -> Any:
        along = x.x**4 / 4 + (p.a - 1.3) * x.x**2 / 2 + p.b * x.x
        return x.c / p.rate + along + x.y**4 / 4 - (p.a + 1.0) * x.y**2 / 2 + (p.b + 0.1) * x.y

    return replace(one, name="two_cusps", phases=(phase,), start=lambda p, xp: (0.0, 0.0, 0.0), objective=objective)


def two_cusps_cost(a: float, b: float) -> float:
    """The least J."""
    return cusp_cost(a - 0.3, b) + cusp_cost(-a, b + 0.1)
