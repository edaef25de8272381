"""Path conditions that the control appears in and that hold the flight back: closed forms, and SciPy's own shooting."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import fsolve

from perilune.core import Outcome
from perilune.problem import (
    Check,
    Conditions,
    Curve,
    FreeParameter,
    Parameter,
    Phase,
    Problem,
    ScalarControl,
    Solution,
    Trajectory,
    UnitVectorControl,
    Variable,
    Verification,
)
from perilune.verify import verify


def failed(verification: Verification) -> set[str]:
    return {c.name for c in verification.failed}


def check(verification: Verification, name: str) -> Check:
    return next(c for c in verification.checks if c.name == name)


def curve(time: Any, values: Any, rates: Any) -> Curve:
    """From rows of values and rates, numbers for what is constant."""
    rows = [np.broadcast_to(np.asarray(row, dtype=float), np.shape(time)) for row in (*values, *rates)]
    half = len(rows) // 2
    return Curve(time=np.asarray(time), values=np.array(rows[:half]).T, rates=np.array(rows[half:]).T)


def flown(solution: Solution, which: str, change: Callable[[Curve], Curve]) -> Solution:
    """The solution with another table."""
    trajectory = solution.trajectories[0]
    return replace(solution, trajectories=(replace(trajectory, **{which: change(getattr(trajectory, which))}),))


def answer(problem: Problem, trajectory: Trajectory, objective: float, **free: float) -> Solution:
    return Solution(
        problem=problem, method="closed form", outcome=Outcome.SOLVED, objective=objective, free=free,
        trajectories=(trajectory,),
    )  # fmt: skip


# --- thrust of one size within a cone about the vertical -------------------------------------------------------------
# The speed vx after 2 s is greatest, height y and way to the side z given. lam_v = (-1, b tau, c tau) with
# tau = T - t is linear as c(u) knows no state: the thrust points against it, or where that leaves the cone, to the
# point of its circle that has the same azimuth.

TIME, ASIDE, LIFT, TILT = 2.0, 0.3, -1.1, math.radians(50)


def steering(tau: Any, aside: float, lift: float, tilt: float, held: bool | None = None) -> tuple[Any, Any]:
    """Direction (3, N) against the costates, on the cone where it is `held`, and its rate in time.

    The components are along x, to the side, up. None asks where it is held.
    """
    against = np.array([np.ones_like(tau), -aside * tau, -lift * tau])
    change = np.array([np.zeros_like(tau), np.full_like(tau, aside), np.full_like(tau, lift)])
    flat = np.sqrt((against[:2] ** 2).sum(axis=0))
    on = flat * math.cos(tilt) > against[2] * math.sin(tilt) if held is None else np.full(np.shape(tau), held)
    level = np.vstack([against[:2] / flat * math.sin(tilt), np.full_like(tau, math.cos(tilt))[None]])
    turn = (change[:2] - against[:2] * (against[:2] * change[:2]).sum(axis=0) / flat**2) / flat * math.sin(tilt)
    size = np.sqrt((against**2).sum(axis=0))
    free = against / size
    spin = (change - free * (free * change).sum(axis=0)) / size
    return np.where(on, level, free), np.where(on, np.vstack([turn, 0 * tau[None]]), spin)


def meets(aside: float, lift: float, tilt: float) -> float:
    """The time to go at which the thrust meets the cone: sqrt(1 + (b tau)^2) = -c tau tan(tilt)."""
    return 1 / math.sqrt((lift * math.tan(tilt)) ** 2 - aside**2)


@cache
def gauss() -> tuple[np.ndarray, np.ndarray]:
    node, weight = np.polynomial.legendre.leggauss(40)
    return 0.5 * (1 + node), 0.5 * weight


def over_time(function: Callable[[Any], Any], cut: float) -> Any:
    """Integral over tau from 0 to TIME of a function with a kink at `cut`."""
    node, weight = gauss()
    parts = [(0.0, min(max(cut, 0.0), TIME)), (min(max(cut, 0.0), TIME), TIME)]
    return sum((b - a) * (function(a + (b - a) * node) @ weight) for a, b in parts if b > a)


def reached(aside: float, lift: float, tilt: float) -> np.ndarray:
    """What the steering reaches: vx, z, y at the end."""
    cut = meets(aside, lift, tilt)
    return np.array([
        over_time(lambda tau: steering(tau, aside, lift, tilt)[0][0], cut),
        *(over_time(lambda tau, i=i: tau * steering(tau, aside, lift, tilt)[0][i], cut) for i in (1, 2)),
    ])  # fmt: skip


def push_back(aside: float, lift: float, tilt: float) -> float:
    """Integral of mu dc/dtilt, c = u_up - cos(tilt): mu sin(tilt) is the slope of H along the meridian."""

    def slope(tau: Any) -> Any:
        flat = np.sqrt(1 + (aside * tau) ** 2)
        return np.maximum(flat * math.cos(tilt) + lift * tau * math.sin(tilt), 0.0)

    return float(over_time(slope, meets(aside, lift, tilt)))


def cone_problem(aside: float, lift: float, tilt: float, *, chosen: bool = False) -> Problem:
    """The tilt given, or chosen at a price for each radian that makes `tilt` the best."""
    phase = Phase(
        name="arc",
        states=tuple(Variable(name=n, unit=u) for n, u in
                     (("z", "m"), ("y", "m"), ("vx", "m/s"), ("vz", "m/s"), ("vy", "m/s"))),
        controls=(UnitVectorControl(names=("along", "aside", "up")),),
        dynamics=lambda x, u, p, xp: (x.vz, x.vy, p.thrust * u.along, p.thrust * u.aside, p.thrust * u.up),
        duration="duration",
        end=Conditions(lambda x, p, xp: (x.z - p.side, x.y - p.height), side="m", height="m"),
        path=Conditions(lambda x, u, p, xp: (x.y + p.depth, u.up - xp.cos(p.tilt)), above="m", upright="1"),
    )  # fmt: skip
    _, side, height = reached(aside, lift, tilt)
    metres = {"side": side, "height": height, "depth": 1.0, "z0": 0.0, "y0": 0.0}
    speeds = {"vx0": 0.0, "vz0": 0.0, "vy0": 0.0, "price": push_back(aside, lift, tilt) if chosen else 0.0}
    given = {
        **{name: Parameter(value=value, unit="m") for name, value in metres.items()},
        **{name: Parameter(value=value, unit="m/s") for name, value in speeds.items()},
        "thrust": Parameter(value=1.0, unit="m/s^2"), "duration": Parameter(value=TIME, unit="s"),
    }  # fmt: skip
    if not chosen:
        given["tilt"] = Parameter(value=tilt, unit="rad")
    return Problem(
        name="cone", phases=(phase,), start=lambda p, xp: (p.z0, p.y0, p.vx0, p.vz0, p.vy0),
        given=given, free=(FreeParameter(name="tilt", unit="rad", lower=0.1, upper=1.5),) if chosen else (),
        objective=lambda x, p, xp: p.price * p.tilt - x.vx, objective_unit="m/s",
    )  # fmt: skip


def nodes(cuts: list[float], count: int = 800) -> np.ndarray:
    """Times from cut to cut, with both sides of those inside."""
    return np.concatenate([np.linspace(a, b, count) for a, b in pairwise(cuts)])


def cone(
    aside: float = ASIDE, lift: float = LIFT, tilt: float = TILT, *, chosen: bool = False, steer: Any = steering
) -> Solution:
    """The extremal, or what another steering law flies with the same costates."""
    problem = cone_problem(aside, lift, tilt, chosen=chosen)
    t = nodes([0.0, TIME - meets(aside, lift, tilt), TIME])
    tau = TIME - t
    pieces = [slice(0, 800), slice(800, 1600)]
    parts = [steer(tau[piece], aside, lift, tilt, bool(i)) for i, piece in enumerate(pieces)]
    u, du = (np.hstack([part[i] for part in parts]) for i in (0, 1))
    v, place = np.zeros((3, len(t))), np.zeros((3, len(t)))
    for i in range(3):
        start = np.zeros(2)
        for piece in pieces:
            speed = CubicHermiteSpline(t[piece], u[i, piece], du[i, piece]).antiderivative()
            way = speed.antiderivative()
            begin = t[piece][0]
            v[i, piece] = start[0] + speed(t[piece])
            place[i, piece] = start[1] + start[0] * (t[piece] - begin) + way(t[piece])
            start = np.array([v[i, piece][-1], place[i, piece][-1]])
    state = curve(t, (place[1], place[2], *v), (v[1], v[2], *u))
    costate = curve(t, (aside, lift, -1, aside * tau, lift * tau), (0, 0, 0, -aside, -lift))
    objective = problem.given["price"].value * tilt - float(v[0, -1])
    trajectory = Trajectory(phase="arc", state=state, costate=costate, control=curve(t, u, du))
    return answer(problem, trajectory, objective, **({"tilt": tilt} if chosen else {}))


def cone_again(problem: Problem, guess: Solution) -> Solution:
    """J of a shifted start by SciPy's `fsolve` on b and c, the tilt as it is given or held."""
    p = problem.parameters({})
    tilt = getattr(p, "tilt", None) or problem.free[0].lower
    wanted = np.array([p.side - p.offset_z - p.offset_vz * TIME, p.height - p.offset_y - p.offset_vy * TIME]) \
        if hasattr(p, "offset_z") else np.array([p.side, p.height])  # fmt: skip
    n: Any = fsolve(lambda n: reached(n[0], n[1], tilt)[1:] - wanted, [ASIDE, LIFT], xtol=1e-12)
    return replace(guess, objective=p.price * tilt - reached(n[0], n[1], tilt)[0] - getattr(p, "offset_vx", 0.0))


