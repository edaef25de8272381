"""Charts of a survey: their branches, the seeds of each, and how what was found joins them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.grid.bound_crossing import continuing_sheets
from perilune.atlas.store.schema import seed_type
from perilune.charts import Borders, Chart, Sheet, same_unknowns
from perilune.core import Matrix, Vector
from perilune.problem import Nature


@dataclass(frozen=True, kw_only=True)
class SurveyedChart:
    """Chart of the region with its branches, and the corners that they reach.

    Attributes
    ----------
    sheets
        Branches in the order in which they were found.
    y
        Unknowns of each at the corners of blocks, NaN where it does not reach, (branches, corners, n).
    times
        Multiples of steps in their independent re-integrations
        (`perilune.charts.reintegrate.ChartReintegration`).
    widths
        Widths of the `Chart` [SI].
    small
        Extremals of branches that reach no corner.
    """

    chart: Chart
    borders: Borders
    sheets: tuple[Sheet, ...]
    y: NDArray[np.float64]
    widths: Vector
    times: tuple[int, ...] = ()
    small: tuple[InteriorSeed, ...] = ()


@dataclass(frozen=True)
class InteriorSeed:
    """Extremal inside a block: its branch, the block and place in its lattice, parameters there, and unknowns."""

    sheet: int
    brick: tuple[int, ...]
    place: NDArray[np.int64]
    values: Vector
    y: Vector


def with_minimum_found(known: SurveyedChart, number: int, sheet: Sheet) -> SurveyedChart:
    """Return the chart with one of its branches marked as a minimum, if that was not known.

    Parameters
    ----------
    known
        Chart with its branches.
    number
        Number of the branch.
    sheet
        The same branch as found later, with the kind of its extremals.
    """
    if known.sheets[number].minimum or not sheet.minimum or sheet.nature is Nature.UNPROVED:
        return known
    sheets = list(known.sheets)
    sheets[number] = replace(sheets[number], nature=sheet.nature)
    return replace(known, sheets=tuple(sheets))


def merge_surveyed_chart(known: SurveyedChart, sheet: Sheet, y: Matrix) -> SurveyedChart:
    """Return the chart with a branch at corners, (corners, n), added.

    With one extremal in common it is a known branch. If it differs from that elsewhere, as around a cusp, the others
    are kept as those of another branch.

    Parameters
    ----------
    known
        Chart with its branches.
    sheet
        Branch that is added.
    y
        Its unknowns, canonical, (corners, n); NaN where it does not reach.
    """
    for number, (other, there) in enumerate(zip(known.sheets, known.y, strict=True)):
        if other.alike(sheet):
            if (common := same_unknowns(y, there)).any():
                known = with_minimum_found(replace(known, y=known.y.copy()), number, sheet)
                known.y[number] = np.where(np.isfinite(there), there, y)
                y = np.where((common | ~np.isfinite(there[:, 0]))[:, None], np.nan, y)
    if not np.isfinite(y[:, 0]).any():
        return known
    return replace(known, sheets=(*known.sheets, sheet), y=np.concatenate([known.y, y[None]]))


def with_expected_branches(known: SurveyedChart, corners: Matrix) -> SurveyedChart:
    """Add the branches that would continue known ones across bounds; blocks find if there are any.

    Parameters
    ----------
    known
        Chart with its branches.
    corners
        Values of the axes at all corners of blocks, canonical, (corners, d).
    """
    sheets, small = list(known.sheets), {one.sheet: (one.values, one.y) for one in known.small}
    for number, (sheet, y) in enumerate(zip(known.sheets, known.y, strict=True)):
        first = int(np.isfinite(y[:, 0]).argmax())
        at = small.get(number, (corners[first], y[first]))
        for other in continuing_sheets(known.borders, sheet, *at) if sheet.minimum else ():
            if not any(one.minimum and one.alike(other) for one in sheets):
                sheets.append(other)
    none = np.full((len(sheets) - len(known.sheets), *known.y.shape[1:]), np.nan)
    return replace(known, sheets=tuple(sheets), y=np.concatenate([known.y, none]))


def chart_entry(found: SurveyedChart) -> dict[str, Any]:
    """Return the entry of a chart in a survey's line."""
    sheets = [
        {"active_bounds": dict(s.holds), "orientation": s.orientation, "nature": s.nature.name} for s in found.sheets
    ]
    said = {"widths": found.widths.tolist(), "reintegration_steps": list(found.times), "unknowns": found.y.shape[2]}
    return {**found.chart.course.document(), **said, "sheets": sheets}


def seed_rows(places: NDArray[np.int64], found: SurveyedChart) -> NDArray[Any]:
    """Return the shard of branches at corners of blocks, and of branches that reach none.

    Parameters
    ----------
    places
        Numbers of all corners of blocks, (corners, d).
    found
        Chart with its branches.

    Returns
    -------
    NDArray[Any]
        Rows with the columns of `seed_type`.
    """
    sheet, corner = np.nonzero(np.isfinite(found.y[:, :, 0]))
    rows = np.zeros(len(sheet) + len(found.small), dtype=seed_type(places.shape[1], found.y.shape[2]))
    first = rows[: len(sheet)]
    first["sheet"], first["corner"], first["y"] = sheet, places[corner], found.y[sheet, corner]
    for row, one in zip(rows[len(sheet) :], found.small, strict=True):
        row["sheet"], row["corner"], row["place"], row["y"] = one.sheet, one.brick, one.place, one.y
    return rows
