"""The best thrust along a condition: against every direction of a fine sample of the sphere."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from perilune.conditions.boundary_arc_control import boundary_arc_optimum
from perilune.conditions.canonical_equations import (
    canonical_equations,
    extremal_parameters,
    hamiltonian_at,
    limit_symbols,
)
from perilune.models import Approach, UniformGravity, Vehicle, precision_landing
from perilune.models.precision.path_constraints import NONE
from perilune.problem import trace_parameters
from perilune.structures import Arc, Structure
from perilune.structures.multiphase import restate


def every_direction(count: int) -> np.ndarray:
    """Directions spread evenly over the sphere (Fibonacci)."""
    i = np.arange(count) + 0.5
    up, turn = 1 - 2 * i / count, np.pi * (1 + np.sqrt(5.0)) * i
    return np.stack([np.sqrt(1 - up**2) * np.cos(turn), np.sqrt(1 - up**2) * np.sin(turn), up], axis=1)


def every_held(axis: np.ndarray, share: float, count: int) -> np.ndarray:
    """Directions with axis . d = share."""
    one = np.cross(axis, [0.3, -0.5, 0.9])
    one /= np.linalg.norm(one)
    other, turn = np.cross(axis, one), np.linspace(0, 2 * np.pi, count)[:, None]
    return share * axis + np.sqrt(1 - share**2) * (np.cos(turn) * one + np.sin(turn) * other)


def test_what_two_more_conditions_hold_has_no_closed_form() -> None:
    """With one more there is; the second would not be held."""
    d, size = ca.SX.sym("d", 3), ca.SX.sym("size")
    asked = size * (d[0] - 2.0 * d[1]), d, size, size * d[2] - 1.0
    assert boundary_arc_optimum(*asked, [d[0] - 0.1]) is not None
    assert boundary_arc_optimum(*asked, [d[0] - 0.1, d[1] - 0.2]) is None


@pytest.mark.parametrize("held", [False, True], ids=["free", "held"])
def test_no_direction_is_better(held: bool) -> None:
    """Where a size of the right sign exists, none of 200 000 directions has a lower H, and the condition is held."""
    d, s, rng, found = ca.SX.sym("d", 3), ca.SX.sym("s"), np.random.default_rng(4), 0
    for _ in range(60):
        g, b, axis = rng.normal(size=(3, 3))
        a, k, share = rng.normal(), rng.normal() + 1.0, rng.uniform(-0.9, 0.9)
        axis /= np.linalg.norm(axis)
        H, c = s * (ca.dot(g, d) + k) + 0.7, a + s * ca.dot(b, d)
        law = boundary_arc_optimum(H, d, s, c, [2.0 * ca.dot(axis, d) - 2.0 * share] if held else [])
        assert law is not None
        best, size, room = (np.array(ca.evalf(e)).ravel() for e in law)
        every = every_held(axis, share, 200_001) if held else every_direction(200_000)
        with np.errstate(divide="ignore"):
            sizes = -a / (every @ b)
        values = np.where(sizes > 0, sizes * (every @ g + k), np.inf)
        if not (room.min() >= 0 and np.isfinite(size).all() and size[0] > 0):
            # None exists, or H falls without end towards directions that hardly act.
            assert values.min() == np.inf or values.min() < -50 or sizes[np.argmin(values)] > 50
            continue
        found += 1
        assert np.linalg.norm(best) == pytest.approx(1.0, abs=1e-12)
        assert a + size[0] * (b @ best) == pytest.approx(0.0, abs=1e-12)
        assert not held or axis @ best == pytest.approx(share, abs=1e-12)
        reached = size[0] * (g @ best + k)
        assert values.min() - 1e-3 * abs(reached) - 1e-3 <= reached <= values.min() + 1e-12
    assert found > 20


def test_another_form_is_left_to_newton() -> None:
    """A drag that grows with the square of the size, or a condition that the size alone moves too."""
    d, s = ca.SX.sym("d", 3), ca.SX.sym("s")
    plain = s * (d[0] + 1.0)
    assert boundary_arc_optimum(plain + s**2, d, s, 1.0 - s * d[1], []) is None
    assert boundary_arc_optimum(plain, d, s, 1.0 - s * d[1] + s, []) is None
    assert boundary_arc_optimum(plain + d[2], d, s, 1.0 - s * d[1], []) is None


@pytest.mark.parametrize("throttle", [(0.4, 0.9), (0.6, 0.9)], ids=["floor too low to hover", "floor that can"])
def test_what_cannot_hold_the_condition_is_no_law_and_leaves_no_nan(throttle: tuple[float, float]) -> None:
    """Along the ground one of three laws holds the height; derivatives of H are its own, not 0 times a NaN of another.

    At a thrust of twice the weight a throttle of 0.4 cannot hover; one of 0.6 can, at another direction than 0.9.
    """
    lander = Vehicle(mass=1000.0, thrust=2000.0, specific_impulse=300.0)
    approach = Approach(east=-300.0, north=40.0, up=100.0, east_speed=5.0, north_speed=0.0, up_speed=-5.0)
    plain = precision_landing(lander, approach, None, NONE, throttle, UniformGravity(gravity=1.0))
    along = Arc(along=("height_above_site",), until=60.0)
    problem = restate(plain, Structure(((Arc(until=30.0), along),)), repeated=False)
    p = trace_parameters(problem)
    symbols, limits = limit_symbols(problem, p)
    numbers = ca.vertcat(p.given, symbols, ca.SX.sym("offset", 7))
    ride = canonical_equations(problem.phases[1], p, limits[1], numbers, problem.free_names)
    z, values = ca.SX.sym("z", 14), extremal_parameters(problem)
    H = hamiltonian_at(ride, z, numbers)
    told = ca.Function("H", [z, numbers], [H, ca.gradient(H, z), ride.mode(z, numbers)])
    scales = np.array([problem.scales.of(state.unit) for state in problem.phases[1].states])
    x = np.array([-100.0, 10.0, 0.0, 8.0, -1.0, 0.0, 950.0]) / scales
    at = np.concatenate([x, [-0.1, 0.02, 0.0, -0.3, 0.1, -0.8, -0.9]])
    slope, mode = np.array(told(at, values)[1]).ravel(), int(told(at, values)[2])
    differences = [
        (float(told(at + step, values)[0]) - float(told(at - step, values)[0])) / 2e-6 for step in 1e-6 * np.eye(14)
    ]
    assert np.isfinite(np.array(ride.modes[mode](at, values))).all()
    assert slope == pytest.approx(differences, abs=1e-8)
    rates = np.array([np.array(rate(at, values)).ravel() for rate in ride.modes])
    hover = ride.regimes.index(("lower",))
    assert np.isnan(rates[hover]).any() == (throttle[0] < 0.5)
