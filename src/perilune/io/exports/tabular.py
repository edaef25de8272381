"""Table of a flight as CSV, Parquet, NetCDF, and as a frame of pandas or xarray.

NetCDF follows the CF conventions: each variable has its units and a long_name, time counts from the epoch where there
is one, and where longitude, latitude and height are known the file is a trajectory of its discrete geometries. It is of
the classic format with 64-bit offsets, which SciPy writes.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from perilune import __version__
from perilune.core import PeriluneError
from perilune.io.columns import round_degrees
from perilune.io.exports.epochs import leap_seconds_sentence, stamp
from perilune.io.exports.table import FlightColumn, FlightTable
from perilune.io.exports.time_scales import leap_seconds_within

if TYPE_CHECKING:
    import pandas
    import xarray

_CONVENTIONS = "CF-1.11"
# Attributes that the conventions have for a place; heights are above the body's sphere, or ellipsoid.
_PLACES = {
    "longitude": {"standard_name": "longitude", "units": "degrees_east"},
    "latitude": {"standard_name": "latitude", "units": "degrees_north"},
    "height": {"standard_name": "height_above_reference_ellipsoid", "positive": "up"},
}
_CF_UNITS = {"deg": "degree"}  # UDUNITS knows no "deg"
_DIMENSION = "time"
_PARTED = (
    "Where a phase ends or a value jumps, the row before is that of a microsecond earlier, so that no time occurs"
    " twice."
)


def write_csv(table: FlightTable, about: Mapping[str, str], epoch: datetime | None, path: Path) -> None:
    """Write names with units, then numbers that read back to the last bit; angles without the rounding of pi.

    The format has no texts outside the table: the proof stands in each row, so that any part of it has it.

    Parameters
    ----------
    table
        Table of the flight.
    about
        Texts on its origin (`perilune.io.exports.provenance`).
    epoch
        UTC at the begin of the flight, if stated.
    path
        File to write.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        stamps = [] if epoch is None else [("utc", "", [stamp(epoch, float(t)) for t in table.time])]
        cells = [
            (f.name, f.unit, [repr(round_degrees(v, f.unit)) if math.isfinite(v) else "" for v in f.values.tolist()])
            for f in table.fields
        ]
        shown = [
            ("time", "s", list(map(repr, table.time.tolist()))), *stamps,
            ("phase", "", table.phase_names.tolist()), *cells,
            *((name, "", [about[name]] * len(table.time)) for name in ("proof",) if name in about),
        ]  # fmt: skip
        writer.writerow([f"{name} [{unit}]" if unit else name for name, unit, _ in shown])
        writer.writerows(zip(*(column for _, _, column in shown), strict=True))


def write_parquet(table: FlightTable, about: Mapping[str, str], epoch: datetime | None, path: Path) -> None:
    """Write Parquet: columns with unit and description; the provenance as JSON under the key ``perilune``.

    Parameters
    ----------
    table
        Columns of all phases over time.
    about
        Provenance: texts by name.
    epoch
        UTC at the begin of the flight; None where not known.
    path
        File to write.

    Raises
    ------
    PeriluneError
        If pyarrow is not installed.
    """
    pa, pq = (package_of_extra(name, "Parquet") for name in ("pyarrow", "pyarrow.parquet"))
    utc = {} if epoch is None else {"epoch": f"{stamp(epoch, 0.0)}Z"}
    fields = [
        pa.field("time", pa.float64(), nullable=False, metadata={"unit": "s", "about": _TIME}),
        pa.field("phase", pa.string(), nullable=False, metadata={"unit": "", "about": "phase of the flight"}),
        *(pa.field(f.name, pa.float64(), metadata={"unit": f.unit, "about": f.about}) for f in table.fields),
    ]
    schema = pa.schema(fields, metadata={"perilune": json.dumps({**about, **utc})})
    arrays = [pa.array(table.time), pa.array(table.phase_names.tolist())]
    arrays += [pa.array(f.values, from_pandas=True) for f in table.fields]  # what a phase does not have is null
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), path)


def write_netcdf(table: FlightTable, about: Mapping[str, str], epoch: datetime | None, path: Path) -> None:
    """Write NetCDF by SciPy, following the CF conventions.

    Parameters
    ----------
    table
        Columns of all phases over time.
    about
        Provenance: texts by name.
    epoch
        UTC at the begin of the flight; None where not known.
    path
        File to write.

    Raises
    ------
    PeriluneError
        If the name of a column has other than ASCII letters.
    """
    from scipy.io import netcdf_file

    for name in (f.name for f in table.fields):
        if not name.isascii():
            raise PeriluneError(
                "NetCDF names are written in ASCII letters only", got=name,
                advice="csv or parquet, or another name in the problem",
            )  # fmt: skip
    with netcdf_file(str(path), "w", version=2) as file:
        for name, text in _file_attributes(table, about, epoch).items():
            setattr(file, name, text.encode())
        file.createDimension(_DIMENSION, len(table.time))
        for name, (values, attributes) in _netcdf_variables(table, epoch).items():
            dimensions = (_DIMENSION,)
            if values.dtype.kind == "S":
                values, dimensions = np.frombuffer(values.tobytes(), dtype="S1"), ("name_length",)
                file.createDimension(*dimensions, len(values))
            variable = file.createVariable(name, values.dtype.newbyteorder(">"), dimensions)
            variable[:] = values
            for key, value in attributes.items():
                setattr(variable, key, value.encode() if isinstance(value, str) else value)


