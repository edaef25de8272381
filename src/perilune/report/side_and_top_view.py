"""Side and top view of a descent, along and across the direction that its problem states."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from perilune.core import Matrix, Vector
from perilune.io import display_times
from perilune.problem import Solution, full
from perilune.report.style import FLAT, GREY, LOOKS, legend_above, new_figure, styled, widen_vertical_range


@styled
def track_figure(flights: Mapping[str, Solution]) -> Figure:
    """Draw height and cross-range over downrange: the path from the side and from above."""
    figure, (side, top) = new_figure(height=3.2, rows=2)
    ways = {who: track_path(solution)[1] / 1e3 for who, solution in flights.items()}
    for (who, (along, across, height, *_)), (colour, dash) in zip(ways.items(), LOOKS, strict=False):
        side.plot(along, height, dash, color=colour, label=who)
        top.plot(along, across, dash, color=colour)
        for ax, y in ((side, height), (top, across)):
            ax.plot(along[-1], y[-1], "v", color=colour, markersize=4, clip_on=False)
            ax.plot(along[0], y[0], "o", color="black", markersize=3, clip_on=False, zorder=5)
    along, _, _, *floor = next(iter(ways.values()))
    text = next(iter(flights.values())).problem.views.floor
    for least in floor:
        side.plot(along, least, "-.", color=GREY, linewidth=0.9, label=text)
    spans = [np.ptp(way[:3], axis=1).max() for way in ways.values()]
    for ax in (side, top):
        widen_vertical_range(ax, FLAT * float(max(spans)))
    side.set(ylabel="height (km)")
    side.set_ylim(bottom=min(0.0, side.get_ylim()[0]))
    top.set(xlabel="downrange (km)", ylabel="cross-range,\nleft (km)")
    figure.align_ylabels()
    legend_above(figure, side, columns=1 if floor else 2)
    return figure


def track_path(solution: Solution) -> tuple[Vector, Matrix]:
    """Return times from the begin of the flight [s], (n,), and values of `Phase.track` there [m], (3 or 4, n)."""
    times, parts, begin = [], [], 0.0
    for k, (phase, trajectory) in enumerate(zip(solution.problem.phases, solution.trajectories, strict=True)):
        t = display_times(trajectory)
        x, u = solution.evaluate(k, t)
        times.append(begin + t)
        parts.append(np.array([full(value, t) for value in phase.evaluate("track", x, u, solution.parameters)]))
        begin += trajectory.duration
    return np.concatenate(times), np.concatenate(parts, axis=1)
