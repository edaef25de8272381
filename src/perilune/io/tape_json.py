"""Tape of a function read from a file: checked entry by entry, and nothing in it is evaluated as code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from perilune.core import PeriluneError, Table
from perilune.problem import ARITY, ROLES, Tape

MOST_INSTRUCTIONS, MOST_TABLES = 50_000, 100  # of one function in a file; the largest of the models has about 200


def tape_of(document: Any, names: Mapping[str, Sequence[str]], what: str) -> Tape:
    """Read and check a tape: known operations, operands before their use, names of the given records.

    Parameters
    ----------
    document
        Tree with instructions, outputs and tables.
    names
        Names of the components of each record that the tape may read.
    what
        Name of the function in messages.

    Raises
    ------
    PeriluneError
        If it is anything else.
    """
    entries = document.get("instructions") if isinstance(document, dict) else None
    outputs = document.get("outputs") if isinstance(document, dict) else None
    if not isinstance(entries, list) or not isinstance(outputs, list):
        raise _unreadable_expressions(what, "not a list of instructions and outputs")
    if max(len(entries), len(outputs)) > MOST_INSTRUCTIONS:
        raise _unreadable_expressions(what, f"more than {MOST_INSTRUCTIONS} instructions")
    read = document.get("tables", [])
    if not isinstance(read, list) or len(read) > MOST_TABLES:
        raise _unreadable_expressions(what, f"tables {str(read)[:60]}")
    tables = tuple(_table_of(entry, what) for entry in read)
    names = {**names, "table": [table.digest for table in tables]}
    for number, entry in enumerate(entries):
        if not _is_sound_entry(entry, number, names):
            raise _unreadable_expressions(what, f"instruction {number}: {str(entry)[:60]}")
    if not all(_before(i, len(entries)) for i in outputs):
        raise _unreadable_expressions(what, f"outputs {str(outputs)[:60]}")
    return Tape(tuple(tuple(entry) for entry in entries), tuple(outputs), tables)


def _is_sound_entry(entry: Any, number: int, names: Mapping[str, Sequence[str]]) -> bool:
    if not isinstance(entry, list) or not entry or not isinstance(entry[0], str):
        return False
    word, *rest = entry
    if word in ROLES:
        return len(rest) == 1 and isinstance(rest[0], str) and rest[0] in names.get(word, ())
    if word == "const":
        return len(rest) == 1 and isinstance(rest[0], str) and len(rest[0]) < 40 and _is_repr(rest[0])
    if word == "table":
        return len(rest) == 2 and _before(rest[0], number) and rest[1] in names["table"]
    return len(rest) == ARITY.get(word) and all(_before(i, number) for i in rest)


def _table_of(entry: Any, what: str) -> Table:
    try:
        return Table(entry["x"], entry["y"], entry["kind"])
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        raise _unreadable_expressions(what, f"a table: {str(error)[:60]}") from None


def _before(index: Any, number: int) -> bool:
    return isinstance(index, int) and not isinstance(index, bool) and 0 <= index < number


def _is_repr(text: str) -> bool:
    try:
        return repr(float(text)) == text
    except ValueError:
        return False


def _unreadable_expressions(what: str, got: str) -> PeriluneError:
    return PeriluneError(
        f"the expressions of {what} in the file cannot be read",
        got=got,
        expected="a list of known operations on earlier values, as `perilune.save` writes it",
        advice="save the solution again; saved files are not meant to be edited",
    )
