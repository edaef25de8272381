"""Events: location, direction, ends, switches with their saltation, jumps, layers of an atmosphere."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from meditch import COST, EXHAUST, FINAL_TIME, PARAMETERS, START, SWITCH, modes_and_switch

from perilune.core import PeriluneError
from perilune.kernels import ArcStatus, Event, compile_arcs
from perilune.kernels.code import native


def fall() -> tuple[ca.Function, ca.Function]:
    """A stone under gravity p, and its height."""
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    return ca.Function("fall", [z, p], [ca.vertcat(z[1], -p)]), ca.Function("height", [z, p], [z[0]])


def oscillator() -> ca.Function:
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    return ca.Function("oscillator", [z, p], [ca.vertcat(z[1], -(p**2) * z[0])])


def test_impact_ends_the_arc_where_it_should(backend: str) -> None:
    rhs, height = fall()
    e = compile_arcs(rhs, columns=2, events=[Event(function=height, direction=-1, terminal=True)], backend=backend)
    starts = np.array([[h, 1.0] for h in (0.5, 1.0, 2.0, 30.0, 7.0)])
    arcs = e.propagate(starts, [2.0], 5.0, np.eye(2))
    exact = (1 + np.sqrt(1 + 4 * starts[:, 0])) / 2
    hit = exact < 5.0
    np.testing.assert_array_equal(arcs.status, np.where(hit, ArcStatus.EVENT, ArcStatus.REACHED))
    np.testing.assert_allclose(arcs.time[hit], exact[hit], rtol=0, atol=5e-12)  # 1e-12 of the arc
    np.testing.assert_allclose(arcs.event_time[hit, 0], exact[hit], rtol=0, atol=5e-12)
    np.testing.assert_array_equal(arcs.event_index[:, 0], np.where(hit, 0, -1))


@pytest.mark.parametrize(("direction", "turns"), [(1, [1.5]), (-1, [0.5, 2.5]), (0, [0.5, 1.5, 2.5])])
def test_direction(backend: str, direction: int, turns: list[float]) -> None:
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    event = Event(function=ca.Function("g", [z, p], [z[0]]), direction=direction)
    arcs = compile_arcs(oscillator(), events=[event], backend=backend).propagate([1.0, 0.0], [np.pi], 3.2)
    assert arcs.status[0] == ArcStatus.REACHED
    np.testing.assert_allclose(arcs.event_time[0, : len(turns)], turns, atol=3e-12)
    assert np.all(np.isnan(arcs.event_time[0, len(turns) :]))


def test_two_crossings_inside_one_step_are_found(backend: str) -> None:
    """A parabola is flown in few steps; it dips below the level for a hundredth of its time."""
    rhs, _ = fall()
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    level = Event(function=ca.Function("level", [z, p], [0.999 - z[0]]))
    arcs = compile_arcs(rhs, events=[level], backend=backend).propagate([0.0, 2.0], [2.0], 2.0)
    half = np.sqrt(1e-3)  # z = 2t - t^2 passes 0.999 at 1 -+ sqrt(0.001)
    np.testing.assert_allclose(arcs.event_time[0, :2], [1 - half, 1 + half], atol=1e-11)


@pytest.mark.parametrize(("tolerance", "depth"), [(1e-6, 1e-5), (1e-9, 1e-7), (1e-12, 1e-7), (1e-12, 1e-9)])
def test_two_crossings_of_what_is_no_cubic_are_found(backend: str, tolerance: float, depth: float) -> None:
    """cos x + 1 dips below a depth at pi for sqrt(8 depth); by the cubic of a long step it stays above.

    Of the steps to it most did, for dips of up to a fiftieth of the arc; beside a double zero g is rounding before it
    is near, and steps towards it had no end.
    """
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    level = Event(function=ca.Function("level", [z, p], [z[0] + (1 - depth)]))
    x = np.linspace(0.0, 2.7, 40)
    arcs = compile_arcs(oscillator(), events=[level], backend=backend).propagate(
        np.column_stack([np.cos(x), -np.sin(x)]), [1.0], 6.0 - x, rtol=tolerance, atol=tolerance
    )
    half = math.acos(1 - depth)
    np.testing.assert_array_equal(arcs.status, ArcStatus.REACHED)
    error = 30 * tolerance / math.sqrt(depth) + 1e-16 / half
    np.testing.assert_allclose(
        arcs.event_time[:, :2] + x[:, None], np.tile([np.pi - half, np.pi + half], (40, 1)), atol=error
    )
    assert np.isnan(arcs.event_time[:, 2:]).all()


@pytest.mark.skipif(not native.is_available(), reason="llvmlite is not installed")
@pytest.mark.parametrize("depth", [1e-14, 1e-15, 0.0, -1e-15])
@pytest.mark.parametrize("tolerance", [1e-9, 1e-13])
def test_beside_a_double_zero_an_event_fires_twice_or_not_at_all(tolerance: float, depth: float) -> None:
    """g = cos x + 1 - depth is rounding where it vanishes twice: up to 3 of 5000 lanes fired there until none was left.

    Machine code alone is asked, which flies as many in a second: a lane in a thousand did so.
    """
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    level = Event(function=ca.Function("level", [z, p], [z[0] + (1 - depth)]))
    rng = np.random.default_rng(5)
    x = rng.uniform(0.0, 2.9, 5000)
    arcs = compile_arcs(oscillator(), events=[level]).propagate(
        np.column_stack([np.cos(x), -np.sin(x)]), [1.0], rng.uniform(3.3, 6.2, 5000) - x, rtol=tolerance, atol=tolerance
    )
    np.testing.assert_array_equal(arcs.status, ArcStatus.REACHED)
    met = np.isfinite(arcs.event_time).sum(axis=1)
    assert np.isin(met, (0, 2)).all(), np.unique(met)


def test_backwards_over_an_event(backend: str) -> None:
    rhs, height = fall()
    e = compile_arcs(rhs, events=[Event(function=height, direction=-1, terminal=True)], backend=backend)
    arcs = e.propagate([1.0, 0.0], [2.0], -3.0)  # z = 1 - t^2 falls through zero at t = -1, flown backwards
    np.testing.assert_allclose(arcs.time, [-1.0], atol=1e-12)


def test_a_ball_bounces_with_its_columns(backend: str) -> None:
    rhs, height = fall()
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    bounce = ca.Function("bounce", [z, p], [ca.vertcat(z[0], -0.5 * z[1])])
    e = compile_arcs(rhs, columns=2, events=[Event(function=height, direction=-1, jump=bounce)], backend=backend)
    arcs = e.propagate([1.0, 0.0], [2.0], 1.7, np.eye(2))  # impact at t = 1 with v = -2, leaves with +1
    np.testing.assert_allclose(arcs.z[0], [0.7 - 0.49, 1.0 - 1.4], atol=1e-11)
    # z(t) = c (t - T) - (t - T)^2, c = 0.5 sqrt(v0^2 + 4 h0), T = (v0 + sqrt(v0^2 + 4 h0))/2
    dT_dh, dT_dv, dc_dh, dc_dv = 0.5, 0.5, 0.5, 0.0
    tau, c = 0.7, 1.0
    exact = [
        [dc_dh * tau + (2 * tau - c) * dT_dh, dc_dv * tau + (2 * tau - c) * dT_dv],
        [dc_dh + 2 * dT_dh, dc_dv + 2 * dT_dv],
    ]
    np.testing.assert_allclose(arcs.columns[0], exact, atol=1e-10)


def test_two_events_at_one_time_both_happen(backend: str) -> None:
    """Where a stone falls below 0 its weight doubles by one event and trebles by another, in either order.

    Neither is lost, however rounding places the two zeros. From h it meets them at sqrt(h), with -2 sqrt(h).
    """
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    modes = [ca.Function("fall", [z, p], [ca.vertcat(z[1], -times * p)]) for times in (1, 2, 3, 6)]
    double = Event(function=ca.Function("double", [z, p], [z[0]]), direction=-1, switches={0: 1, 2: 3})
    starts = np.linspace(0.5, 1.5, 12)
    met, left = np.sqrt(starts), 0.2 * np.sqrt(starts)
    for share, apart in ((1 / 3, 0.0), (0.7, 0.0), (1.0, 1e-14), (1.0, -1e-14)):
        met_too = ca.Function("treble", [z, p], [share * z[0] + apart])
        treble = Event(function=met_too, direction=-1, switches={0: 2, 1: 3})
        arcs = compile_arcs(modes, events=[double, treble], backend=backend).propagate(
            np.column_stack([starts, 0 * starts]), [2.0], met + left
        )
        np.testing.assert_array_equal(np.sort(arcs.event_index[:, :3]), np.tile([-1, 0, 1], (12, 1)))
        np.testing.assert_allclose(arcs.event_time[:, :2], np.stack([met, met], 1), atol=2e-12)
        np.testing.assert_allclose(arcs.z[:, 0], -2 * met * left - 6 * left**2, atol=2e-11)
        np.testing.assert_allclose(arcs.z[:, 1], -2 * met - 12 * left, atol=2e-11)
        np.testing.assert_array_equal(arcs.mode, 3)


def test_a_ball_that_bounces_for_ever_is_stopped(backend: str) -> None:
    rhs, height = fall()
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    bounce = ca.Function("bounce", [z, p], [ca.vertcat(z[0], -0.9 * z[1])])
    e = compile_arcs(rhs, events=[Event(function=height, direction=-1, jump=bounce)], backend=backend)
    assert e.propagate([1.0, 0.0], [2.0], 30.0).status[0] == ArcStatus.STEP_LIMIT


def test_a_polygon_is_flown_from_knot_to_knot(backend: str) -> None:
    """z' = f(z), f a polygon: one event with a level in each mode; dz(T)/dz(0) = f(z(T))/f(z(0))."""
    knots, slopes = (0.0, 1.0, 2.0), (0.5, 1.0, -0.5, -0.25)
    z, p = ca.SX.sym("z", 1), ca.SX.sym("p")
    lines = [p + slopes[0] * z, p + slopes[1] * z, p + 1 + slopes[2] * (z - 1), p + 0.5 + slopes[3] * (z - 2)]
    modes = [ca.Function(f"f{k}", [z, p], [line]) for k, line in enumerate(lines)]
    place = ca.Function("z", [z, p], [z])
    up = Event(function=place, direction=1, steady=True, switches={0: 1, 1: 2, 2: 3}, levels=dict(enumerate(knots)))
    down = Event(
        function=place, direction=-1, steady=True, switches={1: 0, 2: 1, 3: 2}, levels={1: 0.0, 2: 1.0, 3: 2.0}
    )
    e = compile_arcs(modes, columns=1, events=[up, down], backend=backend)
    # ln f grows by slope times time on each line: times from knot to knot, from f(-0.5) = 0.75 on.
    times = np.cumsum([math.log(1 / 0.75) / 0.5, math.log(2), math.log(1.5 / 2) / -0.5])
    arcs = e.propagate([-0.5], [1.0], times[-1] + 0.4, np.eye(1))
    end = 1.5 * math.exp(-0.25 * 0.4)
    np.testing.assert_allclose(arcs.event_time[0][:3], times, atol=1e-11)
    np.testing.assert_allclose(arcs.z[0], 2.0 + (1.5 - end) / 0.25, atol=1e-11)
    np.testing.assert_allclose(arcs.columns[0], end / 0.75, atol=1e-11)
    back = e.propagate(arcs.z, [1.0], -(times[-1] + 0.4), mode=3)
    np.testing.assert_allclose(back.z[0], -0.5, atol=1e-11)
    assert [arcs.mode[0], back.mode[0]] == [3, 0]


