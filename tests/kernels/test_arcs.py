"""Arcs against oracles: order, honest tolerances, columns, and how an arc may end."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from lander import DURATION, PARAMETERS, landing_rhs, landing_seeds, start

from perilune.core import PeriluneError
from perilune.kernels import ArcStatus, compile_arcs


def engine(rhs: ca.Function, backend: str, columns: Any = 0) -> Any:
    return compile_arcs(rhs, columns=columns, backend=backend)


def pendulum() -> ca.Function:
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    return ca.Function("pendulum", [z, p], [ca.vertcat(z[1], -p * ca.sin(z[0]))])


def kepler() -> ca.Function:
    """Plane Kepler motion: the state after time t is known from Kepler's equation."""
    z, p = ca.SX.sym("z", 4), ca.SX.sym("p")
    r3 = (z[0] ** 2 + z[1] ** 2) ** 1.5
    return ca.Function("kepler", [z, p], [ca.vertcat(z[2], z[3], -p * z[0] / r3, -p * z[1] / r3)])


def kepler_state(e: float, t: float) -> np.ndarray:
    E = t
    for _ in range(50):
        E -= (E - e * np.sin(E) - t) / (1 - e * np.cos(E))
    rate, b = 1 / (1 - e * np.cos(E)), np.sqrt(1 - e**2)
    return np.array([np.cos(E) - e, b * np.sin(E), -np.sin(E) * rate, b * np.cos(E) * rate])


def test_order_of_convergence_is_eight(backend: str) -> None:
    e = engine(kepler(), backend)
    exact = kepler_state(0.3, 2.0)
    errors = [
        np.abs(e.propagate(kepler_state(0.3, 0.0), [1.0], 2.0, fixed_steps=n).z[0] - exact).max() for n in (6, 12, 24)
    ]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 7.3)
    assert np.all(orders < 9.5)


@pytest.mark.parametrize(("times", "limit"), [(1, 5e-12), (10, 5e-11), (100, 1.2e-8)])
def test_achieved_error_over_characteristic_times(backend: str, times: int, limit: float) -> None:
    """The phase error grows as time squared: measured 1.7e-12, 1.5e-11 and 3.7e-9 at tolerance 1e-12."""
    arcs = engine(kepler(), backend).propagate(kepler_state(0.3, 0.0), [1.0], float(times))
    assert np.abs(arcs.z[0] - kepler_state(0.3, float(times))).max() < limit


def test_tolerance_is_obeyed_in_proportion(backend: str) -> None:
    e, exact = engine(kepler(), backend), kepler_state(0.3, 10.0)
    for rtol in (1e-6, 1e-8, 1e-10, 1e-12):
        error = np.abs(e.propagate(kepler_state(0.3, 0.0), [1.0], 10.0, rtol=rtol, atol=rtol).z[0] - exact).max()
        assert error < 50 * rtol


def test_dispersed_landings_agree_with_heyoka(backend: str) -> None:
    heyoka = pytest.importorskip("heyoka")
    rhs, starts = landing_rhs(), start(64)
    arcs = engine(rhs, backend).propagate(starts, PARAMETERS, DURATION)
    assert np.all(arcs.status == ArcStatus.REACHED)
    names = heyoka.make_vars(*[f"z{i}" for i in range(10)])
    rates = through_heyoka(rhs, names, heyoka)
    oracle = heyoka.taylor_adaptive(list(zip(names, rates, strict=True)), starts[0], tol=1e-16)
    for lane, state in enumerate(starts):
        oracle.time, oracle.state[:] = 0.0, state
        oracle.propagate_until(DURATION)
        np.testing.assert_allclose(arcs.z[lane], oracle.state, rtol=0, atol=1e-11)


def through_heyoka(rhs: ca.Function, names: Any, heyoka: Any) -> list[Any]:
    """Evaluate the traced program on heyoka's expressions."""
    from perilune.kernels.algebra.program import trace_function

    program, values = trace_function(rhs), []
    operations = {
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "div": lambda a, b: a / b,
        "neg": lambda a: -a,
        "sqrt": heyoka.sqrt,
    }
    for op, *operands in program.instructions:
        if op == "input":
            source = names if operands[0] == 0 else PARAMETERS
            values.append(source[operands[1]])
        elif op == "const":
            values.append(float.fromhex(operands[0]))
        else:
            values.append(operations[op](*(values[i] for i in operands)))
    return [heyoka.expression(values[i]) if isinstance(values[i], float) else values[i] for i in program.outputs]


def test_a_landing_agrees_with_mpmath(backend: str) -> None:
    mpmath = pytest.importorskip("mpmath")
    mpmath.mp.dps = 25
    solution = mpmath.odefun(lambda t, z: [z[1], -mpmath.sin(z[0])], 0, [1, 0], tol=mpmath.mpf("1e-18"))
    arcs = engine(pendulum(), backend).propagate([1.0, 0.0], [1.0], 3.0)
    np.testing.assert_allclose(arcs.z[0], [float(x) for x in solution(3)], rtol=0, atol=1e-11)


