"""What is dropped changes nothing."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from lander import DURATION, PARAMETERS, landing_rhs, start

from perilune.core import PeriluneError
from perilune.kernels import compile_arcs
from perilune.kernels.algebra.prune import prune


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
    p = np.hstack([np.tile(PARAMETERS, (6, 1)), starts[:, pruned.constant]])
    settings = {"fixed_steps": 12}  # the same steps for both: what differs is rounding
    small = compile_arcs(pruned.rhs, backend=backend).propagate(starts[:, pruned.kept], p, DURATION, **settings)
    whole = compile_arcs(landing_rhs(), backend=backend).propagate(starts, PARAMETERS, DURATION, **settings)
    np.testing.assert_allclose(small.z, whole.z[:, pruned.kept], rtol=0, atol=2e-14)


def test_only_constants_of_motion_may_be_fixed() -> None:
    with pytest.raises(PeriluneError, match="not a constant of motion"):
        prune(landing_rhs(), [0], fixed={5: 0.0})
