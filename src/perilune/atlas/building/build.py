"""Build an atlas: the survey, then every block, anywhere and in any order; stored blocks are not computed again."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.building.audit import draw_sample, numbers_of_thin_nodes, refuse_nowhere, require_count
from perilune.atlas.building.tasks import Task, compile_for_bricks, compute_brick, first_tasks, tasks_going_on
from perilune.atlas.region import Region, refuse_moving_ranges, region_of
from perilune.atlas.store.checksums import digest_of, end_line
from perilune.atlas.store.manifest import damage_text
from perilune.atlas.store.schema import MOST_NOTES, RANGES, brick_name, header_axes, survey_region
from perilune.atlas.store.store import MANIFEST, PATIENCE, AtlasStore, clear_atlas
from perilune.atlas.survey.neighbour_seeds import Key
from perilune.atlas.survey.survey import Survey
from perilune.atlas.survey.surveyed_chart import SurveyedChart, chart_entry, seed_rows
from perilune.core import (
    PeriluneError,
    Watch,
    check_call,
    ignore_events,
    renamed_keywords,
    require_callable,
    require_path,
    require_type,
)
from perilune.families import Call, Submits, begin_processes, run_calls
from perilune.io import program_versions, reread_problem
from perilune.methods import Indirect
from perilune.problem import Problem

TOLERANCE = 1e-9  # relative, to which one step of Newton's method leads from what a cell gives
_ROUNDS = 8  # of going on from blocks into their neighbours, at most
_AHEAD = 200  # blocks at work, each with a file that is open
_LOOSEST, _TIGHTEST = 1e-4, 1e-12


@renamed_keywords(watch="callback")
@check_call
def build(
    problem: Problem,
    axes: Mapping[str, Any],
    store: str | Path,
    executor: Submits | None = None,
    *,
    tolerance: float = TOLERANCE,
    method: Indirect | None = None,
    callback: Watch | None = None,
    bricks: int | None = None,
    sample: int | None = None,
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
        The directory. One that holds part of the same atlas is continued.
    executor
        Where the blocks are computed: a `concurrent.futures.Executor` (a process pool, say) or a Dask client.
    tolerance
        Relative, of the unknowns: a cell is cut until one step of Newton's method leads there from what it gives.
    method
        By which the survey solves without an initial guess, ``Indirect()`` by default.
    callback
        Receives lines of text, and each iteration of what the survey solves (`perilune.core.callbacks`).
    bricks
        How many there are along each axis, for as many as that can be computed at once; 8 of one axis, 4 along each of
        two, 2 of more, if it is not given. Those of an atlas that is there stay.
    sample
        How many answers at nodes drawn at random are proved to level 3 at the end, and as many of those with a thin
        margin (`perilune.atlas.building.audit`); by default one for a hundred nodes and at most ten.
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
    NotConvergedError
        If no cell answers, once all that there is to compute is there.
    """
    require_type(problem, Problem, "a problem to map")
    require_callable(callback, "a callback")
    region, say = region_of(problem, axes, bricks), callback or ignore_events
    if not (isinstance(tolerance, float) and _TIGHTEST <= tolerance <= _LOOSEST):
        raise PeriluneError(
            "the tolerance of the atlas is out of range", got=repr(tolerance)[:40],
            expected=f"{_TIGHTEST:g} to {_LOOSEST:g}, relative",
        )  # fmt: skip
    require_count(sample)
    if chosen := {axis.name: axis.low for axis in region.axes if axis.name in problem.free_names}:
        problem = problem.with_given(**chosen)  # an axis is given, not chosen
    kept = AtlasStore(require_path(store, "the directory of an atlas"))
    document, as_kept = reread_problem(problem, region.looks)
    refuse_moving_ranges(problem, as_kept, region)
    header = {**header_axes(region), "tolerance": tolerance, "versions": program_versions(), **document}
    if problem.parameter_bounds is not None and as_kept.parameter_bounds is None:
        header[RANGES] = "as they are within the axes; the function that they follow from is not kept"
    survey = _ensure_survey_line(kept, header, problem, region, method or Indirect(), executor, say, force)
    complete_atlas(kept, problem, survey_region(region, survey), survey, tolerance, executor, say)
    refuse_nowhere(kept, survey, len(region.axes))
    draw_sample(kept, sample, executor, say)
    return kept.directory


def complete_atlas(
    kept: AtlasStore,
    problem: Problem,
    region: Region,
    survey: Mapping[str, Any],
    tolerance: float,
    executor: Submits | None,
    say: Watch,
) -> None:
    """Compute the missing blocks of a survey, and then those into which a branch continues from others.

    Parameters
    ----------
    kept
        Store to which blocks are added.
    problem, region
        Problem that is mapped, and the region of its survey.
    survey
        Line of the survey.
    tolerance
        Relative error of the unknowns to which one step of Newton's method leads.
    executor
        Where blocks are computed; None for this process.
    say
        Receives lines of text.
    """
    with damage_text(MANIFEST):
        tasks = dict(first_tasks(kept, problem, region, survey, tolerance))
    for number in range(_ROUNDS):
        _complete_round(kept, region, survey, tasks, number, executor, say)
        if number and _shard_checksums(kept, region, survey, number) == _shard_checksums(
            kept, region, survey, number - 1
        ):
            break  # neighbours offer what does not lead on
        if not (tasks := dict(tasks_going_on(kept, problem, region, survey, tolerance, number))):
            break
    if not kept.ended(survey, len(region.axes)):
        kept.add(end_line(survey, kept.bricks(survey, len(region.axes))))
    kept.tidy()


