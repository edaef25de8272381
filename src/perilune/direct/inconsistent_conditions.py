"""Infeasibility messages: contradictory conditions before the solve, largest violations after it.

Before: a start or an end condition that depends on given numbers only and breaks a bound is a proof of
infeasibility, and cheap. After: the largest violations of the best iterate, each as a named condition in SI.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from perilune.core import InfeasibleError, PeriluneError, Vector, format_quantity
from perilune.direct.nlp import ProgramSolution, TranscribedProgram
from perilune.problem import (
    Problem,
    Unnumbered,
    Variable,
    at_start,
    between_bounds,
    canonical_given,
    refuse_impossible,
    scalars,
    state_scales,
    stating_keys,
    trace_at_end,
    trace_parameters,
)

# A bound is broken when it is exceeded by more than this part of the canonical unit; rounding stays far
# below.
SLACK = 1e-9


def check_consistent(problem: Problem) -> None:
    """Refuse bounds that contradict each other, the start or the end.

    Raises
    ------
    InfeasibleError
        Naming the bound and what breaks it, in SI.
    PeriluneError
        Of a bound that a free parameter holds.
    """
    p = problem.parameters({})
    for phase in problem.phases:
        bounded = [control for _, control in scalars(phase.controls)]
        for one in (*bounded, *phase.states, *phase.end_conditions):
            for side in ("lower", "upper"):
                if getattr(one, side) in problem.free_names:
                    raise PeriluneError(
                        f"{one.name} of {phase.name} has a free bound, which direct methods do not support",
                        got=f"{side} = {getattr(one, side)!r}, a free parameter",
                        expected="a number, or the name of a given parameter",
                        advice="use Indirect(), or an equivalent path condition",
                    )
    refuse_impossible([*between_bounds(problem, p), *at_start(problem, p)])
    function, ends = _states_fixed_by_ends(Unnumbered(problem))
    values = np.array(function(math.nan, canonical_given(problem))).ravel().tolist() if ends else []
    for end, value in zip(ends, values, strict=True):
        phase = problem.phases[end.phase]
        what = f"the end condition {phase.end_conditions[end.condition].name} of {phase.name} puts "
        _check_inside(what + phase.states[end.state].name, problem, phase.states[end.state], value, p)


class _Fixed(NamedTuple):
    """An end condition that is affine in one state, with known coefficients, and so fixes it."""

    phase: int
    condition: int
    state: int


@lru_cache(maxsize=32)
def _states_fixed_by_ends(unnumbered: Unnumbered) -> tuple[ca.Function, tuple[_Fixed, ...]]:
    """Return the end conditions that fix a state, which ranges do not, and the function of what they fix."""
    problem = unnumbered.problem
    p = trace_parameters(problem)
    values, found = list[ca.SX](), list[_Fixed]()
    for k, phase in enumerate(problem.phases):
        if not phase.end_conditions:
            continue
        x = ca.SX.sym("x", len(phase.states))
        unknown = ca.vertcat(x, p.free)
        conditions = trace_at_end(phase, x, p.record)
        for i, condition in enumerate(phase.end_conditions):
            slope = ca.jacobian(conditions[i], unknown)
            touched = slope.sparsity().get_triplet()[1]
            if condition.ranged or len(touched) != 1 or touched[0] >= x.numel() or ca.depends_on(slope, unknown):
                continue
            at_nothing = ca.substitute(conditions[i], unknown, ca.SX.zeros(unknown.numel()))
            values.append(-at_nothing / slope[touched[0]])
            found.append(_Fixed(k, i, touched[0]))
    return ca.Function("known", [p.free, p.given], [ca.vertcat(*values)]), tuple(found)


def _check_inside(what: str, problem: Problem, state: Variable, canonical: float, p: Any) -> None:
    (lower, upper), scale = state.limits(p), problem.size_of(state)
    value = canonical * scale
    over = max(lower - value, value - upper)
    if over > SLACK * scale:
        raise InfeasibleError(
            f"{what} outside its bounds",
            got=f"{value:.9g} {state.unit}, which is {over:.3g} {state.unit} outside",
            expected=f"between {lower:g} and {upper:g} {state.unit}",
            advice="widen the bound, or change the condition",
        )


def missed_conditions(program: TranscribedProgram, answer: ProgramSolution, slack: float) -> list[tuple[str, str]]:
    """Return every condition that an iterate misses and by how much in SI, the worst (in canonical units) first.

    Parameters
    ----------
    program, answer
        The program and its result.
    slack
        What may be missed, canonical.

    Returns
    -------
    list
        (name, miss with its unit) of each.
    """
    found: list[tuple[float, tuple[str, str]]] = []
    for (k, kind), residual in answer.residuals.items():
        names, scales = _row_names(program.problem, k, kind)
        if not len(residual):
            continue
        worst = residual.reshape(-1, len(names)).max(axis=0)
        for (name, unit), scale, violation in zip(names, scales, worst, strict=True):
            if not violation <= slack:
                found.append((float(violation), (name, format_quantity(violation * scale, unit, 4))))
    return [pair for _, pair in sorted(found, key=lambda pair: -pair[0])]


def _row_names(problem: Problem, k: int, kind: str) -> tuple[list[tuple[str, str]], Vector]:
    """Return (condition, unit) and SI size of each column of a kind of rows of phase k."""
    phase = problem.phases[k]
    if kind in ("start", "defect", "quadrature"):
        word = "the start of" if kind == "start" else "the dynamics of"
        return [(f"{word} {s.name} in {phase.name}", s.unit) for s in phase.states], state_scales(problem, phase)
    if kind == "direction":
        return [(f"unit length of a direction in {phase.name}", "1")], np.ones(1)
    conditions = getattr(phase, f"{kind}_conditions")
    keys = [stating_keys(problem, k, kind, row) for row in range(len(conditions))]
    names = [
        (f"the {kind} condition {phase.name}.{c.name}" + f" ({', '.join(stated)})" * bool(stated), c.unit)
        for c, stated in zip(conditions, keys, strict=True)
    ]
    return names, np.array([problem.size_of(c) for c in conditions])
