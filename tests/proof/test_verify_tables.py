"""Falsified tables: whatever a file says between its nodes, the proof looks there."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from scipy.interpolate import CubicHermiteSpline

from perilune.core import Outcome
from perilune.models import Corridor
from perilune.problem import Conditions, Curve, Parameter, Phase, Problem, ScalarControl, Solution, Trajectory, Variable
from perilune.proof.feasible.deviations import state_deviation
from perilune.proof.feasible.feasibility import STATE_LIMIT
from perilune.proof.feasible.phase_data import PhaseData
from perilune.proof.feasible.reintegration import reintegrate
from perilune.proof.feasible.sample_points import (
    POINTS,
    UP_TO,
    WEIGHTS,
    Pieces,
    cubic_turning_points,
    extreme_values,
    interpolating_cubics,
    polynomial,
)
from perilune.proof.necessary.first_order import COSTATE_LIMIT
from perilune.solve import solve
from perilune.verify import verify
from problems.landings import meditch
from test_descent import approach

Change = Callable[[Curve], Curve]


def with_table(solution: Solution, which: str, change: Change) -> Solution:
    flown = solution.trajectories[0]
    return replace(solution, trajectories=(replace(flown, **{which: change(getattr(flown, which))}),))


def failed(solution: Solution, level: int = 2) -> set[str]:
    return {c.name for c in verify(solution, level=level).verification.failed}


def with_nodes(curve: Curve, times: Any) -> Curve:
    """The same function with more nodes."""
    new = np.setdiff1d(times, curve.time)
    i = np.searchsorted(curve.time, new, side="right") - 1
    pieces = Pieces(curve.time[i], np.diff(curve.time)[i])
    h = pieces.width[:, None]
    s = (new[:, None] - curve.time[i, None]) / h
    values = pieces.read(curve, s)[:, :, 0].T
    c = interpolating_cubics(pieces.read(curve))
    rates = ((c[..., 1] + s.T * (2 * c[..., 2] + 3 * s.T * c[..., 3])) / h.T).T
    at = np.searchsorted(curve.time, new, side="right")
    return Curve(
        time=np.insert(curve.time, at, new),
        values=np.insert(curve.values, at, values, axis=0),
        rates=np.insert(curve.rates, at, rates, axis=0),
    )


def between(first: float, last: float, change: Callable[[np.ndarray], np.ndarray], ramp: float = 1e-3) -> Change:
    """The table changed from `first` to `last`, true at both of them, `ramp` of the way between old and new."""

    def apply(curve: Curve) -> Curve:
        edge = ramp * (last - first)
        dense = with_nodes(curve, [first, first + edge, last - edge, last])
        inside = (dense.time >= first + edge) & (dense.time <= last - edge)
        values, rates = dense.values.copy(), dense.rates.copy()
        values[inside], rates[inside] = change(values[inside]), change(rates[inside])
        return replace(dense, values=values, rates=rates)

    return apply


def reversed_values(values: np.ndarray) -> np.ndarray:
    return -values


def gap(curve: Curve, k: int) -> tuple[float, float]:
    """A stretch between two neighbouring nodes."""
    a, b = curve.time[k : k + 2]
    return a + 0.02 * (b - a), b - 0.02 * (b - a)


# --- the rule


def test_four_points_integrate_and_bound_a_cubic() -> None:
    rng = np.random.default_rng(0)
    c = rng.normal(size=(50, 4))
    s = np.linspace(0.0, 1.0, 20001)
    values = polynomial(c[:, None], POINTS[None, :])
    assert interpolating_cubics(values) == pytest.approx(c, abs=1e-12)
    assert values @ WEIGHTS == pytest.approx(c @ (1 / np.arange(1, 5)), abs=1e-13)
    up_to = polynomial(np.column_stack([np.zeros(50), c[:, 0], c[:, 1] / 2, c[:, 2] / 3])[:, None], POINTS[None])
    assert values @ UP_TO.T == pytest.approx(up_to + c[:, 3:] / 4 * POINTS**4, abs=1e-13)
    dense = polynomial(c[:, None], s[None, :])
    shares = np.column_stack([np.zeros(50), np.ones(50), cubic_turning_points(c)])
    found = polynomial(c[:, None], shares)
    assert found.min(axis=1) == pytest.approx(dense.min(axis=1), abs=1e-8)
    assert found.max(axis=1) == pytest.approx(dense.max(axis=1), abs=1e-8)


def test_the_extremes_of_a_table_are_those_of_its_cubics() -> None:
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.1, 2.0, 30))
    curve = Curve(time=t - t[0], values=rng.normal(size=(30, 2)), rates=rng.normal(size=(30, 2)) * 3)
    spline = CubicHermiteSpline(curve.time, curve.values, curve.rates)
    dense = spline(np.linspace(0, curve.time[-1], 300_001))
    assert extreme_values(curve).min(axis=(1, 2)) == pytest.approx(dense.min(axis=0), abs=1e-6)
    assert extreme_values(curve).max(axis=(1, 2)) == pytest.approx(dense.max(axis=0), abs=1e-6)


def test_more_nodes_on_the_same_curves_change_nothing(hybrid: Solution) -> None:
    """Five times as many, at times of their own in each table."""
    denser = hybrid
    for k, which in enumerate(("state", "control", "costate")):
        at = np.random.default_rng(k).uniform(0, hybrid.trajectories[0].duration, 1500)
        denser = with_table(denser, which, lambda c, at=at: with_nodes(c, at))
    before, after = verify(hybrid, level=3).verification, verify(denser, level=3).verification
    assert after.level == 3, str(after)
    assert [c.name for c in before.checks] == [c.name for c in after.checks]


# --- control


@pytest.mark.parametrize("k", [0, 17, 150, 309])
def test_a_reversal_of_the_thrust_between_two_nodes_fails(hybrid: Solution, k: int) -> None:
    wrong = with_table(hybrid, "control", lambda c: between(*gap(c, k), reversed_values)(c))
    names = failed(wrong)
    assert {"state_v", "state_u", "minimum_of_hamiltonian"} <= names
    assert verify(wrong, level=2).verification.level == 0


def test_a_thrust_reversed_nearly_all_the_time_fails_and_takes_no_minutes(hybrid: Solution) -> None:
    """In 97 % of the flight; what stays right are thousands of instants."""

    def reverse(curve: Curve) -> Curve:
        grid = np.linspace(0.0, curve.time[-1], 2876)
        step = grid[1]
        marks = np.concatenate([grid[:-1] + share * step for share in (0.01, 0.012, 0.988, 0.99)])
        dense = with_nodes(curve, marks)
        phase = dense.time / step % 1.0
        inside = (phase > 0.011) & (phase < 0.989)
        sign = np.where(inside, -1.0, 1.0)[:, None]
        return replace(dense, values=sign * dense.values, rates=sign * dense.rates)

    wrong = with_table(hybrid, "control", reverse)
    assert len(wrong.trajectories[0].control.time) > 11_500
    began = time.process_time()
    names = failed(wrong, level=3)
    assert time.process_time() - began < 20
    assert {"state_v", "state_r", "minimum_of_hamiltonian"} <= names


def test_a_throttle_of_twenty_between_two_nodes_fails() -> None:
    problem = approach(Corridor(tilt=np.radians(80), slope=np.radians(5)), throttle=(0.0, 0.9))
    solution = solve(problem, verify=0)
    column = problem.phases[0].control_names.index("throttle")

    def twenty(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[:, column] = 20.0
        return values

    change = lambda c: between(*gap(c, 20), twenty)(c)  # noqa: E731
    assert {"bounds_throttle", "state_m"} <= failed(with_table(solution, "control", change))


def test_a_bulge_of_the_throttle_that_only_its_rates_make_fails() -> None:
    """Between two nodes at the bound; the exact extreme of the cubic, h/4 times the rate, is what is reported."""
    solution = solve(meditch(), verify=0)

    control = solution.trajectories[0].control
    way = 1.0 if control.values[5, 0] == control.values.max() else -1.0
    assert control.values[5, 0] in (control.values.min(), control.values.max())

    def bulge(curve: Curve) -> Curve:
        rates = curve.rates.copy()
        rates[5], rates[6] = way * 1e-3, -way * 1e-3
        return replace(curve, rates=rates)

    check = next(
        c
        for c in verify(with_table(solution, "control", bulge), level=1).verification.checks
        if c.name == "bounds_thrust"
    )
    assert check.value == pytest.approx(1e-3 * (control.time[6] - control.time[5]) / 4, rel=1e-9)
    assert not check.passed


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_impulse_in_a_piece_of_a_picosecond_fails(way: float) -> None:
    """A control without bounds: 1e9 for 1e-12 s is a millimetre per second."""
    phase = Phase(
        name="push", states=(Variable(name="x", unit="m"), Variable(name="v", unit="m/s"),
                             Variable(name="e", unit="m^2/s^3")),
        controls=(ScalarControl(name="a", unit="m/s^2"),), dynamics=lambda x, u, p, xp: (x.v, u.a, 0.5 * u.a * u.a),
        duration="T", end=Conditions(lambda x, p, xp: (x.x - p.far, x.v), place="m", rest="m/s"),
    )  # fmt: skip
    problem = Problem(
        name="push", phases=(phase,), start=lambda p, xp: (0.0, 0.0, 0.0), objective=lambda x, p, xp: x.e,
        objective_unit="m^2/s^3",
        given={"T": Parameter(value=1.0, unit="s"), "far": Parameter(value=1.0, unit="m")},
    )  # fmt: skip
    solution = solve(problem, verify=3)
    assert solution.outcome is Outcome.PROVED

    def impulse(curve: Curve) -> Curve:
        at = 0.37
        dense = with_nodes(curve, [at, at + 1e-12])
        (k,) = np.nonzero(dense.time == at)
        rates = dense.rates.copy()
        rates[k], rates[k + 1] = way * 1e22, -way * 1e22
        return replace(dense, rates=rates)

    names = failed(with_table(solution, "control", impulse))
    # By rounding of the table the flight either steps over the impulse, is no number there, or creeps through it until
    # it is given up: all three fail.
    assert {"state_v", "computable"} & names


def test_the_two_sides_of_a_switch_exchanged_fail() -> None:
    solution = solve(meditch(), verify=0)

    def exchange(curve: Curve) -> Curve:
        (k,) = np.nonzero(np.diff(curve.time) == 0)[0]
        values = curve.values.copy()
        values[[k, k + 1]] = values[[k + 1, k]]
        return replace(curve, values=values)

    assert {"state_v", "switching_thrust"} <= failed(with_table(solution, "control", exchange))


@pytest.mark.parametrize("which", ["state", "control", "costate"])
def test_an_absurd_value_in_a_piece_of_no_length_fails(hybrid: Solution, which: str) -> None:
    """Three times one time is no table; twice it are the sides of a break, and both are looked at."""

    def absurd(curve: Curve, count: int) -> Curve:
        k = 100
        time, values, rates = (np.insert(a, [k] * count, a[k], axis=0) for a in (curve.time, curve.values, curve.rates))
        values[k + count - 1] += 1e-3 * np.abs(curve.values).max(axis=0)
        return Curve(time=time, values=values, rates=rates)

    assert failed(with_table(hybrid, which, lambda c: absurd(c, 2))) == {"tables"}
    assert any(which in name or "minimum" in name for name in failed(with_table(hybrid, which, lambda c: absurd(c, 1))))


def test_a_control_that_wavers_from_node_to_node_is_no_minimum(hybrid: Solution) -> None:
    """Right at every node, its rates alternately a little wrong: the flight hardly notices, H does."""

    def waver(curve: Curve) -> Curve:
        rates = curve.rates.copy()
        rates[1:-1] += (1e-5 * (-1.0) ** np.arange(len(rates) - 2))[:, None] * curve.values[1:-1, ::-1] * [1, -1]
        return replace(curve, rates=rates)

    assert "stationary_direction_transverse_radial" in failed(with_table(hybrid, "control", waver))


def test_a_direction_that_rounding_decides_ends_the_flight(hybrid: Solution) -> None:
    """Shrunk to its last digits from a break on: steps would take for ever, and give up."""

    def shrunk(curve: Curve) -> Curve:
        k = 1 + int(0.08598287219209247 * (len(curve.time) - 3))
        nodes, values, rates = (np.insert(a, k, a[k], axis=0) for a in (curve.time, curve.values, curve.rates))
        values[k + 1 :] *= 1 - 1.0000000000002303
        return Curve(time=nodes, values=values, rates=rates)

    began = time.process_time()
    assert {"state_r", "state_v", "touchdown_altitude", "objective"} <= failed(with_table(hybrid, "control", shrunk))
    assert time.process_time() - began < 30


# --- states and costates


def test_states_halved_between_two_nodes_fail(hybrid: Solution) -> None:
    wrong = with_table(hybrid, "state", lambda c: between(*gap(c, 33), lambda v: 0.5 * v)(c))
    assert {"state_r", "state_v", "state_m"} <= failed(wrong, level=1)


@pytest.mark.parametrize("amount", [1e-9, 1e-6])
def test_a_state_that_is_off_by_little_between_two_nodes_fails(hybrid: Solution, amount: float) -> None:
    change = between(*gap(hybrid.trajectories[0].state, 200), lambda v: v * (1 + amount), ramp=0.1)
    assert "state_r" in failed(with_table(hybrid, "state", change), level=1)


@pytest.mark.parametrize("which", ["state", "costate"])
def test_rates_that_are_wrong_fail(hybrid: Solution, which: str) -> None:
    def rates(curve: Curve) -> Curve:
        wrong = curve.rates.copy()
        wrong[50] *= 1.01
        return replace(curve, rates=wrong)

    names = failed(with_table(hybrid, which, rates))
    assert f"{which}_v" in names, names


@pytest.mark.parametrize("k", [3, 160, 308])
def test_a_node_half_a_millisecond_late_fails(hybrid: Solution, k: int) -> None:
    def late(curve: Curve) -> Curve:
        time = curve.time.copy()
        time[k] += 5e-4
        return replace(curve, time=time)

    assert "state_phi" in failed(with_table(hybrid, "state", late), level=1)


def test_costates_reversed_in_five_hundred_gaps_fail(hybrid: Solution) -> None:
    def reverse(curve: Curve) -> Curve:
        for a in np.linspace(0.001, 0.998, 500) * curve.time[-1]:
            curve = between(a, a + 0.0018 * curve.time[-1], reversed_values)(curve)
        return curve

    names = failed(with_table(hybrid, "costate", reverse))
    assert {"costate_v", "costate_m", "minimum_of_hamiltonian", "hamiltonian_constant"} <= names


def test_many_gaps_each_too_small_to_see_add_up(hybrid: Solution) -> None:
    """Thrust turned by 1e-9 rad at all times but at the nodes: each gap is 1e-12, their sum is beyond the limit."""
    turn = 3e-8 * np.array([[0.0, -1.0], [1.0, 0.0]])

    def off(curve: Curve) -> Curve:
        widths = np.diff(curve.time)
        for a, h in zip(curve.time[:-1:2], widths[::2], strict=True):
            curve = between(a + 0.01 * h, a + 0.99 * h, lambda v: v + v @ turn)(curve)
        return curve

    wrong = with_table(hybrid, "control", off)
    (_, flight), (_, sound) = *reintegrate(wrong), *reintegrate(hybrid)
    assert flight.difference.max() > 20 * sound.difference.max()
    assert {"touchdown_altitude"} & failed(wrong, level=1)


def test_a_dip_below_the_ground_between_the_points_is_found() -> None:
    """y = (t - c)^2 - d with c anywhere: the least value, -d, is found to first order wherever it lies."""
    phase = Phase(
        name="dive", states=(Variable(name="y", unit="m"), Variable(name="w", unit="m/s")),
        dynamics=lambda x, u, p, xp: (x.w, p.g), duration="T",
        path=Conditions(lambda x, u, p, xp: (x.y,), height="m"), 
    )  # fmt: skip
    for c in np.linspace(0.11, 0.87, 14):
        depth = 1e-7
        given = {"g": Parameter(value=2.0, unit="m/s^2"), "T": Parameter(value=1.0, unit="s"),
                 "y0": Parameter(value=c * c - depth, unit="m"), "w0": Parameter(value=-2 * c, unit="m/s")}  # fmt: skip
        problem = Problem(
            name="dive", phases=(phase,), start=lambda p, xp: (p.y0, p.w0), objective=lambda x, p, xp: x.y,
            objective_unit="m", given=given,
        )  # fmt: skip
        t = np.linspace(0.0, 1.0, 4)
        state = Curve(
            time=t, values=np.column_stack([(t - c) ** 2 - depth, 2 * (t - c)]),
            rates=np.column_stack([2 * (t - c), np.full(4, 2.0)]),
        )  # fmt: skip
        empty = Curve(time=t, values=np.zeros((4, 0)), rates=np.zeros((4, 0)))
        solution = Solution(
            problem=problem, method="closed form", outcome=Outcome.SOLVED, free={},
            objective=float(state.values[-1, 0]),
            trajectories=(Trajectory(phase="dive", state=state, control=empty),),
        )  # fmt: skip
        check = next(c for c in verify(solution, level=1).verification.checks if c.name == "path_height")
        assert check.value == pytest.approx(depth, rel=1e-6)


def drift(rate: Any, cost: float) -> Solution:
    """y' = rate(t) of which a table of one cubic says that y = 0; a clock is the other state."""
    phase = Phase(
        name="drift", states=(Variable(name="clock"), Variable(name="y")), duration="T",
        dynamics=lambda x, u, p, xp: (1 / p.second, rate(x.clock, xp) / p.second),
    )  # fmt: skip
    problem = Problem(
        name="drift", phases=(phase,), start=lambda p, xp: (0.0, 0.0), objective=lambda x, p, xp: x.y,
        given={"T": Parameter(value=1.0, unit="s"), "second": Parameter(value=1.0, unit="s")},
    )  # fmt: skip
    t = np.array([0.0, 1.0])
    state = Curve(time=t, values=np.column_stack([t, 0 * t]), rates=np.array([[1.0, 0.0], [1.0, 0.0]]))
    empty = Curve(time=t, values=np.zeros((2, 0)), rates=np.zeros((2, 0)))
    return Solution(
        problem=problem, method="by hand", outcome=Outcome.SOLVED, free={}, objective=cost,
        trajectories=(Trajectory(phase="drift", state=state, control=empty),),
    )  # fmt: skip


