"""Nodes of an atlas as a table: columns with names, units and descriptions, brick by brick, and their provenance.

Values of the axes, free parameters, J and dJ/dp are in SI; the terms of interpolation are canonical.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.query import Atlas
from perilune.atlas.read import are_possible_answers
from perilune.atlas.sampling import sample_of
from perilune.io.export import program_versions
from perilune.words.outcome import PeriluneError
from perilune.words.units import quotient_unit

_FLOWN = {
    "margin": "by how much the node is an answer of its sheet, canonical; below zero it is beyond its border",
    "length": "step that Newton's method would make there, relative",
    "residual": "largest residual at the ends of the second flight, canonical",
    "path": "least condition of the path and distance of states from their bounds in the second flight, canonical",
    "minimum": "least H of another control minus H of the one flown in the second flight, canonical",
    "drift": "change of H along the second flight, canonical",
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
            NodeColumn(name="sequence", unit="1", about="number of the modes that the second flight goes through"),
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
        """Return the labels of all sheets, by their number."""
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
            "proofs": "; ".join(sample_of(atlas).told(atlas)),
            **names,
        }

    def parts(self) -> Iterator[Mapping[str, NDArray[Any]]]:
        """Yield the columns of each brick, in the order of charts and numbers.

        Raises
        ------
        PeriluneError
            If a shard is damaged.
        """
        atlas = self.atlas
        for number, *place in sorted(atlas.said):
            if (brick := atlas.brick(number, tuple(place))) is None:
                raise PeriluneError(
                    atlas.damaged[number, *place], advice="perilune atlas verify DIR names all that is damaged"
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
