"""Figures of a slice of an atlas: cost, free parameters, branches and refusals, nodes, errors."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import NullFormatter

from perilune.atlas import Axis, Slice
from perilune.core import PeriluneError, Vector
from perilune.io import display_unit, fresh_directory, refuse_unwritten, write_each
from perilune.report.contour_map import label_lines, move_labels_inside
from perilune.report.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, new_figure, save_figure, styled
from perilune.report.time_histories import LONG

_SHEETS = (BLUE, ORANGE, GREEN, SKY, PURPLE, VERMILION)
_NOTHING = ("#D0D0D0", "#8C8C8C", "#404040", "#F0E0E0", "#B8A8A8")  # by their reason
_EMPTY = "#ECECEC"  # where there is no answer, in all other figures
_FINEST = 1e-16  # what is less counts as zero
_SAME = 1e-9  # relative: by less a quantity does not change, it is rounded
_DOTS = 3000  # nodes that are drawn one by one


def atlas_maps(shown: Slice) -> dict[str, Figure]:
    """Draw every figure of a slice; returns them by file name.

    Returns
    -------
    dict
        ``objective``, ``free_NAME`` of each free parameter, ``sheets`` (with the reasons of what has no answer),
        ``nodes`` and ``errors``.

    Raises
    ------
    PeriluneError
        If no point of it has an answer.
    """
    return {name: draw() for name, draw in _map_drawings(shown).items()}


def _map_drawings(shown: Slice) -> dict[str, Callable[[], Figure]]:
    """Return the function that draws each figure, by its name."""
    if not shown.answers.good.any():
        raise PeriluneError(
            "there is nothing to draw", got="; ".join(f"{text}: {n} points" for text, n in shown.counts.items()),
            expected="a slice on which some points have an answer",
        )  # fmt: skip
    problem, answers = shown.problem, shown.answers
    best, sign = (problem.maximised, -1.0) if problem.maximised else ("J", 1.0)
    factor, text = _display_factor(best, problem.objective_unit, answers.objective)
    made = {"objective": partial(_draw_quantity_map, shown, sign * factor * answers.objective, text)}
    for name, values in answers.free.items():
        if name not in (axis.name for axis in shown.axes) and name not in shown.at:
            factor, text = _display_factor(name, problem.unit_of(name), values)
            made[f"free_{name}"] = partial(_draw_quantity_map, shown, factor * values, text)
    return {**made, **{name: partial(draw, shown) for name, draw in _OF_CELLS.items()}}


def write_maps(shown: Slice, directory: str | Path, force: bool = False) -> list[str]:
    """Write ``NAME.png`` and ``.svg`` of every figure of a slice.

    Parameters
    ----------
    shown
        As `perilune.atlas.sliced` gives it.
    directory, force
        As of `perilune.io.atomic_files.fresh_directory`.

    Returns
    -------
    list of str
        The names.

    Raises
    ------
    NotWrittenError
        If a figure cannot be drawn; the others are there then.
    """

    def writer(draw: Callable[[], Figure]) -> Callable[[Path], None]:
        return lambda path: save_figure(draw(), path.parent, path.name)

    writers = {name: writer(draw) for name, draw in _map_drawings(shown).items()}
    with fresh_directory(directory, force) as work:
        failed = write_each(work, writers)
    refuse_unwritten(failed)
    return list(writers)


def _display_factor(name: str, unit: str, values: Vector) -> tuple[float, str]:
    """Return the factor to the display unit of a quantity, and the text of its axis."""
    factor, unit = display_unit(unit)
    least, longer = LONG.get(unit, (math.inf, unit))
    if np.nanmax(np.abs(values), initial=0.0) >= least:
        factor, unit = 1e-3, longer
    return factor, f"{name.replace('_', ' ')} ({unit})".removesuffix(" (1)")


def _section_text(shown: Slice, name: str, value: float) -> str:
    factor, text = _display_factor(name, shown.problem.unit_of(name), np.array([value]))
    words, _, unit = text.partition(" (")
    return f"{words} {factor * value:.6g} {unit.removesuffix(')')}".rstrip()


def _axis_for_display(axis: Axis, values: Vector) -> tuple[Vector, str]:
    factor, text = _display_factor(axis.name, axis.unit, np.array([axis.low, axis.high]))
    return factor * values, text


def _panels(shown: Slice, count: int = 1) -> tuple[Figure, list[Any], list[Vector]]:
    """Make a figure of panels over the axes of a slice, one below the other; returns also the values along the axes."""
    plane = len(shown.axes) == 2
    figure, axes = new_figure((2.75 if plane else 2.3) if count == 1 else 0.5 + (2.1 if plane else 1.3) * count, count)
    panels, values = list(np.atleast_1d(axes)), list[Vector]()
    for number, (axis, rows) in enumerate(zip(shown.axes, shown.values, strict=True)):
        along, text = _axis_for_display(axis, rows)
        values.append(along)
        for panel in panels:
            panel.set_ylabel(text) if number else panel.set_xlim(along[0], along[-1])
            if number:
                panel.set_ylim(along[0], along[-1])
                panel.grid(False)
                panel.set_facecolor(_EMPTY)
        if not number:
            panels[-1].set_xlabel(text)
    held = ", ".join(_section_text(shown, name, value) for name, value in shown.at.items())
    if held:
        panels[0].set_title("\n".join(textwrap.wrap(held, 62)), fontsize=6.5, color=GREY, loc="left")
    return figure, panels, values


def _filled(shown: Slice, panel: Any, along: list[Vector], values: Vector, **settings: Any) -> Any:
    """Draw colours of values at all points of a slice over two axes; none where a value is NaN."""
    rows = np.ma.masked_invalid(values.reshape(shown.shape).T)
    return panel.pcolormesh(*along, rows, shading="nearest", rasterized=True, **settings)


def _shade_unanswered(shown: Slice, panel: Any, along: Vector) -> None:
    """Shade in grey the points along one axis without an answer."""
    half = 0.5 * (along[1] - along[0])
    for value in along[~shown.answers.good]:
        panel.axvspan(value - half, value + half, color=_EMPTY, linewidth=0)


@styled
def _draw_quantity_map(shown: Slice, values: Vector, text: str) -> Figure:
    """Draw one quantity: colours with lines of equal value over two axes, curves along one."""
    figure, (panel,), along = _panels(shown)
    known = values[np.isfinite(values)]
    if len(along) == 1:
        _shade_unanswered(shown, panel, along[0])
        for number, (label, colour) in enumerate(_sheet_labels(shown)):
            here = np.where(shown.answers.sheet == number, values, np.nan)
            if np.isfinite(here).any():
                panel.plot(along[0], here, color=colour, label=_wrap_label(label))
        panel.set_ylabel(text)
        _legend(figure, panel.get_legend_handles_labels()[0])
        return figure
    if len(known):
        same = np.ptp(known) <= _SAME * np.abs(known).max()
        span = {"vmin": known[0] - 1, "vmax": known[0] + 1} if same else {}
        drawn = _filled(shown, panel, along, values, cmap="viridis", **span)
        bar = figure.colorbar(drawn, ax=panel, pad=0.02)
        bar.set_label(text)
        bar.outline.set_linewidth(0.4)  # pyright: ignore[reportCallIssue]
        if not same:
            _draw_level_lines(shown, panel, along, values)
            move_labels_inside(figure, panel)
    return figure


def _draw_level_lines(shown: Slice, panel: Any, along: list[Vector], values: Vector) -> None:
    """Draw lines of equal value for each branch separately, as the value may jump between two."""
    known = values[np.isfinite(values)]
    levels, least = _round_levels(np.quantile(known, np.linspace(0.1, 0.9, 7))), _SAME * np.abs(known).max()
    for number in range(len(shown.sheets)):
        here = np.where(shown.answers.sheet == number, values, np.nan).reshape(shown.shape).T
        if np.isfinite(here[:-1, :-1] + here[1:, 1:]).any() and np.nanmax(here) - np.nanmin(here) > least:
            inside = levels[(levels > np.nanmin(here)) & (levels < np.nanmax(here))]
            if len(inside := np.unique(inside)):
                lines = panel.contour(
                    *along, np.ma.masked_invalid(here), inside, colors="white", linewidths=0.5, linestyles="-"
                )
                label_lines(panel, lines)


def _round_levels(levels: Vector) -> Vector:
    """Round levels to as few digits as keep them distinct, so that lines can be labelled."""
    step = np.min(np.diff(np.unique(levels)), initial=np.inf)
    if not 0 < step < np.inf:
        return levels
    digit = 10.0 ** math.floor(math.log10(0.5 * step))
    return np.unique(np.round(levels / digit) * digit)


def _sheet_labels(shown: Slice) -> list[tuple[str, str]]:
    """Return label and colour of each branch."""
    return [(label.replace("_", " "), _SHEETS[number % len(_SHEETS)]) for number, label in enumerate(shown.sheets)]


@styled
def _draw_sheet_map(shown: Slice) -> Figure:
    """Draw the branch of each answer, and the reason for points without one."""
    figure, (panel,), along = _panels(shown)
    count = len(shown.sheets)
    kinds = [
        *_sheet_labels(shown),
        *zip(shown.reasons, (_NOTHING * len(shown.reasons))[: len(shown.reasons)], strict=True),
    ]
    number = np.where(shown.answers.good, shown.answers.sheet, count + shown.reason_index)
    if len(along) == 2:
        colours = ListedColormap([colour for _, colour in kinds])
        _filled(shown, panel, along, number.astype(float), cmap=colours, vmin=-0.5, vmax=len(kinds) - 0.5)
    else:
        half = 0.5 * (along[0][1] - along[0][0])
        for value, kind in zip(along[0].tolist(), number.tolist(), strict=True):
            panel.axvspan(value - half, value + half, color=kinds[kind][1], linewidth=0)
        panel.set_yticks([])
        panel.grid(False)
    met = [kind for i, kind in enumerate(kinds) if (number == i).any()]
    _legend(figure, [Patch(color=colour, label=_wrap_label(label)) for label, colour in met])
    return figure


def _wrap_label(label: str) -> str:
    return "\n".join(textwrap.wrap(label.replace("$", r"\$"), 60, max_lines=3, placeholder=" ..."))


def _legend(figure: Figure, handles: list[Any]) -> None:
    if handles:
        figure.legend(handles=handles, loc="outside lower left", ncols=1, fontsize=6.5, handlelength=1.2)


@styled
def _draw_node_map(shown: Slice) -> Figure:
    """Draw the size of the answering cells, and the nodes at their corners where they are few."""
    figure, (panel,), along = _panels(shown)
    if len(along) == 1:
        _shade_unanswered(shown, panel, along[0])
        panel.semilogy(along[0], 100.0 * shown.size[:, 0], color=BLUE, drawstyle="steps-mid")
        panel.set_ylabel("cell (% of the range)")
        panel.yaxis.set_major_formatter("{x:g}")
        low, high = panel.get_ylim()
        panel.yaxis.set_minor_formatter("{x:g}" if high < 10.0 * low else NullFormatter())  # there is room for few
        return figure
    density = 1.0 / shown.size.prod(axis=1)
    if np.isfinite(density).any():
        low, high = np.nanmin(density), np.nanmax(density)
        drawn = _filled(shown, panel, along, density, cmap="cividis", norm=LogNorm(low / 1.5, high * 1.5))
        bar = figure.colorbar(drawn, ax=panel, pad=0.02, label="cells per region")
        bar.ax.yaxis.set_major_formatter("{x:g}")
        bar.ax.yaxis.set_minor_formatter(NullFormatter())
    if len(shown.nodes) <= _DOTS:
        rows = [_axis_for_display(axis, column)[0] for axis, column in zip(shown.axes, shown.nodes.T, strict=True)]
        panel.plot(*rows, "o", color="white", markersize=1.2, markeredgewidth=0, clip_on=False, label="nodes")
    return figure


@styled
def _draw_error_map(shown: Slice) -> Figure:
    """Draw the relative errors of what cells give, and the error bound after Newton's method."""
    errors = {
        "first guess, from the cell": shown.answers.guess_error,
        "polished: bound on the error": shown.answers.error_bound,
    }
    if len(shown.axes) == 1:
        figure, (panel,), along = _panels(shown)
        _shade_unanswered(shown, panel, along[0])
        for (text, values), colour in zip(errors.items(), (VERMILION, BLUE), strict=True):
            panel.semilogy(along[0], np.maximum(values, _FINEST), color=colour, label=text)
        panel.set_ylabel("relative error")
        _legend(figure, panel.get_legend_handles_labels()[0])
        return figure
    figure, panels, along = _panels(shown, len(errors))
    title = panels[0].get_title("left")
    for panel, (text, values) in zip(panels, errors.items(), strict=True):
        panel.set_title("\n".join(filter(None, (text, title))), fontsize=6.5, color=GREY, loc="left")
        title = ""
        values = np.maximum(values, _FINEST)
        if np.isfinite(values).any():
            least = 10.0 ** math.floor(math.log10(np.nanmin(values)))
            most = 10.0 ** math.ceil(math.log10(np.nanmax(values)))
            drawn = _filled(shown, panel, along, values, cmap="magma", norm=LogNorm(least, max(most, 10 * least)))
            figure.colorbar(drawn, ax=panel, pad=0.02, label="relative error")
    return figure


_OF_CELLS: dict[str, Callable[[Slice], Figure]] = {
    "sheets": _draw_sheet_map,
    "nodes": _draw_node_map,
    "errors": _draw_error_map,
}
