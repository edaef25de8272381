"""Write a solution to one file of a format: under a temporary name, renamed when it is whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perilune.core import PeriluneError, check_call, require_type, wrong_type_error
from perilune.io.atomic_files import fresh_file, new_file
from perilune.io.exports.epochs import flight_epoch, needed_epoch
from perilune.io.exports.formats import ENDINGS, format_of
from perilune.io.exports.provenance import provenance
from perilune.problem import Solution

if TYPE_CHECKING:
    import pandas
    import xarray

FORMATS = tuple(ENDINGS)
_TIMED = {"oem": "an orbit ephemeris message (OEM)", "czml": "CZML"}  # that have no times without an epoch


@check_call
def export(
    solution: Solution,
    file: str | Path,
    format: str | None = None,
    *,
    epoch: str | datetime | None = None,
    object_name: str | None = None,
    object_id: str | None = None,
    scenario_text: str | None = None,
    force: bool = False,
) -> Path:
    """Write a solution into one file for other programs.

    Parameters
    ----------
    solution
        As a method or `perilune.load` gives it.
    file
        Where.
    format
        ``netcdf`` (CF conventions), ``csv``, ``parquet``, ``oem`` (CCSDS, version 2.0) or ``czml`` (Cesium); by how the
        file is called (``.nc`` for NetCDF) if None, and NetCDF where its name has no ending.
    epoch
        Time at the begin of the flight in ISO 8601, UTC unless it says otherwise. ``oem`` and ``czml`` need one, where
        the problem states none. A leap second that is known is counted; what has one in itself is no epoch.
    object_name, object_id
        ``OBJECT_NAME`` and ``OBJECT_ID`` of an ``oem``, which are the name of the problem and ``UNKNOWN`` if None; the
        standard recommends the name and the international designator (``2030-001A``) that the object is registered by.
    scenario_text
        The scenario that the problem was made of, to stand in the file.
    force
        Whether a file that is there may be replaced.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    PeriluneError
        If the format is not known or does not fit the problem or how the file is called, an epoch is missing, an object
        is named in a way that the format cannot have, the file already exists or cannot be written, or a package is
        not installed.
    """
    require_type(solution, Solution, "a solution to export", "perilune.load(DIR) reads one that was saved")
    if not isinstance(scenario_text, str | None):
        raise wrong_type_error(scenario_text, "a text, or None for a problem in Python", "the text of a scenario")
    about = provenance(solution, scenario_text)
    return write_export(
        solution, file, format, about, epoch=epoch, object_name=object_name, object_id=object_id, force=force
    )


def write_export(
    solution: Solution,
    file: str | Path,
    format: str | None,
    about: Mapping[str, str],
    *,
    epoch: str | datetime | None = None,
    object_name: str | None = None,
    object_id: str | None = None,
    force: bool = False,
) -> Path:
    """Write a solution as `export` does, with given texts on its origin (`perilune.io.exports.provenance`).

    Parameters
    ----------
    solution, file, format, epoch, object_name, object_id, force
        As in `export`.
    about
        Provenance: texts by name.

    Returns
    -------
    Path
        File that was written.

    Raises
    ------
    PeriluneError
        If the format has no place for what is given, or needs an epoch; or the file cannot be written.
    """
    path, format = export_target(file, format, force)
    named = require_object(format, object_name, object_id)
    found = needed_epoch(solution, epoch, _TIMED[format]) if format in _TIMED else None
    with fresh_file(path, "the export") as beside:
        _writer(format, named)(solution, about, found or flight_epoch(solution, epoch), beside)
    return path


def export_target(file: str | Path, format: str | None, force: bool) -> tuple[Path, str]:
    """Return the file as a path, and its format; refuse an unknown format, or a file that must not be replaced.

    Parameters
    ----------
    file, format
        The file; its format, None for the one of its suffix.
    force
        Replace an existing file.
    """
    path = new_file(file, "an export", force)
    return path, format_of(path, format, FORMATS)


def require_object(format: str, object_name: str | None, object_id: str | None) -> dict[str, str | None]:
    """Return the names of the object by their keywords; refuse a format without them, and names it does not allow.

    Parameters
    ----------
    format
        Name of the format.
    object_name, object_id
        As the user gave them; None where not.

    Raises
    ------
    PeriluneError
        If one is given and the format has no place for it, or it is not a valid name.
    """
    named = {"object_name": object_name, "object_id": object_id}
    asked = {name: text for name, text in named.items() if text is not None}
    if asked and format != "oem":
        raise PeriluneError(
            f"{format} has no place for {' and '.join(asked)}", expected="oem, which has", advice="leave it out"
        )
    for name, text in asked.items():
        from perilune.io.exports.oem import require_object_name

        require_object_name(text, name.upper())
    return named


def _writer(format: str, named: Mapping[str, str | None]) -> Callable[[Solution, Mapping[str, str], Any, Path], None]:
    """Return the writer of a format, loaded on demand."""
    if format == "oem":
        from perilune.io.exports.oem import write_oem

        return partial(write_oem, **named)
    if format == "czml":
        from perilune.io.exports.czml import write_czml

        return write_czml
    from perilune.io.exports.table import flight_table
    from perilune.io.exports.tabular import WRITERS

    parted = format == "netcdf"  # in which time is a dimension
    return lambda solution, about, epoch, path: WRITERS[format](flight_table(solution, parted), about, epoch, path)


def to_xarray(solution: Solution, *, epoch: str | datetime | None = None) -> xarray.Dataset:
    """Return the flight as a data set of xarray, with the content that ``format="netcdf"`` writes.

    Its dimension is the time, which increases strictly: ``interp`` and ``sel(time=..., method="nearest")`` take it.
    At a jump the row before is that of a microsecond earlier.

    Parameters
    ----------
    solution, epoch
        As for `export`.

    Raises
    ------
    PeriluneError
        If xarray is not installed.
    """
    from perilune.io.exports.table import flight_table
    from perilune.io.exports.tabular import dataset_of

    require_type(solution, Solution, "a solution to export")
    return dataset_of(flight_table(solution, parted=True), provenance(solution), flight_epoch(solution, epoch))


def to_dataframe(solution: Solution) -> pandas.DataFrame:
    """Return the flight as a frame of pandas, its index the time from the start of the flight [s].

    Raises
    ------
    PeriluneError
        If pandas is not installed.
    """
    from perilune.io.exports.table import flight_table
    from perilune.io.exports.tabular import frame_of

    require_type(solution, Solution, "a solution to export")
    return frame_of(flight_table(solution), provenance(solution))
