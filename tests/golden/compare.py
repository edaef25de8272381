"""Differences between two records: to the last bit, or those that no machine's libraries explain."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

#: What hangs on rounding: how long a search took, errors that are left, digests and sizes of files.
ROUNDING = {"effort", "files", "bytes", "residual", "error_bound", "guess_error", "steps", "drift", "path", "minimum"}
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_RELATIVE, _ABSOLUTE = 1e-6, 1e-9
_NOISE = 1e-6  # below it a number in a sentence may be an error of rounding


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Return the differences of two records: in a key, in a number or in words."""

    kind: str
    where: str
    was: Any
    now: Any

    def __str__(self) -> str:
        return f"{self.kind}: {self.where}: {self.was!r:.200} -> {self.now!r:.200}"


def record_differences(was: Any, now: Any, exact: bool, where: str = "") -> Iterator[Difference]:
    """Yield where `now` differs from `was`; exact, in any bit, else beyond what another machine may make of it."""
    if isinstance(was, dict) and isinstance(now, dict):
        yield from _in_dictionaries(was, now, exact, where)
    elif isinstance(was, list) and isinstance(now, list):
        if len(was) != len(now):
            yield Difference(kind="number", where=f"{where}, entries", was=len(was), now=len(now))
        size = max((abs(value) for value in was if _is_real(value) and value == value), default=0.0)
        for i, (old, new) in enumerate(zip(was, now, strict=False)):
            if exact or not (_is_real(old) and _is_real(new)) or not _close(old, new, size):
                yield from record_differences(old, new, exact, f"{where}[{i}]")
    elif not _same(was, now, exact):
        kind = "number" if _is_real(was) and _is_real(now) else "words"
        yield Difference(kind=kind, where=where, was=was, now=now)


def _in_dictionaries(was: dict[str, Any], now: dict[str, Any], exact: bool, where: str) -> Iterator[Difference]:
    if len(was) == len(now) and was.keys() != now.keys():  # keys were renamed: each stands where it stood
        pairs = list(zip(was, now, strict=True))
    else:
        pairs = [(key, key) for key in was if key in now]
        for key in [*(key for key in was if key not in now), *(key for key in now if key not in was)]:
            yield Difference(kind="key", where=where, was=key if key in was else None, now=key if key in now else None)
    measured = {"value", "limit", "own_limit"} if "limit" in was else set()  # a check's own, which are of rounding
    for old, new in pairs:
        if old != new:
            yield Difference(kind="key", where=where, was=old, now=new)
        if exact or old not in ROUNDING | measured:
            yield from record_differences(was[old], now[new], exact, f"{where}/{new}")


def _is_real(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _same(was: Any, now: Any, exact: bool) -> bool:
    if exact:
        return type(was) is type(now) and repr(was) == repr(now)
    if isinstance(was, float) and _is_real(now):
        return _close(was, now, abs(was))
    if isinstance(was, str) and isinstance(now, str):
        return _said_alike(was, now)
    return type(was) is type(now) and was == now


def _close(was: float, now: float, size: float) -> bool:
    """Return whether a number is another within rounding, among numbers of a size."""
    if not (isinstance(was, float) or isinstance(now, float)):
        return was == now
    allowed = _RELATIVE * abs(was) + _ABSOLUTE * (1 + 1e-3 * size)
    return was == now or (was != was and now != now) or abs(was - now) <= allowed


def _said_alike(was: str, now: str) -> bool:
    """Return whether sentences have the same words, and their numbers are the same within a unit of the last digit."""
    if was == now:
        return True
    numbers = [_NUMBER.findall(text) for text in (was, now)]
    if _NUMBER.sub("#", was).split() != _NUMBER.sub("#", now).split():
        return False
    return all(_digits_alike(*pair) for pair in zip(*numbers, strict=True))


def _digits_alike(was: str, now: str) -> bool:
    old, new = float(was), float(now)
    mantissa, _, power = was.partition("e")
    unit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    return abs(old - new) <= 1.01 * unit or max(abs(old), abs(new)) < _NOISE
