"""Column headings of tables with their units: ``alt (ft)``, ``density_slug_ft3``, ``h/km``, ``rho [kg m-3]``.

A heading is words that are known, then a unit, in brackets or without. All of it must be understood: what is left over
may be a unit that would be read past.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass

from perilune.core.errors import PeriluneError
from perilune.core.units import parse_unit
from perilune.core.untrusted_text import one_line

_LONGEST = 80  # characters of a heading
_BRACKETS = re.compile(r"[(\[{<]([^()\[\]{}<>]*)[)\]}>]")
_APART = re.compile(r"[\s_,:]+")
_FACTOR = re.compile(r"([A-Za-z]+)\^?([+-]?\d(?:\.5)?)?", re.ASCII)
_JOINED = re.compile(r"(kg|g|lbm?|slug)(m|cm|km|ft)\^?-?3", re.ASCII | re.IGNORECASE)  # kgm-3, gcm3
# Signs of powers and products that other programs write, as the parser of units takes them.
_SIGNS = str.maketrans(
    {"⁰": "0", "¹": "1", "²": "2", "³": "3", "⁴": "4", "⁻": "-", "−": "-", "·": "*", "⋅": "*", "×": "*"}
)
# Units spelt out or with capitals; none of these could be another unit.
_SPELT = {
    "foot": "ft", "feet": "ft", "metre": "m", "metres": "m", "meter": "m", "meters": "m",
    "kilometre": "km", "kilometres": "km", "kilometer": "km", "kilometers": "km", "slugs": "slug",
    "gram": "g", "grams": "g", "kilogram": "kg", "kilograms": "kg", "lbm": "lb", "lbs": "lb", "pound": "lb",
    "pounds": "lb", "cc": "cm^3",
    **{name: name for name in ("m", "km", "cm", "ft", "g", "kg", "lb", "slug")},
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TableHeading:
    """One heading, read.

    Parameters
    ----------
    text
        As it is written, in one line.
    words
        Those at its begin that are known, in lower case.
    unit
        As `perilune.core.units.parse_unit` takes it; "" where none is stated.
    unread
        What is neither; "" where all of it is understood.
    bracketed
        Whether something stands in brackets.
    """

    text: str
    words: tuple[str, ...] = ()
    unit: str = ""
    unread: str = ""
    bracketed: bool = False


def table_heading(text: str, known: Collection[str]) -> TableHeading:
    """Read a heading.

    Parameters
    ----------
    text
        Content of the cell.
    known
        Words in lower case that its name may be made of.
    """
    bare = one_line(text, _LONGEST)
    groups = [group.strip() for group in _BRACKETS.findall(bare) if group.strip()]
    rest, words = [part for part in _APART.split(_BRACKETS.sub(" ", bare)) if part], list[str]()
    while rest:
        first, slash, behind = rest[0].partition("/")
        if first.casefold() not in known:
            break
        words.append(first.casefold())
        rest[:1] = [behind] if slash and behind else []
    stated, unread = [], []
    for written in [*(["_".join(rest)] if rest else []), *groups]:
        as_unit, said = unit_as_written(written), [word.casefold() for word in _APART.split(written) if word]
        if as_unit is not None:
            stated.append(as_unit)
        elif all(word in known for word in said):
            words += said
        else:
            unread.append(written)
    if len(set(stated)) > 1:
        unread = [bare]
    found = stated[0] if stated else ""
    return TableHeading(
        text=bare, words=tuple(words), unit=found, unread=", ".join(unread), bracketed=bool(groups)
    )  # fmt: skip


def unit_as_written(text: str) -> str | None:
    """Return the unit of a heading in the grammar of `perilune.core.units`; None where it is none.

    Beyond that grammar: powers without ``^`` (``kg/m3``), ``per``, brackets around it, units spelt out (``feet``) or
    with capitals (``KM``), and units one after another: one with a negative power is a factor (``kg m-3``), another a
    divisor (``slug_ft3``), also without anything between them (``kgm-3``).
    """
    if len(text) > _LONGEST:
        return None
    bare = text.strip(" ()[]{}<>").translate(_SIGNS).replace("**", "^")
    bare = re.sub(r"(?<=[A-Za-z0-9])\.(?=[A-Za-z])", "*", re.sub(r"[\s_]+per[\s_]+", "/", bare))
    bare = _JOINED.sub(r"\1/\2^3", re.sub(r"\s*([*/^])\s*", r"\1", bare))
    parts = re.split(r"([*/\s_]+)", bare)
    found = ""
    for operator, part in zip(["", *parts[1::2]], parts[::2], strict=True):
        match = _FACTOR.fullmatch(part)
        if match is None:
            return None
        name, power = _SPELT.get(match[1].lower(), match[1]), match[2] or ""
        if not operator.strip(" _") and operator:
            operator = "*" if power.startswith("-") else "/"
        found += operator + name + (f"^{power}" if power else "")
    try:
        parse_unit(found)
    except PeriluneError:
        return None
    return found