def test_a_rate_that_vanishes_at_the_points_of_a_piece_is_found_by_its_halves() -> None:
    """Legendre's P4, whose zeros are Gauss's points: y rises to its integral, -s (1 - s)(1 - 2 s)(1 - 7 s (1 - s))."""
    solution = drift(lambda c, m: 1e-6 * (1 - 20 * c + 90 * c**2 - 140 * c**3 + 70 * c**4), 0.0)
    arc = PhaseData(solution=solution, index=0)
    assert len(arc.looked_at[0]) > 1
    s = np.linspace(0.0, 1.0, 10_001)
    largest = 1e-6 * np.abs(s * (1 - s) * (1 - 2 * s) * (1 - 7 * s * (1 - s))).max()
    assert state_deviation(arc, np.zeros(2)).largest[1] == pytest.approx(largest, rel=0.05)


def test_what_quadrature_leaves_open_counts() -> None:
    arc = PhaseData(solution=drift(lambda c, xp: 1e-3 * xp.sin(1e9 * c), 0.0), index=0)
    still = arc.looked_at[2][1]
    found = state_deviation(arc, np.zeros(2))
    assert still > STATE_LIMIT
    assert found.largest[1] == pytest.approx(max(np.abs(found.inside[1]).max(), np.abs(found.ends[1]).max()) + still)


