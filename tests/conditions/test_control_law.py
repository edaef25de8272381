"""Controls between their bounds and at them: closed forms of the literature, by the indirect method."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.conditions.pontryagin import derive
from perilune.core import PeriluneError
from test_indirect import tangent_steering


def given(**values: tuple[float, str]) -> dict[str, pl.Parameter]:
    return {name: pl.Parameter(value=value, unit=unit) for name, (value, unit) in values.items()}


def variables(**units: str) -> tuple[pl.Variable, ...]:
    return tuple(pl.Variable(name=name, unit=unit) for name, unit in units.items())


def slide(bound: float | str) -> pl.Problem:
    """From rest to rest over 1 m in 1 s with the least int u^2/2, |u| <= bound."""
    phase = pl.Phase(
        name="slide",
        states=variables(x="m", v="m/s", c="m^2/s^3"),
        controls=(
            pl.ScalarControl(name="u", unit="m/s^2", lower=-5.0 if isinstance(bound, str) else -bound, upper=bound),
        ),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.way, x.v), arrive="m", rest="m/s"),
    )
    return pl.Problem(
        name="slide",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given=given(T=(1.0, "s"), way=(1.0, "m"), strength=(5.0, "m/s^2")),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s^3",
    )


@pytest.mark.parametrize("bound", [5.0, "strength"])
def test_a_quadratic_cost_between_bounds(bound: float | str) -> None:
    """Saturated until t_1 = (1 - sqrt(0.6))/2, then linear, then saturated: J = 25 (t_1 + (1/2 - t_1)/3)."""
    first = 0.5 * (1 - math.sqrt(0.6))
    solution = pl.solve(slide(bound), verify=2)
    assert solution.outcome is pl.Outcome.PROVED
    assert solution.objective == pytest.approx(25 * (first + (0.5 - first) / 3), abs=1e-10)
    time = solution.trajectories[0].control.time
    switches = time[1:][np.diff(time) == 0]
    assert switches == pytest.approx([first, 1 - first], abs=1e-10)
    assert derive(solution.problem).phases[0].regimes == (("lower",), ("interior",), ("upper",))
    direct = pl.solve(slide(bound), pl.Pseudospectral(), verify=0)
    assert direct.objective == pytest.approx(solution.objective, abs=1e-6)


def test_wide_bounds_are_never_met() -> None:
    """|u| = 6 at most: J = 6."""
    solution = pl.solve(slide(7.0))
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 3)
    assert solution.objective == pytest.approx(6.0, abs=1e-11)


def test_a_bound_that_is_a_parameter_can_be_varied() -> None:
    weaker = [pl.solve(slide("strength").with_given(strength=s), verify=0).objective for s in (5.0, 5.5)]
    first = 0.5 * (1 - math.sqrt(0.6))
    assert weaker[0] == pytest.approx(25 * (first + (0.5 - first) / 3), abs=1e-10)
    assert weaker[1] < weaker[0]
    with pytest.raises(PeriluneError, match="no parameter of this name"):
        slide("strenght")


def test_an_angle_and_a_direction_steer_alike() -> None:
    """Linear tangent steering by an angle, whose minimum of H has no closed form for the program."""
    base = tangent_steering()
    turned = replace(
        base.phases[0],
        controls=(pl.ScalarControl(name="angle", unit="rad"),),
        dynamics=lambda x, u, p, xp: (x.vy, p.a * xp.cos(u.angle), p.a * xp.sin(u.angle)),
    )
    solution = pl.solve(replace(base, phases=(turned,)))
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 3)
    # The truth of the project's table, computed independently.
    assert solution.objective == pytest.approx(0.554570878334603, abs=1e-12)


def curve(push: bool) -> pl.Problem:
    """From (0, 0) with velocity (0, 1) to rest in (1, 1) after 1 s with the least int |a|^2/2.

    The acceleration a is a direction times its size; with a brake of its own along y that costs alike.
    """

    def dynamics(x: Any, u: Any, p: Any, xp: Any) -> Any:
        y = u.size * u.dy + (u.brake if push else 0.0 * u.size)
        cost = 0.5 * u.size * u.size + (0.5 * u.brake * u.brake if push else 0.0 * u.size * u.size)
        return (x.vx, x.vy, u.size * u.dx, y, cost)

    brake = (pl.ScalarControl(name="brake", unit="m/s^2"),) if push else ()
    phase = pl.Phase(
        name="curve",
        states=variables(x="m", y="m", vx="m/s", vy="m/s", c="m^2/s^3"),
        controls=(
            pl.UnitVectorControl(names=("dx", "dy")),
            pl.ScalarControl(name="size", unit="m/s^2", lower=0.0),
            *brake,
        ),
        dynamics=dynamics,
        duration="T",
        end=pl.Conditions(
            lambda x, p, xp: (x.x - p.way, x.y - p.way, x.vx, x.vy), east="m", north="m", rest_x="m/s", rest_y="m/s"
        ),
    )
    return pl.Problem(
        name="curve",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0, p.speed, 0.0),
        given=given(T=(1.0, "s"), way=(1.0, "m"), speed=(1.0, "m/s")),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s^3",
    )


@pytest.mark.parametrize(("push", "share"), [(False, 1.0), (True, 0.5)])
def test_a_quadratic_size_beside_a_direction(push: bool, share: float) -> None:
    """J = 6 d^2 - 6 d e + 2 e^2 for each axis, d the way beyond the coast, e the change of speed; half with a brake."""
    east, north = 6.0, 2 * 1.0  # d = 1, e = 0; d = 0, e = -1
    solution = pl.solve(curve(push), verify=2)
    assert solution.outcome is pl.Outcome.PROVED
    assert solution.objective == pytest.approx(east + share * north, abs=1e-10)


def test_what_has_no_minimum_is_named() -> None:
    """A direction that enters nonlinearly, a scalar that enters linearly and has no bounds."""
    base = tangent_steering()
    squared = replace(base.phases[0], dynamics=lambda x, u, p, xp: (x.vy, p.a * u.cx * u.cx, p.a * u.cy))
    with pytest.raises(PeriluneError, match="no control law for cx, cy"):
        pl.solve(replace(base, phases=(squared,)), verify=0)
    pushed = replace(
        base.phases[0],
        controls=(*base.phases[0].controls, pl.ScalarControl(name="push", unit="m/s^2")),
        dynamics=lambda x, u, p, xp: (x.vy, p.a * u.cx + u.push, p.a * u.cy),
    )
    with pytest.raises(PeriluneError, match="no control law for push"):
        pl.solve(replace(base, phases=(pushed,)), verify=0)


def test_a_bound_of_another_dimension_is_refused() -> None:
    base = slide("strength")
    with pytest.raises(PeriluneError, match="strength of u has another dimension"):
        replace(base, given={**base.given, "strength": pl.Parameter(value=5.0, unit="kg")})


def test_on_either_side_of_a_kink_a_control_passes_through_the_same_regimes() -> None:
    """Three before a slope begins and three on it: from each to its neighbours, and to its like on the other side."""
    (flat,) = slide(5.0).phases

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
        return x.v, u.u - p.strength * xp.fmax(x.x / p.way - 0.5, 0.0), 0.5 * u.u * u.u

    problem = replace(slide(5.0), phases=(replace(flat, dynamics=rates),))
    ways = [way for event in derive(problem).phases[0].events for way in event.switches.items()]
    within = {(side + a, side + b) for side in (0, 3) for a, b in ((0, 1), (1, 0), (1, 2), (2, 1))}
    across = {way for k in range(3) for way in ((k, k + 3), (k + 3, k))}
    assert len(ways) == len(set(ways)) and set(ways) == within | across


def across_a_current(lower: float, upper: float, unit: str) -> tuple[pl.Problem, float, float]:
    """Zermelo's boat in a current -y to the origin, from where theta goes from 105 to 240 deg; theta(0) and T.

    Bryson, Ho 1975, section 2.7: tan theta = tan theta(0) + t, y = sec theta - sec theta(T).
    """
    first, last = math.radians(105.0), math.radians(240.0)

    def way(a: float) -> float:
        """Antiderivative of dx/dtheta = sec - sec^3 + sec theta(T) sec^2."""
        sec, tan = 1 / math.cos(a), math.tan(a)
        return 0.5 * math.log(abs(sec + tan)) - 0.5 * sec * tan + tan / math.cos(last)

    phase = pl.Phase(
        name="cross",
        states=variables(x="m", y="m"),
        controls=(pl.ScalarControl(name="theta", unit=unit, lower=lower, upper=upper),),
        dynamics=lambda x, u, p, xp: (p.V * xp.cos(u.theta) - p.k * x.y, p.V * xp.sin(u.theta)),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x, x.y), there="m", across="m"),
    )
    x0, y0 = way(first) - way(last), 1 / math.cos(first) - 1 / math.cos(last)
    problem = pl.Problem(
        name="zermelo",
        phases=(phase,),
        start=lambda p, xp: (p.x0, p.y0),
        given=given(V=(1.0, "m/s"), k=(1.0, "1/s"), x0=(x0, "m"), y0=(y0, "m")),
        free=(pl.FreeParameter(name="T", unit="s", lower=1.0, upper=20.0, guess=5.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
        scales=pl.Scales(length=1.0, time=1.0, mass=1.0),
    )
    return problem, first, math.tan(last) - math.tan(first)


@pytest.mark.parametrize(
    ("lower", "upper", "unit", "method"),
    [
        (-math.inf, math.inf, "rad", pl.Indirect()),
        (-math.inf, math.inf, "1", pl.Pseudospectral()),
        (-9.0, 9.0, "rad", pl.Indirect()),
        (-9.0, 1.0, "1", pl.Indirect()),
        (7.0, math.inf, "rad", pl.Indirect()),
    ],
)
def test_an_angle_goes_on_past_half_a_turn(lower: float, upper: float, unit: str, method: Any) -> None:
    """Minima of H a turn apart are one: the angle does not hop between them, and stays within its bounds."""
    problem, first, T = across_a_current(lower, upper, unit)
    solution = pl.solve(problem, method)
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 3)
    assert solution.objective == pytest.approx(T, abs=1e-9)
    theta, time = solution.trajectories[0].control.values[:, 0], solution.trajectories[0].control.time
    turn = 2 * math.pi * round((theta[0] - first) / (2 * math.pi))
    truth = np.unwrap(np.arctan2(np.tan(first) + time, 1.0) + math.pi) + turn
    np.testing.assert_allclose(theta, truth, atol=1e-7)
    assert lower <= theta.min() and theta.max() <= upper


def lander_in_a_plane(angle: pl.ScalarControl | None) -> pl.Problem:
    """Least propellant from 1 km to rest anywhere on the ground, by throttle and angle, or by a direction."""
    controls = (pl.ScalarControl(name="k", lower=0.0, upper=1.0), angle or pl.UnitVectorControl(names=("a", "b")))

    def rates(x: Any, u: Any, p: Any, xp: Any) -> tuple[Any, ...]:
        east, up = (u.a, u.b) if angle is None else (xp.sin(u.theta), xp.cos(u.theta))
        thrust = p.thrust * u.k
        return x.vx, x.vy, thrust * east / x.mass, thrust * up / x.mass - p.g, -thrust / p.exhaust

    phase = pl.Phase(
        name="land",
        states=variables(x="m", y="m", vx="m/s", vy="m/s", mass="kg"),
        controls=controls,
        dynamics=rates,
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.y, x.vx, x.vy), ground="m", across="m/s", down="m/s"),
    )
    return pl.Problem(
        name="lander",
        phases=(phase,),
        start=lambda p, xp: (0 * p.height, p.height, p.across, -p.down, p.mass),
        given=given(
            thrust=(4000.0, "N"), g=(1.6, "m/s^2"), exhaust=(120.0, "m/s"), height=(1000.0, "m"), across=(24.0, "m/s"),
            down=(8.0, "m/s"), mass=(1000.0, "kg")),
        free=(pl.FreeParameter(name="T", unit="s", lower=7.5, upper=200.0, guess=38.0),),
        objective=lambda x, p, xp: -x.mass,
        objective_unit="kg",
    )  # fmt: skip


@pytest.mark.parametrize("lower", [-math.inf, -math.pi / 2])
def test_an_angle_may_point_no_thrust(lower: float) -> None:
    """While it coasts H does not depend on the angle, which goes on as it would with the least thrust."""
    angle = pl.ScalarControl(name="theta", unit="rad", lower=lower, upper=-lower)
    pointed = pl.solve(lander_in_a_plane(None), pl.Pseudospectral(), verify=0)
    solution = pl.solve(lander_in_a_plane(angle), pl.Pseudospectral(), verify=2)
    assert (solution.outcome, solution.verification.level) == (pl.Outcome.PROVED, 2)
    assert solution.objective == pytest.approx(pointed.objective, rel=1e-9)
    assert solution.trajectories[0].control.values[0, 0] == 0.0
