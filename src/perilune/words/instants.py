"""Instants as people state them: ISO 8601, UTC unless it says otherwise."""

from __future__ import annotations

from datetime import UTC, datetime

from perilune.words.asked import refused
from perilune.words.outcome import PeriluneError

EXAMPLE = "2030-01-01T00:00:00"


def instant(stated: str | datetime) -> datetime:
    """The instant in UTC.

    Raises
    ------
    PeriluneError
        If what is stated is no time.
    """
    if isinstance(stated, type) or not isinstance(stated, str | datetime):
        raise refused(stated, f'a text such as "{EXAMPLE}", or a datetime', "an epoch")
    try:
        found = datetime.fromisoformat(stated) if isinstance(stated, str) else stated
        return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)
    except (ValueError, OverflowError):
        raise PeriluneError(
            "the epoch is no time", got=repr(stated)[:60], expected=f'UTC in ISO 8601, as "{EXAMPLE}"'
        ) from None
