"""Powered descent in spherical coordinates: functions of state, control and parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from perilune.models.descent.coordinates import (
    AXIS,
    TOUCHDOWN_HEIGHT,
    Coordinates,
    descent_thrust,
    descent_track,
    likely_landing_point,
    mass_rate,
    track_normal,
    variables_of_unit,
)
from perilune.models.physics.delta_v_budget import velocity_loss_rates
from perilune.models.physics.rotating_frame import (
    apparent_gravity,
    combine,
    heading_axes,
    inertial_triples,
    local_axes,
    scalar_product,
    spherical_coordinates,
    zonal_gravity,
)


def _spherical_dynamics(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Peng et al. (17), as decoded at the head of this file, and J2."""
    omega, sin_g, cos_g = p.body_rotation_rate, xp.sin(p.start_heading), xp.cos(p.start_heading)
    sin_phi, cos_phi, tan_phi = xp.sin(x.phi), xp.cos(x.phi), xp.tan(x.phi)
    east, north = x.u * sin_g - x.v * cos_g, x.u * cos_g + x.v * sin_g
    push = descent_thrust(u, p) / x.m
    # In local axes up, north, east, where the rotation axis is (sin phi, cos phi, 0).
    pull_up, pull_north, _ = zonal_gravity((x.r, 0.0, 0.0), (sin_phi, cos_phi, 0.0), p, xp)
    northward = pull_north - omega * omega * x.r * sin_phi * cos_phi
    return (
        x.w,
        east / (x.r * cos_phi),
        north / x.r,
        push * xp.cos(u.alpha) * xp.cos(u.beta) - x.u * x.w / x.r + x.v * east * tan_phi / x.r
        + 2 * omega * (x.v * sin_phi - x.w * cos_phi * sin_g) + northward * cos_g,
        push * xp.cos(u.alpha) * xp.sin(u.beta) - x.v * x.w / x.r - x.u * east * tan_phi / x.r
        + 2 * omega * (x.w * cos_phi * cos_g - x.u * sin_phi) + northward * sin_g,
        push * xp.sin(u.alpha) + (x.u * x.u + x.v * x.v) / x.r + pull_up
        + 2 * omega * east * cos_phi + omega * omega * x.r * cos_phi * cos_phi,
        mass_rate(u, p),
    )  # fmt: skip


def _spherical_start(p: Any, xp: Any) -> Sequence[Any]:
    """Peng et al. (20), (21)."""
    speeds = (p.start_forward_speed, p.start_sideways_speed, p.start_vertical_speed)
    return (p.body_radius + p.start_altitude, p.start_longitude, p.start_latitude, *speeds, p.vehicle_mass)


def _spherical_height(x: Any, p: Any) -> Any:
    return x.r - p.body_radius - p.site_altitude


def _spherical_at_site(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Peng et al. (22), (23)."""
    return _spherical_height(x, p), x.theta - p.site_longitude, x.phi - p.site_latitude, x.u, x.v, x.w


def _spherical_on_track(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    across = x.r * scalar_product(track_normal(p, xp), local_axes(x.theta, x.phi, xp)[0])
    return _spherical_height(x, p), across, x.u, x.v, x.w


def _spherical_anywhere(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    return _spherical_height(x, p), x.u, x.v, x.w


def _spherical_path(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    return (_spherical_height(x, p),)


def _spherical_outputs(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    speeds, acceleration = (x.u, x.v, x.w), descent_thrust(u, p) / x.m
    return (x.r - p.body_radius, x.theta, x.phi, *speeds, u.alpha, u.beta, acceleration)


def _spherical_vectors(x: Any, u: Any, p: Any, xp: Any) -> tuple[Any, Any, Any]:
    """Position, velocity and direction of the thrust along the axes that turn with the body."""
    up, oy, oz = heading_axes(x.theta, x.phi, p.start_heading, xp)
    level = xp.cos(u.alpha)
    direction = combine((xp.sin(u.alpha), up), (level * xp.cos(u.beta), oy), (level * xp.sin(u.beta), oz))
    return combine((x.r, up)), combine((x.u, oy), (x.v, oz), (x.w, up)), direction


def _spherical_spent(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    position, velocity, direction = _spherical_vectors(x, u, p, xp)
    return velocity_loss_rates(
        velocity, descent_thrust(u, p) / x.m, direction, apparent_gravity(position, AXIS, p, xp), xp
    )


def _spherical_inertial(x: Any, u: Any, t: Any, p: Any, xp: Any) -> Sequence[Any]:
    position, velocity, direction = _spherical_vectors(x, u, p, xp)
    return inertial_triples(position, velocity, combine((descent_thrust(u, p) / x.m, direction)), t, p, xp)


def _spherical_track(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    return descent_track(local_axes(x.theta, x.phi, xp)[0], x.r, p, xp)


def _spherical_end_guess(p: Any, xp: Any) -> Sequence[Any]:
    r, longitude, latitude = p.body_radius + p.site_altitude, *_likely_landing_place(p, xp)
    return (r, longitude, latitude, 0.0, 0.0, 0.0, 0.6 * p.vehicle_mass)


def _likely_landing_place(p: Any, xp: Any) -> tuple[Any, Any]:
    """Longitude and latitude of it, the longitude without a jump from that of the start."""
    if hasattr(p, "site_longitude"):
        return p.site_longitude, p.site_latitude
    x, y, z = likely_landing_point(p, xp)
    c, s = xp.cos(p.start_longitude), xp.sin(p.start_longitude)
    return p.start_longitude + xp.atan2(c * y - s * x, c * x + s * y), spherical_coordinates((x, y, z), xp)[2]


SPHERICAL = Coordinates(
    states=(
        *variables_of_unit("m", "r"),
        *variables_of_unit("rad", "theta", "phi"),
        *variables_of_unit("m/s", "u", "v", "w"),
    ),
    dynamics=_spherical_dynamics,
    start=_spherical_start,
    ends={
        "site": (
            _spherical_at_site,
            (
                TOUCHDOWN_HEIGHT,
                *variables_of_unit("rad", "site_longitude", "site_latitude"),
                *variables_of_unit("m/s", "rest_forward", "rest_sideways", "rest_vertical"),
            ),
        ),
        "downrange": (
            _spherical_on_track,
            (
                TOUCHDOWN_HEIGHT,
                *variables_of_unit("m", "cross_range"),
                *variables_of_unit("m/s", "rest_forward", "rest_sideways", "rest_vertical"),
            ),
        ),
        "anywhere": (
            _spherical_anywhere,
            (TOUCHDOWN_HEIGHT, *variables_of_unit("m/s", "rest_forward", "rest_sideways", "rest_vertical")),
        ),
    },
    path=_spherical_path,
    outputs=_spherical_outputs,
    spent=_spherical_spent,
    inertial=_spherical_inertial,
    track=_spherical_track,
    end_guess=_spherical_end_guess,
)