def test_columns_are_the_derivative_by_taylor_ratio(backend: str) -> None:
    """|z(z0 + h d) - z - h S d| falls a hundredfold for each tenfold of h."""
    e = engine(landing_rhs(), backend, 10)
    z0, direction = start(1)[0], np.random.default_rng(2).normal(size=10)
    base = e.propagate(z0, PARAMETERS, DURATION, np.eye(10))
    slope = base.columns[0] @ direction
    remainders = [
        np.linalg.norm(e.propagate(z0 + h * direction, PARAMETERS, DURATION).z[0] - base.z[0] - h * slope)
        for h in (1e-2, 1e-3, 1e-4)
    ]
    orders = np.log10(np.array(remainders[:-1]) / remainders[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.15)


def test_transition_matrix_is_symplectic(backend: str) -> None:
    S = engine(landing_rhs(), backend, 10).propagate(start(1)[0], PARAMETERS, DURATION, np.eye(10)).columns[0]
    J = np.block([[np.zeros((5, 5)), np.eye(5)], [-np.eye(5), np.zeros((5, 5))]])
    # The lander's mass flow and cyclic angle are within H as well: the identity is exact for the flow.
    np.testing.assert_allclose(S.T @ J @ S, J, atol=3e-11)


def test_columns_change_nothing_of_the_arc(backend: str) -> None:
    e, starts = engine(landing_rhs(), backend, 6), start(5)
    with_columns = e.propagate(starts, PARAMETERS, DURATION, landing_seeds(5))
    np.testing.assert_allclose(with_columns.z, e.propagate(starts, PARAMETERS, DURATION).z, atol=1e-14)
    assert with_columns.columns.shape == (5, 10, 6)


def test_a_pattern_of_seeds_gives_the_same_columns(backend: str) -> None:
    seeds = landing_seeds()[0]
    sparse, full = engine(landing_rhs(), backend, seeds != 0), engine(landing_rhs(), backend, 6)
    assert sparse.system.size < full.system.size
    args = start(1)[0], PARAMETERS, DURATION, seeds
    np.testing.assert_allclose(sparse.propagate(*args).columns, full.propagate(*args).columns, atol=1e-13)


def test_there_and_back(backend: str) -> None:
    e, z0 = engine(landing_rhs(), backend, 10), start(3)
    out = e.propagate(z0, PARAMETERS, DURATION, np.eye(10))
    back = e.propagate(out.z, PARAMETERS, -DURATION, out.columns)
    np.testing.assert_allclose(back.z, z0, atol=1e-11)
    np.testing.assert_allclose(back.columns, np.broadcast_to(np.eye(10), (3, 10, 10)), atol=1e-9)


def test_lanes_are_independent_and_keep_their_places(backend: str) -> None:
    e, starts = engine(landing_rhs(), backend), start(7)
    durations = DURATION * np.array([1.0, 0.1, 0.0, -0.3, 0.7, 0.2, 0.9])
    together = e.propagate(starts, PARAMETERS, durations)
    for lane in range(7):
        alone = e.propagate(starts[lane], PARAMETERS, durations[lane])
        np.testing.assert_allclose(alone.z[0], together.z[lane], atol=1e-13)
    np.testing.assert_array_equal(together.time, durations)


def test_the_rate_at_the_end_is_that_of_the_equations(backend: str) -> None:
    """Forward, backward, not at all, and where the steps gave out."""
    rhs, starts = landing_rhs(), start(5)
    durations = DURATION * np.array([1.0, -0.3, 0.0, 0.5, 0.1])
    for settings in ({}, {"max_steps": 3}, {"fixed_steps": 4}):
        arcs = engine(rhs, backend, 6).propagate(starts, PARAMETERS, durations, landing_seeds(5), **settings)
        exact = np.asarray(rhs.map(5)(arcs.z.T, PARAMETERS)).T
        np.testing.assert_allclose(arcs.rates, exact, rtol=0, atol=1e-14)


def test_each_lane_may_have_its_parameters(backend: str) -> None:
    e = engine(pendulum(), backend)
    p = np.array([[0.5], [1.0], [2.0]])
    together = e.propagate(np.tile([1.0, 0.0], (3, 1)), p, 2.0)
    for lane in range(3):
        np.testing.assert_allclose(e.propagate([1.0, 0.0], p[lane], 2.0).z[0], together.z[lane], atol=1e-14)


def test_a_pole_is_reported_not_flown_through(backend: str) -> None:
    z, p = ca.SX.sym("z"), ca.SX.sym("p")
    arcs = engine(ca.Function("blow", [z, p], [z**2]), backend).propagate([[1.0], [0.1]], [0.0], 2.0)
    assert arcs.status[0] in (ArcStatus.NON_FINITE, ArcStatus.STALLED)
    assert arcs.status[1] == ArcStatus.REACHED
    np.testing.assert_allclose(arcs.z[1, 0], 0.1 / (1 - 0.2), rtol=1e-12)


@pytest.mark.parametrize("settings", [{}, {"fixed_steps": 10}])
def test_not_a_number_is_an_outcome(backend: str, settings: dict[str, int]) -> None:
    z, p = ca.SX.sym("z"), ca.SX.sym("p")
    e = engine(ca.Function("root", [z, p], [-ca.sqrt(z) - 1]), backend)  # z = 1 falls to 0 before t = 1
    arcs = e.propagate([[1.0], [np.nan], [9.0]], [0.0], 1.5, **settings)
    assert list(arcs.status[:2]) == [ArcStatus.NON_FINITE] * 2
    assert arcs.status[2] == ArcStatus.REACHED


def test_columns_that_are_not_finite_are_an_outcome(backend: str) -> None:
    e = engine(pendulum(), backend, 1)
    arcs = e.propagate([1.0, 0.0], [1.0], 1.0, [[np.inf], [0.0]])
    assert arcs.status[0] == ArcStatus.NON_FINITE


def test_out_of_steps(backend: str) -> None:
    arcs = engine(kepler(), backend).propagate(kepler_state(0.3, 0.0), [1.0], 50.0, max_steps=5)
    assert arcs.status[0] == ArcStatus.STEP_LIMIT
    assert 0 < arcs.time[0] < 50.0


def test_dense_output_follows_the_arc(backend: str) -> None:
    d = engine(kepler(), backend).dense(kepler_state(0.3, 0.0), [1.0], 5.0)
    times = np.linspace(0, 5.0, 101)
    exact = np.array([kepler_state(0.3, t) for t in times])
    np.testing.assert_allclose(d(times), exact, atol=2e-10)  # measured 4e-11: order 7 between nodes of order 8
    np.testing.assert_allclose(d.z, [kepler_state(0.3, t) for t in d.t], atol=1e-11)
    assert d(2.0).shape == (4,)


def test_dense_output_after_a_batch(backend: str) -> None:
    """The code of a batch writes no nodes: a single flight on the same engine must not take it."""
    e = engine(kepler(), backend)
    e.propagate(np.tile(kepler_state(0.3, 0.0), (6, 1)), [1.0], 5.0)
    np.testing.assert_allclose(e.dense(kepler_state(0.3, 0.0), [1.0], 5.0)(2.0), kepler_state(0.3, 2.0), atol=2e-10)


def test_dense_output_backwards(backend: str) -> None:
    d = engine(kepler(), backend).dense(kepler_state(0.3, 0.0), [1.0], -3.0)
    np.testing.assert_allclose(d(-1.7), kepler_state(0.3, -1.7), atol=2e-10)


def test_both_backends_fly_the_same_arcs() -> None:
    """Measured: z 1.3e-13, columns 8.5e-13, rates 3.4e-13."""
    pytest.importorskip("llvmlite")
    seeds = landing_seeds(9)
    a, b = (
        engine(landing_rhs(), name, 6).propagate(start(9), PARAMETERS, DURATION, seeds) for name in ("native", "scipy")
    )
    np.testing.assert_array_equal(a.status, b.status)
    np.testing.assert_allclose(a.z, b.z, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a.columns, b.columns, rtol=0, atol=1e-11)
    np.testing.assert_allclose(a.rates, b.rates, rtol=0, atol=2e-12)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (([1.0], [1.0], 1.0), "z0 has the wrong shape"),
        (([1.0, 0.0], [1.0, 2.0], 1.0), "p has the wrong shape"),
        (([1.0, 0.0], [1.0], [1.0, 2.0]), "duration has the wrong shape"),
        (([1.0, 0.0], [1.0], 1.0, np.eye(3)), "seeds of the columns"),
    ],
)
def test_wrong_shapes_are_named(backend: str, arguments: tuple[Any, ...], text: str) -> None:
    with pytest.raises(PeriluneError, match=text):
        engine(pendulum(), backend, 1).propagate(*arguments)


def test_a_mode_that_does_not_exist_is_refused(backend: str) -> None:
    with pytest.raises(PeriluneError, match="mode that does not exist"):
        engine(pendulum(), backend).propagate([1.0, 0.0], [1.0], 1.0, mode=3)


def test_an_unknown_backend_is_refused() -> None:
    with pytest.raises(PeriluneError, match="no such backend"):
        compile_arcs(pendulum(), backend="fast")
