"""Figs 7 to 15 of the paper, nine quantities over the manoeuvre points, and Figs 19 to 27: how well (16) fits them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.tri import TriAnalyzer, Triangulation

from perilune.core import Matrix, Vector
from perilune.report import markdown_table, new_figure, styled
from perilune_papers.liu2019.equations import NAMES
from perilune_papers.liu2019.members import ManoeuvreMember, is_variable, prediction_error

# Of Figs 19 to 27, in the order of `nine_quantities`: what the errors are less than, as printed, and the unit.
PRINTED_FITS = {
    "λ_V": (5e-4, ""), "λ_γ": (1.5e-4, ""), "λ_ψ": (1e-3, ""), "λ_r": (8e-3, ""), "λ_Θ": (1.5e-5, ""),
    "λ_m": (8e-5, ""), "V_a": (5e-8, "km/s"), "γ_a": (4e-5, "°"), "t_a": (5e-4, "s"),
}  # fmt: skip
_SLENDER = 0.1  # radius of the circle in a triangle over that of the one about it: 0.5 where its sides are equal
_TEX = {"V": "V", "γ": r"\gamma", "ψ": r"\psi", "r": "r", "Θ": r"\Theta", "m": "m"}


def nine_quantities(members: Sequence[ManoeuvreMember]) -> dict[str, Vector]:
    """Values over the points, by the text of the panel, in the order of the paper's figures."""
    costates = np.array([m.costates() for m in members])
    found = {rf"$\lambda_{{{tex}}}(t_0)$": costates[:, NAMES.index(name)] for name, tex in _TEX.items()}
    for text, name, factor in (
        ("$V_a$ (km/s)", "interface_speed", 1e-3), (r"$\gamma_a$ (°)", "interface_angle", math.degrees(1)),
        ("$t_a$ (s)", "transition_time", 1.0),
    ):  # fmt: skip
        found[text] = factor * np.array([m.value(name) for m in members])
    return found


def _triangles_between(place: Matrix) -> Triangulation:
    """Triangles between points, without the slivers along the edge: nothing is known between ends so far apart."""
    found = Triangulation(*place.T)
    flat = TriAnalyzer(found).get_flat_tri_mask(_SLENDER, rescale=False)
    if not flat.all():
        found.set_mask(flat)
    return found


def fit_errors(grid: Sequence[ManoeuvreMember], at: Sequence[ManoeuvreMember]) -> dict[str, Vector]:
    """Errors of (16) at the points `at`, each over the largest size of its quantity, by the text of the panel.

    Parameters
    ----------
    grid
        Members that the cubics are fitted to.
    at
        Members that they are compared with.
    """
    right = nine_quantities(at)
    return {text: prediction_error(grid, at, known, right[text]) for text, known in nine_quantities(grid).items()}


def fit_table(grid: Sequence[ManoeuvreMember], at: Sequence[ManoeuvreMember]) -> str:
    """Table of what the paper says of these errors and what they are, in the paper's units.

    Parameters
    ----------
    grid
        Members that the cubics are fitted to.
    at
        Members that they are compared with.

    Returns
    -------
    str
        A table in Markdown.
    """
    rows = []
    for (name, (printed, unit)), relative, known in zip(
        PRINTED_FITS.items(), fit_errors(grid, at).values(), nine_quantities(grid).values(), strict=True
    ):
        errors = relative[np.isfinite(relative)] * np.abs(known[np.isfinite(known)]).max(initial=0.0)
        cells = [f"{f(errors):.1e}" for f in (np.median, np.max)] if len(errors) else ["", ""]
        rows.append([name, f"{printed:.1e} {unit}".strip(), *cells])
    return markdown_table(["quantity", "printed, at most", "ours, median", "ours, at most"], rows)


@styled
def surfaces(members: Sequence[ManoeuvreMember]) -> Figure:
    """Contours of each quantity between the points; one that does not vary is given in words."""
    figure, axes = new_figure(height=5.6, rows=3, cols=3, width=7.0)
    place = np.array([(m.longitude, m.latitude) for m in members])
    for number, (ax, (text, values)) in enumerate(zip(axes.flat, nine_quantities(members).items(), strict=True)):
        known = np.isfinite(values)
        if is_variable(values):
            if np.linalg.matrix_rank(place[known] - place[known][0]) == 2:
                shown = ax.tricontourf(_triangles_between(place[known]), values[known], levels=9, cmap="cividis")
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
