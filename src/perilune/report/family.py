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
from perilune.io import (
    display_unit,
    finite,
    fresh_directory,
    json_text,
    refuse_unwritten,
    results_document,
    round_degrees,
    write_each,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from perilune.families import Family

FAMILY_NAME = "family"


def family_document(family: Family) -> dict[str, Any]:
    """Make the tree: parameter, unit, whether Ctrl-C cut it short; of each point value, outcome, results, message.

    `tolerance_used` is the part of a stated tolerance that its proof needed.
    A family along several parameters has ``parameters`` and ``values`` in their place, in the same order.
    """
    shown = [display_unit(unit) for unit in family.units]
    heads = [{"name": name, "unit": unit} for name, (_, unit) in zip(family.parameters, shown, strict=True)]
    points = []
    for point in family.points:
        solution = point.solution
        values = [
            round_degrees(value * factor, unit) for value, (factor, unit) in zip(point.values, shown, strict=True)
        ]
        points.append(
            {
                **({"value": values[0]} if len(values) == 1 else {"values": values}),
                "outcome": point.outcome.name,
                "verification_level": solution.verification.level if solution else 0,
                "tolerance_used": point.tolerance_used,
                "results": results_document(solution) if solution else {},
                "message": point.message,
            }
        )
    one = {"parameter": heads[0]["name"], "unit": heads[0]["unit"]} if len(heads) == 1 else {"parameters": heads}
    notes = {"notes": list(family.notes)} if family.notes else {}
    return finite({**one, "interrupted": family.interrupted, **notes, "points": points})


def family_csv(family: Family) -> str:
    """Write comma-separated values, one row for each point; empty cells where there is no solution."""
    document = family_document(family)
    names = _result_units(document)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    axes = document.get("parameters", [{"name": document.get("parameter"), "unit": document.get("unit")}])
    heads = [f"{axis['name']} [{axis['unit']}]" for axis in axes] + [f"{name} [{unit}]" for name, unit in names.items()]
    writer.writerow([*heads, "outcome", "verification_level", "message"])
    for point in document["points"]:
        found = [point["results"].get(name, {}).get("value") for name in names]
        cells = ["" if v is None else repr(v) for v in (*point.get("values", [point.get("value")]), *found)]
        said = "; ".join(text for text in (point["tolerance_used"], str(point["message"] or "")) if text)
        writer.writerow([*cells, point["outcome"], point["verification_level"], " ".join(said.split())])
    return text.getvalue()


def family_figure(family: Family) -> Figure:
    """Draw each result that varies against the one parameter, in panels; unproved points stand out."""
    from perilune.report.time_histories import family_panels

    document = family_document(family)
    value = np.array([point["value"] for point in document["points"]])
    table = {
        f"{name.replace('_', ' ')} ({unit})": np.array(
            [point["results"].get(name, {}).get("value", math.nan) for point in document["points"]],
            dtype=float,
        )
        for name, unit in _result_units(document).items()
    }
    shown = {
        text: y
        for text, y in table.items()
        if np.isfinite(y).any() and _changes_visibly(y) and not _repeats_parameter(y, value)
    }
    name = document["parameter"].replace("_", " ")
    doubted = np.array([point["outcome"] == Outcome.NOT_PROVED.name for point in document["points"]], dtype=bool)
    order = np.argsort(value)  # a list of values may be asked for in any
    drawn = {text: y[order] for text, y in (shown or table).items()}
    return family_panels(value[order], drawn, f"{name} ({document['unit']})", doubted[order])


def write_family(
    family: Family, directory: str | Path, force: bool = False, axes: Mapping[str, str | None] | None = None
) -> None:
    """Write ``family.csv``, ``family.json`` and, along one parameter or two, ``family.png`` / ``.svg``.

    Parameters
    ----------
    family
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
    from perilune.families import grid_of
    from perilune.report.style import save_figure

    writers: dict[str, Callable[[Path], object]] = {
        f"{FAMILY_NAME}.csv": lambda path: path.write_text(family_csv(family), encoding="utf-8", newline="")
    }
    if len(family.parameters) == 1:
        writers[FAMILY_NAME] = lambda path: save_figure(family_figure(family), path.parent, path.name)
    elif any((axes or {}).values()) or _has_map(family, grid_of(family)):
        from perilune.report.contour_map import family_map

        writers[FAMILY_NAME] = lambda path: save_figure(family_map(family, **(axes or {})), path.parent, path.name)
    with fresh_directory(directory, force) as work:
        (work / f"{FAMILY_NAME}.json").write_text(json_text(family_document(family)), encoding="utf-8")
        failed = write_each(work, writers)
    refuse_unwritten(failed)


def _has_map(family: Family, placed: np.ndarray | None) -> bool:
    """Return True if a family makes a map unasked: two parameters on a grid, and three solved neighbours."""
    if placed is None or placed.ndim != 2 or min(placed.shape) < 2:
        return False
    solved = np.array([p.solution is not None for p in family.points])[placed]
    corners = solved[1:, 1:].astype(int) + solved[:-1, 1:] + solved[1:, :-1] + solved[:-1, :-1]
    return bool((corners >= 3).any())


def _result_units(document: dict[str, Any]) -> dict[str, str]:
    """Find the unit of every result that any point has, in order of first appearance."""
    units: dict[str, str] = {}
    for point in document["points"]:
        units |= {name: entry["unit"] for name, entry in point["results"].items() if name not in units}
    return units


def _changes_visibly(values: np.ndarray) -> bool:
    finite_values = values[np.isfinite(values)]
    return bool(np.ptp(finite_values) > 1e-9 * np.abs(finite_values).max())


def _repeats_parameter(values: np.ndarray, parameter: np.ndarray) -> bool:
    """Return True if a result is the parameter itself, which needs no panel."""
    known = np.isfinite(values)
    return bool(np.allclose(values[known], parameter[known], rtol=1e-12))
