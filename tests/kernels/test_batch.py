"""Boundary value problems in lanes: convergence, outcomes, and the same answers as SciPy's root finder."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from lander import TIME
from landing_bvp import functions, parameters
from scipy.integrate import solve_ivp
from scipy.optimize import root

from perilune.kernels.batch import BatchShooter, ShootingStatus
from perilune.words.outcome import PeriluneError

#: lam_r, lam_u, lam_v, T near the nominal landing: 1007.2 s.
GUESS = np.array([0.887, 0.458, -0.063, 0.973])


@pytest.fixture
def shooter(backend: str) -> BatchShooter:
    return BatchShooter(*functions(), backend=backend)


def test_dispersed_landings_all_converge(shooter: BatchShooter, backend: str) -> None:
    p = parameters(512 if backend == "native" else 24)
    shots = shooter.solve(GUESS, p)
    assert np.all(shots.converged)
    assert shots.residual.max() <= 1e-10
    np.testing.assert_allclose(shots.z[:, :3], [[1.0, 0.0, 0.0]] * len(p), atol=1e-10)
    assert shots.y[0, 3] * TIME == pytest.approx(1007.233, abs=1e-3)  # flight time of the undispersed landing


def test_a_lane_agrees_with_scipy(shooter: BatchShooter) -> None:
    rhs, _, _ = functions()
    p = parameters(3)

    def residual(y: np.ndarray) -> np.ndarray:
        start = np.concatenate([p[2, 3:], y[:3]])
        flown = solve_ivp(
            lambda t, z: np.asarray(rhs(z, p[2])).ravel(),
            (0, y[3]),
            start,
            method="DOP853",
            rtol=1e-12,
            atol=1e-12,
        )
        return np.concatenate([flown.y[:3, -1] - [1, 0, 0], [y[:3] @ y[:3] - 1]])

    truth = root(residual, GUESS, tol=1e-11)
    assert truth.success
    np.testing.assert_allclose(shooter.solve(GUESS, p).y[2], truth.x, atol=1e-8)


def test_bad_guesses_end_with_an_outcome(shooter: BatchShooter) -> None:
    p = parameters(4)
    guesses = np.array([GUESS, [np.nan, 0, 0, 1], [0, 0, 0, 1], [-0.1, -0.9, 0.2, 4.0]])
    shots = shooter.solve(guesses, p, max_iterations=40)
    assert shots.status[0] == ShootingStatus.CONVERGED
    assert list(shots.status[1:3]) == [ShootingStatus.NON_FINITE] * 2
    assert np.isfinite(shots.residual[0])
    bad = ~shots.converged
    assert np.all(shots.residual[bad] > 1e-10)


def test_out_of_iterations(shooter: BatchShooter) -> None:
    shots = shooter.solve(GUESS, parameters(5), max_iterations=2)
    assert np.all(shots.status == ShootingStatus.ITERATION_LIMIT)
    assert np.all(shots.iterations == 2)


def scalar(residual: Any) -> tuple[ca.Function, ca.Function, ca.Function]:
    """z' = p z from z = y over unit time, and a condition on y and z."""
    y, z, p = ca.SX.sym("y"), ca.SX.sym("z"), ca.SX.sym("p")
    return (
        ca.Function("rhs", [z, p], [p * z]),
        ca.Function("start", [y, p], [y, ca.SX(1.0)]),
        ca.Function("residual", [y, z, p], [residual(y, z)]),
    )


def test_damping_brings_back_what_newton_would_lose(backend: str) -> None:
    """atan: the full step from 3 diverges."""
    shots = BatchShooter(*scalar(lambda y, z: ca.atan(z)), backend=backend).solve([3.0], [[0.0], [0.1]])
    assert np.all(shots.converged)
    np.testing.assert_allclose(shots.y, 0.0, atol=1e-9)


def test_no_root_stalls(backend: str) -> None:
    shots = BatchShooter(*scalar(lambda y, z: z**2 + 1), backend=backend).solve([0.3], [[0.0]])
    assert shots.status[0] in (ShootingStatus.STALLED, ShootingStatus.ITERATION_LIMIT)
    assert shots.residual[0] >= 1.0


def test_as_many_conditions_as_unknowns(backend: str) -> None:
    rhs, start, _ = scalar(lambda y, z: z)
    with pytest.raises(PeriluneError, match="as many conditions"):
        BatchShooter(rhs, start, scalar(lambda y, z: ca.vertcat(y, z))[2], backend=backend)
