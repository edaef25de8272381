"""One arc, one evaluation: the same as the batch computes, in arrays that are used again."""

from __future__ import annotations

import gc
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest
from lander import DURATION, PARAMETERS, landing_rhs, landing_seeds, start
from meditch import FINAL_TIME, PARAMETERS as MEDITCH, START, SWITCH, modes_and_switch

from perilune.kernels import ArcStatus, compile_arcs
from perilune.kernels.code.mapped import compile_single
from perilune.words.outcome import PeriluneError


def test_one_arc_is_what_the_batch_flies(backend: str) -> None:
    e, starts, seeds = compile_arcs(landing_rhs(), columns=6, backend=backend), start(3), landing_seeds()[0]
    fly = e.single(columns=True)
    for z0, duration in zip(starts, (DURATION, -0.3 * DURATION, 0.0), strict=True):
        arcs = e.propagate(z0, PARAMETERS, duration, seeds)
        assert fly(z0, PARAMETERS, duration, seeds) == ArcStatus.REACHED
        np.testing.assert_array_equal(fly.z, arcs.z[0])
        np.testing.assert_array_equal(fly.rate, arcs.rates[0])
        np.testing.assert_array_equal(fly.S, arcs.columns[0])
        assert (fly.time, fly.steps, fly.mode) == (duration, arcs.steps[0], 0)


def test_without_columns(backend: str) -> None:
    e = compile_arcs(landing_rhs(), columns=6, backend=backend)
    fly = e.single(rtol=1e-8, atol=1e-8)
    assert fly(start()[0], PARAMETERS, DURATION) == ArcStatus.REACHED
    coarse = e.propagate(start(), PARAMETERS, DURATION, rtol=1e-8, atol=1e-8)
    np.testing.assert_array_equal(fly.z, coarse.z[0])
    assert fly.S.shape == (10, 0)


def test_the_arrays_are_used_again(backend: str) -> None:
    fly = compile_arcs(landing_rhs(), backend=backend).single()
    z, starts = fly.z, start(2)
    fly(starts[0], PARAMETERS, DURATION)
    first = z.copy()
    fly(starts[1], PARAMETERS, DURATION)
    assert fly.z is z
    assert np.abs(z - first).max() > 1e-6


def test_switches_and_modes_of_one_arc(backend: str) -> None:
    modes, events = modes_and_switch()
    e = compile_arcs(modes, columns=6, events=events, backend=backend)
    fly = e.single(columns=True)
    for _ in range(2):  # the second call does not see the first one's events
        assert fly(START, MEDITCH, FINAL_TIME, np.eye(6), mode=0) == ArcStatus.REACHED
        assert [index for index, _ in fly.events] == [0]
        assert fly.events[0][1] == pytest.approx(SWITCH, abs=1e-10)
        assert fly.mode == 1
        np.testing.assert_allclose(fly.rate, np.asarray(modes[1](fly.z, MEDITCH)).ravel(), atol=1e-14)
    arcs = e.propagate(START, MEDITCH, FINAL_TIME, np.eye(6))
    np.testing.assert_array_equal(fly.S, arcs.columns[0])
    fly(START, MEDITCH, 0.5 * SWITCH, np.eye(6))
    assert (fly.events, fly.mode) == ([], 0)


def test_failure_is_a_status(backend: str) -> None:
    z, p = ca.SX.sym("z"), ca.SX.sym("p")
    e = compile_arcs(ca.Function("blow", [z, p], [z**2]), backend=backend)
    fly, few = e.single(), e.single(max_steps=2)
    pole = fly(np.array([1.0]), np.zeros(1), 2.0)
    assert pole in (ArcStatus.NON_FINITE, ArcStatus.STALLED)
    assert fly(np.array([np.nan]), np.zeros(1), 1.0) == ArcStatus.NON_FINITE
    assert few(np.array([1.0]), np.zeros(1), 0.99) == ArcStatus.STEP_LIMIT
    assert fly(np.array([0.1]), np.zeros(1), 2.0) == ArcStatus.REACHED  # nothing of the failure is left
    assert fly.z[0] == pytest.approx(0.1 / 0.8, rel=1e-12)


def test_each_thread_its_own_object(backend: str) -> None:
    e, starts = compile_arcs(landing_rhs(), backend=backend), start(2)
    expected = e.propagate(starts, PARAMETERS, DURATION, rtol=1e-9).z

    def work(lane: int) -> np.ndarray:
        fly = e.single(rtol=1e-9)
        for _ in range(5):
            fly(starts[lane], PARAMETERS, DURATION)
        return fly.z

    with ThreadPoolExecutor(2) as pool:
        np.testing.assert_allclose(list(pool.map(work, range(2))), expected, atol=1e-14)


def test_the_code_outlives_its_engine(backend: str) -> None:
    fly = compile_arcs(landing_rhs(), backend=backend).single()
    gc.collect()
    assert fly(start()[0], PARAMETERS, DURATION) == ArcStatus.REACHED


def test_wrong_arguments_of_an_arc_are_named(backend: str) -> None:
    e, z0, seeds = compile_arcs(landing_rhs(), columns=6, backend=backend), start()[0], landing_seeds()[0]
    fly, bare = e.single(columns=True), e.single()
    for call in (
        lambda: fly(z0[:1], PARAMETERS, DURATION, seeds),
        lambda: fly(z0, PARAMETERS[:1], DURATION, seeds),
        lambda: fly(z0, PARAMETERS, DURATION, seeds[:, :1]),
        lambda: fly(z0, PARAMETERS, DURATION),
        lambda: bare(z0, PARAMETERS, DURATION, seeds),
    ):
        with pytest.raises(PeriluneError, match="fixed shapes"):
            call()
    with pytest.raises(PeriluneError, match="mode that does not exist"):
        bare(z0, PARAMETERS, DURATION, mode=1)


def test_an_evaluation_keeps_the_shapes_of_all_outputs(backend: str) -> None:
    a, none, b = ca.SX.sym("a", 2), ca.SX.sym("none", 0), ca.SX.sym("b", 3)
    sparse = ca.SX(ca.Sparsity.lower(3), ca.vertcat(b * a[0], b / a[1]))
    outputs = [sparse, ca.SX(0, 2), ca.sin(b), ca.mtimes(a, b.T)]
    function = ca.Function("several", [a, none, b], outputs)
    evaluate = compile_single(function, backend=backend)
    random = np.random.default_rng(4)
    for _ in range(2):
        x, y = random.uniform(0.5, 2.0, 2), random.uniform(-2, 2, 3)
        for found, expected in zip(evaluate(x, np.zeros(0), y), function(x, [], y), strict=True):
            assert found.shape == expected.shape
            np.testing.assert_allclose(found, expected.full(), rtol=1e-15, atol=1e-16)


def test_wrong_arguments_of_an_evaluation_are_named(backend: str) -> None:
    evaluate = compile_single(landing_rhs(), backend=backend)
    for arguments in ((start()[0],), (start()[0], PARAMETERS[:1]), (start(), PARAMETERS)):
        with pytest.raises(PeriluneError, match="fixed lengths"):
            evaluate(*arguments)
