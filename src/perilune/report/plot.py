"""One figure of a solution, by name."""

from __future__ import annotations

from matplotlib.figure import Figure

from perilune.core import require_type, unknown_name, wrong_type_error
from perilune.problem import Solution
from perilune.report.figures import solution_drawings

_FIRST = ("path", "track", "ground_track")  # the way in space, where there is one


def plot(solution: Solution, name: str = "") -> Figure:
    """Draw a figure of a solution.

    Parameters
    ----------
    solution
        What to show.
    name
        Of the figure, as ``perilune solve --out`` names its file; "" is the way in space, or the first there is.

    Returns
    -------
    Figure
        Of matplotlib, for a notebook to show and for ``savefig``; no window opens.

    Raises
    ------
    PeriluneError
        If there is no figure of that name; those that there are stand in it.
    """
    require_type(solution, Solution, "a solution to show")
    if not isinstance(name, str):
        raise wrong_type_error(name, "the name of a figure, as a text", "a figure to show")
    known = solution_drawings(solution)
    wanted = name or next((first for first in _FIRST if first in known), next(iter(known)))
    if wanted not in known:
        raise unknown_name("figure", name, list(known))
    return known[wanted]()
