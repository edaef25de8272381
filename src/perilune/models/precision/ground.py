"""Ground around a landing site: of a rotating round body, or flat under uniform gravity.

Frame: east, north, up at the site, turning with the body; position from the site, velocity relative to it. The
rotation axis of a round body is (0, cos latitude, sin latitude) there, and the mechanics are those of
`perilune.models.physics.rotating_frame`. Over flat ground gravity is (0, 0, -g), and no direction in the plane is
marked.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from perilune.models.descent.coordinates import descent_thrust
from perilune.models.physics.delta_v_bounds import is_flat
from perilune.models.physics.rotating_frame import Triple, combine, free_acceleration, inertial_triples, local_axes


def position_from_centre(x: Any, p: Any) -> Triple:
    """Position [m] from the centre of a round body.

    Parameters
    ----------
    x
        Record with east, north, up from the site [m].
    p
        Parameters [SI].
    """
    return x.east, x.north, x.up + p.body_radius + p.site_altitude


def axis(p: Any, xp: Any) -> Triple:
    """Unit vector of the rotation of a round body.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Triple
        East, north, up at the site, (3,).
    """
    return 0.0, xp.cos(p.site_latitude), xp.sin(p.site_latitude)


def ground_free_acceleration(x: Any, velocity: Sequence[Any], p: Any, xp: Any) -> Triple:
    """Return the acceleration [m/s^2] of a free fall relative to the ground.

    Parameters
    ----------
    x
        Record with east, north, up from the site [m].
    velocity
        Relative to the ground: east, north, up [m/s], (3,).
    p, xp
        Parameters [SI] and maths namespace.
    """
    if is_flat(p):
        return 0.0, 0.0, -p.body_gravity
    return free_acceleration(position_from_centre(x, p), velocity, axis(p, xp), p, xp)


def over_ground(x: Any, p: Any, xp: Any) -> tuple[Triple, Triple, Any]:
    """Return the place in the form of `delta_v_bounds`: position, axis of the rotation, radius of the site.

    Parameters
    ----------
    x
        Record with east, north, up from the site [m].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    tuple[Triple, Triple, Any]
        In m, 1 and m; over flat ground the height, no axis and a radius of 0.
    """
    if is_flat(p):
        return (0.0, 0.0, x.up), (0.0, 0.0, 0.0), 0.0
    return position_from_centre(x, p), axis(p, xp), p.body_radius + p.site_altitude


def inertial_over_round_body(x: Any, u: Any, t: Any, p: Any, xp: Any) -> Sequence[Any]:
    """`perilune.problem.phase.Phase.inertial` over a round body.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    t
        Time from the begin of the flight [s].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        Position [m], velocity [m/s] and acceleration by thrust [m/s^2] in inertial axes, (9,).
    """
    up, north, east = local_axes(p.site_longitude, p.site_latitude, xp)
    vectors = (position_from_centre(x, p), (x.v_east, x.v_north, x.v_up), (u.toward_east, u.toward_north, u.toward_up))
    position, velocity, direction = (combine((a, east), (b, north), (c, up)) for a, b, c in vectors)
    return inertial_triples(position, velocity, combine((descent_thrust(u, p) / x.m, direction)), t, p, xp)
