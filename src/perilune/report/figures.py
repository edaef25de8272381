"""Figures of a landing as a reader of Cho et al. 2015 knows them: histories, costates, minimum condition.

Those of a descent in three dimensions are in `perilune.report.spatial`.

Every function returns a `matplotlib.figure.Figure` made by the object interface: no global state, no window,
no display. One column wide (3.4 in) with 8 pt text, so that it is legible in a two-column paper; the colours
are those of Okabe and Ito (2008), told apart by every colour vision, and lines differ in dash as well. `save`
writes PNG and SVG; the same figure gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from perilune.io.columns import Column, columns, flown_control, hamiltonian, hamiltonian_terms, required_hamiltonian
from perilune.problem.controls import directions
from perilune.problem.solution import Solution

COLUMN_WIDTH = 3.4  # inches
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

# name of the column: axis label, factor from the column's unit to the label's
HISTORIES = {
    "altitude": ("altitude (km)", 1e-3),
    "horizontal_velocity": ("horizontal velocity (m/s)", 1.0),
    "vertical_velocity": ("vertical velocity (m/s)", 1.0),
    "thrust_angle": ("thrust angle β (deg)", 1.0),
    "mass": ("mass (kg)", 1.0),
}
_PLANAR = ("horizontal_velocity", "vertical_velocity", "thrust_angle")
_COLUMN_OF = {"horizontal_velocity": "u", "vertical_velocity": "v", "mass": "m"}


def solution_figures(solution: Solution, ordinary: Solution | None = None) -> dict[str, Figure]:
    """Every figure that the solution has data for, by file name.

    Parameters
    ----------
    solution
        The landing to show.
    ordinary
        The landing without a retro burn, drawn with it.
    """
    flights = {label(solution): solution}
    if ordinary is not None:
        flights[label(ordinary)] = ordinary
    known = columns(solution)
    planar = "thrust_angle" in known  # elsewhere u, v and phi are other quantities
    names = HISTORIES if planar else [name for name in HISTORIES if name not in _PLANAR]
    made: dict[str, Figure] = {name: history(flights, name) for name in names if _COLUMN_OF.get(name, name) in known}
    if planar and {"r", "phi"} <= set(known) and hasattr(solution.parameters, "body_radius"):
        from perilune.report.limb import path_over_limb

        made["path"] = path_over_limb(flights)
    if not planar:
        from perilune.report.spatial import spatial_figures

        made |= spatial_figures(flights, known)
    if solution.trajectories[0].costate is not None:
        made["costates"] = costates(solution)
        made["hamiltonian"] = optimality(solution)
    return made


def label(solution: Solution) -> str:
    """How a landing is called in a legend."""
    delta_v = getattr(solution.parameters, "retro_delta_v", None)
    if delta_v is None:
        return solution.problem.title or solution.problem.name
    return f"hybrid, ΔV = {delta_v:.1f} m/s" if delta_v > 0 else "ordinary, no retro burn"


def save(figure: Figure, directory: Path, name: str) -> None:
    """Write ``name.png`` and ``name.svg``; equal figures give equal files."""
    with matplotlib.rc_context(STYLE):
        FigureCanvasAgg(figure).print_figure(directory / f"{name}.png", metadata={"Software": None})
        FigureCanvasSVG(figure).print_figure(directory / f"{name}.svg", metadata={"Date": None, "Creator": "perilune"})


def new_figure(height: float = 2.3, rows: int = 1, cols: int = 1, width: float = COLUMN_WIDTH) -> tuple[Figure, Any]:
    """Figure of one column's width in the house style, and its axes (an array if there are several)."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        return figure, figure.subplots(rows, cols, sharex=rows > 1 and cols == 1)


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Draw in the house style: ticks and legends take their sizes when they are made."""

    def drawn(*args: Any, **kwargs: Any) -> Figure:
        with matplotlib.rc_context(STYLE):
            return draw(*args, **kwargs)

    drawn.__doc__, drawn.__name__ = draw.__doc__, draw.__name__
    return drawn


def flight_columns(solution: Solution, name: str) -> list[tuple[np.ndarray, Column]]:
    """(time from the first ignition [s], column) for each phase that has the column, finely sampled."""
    found, begin = [], 0.0
    for k, trajectory in enumerate(solution.trajectories):
        t = np.linspace(0.0, trajectory.duration, 601)
        table = columns(solution, k, t)
        if name in table:
            found.append((begin + t, table[name]))
        begin += trajectory.duration
    return found


@styled
def history(flights: Mapping[str, Solution], name: str) -> Figure:
    """One quantity of `HISTORIES` against time for several flights, as Figs 2 and 4-7 of the paper."""
    text, factor = HISTORIES[name]
    figure, axes = new_figure()
    for (who, solution), colour, dash in zip(flights.items(), (BLUE, VERMILION, GREEN), ("-", "--", ":"), strict=False):
        for time, column in flight_columns(solution, _COLUMN_OF.get(name, name)):
            axes.plot(time, factor * column.values, dash, color=colour, label=who)
            who = "_"  # one entry in the legend for all phases of a flight
        axes.plot(time[-1], factor * column.values[-1], "o", color=colour, markersize=3, clip_on=False)
    axes.set(xlabel="time from ignition (s)", ylabel=text)
    axes.set_xlim(left=0)
    if name == "altitude":
        axes.set_ylim(bottom=0)
    legend_above(figure, axes)
    return figure


def legend_above(figure: Figure, axes: Any, columns: int = 2) -> None:
    """Legend over the axes, where it can hide no line."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=columns, handlelength=2.2)


