"""Extend an atlas by more blocks; existing ones stay as they are.

The wider region is surveyed as a new one would be. Extremals on known branches continue these; others begin new charts,
with blocks over all of the region that they reach. A branch that is not found again is continued from where it was
known. The survey's line in the manifest names the one that it extends: once it is written the atlas is the wider one,
and before that nothing has changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.building.audit import draw_sample, refuse_nowhere, require_count
from perilune.atlas.building.build import complete_atlas
from perilune.atlas.region import Region, refuse_untaken, wider
from perilune.atlas.store.checksums import digest_of
from perilune.atlas.store.manifest import damage_text
from perilune.atlas.store.schema import (
    MOST_NOTES,
    RANGES,
    header_region,
    seed_type,
    sheets_of,
    survey_region,
    widths_of,
)
from perilune.atlas.store.store import HEADER, MANIFEST, AtlasStore
from perilune.atlas.survey.corner_continuation import Corners, continue_between_corners, corners_reached
from perilune.atlas.survey.survey import Survey
from perilune.atlas.survey.surveyed_chart import InteriorSeed, SurveyedChart, chart_entry, seed_rows
from perilune.charts import Borders, Chart, Sheet, arc_sequence_from, same_unknowns
from perilune.core import (
    PeriluneError,
    Watch,
    check_call,
    ignore_events,
    renamed_keywords,
    require_callable,
    require_path,
)
from perilune.families import Submits
from perilune.io import read_problem
from perilune.methods import Indirect
from perilune.problem import Problem


@renamed_keywords(watch="callback")
@check_call
def extend(
    store: str | Path,
    axes: Mapping[str, tuple[float, float]],
    executor: Submits | None = None,
    *,
    method: Indirect | None = None,
    callback: Watch | None = None,
    sample: int | None = None,
    problem_from_scenario: Callable[[str], Problem] | None = None,
) -> Path:
    """Map more of the same problem, around the present region.

    Parameters
    ----------
    store
        The directory of an atlas, as `perilune.atlas.build` made it; no node in it is computed again.
    axes
        ``{name: (low, high)}`` in SI of the axes that become wider; ranges that it has already complete it.
    executor, method, callback, sample
        As of `perilune.atlas.build`; the sample is drawn of all that there is then.
    problem_from_scenario
        As of `perilune.atlas.open`.

    Returns
    -------
    Path
        The directory.

    Raises
    ------
    PeriluneError
        If there is no atlas, a name is no axis of it, or a range excludes a part of the mapped region.
    NotConvergedError
        If no cell answers, once all that there is to compute is there.
    """
    if problem_from_scenario is None:
        from perilune.scenario import load_text as problem_from_scenario
    require_callable(callback, "a callback")
    require_count(sample)
    kept, say = AtlasStore(require_path(store, "the directory of an atlas")), callback or ignore_events
    header, survey = kept.header(), kept.survey()
    problem = read_problem(header, problem_from_scenario)
    if survey is None:
        raise PeriluneError(
            "this atlas has no survey yet that could be extended", got=str(kept.directory),
            advice="build it first, or complete it: perilune atlas build ... --resume",
        )  # fmt: skip
    region = survey_region(header_region(problem, header), survey)
    wide = wider(region, axes)
    if wide != region:
        refuse_untaken(problem, wide)
        if RANGES in header:
            raise PeriluneError(
                "ranges of free parameters follow from a function that this atlas does not keep",
                got=str(kept.directory), expected="ranges that also hold outside the mapped region",
                advice="build an atlas of the wider region from the problem itself",
            )  # fmt: skip
        with kept.claimed("survey") as ours:
            if not ours or kept.survey() != survey:
                raise PeriluneError("another builder is surveying this atlas", advice="wait until it is done")
            with damage_text(MANIFEST):
                survey = _wider_survey_line(kept, problem, region, wide, survey, method or Indirect(), say)
            kept.add(survey)
    with damage_text(HEADER):
        tolerance = float(header["tolerance"])
    complete_atlas(kept, problem, wide, survey, tolerance, executor, say)
    refuse_nowhere(kept, survey, len(wide.axes))
    draw_sample(kept, sample, executor, say, problem_from_scenario)
    return kept.directory


def _wider_survey_line(
    kept: AtlasStore,
    problem: Problem,
    region: Region,
    wide: Region,
    survey: Mapping[str, Any],
    method: Indirect,
    say: Watch,
) -> dict[str, Any]:
    """Write the shards of the wider survey and return its line."""
    widths = widths_of(survey["charts"][0], region)
    surveyed, found = (
        Survey(problem=problem, region=wide, method=method, watch=say, widths=widths),
        list[SurveyedChart](),
    )
    with suppress(PeriluneError):  # nothing at the points that were tried: what is known is carried on all the same
        found = surveyed.run()
    places, values = wide.corners()
    charts = list[tuple[dict[str, Any], NDArray[Any]]]()
    reach = [
        np.isfinite(one.y[:, :, 0]).any(axis=1)
        | np.isin(np.arange(len(one.sheets)), [inside.sheet for inside in one.small])
        for one in found
    ]
    unmet = [np.nonzero(reaches)[0].tolist() for reaches in reach]
    for said in survey["charts"]:
        said = {**said, "widths": widths_of(said, region).tolist()}
        rows = kept.shard(said["seeds"], seed_type(len(wide.axes), said["unknowns"]))
        alike = next((i for i, one in enumerate(found) if _equations_key(chart_entry(one)) == _equations_key(said)), -1)
        left = unmet[alike] if alike >= 0 else []
        sheets = sheets_of(said)
        known = [_corners_of(rows, number) for number in range(len(sheets))]
        chart = Chart(problem, wide.names, np.array(said["widths"]), arc_sequence_from(said))
        borders = Borders(chart)
        for number, sheet in enumerate(sheets):
            same = [n for n in left if _is_known_sheet(found[alike], n, sheet, places, known[number])]
            for n in same:
                known[number] = {**corners_reached(places, found[alike].y[n]), **known[number]}
                left.remove(n)
            if not same:
                known[number] = continue_between_corners(chart, borders, sheet, places, values, known[number])
        rows = np.concatenate([_corner_rows(known, rows.dtype), rows[rows["place"].any(axis=1)]])
        charts.append(({k: v for k, v in said.items() if k != "seeds"}, rows))
    for one, left, reaches in zip(found, unmet, reach, strict=True):
        if left:
            said, left = chart_entry(one), [*left, *np.nonzero(~reaches)[0].tolist()]  # with those behind their bounds
            some = replace(one, y=one.y[left], small=_renumber_sheets(one.small, left))
            charts.append(({**said, "sheets": [said["sheets"][n] for n in left]}, seed_rows(places, some)))
    before = [*survey.get("predecessors", []), survey["digest"]]
    lines = [
        {**said, "seeds": kept.put(f"survey-{len(before)}-{number}.npy", rows)}
        for number, (said, rows) in enumerate(charts)
    ]
    edges = [{"first": axis.first, "at": list(axis.edges)} for axis in wide.axes]
    notes = [*survey.get("notes", []), *surveyed.notes]
    return {
        "kind": "survey", "digest": digest_of([before, edges, lines]), "header": kept.seal, "predecessors": before,
        "edges": edges, "charts": lines, "notes": list(dict.fromkeys(notes))[:MOST_NOTES],
    }  # fmt: skip


def _equations_key(said: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the entries of a chart's line that decide its equations and their canonical units."""
    course = arc_sequence_from(said)
    return course.keep, course.text, said["unknowns"], said["widths"]


