"""Bounds on speed and angle at the interface for a velocity change, of one burn or many, wherever it thrusts.

A flight about a round body has at any time the energy E and the angular momentum h, and with r_a the radius of the
interface

    V = sqrt(2 (E + mu/r_a)),   w = h/r_a,   c = w/V

which at the interface itself are its speed, its speed along the horizon, and the cosine of its path angle. Thrust
changes E by v.dV, and above the interface v <= V; so **V changes by no more than the velocity change**. It changes
-ln c by no more than its gradient there, of the length

    sqrt((r/r_a)^2/c^2 - 1 - D/V^2)/V,     D = 2 mu (1/r_a - 1/r)

which grows with r. One burn at full thrust does not rise far meanwhile: what each part of it gives moves the vehicle
within the time t that is left by no more than dV t (1 + n t) (Clohessy and Wiltshire's equations), and never beyond
what its energy allows. The integral over the velocity change bounds the **path angle**, at 1.3 to 1.5 times what an
impulse against the velocity gives. Oblateness, which moves the height by kilometres and tilts the path by some J2, and
the turning of the body, relative to which angles are given, are added.
"""

from __future__ import annotations

from typing import Any

from perilune.models.deorbit.records import engine_exhaust_speed, total_velocity_change
from perilune.models.deorbit.site_passes import apsis_radii, largest_plane_turn

_LEAST_SLACK = 25e3  # m
_OBLATE = 3.5  # times J2 and the radius
_SURELY = 1.2  # times what linear equations say of a path that is bent
_STEPS = 60
_TILTS = 3.0  # times J2, by which oblateness tilts a path
_LEAST = 0.02  # of a speed or a cosine: what comes below may be anything
_NOTHING = 1e-9  # of full thrust
_STEEP = 20.0  # -ln c of a path that is as good as vertical


def oblateness_height_shift(p: Any, xp: Any) -> Any:
    """Return how far [m] oblateness and the ellipsoid move the height of a flight within a turn.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.
    """
    return xp.fmax(_OBLATE * xp.fabs(p.body_j2) * p.body_radius, _LEAST_SLACK)


def gate_radius(p: Any) -> Any:
    """Least distance [m] of the interface from the centre."""
    return p.body_radius * (1 - getattr(p, "body_flattening", 0.0)) + p.interface_altitude


def interface_speeds(p: Any, xp: Any) -> tuple[Any, Any]:
    """Return the least and the greatest speed [m/s] relative to the body at the interface.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.
    """
    gate, change = gate_radius(p), total_velocity_change(p, xp)
    speed, turning = orbital_speed_at(p, xp, gate), p.body_rotation_rate * gate
    # The body turns below the plane of the orbit, which the velocity change tilts.
    beside, size = speed - turning * xp.cos(p.orbit_inclination), xp.fabs(turning)
    tilt = size * (xp.fmin(largest_plane_turn(p, change, xp), 2.0) + size / speed) + _TILTS * xp.fabs(p.body_j2) * speed
    # With the height that is not known to better than the slack goes a speed.
    loose = tilt + p.body_gravitational_parameter * oblateness_height_shift(p, xp) / (gate * gate * speed)
    return xp.fmax(beside - change - loose, 0.0), beside + change + loose


def steepest_angle(p: Any, xp: Any) -> Any:
    """Return the steepest path angle [rad] relative to the body at the interface, positive below the horizon.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.
    """
    low, high = apsis_radii(p)
    mu, gate, change = (
        p.body_gravitational_parameter,
        gate_radius(p) - oblateness_height_shift(p, xp),
        total_velocity_change(p, xp),
    )
    speed = orbital_speed_at(p, xp, gate)
    flat = xp.log(speed * gate / xp.sqrt(2 * mu * low * high / (low + high)))  # -ln c
    step = change / _STEPS
    for k in range(1, _STEPS + 1):
        slow, fast = xp.fmax(speed - k * step, _LEAST * speed), speed + k * step
        far = oblateness_height_shift(p, xp) + xp.fmin(
            high + largest_altitude_change(p, xp, k * step),
            mu / xp.fmax(mu / gate - fast * fast / 2, _LEAST * mu / gate),
        )
        gained = 2 * mu * (1 / gate - 1 / far)
        ahead = flat
        for _ in range(2):  # the gradient at the end of a step is the greatest of it
            grown = xp.exp(2 * xp.fmin(ahead, _STEEP)) * (far / gate) * (far / gate) - 1 - gained / (fast * fast)
            ahead = flat + step / slow * xp.sqrt(xp.fmax(grown, 0.0))
        flat = ahead
    cosine = xp.exp(-xp.fmin(xp.fmax(flat, 0.0), _STEEP))
    level = xp.fmax(speed - change, _LEAST * speed)
    carried = xp.fabs(p.body_rotation_rate) * gate
    down = level * xp.sqrt(xp.fmax(1 - cosine * cosine, 0.0))
    tilt = xp.fabs(p.body_j2) * _TILTS
    return xp.atan2(down, xp.fmax(level * cosine - carried, _LEAST * level * cosine)) + tilt


def largest_altitude_change(p: Any, xp: Any, change: Any) -> Any:
    """Return the most [m] that a burn of a velocity change [m/s] raises or lowers the vehicle by its end.

    A burn lasts longest at its least thrust, without bound where that is zero.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.
    change
        Velocity change of the burn [m/s].
    """
    low, _ = apsis_radii(p)
    least = p.vehicle_thrust * xp.fmax(getattr(p, "throttle_lower", 1.0), _NOTHING)
    ratio = xp.exp(change / engine_exhaust_speed(p))
    lasts = p.vehicle_mass * (1 - 1 / ratio) * engine_exhaust_speed(p) / least
    straight = engine_exhaust_speed(p) * lasts * (1 - xp.log(ratio) / (ratio - 1))
    return _SURELY * straight * (1 + lasts * xp.sqrt(p.body_gravitational_parameter / (low * low * low)))


def orbital_speed_at(p: Any, xp: Any, gate: Any) -> Any:
    """Return the inertial speed [m/s] of the orbit's energy at a distance.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.
    gate
        Distance from the centre [m].
    """
    low, high = apsis_radii(p)
    return xp.sqrt(2 * p.body_gravitational_parameter * (1 / gate - 1 / (low + high)))
