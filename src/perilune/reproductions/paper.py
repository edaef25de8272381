"""Common sections of the reports on reproduced papers: printed and computed numbers, claims, pictures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from matplotlib.figure import Figure

from perilune.io.columns import flight_columns
from perilune.io.export import versions
from perilune.problem.solution import Solution
from perilune.report.style import save
from perilune.report.summary import table

# Name: value, unit, place in the paper. For comparison, never for computing.
Printed = MappingProxyType[str, tuple[float, str, str]]


def numbers(printed: Printed, computed: Mapping[str, float]) -> str:
    """Return the section with every printed number and ours, which has two more decimals than the paper prints."""
    rows = []
    for name, (value, unit, where) in printed.items():
        decimals, ours = len(str(value).partition(".")[2]), computed[name]
        rows.append([name, where, f"{value:.{decimals}f}", f"{ours:.{decimals + 2}f}", f"{ours - value:+.1e}", unit])
    head = ["quantity", "where", "printed", "computed", "computed - printed", "unit"]
    return "## Numbers\n\n" + table(head, rows)


def claims(rows: Iterable[Sequence[str]]) -> str:
    """Section with the paper's claims: (claim, where, the number that decides it, `verdict`)."""
    return "## Claims\n\n" + table(["claim", "where", "computed", "holds"], rows)


def slips(rows: Iterable[Sequence[str]]) -> str:
    """Section with what the paper prints or implies, and what is used here: (where, printed, used)."""
    return "### Misprints, and what is easily missed\n\n" + table(["where", "printed or implied", "used here"], rows)


def verdict(holds: bool) -> str:
    """The last column of `claims`."""
    return "yes" if holds else "**no**"


def worst(*proved: Solution) -> Solution:
    """The solution of the worst outcome, and among equal ones of the lowest level of proof."""
    return max(proved, key=lambda s: (s.outcome.exit_code, -s.verification.level))


def highest(solution: Solution, name: str) -> float:
    """Largest value of a column along the flight."""
    return max(float(column.values.max()) for _, column in flight_columns(solution, name))


def illustrated(captions: Mapping[str, str]) -> list[str]:
    """Markdown of the figures ``figures/<name>.png`` with their captions."""
    return [f"![{text}](figures/{name}.png)\n\n*{text}*" for name, text in captions.items()]


def versions_line() -> str:
    """The last line of a report."""
    return "Versions: " + ", ".join(f"{name} {version}" for name, version in versions().items()) + "."


def write_report(directory: Path, text: str, figures: Mapping[str, Figure], data: Mapping[str, str]) -> None:
    """Write ``report.md``, all figures into ``figures/``, and files of data by name, into a directory that exists."""
    (directory / "figures").mkdir()
    for name, figure in figures.items():
        save(figure, directory / "figures", name)
    for name, content in data.items():
        (directory / name).write_text(content, encoding="utf-8", newline="")
    (directory / "report.md").write_text(text, encoding="utf-8")
