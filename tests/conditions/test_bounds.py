"""What may sit on a bound: ranges at ends, free parameters, durations. Closed forms, both methods, proved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from perilune import Genetic, Hybrid, Indirect, Pseudospectral, sweep
from perilune.charts.feasibility import point_feasibility
from perilune.conditions.canonical_equations import extremal_parameters
from perilune.conditions.pontryagin import derive
from perilune.core import NotConvergedError, Outcome, PeriluneError
from perilune.problem import (
    Check,
    Conditions,
    FreeParameter,
    Nature,
    Parameter,
    Phase,
    Problem,
    ScalarControl,
    Variable,
    preflight,
)
from perilune.proof.feasible.phase_data import PhaseData
from perilune.proof.necessary.first_order import _check_range_signs
from perilune.scenario import load_text
from perilune.shooting.shooting_function import Shooting
from perilune.solve import solve
from perilune.verify import verify

Method = Indirect | Pseudospectral
METHODS: list[Method] = [Indirect(), Pseudospectral()]


def push(lower: float = -math.inf, upper: float = math.inf, **given: float) -> Problem:
    """Least energy, the integral of u^2/2, over 1 m in 1 s from rest; the end speed within a range."""
    phase = Phase(
        name="push",
        states=(Variable(name="x", unit="m"), Variable(name="v", unit="m/s"), Variable(name="cost", unit="m^2/s^3")),
        controls=(ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u),
        duration="T",
        end=Conditions(
            lambda x, p, xp: (x.x - p.length, x.v),
            Variable(name="place", unit="m"),
            Variable(name="speed", unit="m/s", lower=lower, upper=upper),
        ),
        end_guess=lambda p, xp: (p.length, p.length / p.T, p.length * p.length / (p.T * p.T * p.T)),
    )
    numbers = {"T": (1.0, "s"), "length": (1.0, "m")}
    return Problem(
        name="push",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given={name: Parameter(value=given.get(name, v), unit=unit) for name, (v, unit) in numbers.items()},
        objective=lambda x, p, xp: x.cost,
        objective_unit="m^2/s^3",
    )


def energy(distance: float, start_speed: float, end_speed: float, time: float = 1.0) -> float:
    """Least integral of u^2/2 between speeds over a distance: u = a + b t meets both conditions."""
    matrix = np.array([[time, time**2 / 2], [time**2 / 2, time**3 / 6]])
    a, b = np.linalg.solve(matrix, [end_speed - start_speed, distance - start_speed * time])
    return 0.5 * (a * a * time + a * b * time**2 + b * b * time**3 / 3)


# -- ranges at ends. Left free, the end speed is 1.5 m/s: the costate of the speed vanishes there.


@pytest.mark.parametrize("method", METHODS, ids=lambda xp: type(xp).__name__)
@pytest.mark.parametrize(
    ("lower", "upper", "speed", "sign"),
    [(0.0, 2.0, 1.5, 0), (0.0, 1.0, 1.0, 1), (1.8, math.inf, 1.8, -1), (-math.inf, 1.2, 1.2, 1)],
    ids=["inside", "at the upper bound", "at the lower bound", "with one bound"],
)
def test_a_range_at_the_end(
    method: Indirect | Pseudospectral, lower: float, upper: float, speed: float, sign: int
) -> None:
    problem = push(lower, upper)
    solution = solve(problem, method)
    assert solution.outcome is Outcome.PROVED and solution.verification.level == 3
    assert solution.objective == pytest.approx(energy(1.0, 0.0, speed), rel=1e-9)
    assert solution.trajectories[0].state.values[-1, 1] == pytest.approx(speed, abs=1e-9)
    # dJ*/d(speed) = -nu, which pulls towards 1.5 m/s from either side.
    slope = (energy(1.0, 0.0, speed + 1e-4) - energy(1.0, 0.0, speed - 1e-4)) / 2e-4
    assert solution.multipliers["push.speed"] == pytest.approx(-slope, abs=1e-8)
    assert np.sign(round(solution.multipliers["push.speed"], 6)) == sign
    for other in METHODS:  # and from there and back
        assert other.run(problem, guess=solution).objective == pytest.approx(solution.objective, rel=1e-9)


def test_a_sweep_over_the_bound_of_a_range_takes_what_is_held_along() -> None:
    """A member that sits on the bound begins the next one, whose bound is elsewhere, either way."""
    base = push()
    place, speed = base.phases[0].end_conditions
    phase = replace(base.phases[0], end=Conditions.of(base.phases[0].end, (place, replace(speed, upper="fastest"))))
    given = {**base.given, "fastest": Parameter(value=1.2, unit="m/s")}
    family = sweep(replace(base, phases=(phase,), given=given), {"fastest": [1.2, 1.0, 1.3, 2.0]}, verify=1)
    for point in family.points:
        assert point.solution is not None and point.solution.outcome is Outcome.PROVED
        assert point.solution.objective == pytest.approx(energy(1.0, 0.0, min(point.value, 1.5)), rel=1e-9)


@pytest.mark.parametrize("upper", [1.0, 2.0])
def test_a_range_between_phases(upper: float) -> None:
    """The first half must end slower than that: one that binds, and one that does not."""
    base = push()
    half = base.phases[0]

    def phase(name: str, duration: str, where: float, conditions: tuple[Variable, ...]) -> Phase:
        return replace(
            half, name=name, duration=duration, 
            end=Conditions(lambda x, p, xp: (x.x - where * p.length, x.v)[: len(conditions)], *conditions),
            end_guess=lambda p, xp: (where * p.length, p.length / p.T, p.length * p.length / (p.T * p.T * p.T)),
        )  # fmt: skip

    place, speed = half.end_conditions[0], Variable(name="speed", unit="m/s", upper=upper)
    problem = replace(
        base,
        phases=(phase("first", "T", 0.5, (place, speed)), phase("second", "T2", 1.0, (place,))),
        links=(lambda x, p, xp: (x.x, x.v, x.cost),),
        given={**base.given, "T2": Parameter(value=1.0, unit="s")},
    )
    speeds = np.linspace(0.0, upper, 20001)
    # Over the second half the end speed is free: u ends at zero, and the energy is 3/2 (distance - v)^2.
    best = min(energy(0.5, 0.0, v) + 1.5 * (0.5 - v) ** 2 for v in speeds.tolist())
    solution = solve(problem)
    assert solution.outcome is Outcome.PROVED
    assert solution.objective == pytest.approx(best, rel=1e-7)
    binding = speeds[-1] < 0.7
    assert (solution.multipliers["first.speed"] > 1e-6) == binding


def failed(checks: Sequence[Check]) -> set[str]:
    return {c.name for c in checks if not c.passed}


def test_the_proof_sees_a_range_that_is_left_and_a_wrong_sign() -> None:
    """The free optimum, sold as that of a range it lies outside of; and that of an equality as that of a range."""
    free, fixed = solve(push(0.0, 2.0), verify=0), solve(push(0.0, 1.0), verify=0)
    assert "speed" in failed(verify(replace(free, problem=push(0.0, 1.0))).verification.checks)
    assert "range_speed" in failed(verify(replace(fixed, problem=push(1.0, 2.0))).verification.checks)
    inside = failed(verify(replace(fixed, problem=push(0.0, 2.0))).verification.checks)
    assert {"transversality", "multipliers"} <= inside


def test_an_empty_range_is_refused() -> None:
    with pytest.raises(PeriluneError, match="bounds of speed are empty"):
        push(2.0, 1.0)


def between(slowest: float, fastest: float) -> Problem:
    """The end speed between two parameters."""
    base = push()
    place, speed = base.phases[0].end_conditions
    ranged = replace(speed, lower="slowest", upper="fastest")
    phase = replace(base.phases[0], end=Conditions.of(base.phases[0].end, (place, ranged)))
    bounds = {"slowest": Parameter(value=slowest, unit="m/s"), "fastest": Parameter(value=fastest, unit="m/s")}
    return replace(base, phases=(phase,), given={**base.given, **bounds})


def test_an_empty_range_between_parameters_is_refused_in_an_atlas_too() -> None:
    """Along it two extremals were found, each at one of the bounds: it was solved, not proved, and mapped."""
    problem = between(1.2, 1.0)
    with pytest.raises(PeriluneError, match="bounds of speed are empty") as refused:
        solve(problem)
    assert refused.value.exit_code == 2
    assert refused.value.got == "the upper bound of speed 1 m/s" and refused.value.expected == "at least 1.2 m/s"
    points = np.array([[1.2, 1.0], [1.2, 1.3], [1.2, 1.2]])
    assert point_feasibility(problem, ["slowest", "fastest"])(points).tolist() == [False, True, True]
    assert preflight(problem.with_given(fastest=1.3)) == ()  # and of what is in order nothing is said


@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_a_range_of_one_value_is_an_equality_to_the_proof(speed: float) -> None:
    """Whichever way the speed pulls."""
    solution = solve(between(speed, speed))
    assert solution.outcome is Outcome.PROVED
    assert solution.objective == pytest.approx(energy(1.0, 0.0, speed), rel=1e-9)


def test_a_population_knows_ranges() -> None:
    found = Hybrid(Genetic(population=32, generations=10), Indirect()).run(push(0.0, 1.0))
    assert found.objective == pytest.approx(energy(1.0, 0.0, 1.0), rel=1e-9)


# -- any number of bounded free parameters


def shove(place: tuple[float, float], speed: tuple[float, float], time: tuple[float, float]) -> Problem:
    """Where to start, how fast, and how long, each within bounds and at a price: J is quadratic in the first two."""
    base = push(1.0, 1.5)
    return replace(
        base,
        start=lambda p, xp: (p.a, p.b, 0.0 * p.price_a * p.a * p.a),
        given={
            "length": Parameter(value=1.0, unit="m"),
            "price_a": Parameter(value=4.0, unit="1/s^3"),
            "price_b": Parameter(value=1.0, unit="1/s"),
            "price_T": Parameter(value=1.5, unit="m^2/s^4"),
        },
        free=(
            FreeParameter(name="a", unit="m", lower=place[0], upper=place[1], guess=0.1),
            FreeParameter(name="b", unit="m/s", lower=speed[0], upper=speed[1], guess=0.1),
            FreeParameter(name="T", unit="s", lower=time[0], upper=time[1], guess=1.0),
        ),
        objective=lambda x, p, xp: x.cost + p.price_a * p.a * p.a + p.price_b * p.b * p.b + p.price_T * p.T,
    )


def least(place: tuple[float, float], speed: tuple[float, float], time: tuple[float, float]) -> float:
    """The same by SciPy, from many starts."""
    from scipy.optimize import minimize

    def cost(z: np.ndarray) -> float:
        a, b, end, t = z
        return energy(1.0 - a, b, end, t) + 4.0 * a * a + b * b + 1.5 * t

    bounds = [place, speed, (1.0, 1.5), time]
    starts = product(*[(low + 0.2 * (high - low), low + 0.7 * (high - low)) for low, high in bounds])
    return min(float(minimize(cost, start, bounds=bounds, tol=1e-15).fun) for start in starts)


BOUNDED = [
    ((-1.0, 1.0), (-1.0, 2.0), (0.2, 5.0)),
    ((-1.0, 0.05), (-1.0, 2.0), (0.2, 5.0)),
    ((-1.0, 1.0), (-1.0, 0.3), (0.2, 5.0)),
    ((-1.0, 0.05), (-1.0, 0.3), (0.2, 5.0)),
    ((-1.0, 0.05), (-1.0, 0.3), (0.2, 0.9)),
    ((0.6, 1.0), (1.2, 2.0), (1.4, 5.0)),
]


@pytest.mark.parametrize("bounds", BOUNDED, ids=str)
def test_which_parameters_sit_on_a_bound_is_found(bounds: tuple[tuple[float, float], ...]) -> None:
    problem = shove(*bounds)
    best = least(*bounds)
    for method in METHODS:
        solution = solve(problem, method)
        assert solution.objective == pytest.approx(best, rel=1e-8)
        assert solution.outcome is Outcome.PROVED
    solution = solve(problem, verify=0)
    held = [
        name for name, pair in zip(("a", "b", "T"), bounds, strict=True)
        if any(solution.free[name] == pytest.approx(limit, abs=1e-9) for limit in pair)
    ]  # fmt: skip
    assert (solution.extremals[0].nature is Nature.BEST_AT_BOUND) == bool(held)
    again = solve(problem, guess=solution, verify=0)
    assert again.objective == pytest.approx(best, rel=1e-8)
    assert again.free == pytest.approx(solution.free, abs=1e-9)


def test_a_guess_is_held_at_the_bound_it_runs_into() -> None:
    """From the answer between wide bounds to that between narrow ones, and back."""
    wide, narrow = (solve(shove(*bounds), verify=0) for bounds in (BOUNDED[0], BOUNDED[4]))
    there = solve(shove(*BOUNDED[4]), guess=wide, verify=0)
    back = solve(shove(*BOUNDED[0]), guess=narrow, verify=0)
    assert (there.objective, back.objective) == pytest.approx((narrow.objective, wide.objective), rel=1e-9)


# -- which extremals there are, and what each is


@pytest.mark.parametrize("worst", [0.47, 0.2])
@pytest.mark.parametrize("price", [1e-3, 1.0])
def test_extremals_are_told_apart_however_close_and_flat(worst: float, price: float) -> None:
    """dJ/dq = price (q - worst) (q - best): between two values of the family too, and where J is all but flat."""
    best, base = 0.485, push(0.0, 2.0)

    def polynomial(q: Any) -> Any:
        return q * q * q / 3 - (worst + best) / 2 * q * q + worst * best * q

    problem = replace(
        base,
        given={**base.given, "price": Parameter(value=price, unit="m^2/s^3")},
        free=(FreeParameter(name="q", unit="m", lower=0.0, upper=1.0, guess=1.0),),
        objective=lambda x, p, xp: x.cost + p.price * polynomial(p.q / p.length),
    )

    found = {e.nature: e for e in solve(problem, verify=0).extremals}
    assert found[Nature.WORST].free["q"] == pytest.approx(worst, abs=1e-7)
    least = found.get(Nature.LOCAL_OPTIMUM) or found[Nature.BEST]
    assert least.free["q"] == pytest.approx(best, abs=1e-7)
    assert least.objective == pytest.approx(energy(1.0, 0.0, 1.5) + price * polynomial(best), rel=1e-12)
    assert len(found) == 3  # and the lower bound, where J rises into the range


def test_a_parameter_that_acts_between_phases() -> None:
    """A kick at the joint, paid for at the end: the least by SciPy over the place, the speed before it and the kick."""
    from scipy.optimize import minimize

    base = push()
    half = base.phases[0]
    first = replace(half, name="first", end=None)
    ends = (half.end_conditions[0], Variable(name="speed", unit="m/s"))
    second = replace(half, name="second", duration="T2", end=Conditions.of(half.end, ends))
    problem = replace(
        base,
        phases=(first, second),
        links=(lambda x, p, xp: (x.x, x.v + p.kick, x.cost),),
        given={**base.given, "T2": Parameter(value=0.5, unit="s"), "price": Parameter(value=0.8, unit="1/s")},
        free=(FreeParameter(name="kick", unit="m/s", lower=-5.0, upper=5.0, guess=1.0),),
        objective=lambda x, p, xp: x.cost + p.price * p.kick * p.kick,
    )

    def cost(z: np.ndarray) -> float:
        place, speed, kick = z
        return energy(place, 0.0, speed) + 0.8 * kick * kick + energy(1.0 - place, speed + kick, 0.0, 0.5)

    least = minimize(cost, [0.5, 0.5, 0.0], tol=1e-14)
    solution = solve(problem)
    assert solution.outcome is Outcome.PROVED, str(solution.verification)
    assert solution.objective == pytest.approx(float(least.fun), rel=1e-10)
    assert solution.free["kick"] == pytest.approx(float(least.x[2]), abs=1e-6)


# -- what is no answer

SMALL_BODY = """
[body]
name = "ceres"
[vehicle]
mass = "300 kg"
thrust = "300 N"
specific_impulse = "440 s"
[retro]
specific_impulse = "320 s"
[orbit]
parking_altitude = "60 km"
perilune_altitude = "5 km"
[landing]
altitude = "4.9 km"
"""


def test_a_negative_flight_time_is_no_answer() -> None:
    """100 m above the site the equations have an extremal that ends 296 s before it begins, with 320.6 of 300 kg."""
    solution = solve(load_text(SMALL_BODY))
    assert solution.outcome is Outcome.PROVED
    assert solution.free["flight_time"] == pytest.approx(276.294515538, rel=1e-9)
    assert all(extremal.free["flight_time"] > 0 for extremal in solution.extremals)
    assert len(solution.extremals) == 1  # and none is listed twice


def test_from_a_guess_no_negative_flight_time_is_reached() -> None:
    """Newton ends there from that extremal itself, and it is no flight."""
    problem = load_text(SMALL_BODY)
    best, p, shooting = solve(problem, verify=0), extremal_parameters(problem), Shooting(derive(problem))
    assert best.unknowns is not None
    backwards = np.tile(best.unknowns, (64, 1))
    backwards[:, :5] = np.random.default_rng(0).normal(size=(64, 5))
    backwards[:, 6] *= -1.0
    roots = shooting.solve(backwards, p, shooting.holding({0: 0.0}), max_step=0.5)
    y = next(root.y for root in roots if root.converged and root.y[6] < 0)
    with pytest.raises(NotConvergedError, match=r"outside the bounds of flight_time\s+got: -296.108 s"):
        solve(problem, guess=replace(best, unknowns=y), verify=0)


@pytest.mark.parametrize("longest", [5.0, math.inf])
def test_that_no_flight_at_all_is_best_is_said(longest: float) -> None:
    """The start is the end, and time costs: the least is a flight of no length, which has no extremal."""
    base = push(0.0, 1.0)
    waiting = replace(
        base,
        given={"length": Parameter(value=0.0, unit="m"), "price": Parameter(value=1.0, unit="m^2/s^4")},
        free=(FreeParameter(name="T", unit="s", lower=0.0, upper=longest, guess=1.0),),
        objective=lambda x, p, xp: x.cost + p.price * p.T,
    )
    with pytest.raises(
        NotConvergedError, match=r"T goes to 0 s: the optimal flight has no push[\s\S]*a lower bound above 0"
    ):
        solve(waiting)


def placed_by_choice(gain: float, ranged: bool) -> Problem:
    """x' = u for 1 s from 0 to q >= 0, J = int u^2/2 - gain q^2 = (1/2 - gain) q^2; q free, or the range of an end."""
    phase = Phase(
        name="go",
        states=(Variable(name="x", unit="m"), Variable(name="e", unit="m^2/s")),
        controls=(ScalarControl(name="u", unit="m/s"),),
        dynamics=lambda x, u, p, xp: (u.u, 0.5 * u.u * u.u),
        duration="T",
        end=Conditions.of(
            (lambda x, p, xp: (x.x,)) if ranged else (lambda x, p, xp: (x.x - p.q,)),
            (Variable(name="place", unit="m", lower=0.0 if ranged else -np.inf),),
        ),
    )
    return Problem(
        name="placed",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0),
        given={"T": Parameter(value=1.0, unit="s"), "gain": Parameter(value=gain, unit="1/s")},
        free=() if ranged else (FreeParameter(name="q", unit="m", lower=0.0, upper=5.0),),
        objective=(lambda x, p, xp: x.e - p.gain * x.x * x.x)
        if ranged
        else (lambda x, p, xp: x.e - p.gain * p.q * p.q),
        objective_unit="m^2/s",
    )


