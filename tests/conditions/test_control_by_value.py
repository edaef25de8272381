"""The minimum of H by its value at bounds and between: where a costate makes H concave, or does not bend it at all."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize

import perilune as pl
from perilune.conditions.pontryagin import derive
from perilune.conditions.singular_control import singular_control
from perilune.core import PeriluneError
from perilune.methods.indirect.chattering import find_chattering_arc
from perilune.problem import cost_states, unpriced_states
from problems.goddard import goddard
from test_control_law import given, slide, variables

METHODS = (pl.Indirect(), pl.Pseudospectral())
SCALES = pl.Scales(length=1.0, time=1.0, mass=1.0)
Rate = Callable[[Any, Any, Any], Any]


def counted(
    rate: Rate = lambda u, p, xp: u.u * u.u,
    unit: str = "m^2/s^3",
    *,
    lower: float = -1.1,
    upper: float = 1.1,
    used: tuple[float, float] | None = None,
    fastest: float | None = None,
) -> pl.Problem:
    """Least time over 10 m from rest to rest, with a state that only counts; its end between bounds, v at most."""
    ends = [*variables(place="m", speed="m/s")]
    ends += [] if used is None else [pl.Variable(name="used", unit=unit, lower=used[0], upper=used[1])]
    limited: dict[str, Any] = {}
    if fastest is not None:
        limited = {"path": pl.Conditions(lambda x, u, p, xp: (p.fastest - x.v,), limit="m/s")}
    phase = pl.Phase(
        name="run",
        states=variables(s="m", v="m/s", E=unit),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=lower, upper=upper),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, rate(u, p, xp)),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.s - p.L, x.v) if used is None else (x.s - p.L, x.v, x.E), *tuple(ends)),
        **limited,
    )
    return pl.Problem(
        name="counted",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given=given(L=(10.0, "m"), one=(1.0, "m/s^2"), **({} if fastest is None else {"fastest": (fastest, "m/s")})),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.1, upper=100.0, guess=8.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
        scales=SCALES,
    )


def spent(sign: float) -> pl.Problem:
    """2 m from rest in 4 s, -1 <= u <= 0.5, with the least or the most (-1) int u^2; at any speed."""
    phase = pl.Phase(
        name="run",
        states=variables(s="m", v="m/s", E="m^2/s^3"),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=-1.0, upper=0.5),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.s - p.L,), place="m"),
    )
    return pl.Problem(
        name="spent",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given=given(L=(2.0, "m"), T=(4.0, "s")),
        objective=lambda x, p, xp: sign * x.E,
        objective_unit="m^2/s^3",
        scales=SCALES,
    )


def turned(a: float, lower: float, upper: float) -> pl.Problem:
    """1.5 m from rest to rest in 4 s; E = int u^2 is paid for at the rate a - t, so that its costate changes sign."""
    phase = pl.Phase(
        name="run",
        states=variables(s="m", v="m/s", E="m^2/s^3", tau="s", C="m^2/s"),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=lower, upper=upper),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, u.u * u.u, 1.0, (p.a - x.tau) * x.E),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.s - p.L, x.v), place="m", speed="m/s"),
    )
    return pl.Problem(
        name="turned",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0, 0.0, 0.0),
        given=given(L=(1.5, "m"), T=(4.0, "s"), a=(a, "s")),
        objective=lambda x, p, xp: x.C,
        objective_unit="m^2/s",
        scales=SCALES,
    )


def rocket(fastest: float | None = None) -> pl.Problem:
    """The rocket cart of InfiniteOpt's manual: drag 0.2 v^2, propellant 0.01 u^2, |u| <= 1.1; the speed at most."""
    limited: dict[str, Any] = {}
    if fastest is not None:
        limited = {"path": pl.Conditions(lambda x, u, p, xp: (p.fastest - x.v,), limit="m/s")}
    phase = pl.Phase(
        name="run",
        states=variables(s="m", v="m/s", m="kg"),
        controls=(pl.ScalarControl(name="u", unit="N", lower=-1.1, upper=1.1),),
        dynamics=lambda x, u, p, xp: (x.v, (u.u - p.k * x.v * x.v) / x.m, -p.c * u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.s - p.L, x.v), place="m", speed="m/s"),
        **limited,
    )
    values = {"k": (0.2, "kg/m"), "c": (0.01, "kg/N^2/s"), "L": (10.0, "m"), "m0": (1.0, "kg")}
    return pl.Problem(
        name="rocket cart",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, p.m0),
        given=given(**values, **({} if fastest is None else {"fastest": (fastest, "m/s")})),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.1, upper=100.0, guess=8.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
        scales=SCALES,
    )


