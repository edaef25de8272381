"""The minimum condition as a figure: the Hamiltonian along the flight, and what another control would add to it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from perilune.io.columns import hamiltonian, hamiltonian_terms, required_hamiltonian
from perilune.problem.controls import directions
from perilune.problem.solution import Solution
from perilune.report.style import BLUE, GREEN, TIME, VERMILION, new_figure, styled


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
        along, up = solution.flown(0, t)[1]
        for degrees, colour, dash in ((180, VERMILION, "--"), (45, BLUE, "-"), (5, GREEN, "-.")):
            a = np.radians(degrees)
            turned = np.array([along * np.cos(a) - up * np.sin(a), along * np.sin(a) + up * np.cos(a)])
            axes[1].semilogy(
                t, hamiltonian(solution, 0, t, turned) - H, dash, color=colour, label=f"turned by {degrees}°"
            )
        axes[1].set_ylabel(rf"$H(\beta+\delta)-H(\beta)$ ({per})")
        axes[1].legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=3, handlelength=2.0, columnspacing=1.0)
    axes[-1].set(xlabel=TIME, xlim=(0, solution.trajectories[0].duration))
    figure.align_ylabels()
    return figure
