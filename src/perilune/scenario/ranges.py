"""The values of a sweep, ``START:STOP:STEP`` of one key."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from perilune.words.declared import LONGEST_VALUE, Quantity, named
from perilune.words.outcome import PeriluneError, unknown_name
from perilune.words.units import parse_quantity

MOST_STEPS = 10_000
_ADVICE = 'for example --vary "retro.delta_v=0:1600:50 m/s", or with a unit in each part'


def values_of(key: str, text: str, known: Mapping[str, Quantity]) -> list[float]:
    """Values in SI of ``"START:STOP:STEP"`` for a key; the unit may stand in each part or in the last only.

    STOP is included where a step meets it. `known` are the keys that may be varied.

    Raises
    ------
    PeriluneError
        If there is no such key, it is no such range, has more than `MOST_STEPS` values, or the step leads away from
        STOP.
    """
    if key not in known:
        raise unknown_name("key with a quantity", key, list(known))
    quantity, parts = known[key], [part.strip() for part in text[:LONGEST_VALUE].split(":")]
    if len(parts) != 3 or not all(parts):
        raise PeriluneError(
            f"the range of {key} must have three parts",
            got=repr(text[:60]),
            expected="START:STOP:STEP",
            advice=_ADVICE,
        )
    last_unit = re.sub(r"^[-+\d.]+([eE][-+]?\d+)?\s*", "", parts[2])
    parts = [f"{part} {last_unit}" if re.fullmatch(r"[-+\d.]+([eE][-+]?\d+)?", part) else part for part in parts]
    try:
        start, stop = (float(quantity.read(part)) for part in parts[:2])
        step = parse_quantity(parts[2], quantity.unit)
    except PeriluneError as error:
        said = named(key, error)
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