@styled
def costates(solution: Solution) -> Figure:
    """Each costate of the first phase against time, with its unit."""
    t = np.linspace(0.0, solution.trajectories[0].duration, 601)
    found = [c for c in columns(solution, 0, t).values() if c.name.startswith("lambda_")]
    figure, axes = new_figure(height=0.5 + 0.95 * len(found), rows=len(found))
    for ax, column in zip(np.atleast_1d(axes), found, strict=True):
        ax.plot(t, column.values, color=BLUE)
        if np.ptp(column.values) == 0:
            centre = column.values[0]
            ax.set_ylim(centre - 1, centre + 1)
        ax.set_ylabel(_costate_symbol(column) + f"\n({column.unit})")
        ax.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
    figure.align_ylabels()
    np.atleast_1d(axes)[-1].set(xlabel="time from ignition (s)", xlim=(0, t[-1]))
    return figure


def _costate_symbol(column: Column) -> str:
    state = column.name.removeprefix("lambda_")
    return rf"$\lambda_{{\{state}}}$" if state in ("phi", "theta", "psi", "gamma") else rf"$\lambda_{{{state}}}$"


@styled
def optimality(solution: Solution) -> Figure:
    """H along the arc, and what turning the thrust adds to H, which must not be negative."""
    # Without the ends, where coordinates may be singular (a start over the pole).
    t = np.linspace(0.0, solution.trajectories[0].duration, 603)[1:-1]
    phase = solution.problem.phases[0]
    per = f"{solution.problem.objective_unit}/s"
    planar = directions(phase.controls) == ((0, 2),) and len(phase.controls) == 1
    figure, axes = new_figure(height=3.6 if planar else 2.2, rows=2 if planar else 1)
    axes = np.atleast_1d(axes)
    H, required = hamiltonian(solution, 0, t), required_hamiltonian(solution, 0)
    largest = max(np.abs(term).max() for term in hamiltonian_terms(solution, 0, t))
    # Zero has no place on a logarithmic axis; the floor is below the rounding of double precision.
    axes[0].semilogy(t, np.maximum(np.abs(H - required) / largest, 1e-17), ".", color=BLUE, markersize=1.5)
    axes[0].set_ylim(1e-17, max(1e-9, 10 * float(np.abs(H - required).max() / largest)))
    error = f"|H{-required:+g}|" if required else "|H|"
    axes[0].set_ylabel(rf"${error}\,/\,\max|\lambda_i \dot x_i|$")
    if planar:
        u = flown_control(phase, solution.trajectories[0], t)
        for degrees, colour, dash in ((180, VERMILION, "--"), (45, BLUE, "-"), (5, GREEN, "-.")):
            a = np.radians(degrees)
            turned = np.column_stack(
                [u[:, 0] * np.cos(a) - u[:, 1] * np.sin(a), u[:, 0] * np.sin(a) + u[:, 1] * np.cos(a)]
            )
            axes[1].semilogy(
                t, hamiltonian(solution, 0, t, turned) - H, dash, color=colour, label=f"turned by {degrees}°"
            )
        axes[1].set_ylabel(rf"$H(\beta+\delta)-H(\beta)$ ({per})")
        axes[1].legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=3, handlelength=2.0, columnspacing=1.0)
    axes[-1].set(xlabel="time from ignition (s)", xlim=(0, solution.trajectories[0].duration))
    figure.align_ylabels()
    return figure


@styled
def lines(
    curves: Iterable[tuple[Sequence[float], Sequence[float], str, str]],
    labels: tuple[str, str],
    marks: Sequence[tuple[float, float, str, tuple[float, float]]] = (),
    height: float = 2.3,
    from_zero: bool = False,
    log: bool = False,
) -> Figure:
    """Curves (x, y, style, name) and marked points (x, y, text, offset of the text in pt); y logarithmic with `log`."""
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


@styled
def family_panels(value: np.ndarray, results: Mapping[str, np.ndarray], parameter: str) -> Figure:
    """Panels of results (axis label: values, NaN where none) against a parameter, sharing its axis."""
    rows = max(len(results), 1)
    figure, axes = new_figure(height=0.6 + 1.15 * rows, rows=rows)
    axes = np.atleast_1d(axes)
    order = np.argsort(value)
    for ax, (text, y) in zip(axes, results.items(), strict=False):
        # The optimum may jump between two points: the line only guides the eye.
        ax.plot(value[order], y[order], "-", color=GREY, alpha=0.5, linewidth=0.6)
        ax.plot(value[order], y[order], "o", color=BLUE, markersize=2.5)
        for failed in value[~np.isfinite(y)]:
            ax.axvline(failed, color=VERMILION, linewidth=0.8, linestyle=":")
        ax.set_ylabel(text.replace(" (", "\n("))
    if any(not np.isfinite(y).all() for y in results.values()):
        axes[0].set_title("dotted: no solution", fontsize=7, color=VERMILION, loc="right")
    figure.align_ylabels()
    axes[-1].set_xlabel(parameter)
    return figure
