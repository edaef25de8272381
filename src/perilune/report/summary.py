"""Summary of a solution in words and tables: a few lines for the terminal, a Markdown report for the directory."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from perilune.io import extremals_document
from perilune.problem import LEVEL_NAMES, Result, Solution, Verification

_DIGITS = {"kg": 6, "m/s": 4, "s": 4, "Pa": 1, "W/m^2": 1, "J/m^2": 1}

_CAPTIONS = {
    "path": "Path over the limb; strokes show the exhaust",
    "track": "Path from the side and from above",
    "ground_track": "The point below the vehicle; coasts of Natural Earth, where they are drawn",
    "corridor": "Altitude over speed, with lines of constant load or heat rate",
    "states": "States",
    "controls": "Controls",
    "costates": "Costates",
    "hamiltonian": "Hamiltonian, and its increase if the thrust is turned away",
}
_AGAIN = "those listed in the file, each recomputed"


def solution_summary(solution: Solution, *, every_check: bool = True) -> str:
    """Return plain text for a terminal, 80 columns: results, extremals, proof, method.

    Without `every_check` checks are counted, level by level, and only failed ones are shown.

    Parameters
    ----------
    solution
        Solution, proved or not.
    every_check
        List all checks.
    """
    lines = [
        f"{solution.problem.heading}: {_outcome(solution)}",
        f"  {solution.outcome.value}",
        "",
    ]
    found = [readable_result(name, result) for name, result in solution.results.items()]
    width = max([16, *(len(told) for told, *_ in found)])
    lines += [f"  {told:{width}}{value:>16} {unit}".rstrip() for told, value, unit in found]
    lines += ["", *(f"warning: {warning}" for warning in solution.warnings)] if solution.warnings else []
    if solution.structure and not solution.statistics.from_file:
        lines += ["", "structure", *(f"  {arc.text}" for arc in solution.structure)]
    rows = _extremal_rows(solution)
    if len(rows) > 1:
        head = "extremals, best first" if len(rows) > 2 else "extremal"
        lines += ["", head + (f" ({_AGAIN})" if solution.statistics.from_file else "")]
        lines += ["  " + "  ".join(f"{cell:>{width}}" for cell, width in _padded(rows, row)) for row in rows]
    if solution.problem.inputs_read:
        lines += ["", *(f"read: {text}" for text in solution.problem.inputs_read)]
    verification = solution.verification
    lines += ["", f"verification: {verification.headline}"]
    if solution.statistics.from_file and verification.source:
        lines.append(f"  flown: {verification.source}")
    if not every_check:
        lines += _check_counts(verification)
    for c in verification.checks if every_check else verification.failed:
        mark, unit = "ok  " if c.passed else "FAIL", "" if c.unit == "1" else f" {c.unit}"
        lines.append(f"  {mark} {c.level} {c.name}: {c.value:.2g}{unit} ({c.format_limit(2)})")
        if not c.passed:
            lines.append(f"         {c.meaning}")
    lines += ["", *(f"note: {note}" for note in verification.notes)] if verification.notes else []
    # How it was found is of a file only its word.
    return "\n".join(lines if solution.statistics.from_file else [*lines, "", _method_lines(solution)])


def solution_markdown(solution: Solution, figures: Iterable[str] = (), scenario_text: str = "") -> str:
    """Return the Markdown report of one solution.

    Parameters
    ----------
    solution
        The solution.
    figures
        Names of the figures that lie in ``figures/``.
    scenario_text
        Shown at the end, so that the report says what it answers.
    """
    parts = [
        f"# {solution.problem.heading}",
        f"**{_outcome(solution)}.** {_as_sentence(solution.outcome.value)}",
        "## Results",
    ]
    found = solution.results
    parts.append(
        markdown_table(
            ["quantity", "value", "unit", ""],
            [[*readable_result(name, result), result.description] for name, result in found.items()],
        )
    )
    if solution.warnings:
        parts += ["## Warnings", "\n".join(f"- {_as_sentence(warning)}" for warning in solution.warnings)]
    rows = _extremal_rows(solution)
    if len(rows) > 1:
        parts += [
            "## Extremals",
            "Every extremal found, best first; the first is this solution"
            + (f" ({_AGAIN})." if solution.statistics.from_file else "."),
            markdown_table(rows[0], rows[1:]),
        ]
    if solution.problem.inputs_read:
        parts += ["## Files read", "\n".join(f"- {text}" for text in solution.problem.inputs_read)]
    parts += ["## Proof", _proof_markdown(solution)]
    parts += [] if solution.statistics.from_file else ["## How it was found", _method_lines(solution)]
    names = list(figures)
    if names:
        captions = _CAPTIONS | {h.name: h.caption for h in solution.problem.views.histories}
        told = {name: captions.get(name) or name.replace("_", " ").capitalize() for name in names}
        parts += ["## Figures", *(f"![{text}](figures/{n}.png)\n\n*{text}.*" for n, text in told.items())]
    if scenario_text:
        parts += [
            "## Scenario",
            f"```toml\n{scenario_text.replace('```', '')}\n```".replace("\n\n```", "\n```"),
        ]
    return "\n\n".join(parts) + "\n"


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a Markdown table; a bar inside a cell is escaped.

    Parameters
    ----------
    head
        Headings of the columns.
    rows
        Cells of each row.
    """

    def row(cells: Sequence[Any]) -> str:
        return "| " + " | ".join(str(c).replace("|", "\\|").replace("\n", " ") for c in cells) + " |"

    return "\n".join([row(head), "|" + "---|" * len(head), *(row(r) for r in rows)])


