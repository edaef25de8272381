"""Export formats by their names or endings; the writer of each is chosen in `perilune.io.exports.writing`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from perilune.core import PeriluneError, unknown_name

ENDINGS = {"netcdf": ".nc", "csv": ".csv", "parquet": ".parquet", "oem": ".oem", "czml": ".czml"}


def format_of(path: Path, format: str | None, known: Sequence[str]) -> str:
    """Return the format in which to write a file.

    Parameters
    ----------
    path, format
        The file, and what is asked for; None for what the name of the file says, the first of those known where the
        name has no ending.
    known
        Which there are.

    Raises
    ------
    PeriluneError
        If there is no such format, or the name of the file says another or one that nobody knows: who opens it would
        take it for that.
    """
    if format is not None and format not in known:
        raise unknown_name("format", format, known)
    named = next((name for name, ending in ENDINGS.items() if path.suffix.lower() == ending), None)
    if format is not None and named in (None, format):
        return format
    if format is None and named is not None and named in known:
        return named
    if format is None and not path.suffix:
        return known[0]
    fits = known if format is None else [format]
    raise PeriluneError(
        f"the file name has the ending of {named or 'no known format'}",
        got=path.name,
        expected=" or ".join(f"{path.stem}{ENDINGS[name]} for {name}" for name in fits),
        advice=f"name it by its format{_or_ask(named, format)}",
    )


def _or_ask(named: str | None, format: str | None) -> str:
    if named is None:
        return ", or give the format with format=... (--format)"
    return f", or request {named}" if format else ""
