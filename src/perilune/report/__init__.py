"""What leaves the program: documents, tables, figures, reports. matplotlib is imported for figures only."""

from __future__ import annotations

import shutil
from pathlib import Path

from perilune.problem.solution import Solution

REPORT_FILE = "report.md"


def write_all(
    solution: Solution,
    out_dir: str | Path,
    *,
    scenario_text: str | None,
    ordinary: Solution | None = None,
    force: bool = False,
) -> None:
    """Write everything about a solution: ``solution.json``, ``trajectory.csv``, figures, ``report.md``.

    Parameters
    ----------
    solution
        What to write.
    out_dir
        Directory; its files appear together, when all are complete.
    scenario_text
        The scenario that the problem was made of, with every change made to it; None where it alone is not all of it.
    ordinary
        A plainer flight of the same problem, drawn into the same figures.
    force
        Whether what an earlier run wrote there may be replaced.

    Raises
    ------
    PeriluneError
        If the directory cannot be written, or is not empty and `force` is false.
    """
    from perilune.io.export import write_solution_files
    from perilune.io.files import fresh_directory

    with fresh_directory(out_dir, force) as work:
        write_solution_files(solution, work, scenario_text)
        _write_report(solution, work, scenario_text, ordinary)


def add_report(
    solution: Solution, directory: Path, *, scenario_text: str | None, ordinary: Solution | None = None
) -> None:
    """Write the same beside what `perilune.save` wrote of the solution, which stays where this ends by an error."""
    from perilune.io.export import solution_files
    from perilune.io.files import fresh_directory

    with fresh_directory(directory, force=True) as work:
        for name in solution_files(solution):
            shutil.copy2(directory / name, work)
        _write_report(solution, work, scenario_text, ordinary)


def _write_report(solution: Solution, work: Path, scenario_text: str | None, ordinary: Solution | None) -> None:
    from perilune.report.figures import save, solution_figures
    from perilune.report.summary import solution_markdown

    (work / "figures").mkdir()
    drawn = solution_figures(solution, ordinary)
    for name, figure in drawn.items():
        save(figure, work / "figures", name)
    report = solution_markdown(solution, drawn, scenario_text or "")
    (work / REPORT_FILE).write_text(report, encoding="utf-8")