def switches(solution: pl.Solution) -> Any:
    time = solution.trajectories[0].control.time
    return time[1:][np.diff(time) == 0]


def proved(problem: pl.Problem, method: Any) -> pl.Solution:
    solution = pl.solve(problem, method)
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 3)
    return solution


LEAST_TIME = 2 * math.sqrt(10 / 1.1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("problem", "truth"),
    [
        (counted(), LEAST_TIME),
        (counted(lambda u, p, xp: u.u**4, "m^4/s^7"), LEAST_TIME),
        (counted(lower=-2.0, upper=0.7), math.sqrt(2 * 10 * 2.7 / (2.0 * 0.7))),
        # A costate that is zero only at the solution: the range of its state does not bind.
        (counted(used=(-math.inf, 100.0)), LEAST_TIME),
        (counted(used=(1.0, 100.0), lower=-2.0, upper=0.7), math.sqrt(2 * 10 * 2.7 / (2.0 * 0.7))),
        (counted(lambda u, p, xp: u.u**4, "m^4/s^7", used=(-math.inf, 100.0)), LEAST_TIME),
        (counted(fastest=1.7), 10 / 1.7 + 1.7 / 1.1),
    ],
)
def test_what_only_counts_does_not_bend_the_hamiltonian(method: Any, problem: pl.Problem, truth: float) -> None:
    """Bang-bang in closed form, whatever is counted on the way; with the speed limited bang, coast, bang."""
    assert proved(problem, method).objective == pytest.approx(truth, rel=1e-10)


def test_what_is_counted_changes_no_digit() -> None:
    linear, squared = (
        pl.solve(counted(rate), verify=0) for rate in (lambda u, p, xp: p.one * u.u, lambda u, p, xp: u.u * u.u)
    )
    assert linear.objective == squared.objective


@pytest.mark.parametrize("method", METHODS)
def test_the_most_of_a_square_is_at_bounds(method: Any) -> None:
    """H = lambda_s v + lambda_v u - u^2 is concave: u jumps where it is the same at both bounds, and H_u is not 0."""
    solution = proved(spent(-1.0), method)
    first: Any = brentq(lambda t: 0.25 * t * t + 0.5 * t * (4 - t) - 0.5 * (4 - t) ** 2 - 2, 0, 4, xtol=1e-14)
    assert switches(solution) == pytest.approx([first], abs=1e-9)
    assert -solution.objective == pytest.approx(0.25 * first + 4 - first, abs=1e-9)


def turned_truth(a: float, lower: float, upper: float) -> float:
    """J by the dual: the greatest of int min_u (lambda_E u^2 + (y_0 + y_1 t) u) dt + 1.5 y_1, for int u = 0 = v(4).

    With lambda_E = (4 - t)(a - (4 + t)/2) known, no flight has less than that whatever y is: a bound for all of them.
    """
    t = np.linspace(0.0, 4.0, 40_001)
    price = (4 - t) * (a - (4 + t) / 2)

    def dual(y: Any) -> float:
        pull = y[0] + y[1] * t
        between = np.clip(np.divide(-pull, 2 * price, out=np.full_like(t, lower), where=price > 0), lower, upper)
        tried = np.array([np.full_like(t, lower), np.full_like(t, upper), between])
        return float(np.trapezoid((pull * tried + price * tried**2).min(axis=0), t)) + 1.5 * y[1]

    found = minimize(lambda y: -dual(y), [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13})
    return -float(found.fun)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("a", "lower", "upper", "count"),
    [(2.5, -1.0, 0.8, 3), (3.2, -0.6, 1.0, 2)],
)
def test_a_costate_that_changes_its_sign_on_the_way(
    method: Any, a: float, lower: float, upper: float, count: int
) -> None:
    """Between its bounds at first, where H is convex, and at bounds later, where it is concave."""
    solution = proved(turned(a, lower, upper), method)
    assert len(switches(solution)) == count
    assert solution.objective == pytest.approx(turned_truth(a, lower, upper), abs=1e-7)


