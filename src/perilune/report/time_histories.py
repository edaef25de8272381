"""Time histories, figures that every problem has: quantities against time, and families against a parameter.

Axis texts come from the problem's variables: their `label`, or their name, and the unit in which a reader expects them
(angles in degrees, long ways in kilometres).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from perilune.io import Column, flight_columns
from perilune.problem import Problem, Solution, views
from perilune.report.style import (
    BLUE,
    FLAT,
    GREY,
    LOOKS,
    VERMILION,
    legend_above,
    new_figure,
    styled,
    time_text,
    widen_vertical_range,
)

# From these values on, a quantity is told in units of a thousand.
LONG = {"m": (2000.0, "km"), "Pa": (2000.0, "kPa"), "W/m^2": (2000.0, "kW/m^2")}
GREEK = ("alpha", "beta", "gamma", "phi", "psi", "theta")


@styled
def history_figure(flights: Mapping[str, Solution], shown: views.History) -> Figure:
    """Draw each quantity of a `History` in its panel against time, several flights in each.

    Parameters
    ----------
    flights
        Solutions of one problem, by label.
    shown
        Names of the quantities.
    """
    problem = next(iter(flights.values())).problem
    sampled = {
        name: {who: flight_columns(solution, name) for who, solution in flights.items()} for name in shown.quantities
    }
    sampled = {name: parts for name, parts in sampled.items() if any(parts.values())}
    rows = len(sampled)
    figure, axes = new_figure(height=2.3 if rows == 1 else 0.55 + 1.05 * rows, rows=rows)
    axes, spans = np.atleast_1d(axes), _largest_changes(sampled)
    for ax, (name, flown) in zip(axes, sampled.items(), strict=True):
        text, factor = axis_text(problem, [column for parts in flown.values() for _, column in parts])
        for (who, parts), (colour, dash) in zip(flown.items(), LOOKS, strict=False):
            for time, column in parts:
                ax.plot(time, factor * column.values, dash, color=colour, label=who)
                who = "_"  # one entry in the legend for all phases of a flight
            if rows == 1 and parts:
                time, column = parts[-1]
                ax.plot(time[-1], factor * column.values[-1], "o", color=colour, markersize=3, clip_on=False)
        ax.set_ylabel(text if rows == 1 else text.replace(" (", "\n("))
        widen_vertical_range(ax, factor * FLAT * spans[name])
        if name == problem.views.height:  # from the ground: 0, or a site below it
            lowest = min(float(column.values.min()) for parts in flown.values() for _, column in parts)
            ax.set_ylim(bottom=min(0.0, factor * lowest))
    times = [time for flown in sampled.values() for parts in flown.values() for time, _ in parts]
    # What is there in some phases alone is shown for them.
    begin, last = (float(pick([time[at] for time in times], default=0.0)) for pick, at in ((min, 0), (max, -1)))
    if len(flights) == 1:
        mark_phases(axes, next(iter(flights.values())), begin, last)
    axes[-1].set_xlabel(time_text(problem))
    axes[-1].set_xlim(left=begin)
    figure.align_ylabels()
    legend_above(figure, axes[0])
    return figure


def _largest_changes(sampled: Mapping[str, Mapping[str, list[tuple[Any, Column]]]]) -> dict[str, float]:
    """Return for each quantity the largest change, along the flights, of any quantity of the same unit."""
    changes: dict[str, tuple[str, float]] = {}
    for name, flown in sampled.items():
        columns = [column for parts in flown.values() for _, column in parts]
        known = np.concatenate([column.values[np.isfinite(column.values)] for column in columns])
        changes[name] = columns[0].unit, float(np.ptp(known)) if len(known) else 0.0
    return {name: max(span for other, span in changes.values() if other == unit) for name, (unit, _) in changes.items()}


def mark_phases(axes: Any, solution: Solution, begin: float, last: float) -> None:
    """Draw dotted lines in all panels between phases, within a range of times, and the names of long phases.

    Parameters
    ----------
    axes
        Panels over time.
    solution
        The flight.
    begin, last
        Range of times [s] from the begin of the flight.
    """
    ends = np.cumsum([0.0, *(trajectory.duration for trajectory in solution.trajectories)])
    if len(ends) < 3:
        return
    for ax in axes:
        for end in ends[1:-1][(ends[1:-1] > begin) & (ends[1:-1] < last)]:
            ax.axvline(end, color=GREY, linewidth=0.6, linestyle=":")
    for k, phase in enumerate(solution.problem.phases):
        if begin <= ends[k] < last and (ends[k + 1] - ends[k] > 0.12 * ends[-1] or k == len(ends) - 2):
            axes[0].annotate(
                phase.name.replace("_", " "), (0.5 * (ends[k] + ends[k + 1]), 1.0), (0, 1),
                xycoords=axes[0].get_xaxis_transform(), textcoords="offset points", ha="center", va="bottom",
                fontsize=6, color=GREY,
            )  # fmt: skip


def axis_text(problem: Problem, shown: list[Column]) -> tuple[str, float]:
    """Return the text of an axis for columns of one name, and the factor from their unit to that of the text.

    Parameters
    ----------
    problem
        Problem whose variables may have labels.
    shown
        Columns of one name and unit, of which the largest value chooses the unit.
    """
    name, unit, factor = shown[0].name, shown[0].unit, 1.0
    least, longer = LONG.get(unit, (math.inf, unit))
    if max(float(np.abs(column.values).max()) for column in shown) >= least:
        unit, factor = longer, 1e-3
    labels = {v.name: v.label for phase in problem.phases for v in (*phase.states, *phase.output_variables)}
    text = labels.get(name) or name.replace("_", " ")
    return f"{text} ({unit})".removesuffix(" (1)"), factor


@styled
def costate_figure(solution: Solution) -> Figure:
    """Draw each costate against time, with its unit."""
    states = dict.fromkeys(name for phase in solution.problem.phases for name in phase.state_names)
    found = [flight_columns(solution, f"lambda_{name}") for name in states]
    figure, axes = new_figure(height=0.5 + 0.95 * len(found), rows=len(found))
    axes = np.atleast_1d(axes)
    for ax, parts in zip(axes, found, strict=True):
        for time, column in parts:
            ax.plot(time, column.values, color=BLUE)
        values = np.concatenate([column.values for _, column in parts])
        if np.ptp(values) <= 1e-9 * np.abs(values).max():  # constant: not the noise of its last digits
            room = abs(values[0]) or 1.0
            ax.set_ylim(values[0] - room, values[0] + room)
        ax.set_ylabel(_costate_symbol(parts[0][1]) + f"\n({parts[0][1].unit})")
        ax.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
    figure.align_ylabels()
    axes[-1].set(xlabel=time_text(solution.problem), xlim=(0, solution.duration))
    return figure


def _costate_symbol(column: Column) -> str:
    parts = column.name.removeprefix("lambda_").split("_")
    letters = (rf"\{p}" if p in GREEK else p if len(p) == 1 else rf"\mathrm{{{p}}}" for p in parts)
    return rf"$\lambda_{{{','.join(letters)}}}$"


@styled
def family_panels(value: np.ndarray, results: Mapping[str, np.ndarray], parameter: str, doubted: np.ndarray) -> Figure:
    """Draw panels of results against a parameter, sharing its axis.

    Parameters
    ----------
    value
        Values of the parameter, shape (n,).
    results
        Values of each result by the text of its axis, shape (n,), NaN for none.
    parameter
        Text of the parameter's axis.
    doubted
        True for points that failed their proof, shape (n,).
    """
    rows = max(len(results), 1)
    figure, axes = new_figure(height=0.6 + 1.15 * rows, rows=rows)
    axes = np.atleast_1d(axes)
    order = np.argsort(value)
    for ax, (text, y) in zip(axes, results.items(), strict=False):
        # The optimum may jump between two points: the line only guides the eye.
        ax.plot(value[order], y[order], "-", color=GREY, alpha=0.5, linewidth=0.6)
        ax.plot(value[~doubted], y[~doubted], "o", color=BLUE, markersize=2.5)
        ax.plot(value[doubted], y[doubted], "o", color=VERMILION, markersize=2.5, markerfacecolor="none")
        for failed in value[~np.isfinite(y)]:
            ax.axvline(failed, color=VERMILION, linewidth=0.8, linestyle=":")
        ax.set_ylabel(text.replace(" (", "\n("))
    missing = any(not np.isfinite(y).all() for y in results.values())
    said = [*(["hollow: NOT_PROVED"] if doubted.any() else []), *(["dotted: no solution"] if missing else [])]
    axes[0].set_title(", ".join(said), fontsize=7, color=VERMILION, loc="right")
    figure.align_ylabels()
    axes[-1].set_xlabel(parameter)
    return figure