def _shard_checksums(kept: AtlasStore, region: Region, survey: Mapping[str, Any], rounds: int) -> dict[Key, list[str]]:
    """Return the checksums of the shards of each block after so many rounds."""
    lines = kept.latest(survey, len(region.axes), rounds)
    return {key: [line[kind]["sha256"] for kind in ("nodes", "cells")] for key, line in lines.items()}


def _complete_round(
    kept: AtlasStore,
    region: Region,
    survey: Mapping[str, Any],
    tasks: Mapping[Key, Task],
    number: int,
    executor: Submits | None,
    say: Watch,
) -> None:
    """Compute the missing blocks of one round."""
    named = {brick_name(key) + (f"~{number}" if number else ""): key for key in tasks}
    there = _node_counts(kept, region, survey)
    say(_progress_text(named, there, number))
    began, work = time.monotonic(), {name: tasks[key].size for name, key in named.items() if name not in there}
    while todo := {name: tasks[key] for name, key in named.items() if name not in there}:
        for name, arrays in _computed_shards(kept, todo, executor, say):
            prefix = f"brick-{survey['digest'][:8]}-{name}"
            shards = {kind: kept.put(f"{prefix}.{kind}.npy", rows) for kind, rows in arrays.items()}
            group, *brick = key = named[name]
            line = {"kind": "brick", "name": name, "chart": group, "brick": brick, "survey": survey["digest"]}
            line["sheets"] = np.unique(arrays["nodes"]["sheet"]).tolist()
            line |= {"round": number} if number else {}
            kept.add({**line, "thin_margin": len(numbers_of_thin_nodes(arrays["nodes"], tasks[key].sheets)), **shards})
            there[name] = len(arrays["nodes"])
            say(_progress_text(named, there, number) + _pace(work, there, time.monotonic() - began))
        known = len(there)
        there = _node_counts(kept, region, survey)
        if len(there) == known and not there.keys() >= named.keys():
            time.sleep(PATIENCE)  # what is missing is computed elsewhere; a process that dies there releases it


def _node_counts(kept: AtlasStore, region: Region, survey: Mapping[str, Any]) -> dict[str, int]:
    """Return the number of nodes of each block on disk, by name."""
    return {line["name"]: line["nodes"]["rows"] for line in kept.bricks(survey, len(region.axes))}


def _progress_text(named: Mapping[str, Key], there: Mapping[str, int], number: int) -> str:
    done = [there[name] for name in named if name in there]
    again = f", continued from their neighbours ({number})" if number else ""
    return f"{len(done)} of {len(named)} bricks, {sum(done)} nodes{again}"


def _pace(work: Mapping[str, int], there: Mapping[str, int], seconds: float) -> str:
    """Format the rate of nodes and the time left for missing blocks; `work` is the size of each block."""
    new = there.keys() & work.keys()
    rate = sum(there[name] for name in new) / max(seconds, 1e-3)
    done = sum(work[name] for name in new)
    left = (sum(work.values()) - done) * seconds / max(done, 1)
    return f", {rate:.0f} nodes/s" + (f", about {left:.0f} s left" if left else "")


def _computed_shards(
    kept: AtlasStore, todo: Mapping[str, Task], executor: Submits | None, say: Watch
) -> Iterator[tuple[str, dict[str, NDArray[Any]]]]:
    """Yield the shards of the blocks that can be claimed, as soon as they are computed."""
    claims = dict[str, ExitStack]()

    def calls() -> Iterator[tuple[str, Call]]:
        for name, task in sorted(todo.items(), key=lambda item: item[1].size, reverse=True):  # the longest first
            claim = ExitStack()
            if claim.enter_context(kept.claimed(name)) and not kept.there(name):
                claims[name] = claim
                yield name, (compute_brick, task) if executor is not None else (compute_brick, task, say)
            else:
                claim.close()

    try:
        for name, (nodes, cells) in run_calls(executor, calls(), _AHEAD):
            yield name, {"nodes": nodes, "cells": cells}
            kept.settled(name)  # its line is in the manifest
            claims.pop(name).close()
    finally:
        for claim in claims.values():
            claim.close()


def _ensure_survey_line(
    kept: AtlasStore,
    header: Mapping[str, Any],
    problem: Problem,
    region: Region,
    method: Indirect,
    executor: Submits | None,
    say: Watch,
    fresh: bool,
) -> dict[str, Any]:
    """Return the survey's line of the manifest, made if missing or with `fresh`; a failed survey leaves no files."""
    kept.prepare(None if fresh else header)
    while fresh or (known := kept.survey()) is None:
        with kept.claimed("survey") as ours:
            if not ours:
                time.sleep(PATIENCE)
            elif fresh or kept.survey() is None:
                try:
                    begin_processes(executor, (compile_for_bricks, problem, region.names, region.high - region.low))
                    survey = Survey(problem=problem, region=region, method=method, watch=say)
                    found = survey.run()
                except BaseException:
                    kept.leave()
                    raise
                if fresh:
                    clear_atlas(kept.directory)
                    fresh = False
                kept.begin(header)
                kept.add(_survey_line(kept, region, found, survey.notes))
                kept.settled("survey")
    kept.prepare(header)  # another builder may have begun meanwhile
    return known


def _survey_line(
    kept: AtlasStore, region: Region, found: Sequence[SurveyedChart], notes: Sequence[str]
) -> dict[str, Any]:
    """Write the shards of a survey and return its line."""
    places, _ = region.corners()
    charts, edges = [], [{"first": axis.first, "at": list(axis.edges)} for axis in region.axes]
    for number, one in enumerate(found):
        rows = seed_rows(places, one)
        charts.append({**chart_entry(one), "seeds": kept.put(f"survey-{number}.npy", rows)})
    said = {"edges": edges, "charts": charts, "notes": list(notes)[:MOST_NOTES]}
    return {"kind": "survey", "digest": digest_of([edges, charts]), "header": kept.seal, **said}