def test_ripples_between_the_nodes_of_a_right_table_are_looked_at_until_nothing_is_open() -> None:
    """Two ripples in each of 1000 pieces, 5e-8 high: they move y by no more than 4e-12, as their integral says.

    Left as they are, the pieces would leave 1e-11 open each, and all of them more than the limit.
    """
    solution = drift(lambda c, xp: 5e-8 * xp.cos(4 * np.pi * 1000 * c), 0.0)
    t = np.linspace(0.0, 1.0, 1001)
    ripple = 5e-8 * np.cos(4 * np.pi * 1000 * t)
    flown = solution.trajectories[0]
    table = Curve(time=t, values=np.column_stack([t, 0 * t]), rates=np.column_stack([1 + 0 * t, ripple]))
    assert verify(replace(solution, trajectories=(replace(flown, state=table),)), level=1).verification.passed


# --- anything at all


COLUMNS = {"state": 5, "control": 2, "costate": 5}


@st.composite
def falsifications(draw: st.DrawFn) -> tuple[str, Change]:
    which = draw(st.sampled_from(sorted(COLUMNS)))
    columns = draw(st.sets(st.integers(0, COLUMNS[which] - 1), min_size=1))
    size = draw(st.sampled_from([-1.0, 1.0])) * 10.0 ** draw(st.floats(-13, 1))
    kind = draw(st.sampled_from(["stretch", "stretches", "rates", "node", "time", "jump"]))
    share, width = draw(st.floats(0.001, 0.98)), 10.0 ** draw(st.floats(-9, -2))
    count = draw(st.integers(2, 40))
    mask = np.array([k in columns for k in range(COLUMNS[which])])

    def grown(values: np.ndarray) -> np.ndarray:
        return values * (1 + size * mask)

    def change(curve: Curve) -> Curve:
        k = 1 + int(share * (len(curve.time) - 3))
        if kind == "stretch":
            a = share * curve.time[-1]
            return between(a, a + width * curve.time[-1], grown, ramp=0.2)(curve)
        if kind == "stretches":
            for a in np.linspace(share, 0.99, count, endpoint=False) * curve.time[-1]:
                curve = between(a, a + min(width, 2e-4) * curve.time[-1], grown, ramp=0.2)(curve)
            return curve
        time, values, rates = (a.copy() for a in (curve.time, curve.values, curve.rates))
        if kind == "rates":
            rates[k] = grown(rates[k])
        elif kind == "node":
            values[k] = grown(values[k])
        elif kind == "time":
            time[k] += np.clip(size, -0.9, 0.9) * (time[k + 1] - time[k] if size > 0 else time[k] - time[k - 1])
        else:
            time, values, rates = (np.insert(a, k, a[k], axis=0) for a in (time, values, rates))
            values[k + 1 :] = grown(values[k + 1 :])
        return Curve(time=time, values=values, rates=rates)

    return which, change


