"""What the reports on reproduced papers share: printed beside computed, claims that hold or do not, pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from matplotlib.figure import Figure

from perilune.io.columns import flight_columns
from perilune.problem.solution import Solution
from perilune.report.style import save

# Name: value, unit, place in the paper. For comparison, never for computing.
Printed = MappingProxyType[str, tuple[float, str, str]]
NUMBERS_HEAD = ["quantity", "where", "printed", "computed", "computed - printed", "unit"]
CLAIMS_HEAD = ["claim", "where", "computed", "holds"]


def number_rows(printed: Printed, computed: Mapping[str, float]) -> list[list[str]]:
    """Rows of the table `NUMBERS_HEAD`; ours with two more decimals than the paper prints."""
    rows = []
    for name, (value, unit, where) in printed.items():
        decimals, ours = len(str(value).partition(".")[2]), computed[name]
        rows.append([name, where, f"{value:.{decimals}f}", f"{ours:.{decimals + 2}f}", f"{ours - value:+.1e}", unit])
    return rows


def verdict(holds: bool) -> str:
    """The last column of the table `CLAIMS_HEAD`."""
    return "yes" if holds else "**no**"


def highest(solution: Solution, name: str) -> float:
    """Largest value of a column along the flight."""
    return max(float(column.values.max()) for _, column in flight_columns(solution, name))


def illustrated(captions: Mapping[str, str]) -> list[str]:
    """Markdown of the figures ``figures/<name>.png`` with their captions."""
    return [f"![{text}](figures/{name}.png)\n\n*{text}*" for name, text in captions.items()]


def save_figures(figures: Mapping[str, Figure], directory: Path) -> None:
    """Write all figures into ``figures/`` of a directory."""
    (directory / "figures").mkdir()
    for name, figure in figures.items():
        save(figure, directory / "figures", name)


def versions_line(versions: Mapping[str, str]) -> str:
    """The last line of a report."""
    return "Versions: " + ", ".join(f"{name} {version}" for name, version in versions.items()) + "."
