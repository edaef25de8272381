"""Checks of an untrusted JSON tree: each entry before it is used, and refused by its name.

`record_tree` writes a record (a dataclass of texts, numbers, and tuples of these or of records) without what is at its
default; `checked_record` reads one back by the types that its fields declare.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, NoReturn, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from perilune.core import PeriluneError, refuse_nested

LONGEST_TEXT = 10_000
DEEPEST_TREE = 16  # brackets; a problem's functions reach 6
_AGAIN = "solve again and save"
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
MOST_ENTRIES = 1000  # of a list that is no table: phases, extremals, unknowns
Kind = TypeVar("Kind")


def refuse_entry(where: str, got: str, expected: str) -> NoReturn:
    """Raise the refusal of one entry.

    Parameters
    ----------
    where
        Name of the entry.
    got, expected
        The value that was found and the one that was expected, in words.
    """
    raise PeriluneError(
        f"the saved solution does not fit its own problem: {where}",
        got=got,
        expected=expected,
        advice="solve again and save; saved files are not meant to be edited",
    )


def tree(content: str, what: str, advice: str = _AGAIN) -> Any:
    """Parse JSON strictly: no repeated names, no numbers that are not finite, no endless nesting.

    Texts may have no control characters but ends of lines, so that none moves the cursor when printed.

    Parameters
    ----------
    content
        Text of the document.
    what, advice
        Name of the document, and what to do, in messages.

    Raises
    ------
    PeriluneError
        If it breaks these rules; `what` names the document, `advice` says what to do.
    """
    refuse_nested(content, what, DEEPEST_TREE, expected="records and tables without deeper nesting", advice=advice)

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in found if names.count(name) > 1)
            raise PeriluneError(f"the {what} has a repeated name", got=twice[:60], expected="each name once",
                                advice=advice)  # fmt: skip
        for name, value in pairs:
            texts = [name, *(value if isinstance(value, list) else [value])]
            if any(isinstance(text, str) and _CONTROL.search(text) for text in texts):
                raise PeriluneError(f"the {what} holds control characters", got=repr(name)[:60], expected="plain text",
                                    advice=advice)  # fmt: skip
        return found

    def no_constant(name: str) -> NoReturn:
        expected = "finite numbers"
        raise PeriluneError(f"the {what} holds a number that is not finite", got=name, expected=expected, advice=advice)

    try:
        return json.loads(content, object_pairs_hook=once, parse_constant=no_constant, parse_int=_bounded_integer)
    except (ValueError, RecursionError) as error:
        if isinstance(error, PeriluneError):
            raise
        raise PeriluneError(
            f"the {what} is not readable JSON", got=str(error)[:120], expected="complete JSON as this program writes"
            " it",
            advice=advice,
        ) from None  # fmt: skip


def _bounded_integer(digits: str) -> int | float:
    """Parse an integer; one with many digits becomes a float, so that nothing overflows later."""
    return int(digits) if len(digits) < 18 else float(digits)


def part(entry: Mapping[str, Any], name: str, kind: type) -> Any:
    """Return the entry of a name, checked to be of a kind.

    Parameters
    ----------
    entry, name
        The tree, and the name of the entry in it.
    kind
        Type that the entry must have.
    """
    value = entry.get(name)
    if not isinstance(value, kind):
        refuse_entry(name, str(value)[:40], {dict: "a record", list: "a list", str: "a text"}[kind])
    return value


def short_text(entry: Mapping[str, Any], name: str) -> str:
    """Return the text of a name, checked not to be longer than a sentence may be.

    Parameters
    ----------
    entry, name
        Record of the tree, and the name of its entry.

    Raises
    ------
    PeriluneError
        If it is no text, or longer than `LONGEST_TEXT`.
    """
    found = part(entry, name, str)
    if len(found) > LONGEST_TEXT:
        refuse_entry(name, f"{len(found)} characters", f"a text of at most {LONGEST_TEXT}")
    return found


def finite_number(entry: Mapping[str, Any], name: str, where: str) -> float:
    """Return the finite number of a name; texts and booleans are refused.

    Parameters
    ----------
    entry, name
        Record of the tree, and the name of its entry.
    where
        Path of the record in messages.

    Raises
    ------
    PeriluneError
        If it is not a finite number.
    """
    return _checked_number(entry.get(name), f"{where}.{name}")


def _checked_number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        refuse_entry(where, str(value)[:40], "a number")
    try:
        found = float(value)
    except OverflowError:
        found = math.inf
    if not math.isfinite(found):
        refuse_entry(where, str(value)[:40], "a finite number")
    return found


def valued_numbers(document: Mapping[str, Any], name: str) -> dict[str, float]:
    """Return the values of ``{key: {"value": number}}``.

    Parameters
    ----------
    document, name
        Tree, and the name of the record of numbers.

    Raises
    ------
    PeriluneError
        If an entry is not a record with a finite number.
    """
    entries = part(document, name, dict)
    return {key: finite_number(part(entries, key, dict), "value", f"{name}.{key}") for key in entries}


def array(value: Any, where: str, shape: tuple[int | None, ...]) -> Any:
    """Return an array of finite numbers of a shape (None: any length); texts and booleans are refused.

    Parameters
    ----------
    value, where
        The entry, and its name for the message.
    shape
        Shape that it must have.
    """
    try:
        found = np.asarray(value)
    except ValueError:
        refuse_entry(where, "rows of unequal length", "a complete table of numbers")
    wanted = " x ".join("any" if n is None else str(n) for n in shape)
    fits = found.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, found.shape, strict=True))
    rows = value if len(shape) > 1 else [value]
    if fits and isinstance(value, list) and any(bool in set(map(type, row)) for row in rows):
        refuse_entry(where, "true or false among them", f"numbers, {wanted}")
    if (found.size and found.dtype.kind not in "if") or not fits:
        refuse_entry(where, f"{found.dtype.kind}-type table of shape {found.shape}", f"numbers, {wanted}")
    found = found.astype(float)
    if not np.isfinite(found).all():
        refuse_entry(where, "numbers that are not finite", "finite numbers")
    return found


def enumeration_member(kind: type, found: Any, where: str) -> Any:
    """Return the member of an enumeration; refuse None.

    Parameters
    ----------
    kind
        Enumeration, whose names are listed in the message.
    found
        Member, or None for an unknown word.
    where
        Path of the entry in messages.

    Raises
    ------
    PeriluneError
        If it is None.
    """
    if found is None:
        refuse_entry(where, "an unknown word", "one of " + ", ".join(str(m.name) for m in kind))  # type: ignore[attr-defined]
    return found


# -- records ----------------------------------------------------------------------------------------------------------


def record_tree(value: Any) -> Any:
    """Return a record as a tree for JSON, without the fields that have their defaults."""
    if is_dataclass(value) and not isinstance(value, type):
        shown = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
        defaults = {f.name: f.default for f in fields(value)}
        return {name: record_tree(entry) for name, entry in shown.items() if entry != defaults[name]}
    return [record_tree(entry) for entry in value] if isinstance(value, tuple) else value


def checked_record(kind: type[Kind], document: Any, where: str) -> Kind:
    """Build a record of a kind, which makes its own checks.

    Parameters
    ----------
    kind, document
        Class of the record, and its tree.
    where
        Name of the entry for the message.
    """
    if not isinstance(document, dict):
        refuse_entry(where, str(document)[:40], "a record")
    hints, known = _hints(kind), {f.name: f for f in fields(kind) if f.init}  # type: ignore[arg-type]
    for name in document:
        if name not in known:
            refuse_entry(f"{where}.{name}"[:100], "an unknown field", "one of " + ", ".join(known))
    for name, f in known.items():
        if name not in document and f.default is MISSING and f.default_factory is MISSING:
            refuse_entry(f"{where}.{name}", "nothing", "an entry")
    return kind(**{name: _checked_entry(hints[name], value, f"{where}.{name}") for name, value in document.items()})


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _checked_entry(hint: Any, value: Any, where: str) -> Any:
    """Return a value, checked to be of a declared type."""
    if get_origin(hint) in (Union, UnionType):
        choices = get_args(hint)
        if value is None and NoneType in choices:
            return None
        words = isinstance(value, str) and str in choices
        hint = str if words else next(h for h in choices if h not in (str, NoneType))
    if get_origin(hint) is tuple:
        return _checked_row(get_args(hint), value, where)
    if hint is str:
        if not isinstance(value, str) or len(value) > LONGEST_TEXT:
            refuse_entry(where, str(value)[:40], f"a text of at most {LONGEST_TEXT} characters")
        return value
    if hint in (float, int):
        return hint(_checked_number(value, where))
    if hint is bool:
        return value if isinstance(value, bool) else refuse_entry(where, str(value)[:40], "true or false")
    return checked_record(hint, value, where)


def _checked_row(hints: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    alike = len(hints) == 2 and hints[1] is Ellipsis
    if not isinstance(value, list) or len(value) > MOST_ENTRIES or not (alike or len(value) == len(hints)):
        refuse_entry(where, str(value)[:40], "a list" if alike else f"a list of {len(hints)}")
    each = (hints[0],) * len(value) if alike else hints
    return tuple(_checked_entry(h, v, f"{where}[{i}]") for i, (h, v) in enumerate(zip(each, value, strict=True)))
