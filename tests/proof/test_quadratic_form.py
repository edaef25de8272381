"""Extent and Newton gain of a quadratic form under conditions, beside generalised eigenvalues and linear systems."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh, null_space

from perilune.proof.sufficient.quadratic_form import QuadraticForm, destabilising_eigenvalue, newton_gain


@pytest.mark.parametrize(
    ("size", "conditions", "m"), [(6, 0, 0), (6, 2, 0), (6, 0, 2), (30, 5, 3), (30, 8, 1), (9, 2, 5)]
)
def test_form_beside_other_methods(size: int, conditions: int, m: int) -> None:
    """Conditions of which one is said twice change neither; parameters cost nothing by the measure."""
    rng = np.random.default_rng(size + conditions + m)
    root = rng.normal(size=(size, size))
    form, slope = root @ root.T + 0.1 * np.eye(size), rng.normal(size=size)
    constraints = rng.normal(size=(conditions, size))
    said_twice = np.vstack([constraints, constraints[:1] - constraints[-1:]])
    free = null_space(constraints) if conditions else np.eye(size)
    measure = free[m:].T @ free[m:]
    kappa, count = destabilising_eigenvalue(form, said_twice, m)
    assert count == size - conditions
    assert kappa == pytest.approx(1 - 1 / eigh(measure, free.T @ form @ free, eigvals_only=True)[-1], rel=1e-9)
    step = np.linalg.solve(free.T @ form @ free, free.T @ slope)
    gain = 0.5 * float(step @ free.T @ slope)
    assert newton_gain(QuadraticForm(form, said_twice, slope, m)) == pytest.approx(gain, rel=1e-9)


def test_form_that_is_none_of_a_minimum() -> None:
    """Beyond 1 where a control gains, infinite where a parameter by itself does, and NaN where that costs nothing."""
    none = np.zeros((0, 3))
    assert destabilising_eigenvalue(np.diag([2.0, -0.5, 1.0]), none, 1)[0] == pytest.approx(1.5)
    assert destabilising_eigenvalue(np.diag([-1.0, 1.0, 1.0]), none, 1)[0] == np.inf
    assert np.isnan(destabilising_eigenvalue(np.diag([0.0, 1.0, 1.0]), none, 1)[0])
    assert destabilising_eigenvalue(np.diag([-1.0, 1.0, 1.0]), np.eye(1, 3), 1) == (pytest.approx(0.0), 2)
