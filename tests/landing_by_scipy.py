"""Cho's landing solved with SciPy alone, costates by hand: truth that shares no code with the library.

Only the start state and the constants come from the `Problem`, so that shifted and perturbed problems are
flown too. Canonical units; the Jacobian of the shooting function comes from one integration of complex-step
lanes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from perilune.core import NUMERIC, Outcome
from perilune.models import Body, Orbit, Retro, Vehicle, hybrid_landing
from perilune.problem import Curve, Problem, Solution, Trajectory, hermite_nodes

STEP = 1e-40
MOON = Body(name="moon", gravitational_parameter=4902.7779e9, radius=1738.14e3, rotation_rate=2.6617e-6)


def cho_problem(retro: Retro | None, thrust: float = 440.0) -> Problem:
    """The paper's lander."""
    vehicle = Vehicle(mass=300.0, thrust=thrust, specific_impulse=310.0, standard_gravity=9.81)
    return hybrid_landing(vehicle, retro, Orbit(parking_altitude=100e3, perilune_altitude=15e3), body=MOON)


def _scales(problem: Problem) -> np.ndarray:
    s = problem.scales
    return np.array([s.of(v.unit) for v in problem.phases[0].states])


def _costate_scales(problem: Problem) -> np.ndarray:
    return problem.scales.mass / _scales(problem)


def _constants(problem: Problem) -> tuple[float, float, float, float, float, float]:
    """mu, thrust, exhaust speed, ground radius, ground speed, retro exhaust speed; canonical."""
    g, s = problem.given, problem.scales
    thrust = g["vehicle_thrust"].value / s.of("N")
    exhaust = g["vehicle_specific_impulse"].value * g["vehicle_standard_gravity"].value / s.of("m/s")
    ground = (g["body_radius"].value + g["landing_altitude"].value) / s.length
    ground_speed = ground * g["body_rotation_rate"].value * s.time
    retro_exhaust = g["retro_specific_impulse"].value * g["vehicle_standard_gravity"].value / s.of("m/s")
    mu = g["body_gravitational_parameter"].value / s.of("m^3/s^2")
    return mu, thrust, exhaust, ground, ground_speed, retro_exhaust


def _rates(y: Any, mu: float, thrust: float, exhaust: float) -> np.ndarray:
    """Rates of (r, phi, u, v, m, and their costates), canonical, shape of y; lanes in the second axis."""
    r, _, u, v, m, lr, lphi, lu, lv, _ = y
    norm = np.sqrt(lu * lu + lv * lv)
    a = thrust / m
    out = np.empty_like(y)
    out[0], out[1] = v, u / r
    out[2] = -u * v / r - a * lu / norm
    out[3] = u * u / r - mu / (r * r) - a * lv / norm
    out[4] = -thrust / exhaust
    out[5] = lphi * u / r**2 - lu * u * v / r**2 + lv * (u * u / r**2 - 2 * mu / r**3)
    out[6] = 0 * r
    out[7] = -lphi / r + lu * v / r - 2 * lv * u / r
    out[8] = -lr + lu * u / r
    out[9] = -a / m * norm
    return out


def _residual(problem: Problem, z: np.ndarray) -> np.ndarray:
    """Shooting function of z = (lam_r, lam_u, lam_v, lam_m, t_f [, delta_v]), canonical; z (k, lanes)."""
    mu, thrust, exhaust, ground, ground_speed, retro_exhaust = _constants(problem)
    s, lanes = problem.scales, z.shape[1]
    free = {"flight_time": 0.0}
    if "retro_delta_v" in problem.free_names:
        free["retro_delta_v"] = z[5] * s.of("m/s")
    start = problem.start(problem.parameters(free), NUMERIC)
    y0 = np.zeros((10, lanes), dtype=complex)
    for i, (value, scale) in enumerate(zip(start, _scales(problem), strict=True)):
        y0[i] = value / scale
    y0[5], y0[7], y0[8], y0[9] = z[:4]
    rates0 = _rates(y0, mu, thrust, exhaust)

    def rhs(_: float, y: np.ndarray) -> np.ndarray:
        return (z[4] * _rates(y.reshape(10, lanes), mu, thrust, exhaust)).ravel()

    end = solve_ivp(rhs, (0.0, 1.0), y0.ravel(), method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1].reshape(10, lanes)
    out = [
        end[0] - ground,
        end[2] - ground_speed,
        end[3],
        end[9] + 1,
        sum(y0[5 + i] * rates0[i] for i in range(5)),
    ]
    if "retro_delta_v" in free:
        out.append(-y0[7] - y0[9] * y0[4] / retro_exhaust)
    return np.array(out)


