"""Every operation against NumPy: values, the edges of the domain, the error in ulp."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from perilune.core import PeriluneError
from perilune.kernels.algebra.program import hoist, trace_function
from perilune.kernels.code.batch_map import compile_map

EDGES = np.array([0.0, -0.0, 1.0, -1.0, 0.5, -0.5, np.inf, -np.inf, np.nan, 5e-324, 2.3e-308, 1.7e308, -1.7e308])

# name: (CasADi's function, NumPy's, interval to sample, limit of the error in ulp); measured over 200 000
# points: sin 1.8, cos 2.0, tan 2.7, asin 2.0, acos 1.9, atan 1.6, sinh 1.6, cosh 1.4, tanh 1.3, exp 1.0, log
# 0.5
UNARY = {
    "sin": (ca.sin, np.sin, (-1e4, 1e4), 2.5),
    "cos": (ca.cos, np.cos, (-1e4, 1e4), 2.5),
    "tan": (ca.tan, np.tan, (-1.5, 1.5), 3.5),
    "asin": (ca.asin, np.arcsin, (-1, 1), 3.0),
    "acos": (ca.acos, np.arccos, (-1, 1), 3.0),
    "atan": (ca.atan, np.arctan, (-50, 50), 2.5),
    "sinh": (ca.sinh, np.sinh, (-5, 5), 3.5),
    "cosh": (ca.cosh, np.cosh, (-5, 5), 2.5),
    "tanh": (ca.tanh, np.tanh, (-5, 5), 3.0),
    "exp": (ca.exp, np.exp, (-700, 700), 1.5),
    "log": (ca.log, np.log, (1e-12, 1e6), 1.5),
    "sqrt": (ca.sqrt, np.sqrt, (0, 1e6), 0.5),
    "asinh": (ca.asinh, np.arcsinh, (-50, 50), 2.0),
    "acosh": (ca.acosh, np.arccosh, (1, 50), 2.0),
    "atanh": (ca.atanh, np.arctanh, (-0.99, 0.99), 2.0),
    "log1p": (ca.log1p, np.log1p, (-0.9, 50), 2.0),
    "expm1": (ca.expm1, np.expm1, (-5, 5), 2.0),
    "fabs": (ca.fabs, np.abs, (-9, 9), 0.0),
    "floor": (ca.floor, np.floor, (-9, 9), 0.0),
    "ceil": (ca.ceil, np.ceil, (-9, 9), 0.0),
    "sign": (ca.sign, np.sign, (-9, 9), 0.0),
}
BINARY = {
    "add": (lambda a, b: a + b, np.add),
    "sub": (lambda a, b: a - b, np.subtract),
    "mul": (lambda a, b: a * b, np.multiply),
    "div": (lambda a, b: a / b, np.divide),
    "atan2": (ca.atan2, np.arctan2),
    "pow": (lambda a, b: a**b, np.power),
    "hypot": (ca.hypot, np.hypot),
    "fmin": (ca.fmin, np.minimum),
    "fmax": (ca.fmax, np.maximum),
    "copysign": (ca.copysign, np.copysign),
    "lt": (lambda a, b: a < b, np.less),
    "le": (lambda a, b: a <= b, np.less_equal),
    "eq": (lambda a, b: a == b, np.equal),
    "ne": (lambda a, b: a != b, np.not_equal),
    "and": (ca.logic_and, np.logical_and),
    "or": (ca.logic_or, np.logical_or),
    "if_else_zero": (lambda a, b: ca.if_else(a > 0, b, 0), lambda a, b: np.where(a > 0, b, 0.0)),
}


def mapped(expression, arguments: int):
    pytest.importorskip("llvmlite")
    symbols = [ca.SX.sym(f"x{i}") for i in range(arguments)]
    evaluate = compile_map(ca.Function("f", symbols, [expression(*symbols)]), backend="native")
    return lambda *values: evaluate(*values)[0]


def ulps(value: np.ndarray, exact: np.ndarray) -> float:
    spacing = np.spacing(np.abs(exact.astype(float))).astype(np.longdouble)
    return float(np.max(np.abs(value.astype(np.longdouble) - exact) / spacing))


@pytest.mark.parametrize("name", UNARY)
def test_error_in_ulp(name: str) -> None:
    if np.finfo(np.longdouble).nmant <= 52:
        pytest.skip("no wider floating-point type to compare with")
    casadi, numpy, (low, high), limit = UNARY[name]
    x = np.random.default_rng(3).uniform(low, high, 20000)
    value = mapped(casadi, 1)(x[:, None])[:, 0]
    assert ulps(value, numpy(x.astype(np.longdouble))) <= limit


@pytest.mark.parametrize("name", UNARY)
def test_edges_of_one_argument(name: str) -> None:
    casadi, numpy, _, _ = UNARY[name]
    edges = EDGES[:-2] if name in ("sin", "cos", "tan") else EDGES  # beyond 2^19 they are the library's
    with np.errstate(all="ignore"):
        expected = numpy(edges)
    np.testing.assert_allclose(mapped(casadi, 1)(edges[:, None])[:, 0], expected, rtol=1e-15, atol=0)


@pytest.mark.parametrize("name", BINARY)
def test_two_arguments_at_values_and_edges(name: str) -> None:
    casadi, numpy = BINARY[name]
    values = np.concatenate([EDGES, np.random.default_rng(4).uniform(-3, 3, 40)])
    a, b = (grid.ravel() for grid in np.meshgrid(values, values))
    if name in ("and", "or"):
        keep = ~np.isnan(a) & ~np.isnan(b)
        a, b = a[keep], b[keep]
    with np.errstate(all="ignore"):
        expected = numpy(a, b).astype(float)
    result = mapped(casadi, 2)(a[:, None], b[:, None])[:, 0]
    np.testing.assert_allclose(result, expected, rtol=1e-15, atol=5e-324)


def test_large_angles_are_reduced_by_the_library() -> None:
    x = np.array([1e6, -3e9, 1e15, 1e300])
    np.testing.assert_allclose(mapped(ca.sin, 1)(x[:, None])[:, 0], np.sin(x), rtol=1e-15)


def test_angles_near_multiples_of_half_pi_keep_their_digits() -> None:
    x = np.arange(1, 4000) * (np.pi / 2)
    np.testing.assert_allclose(mapped(ca.cos, 1)(x[1::2][:, None])[:, 0], np.cos(x[1::2]), rtol=1e-15)
    np.testing.assert_allclose(mapped(ca.cos, 1)(x[::2][:, None])[:, 0], np.cos(x[::2]), rtol=2e-13)


@pytest.mark.parametrize("power", [-3, -1.5, -1, -0.5, 0.5, 1.5, 2, 3, 7, 16, 2.25, 17])
def test_constant_powers(power: float) -> None:
    x = np.random.default_rng(5).uniform(0.1, 4, 100)
    np.testing.assert_allclose(mapped(lambda a: a**power, 1)(x[:, None])[:, 0], x**power, rtol=4e-15)


def test_an_unknown_operation_is_named() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(PeriluneError, match="OP_ERF"):
        trace_function(ca.Function("f", [x], [ca.erf(x)]))


def test_a_function_that_is_not_sx_is_refused() -> None:
    x = ca.MX.sym("x")
    with pytest.raises(PeriluneError, match="only SX"):
        trace_function(ca.Function("f", [x], [x]))


def test_equal_operations_are_done_once_and_divisors_are_shared() -> None:
    x = ca.SX.sym("x", 4)
    program = trace_function(
        ca.Function("f", [x], [ca.vertcat(x[0] / x[3], x[1] / x[3], x[2] / x[3], x[0] * x[1] + x[1] * x[0])])
    )
    assert program.operations["div"] == 1
    assert program.operations["mul"] == 4  # three by the reciprocal, one product


def test_what_depends_on_parameters_alone_is_hoisted() -> None:
    z, p = ca.SX.sym("z"), ca.SX.sym("p", 2)
    before, during = hoist(trace_function(ca.Function("f", [z, p], [z * ca.sqrt(p[0] / p[1])])), 1)
    assert dict(before.operations) == {"div": 1, "sqrt": 1}
    assert dict(during.operations) == {"mul": 1}
