"""Checks of the lines of a manifest, so that a foreign one is refused before it is used.

Each line ends with a checksum of its content, as nothing else would show a changed digit. The shards that it describes
are checked when they are read (`perilune.atlas.store.store`).
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from perilune.core import PeriluneError
from perilune.io import finite, tree
from perilune.problem import Nature, with_new_keys

_CHECKSUM = "crc32"
_LAST = f', "{_CHECKSUM}": '  # before its value, which ends the line
_MOST_TIMES = 4096
_MOST_UNKNOWNS, _MOST_SHEETS, _MOST_CHARTS = 10_000, 10_000, 10_000


def written_line(said: Mapping[str, Any]) -> str:
    """Return a line as it is written, with its checksum, without the newline."""
    text = json.dumps(finite({name: value for name, value in said.items() if name != _CHECKSUM}), allow_nan=False)
    return f"{text[:-1]}{_LAST}{zlib.crc32(text.encode())}}}"


def read_line(line: bytes) -> dict[str, Any] | None:
    """Parse a line; None if it has changed since it was written, or is incomplete as its writer was killed.

    There is a line for each block, and `refuse_no_brick` checks all that is used of it: these are read without the
    checks that other documents need, eight times as fast.
    """
    text, told, checksum = line.rpartition(_LAST.encode())
    if not told or b"%d}" % zlib.crc32(text + b"}") != checksum:
        return None
    line = text + b"}"
    try:
        found = json.loads(line)
        if not (isinstance(found, dict) and found.get("kind") == "brick"):
            found = tree(line.decode(), "a line of a manifest")
    except (ValueError, RecursionError):
        return None
    return with_new_keys(found, "manifest") if isinstance(found, dict) else None


def is_cut_off(line: bytes) -> bool:
    """Return True if an unreadable line was cut off, as by a killed writer, and is not a complete one that changed."""
    _, told, checksum = line.rpartition(_LAST.encode())
    return not checksum.strip(b"0123456789") if told else line.count(b"{") != line.count(b"}")


@contextmanager
def damage_text(name: str) -> Iterator[None]:
    """Turn errors over the content of a file into a `PeriluneError` that calls the file damaged."""
    try:
        yield
    except PeriluneError:
        raise
    except (LookupError, TypeError, ValueError, OverflowError, AttributeError, MemoryError) as error:
        raise PeriluneError(
            f"the atlas is damaged: {name} has an entry that no atlas has",
            got=f"{type(error).__name__}: {error}"[:80], expected="the file as it was written",
        ) from error  # fmt: skip


def refuse_no_survey(line: Mapping[str, Any]) -> None:
    """Raise ValueError for an invalid line of a survey; the equations of its charts are checked elsewhere."""
    _refuse_unless(isinstance(line.get("digest"), str) and line["digest"].isalnum(), "a survey's digest")
    before, notes, edges, charts = (line.get(key, []) for key in ("predecessors", "notes", "edges", "charts"))
    _refuse_unless(_is_list_of(before, str), "the surveys before one")
    _refuse_unless(_is_list_of(notes, str), "its notes")
    _refuse_unless(_is_list_of(edges, dict), "edges of bricks")
    for axis in edges:
        _refuse_unless(
            _is_exact_integer(axis.get("first")) and _is_list_of(axis.get("at"), int, float), "edges of bricks"
        )
    _refuse_unless(_is_list_of(charts, dict) and 0 < len(charts) <= _MOST_CHARTS, "the charts of a survey")
    for chart in charts:
        _refuse_unless(
            _is_exact_integer(chart.get("unknowns")) and 0 < chart["unknowns"] <= _MOST_UNKNOWNS, "how many unknowns"
        )
        _refuse_unless(_shard(chart.get("seeds")), "the shard of a survey")
        widths = chart.get("widths", [])
        _refuse_unless(
            _is_list_of(widths, int, float) and all(0 < width < math.inf for width in widths), "the widths of a chart"
        )
        times = chart.get("reintegration_steps")
        _refuse_unless(
            _is_list_of(times, int) and all(0 < n <= _MOST_TIMES for n in times),
            "the steps of the independent re-integration",
        )
        without = chart.get("excluded_bricks", [])
        places = _is_list_of(without, list) and all(_is_exact_integer(number) for place in without for number in place)
        _refuse_unless(places, "places that a chart leaves out")
        _refuse_unless(
            _is_list_of(chart.get("sheets"), dict) and 0 < len(chart["sheets"]) <= _MOST_SHEETS, "the sheets of a chart"
        )
        for sheet in chart["sheets"]:
            holds = sheet.get("active_bounds")
            _refuse_unless(isinstance(holds, dict) and set(holds.values()) <= {"lower", "upper"}, "what a sheet holds")
            _refuse_unless(sheet.get("orientation") in (-1, 1), "the side of a fold")
            _refuse_unless(sheet.get("nature") in Nature.__members__, "the kind of a sheet's extremals")


def refuse_no_brick(line: Mapping[str, Any], d: int, charts: int) -> None:
    """Raise ValueError for an invalid line of a block, of an atlas of d axes and so many charts.

    Parameters
    ----------
    line
        Line of the manifest.
    d, charts
        Numbers of axes and of charts.

    Raises
    ------
    ValueError
        If an entry is missing or has another type or range.
    """
    place: Any = line.get("brick")
    _refuse_unless(
        _is_list_of(place, int) and len(place) == d and all(map(_is_exact_integer, place)), "numbers of a brick"
    )
    _refuse_unless(_is_exact_integer(line.get("chart")) and 0 <= line["chart"] < charts, "the chart of a brick")
    name = line.get("name")
    _refuse_unless(
        isinstance(name, str) and len(name) <= 80 and name.isascii() and name.isprintable(), "the name of a brick"
    )
    _refuse_unless(_is_exact_integer(line.get("round", 0)) and line.get("round", 0) >= 0, "the round of a brick")
    _refuse_unless(
        _is_exact_integer(line.get("thin_margin", 0)) and line.get("thin_margin", 0) >= 0,
        "how many nodes have a thin margin",
    )
    _refuse_unless(_shard(line.get("nodes")) and _shard(line.get("cells")), "the shards of a brick")


def refuse_no_sample(line: Mapping[str, Any], d: int) -> None:
    """Raise ValueError for an invalid line of proofs, of an atlas of d axes.

    Parameters
    ----------
    line
        Line of the manifest.
    d
        Number of axes.

    Raises
    ------
    ValueError
        If an entry is missing or has another type or range.
    """
    _refuse_unless(_is_exact_integer(line.get("requested")) and line["requested"] >= 0, "how many proofs")
    _refuse_unless(
        _is_exact_integer(line.get("refused", 0)) and line.get("refused", 0) >= 0, "how many places are refused"
    )
    for kind in ("drawn", "thin_margin", "merged"):
        certificates: Any = line.get(kind, [] if kind == "merged" else None)
        _refuse_unless(_is_list_of(certificates, dict), f"certificates that are {kind}")
        for one in certificates:
            values = one.get("values")
            _refuse_unless(
                _is_list_of(values, int, float) and len(values) == d and _is_exact_integer(one.get("level")),
                "a certificate",
            )
            _refuse_unless(_is_list_of(one.get("failed"), str), "checks that failed")


def _shard(said: Any) -> bool:
    return (
        isinstance(said, dict)
        and isinstance(said.get("file"), str)
        and isinstance(said.get("sha256"), str)
        and all(_is_exact_integer(said.get(key)) and said[key] >= 0 for key in ("rows", "bytes"))
    )


def _is_exact_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and math.fabs(value) < 2**53


def _is_list_of(values: Any, *kinds: type) -> bool:
    return isinstance(values, list) and all(isinstance(v, kinds) and not isinstance(v, bool) for v in values)


def _refuse_unless(said: bool, what: str) -> None:
    if not said:
        raise ValueError(f"{what}: not as a builder writes it")
