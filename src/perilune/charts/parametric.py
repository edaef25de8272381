"""Problem with some given parameters freed and held, so that its extremals come with derivatives by them.

A parameter that is in the dynamics is a constant state then, and its costate an unknown. Where the canonical unit of
one is far from its range (an area next to the square of a planet's radius), that costate would be so large or so small
that nothing else counted: it is replaced by its share of a size, which is given.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from perilune.problem import Expression, FreeParameter, Parameter, Problem, Recorder, run_expression, scalars

_FAR = 1e4  # canonical: a range that is so much wider or narrower than 1 has a size of its own


def parametric_problem(problem: Problem, names: Sequence[str], sizes: Mapping[str, float]) -> Problem:
    """Return the problem with these parameters free without bounds; other free ones keep their places before them.

    Parameters
    ----------
    problem, names
        Which parameters of which problem.
    sizes
        Of those that are shares of a size (`sizes_of`), these [SI].
    """
    given = {name: g for name, g in problem.given.items() if name not in names}
    units = {name: problem.unit_of(name) for name in names}
    new = tuple(
        FreeParameter(name=n, unit="1", guess=g.value / sizes[n])
        if n in sizes
        else FreeParameter(name=n, unit=g.unit, guess=g.value)
        for n in names
        if (g := problem.given.get(n)) is not None
    )
    free = tuple(replace(f, lower=-math.inf, upper=math.inf) if f.name in names else f for f in problem.free)
    if not sizes:
        return problem.changed(given=MappingProxyType(given), free=(*free, *new), parameter_bounds=None, form=None)
    given |= {_size_name(name): Parameter(value=size, unit=units[name]) for name, size in sizes.items()}
    shares = {key: _with_shares(e, sizes) for key, e in problem.form.expressions.items()}
    stated = problem.stated_by(shares)
    return stated.changed(given=MappingProxyType(given), free=(*free, *new), parameter_bounds=None, form=None)


def sizes_of(problem: Problem, names: Sequence[str], widths: Sequence[float]) -> dict[str, float]:
    """Return sizes [SI] for parameters whose ranges are far from 1 in canonical units.

    A parameter that is a limit itself has none, as it is read by its name.

    Parameters
    ----------
    problem
        The problem.
    names
        Names of parameters.
    widths
        Widths of their ranges [SI], in the same order.

    Returns
    -------
    dict
        Size [SI] by name, of given parameters that need one.
    """
    limits = {
        limit
        for phase in problem.phases
        for c in (*phase.states, *phase.end_conditions, *(c for _, c in scalars(phase.controls)))
        for limit in (c.lower, c.upper)
    }
    found = dict[str, float]()
    for name, width in zip(names, widths, strict=True):
        canonical = width / problem.scales.of(problem.unit_of(name))
        if name in problem.given and name not in limits and not 1 / _FAR <= canonical <= _FAR:
            found[name] = float(width)
    return found


def _size_name(name: str) -> str:
    return f"size_of_{name}"


def _with_shares(expression: Expression, sizes: Mapping[str, float]) -> Expression:
    """Return an expression with a share times a size in place of a parameter."""
    inside = [name for name in sizes if ("p", name) in expression.tape.instructions]
    if not inside:
        return expression
    recorder = Recorder()
    values: list[Any] = run_expression(
        expression,
        recorder,
        {("p", n): recorder.do("mul", recorder.input("p", n), recorder.input("p", _size_name(n))) for n in inside},
    )
    return Expression(recorder.tape(values), expression.roles, expression.scalar, expression.origin)
