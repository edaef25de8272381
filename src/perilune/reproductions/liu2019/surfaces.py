"""Figs 7 to 15 of the paper: nine quantities over the region of manoeuvre points."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from perilune.report.style import new_figure, styled
from perilune.reproductions.liu2019.compute import Member, varies
from perilune.reproductions.liu2019.equations import NAMES
from perilune.words.types import Vector

_TEX = {"V": "V", "γ": r"\gamma", "ψ": r"\psi", "r": "r", "Θ": r"\Theta", "m": "m"}


def nine(members: Sequence[Member]) -> dict[str, Vector]:
    """Values over the points, by the text of the panel, in the order of the paper's figures."""
    costates = np.array([m.costates() for m in members])
    found = {rf"$\lambda_{{{tex}}}(t_0)$": costates[:, NAMES.index(name)] for name, tex in _TEX.items()}
    for text, name, factor in (
        ("$V_a$ (km/s)", "interface_speed", 1e-3), (r"$\gamma_a$ (°)", "interface_angle", math.degrees(1)),
        ("$t_a$ (s)", "transition_time", 1.0),
    ):  # fmt: skip
        found[text] = factor * np.array([m.value(name) for m in members])
    return found


@styled
def surfaces(members: Sequence[Member]) -> Figure:
    """Contours of each quantity between the points; one that does not vary is told in words."""
    figure, axes = new_figure(height=5.6, rows=3, cols=3, width=7.0)
    place = np.array([(m.longitude, m.latitude) for m in members])
    for number, (ax, (text, values)) in enumerate(zip(axes.flat, nine(members).items(), strict=True)):
        known = np.isfinite(values)
        if varies(values):
            if np.linalg.matrix_rank(place[known] - place[known][0]) == 2:
                shown = ax.tricontourf(*place[known].T, values[known], levels=9, cmap="cividis")
            else:  # points on a line have nothing between them
                shown = ax.scatter(*place[known].T, c=values[known], s=20, cmap="cividis")
            figure.colorbar(shown, ax=ax, format="%.5g")
            ax.plot(*place[known].T, "k.", markersize=1.5)
        elif known.any():
            ax.text(0.5, 0.5, f"{values[known][0]:.3f} throughout", transform=ax.transAxes, ha="center", fontsize=7)
        ax.grid(False)
        ax.update_datalim(place)  # one region in all panels, an empty one too
        ax.autoscale_view()
        ax.set_title(text, fontsize=8)
        ax.set(xlabel="longitude (°)" if number > 5 else "", ylabel="" if number % 3 else "latitude (°)")
    return figure
