"""Limits that can only be used up, as of energy or propellant: stated on the way, they bind at the end alone."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from scipy.optimize import brentq, minimize_scalar

import perilune as pl
from perilune.structures.monotone_limits import with_budgets
from test_control_law import given, variables

METHODS = (pl.Indirect(), pl.Pseudospectral())
ENERGY, SPEED = "m^2/s^3", "m/s"
Rate = Callable[[Any], Any]


def cart(
    limit: float, rate: Rate = lambda u: u * u, unit: str = ENERGY, *, most: float = math.inf, stated: str = "path"
) -> pl.Problem:
    """Least time over 10 m from rest to rest with |u| <= most, and int rate(u) dt at most `limit`."""
    used = pl.Variable(name="E", unit=unit, upper=limit if stated == "bound" else math.inf)
    path: dict[str, Any] = {}
    if stated == "path":
        path = {"path": pl.Conditions(lambda x, u, p, xp: (p.budget - x.E,), left=unit)}
    phase = pl.Phase(
        name="run",
        states=(*variables(s="m", v="m/s"), used),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=-most, upper=most),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, rate(u.u)),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.s - p.L, x.v), place="m", speed="m/s"),
        **path,
    )
    return pl.Problem(
        name="budget",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given=given(L=(10.0, "m"), **({"budget": (limit, unit)} if stated == "path" else {})),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.1, upper=100.0, guess=8.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
        scales=pl.Scales(length=1.0, time=1.0, mass=1.0),
    )


def thrusters(budget: float, stated: str) -> pl.Problem:
    """The cart with two thrusters of 1.1 m/s^2, whose velocity gain together is limited: bang, coast, bang."""
    used = pl.Variable(name="gain", unit=SPEED, upper=budget if stated == "bound" else math.inf)
    path: dict[str, Any] = {}
    if stated == "path":
        path = {"path": pl.Conditions(lambda x, u, p, xp: (p.budget - x.gain,), left=SPEED)}
    phase = pl.Phase(
        name="run",
        states=(*variables(s="m", v="m/s"), used),
        controls=tuple(pl.ScalarControl(name=name, unit="m/s^2", lower=0.0, upper=1.1) for name in ("ahead", "astern")),
        dynamics=lambda x, u, p, xp: (x.v, u.ahead - u.astern, u.ahead + u.astern),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.s - p.L, x.v), place="m", speed="m/s"),
        **path,
    )
    own = {"budget": (budget, SPEED)} if stated == "path" else {}
    problem = cart(1.0)
    return problem.changed(name="thrusters", phases=(phase,), given=given(L=(10.0, "m"), **own), form=None)


def least_time(energy: float, most: float) -> float:
    """T with u = most until w before the middle, then linear through 0 there: int u^2 and the way in closed form."""

    def way(w: float) -> tuple[float, float]:
        """Half the time, and twice the way of the first half, where the energy is used up."""
        half = (energy / 2 - most**2 * w / 3) / most**2 + w
        full = half - w  # at u = most
        speed = most * full
        return half, 2 * (speed * full / 2 + speed * w + most * w * w / 3)

    w: Any = brentq(lambda w: way(w)[1] - 10.0, 1e-3, 1.5 * energy / most**2, xtol=1e-15)
    return 2 * way(w)[0]


@pytest.mark.parametrize(("method", "stated"), [(METHODS[0], "path"), (METHODS[1], "bound")])
@pytest.mark.parametrize(
    ("limit", "most", "truth"),
    [
        (5.0, math.inf, (12 * 10**2 / 5.0) ** (1 / 3)),  # u falls linearly from first to last
        (5.0, 1.1, least_time(5.0, 1.1)),
        (9.0, 1.1, 2 * math.sqrt(10 / 1.1)),  # more than is ever used
    ],
)
def test_an_energy_budget(method: Any, stated: str, limit: float, most: float, truth: float) -> None:
    solution = pl.solve(cart(limit, most=most, stated=stated), method)
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 3)
    assert solution.objective == pytest.approx(truth, rel=1e-10)


@pytest.mark.parametrize(("method", "stated"), [(METHODS[0], "path"), (METHODS[0], "bound"), (METHODS[1], "path")])
def test_a_budget_of_velocity(method: Any, stated: str) -> None:
    """Half of it to speed up, half to brake, and a coast between: T = L/v + v/u."""
    solution = pl.solve(thrusters(4.0, stated), method)
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 3)
    assert solution.objective == pytest.approx(10 / 2 + 2 / 1.1, rel=1e-9)


def test_two_thrusters_that_switch_at_once() -> None:
    """Full speed ahead to the middle, and full astern: no piece of the tables lies between both switches."""
    solution = pl.solve(thrusters(9.0, "path"))
    assert solution.objective == pytest.approx(2 * math.sqrt(10 / 1.1), rel=1e-10)
    assert solution.verification.level >= 2, str(solution.verification)
    time = solution.trajectories[0].control.time
    assert (time[1:] == time[:-1]).sum() == 1


def test_the_multiplier_of_a_budget_is_what_more_of_it_gains() -> None:
    """T = (12 L^2/E)^(1/3) and dT/dE = -T/(3 E)."""
    solution = pl.solve(cart(5.0), verify=2)
    assert solution.multipliers["run.left_at_end"] == pytest.approx(-solution.objective / 15.0, rel=1e-9)


def test_a_solution_with_a_budget_is_saved_and_proved_again(tmp_path: Path) -> None:
    pl.save(pl.solve(cart(5.0, most=1.1)), tmp_path)
    found = pl.load(tmp_path)
    assert pl.verify(found).verification.level == 3
    again = pl.solve(cart(4.0, most=1.1), guess=found, verify=2)
    assert again.objective == pytest.approx(least_time(4.0, 1.1), rel=1e-10)


def test_what_is_no_budget_stays_as_it_is() -> None:
    """Limits on what may rise again, on what the end says, on what is asked for least, or linear ones unless asked."""
    assert len(with_budgets(cart(5.0), linear=False).phases[0].end_conditions) == 3
    rising = cart(5.0, lambda u: u, SPEED)
    assert with_budgets(rising, linear=True) is rising
    linear = thrusters(4.0, "bound")
    assert with_budgets(linear, linear=False) is linear
    assert with_budgets(linear, linear=True).phases[0].end_conditions[-1].name == "gain_at_end"
    least = cart(5.0).changed(objective=lambda x, p, xp: x.E, objective_unit=ENERGY, form=None)
    assert with_budgets(least, linear=True) is least
    told = with_budgets(cart(5.0), linear=False)
    assert with_budgets(told, linear=False) is told


def stages(first: float, last: float, *, anew: bool = False, coast: bool = False, size: float = 1.0) -> pl.Problem:
    """The cart at rest at 0 and 10 m with a limit of E in each half, or at 2 m/s there before a coast within both.

    With `anew` E counts from 0 again in the second half; `size` is that of the limits' values and of J.
    """

    def phase(name: str, **more: Any) -> pl.Phase:
        return pl.Phase(
            name=name, states=variables(s="m", v="m/s", E=ENERGY), duration=f"T_{name}",
            path=pl.Conditions(lambda x, u, p, xp: (size * (getattr(p, name) - x.E),), left=ENERGY), **more,
        )  # fmt: skip

    steered: Any = {
        "controls": (pl.ScalarControl(name="u", unit="m/s^2"),),
        "dynamics": lambda x, u, p, xp: (x.v, u.u, u.u * u.u),
    }
    half: Any = {"end": pl.Conditions(lambda x, p, xp: (x.s - 0.5 * p.L,), place="m"), **steered}
    rest: Any = {"end": pl.Conditions(lambda x, p, xp: (x.s - p.L, x.v - p.vT), place="m", speed="m/s")}
    still: Any = {"dynamics": lambda x, u, p, xp: (x.v, 0 * p.a, 0 * p.a * p.a)}
    one, two = (phase("one", **rest, **steered), phase("two", **still)) if coast else (
        phase("one", **half), phase("two", **rest, **steered))  # fmt: skip
    names = ("T_one",) if coast else ("T_one", "T_two")
    own = {"one": (first, ENERGY), "two": (last, ENERGY), "L": (10.0, "m"), "vT": (2.0 if coast else 0.0, "m/s")}
    return cart(5.0).changed(
        name="stages", phases=(one, two), form=None,
        links=(lambda x, p, xp: (x.s, x.v, 0 * x.E if anew else x.E),),
        given=given(**own, **({"T_two": (3.0, "s"), "a": (1.0, "m/s^2")} if coast else {})),
        free=tuple(pl.FreeParameter(name=name, unit="s", lower=0.1, upper=100.0, guess=4.0) for name in names),
        objective=lambda x, p, xp: (p.T_one if coast else p.T_one + p.T_two) / size,
    )  # fmt: skip


def energy_between(way: float, begin: float, end: float, T: float) -> float:
    """int u^2 over a way between two speeds, with u linear in time."""
    return 4 * (begin**2 + begin * end + end**2) / T - 12 * way * (begin + end) / T**2 + 12 * way**2 / T**3


def least_time_in_halves(first: float, last: float, anew: bool) -> float:
    """Over the speed between both halves, each as short as its energy lets it be."""

    def shortest(begin: float, end: float, energy: float) -> float:
        longest = 15.0 / (begin + end)  # beyond it the least energy rises again
        found: Any = brentq(lambda T: energy_between(5.0, begin, end, T) - energy, 0.5, longest, xtol=1e-14)
        return found

    def total(speed: float) -> float:
        return shortest(0.0, speed, first) + shortest(speed, 0.0, last if anew else last - first)

    found: Any = minimize_scalar(total, bounds=(1.5, 2.5), method="bounded", options={"xatol": 1e-9})
    return float(found.fun)


@pytest.mark.parametrize(
    ("first", "last", "anew"),
    [(1.5, 5.0, False), (2.0, 3.0, True)],  # tighter before the half; anew in the second one
)
def test_budgets_of_two_phases_that_are_called_alike(first: float, last: float, anew: bool) -> None:
    solution = pl.solve(stages(first, last, anew=anew))
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 3)
    assert solution.objective == pytest.approx(least_time_in_halves(first, last, anew), rel=1e-9)


def test_one_budget_through_two_phases_is_said_once() -> None:
    for problem, count in ((stages(5.0, 5.0), 0), (stages(1.5, 5.0), 1), (stages(5.0, 5.0, anew=True), 1)):
        first, last = with_budgets(problem, linear=False).phases
        assert (len(first.end_conditions), len(last.end_conditions)) == (1 + count, 3)


def test_a_budget_before_a_coast_within_it() -> None:
    """No control of the coast uses it up, so that the end of the burn says it."""
    solution = pl.solve(stages(1.5, 1.5, coast=True))
    truth: Any = brentq(lambda T: energy_between(10.0, 0.0, 2.0, T) - 1.5, 1.0, 7.5, xtol=1e-14)
    assert solution.verification.level == 3, str(solution.verification)
    assert solution.objective == pytest.approx(truth, rel=1e-10)


def test_a_budget_in_large_units_is_proved() -> None:
    """Its multiplier is 4e-7 of canonical J per canonical unit, and neighbours are solved with it all the same."""
    solution = pl.solve(stages(5.0, 5.0, size=1e3))
    assert solution.verification.level == 3, str(solution.verification)
    assert solution.objective == pytest.approx((12 * 10**2 / 5.0) ** (1 / 3) / 1e3, rel=1e-10)


@pytest.mark.parametrize(
    ("limit", "longest", "enough"),
    [(5.0, 5.0, 12 * 10**2 / 5.0**3), (1e-3, 100.0, 12 * 10**2 / 100.0**3)],
)
def test_a_budget_that_is_too_small_is_named_with_one_that_does(limit: float, longest: float, enough: float) -> None:
    """It is said at the end too, where no point of a mesh lies: both give together."""
    problem = cart(limit)
    (duration,) = problem.free
    with pytest.raises(pl.NotConvergedError) as refused:
        pl.solve(problem.changed(free=(replace(duration, upper=longest),)))
    found = re.search(r"budget ([0-9.e-]+) m\^2/s\^3", refused.value.advice)
    assert found is not None, str(refused.value)
    assert enough <= float(found[1]) * (1 + 1e-12) <= 1.01 * enough
