"""Building an atlas: the survey, then every brick, anywhere and in any order; what is there is not computed again."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.brick import WHOLE, Brick, Cells, Cut
from perilune.atlas.chart import Chart
from perilune.atlas.course import Course, course_from
from perilune.atlas.flooding import Key, Shards, spilled
from perilune.atlas.hermite import bits
from perilune.atlas.lines import told_of_damage
from perilune.atlas.reflight import Reflights
from perilune.atlas.region import Region, region_of, stated_region
from perilune.atlas.sheets import Borders, Sheet
from perilune.atlas.store import HEADER, MANIFEST, Store, clear
from perilune.atlas.survey import Found, Survey
from perilune.families.elsewhere import Call, Submits, answers, here, told_of_loss
from perilune.io.export import problem_document, versions
from perilune.methods.indirect import Indirect
from perilune.problem.extremal import Nature
from perilune.problem.problem import Problem
from perilune.words.asked import demand, demand_callable, demand_path
from perilune.words.outcome import PeriluneError
from perilune.words.types import Matrix, Vector
from perilune.words.watch import Watch, silent

TOLERANCE = 1e-9  # relative, to which one step of Newton's method leads from what a cell gives
MOST_NOTES = 100
_ROUNDS = 8  # of going on from bricks into their neighbours, at most
_AHEAD = 200  # bricks at work, each with a file that is open
_PATIENCE = 0.2  # seconds between looks at what another builder does
_LOOSEST, _TIGHTEST = 1e-4, 1e-12


def node_type(d: int, n: int) -> np.dtype[Any]:
    """Columns of a shard of nodes, of d axes and n unknowns."""
    return np.dtype(
        [
            ("sheet", "<i4"), ("place", "<i4", (d,)), ("values", "<f8", (d,)), ("terms", "<f8", (2**d, n + 1)),
            ("margin", "<f8"), ("length", "<f8"), ("sequence", "<i8"), ("residual", "<f8"), ("path", "<f8"),
            ("minimum", "<f8"), ("drift", "<f8"),
        ]
    )  # fmt: skip


def cell_type(d: int) -> np.dtype[Any]:
    """Columns of a shard of cells."""
    return np.dtype(
        [
            ("sheet", "<i4"), ("low", "<i4", (d,)), ("size", "<i4", (d,)), ("corners", "<i4", (2**d,)), ("axis", "<i4"),
            ("child", "<i4"), ("status", "<i4"),
        ]
    )  # fmt: skip


def seed_type(d: int, n: int) -> np.dtype[Any]:
    """Columns of a shard of the survey: unknowns of a sheet at corners of bricks."""
    return np.dtype([("sheet", "<i4"), ("corner", "<i4", (d,)), ("y", "<f8", (n,))])


@dataclass(frozen=True, kw_only=True)
class Task:
    """One brick of one chart, as any process can compute it.

    Parameters
    ----------
    problem, names, widths, course, times
        The chart, and how finely it is flown again.
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
    course: Course
    times: tuple[int, ...]
    sheets: tuple[Sheet, ...]
    low: Vector
    high: Vector
    sheet: NDArray[np.int64]
    place: NDArray[np.int64]
    y: Matrix
    tolerance: float
    before: tuple[NDArray[Any], NDArray[Any]] | None = None


def computed(task: Task, watch: Watch = silent) -> tuple[NDArray[Any], NDArray[Any]]:
    """Nodes and cells of a brick, as their shards have them."""
    chart, borders, reflights = _tools(task.problem, task.names, tuple(task.widths.tolist()), task.course, task.times)
    low, high = task.low / chart.scale, task.high / chart.scale
    cut = Brick(chart, borders, reflights, task.sheets, low, high, task.tolerance, watch).cut(
        task.sheet, task.place, task.y, None if task.before is None else _cut_of(*task.before)
    )
    d, n = len(low), task.y.shape[1]
    nodes = np.zeros(len(cut.nodes["sheet"]), dtype=node_type(d, n))
    for name, rows in cut.nodes.items():
        nodes[name] = rows
    nodes["values"] = (low + cut.nodes["place"] * ((high - low) / WHOLE)) * chart.scale
    cells = np.zeros(len(cut.cells), dtype=cell_type(d))
    for name in cells.dtype.names or ():
        cells[name] = getattr(cut.cells, name)
    return nodes, cells


