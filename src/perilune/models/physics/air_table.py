"""Atmosphere tables in files: which columns are altitude and density, their units, and what the file states.

A file states its units itself, in its headings or in a row below them. Only without headings, or where these state no
unit, are altitudes in m and densities in kg/m^3.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from perilune.core import PeriluneError, TableHeading, Vector, bounded_text, parse_unit, table_heading, unit_as_written
from perilune.models.physics.delimited_text import CellRow, DelimitedTable, TextLine, delimited_table

LARGEST_FILE = 1_000_000  # bytes
_SI = {"altitude": "m", "density": "kg/m^3"}
_CALLED = {
    "altitude": "altitude altitudes alt height heights h z elevation höhe hoehe hauteur altura altitud quota".split(),
    "density": "density densities dens rho ρ dichte densité densite densidad densidade densità densita".split(),
}
# What changes nothing about either.
_FURTHER = "geometric geodetic mass total air atmosphere atmospheric neutral mean sea level above msl asl amsl".split()
_KNOWN = {*_CALLED["altitude"], *_CALLED["density"], *_FURTHER, "in", "of", "the"}
_EXPECTED = 'headings such as "altitude [km]" and "density [kg/m^3]", or none for m and kg/m^3'
# What may be a unit in a comment; one behind a number is of that number: "from 0 to 86 km" states no column's.
_IN_PROSE = re.compile(r"[^\s_,;:=()\[\]{}<>\"'|]+")
_BRACKETED = re.compile(r"[(\[]([^()\[\]]{1,20})[)\]]")
_MOST_NAMED = 6  # columns in a message


@dataclass(frozen=True, kw_only=True)
class AirTable:
    """Samples of a file, in the order of rising altitude.

    Parameters
    ----------
    altitude, density
        In SI.
    lines
        Where in the file each row stands.
    said
        What was read, in words.
    """

    altitude: Vector
    density: Vector
    lines: tuple[int, ...]
    said: str


@dataclass(frozen=True, kw_only=True)
class _AirColumn:
    """A column of altitudes or densities and its unit, "" where none is stated.

    `unclear` altitudes may be geopotential as well.
    """

    place: int
    unit: str
    unclear: bool = False


def read_air_table(path: Path) -> AirTable:
    """Read a table of air.

    Parameters
    ----------
    path
        A text file of at most `LARGEST_FILE` bytes.

    Raises
    ------
    PeriluneError
        If it cannot be read, has no column of altitudes or of densities, or no number where one should be.
    """
    text = bounded_text(
        path, "table of air", LARGEST_FILE, expected="a CSV file of altitude and density",
        advice="give its path, relative to the scenario file",
    )  # fmt: skip
    table = delimited_table(text, "table of air")
    if not table.body:
        raise PeriluneError(
            "the table of air needs rows", got="no row of numbers", expected="at least 3", advice=_EXPECTED
        )
    count = _column_count(table)
    headings, units = _headings(table, count)
    columns = _find_columns(table, headings, count)
    columns = {name: _with_unit_row(name, column, units) for name, column in columns.items()}
    for name, column in columns.items():
        if not column.unit:
            _refuse_conflicting_unit(name, [*table.comments, *table.below])
    values = {
        name: np.array([table.number(row, column.place) for row in table.body]) for name, column in columns.items()
    }
    lines = np.array([row.line for row in table.body])
    order = slice(None, None, -1) if (np.diff(values["altitude"]) < 0).all() else slice(None)
    found = {name: values[name][order] * parse_unit(column.unit or _SI[name])[0] for name, column in columns.items()}
    used = [column.place for column in columns.values()]
    ignored = [h.text or f"column {k + 1}" for k, h in enumerate(headings) if k not in used]
    return AirTable(
        altitude=found["altitude"], density=found["density"], lines=tuple(lines[order].tolist()),
        said=_describe_table(values, found, columns, ignored),
    )  # fmt: skip


# -- headings -------------------------------------------------------------------------------------------------------


def _column_count(table: DelimitedTable) -> int:
    """Return the number of columns, which all rows share; an empty last one is not counted."""
    counts = [len(row.cells) for row in table.body]
    count = max(set(counts), key=counts.count)
    for row, found in zip(table.body, counts, strict=True):
        if found != count:
            raise PeriluneError(
                f"line {row.line} of the table of air has {found} cells",
                got=table.delimiter.join(row.cells)[:60],
                expected=f"{count}, as most rows have",
                advice="a line that begins with # is a comment",
            )
    while not any(row.cells[count - 1] for row in table.body):
        count -= 1
    return count


def _headings(table: DelimitedTable, count: int) -> tuple[list[TableHeading], list[str] | None]:
    """Return the headings of the columns, and the units in a row of their own; empty where the table has none."""
    if len(table.above) > 2:
        raise PeriluneError(
            f"line {table.above[0].number} of the table of air is neither a heading nor a row of numbers",
            got=table.above[0].text[:60], expected=f"at most a row of {_EXPECTED}, and one of units",
            advice="a line that begins with # is a comment",
        )  # fmt: skip
    rows = [(line, _heading_cells(table, line, count)) for line in table.above]
    units = next((cells for _, cells in rows[1:]), None)
    if len(rows) == 2 and not any(map(unit_as_written, rows[1][1])):
        line = rows[1][0]
        raise PeriluneError(
            f"line {line.number} of the table of air is neither units nor numbers", got=line.text[:60],
            expected='a row of units, as "m" and "kg/m^3"', advice="a line that begins with # is a comment",
        )  # fmt: skip
    headings = [table_heading(cell, _KNOWN) for cell in rows[0][1]] if rows else []
    for line in reversed(table.comments):
        cells = table.cells(line, count)
        if cells is None:
            continue
        if not headings and _is_heading_row(found := [table_heading(cell, _KNOWN) for cell in cells]):
            headings = found
        elif units is None and sum(unit_as_written(cell) is not None for cell in cells) > 1:
            units = cells
    return headings, units


def _heading_cells(table: DelimitedTable, line: TextLine, count: int) -> list[str]:
    """Return the cells of a line of headings, one for each column; R writes none for the row number."""
    cells, longer, shorter = (table.cells(line, wanted) for wanted in (count, count + 1, count - 1))
    if cells is None and longer is not None and not longer[-1]:
        cells = longer[:-1]
    if cells is None and shorter is not None and _has_row_numbers(table.body):
        cells = ["", *shorter]
    if cells is not None:
        return cells
    raise PeriluneError(
        f"line {line.number} of the table of air does not have one heading for each column",
        got=line.text[:60], expected=f"{count} headings, as rows have {count} cells",
        advice="a line that begins with # is a comment",
    )  # fmt: skip


def _has_row_numbers(body: list[CellRow]) -> bool:
    """Return True if the first column numbers the rows."""
    found = [row.cells[0] for row in body]
    return any(found == [str(k + begin) for k in range(len(found))] for begin in (0, 1))


def _is_heading_row(headings: list[TableHeading]) -> bool:
    """Return True if a comment is a row of headings, not prose: both columns, their units in brackets or understood."""
    called = [{name for name in _SI if set(h.words[:1]) & set(_CALLED[name])} for h in headings
              if not h.unread or h.bracketed]  # fmt: skip
    return len(set[str]().union(*called)) == len(_SI) or len({_role_of_heading(h) for h in headings} & set(_SI)) == len(
        _SI
    )


def _role_of_heading(heading: TableHeading) -> str:
    """Return ``altitude`` or ``density`` where a heading says only that; "" otherwise."""
    named = {name for name, words in _CALLED.items() if not set(words).isdisjoint(heading.words)}
    if heading.unread or len(named) > 1 or (heading.words and not named):
        return ""
    alike = {name for name, si in _SI.items() if heading.unit and parse_unit(heading.unit)[1] == parse_unit(si)[1]}
    found = (named & alike) if heading.unit and named else (named or alike)
    return next(iter(found), "")


def _find_columns(table: DelimitedTable, headings: list[TableHeading], count: int) -> dict[str, _AirColumn]:
    """Return the columns of altitude and density."""
    if not headings:
        if count != 2:
            raise PeriluneError(
                f"line {table.body[0].line} of the table of air has {count} cells, and no headings say what they are",
                got=table.delimiter.join(table.body[0].cells)[:60], expected="altitude [m], density [kg/m^3]",
                advice=_EXPECTED,
            )  # fmt: skip
        return {name: _AirColumn(place=k, unit="") for k, name in enumerate(_SI)}
    roles = [_role_of_heading(heading) for heading in headings]
    if roles.count("altitude") > 1:  # beside geometric ones H is geopotential, as in the US Standard Atmosphere 1976
        roles = [
            "" if _is_geopotential_symbol(heading) else role for role, heading in zip(roles, headings, strict=True)
        ]
    for name in _SI:
        if roles.count(name) != 1:
            _refuse_role(name, headings, roles.count(name))
    return {
        name: _AirColumn(
            place=(k := roles.index(name)), unit=headings[k].unit, unclear=_is_geopotential_symbol(headings[k])
        )
        for name in _SI
    }


def _is_geopotential_symbol(heading: TableHeading) -> bool:
    """Return True if a heading is ``H``, which also stands for geopotential altitudes."""
    return heading.words == ("h",) and heading.text.lstrip(" ([").startswith("H")


def _refuse_role(name: str, headings: list[TableHeading], count: int) -> None:
    """Refuse a table with no column of a kind, or with more than one."""
    named = [h for h in headings if not set(_CALLED[name]).isdisjoint(_heading_words(h))]
    got = ", ".join(repr(h.text) for h in headings[:_MOST_NAMED]) + (", …" if len(headings) > _MOST_NAMED else "")
    expected = f'one column "{name} [{_SI[name]}]", in any unit of that dimension'
    advice = _EXPECTED
    if count:
        what = f"more than one column of the table of air can be its {name}"
        advice = f"keep one column of {name}, or rename the others"
    elif not named:
        what = f"no column of the table of air is its {name}"
    else:
        got = repr(named[0].text)
        what = f"the table of air has no {name} that can be read"
        if "geopotential" in _heading_words(named[0]):
            advice = "geopotential altitudes h are not geometric: with the radius R of the body, z = R h/(R - h)"
        elif named[0].unit:
            expected = f"{name} in {_SI[name]}, or in another unit of that dimension"
    raise PeriluneError(what, got=got, expected=expected, advice=advice)


def _heading_words(heading: TableHeading) -> list[str]:
    """Return all words of a heading, known or not."""
    return [*heading.words, *heading.text.casefold().replace("_", " ").replace("[", " ").replace("(", " ").split()]


def _with_unit_row(name: str, column: _AirColumn, units: list[str] | None) -> _AirColumn:
    """Return the column with the unit that is written below its heading."""
    if units is None or column.place >= len(units) or not units[column.place]:
        return column
    stated = unit_as_written(units[column.place])
    if (
        stated is None
        or parse_unit(stated)[1] != parse_unit(_SI[name])[1]
        or (column.unit and parse_unit(column.unit) != parse_unit(stated))
    ):
        raise PeriluneError(
            f"the unit of the {name} cannot be read", got=repr(units[column.place][:60]),
            expected=f"{column.unit or _SI[name]}, or another unit of that dimension" if not column.unit else
            f"{column.unit}, as its heading says", advice=_EXPECTED,
        )  # fmt: skip
    return replace(column, unit=stated)


def _refuse_conflicting_unit(name: str, comments: list[TextLine]) -> None:
    """Refuse a comment that names another unit for a column whose heading states none."""
    for line in comments:
        for written in _possible_units(line.text):
            stated = unit_as_written(written)
            if (
                stated is not None
                and parse_unit(stated)[1] == parse_unit(_SI[name])[1]
                and parse_unit(stated) != parse_unit(_SI[name])
            ):
                raise PeriluneError(
                    f"line {line.number} of the table of air mentions {stated}, but no heading states the unit of the"
                    f" {name}",
                    got=line.text[:60], expected=f"a heading such as {name} [{stated}]",
                    advice="state the units in headings, or change the comment if it means something else",
                )  # fmt: skip


def _possible_units(comment: str) -> list[str]:
    """Return the parts of a comment that may be the unit of a column."""
    parts = [part.strip(".-–—") for part in _IN_PROSE.findall(comment)]
    return [*_BRACKETED.findall(comment),
            *(part for before, part in pairwise(["", *parts]) if not before[-1:].isdigit())]  # fmt: skip


# -- what is said ---------------------------------------------------------------------------------------------------


def _describe_table(
    values: dict[str, Vector], found: dict[str, Vector], columns: dict[str, _AirColumn], ignored: list[str]
) -> str:
    """Describe rows, units and ranges, as ``51 rows; altitude in ft, 0 to 460 000 (0 to 140.208 km); …``."""
    parts = [f"{len(found['altitude'])} rows"]
    for name, column in columns.items():
        low, high = (f"{_group_thousands(end(values[name]))}" for end in (np.min, np.max))
        said = f"{name} in {column.unit or _SI[name]}{'' if column.unit else ' (no unit is stated)'}, {low} to {high}"
        if column.unit and parse_unit(column.unit)[0] != 1.0:
            low, high = (f"{_group_thousands(end(found[name]))}" for end in (np.min, np.max))
            said += f" ({low} to {high} {_SI[name]})"
        parts.append(said + " (H is read as geometric, not geopotential)" * column.unclear)
    if ignored:
        named = ", ".join(ignored[:_MOST_NAMED]) + (", …" if len(ignored) > _MOST_NAMED else "")
        parts.append(f"not used: {named}")
    return "; ".join(parts)


def _group_thousands(value: float) -> str:
    """Format a number in six digits, its thousands separated."""
    value = float(value)
    if 1e4 <= abs(value) < 1e9:
        return f"{value:,.0f}".replace(",", " ")
    return f"{value:.6g}"
