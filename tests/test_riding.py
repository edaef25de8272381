"""The best thrust along a condition: against every direction of a fine sample of the sphere."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from perilune.conditions.riding import riding


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


@pytest.mark.parametrize("held", [False, True], ids=["free", "held"])
def test_no_direction_is_better(held: bool) -> None:
    """Where a size of the right sign exists, none of 200 000 directions has a lower H, and the condition is held."""
    d, s, rng, found = ca.SX.sym("d", 3), ca.SX.sym("s"), np.random.default_rng(4), 0
    for _ in range(60):
        g, b, axis = rng.normal(size=(3, 3))
        a, k, share = rng.normal(), rng.normal() + 1.0, rng.uniform(-0.9, 0.9)
        axis /= np.linalg.norm(axis)
        H, c = s * (ca.dot(g, d) + k) + 0.7, a + s * ca.dot(b, d)
        law = riding(H, d, s, c, [2.0 * ca.dot(axis, d) - 2.0 * share] if held else [])
        assert law is not None
        best, size = (np.array(ca.evalf(e)).ravel() for e in law)
        every = every_held(axis, share, 200_001) if held else every_direction(200_000)
        with np.errstate(divide="ignore"):
            sizes = -a / (every @ b)
        values = np.where(sizes > 0, sizes * (every @ g + k), np.inf)
        if not (np.isfinite(size).all() and size[0] > 0):
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
    assert riding(plain + s**2, d, s, 1.0 - s * d[1], []) is None
    assert riding(plain, d, s, 1.0 - s * d[1] + s, []) is None
    assert riding(plain + d[2], d, s, 1.0 - s * d[1], []) is None
