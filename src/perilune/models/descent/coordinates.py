"""Coordinate systems of a powered descent, two of them: functions of state, control and parameters.

Both turn with the body, and velocities are relative to it (Peng, Li, Shen, Tang 2012, section 4):

*Cartesian*: position and velocity along fixed axes, z the axis of rotation; thrust a free `Direction`. No
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

from perilune.core.arrays import Physics
from perilune.models.physics.delta_v_bounds import braking_distance_and_time
from perilune.models.physics.delta_v_budget import velocity_loss_rates
from perilune.models.physics.rotating_frame import (
    apparent_gravity,
    combine,
    cross_product,
    free_acceleration,
    heading_axes,
    inertial_triples,
    local_axes,
    scalar_product,
    spherical_coordinates,
    zonal_gravity,
)
from perilune.problem.variables import Variable

AXIS = (0.0, 0.0, 1.0)  # of the rotation, in the Cartesian frame


# -- what both coordinate systems share
# -------------------------------------------------------------------------------


def descent_thrust(u: Any, p: Any) -> Any:
    """Thrust [N]: constant, or throttled where `throttle` is a control."""
    return p.vehicle_thrust * getattr(u, "throttle", 1.0)


def mass_rate(u: Any, p: Any) -> Any:
    """Rate of the mass [kg/s]."""
    return -descent_thrust(u, p) / (p.vehicle_specific_impulse * p.vehicle_standard_gravity)


def _axes_at_start(p: Any, xp: Any) -> Any:
    return heading_axes(p.start_longitude, p.start_latitude, p.start_heading, xp)


def _site_position(p: Any, xp: Any) -> Any:
    return combine((p.body_radius + p.site_altitude, local_axes(p.site_longitude, p.site_latitude, xp)[0]))


def _likely_landing(p: Any, xp: Any) -> Any:
    """Site, or where none is stated a place ahead of the start, as far as full thrust stops the speed over ground."""
    if hasattr(p, "site_longitude"):
        return _site_position(p, xp)
    up, oy, oz = _axes_at_start(p, xp)
    r_site = p.body_radius + p.site_altitude
    _, time = braking_distance_and_time(xp.sqrt(p.start_forward_speed**2 + p.start_sideways_speed**2), p, xp)
    ahead = combine((r_site, up), (0.5 * time * p.start_forward_speed, oy), (0.5 * time * p.start_sideways_speed, oz))
    return combine((r_site / xp.sqrt(scalar_product(ahead, ahead)), ahead))


def _track_normal(p: Any, xp: Any) -> Any:
    """Return the unit normal of the great circle from the point under the start to the site."""
    normal = cross_product(_axes_at_start(p, xp)[0], local_axes(p.site_longitude, p.site_latitude, xp)[0])
    return combine((1 / xp.sqrt(scalar_product(normal, normal)), normal))


def _descent_track(above: Any, r: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Arc over the ground along the great circle of the first heading, arc to the left of it, height.

    No pole disturbs it. `above` is the unit vector to the vehicle.
    """
    up, oy, oz = _axes_at_start(p, xp)
    along, across = xp.atan2(scalar_product(above, oy), scalar_product(above, up)), xp.asin(scalar_product(above, oz))
    return p.body_radius * along, p.body_radius * across, r - p.body_radius