def _cut_of(nodes: NDArray[Any], cells: NDArray[Any]) -> Cut:
    """What shards say, as `computed` has it."""
    columns = [name for name in nodes.dtype.names or () if name != "values"]
    said = {
        name: np.array(nodes[name], dtype=np.float64 if nodes[name].dtype.kind == "f" else np.int64) for name in columns
    }
    return Cut(nodes=said, cells=Cells(**{name: cells[name].astype(np.int64) for name in cells.dtype.names or ()}))


@lru_cache(maxsize=4)
def _tools(
    problem: Problem, names: tuple[str, ...], widths: tuple[float, ...], course: Course, times: tuple[int, ...]
) -> Any:
    chart = Chart(problem, names, np.array(widths), course)
    return chart, Borders(chart), Reflights(chart.free, chart.conditions, times)


def build(
    problem: Problem,
    axes: Mapping[str, Any],
    store: str | Path,
    executor: Submits | None = None,
    *,
    tolerance: float = TOLERANCE,
    method: Indirect | None = None,
    watch: Watch | None = None,
    force: bool = False,
) -> Path:
    """Map the extremals of a problem over a region of its parameters.

    Parameters
    ----------
    problem
        What is mapped; its own values of the axes are not used.
    axes
        ``{name: (low, high)}`` in SI, one to four; a dot in a name may stand for an underscore.
    store
        The directory. One that holds part of the same atlas is gone on with.
    executor
        Where the bricks are computed: a `concurrent.futures.Executor` (a process pool, say) or a Dask client.
    tolerance
        Relative, of the unknowns: a cell is cut until one step of Newton's method leads there from what it gives.
    method
        By which the survey solves from nothing, ``Indirect()`` by default.
    watch
        Receives lines of text.
    force
        Whether an atlas that is there is replaced, as soon as the survey of the new one is made.

    Returns
    -------
    Path
        The directory, for `perilune.atlas.open`.

    Raises
    ------
    PeriluneError
        If the region is none, the directory is of another atlas, or nothing in the region can be mapped.
    """
    demand(problem, Problem, "a problem to map")
    demand_callable(watch, "a watch")
    region, say = region_of(problem, axes), watch or silent
    if not (isinstance(tolerance, float) and _TIGHTEST <= tolerance <= _LOOSEST):
        raise PeriluneError(
            "the tolerance of an atlas is out of range", got=repr(tolerance)[:40],
            expected=f"{_TIGHTEST:g} to {_LOOSEST:g}, relative",
        )  # fmt: skip
    if chosen := {axis.name: axis.low for axis in region.axes if axis.name in problem.free_names}:
        problem = problem.with_given(**chosen)  # an axis is told, not chosen
    kept = Store(demand_path(store, "the directory of an atlas"))
    header = {
        "axes": [{"name": a.name, "low": a.low, "high": a.high, "unit": a.unit} for a in region.axes],
        "tolerance": tolerance,
        "versions": versions(),
        **problem_document(problem),
    }
    survey = _surveyed(kept, header, problem, region, method or Indirect(), say, force)
    return completed(kept, problem, survey_region(region, survey), survey, tolerance, executor, say)


def completed(
    kept: Store,
    problem: Problem,
    region: Region,
    survey: Mapping[str, Any],
    tolerance: float,
    executor: Submits | None,
    say: Watch,
) -> Path:
    """Compute what is missing of the bricks of a survey, and then of those into which a sheet goes on from others."""
    with told_of_damage(MANIFEST):
        tasks = dict(_tasks(kept, problem, region, survey, tolerance))
    for number in range(_ROUNDS):
        _complete(kept, region, survey, tasks, number, executor, say)
        if not (tasks := dict(_going_on(kept, problem, region, survey, tolerance, number))):
            break
    return kept.directory


