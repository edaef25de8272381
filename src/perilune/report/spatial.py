"""Figures of a descent in three dimensions: the path from the side and from above, velocities, steering.

The path is drawn along and across its first direction, which no pole disturbs: over the ground *downrange* is the
arc along the great circle of the start's heading, *cross-range* the arc to the left of it; beside a landing site both
are counted on the line from the start to the site. Heights are above the body's radius, or above the site.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from perilune.models.rotating import dot, heading_axes, local_axes
from perilune.problem.solution import Solution
from perilune.report.figures import BLUE, GREEN, GREY, VERMILION, flight_columns, legend_above, new_figure, styled
from perilune.words.maths import NUMERIC
from perilune.words.types import Vector

# File name of a figure: column and axis label of each panel that a problem may have.
PANELS = {
    "velocities": {
        "forward_speed": "forward u (m/s)",
        "sideways_speed": "left v (m/s)",
        "vertical_speed": "up w (m/s)",
        "v_east": "east (m/s)",
        "v_north": "north (m/s)",
        "v_up": "up (m/s)",
    },
    "steering": {
        "thrust_elevation": "elevation α (deg)",
        "thrust_azimuth": "azimuth β (deg)",
        "thrust_tilt": "tilt (deg)",
        "throttle": "throttle",
    },
}
_LOOKS = ((BLUE, "-"), (VERMILION, "--"), (GREEN, ":"))


def spatial_figures(flights: Mapping[str, Solution], known: Mapping[str, Any]) -> dict[str, Figure]:
    """Every figure that a descent with the columns `known` has data for, by file name."""
    made = {"track": track(flights)} if {"latitude", "altitude"} <= set(known) or "v_up" in known else {}
    for figure, texts in PANELS.items():
        shown = {name: text for name, text in texts.items() if name in known}
        if shown:
            made[figure] = panels(flights, shown)
    return made


@styled
def panels(flights: Mapping[str, Solution], texts: Mapping[str, str]) -> Figure:
    """One panel for each column against time, several flights in each."""
    figure, axes = new_figure(height=0.55 + 1.05 * len(texts), rows=len(texts))
    axes = np.atleast_1d(axes)
    for ax, (name, text) in zip(axes, texts.items(), strict=True):
        for (who, solution), (colour, dash) in zip(flights.items(), _LOOKS, strict=False):
            for time, column in flight_columns(solution, name):
                ax.plot(time, column.values, dash, color=colour, label=who)
                who = "_"  # one entry in the legend for all phases of a flight
        ax.set_ylabel(text.replace(" (", "\n("))
    axes[-1].set_xlabel("time from ignition (s)")
    axes[-1].set_xlim(left=0)
    figure.align_ylabels()
    legend_above(figure, axes[0])
    return figure


@styled
def track(flights: Mapping[str, Solution]) -> Figure:
    """Height and cross-range over downrange: the path from the side and from above."""
    figure, (side, top) = new_figure(height=3.2, rows=2)
    for (who, solution), (colour, dash) in zip(flights.items(), _LOOKS, strict=False):
        along, across, height = (v / 1e3 for v in path(solution))
        side.plot(along, height, dash, color=colour, label=who)
        top.plot(along, across, dash, color=colour)
        for ax, y in ((side, height), (top, across)):
            ax.plot(along[-1], y[-1], "v", color=colour, markersize=4, clip_on=False)
            ax.plot(along[0], y[0], "o", color="black", markersize=3, clip_on=False, zorder=5)
    slope = _glide_slope(next(iter(flights.values())))
    if slope is not None:
        side.plot(*slope, "-.", color=GREY, linewidth=0.9, label="glide slope")
    side.set(ylabel="height (km)")
    side.set_ylim(bottom=min(0.0, side.get_ylim()[0]))
    top.set(xlabel="downrange (km)", ylabel="cross-range,\nleft (km)")
    figure.align_ylabels()
    legend_above(figure, side, columns=2 if slope is None else 1)
    return figure


def path(solution: Solution) -> tuple[Vector, Vector, Vector]:
    """Downrange, cross-range and height [m] along the flight."""

    def column(name: str) -> Vector:
        return np.concatenate([c.values for _, c in flight_columns(solution, name)])

    p = solution.parameters
    if hasattr(p, "approach_east"):
        forward, left = _line_to_site(p)
        east, north = column("east"), column("north")
        return forward[0] * east + forward[1] * north, left[0] * east + left[1] * north, column("up")
    up, oy, oz = heading_axes(p.start_longitude, p.start_latitude, p.start_heading, NUMERIC)
    above = local_axes(np.radians(column("longitude")), np.radians(column("latitude")), NUMERIC)[0]
    along = p.body_radius * np.arctan2(dot(above, oy), dot(above, up))
    return along, p.body_radius * np.arcsin(dot(above, oz)), column("altitude")


def _line_to_site(p: Any) -> tuple[Sequence[float], Sequence[float]]:
    """Unit vectors (east, north) from the start to the site, and to the left of that."""
    away = np.hypot(p.approach_east, p.approach_north)
    east, north = (-p.approach_east / away, -p.approach_north / away) if away > 0 else (1.0, 0.0)
    return (east, north), (-north, east)


def _glide_slope(solution: Solution) -> tuple[Vector, Vector] | None:
    """Least height [km] over downrange [km] that the corridor allows on the line to the site."""
    p = solution.parameters
    if not hasattr(p, "corridor_slope"):
        return None
    along = np.linspace(-np.hypot(p.approach_east, p.approach_north), 0.0, 200)
    a = p.corridor_pad_radius
    return along / 1e3, np.tan(p.corridor_slope) * (np.sqrt(along**2 + a**2) - a) / 1e3
