"""Merge two atlases of one problem, each over a part of the same region or over adjacent regions.

Nothing is computed. The charts of the second follow those of the first, unless both were made from one survey; of a
part of the region that is complete in both, that of the first is taken. Every shard is checked before it is copied, and
a proof is copied if all that answers at its node is. The header is written last: before that there is no atlas, and the
same command resumes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.building.audit import LEVEL
from perilune.atlas.region import Axis, Region
from perilune.atlas.store.checksums import digest_of, end_line, seal_of
from perilune.atlas.store.manifest import damage_text
from perilune.atlas.store.schema import (
    MOST_NOTES,
    brick_name,
    cell_type,
    header_axes,
    header_region,
    node_type,
    seed_type,
    seeded_places,
    survey_region,
    widths_of,
)
from perilune.atlas.store.store import HEADER, AtlasStore, clear_atlas
from perilune.core import (
    PeriluneError,
    Watch,
    check_call,
    format_quantity,
    ignore_events,
    renamed_keywords,
    require_path,
)
from perilune.io import fresh_directory, read_problem
from perilune.problem import Problem

_BY_HAND = ("axes", "versions", "format")  # of a header: compared otherwise, or not at all


Place = tuple[int, ...]  # numbers of a block, with its chart before them or without


@dataclass(frozen=True)
class _Part:
    """One of the two atlases: store, header, survey, region, blocks by chart and numbers, and proofs."""

    kept: AtlasStore
    header: Mapping[str, Any]
    survey: Mapping[str, Any]
    region: Region
    bricks: Mapping[tuple[int, ...], Mapping[str, Any]]
    samples: Sequence[Mapping[str, Any]]
    ended: bool  # whether a builder came to its end

    @cached_property
    def wholes(self) -> set[Place]:
        """Return places at which each chart has the blocks for which its survey has branches."""
        d, found = len(self.region.axes), set(self.region.bricks)
        for number, chart in enumerate(self.survey["charts"]):
            seeds = self.kept.shard(chart["seeds"], seed_type(d, chart["unknowns"]))
            asked = seeded_places(self.region, chart, seeds)
            found -= {place for place in asked if (number, *place) not in self.bricks}
        return found

    def moved(self, shift: NDArray[np.int64]) -> _Part:
        """Return the part with shifted numbers of places; the shards of its survey keep theirs."""

        def move(place: Sequence[int]) -> Place:
            return tuple((np.array(place) + shift).tolist())

        charts = [
            {**chart, "excluded_bricks": [list(move(place)) for place in chart.get("excluded_bricks", ())]}
            for chart in self.survey["charts"]
        ]
        axes = (replace(axis, first=axis.first + int(by)) for axis, by in zip(self.region.axes, shift, strict=True))
        bricks = {(number, *move(place)): line for (number, *place), line in self.bricks.items()}
        found = replace(self, survey={**self.survey, "charts": charts}, region=Region(tuple(axes)), bricks=bricks)
        found.__dict__["wholes"] = {move(place) for place in self.wholes}
        return found


@renamed_keywords(watch="callback")
@check_call
def merge(
    first: str | Path,
    second: str | Path,
    out: str | Path,
    *,
    force: bool = False,
    callback: Watch = ignore_events,
    problem_from_scenario: Callable[[str], Problem] | None = None,
) -> Path:
    """Make one atlas of two.

    Parameters
    ----------
    first, second
        Directories of atlases of the same problem, over the same parameters, to the same tolerance; they stay as they
        are.
    out
        A new or empty directory, or that of a merge that was stopped.
    force
        Whether an atlas that is there may be replaced, when all of the new one is written.
    callback
        Receives lines of text.
    problem_from_scenario
        As of `perilune.atlas.open`.

    Returns
    -------
    Path
        The directory, for `perilune.atlas.open`. What both lack is built by ``perilune atlas extend`` with no range,
        which also draws proofs among all; those of the two that are kept say nothing of the whole.

    Raises
    ------
    PeriluneError
        If they are of different problems, or their regions make no one box, or a file of them is damaged.
    """
    if problem_from_scenario is None:
        from perilune.scenario import load_text as problem_from_scenario
    one, other = (
        _read_part(require_path(place, "an atlas to merge"), problem_from_scenario) for place in (first, second)
    )
    _refuse_unlike(one, other)
    one, other, region = _ordered_parts(one, other)
    kept = AtlasStore(require_path(out, "the directory of an atlas"))
    if (kept.directory / HEADER).exists() and not force:
        raise PeriluneError(
            "the output directory holds an atlas already", got=str(out), expected="a new or empty directory",
            advice="choose another directory, or --force (in Python force=True)",
        )  # fmt: skip
    if kept.directory.resolve() in (one.kept.directory.resolve(), other.kept.directory.resolve()):
        raise PeriluneError("the two atlases are merged into a third", got=str(out), expected="another directory")
    header = {**one.header, **header_axes(region), "versions": _versions_of(one.header, other.header)}
    kept.prepare(None)

    def write(into: AtlasStore) -> None:
        lines = list(_merged_manifest_lines(into, one, other, region, seal_of(header), callback))
        if one.ended and other.ended:
            survey = next(line for line in lines if line["kind"] == "survey")
            lines.append(end_line(survey, (line for line in lines if line["kind"] == "brick")))
        into.write_lines(lines)
        into.begin(header)

    if (kept.directory / HEADER).exists():  # it stays until the whole of the new one is complete
        with fresh_directory(kept.directory.resolve(), force=True) as work:
            write(AtlasStore(work))
            clear_atlas(kept.directory)
    else:
        write(kept)
    return kept.directory


def _read_part(directory: Path, problem_from_scenario: Callable[[str], Problem]) -> _Part:
    kept = AtlasStore(directory)
    header, survey = kept.header(), kept.survey()
    if survey is None:
        raise PeriluneError("this atlas has no survey yet", got=str(directory), advice="build it first")
    region = survey_region(header_region(read_problem(header, problem_from_scenario), header), survey)
    bricks = kept.latest(survey, len(region.axes))
    samples = kept.samples(survey["digest"], _total_nodes(bricks.values()), len(region.axes))
    return _Part(kept, header, survey, region, bricks, samples, kept.ended(survey, len(region.axes)))


def _total_nodes(lines: Iterable[Mapping[str, Any]]) -> int:
    """Return the number of nodes of blocks, given their lines."""
    return sum(line["nodes"]["rows"] for line in lines)


def _versions_of(*headers: Mapping[str, Any]) -> dict[str, str]:
    """Return the versions of the programs that computed the parts; both where they differ."""
    with damage_text(HEADER):
        found = [dict[str, str](header["versions"]) for header in headers]
        names = list(dict.fromkeys(name for one in found for name in one))
        return {n: " and ".join(dict.fromkeys(str(one[n]) for one in found if n in one)) for n in names}


def _refuse_unlike(one: _Part, other: _Part) -> None:
    """Refuse atlases of different problems, parameters or tolerances."""
    keys = [key for key in {**one.header, **other.header} if key not in _BY_HAND]
    differs = [key for key in keys if one.header.get(key) != other.header.get(key)]
    if one.region.names != other.region.names:
        differs.append("axes")
    if differs:
        raise PeriluneError(
            f"these atlases are of different {', '.join(differs)}",
            got=f"{one.kept.directory} and {other.kept.directory}",
            expected="the same problem, the same parameters in the same order, the same tolerance",
        )


def _ordered_parts(one: _Part, other: _Part) -> tuple[_Part, _Part, Region]:
    """Return both parts, the lower first, and their joint region; the second's blocks keep their own numbers."""
    apart = [i for i, (a, b) in enumerate(zip(one.region.axes, other.region.axes, strict=True)) if a.edges != b.edges]
    if len(apart) == 1:
        a, b = one.region.axes[apart[0]], other.region.axes[apart[0]]
        if b.high == a.low:
            one, other, a, b = other, one, b, a
        if a.high == b.low:
            joined = replace(a, edges=(*a.edges, *b.edges[1:]))
            axes = tuple(joined if i == apart[0] else axis for i, axis in enumerate(one.region.axes))
            return one, other, Region(axes)
    if apart:
        told = "; ".join(_axis_difference_text(one.region.axes[i], other.region.axes[i]) for i in apart)
        raise PeriluneError(
            "these two regions do not form one", got=told,
            expected="equal ranges along all axes but one, and along this axis one ends where the other begins",
            advice="build the missing part, or extend one of them: perilune atlas extend",
        )  # fmt: skip
    return one, other, one.region


