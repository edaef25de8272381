"""Velocity change of a landing in one burn at full thrust, compared with that of coasting first.

An engine that is on all the way down at full thrust has to spend the time of the fall: it pushes down, and up again.
Who may coast takes two impulses, one where the orbit is highest so that the fall grazes the ground, and one there; from
an orbit that meets the ground he falls down to it, and stops in one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from perilune.models.physics.delta_v_bounds import exhaust_speed, greatest_thrust, speed_of_ground
from perilune.models.physics.rotating_frame import combine, cross_product, scalar_product
from perilune.problem import Finding

SPENDS = 1.5  # times the velocity change of impulses: more of one burn is worth a word
_ROUNDS = 12  # of the mean acceleration


def full_burn(speed: Any, sinking: Any, height: Any, p: Any, xp: Any) -> Any:
    """Return roughly the velocity change [m/s] of full thrust all the way to rest on the ground.

    Thrust acceleration a takes away the speed v evenly in the time t, gravity apart, and what it pushes up and down, b,
    comes down by the height h from a rate w: (b t)^2 - (4 h/t - 2 w) b t - w^2 = 0, (a t)^2 = v^2 + (b t)^2; a is the
    mean that the rocket equation gives.

    Parameters
    ----------
    speed, sinking, height
        Across the radius and downwards [m/s], and above the ground [m].
    p, xp
        Parameters with a vehicle, and the maths namespace.
    """
    exhaust = exhaust_speed(p)
    spent = xp.sqrt(speed * speed + sinking * sinking) + 1.0
    for _ in range(_ROUNDS):
        t = p.vehicle_mass * exhaust / greatest_thrust(p) * (1 - xp.exp(-spent / exhaust))
        half = 2 * height / t - sinking
        upwards = half + xp.sqrt(half * half + sinking * sinking)
        spent = xp.sqrt(spent * xp.sqrt(speed * speed + upwards * upwards))
    return spent


def one_burn_wastes(
    position: Sequence[Any], velocity: Sequence[Any], axis: Sequence[Any], r_site: Any, p: Any, xp: Any
) -> Finding:
    """Compare full thrust all the way with coasting first, to a place anywhere.

    Parameters
    ----------
    position, velocity, axis, r_site
        As for `delta_v_bounds.compare_stopping_distance`.
    p, xp
        Parameters of a descent, and the maths namespace.
    """
    mu, r = p.body_gravitational_parameter, xp.sqrt(scalar_product(position, position))
    inertial = combine((1.0, velocity), (p.body_rotation_rate, cross_product(axis, position)))
    square, rising = scalar_product(inertial, inertial), scalar_product(inertial, position) / r
    speed = xp.sqrt(xp.fmax(square - rising * rising, 0.0))
    semi, momentum = 1 / xp.fmax(2 / r - square / mu, 1e-9 / r), r * speed
    eccentricity = xp.sqrt(xp.fmax(1 - momentum * momentum / (mu * semi), 0.0))
    high, low = semi * (1 + eccentricity), semi * (1 - eccentricity)
    before, after = (xp.sqrt(mu * xp.fmax(2 / high - 2 / (high + q), 0.0)) for q in (low, r_site))
    clear = xp.fabs(before - after) + xp.sqrt(mu * xp.fmax(2 / r_site - 2 / (high + r_site), 0.0))
    fallen = xp.sqrt(square + 2 * mu * xp.fmax(1 / r_site - 1 / r, 0.0))
    ground = speed_of_ground(r_site, p, xp)  # whichever way it moves
    return Finding(
        name="velocity change of impulses", value=xp.where(low > r_site, clear, fallen) + ground,
        limit=full_burn(speed, xp.fmax(-rising, 0.0), r - r_site, p, xp) / SPENDS,
        at_least=True, unit="m/s", binding=False,
        meaning="coasting first, until the trajectory meets or grazes the ground, would need only this: full throttle"
        " all the"
        f" way down is one burn and needs more than {SPENDS:g} times as much",
        advice="throttle.lower = 0 and throttle.upper = 1, with which the engine may be off",
    )  # fmt: skip
