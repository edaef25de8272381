"""How far the time of ephemerides is ahead of the clocks: TDB - UTC by the leap seconds that are known."""

from __future__ import annotations

from bisect import bisect_right
from datetime import UTC, datetime

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


def tdb_minus_utc(epoch: datetime) -> float:
    """TDB - UTC [s], TDB taken as TT, from which it is never 2 ms away.

    Before the first leap second and after the last that is known, what these have.
    """
    return _TT + _FIRST + max(bisect_right(_LEAPS, epoch) - 1, 0)


def told_tdb(epoch: datetime) -> str:
    """The same in words, with what is neglected."""
    told = f"TDB taken as {tdb_minus_utc(epoch):.3f} s ahead of UTC"
    if epoch < _LEAPS[0]:
        # TT - UT was -3 s in 1900 (Espenak and Meeus 2006), and UTC kept near to UT.
        return f"{told} as in {_LEAPS[0].year}, which before is too much by up to 45 s"
    return f"{told} as since {_LEAPS[-1].year}: later leap seconds are not known" if epoch >= _LEAPS[-1] else told
