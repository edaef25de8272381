"""Dates and times as people state them: ISO 8601 or a datetime, in years for which the models hold."""

from __future__ import annotations

import re
from datetime import UTC, datetime

from perilune.core.errors import PeriluneError
from perilune.core.validation import wrong_type_error

# How bodies are turned in space is told by polynomials about J2000, which are of use for a century or two.
FIRST, END = (datetime(year, 1, 1, tzinfo=UTC) for year in (1900, 2200))
EXAMPLE = "2030-01-01T00:00:00"
_LEAP = re.compile(r"\d:?60([.,]\d+)?(Z|[+-]\d\d:?\d\d)?$")
_FINER = re.compile(r"[.,]\d{6}\d*[1-9]")  # than a microsecond, which a datetime would cut


def instant(stated: str | datetime, name: str = "the epoch") -> datetime:
    """Return a time in UTC, the zone of a time that states none.

    Parameters
    ----------
    stated
        ISO 8601 text or datetime.
    name
        Description of the value in messages.

    Raises
    ------
    PeriluneError
        If it is no time, not before `END` and from `FIRST` on, finer than a microsecond, or in a leap second; `name` is
        what is stated.
    """
    if isinstance(stated, type) or not isinstance(stated, str | datetime):
        raise wrong_type_error(stated, f'a text such as "{EXAMPLE}", or a datetime', "an epoch")
    if _FINER.search(str(stated)):
        raise PeriluneError(
            f"{name} has more digits than can be stored", got=str(stated)[:60], expected="microseconds at most",
            advice="round it",
        )  # fmt: skip
    if isinstance(stated, str) and "T" in stated and _LEAP.search(stated):
        raise PeriluneError(
            f"{name} has a second 60, which only leap seconds have", got=stated[:60],
            expected="a time before or after it", advice="start a second earlier or later",
        )  # fmt: skip
    try:
        found = datetime.fromisoformat(stated) if isinstance(stated, str) else stated
        found = found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)
        if not FIRST <= found < END:
            raise ValueError
        return found
    except (ValueError, OverflowError):
        raise PeriluneError(
            f"{name} is not a supported time", got=repr(stated)[:60],
            expected=f'ISO 8601 from {FIRST.year} on and before {END.year}, as "{EXAMPLE}"',
        ) from None  # fmt: skip
