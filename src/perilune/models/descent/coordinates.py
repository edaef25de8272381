"""Coordinate systems of a powered descent, two of them: functions of state, control and parameters.

Both turn with the body, and velocities are relative to it (Peng, Li, Shen, Tang 2012, section 4):

*Cartesian*: position and velocity along fixed axes, z the axis of rotation; thrust a free `UnitVectorControl`. No
point is singular, so a start over the pole can be flown and shot from.

*Spherical*, the paper's: r, longitude theta, latitude phi; velocity u along oy, v along oz, w radially up,
where oy lies at the constant heading g (gamma) from north towards east, and oz = up x oy. Thrust at elevation
a (alpha) above the horizon and azimuth b (beta) from oy towards oz, both bounded (24). Equation (17) was lost
from the paper's text; the frames and (20)-(23) force it to be, J2 apart and with E = u sin g - v cos g,

    r' = w,  theta' = E/(r cos phi),  phi' = (u cos g + v sin g)/r,  m' = -T/(Isp g0)
    u' = (T/m) cos a cos b - u w/r + v E tan(phi)/r
         + 2 om (v sin phi - w cos phi sin g) - om^2 r sin phi cos phi cos g
    v' = (T/m) cos a sin b - v w/r - u E tan(phi)/r
         + 2 om (w cos phi cos g - u sin phi) - om^2 r sin phi cos phi sin g
    w' = (T/m) sin a + (u^2 + v^2)/r - mu/r^2 + 2 om E cos phi + om^2 r cos^2 phi

At a pole tan(phi) is infinite: there only a method that does not evaluate the rates at t = 0 can use it
(Gauss points leave out the ends).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from perilune.core import Physics
from perilune.models.physics.delta_v_bounds import braking_distance_and_time
from perilune.models.physics.rotating_frame import (
    combine,
    cross_product,
    heading_axes,
    local_axes,
    scalar_product,
    spherical_coordinates,
)
from perilune.problem import Variable

AXIS = (0.0, 0.0, 1.0)  # of the rotation, in the Cartesian frame


# -- what both coordinate systems share
# -------------------------------------------------------------------------------


def descent_thrust(u: Any, p: Any) -> Any:
    """Thrust [N]: constant, or throttled where `throttle` is a control.

    Parameters
    ----------
    u
        Control of the burn.
    p
        Parameters [SI].
    """
    return p.vehicle_thrust * getattr(u, "throttle", 1.0)


def mass_rate(u: Any, p: Any) -> Any:
    """Rate of the mass [kg/s].

    Parameters
    ----------
    u
        Control of the burn.
    p
        Parameters [SI].
    """
    return -descent_thrust(u, p) / (p.vehicle_specific_impulse * p.vehicle_standard_gravity)


def axes_at_start(p: Any, xp: Any) -> Any:
    """Return the vertical and the horizontal axes along and across the heading at the start, unit vectors.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Any
        Up, oy and oz, (3,) each, in axes that turn with the body.
    """
    return heading_axes(p.start_longitude, p.start_latitude, p.start_heading, xp)


def target_position(p: Any, xp: Any) -> Any:
    """Return the position of the site [m].

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Any
        In axes that turn with the body, (3,).
    """
    return combine((p.body_radius + p.site_altitude, local_axes(p.site_longitude, p.site_latitude, xp)[0]))


def likely_landing_point(p: Any, xp: Any) -> Any:
    """Site, or where none is stated a place ahead of the start, as far as full thrust stops the speed over ground.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Any
        Position [m] in axes that turn with the body, (3,).
    """
    if hasattr(p, "site_longitude"):
        return target_position(p, xp)
    up, oy, oz = axes_at_start(p, xp)
    r_site = p.body_radius + p.site_altitude
    _, time = braking_distance_and_time(xp.sqrt(p.start_forward_speed**2 + p.start_sideways_speed**2), p, xp)
    ahead = combine((r_site, up), (0.5 * time * p.start_forward_speed, oy), (0.5 * time * p.start_sideways_speed, oz))
    return combine((r_site / xp.sqrt(scalar_product(ahead, ahead)), ahead))


def track_normal(p: Any, xp: Any) -> Any:
    """Return the unit normal of the great circle from the point under the start to the site.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Any
        In axes that turn with the body, (3,).
    """
    normal = cross_product(axes_at_start(p, xp)[0], local_axes(p.site_longitude, p.site_latitude, xp)[0])
    return combine((1 / xp.sqrt(scalar_product(normal, normal)), normal))


def descent_track(above: Any, r: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Arc over the ground along the great circle of the first heading, arc to the left of it, height.

    No pole disturbs it. `above` is the unit vector to the vehicle.

    Parameters
    ----------
    above, r
        Unit vector to the vehicle, (3,), and its distance from the centre [m].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        All three in m.
    """
    up, oy, oz = axes_at_start(p, xp)
    along, across = xp.atan2(scalar_product(above, oy), scalar_product(above, up)), xp.asin(scalar_product(above, oz))
    return p.body_radius * along, p.body_radius * across, r - p.body_radius


