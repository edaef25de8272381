"""The command ``atlas``: build, extend, merge, query, plot, export, info, verify."""

from __future__ import annotations

from argparse import Namespace
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from perilune import PeriluneError
from perilune.cli.interrupts import advise_on_interrupt, raise_pending_interrupt
from perilune.cli.output import CommandAnswer, WrittenFiles
from perilune.cli.progress import LONGEST_LOG, print_note, progress, refuse_unusable_target
from perilune.cli.sweep import ranges_of_keys, scenario_with_ranges, sweep_executor
from perilune.core import format_quantity, parameter_name, parse_quantity, unknown_name, with_key_named

if TYPE_CHECKING:
    from perilune import Problem
    from perilune.atlas import Atlas, Query


def _run_atlas_build(typed: Namespace) -> CommandAnswer:
    from perilune.atlas import HEADER, build
    from perilune.scenario import bounds_of

    axes = ranges_of_keys(typed, bounds_of)
    problem = _problem_to_map(typed, axes)
    there = _file_signature(typed.out / HEADER)
    if there and not (typed.resume or typed.force):
        raise PeriluneError(
            "the output directory already holds an atlas", got=str(typed.out), expected="a new or empty directory",
            advice="--resume to continue it, --force to start over, or another directory",
        )  # fmt: skip

    def going_on() -> str:
        """Return advice on going on; empty if nothing was begun, or the atlas to be replaced is still there."""
        begun = _file_signature(typed.out / HEADER)
        return "the same command with --resume continues" if begun and (typed.resume or begun != there) else ""

    with (
        advise_on_interrupt(going_on),
        progress(typed.verbose, deque(maxlen=LONGEST_LOG)) as watch,
        sweep_executor(typed) as executor,
    ):
        build(
            problem,
            axes,
            typed.out,
            executor,
            callback=watch,
            bricks=typed.bricks,
            sample=typed.sample,
            force=typed.force and not typed.resume,
            **({} if typed.tolerance is None else {"tolerance": typed.tolerance}),
        )
    return _atlas_description(_open_typed_atlas(typed), built=str(typed.out))


def _file_signature(file: Path) -> tuple[int, int] | None:
    """Return a signature that differs between a file and its replacement; None for a missing file."""
    return (found.st_ino, found.st_mtime_ns) if file.is_file() and (found := file.stat()) else None


def _run_atlas_extend(typed: Namespace) -> CommandAnswer:
    from perilune.atlas import extend

    atlas, wanted = _open_typed_atlas(typed), dict[str, tuple[float, float]]()
    for key, bounds in _axis_ranges(atlas, typed.vary):
        if key in wanted:
            raise PeriluneError(f"--vary names {key} twice", expected="each axis once")
        wanted[key] = bounds

    def going_on() -> str:
        """Return advice on going on; empty until the wider region is surveyed, as the atlas is unchanged."""
        wide = (atlas.store.survey() or {}).get("digest") != atlas.survey.get("digest")
        return f"perilune atlas extend {typed.directory} builds what is missing" if wide or not wanted else ""

    with (
        advise_on_interrupt(going_on),
        progress(typed.verbose, deque(maxlen=LONGEST_LOG)) as watch,
        sweep_executor(typed) as executor,
    ):
        extend(typed.directory, wanted, executor, callback=watch, sample=typed.sample)
    return _atlas_description(_open_typed_atlas(typed), built=str(typed.directory))