def test_a_zero_that_is_only_touched_holds_nothing_up(backend: str) -> None:
    """z = 1 - (t - 1)^2 comes to 1 at the very end, where rounding may meet the level many times."""
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    f = ca.Function("f", [z, p], [ca.vertcat(z[1], -2.0)])
    event = Event(function=ca.Function("z", [z, p], [z[0]]), direction=1, steady=True, switches={0: 1}, levels={0: 1.0})
    arcs = compile_arcs([f, f], events=[event], backend=backend).propagate([0.0, 2.0], [0.0], 1.0)
    assert arcs.status[0] == ArcStatus.REACHED
    np.testing.assert_allclose(arcs.z[0], [1.0, 0.0], atol=1e-12)


def test_meditch_lands_by_its_switch(backend: str) -> None:
    """From the closed form's costates (12 digits printed) the lander comes to rest at the ground."""
    modes, events = modes_and_switch()
    arcs = compile_arcs(modes, columns=6, events=events, backend=backend).propagate(
        START, PARAMETERS, FINAL_TIME, np.eye(6)
    )
    np.testing.assert_allclose(arcs.z[0, :2], 0.0, atol=5e-11)
    np.testing.assert_allclose(arcs.event_time[0, 0], SWITCH, atol=2e-11)
    np.testing.assert_allclose((1 - arcs.z[0, 2]) * EXHAUST, COST, atol=2e-11)
    assert arcs.mode[0] == 1
    assert list(arcs.event_index[0, :2]) == [0, -1]
    S, J = arcs.columns[0], np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
    np.testing.assert_allclose(S.T @ J @ S, J, atol=1e-12)  # saltation keeps the symplectic form


