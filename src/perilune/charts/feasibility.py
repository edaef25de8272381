"""Presolve checks at the points of a region, at every query: as machine code if they can be traced."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.core import Matrix
from perilune.kernels import compile_map
from perilune.problem import SYMBOLIC, Expression, Problem, Recorder, between_bounds, is_possible, preflight

Allowed = Callable[[Matrix], NDArray[np.bool_]]

_LEAVING = {"p", "div", "pow", "sqrt", "log", "exp", "asin", "acos", "tan", "sinh", "cosh"}  # the numbers, from numbers


def point_feasibility(problem: Problem, names: Sequence[str]) -> Allowed:
    """Build the test, (points, d) -> (points,), if all binding comparisons of a problem hold at parameter values [SI].

    Extremals may exist where it fails: the equations know nothing of a parking orbit below its perilune.

    Parameters
    ----------
    problem
        The problem.
    names
        Names of the parameters that vary, d of them.
    """
    if problem.preflight is None and not between_bounds(problem, problem.parameters({})):
        return lambda points: np.ones(len(points), dtype=bool)
    try:
        traced = _traced_comparisons(problem, names)
    except Exception:  # whatever a user's own comparisons, which may use NumPy only, make of symbols
        return lambda points: _compare_at_points(problem, names, points)
    mapped, given = compile_map(traced), np.array([[own.value for own in problem.given.values()]])

    def asked(points: Matrix) -> NDArray[np.bool_]:
        found = mapped(points, given)[0][:, 0] > 0.0
        if not found.all():
            found[~found] = _compare_at_points(problem, names, points[~found])
        return found

    return asked


def _compare_at_points(problem: Problem, names: Sequence[str], points: Matrix) -> NDArray[np.bool_]:
    return np.broadcast_to(is_possible(preflight(problem, dict(zip(names, points.T, strict=True)))), len(points))


def _traced_comparisons(problem: Problem, names: Sequence[str]) -> ca.Function:
    """Build (values of the parameters, all given) -> 1 where physics surely allows it; other points have to be asked.

    CasADi takes 0 times anything for 0, x/x for 1 and the square of a root for its argument, where the stated formula
    gives NaN and allows nothing. So the result is sure if no function on the way leaves the numbers and no divisor is
    0; constants are symbols too.
    """
    recorder = Recorder()
    symbols = SimpleNamespace(**{name: recorder.input("p", name) for name in problem.given})
    symbols.__dict__.update({name: recorder.input("p", name) for name in names})
    stated = () if problem.preflight is None else problem.preflight(symbols, recorder.namespace)
    found = [f for f in (*stated, *between_bounds(problem, symbols)) if f.binding]
    tape = recorder.tape([side for f in found for side in (f.value, f.limit)])
    point, given = ca.SX.sym("point", len(names)), ca.SX.sym("given", len(problem.given))
    values = {name: given[i] for i, name in enumerate(problem.given)}
    values |= {name: point[i] for i, name in enumerate(names)}
    all_of_it = Expression(replace(tape, outputs=tuple(range(len(tape.instructions)))), ("p",))
    way = [ca.SX(value) for value in all_of_it(SimpleNamespace(**values), SYMBOLIC)]
    sides = [way[k] for k in tape.outputs]
    pairs = zip(found, sides[::2], sides[1::2], strict=True)
    passed = [replace(f, value=value, limit=limit).passed for f, value, limit in pairs]
    sound = [
        ca.fabs(way[op[2]]) > 0.0 if op[0] == "div" else ca.fabs(value) <= sys.float_info.max
        for op, value in zip(tape.instructions, way, strict=True)
        if op[0] in _LEAVING
    ]
    return ca.Function("allowed", [point, given], [reduce(ca.logic_and, [*passed, *sound], ca.SX(1))])
