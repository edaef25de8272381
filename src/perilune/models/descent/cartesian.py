"""Powered descent in Cartesian coordinates: functions of state, control and parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from perilune.models.descent.coordinates import (
    AXIS,
    TOUCHDOWN_HEIGHT,
    Coordinates,
    axes_at_start,
    descent_outputs,
    descent_thrust,
    descent_track,
    elevation_and_azimuth,
    likely_landing_point,
    mass_rate,
    target_position,
    track_normal,
    variables_of_unit,
)
from perilune.models.physics.delta_v_budget import velocity_loss_rates
from perilune.models.physics.rotating_frame import (
    apparent_gravity,
    combine,
    free_acceleration,
    heading_axes,
    inertial_triples,
    scalar_product,
    spherical_coordinates,
)


def _cartesian_dynamics(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    velocity = (x.vx, x.vy, x.vz)
    acceleration = combine(
        (1, free_acceleration((x.x, x.y, x.z), velocity, AXIS, p, xp)),
        (descent_thrust(u, p) / x.m, (u.toward_x, u.toward_y, u.toward_z)),
    )
    return (*velocity, *acceleration, mass_rate(u, p))


def _cartesian_start(p: Any, xp: Any) -> Sequence[Any]:
    up, oy, oz = axes_at_start(p, xp)
    position = combine((p.body_radius + p.start_altitude, up))
    velocity = combine((p.start_forward_speed, oy), (p.start_sideways_speed, oz), (p.start_vertical_speed, up))
    return (*position, *velocity, p.vehicle_mass)


def _cartesian_at_site(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    site = target_position(p, xp)
    return x.x - site[0], x.y - site[1], x.z - site[2], x.vx, x.vy, x.vz


def _cartesian_on_track(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    return _cartesian_height(x, p, xp), scalar_product(track_normal(p, xp), (x.x, x.y, x.z)), x.vx, x.vy, x.vz


def _cartesian_anywhere(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    return _cartesian_height(x, p, xp), x.vx, x.vy, x.vz


def _cartesian_height(x: Any, p: Any, xp: Any) -> Any:
    return xp.sqrt(x.x * x.x + x.y * x.y + x.z * x.z) - p.body_radius - p.site_altitude


def _cartesian_path(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    return (_cartesian_height(x, p, xp),)


def steered_path(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Height, and the margins of elevation and azimuth to their bounds, Peng et al. (24).

    Those of the elevation are differences of sines, linear in the direction, which the indirect method can hold.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        Height [m]; margins of the elevation, sines [1]; margins of the azimuth [rad].
    """
    r = xp.sqrt(x.x * x.x + x.y * x.y + x.z * x.z)
    upward = scalar_product((x.x, x.y, x.z), (u.toward_x, u.toward_y, u.toward_z)) / r
    _, longitude, latitude = spherical_coordinates((x.x, x.y, x.z), xp)
    axes = heading_axes(longitude, latitude, p.start_heading, xp)
    _, azimuth = elevation_and_azimuth((u.toward_x, u.toward_y, u.toward_z), axes, xp)
    return (
        _cartesian_height(x, p, xp),
        upward - xp.sin(p.steering_elevation_lower), xp.sin(p.steering_elevation_upper) - upward,
        azimuth - p.steering_azimuth_lower, p.steering_azimuth_upper - azimuth,
    )  # fmt: skip


def _cartesian_outputs(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    seen = descent_outputs((x.x, x.y, x.z), (x.vx, x.vy, x.vz), (u.toward_x, u.toward_y, u.toward_z), p, xp)
    return (*seen, descent_thrust(u, p) / x.m)


def _cartesian_spent(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    pull = apparent_gravity((x.x, x.y, x.z), AXIS, p, xp)
    return velocity_loss_rates(
        (x.vx, x.vy, x.vz), descent_thrust(u, p) / x.m, (u.toward_x, u.toward_y, u.toward_z), pull, xp
    )


def _cartesian_inertial(x: Any, u: Any, t: Any, p: Any, xp: Any) -> Sequence[Any]:
    push = combine((descent_thrust(u, p) / x.m, (u.toward_x, u.toward_y, u.toward_z)))
    return inertial_triples((x.x, x.y, x.z), (x.vx, x.vy, x.vz), push, t, p, xp)


def _cartesian_track(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    r = xp.sqrt(x.x * x.x + x.y * x.y + x.z * x.z)
    return descent_track(combine((1 / r, (x.x, x.y, x.z))), r, p, xp)


def _cartesian_end_guess(p: Any, xp: Any) -> Sequence[Any]:
    return (*likely_landing_point(p, xp), 0.0, 0.0, 0.0, 0.6 * p.vehicle_mass)


CARTESIAN = Coordinates(
    states=(*variables_of_unit("m", "x", "y", "z"), *variables_of_unit("m/s", "vx", "vy", "vz")),
    dynamics=_cartesian_dynamics,
    start=_cartesian_start,
    ends={
        "site": (
            _cartesian_at_site,
            (
                *variables_of_unit("m", "site_x", "site_y", "site_z"),
                *variables_of_unit("m/s", "rest_x", "rest_y", "rest_z"),
            ),
        ),
        "downrange": (
            _cartesian_on_track,
            (
                TOUCHDOWN_HEIGHT,
                *variables_of_unit("m", "cross_range"),
                *variables_of_unit("m/s", "rest_x", "rest_y", "rest_z"),
            ),
        ),
        "anywhere": (_cartesian_anywhere, (TOUCHDOWN_HEIGHT, *variables_of_unit("m/s", "rest_x", "rest_y", "rest_z"))),
    },
    path=_cartesian_path,
    outputs=_cartesian_outputs,
    spent=_cartesian_spent,
    inertial=_cartesian_inertial,
    track=_cartesian_track,
    end_guess=_cartesian_end_guess,
)