def test_the_thrust_within_a_cone_is_an_extremal() -> None:
    verification = verify(cone(), level=2).verification
    assert verification.passed, str(verification)
    assert check(verification, "multiplier_upright").value < 1e-12
    assert not [c for c in verification.checks if c.name == "multiplier_above"]  # no control in it


def test_a_tilt_that_is_chosen_is_stationary_at_its_price_and_at_no_other() -> None:
    """dJ/dtilt = price - integral of mu sin(tilt)."""
    right = cone(chosen=True)
    assert verify(right, level=2).verification.passed
    dearer = right.problem.with_given(price=right.problem.given["price"].value + 1e-7)
    wrong = replace(right, problem=dearer, objective=right.objective + 1e-7 * TILT)
    assert failed(verify(wrong, level=2).verification) == {"stationary_tilt"}


def beside(turn: float) -> Callable[..., Any]:
    """A law that holds the thrust on the cone at another azimuth."""
    rotation = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])

    def steer(tau: Any, aside: float, lift: float, tilt: float, held: bool) -> Any:
        u, du = steering(tau, aside, lift, tilt, held)
        return (rotation @ u, rotation @ du) if held else (u, du)

    return steer


@pytest.mark.parametrize("turn", [1e-7, 1e-3, 0.2, math.pi])
def test_another_point_of_the_cone_is_no_minimum(turn: float) -> None:
    wrong = failed(verify(cone(steer=beside(turn)), level=2).verification)
    assert {"stationary_direction_along_aside_up"} <= wrong or turn == math.pi
    assert ("minimum_of_hamiltonian" in wrong) == (turn > 1e-4)


