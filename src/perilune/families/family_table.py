"""MemberTable: the members of a family, or the points of a batch, as columns; tables and figures are made of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from perilune.charts import PointSolver
from perilune.core import Matrix, Vector
from perilune.families.batch import Batch
from perilune.families.family import Family
from perilune.io import display_unit
from perilune.problem import Problem, Result, Solution, Variable


@dataclass(frozen=True, kw_only=True)
class MemberColumn:
    """Quantity of all members with its values, (members,); `label` is its name on axes where that is another."""

    name: str
    unit: str
    description: str
    label: str
    values: Vector


@dataclass(frozen=True, kw_only=True)
class MemberTable:
    """Columns of all members in SI, in the order of the request; NaN where a member has no solution.

    Parameters
    ----------
    problem, parameters, values
        What was varied, along which parameters, and their values [SI], (members, d).
    results, free
        Results, and free parameters, (members,) each.
    given
        Given parameters that are the same in all members, one value each.
    solved
        True where a member has a solution, (members,).
    outcomes, levels
        Name of the outcome and verification level of each.
    tolerances, messages
        Part of a stated tolerance that its proof needed, and why it has no solution, in words; empty for none.
    interrupted, notes
        As of the family.
    """

    problem: Problem
    parameters: tuple[str, ...]
    values: Matrix
    results: Sequence[MemberColumn]
    free: Sequence[MemberColumn]
    given: Sequence[MemberColumn]
    solved: NDArray[np.bool_]
    outcomes: Sequence[str]
    levels: Sequence[int]
    tolerances: Sequence[str]
    messages: Sequence[str]
    interrupted: bool
    notes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.values)

    @property
    def axes(self) -> list[MemberColumn]:
        """Return the columns of the parameters."""
        return [
            _member_column(name, Variable(name=name, unit=self.problem.unit_of(name)), self.values[:, k])
            for k, name in enumerate(self.parameters)
        ]

    @property
    def quantities(self) -> list[MemberColumn]:
        """Return results and free parameters; one with the name of a parameter has ``_result`` appended."""
        named = {c.name: c for c in (*self.free, *self.results)}  # a result has precedence
        ordered = [named[name] for name in dict.fromkeys(c.name for c in (*self.results, *self.free))]
        return [replace(c, name=f"{c.name}_result") if c.name in self.parameters else c for c in ordered]

    @cached_property
    def grid(self) -> NDArray[np.int64] | None:
        """Return the numbers of the members as a grid, each axis in the order of the request; None if they are none."""
        rows = [tuple(row) for row in self.values.tolist()]
        places = [{value: i for i, value in enumerate(dict.fromkeys(column))} for column in zip(*rows, strict=True)]
        shape = tuple(map(len, places))
        if not rows or math.prod(shape) != len(rows) or len(set(rows)) < len(rows):
            return None
        placed = np.empty(shape, dtype=np.int64)
        for number, row in enumerate(rows):
            placed[tuple(place[value] for place, value in zip(places, row, strict=True))] = number
        return placed


def member_table(found: Family | Batch | MemberTable) -> MemberTable:
    """Return the table of a family or of a batch; a table is returned as it is."""
    if isinstance(found, MemberTable):
        return found
    return _family_table(found) if isinstance(found, Family) else _batch_table(found)


def _family_table(family: Family) -> MemberTable:
    points, solutions = family.points, [p.solution for p in family.points if p.solution is not None]
    about = {name: result for s in solutions for name, result in s.results.items()}
    free = {name: _chosen(s.problem, name) for s in solutions for name in s.free}

    def column(name: str, of: Result | Variable, read: Callable[[Solution, str], float]) -> MemberColumn:
        return _member_column(name, of, [math.nan if p.solution is None else read(p.solution, name) for p in points])

    return MemberTable(
        problem=family.problem, parameters=family.parameters,
        values=np.array([p.values for p in points], dtype=float).reshape(len(points), len(family.parameters)),
        results=[column(name, result, _result_value) for name, result in about.items()],
        free=[column(name, variable, lambda s, name: s.free.get(name, math.nan)) for name, variable in free.items()],
        given=_given_columns([s.problem for s in solutions] or [family.problem], family.parameters),
        solved=np.array([p.solution is not None for p in points], dtype=bool),
        outcomes=[p.outcome.name for p in points],
        levels=[p.solution.verification.level if p.solution is not None else 0 for p in points],
        tolerances=[p.tolerance_used for p in points], messages=[p.message for p in points],
        interrupted=family.interrupted, notes=family.notes,
    )  # fmt: skip


def _batch_table(batch: Batch) -> MemberTable:
    problem, about = batch.problem, PointSolver.end_results(batch.problem)
    free = {name: _chosen(problem, name) for name in batch.free}
    return MemberTable(
        problem=problem, parameters=batch.parameters, values=batch.values,
        results=[_member_column(name, about[name], column) for name, column in batch.results.items()],
        free=[_member_column(name, free[name], column) for name, column in batch.free.items()],
        given=_given_columns([problem], batch.parameters),
        solved=batch.solved, outcomes=batch.outcomes.tolist(), levels=batch.levels.tolist(),
        tolerances=[""] * len(batch), messages=batch.messages, interrupted=batch.interrupted, notes=batch.notes,
    )  # fmt: skip


def _given_columns(problems: Sequence[Problem], varied: Sequence[str]) -> list[MemberColumn]:
    """Return the given parameters that are not varied and equal in all problems."""
    return [
        _member_column(name, Variable(name=name, unit=given.unit), [given.value])
        for name, given in problems[0].given.items()
        if name not in varied
        and all(name in problem.given and problem.given[name].value == given.value for problem in problems)
    ]


def _chosen(problem: Problem, name: str) -> Variable:
    return Variable(name=name, unit=problem.unit_of(name), description="chosen")


def _result_value(solution: Solution, name: str) -> float:
    result = solution.results.get(name)
    return math.nan if result is None else float(result.value)


def _member_column(name: str, of: Variable | Result, values: Sequence[float] | Vector) -> MemberColumn:
    values = np.asarray(values, dtype=float)
    return MemberColumn(name=name, unit=of.unit, description=of.description, label=of.label, values=values)


def shown_column(column: MemberColumn) -> MemberColumn:
    """Return a column in the units of tables: angles in degrees, everything else in SI."""
    factor, unit = display_unit(column.unit)
    return replace(column, unit=unit, values=factor * column.values)
