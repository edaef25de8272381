"""Every figure of a solution: the histories its problem states, its path in space, its costates and Hamiltonian."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from perilune.core import Outcome, one_line
from perilune.io import phase_columns
from perilune.problem import Problem, Solution, views
from perilune.report.corridor import corridor_figure
from perilune.report.ground import ground_track
from perilune.report.hamiltonian_figure import optimality_figure
from perilune.report.profile_view import path_over_limb
from perilune.report.side_and_top_view import track_figure
from perilune.report.style import VERMILION, WIDEST, save_figure
from perilune.report.time_histories import costate_figure, history_figure

__all__ = ["label", "save_figure", "solution_drawings", "solution_figures", "write_doubts"]


def solution_figures(solution: Solution, beside: Solution | None = None) -> dict[str, Figure]:
    """Draw every figure that the solution has data for; returns them by file name.

    Parameters
    ----------
    solution
        The flight to show.
    beside
        Another flight of the same problem, drawn with it.
    """
    return {name: draw() for name, draw in solution_drawings(solution, beside).items()}


def solution_drawings(solution: Solution, beside: Solution | None = None) -> dict[str, Callable[[], Figure]]:
    """Return the function that draws each of `solution_figures`, by name.

    Parameters
    ----------
    solution
        Solution to draw.
    beside
        Solution for comparison; None without one.
    """
    flights = {label(solution): solution}
    if beside is not None:  # of one label, as at values of which it says nothing, both are drawn
        called = label(beside)
        flights[f"{called}, the other" if called in flights else called] = beside
    first = solution.problem.phases[0]
    known = {name for k in range(len(solution.problem.phases)) for name in phase_columns(solution, k, np.zeros(1))}
    made: dict[str, Callable[[], Figure]] = {
        shown.name: partial(history_figure, flights, shown)
        for shown in solution.problem.views.histories or _generic_drawings(solution.problem)
        if known & set(shown.quantities)
    }
    views = solution.problem.views
    if views.ground is not None:
        made["ground_track"] = partial(ground_track, solution, views.ground)
    if views.corridor is not None:
        made["corridor"] = partial(corridor_figure, solution, views.corridor)
    if first.track is not None:
        made["track"] = partial(track_figure, flights)
    elif first.inertial is not None and solution.problem.views.radius:
        made["path"] = partial(path_over_limb, flights)
    if solution.trajectories[0].costate is not None:
        made["costates"] = partial(costate_figure, solution)
        made["hamiltonian"] = partial(optimality_figure, solution)
    return {name: partial(_with_doubts, draw, flights) for name, draw in made.items()}


def _with_doubts(draw: Callable[[], Figure], flights: Mapping[str, Solution]) -> Figure:
    figure = draw()
    write_doubts(figure, flights)
    return figure


def write_doubts(figure: Figure, flights: Mapping[str, Solution]) -> None:
    """Write the failed proof of each unproved flight below a figure, which may be seen without other files.

    Parameters
    ----------
    figure
        Figure of matplotlib.
    flights
        Solutions that it shows, by label.
    """
    doubts = {
        called: flight.verification.summary for called, flight in flights.items() if flight.outcome != Outcome.PROVED
    }
    said = [f"{called}: {told}" if len(flights) > 1 else told for called, told in doubts.items()]
    if said:
        figure.supxlabel(fill("; ".join(said), WIDEST), fontsize=6, color=VERMILION)


def label(solution: Solution) -> str:
    """Return the label of a flight in a legend."""
    views, p = solution.problem.views, solution.parameters
    if views.comparison and all(getattr(p, name) == value for name, value in views.comparison.given):
        return views.comparison.label
    values = {name: result.value for name, result in solution.results.items()}
    text = one_line(views.label.format(**values)) or solution.problem.heading
    return text.replace("$", r"\$")  # between two of them Matplotlib would read a formula


def _generic_drawings(problem: Problem) -> tuple[views.History, ...]:
    """Return a history of each state and each control, for a problem that states no figures."""
    both = {
        "states": [name for phase in problem.phases for name in phase.state_names],
        "controls": [name for phase in problem.phases for name in phase.control_names],
    }
    return tuple(
        views.History(name=name, quantities=tuple(dict.fromkeys(names))) for name, names in both.items() if names
    )
