"""What hardly moves is judged by what it could tell in J: a flight at rest that had better move is no extremal.

J = int (u^2/2 - g x + ...) over 1 s: x at rest is worse than x' = u = 1 - t. Its own size, that of what it reaches,
says nothing of a state, a control or a parameter that drifts by 1e-13 of its unit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import perilune as pl
from perilune.core import Physics
from perilune.problem import Curve, Parameter, Solution, Variable

DRIFTS = [1e-6, 1e-9, 1e-12, 1e-13, 1e-15, 1e-17, -1e-13]
GIVEN = {
    "T": Parameter(value=1.0, unit="s"),
    "a": Parameter(value=1.0, unit="m/s"),
    "g": Parameter(value=1.0, unit="m/s^2"),
    "k": Parameter(value=1.0, unit="m^2/s^2"),
    "L": Parameter(value=1.0, unit="m"),
}


def variables(**units: str) -> tuple[Variable, ...]:
    return tuple(Variable(name=name, unit=unit) for name, unit in units.items())


def straight(first: list[float], last: list[float]) -> Curve:
    """From one row to another in 1 s."""
    values = np.array([first, last])
    return Curve(time=np.array([0.0, 1.0]), values=values, rates=np.tile(values[1] - values[0], (2, 1)))


def claimed(problem: pl.Problem, state: Curve, control: Curve, costate: Curve, **free: float) -> Solution:
    flown = pl.Trajectory(phase="go", state=state, control=control, costate=costate)
    return Solution(
        problem=problem, method="by hand", outcome=pl.Outcome.SOLVED, objective=float(state.values[-1, -1]), free=free,
        trajectories=(flown,),
    )  # fmt: skip


def for_a_second(
    name: str,
    states: tuple[Variable, ...],
    dynamics: Physics,
    *,
    bound: float = np.inf,
    free: tuple[pl.FreeParameter, ...] = (),
) -> pl.Problem:
    """One phase from 0, whose last state counts J."""
    phase = pl.Phase(
        name="go", states=states, controls=(pl.ScalarControl(name="u", unit="m/s", lower=-bound, upper=bound),),
        dynamics=dynamics, duration="T",
    )  # fmt: skip
    return pl.Problem(
        name=name, phases=(phase,), start=lambda p, xp: (0.0 * p.L, 0.0)[-len(states) :], given=GIVEN, free=free,
        objective=lambda x, p, xp: x.c, objective_unit="m^2/s",
    )  # fmt: skip


def idle(bound: float = np.inf) -> pl.Problem:
    """The control alone tells: J = int (u^2/2 - a u + k), least at u = a."""
    return for_a_second(
        "idle", variables(w="m", c="m^2/s"),
        lambda x, u, p, xp: (p.a, 0.5 * u.u * u.u - p.a * u.u + p.k), bound=bound,
    )  # fmt: skip


def resting() -> pl.Problem:
    """The state tells: x' = u, J = int (u^2/2 - g x + k), least at u = g (T - t)."""
    return for_a_second(
        "resting", variables(x="m", c="m^2/s"),
        lambda x, u, p, xp: (u.u, 0.5 * u.u * u.u - p.g * x.x + p.k),
    )  # fmt: skip


def chosen() -> pl.Problem:
    """A free parameter tells: J = int (q^2/2 - a q + k + (u - a)^2/2), least at q = a."""
    return for_a_second(
        "chosen", variables(c="m^2/s"),
        lambda x, u, p, xp: (0.5 * p.q * p.q - p.a * p.q + p.k + 0.5 * (u.u - p.a) ** 2,),
        free=(pl.FreeParameter(name="q", unit="m/s", guess=1.0),),
    )  # fmt: skip


def failed(solution: Solution, level: int = 2) -> set[str]:
    return {check.name for check in pl.verify(solution, level=level).verification.failed}


@pytest.mark.parametrize("drift", DRIFTS)
@pytest.mark.parametrize("bound", [np.inf, 50.0])
def test_a_control_that_is_nearly_nought_has_a_slope(drift: float, bound: float) -> None:
    J = 0.5 * drift * drift - drift + 1.0
    wrong = claimed(idle(bound), straight([0, 0], [1, J]), straight([drift], [drift]), straight([0, 1], [0, 1]))
    assert pl.verify(wrong, level=1).verification.passed
    assert failed(wrong) == {"minimum_of_hamiltonian", "switching_u"}


@pytest.mark.parametrize("drift", DRIFTS)
@pytest.mark.parametrize("costate", ["of a state at rest", "true"])
def test_a_state_that_nearly_rests_has_a_costate(drift: float, costate: str) -> None:
    """Either the costate says that moving gains nothing, and is wrong, or it says the truth, and the control is."""
    J = 0.5 * drift * drift - 0.5 * drift + 1.0
    lam = straight([-drift, 1], [0, 1]) if costate != "true" else straight([-1, 1], [0, 1])
    state = straight([0, 0], [drift, J])
    state = replace(state, rates=np.array([[drift, 1.0], [drift, 1.0 - drift]]))
    wrong = claimed(resting(), state, straight([drift], [drift]), lam)
    assert pl.verify(wrong, level=1).verification.passed
    assert ("switching_u" if costate == "true" else "costate_x") in failed(wrong)