def cart(until: float, brake: bool, spent: Callable[[float], float], coast: float = 0.0) -> tuple[Any, float, float]:
    """The cart at full thrust for a time or up to a speed, along that for a time, and braked to rest: x, and times."""

    def flown(u: Callable[[Any], float], x: Any, far: float, stop: Any = None) -> tuple[Any, float]:
        def rates(t: float, x: Any) -> list[float]:
            return [x[1], (u(x) - 0.2 * x[1] ** 2) / x[2], -spent(u(x))]

        found = solve_ivp(rates, (0.0, far), x, events=stop, rtol=1e-12, atol=1e-13)
        return found.y[:, -1], float(found.t[-1])

    def rest(t: float, x: Any) -> float:
        return float(x[1])

    def fast(t: float, x: Any) -> float:
        return float(x[1]) - until

    rest.terminal = fast.terminal = True  # pyright: ignore[reportFunctionMemberAccess]
    rest.direction = -1.0  # pyright: ignore[reportFunctionMemberAccess]
    x, first = flown(lambda x: 1.1, [0.0, 0.0, 1.0], 20.0 if brake else until, fast if brake else None)
    if coast:
        x, _ = flown(lambda x: 0.2 * x[1] ** 2, x, coast)
    x, last = flown(lambda x: -1.1, x, 20.0, rest)
    return x, first, first + coast + last


def test_propellant_by_the_square_of_the_thrust_makes_h_concave() -> None:
    """Lighter is quicker, so that lambda_m > 0 and u is at a bound: one switch, found by a root of its own."""
    first: Any = brentq(lambda t: cart(t, False, lambda u: 0.01 * u * u)[0][0] - 10.0, 1.0, 8.0, xtol=1e-13)
    for method in METHODS:
        solution = proved(rocket(), method)
        assert switches(solution) == pytest.approx([first], abs=1e-8)
        assert solution.objective == pytest.approx(cart(first, False, lambda u: 0.01 * u * u)[2], abs=1e-9)
    told = pl.solve(rocket(), verify=5)
    assert told.verification.level == 3 and "which jumps from bound to bound" in str(told.verification)


@pytest.mark.parametrize("method", METHODS)
def test_along_the_speed_limit_the_cart_would_better_chatter(method: Any) -> None:
    """No best flight: at full thrust, back and forth, it loses mass sooner. That along the limit is only feasible.

    Both figures by SciPy: 7.418990902 s along the limit, 7.392669885 s approached by ever faster switching.
    """
    times = {}
    for name, spent in (("along", lambda u: 0.01 * u * u), ("chattering", lambda u: 0.01 * 1.1**2)):
        coast: Any = brentq(lambda c, spent=spent: cart(1.7, True, spent, c)[0][0] - 10.0, 0.1, 8.0, xtol=1e-13)
        times[name] = cart(1.7, True, spent, coast)[2]
    assert times["chattering"] < times["along"] - 0.02
    solution = pl.solve(rocket(1.7), method)
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.NOT_PROVED, 1)
    assert solution.objective == pytest.approx(times["along"], abs=2e-9)
    failed = [c.meaning for c in solution.verification.checks if not c.passed]
    assert any("no optimal flight follows it (chattering)" in meaning for meaning in failed)
    assert any("no optimal flight follows it (chattering)" in line for line in solution.statistics.attempts)
    assert any(line.startswith("flights that chatter are better than this one") for line in solution.warnings)


def test_a_flight_along_a_limit_that_is_best_does_not_chatter() -> None:
    assert find_chattering_arc(pl.solve(counted(fastest=1.7), verify=0).trajectories.restated) is None  # pyright: ignore