def _descent_outputs(position: Any, velocity: Any, direction: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Return all of `OUTPUTS` but the last."""
    r, longitude, latitude = spherical_coordinates(position, xp)
    up, oy, oz = heading_axes(longitude, latitude, p.start_heading, xp)
    return (
        r - p.body_radius,
        longitude,
        latitude,
        scalar_product(velocity, oy),
        scalar_product(velocity, oz),
        scalar_product(velocity, up),
        *_elevation_and_azimuth(direction, (up, oy, oz), xp),
    )


def _elevation_and_azimuth(direction: Any, axes: Any, xp: Any) -> tuple[Any, Any]:
    """Elevation and azimuth, the latter counted from straight retro: it jumps for pro-grade thrust only."""
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


def _cartesian_dynamics(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    velocity = (x.vx, x.vy, x.vz)
    acceleration = combine(
        (1, free_acceleration((x.x, x.y, x.z), velocity, AXIS, p, xp)),
        (descent_thrust(u, p) / x.m, (u.toward_x, u.toward_y, u.toward_z)),
    )
    return (*velocity, *acceleration, mass_rate(u, p))


def _cartesian_start(p: Any, xp: Any) -> Sequence[Any]:
    up, oy, oz = _axes_at_start(p, xp)
    position = combine((p.body_radius + p.start_altitude, up))
    velocity = combine((p.start_forward_speed, oy), (p.start_sideways_speed, oz), (p.start_vertical_speed, up))
    return (*position, *velocity, p.vehicle_mass)


def _cartesian_at_site(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    site = _site_position(p, xp)
    return x.x - site[0], x.y - site[1], x.z - site[2], x.vx, x.vy, x.vz


def _cartesian_on_track(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    return _cartesian_height(x, p, xp), scalar_product(_track_normal(p, xp), (x.x, x.y, x.z)), x.vx, x.vy, x.vz


def _cartesian_anywhere(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    return _cartesian_height(x, p, xp), x.vx, x.vy, x.vz


def _cartesian_height(x: Any, p: Any, xp: Any) -> Any:
    return xp.sqrt(x.x * x.x + x.y * x.y + x.z * x.z) - p.body_radius - p.site_altitude


def _cartesian_path(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    return (_cartesian_height(x, p, xp),)


def steered_path(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Height, and the margins of elevation and azimuth to their bounds, Peng et al. (24).

    Those of the elevation are differences of sines, linear in the direction, which the indirect method can hold.
    """
    r = xp.sqrt(x.x * x.x + x.y * x.y + x.z * x.z)
    upward = scalar_product((x.x, x.y, x.z), (u.toward_x, u.toward_y, u.toward_z)) / r
    _, longitude, latitude = spherical_coordinates((x.x, x.y, x.z), xp)
    axes = heading_axes(longitude, latitude, p.start_heading, xp)
    _, azimuth = _elevation_and_azimuth((u.toward_x, u.toward_y, u.toward_z), axes, xp)
    return (
        _cartesian_height(x, p, xp),
        upward - xp.sin(p.steering_elevation_lower), xp.sin(p.steering_elevation_upper) - upward,
        azimuth - p.steering_azimuth_lower, p.steering_azimuth_upper - azimuth,
    )  # fmt: skip


def _cartesian_outputs(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    seen = _descent_outputs((x.x, x.y, x.z), (x.vx, x.vy, x.vz), (u.toward_x, u.toward_y, u.toward_z), p, xp)
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
    return _descent_track(combine((1 / r, (x.x, x.y, x.z))), r, p, xp)


def _cartesian_typical_end(p: Any, xp: Any) -> Sequence[Any]:
    return (*_likely_landing(p, xp), 0.0, 0.0, 0.0, 0.6 * p.vehicle_mass)


# -- spherical
# --------------------------------------------------------------------------------------------------------


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
    across = x.r * scalar_product(_track_normal(p, xp), local_axes(x.theta, x.phi, xp)[0])
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
    return _descent_track(local_axes(x.theta, x.phi, xp)[0], x.r, p, xp)


def _spherical_typical_end(p: Any, xp: Any) -> Sequence[Any]:
    r, longitude, latitude = p.body_radius + p.site_altitude, *_likely_landing_place(p, xp)
    return (r, longitude, latitude, 0.0, 0.0, 0.0, 0.6 * p.vehicle_mass)


def _likely_landing_place(p: Any, xp: Any) -> tuple[Any, Any]:
    """Longitude and latitude of it, the longitude without a jump from that of the start."""
    if hasattr(p, "site_longitude"):
        return p.site_longitude, p.site_latitude
    x, y, z = _likely_landing(p, xp)
    c, s = xp.cos(p.start_longitude), xp.sin(p.start_longitude)
    return p.start_longitude + xp.atan2(c * y - s * x, c * x + s * y), spherical_coordinates((x, y, z), xp)[2]


# -- the two records
# --------------------------------------------------------------------------------------------------


def variables_of_unit(unit: str, *names: str) -> tuple[Variable, ...]:
    """Variables of one unit."""
    return tuple(Variable(name=name, unit=unit) for name in names)


_HEIGHT = Variable(name="touchdown_height", unit="m")


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
    typical_end: Physics


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
            (_HEIGHT, *variables_of_unit("m", "cross_range"), *variables_of_unit("m/s", "rest_x", "rest_y", "rest_z")),
        ),
        "anywhere": (_cartesian_anywhere, (_HEIGHT, *variables_of_unit("m/s", "rest_x", "rest_y", "rest_z"))),
    },
    path=_cartesian_path,
    outputs=_cartesian_outputs,
    spent=_cartesian_spent,
    inertial=_cartesian_inertial,
    track=_cartesian_track,
    typical_end=_cartesian_typical_end,
)
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
                _HEIGHT,
                *variables_of_unit("rad", "site_longitude", "site_latitude"),
                *variables_of_unit("m/s", "rest_forward", "rest_sideways", "rest_vertical"),
            ),
        ),
        "downrange": (
            _spherical_on_track,
            (
                _HEIGHT,
                *variables_of_unit("m", "cross_range"),
                *variables_of_unit("m/s", "rest_forward", "rest_sideways", "rest_vertical"),
            ),
        ),
        "anywhere": (
            _spherical_anywhere,
            (_HEIGHT, *variables_of_unit("m/s", "rest_forward", "rest_sideways", "rest_vertical")),
        ),
    },
    path=_spherical_path,
    outputs=_spherical_outputs,
    spent=_spherical_spent,
    inertial=_spherical_inertial,
    track=_spherical_track,
    typical_end=_spherical_typical_end,
)