@pytest.mark.parametrize(("ranged", "sees"), [(False, "second_variation"), (True, "conjugate_point")])
def test_a_bound_that_holds_nothing_back_proves_no_optimum(ranged: bool, sees: str) -> None:
    """At q = 0 the slope of J is 0 whatever the gain: beyond 1/2 leaving the bound is better at second order."""
    rests = solve(placed_by_choice(0.2, ranged))
    assert rests.outcome is Outcome.PROVED, str(rests.verification)
    proof = verify(replace(rests, problem=placed_by_choice(1.0, ranged))).verification
    assert proof.level == 2
    assert next(c for c in proof.checks if c.name == sees).value == pytest.approx(2.0, rel=1e-6)  # gain / (1/2)


def test_a_free_limit_of_a_control_is_proved_where_it_is_best_and_nowhere_else() -> None:
    """x'' = u in [-1, q], 1 m from rest to rest: T = sqrt(2 (1 + 1/q)), J = T + q^2/5. dJ/dq goes through u = q."""
    phase = Phase(
        name="go",
        states=(Variable(name="x", unit="m"), Variable(name="v", unit="m/s")),
        controls=(ScalarControl(name="u", unit="m/s^2", lower=-1.0, upper="q"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u),
        duration="T",
        end=Conditions(lambda x, p, xp: (x.x - p.distance, x.v), place="m", rest="m/s"),
    )
    problem = Problem(
        name="limits",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0),
        given={"distance": Parameter(value=1.0, unit="m"), "price": Parameter(value=0.2, unit="s^5/m^2")},
        free=(
            FreeParameter(name="T", unit="s", lower=0.0, upper=20.0),
            FreeParameter(name="q", unit="m/s^2", lower=0.1, upper=10.0),
        ),
        objective=lambda x, p, xp: p.T + p.price * p.q * p.q,
        objective_unit="s",
    )
    best = solve(problem)
    assert best.outcome is Outcome.PROVED, str(best.verification)
    q = best.free["q"]
    assert 0.4 * q == pytest.approx(1 / (q * q * math.sqrt(2 * (1 + 1 / q))), rel=1e-8)
    least = solve(problem.with_given(q=0.1), verify=0)
    claim = verify(replace(least, problem=problem, free={**least.free, "q": 0.1})).verification
    assert [c.name for c in claim.failed if c.level == 2] == ["stationary_q"]
    with pytest.raises(PeriluneError, match="u of go has a free bound, which direct methods do not support"):
        solve(problem, Pseudospectral())


def test_a_multiplier_that_is_no_number_has_no_sign() -> None:
    """Of a range that is met at its bound."""
    rests = solve(placed_by_choice(0.2, ranged=True), verify=0)
    for nu, passes in ((0.0, True), (-1.0, True), (1.0, False), (math.nan, False)):
        (sign,) = _check_range_signs(PhaseData(solution=rests, index=0), np.array([nu]))
        assert sign.passed is passes
