"""Export of a family or a batch as a frame of pandas or a data set of xarray, one row or place for each member.

Angles are in degrees, everything else in SI, as in the tables of one flight. A member without a solution has NaN.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from perilune.families.batch import Batch
from perilune.families.family import Family
from perilune.families.family_table import MemberColumn, MemberTable, member_table, shown_column
from perilune.io import cf_unit, package_of_extra

if TYPE_CHECKING:
    import pandas
    import xarray

POINT = "point"
_LEVEL = "verification_level"


def member_frame(found: Family | Batch) -> pandas.DataFrame:
    """Make a frame with one row for each member: parameters, results, free parameters, and how it ended.

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
    table = member_table(found)
    columns, given = _table_columns(table), [shown_column(column) for column in table.given]
    frame = pd.DataFrame({**{f.name: f.values for f in columns}, **_endings(table)})
    frame.attrs = {
        "problem": table.problem.name, "title": table.problem.heading, "notes": list(table.notes),
        "units": {f.name: f.unit for f in columns},
        "given": {f.name: (float(f.values[0]), f.unit) for f in given},
    }  # fmt: skip
    return frame


def member_dataset(found: Family | Batch) -> xarray.Dataset:
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
    table = member_table(found)
    axes, placed = [shown_column(column) for column in table.axes], table.grid
    if placed is None:
        dimensions, shape, order = (POINT,), (len(table),), np.arange(len(table))
        coordinates = {f.name: ((POINT,), f.values, _cf_attributes(f)) for f in axes}
    else:
        dimensions, shape, order = table.parameters, placed.shape, placed.ravel()
        coordinates = {
            f.name: ((f.name,), np.moveaxis(f.values[placed], k, 0).reshape(shape[k], -1)[:, 0], _cf_attributes(f))
            for k, f in enumerate(axes)
        }

    def arranged(values: np.ndarray) -> np.ndarray:
        return values[order].reshape(shape)

    variables = {
        f.name: (dimensions, arranged(f.values), _cf_attributes(f)) for f in map(shown_column, table.quantities)
    }
    variables |= {
        name: (dimensions, arranged(np.array(values)), {"long_name": name.replace("_", " ")})
        for name, values in _endings(table).items()
    }
    given = [shown_column(column) for column in table.given if column.name not in variables]
    variables |= {f.name: ((), f.values[0], _cf_attributes(f)) for f in given}
    about = {"problem": table.problem.name, "title": table.problem.heading, "notes": "; ".join(table.notes)}
    return xr.Dataset(variables, coordinates, about)


def _table_columns(table: MemberTable) -> list[MemberColumn]:
    return [shown_column(column) for column in (*table.axes, *table.quantities)]


def _endings(table: MemberTable) -> dict[str, Any]:
    """Return outcome, level, tolerance used and message of each member."""
    return {
        "outcome": table.outcomes, _LEVEL: table.levels,
        "tolerance_used": table.tolerances, "message": table.messages,
    }  # fmt: skip


def _cf_attributes(f: MemberColumn) -> dict[str, str]:
    return {"units": cf_unit(f.unit), "long_name": f.description or f.name.replace("_", " ")}
