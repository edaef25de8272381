"""Time scales: the difference between ephemeris time and clocks, TDB - UTC, by the known leap seconds.

UTC has leap seconds since 1972. Before that it followed universal time in small steps and by the length of its second,
and before 1960 there was none: a time of those years is taken as universal time, TT - UT by the polynomials of Espenak
and Meeus (2006, Five Millennium Canon of Solar Eclipses, NASA/TP-2006-214141).
"""

from __future__ import annotations

from bisect import bisect_right
from datetime import UTC, datetime, timedelta

# Days at whose begin TAI - UTC became 10 s, 11 s and so on (IERS, Bulletin C and the list Leap_Second.dat).
_LEAPS = tuple(
    datetime(year, month, 1, tzinfo=UTC)
    for year, month in (
        (1972, 1), (1972, 7), (1973, 1), (1974, 1), (1975, 1), (1976, 1), (1977, 1), (1978, 1), (1979, 1), (1980, 1),
        (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7), (1994, 7),
        (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
    )
)  # fmt: skip
_FIRST, _TT = 10.0, 32.184  # s, TAI - UTC of the first of them; TT - TAI
# TT - UT [s] until a year, by powers of the years since another.
_UNIVERSAL = (
    (1920, 1900, (-2.79, 1.494119, -0.0598939, 0.0061966, -0.000197)),
    (1941, 1920, (21.20, 0.84493, -0.076100, 0.0020936)),
    (1961, 1950, (29.07, 0.407, -1 / 233, 1 / 2547)),
    (1972, 1975, (45.45, 1.067, -1 / 260, -1 / 718)),
)
_YEAR = timedelta(days=365.2425)


def tdb_minus_utc(epoch: datetime) -> float:
    """Return TDB - UTC [s], TDB taken as TT, from which it is never 2 ms away.

    After the last leap second that is known, what it has; before 1972 TT - UT, some 0.2 s from the UTC that there was.
    """
    if epoch >= _LEAPS[0]:
        return _TT + _FIRST + bisect_right(_LEAPS, epoch) - 1
    year = 2000 + (epoch - datetime(2000, 1, 1, tzinfo=UTC)) / _YEAR
    _, origin, powers = next(row for row in _UNIVERSAL if year < row[0] or row is _UNIVERSAL[-1])
    return sum(c * (year - origin) ** k for k, c in enumerate(powers))


def describe_tdb(epoch: datetime) -> str:
    """Describe TDB - UTC in words, with what is neglected."""
    ahead = tdb_minus_utc(epoch)
    if epoch < _LEAPS[0]:
        return (
            f"TDB taken as {ahead:.1f} s ahead of UTC, which in {epoch.year} is taken as universal time, within some "
            f"0.2 s; taking the {_TT + _FIRST:.3f} s of 1972 instead is {_TT + _FIRST - ahead:.1f} s off"
        )
    told = f"TDB taken as {ahead:.3f} s ahead of UTC"
    return f"{told} as since {_LEAPS[-1].year}: later leap seconds are not known" if epoch >= _LEAPS[-1] else told


def leap_seconds_within(epoch: datetime, seconds: float) -> tuple[datetime, ...]:
    """Return the days at whose begin a leap second ends that begins within so many seconds after an epoch.

    The first of all is none: in 1972 UTC began at a whole number of seconds from TAI.

    Parameters
    ----------
    epoch
        UTC with its time zone.
    seconds
        Length of the span [s].
    """
    found: list[datetime] = []
    for day in _LEAPS[1:]:
        if day > epoch and (day - epoch).total_seconds() + len(found) <= seconds:
            found.append(day)
    return tuple(found)


def utc_after(epoch: datetime, nanoseconds: int) -> str:
    """Return UTC so many nanoseconds of an even clock after an epoch, in ISO 8601; in a leap second it is 23:59:60.

    Parameters
    ----------
    epoch
        UTC with its time zone; a datetime never lies in a leap second.
    nanoseconds
        Not negative.
    """
    whole, rest = divmod(1000 * epoch.microsecond + nanoseconds, 1_000_000_000)
    begin = epoch.replace(microsecond=0)
    leaps = leap_seconds_within(begin, whole)
    # Behind each leap second the clocks read one second less; in the last one they read its second 60.
    at = begin + timedelta(seconds=whole - len(leaps))
    inside = bool(leaps) and at < leaps[-1]
    told = at.replace(tzinfo=None).isoformat()
    return f"{told[:-2]}{60 if inside else told[-2:]}.{rest:09d}"
