"""The proof's integrator against closed forms and SciPy's, its order, and rates that bend, jump and blow up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from perilune.problem import Solution
from perilune.proof.feasible.gauss_steps import COUNT, POINT, UP_TO_POINT, WEIGHT, gauss_rule, integrate_by_gauss
from perilune.proof.feasible.phase_data import PhaseData
from perilune.proof.feasible.reintegration import integrate_by_steps


def end_of(rates: Callable[[Any, Any], Any], span: tuple[float, float], start: Any, grid: Any = ()) -> Any:
    """Integrate states of the size 1 to the end."""
    x = np.array(start, dtype=float)
    nodes = np.array([span[0], *grid, span[1]])
    flown = integrate_by_gauss(lambda t: lambda X: np.array(rates(t, X)), span, x, np.ones(len(x)), nodes)
    if flown is None:
        return None
    assert flown[0][-1] == span[1] and (np.diff(flown[0]) > 0).all()
    return flown[1][:, -1]


def test_the_rule_has_order_32() -> None:
    """B(32) and C(16), from which the order follows (Hairer, Lubich, Wanner, II.1.2)."""
    for k in range(1, 2 * COUNT + 1):
        assert WEIGHT @ POINT ** (k - 1) == pytest.approx(1 / k, abs=1e-14)
    for k in range(1, COUNT + 1):
        assert POINT ** (k - 1) @ UP_TO_POINT == pytest.approx(POINT**k / k, abs=1e-14)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_the_order_is_twice_the_number_of_points(count: int) -> None:
    """What a step leaves of x' = i x falls with one power more."""
    _, weight, up_to, _ = gauss_rule(count)
    left = [
        abs(1 + 1j * h * weight @ np.linalg.solve(np.eye(count) - 1j * h * up_to.T, np.ones(count)) - np.exp(1j * h))
        for h in (0.8, 0.4)
    ]
    assert np.log2(left[0] / left[1]) == pytest.approx(2 * count + 1, abs=0.1)


def test_an_oscillator_and_an_eccentric_orbit_return() -> None:
    assert end_of(lambda t, x: (x[1], -x[0]), (0.0, 20.0), [1.0, 0.0]) == pytest.approx(
        [np.cos(20.0), -np.sin(20.0)], abs=1e-12
    )

    def attracted(t: Any, x: Any) -> Any:
        cube = (x[0] ** 2 + x[1] ** 2) ** 1.5
        return x[2], x[3], -x[0] / cube, -x[1] / cube

    e = 0.6
    start = [1 - e, 0.0, 0.0, np.sqrt((1 + e) / (1 - e))]
    assert end_of(attracted, (0.0, 2 * np.pi), start) == pytest.approx(start, abs=3e-12)
    # Half a turn: the apocentre, and SciPy's flight.
    by_scipy = solve_ivp(lambda t, x: attracted(t, x), (0.0, 4.0), start, method="DOP853", rtol=1e-13, atol=1e-14).y[
        :, -1
    ]
    assert end_of(attracted, (0.0, np.pi), start) == pytest.approx([-1 - e, 0, 0, -start[3] / 4], abs=1e-12)
    assert end_of(attracted, (0.0, 4.0), start) == pytest.approx(by_scipy, abs=1e-11)


def test_rates_that_jump_or_bend_are_integrated_to_the_tolerance() -> None:
    """Wherever it is; at a node without a shorter step."""
    calls = []

    def rates(t: Any, X: Any) -> Any:
        calls.append(t)
        return [np.where(t < 1 / 3, -1.0, 2.0), np.abs(t - 1 / 3)]

    assert end_of(rates, (0.0, 1.0), [0.0, 0.0]) == pytest.approx([1.0, 5 / 18], abs=1e-11)
    assert len(calls) < 300
    calls.clear()
    assert end_of(lambda t, X: rates(t, X)[1:], (0.0, 1.0), [0.0], (1 / 3,)) == pytest.approx([5 / 18], abs=1e-14)
    assert len(calls) < 20


@pytest.mark.parametrize("jump", np.linspace(0.4, 0.6, 21))
def test_a_jump_next_to_the_end_of_a_step_is_seen(jump: float) -> None:
    """Where the last point of one step and the first of the next leave it between them."""
    found = end_of(lambda t, X: [np.where(t < jump, 1.0, 0.0)], (0.0, 1.0), [0.0], (0.5 - 1e-4, 0.5 + 1e-4))
    assert found == pytest.approx([jump], abs=1e-11)


def test_a_change_between_two_nodes_of_many_is_seen() -> None:
    """No step passes more than 32 nodes: of a thousand it meets each change that three of them show."""
    grid = np.linspace(0.0, 1.0, 1001)[1:-1]
    bump = (0.5, 0.5015)
    found = end_of(lambda t, X: [np.where((t > bump[0]) & (t < bump[1]), 1.0, 0.0)], (0.0, 1.0), [0.0], grid)
    assert found == pytest.approx([bump[1] - bump[0]], abs=1e-11)


def test_quick_decay_and_a_pole() -> None:
    lag = 1e4
    found = end_of(lambda t, x: [-lag * (x[0] - np.cos(t))], (0.0, 1.0), [1.0])
    assert found == pytest.approx([(lag**2 * np.cos(1.0) + lag * np.sin(1.0)) / (lag**2 + 1)], abs=1e-12)
    with np.errstate(all="ignore"):
        assert end_of(lambda t, x: [x[0] ** 2], (0.0, 2.0), [1.0]) is None
        assert end_of(lambda t, x: [np.nan * x[0]], (0.0, 2.0), [1.0]) is None
        assert end_of(lambda t, x: [x[0] ** 2], (0.0, 0.99), [1.0]) == pytest.approx([100.0], rel=1e-9)


def test_a_flight_is_that_of_scipy(hybrid: Solution) -> None:
    """With the control of the file, read by another function."""
    arc = PhaseData(solution=hybrid, index=0)
    start, control = arc.trajectory.state.values[0], arc.trajectory.control
    flown = solve_ivp(
        lambda t, x: arc.phase.rates(x, (u := control(t)) / np.linalg.norm(u), arc.p), (0.0, arc.duration), start,
        method="DOP853", rtol=1e-13, atol=1e-13 * arc.state_scale, max_step=arc.duration / 100,
    ).y[:, -1]  # fmt: skip
    end, apart = integrate_by_steps(arc, start)
    assert np.abs((end - flown) / arc.state_scale).max() < 1e-11
    assert apart.max() < 1e-10
