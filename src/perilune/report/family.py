"""A family of landings along one parameter: table (CSV, JSON) and figure, failures named.

The parameter leaves in its scenario unit where the boundary speaks in degrees, else in SI.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from perilune.core import Outcome
from perilune.families import MemberTable, member_table, shown_column
from perilune.io import finite, fresh_directory, json_text, refuse_unwritten, round_degrees, write_each

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from perilune.families import Batch, Family

FAMILY_NAME = "family"


def family_document(found: Family | Batch | MemberTable) -> dict[str, Any]:
    """Make the tree: parameter, unit, whether Ctrl-C cut it short; of each point value, outcome, results, message.

    `tolerance_used` is the part of a stated tolerance that its proof needed.
    A family along several parameters has ``parameters`` and ``values`` in their place, in the same order.
    """
    table = member_table(found)
    axes = [shown_column(axis) for axis in table.axes]
    heads = [{"name": axis.name, "unit": axis.unit} for axis in axes]
    values = [[round_degrees(value, axis.unit) for value in axis.values.tolist()] for axis in axes]
    results = [
        (c.name, {"unit": c.unit, "description": c.description, "label": c.label}, c.values.tolist())
        for c in table.results
    ]
    points = [
        {
            **({"value": at[0]} if len(at) == 1 else {"values": list(at)}),
            "outcome": table.outcomes[i],
            "verification_level": int(table.levels[i]),
            "tolerance_used": table.tolerances[i],
            "results": {name: {"value": y[i], **about} for name, about, y in results} if table.solved[i] else {},
            "message": table.messages[i],
        }
        for i, at in enumerate(zip(*values, strict=True))
    ]
    one = {"parameter": heads[0]["name"], "unit": heads[0]["unit"]} if len(heads) == 1 else {"parameters": heads}
    notes = {"notes": list(table.notes)} if table.notes else {}
    return finite({**one, "interrupted": table.interrupted, **notes, "points": points})


def family_csv(found: Family | Batch | MemberTable) -> str:
    """Write comma-separated values, one row for each point; empty cells where there is no solution."""
    table = member_table(found)
    axes = [shown_column(axis) for axis in table.axes]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    heads = [f"{column.name} [{column.unit}]" for column in (*axes, *table.results)]
    writer.writerow([*heads, "outcome", "verification_level", "message"])
    columns = [[repr(round_degrees(value, axis.unit)) for value in axis.values.tolist()] for axis in axes]
    columns += [[repr(v) if math.isfinite(v) else "" for v in c.values.tolist()] for c in table.results]
    for i, cells in enumerate(zip(*columns, strict=True)):
        said = "; ".join(text for text in (table.tolerances[i], table.messages[i]) if text)
        writer.writerow([*cells, table.outcomes[i], table.levels[i], " ".join(said.split())])
    return text.getvalue()


def family_figure(found: Family | Batch | MemberTable) -> Figure:
    """Draw each result that varies against the one parameter, in panels; unproved points stand out."""
    from perilune.report.time_histories import family_panels

    table = member_table(found)
    (axis,) = [shown_column(axis) for axis in table.axes]
    value = np.array([round_degrees(value, axis.unit) for value in axis.values.tolist()])
    panels = {f"{c.name.replace('_', ' ')} ({c.unit})": c.values for c in table.results}
    shown = {
        text: y
        for text, y in panels.items()
        if np.isfinite(y).any() and _changes_visibly(y) and not _repeats_parameter(y, value)
    }
    doubted = np.array([outcome == Outcome.NOT_PROVED.name for outcome in table.outcomes], dtype=bool)
    order = np.argsort(value)  # a list of values may be asked for in any
    drawn = {text: y[order] for text, y in (shown or panels).items()}
    return family_panels(value[order], drawn, f"{axis.name.replace('_', ' ')} ({axis.unit})", doubted[order])


def write_family(
    found: Family | Batch | MemberTable,
    directory: str | Path,
    force: bool = False,
    axes: Mapping[str, str | None] | None = None,
) -> None:
    """Write ``family.csv``, ``family.json`` and, along one parameter or two, ``family.png`` / ``.svg``.

    Parameters
    ----------
    found
        What is written.
    directory, force
        As of `fresh_directory`.
    axes
        Names of the quantities of a map, as of `perilune.report.contour_map.family_map`.

    Raises
    ------
    NotWrittenError
        If a table or figure cannot be written; the other files are there then.
    """
    from perilune.report.style import save_figure

    table = member_table(found)

    writers: dict[str, Callable[[Path], object]] = {
        f"{FAMILY_NAME}.csv": lambda path: path.write_text(family_csv(table), encoding="utf-8", newline="")
    }
    if len(table.parameters) == 1:
        writers[FAMILY_NAME] = lambda path: save_figure(family_figure(table), path.parent, path.name)
    elif any((axes or {}).values()) or _has_map(table):
        from perilune.report.contour_map import family_map

        writers[FAMILY_NAME] = lambda path: save_figure(family_map(table, **(axes or {})), path.parent, path.name)
    with fresh_directory(directory, force) as work:
        (work / f"{FAMILY_NAME}.json").write_text(json_text(family_document(table)), encoding="utf-8")
        failed = write_each(work, writers)
    refuse_unwritten(failed)


def _has_map(table: MemberTable) -> bool:
    """Return True if a family makes a map unasked: two parameters on a grid, and three solved neighbours."""
    placed = table.grid
    if placed is None or placed.ndim != 2 or min(placed.shape) < 2:
        return False
    solved = table.solved[placed]
    corners = solved[1:, 1:].astype(int) + solved[:-1, 1:] + solved[1:, :-1] + solved[:-1, :-1]
    return bool((corners >= 3).any())


def _changes_visibly(values: np.ndarray) -> bool:
    finite_values = values[np.isfinite(values)]
    return bool(np.ptp(finite_values) > 1e-9 * np.abs(finite_values).max())


def _repeats_parameter(values: np.ndarray, parameter: np.ndarray) -> bool:
    """Return True if a result is the parameter itself, which needs no panel."""
    known = np.isfinite(values)
    return bool(np.allclose(values[known], parameter[known], rtol=1e-12))
