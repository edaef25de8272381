"""Points of a batch as users have them: a list of mappings, a mapping of arrays, or a frame of pandas."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.core import (
    Matrix,
    PeriluneError,
    Vector,
    parameter_name,
    parse_unit,
    unit_as_written,
    unknown_name,
    wrong_type_error,
)
from perilune.problem import Problem

#: A list of points, or the columns of a table: names may end in a unit in brackets, and are in SI without one.
Points = Any
_UNIT = re.compile(r"(.*?)\s*[\[(](.*)[\])]\s*")
_FORM = "a list of {name: value}, {name: values}, or a frame of pandas"


@dataclass(frozen=True, kw_only=True)
class PointTable:
    """Values of parameters [SI], (points, d), and by the number of a point why its values cannot be read."""

    names: tuple[str, ...]
    values: Matrix
    unreadable: Mapping[int, str]


def read_points(problem: Problem, points: Points) -> PointTable:
    """Read points; a value that is missing or no finite number refuses its point, and no other.

    Parameters
    ----------
    problem
        Problem whose parameters they name; a dot in a name may stand for an underscore.
    points
        The points.

    Raises
    ------
    PeriluneError
        If they are nothing of the kind, columns differ in length, or a name or unit is unknown.
    """
    columns, gaps = _columns(points)
    names, factors = list[str](), list[float]()
    for heading in columns:
        name, factor = _read_heading(problem, heading)
        if name in names:
            raise PeriluneError("a parameter stands in two columns", got=name, expected="each parameter once")
        names.append(name)
        factors.append(factor)
    if not names:
        raise PeriluneError("the points name no parameter", got="no column", expected=_FORM)
    count = len(next(iter(columns.values())))
    values, unreadable = np.empty((count, len(names))), dict[int, str]()
    for k, (heading, column) in enumerate(columns.items()):
        if len(column) != count:
            raise PeriluneError(
                "columns of points differ in length",
                got=f"{len(column)} values of {heading}",
                expected=f"{count}, as of {next(iter(columns))}",
            )
        values[:, k] = factors[k] * _numbers(column)
        for i in np.nonzero(~np.isfinite(values[:, k]))[0].tolist():
            what = "is missing" if i in gaps.get(heading, ()) else f"is no finite number: got {_shown(column[i])}"
            unreadable.setdefault(i, f"{names[k]} {what}")
    return PointTable(names=tuple(names), values=values, unreadable=unreadable)


def grid_points(over: Mapping[str, Sequence[float]]) -> dict[str, Vector]:
    """Return the columns of all combinations of values, the last name changing fastest.

    Parameters
    ----------
    over
        Values of each parameter [SI].
    """
    axes = np.meshgrid(*(np.asarray(values, dtype=float) for values in over.values()), indexing="ij")
    return {name: axis.ravel() for name, axis in zip(over, axes, strict=True)}


def _columns(points: Points) -> tuple[Mapping[str, Any], Mapping[str, set[int]]]:
    """Return the columns of points, and for each the numbers of the points in which it is missing."""
    if isinstance(points, Mapping):
        named = {str(name): _plain(points[name]) for name in points}
    elif (names := _column_names(points)) is not None:
        named = {str(name): np.asarray(points[name]) for name in names}
    elif isinstance(points, str) or not isinstance(points, Iterable):
        raise wrong_type_error(points, _FORM, "a valid set of points")
    else:
        rows = list(points)
        for row in rows:
            if not isinstance(row, Mapping):
                raise wrong_type_error(row, "{name: value, ...}", "a point")
        names = list(dict.fromkeys(str(name) for row in rows for name in row))
        gaps = {name: {i for i, row in enumerate(rows) if name not in row} for name in names}
        return {name: [row.get(name, np.nan) for row in rows] for name in names}, gaps
    for name, column in named.items():
        if isinstance(column, str) or not hasattr(column, "__len__") or _dimensions(column) != 1:
            raise wrong_type_error(column, "a list of numbers", f"a valid column {name}")
    return named, {}


def _column_names(points: Any) -> Sequence[Any] | None:
    """Return the names of the columns of a frame of pandas or polars, a table of Arrow or a structured array."""
    kind = getattr(points, "dtype", None)
    return next(
        (names for names in (getattr(points, "column_names", None), getattr(points, "columns", None),
                             getattr(kind, "names", None)) if names is not None),
        None,
    )  # fmt: skip


def _shown(value: Any) -> str:
    """Return a value for a message; a text in quotes, as a number in it would look like one."""
    return (repr(value) if isinstance(value, str) else str(value))[:40]


def _plain(column: Any) -> Any:
    """Return a column that has an index of its own, as a series of pandas, as an array."""
    return np.asarray(column) if hasattr(column, "iloc") else column


def _dimensions(column: Any) -> int:
    """Return the number of dimensions of a column; 0 for lists in it of several lengths."""
    try:
        return np.ndim(column)
    except ValueError:
        return 0


def _numbers(column: Sequence[Any]) -> Any:
    """Return a column as floats, NaN for what is none."""
    array = column if isinstance(column, (list, tuple)) else np.ma.asarray(column)
    if isinstance(array, np.ma.MaskedArray) and array.dtype.kind in "fiu":
        return np.ma.filled(array.astype(float), np.nan)
    return np.array([_number(value) for value in column], dtype=float)


def _number(value: Any) -> float:
    if isinstance(value, (str, bytes, bool, np.bool_, complex, np.complexfloating)):  # a text may have a unit
        return np.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return np.nan


def _read_heading(problem: Problem, heading: str) -> tuple[str, float]:
    """Return the parameter of a column, and the factor of its unit to SI."""
    match = _UNIT.fullmatch(heading)
    stated, unit = (match[1], match[2]) if match else (heading, "")
    name, known = parameter_name(stated.strip()), sorted({*problem.given, *problem.free_names})
    if name not in known:
        raise unknown_name("parameter", name, known)
    if not unit:
        return name, 1.0
    own, written = problem.unit_of(name), unit_as_written(unit)
    if written is None:
        raise PeriluneError(f"the unit of the column {heading[:60]} is unknown", got=unit[:40], expected=own)
    factor, dimension = parse_unit(written)
    if dimension != parse_unit(own)[1]:
        raise PeriluneError(f"the unit of the column {heading[:60]} is of another kind", got=unit[:40], expected=own)
    return name, factor
