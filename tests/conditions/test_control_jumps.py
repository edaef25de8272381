"""Jumps of a control between minima of H: from between its bounds to one of them, and from one minimum to another."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import perilune as pl
from perilune.conditions.pontryagin import derive
from perilune.proof.feasible.phase_data import PhaseData
from perilune.proof.sufficient.singular_arcs import Singular
from test_control_law import given, slide, variables

METHODS = (pl.Indirect(), pl.Pseudospectral())
Cost = Callable[[Any, Any], Any]


def cart(cost: Cost, unit: str, way: float, speed: float | None = None) -> pl.Problem:
    """So far in 3 s from rest, |u| <= 1 m/s^2, with the least integral of a cost of u; at any speed or at one."""
    phase = pl.Phase(
        name="run",
        states=variables(s="m", v="m/s", C=unit),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, cost(u.u, p.one)),
        duration="T",
        end=pl.Conditions.of(
            lambda x, p, xp: (x.s - p.L,) if speed is None else (x.s - p.L, x.v - p.vT),
            variables(place="m") if speed is None else variables(place="m", speed="m/s"),
        ),
    )
    ends = {"L": (way, "m"), "T": (3.0, "s"), "one": (1.0, "m/s^2")}
    return pl.Problem(
        name="cart",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given=given(**ends, **({} if speed is None else {"vT": (speed, "m/s")})),
        objective=lambda x, p, xp: x.C,
        objective_unit=unit,
        scales=pl.Scales(length=1.0, time=1.0, mass=1.0),
    )


def bound(cost: Cost, way: float, speed: float | None) -> float:
    """The greatest of int min_u [c(u) - (a + b (T - t)) u] dt + a v(T) + b s(T): no flight has less, whatever a, b are.

    As the set of what controls reach is convex (Lyapunov), the least J is that.
    """
    u, t = np.linspace(-1.0, 1.0, 2001), (np.arange(600) + 0.5) / 200.0
    c = cost(u, 1.0)

    def dual(y: Any) -> float:
        a, b = (0.0, y[0]) if speed is None else y
        pull = a + b * (3.0 - t)
        least = np.array([(c - q * u).min() for q in pull])
        return float(-(3.0 * least.mean() + a * (speed or 0.0) + b * way))

    start = [0.1] if speed is None else [0.1, 0.2]
    return -float(minimize(dual, start, method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-11}).fun)


def cubic(u: Any, one: Any) -> Any:
    return u**3


def falling_cubic(u: Any, one: Any) -> Any:
    return -(u**3)


def two_minima(u: Any, one: Any) -> Any:
    """Convex below 0 and above 1/2, and concave between."""
    return u**4 - one * u**3


def well(u: Any, one: Any) -> Any:
    """Least at 1/2 and at -1/2."""
    return u**4 - 0.5 * one * one * u * u


JUMPS = [
    (cubic, "m^3/s^5", 1.0, None, METHODS[0], (0.5, -1.0)),  # tangent from -1 to u^3
    (falling_cubic, "m^3/s^5", 1.0, None, METHODS[1], (-0.5, 1.0)),
    (falling_cubic, "m^3/s^5", 1.9, 0.2, METHODS[0], (1.0, -0.5)),
    (two_minima, "m^4/s^7", 1.0, None, METHODS[0], None),
    (well, "m^4/s^7", 2.0, 0.0, METHODS[1], (0.5, -0.5)),
]


@pytest.mark.parametrize(("cost", "unit", "way", "speed", "method", "jump"), JUMPS)
def test_a_jump_between_minima(
    cost: Cost, unit: str, way: float, speed: float | None, method: Any, jump: tuple[float, float] | None
) -> None:
    """J is that of the dual, and u jumps along the tangent that meets c(u) twice."""
    solution = pl.solve(cart(cost, unit, way, speed), method)
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 3)
    assert solution.objective == pytest.approx(bound(cost, way, speed), abs=2e-5)
    control = solution.trajectories[0].control
    jumps = np.nonzero(np.diff(control.time) == 0)[0]
    found = [(control.values[i, 0], control.values[i + 1, 0]) for i in jumps]
    found = [pair for pair in found if abs(pair[0] - pair[1]) > 1e-3]
    if jump is not None:
        assert found == [pytest.approx(jump, abs=1e-7)]


def test_a_cubic_that_meets_its_chord_in_the_middle_is_not_singular() -> None:
    solution = pl.solve(cart(cubic, "m^3/s^5", 1.0), verify=2)
    assert Singular.of(PhaseData(solution=solution, index=0)).places == (None, None)


def test_only_what_bends_both_ways_has_more_events() -> None:
    """A quadratic cost has no jumps from between the bounds, a quartic one two minima there."""
    assert {regime for own in derive(slide(5.0)).phases[0].regimes for regime in own} == {"lower", "interior", "upper"}
    (quartic,) = derive(cart(well, "m^4/s^7", 2.0, 0.0)).phases
    assert quartic.regimes == (("lower",), ("low_interior",), ("interior",), ("upper",))
    jumps = {way for event in quartic.events if not event.steady for way in event.switches.items()}
    assert {(1, 2), (2, 1), (0, 2), (3, 1), (1, 3)} <= jumps
