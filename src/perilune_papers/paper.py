"""Common sections of the reports on reproduced papers: printed and computed numbers, claims, pictures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from matplotlib.figure import Figure

from perilune import Solution
from perilune.io import flight_columns, program_versions
from perilune.report import markdown_table, save_figure

# Name: value, unit, place in the paper. For comparison, never for computing.
Printed = MappingProxyType[str, tuple[float, str, str]]


def numbers_section(printed: Printed, computed: Mapping[str, float]) -> str:
    """Return the section with every printed number and ours, which has two more decimals than the paper prints.

    Parameters
    ----------
    printed
        By name the number as printed, its unit, and where it stands in the paper.
    computed
        Computed values by the same names, in the same units.
    """
    rows = []
    for name, (value, unit, where) in printed.items():
        decimals, ours = len(str(value).partition(".")[2]), computed[name]
        rows.append([name, where, f"{value:.{decimals}f}", f"{ours:.{decimals + 2}f}", f"{ours - value:+.1e}", unit])
    head = ["quantity", "where", "printed", "computed", "computed - printed", "unit"]
    return "## Numbers\n\n" + markdown_table(head, rows)


def claims_section(rows: Iterable[Sequence[str]]) -> str:
    """Section with the paper's claims: (claim, where, the number that decides it, `claim_verdict`)."""
    return "## Claims\n\n" + markdown_table(["claim", "where", "computed", "holds"], rows)


def slips_section(rows: Iterable[Sequence[str]]) -> str:
    """Section with what the paper prints or implies, and what is used here: (where, printed, used)."""
    return "### Misprints, and what is easily missed\n\n" + markdown_table(
        ["where", "printed or implied", "used here"], rows
    )


def claim_verdict(holds: bool) -> str:
    """The last column of `claims_section`."""
    return "yes" if holds else "**no**"


def worst_solution(*proved: Solution) -> Solution:
    """The solution of the worst outcome, and among equal ones of the lowest level of proof."""
    return max(proved, key=lambda s: (s.outcome.exit_code, -s.verification.level))


def largest_value(solution: Solution, name: str) -> float:
    """Largest value of a column along the flight.

    Parameters
    ----------
    solution
        The flight.
    name
        Name of the column; the value has its unit.
    """
    return max(float(column.values.max()) for _, column in flight_columns(solution, name))


def figure_markdown(captions: Mapping[str, str]) -> list[str]:
    """Markdown of the figures ``figures/<name>.png`` with their captions."""
    return [f"![{text}](figures/{name}.png)\n\n*{text}*" for name, text in captions.items()]


def versions_line() -> str:
    """The last line of a report."""
    return "Versions: " + ", ".join(f"{name} {version}" for name, version in program_versions().items()) + "."


def write_paper_report(directory: Path, text: str, figures: Mapping[str, Figure], data: Mapping[str, str]) -> None:
    """Write ``report.md``, all figures into ``figures/``, and files of data by name, into a directory that exists.

    Parameters
    ----------
    directory
        Where to write.
    text
        The report in Markdown.
    figures
        Figures by the names of their files, without a suffix.
    data
        Texts by the names of their files.
    """
    (directory / "figures").mkdir()
    for name, figure in figures.items():
        save_figure(figure, directory / "figures", name)
    for name, content in data.items():
        (directory / name).write_text(content, encoding="utf-8", newline="")
    (directory / "report.md").write_text(text, encoding="utf-8")