def dataset_of(table: FlightTable, about: Mapping[str, str], epoch: datetime | None) -> xarray.Dataset:
    """Return the table as a data set of xarray, with longitude, latitude, height, time and phase as coordinates.

    Parameters
    ----------
    table
        Columns of all phases over time.
    about
        Provenance: texts by name.
    epoch
        UTC at the begin of the flight; None where not known.

    Raises
    ------
    PeriluneError
        If xarray is not installed.
    """
    xr = package_of_extra("xarray", "a data set of xarray")
    variables = {
        name: xr.Variable((_DIMENSION,) if values.ndim else (), values, attributes)
        for name, (values, attributes) in _netcdf_variables(table, epoch).items()
    }
    found = xr.Dataset(variables, attrs=_file_attributes(table, about, epoch)).set_coords("phase")
    return xr.decode_cf(found)


def frame_of(table: FlightTable, about: Mapping[str, str]) -> pandas.DataFrame:
    """Return the table as a frame of pandas, its index the time [s]; units and provenance in `attrs`.

    Parameters
    ----------
    table
        Columns of all phases over time.
    about
        Provenance: texts by name.

    Raises
    ------
    PeriluneError
        If pandas is not installed.
    """
    pd = package_of_extra("pandas", "a frame of pandas")
    found = pd.DataFrame(
        {"phase": table.phase_names, **{f.name: f.values for f in table.fields}},
        index=pd.Index(table.time, name="time"),
    )
    found.attrs = {"units": {"time": "s", **{f.name: f.unit for f in table.fields}}, **about}
    return found


_TIME = "time from the start of the flight"
_TRAJECTORY = "trajectory"


def _is_geometry(table: FlightTable, epoch: datetime | None) -> bool:
    """Return True if each row has a place and a time, as a trajectory of the conventions must."""
    return epoch is not None and {f.placed for f in table.fields} >= set(_PLACES)


def _file_attributes(table: FlightTable, about: Mapping[str, str], epoch: datetime | None) -> dict[str, str]:
    geometry = {"featureType": "trajectory"} if _is_geometry(table, epoch) else {}
    return {
        "Conventions": _CONVENTIONS,
        **geometry,
        "history": f"exported by perilune {__version__}",
        "comment": _PARTED,
        **about,
    }


def _netcdf_variables(table: FlightTable, epoch: datetime | None) -> dict[str, tuple[np.ndarray, dict[str, Any]]]:
    """Return values and attributes of each variable."""
    time: dict[str, Any] = {"units": "s", "long_name": _TIME}
    if epoch is not None:
        since = f"seconds since {stamp(epoch, 0.0).replace('T', ' ')[:-3]}"
        time = {"standard_name": "time", "long_name": "UTC", "units": since, "calendar": "standard"}
        if leap_seconds_within(epoch, float(table.time[-1])):
            # No calendar that readers know has leap seconds; lengths of time are right, dates behind the leap are not.
            leap = leap_seconds_sentence(epoch, float(table.time[-1]))
            late = f"{leap} It is counted here, so that later dates are one second late."
            time |= {"long_name": "UTC until a leap second", "units_metadata": "leap_seconds: none", "comment": late}
        else:
            time["units_metadata"] = "leap_seconds: utc"
    phase = {
        "long_name": "phase of the flight",
        "flag_meanings": " ".join(table.phases),
        "flag_values": np.arange(len(table.phases), dtype=np.int8),
    }
    found = {"time": (table.time, time), "phase": (table.phase, phase)}
    places = [f.name for f in table.fields if f.placed]
    if _is_geometry(table, epoch):
        found[_TRAJECTORY] = (np.array(b"flight"), {"cf_role": "trajectory_id", "long_name": "name of the flight"})
    for f in table.fields:
        found[f.name] = (f.values, _netcdf_attributes(f, places))
    return found


def _netcdf_attributes(f: FlightColumn, places: list[str]) -> dict[str, Any]:
    found: dict[str, Any] = {"units": cf_unit(f.unit), "long_name": f.about, **_PLACES.get(f.placed, {})}
    if not np.isfinite(f.values).all():
        found["_FillValue"] = np.float64(np.nan)
    if places and not f.placed:
        found["coordinates"] = " ".join(places)
    return found


def cf_unit(unit: str) -> str:
    """Return a unit in the form of the CF conventions."""
    return _CF_UNITS.get(unit, unit)


def package_of_extra(name: str, what: str) -> Any:
    """Import a package of the extra `export`.

    Parameters
    ----------
    name
        Name of the package, or of a module in it.
    what
        Format or object that needs it.

    Raises
    ------
    PeriluneError
        If it is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        needed = name.partition(".")[0]
        raise PeriluneError(
            f"{what} needs {needed}, which is not installed", advice="pip install 'perilune[export]'"
        ) from None


WRITERS = {"netcdf": write_netcdf, "csv": write_csv, "parquet": write_parquet}
