"""Figure of the path over the limb of the body: ground and flight, downrange to scale, height stretched.

A landing from 15 km covers some hundred kilometres of ground, so at true scale its height would be a hair's
width. The height above the ground is stretched by a round factor, which the picture names; angles at the
centre are true. The ground is the sphere of the body's radius, or, of a site in a depression, that of the lowest site.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from perilune.core import Matrix, Vector
from perilune.io import display_times
from perilune.problem import Solution
from perilune.report.style import GREY, LOOKS, new_figure, styled

WIDTH = 7.0  # inches: two columns, as the path is long and flat


@styled
def path_over_limb(flights: Mapping[str, Solution]) -> Figure:
    """Draw the path of each flight from ignition to touchdown, thrust shown by strokes along the exhaust."""
    first = next(iter(flights.values()))
    radius = getattr(first.parameters, first.problem.views.radius)
    plane = plane_of_flight(first)
    paths = {who: _angle_and_height(solution, plane, radius) for who, solution in flights.items()}
    begin = min(float(phi[0]) for phi, _ in paths.values())
    end = max(float(phi[-1]) for phi, _ in paths.values())
    ground_level = min(0.0, *(float(height.min()) for _, height in paths.values()))
    highest = max(float(height.max()) for _, height in paths.values()) - ground_level
    stretch = _round_factor(0.16 * radius * (end - begin) / highest)
    margin = max(0.07 * (end - begin), 0.2 * highest / radius)
    middle = 0.5 * (begin + end)

    def place(phi: Any, height: Any) -> tuple[Any, Any]:
        """Return kilometres right and up from the ground at the middle; flight is to the right."""
        r = radius + stretch * (np.asarray(height) - ground_level)
        return r * np.sin(phi - middle) / 1e3, (r * np.cos(phi - middle) - radius) / 1e3

    figure, axes = new_figure(height=2.2, width=WIDTH)
    round_it = end - begin + 2 * margin > np.pi  # too far for a limb: the whole body is seen
    if round_it:
        margin = np.pi - 0.5 * (end - begin)
    ground = place(np.linspace(begin - margin, end + margin, 300), np.full(300, ground_level))
    span = float(ground[0][-1] - ground[0][0])
    # Room for the scale bars under the top of the limb.
    floor = min(float(ground[1].min()) - 0.02 * span, -0.11 * span)
    if round_it:
        axes.fill(*ground, color="#C9C9C9", linewidth=0, zorder=2)
    else:
        axes.fill_between(*ground, floor, color="#C9C9C9", linewidth=0, zorder=2)
    axes.plot(*ground, color=GREY, linewidth=0.8, zorder=2)
    for (who, (phi, height)), (colour, dash) in zip(paths.items(), LOOKS, strict=False):
        axes.plot(*place(phi, height), dash, color=colour, label=who, zorder=3)
        axes.plot(*place(phi[-1], height[-1]), "v", color=colour, markersize=5, zorder=4)
        _thrust_strokes(axes, flights[who], plane, radius, place, colour, 0.035 * radius * (end - begin))
    x, y = place(phi[0], height[0])
    axes.plot(x, y, "ko", markersize=4, zorder=5)
    axes.annotate(
        "ignition",
        (x, y),
        (-6, 0),
        textcoords="offset points",
        ha="right",
        va="center",
        fontsize=7,
    )
    if round_it:
        centre = (0.0, float(ground[1].mean()))
        axes.annotate(f"height × {stretch:g}", centre, ha="center", va="center", fontsize=7, zorder=3)
    else:
        _scale_bars(axes, stretch, floor, span)
    axes.set_aspect("equal")
    axes.set_axis_off()
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def plane_of_flight(solution: Solution) -> Matrix:
    """Return unit vectors, as rows: up at ignition, and ahead along the horizon there, in the inertial axes."""
    position, velocity, _ = (vector[:, 0] for vector in solution.inertial(0, np.zeros(1)))
    up = position / np.linalg.norm(position)
    ahead = velocity - (velocity @ up) * up
    if not np.linalg.norm(ahead) > 1e-9 * np.linalg.norm(velocity):  # straight down: any direction will do
        ahead = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    return np.array([up, ahead / np.linalg.norm(ahead)])


def _angle_and_height(solution: Solution, plane: Matrix, radius: float) -> tuple[Vector, Vector]:
    """Return angle from ignition [rad] and height above the body's radius [m] along the flight."""
    times = map(display_times, solution.trajectories)
    r = np.concatenate([solution.inertial(k, t)[0] for k, t in enumerate(times)], axis=1)
    above, ahead = plane @ r
    return np.unwrap(np.arctan2(ahead, above)), np.linalg.norm(r, axis=0) - radius


def _round_factor(value: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... that is not above the value."""
    if value < 1:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value))


def _thrust_strokes(
    axes: Any, solution: Solution, plane: Matrix, radius: float, place: Any, colour: str, length: float
) -> None:
    """Draw strokes from the path along the exhaust, opposite the thrust, at equal times; none with the engine off."""
    whole = solution.duration
    for k, trajectory in enumerate(solution.trajectories):
        t = np.linspace(0.02, 0.98, max(2, round(12 * trajectory.duration / whole))) * trajectory.duration
        r, _, push = solution.inertial(k, t)
        (above, ahead), thrust = plane @ r, plane @ push
        angles, heights = np.arctan2(ahead, above), np.linalg.norm(r, axis=0) - radius
        for angle, h, (out, on), strength in zip(angles, heights, thrust.T, np.linalg.norm(push, axis=0), strict=True):
            if not strength > 0:
                continue
            cosine, sine = np.cos(angle), np.sin(angle)
            radial, transverse = (out * cosine + on * sine) / strength, (on * cosine - out * sine) / strength
            x, y = place(angle, h)
            across, rise = place(angle + 1e-4, h)[0] - x, place(angle + 1e-4, h)[1] - y
            east = np.array([across, rise]) / np.hypot(across, rise)
            north = np.array([-east[1], east[0]])
            stroke = -(transverse * east + radial * north) * length / 1e3
            axes.plot([x, x + stroke[0]], [y, y + stroke[1]], color=colour, linewidth=0.6, alpha=0.7, zorder=1)


def _scale_bars(axes: Any, stretch: float, floor: float, span: float) -> None:
    """Draw a bar along the ground and one up, inside the body, each with its length in true kilometres."""
    along, up = _round_factor(span / 8), _round_factor(0.07 * span / stretch)
    x0, y0 = -0.12 * span, floor + 0.02 * span
    axes.plot([x0, x0, x0 + along], [y0 + up * stretch, y0, y0], color="black", linewidth=1, zorder=3)
    axes.annotate(
        f"{along:g} km",
        (x0 + along, y0),
        (4, 0),
        textcoords="offset points",
        va="center",
        fontsize=7,
        zorder=3,
    )
    axes.annotate(
        f"{up:g} km" + (f"  (height × {stretch:g})" if stretch > 1 else ""),
        (x0, y0 + up * stretch / 2), (4, 2), textcoords="offset points", va="center", fontsize=7, zorder=3,
    )  # fmt: skip
