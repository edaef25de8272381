"""What physics allows of the points of a region, asked at every query: as machine code where it can be traced."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import reduce
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.kernels import compile_map
from perilune.problem.preflight import possible, preflight
from perilune.problem.problem import Problem
from perilune.problem.symbolic import SYMBOLIC
from perilune.words.types import Matrix

Allowed = Callable[[Matrix], NDArray[np.bool_]]


def allowed(problem: Problem, names: Sequence[str]) -> Allowed:
    """Whether no binding comparison of a problem is missed at values [SI] of some parameters, (points, d) -> (points,).

    There may be extremals of others all the same: of a parking orbit below its perilune equations know nothing.
    """
    if problem.preflight is None:
        return lambda points: np.ones(len(points), dtype=bool)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of NumPy's functions CasADi warns, and has its own idea of what they mean
            passed = _traced(problem, names)
    except Exception:  # whatever a user's own comparisons, which may use NumPy alone, make of symbols
        return lambda points: _compared(problem, dict(zip(names, points.T, strict=True)), len(points))
    mapped, given = compile_map(passed), np.array([[own.value for own in problem.given.values()]])
    return lambda points: mapped(points, given)[0][:, 0] > 0.0


def _compared(problem: Problem, over: dict[str, NDArray[np.float64]], count: int) -> NDArray[np.bool_]:
    return np.broadcast_to(possible(preflight(problem, over)), count)


def _traced(problem: Problem, names: Sequence[str]) -> ca.Function:
    """(values of the parameters, all that is given) -> 1 where physics allows it and else 0.

    What does not vary is a symbol too: CasADi takes 0 times anything for 0, and NaN would pass.
    """
    assert problem.preflight is not None
    point, given = ca.SX.sym("point", len(names)), ca.SX.sym("given", len(problem.given))
    values = {name: given[i] for i, name in enumerate(problem.given)}
    values |= {name: point[i] for i, name in enumerate(names)}
    found = problem.preflight(SimpleNamespace(**values), SYMBOLIC)
    passed = reduce(ca.logic_and, (f.passed for f in found if f.binding), ca.SX(1))
    return ca.Function("allowed", [point, given], [passed])
