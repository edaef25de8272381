"""Flight-path coordinates relative to a turning body, and the equations of motion in them: Liu, Liu, Wu 2019, (1).

V is the speed relative to the body, gamma its angle above the horizon, psi its course from east towards north, r the
distance from the centre, Theta the longitude, Phi the latitude. The axis of the rotation is z.

The printed (1) has slips, which a comparison with Newton's law in Cartesian coordinates shows; `flight_path_rates` is

    V'   = (T cos a cos b - X)/m - g_r sin g - g_F cos g sin psi + w^2 r cos F (sin g cos F - cos g sin F sin psi)
    g'   = (T sin a + Y)/(m V) + V cos g/r - g_r cos g/V + g_F sin g sin psi/V + 2 w cos F cos psi
           + w^2 r cos F/V (cos g cos F + sin g sin F sin psi)
    psi' = (T cos a sin b - Z)/(m V cos g) - V cos g cos psi tan F/r - g_F cos psi/(V cos g)
           + 2 w (cos F sin psi tan g - sin F) - w^2 r/(V cos g) cos psi sin F cos F
    r' = V sin g,   Theta' = V cos g cos psi/(r cos F),   F' = V cos g sin psi/r

where (1) prints cos psi for the last sin psi of V', and in g' sin psi for cos psi and a minus in the last bracket; in
psi' the signs of its last two terms, and g_theta for g_F. The coordinates end at the poles and in vertical flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from perilune.models import Triple, combine, local_axes, scalar_product, spherical_coordinates


@dataclass(frozen=True, kw_only=True)
class FlightPath:
    """Speed [m/s], path angle and course [rad], distance [m], longitude and latitude [rad]."""

    speed: Any
    angle: Any
    course: Any
    distance: Any
    longitude: Any
    latitude: Any


def flight_path(position: Sequence[Any], velocity: Sequence[Any], xp: Any) -> FlightPath:
    """Return the flight-path coordinates of a position and a velocity relative to the body.

    Parameters
    ----------
    position, velocity
        From the centre [m], (3,), and relative to the turning body [m/s], (3,).
    xp
        Maths namespace.
    """
    distance, longitude, latitude = spherical_coordinates(position, xp)
    up, north, east = local_axes(longitude, latitude, xp)
    rise, to_north, to_east = (scalar_product(velocity, axis) for axis in (up, north, east))
    level = xp.sqrt(to_north * to_north + to_east * to_east)
    return FlightPath(
        speed=xp.sqrt(scalar_product(velocity, velocity)),
        angle=xp.atan2(rise, level),
        course=xp.atan2(to_north, to_east),
        distance=distance,
        longitude=longitude,
        latitude=latitude,
    )


def to_cartesian(path: FlightPath, xp: Any) -> tuple[Triple, Triple]:
    """Return position [m] and velocity [m/s] of flight-path coordinates.

    Parameters
    ----------
    path
        Flight-path coordinates.
    xp
        Maths namespace.
    """
    up, _, _ = local_axes(path.longitude, path.latitude, xp)
    forward, _, _ = path_axes(path, xp)
    return combine((path.distance, up)), combine((path.speed, forward))


def path_axes(path: FlightPath, xp: Any) -> tuple[Triple, Triple, Triple]:
    """Unit vectors along the velocity, across it upwards, and level to the left, towards greater psi.

    Parameters
    ----------
    path
        Longitude, latitude, path angle and course [rad] of the vehicle.
    xp
        Maths namespace.

    Returns
    -------
    tuple[Triple, Triple, Triple]
        (3,) each, in axes that turn with the body.
    """
    up, north, east = local_axes(path.longitude, path.latitude, xp)
    sine, cosine = xp.sin(path.angle), xp.cos(path.angle)
    level = combine((xp.cos(path.course), east), (xp.sin(path.course), north))
    left = combine((-xp.sin(path.course), east), (xp.cos(path.course), north))
    return combine((cosine, level), (sine, up)), combine((-sine, level), (cosine, up)), left


def gravity_components(distance: Any, latitude: Any, p: Any, xp: Any) -> tuple[Any, Any]:
    """g_r, downwards, and g_Phi, towards the equator [m/s^2]; Liu et al. (2).

    Parameters
    ----------
    distance, latitude
        From the centre [m], and geocentric [rad].
    p, xp
        Parameters [SI] and maths namespace.
    """
    strength = p.body_gravitational_parameter / (distance * distance)
    oblate = 1.5 * p.body_j2 * (p.body_radius / distance) ** 2
    sine = xp.sin(latitude)
    return strength * (1 - oblate * (3 * sine * sine - 1)), strength * oblate * xp.sin(2 * latitude)


def flight_path_rates(path: FlightPath, pushed: Sequence[Any], p: Any, xp: Any) -> tuple[Any, ...]:
    """Rates of the six coordinates; `pushed` is all acceleration but gravity along `path_axes` [m/s^2].

    Parameters
    ----------
    path
        Flight-path coordinates.
    pushed
        Acceleration without gravity along `path_axes` [m/s^2], (3,).
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    tuple
        Rates of speed, path angle, course, distance, longitude and latitude, per second.
    """
    forward, upward, leftward = pushed
    g_r, g_f = gravity_components(path.distance, path.latitude, p, xp)
    sin_g, cos_g, sin_c, cos_c = xp.sin(path.angle), xp.cos(path.angle), xp.sin(path.course), xp.cos(path.course)
    sin_f, cos_f = xp.sin(path.latitude), xp.cos(path.latitude)
    r, v, omega = path.distance, path.speed, p.body_rotation_rate
    turning = omega * omega * r
    return (
        forward - g_r * sin_g - g_f * cos_g * sin_c + turning * cos_f * (sin_g * cos_f - cos_g * sin_f * sin_c),
        upward / v + v * cos_g / r - g_r * cos_g / v + g_f * sin_g * sin_c / v + 2 * omega * cos_f * cos_c
        + turning * cos_f / v * (cos_g * cos_f + sin_g * sin_f * sin_c),
        leftward / (v * cos_g) - v * cos_g * cos_c * sin_f / cos_f / r - g_f * cos_c / (v * cos_g)
        + 2 * omega * (cos_f * sin_c * sin_g / cos_g - sin_f) - turning / (v * cos_g) * cos_c * sin_f * cos_f,
        v * sin_g,
        v * cos_g * cos_c / (r * cos_f),
        v * cos_g * sin_c / r,
    )  # fmt: skip