def _complete(
    kept: Store,
    region: Region,
    survey: Mapping[str, Any],
    tasks: Mapping[Key, Task],
    number: int,
    executor: Submits | None,
    say: Watch,
) -> None:
    """Compute what is missing of one round."""
    named = {brick_name(key) + (f"~{number}" if number else ""): key for key in tasks}
    there = _written(kept, region, survey)
    say(_told(named, there, number))
    while todo := {name: tasks[key] for name, key in named.items() if name not in there}:
        for name, arrays in _everywhere(kept, todo, executor, say):
            prefix = f"brick-{survey['digest'][:8]}-{name}"
            shards = {kind: kept.put(f"{prefix}.{kind}.npy", rows) for kind, rows in arrays.items()}
            group, *brick = named[name]
            line = {"kind": "brick", "name": name, "chart": group, "brick": brick, "survey": survey["digest"], **shards}
            kept.add({**line, **({"round": number} if number else {})})
            there[name] = len(arrays["nodes"])
            say(_told(named, there, number))
        before = len(there)
        there = _written(kept, region, survey)
        if len(there) == before and not there.keys() >= named.keys():
            time.sleep(_PATIENCE)  # what is missing is at work elsewhere; who dies there lets go of it


def _written(kept: Store, region: Region, survey: Mapping[str, Any]) -> dict[str, int]:
    """How many nodes the bricks have that are there, by name."""
    return {line["name"]: line["nodes"]["rows"] for line in kept.bricks(survey, len(region.axes))}


def _told(named: Mapping[str, Key], there: Mapping[str, int], number: int) -> str:
    done = [there[name] for name in named if name in there]
    again = f", gone on with from their neighbours ({number})" if number else ""
    return f"{len(done)} of {len(named)} bricks, {sum(done)} nodes{again}"


def _everywhere(
    kept: Store, todo: Mapping[str, Task], executor: Submits | None, say: Watch
) -> Iterator[tuple[str, dict[str, NDArray[Any]]]]:
    """Shards of the bricks that can be claimed, as soon as they are there."""
    claims = dict[str, ExitStack]()

    def calls() -> Iterator[tuple[str, Call]]:
        for name, task in todo.items():
            claim = ExitStack()
            if claim.enter_context(kept.claimed(name)) and not kept.there(name):
                claims[name] = claim
                yield name, (computed, task) if executor is not None else (computed, task, say)
            else:
                claim.close()

    try:
        found = answers(executor, calls(), _AHEAD) if executor is not None else here(calls())
        for name, (nodes, cells) in told_of_loss(found):
            yield name, {"nodes": nodes, "cells": cells}
            kept.settled(name)  # its line is in the manifest
            claims.pop(name).close()
    finally:
        for claim in claims.values():
            claim.close()


def _surveyed(
    kept: Store, header: Mapping[str, Any], problem: Problem, region: Region, method: Indirect, say: Watch, anew: bool
) -> dict[str, Any]:
    """The survey's line of the manifest, made where there is none, or `anew`; of one that fails nothing is left."""
    kept.prepare(None if anew else header)
    while anew or (known := kept.survey()) is None:
        with kept.claimed("survey") as ours:
            if not ours:
                time.sleep(_PATIENCE)
            elif anew or kept.survey() is None:
                try:
                    survey = Survey(problem=problem, region=region, method=method, watch=say)
                    found = survey.run()
                except BaseException:
                    kept.leave()
                    raise
                if anew:
                    clear(kept.directory)
                    anew = False
                kept.begin(header)
                kept.add(_survey(kept, region, found, survey.notes))
                kept.settled("survey")
    kept.prepare(header)  # another builder may have begun meanwhile
    return known


def _survey(kept: Store, region: Region, found: Sequence[Found], notes: Sequence[str]) -> dict[str, Any]:
    """Its line, behind its shards."""
    places, _ = region.corners()
    charts = []
    for number, one in enumerate(found):
        rows = seeds(places, one.y)
        charts.append({**said_of(one), "seeds": kept.put(f"survey-{number}.npy", rows)})
    return {"kind": "survey", "digest": digest_of(charts), "charts": charts, "notes": list(notes)[:MOST_NOTES]}


def said_of(found: Found) -> dict[str, Any]:
    """What a survey's line says of a chart."""
    sheets = [{"holds": dict(s.holds), "orientation": s.orientation, "nature": s.nature.name} for s in found.sheets]
    course = found.chart.course.document()
    return {**course, "times": list(found.times), "unknowns": found.y.shape[2], "sheets": sheets}


def seeds(places: NDArray[np.int64], y: NDArray[np.float64]) -> NDArray[Any]:
    """The shard of sheets at corners, (sheets, corners, n) with NaN where one does not reach."""
    sheet, corner = np.nonzero(np.isfinite(y[:, :, 0]))
    rows = np.zeros(len(sheet), dtype=seed_type(places.shape[1], y.shape[2]))
    rows["sheet"], rows["corner"], rows["y"] = sheet, places[corner], y[sheet, corner]
    return rows


