"""Arcs and maps bound to arrays: the same as one batch computes, from arrays that are filled again."""

from __future__ import annotations

import gc
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import casadi as ca
import numpy as np
import pytest
from lander import DURATION, PARAMETERS, landing_rhs, landing_seeds, start
from meditch import FINAL_TIME, PARAMETERS as MEDITCH, START, SWITCH, modes_and_switch

from perilune.core import PeriluneError
from perilune.kernels import ArcStatus, BoundArcs, Engine, Request, compile_arcs, compile_map
from perilune.kernels.code import native


def bound(engine: Engine, lanes: int = 1, *, columns: bool = False, tolerance: float = 1e-12, **more: Any) -> BoundArcs:
    """Lanes of the engine, their arrays still empty."""
    system = engine.system
    return engine.bind(
        Request(
            z0=np.zeros((lanes, system.nz)),
            p=np.zeros((1, system.np)),
            duration=np.zeros(lanes),
            seeds=np.zeros((lanes, system.nz, system.nc)) if columns else None,
            rtol=np.full(lanes, tolerance),
            atol=np.full(lanes, tolerance),
            mode=np.zeros(lanes),
            **more,
        )
    )


def fly(flight: BoundArcs, z0: Any, p: Any, duration: Any, seeds: Any = None) -> int:
    """Fill the arrays, fly, and return the status of the first lane."""
    asked = flight.asked
    asked.z0[:], asked.p[:], asked.duration[:] = z0, p, duration
    if asked.seeds is not None:
        asked.seeds[:] = seeds
    flight()
    return int(flight.ends().status[0])


def test_a_bound_arc_is_what_the_batch_flies(backend: str) -> None:
    e, starts, seeds = compile_arcs(landing_rhs(), columns=6, backend=backend), start(3), landing_seeds()[0]
    flight = bound(e, columns=True)
    for z0, duration in zip(starts, (DURATION, -0.3 * DURATION, 0.0), strict=True):
        arcs = e.propagate(z0, PARAMETERS, duration, seeds)
        assert fly(flight, z0, PARAMETERS, duration, seeds) == ArcStatus.REACHED
        ends = flight.ends()
        for name in ("z", "rates", "columns", "steps", "mode", "time"):
            np.testing.assert_array_equal(getattr(ends, name), getattr(arcs, name))


def test_a_lane_does_not_know_its_neighbours(backend: str) -> None:
    """To the last bit: alone, and among lanes of other lengths, in another order, that end sooner or later."""
    modes, events = modes_and_switch()
    e = compile_arcs(modes, columns=6, events=events, backend=backend)
    durations, mode = FINAL_TIME * np.array([1.0, 0.2, 0.9, 0.5, 0.7, 0.01]), np.array([0, 0, 1, 0, 0, 1])
    starts = np.array([START * (1 + 1e-3 * k) for k in range(6)])
    together = e.propagate(starts, MEDITCH, durations, np.eye(6), mode=mode)
    for k in range(6):
        alone = e.propagate(starts[k], MEDITCH, durations[k], np.eye(6), mode=mode[k])
        for name in ("z", "rates", "columns", "steps", "mode", "event_time"):
            np.testing.assert_array_equal(getattr(alone, name)[0], getattr(together, name)[k])


def test_without_columns(backend: str) -> None:
    e = compile_arcs(landing_rhs(), columns=6, backend=backend)
    flight = bound(e, tolerance=1e-8)
    assert fly(flight, start()[0], PARAMETERS, DURATION) == ArcStatus.REACHED
    coarse = e.propagate(start(), PARAMETERS, DURATION, rtol=1e-8, atol=1e-8)
    np.testing.assert_array_equal(flight.z, coarse.z[:1])
    assert flight.columns.shape == (1, 10, 0)


def test_the_arrays_are_used_again(backend: str) -> None:
    flight = bound(compile_arcs(landing_rhs(), backend=backend))
    z, starts = flight.z, start(2)
    fly(flight, starts[0], PARAMETERS, DURATION)
    first = z.copy()
    fly(flight, starts[1], PARAMETERS, DURATION)
    assert flight.z is z
    assert np.abs(z - first).max() > 1e-6


def test_switches_and_modes(backend: str) -> None:
    modes, events = modes_and_switch()
    e = compile_arcs(modes, columns=6, events=events, backend=backend)
    flight = bound(e, columns=True)
    for _ in range(2):  # the second call does not see the first one's events
        assert fly(flight, START, MEDITCH, FINAL_TIME, np.eye(6)) == ArcStatus.REACHED
        ends = flight.ends()
        assert ends.event_index[0, :2].tolist() == [0, -1]
        assert ends.event_time[0, 0] == pytest.approx(SWITCH, abs=1e-10)
        assert ends.mode[0] == 1
        np.testing.assert_allclose(ends.rates[0], np.asarray(modes[1](ends.z[0], MEDITCH)).ravel(), atol=1e-14)
    fly(flight, START, MEDITCH, 0.5 * SWITCH, np.eye(6))
    assert np.isnan(flight.ends().event_time).all()
    assert flight.ends().mode[0] == 0


