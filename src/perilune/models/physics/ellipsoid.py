"""Ellipsoid of revolution: altitude above it, and places on it, smooth in Cartesian coordinates.

Bowring's second formula (Survey Review 28, 1985) gives the parametric latitude of a point closely enough that its
altitude, whose error is of second order in it, is exact to rounding up to some thousand kilometres:

    tan beta = (b z/(a rho)) (1 + e'^2 b/r),   tan phi = (z + e'^2 b sin^3 beta)/(rho - e^2 a cos^3 beta)
    h = rho cos phi + z sin phi - a sqrt(1 - e^2 sin^2 phi)

Written only in rho^2 it has no corner at the poles. A body without a flattening is a sphere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from perilune.models.physics.rotating_frame import Triple, combine, local_axes, scalar_product


def altitude(position: Sequence[Any], p: Any, xp: Any) -> Any:
    """Altitude [m] above the ellipsoid of ``body_radius`` (equatorial) and ``body_flattening``, or above the sphere.

    Parameters
    ----------
    position
        From the centre [m], (3,).
    p, xp
        Parameters [SI] and maths namespace.
    """
    if not hasattr(p, "body_flattening"):
        return xp.sqrt(scalar_product(position, position)) - p.body_radius
    _, _, height = _geodetic_vertical(position, p, xp)
    return height


def latitude(position: Sequence[Any], p: Any, xp: Any) -> Any:
    """Geodetic latitude [rad]; geocentric above a sphere.

    Parameters
    ----------
    position
        From the centre [m], (3,).
    p, xp
        Parameters [SI] and maths namespace.
    """
    x, y, z = position
    across = xp.sqrt(x * x + y * y)
    if not hasattr(p, "body_flattening"):
        return xp.atan2(z, across)
    level, along, _ = _geodetic_vertical(position, p, xp)
    return xp.atan2(along, across * level)


def geocentric(latitude: Any, distance: Any, p: Any, xp: Any) -> Any:
    """Geocentric latitude [rad] of a point at a geodetic one [rad] and at a distance from the centre [m].

    Parameters
    ----------
    latitude, distance
        Geodetic latitude [rad] and distance from the centre [m].
    p, xp
        Parameters [SI] and maths namespace.
    """
    if not hasattr(p, "body_flattening"):
        return latitude
    x, _, z = geodetic_position(0.0, latitude, 0.0, p, xp)
    outwards = x * xp.cos(latitude) + z * xp.sin(latitude)
    height = xp.sqrt(outwards * outwards + distance * distance - x * x - z * z) - outwards
    return xp.atan2(z + height * xp.sin(latitude), x + height * xp.cos(latitude))


def geodetic_position(longitude: Any, latitude: Any, height: Any, p: Any, xp: Any) -> Triple:
    """Position [m] of a place by its geodetic latitude [rad] and its altitude [m].

    Parameters
    ----------
    longitude, latitude, height
        Longitude and geodetic latitude [rad], and altitude [m].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Triple
        Position from the centre [m], (3,).
    """
    up, _, _ = local_axes(longitude, latitude, xp)
    if not hasattr(p, "body_flattening"):
        return combine((p.body_radius + height, up))
    squared = p.body_flattening * (2 - p.body_flattening)
    normal = p.body_radius / xp.sqrt(1 - squared * up[2] * up[2])
    return combine((normal + height, up), (-squared * normal * up[2], (0.0, 0.0, 1.0)))


def _geodetic_vertical(position: Sequence[Any], p: Any, xp: Any) -> tuple[Any, Any, Any]:
    """The tangent of the geodetic latitude as n and Z, cos phi : sin phi = rho n : Z; and the altitude."""
    x, y, z = position
    a, squared = p.body_radius, p.body_flattening * (2 - p.body_flattening)  # e^2
    b = a * (1 - p.body_flattening)
    second = squared / (1 - squared)  # e'^2
    across = x * x + y * y
    steep = b * z * (1 + second * b / xp.sqrt(across + z * z))
    length = xp.sqrt(a * a * across + steep * steep)
    level = 1 - squared * a * a * a * a * across / (length * length * length)
    along = z + second * b * (steep / length) * (steep / length) * (steep / length)
    normal = xp.sqrt(across * level * level + along * along)
    sine = along / normal
    height = (across * level + z * along) / normal - a * xp.sqrt(1 - squared * sine * sine)
    return level, along, height
