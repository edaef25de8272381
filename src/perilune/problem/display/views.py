"""Views of a problem: the figures, tables and titles it asks for, so that nothing is guessed from names.

The position of a flight in space is physics of a phase (`Phase.inertial`, `Phase.track`); a view adds its description
and the quantities that are worth a figure. A problem without views gets each state, control and costate against time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from string import Formatter
from typing import Any, ClassVar

from perilune.core import (
    RenamedAttribute,
    check_call,
    instant,
    public_names,
    renamed_keywords,
    renamed_names,
    require_row,
    require_si_number,
    require_type,
    unknown_name,
)

__all__ = [
    "ComparisonFlight",
    "Corridor",
    "Dispersion",
    "Disturbance",
    "Ground",
    "History",
    "Space",
    "ValidRange",
    "Views",
]


def __dir__() -> list[str]:
    return public_names(__all__)


__getattr__: Callable[[str], Any] = renamed_names(__name__, {"Beside": f"{__name__}.ComparisonFlight"})


@check_call
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


@check_call
@dataclass(frozen=True, kw_only=True)
class ComparisonFlight:
    """A plainer flight of the same problem, drawn into the same figures: parameters held at values [SI]."""

    given: tuple[tuple[str, float], ...]
    label: str


@check_call
@dataclass(frozen=True, kw_only=True)
class Ground:
    """A map of the point below the vehicle: names of its longitude and latitude, on the Earth with its coasts."""

    longitude: str
    latitude: str
    coasts: bool = False


@check_call
@dataclass(frozen=True, kw_only=True)
class Corridor:
    """Height against speed in the atmosphere, with contour lines of other outputs.

    Parameters
    ----------
    height, speed
        Names of outputs.
    equal
        Names of outputs that depend on height and speed only.
    position, velocity
        Names of the states of which they are made: the lines are found from states further out or in, and faster or
        slower, than those of the flight.
    """

    height: str
    speed: str
    equal: tuple[str, ...]
    position: tuple[str, ...]
    velocity: tuple[str, ...]


@check_call
@dataclass(frozen=True, kw_only=True)
class Disturbance:
    """A deviation of the flight from what was planned.

    Parameters
    ----------
    name
        Its unit amount: ``percent_thrust``.
    shares
        (parameter, percent): by how much one such disturbance changes given parameters.
    begins, without
        Or the name of a phase that begins one second later, and the parameters that are 0 until then.
    """

    name: str
    shares: tuple[tuple[str, float], ...] = ()
    begins: str = ""
    without: tuple[str, ...] = ()


@check_call
@dataclass(frozen=True, kw_only=True)
class Dispersion:
    """The disturbances that move the landing point (`perilune.problem.results.dispersion`).

    Parameters
    ----------
    disturbances
        Each makes two results, ``along_track_per_<name>`` and ``across_track_per_<name>``.
    position, velocity
        Names of the states in axes that turn with the body, from its centre.
    track
        Name of the phase whose initial track is meant: along-track changes lie on its great circle.
    """

    disturbances: tuple[Disturbance, ...]
    position: tuple[str, ...]
    velocity: tuple[str, ...]
    track: str


@check_call
@dataclass(frozen=True, kw_only=True)
class Space:
    """The place and time of a flight, for programs that know bodies and times: what `Phase.inertial` is relative to.

    Its axes are those of the body itself at the begin of the flight: z along its rotation, x to longitude 0.

    Parameters
    ----------
    body
        Name of the body at the origin, in lower case: ``moon``; "" of one that has none.
    rotation
        Name of the parameter that is the rate of the body's rotation [rad/s].
    epoch
        Time at the begin of the flight in ISO 8601, UTC unless it says otherwise; "" where it may begin at any time.
    longitude, latitude, height
        Names of outputs that place the point below the vehicle, and of the height above the body's surface (its
        ellipsoid, where it has one); "" where there are none.
    chosen
        What was chosen where the model leaves a direction open, in a sentence; "" where it leaves none.
    """

    body: str = ""
    rotation: str = ""
    epoch: str = ""
    longitude: str = ""
    latitude: str = ""
    height: str = ""
    chosen: str = ""

    def __post_init__(self) -> None:
        _demand_texts(self, "Space", *(f.name for f in fields(self)))
        if self.epoch:
            instant(self.epoch)


@check_call
@dataclass(frozen=True, kw_only=True)
class ValidRange:
    """The range of a quantity that a model is meant for; beyond it an answer is given with a warning.

    Parameters
    ----------
    quantity
        Name of a state or an output.
    because
        What the range rests on, with its source.
    lower, upper
        Its ends [SI].
    phases
        Names of the phases in which it holds; all where there are none.
    title
        What the quantity is called in the warning; its name with blanks by default.
    """

    quantity: str
    because: str
    lower: float = -math.inf
    upper: float = math.inf
    phases: tuple[str, ...] = ()
    title: str = ""

    def __post_init__(self) -> None:
        _demand_texts(self, "ValidRange", "quantity", "because", "title")
        require_row(self.phases, "phases", str)
        for side in ("lower", "upper"):
            require_si_number(getattr(self, side), f"the {side} end of a range")


@renamed_keywords(beside="comparison")
@check_call
@dataclass(frozen=True, kw_only=True)
class Views:
    """The ways in which a problem is looked at.

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
        Name of a solution in a legend; ``{name:format}`` stands for the value of a result.
    comparison
        A flight to draw with it, or None.
    peaks
        Names of outputs whose largest value along the flight is a result, ``peak_load``, with its time from the begin
        of the flight, ``peak_load_time``.
    ground
        Content of a map, or None.
    corridor
        Figure of height against speed, or None.
    dispersion
        Disturbances of the landing point, or None.
    floor
        Name of the fourth value of `Phase.track`, the least height there [m]; "" where there is none.
    space
        Where in space the flight is, or None.
    inputs
        Content of each file from which the problem was made, in a sentence: its rows, units and ranges.
    meant_for
        Ranges of quantities that the model is meant for.
    """

    histories: tuple[History, ...] = ()
    height: str = ""
    radius: str = ""
    frame: str = ""
    label: str = ""
    comparison: ComparisonFlight | None = None
    peaks: tuple[str, ...] = ()
    floor: str = ""
    ground: Ground | None = None
    corridor: Corridor | None = None
    dispersion: Dispersion | None = None
    space: Space | None = None
    inputs: tuple[str, ...] = ()
    meant_for: tuple[ValidRange, ...] = ()
    beside: ClassVar[RenamedAttribute] = RenamedAttribute("comparison")

    def __post_init__(self) -> None:
        require_row(self.histories, "figures", History)
        require_row(self.peaks, "peaks", str)
        require_row(self.inputs, "sentences on files", str)
        require_row(self.meant_for, "ranges", ValidRange)
        _demand_texts(self, "Views", "height", "radius", "frame", "label", "floor")
        for name, kind in _PARTS.items():
            if (part := getattr(self, name)) is not None:
                require_type(part, kind, f"a valid {name} of Views", f"pl.views.{kind.__name__}(...), or None")


_PARTS = {
    "comparison": ComparisonFlight,
    "ground": Ground,
    "corridor": Corridor,
    "dispersion": Dispersion,
    "space": Space,
}


def _demand_texts(record: Any, called: str, *names: str) -> None:
    for name in names:
        require_type(getattr(record, name), str, f"a valid {name} of {called}")


def check_views(
    views: Views, quantities: Iterable[str], parameters: Iterable[str], results: Iterable[str], phases: Iterable[str]
) -> None:
    """Refuse names that are not there.

    Parameters
    ----------
    views
        Views of a problem.
    quantities
        Names of states, controls and outputs.
    parameters
        Names of given and free parameters.
    results
        Names of results.
    phases
        Names of phases.

    Raises
    ------
    PeriluneError
        Named, with what is known.
    """
    fixed = views.comparison.given if views.comparison else ()
    ground = (views.ground.longitude, views.ground.latitude) if views.ground else ()
    plane = views.corridor
    shown = (plane.height, plane.speed, *plane.equal, *plane.position, *plane.velocity) if plane else ()
    moved = views.dispersion
    by = moved.disturbances if moved else ()
    axes = (*moved.position, *moved.velocity) if moved else ()
    placed = (views.space.longitude, views.space.latitude, views.space.height) if views.space else ()
    turning = views.space.rotation if views.space else ""
    disturbed = [name for d in by for name in (*d.without, *(share[0] for share in d.shares))]
    asked = (
        (
            "quantity",
            [views.height, *views.peaks, *ground, *shown, *axes, *placed, *(r.quantity for r in views.meant_for)],
            quantities,
        ),
        ("parameter", [views.radius, turning, *(name for name, _ in fixed), *disturbed], parameters),
        (
            "phase",
            [
                *(d.begins for d in by),
                *([moved.track] if moved else []),
                *(n for r in views.meant_for for n in r.phases),
            ],
            phases,
        ),
        ("result", [name for _, name, _, _ in Formatter().parse(views.label) if name], results),
    )
    for kind, names, known in asked:
        known = sorted(known)
        for name in names:
            if name and name not in known:
                raise unknown_name(kind, name, known)