def test_failure_is_a_status(backend: str) -> None:
    z, p = ca.SX.sym("z"), ca.SX.sym("p")
    e = compile_arcs(ca.Function("blow", [z, p], [z**2]), backend=backend)
    flight, few = bound(e), bound(e, max_steps=2)
    assert fly(flight, 1.0, 0.0, 2.0) in (ArcStatus.NON_FINITE, ArcStatus.STALLED)
    assert flight.lost.tolist() == [0]
    assert fly(flight, np.nan, 0.0, 1.0) == ArcStatus.NON_FINITE
    assert fly(few, 1.0, 0.0, 0.99) == ArcStatus.STEP_LIMIT
    assert fly(flight, 0.1, 0.0, 2.0) == ArcStatus.REACHED  # nothing of the failure is left
    assert not len(flight.lost)
    assert flight.z[0, 0] == pytest.approx(0.1 / 0.8, rel=1e-12)


def test_each_thread_its_own_object(backend: str) -> None:
    e, starts = compile_arcs(landing_rhs(), backend=backend), start(2)
    expected = e.propagate(starts, PARAMETERS, DURATION, rtol=1e-9, atol=1e-9).z

    def work(lane: int) -> np.ndarray:
        flight = bound(e, tolerance=1e-9)
        for _ in range(5):
            fly(flight, starts[lane], PARAMETERS, DURATION)
        return flight.z[0]

    with ThreadPoolExecutor(2) as pool:
        np.testing.assert_array_equal(list(pool.map(work, range(2))), expected)


def test_the_code_outlives_its_engine(backend: str) -> None:
    flight = bound(compile_arcs(landing_rhs(), backend=backend))
    gc.collect()
    assert fly(flight, start()[0], PARAMETERS, DURATION) == ArcStatus.REACHED


def test_the_code_outlives_its_map(backend: str) -> None:
    """Of two threads that compile the same map one is let go, though it may be bound: queries of an atlas crashed."""
    a = ca.SX.sym("a", 2)
    flight = compile_map(ca.Function("f", [a], [2 * a]), backend=backend).bind(np.ones((1, 2)))
    gc.collect()
    flight()
    np.testing.assert_array_equal(flight.outputs[0], [[2.0, 2.0]])


def test_an_evaluation_keeps_all_outputs_apart(backend: str) -> None:
    """Dense, row by row; an argument without entries, and one of one row for all lanes."""
    a, none, b = ca.SX.sym("a", 2), ca.SX.sym("none", 0), ca.SX.sym("b", 3)
    sparse = ca.SX(ca.Sparsity.lower(3), ca.vertcat(b * a[0], b / a[1]))
    outputs = [sparse, ca.SX(0, 2), ca.sin(b), ca.mtimes(a, b.T)]
    function = ca.Function("several", [a, none, b], outputs)
    evaluate = compile_map(function, backend=backend)
    random = np.random.default_rng(4)
    x, y = random.uniform(0.5, 2.0, (1, 2)), random.uniform(-2, 2, (5, 3))
    flight = evaluate.bind(x, np.zeros((5, 0)), y)
    for _ in range(2):
        x[:], y[:] = random.uniform(0.5, 2.0, (1, 2)), random.uniform(-2, 2, (5, 3))
        flight()
        for lane in range(5):
            for found, expected in zip(flight.outputs, function(x[0], [], y[lane]), strict=True):
                np.testing.assert_allclose(found[lane], expected.full().ravel(), rtol=2e-15, atol=1e-16)


def test_rows_may_lie_apart_in_an_argument(backend: str) -> None:
    a = ca.SX.sym("a", 2)
    evaluate = compile_map(ca.Function("f", [a], [2 * a]), backend=backend)
    whole = np.arange(20.0).reshape(5, 4)
    for part in (whole[:, 1:3], whole[:, ::2], whole.T[:2].T, np.asfortranarray(whole)[:, :2]):
        np.testing.assert_array_equal(evaluate(part)[0], 2 * part)


def test_one_row_beside_none_is_evaluated_for_none(backend: str) -> None:
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b", 3)
    evaluate = compile_map(ca.Function("f", [a, b], [a, b]), backend=backend)
    assert [out.shape for out in evaluate(np.zeros((0, 2)), np.ones((1, 3)))] == [(0, 2), (0, 3)]


def test_wrong_arguments_of_an_evaluation_are_named(backend: str) -> None:
    evaluate = compile_map(landing_rhs(), backend=backend)
    for arguments in ((start(),), (start(), PARAMETERS[None, :1]), (start(), PARAMETERS)):
        with pytest.raises(PeriluneError, match="fixed lengths"):
            evaluate(*arguments)


@pytest.mark.skipif(not native.is_available(), reason="machine code")
def test_a_map_may_be_larger_than_a_stack() -> None:
    """Four lanes of 700 unknowns and their Jacobian are 16 MB."""
    x = ca.SX.sym("x", 700 * 700)
    points = np.random.default_rng(1).normal(size=(3, x.shape[0]))
    bound = compile_map(ca.Function("large", [x], [x[5] * x[-1], x[-2], 0.0]), backend="native").bind(points)
    for _ in range(2):
        bound()
        np.testing.assert_array_equal(bound.outputs[0][:, 0], points[:, 5] * points[:, -1])
        np.testing.assert_array_equal(bound.outputs[1][:, 0], points[:, -2])
        assert not bound.outputs[2].any()
        points[:] *= 2.0