def descent_outputs(position: Any, velocity: Any, direction: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Return all of `OUTPUTS` but the last.

    Parameters
    ----------
    position, velocity
        From the centre [m], and relative to the body [m/s], in axes that turn with it, (3,) each.
    direction
        Unit vector of the thrust in them, (3,).
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        In SI: altitude, longitude, latitude, three speeds, elevation, azimuth.
    """
    r, longitude, latitude = spherical_coordinates(position, xp)
    up, oy, oz = heading_axes(longitude, latitude, p.start_heading, xp)
    return (
        r - p.body_radius,
        longitude,
        latitude,
        scalar_product(velocity, oy),
        scalar_product(velocity, oz),
        scalar_product(velocity, up),
        *elevation_and_azimuth(direction, (up, oy, oz), xp),
    )


def elevation_and_azimuth(direction: Any, axes: Any, xp: Any) -> tuple[Any, Any]:
    """Elevation and azimuth, the latter counted from straight retro: it jumps for pro-grade thrust only.

    Parameters
    ----------
    direction
        Unit vector of the thrust, (3,).
    axes
        Up, oy and oz at the vehicle, (3,) each.
    xp
        Maths namespace.

    Returns
    -------
    tuple[Any, Any]
        Both in rad.
    """
    vertical, forward, sideways = (scalar_product(direction, axis) for axis in axes)
    horizontal = xp.sqrt(forward * forward + sideways * sideways)
    return xp.atan2(vertical, horizontal), xp.atan2(-sideways, -forward) + math.pi


OUTPUTS = (
    Variable(name="altitude", unit="m"),
    Variable(name="longitude", unit="rad"),
    Variable(name="latitude", unit="rad"),
    Variable(name="forward_speed", unit="m/s", description="u, along oy", label="forward u"),
    Variable(name="sideways_speed", unit="m/s", description="v, along oz", label="left v"),
    Variable(name="vertical_speed", unit="m/s", description="w, up", label="up w"),
    Variable(name="thrust_elevation", unit="rad", description="alpha, above the horizon", label="elevation α"),
    Variable(name="thrust_azimuth", unit="rad", description="beta, from oy towards oz", label="azimuth β"),
    Variable(name="thrust_acceleration", unit="m/s^2"),
)


# -- Cartesian
# --------------------------------------------------------------------------------------------------------


# -- spherical
# --------------------------------------------------------------------------------------------------------


# -- the two records
# --------------------------------------------------------------------------------------------------


def variables_of_unit(unit: str, *names: str) -> tuple[Variable, ...]:
    """Variables of one unit."""
    return tuple(Variable(name=name, unit=unit) for name in names)


TOUCHDOWN_HEIGHT = Variable(name="touchdown_height", unit="m")


@dataclass(frozen=True, kw_only=True)
class Coordinates:
    """A coordinate system: its states but the mass, and the functions of a `Phase`; `ends` by the kind of target."""

    states: tuple[Variable, ...]
    dynamics: Physics
    start: Physics
    ends: Mapping[str, tuple[Physics, tuple[Variable, ...]]]
    path: Physics
    outputs: Physics
    spent: Physics
    inertial: Physics
    track: Physics
    end_guess: Physics