def _axis_difference_text(a: Axis, b: Axis) -> str:
    if (a.low, a.high) == (b.low, b.high):
        return f"{a.key} is divided at different values"
    ranges = (f"{format_quantity(axis.low, axis.unit)} to {format_quantity(axis.high, axis.unit)}" for axis in (a, b))
    return f"{a.key} {' and '.join(ranges)}"


def _merged_manifest_lines(
    kept: AtlasStore, one: _Part, other: _Part, region: Region, seal: str, watch: Watch
) -> Iterator[dict[str, Any]]:
    """Yield the lines of the manifest, after the shards that they name are written."""
    d, same = len(region.axes), one.survey["digest"] == other.survey["digest"]
    shift = np.array([_shift(a, b, c) for a, b, c in zip(one.region.axes, other.region.axes, region.axes, strict=True)])
    other = other.moved(shift)
    # A place that one of them has whole is not taken from the other.
    of_one = set() if same else one.wholes
    of_other = set() if same else other.wholes - of_one
    lines, taken = list[dict[str, Any]](), dict[Place, tuple[_Part, Mapping[str, Any]]]()
    for part, leaves, by in ((one, of_other, 0 * shift), (other, of_one, shift)):
        behind = 0 if same else len(lines)
        for (number, *place), line in part.bricks.items():
            if tuple(place) not in leaves:
                taken.setdefault((number + behind, *place), (part, line))
        if len(lines) and same:
            continue
        for chart in part.survey["charts"]:
            rows = np.array(part.kept.shard(chart["seeds"], seed_type(d, chart["unknowns"])))
            rows["corner"] += by
            without = sorted({*map(tuple, chart.get("excluded_bricks", ())), *leaves})
            seeds = kept.put(f"survey-{len(lines)}.npy", rows)
            widths = widths_of(chart, part.region).tolist()
            lines.append(
                {**chart, "widths": widths, "excluded_bricks": [list(place) for place in without], "seeds": seeds}
            )
    edges = [{"first": axis.first, "at": list(axis.edges)} for axis in region.axes]
    notes = list(dict.fromkeys([*one.survey.get("notes", []), *other.survey.get("notes", [])]))[:MOST_NOTES]
    digest = digest_of([edges, lines])
    proofs, lost = _valid_proofs((one, other), region, taken)
    if lost:
        watch(said := f"{lost} proofs of the merged atlases are dropped, because both atlases answer at their nodes")
        notes = [*notes, said][-MOST_NOTES:]
    yield {"kind": "survey", "digest": digest, "header": seal, "edges": edges, "charts": lines, "notes": notes}
    for count, (key, (part, line)) in enumerate(sorted(taken.items(), key=lambda item: item[0]), 1):
        watch(f"{count} of {len(taken)} bricks")
        yield _copied_brick_line(kept, part, line, key, digest, lines[key[0]]["unknowns"])
    if any(proofs.values()):  # nothing was asked of the whole
        nodes = _total_nodes(line for _, line in taken.values())
        yield {"kind": "sample", "survey": digest, "nodes": nodes, "requested": 0, "level": LEVEL, **proofs}