def shoot(problem: Problem, z: np.ndarray) -> np.ndarray:
    """Newton's method from the unknowns z, canonical."""
    size = 6 if "retro_delta_v" in problem.free_names else 5
    z = np.array(z[:size], dtype=float)
    for _ in range(12):
        values: Any = _residual(problem, z[:, None] + 1j * STEP * np.eye(size))
        step = np.linalg.solve(values.imag / STEP, values.real[:, 0])
        z = z - step
        if np.abs(step).max() < 1e-11:
            return z
    raise RuntimeError(f"no convergence: {step}")


def solution_of(problem: Problem, z: np.ndarray) -> Solution:
    """Fly the unknowns once more and export them as a method would."""
    mu, thrust, exhaust, *_ = _constants(problem)
    s, duration = problem.scales, z[4] * problem.scales.time
    free = {"flight_time": duration}
    if "retro_delta_v" in problem.free_names:
        free["retro_delta_v"] = z[5] * s.of("m/s")
    y0 = np.zeros(10)
    y0[:5] = np.array(problem.start(problem.parameters(free), NUMERIC)) / _scales(problem)
    y0[[5, 7, 8, 9]] = z[:4]
    flown = solve_ivp(
        lambda _, y: _rates(y, mu, thrust, exhaust), (0.0, z[4]), y0, method="DOP853", rtol=1e-13, atol=1e-14,
        dense_output=True, max_step=z[4] / 60,
    )  # fmt: skip
    scale = np.concatenate([_scales(problem), _costate_scales(problem), [1.0, 1.0]])

    def evaluate(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y = flown.sol(t / s.time)
        dy = _rates(y, mu, thrust, exhaust)
        norm = np.hypot(y[7], y[8])
        along = -y[7:9] / norm
        turn = -(dy[7:9] - along * (along * dy[7:9]).sum(axis=0)) / norm
        return np.vstack([y, along]).T * scale, np.vstack([dy, turn]).T * scale / s.time

    tolerance = 1e-11 * scale
    time, values, rates = hermite_nodes(evaluate, duration, tolerance)
    curve = [Curve(time=time, values=values[:, k], rates=rates[:, k]) for k in (slice(5), slice(5, 10), slice(10, 12))]
    trajectory = Trajectory(phase="descent", state=curve[0], costate=curve[1], control=curve[2])
    return Solution(
        problem=problem, method="scipy", outcome=Outcome.SOLVED, objective=-float(values[-1, 4]), free=free,
        trajectories=(trajectory,), unknowns=z,
    )  # fmt: skip


def resolve(problem: Problem, guess: Solution) -> Solution:
    """Re-solve a perturbed problem from a solution of a near one."""
    problem = problem.with_given(**{f.name: f.lower for f in problem.free if f.lower == f.upper})
    z = np.asarray(guess.unknowns)
    if "retro_delta_v" in problem.free_names and len(z) == 5:
        z = np.append(z, guess.parameters.retro_delta_v / problem.scales.of("m/s"))
    z = shoot(problem, z)
    _, thrust, exhaust, *_ = _constants(problem)
    free = {"flight_time": z[4] * problem.scales.time}
    if len(z) == 6:
        free["retro_delta_v"] = z[5] * problem.scales.of("m/s")
    start = problem.start(problem.parameters(free), NUMERIC)
    landed = start[4] / problem.scales.mass - thrust / exhaust * z[4]
    return Solution(
        problem=problem, method="scipy", outcome=Outcome.SOLVED, objective=-landed * problem.scales.mass,
        free=free, trajectories=guess.trajectories, unknowns=z,
    )  # fmt: skip
