"""Quadrature, differentiation and interpolation: exact where theory says so, and no further."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from perilune.core import PeriluneError
from perilune.direct.collocation import Polynomial, differentiation_matrix, interpolation_matrix, rule

SCHEMES = [("gauss", 1), ("radau", 2)]


def monomial_integral(k: int) -> float:
    return 0.0 if k % 2 else 2.0 / (k + 1)


@pytest.mark.parametrize("n", [2, 3, 5, 12, 40])
@pytest.mark.parametrize(("scheme", "short"), SCHEMES)
def test_quadrature_is_exact_to_its_degree_and_not_beyond(scheme, short, n):
    r = rule(scheme, n)
    exact_to = 2 * n - short
    for k in range(exact_to + 1):
        assert r.weights @ r.points**k == pytest.approx(monomial_integral(k), abs=2e-14)
    if n <= 5:
        # The remainder of x^(2n) is about 4^-n; in double precision it shows for small n only.
        assert abs(r.weights @ r.points ** (exact_to + 1) - monomial_integral(exact_to + 1)) > 1e-4


@pytest.mark.parametrize(("scheme", "polynomial"), [("gauss", (0.0, 1.0)), ("radau", (1.0, 1.0))])
def test_points_are_the_roots_that_define_them(scheme, polynomial):
    for n in (2, 7, 30):
        r = rule(scheme, n)
        coefficients = np.zeros(n + 1)
        coefficients[n - 1 :] = polynomial
        assert np.abs(np.polynomial.legendre.legval(r.points, coefficients)).max() < 1e-13
        assert (np.diff(r.support) > 0).all()


def test_known_three_point_rules():
    gauss, radau = rule("gauss", 3), rule("radau", 3)
    assert gauss.points == pytest.approx([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
    assert gauss.weights == pytest.approx([5 / 9, 8 / 9, 5 / 9])
    assert radau.points == pytest.approx([-1.0, (1 - np.sqrt(6)) / 5, (1 + np.sqrt(6)) / 5])
    assert radau.weights == pytest.approx([2 / 9, (16 + np.sqrt(6)) / 18, (16 - np.sqrt(6)) / 18])


@pytest.mark.parametrize("n", [2, 4, 20, 60])
@pytest.mark.parametrize("scheme", ["gauss", "radau"])
def test_differentiation_is_exact_on_polynomials(scheme, n):
    r = rule(scheme, n)
    values = np.polynomial.legendre.legval(r.support, np.eye(n + 1)[n])
    slopes = np.polynomial.legendre.legval(r.points, np.polynomial.legendre.legder(np.eye(n + 1)[n]))
    # The largest slope is n(n+1)/2; measured relative error 3e-13 at n = 60.
    assert np.abs(r.differentiation @ values - slopes).max() < 1e-11 * n * n
    assert np.abs(r.differentiation.sum(axis=1)).max() < 1e-10


def test_the_gauss_end_by_quadrature_is_the_polynomials_end():
    """Peng et al. (13) and extrapolation agree: D X = f implies X(1) = X(-1) + w.f."""
    r = rule("gauss", 9)
    x = np.cos(np.arange(10.0))
    end = interpolation_matrix(r.support, np.array([1.0])) @ x
    assert x[0] + r.weights @ (r.differentiation @ x) == pytest.approx(end[0], abs=1e-12)


@settings(max_examples=50, deadline=None)
@given(st.integers(2, 30), st.floats(-1.0, 1.0))
def test_interpolation_reproduces_values_and_constants(n, tau):
    points = rule("gauss", n).support
    rows = interpolation_matrix(points, np.array([tau, *points]))
    assert rows.sum(axis=1) == pytest.approx(np.ones(len(points) + 1))
    assert np.array_equal(rows[1:], np.eye(len(points)))


def test_spectral_convergence_of_interpolation_and_derivative():
    errors = []
    for n in (6, 12, 18):
        points = rule("radau", n).support
        p = Polynomial(points=points, values=np.exp(2 * points)[:, None])
        at = np.linspace(-1, 1, 101)
        errors.append(
            (
                np.abs(p(at)[:, 0] - np.exp(2 * at)).max(),
                np.abs(p.derivative(at)[:, 0] - 2 * np.exp(2 * at)).max(),
            )
        )
    assert errors[0][0] > 1e4 * errors[1][0] and errors[0][1] > 1e4 * errors[1][1]
    assert errors[2][0] < 1e-13 and errors[2][1] < 1e-11


def test_differentiation_matrix_order_two_by_hand():
    assert differentiation_matrix(np.array([-1.0, 0.0, 1.0])) == pytest.approx(
        np.array([[-1.5, 2.0, -0.5], [-0.5, 0.0, 0.5], [0.5, -2.0, 1.5]])
    )


def test_unknown_scheme_and_too_few_points_are_refused():
    with pytest.raises(PeriluneError, match=r"unknown collocation scheme[\s\S]*'lobatto'[\s\S]*'radau'"):
        rule("lobatto", 5)  # type: ignore[arg-type]
    with pytest.raises(PeriluneError, match=r"at least two collocation points[\s\S]*got: 1"):
        rule("gauss", 1)
