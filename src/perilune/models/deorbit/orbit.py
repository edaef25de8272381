"""Initial state of a return: on a Kepler orbit, in axes that turn with the body, as a formula of the orbit.

With the argument of latitude u, counted from the ascending node, i the inclination and W the longitude of the node at
that time, the unit vectors up and ahead (in the orbit's plane, at right angles to up) are

    up    = R_z(W) (cos u, sin u cos i, sin u sin i),     ahead = R_z(W) (-sin u, cos u cos i, cos u sin i)

A place on the orbit gives them by sin u = sin(geocentric latitude)/sin i, with cos u >= 0 on an ascending pass and W
from the longitude. The orbit's plane does not turn while the body does, and W is relative to the body.
"""

from __future__ import annotations

from typing import Any

from perilune.core import Physics
from perilune.models.physics import ellipsoid
from perilune.models.physics.rotating_frame import Triple, combine, cross_product

AXIS: Triple = (0.0, 0.0, 1.0)
# The distance on an ellipse depends on the latitude, and above an ellipsoid this on that, by a thousandth.
_ROUNDS = 6


def angles_of_place(going: str) -> Physics:
    """``angles(p, xp)`` of a manoeuvre: argument of latitude and longitude of the node [rad]."""
    return _ascending if going == "ascending" else _descending


def angles_of_node(p: Any, xp: Any) -> tuple[Any, Any]:
    """Angles of an orbit that says where it is at t = 0.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    tuple[Any, Any]
        Argument of latitude and longitude of the node [rad].
    """
    return p.orbit_argument_of_latitude, p.orbit_node_longitude


def _ascending(p: Any, xp: Any) -> tuple[Any, Any]:
    return _angles_at_latitude(p, xp, 1.0)


def _descending(p: Any, xp: Any) -> tuple[Any, Any]:
    return _angles_at_latitude(p, xp, -1.0)


def _angles_at_latitude(p: Any, xp: Any, northwards: float) -> tuple[Any, Any]:
    def angles(latitude: Any) -> tuple[Any, Any, Any]:
        sine = xp.sin(latitude) / xp.sin(p.orbit_inclination)
        cosine = northwards * xp.sqrt(1 - sine * sine)
        return xp.atan2(sine, cosine), sine, cosine

    # Nowhere is it further from the geodetic one than at the ground: no orbit that comes to the place starts beyond it.
    angle, sine, cosine = angles(ellipsoid.geocentric(p.manoeuvre_latitude, p.body_radius, p, xp))
    for _ in range(_ROUNDS if hasattr(p, "body_flattening") else 0):
        distance = radius_and_speeds(angle, p, xp)[0]
        angle, sine, cosine = angles(ellipsoid.geocentric(p.manoeuvre_latitude, distance, p, xp))
    return angle, p.manoeuvre_longitude - xp.atan2(xp.cos(p.orbit_inclination) * sine, cosine)


def plane_axes(angle: Any, node: Any, p: Any, xp: Any) -> tuple[Triple, Triple]:
    """Unit vectors up and ahead at an argument of latitude, for a node given relative to the body.

    Parameters
    ----------
    angle, node
        Argument of latitude, and longitude of the ascending node [rad].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    tuple[Triple, Triple]
        Each (3,), in axes that turn with the body.
    """
    sin_i, cos_i = xp.sin(p.orbit_inclination), xp.cos(p.orbit_inclination)
    to_node, beyond = (xp.cos(node), xp.sin(node), 0.0), (-cos_i * xp.sin(node), cos_i * xp.cos(node), sin_i)
    return (
        combine((xp.cos(angle), to_node), (xp.sin(angle), beyond)),
        combine((-xp.sin(angle), to_node), (xp.cos(angle), beyond)),
    )


def radius_and_speeds(angle: Any, p: Any, xp: Any) -> tuple[Any, Any, Any]:
    """Distance [m], and inertial speeds upwards and ahead [m/s], at an argument of latitude.

    Parameters
    ----------
    angle
        Argument of latitude [rad].
    p, xp
        Parameters [SI] and maths namespace.
    """
    if hasattr(p, "orbit_radius"):
        return p.orbit_radius, 0.0 * p.orbit_radius, xp.sqrt(p.body_gravitational_parameter / p.orbit_radius)
    low, high = p.body_radius + p.orbit_perigee_altitude, p.body_radius + p.orbit_apogee_altitude
    parameter, eccentricity = 2 * low * high / (low + high), (high - low) / (high + low)
    anomaly = angle - p.orbit_argument_of_perigee
    speed = xp.sqrt(p.body_gravitational_parameter / parameter)
    ahead = 1 + eccentricity * xp.cos(anomaly)
    return parameter / ahead, speed * eccentricity * xp.sin(anomaly), speed * ahead


def orbit_state(angle: Any, node: Any, p: Any, xp: Any) -> tuple[Triple, Triple]:
    """Position [m], and velocity [m/s] relative to the turning body.

    Parameters
    ----------
    angle, node
        Argument of latitude, and longitude of the ascending node [rad].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    tuple[Triple, Triple]
        Each (3,), in axes that turn with the body.
    """
    up, ahead = plane_axes(angle, node, p, xp)
    distance, rise, level = radius_and_speeds(angle, p, xp)
    position = combine((distance, up))
    return position, combine((rise, up), (level, ahead), (-p.body_rotation_rate, cross_product(AXIS, position)))
