"""Common style of all figures; making and saving of figures.

One column wide (3.4 in) with 8 pt text, so that it is legible in a two-column paper; the colours are those of Okabe
and Ito (2008), distinct in every colour vision, and lines differ in dash as well. Figures are made by matplotlib's
object interface: no global state, no window, no display. `save_figure` writes PNG and SVG; equal figures give equal
bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from perilune.io import DRAWN_BY
from perilune.problem import Problem

COLUMN_WIDTH = 3.4  # inches
FLAT = 1e-3  # of the largest motion beside it: what moves by less is drawn as if it moved by so much
WIDEST = 54  # letters of a legend on one line, beside its stroke
BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE, GREY = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#6B6B6B",
)  # fmt: skip

STYLE: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.4,
    "axes.formatter.useoffset": False,
    "figure.constrained_layout.use": True,
    "mathtext.fontset": "dejavusans",
    "savefig.dpi": 200,
    "svg.hashsalt": "perilune",  # else the ids in an SVG are random and no two files are equal
}

# Of the flights that share a figure, in order.
LOOKS = ((BLUE, "-"), (VERMILION, "--"), (GREEN, ":"))


def time_text(problem: Problem) -> str:
    """Return the text of the axis of time, which counts from ignition unless the flight begins with a free fall."""
    return f"time from {'ignition' if problem.phases[0].controls else 'the start'} (s)"


def save_figure(figure: Figure, directory: Path, name: str) -> None:
    """Write ``name.png`` and ``name.svg``; equal figures give equal files.

    Both share the layout of the first, which takes two thirds of the time of drawing.

    Parameters
    ----------
    figure
        Figure of matplotlib.
    directory, name
        Where to write, and the name without its ending.
    """
    with matplotlib.rc_context(STYLE):
        FigureCanvasAgg(figure).print_figure(directory / f"{name}.png", metadata={"Software": None})
        engine = figure.get_layout_engine()
        with matplotlib.rc_context({"figure.constrained_layout.use": False}):
            figure.set_layout_engine(None)
        FigureCanvasSVG(figure).print_figure(directory / f"{name}.svg", metadata={"Date": None, "Creator": DRAWN_BY})
        figure.set_layout_engine(engine)


def new_figure(height: float = 2.3, rows: int = 1, cols: int = 1, width: float = COLUMN_WIDTH) -> tuple[Figure, Any]:
    """Make a figure of one column's width in the common style; returns also its axes (an array if several).

    Parameters
    ----------
    height, width
        Size [in].
    rows, cols
        Numbers of axes.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        return figure, figure.subplots(rows, cols, sharex=rows > 1 and cols == 1)


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Make a function draw in the common style, as ticks and legends take their sizes when they are made."""

    def drawn(*args: Any, **kwargs: Any) -> Figure:
        with matplotlib.rc_context(STYLE):
            return draw(*args, **kwargs)

    drawn.__doc__, drawn.__name__ = draw.__doc__, draw.__name__
    return drawn


def widen_vertical_range(axes: Any, least: float) -> None:
    """Widen the vertical range of axes about its middle to a least span, so that small changes look flat.

    Parameters
    ----------
    axes
        Axes of matplotlib.
    least
        Least span, in the unit of the axis.
    """
    low, high = axes.get_ylim()
    if high - low < least:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - 0.5 * least, middle + 0.5 * least)


def legend_above(figure: Figure, axes: Any, columns: int = 2) -> None:
    """Put the legend above the axes, where it hides no line, in rows no wider than the figure.

    Parameters
    ----------
    figure, axes
        Figure of matplotlib, and its axes with the labelled lines.
    columns
        Number of entries in a row.
    """
    handles, labels = axes.get_legend_handles_labels()
    labels = [fill(label, WIDEST) for label in labels]
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, handlelength=2.2)


@styled
def line_figure(
    curves: Iterable[tuple[Sequence[float], Sequence[float], str, str]],
    labels: tuple[str, str],
    marks: Sequence[tuple[float, float, str, tuple[float, float]]] = (),
    height: float = 2.3,
    from_zero: bool = False,
    log: bool = False,
) -> Figure:
    """Draw curves (x, y, style, name) and marked points (x, y, text, offset of the text in pt).

    Parameters
    ----------
    curves, marks
        Curves and marked points.
    labels
        Texts of the axes.
    height
        Of the figure [in].
    from_zero, log
        True for a vertical axis from zero, and for a logarithmic one.
    """
    figure, axes = new_figure(height)
    colours = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, GREY)
    named = 0
    for (x, y, dash, name), colour in zip(curves, colours, strict=False):
        axes.plot(x, y, dash, color=colour, label=name or "_", markersize=3)
        named += bool(name)
    for x, y, text, offset in marks:
        axes.plot(x, y, "o", color="black", markersize=3.5, zorder=5)
        axes.annotate(
            text, (x, y), offset, textcoords="offset points", ha="center", fontsize=7,
            arrowprops={"arrowstyle": "-", "linewidth": 0.5, "color": GREY, "shrinkB": 2},
        )  # fmt: skip
    axes.set(xlabel=labels[0], ylabel=labels[1])
    if from_zero:
        axes.set_xlim(left=0)
    if log:
        axes.set_yscale("log")
    elif from_zero:
        axes.set_ylim(bottom=0)
    if named:
        legend_above(figure, axes, columns=min(named, 3))
    return figure
