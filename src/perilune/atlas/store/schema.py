"""Array schema of an atlas: columns of its shards, entries of its header, the survey's line of its manifest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.hermite import binary_digits
from perilune.atlas.region import Region, region_of, stated_region
from perilune.atlas.store.manifest import damage_text
from perilune.atlas.store.store import HEADER, MANIFEST
from perilune.charts import Chart, OpenChart, Sheet, arc_sequence_from
from perilune.core import Vector
from perilune.problem import Nature, Problem

MOST_NOTES = 100
RANGES = "ranges"  # key of a header whose problem has lost what its ranges follow from


def node_type(d: int, n: int) -> np.dtype[Any]:
    """Return the columns of a shard of nodes, for d axes and n unknowns.

    Parameters
    ----------
    d, n
        Numbers of axes and of unknowns.
    """
    return np.dtype(
        [
            ("sheet", "<i4"), ("branch", "<i4"), ("place", "<i4", (d,)), ("values", "<f8", (d,)),
            ("terms", "<f8", (2**d, n + 1)), ("margin", "<f8"), ("length", "<f8"), ("sequence", "<i8"),
            ("residual", "<f8"), ("path", "<f8"), ("minimum", "<f8"), ("drift", "<f8"),
        ]
    )  # fmt: skip


def cell_type(d: int) -> np.dtype[Any]:
    """Return the columns of a shard of cells."""
    return np.dtype(
        [
            ("sheet", "<i4"), ("branch", "<i4"), ("low", "<i4", (d,)), ("size", "<i4", (d,)),
            ("corners", "<i4", (2**d,)), ("axis", "<i4"), ("child", "<i4"), ("status", "<i4"),
        ]
    )  # fmt: skip


def seed_type(d: int, n: int) -> np.dtype[Any]:
    """Return the columns of a shard of the survey: unknowns of a sheet at corners of blocks.

    A sheet that reaches no corner has them at the `place`, in lattice steps, of the block with this low corner.

    Parameters
    ----------
    d, n
        Numbers of axes and of unknowns.
    """
    return np.dtype([("sheet", "<i4"), ("corner", "<i4", (d,)), ("place", "<i4", (d,)), ("y", "<f8", (n,))])


def brick_name(key: tuple[int, ...]) -> str:
    """Return the name of a block of a chart: its numbers, with ``m`` before those below zero."""
    return "-".join(f"m{-number}" if number < 0 else str(number) for number in key)


def header_axes(region: Region) -> dict[str, Any]:
    """Return the entry ``axes`` of a header for a region."""
    return {"axes": [{"name": a.name, "low": a.low, "high": a.high, "unit": a.unit} for a in region.axes]}


def header_region(problem: Problem, header: Mapping[str, Any]) -> Region:
    """Return the region that a header states.

    Parameters
    ----------
    problem
        Problem of the header, which has the axes as parameters.
    header
        Content of the header file.

    Raises
    ------
    PeriluneError
        If the axes are not those of a region.
    """
    with damage_text(HEADER):
        return region_of(problem, {axis["name"]: (axis["low"], axis["high"]) for axis in header["axes"]})


def survey_region(region: Region, survey: Mapping[str, Any]) -> Region:
    """Return the region of a survey: that of the header, unless it states its own edges.

    Parameters
    ----------
    region
        Region of the header.
    survey
        Line of the survey.

    Raises
    ------
    PeriluneError
        If the stated edges are not valid ones.
    """
    with damage_text(MANIFEST):
        return stated_region(region, survey["edges"]) if "edges" in survey else region


def widths_of(chart: Mapping[str, Any], region: Region) -> Vector:
    """Return the lengths of the ranges [SI] that set a chart's canonical units; a region that grows keeps them.

    Parameters
    ----------
    chart
        Entry of the chart in the line of the survey.
    region
        Region of the survey.

    Returns
    -------
    Vector
        Lengths, (d,).
    """
    return np.array(chart.get("widths", region.high - region.low), dtype=float)


def places_of(region: Region, chart: Mapping[str, Any]) -> list[tuple[int, ...]]:
    """Return the numbers of the blocks that a chart may have.

    Parameters
    ----------
    region
        Region of the survey.
    chart
        Entry of the chart in the line of the survey.
    """
    without = {tuple(place) for place in chart.get("excluded_bricks", ())}
    return [brick for brick in region.bricks if brick not in without]


def seeded_places(region: Region, chart: Mapping[str, Any], seeds: NDArray[Any]) -> set[tuple[int, ...]]:
    """Return the blocks of a chart in which, or at whose corners, its survey has a sheet, by its shard.

    Parameters
    ----------
    region
        Region of the survey.
    chart
        Entry of the chart in the line of the survey.
    seeds
        Shard of the survey's extremals in the chart, with the columns of `seed_type`.
    """
    within = seeds["place"].any(axis=1)
    beside = (seeds["corner"][~within][:, None] - binary_digits(len(region.axes))[None]).reshape(-1, len(region.axes))
    there = set(map(tuple, np.vstack([beside, seeds["corner"][within]]).tolist()))
    return there.intersection(places_of(region, chart))


def sheets_of(chart: Mapping[str, Any]) -> tuple[Sheet, ...]:
    """Return the sheets that the survey's line lists for a chart."""
    return tuple(
        Sheet(holds=dict(s["active_bounds"]), orientation=float(s["orientation"]), nature=Nature[s["nature"]])
        for s in chart["sheets"]
    )


def open_chart(problem: Problem, region: Region, said: Mapping[str, Any]) -> OpenChart:
    """Open a chart that the survey's line lists.

    Parameters
    ----------
    problem, region
        Of the survey.
    said
        Entry of the chart in the line.

    Raises
    ------
    ValueError
        If its number of unknowns is not that of the problem.
    """
    chart = Chart(problem, region.names, widths_of(said, region), arc_sequence_from(said))
    if said["unknowns"] != len(chart.places):
        raise ValueError(f"{said['unknowns']} unknowns in place of {len(chart.places)}")
    return OpenChart(chart, sheets_of(said), tuple(map(int, said["reintegration_steps"])))