def test_the_worst_point_of_the_cone_is_stationary_and_its_multiplier_gives_it_away() -> None:
    """Opposite in azimuth H is greatest along the circle: only the inequality and the samples tell."""
    wrong = failed(verify(cone(steer=beside(math.pi)), level=2).verification)
    assert "stationary_direction_along_aside_up" not in wrong
    assert {"minimum_of_hamiltonian", "multiplier_upright"} <= wrong


def test_held_where_it_should_be_free_the_multiplier_has_the_wrong_sign() -> None:
    """The thrust stays on the cone although the costates point into it."""
    verification = verify(
        cone(steer=lambda tau, b, c, tilt, held: steering(tau, b, c, tilt, True)), level=2
    ).verification
    assert {"multiplier_upright", "minimum_of_hamiltonian"} <= failed(verification)
    assert "stationary_direction_along_aside_up" not in failed(verification)


def test_released_where_it_should_be_held_the_condition_is_broken() -> None:
    verification = verify(
        cone(steer=lambda tau, b, c, tilt, held: steering(tau, b, c, tilt, False)), level=2
    ).verification
    assert "path_upright" in failed(verification)
    assert "stationary_direction_along_aside_up" not in failed(verification)


@pytest.mark.parametrize("inside", [5e-7, 1e-2])
def test_short_of_the_cone_there_is_no_multiplier(inside: float) -> None:
    verification = verify(cone(steer=lambda tau, b, c, tilt, held: steering(tau, b, c, tilt - inside * held, held)),
                          level=2).verification  # fmt: skip
    assert {"stationary_direction_along_aside_up", "minimum_of_hamiltonian"} <= failed(verification)
    assert "path_upright" not in failed(verification)
    said = "upright >= 0 is kept too inaccurately for a multiplier" in check(verification, "costate_y").meaning
    assert said == (inside < 1e-5)