def test_both_backends_meet_the_same_events() -> None:
    """Measured over dispersed starts: event times 5e-16, z 6.3e-13, columns 2.2e-11."""
    pytest.importorskip("llvmlite")
    modes, events = modes_and_switch()
    starts = START + 0.01 * np.random.default_rng(0).uniform(-1, 1, (9, 6))
    a, b = (
        compile_arcs(modes, columns=6, events=events, backend=name).propagate(starts, PARAMETERS, FINAL_TIME, np.eye(6))
        for name in ("native", "scipy")
    )
    np.testing.assert_array_equal(a.event_index, b.event_index)
    np.testing.assert_array_equal(a.mode, b.mode)
    np.testing.assert_allclose(a.event_time, b.event_time, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a.z, b.z, rtol=0, atol=5e-12)
    np.testing.assert_allclose(a.columns, b.columns, rtol=0, atol=2e-10)


def test_saltation_against_finite_differences(backend: str) -> None:
    modes, events = modes_and_switch()
    e = compile_arcs(modes, columns=6, events=events, backend=backend)
    S = e.propagate(START, PARAMETERS, FINAL_TIME, np.eye(6)).columns[0]
    h = 1e-4
    offsets = np.array([k * h * row for row in np.eye(6) for k in (-2, -1, 1, 2)])
    z = e.propagate(START + offsets, PARAMETERS, FINAL_TIME).z.reshape(6, 4, 6)
    difference = (z[:, 0] - 8 * z[:, 1] + 8 * z[:, 2] - z[:, 3]) / (12 * h)
    np.testing.assert_allclose(difference.T, S, rtol=1e-6, atol=1e-7)


