"""Tables in machine code: read at a place among knots, with the numbers that the choices give."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest

from perilune.core import Table, Vector
from perilune.kernels import compile_arcs, compile_map
from perilune.kernels.algebra.program import hoist, trace_function


def table(knots: int, kind: Any = "smooth") -> Table:
    rng = np.random.default_rng(knots)
    x = np.cumsum(rng.uniform(0.1, 1.0, knots)) - 2.0
    return Table(x=tuple(x.tolist()), y=tuple(rng.normal(size=knots).tolist()), kind=kind)


def everywhere(of: Table) -> Vector:
    """Random places, knots and the numbers beside them, far beyond both ends, and what is not a number."""
    knots = np.array(of.x)
    inside = np.random.default_rng(1).uniform(knots[0] - 1, knots[-1] + 1, 200)
    odd = [math.inf, -math.inf, math.nan, 1e300, 0.0, -0.0]
    return np.concatenate([inside, knots, np.nextafter(knots, -np.inf), np.nextafter(knots, np.inf), odd])


def chosen(of: Table, side: int | None = None) -> ca.Function:
    """The table and its slope, and once more with another number, by choices."""
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    value = of.chosen(x, ca.if_else, side)
    return ca.Function("f", [x, p], [ca.vertcat(value, ca.gradient(value, x), of.chosen(x + p, ca.if_else, side))])


@pytest.mark.parametrize("kind", ["linear", "monotone", "smooth"])
@pytest.mark.parametrize("knots", [4, 5, 23, 100])
@pytest.mark.parametrize("side", [None, 1])
def test_a_table_is_read_with_the_numbers_of_its_choices(kind: str, knots: int, side: int | None) -> None:
    """To the last bit but for products that are fused with sums."""
    of = table(knots, kind)
    function = chosen(of, side if kind == "smooth" else None)
    x = everywhere(of)
    found = compile_map(function, backend="native")(x[:, None], np.array([[0.25]]))[0]
    with np.errstate(all="ignore"):
        expected = np.array(function.map(len(x))(x[None], np.full((1, len(x)), 0.25))).T
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13 * np.nanmax(np.abs(expected[:200])))


def test_choices_are_made_once_for_all_coefficients() -> None:
    """Two places, of x and of x + p, in place of hundreds of choices."""
    program = trace_function(chosen(table(60)))
    assert program.operations["read"] > 8 and program.operations["if_else_zero"] < 4  # beyond the last knot
    assert len({op[1] for op in program.instructions if op[0] == "read"}) == 2
    assert len(program.instructions) < 200
    few = trace_function(chosen(table(3, "linear")))
    assert few.operations["if_else_zero"] and not few.operations["read"]


def test_choices_that_are_no_table_are_left() -> None:
    """Knots that do not increase, different arguments, numbers that are not constant."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    falling, mixed, moving = ca.SX(1.0), ca.SX(1.0), ca.SX(1.0)
    for k in range(6):
        falling = ca.if_else(x >= -k, 2.0 + k, falling)
        mixed = ca.if_else((y if k == 3 else x) >= k, 2.0 + k, mixed)
        moving = ca.if_else(x >= k, 2.0 + k + y, moving)
    function = ca.Function("f", [x, y], [ca.vertcat(falling, mixed, moving)])
    assert not trace_function(function).operations["read"]
    points = np.random.default_rng(2).uniform(-7, 7, (50, 2))
    found = compile_map(function, backend="native")(points[:, :1].copy(), points[:, 1:].copy())[0]
    np.testing.assert_array_equal(found, np.array(function.map(50)(points[:, 0][None], points[:, 1][None])).T)


def test_a_table_of_a_parameter_is_read_once_for_an_arc() -> None:
    """It is handed over from the program that goes before."""
    x, p, of = ca.SX.sym("x"), ca.SX.sym("p"), table(12)
    program = trace_function(ca.Function("f", [x, p], [x * of.chosen(p, ca.if_else)]))
    before, during = hoist(program, 1)
    assert before.operations["read"] and not during.operations["read"]
    arc = compile_arcs(ca.Function("rhs", [x, p], [x * of.chosen(p, ca.if_else)])).dense(np.ones(1), np.zeros(1), 1.0)
    assert float(arc(1.0)[0]) == pytest.approx(math.exp(float(of(0.0))), rel=1e-11)