def on_the_cone(turn: float, aside: float = ASIDE, *, held: bool = False) -> Solution:
    """The same with u_up = cos(tilt), held or asked for by two inequalities: what is allowed has no inside."""
    tilted = cone(aside, steer=lambda tau, b, c, tilt, held: beside(turn)(tau, b, c, tilt, True))
    (phase,) = tilted.problem.phases
    both = replace(
        phase,
        path=Conditions(lambda x, u, p, xp: (u.up - xp.cos(p.tilt), xp.cos(p.tilt) - u.up), upright="1", leaning="1"),
    )
    if held:
        both = replace(
            phase, path=None, held=Conditions(lambda x, u, p, xp: (u.up - xp.cos(p.tilt),), leaning="1"),
        )  # fmt: skip
    end = tilted.trajectories[0].state.values[-1]
    return replace(tilted, problem=replace(tilted.problem, phases=(both,)).with_given(side=end[0], height=end[1]))


@pytest.mark.parametrize("held", [False, True])
def test_conditions_that_leave_a_circle_are_proved_and_its_worst_point_is_not(held: bool) -> None:
    """Slopes of two are opposite: the one of the right sign has the multiplier. Only samples on the circle see all."""
    verification = verify(on_the_cone(0.0, held=held), level=2).verification
    assert verification.passed, str(verification)
    assert failed(verify(on_the_cone(math.pi, held=held), level=2).verification) == {"minimum_of_hamiltonian"}
    # Where the thrust does not turn, its own values at other times tell nothing.
    assert failed(verify(on_the_cone(math.pi, aside=0.0, held=held), level=2).verification) == {
        "minimum_of_hamiltonian"
    }
    assert "stationary_direction_along_aside_up" in failed(verify(on_the_cone(1e-3, held=held), level=2).verification)


def with_engine(share: float = 1.0) -> Solution:
    """A throttle beside the direction, full all along, and the thrust's component up is what must be large enough."""
    solution = cone()
    (phase,) = solution.problem.phases
    engine = replace(
        phase, controls=(*phase.controls, ScalarControl(name="share", lower=0.0, upper=1.0)),
        dynamics=lambda x, u, p, xp: (
            x.vz, x.vy, p.thrust * u.share * u.along, p.thrust * u.share * u.aside, p.thrust * u.share * u.up,
        ),
        path=Conditions.of(lambda x, u, p, xp: (x.y + p.depth, u.share * u.up - xp.cos(p.tilt)), phase.path_conditions),
    )  # fmt: skip
    full = replace(solution, problem=replace(solution.problem, phases=(engine,)))

    def beside(table: Curve) -> Curve:
        more = np.full((len(table.time), 1), share)
        return replace(table, values=np.hstack([table.values, more]), rates=np.hstack([table.rates, 0 * more]))

    return flown(full, "control", beside)


def test_a_scalar_on_its_bound_has_a_multiplier_of_its_own_beside_the_condition() -> None:
    """dH/dshare is no equation for mu; what mu leaves of it is the switching function, negative at the upper bound."""
    verification = verify(with_engine(), resolve=cone_again).verification
    assert verification.passed, str(verification)
    assert verification.level == 3
    # dL/dshare = lam_v.u - mu up, mu that of the meridian: there dH/dangle = mu sin(tilt).
    tau = np.linspace(0.0, TIME, 4001)
    u, _ = steering(tau, ASIDE, LIFT, TILT)
    mu = np.maximum(np.sqrt(1 + (ASIDE * tau) ** 2) / math.tan(TILT) + LIFT * tau, 0.0)
    S = -u[0] + ASIDE * tau * u[1] + LIFT * tau * u[2] - mu * u[2]
    apart = np.abs(tau - meets(ASIDE, LIFT, TILT))
    least = (np.abs(S) / apart).min() * TIME / np.abs(S).max()
    assert check(verification, "strict_share").value == pytest.approx(-least, rel=2e-3)


def test_an_engine_that_is_not_full_is_no_extremal() -> None:
    assert "switching_share" in failed(verify(with_engine(0.999), level=2).verification)


# --- a limit that rises with the flight: mu dc/dx enters lam' --------------------------------------------------------
# The speed vx after 2 s is greatest at a given height; the thrust's component up is at most `low` + `rise` y/L.

LOW, RISE, TOP = 0.3, 0.4, 0.55


