"""Tables of numbers in delimited text files of other programs, each row with its line of the file.

Cells lie apart by tabs, semicolons, commas or blanks, in quotes or not (Python's `csv` reads them); decimals have a
point, or a comma throughout. Lines that begin with ``#`` or ``%`` are comments. Above the numbers stand headings and
units; numpy and MATLAB write them as comments.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from typing import NamedTuple

from perilune.core import PeriluneError, one_line

_DELIMITERS = ("\t", ";", ",", " ")
_NUMBER = re.compile(
    r"[+-]?(?:\d+(?:\.\d*|,\d+)?|[.,]\d+)(?:[ed][+-]?\d{1,3})?|[+-]?(?:nan|inf)", re.ASCII | re.IGNORECASE
)
_OF_EXCEL = re.compile(r'"?sep=.?"?')  # its first line, which names the delimiter
_CALLED = {",": "commas", ".": "points"}
_LONGEST = 60  # characters of a line that a message shows
_LOOKED_AT = 1000  # lines, for the delimiter
_MOST_COMMENTED = 50_000  # characters of comments, where headings and units may stand
# A comma or point before three digits, of a number above 1: it may part thousands as well as decimals.
_OF_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}", re.ASCII)


class TextLine(NamedTuple):
    """A line of a file and its number, from 1 on."""

    number: int
    text: str


class CellRow(NamedTuple):
    """The cells of a line, with its number."""

    line: int
    cells: list[str]


@dataclass(frozen=True, kw_only=True)
class DelimitedTable:
    """A table as it is written.

    Parameters
    ----------
    body
        Rows from the first that is made of numbers to the end.
    above
        Lines of text above it.
    comments, below
        Comments above it and further down, without their sign.
    delimiter
        What lies between cells.
    decimal_comma
        Whether decimals have a comma.
    what
        What it should be, for messages.
    """

    body: list[CellRow]
    above: list[TextLine]
    comments: list[TextLine]
    below: list[TextLine]
    delimiter: str
    decimal_comma: bool
    what: str

    def cells(self, line: TextLine, count: int) -> list[str] | None:
        """Return the cells of a line above the numbers; None if no delimiter splits it into `count`.

        Parameters
        ----------
        line
            A line of the file.
        count
            Number of cells wanted.
        """
        for delimiter in (self.delimiter, *_DELIMITERS):
            found = _split_cells(line.text, delimiter)
            if found is not None and delimiter == " ":
                found = _with_brackets(found)
            if found is not None and len(found) == count:
                return found
        return None

    def number(self, row: CellRow, column: int) -> float:
        """Return the number in a cell.

        Parameters
        ----------
        row
            Row of the table.
        column
            Number of the column, from 0.

        Raises
        ------
        PeriluneError
            If there is none.
        """
        cell = row.cells[column] if column < len(row.cells) else ""
        if _NUMBER.fullmatch(cell) is None:
            raise PeriluneError(
                f"line {row.line} of the {self.what} has no number in column {column + 1}",
                got=one_line(self.delimiter.join(row.cells), _LONGEST) or "an empty line",
                expected="a number in each row" + (", with a decimal comma" if self.decimal_comma else ""),
                advice="a line that begins with # is a comment",
            )
        return float(cell.replace(",", ".").lower().replace("d", "e"))  # Fortran's exponents


def delimited_table(text: str, what: str) -> DelimitedTable:
    """Find the cells of a table.

    Parameters
    ----------
    text
        Content of the file.
    what
        What it should be, as messages call it ("table of air").

    Raises
    ------
    PeriluneError
        If a line is not a row of cells, both commas and points stand in numbers, or commas may part thousands.
    """
    lines = [TextLine(k, line.strip(" ")) for k, line in enumerate(re.split(r"\r\n|\r|\n", text), 1) if line.strip()]
    if lines and lines[0].number == 1 and _OF_EXCEL.fullmatch(lines[0].text.strip()):
        lines = lines[1:]
    plain = [line for line in lines if not _is_comment(line)]
    delimiter = max(_DELIMITERS, key=lambda one: _likeness(plain[:_LOOKED_AT], one))
    rows = [_cell_row(line, delimiter, what) for line in plain]
    rows = [row for row in rows if any(row.cells)]
    first = next((k for k, row in enumerate(rows) if _count_numbers(row.cells) > min(1, len(row.cells) - 1)), len(rows))
    body = rows[first:]
    begin = body[0].line if body else lines[-1].number + 1 if lines else 1
    filled = {row.line for row in rows[:first]}
    comments = [line for line in lines if _is_comment(line)]
    _refuse_long(comments, what)
    comments = [TextLine(k, line.strip().lstrip("#%").strip(" ")) for k, line in comments]
    return DelimitedTable(
        body=body,
        above=[line for line in plain if line.number in filled],
        comments=[line for line in comments if line.number < begin],
        below=[line for line in comments if line.number > begin],
        delimiter=delimiter,
        decimal_comma=_has_decimal_comma(body, delimiter, what),
        what=what,
    )


def _is_comment(line: TextLine) -> bool:
    return line.text.lstrip().startswith(("#", "%"))


def _refuse_long(comments: list[TextLine], what: str) -> None:
    """Refuse comments of which a unit could be lost, as nobody looks through so many."""
    count = sum(len(line.text) for line in comments)
    if count > _MOST_COMMENTED:
        raise PeriluneError(
            f"the comments of the {what} are too long", got=f"{count} characters",
            expected=f"at most {_MOST_COMMENTED}, which are searched for units", advice="leave out comments without"
            " units",
        )  # fmt: skip


def _split_cells(text: str, delimiter: str) -> list[str] | None:
    """Split a line into cells; None if its quotes do not close."""
    if delimiter == " ":
        text = text.replace("\t", " ").strip()
    try:
        cells = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True, strict=True), [])
    except csv.Error:
        return None
    return [cell.strip() for cell in cells]


def _cell_row(line: TextLine, delimiter: str, what: str) -> CellRow:
    cells = _split_cells(line.text, delimiter)
    if cells is None:
        raise PeriluneError(
            f"line {line.number} of the {what} is not a row of cells", got=one_line(line.text, _LONGEST),
            expected='closed quotes, with "" for a quote inside', advice="leave the quotes out",
        )  # fmt: skip
    return CellRow(line.number, cells)


def _count_numbers(cells: list[str]) -> int:
    return sum(_NUMBER.fullmatch(cell) is not None for cell in cells)


def _likeness(lines: list[TextLine], delimiter: str) -> tuple[int, int]:
    """Return the number of lines made of at least two numbers only, and of lines with at least two numbers."""
    whole = some = 0
    for line in lines:
        cells = [cell for cell in _split_cells(line.text, delimiter) or [] if cell]
        count = _count_numbers(cells)
        whole, some = whole + (1 < count == len(cells)), some + (count > 1)
    return whole, some


def _with_brackets(cells: list[str]) -> list[str]:
    """Join a cell in brackets with the one before it, of cells separated by blanks."""
    joined, depth = list[str](), 0
    for cell in cells:
        if joined and (depth > 0 or cell.startswith(("(", "["))):
            joined[-1] += f" {cell}"
        else:
            joined.append(cell)
        depth += sum(cell.count(c) for c in "([") - sum(cell.count(c) for c in ")]")
    return joined


def _has_decimal_comma(body: list[CellRow], delimiter: str, what: str) -> bool:
    """Tell whether numbers have a decimal comma; one of both signs must be seen to part decimals, not thousands."""
    found, plain = dict[str, tuple[int, str]](), False
    for row in body:
        for cell in row.cells:
            if _NUMBER.fullmatch(cell):
                for sign in ".,":
                    if sign in cell:
                        found.setdefault(sign, (row.line, cell))
                plain = plain or (("," in cell or "." in cell) and not _OF_THOUSANDS.fullmatch(cell))
    if len(found) > 1:
        line = max(number for number, _ in found.values())
        raise PeriluneError(
            f"commas and points both occur in the numbers of the {what}: line {line}",
            got=" and ".join(f"{cell} in line {number}" for number, cell in sorted(found.values())),
            expected="a decimal point, or a decimal comma, in every row",
            advice="leave out thousands separators",
        )
    if plain or (delimiter == "," and "." in found):  # nobody parts thousands by points between commas
        return "," in found
    for sign, (line, cell) in found.items():
        bare, decimal = cell.replace(sign, ""), cell.replace(",", ".")
        raise PeriluneError(
            f"{_CALLED[sign]} in the numbers of the {what} may separate thousands or decimals: line {line}", got=cell,
            expected=f"{bare} or {decimal}{'' if sign == ',' else '0'}", advice="write it as one of these",
        )  # fmt: skip
    return "," in found
