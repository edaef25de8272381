"""What a problem says of its own pictures, so that figures and exports need not guess from names.

Where a flight is in space is physics of a phase (`Phase.inertial`, `Phase.track`); here stand the words beside it, and
which quantities are worth a figure. A problem that states no views gets each state, control and costate against time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from string import Formatter

from perilune.words.outcome import unknown_name


@dataclass(frozen=True, kw_only=True)
class History:
    """A figure of quantities against time, one panel below the other.

    Parameters
    ----------
    name
        Of the figure's file.
    quantities
        Names of outputs, states or control components; one that a phase does not have is left out.
    caption
        One line, without a full stop.
    """

    name: str
    quantities: tuple[str, ...]
    caption: str = ""


@dataclass(frozen=True, kw_only=True)
class Beside:
    """A plainer flight of the same problem, drawn into the same figures: parameters held at values [SI]."""

    given: tuple[tuple[str, float], ...]
    label: str


@dataclass(frozen=True, kw_only=True)
class Views:
    """How a problem is looked at.

    Parameters
    ----------
    histories
        Figures against time, in order.
    height
        Name of the quantity that is the height above the body's radius; drawn from 0 or from a site below.
    radius
        Name of the parameter that is the body's radius [m].
    frame
        Axes and epoch of `Phase.inertial`, in words.
    label
        How a solution is called in a legend; ``{name:format}`` stands for the value of a result.
    beside
        What to draw with it, or None.
    peaks
        Names of outputs whose largest value along the flight is a result, ``peak_load``, with its time from the first
        ignition, ``peak_load_time``.
    floor
        What the fourth value of `Phase.track` is, the least height there [m]; "" where there is none.
    """

    histories: tuple[History, ...] = ()
    height: str = ""
    radius: str = ""
    frame: str = ""
    label: str = ""
    beside: Beside | None = None
    peaks: tuple[str, ...] = ()
    floor: str = ""


def check_views(views: Views, quantities: Iterable[str], parameters: Iterable[str], results: Iterable[str]) -> None:
    """Refuse names that are not there.

    Raises
    ------
    PeriluneError
        Named, with what is known.
    """
    fixed = views.beside.given if views.beside else ()
    asked = (
        ("quantity", [views.height, *views.peaks], quantities),
        ("parameter", [views.radius, *(name for name, _ in fixed)], parameters),
        ("result", [name for _, name, _, _ in Formatter().parse(views.label) if name], results),
    )
    for kind, names, known in asked:
        known = sorted(known)
        for name in names:
            if name and name not in known:
                raise unknown_name(kind, name, known)