def readable_result(name: str, result: Result) -> tuple[str, str, str]:
    """Return name, value and unit of a result for people.

    Parameters
    ----------
    name, result
        Result of a solution by its name.

    Returns
    -------
    tuple[str, str, str]
        Angles in deg, all else in SI.
    """
    return (result.label or name.replace("_", " "), *readable_quantity(result.value, result.unit))


def readable_quantity(value: float, unit: str) -> tuple[str, str]:
    """Format a number with sensible decimals, and its unit: angles in degrees, no unit for a pure number.

    Parameters
    ----------
    value, unit
        In SI.
    """
    if unit == "rad":
        value, unit = math.degrees(value), "deg"
    text = f"{value:z.{_DIGITS.get(unit, 6)}f}" if math.isfinite(value) else "unknown"
    return text, "" if unit == "1" else unit


def _as_sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _outcome(solution: Solution) -> str:
    """Return the outcome, with the level reached if a proof was asked for."""
    verified = solution.verification.checks
    return solution.outcome.name + (f", {solution.verification.title}" if verified else "")


def extremal_cells(solution: Solution) -> list[dict[str, str]]:
    """Return the cells of each extremal, best first, by the heading of their column."""
    units = {name: result.unit for name, result in solution.results.items()}
    units |= {"objective": solution.problem.objective_unit, "nature": "1"}

    def cell(key: str, value: Any) -> tuple[str, str]:
        text, unit = (value, "") if key == "nature" else readable_quantity(value, units[key])
        return f"{key.replace('_', ' ')} ({unit})".removesuffix(" ()"), text

    return [dict(cell(k, v) for k, v in document.items()) for document in extremals_document(solution)]


def _extremal_rows(solution: Solution) -> list[list[str]]:
    """Return the heading and a row for each extremal, of the columns in which they differ."""
    known = extremal_cells(solution)
    keys = list(known[0]) if known else []
    shown = [key for key in keys if key in keys[-2:] or len({cells[key] for cells in known}) > 1]
    return [shown] + [[cells[key] for key in shown] for cells in known]


def _padded(rows: list[list[str]], row: list[str]) -> Iterable[tuple[str, int]]:
    return zip(row, [max(len(r[i]) for r in rows) for i in range(len(row))], strict=True)


def _check_counts(verification: Verification) -> list[str]:
    """Return a line with the count of checks for each level that has any."""
    lines = []
    for level, name in enumerate(LEVEL_NAMES):
        here = [c.passed for c in verification.checks if c.level == level]
        if here:
            count = f"{here.count(all(here))} of {len(here)} checks {'passed' if all(here) else 'FAILED'}"
            lines.append(f"  level {level}, {name + ':':18}{count}")
    return lines


def _proof_markdown(solution: Solution) -> str:
    verification = solution.verification
    lines = [f"{_as_sentence(verification.title)} A check passes within its limit."]
    if not verification.checks:
        return "Not verified. `perilune verify` proves a saved solution."
    rows = [
        [
            c.level,
            c.name,
            f"{c.value:.3g}",
            c.format_limit().removeprefix("limit "),
            c.unit,
            "passed" if c.passed else "**FAILED**",
            c.meaning,
        ]
        for c in verification.checks
    ]
    lines += [" ".join(f"{_as_sentence(note)}" for note in verification.notes)] if verification.notes else []
    return "\n\n".join([*lines, markdown_table(["level", "check", "value", "limit", "unit", "", "meaning"], rows)])


def _method_lines(solution: Solution) -> str:
    s = solution.statistics
    text = f"method {solution.method}"
    if s.initialization:
        text += f"; start: {s.initialization}"
    text += f"; {s.iterations} iteration{'' if s.iterations == 1 else 's'}"
    text += f"; {s.wall_time:.2f} s" if math.isfinite(s.wall_time) else ""
    # A list in Markdown as well; what a mesh missed, by condition, is in solution.json.
    steps = [f"- {step.partition(' (')[0]}" for step in s.attempts]
    return text + ("\n\n" + "\n".join(steps) if steps else "")