def limited_problem() -> Problem:
    phase = Phase(
        name="arc",
        states=tuple(Variable(name=n, unit=u) for n, u in (("y", "m"), ("vx", "m/s"), ("vy", "m/s"))),
        controls=(UnitVectorControl(names=("along", "up")),),
        dynamics=lambda x, u, p, xp: (x.vy, p.thrust * u.along, p.thrust * u.up),
        duration="duration",
        end=Conditions(lambda x, p, xp: (x.y - p.height,), height="m"),
        path=Conditions(lambda x, u, p, xp: (p.low + p.rise * x.y / p.L - u.up,), shallow="1"),
    )
    metres = {"L": 1.0, "height": TOP, "y0": 0.0}
    return Problem(
        name="limited", phases=(phase,), start=lambda p, xp: (p.y0, p.v0, p.v0),
        given={
            **{name: Parameter(value=value, unit="m") for name, value in metres.items()},
            "thrust": Parameter(value=1.0, unit="m/s^2"), "duration": Parameter(value=TIME, unit="s"),
            "v0": Parameter(value=0.0, unit="m/s"), "low": Parameter(value=LOW), "rise": Parameter(value=RISE),
        },
        objective=lambda x, p, xp: -x.vx, objective_unit="m/s",
    )  # fmt: skip


def limited_rates(z: np.ndarray, held: bool) -> np.ndarray:
    """Rates of y, vx, vy, lam_y, lam_vy: the costates by hand, mu = -(up + lam_vy along)/along.

    H turns with the thrust by up + lam_vy along (lam_vx = -1), the condition by -along.
    """
    y, _, vy, lam_y, lam_vy = z
    up = LOW + RISE * y if held else -lam_vy / math.hypot(1, lam_vy)
    along = math.sqrt(1 - up * up)
    mu = -(up + lam_vy * along) / along if held else 0.0
    return np.array([vy, along, up, mu * RISE, -lam_y])


def limited_flight(n: Any, y0: float, vy0: float, vx0: float, most: float = np.inf) -> list[Any]:
    """Held first, then free: SciPy's two arcs for lam(0) = n, from the start to the release to the end."""

    def release(t: float, z: np.ndarray) -> float:
        up = LOW + RISE * z[0]
        return up + z[4] * math.sqrt(1 - up * up)

    release.terminal = True  # type: ignore[attr-defined]
    settings = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14, "dense_output": most < np.inf, "max_step": most}
    first = solve_ivp(lambda t, z: limited_rates(z, True), (0, TIME), [y0, vx0, vy0, *n], events=release, **settings)
    if first.status != 1:
        return [first]
    after = (first.t[-1], TIME)
    return [first, solve_ivp(lambda t, z: limited_rates(z, False), after, first.y[:, -1], **settings)]


def limited_extremal(top: float = TOP, y0: float = 0.0, vx0: float = 0.0, vy0: float = 0.0) -> np.ndarray:
    """lam_y and lam_vy at the start: the height is met, and lam_vy ends at 0."""

    def missed(n: Any) -> list[float]:
        end = limited_flight(n, y0, vy0, vx0)[-1].y[:, -1]
        return [end[0] - top, end[4]]

    n: Any = fsolve(missed, [-0.31, -0.556], xtol=1e-12)
    assert np.abs(missed(n)).max() < 1e-12
    return np.asarray(n)


def limited_again(problem: Problem, guess: Solution) -> Solution:
    p = problem.parameters({})
    start = p.offset_y, p.offset_vx, p.offset_vy
    n = limited_extremal(p.height, *start)
    return replace(guess, objective=-float(limited_flight(n, start[0], start[2], start[1])[-1].y[1, -1]))


@pytest.fixture(scope="module")
def limited() -> Solution:
    arcs = limited_flight(limited_extremal(), 0.0, 0.0, 0.0, most=0.01)
    time, rows = [], []
    for arc, held in zip(arcs, (True, False), strict=True):
        t = np.linspace(arc.t[0], arc.t[-1], 600)
        z = arc.sol(t)
        dz = np.array([limited_rates(column, held) for column in z.T]).T
        if held:
            up, turn = LOW + RISE * z[0], RISE * z[2]
        else:
            size = np.hypot(1, z[4])
            up, turn = -z[4] / size, -dz[4] / size**3
        along = np.sqrt(1 - up * up)
        time.append(t)
        rows.append(np.vstack([z, [along, up], dz, [-up / along * turn, turn]]))
    rows, time = np.hstack(rows), np.concatenate(time)
    vx, vy, lam_y, lam_vy, along = 1, 2, 3, 4, 5
    values, rates = rows[:7], rows[7:]
    trajectory = Trajectory(
        phase="arc", state=curve(time, values[: vy + 1], rates[: vy + 1]),
        costate=curve(time, (values[lam_y], -1, values[lam_vy]), (rates[lam_y], 0, rates[lam_vy])),
        control=curve(time, values[along:], rates[along:]),
    )  # fmt: skip
    return answer(limited_problem(), trajectory, -float(values[vx, -1]))


