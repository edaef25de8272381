"""Path constraints of a precision landing: height above the ground or a glide slope, and the tilt of its thrust.

    d_up >= cos(tilt)                                      pointing limit: the vehicle stays near upright
    up >= tan(slope) (sqrt(east^2 + north^2 + a^2) - a)    glide slope: the ground is not flown into

The glide slope is a hyperboloid with pad radius a. It lies between the cone from the site, whose tip has no
normal, and the cone from the rim of the pad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from perilune.core import quantity, record
from perilune.models.descent.coordinates import variables_of_unit
from perilune.problem import Variable


@record("corridor")
class Corridor:
    """Limits on the path of a precision landing, each of them optional; without any, only the ground remains."""

    tilt: float | None = quantity(
        "rad", "50 deg", default=None, above=0.0, below=0.5 * math.pi, outside="is not an angle",
        about="greatest tilt of the thrust from the vertical; the lander may touch down with it",
    )  # fmt: skip
    slope: float | None = quantity(
        "rad", "20 deg", default=None, above=0.0, below=0.5 * math.pi, outside="is not an angle",
        about="least elevation of the vehicle above the horizon as seen from the site; default: only the ground",
    )  # fmt: skip
    pad_radius: float = quantity(
        "m", "10 m", default=10.0, above=0.0, outside="must be positive",
        about="radius within which the tip of the glide slope is rounded",
    )  # fmt: skip


NONE = Corridor()  # but the ground
POINTING = Variable(name="pointing_margin", description="cosine of the thrust's tilt less that of corridor.tilt")


def corridor_conditions(corridor: Corridor, *, to_gate: bool = False) -> tuple[Variable, ...]:
    """Conditions of the path, in the order of `corridor_margins`; `to_gate` where a vertical descent follows.

    Parameters
    ----------
    corridor
        Glide slope and tilt, None where not stated.
    to_gate
        Add the height above the gate of a vertical descent.
    """
    heights = ("height_above_glide_slope",) if corridor.slope is not None else ()
    heights += ("height_above_gate",) if to_gate else ()
    return (
        *variables_of_unit("m", *(heights or ("height_above_site",))),
        *((POINTING,) if corridor.tilt is not None else ()),
    )


def above_slope(x: Any, p: Any, xp: Any) -> Any:
    """Height [m] above the glide slope.

    Parameters
    ----------
    x
        Record with east, north, up from the site [m].
    p, xp
        Parameters [SI] and maths namespace.
    """
    a = p.corridor_pad_radius
    return x.up - xp.tan(p.corridor_slope) * (xp.sqrt(x.east * x.east + x.north * x.north + a * a) - a)


def corridor_margins(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Values of `corridor_conditions` where the engine burns.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        Heights [m], and the margin of the pointing limit [1].
    """
    pointing = (u.toward_up - xp.cos(p.corridor_tilt),) if hasattr(p, "corridor_tilt") else ()
    return *height_margins(x, u, p, xp), *pointing


def height_margins(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Values of `corridor_conditions` that mean something without thrust: the heights.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        In m.
    """
    slope = (above_slope(x, p, xp),) if hasattr(p, "corridor_slope") else ()
    gate = (x.up - p.final_height,) if hasattr(p, "final_height") else ()
    return (*slope, *gate) or (x.up,)
