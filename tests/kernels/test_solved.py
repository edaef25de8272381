"""Modes whose control an iteration finds: the columns are those of the exact control, the iteration is not derived."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from perilune.core import PeriluneError
from perilune.kernels import ArcStatus, Event, compile_arcs


def implicit(steps: int = 6) -> tuple[ca.Function, ca.Function]:
    """z' = u where u minimises cosh(u) + z u, so u = -asinh(z/p) with p = 1; found by Newton from u = -z/(1 + |z|)."""
    z, p, w = ca.SX.sym("z"), ca.SX.sym("p"), ca.SX.sym("w")
    u = -z / (1 + ca.fabs(z))
    for _ in range(steps):
        u = u - (ca.sinh(u) + z / p) / ca.cosh(u)
    closing = w - (ca.sinh(w) + z / p) / ca.cosh(w)
    return ca.Function("mode", [z, ca.vertcat(p, w)], [closing]), ca.Function("solved", [z, p], [u])


def explicit() -> ca.Function:
    z, p = ca.SX.sym("z"), ca.SX.sym("p")
    return ca.Function("mode", [z, p], [-ca.asinh(z / p)])


def test_columns_are_those_of_the_minimiser(backend: str) -> None:
    """Of z' = f(z) the derivative of the end by the start is f(end)/f(start)."""
    mode, solved = implicit()
    starts = np.array([[0.3], [-1.5], [2.0], [0.01], [1.0]])
    arcs = compile_arcs(mode, columns=1, solved=[solved], backend=backend).propagate(starts, [1.0], 1.7, np.eye(1))
    assert np.all(arcs.status == ArcStatus.REACHED)
    np.testing.assert_allclose(arcs.rates, -np.arcsinh(arcs.z), rtol=0, atol=1e-14)
    np.testing.assert_allclose(arcs.columns[:, 0], arcs.rates / -np.arcsinh(starts), rtol=1e-10)
    exact = compile_arcs(explicit(), columns=1, backend=backend).propagate(starts, [1.0], 1.7, np.eye(1))
    np.testing.assert_allclose(arcs.z, exact.z, rtol=0, atol=1e-12)


def test_a_coarse_iteration_is_not_what_is_derived(backend: str) -> None:
    """With w held, z' = w has no derivative by z, whatever w does: the columns stay as they were."""
    z, p, w = ca.SX.sym("z"), ca.SX.sym("p"), ca.SX.sym("w")
    held = ca.Function("held", [z, ca.vertcat(p, w)], [w])
    arcs = compile_arcs(held, columns=1, solved=[implicit()[1]], backend=backend).propagate([1.0], [1.0], 1.0, [[3.0]])
    assert arcs.columns[0, 0, 0] == 3.0
    assert abs(arcs.z[0, 0] - 1.0) > 0.5


def test_the_curve_of_a_solved_mode(backend: str) -> None:
    mode, solved = implicit()
    arc = compile_arcs(mode, solved=[solved], backend=backend).dense([2.0], [1.0], 1.5)
    exact = compile_arcs(explicit(), backend=backend)
    for t in (0.2, 0.9, 1.5):
        np.testing.assert_allclose(arc(t), exact.propagate([2.0], [1.0], t).z[0], atol=1e-10)


def test_saltation_between_a_solved_and_a_plain_mode(backend: str) -> None:
    """Below z = 1 the fall is z' = -2p; above it that of the minimiser. Both ways of stating it end alike."""
    z, p = ca.SX.sym("z"), ca.SX.sym("p")
    plain, (mode, solved) = ca.Function("plain", [z, p], [-2 * p]), implicit()
    event = Event(function=ca.Function("g", [z, p], [z - 1]), direction=-1, switches={1: 0})
    one, two = (
        compile_arcs([plain, upper], columns=1, events=[event], solved=laws, backend=backend).propagate(
            [[2.0], [1.5]], [[1.0], [1.2]], 1.5, np.eye(1), mode=1
        )
        for upper, laws in ((mode, [None, solved]), (explicit(), []))
    )
    assert list(one.mode) == [0, 0]
    np.testing.assert_allclose(one.event_time[:, 0], two.event_time[:, 0], atol=1e-12)
    np.testing.assert_allclose(one.z, two.z, atol=1e-12)
    np.testing.assert_allclose(one.columns, two.columns, rtol=1e-11)
    np.testing.assert_allclose(one.columns[0, 0, 0], 2.0 / np.arcsinh(2.0), rtol=1e-10)  # f(end)/f(start)


def test_what_is_solved_for_is_part_of_the_key() -> None:
    mode, solved = implicit(6)
    systems = [compile_arcs(mode, solved=[law], backend="native").system for law in (solved, implicit(5)[1])]
    assert systems[0].key != systems[1].key
    assert systems[0].np == 1


def test_laws_that_do_not_fit_are_refused() -> None:
    mode, solved = implicit()
    with pytest.raises(PeriluneError, match="each mode states"):
        compile_arcs(mode, solved=[solved, None])
    z, p = ca.SX.sym("z", 2), ca.SX.sym("p")
    with pytest.raises(PeriluneError, match="a z or p of another shape"):
        compile_arcs(mode, solved=[ca.Function("law", [z, p], [z[0]])])