def test_the_multiplier_of_a_limit_that_knows_the_state_enters_the_costates(limited: Solution) -> None:
    verification = verify(limited, level=2).verification
    assert verification.passed, str(verification)
    assert "active" not in str(verification)


def test_costates_without_the_multiplier_fail(limited: Solution) -> None:
    """lam_y constant, lam_vy linear, as they are where the limit holds nothing back."""

    def straight(table: Curve) -> Curve:
        values, rates = table.values.copy(), table.rates.copy()
        values[:, 0], rates[:, 0] = values[-1, 0], 0.0
        values[:, 2], rates[:, 2] = values[-1, 0] * (TIME - table.time), -values[-1, 0]
        return replace(table, values=values, rates=rates)

    assert "costate_y" in failed(verify(flown(limited, "costate", straight), level=2).verification)


@pytest.mark.parametrize(("column", "name"), [(0, "costate_y"), (2, "costate_vy")])
def test_a_costate_that_slips_while_the_condition_holds_fails(limited: Solution, column: int, name: str) -> None:
    """On an arc that is held a bulge of lam changes mu with it: lam' sees it, the direction does not."""

    def bulged(table: Curve) -> Curve:
        values, rates, end = table.values.copy(), table.rates.copy(), limited.trajectories[0].control.time[599]
        share = np.clip(table.time / end, 0.0, 1.0)
        values[:, column] += 1e-8 * np.sin(np.pi * share) ** 2
        rates[:, column] += 1e-8 * np.pi / end * np.sin(2 * np.pi * share)
        return replace(table, values=values, rates=rates)

    assert name in failed(verify(flown(limited, "costate", bulged), level=2).verification)


def test_a_limit_that_knows_the_state_is_proved(limited: Solution) -> None:
    verification = verify(limited, resolve=limited_again).verification
    assert verification.passed, str(verification)
    assert verification.level == 3


@pytest.mark.parametrize("chosen", [False, True])
def test_the_thrust_within_a_cone_is_proved(chosen: bool) -> None:
    solution = cone(chosen=chosen)
    verification = verify(solution, resolve=cone_again).verification
    assert verification.passed, str(verification)
    assert verification.level == 3
    # mu sin(tilt) rises with the time since the cone is met, by less and less, to cos(tilt) at the end.
    tau, held = np.linspace(0.0, meets(ASIDE, LIFT, TILT), 20001)[:-1], math.cos(TILT)
    pull = np.sqrt(1 + (ASIDE * tau) ** 2) * math.cos(TILT) + LIFT * tau * math.sin(TILT)
    least = (pull / np.minimum(meets(ASIDE, LIFT, TILT) - tau, np.inf)).min()
    assert check(verification, "strict_upright").value == pytest.approx(-least * TIME / held, rel=1e-3)


def test_the_worst_point_of_a_circle_is_a_maximum_along_it() -> None:
    assert (
        check(verify(on_the_cone(math.pi), resolve=lambda problem, guess: guess).verification, "legendre_clebsch").value
        > 0.5
    )


def test_a_condition_that_takes_hold_without_a_break_in_the_table_is_not_understood() -> None:
    """Level 2 does not mind; of level 3 the words say what stands in the way."""
    good = cone()

    def ramp(table: Curve) -> Curve:
        time = table.time.copy()
        time[800] += 1e-9
        return replace(table, time=time)

    verification = verify(flown(good, "control", ramp), resolve=cone_again).verification
    assert verification.level == 2, str(verification)
    assert failed(verification) == {"conjugate_point", "strict_upright"} & failed(verification)
    verdict = check(verification, "conjugate_point")
    assert math.isnan(verdict.value)
    assert "becomes active without a break" in verdict.meaning


# --- an oscillator on a leash: conjugate points of a problem whose control is held all along -------------------------
# Least J = int (a^2 - x^2 + (b + q)^2)/2 dt with x' = a and b >= beta x + gamma a + s. Where q is large enough, b lies
# on its condition: x'' = -omega^2 x + beta (q + s)/(1 + gamma^2), omega^2 = (1 - beta^2)/(1 + gamma^2), and a point
# conjugate to the start lies at pi/omega.

BETA = 0.6


