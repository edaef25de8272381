"""Entry corridor: height against speed through the air, over lines of equal load and of equal heat rate.

The lines are found from the problem's own outputs, at states further out or in, and faster or slower, than the one at
which the air begins: so they are of the air and the vehicle that were flown, whatever these are.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from perilune.core import Matrix
from perilune.io import display_times, phase_columns
from perilune.problem import Solution, views
from perilune.report.style import BLUE, GREEN, VERMILION, legend_above, new_figure, styled
from perilune.report.time_histories import axis_text

_POINTS = 81
_LOOKS = ((VERMILION, "--"), (GREEN, ":"))
_LINES = 5  # of each quantity


@styled
def corridor_figure(solution: Solution, shown: views.Corridor) -> Figure:
    """Draw the path of each phase that has the quantities, and lines of round values of `shown.equal`.

    Parameters
    ----------
    solution
        Solution with these outputs in some phase.
    shown
        Names of height and speed, and of quantities with lines of equal value.
    """
    figure, ax = new_figure(height=3.0)
    for k, trajectory in enumerate(solution.trajectories):
        names = [v.name for v in solution.problem.phases[k].output_variables]
        if not {shown.height, shown.speed, *shown.equal} <= set(names):
            continue
        t = display_times(trajectory)
        table = phase_columns(solution, k, t)
        height, speed = table[shown.height].values / 1e3, table[shown.speed].values / 1e3
        ax.plot(speed, height, color=BLUE, label=solution.problem.phases[k].name.replace("_", " "))
        ax.plot(speed[-1], height[-1], "v", color=BLUE, markersize=4, clip_on=False)
        grid = _outputs_on_grid(solution, k, shown, height, speed)
        for number, (name, (colour, dash)) in enumerate(zip(shown.equal, _LOOKS, strict=False)):
            text, factor = axis_text(solution.problem, [table[name]])
            most = factor * float(table[name].values.max())
            if not (most > 0 and math.isfinite(most)):
                continue
            levels = [_round_down(most) * 2.0 ** (i - _LINES + 2) for i in range(_LINES)]
            drawn = ax.contour(
                grid[shown.speed] / 1e3, grid[shown.height] / 1e3, factor * grid[name], levels=levels, colors=colour,
                linestyles=dash, linewidths=0.8,
            )  # fmt: skip
            at = _labelled(grid, shown, factor * grid[name], levels, low=number > 0)
            ax.clabel(drawn, fmt="%.4g", fontsize=6, manual=at)
            ax.plot([], [], dash, color=colour, linewidth=0.8, label=text)
    ax.set(xlabel="speed (km/s)", ylabel="altitude (km)")
    ax.set_xlim(left=0)
    ax.set_ylim(bottom=0)
    legend_above(figure, ax, columns=3)
    return figure


def _outputs_on_grid(solution: Solution, k: int, shown: views.Corridor, height: Any, speed: Any) -> dict[str, Matrix]:
    """Evaluate outputs of phase k over its heights and speeds."""
    phase, trajectory = solution.problem.phases[k], solution.trajectories[k]
    x, u = solution.evaluate(k, np.array([0.5 * trajectory.duration]))
    state = {name: float(value[0]) for name, value in zip(phase.state_names, x, strict=True)}
    distance = math.hypot(*(state[name] for name in shown.position))
    quick = math.hypot(*(state[name] for name in shown.velocity))
    middle = phase_columns(solution, k, np.array([0.5 * trajectory.duration]))[shown.height].values[0] / 1e3
    fast, up = np.meshgrid(
        np.linspace(0.02, 1.05, _POINTS) * speed.max(), np.linspace(0.0, 1.05 * height.max(), _POINTS)
    )  # fmt: skip
    out, faster = 1 + 1e3 * (up - middle) / distance, 1e3 * fast / quick
    moved = [
        state[name] * (out if name in shown.position else faster if name in shown.velocity else 1.0)
        for name in phase.state_names
    ]
    values = phase.evaluate("outputs", moved, [float(value[0]) for value in u], solution.parameters)
    return {
        variable.name: np.broadcast_to(np.asarray(value, dtype=float), up.shape)
        for variable, value in zip(phase.output_variables, values, strict=True)
    }


def _labelled(
    grid: dict[str, Matrix], shown: views.Corridor, values: Matrix, levels: list[float], *, low: bool
) -> list[tuple[float, float]]:
    """Return the places of the labels of lines [km/s, km]: at high speed for one quantity, low for the other."""
    speed, height = grid[shown.speed] / 1e3, grid[shown.height] / 1e3
    k = round(0.05 * _POINTS) if low else round(0.55 * _POINTS)
    along, across, of = (speed[k], height[k], values[k]) if low else (speed[:, k], height[:, k], values[:, k])
    order = np.argsort(of)
    return [
        (float(np.interp(level, of[order], along[order])), float(np.interp(level, of[order], across[order])))
        for level in levels if of.min() < level < of.max()
    ]  # fmt: skip


def _round_down(value: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... that is not above a value."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value)
