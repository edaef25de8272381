"""The proof: true extremals pass, and each way of being wrong fails the check that names it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from landing_by_scipy import cho_problem, resolve, shoot, solution_of
from perilune import Pseudospectral
from perilune.core import Outcome, PeriluneError
from perilune.models import Retro
from perilune.models.landing.problem import mass_consistency_checks
from perilune.problem import (
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
from perilune.proof.sufficient.sensitivities import check_neighbours
from perilune.verify import verify
from problems.constrained import mars_glide_slope

HYBRID = Retro(specific_impulse=310.0)
# First values only: Newton's method finds the roots to the last digit.
GUESSES = {
    "hybrid": (2.17, 0.265, 0.0, -0.707, 0.264, 0.71),
    "ordinary": (0.436, 0.2135, -0.0286, -0.3885, 0.925),
    "local minimum": (0.414, 0.216, -0.058, -0.405, 0.846, 0.0762),
}


@pytest.fixture(scope="session")
def scipy_hybrid() -> Solution:
    problem = cho_problem(HYBRID)
    return solution_of(problem, shoot(problem, np.array(GUESSES["hybrid"])))


@pytest.fixture(scope="session")
def scipy_ordinary() -> Solution:
    problem = cho_problem(None)
    return solution_of(problem, shoot(problem, np.array(GUESSES["ordinary"])))


@pytest.fixture(scope="session")
def local_minimum() -> Solution:
    problem = cho_problem(HYBRID)
    return solution_of(problem, shoot(problem, np.array(GUESSES["local minimum"])))


def failed(verification: Verification) -> set[str]:
    return {c.name for c in verification.failed}


def with_curve(solution: Solution, which: str, change: Callable[[Curve], Curve]) -> Solution:
    flown = solution.trajectories[0]
    return replace(solution, trajectories=(replace(flown, **{which: change(getattr(flown, which))}),))


def shifted_values(column: int, amount: float) -> Callable[[Curve], Curve]:
    def change(curve: Curve) -> Curve:
        values = curve.values.copy()
        values[:, column] += amount
        return replace(curve, values=values)

    return change


# --- true extremals
# ---------------------------------------------------------------------------------------------------


def test_the_scipy_extremals_are_those_of_the_paper(
    scipy_hybrid: Solution, scipy_ordinary: Solution, local_minimum: Solution
) -> None:
    """Table 1 of Cho et al. with the constants that reproduce its printed digits."""
    assert -scipy_ordinary.objective == pytest.approx(154.54135, abs=1e-5)
    assert scipy_ordinary.free["flight_time"] == pytest.approx(1005.3507, abs=1e-3)
    assert -scipy_hybrid.objective == pytest.approx(160.618584, abs=1e-6)
    assert scipy_hybrid.free["retro_delta_v"] == pytest.approx(1200.944, abs=1e-3)
    assert scipy_hybrid.free["flight_time"] == pytest.approx(286.864, abs=1e-3)
    assert 120 < local_minimum.free["retro_delta_v"] < 140


@pytest.mark.parametrize("name", ["scipy_hybrid", "scipy_ordinary"])
def test_a_true_extremal_is_proved(name: str, request: pytest.FixtureRequest) -> None:
    verification = verify(request.getfixturevalue(name), resolve=resolve).verification
    assert verification.passed, str(verification)
    assert verification.level == 3
    names = [c.name for c in verification.checks]
    assert len(set(names)) == len(names)
    assert all(c.meaning and c.unit for c in verification.checks)


@pytest.mark.parametrize("name", ["hybrid", "ordinary"])
def test_the_answer_of_the_solver_is_proved(name: str, request: pytest.FixtureRequest) -> None:
    """With neighbours solved again by the solver itself."""
    verification = verify(request.getfixturevalue(name)).verification
    assert verification.passed, str(verification)
    assert verification.level == 3


def test_no_retro_burn_is_an_extremal_at_its_bound(scipy_ordinary: Solution) -> None:
    """In the hybrid problem delta_v = 0 satisfies Karush-Kuhn-Tucker: leaving it gains nothing."""
    problem = cho_problem(HYBRID)
    at_bound = replace(scipy_ordinary, problem=problem, free={**scipy_ordinary.free, "retro_delta_v": 0.0})
    verification = verify(at_bound, resolve=resolve).verification
    assert verification.passed, str(verification)
    check = next(c for c in verification.checks if c.name == "stationary_retro_delta_v")
    assert "at its bound" in check.meaning
    assert "second_order_retro_delta_v" not in {c.name for c in verification.checks}


def test_the_touchdown_of_a_good_answer_is_within_a_millimetre(scipy_ordinary: Solution) -> None:
    checks = {c.name: c for c in verify(scipy_ordinary, level=1).verification.checks}
    assert checks["touchdown_altitude"].limit < 1e-3
    assert checks["touchdown_transverse_velocity"].limit < 1e-6
    # Limits are not far above what a good answer leaves; 1e-4 of them would be a check that cannot fail.
    assert checks["touchdown_altitude"].value > 1e-4 * checks["touchdown_altitude"].limit


# --- every way of being wrong
# -----------------------------------------------------------------------------------------


def test_a_local_minimum_of_landed_mass_fails_the_second_order(local_minimum: Solution) -> None:
    verification = verify(local_minimum, resolve=resolve).verification
    assert failed(verification) == {"second_order_retro_delta_v", "second_variation"}
    assert verification.level == 2


def test_a_retro_burn_of_zero_is_not_stationary_inside_its_range(scipy_ordinary: Solution) -> None:
    problem = cho_problem(HYBRID)
    free = tuple(replace(f, lower=-100.0) if f.name == "retro_delta_v" else f for f in problem.free)
    inside = replace(
        scipy_ordinary,
        problem=replace(problem, parameter_bounds=None, free=free),
        free={**scipy_ordinary.free, "retro_delta_v": 0.0},
    )
    assert failed(verify(inside, level=2).verification) == {"stationary_retro_delta_v"}


@pytest.mark.parametrize(("bounds", "passes"), [((0.0, 1000.0), True), ((1000.0, 1500.0), False)])
def test_at_a_bound_the_objective_must_not_fall_into_the_range(bounds: tuple[float, float], passes: bool) -> None:
    """The best retro burn is 1200.9 m/s: 1000 m/s are right as the most that may be burnt, not as the least."""
    fixed = cho_problem(Retro(specific_impulse=310.0, delta_v=1000.0))
    found = solution_of(fixed, shoot(fixed, np.array(GUESSES["hybrid"])))
    hybrid, (lower, upper) = cho_problem(HYBRID), bounds
    free = tuple(replace(f, lower=lower, upper=upper) if f.name == "retro_delta_v" else f for f in hybrid.free)
    problem = replace(hybrid, parameter_bounds=None, free=free)
    claimed = replace(found, problem=problem, free={**found.free, "retro_delta_v": 1000.0})
    assert failed(verify(claimed, level=2).verification) == (set() if passes else {"stationary_retro_delta_v"})


def test_another_delta_v_is_not_stationary() -> None:
    fixed = cho_problem(Retro(specific_impulse=310.0, delta_v=1200.9011))  # as (26) prints it, 0.04 m/s short
    found = solution_of(fixed, shoot(fixed, np.array(GUESSES["hybrid"])))
    claimed = replace(found, problem=cho_problem(HYBRID), free={**found.free, "retro_delta_v": 1200.9011})
    assert failed(verify(claimed, level=2).verification) == {"stationary_retro_delta_v"}


def test_costates_of_the_other_sign_fail(scipy_hybrid: Solution) -> None:
    flipped = with_curve(scipy_hybrid, "costate", lambda c: replace(c, values=-c.values, rates=-c.rates))
    assert {"transversality", "minimum_of_hamiltonian"} <= failed(verify(flipped, level=2).verification)
    assert verify(flipped, level=2).verification.level == 1


def rotated(angle: float) -> Callable[[Curve], Curve]:
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    return lambda c: replace(c, values=c.values @ turn, rates=c.rates @ turn)


def test_a_control_off_by_a_hundredth_of_a_degree_fails(scipy_hybrid: Solution) -> None:
    verification = verify(with_curve(scipy_hybrid, "control", rotated(math.radians(0.01))), level=2).verification
    assert {
        "touchdown_altitude", "touchdown_radial_velocity", "state_v",
        "minimum_of_hamiltonian", "stationary_direction_transverse_radial",
    } <= failed(verification)  # fmt: skip
    assert verification.level == 0


def test_a_control_shifted_in_time_fails(scipy_ordinary: Solution) -> None:
    late = with_curve(scipy_ordinary, "control", lambda c: replace(c, values=c(np.maximum(c.time - 0.5, 0.0))))
    assert {"touchdown_altitude", "minimum_of_hamiltonian"} <= failed(verify(late, level=2).verification)


def test_the_control_that_maximises_the_hamiltonian_fails(scipy_hybrid: Solution) -> None:
    opposite = with_curve(scipy_hybrid, "control", rotated(math.pi))
    names = failed(verify(opposite, level=3, resolve=resolve).verification)
    assert {"touchdown_transverse_velocity", "minimum_of_hamiltonian", "legendre_clebsch"} <= names


@pytest.mark.parametrize("grams", [0.001, 1.0])
def test_a_mass_that_was_tampered_with_fails(scipy_hybrid: Solution, grams: float) -> None:
    tampered = with_curve(scipy_hybrid, "state", shifted_values(4, grams * 1e-3))
    assert "state_m" in failed(verify(tampered, level=1).verification)
    assert "retro_mass" in {c.name for c in mass_consistency_checks(tampered) if not c.passed}


def test_a_landed_mass_that_was_not_flown_fails(scipy_hybrid: Solution) -> None:
    assert failed(verify(replace(scipy_hybrid, objective=scipy_hybrid.objective - 1e-6), level=1).verification) == {
        "objective"
    }


@pytest.mark.parametrize("which", ["state", "control", "costate"])
def test_a_nan_in_a_table_ends_the_proof(scipy_hybrid: Solution, which: str) -> None:
    def spoil(curve: Curve) -> Curve:
        values = curve.values.copy()
        values[7, 1] = math.nan
        return replace(curve, values=values)

    verification = verify(with_curve(scipy_hybrid, which, spoil)).verification
    assert failed(verification) == {"tables"}
    assert verification.level == 0


def test_times_out_of_order_end_the_proof(scipy_hybrid: Solution) -> None:
    assert failed(
        verify(with_curve(scipy_hybrid, "control", lambda c: replace(c, time=c.time[::-1]))).verification
    ) == {"tables"}


@pytest.mark.parametrize("late", [1e-3, -1e-3])
def test_a_wrong_flight_time_fails(scipy_hybrid: Solution, late: float) -> None:
    wrong = replace(scipy_hybrid, free={**scipy_hybrid.free, "flight_time": scipy_hybrid.free["flight_time"] + late})
    assert {"flight_time", "touchdown_transverse_velocity", "objective"} <= failed(verify(wrong, level=1).verification)


def test_wrong_multipliers_fail(scipy_hybrid: Solution) -> None:
    found = replace(scipy_hybrid, multipliers={"descent.touchdown_altitude": 0.0})
    assert failed(verify(found, level=2).verification) == {"multipliers"}


def test_without_costates_nothing_beyond_level_one_is_proved(scipy_hybrid: Solution) -> None:
    bare = replace(scipy_hybrid, trajectories=(replace(scipy_hybrid.trajectories[0], costate=None),))
    verification = verify(bare).verification
    assert failed(verification) == {"costates"}
    assert verification.level == 1


def test_a_neighbour_that_cannot_be_solved_fails(scipy_hybrid: Solution) -> None:
    def refuse(problem: Problem, guess: Solution) -> Solution:
        raise PeriluneError("no")

    names = failed(verify(scipy_hybrid, resolve=refuse).verification)
    assert names == {f"initial_costate_{s}" for s in ("r", "phi", "u", "v", "m")} | {"second_order_retro_delta_v"}


def test_neighbours_that_disagree_with_the_costates_fail(scipy_hybrid: Solution) -> None:
    """A solver that forgets to choose the retro burn again, and reports half the change."""

    def half(problem: Problem, guess: Solution) -> Solution:
        found = resolve(problem, guess)
        return replace(found, objective=0.5 * (found.objective + guess.objective))

    assert {"initial_costate_r", "initial_costate_u", "initial_costate_m"} <= failed(
        verify(scipy_hybrid, resolve=half).verification
    )


def test_an_unknown_level_is_refused(scipy_hybrid: Solution) -> None:
    with pytest.raises(PeriluneError, match="no such verification level"):
        verify(scipy_hybrid, level=6)


def test_missing_trajectories_are_refused(scipy_hybrid: Solution) -> None:
    with pytest.raises(PeriluneError, match="lacks trajectories"):
        verify(replace(scipy_hybrid, trajectories=()))


def test_the_bookkeeping_of_good_answers_closes(scipy_hybrid: Solution, scipy_ordinary: Solution) -> None:
    for solution in (scipy_hybrid, scipy_ordinary):
        checks = mass_consistency_checks(solution)
        assert [c.name for c in checks] == ["retro_mass", "propellant", "rocket_equation"]
        assert all(c.passed for c in checks), checks


def test_the_bookkeeping_sees_propellant_that_was_not_burnt(scipy_hybrid: Solution) -> None:
    def thinner(curve: Curve) -> Curve:
        values = curve.values.copy()
        values[:, 4] += 1e-6 * curve.time / curve.time[-1]
        return replace(curve, values=values)

    names = {c.name for c in mass_consistency_checks(with_curve(scipy_hybrid, "state", thinner)) if not c.passed}
    assert "propellant" in names


# --- closed forms
# -----------------------------------------------------------------------------------------------------


def curves(t: np.ndarray, x: Any, dx: Any, lam: Any, dlam: Any, u: Any, du: Any) -> Trajectory:
    def curve(values: Any, rates: Any) -> Curve:
        columns = [np.broadcast_to(np.asarray(v, dtype=float), t.shape) for v in (*values, *rates)]
        half = len(columns) // 2
        return Curve(time=t, values=np.array(columns[:half]).T, rates=np.array(columns[half:]).T)

    return Trajectory(phase="arc", state=curve(x, dx), costate=curve(lam, dlam), control=curve(u, du))


def oscillator(duration: float) -> Solution:
    """Least action of x'' = -x from x = 1 to 0: J = int (u^2 - x^2)/2 dt; conjugate to the start at pi."""
    phase = Phase(
        name="arc",
        states=(Variable(name="x"), Variable(name="action")),
        controls=(ScalarControl(name="rate"),),
        dynamics=lambda x, u, p, xp: (u.rate / p.second, (u.rate * u.rate - x.x * x.x) / (2 * p.second)),
        duration="duration",
        end=Conditions(lambda x, p, xp: (x.x,), at_origin="1"),
    )
    problem = Problem(
        name="oscillator",
        phases=(phase,),
        start=lambda p, xp: (p.x0, 0.0),
        given={
            "duration": Parameter(value=duration, unit="s"), "x0": Parameter(value=1.0),
            "second": Parameter(value=1.0, unit="s"),
        },
        objective=lambda x, p, xp: x.action,
    )  # fmt: skip
    t = np.linspace(0.0, duration, 1201)
    b = -math.cos(duration) / math.sin(duration)
    x, v = np.cos(t) + b * np.sin(t), -np.sin(t) + b * np.cos(t)
    action = 0.5 * (x * v - b)  # int (v^2 - x^2)/2 = [x v]/2 on an extremal
    flown = curves(t, (x, action), (v, 0.5 * (v * v - x * x)), (-v, 1.0), (x, 0.0), (v,), (-x,))
    return Solution(
        problem=problem, method="closed form", outcome=Outcome.SOLVED, objective=float(action[-1]), free={},
        trajectories=(flown,),
    )  # fmt: skip


def oscillator_again(problem: Problem, guess: Solution) -> Solution:
    """J = x0^2 cot(T)/2 in closed form, the running action added."""
    p = problem.parameters({})
    x0 = p.x0 + getattr(p, "offset_x", 0.0)
    return replace(guess, objective=getattr(p, "offset_action", 0.0) + 0.5 * x0**2 / math.tan(p.duration))


@pytest.mark.parametrize("duration", [1.0, 2.5, 3.0, 3.3, 4.0, 5.0])
def test_the_oscillator_has_its_conjugate_point_at_pi(duration: float) -> None:
    verification = verify(oscillator(duration), resolve=oscillator_again).verification
    check = next(c for c in verification.checks if c.name == "conjugate_point")
    assert check.value == pytest.approx((duration / math.pi) ** 2, rel=3e-4)  # measured 1.6e-4
    assert failed(verification) == (set() if duration < math.pi else {"conjugate_point"})
    assert verification.level == (3 if duration < math.pi else 2)


def test_two_oscillators_have_a_double_conjugate_point() -> None:
    """A determinant does not change its sign at a double zero; kappa does pass 1."""
    phase = Phase(
        name="arc",
        states=(Variable(name="x"), Variable(name="y"), Variable(name="action")),
        controls=(ScalarControl(name="a"), ScalarControl(name="b")),
        dynamics=lambda x, u, p, xp: (
            u.a / p.second, u.b / p.second, (u.a * u.a + u.b * u.b - x.x * x.x - x.y * x.y) / (2 * p.second),
        ),
        duration="duration",
        end=Conditions(lambda x, p, xp: (x.x, x.y), x_end="1", y_end="1"),
    )  # fmt: skip
    for duration, good in ((3.0, True), (3.3, False)):
        problem = Problem(
            name="two", phases=(phase,), start=lambda p, xp: (0.0, 0.0, 0.0),
            objective=lambda x, p, xp: x.action,
            given={"duration": Parameter(value=duration, unit="s"), "second": Parameter(value=1.0, unit="s")},
        )  # fmt: skip
        rest = curves(np.linspace(0, duration, 11), (0, 0, 0), (0, 0, 0), (0, 0, 1), (0, 0, 0), (0, 0), (0, 0))
        solution = Solution(
            problem=problem,
            method="closed form",
            outcome=Outcome.SOLVED,
            objective=0.0,
            free={},
            trajectories=(rest,),
        )
        names = failed(
            verify(solution, resolve=lambda p, g: replace(g, objective=getattr(p, "offset_action", 0.0))).verification
        )
        assert ("conjugate_point" in names) is not good


def double_integrator(sign: float = 1.0) -> Solution:
    """To rest in minimum time in two phases, from x = 1 at rest: thrust -1, then +1, one second each.

    lam_x = -1 and lam_v = t - 1 times `sign`, as H = -1 and lam_v vanishes at the switch (Bryson and Ho 3.9).
    """

    def phase(name: str, end: bool) -> Phase:
        conditions = (Variable(name="position", unit="m"), Variable(name="velocity", unit="m/s"))
        return Phase(
            name=name,
            states=(Variable(name="x", unit="m"), Variable(name="v", unit="m/s")),
            controls=(ScalarControl(name="a", unit="m/s^2", lower=-1.0, upper=1.0),),
            dynamics=lambda x, u, p, xp: (x.v, u.a),
            duration=f"{name}_time",
            end=Conditions.of((lambda x, p, xp: (x.x, x.v)) if end else None, conditions if end else ()),
        )

    problem = Problem(
        name="double_integrator",
        phases=(phase("speeding", False), phase("braking", True)),
        start=lambda p, xp: (p.x0, p.v0),
        links=(lambda x, p, xp: (x.x, x.v),),
        given={"x0": Parameter(value=1.0, unit="m"), "v0": Parameter(value=0.0, unit="m/s")},
        free=(
            FreeParameter(name="speeding_time", unit="s", lower=0.0),
            FreeParameter(name="braking_time", unit="s", lower=0.0),
        ),
        objective=lambda x, p, xp: p.speeding_time + p.braking_time,
        objective_unit="s",
    )
    t = np.linspace(0.0, 1.0, 11)
    lam = sign
    first = curves(t, (1 - t**2 / 2, -t), (-t, -1), (lam, lam * (1 - t)), (0, -lam), (-1,), (0,))
    second = curves(t, (0.5 - t + t**2 / 2, t - 1), (t - 1, 1), (lam, -lam * t), (0, -lam), (1,), (0,))
    return Solution(
        problem=problem, method="closed form", outcome=Outcome.SOLVED, objective=2.0,
        free={"speeding_time": 1.0, "braking_time": 1.0},
        trajectories=(replace(first, phase="speeding"), replace(second, phase="braking")),
    )  # fmt: skip


def minimum_time(problem: Problem, guess: Solution) -> Solution:
    """T = v + 2 sqrt(x + v^2/2) in closed form (Bryson and Ho 3.9)."""
    p = problem.parameters({})
    x, v = p.x0 + p.offset_x, p.v0 + p.offset_v
    return replace(guess, objective=v + 2 * math.sqrt(x + v * v / 2))


def test_the_double_integrator_in_two_phases_is_proved() -> None:
    verification = verify(double_integrator(), resolve=minimum_time).verification
    assert verification.passed, str(verification)
    assert verification.level == 3


def test_the_double_integrator_with_costates_reversed_fails_its_switching_function() -> None:
    names = failed(verify(double_integrator(-1.0), level=2).verification)
    assert {"speeding_switching_a", "braking_switching_a", "speeding_minimum_of_hamiltonian"} <= names
    assert {"stationary_speeding_time", "stationary_braking_time"} <= names


def test_a_control_beyond_its_bounds_fails() -> None:
    good = double_integrator()
    first, second = good.trajectories
    strong = replace(first, control=replace(first.control, values=first.control.values * 1.001))
    assert "speeding_bounds_a" in failed(verify(replace(good, trajectories=(strong, second)), level=1).verification)


def linear_tangent(bend: float = 0.0) -> Solution:
    """Greatest speed in a given time at a given height, thrust acceleration 1: tan(angle) is linear in time.

    lam = (0, n, -1, n (T - t)) with n the multiplier of the height (Bryson and Ho 2.4); `bend` adds a wrong
    term.
    """
    phase = Phase(
        name="arc",
        states=tuple(Variable(name=n, unit=u) for n, u in (("y", "m"), ("vx", "m/s"), ("vy", "m/s"))),
        controls=(UnitVectorControl(names=("along", "up")),),
        dynamics=lambda x, u, p, xp: (x.vy, p.thrust * u.along, p.thrust * u.up),
        duration="duration",
        end=Conditions(lambda x, p, xp: (x.y - p.height,), height="m"),
    )
    duration, n, count = 2.0, -0.4, 2001
    t = np.linspace(0.0, duration, count)
    tangent, slope = -n * (duration - t) + bend * t * (duration - t), n + bend * (duration - 2 * t)
    angle, turn = np.arctan(tangent), slope / (1 + tangent**2)
    u, du = (np.cos(angle), np.sin(angle)), (-np.sin(angle) * turn, np.cos(angle) * turn)
    from scipy.interpolate import CubicHermiteSpline

    velocity = [CubicHermiteSpline(t, a, b).antiderivative() for a, b in zip(u, du, strict=True)]
    height = velocity[1].antiderivative()
    vx, vy, y = velocity[0](t), velocity[1](t), height(t)
    problem = Problem(
        name="linear_tangent",
        phases=(phase,),
        start=lambda p, xp: (p.y0, p.v0, p.v0),
        given={
            "thrust": Parameter(value=1.0, unit="m/s^2"), "height": Parameter(value=float(y[-1]), unit="m"),
            "duration": Parameter(value=duration, unit="s"), "y0": Parameter(value=0.0, unit="m"),
            "v0": Parameter(value=0.0, unit="m/s"),
        },
        objective=lambda x, p, xp: -x.vx,
        objective_unit="m/s",
    )  # fmt: skip
    flown = curves(t, (y, vx, vy), (vy, *u), (n, -1, n * (duration - t)), (0, 0, -n), u, du)
    return Solution(
        problem=problem, method="closed form", outcome=Outcome.SOLVED, objective=-float(vx[-1]), free={},
        trajectories=(flown,),
    )  # fmt: skip


def linear_tangent_again(problem: Problem, guess: Solution) -> Solution:
    """Solve for n by bisection: the height is int (T - t) sin(angle) dt, the speed int cos(angle) dt."""
    p = problem.parameters({})
    node, weight = np.polynomial.legendre.leggauss(40)
    left, weight = 0.5 * p.duration * (1 - node), 0.5 * p.duration * weight
    wanted = p.height - p.offset_y - p.offset_vy * p.duration
    low, high = -3.0, 3.0
    for _ in range(80):
        n = 0.5 * (low + high)
        root = np.sqrt(1 + (n * left) ** 2)
        low, high = (low, n) if weight @ (-n * left * left / root) < wanted else (n, high)
    return replace(guess, objective=-float(weight @ (1 / root)) - p.offset_vx)


def test_linear_tangent_steering_is_proved() -> None:
    verification = verify(linear_tangent(), resolve=linear_tangent_again).verification
    assert verification.passed, str(verification)
    assert verification.level == 3


def test_steering_that_is_not_linear_in_its_tangent_is_feasible_but_no_extremal() -> None:
    verification = verify(linear_tangent(bend=1e-3), level=2).verification
    assert verification.level == 1
    assert failed(verification) >= {"minimum_of_hamiltonian", "stationary_direction_along_up"}


@pytest.mark.parametrize(("bend", "slips"), [(0.0, set()), (1e10, set()), (1e10, {"vy"})])
def test_a_cubic_bend_of_the_optimum_is_extrapolated_away(bend: float, slips: set[str]) -> None:
    """J = lam s + bend s^3: differences at steps s and 2 s, extrapolated, give lam exactly; another lam they do not."""
    solution = linear_tangent()
    costate = solution.trajectories[0].costate
    assert costate is not None
    slopes = dict(zip(("y", "vx", "vy"), costate.values[0], strict=True))

    def resolve(problem: Problem, guess: Solution) -> Solution:
        moved = {name: problem.given[f"offset_{name}"].value for name in slopes}
        lam = {name: value + 1e-4 * (name in slips) for name, value in slopes.items()}
        return replace(guess, objective=sum(lam[name] * s + bend * s**3 for name, s in moved.items()))

    checks = list(check_neighbours(solution, resolve))
    assert {c.name for c in checks if not c.passed} == {f"initial_costate_{name}" for name in slips}


# Absolute, in canonical units: a few times what an answer may leave, not in terms of the limits themselves.
@pytest.mark.parametrize(
    ("which", "column", "amount", "check"),
    [("state", 2, 1e-9, "state_vy"), ("costate", 2, 1e-8, "costate_vy"), ("costate", 0, 1e-8, "costate_y")],
)
def test_a_table_off_by_a_hundred_millionth_fails(which: str, column: int, amount: float, check: str) -> None:
    good = linear_tangent()
    T = good.trajectories[0].duration

    def bulged(curve: Curve) -> Curve:
        values, rates = curve.values.copy(), curve.rates.copy()
        values[:, column] += amount * np.sin(np.pi * curve.time / T) ** 2
        rates[:, column] += amount * np.pi / T * np.sin(2 * np.pi * curve.time / T)
        return replace(curve, values=values, rates=rates)

    assert check in failed(verify(with_curve(good, which, bulged), level=2).verification)


def test_an_end_that_is_missed_by_a_billionth_fails() -> None:
    good = linear_tangent()
    height = good.problem.given["height"].value
    assert failed(verify(good, level=1).verification) == set()
    missed = replace(good, problem=good.problem.with_given(height=height + 1e-9))
    assert failed(verify(missed, level=1).verification) == {"height"}
    assert failed(verify(replace(good, objective=good.objective + 1e-9), level=1).verification) == {"objective"}


def sailing(along: float, space: int) -> Solution:
    """Farthest in 1 s at the speed v (a^2 + 0.3 a), a the first component of a direction: best along 1, locally -1."""
    names, rest = ("a", "b", "c")[:space], [0.0] * (space - 1)
    phase = Phase(
        name="sail",
        states=(Variable(name="x", unit="m"),),
        controls=(UnitVectorControl(names=names),),
        dynamics=lambda x, u, p, xp: (p.v * (u.a * u.a + 0.3 * u.a),),
        duration="T",
    )
    problem = Problem(
        name="sailing",
        phases=(phase,),
        start=lambda p, xp: (0.0 * p.v * p.T,),
        given={"v": Parameter(value=1.0, unit="m/s"), "T": Parameter(value=1.0, unit="s")},
        objective=lambda x, p, xp: -x.x,
        objective_unit="m",
    )
    t, speed = np.linspace(0.0, 1.0, 5), 1.0 + 0.3 * along
    flown = curves(t, (speed * t,), (speed,), (-1.0,), (0.0,), (along, *rest), [0.0] * space)
    return Solution(
        problem=problem, method="closed form", outcome=Outcome.SOLVED, objective=-speed, free={}, trajectories=(flown,)
    )


@pytest.mark.parametrize("space", [2, 3])
def test_a_direction_that_is_best_among_its_neighbours_alone_fails(space: int) -> None:
    assert failed(verify(sailing(1.0, space), level=2).verification) == set()
    assert failed(verify(sailing(-1.0, space), level=2).verification) == {"minimum_of_hamiltonian"}


def test_what_is_no_flight_has_no_neighbours_solved() -> None:
    """Its costates promise nothing, and from a rough start each may take seconds."""
    rough = Pseudospectral(nodes=3, refine=0, polish=False).run(mars_glide_slope())

    def refused(problem: Problem, guess: Solution) -> Solution:
        raise AssertionError("solved again")

    found = verify(rough, resolve=refused).verification
    assert found.level == 0 and "conjugate_point" in {c.name for c in found.checks}
    assert any("neighbouring problems were not solved" in note for note in found.notes)