def planar(rate: Rate, of: str) -> pl.Problem:
    """From (0, 0) with velocity (0, 1 m/s) to rest in (2 m, 2 m) in least time: thrust in any direction, 0.2 to 1."""
    mass = of == "m"

    def dynamics(x: Any, u: Any, p: Any, xp: Any) -> Any:
        pushed = u.size / x.m if mass else u.size
        return (x.vx, x.vy, pushed * u.dx, pushed * u.dy, rate(u, p, xp))

    unit = "N" if mass else "m/s^2"
    phase = pl.Phase(
        name="run",
        states=variables(x="m", y="m", vx="m/s", vy="m/s", **({"m": "kg"} if mass else {"E": "m^2/s^3"})),
        controls=(
            pl.UnitVectorControl(names=("dx", "dy")),
            pl.ScalarControl(name="size", unit=unit, lower=0.2, upper=1.0),
        ),
        dynamics=dynamics,
        duration="T",
        end=pl.Conditions(
            lambda x, p, xp: (x.x - p.L, x.y - p.L, x.vx, x.vy), east="m", north="m", rest_x="m/s", rest_y="m/s"
        ),
    )
    own = {"c": (0.05, "kg/N^2/s"), "k": (0.05, "kg/N/s"), "m0": (1.0, "kg")} if mass else {"one": (1.0, "m/s^2")}
    return pl.Problem(
        name="planar",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0, p.v0, p.m0 if mass else 0.0),
        given=given(L=(2.0, "m"), v0=(1.0, "m/s"), **own),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.1, upper=100.0, guess=8.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
        scales=SCALES,
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("of", ["E", "m"])
def test_beside_a_direction_too(method: Any, of: str) -> None:
    """At full thrust all along what is counted, or burnt, is the same by the thrust or by its square."""
    one = planar(lambda u, p, xp: -p.k * u.size if of == "m" else p.one * u.size, of)
    two = planar(lambda u, p, xp: -p.c * u.size**2 if of == "m" else u.size**2, of)
    assert proved(two, method).objective == pytest.approx(pl.solve(one, verify=2).objective, abs=1e-11)


@pytest.mark.parametrize(
    "rate", [lambda u, p, xp: u.u * u.u, lambda u, p, xp: u.u * u.u + u.b * u.b, lambda u, p, xp: u.u * u.b]
)
def test_one_of_two_scalars_alone(rate: Rate) -> None:
    """T + int b^2/2 for 3 m from rest to rest by u, and a speed of 1 m/s beside it by b: T is least, b = 1/T."""
    phase = pl.Phase(
        name="run",
        states=variables(s="m", v="m/s", w="m/s", E="m^2/s^3", C="s"),
        controls=(
            pl.ScalarControl(name="u", unit="m/s^2", lower=-1.1, upper=0.8),
            pl.ScalarControl(name="b", unit="m/s^2", lower=-1.0, upper=1.0),
        ),
        dynamics=lambda x, u, p, xp: (x.v, u.u, u.b, rate(u, p, xp), 0.5 * u.b * u.b / (p.one * p.one)),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.s - p.L, x.v, x.w - p.W), place="m", speed="m/s", side="m/s"),
    )
    problem = pl.Problem(
        name="two",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0, 0.0, 0.0),
        given=given(L=(3.0, "m"), W=(1.0, "m/s"), one=(1.0, "m/s^2")),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.1, upper=100.0, guess=8.0),),
        objective=lambda x, p, xp: p.T + x.C,
        objective_unit="s",
        scales=SCALES,
    )
    least = math.sqrt(2 * 3 * 1.9 / (1.1 * 0.8))
    assert proved(problem, pl.Indirect()).objective == pytest.approx(least + 0.5 / least, abs=1e-10)


def with_energy() -> pl.Problem:
    """Goddard's rocket with the square of its thrust counted."""
    own = goddard()
    (ascent,) = own.phases

    def dynamics(x: Any, u: Any, p: Any, xp: Any) -> Any:
        return (*ascent.dynamics(x, u, p, xp), u.thrust * u.thrust)

    phase = replace(
        ascent,
        states=(*ascent.states, pl.Variable(name="E", unit="N^2*s")),
        dynamics=dynamics,
        end_guess=lambda p, xp: (p.scale_height, 0 * p.c, p.dry_mass, 0.0 * p.c),
    )
    return replace(own, phases=(phase,), start=lambda p, xp: (0.0, 0.0, p.mass, 0.0))


def test_a_singular_arc_beside_what_only_counts() -> None:
    alone = pl.solve(goddard(), verify=2)
    assert proved(with_energy(), pl.Indirect()).objective == pytest.approx(alone.objective, rel=1e-12)