def test_meditch_back_over_the_switch(backend: str) -> None:
    modes, events = modes_and_switch()
    e = compile_arcs(modes, events=events, backend=backend)
    end = e.propagate(START, PARAMETERS, FINAL_TIME)
    back = e.propagate(end.z, PARAMETERS, -FINAL_TIME, mode=1)
    np.testing.assert_allclose(back.z[0], START, atol=2e-11)
    assert back.mode[0] == 0


def test_the_rate_at_the_end_is_that_of_the_mode_reached(backend: str) -> None:
    """Before and after the switch, and with the switch the last thing that happens."""
    modes, events = modes_and_switch()
    e = compile_arcs(modes, columns=6, events=events, backend=backend)
    met = e.propagate(START, PARAMETERS, FINAL_TIME).event_time[0, 0]
    durations = np.array([0.5 * SWITCH, met, FINAL_TIME, 0.0])
    arcs = e.propagate(np.tile(START, (4, 1)), PARAMETERS, durations, np.eye(6))
    assert list(arcs.mode) == [0, 1, 1, 0]
    for lane, mode in enumerate(arcs.mode):
        np.testing.assert_allclose(arcs.rates[lane], rate(modes[mode], arcs.z[lane], PARAMETERS), atol=1e-14)


def test_the_rate_at_a_terminal_event_and_after_a_jump(backend: str) -> None:
    rhs, height = fall()
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    drag = ca.Function("drag", [z, p], [ca.vertcat(z[1], -p - z[1])])
    end = compile_arcs(drag, events=[Event(function=height, direction=-1, terminal=True)], backend=backend)
    arcs = end.propagate([1.0, 0.0], [2.0], 9.0)
    assert arcs.status[0] == ArcStatus.EVENT
    np.testing.assert_allclose(arcs.rates[0], rate(drag, arcs.z[0], 2.0), atol=1e-14)
    bounce = ca.Function("bounce", [z, p], [ca.vertcat(z[0], -0.5 * z[1])])
    jump = compile_arcs(rhs, events=[Event(function=height, direction=-1, jump=bounce)], backend=backend)
    arcs = jump.propagate([1.0, 0.0], [2.0], 1.0)  # the impact is the end
    np.testing.assert_allclose(arcs.z[0], [0.0, 1.0], atol=1e-11)
    np.testing.assert_allclose(arcs.rates[0], [1.0, -2.0], atol=1e-11)


