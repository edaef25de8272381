"""Switches: closed forms in which each condition of bang-bang controls decides alone, and Meditch's lander."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from perilune import Pseudospectral
from perilune.core import Outcome
from perilune.models import Corridor
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
    Variable,
    Verification,
)
from perilune.solve import solve
from perilune.verify import verify
from problems.integrators import CEILING, least_energy, least_time
from problems.landings import meditch
from problems.staging import staged_burns
from test_descent import approach


def failed(verification: Verification, level: int = 4) -> set[str]:
    return {c.name for c in verification.failed if c.level <= level}


def check(verification: Verification, name: str) -> Check:
    return next(c for c in verification.checks if c.name == name)


# --- a switch whose every condition is known -------------------------------------------------------------------------

END, MIDDLE = 2.0, 1.0


def tug(pull: float, power: int = 1, switch: float = MIDDLE, swing: float = 1.0) -> Solution:
    """Least J = int (t - 1)^n u dt - pull/2 y(2)^2 with y' = u, |u| <= 1, beside an oscillator of its own.

    S = (t - 1)^n + lam_y with lam_y = -pull y(2). With u = 1 up to t = s and then -1, y(2) = 2 s - 2, and for n = 1
    d2J/ds2 = 2 - 4 pull where D = 2: kappa = 2 pull. The oscillator, least action of x'' = -x from `swing` over 2 s,
    has (2/pi)^2.
    """
    phase = Phase(
        name="arc",
        states=tuple(Variable(name=n) for n in ("clock", "y", "cost", "x")),
        controls=(ScalarControl(name="u", lower=-1.0, upper=1.0), ScalarControl(name="w")),
        dynamics=lambda x, u, p, xp: (
            1 / p.second,
            u.u / p.second,
            ((x.clock - MIDDLE) ** power * u.u + 0.5 * (u.w * u.w - x.x * x.x)) / p.second,
            u.w / p.second,
        ),
        duration="duration",
        end=Conditions(lambda x, p, xp: (x.x,), at_origin="1"),
    )
    problem = Problem(
        name="tug",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0, p.swing),
        given={
            "duration": Parameter(value=END, unit="s"),
            "second": Parameter(value=1.0, unit="s"),
            "pull": Parameter(value=pull),
            "swing": Parameter(value=swing),
        },
        objective=lambda x, p, xp: x.cost - 0.5 * p.pull * x.y * x.y,
    )
    pieces = [_tug_piece(np.linspace(a, b, 1201), u, pull, power, switch, swing) for a, b, u in
              ((0.0, switch, 1.0), (switch, END, -1.0)) if b > a]  # fmt: skip
    time = np.concatenate([piece[0] for piece in pieces])
    values, rates = (np.concatenate([piece[i] for piece in pieces], axis=1).T for i in (1, 2))
    state, costate, control = (
        Curve(time=time, values=values[:, at], rates=rates[:, at]) for at in (slice(4), slice(4, 8), slice(8, 10))
    )
    end = values[-1]
    return Solution(
        problem=problem, method="closed form", outcome=Outcome.SOLVED, free={},
        objective=float(end[2] - 0.5 * pull * end[1] ** 2),
        trajectories=(Trajectory(phase="arc", state=state, costate=costate, control=control),),
    )  # fmt: skip


def _tug_piece(
    t: np.ndarray, u: float, pull: float, power: int, s: float, swing: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, values and rates (10, N) of states, costates and controls on one side of the switch at s."""
    b = -math.cos(END) / math.sin(END)
    x, w = swing * (np.cos(t) + b * np.sin(t)), swing * (-np.sin(t) + b * np.cos(t))
    y, y_end = (t if u > 0 else 2 * s - t), 2 * s - END
    late = t - MIDDLE
    slope = power * late ** (power - 1)

    def work(t: Any) -> Any:
        return (t - MIDDLE) ** (power + 1) / (power + 1)

    cost = work(t) - work(0.0) if u > 0 else 2 * work(s) - work(0.0) - work(t)
    cost = cost + 0.5 * (x * w - swing * swing * b)
    # lam_clock' = -n (t - 1)^(n - 1) u, from 0 at the end
    lam_clock = late**power - (END - MIDDLE) ** power
    if u > 0:
        lam_clock = 2 * (s - MIDDLE) ** power - (END - MIDDLE) ** power - late**power
    rows = (
        (t, 1.0), (y, u), (cost, late**power * u + 0.5 * (w * w - x * x)), (x, w),
        (lam_clock, -slope * u), (-pull * y_end, 0.0), (1.0, 0.0), (-w, x),
        (u, 0.0), (w, -x),
    )  # fmt: skip
    values, rates = (np.array([np.full(t.shape, row[i]) for row in rows]) for i in (0, 1))
    return t, values, rates


