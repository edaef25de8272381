"""Times of a flight as formats write them: a stated epoch, and seconds after it."""

from __future__ import annotations

from datetime import datetime, timedelta

from perilune.core import END, EXAMPLE, PeriluneError, instant
from perilune.io.exports.time_scales import leap_seconds_within, utc_after
from perilune.problem import Solution

TICK = 1e-6  # s


def flight_epoch(solution: Solution, stated: str | datetime | None) -> datetime | None:
    """Return UTC at the begin of the flight: the stated epoch, else the problem's, else None.

    Parameters
    ----------
    solution
        Solution, whose problem may state an epoch.
    stated
        UTC as the user states it; None for the problem's own.

    Raises
    ------
    PeriluneError
        If the stated epoch is no time, or differs from the problem's own, or the flight goes on too long for it.
    """
    space = solution.problem.views.space
    own = space.epoch if space is not None else ""
    if stated is None and not own:
        return None
    found = instant(own if stated is None else stated)
    if own and found != instant(own, "the problem's epoch"):
        raise PeriluneError(
            "the problem already has an epoch", got=str(stated), expected=own,
            advice="leave the epoch out, or solve the problem for the other one",
        )  # fmt: skip
    if solution.duration > (END - found).total_seconds():
        raise PeriluneError(
            f"the flight extends beyond the year {END.year - 1}", got=f"an epoch of {found.isoformat()}",
            expected="an earlier one",
        )  # fmt: skip
    return found


def needed_epoch(solution: Solution, stated: str | datetime | None, form: str) -> datetime:
    """Return the epoch as `flight_epoch` does, for a format that needs one.

    Parameters
    ----------
    solution, stated
        As in `flight_epoch`.
    form
        Name of the format in messages.

    Raises
    ------
    PeriluneError
        If there is none.
    """
    found = flight_epoch(solution, stated)
    if found is None:
        raise PeriluneError(
            f"{form} needs the time at which the flight starts, and {solution.problem.name} states none",
            expected="UTC in ISO 8601",
            advice=f'--epoch {EXAMPLE} (in Python epoch="{EXAMPLE}")',
        )
    return found


def stamp(epoch: datetime, seconds: float) -> str:
    """Return UTC after the epoch in ISO 8601 without a letter, to a nanosecond; in a leap second it is 23:59:60.

    Parameters
    ----------
    epoch
        UTC at the begin of the flight.
    seconds
        Time after it [s].
    """
    return utc_after(epoch, round(seconds * 1e9))


def stamp_of_tick(epoch: datetime, seconds: float) -> str:
    """Return UTC as `stamp` does, to a microsecond, as finely as most readers resolve time.

    Parameters
    ----------
    epoch
        UTC at the begin of the flight.
    seconds
        Time after it [s].
    """
    return utc_after(epoch, 1000 * round(seconds / TICK))[:-3]


def leap_seconds_sentence(epoch: datetime, seconds: float) -> str:
    """Return a sentence on the known leap seconds within so many seconds after the epoch.

    Parameters
    ----------
    epoch
        UTC at the begin of the flight.
    seconds
        Duration of the flight [s].
    """
    days = leap_seconds_within(epoch, seconds)
    if not days:
        return "No known leap second lies within the flight."
    named = ", ".join(f"{day - timedelta(days=1):%Y-%m-%d}T23:59:60" for day in days)
    return f"The leap second {named} lies within the flight."
