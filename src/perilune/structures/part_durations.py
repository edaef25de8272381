"""Names and durations of the parts of a phase, and the sums that stand in place of the user's durations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from perilune.problem.problem import Problem
from perilune.problem.tracing.lie_derivatives import run_expression
from perilune.problem.tracing.tape import Expression, Recorder
from perilune.problem.variables import FreeParameter
from perilune.structures.structure import Structure


def range_of_sum(of: FreeParameter) -> tuple[float, float]:
    """Return the range of a sum of durations that stands in place of a free one [s]."""
    return (of.lower if of.lower > 0 else -math.inf), of.upper  # none of the durations is negative


def part_name(name: str, j: int, count: int) -> str:
    """Return the name of the j-th of so many parts of a phase, or of its duration.

    Parameters
    ----------
    name
        Name of the phase, or of its duration.
    j
        Number of the part, from 0.
    count
        Number of the parts.
    """
    return name if count == 1 else f"{name}-{j + 1}"


def part_durations(problem: Problem, structure: Structure, k: int) -> tuple[str, ...]:
    """Return the names of the durations of the parts of phase k.

    Parameters
    ----------
    problem, structure
        The user's problem and its arcs.
    k
        Number of the phase.
    """
    count, name = len(structure.phases[k]), problem.phases[k].duration
    if count == 1:
        return (name,)
    shared = problem.duration_names.count(name) > 1
    own = f"{name}.{problem.phases[k].name}" if shared else name
    return tuple(part_name(own, j, count) for j in range(count))


def summed_durations(problem: Problem, structure: Structure) -> dict[str, int]:
    """Return free durations that are sums of new ones, each with the number of the phase whose parts it sums.

    Parameters
    ----------
    problem
        The user's problem.
    structure
        Arcs of each of its phases; a phase with several becomes as many parts.
    """
    found: dict[str, int] = {}
    for k, phase in enumerate(problem.phases):
        if phase.duration in problem.free_names and len(structure.phases[k]) > 1:
            found.setdefault(phase.duration, k)
    whole = {p.duration for p, arcs in zip(problem.phases, structure.phases, strict=True) if len(arcs) == 1}
    return {name: k for name, k in found.items() if name not in whole}


def sums_of(problem: Problem, structure: Structure) -> dict[str, tuple[str, ...]]:
    """Return free durations that are sums, with the names of the new ones that they sum.

    Parameters
    ----------
    problem
        The user's problem.
    structure
        Arcs of each of its phases; a phase with several becomes as many parts.
    """
    return {name: part_durations(problem, structure, k) for name, k in summed_durations(problem, structure).items()}


def sum_of_parameters(recorder: Recorder, names: Sequence[str]) -> Any:
    """Record the sum of some parameters.

    Parameters
    ----------
    recorder
        Tape that the additions are recorded on.
    names
        Names of the parameters, at least one.

    Returns
    -------
    Any
        The recorder's number of the sum.
    """
    total, *others = [recorder.input("p", name) for name in names]
    for other in others:
        total = recorder.do("add", total, other)
    return total


def with_sums(expression: Expression, sums: Mapping[str, Sequence[str]]) -> Expression:
    """Return an expression with sums of new durations in place of the user's.

    Parameters
    ----------
    expression
        Traced function of the user's problem.
    sums
        Names of the new durations by the name of the duration that they sum up to (`sums_of`).
    """
    inside = [name for name in sums if ("p", name) in expression.tape.instructions]
    if not inside:
        return expression
    recorder = Recorder()
    values = run_expression(
        expression, recorder, {("p", name): sum_of_parameters(recorder, sums[name]) for name in inside}
    )
    return Expression(recorder.tape(values), expression.roles, expression.scalar, expression.origin)
