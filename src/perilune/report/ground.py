"""Ground track on a map: longitude to the right, latitude up, each degree alike.

The coasts of the Earth are those of Natural Earth at 1:110 million (``coastline.csv`` beside this file, public domain),
thinned to 0.1 degrees. Nothing is drawn across the map where a track leaves it at 180 degrees.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np
from matplotlib.figure import Figure

from perilune.core import Matrix, Vector
from perilune.io import display_times, phase_columns
from perilune.problem import Solution, views
from perilune.report.style import BLUE, GREEN, GREY, PURPLE, VERMILION, legend_above, new_figure, styled

WIDTH = 7.0  # inches
_COLOURS = (BLUE, VERMILION, GREEN, PURPLE)


@styled
def ground_track(solution: Solution, shown: views.Ground) -> Figure:
    """Draw the track of each phase over the whole map; a circle at its begin, a triangle at its end.

    Parameters
    ----------
    solution
        Solution with these outputs in some phase.
    shown
        Names of longitude and latitude, and whether to draw the coastlines.
    """
    figure, ax = new_figure(height=3.9, width=WIDTH)
    for line in coastline() if shown.coasts else ():
        ax.plot(*line.T, color=GREY, linewidth=0.5, label="_")
    tracks = []
    for k, trajectory in enumerate(solution.trajectories):
        table = phase_columns(solution, k, display_times(trajectory))
        if shown.longitude in table and shown.latitude in table:
            values = [table[name].values for name in (shown.longitude, shown.latitude)]
            tracks.append((solution.problem.phases[k].name.replace("_", " "), *values))
    for k, (name, longitude, latitude) in enumerate(tracks):
        ax.plot(*track_on_map(longitude, latitude), color=_COLOURS[k % len(_COLOURS)], label=name)
        ax.plot(wrap_longitude(longitude[0]), latitude[0], "ko", markersize=3, label="_")
    if tracks:
        _, longitude, latitude = tracks[-1]
        ax.plot(wrap_longitude(longitude[-1]), latitude[-1], "kv", markersize=5, label="_")
        legend_above(figure, ax, columns=4)
    ax.set(
        xlim=(-180, 180), ylim=(-90, 90), xlabel="longitude (deg)", ylabel="latitude (deg)",
        xticks=range(-180, 181, 60), yticks=range(-90, 91, 30), aspect="equal",
    )  # fmt: skip
    return figure


def wrap_longitude(longitude: Vector) -> Vector:
    """Wrap longitudes to -180 to 180 [deg]."""
    return (np.asarray(longitude) + 180.0) % 360.0 - 180.0


def track_on_map(longitude: Vector, latitude: Vector) -> tuple[Vector, Vector]:
    """Split a track [deg] at the edges of the map: it leaves at one side and continues at the other after a NaN.

    Parameters
    ----------
    longitude, latitude
        Points of the track, (n,).

    Returns
    -------
    tuple[Vector, Vector]
        Longitude from -180 to 180 deg, and latitude [deg], (n + 3 k,) with k crossings.
    """
    east = np.unwrap(longitude, period=360.0)
    turns = np.floor((east + 180.0) / 360.0)
    x, y = [], []
    for k in range(len(east)):
        if k and turns[k] != turns[k - 1]:
            forward = turns[k] > turns[k - 1]
            seam = 360.0 * max(turns[k], turns[k - 1]) - 180.0
            at = latitude[k - 1] + (latitude[k] - latitude[k - 1]) * (seam - east[k - 1]) / (east[k] - east[k - 1])
            x += [180.0, np.nan, -180.0] if forward else [-180.0, np.nan, 180.0]
            y += [at, np.nan, at]
        x.append(east[k] - 360.0 * turns[k])
        y.append(latitude[k])
    return np.array(x), np.array(y)


@cache
def coastline() -> tuple[Matrix, ...]:
    """Read the coasts of the Earth: lines of (longitude, latitude) [deg], shape (n, 2) each."""
    text = (files("perilune.report") / "coastline.csv").read_text(encoding="utf-8")
    rows = (row for row in text.splitlines() if not row.startswith("#"))
    return tuple(np.array([point.split(",") for point in row.split()], dtype=float) for row in rows)