def rate(mode: ca.Function, z: np.ndarray, p: np.ndarray | float) -> np.ndarray:
    return np.asarray(mode(z, p)).ravel()


def layered_entry() -> tuple[list[ca.Function], list[Event], np.ndarray]:
    """Vertical fall with drag through three layers: scale heights differ and density jumps in slope."""
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    bases, densities, scales = [0.0, 1.0, 2.0], [1.0, np.exp(-2.0), np.exp(-3.0)], [0.5, 1.0, 0.7]
    modes = [
        ca.Function("layer", [z, p], [ca.vertcat(z[1], -1 + p * rho * ca.exp(-(z[0] - base) / scale) * z[1] ** 2)])
        for base, rho, scale in zip(bases, densities, scales, strict=True)
    ]
    events = []
    for upper in (2, 1):
        g = ca.Function("g", [z, p], [z[0] - bases[upper]])
        events.append(Event(function=g, direction=-1, switches={upper: upper - 1}))
    return modes, events, np.array(bases)


def test_layers_of_an_atmosphere_against_restarts(backend: str) -> None:
    modes, events, bases = layered_entry()
    e = compile_arcs(modes, columns=2, events=events, backend=backend)
    arcs = e.propagate([3.0, -1.0], [0.8], 2.5, np.eye(2), mode=2)
    state, t, times = np.array([3.0, -1.0]), 0.0, []
    for layer in (2, 1):
        t_hit, state = oracle(modes[layer], state, bases[layer])
        t += t_hit
        times.append(t)
    _, state = oracle(modes[0], state, None, 2.5 - t)
    np.testing.assert_allclose(arcs.event_time[0, :2], times, atol=1e-11)
    np.testing.assert_allclose(arcs.z[0], state, atol=1e-11)
    assert list(arcs.event_index[0, :3]) == [0, 1, -1]
    h = 1e-4
    offsets = np.array([k * h * row for row in np.eye(2) for k in (-2, -1, 1, 2)])
    z = e.propagate(np.array([3.0, -1.0]) + offsets, [0.8], 2.5, mode=2).z.reshape(2, 4, 2)
    difference = (z[:, 0] - 8 * z[:, 1] + 8 * z[:, 2] - z[:, 3]) / (12 * h)
    np.testing.assert_allclose(difference.T, arcs.columns[0], atol=1e-7)


