"""Mechanics relative to a rotating body: gravity with zonal harmonics, apparent accelerations, places on the sphere.

Vectors are triples of whatever the caller computes with (numbers, arrays, symbols), in any Cartesian frame
that turns with the body; `axis` is the unit vector of the rotation, Omega = omega axis, in that frame:

    r'' = g(r) + thrust/m - 2 Omega x r' - Omega x (Omega x r)
    U   = -(mu/r) (1 - sum of J_n (R/r)^n P_n(s)),   s = r.axis/r,   g = -grad U

with J2, and J3 and J4 where a body has them (Vallado, Fundamentals of Astrodynamics, 2013, section 8.7). The gradient
stands in closed form in `zonal_gravity`, because the numeric namespace cannot differentiate; the tests differentiate
`potential` and compare.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

Triple = tuple[Any, Any, Any]


def scalar_product(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """Scalar product of two triples.

    Parameters
    ----------
    a, b
        Vectors in the same Cartesian axes, (3,) each.
    """
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross_product(a: Sequence[Any], b: Sequence[Any]) -> Triple:
    """Vector product of two triples.

    Parameters
    ----------
    a, b
        Vectors in the same right-handed axes, (3,) each.
    """
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def combine(*terms: tuple[Any, Sequence[Any]]) -> Triple:
    """Sum of factor times triple."""
    x, y, z = (sum(factor * vector[i] for factor, vector in terms) for i in range(3))
    return x, y, z


def potential(position: Sequence[Any], axis: Sequence[Any], p: Any, xp: Any) -> Any:
    """Gravity potential U [m^2/s^2]; `p` holds the body's gravitational_parameter, radius, j2, perhaps j3, j4.

    Parameters
    ----------
    position, axis
        From the centre [m], (3,), and the unit vector of the rotation, (3,).
    p, xp
        Parameters [SI] and maths namespace.
    """
    r = xp.sqrt(scalar_product(position, position))
    s = scalar_product(position, axis) / r
    ratio = p.body_radius / r
    zonal = p.body_j2 * ratio**2 * (3 * s * s - 1) / 2
    if hasattr(p, "body_j3"):
        zonal += p.body_j3 * ratio**3 * (5 * s * s - 3) * s / 2
    if hasattr(p, "body_j4"):
        zonal += p.body_j4 * ratio**4 * ((35 * s * s - 30) * s * s + 3) / 8
    return -p.body_gravitational_parameter / r * (1 - zonal)


def zonal_gravity(position: Sequence[Any], axis: Sequence[Any], p: Any, xp: Any) -> Triple:
    """-grad U: along the position with J_n (R/r)^n P'_n+1, and along the axis with -P'_n.

    Parameters
    ----------
    position, axis
        From the centre [m], (3,), and the unit vector of the rotation, (3,).
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Triple
        Acceleration [m/s^2], (3,).
    """
    r = xp.sqrt(scalar_product(position, position))
    s = scalar_product(position, axis) / r
    ratio = p.body_radius / r
    oblate = 1.5 * p.body_j2 * ratio**2
    strength = -p.body_gravitational_parameter / (r * r)
    inward, along = 1 + oblate * (1 - 5 * s * s), 2 * oblate * s
    if hasattr(p, "body_j3"):
        pear = 0.5 * p.body_j3 * ratio**3
        inward, along = inward - pear * (35 * s * s - 15) * s, along + pear * (15 * s * s - 3)
    if hasattr(p, "body_j4"):
        square = 0.125 * p.body_j4 * ratio**4
        inward -= square * ((315 * s * s - 210) * s * s + 15)
        along += square * (140 * s * s - 60) * s
    return combine((strength * inward / r, position), (strength * along, axis))


def free_acceleration(position: Sequence[Any], velocity: Sequence[Any], axis: Sequence[Any], p: Any, xp: Any) -> Triple:
    """Return the acceleration without thrust in the rotating frame: gravity, Coriolis, centrifugal [m/s^2].

    Parameters
    ----------
    position, velocity
        From the centre [m], (3,), and relative to the rotating frame [m/s], (3,).
    axis
        Unit vector of the rotation, (3,).
    p, xp
        Parameters [SI] and maths namespace.
    """
    omega = p.body_rotation_rate
    return combine(
        (1, zonal_gravity(position, axis, p, xp)),
        (-2 * omega, cross_product(axis, velocity)),
        (-omega * omega, cross_product(axis, cross_product(axis, position))),
    )


def local_axes(longitude: Any, latitude: Any, xp: Any) -> tuple[Triple, Triple, Triple]:
    """Return the unit vectors up, north, east at a place, in the frame whose z is the rotation axis.

    At a pole, north and east are those of the meridian `longitude`, by continuity.

    Parameters
    ----------
    longitude, latitude
        Of the place [rad].
    xp
        Maths namespace.
    """
    sin_lon, cos_lon, sin_lat, cos_lat = xp.sin(longitude), xp.cos(longitude), xp.sin(latitude), xp.cos(latitude)
    up = (cos_lat * cos_lon, cos_lat * sin_lon, sin_lat)
    north = (-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat)
    return up, north, (-sin_lon, cos_lon, 0.0)


def heading_axes(longitude: Any, latitude: Any, heading: Any, xp: Any) -> tuple[Triple, Triple, Triple]:
    """Return Peng et al.'s orbit frame: ox up, oy at `heading` from north towards east, oz = ox x oy.

    Parameters
    ----------
    longitude, latitude, heading
        Of the place [rad], and from north towards east [rad].
    xp
        Maths namespace.
    """
    up, north, east = local_axes(longitude, latitude, xp)
    sine, cosine = xp.sin(heading), xp.cos(heading)
    return up, combine((cosine, north), (sine, east)), combine((sine, north), (-cosine, east))


def spherical_coordinates(position: Sequence[Any], xp: Any) -> tuple[Any, Any, Any]:
    """Distance, longitude and latitude of a position in the frame whose z is the rotation axis.

    Parameters
    ----------
    position
        From the centre [m], (3,).
    xp
        Maths namespace.

    Returns
    -------
    tuple
        Distance [m], longitude and latitude [rad].
    """
    x, y, z = position
    across = xp.sqrt(x * x + y * y)
    return xp.sqrt(scalar_product(position, position)), xp.atan2(y, x), xp.atan2(z, across)


def apparent_gravity(position: Sequence[Any], axis: Sequence[Any], p: Any, xp: Any) -> Triple:
    """Return gravity at rest in the rotating frame, with the centrifugal acceleration [m/s^2].

    Parameters
    ----------
    position, axis
        From the centre [m], (3,), and the unit vector of the rotation, (3,).
    p, xp
        Parameters [SI] and maths namespace.
    """
    return free_acceleration(position, (0.0, 0.0, 0.0), axis, p, xp)


INERTIAL_AXES = (
    "inertial axes that coincide with the body-fixed axes at the start of the flight: z along its rotation, x to"
    " longitude 0"
)


def inertial_triples(
    position: Sequence[Any], velocity: Sequence[Any], push: Sequence[Any], t: Any, p: Any, xp: Any
) -> tuple[Any, ...]:
    """Position, velocity and a third vector in `INERTIAL_AXES` as nine values, t seconds after the begin of the flight.

    From the axes that turn with the body, z along its rotation; `velocity` is relative to these.

    Parameters
    ----------
    position, velocity, push
        Triples in the axes of the body: [m], relative to it [m/s], and any third, as an acceleration [m/s^2].
    t
        Time after the begin of the flight [s].
    p, xp
        Parameters [SI] and maths namespace.
    """
    omega = p.body_rotation_rate
    sine, cosine = xp.sin(omega * t), xp.cos(omega * t)
    carried = combine((1, velocity), (omega, cross_product((0.0, 0.0, 1.0), position)))
    return tuple(
        value for x, y, z in (position, carried, push) for value in (cosine * x - sine * y, sine * x + cosine * y, z)
    )