def _axis_ranges(atlas: Atlas, vary: list[str]) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield the typed ranges of axes [SI]."""
    from perilune.core import Quantity
    from perilune.scenario import bounds_of

    units = {axis.name: axis.unit for axis in atlas.region.axes}
    for stated in vary:
        key, _, text = (part.strip() for part in stated.partition("="))
        name = parameter_name(key)
        if name not in units:
            raise unknown_name("axis", key, [axis.key for axis in atlas.region.axes])
        yield name, bounds_of(key, text, {key: Quantity(unit=units[name], example=f"1 {units[name]}")})


def _run_atlas_merge(typed: Namespace) -> CommandAnswer:
    from perilune.atlas import HEADER, merge

    def going_on() -> str:
        """Return advice on going on; empty if nothing was copied yet, or an atlas is there, old or new."""
        copied = typed.out.is_dir() and any(typed.out.iterdir()) and not _file_signature(typed.out / HEADER)
        return f"{typed.out} is not a complete atlas; repeat the same command to merge again" if copied else ""

    with advise_on_interrupt(going_on), progress(typed.verbose, deque(maxlen=LONGEST_LOG)) as watch:
        merge(typed.directory, typed.other, typed.out, force=typed.force, callback=watch)
    typed.directory = typed.out
    return _atlas_description(_open_typed_atlas(typed), built=str(typed.out))


def _problem_to_map(typed: Namespace, axes: Mapping[str, tuple[float, float]]) -> Problem:
    """Return the problem of the file, or if it leaves an axis open, with the first value of that."""
    from perilune.scenario import load_file

    at_ends = scenario_with_ranges(typed.file, typed.changes, axes)
    try:
        return load_file(typed.file, typed.changes).problem
    except PeriluneError:
        return at_ends.problem


def _run_atlas_info(typed: Namespace) -> CommandAnswer:
    return _atlas_description(_open_typed_atlas(typed))


def _run_atlas_verify(typed: Namespace) -> CommandAnswer:
    from perilune.atlas import verify_atlas

    with progress(typed.verbose, deque(maxlen=LONGEST_LOG)) as watch:
        found = verify_atlas(_open_typed_atlas(typed), typed.sample, seed=typed.seed, callback=watch)
    outcome = ("PROVED" if found.drawn else "SOLVED") if found.passed else "NOT_PROVED"  # of none drawn nothing is
    document = {**asdict(found), "share": found.share, "outcome": outcome}
    return CommandAnswer(text=str(found), document=document, exit_code=0 if found.passed else 5)


def _run_atlas_query(typed: Namespace) -> CommandAnswer:
    from perilune import verify
    from perilune.io import solution_document
    from perilune.report import solution_summary

    atlas = _open_typed_atlas(typed)
    values = _typed_axis_values(atlas, typed.at)
    refuse_unusable_target(typed.out, typed.force)
    answer = atlas.query(**values)
    solution = verify(answer, typed.verify) if typed.verify else answer
    raise_pending_interrupt()
    files = WrittenFiles()
    if typed.out is not None:
        with files.written():
            from perilune.report import write_all

            write_all(solution, typed.out, scenario_text=None, force=typed.force)
    lines = [solution_summary(solution, every_check=typed.verbose), "", *_query_lines(answer.query)]
    code = solution.outcome.exit_code if typed.verify else 0
    document = {**solution_document(solution), "query": asdict(answer.query)}
    return files.placed(CommandAnswer(text="\n".join(lines), document=document, exit_code=code), typed.out)


def _run_atlas_export(typed: Namespace) -> CommandAnswer:
    from perilune.atlas import FORMS, export
    from perilune.io import format_of

    atlas, form = _open_typed_atlas(typed), format_of(typed.out, typed.format, list(FORMS))
    there = _file_signature(typed.out)
    with advise_on_interrupt(
        lambda: "" if _file_signature(typed.out) != there else f"nothing was written to {typed.out}"
    ):
        export(atlas, typed.out, form, force=typed.force)
    nodes, size = atlas.rows, typed.out.stat().st_size
    document = {"written": str(typed.out), "format": form, "nodes": nodes, "bytes": size}
    return CommandAnswer(text=f"written to {typed.out}: {nodes} nodes, {size / 2**20:.1f} MiB", document=document)


def _run_atlas_plot(typed: Namespace) -> CommandAnswer:
    from perilune.atlas import sliced
    from perilune.io import NotWrittenError
    from perilune.report import write_maps

    atlas = _open_typed_atlas(typed)
    refuse_unusable_target(typed.out, typed.force)
    names = [name.strip() for name in typed.axes.split(",")] if typed.axes is not None else []
    shown = sliced(atlas, names, _typed_axis_values(atlas, typed.at), points=typed.points)
    files, drawn = WrittenFiles(), list[str]()
    if typed.out is not None:
        try:
            drawn = write_maps(shown, typed.out, typed.force)
        except NotWrittenError as error:
            files.failed += error.failed
            drawn = sorted(path.stem for path in typed.out.glob("*.png"))
    total = len(shown.answers.good)
    lines = [
        f"slice over {' and '.join(axis.key for axis in shown.axes)}"
        + "".join(f", {axis.format_value(shown.at[axis.name])}" for axis in atlas.region.axes if axis.name in shown.at),
        *(f"  {100 * count / total:5.1f} %  {text}" for text, count in shown.counts.items()),
        f"written to {typed.out}: {', '.join(drawn)}" if drawn else "--out DIR writes its figures",
    ]  # fmt: skip
    document = {
        "axes": [axis.name for axis in shown.axes], "at": dict(shown.at), "points": total,
        "answered": int(shown.answers.good.sum()), "counts": shown.counts, "figures": drawn,
    }  # fmt: skip
    return files.noted(CommandAnswer(text="\n".join(lines), document=document))


def _open_typed_atlas(typed: Namespace) -> Atlas:
    from perilune import atlas

    return atlas.open(typed.out if typed.action == "build" else typed.directory)


def _typed_axis_values(atlas: Atlas, at: list[str]) -> dict[str, float]:
    """Return the typed values of the axes [SI]."""
    axes, found = {axis.name: axis for axis in atlas.region.axes}, dict[str, float]()
    for stated in at:
        key, sign, text = (part.strip() for part in stated.partition("="))
        name = parameter_name(key)
        if not sign:
            raise PeriluneError("--at needs a key and a value", got=stated[:60], expected='--at "vehicle.thrust=440 N"')
        if name not in axes:
            raise unknown_name("axis", key, [axis.key for axis in axes.values()])
        if name in found:
            raise PeriluneError(f"--at names {key} twice", got=stated[:60], expected="each axis once")
        try:
            found[name] = parse_quantity(text, axes[name].unit)
        except PeriluneError as error:
            raise with_key_named(key, error) from None
    return found


def _atlas_description(atlas: Atlas, **more: str) -> CommandAnswer:
    """Describe an atlas and how complete it is; exit code 5 if not all of the answers drawn at building are proved."""
    from perilune.atlas import covered_share, sample_of

    axes = [
        {"name": a.name, "low": a.low, "high": a.high, "unit": a.unit} for a in atlas.region.axes
    ]  # fmt: skip
    nodes = atlas.rows
    size = sum(int(line[kind]["bytes"]) for line in atlas.said.values() for kind in ("nodes", "cells"))
    sheets = [
        label
        for number, charted in enumerate(atlas.charted)
        for sheet, label in enumerate(charted.labels)
        if any(key[0] == number and sheet in line.get("sheets", (sheet,)) for key, line in atlas.said.items())
    ]
    total, share = len(atlas.region.bricks) * max(1, len(atlas.charted)), covered_share(atlas)
    lines = [
        f"atlas of {atlas.problem.heading}",
        *(
            f"  {a.key}: {format_quantity(a.low, a.unit)} to {format_quantity(a.high, a.unit)}"
            for a in atlas.region.axes
        ),
        f"{len(atlas.said)} of at most {total} bricks, {nodes} nodes, {size / 2**20:.1f} MiB",
        f"cells that answer: {100 * share.answered:.1f} % of the region"
        + (f", and infeasible by physical bounds: {100 * share.impossible:.1f} %" if share.impossible else "")
        + f", by {share.points} points",
        "sheets",
        *(f"  {label}" for label in sheets),
    ]
    notes = list(atlas.survey.get("notes", []))
    for text in notes:
        print_note(text)
    sample = sample_of(atlas)
    lines += sample.describe(atlas)
    proofs = {
        "drawn": len(sample.drawn), "proved": sample.proved, "share": sample.share,
        "thin_margin_nodes": sample.thin_nodes, "thin_margin_drawn": len(sample.thin), "merged": len(sample.merged),
        "refused": sample.refused, "unproved": [asdict(one) for one in sample.unproved],
    }  # fmt: skip
    document = {
        "problem": atlas.problem.name, "axes": axes, "tolerance": atlas.tolerance, "bricks": len(atlas.said),
        "nodes": nodes, "bytes": size, "coverage": share._asdict(), "sheets": sheets, "proofs": proofs,
        "notes": notes, **more,
    }  # fmt: skip
    return CommandAnswer(text="\n".join(lines), document=document, exit_code=5 if more and sample.unproved else 0)


def _query_lines(query: Query) -> list[str]:
    steps = "1 step" if query.steps == 1 else f"{query.steps} steps"
    return [
        f"answered from the atlas in {1e3 * query.latency:.2f} ms: sheet {query.sheet}",
        f"  first guess from its cell: error {query.guess_error:.1e}, polished in {steps} to "
        f"{query.error_bound:.1e} (relative)",
        f"  re-integrated independently: end conditions {query.residual:.1e}, drift of H {query.drift:.1e} (limits"
        f" 1e-9, canonical)",
        *(
            [f"  answers at randomly drawn nodes: all proved to level {query.sample_level}"]
            if query.sample_level
            else ()
        ),
    ]


ACTIONS: Mapping[str, Callable[[Namespace], CommandAnswer]] = {
    "build": _run_atlas_build,
    "extend": _run_atlas_extend,
    "merge": _run_atlas_merge,
    "query": _run_atlas_query,
    "plot": _run_atlas_plot,
    "export": _run_atlas_export,
    "info": _run_atlas_info,
    "verify": _run_atlas_verify,
}
