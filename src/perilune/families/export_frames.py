"""Export of a family as a frame of pandas or a data set of xarray: parameters, results, outcome of each member.

Angles are in degrees, everything else in SI, as in the tables of one flight. A member without a solution has NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from perilune.core import Vector
from perilune.families.batch import Batch
from perilune.families.family import Family
from perilune.io import FlightColumn, cf_unit, display_unit, package_of_extra
from perilune.problem import Solution

if TYPE_CHECKING:
    import pandas
    import xarray

POINT = "point"
_LEVEL = "verification_level"


def family_frame(family: Family) -> pandas.DataFrame:
    """Make a frame with one row for each member: parameters, free parameters, results, and how it ended.

    Returns
    -------
    pandas.DataFrame
        Units are in ``attrs["units"]``, given parameters that are the same in all members in ``attrs["given"]``.

    Raises
    ------
    PeriluneError
        If pandas is not installed.
    """
    pd = package_of_extra("pandas", "a frame of pandas")
    axes, found, given = parameter_fields(family), result_fields(family), given_fields(family)
    columns = {f.name: f.values for f in (*axes, *found)}
    frame = pd.DataFrame({**columns, **_endings(family)})
    frame.attrs = {
        "problem": family.problem.name, "title": family.problem.heading, "notes": list(family.notes),
        "units": {f.name: f.unit for f in (*axes, *found)},
        "given": {f.name: (float(f.values[0]), f.unit) for f in given},
    }  # fmt: skip
    return frame


def family_dataset(family: Family) -> xarray.Dataset:
    """Make a data set whose dimensions are the parameters, where the members are their grid, else ``point``.

    Returns
    -------
    xarray.Dataset
        Free parameters, results, ``outcome``, ``verification_level``, ``tolerance_used`` and ``message`` over the
        dimensions, given parameters that are the same in all members without; ``units`` and ``long_name`` as the CF
        conventions have them.

    Raises
    ------
    PeriluneError
        If xarray is not installed.
    """
    xr = package_of_extra("xarray", "a data set of xarray")
    axes, placed = parameter_fields(family), grid_of(family)
    if placed is None:
        dimensions, shape, order = (POINT,), (len(family.points),), np.arange(len(family.points))
        coordinates = {f.name: ((POINT,), f.values, _cf_attributes(f)) for f in axes}
    else:
        dimensions, shape, order = family.parameters, placed.shape, placed.ravel()
        coordinates = {
            f.name: ((f.name,), np.moveaxis(f.values[placed], k, 0).reshape(shape[k], -1)[:, 0], _cf_attributes(f))
            for k, f in enumerate(axes)
        }

    def arranged(values: np.ndarray) -> np.ndarray:
        return values[order].reshape(shape)

    variables = {f.name: (dimensions, arranged(f.values), _cf_attributes(f)) for f in result_fields(family)}
    variables |= {
        name: (dimensions, arranged(np.array(values)), {"long_name": name.replace("_", " ")})
        for name, values in _endings(family).items()
    }
    variables |= {f.name: ((), f.values[0], _cf_attributes(f)) for f in given_fields(family) if f.name not in variables}
    about = {"problem": family.problem.name, "title": family.problem.heading, "notes": "; ".join(family.notes)}
    return xr.Dataset(variables, coordinates, about)


def batch_frame(batch: Batch) -> pandas.DataFrame:
    """Make a frame with one row for each point: parameters, free parameters, results, J, outcome and level.

    Raises
    ------
    PeriluneError
        If pandas is not installed.
    """
    pd = package_of_extra("pandas", "a frame of pandas")
    found = _batch_fields(batch)
    frame = pd.DataFrame(
        {**{f.name: f.values for f in found}, "outcome": pd.Categorical(batch.outcomes), _LEVEL: batch.levels}
    )
    frame.attrs = {"problem": batch.problem.name, "units": {f.name: f.unit for f in found}}
    return frame


def batch_dataset(batch: Batch) -> xarray.Dataset:
    """Make a data set with the dimension ``point``: parameters, free parameters, results, J, outcome and level.

    Raises
    ------
    PeriluneError
        If xarray is not installed.
    """
    xr = package_of_extra("xarray", "a data set of xarray")
    found = {f.name: ((POINT,), f.values, _cf_attributes(f)) for f in _batch_fields(batch)}
    found |= {"outcome": ((POINT,), batch.outcomes, {}), _LEVEL: ((POINT,), batch.levels, {})}
    return xr.Dataset(found, attrs={"problem": batch.problem.name})


def _batch_fields(batch: Batch) -> list[FlightColumn]:
    problem, taken = batch.problem, batch.parameters
    variables = [*problem.result_variables, *problem.phases[-1].end_output_variables]
    about = {variable.name: (variable.unit, variable.description) for variable in variables}
    return [
        *(_field(name, problem.unit_of(name), batch.values[:, k], "", ()) for k, name in enumerate(taken)),
        *(_field(name, problem.unit_of(name), values, "chosen", ()) for name, values in batch.free.items()),
        *(_field(name, about[name][0], values, about[name][1], taken) for name, values in batch.results.items()),
        _field("objective", problem.objective_unit, batch.objective, "J", (*taken, *batch.results)),
    ]


def grid_of(family: Family) -> np.ndarray | None:
    """Return the numbers of the members as a grid, each axis in the order of the request; None if they are no grid."""
    if not family.points:
        return None
    axes = [list(dict.fromkeys(column)) for column in zip(*(p.values for p in family.points), strict=True)]
    shape = tuple(len(axis) for axis in axes)
    if math.prod(shape) != len(family.points) or len({p.values for p in family.points}) < len(family.points):
        return None
    placed = np.empty(shape, dtype=np.int64)
    for number, point in enumerate(family.points):
        placed[tuple(axis.index(value) for axis, value in zip(axes, point.values, strict=True))] = number
    return placed


def member_quantities(family: Family) -> dict[str, tuple[Vector, str]]:
    """Return values at each member and unit of all quantities, by name; a parameter has precedence over a result."""
    count = len(family.points)
    found = {f.name: (np.full(count, f.values[0]), f.unit) for f in given_fields(family)}
    return found | {f.name: (f.values, f.unit) for f in (*result_fields(family), *parameter_fields(family))}


def parameter_fields(family: Family) -> list[FlightColumn]:
    """Return the varied parameters, at each member."""
    columns = list(zip(*(p.values for p in family.points), strict=True)) or [()] * len(family.parameters)
    return [
        _field(name, unit, np.array(values, dtype=float), "", ())
        for name, unit, values in zip(family.parameters, family.units, columns, strict=True)
    ]


def result_fields(family: Family) -> list[FlightColumn]:
    """Return free parameters and results, at each member; NaN where it has no solution.

    One with the name of a parameter of the family has ``_result`` appended.
    """
    known: dict[str, tuple[str, str, Callable[[Solution], float]]] = {}
    for solution in (p.solution for p in family.points if p.solution is not None):
        for name, result in solution.results.items():
            known.setdefault(name, (result.unit, result.description, lambda s, n=name: _result_value(s, n)))
        for name in solution.free:
            known.setdefault(
                name, (solution.problem.unit_of(name), "chosen", lambda s, n=name: s.free.get(n, math.nan))
            )
    return [
        _field(name, unit, np.array([math.nan if p.solution is None else read(p.solution) for p in family.points]),
               about, family.parameters)
        for name, (unit, about, read) in known.items()
    ]  # fmt: skip


def given_fields(family: Family) -> list[FlightColumn]:
    """Return the given parameters that are not varied and equal in all members with a solution."""
    problems = [p.solution.problem for p in family.points if p.solution is not None] or [family.problem]
    return [
        _field(name, given.unit, np.array([given.value]), "", ())
        for name, given in problems[0].given.items()
        if name not in family.parameters
        and all(name in problem.given and problem.given[name].value == given.value for problem in problems)
    ]


def _result_value(solution: Solution, name: str) -> float:
    result = solution.results.get(name)
    return math.nan if result is None else float(result.value)


def _field(name: str, unit: str, values: Vector, about: str, taken: tuple[str, ...]) -> FlightColumn:
    factor, unit = display_unit(unit)
    called = f"{name}_result" if name in taken else name
    return FlightColumn(name=called, unit=unit, about=about or name.replace("_", " "), values=factor * values)


def _endings(family: Family) -> dict[str, list[Any]]:
    """Return outcome, level, tolerance used and message of each member."""
    return {
        "outcome": [p.outcome.name for p in family.points],
        _LEVEL: [p.solution.verification.level if p.solution is not None else 0 for p in family.points],
        "tolerance_used": [p.tolerance_used for p in family.points],
        "message": [p.message for p in family.points],
    }


def _cf_attributes(f: FlightColumn) -> dict[str, str]:
    return {"units": cf_unit(f.unit), "long_name": f.about}