def paid_at_the_end(rests: bool) -> pl.Problem:
    """J = int (u^2/2 + k) - a x at the end, least at u = a; where it `rests`, after another second in which x stays."""
    phase = for_a_second("go", variables(x="m", c="m^2/s"), lambda x, u, p, xp: (u.u, 0.5 * u.u * u.u + p.k)).phases[0]
    rest = replace(phase, name="rest", controls=(), duration="rests", dynamics=lambda x, u, p, xp: (0.0 * p.a, p.k))
    return pl.Problem(
        name="paid_at_the_end", phases=(phase, rest) if rests else (phase,), start=lambda p, xp: (0.0 * p.a * p.T, 0.0),
        links=(lambda x, p, xp: (x.x, x.c),) if rests else (), given=GIVEN | {"rests": GIVEN["T"]},
        objective=lambda x, p, xp: x.c - p.a * x.x, objective_unit="m^2/s",
    )  # fmt: skip


@pytest.mark.parametrize("drift", DRIFTS)
@pytest.mark.parametrize("rests", [False, True])
def test_a_state_that_nearly_rests_tells_at_the_end_of_its_phase(drift: float, rests: bool) -> None:
    """Its costate says there that it gains nothing; what follows knows better, and is known no worse for that."""
    c, rate = 0.5 * drift * drift + 1.0, np.array([[drift, 0.5 * drift * drift + 1.0]] * 2)
    lam = straight([-drift, 1], [-drift, 1])
    wrong = claimed(
        paid_at_the_end(rests), replace(straight([0, 0], [drift, c]), rates=rate), straight([drift], [drift]), lam
    )
    if rests:
        later = straight([drift, c], [drift, c + 1.0])
        none = Curve(time=later.time, values=np.zeros((2, 0)), rates=np.zeros((2, 0)))
        rest = pl.Trajectory(phase="rest", state=later, control=none, costate=straight([-1, 1], [-1, 1]))
        wrong = replace(wrong, trajectories=(*wrong.trajectories, rest))
    wrong = replace(wrong, objective=c - drift + rests)
    assert pl.verify(wrong, level=1).verification.passed
    assert failed(wrong) == {"go_transversality" if rests else "transversality"}


def test_trajectories_in_another_order_are_refused() -> None:
    solution = pl.solve(late_stop(2.0), verify=0)
    turned = replace(solution, trajectories=tuple(reversed(solution.trajectories)))
    with pytest.raises(pl.PeriluneError, match=r"not in the order of its phases(.|\n)*got: stop, wait"):
        pl.verify(turned)


@pytest.mark.parametrize("drift", DRIFTS)
def test_a_parameter_that_is_nearly_nought_has_a_slope(drift: float) -> None:
    J = 0.5 * drift * drift - drift + 1.0
    wrong = claimed(chosen(), straight([0], [J]), straight([1], [1]), straight([1], [1]), q=drift)
    assert pl.verify(wrong, level=1).verification.passed
    assert failed(wrong) == {"stationary_q"}


@pytest.mark.parametrize("make", [idle, resting, chosen])
def test_the_answers_themselves_are_proved(make) -> None:
    solution = pl.solve(make())
    assert solution.verification.level == 3, str(solution.verification)
    assert solution.objective == pytest.approx(5 / 6 if make is resting else 0.5, rel=1e-9)


@pytest.mark.parametrize("drift", [0.0, 1e-16, 1e-13])
def test_a_rest_that_is_best_is_proved(drift: float) -> None:
    """Rounding is no fault where nothing pulls: J = int (u^2/2 + k), and x rests but for its drift."""
    problem = resting().with_given(g=0.0)
    state = straight([0, 0], [drift, 1.0 + 0.5 * drift**2])
    right = claimed(problem, state, straight([drift], [drift]), straight([0, 1], [0, 1]))
    assert not failed(right)


@pytest.mark.parametrize("length", [1.0, 1e-6, 1e-9, 1e-14])
def test_no_choice_of_units_makes_a_rest_the_best(length: float) -> None:
    """In units as small as its drift everything that is scaled is small; what a Newton step gains is not."""
    problem = replace(resting(), scales=pl.Scales(length=length))
    state = straight([0, 0], [1e-13, 1.0 - 0.5e-13])
    state = replace(state, rates=np.array([[1e-13, 1.0], [1e-13, 1.0 - 1e-13]]))
    wrong = claimed(problem, state, straight([1e-13], [1e-13]), straight([-1e-13, 1], [0, 1]))
    found = {check.name: check for check in pl.verify(wrong, level=3).verification.checks}
    assert found["nothing_gained"].value == pytest.approx(1 / 6, rel=1e-3) and not found["nothing_gained"].passed


