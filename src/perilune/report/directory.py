"""Directory of a solution: its files, figures and report, which appear together."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

from perilune.core import PeriluneError
from perilune.problem import Solution

REPORT_FILE = "report.md"


def write_all(
    solution: Solution,
    out_dir: str | Path,
    *,
    scenario_text: str | None,
    ordinary: Solution | None = None,
    force: bool = False,
) -> None:
    """Write all files of a solution: ``solution.json``, ``trajectory.csv``, figures, ``report.md``.

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
    NotWrittenError
        If a file beside ``solution.json`` cannot be written; all others are there then.
    PeriluneError
        If the directory cannot be written, or is not empty and `force` is false.
    """
    from perilune.io import fresh_directory, refuse_unwritten, write_solution_files

    with fresh_directory(out_dir, force) as work:
        failed = write_solution_files(solution, work, scenario_text)
        failed += _write_figures_and_report(solution, work, scenario_text, ordinary)
    refuse_unwritten(failed)


def add_report(
    solution: Solution, directory: Path, *, scenario_text: str | None, ordinary: Solution | None = None
) -> None:
    """Add figures and report to the files that `perilune.save` wrote, which stay if this fails.

    Parameters
    ----------
    solution
        Solution that was saved.
    directory
        Directory of its files.
    scenario_text
        Text of the scenario that states its problem; None without one.
    ordinary
        Solution for comparison in figures and report; None without one.

    Raises
    ------
    NotWrittenError
        If a figure or the report cannot be written.
    """
    from perilune.io import fresh_directory, refuse_unwritten, solution_files

    with fresh_directory(directory, force=True) as work:
        for name in solution_files(solution):
            if (directory / name).is_file():  # a table may have failed
                shutil.copy2(directory / name, work)
        failed = _write_figures_and_report(solution, work, scenario_text, ordinary)
    refuse_unwritten(failed)


def _write_figures_and_report(
    solution: Solution, work: Path, scenario_text: str | None, ordinary: Solution | None
) -> list[PeriluneError]:
    """Write figures and report into a directory; return the errors of those that failed."""
    from matplotlib.figure import Figure

    from perilune.io import FIGURES, unwritten, write_each
    from perilune.report.figures import save_figure, solution_drawings
    from perilune.report.summary import solution_markdown

    known, failed = dict[str, Callable[[], Figure]](), list[PeriluneError]()
    drawn = []
    try:
        known = solution_drawings(solution, ordinary)
    except Exception as error:  # of what all figures share
        failed.append(unwritten("no figure is drawn", error))

    def figure(path: Path, draw: Callable[[], Figure]) -> None:
        save_figure(draw(), path.parent, path.name)
        drawn.append(path.name)

    def report(path: Path) -> None:
        path.write_text(solution_markdown(solution, drawn, scenario_text or ""), encoding="utf-8")

    figures = {f"{FIGURES}/{name}": partial(figure, draw=draw) for name, draw in known.items()}
    return failed + write_each(work, {**figures, REPORT_FILE: report})
