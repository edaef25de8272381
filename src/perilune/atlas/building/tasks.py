"""Tasks of computing an atlas, block by block, anywhere and in any order.

First every block in which the survey has a sheet; then, round by round, those into which one continues from others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.grid.cell_subdivision import BrickSubdivision
from perilune.atlas.grid.nodes import Lattice
from perilune.atlas.hermite import binary_digits
from perilune.atlas.region import Region
from perilune.atlas.store.cell_coverage import ANSWERING, covered_by_branches
from perilune.atlas.store.cells import WHOLE, Cells, Cut, Nodes, leaves_of, select_cells
from perilune.atlas.store.schema import cell_type, node_type, places_of, seed_type, sheets_of, widths_of
from perilune.atlas.store.store import AtlasStore
from perilune.atlas.survey.neighbour_seeds import Key, Shards, seeds_for_neighbours
from perilune.charts import ArcSequence, Borders, Chart, ChartReintegration, Sheet, arc_sequence_from
from perilune.core import Matrix, Vector, Watch, ignore_events
from perilune.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Task:
    """Task of one block of one chart, which any process can compute.

    Parameters
    ----------
    problem, names, widths, course, times
        The chart, and the steps of its independent re-integration.
    sheets
        All sheets of the chart.
    low, high
        The box [SI].
    sheet, place, y
        Extremals in it to begin with, and where they are in its lattice.
    tolerance
        Of `build`.
    before
        Nodes and cells that are known already.
    """

    problem: Problem
    names: tuple[str, ...]
    widths: Vector
    course: ArcSequence
    times: tuple[int, ...]
    sheets: tuple[Sheet, ...]
    low: Vector
    high: Vector
    sheet: NDArray[np.int64]
    place: NDArray[np.int64]
    y: Matrix
    tolerance: float
    before: tuple[NDArray[Any], NDArray[Any]] | None = None

    @property
    def size(self) -> int:
        """Return an estimate of the work relative to other blocks: those whose sheets miss corners are cut most."""
        return 1 + max(0, len(np.unique(self.sheet)) * 2 ** len(self.low) - len(self.sheet))


def compute_brick(task: Task, watch: Watch = ignore_events) -> tuple[NDArray[Any], NDArray[Any]]:
    """Compute the nodes and cells of a block, as their shards have them.

    Parameters
    ----------
    task
        Block, its chart, and extremals to begin with.
    watch
        Receives lines of text.

    Returns
    -------
    tuple[NDArray[Any], NDArray[Any]]
        Rows with the columns of `node_type` and of `cell_type`.
    """
    chart, borders, reflights = _tools(task.problem, task.names, tuple(task.widths.tolist()), task.course, task.times)
    low, high = task.low / chart.scale, task.high / chart.scale
    before = (
        None if task.before is None or not len(task.before[0]) else _cut_from_shards(*task.before, len(task.sheets))
    )
    lattice = Lattice(chart, borders, reflights, task.sheets, low, high, before)
    cells_before = None if before is None else before.cells
    cut = BrickSubdivision(lattice, task.tolerance, watch).cut(task.sheet, task.place, task.y, cells_before)
    d, n, own = len(low), task.y.shape[1], np.array(cut.own)
    nodes = np.zeros(len(cut.nodes.get("branch", ())), dtype=node_type(d, n))
    for name, rows in cut.nodes.items():
        nodes[name] = rows
    nodes["sheet"] = own[nodes["branch"]]
    inside = task.low + nodes["place"] * ((task.high - task.low) / WHOLE)
    nodes["values"] = np.where(nodes["place"] == WHOLE, task.high, inside)  # not beyond it by a rounding
    cells = np.zeros(len(cut.cells), dtype=cell_type(d))
    for column in fields(Cells):
        cells[column.name] = getattr(cut.cells, column.name)
    cells["sheet"] = own[cut.cells.branch]
    return nodes, cells


def _cut_from_shards(nodes: NDArray[Any], cells: NDArray[Any], sheets: int) -> Cut:
    """Build the cut of a block from its shards, as `compute_brick` makes it."""
    columns = [name for name in nodes.dtype.names or () if name not in ("values", "sheet")]
    said = {
        name: np.array(nodes[name], dtype=np.float64 if nodes[name].dtype.kind == "f" else np.int64) for name in columns
    }
    later = {int(branch): int(sheet) for branch, sheet in zip(cells["branch"], cells["sheet"], strict=True)}
    own = (*range(sheets), *(later[branch] for branch in range(sheets, max(later, default=0) + 1)))
    return Cut(nodes=said, cells=Cells(**{c.name: cells[c.name].astype(np.int64) for c in fields(Cells)}), own=own)


def compile_for_bricks(problem: Problem, names: tuple[str, ...], widths: Vector) -> None:
    """Derive and compile the functions that most blocks need, in advance.

    Parameters
    ----------
    problem
        Problem that is mapped.
    names
        Parameters that vary.
    widths
        Length of the range of each [SI], (d,).
    """
    Chart(problem, names, widths)


@lru_cache(maxsize=4)
def _tools(
    problem: Problem, names: tuple[str, ...], widths: tuple[float, ...], course: ArcSequence, times: tuple[int, ...]
) -> Any:
    chart = Chart(problem, names, np.array(widths), course)
    return chart, Borders(chart), ChartReintegration(chart, times)


def first_tasks(
    kept: AtlasStore, problem: Problem, region: Region, survey: Mapping[str, Any], tolerance: float
) -> Iterator[tuple[Key, Task]]:
    """Yield every block in which a sheet is known, by chart and numbers.

    Parameters
    ----------
    kept
        Store with the shards of the survey.
    problem, region
        Problem that is mapped, and the region of its survey.
    survey
        Line of the survey.
    tolerance
        Relative error of the unknowns to which one step of Newton's method leads.
    """
    d = len(region.axes)
    for number, chart in enumerate(survey["charts"]):
        known = kept.shard(chart["seeds"], seed_type(d, chart["unknowns"]))
        at, inside = dict[tuple[int, ...], list[int]](), dict[tuple[int, ...], list[int]]()
        within = np.any(known["place"], axis=1).tolist()
        for row, corner in enumerate(known["corner"].tolist()):
            (inside if within[row] else at).setdefault(tuple(corner), []).append(row)
        for brick in places_of(region, chart):
            beside = [tuple((np.array(brick) + side).tolist()) for side in binary_digits(d)]
            rows = [row for corner in beside for row in at.get(corner, ())] + inside.get(brick, [])
            here = np.sort(rows).astype(np.int64)
            if len(here):
                place = (known["corner"][here] - np.array(brick)) * WHOLE + known["place"][here]
                seeds = known["sheet"][here].astype(np.int64), place, np.array(known["y"][here])
                yield (number, *brick), _task(problem, region, chart, brick, tolerance, seeds)


def tasks_going_on(
    kept: AtlasStore, problem: Problem, region: Region, survey: Mapping[str, Any], tolerance: float, rounds: int
) -> Iterator[tuple[Key, Task]]:
    """Yield every block into which sheets continue from its neighbours, as these were after so many rounds.

    Parameters
    ----------
    kept
        Store with the shards of the blocks.
    problem, region
        Problem that is mapped, and the region of its survey.
    survey
        Line of the survey.
    tolerance
        Relative error of the unknowns to which one step of Newton's method leads.
    rounds
        Number of the last round whose blocks count.
    """
    d, charts = len(region.axes), survey["charts"]
    lines = kept.latest(survey, d, rounds)

    def shards(key: Key) -> Shards | None:
        if (line := lines.get(key)) is None:
            return None
        types = node_type(d, charts[key[0]]["unknowns"]), cell_type(d)
        return kept.shard(line["nodes"], types[0]), kept.shard(line["cells"], types[1])

    def passed_over(key: Key, nodes: Any) -> NDArray[np.bool_]:
        chart, known, (low, high) = charts[key[0]], shards(key), region.box(key[1:])
        assert known is not None
        widths = tuple(widths_of(chart, region).tolist())
        scale = _tools(problem, region.names, widths, arc_sequence_from(chart), tuple(chart["reintegration_steps"]))[
            0
        ].scale
        return _already_answered(
            _cut_from_shards(*known, len(chart["sheets"])), (high - low) / scale / WHOLE, sheets[key[0]], nodes
        )

    keys = [(number, *brick) for number, chart in enumerate(charts) for brick in places_of(region, chart)]
    sheets = [sheets_of(chart) for chart in charts]
    for key, nodes in seeds_for_neighbours(keys, shards, sheets.__getitem__, passed_over):
        seeds = nodes["sheet"].astype(np.int64), nodes["place"].astype(np.int64), nodes["terms"][:, 0, :-1]
        before = None if (known := shards(key)) is None else tuple(map(np.array, known))
        yield key, _task(problem, region, charts[key[0]], key[1:], tolerance, seeds, before)


def _already_answered(before: Cut, step: Vector, sheets: Sequence[Sheet], found: Any) -> NDArray[np.bool_]:
    """Return a mask of extremals on the sides of a block that lie in answering cells, and are given by none."""
    out, cells, nodes = np.zeros(len(found), dtype=bool), before.cells, Nodes()
    nodes.add(np.arange(len(before.nodes["branch"])), **before.nodes)
    sided = select_cells(cells, ((cells.low == 0) | (cells.low + cells.size == WHOLE)).any(axis=1))
    for sheet in np.intersect1d(found["sheet"], cells.branch).tolist():
        place = found["place"].astype(np.int64)
        inside = np.isin(cells.status[leaves_of(cells, sheet, place)], ANSWERING)
        here = np.nonzero((found["sheet"] == sheet) & inside)[0]
        alike = [branch for branch, own in enumerate(before.own) if sheets[own].alike(sheets[sheet])]
        out[here] = ~covered_by_branches(sided, nodes, step, alike, place[here], found["terms"][here, 0, :-1])
    return out


def _task(
    problem: Problem,
    region: Region,
    chart: Mapping[str, Any],
    brick: tuple[int, ...],
    tolerance: float,
    seeds: tuple[NDArray[np.int64], NDArray[np.int64], Matrix],
    before: Any = None,
) -> Task:
    low, high = region.box(brick)
    sheet, place, y = seeds
    return Task(
        problem=problem,
        names=region.names,
        widths=widths_of(chart, region),
        course=arc_sequence_from(chart),
        times=tuple(chart["reintegration_steps"]),
        sheets=sheets_of(chart),
        low=low,
        high=high,
        sheet=sheet,
        place=place,
        y=y,
        tolerance=tolerance,
        before=before,
    )