def digest_of(charts: Any) -> str:
    """By which a survey is known."""
    return hashlib.sha256(json.dumps(charts, sort_keys=True).encode()).hexdigest()


def header_region(problem: Problem, header: Mapping[str, Any]) -> Region:
    """The region that a header states."""
    with told_of_damage(HEADER):
        return region_of(problem, {axis["name"]: (axis["low"], axis["high"]) for axis in header["axes"]})


def survey_region(region: Region, survey: Mapping[str, Any]) -> Region:
    """The region of a survey: that of the header, unless it states edges of its own."""
    with told_of_damage(MANIFEST):
        return stated_region(region, survey["edges"]) if "edges" in survey else region


def sheets_of(chart: Mapping[str, Any]) -> tuple[Sheet, ...]:
    """The sheets that the survey's line lists for a chart."""
    return tuple(
        Sheet(holds=dict(s["holds"]), orientation=float(s["orientation"]), nature=Nature[s["nature"]])
        for s in chart["sheets"]
    )


def _tasks(
    kept: Store, problem: Problem, region: Region, survey: Mapping[str, Any], tolerance: float
) -> Iterator[tuple[Key, Task]]:
    """Every brick in which a sheet is known, by chart and numbers."""
    d = len(region.axes)
    for number, chart in enumerate(survey["charts"]):
        known = kept.shard(chart["seeds"], seed_type(d, chart["unknowns"]))
        at = dict[tuple[int, ...], list[int]]()
        for row, corner in enumerate(known["corner"].tolist()):
            at.setdefault(tuple(corner), []).append(row)
        for brick in _places(region, chart):
            beside = [tuple((np.array(brick) + side).tolist()) for side in bits(d)]
            here = np.sort([row for corner in beside for row in at.get(corner, ())]).astype(np.int64)
            if len(here):
                place = (known["corner"][here] - np.array(brick)) * WHOLE
                seeds = known["sheet"][here].astype(np.int64), place, np.array(known["y"][here])
                yield (number, *brick), _task(problem, region, chart, brick, tolerance, seeds)


def _going_on(
    kept: Store, problem: Problem, region: Region, survey: Mapping[str, Any], tolerance: float, rounds: int
) -> Iterator[tuple[Key, Task]]:
    """Every brick into which sheets go on from its neighbours, as they were after so many rounds."""
    d, charts = len(region.axes), survey["charts"]
    lines = kept.latest(survey, d, rounds)

    def shards(key: Key) -> Shards | None:
        if (line := lines.get(key)) is None:
            return None
        types = node_type(d, charts[key[0]]["unknowns"]), cell_type(d)
        return kept.shard(line["nodes"], types[0]), kept.shard(line["cells"], types[1])

    keys = [(number, *brick) for number, chart in enumerate(charts) for brick in _places(region, chart)]
    minima = [[n for n, sheet in enumerate(sheets_of(chart)) if sheet.minimum] for chart in charts]
    for key, nodes in spilled(keys, shards, minima.__getitem__):
        seeds = nodes["sheet"].astype(np.int64), nodes["place"].astype(np.int64), nodes["terms"][:, 0, :-1]
        before = None if (known := shards(key)) is None else tuple(map(np.array, known))
        yield key, _task(problem, region, charts[key[0]], key[1:], tolerance, seeds, before)


def _places(region: Region, chart: Mapping[str, Any]) -> list[tuple[int, ...]]:
    """Numbers of the bricks that a chart may have."""
    without = {tuple(place) for place in chart.get("without", ())}
    return [brick for brick in region.bricks if brick not in without]


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
        widths=region.high - region.low,
        course=course_from(chart),
        times=tuple(chart["times"]),
        sheets=sheets_of(chart),
        low=low,
        high=high,
        sheet=sheet,
        place=place,
        y=y,
        tolerance=tolerance,
        before=before,
    )


def brick_name(key: tuple[int, ...]) -> str:
    """Name of a brick of a chart: its numbers, ``m`` before those below zero."""
    return "-".join(f"m{-number}" if number < 0 else str(number) for number in key)