def _renumber_sheets(small: Sequence[InteriorSeed], left: Sequence[int]) -> tuple[InteriorSeed, ...]:
    """Return the interior extremals of the remaining branches, with the new numbers of these."""
    return tuple(replace(one, sheet=left.index(one.sheet)) for one in small if one.sheet in left)


def _corners_of(rows: NDArray[Any], sheet: int) -> Corners:
    mine = rows[(rows["sheet"] == sheet) & ~rows["place"].any(axis=1)]
    return {tuple(corner): np.array(y) for corner, y in zip(mine["corner"].tolist(), mine["y"], strict=True)}


def _is_known_sheet(found: SurveyedChart, number: int, sheet: Sheet, places: NDArray[np.int64], known: Corners) -> bool:
    """Return True if a branch that was found is a known one: one extremal in common makes them the same."""
    other = found.sheets[number]
    if not other.alike(sheet):
        return False
    there = corners_reached(places, found.y[number])
    return any(same_unknowns(y, there[corner]) for corner, y in known.items() if corner in there)


def _corner_rows(sheets: Sequence[Corners], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the rows of a shard of branches at corners."""
    listed = [(number, corner, y) for number, known in enumerate(sheets) for corner, y in sorted(known.items())]
    rows = np.zeros(len(listed), dtype=dtype)
    for row, (number, corner, y) in zip(rows, listed, strict=True):
        row["sheet"], row["corner"], row["y"] = number, corner, y
    return rows