@pytest.mark.parametrize(("share", "passes"), [(1.0, True), (1.01, False), (0.5, False)])
def test_what_a_newton_step_gains_is_what_is_missing(share: float, passes: bool) -> None:
    """J is quadratic: (1 - share)^2/6 of what is flown is missing, told of flights alone, with true costates."""
    u = straight([share], [0.0])
    t = np.linspace(0.0, 1.0, 200)
    x = share * (t - t * t / 2)
    c = share**2 * (t - t * t + t**3 / 3) / 2 - share * (t * t / 2 - t**3 / 6) + t
    rates = np.column_stack([share * (1 - t), share**2 * (1 - t) ** 2 / 2 - x + 1])
    state = Curve(time=t, values=np.column_stack([x, c]), rates=rates)
    solution = claimed(resting(), state, u, straight([-1, 1], [0, 1]))
    check = next(c for c in pl.verify(solution, level=3).verification.checks if c.name == "nothing_gained")
    scale = max(1.0, abs(solution.objective))
    assert check.passed is passes
    assert check.value == pytest.approx((1 - share) ** 2 / 6 / scale, rel=1e-3, abs=1e-12)


def late_stop(turns: float) -> pl.Problem:
    """A spring swings for about so many radians, and is stopped in its middle within a second by the least effort."""
    states = variables(x="m", v="m/s", c="m^2/s^3")
    wait = pl.Phase(
        name="wait", states=states, dynamics=lambda x, u, p, xp: (x.v, -p.stiff * x.x, 0.0), duration="waits"
    )
    stop = pl.Phase(
        name="stop", states=states, controls=(pl.ScalarControl(name="u", unit="m/s^2"),), duration="T",
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u),
        end=pl.Conditions(lambda x, p, xp: (x.x, x.v), there="m", still="m/s"), 
    )  # fmt: skip
    return pl.Problem(
        name="late_stop",
        phases=(wait, stop),
        links=(lambda x, p, xp: (x.x, x.v, x.c),),
        start=lambda p, xp: (p.L, 0.0, 0.0),
        given={n: GIVEN[n] for n in "TL"} | {"stiff": Parameter(value=1, unit="1/s^2")},
        free=(pl.FreeParameter(name="waits", unit="s", lower=0.0, guess=turns),),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s^3",
    )


def test_many_swings_of_what_nothing_steers_are_no_gain() -> None:
    """35.6 rad in usual steps owe more of the first variation than is allowed; in steps of its own it is 0."""
    solution = pl.solve(late_stop(25.0))
    assert solution.free["waits"] == pytest.approx(35.636918654667, abs=1e-8)
    assert solution.verification.level == 3, str(solution.verification)


def two_ways(mass: float, aside: float) -> pl.Problem:
    """From rest to rest in 1 s, 1 m ahead by a force and so far `aside` by an acceleration: J = 6 (1 + aside^2)."""
    phase = pl.Phase(
        name="go",
        states=variables(x="m", y="m", vx="m/s", vy="m/s", c="m^2/s^3"),
        controls=(pl.ScalarControl(name="force", unit="N"), pl.ScalarControl(name="w", unit="m/s^2")),
        dynamics=lambda x, u, p, xp: (x.vx, x.vy, u.force / p.m, u.w, 0.5 * ((u.force / p.m) ** 2 + u.w * u.w)),
        duration="T",
        end=pl.Conditions(
            lambda x, p, xp: (x.x - p.L, x.y - p.aside, x.vx, x.vy), ahead="m", beside="m", still="m/s", steady="m/s"
        ),
    )
    given = {
        "T": GIVEN["T"],
        "L": GIVEN["L"],
        "m": Parameter(value=mass, unit="kg"),
        "aside": Parameter(value=aside, unit="m"),
    }
    return pl.Problem(
        name="two_ways",
        phases=(phase,),
        given=given,
        start=lambda p, xp: (0.0 * p.L, 0.0 * p.L, 0.0 * p.L / p.T, 0.0 * p.L / p.T, 0.0),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s^3",
    )


@pytest.mark.parametrize(("mass", "aside"), [(1e-4, 1.0), (100.0, 1e-13), (1e4, 1e-6)])
def test_controls_of_other_sizes_are_compared_by_what_they_tell(mass: float, aside: float) -> None:
    """Newtons beside metres per square second, and a way aside that is almost none."""
    solution = pl.solve(two_ways(mass, aside))
    assert solution.verification.level == 3, str(solution.verification)
    assert solution.objective == pytest.approx(6.0 * (1 + aside**2), rel=1e-9)
    flown = solution.trajectories[0]
    wrong = replace(flown, control=replace(flown.control, values=flown.control.values * np.array([1 + 1e-7, 1.0])))
    assert pl.verify(replace(solution, trajectories=(wrong,))).verification.level == 0
