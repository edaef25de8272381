"""Times of a flight as formats write them: an epoch that somebody stated, and seconds after it."""

from __future__ import annotations

from datetime import datetime, timedelta

from perilune.problem.problem import Problem
from perilune.words.instants import EXAMPLE, instant
from perilune.words.outcome import PeriluneError


def epoch_of(problem: Problem, stated: str | datetime | None) -> datetime | None:
    """UTC at the begin of the flight: what is stated, else what the problem says, else None.

    Raises
    ------
    PeriluneError
        If what is stated is no time, or another than the problem's own.
    """
    own = problem.views.space.epoch if problem.views.space is not None else ""
    if stated is None:
        return instant(own) if own else None
    found = instant(stated)
    if own and found != instant(own):
        raise PeriluneError(
            "the problem has an epoch of its own", got=str(stated), expected=own,
            advice="leave the epoch out, or solve the problem at the other one",
        )  # fmt: skip
    return found


def needed_epoch(problem: Problem, stated: str | datetime | None, form: str) -> datetime:
    """The same for a format that has no times without one.

    Raises
    ------
    PeriluneError
        If there is none.
    """
    found = epoch_of(problem, stated)
    if found is None:
        raise PeriluneError(
            f"{form} needs the time at which the flight begins, and {problem.name} states none",
            expected="UTC in ISO 8601",
            advice=f'--epoch {EXAMPLE} (in Python epoch="{EXAMPLE}")',
        )
    return found


def stamp(epoch: datetime, seconds: float) -> str:
    """A time after the epoch in ISO 8601, UTC without a letter, to a nanosecond. No leap second is put in.

    Raises
    ------
    PeriluneError
        If it is behind the year 9999, which these formats cannot write.
    """
    whole, rest = divmod(1000 * epoch.microsecond + round(seconds * 1e9), 1_000_000_000)
    try:
        at = epoch.replace(microsecond=0, tzinfo=None) + timedelta(seconds=whole)
    except OverflowError:
        raise PeriluneError(
            "the flight goes on behind the year 9999", got=f"an epoch of {epoch.isoformat()}", expected="an earlier one"
        ) from None
    return f"{at.isoformat()}.{rest:09d}"