def oracle(
    rhs: ca.Function, state: np.ndarray, level: float | None, duration: float = 10.0
) -> tuple[float, np.ndarray]:
    """SciPy's integrator in one layer, to a level (polished by whole arcs) or for a time."""
    from scipy.integrate import solve_ivp
    from scipy.optimize import brentq

    def fly(t: float) -> np.ndarray:
        settings = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
        return solve_ivp(lambda _, z: np.asarray(rhs(z, 0.8)).ravel(), (0, t), state, **settings).y[:, -1]

    if level is None:
        return duration, fly(duration)
    hit = float(np.asarray(brentq(lambda t: fly(t)[0] - level, 1e-3, 1.5, xtol=1e-14)))
    return hit, fly(hit)


def test_lanes_in_different_modes(backend: str) -> None:
    modes, events, _ = layered_entry()
    e = compile_arcs(modes, events=events, backend=backend)
    starts = np.array([[3.0, -1.0], [1.5, -0.5], [0.5, -0.1], [2.2, 0.0], [2.9, -2.0]])
    mode = np.array([2, 1, 0, 2, 2])
    together = e.propagate(starts, [0.8], 1.2, mode=mode)
    for lane in range(5):
        alone = e.propagate(starts[lane], [0.8], 1.2, mode=mode[lane])
        np.testing.assert_allclose(together.z[lane], alone.z[0], atol=1e-12)
        assert together.mode[lane] == alone.mode[0]


def test_dense_output_over_a_switch(backend: str) -> None:
    modes, events = modes_and_switch()
    e = compile_arcs(modes, events=events, backend=backend)
    d = e.dense(START, PARAMETERS, FINAL_TIME)
    for t in (0.1, SWITCH, 0.3, 1.2):
        np.testing.assert_allclose(d(t), e.propagate(START, PARAMETERS, t).z[0], atol=1e-10)


def test_dense_output_that_ends_at_a_switch(backend: str) -> None:
    """The last step has no length where the switch is met at the very end; no step has in a flight without any."""
    modes, events = modes_and_switch()
    e = compile_arcs(modes, events=events, backend=backend)
    met = e.propagate(START, PARAMETERS, FINAL_TIME).event_time[0, 0]
    for end in (met, np.nextafter(met, 0), np.nextafter(met, 2)):
        d = e.dense(START, PARAMETERS, end)
        np.testing.assert_allclose(d([end, 0.3 * end]), [d.end.z[0], e.propagate(START, PARAMETERS, 0.3 * end).z[0]],
                                   atol=1e-10)  # fmt: skip
    np.testing.assert_array_equal(e.dense(START, PARAMETERS, 0.0)(0.0), START)


def test_events_that_contradict_themselves_are_refused() -> None:
    rhs, height = fall()
    with pytest.raises(PeriluneError, match="direction"):
        Event(function=height, direction=2)
    with pytest.raises(PeriluneError, match="cannot end the arc"):
        Event(function=height, terminal=True, switches={0: 1})
    with pytest.raises(PeriluneError, match="modes that do not exist"):
        compile_arcs(rhs, events=[Event(function=height, switches={0: 1})])


def test_an_event_of_another_state_is_refused() -> None:
    rhs, _ = fall()
    z, p = ca.SX.sym("z", 3), ca.SX.sym("p")
    with pytest.raises(PeriluneError, match="a z or p of another shape"):
        compile_arcs(rhs, events=[Event(function=ca.Function("g", [z, p], [z[0]]))])
