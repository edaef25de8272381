"""Figure of the minimum condition: the Hamiltonian along the flight, and its increase by other controls."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from perilune.core import Vector
from perilune.io import display_times, hamiltonian, hamiltonian_terms, per_unit, required_hamiltonian
from perilune.problem import Solution, directions
from perilune.report.style import BLUE, GREEN, VERMILION, new_figure, styled, time_text


@styled
def optimality_figure(solution: Solution) -> Figure:
    """Draw H along the flight, and the increase of H by turned thrusts, which must not be negative."""
    phases, begin = solution.problem.phases, 0.0
    per = per_unit(solution.problem.objective_unit, "s")
    planar = all(directions(phase.controls) == ((0, 2),) and len(phase.controls) == 1 for phase in phases)
    figure, axes = new_figure(height=3.6 if planar else 2.2, rows=2 if planar else 1)
    axes = np.atleast_1d(axes)
    worst = 0.0
    for k, trajectory in enumerate(solution.trajectories):
        # Without the ends, where coordinates may be singular (a start over the pole).
        t = display_times(trajectory)[1:-1]
        H = hamiltonian(solution, k, t)
        # Of a phase whose duration is given only the change along it is known to vanish.
        free = phases[k].duration in solution.problem.free_names
        required = required_hamiltonian(solution, k) if free else float(np.mean(H))
        largest = max(np.abs(term).max() for term in hamiltonian_terms(solution, k, t))
        error = np.abs(H - required) / (largest or 1.0)  # where nothing counts any more, as on a free fall, all is 0
        worst = max(worst, float(error.max()))
        # Zero has no place on a logarithmic axis; the floor is below the rounding of double precision.
        axes[0].semilogy(begin + t, np.maximum(error, 1e-17), ".", color=BLUE, markersize=1.5)
        if planar:
            _draw_turned_thrust(axes[1], solution, k, begin, t)
        begin += trajectory.duration
    axes[0].set_ylim(1e-17, max(1e-9, 10 * worst))
    required = required_hamiltonian(solution, 0)
    text = (f"|H{-required:+g}|" if required else "|H|") if len(phases) == 1 else r"|\Delta H|"
    axes[0].set_ylabel(rf"${text}\,/\,\max|\lambda_i \dot x_i|$")
    if planar:
        axes[1].set_ylabel(rf"$H(\beta+\delta)-H(\beta)$ ({per})")
        axes[1].legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=3, handlelength=2.0, columnspacing=1.0)
    axes[-1].set(xlabel=time_text(solution.problem), xlim=(0, begin))
    figure.align_ylabels()
    return figure


def _draw_turned_thrust(axes: Any, solution: Solution, k: int, begin: float, t: Vector) -> None:
    """Draw the increase of H by turned thrusts in the plane over phase k, which begins at time `begin` [s]."""
    H, (along, up) = hamiltonian(solution, k, t), solution.evaluate(k, t)[1]
    for degrees, colour, dash in ((180, VERMILION, "--"), (45, BLUE, "-"), (5, GREEN, "-.")):
        a = np.radians(degrees)
        turned = np.array([along * np.cos(a) - up * np.sin(a), along * np.sin(a) + up * np.cos(a)])
        text = "_" if k else f"turned by {degrees}°"
        axes.semilogy(begin + t, hamiltonian(solution, k, t, turned) - H, dash, color=colour, label=text)