def pulse(length: float) -> Solution:
    """Least J = int [(t - 1)^2 - (length/2)^2] u dt, |u| <= 1: u = 1 while S < 0, about t = 1, and -1 beside that."""
    phase = Phase(
        name="arc",
        states=(Variable(name="clock"), Variable(name="cost")),
        controls=(ScalarControl(name="u", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (1 / p.second, ((x.clock - MIDDLE) ** 2 - 0.25 * length**2) * u.u / p.second),
        duration="duration",
    )
    problem = Problem(
        name="pulse",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0),
        given={"duration": Parameter(value=END, unit="s"), "second": Parameter(value=1.0, unit="s")},
        objective=lambda x, p, xp: x.cost,
    )
    begin, until = MIDDLE - length / 2, MIDDLE + length / 2
    # Backwards from the end, where the costate of the clock is 0; it is even about the middle, the cost odd.
    rows = list[tuple[np.ndarray, ...]]()
    cost = 0.0
    for a, b, u in ((0.0, begin, -1.0), (begin, until, 1.0), (until, END, -1.0)):
        t = np.linspace(a, b, 801)
        late, S = t - MIDDLE, (t - MIDDLE) ** 2 - 0.25 * length**2
        work = late**3 / 3 - 0.25 * length**2 * late
        along = cost + u * (work - work[0])
        cost = along[-1]
        clock = (END - MIDDLE) ** 2 - late**2 if u < 0 else (END - MIDDLE) ** 2 + late**2 - 0.5 * length**2
        rows.append((t, t, along, -clock, 1 + 0 * t, u + 0 * t, 1 + 0 * t, u * S, -2 * u * late, 0 * t, 0 * t))
    table = np.concatenate([np.array(row) for row in rows], axis=1)
    state, costate, control = (
        Curve(time=table[0], values=table[1 + a : 1 + b].T, rates=table[6 + a : 6 + b].T)
        for a, b in ((0, 2), (2, 4), (4, 5))
    )
    return Solution(
        problem=problem, method="closed form", outcome=Outcome.SOLVED, free={}, objective=float(cost),
        trajectories=(Trajectory(phase="arc", state=state, costate=costate, control=control),),
    )  # fmt: skip


@pytest.mark.parametrize(("length", "unit"), [(0.1, 1.0), (2e-3, 0.1), (4e-5, 0.01), (1e-7, 0.01)])
def test_beside_an_arc_as_brief_as_an_impulse_the_slope_counts_over_its_length(length: float, unit: float) -> None:
    """|dS/dt| = length at both switches, half of that to the middle; what is almost no arc is none."""
    verification = verify(pulse(length), resolve=lambda problem, guess: guess, level=3).verification
    assert {c.name for c in verification.failed if c.level < 3} == set()
    strict = check(verification, "strict_u")
    assert END * length * 0.49 < -strict.value * unit * (1 - 0.25 * length**2) < END * length * 1.001
    assert strict.passed == (length > 1e-6)


def tug_again(problem: Problem, guess: Solution) -> Solution:
    """J of the tug in closed form (n = 1) for a shifted start."""
    p = problem.parameters({})
    late, y0, x0 = MIDDLE - p.offset_clock, p.offset_y, p.swing + p.offset_x
    s = (late + p.pull * (y0 - END)) / (1 - 2 * p.pull)
    y_end = y0 + 2 * s - END
    cost = (s - late) ** 2 - 0.5 * late**2 - 0.5 * (END - late) ** 2
    return replace(guess, objective=p.offset_cost + cost - 0.5 * p.pull * y_end**2 + 0.5 * x0**2 / math.tan(END))


@pytest.mark.parametrize("pull", [-0.4, 0.1, 0.4, 0.49, 0.51, 0.6])
def test_the_switching_time_has_the_curvature_of_the_closed_form(pull: float) -> None:
    """Beside a regular control: the larger kappa of the two counts, and beyond 1 only this check objects."""
    verification = verify(tug(pull, swing=0.0), resolve=tug_again).verification
    kappa = check(verification, "conjugate_point").value
    assert kappa == pytest.approx(max(2 * pull, (END / math.pi) ** 2), rel=3e-4)  # measured 1.7e-4
    assert failed(verification) == (set() if pull < 0.5 else {"conjugate_point"})
    assert verification.level == (3 if pull < 0.5 else 2)
    assert check(verification, "strict_u").value == pytest.approx(-END, rel=1e-9)  # S = t - 1, at most 1, over 2 s


@pytest.mark.parametrize("pull", [-0.4, 0.1, 0.49, 0.51])
def test_the_switching_time_beside_a_control_that_moves(pull: float) -> None:
    """The size of kappa depends on how time is normalised where w varies; on which side of 1 it lies does not."""
    verification = verify(tug(pull), resolve=tug_again).verification
    assert failed(verification) == (set() if pull < 0.5 else {"conjugate_point"})


@pytest.mark.parametrize("power", [2, 3])
def test_a_switching_function_that_only_touches_zero_is_not_strict(power: int) -> None:
    """(t - 1)^2 touches zero without a switch, (t - 1)^3 crosses it with slope zero: extremal, not shown optimal."""
    solution = tug(0.0, power=power, switch=0.0 if power == 2 else MIDDLE)
    verification = verify(solution, resolve=lambda problem, guess: guess).verification
    assert verification.level == 2, str(verification)
    assert "strict_u" in failed(verification)
    assert math.isnan(check(verification, "conjugate_point").value) == (power == 3)
    if power == 3:
        assert "switching function crosses zero" in check(verification, "conjugate_point").meaning


def test_a_condition_that_is_called_as_a_control_excuses_no_weak_switch_of_that() -> None:
    """Both checks are called strict_u, and only the multiplier of a condition need not be strict."""
    solution = tug(0.0, power=2, switch=0.0)
    (phase,) = solution.problem.phases
    far = replace(phase, path=Conditions(lambda x, u, p, xp: (2 - u.u,), u="1"))
    solution = replace(solution, problem=replace(solution.problem, phases=(far,)))
    assert "strict_u" in failed(verify(solution, resolve=lambda problem, guess: guess).verification)


@pytest.mark.parametrize("late", [1e-6, 1e-2, -1e-2])
def test_a_switch_away_from_the_zero_of_its_function_is_feasible_but_no_extremal(late: float) -> None:
    solution = tug(0.1, switch=MIDDLE + late)
    verification = verify(solution, level=2).verification
    assert verification.level == 1, str(verification)
    assert failed(verification) >= {"switch_u", "switching_u"}
    # S = t - 1 - pull y(2) at the switch, over the size of J in the 2 s of the flight
    size = max(1.0, abs(solution.objective)) / 2.0
    assert check(verification, "switch_u").value == pytest.approx(abs(late - 0.1 * 2 * late) / size, rel=1e-6)


def test_the_other_order_of_bounds_maximises() -> None:
    """Costates and control of -J: extremal with every sign reversed."""
    good = tug(0.1)
    flown = good.trajectories[0]
    values = flown.control.values * np.array([-1.0, 1.0])
    reverse = replace(good, trajectories=(replace(flown, control=replace(flown.control, values=values)),))
    assert {"switching_u", "minimum_of_hamiltonian", "state_y", "objective"} <= failed(
        verify(reverse, level=2).verification
    )


def test_a_switch_drawn_as_a_ramp_is_not_taken_for_one() -> None:
    """Without a repeated node there is no switching time: level 3 says that it cannot be shown."""
    solution = tug(0.1)

    def ramp(curve: Curve) -> Curve:
        time = curve.time.copy()
        time[1201] += 1e-6
        return replace(curve, time=time)

    flown = solution.trajectories[0]
    drawn = replace(flown, control=ramp(flown.control))
    verification = verify(replace(solution, trajectories=(drawn,)), resolve=tug_again).verification
    assert {"conjugate_point"} <= failed(verification, 3)
    assert math.isnan(check(verification, "conjugate_point").value)
    assert "without a switch in the table" in check(verification, "conjugate_point").meaning


@pytest.mark.parametrize("at", [0, 1200, 2401])
def test_a_time_stands_in_a_table_at_most_twice_and_not_at_its_ends(at: int) -> None:
    solution = tug(0.1)
    flown = solution.trajectories[0]
    curve = flown.control
    spoilt = Curve(*(), **{n: np.insert(getattr(curve, n), at, getattr(curve, n)[at], axis=0)
                           for n in ("time", "values", "rates")})  # fmt: skip
    assert failed(verify(replace(solution, trajectories=(replace(flown, control=spoilt),))).verification) == {"tables"}


def test_a_state_that_jumps_at_a_switch_was_not_flown() -> None:
    solution = tug(0.1)
    flown = solution.trajectories[0]
    values = flown.state.values.copy()
    values[1201:, 1] += 1e-6
    jumped = replace(flown, state=replace(flown.state, values=values))
    assert "state_y" in failed(verify(replace(solution, trajectories=(jumped,)), level=1).verification)


# --- the solver's own answers ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lander() -> Solution:
    return solve(meditch(), verify=0)


def test_meditchs_lander_is_proved_locally_optimal(lander: Solution) -> None:
    verification = verify(lander).verification
    assert verification.level == 3, str(verification)
    assert verification.passed
    assert lander.objective == pytest.approx(1.42031259905, abs=5e-12)
    assert check(verification, "switch_thrust").value < 1e-10
    # Two end conditions for the switch and the flight time: nothing is left to vary, and the slope of S decides.
    assert "leave no variation" in check(verification, "conjugate_point").meaning
    assert check(verification, "strict_thrust").value < -0.1


@pytest.mark.parametrize("late", [1e-7, -1e-7])
def test_meditchs_lander_switched_at_another_time_misses_the_ground(lander: Solution, late: float) -> None:
    flown = lander.trajectories[0]
    (switch,) = flown.control.time[1:][np.diff(flown.control.time) == 0]
    moved = flown.control.time.copy()
    moved[moved == switch] += late
    wrong = replace(flown, control=replace(flown.control, time=moved))
    verification = verify(replace(lander, trajectories=(wrong,)), level=2).verification
    assert {"touchdown_speed", "state_v", "objective", "switch_thrust"} <= failed(verification)


def test_a_throttle_beside_a_direction_is_proved() -> None:
    """Full, coast, full, in three dimensions: the direction varies where the engine burns and nowhere else."""
    problem = approach(Corridor(tilt=math.radians(80), slope=math.radians(5)), throttle=(0.0, 0.9))
    solution = solve(problem, verify=0)
    assert int((np.diff(solution.trajectories[0].time) == 0).sum()) == 2
    verification = verify(solution).verification
    assert verification.level == 3, str(verification)
    assert 0.1 < check(verification, "conjugate_point").value < 0.9


def test_least_time_between_rests_is_proved() -> None:
    verification = verify(solve(least_time(), verify=0)).verification
    assert verification.level == 3, str(verification)


@pytest.mark.parametrize("spare", [1e-3, 1e-9, 0.0, -1e-12])
def test_a_longest_time_that_is_the_least_time_is_proved(spare: float) -> None:
    """It holds nothing back, though a neighbour that takes longer may not be flown."""
    problem = least_time()
    best = solve(problem, verify=0).free["t_f"]
    free = tuple(replace(f, upper=best * (1 + spare)) for f in problem.free)
    solution = solve(replace(problem, free=free))
    assert solution.outcome is Outcome.PROVED, str(solution.verification)
    # The costate of another flight is none of this one, whatever the neighbours take.
    flown = solution.trajectories[0]
    assert flown.costate is not None
    wrong = replace(flown.costate, values=flown.costate.values * (1 + 1e-5), rates=flown.costate.rates * (1 + 1e-5))
    claim = replace(solution, trajectories=(replace(flown, costate=wrong),))
    assert {"initial_costate_x", "initial_costate_v"} <= {c.name for c in verify(claim).verification.failed}


# --- conditions that are active --------------------------------------------------------------------------------------


def test_an_arc_on_a_bound_of_a_state_is_not_taken_for_an_extremal() -> None:
    """Its multiplier shows in the costates, and the check says which condition it belongs to."""
    answer = Pseudospectral().run(least_energy(CEILING))
    verdict = check(verify(answer, level=2).verification, "costate_v")
    assert not verdict.passed
    assert f"x <= {CEILING:g} is active, but no table has its multiplier" in verdict.meaning


@pytest.mark.parametrize("ceiling", [0.3, 0.25 + 1e-9, 0.25 + 1e-14])
def test_a_ceiling_that_holds_nothing_back_changes_nothing(ceiling: float) -> None:
    """x rises to 1/4: not reached, or touched at one time with multiplier 0."""
    verification = verify(solve(least_energy(ceiling), verify=0)).verification
    assert verification.level == 3, str(verification)
    assert "active" not in str(verification)


def test_a_bound_that_is_reached_at_the_end_has_a_multiplier_with_a_sign() -> None:
    """Two burns, each until its tank is empty: the bound shows in the costates' end, and nowhere else."""
    solution = Pseudospectral(nlp_tolerance=1e-12).run(staged_burns())
    problem, ends = solution.problem, {"first_transversality", "second_transversality"}
    verification = verify(solution).verification
    assert verification.level == 3, str(verification)
    assert check(verification, "first_range_m_at_end").passed
    # The same flight is none where the tank may be emptied further, nor the slowest, which would rather not burn.
    deeper = replace(problem.phases[0], states=(problem.phases[0].states[0], Variable(name="m", unit="kg", lower=59.9)))
    further = replace(solution, problem=replace(problem, phases=(deeper, problem.phases[1])))
    assert failed(verify(further, level=2).verification) & ends == {"first_transversality"}
    flown = (replace(t, costate=opposite(t.costate)) for t in solution.trajectories)
    slowest = replace(
        solution, problem=replace(problem, objective=lambda x, p, xp: x.v), objective=-solution.objective,
        trajectories=tuple(flown),
    )  # fmt: skip
    assert failed(verify(slowest, level=2).verification) == ends


@pytest.mark.parametrize("ceiling", [0.5, 9.0])
def test_where_a_bound_holds_the_end_free_parameters_have_the_ranges_that_they_have(ceiling: float) -> None:
    """Least integral of u^2/2, less x(1), and (q - 2)^2 with q up to 1, which a hook says; in a wider range it is 2."""
    phase = Phase(
        name="go", states=(Variable(name="x", unit="m", upper=ceiling), Variable(name="c", unit="m^2/s")),
        controls=(ScalarControl(name="u", unit="m/s"),), duration="T",
        dynamics=lambda x, u, p, xp: (u.u, 0.5 * u.u * u.u),
    )  # fmt: skip
    problem = Problem(
        name="ranged",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0),
        objective_unit="m^2/s",
        objective=lambda x, p, xp: x.c - p.k * x.x + p.k * (p.q - 2 * p.l) ** 2 / p.l,
        given={
            "T": Parameter(value=1.0, unit="s"),
            "k": Parameter(value=1.0, unit="m/s"),
            "l": Parameter(value=1.0, unit="m"),
        },
        free=(FreeParameter(name="q", unit="m", lower=-1.0, upper=1.0, guess=0.5),),
        parameter_bounds=lambda p, xp: {"q": (-p.l, p.l, 0.5)},
    )
    solution = Pseudospectral(nlp_tolerance=1e-13).run(problem)
    assert verify(solution).verification.level == 3
    wide = problem.changed(free=(replace(problem.free[0], upper=5.0),))
    assert "stationary_q" in failed(verify(replace(solution, problem=wide), level=2).verification)


def opposite(curve: Curve | None) -> Curve:
    assert curve is not None
    return replace(curve, values=-curve.values, rates=-curve.rates)


# --- what is no number ------------------------------------------------------------------------------------------------


def test_no_control_is_compared_with_one_of_which_nothing_is_known(lander: Solution) -> None:
    """At thrusts about 0.5 N, which are admissible, the rate is not a number: where H is least nobody can say."""
    problem, phase = lander.problem, lander.problem.phases[0]

    def blind(x, u, p, xp):
        nothing = xp.sqrt((u.thrust - p.gap) ** 2 - (0.1 * p.gap) ** 2)
        return (*phase.dynamics(x, u, p, xp)[:3], u.thrust + 0.0 * nothing)

    given = {**problem.given, "gap": Parameter(value=0.5, unit="N")}
    stated = replace(problem, phases=(replace(phase, dynamics=blind),), given=given)
    proof = verify(replace(lander, problem=stated), level=2).verification
    assert math.isnan(check(proof, "minimum_of_hamiltonian").value)
    assert "minimum_of_hamiltonian" in failed(proof)