def leash(
    duration: float, q: float, *, gamma: float = 0.0, power: int = 1, ends: tuple[float, float] | None = None,
    chosen: float | None = None,
) -> Solution:  # fmt: skip
    """The extremal on which b is held; as b^power >= (...)^power the condition allows the same.

    `chosen` leaves s free and adds w s^2/2 and, so that s = 0 is stationary, a price of s to J: its curvature w.
    """
    omega = math.sqrt((1 - BETA**2) / (1 + gamma**2))
    rest = BETA * q / (1 - BETA**2)
    if ends is None:
        swing, tilt = 0.3 * math.cos(0.5 * omega * duration), 0.1 * math.sin(0.5 * omega * duration)
        ends = rest + swing - tilt, rest + swing + tilt
    first, last = ends[0] - rest, ends[1] - rest
    other = (last - first * math.cos(omega * duration)) / math.sin(omega * duration)
    t = np.linspace(0.0, duration, 601)
    c, s = np.cos(omega * t), np.sin(omega * t)
    x, a = rest + first * c + other * s, omega * (other * c - first * s)
    jerk = omega**2 * (rest - x)  # the rate of a
    b, turn = BETA * x + gamma * a, BETA * a + gamma * jerk
    running = 0.5 * (a**2 - x**2 + (b + q) ** 2), a * jerk - x * a + (b + q) * turn
    action = CubicHermiteSpline(t, *running).antiderivative()(t)
    mu = b + q, turn
    control = curve(t, (a, b), (jerk, turn))
    costates = curve(t, (-a - gamma * mu[0], 1.0), (-jerk - gamma * mu[1], 0.0))
    # dJ/ds = price + integral of mu
    price = -float(CubicHermiteSpline(t, *mu).antiderivative()(t)[-1]) if chosen is not None else 0.0
    problem = leash_problem(duration, q, gamma, power, ends, price, chosen)
    trajectory = Trajectory(phase="arc", state=curve(t, (x, action), (a, running[0])), costate=costates,
                            control=control)  # fmt: skip
    return answer(problem, trajectory, float(action[-1]), **({"s": 0.0} if chosen is not None else {}))


def leash_problem(
    duration: float, q: float, gamma: float, power: int, ends: tuple[float, float], price: float, w: float | None
) -> Problem:
    phase = Phase(
        name="arc",
        states=(Variable(name="x"), Variable(name="action")),
        controls=(ScalarControl(name="a"), ScalarControl(name="b")),
        dynamics=lambda x, u, p, xp: (
            u.a / p.second, (u.a * u.a - x.x * x.x + (u.b + p.q) ** 2) / (2 * p.second),
        ),
        duration="duration",
        end=Conditions(lambda x, p, xp: (x.x - p.x_end,), at_end="1"),
        path=Conditions(lambda x, u, p, xp: (u.b**power - (p.beta * x.x + p.gamma * u.a + p.s) ** power,), taut="1"),
    )  # fmt: skip
    numbers = {"q": q, "beta": BETA, "gamma": gamma, "x0": ends[0], "x_end": ends[1], "price": price, "w": w or 0.0}
    if w is None:
        numbers["s"] = 0.0
    seconds = {"duration": duration, "second": 1.0}
    return Problem(
        name="leash", phases=(phase,), start=lambda p, xp: (p.x0, 0.0),
        given={
            **{name: Parameter(value=value) for name, value in numbers.items()},
            **{name: Parameter(value=value, unit="s") for name, value in seconds.items()},
        },
        free=(FreeParameter(name="s", lower=-1.0, upper=1.0),) if w is not None else (),
        objective=lambda x, p, xp: x.action + p.price * p.s + 0.5 * p.w * p.s * p.s,
    )  # fmt: skip


def leash_again(problem: Problem, guess: Solution) -> Solution:
    """J of the leash in closed form, but for its integral: s adds to q."""
    p = problem.parameters({})
    s = p.s if hasattr(p, "s") else problem.free[0].lower
    held = leash(p.duration, p.q + s, gamma=p.gamma, ends=(p.x0 + getattr(p, "offset_x", 0.0), p.x_end))
    return replace(guess, objective=held.objective + getattr(p, "offset_action", 0.0) + p.price * s + 0.5 * p.w * s * s)


@pytest.mark.parametrize("power", [1, 3])
@pytest.mark.parametrize("duration", [1.0, 3.5, 3.8, 4.1])
def test_the_leash_moves_the_conjugate_point(duration: float, power: int) -> None:
    """(T/pi)^2 if the control were not held, (1 - beta^2) of it as it is: 3.5 s are too long for the one alone."""
    verification = verify(leash(duration, 3.0, power=power), resolve=leash_again).verification
    verdict, kappa = check(verification, "conjugate_point"), (1 - BETA**2) * (duration / math.pi) ** 2
    assert verdict.value == pytest.approx(kappa, rel=3e-4)
    assert failed(verification) == (set() if kappa < 1 else {"conjugate_point"}), str(verification)