def _valid_proofs(
    parts: Sequence[_Part], region: Region, taken: Mapping[Place, tuple[_Part, Mapping[str, Any]]]
) -> tuple[dict[str, list[Any]], int]:
    """Return the proofs at places where only their own atlas answers, and the number of other proofs."""
    found, lost, of_place = {"drawn": [], "thin_margin": [], "merged": []}, 0, dict[Place, list[_Part]]()
    for (_, *place), (part, _) in taken.items():
        of_place.setdefault(tuple(place), []).append(part)
    for part in parts:
        own = Counter(tuple(place) for _, *place in part.bricks)
        for kind, one in ((k, one) for line in part.samples for k in found for one in line.get(k, ())):
            values = np.array(one["values"], dtype=float)
            place, here = part.region.brick_of(values), of_place.get(region.brick_of(values), [])
            whole = len(here) == own[place] and all(of is part for of in here)
            if whole and place == region.brick_of(values):  # on a common side of both it is a node of the other
                found["thin_margin" if kind == "thin_margin" else "merged"].append(one)
            else:
                lost += 1
    return found, lost


def _shift(a: Axis, b: Axis, joined: Axis) -> int:
    """Return the shift of the numbers of the second atlas's blocks along an axis."""
    begins = 0 if a.edges == b.edges else len(joined.edges) - len(b.edges)
    return joined.first + begins - b.first


def _copied_brick_line(
    kept: AtlasStore, part: _Part, line: Mapping[str, Any], key: tuple[int, ...], digest: str, unknowns: int
) -> dict[str, Any]:
    """Copy the shards of a block of one of the two, and return its line in the new manifest."""
    name, d = brick_name(key), len(key) - 1
    shards = {}
    for kind, dtype in (("nodes", node_type(d, unknowns)), ("cells", cell_type(d))):
        file = f"brick-{digest[:8]}-{name}.{kind}.npy"
        if not kept.has(file, line[kind]):
            kept.put(file, np.asarray(part.kept.shard(line[kind], dtype)))
        shards[kind] = {**line[kind], "file": file}
    line = {k: v for k, v in line.items() if k != "round"}
    return {**line, "name": name, "chart": key[0], "brick": list(key[1:]), "survey": digest, **shards}
