"""Problems, solutions and proofs in a notebook: a few lines of HTML with a picture inside, no network.

Names may be those of a stranger's file, so every text is escaped, and the picture is an image that runs nothing.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape

import matplotlib
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from perilune.core import format_quantity
from perilune.problem import Problem, Solution, Verification
from perilune.report.plot import plot
from perilune.report.style import STYLE
from perilune.report.summary import readable_result

_MOST = 12  # rows of a table


def solution_page(solution: Solution) -> str:
    """Return HTML of outcome, proof and results next to a figure of the path."""
    rows = [tuple(readable_result(name, result)) for name, result in solution.results.items()]
    head = f"{solution.problem.heading}: {solution.outcome.name}, {solution.verification.title}"
    drawn = _svg_image(plot(solution), f"the flight of {solution.problem.heading}")
    return f"<div><b>{escape(head)}</b>{drawn}{_html_table(('result', 'value', 'unit'), rows)}</div>"


def problem_page(problem: Problem) -> str:
    """Return HTML of the phases, the given and the free parameters."""
    phases = [
        (phase.name, ", ".join(phase.state_names), ", ".join(phase.control_names) or "none") for phase in problem.phases
    ]
    given = [(name, format_quantity(g.value, g.unit), "") for name, g in problem.given.items()]
    free = [
        (f.name, f"{format_quantity(f.lower, f.unit)} to {format_quantity(f.upper, f.unit)}", "free")
        for f in problem.free
    ]
    return (
        f"<div><b>{escape(problem.heading)}</b>, J in {escape(problem.objective_unit)}, minimised"
        f"{_html_table(('phase', 'states', 'controls'), phases)}"
        f"{_html_table(('parameter', 'value', ''), [*free, *given])}</div>"
    )


def verification_page(verification: Verification) -> str:
    """Return HTML of each check with its value and limit, failed ones first."""
    checks = sorted(verification.checks, key=lambda check: check.passed)
    rows = [
        ("ok" if c.passed else "FAILED", c.name, str(c.level), format_quantity(c.value, c.unit), c.format_limit())
        for c in checks
    ]
    return (
        f"<div><b>{escape(verification.title)}</b>{_html_table(('', 'check', 'level', 'value', 'limit'), rows)}</div>"
    )


def _html_table(heads: Sequence[str], rows: Sequence[Iterable[str]]) -> str:
    if not rows:
        return ""
    cells = "".join(f"<th style='text-align:left'>{escape(head)}</th>" for head in heads)
    lines = [
        "<tr>" + "".join(f"<td style='text-align:left'>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    ]
    shown, more = lines[:_MOST], lines[_MOST:]
    rest = f"<details><summary>{len(more)} more</summary><table>{''.join(more)}</table></details>" if more else ""
    return f"<table><tr>{cells}</tr>{''.join(shown)}</table>{rest}"


def _svg_image(figure: Figure, text: str) -> str:
    drawn = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        FigureCanvasSVG(figure).print_figure(drawn, metadata={"Date": None})
    data = base64.b64encode(drawn.getvalue()).decode()
    return f'<br><img alt="{escape(text)}" style="max-width:32em;width:100%" src="data:image/svg+xml;base64,{data}">'
