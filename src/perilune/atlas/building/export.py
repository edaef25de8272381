"""Export of an atlas' nodes as a table: columns with names, units and descriptions, and their provenance.

Values of the axes, free parameters, J and dJ/dp are in SI; the terms of interpolation are canonical.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.building.audit import sample_of
from perilune.atlas.query.query import Atlas
from perilune.atlas.query.reader import are_possible_answers
from perilune.core import PeriluneError, check_call, quotient_unit, require_type
from perilune.io import format_of, fresh_file, new_file, program_versions

_FLOWN = {
    "margin": "margin by which the node is an answer of its sheet, canonical; negative beyond the sheet's border",
    "length": "Newton step there, relative",
    "residual": "largest residual of the end conditions in the independent re-integration, canonical",
    "path": "least value of the path conditions and of the states' distances from their bounds in the independent"
    " re-integration, canonical",
    "minimum": "least H of another control minus H of the control flown, in the independent re-integration, canonical",
    "drift": "change of H along the independent re-integration, canonical",
}


_OTHERS = {"objective", "chart", "sheet", "answer", "sequence", "terms", *_FLOWN}


def _parameter_column_name(parameter: str) -> str:
    """Return the name of the column of a parameter, changed if another column has it."""
    return f"parameter_{parameter}" if parameter in _OTHERS or parameter.startswith("slope_") else parameter


@dataclass(frozen=True, kw_only=True)
class NodeColumn:
    """Column of the table.

    Parameters
    ----------
    name, unit, about
        ``about`` says what it is.
    kind
        Of its numbers, as NumPy names them: ``<f8``, ``<i4``.
    shape
        Of what stands in one row; () for one number.
    """

    name: str
    unit: str
    about: str
    kind: str = "<f8"
    shape: tuple[int, ...] = ()


class NodeTable:
    """Table of all nodes of an atlas.

    Parameters
    ----------
    atlas
        Which.
    """

    def __init__(self, atlas: Atlas) -> None:
        self.atlas: Atlas = atlas
        problem, region = atlas.problem, atlas.region
        self.unknowns: int = max(charted.unknowns for charted in atlas.charted)
        free = [name for name in problem.free_names if name not in region.names]
        self._free = [problem.free_names.index(name) for name in free]
        self.columns: tuple[NodeColumn, ...] = (
            *(
                NodeColumn(name=_parameter_column_name(a.name), unit=a.unit, about=f"{a.key}, an axis of the atlas")
                for a in region.axes
            ),
            NodeColumn(name="objective", unit=problem.objective_unit, about="J"),
            *(
                NodeColumn(
                    name=f"slope_{a.name}",
                    unit=quotient_unit(problem.objective_unit, a.unit),
                    about=f"dJ by {a.key}",
                )
                for a in region.axes
            ),
            *(
                NodeColumn(name=_parameter_column_name(name), unit=problem.unit_of(name), about="free parameter")
                for name in free
            ),
            NodeColumn(name="chart", unit="1", about="number of the chart", kind="<i4"),
            NodeColumn(name="sheet", unit="1", about="number of the sheet, counted through all charts", kind="<i4"),
            NodeColumn(name="answer", unit="1", about="1 where the node may be an answer, else 0", kind="<i4"),
            *(NodeColumn(name=name, unit="1", about=about) for name, about in _FLOWN.items()),
            NodeColumn(
                name="sequence", unit="1", about="number of modes that the independent re-integration passes through"
            ),
            NodeColumn(
                name="terms",
                unit="1",
                shape=(2 ** len(region.axes), self.unknowns + 1),
                about="derivatives, canonical: number b is once by each axis whose bit is set in b; of the unknowns of "
                "its chart, then J; NaN beyond them",
            ),
        )

    @property
    def rows(self) -> int:
        """Return the number of nodes."""
        return self.atlas.rows

    @property
    def sheets(self) -> list[str]:
        """Return the labels of all branches, by their number."""
        return [label for charted in self.atlas.charted for label in charted.labels]

    @property
    def provenance(self) -> dict[str, str]:
        """Return the problem, axes, versions and tolerance of the atlas, one text each."""
        atlas, header = self.atlas, self.atlas.store.header()
        names = {
            f"unknowns_of_chart_{number}": ", ".join(
                charted.chart.conditions.unknowns[i][0] for i in charted.chart.active
            )
            for number, charted in enumerate(atlas.charted)
        }
        return {
            "title": f"atlas of {atlas.problem.heading}",
            "source": ", ".join(f"{name} {version}" for name, version in program_versions().items()),
            "built_with": json.dumps(header.get("versions", {})),
            "problem": atlas.problem.name,
            "given": json.dumps({name: [g.value, g.unit] for name, g in atlas.problem.given.items()}),
            "axes": json.dumps({axis.name: [axis.low, axis.high, axis.unit] for axis in atlas.region.axes}),
            "tolerance": repr(atlas.tolerance),
            "survey": str(atlas.survey.get("digest", "")),
            "sheets": json.dumps(self.sheets),
            "proofs": "; ".join(sample_of(atlas).describe(atlas)),
            **names,
        }

    def parts(self) -> Iterator[Mapping[str, NDArray[Any]]]:
        """Yield the columns of each block, in the order of charts and numbers.

        Raises
        ------
        PeriluneError
            If a shard is damaged.
        """
        atlas = self.atlas
        for number, *place in sorted(atlas.said):
            if (brick := atlas.brick(number, tuple(place))) is None:
                raise PeriluneError(
                    atlas.damaged[number, *place], advice="perilune atlas verify DIR lists everything that is damaged"
                )
            yield self._part(number, brick.nodes)

    def _part(self, number: int, nodes: NDArray[Any]) -> dict[str, NDArray[Any]]:
        atlas, charted = self.atlas, self.atlas.charted[number]
        first = sum(len(before.sheets) for before in atlas.charted[:number])
        chart, n, size = charted.chart, charted.unknowns, atlas.problem.objective_size
        terms = np.full((len(nodes), nodes["terms"].shape[1], self.unknowns + 1), np.nan)
        terms[:, :, : n + 1] = nodes["terms"]
        free = charted.free(chart.whole(nodes["values"] / chart.scale, np.ascontiguousarray(nodes["terms"][:, 0, :n])))
        slopes = [nodes["terms"][:, 1 << i, n] * (size / scale) for i, scale in enumerate(chart.scale)]
        columns = [
            *nodes["values"].T,
            nodes["terms"][:, 0, n] * size,
            *slopes,
            *free[:, self._free].T,
            np.full(len(nodes), number),
            nodes["sheet"] + first,
            are_possible_answers(nodes, charted.sheets),
            *(nodes[name] for name in _FLOWN),
            nodes["sequence"],
            terms,
        ]
        return {
            column.name: np.ascontiguousarray(values, dtype=column.kind)
            for column, values in zip(self.columns, columns, strict=True)
        }


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
