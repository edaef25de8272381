"""Ranges of one key: the values of a sweep, ``START:STOP:STEP`` or ``A,B,C``, and the ends of an axis, ``LOW:HIGH``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from perilune.core import (
    LONGEST_VALUE,
    PeriluneError,
    Quantity,
    check_call,
    one_line,
    parse_quantity,
    require_type,
    unknown_name,
    with_key_named,
    wrong_type_error,
)

MOST_STEPS = 10_000
_BARE = r"[-+]?nan|[-+]?inf|[-+\d.]+(?:[eE][-+]?\d+)?"  # what stands before a unit; if it is a number its reader says
_ENDS = 'for example --vary "vehicle.thrust=350:650 N", or with a unit in each part'
_ADVICE = (
    'for example --vary "retro.delta_v=0:1600:50 m/s" or "retro.delta_v=0,400,1600 m/s", or with a unit in each part'
)
_LONGEST_LIST = 20_000  # characters


@check_call
def values_of(key: str, text: str, known: Mapping[str, Quantity]) -> list[float]:
    """Return the values in SI of ``"START:STOP:STEP"`` or of a list ``"A,B,C"`` for a key.

    The unit may stand in each part or in the last only. STOP is included where a step meets it.

    Parameters
    ----------
    key, text
        The key as a scenario writes it, and its range or list.
    known
        The keys that may be varied.

    Raises
    ------
    PeriluneError
        If there is no such key, it is no such range or list, the range has more than `MOST_STEPS` values, its step
        leads away from STOP, or a value stands in the list twice.
    """
    if isinstance(text, str) and "," in text:
        return _listed_values(key, text, known)
    quantity, parts = _range_parts(key, text, known, "START:STOP:STEP", _ADVICE)
    try:
        start, stop = (float(quantity.read(part)) for part in parts[:2])
        step = parse_quantity(parts[2], quantity.unit)
    except PeriluneError as error:
        said = with_key_named(key, error)
        raise PeriluneError(said.what, got=said.got, expected=said.expected, advice=_ADVICE) from None
    steps = (stop - start) / step if step else math.inf
    if not 0 <= steps < MOST_STEPS:
        endless = not step or steps < 0
        raise PeriluneError(
            f"the range of {key} has no end" if endless else f"the range of {key} is too long",
            got=repr(text[:60]),
            expected=f"a step that leads from START to STOP in less than {MOST_STEPS} steps",
            advice="give the step the sign of STOP - START" if endless else "take a larger step",
        )
    return [start + k * step for k in range(int(steps + 1e-9) + 1)]


def _listed_values(key: str, text: str, known: Mapping[str, Quantity]) -> list[float]:
    """Return the values in SI of a list, in its order."""
    quantity, parts = _split_range(key, text, known, ",")
    if not all(parts) or any(":" in part for part in parts) or len(text) > _LONGEST_LIST:
        raise PeriluneError(
            f"the values of {key} are not a list", got=one_line(text, 60),
            expected=f"A,B,C UNIT, a comma between values, at most {_LONGEST_LIST} characters; or START:STOP:STEP",
            advice=_ADVICE,
        )  # fmt: skip
    try:
        values = [float(quantity.read(part)) for part in parts]
    except PeriluneError as error:
        said = with_key_named(key, error)
        raise PeriluneError(said.what, got=said.got, expected=said.expected, advice=_ADVICE) from None
    if len(set(values)) < len(values):
        twice = next(part for k, part in enumerate(parts) if values[k] in values[:k])
        raise PeriluneError(
            f"a value of {key} occurs twice in its list", got=twice, expected="each value once", advice=_ADVICE
        )
    return values


@check_call
def bounds_of(key: str, text: str, known: Mapping[str, Quantity]) -> tuple[float, float]:
    """Return the ends in SI of ``"LOW:HIGH"`` for a key; the unit may stand in each part or in the last only.

    Parameters
    ----------
    key
        Key of a scenario, as ``vehicle.thrust``.
    text
        Range as the user wrote it.
    known
        Quantities that may vary, by key.

    Raises
    ------
    PeriluneError
        If there is no such key, or it is no such range.
    """
    quantity, parts = _range_parts(key, text, known, "LOW:HIGH", _ENDS)
    try:
        low, high = (float(quantity.read(part)) for part in parts)
    except PeriluneError as error:
        said = with_key_named(key, error)
        raise PeriluneError(said.what, got=said.got, expected=said.expected, advice=_ENDS) from None
    if not low < high:
        raise PeriluneError(f"the range of {key} is empty", got=repr(text[:60]), expected="LOW < HIGH", advice=_ENDS)
    return low, high


def _range_parts(
    key: str, text: str, known: Mapping[str, Quantity], form: str, advice: str
) -> tuple[Quantity, list[str]]:
    """Return the declaration of a key, and the parts of a range, each with its unit."""
    quantity, parts = _split_range(key, text, known, ":")
    wanted = form.count(":") + 1
    if len(parts) != wanted or not all(parts) or len(text) > LONGEST_VALUE:
        many = {2: "two", 3: "three"}[wanted]
        raise PeriluneError(
            f"the range of {key} must have {many} parts",
            got=one_line(text, 60) or "nothing",
            expected=form,
            advice=advice,
        )
    return quantity, parts


def _split_range(key: str, text: str, known: Mapping[str, Quantity], sign: str) -> tuple[Quantity, list[str]]:
    """Return the declaration of a key, and the parts between signs; a part without a unit has that of the last."""
    require_type(known, Mapping, "a valid table of the keys that may be varied")
    for value, what in ((key, "a key"), (text, "a range")):
        if not isinstance(value, str):
            raise wrong_type_error(value, "a text", what)
    if key not in known:
        raise unknown_name("key with a quantity", key, list(known))
    parts = [part.strip() for part in text.split(sign)]
    last_unit = re.sub(rf"^(?:{_BARE})\s*", "", parts[-1])
    return known[key], [f"{part} {last_unit}" if re.fullmatch(_BARE, part) else part for part in parts]