@pytest.mark.parametrize("share", [0.5, 0.99, 1.01])
def test_a_condition_of_two_controls_leaves_one_way_to_go(share: float) -> None:
    """The point conjugate to the start lies at pi/omega: on which side the end lies is told."""
    duration = share * math.pi / math.sqrt((1 - BETA**2) / (1 + 0.5**2))
    verification = verify(leash(duration, 3.0, gamma=0.5), resolve=leash_again).verification
    assert failed(verification) == (set() if share < 1 else {"conjugate_point"}), str(verification)


def curvature(duration: float) -> float:
    """That of int L over s where w is 0: dx/ds = beta/omega^2 (1 - cos(omega (t - T/2))/cos(omega T/2))."""
    omega = math.sqrt(1 - BETA**2)
    return duration + BETA**2 / omega**2 * (duration - 2 / omega * math.tan(omega * duration / 2))


@pytest.mark.parametrize("beyond", [-0.5, -0.1, 0.1, 0.5])
def test_a_parameter_within_a_condition_that_holds_is_varied_with_the_control(beyond: float) -> None:
    """J over s has the curvature w and that of the leash: its sign is that of `beyond`."""
    duration = 3.5
    solution = leash(duration, 3.0, chosen=beyond - curvature(duration))
    verification = verify(solution, resolve=leash_again).verification
    assert check(verification, "second_order_s").value == pytest.approx(-beyond / solution.objective, rel=0.05)
    expected = set() if beyond > 0 else {"second_variation", "second_order_s"}
    assert failed(verification) - {"second_order_s"} == expected - {"second_order_s"}, str(verification)


def held_leash(duration: float, q: float) -> Solution:
    """The condition is held all along whichever way it pulls."""
    free = leash(duration, q, gamma=0.0)
    (phase,) = free.problem.phases
    stiff = replace(phase, path=None, held=Conditions.of(phase.path, phase.path_conditions))
    return replace(free, problem=replace(free.problem, phases=(stiff,)))


@pytest.mark.parametrize("q", [3.0, -3.0])
@pytest.mark.parametrize("duration", [3.5, 4.1])
def test_a_condition_that_is_held_all_along_may_pull_either_way(duration: float, q: float) -> None:
    verification = verify(held_leash(duration, q), resolve=leash_again).verification
    kappa = (1 - BETA**2) * (duration / math.pi) ** 2
    assert check(verification, "conjugate_point").value == pytest.approx(kappa, rel=3e-4)
    assert failed(verification) == (set() if kappa < 1 else {"conjugate_point"}), str(verification)
    assert not {c.name for c in verification.checks} & {"multiplier_taut", "strict_taut"}


def test_what_is_held_is_not_left() -> None:
    """Held or not, b is one that its condition asks for; a costate that forgets the pull on x fails."""
    right = held_leash(1.0, -3.0)
    assert "held_taut" in failed(
        verify(flown(right, "control", lambda c: replace(c, values=c.values + 1e-9)), level=1).verification
    )
    slipped = replace(right, problem=right.problem.with_given(q=-2.9))
    assert "costate_x" in failed(verify(slipped, level=2).verification)


def test_a_leash_that_pulls_the_wrong_way_is_no_extremal() -> None:
    """With q below -b the control would rather leave its condition."""
    verification = verify(leash(1.0, -3.0), level=2).verification
    assert failed(verification) == {"minimum_of_hamiltonian", "multiplier_taut"}


def test_a_multiplier_that_vanishes_at_the_start_is_not_strict() -> None:
    """Beyond pi the second variation is positive for flights that keep the condition alone, before it for all."""
    verification = verify(leash(3.5, 0.0, ends=(0.0, 1.0)), resolve=leash_again).verification
    assert failed(verification) == {"strict_taut"}, str(verification)
    verification = verify(leash(1.0, 0.0, ends=(0.0, 1.0)), resolve=leash_again).verification
    assert verification.level == 3, str(verification)
    assert check(verification, "conjugate_point").value == pytest.approx((1.0 / math.pi) ** 2, rel=1e-2)
    verification = verify(leash(1.0, 1.0, ends=(0.0, 1.0)), resolve=leash_again).verification
    assert verification.level == 3, str(verification)