def deviation(arc: PhaseData, which: str, wrong: Curve) -> float:
    """Largest difference of two tables inside the pieces of both, canonical."""
    right = getattr(arc.trajectory, which)
    pieces = Pieces.between([right.time, wrong.time], arc.duration)
    shares = np.linspace(0.01, 0.99, 15)
    of, old = pieces.read(wrong, shares), pieces.read(right, shares)
    if which == "control":
        with np.errstate(all="ignore"):  # no direction at all is NaN, which no limit allows
            of, old = (v / np.sqrt((v * v).sum(axis=0)) for v in (of, old))
        return float(np.abs(of - old).max())
    scale = arc.state_scale if which == "state" else arc.costate_scale
    return float((np.abs(of - old) / scale[:, None, None]).max())


# What may pass: less than a limit, for a cubic may be 3 times larger between the points than at them; of a control the
# slope of H, 1e-9, at a second derivative of 0.3.
BELOW = {"state": 10 * STATE_LIMIT, "costate": 10 * COSTATE_LIMIT, "control": 1e-7}


@settings(
    max_examples=80, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
@given(falsification=falsifications())
def test_no_falsified_table_passes(hybrid: Solution, falsification: tuple[str, Change]) -> None:
    which, change = falsification
    wrong = with_table(hybrid, which, change)
    small = deviation(PhaseData(solution=hybrid, index=0), which, getattr(wrong.trajectories[0], which)) <= BELOW[which]
    assert small or not verify(wrong, level=1 if which == "state" else 2).verification.passed
