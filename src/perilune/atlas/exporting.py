"""The nodes of an atlas as one file for other programs: NetCDF, which xarray opens, or Parquet.

NetCDF has the classic format with 64-bit offsets, which SciPy writes; Parquet needs pyarrow, of the extra ``export``.
Both describe each column with its unit, and the problem with the versions of programs. A file is written under another
name and renamed.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from perilune.atlas.query import Atlas
from perilune.atlas.table import NodeTable
from perilune.io.exports.formats import format_of
from perilune.io.files import fresh_file, new_file
from perilune.words.asked import check_call, require_type
from perilune.words.outcome import PeriluneError

_LARGEST = 2**31 - 8  # bytes of a variable of a classic NetCDF file, as SciPy writes it


@check_call
def export(atlas: Atlas, file: str | Path, form: str | None = None, *, force: bool = False) -> Path:
    """Write all nodes of an atlas into one file.

    Parameters
    ----------
    atlas
        As `perilune.atlas.open` gives it.
    file
        Where.
    form
        ``netcdf`` or ``parquet``; by how the file is called if None, and NetCDF where that says none.
    force
        Whether a file that is there may be replaced.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    PeriluneError
        If the form is not known or not what the file is called, nothing is built yet, a shard is damaged, the file is
        there already or cannot be written, or pyarrow is not installed.
    """
    require_type(atlas, Atlas, "an atlas to export", "perilune.atlas.open(directory)")
    path = new_file(file, "an export", force)
    form = format_of(path, form, list(FORMS))
    if not atlas.said:
        raise PeriluneError("there is nothing to export: no brick is built yet", got=str(atlas.store.directory))
    with fresh_file(path, "the export") as beside:
        FORMS[form](NodeTable(atlas), beside)
    return path


def _netcdf(table: NodeTable, path: Path) -> None:
    from scipy.io import netcdf_file

    rows = table.rows
    widest = max(int(np.prod(column.shape)) * np.dtype(column.kind).itemsize for column in table.columns)
    if rows * widest > _LARGEST:
        raise PeriluneError(
            "the atlas is too large for one NetCDF file", got=f"{rows} nodes",
            expected=f"at most {_LARGEST // widest}", advice="a file .parquet",
        )  # fmt: skip
    with netcdf_file(str(path), "w", version=2) as file:
        for name, text in table.provenance.items():
            setattr(file, name, text.encode() or b" ")
        file.createDimension("node", rows)
        file.createDimension("term", 2 ** len(table.atlas.region.axes))
        file.createDimension("unknown", table.unknowns + 1)
        written = {}
        for column in table.columns:
            dimensions = ("node", "term", "unknown")[: 1 + len(column.shape)]
            variable = file.createVariable(column.name, np.dtype(column.kind).newbyteorder(">"), dimensions)
            variable.units, variable.long_name = column.unit.encode(), column.about.encode()
            written[column.name] = variable
        start = 0
        for part in table.parts():
            end = start + len(part["chart"])
            for name, values in part.items():
                written[name][start:end] = values
            start = end


def _parquet(table: NodeTable, path: Path) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise PeriluneError(
            "Parquet needs pyarrow, which is not installed", advice="pip install 'perilune[export]', or a file .nc"
        ) from None
    fields = []
    for column in table.columns:
        kind = pa.from_numpy_dtype(np.dtype(column.kind))
        for length in reversed(column.shape):
            kind = pa.list_(kind, length)
        about = {"unit": column.unit, "about": column.about}
        fields.append(pa.field(column.name, kind, nullable=False, metadata=about))
    schema = pa.schema(fields, metadata={"perilune": json.dumps(table.provenance)})
    with pq.ParquetWriter(path, schema) as writer:
        for part in table.parts():
            arrays = []
            for field, column in zip(fields, table.columns, strict=True):
                array = pa.array(part[column.name].ravel())
                for length in reversed(column.shape):
                    array = pa.FixedSizeListArray.from_arrays(array, length)
                arrays.append(array.cast(field.type))
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))


FORMS: dict[str, Callable[[NodeTable, Path], None]] = {"netcdf": _netcdf, "parquet": _parquet}