def test_a_control_that_bends_what_counts_has_no_singular_arc() -> None:
    z, s = ca.SX.sym("z", 3), ca.SX.sym("s")
    with pytest.raises(PeriluneError, match="the rates are not linear in it"):
        singular_control("u", z[0] + z[2], s, z, ca.vertcat(z[1], s, s * s))
    assert float(ca.substitute(singular_control("u", z[0], s, z, ca.vertcat(z[1], s, s * s)), z, 1)) == 0.0


def test_the_stationary_point_of_a_concave_hamiltonian_is_no_answer() -> None:
    """The flight of least energy has H_u = 0 for the most of it too, with costates of the other sign: refused."""
    least = pl.solve(spent(1.0), verify=2)
    assert least.outcome is pl.Outcome.PROVED and not len(switches(least))
    (flown,) = least.trajectories
    assert flown.costate is not None
    costate = replace(flown.costate, values=-flown.costate.values, rates=-flown.costate.rates)
    mutant = replace(
        least,
        problem=spent(-1.0),
        trajectories=(replace(flown, costate=costate),),
        multipliers={name: -value for name, value in least.multipliers.items()},
        objective=-least.objective,
    )
    found = pl.verify(mutant).verification
    assert found.level == 1
    assert [c.name for c in found.checks if c.level == 2 and not c.passed] == ["minimum_of_hamiltonian"]


def test_costates_of_another_cart_are_no_proof() -> None:
    """With them H is not the same at both bounds where this cart switches."""
    solution, other = (pl.solve(rocket().with_given(c=c), verify=2) for c in (0.01, 0.02))
    (flown,), (behind,) = solution.trajectories, other.trajectories
    assert flown.costate is not None and behind.costate is not None
    share = flown.costate.time / flown.costate.time[-1]
    columns = behind.costate(share * behind.costate.time[-1])
    mutant = replace(flown, costate=replace(flown.costate, values=columns))
    failed = {c.name for c in pl.verify(replace(solution, trajectories=(mutant,))).verification.checks if not c.passed}
    assert {"switch_u", "costate_v"} <= failed


def test_a_theorem_of_what_only_counts() -> None:
    pytest.importorskip("flint")
    from perilune.problem import Verification
    from perilune.rigorous.verified import add_theorem_checks
    from perilune_checker.check import confirm

    solution = pl.solve(counted(), verify=5)
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 5)
    told = add_theorem_checks(Verification(checks=()), solution).certificate
    confirm(json.loads(json.dumps(told)), tell=lambda *lines: None)
    # Where its end is asked for, its costate is not known to vanish, and no theorem says so.
    asked = pl.solve(counted(used=(-math.inf, 100.0)), verify=5)
    assert asked.verification.level == 3 and "no theorem: H is nonlinear in u" in str(asked.verification)


def test_a_certificate_that_asks_for_what_is_counted_is_refused() -> None:
    pytest.importorskip("flint")
    from perilune.problem import Verification
    from perilune.rigorous.verified import add_theorem_checks
    from perilune_checker.check import confirm
    from perilune_checker.expressions import Failed

    told = add_theorem_checks(Verification(checks=()), pl.solve(counted())).certificate
    forged = json.loads(json.dumps(told))
    states = forged["problem"]["phases"][0]["states"]
    states[2]["lower"] = "-1000"
    with pytest.raises(Failed):
        confirm(forged, tell=lambda *lines: None)


def test_states_that_nothing_asks_for() -> None:
    assert unpriced_states(counted()) == (frozenset({"E"}),)
    assert unpriced_states(counted(used=(0.0, 9.0))) == (frozenset(),)
    assert unpriced_states(rocket()) == (frozenset(),)
    assert unpriced_states(with_energy()) == (frozenset({"E"}),)
    assert unpriced_states(slide(5.0)) == (frozenset(),)
    assert cost_states(slide(5.0)) == (frozenset({"c"}),)
    assert cost_states(spent(-1.0)) == (frozenset(),)  # -1 is no positive price
    assert cost_states(turned(2.5, -1.0, 0.8)) == (frozenset({"C"}),)


def test_of_a_known_price_no_bounds_are_compared() -> None:
    """A convex cost needs no events between bounds; one of unknown sign has them."""
    (convex,), (either,) = derive(slide(5.0)).phases, derive(spent(-1.0)).phases
    assert (2, 0) not in {way for event in convex.events for way in event.switches.items()}
    assert {(0, 2), (2, 0)} <= {way for event in either.events for way in event.switches.items()}
