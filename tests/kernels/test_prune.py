"""What is dropped changes nothing, and can be had back."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from lander import DURATION, PARAMETERS, landing_rhs, start

from perilune.kernels import compile_arcs
from perilune.kernels.algebra.prune import prune
from perilune.words.outcome import PeriluneError


def test_the_planar_landing_loses_angle_and_costates_that_decouple() -> None:
    pruned = prune(landing_rhs(), [0, 2, 3], fixed={6: 0.0})
    assert pruned.kept == (0, 2, 3, 4, 5, 7, 8)
    assert pruned.dropped == (1, 9)
    assert pruned.constant == ()


def test_a_constant_of_motion_becomes_a_parameter() -> None:
    pruned = prune(landing_rhs(), [0, 2, 3])
    assert pruned.constant == (6,)
    assert pruned.rhs.size1_in(1) == len(PARAMETERS) + 1


def test_functions_say_what_they_need() -> None:
    z, p = ca.SX.sym("z", 10), ca.SX.sym("p", 3)
    pruned = prune(landing_rhs(), [ca.Function("wanted", [z, p], [z[1] - z[9] * p[0]])], fixed={6: 0.0})
    assert {1, 9} <= set(pruned.kept)
    assert pruned.dropped == ()


@pytest.mark.parametrize("fixed", [None, {6: 0.0}])
def test_the_result_is_the_same_to_rounding(backend: str, fixed: dict[int, float] | None) -> None:
    pruned, starts = prune(landing_rhs(), [0, 2, 3], fixed=fixed), start(6)
    z, p = pruned.reduce(starts, PARAMETERS)
    settings = {"fixed_steps": 12}  # the same steps for both: what differs is rounding
    small = compile_arcs(pruned.rhs, backend=backend).propagate(z, p, DURATION, **settings)
    whole = compile_arcs(landing_rhs(), backend=backend).propagate(starts, PARAMETERS, DURATION, **settings)
    np.testing.assert_allclose(small.z, whole.z[:, pruned.kept], rtol=0, atol=2e-14)


def test_the_dropped_are_recovered(backend: str) -> None:
    pruned, z0 = prune(landing_rhs(), [0, 2, 3], fixed={6: 0.0}), start(1)[0]
    z, p = pruned.reduce(z0, PARAMETERS)
    arc = compile_arcs(pruned.rhs, backend=backend).dense(z, p, DURATION)
    whole = compile_arcs(landing_rhs(), backend=backend).dense(z0, PARAMETERS, DURATION)
    np.testing.assert_allclose(pruned.restore(arc, z0, PARAMETERS), whole(arc.t), atol=3e-11)


def test_a_chain_of_quadratures(backend: str) -> None:
    z, p = ca.SX.sym("z", 3), ca.SX.sym("p")
    pruned = prune(ca.Function("chain", [z, p], [ca.vertcat(p, z[0], z[1])]), [0])
    arc = compile_arcs(pruned.rhs, backend=backend).dense([1.0], [2.0], 1.5)
    t = arc.t
    exact = np.column_stack([1 + 2 * t, 3 + t + t**2, 4 + 3 * t + t**2 / 2 + t**3 / 3])
    np.testing.assert_allclose(pruned.restore(arc, [1.0, 3.0, 4.0], [2.0]), exact, atol=1e-13)


def test_only_constants_of_motion_may_be_fixed() -> None:
    with pytest.raises(PeriluneError, match="not a constant of motion"):
        prune(landing_rhs(), [0], fixed={5: 0.0})


def test_entries_that_need_each_other_are_no_quadratures(backend: str) -> None:
    z, p = ca.SX.sym("z", 3), ca.SX.sym("p")
    pruned = prune(ca.Function("pair", [z, p], [ca.vertcat(-p * z[0], z[2], -z[1])]), [0])
    arc = compile_arcs(pruned.rhs, backend=backend).dense([1.0], [2.0], 1.0)
    with pytest.raises(PeriluneError, match="depend on one another"):
        pruned.restore(arc, [1.0, 0.0, 1.0], [2.0])
