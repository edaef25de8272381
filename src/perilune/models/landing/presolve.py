"""Feasibility checks of a landing from perilune, before it is solved.

The bounds of `perilune.models.physics.delta_v_bounds` are compared with the least mass that must land. An ideal
vehicle can burn all of its mass, so without such a mass nothing is fatal. It is `vehicle_dry_mass` where that is given,
and else 10 % of the mass: that much propellant is found in the first stages of launchers, which do not carry it to
another body. As this is our judgement and no fact of the scenario, less is only warned of; stating the dry mass makes
it one.
"""

from __future__ import annotations

import math
from typing import Any

from perilune.models.physics.bodies import MOON, Body
from perilune.models.physics.delta_v_bounds import (
    braking_distance_and_time,
    compare_neglected_air,
    compare_thrust_and_weight,
    exhaust_speed,
    largest_mass_stopped,
    speed_of_ground,
    speed_with_fall,
)
from perilune.models.physics.one_burn import SPENDS, full_burn
from perilune.problem import Finding

LEAST_LANDED_SHARE = 0.1


def perilune_speed(p: Any, xp: Any) -> Any:
    """Inertial speed at the perilune of the Hohmann transfer, Cho et al. (7). `p` as in `hybrid_landing`.

    Parameters
    ----------
    p, xp
        Parameters as in `hybrid_landing` [SI], and maths namespace.

    Returns
    -------
    Any
        In m/s.
    """
    r0 = p.body_radius + p.orbit_perilune_altitude
    r_parking = p.body_radius + p.orbit_parking_altitude
    return xp.sqrt(p.body_gravitational_parameter * (2 / r0 - 2 / (r0 + r_parking)))


def compare_landing(p: Any, xp: Any, body: Body = MOON) -> tuple[Finding, ...]:
    """Return every comparison of a landing from perilune, for `Problem.preflight`.

    Parameters
    ----------
    p, xp
        Parameters as in `hybrid_landing` [SI], and maths namespace.
    body
        Body of the landing, whose air the model neglects.
    """
    return (
        *_compare_altitudes(p),
        *_compare_burns(p, xp),
        *_compare_unusual_values(p, xp),
        *compare_neglected_air(body),
    )


def _compare_altitudes(p: Any) -> tuple[Finding, ...]:
    """Comparisons of the three altitudes above the body's radius, all binding."""

    def at_least(name: str, value: Any, limit: float, meaning: str, advice: str) -> Finding:
        return Finding(
            name=name, value=value, limit=limit, at_least=True, unit="m", binding=True, meaning=meaning, advice=advice
        )

    perilune, parking, site = p.orbit_perilune_altitude, p.orbit_parking_altitude, p.landing_altitude
    # A millimetre stands for "strictly above".
    return (
        at_least(
            "height of the perilune above the surface", perilune, 1e-3,
            "the perilune lies below the surface: the orbit hits the ground", "raise orbit.perilune_altitude",
        ),
        at_least(
            "height of the perilune above the landing site", perilune - site, 1e-3,
            "the perilune lies below the landing site: the orbit hits the ground",
            "raise orbit.perilune_altitude or lower landing.altitude",
        ),
        at_least(
            "height of the parking orbit above the perilune", parking - perilune, 0.0,
            "the perilune lies above the parking orbit", "exchange the two, or check for km in place of m",
        ),
    )  # fmt: skip


def _compare_burns(p: Any, xp: Any) -> tuple[Finding, ...]:
    """Comparisons of velocity changes and masses, binding but for those with an assumed mass."""
    speed, stated = perilune_speed(p, xp), hasattr(p, "vehicle_dry_mass")
    least, said = p.vehicle_dry_mass if stated else LEAST_LANDED_SHARE * p.vehicle_mass, "vehicle.dry_mass"
    if not stated:
        said = f"{LEAST_LANDED_SHARE:.0%} of vehicle.mass (assumed: no vehicle.dry_mass is stated)"
    found = []
    if hasattr(p, "retro_delta_v"):
        impulsive = p.retro_specific_impulse * p.vehicle_standard_gravity
        # Whatever follows, the impulsive burn alone must leave the least mass.
        for limit, meaning, binding in (
            (speed, "the retro burn exceeds the speed at the perilune: the lander would fly backwards", True),
            (impulsive * xp.log(p.vehicle_mass / least),
             f"the retro burn needs more propellant than there is above {said}", stated),
        ):  # fmt: skip
            found.append(
                Finding(
                    name="retro.delta_v",
                    value=p.retro_delta_v,
                    limit=limit,
                    at_least=False,
                    unit="m/s",
                    binding=binding,
                    lasting=not binding,
                    meaning=meaning,
                    advice="lower retro.delta_v, or omit it to have it optimised",
                )
            )
    for name, value, meaning, advice in (
        (
            "landed mass that the thrust can hold", largest_mass_stopped(p.body_radius + p.landing_altitude, p, xp),
            f"the engine is too weak: its thrust cannot carry {said} at touchdown",
            "raise vehicle.thrust, lower vehicle.mass, or state the mass that must land as vehicle.dry_mass",
        ),
        (
            "landed mass by the rocket equation", _mass_by_rocket_equation(p, xp, speed),
            f"there is not enough propellant: even an ideal landing leaves less than {said}",
            "raise the specific impulse, or state the mass that must land as vehicle.dry_mass",
        ),
    ):  # fmt: skip
        found.append(
            Finding(
                name=name,
                value=value,
                limit=least,
                at_least=True,
                unit="kg",
                binding=stated,
                lasting=not stated,
                meaning=meaning,
                advice=advice,
            )
        )
    return tuple(found)


def _mass_by_rocket_equation(p: Any, xp: Any, speed: Any) -> Any:
    """Upper bound of the landed mass [kg] from the least ideal velocity change."""
    r_site, r_start = p.body_radius + p.landing_altitude, p.body_radius + p.orbit_perilune_altitude
    ground = speed_of_ground(r_site, p, xp)
    main, impulsive = exhaust_speed(p), p.retro_specific_impulse * p.vehicle_standard_gravity
    if not hasattr(p, "retro_delta_v"):
        change = xp.fmax(speed_with_fall(speed, r_start, r_site, p, xp) - ground, 0.0)
        return p.vehicle_mass * xp.exp(-change / xp.fmax(main, impulsive))
    rest = xp.fmax(speed_with_fall(speed - p.retro_delta_v, r_start, r_site, p, xp) - ground, 0.0)
    return p.vehicle_mass * xp.exp(-p.retro_delta_v / impulsive - rest / main)


def _compare_unusual_values(p: Any, xp: Any) -> tuple[Finding, ...]:
    """Comparisons that make a landing hard or look like a slip, none binding."""

    def at_most(name: str, unit: str, value: Any, limit: Any, meaning: str, advice: str) -> Finding:
        return Finding(
            name=name, value=value, limit=limit, at_least=False, unit=unit, binding=False, meaning=meaning,
            advice=advice,
        )  # fmt: skip

    r = p.body_radius + p.landing_altitude
    return (
        compare_thrust_and_weight(r, p),
        at_most(
            "mass after braking",
            "kg",
            _mass_by_rocket_equation(p, xp, perilune_speed(p, xp)),
            largest_mass_stopped(r, p, xp),
            "braking by itself leaves the lander heavier than its thrust can hold: it must burn the rest before it can"
            " descend, and the optimal flight may follow the ground, which is hard to solve",
            "lower vehicle.mass, raise vehicle.thrust",
        ),
        at_most(
            "braking distance without gravity",
            "km",
            braking_distance_and_time(perilune_speed(p, xp), p, xp)[0] / 1e3,
            math.pi * p.body_radius / 1e3,
            "braking takes more than half a revolution: expect a long spiral that is hard to solve",
            "raise vehicle.thrust",
        ),
        at_most(
            "speed of the ground",
            "m/s",
            speed_of_ground(r, p, xp),
            0.1 * xp.sqrt(p.body_gravitational_parameter / r),
            "the ground moves at more than a tenth of orbital speed",
            "check that body.rotation_rate is in rad/s and not in deg/s",
        ),
        at_most(
            "perilune altitude",
            "km",
            p.orbit_perilune_altitude / 1e3,
            0.2 * p.body_radius / 1e3,
            "the perilune is very high for a landing",
            "altitudes are above the surface, not distances from the centre",
        ),
        Finding(
            name="velocity change of two impulses",
            value=two_impulse_velocity_change(p, xp),
            limit=one_burn_velocity_change(p, xp) / SPENDS,
            at_least=True,
            unit="m/s",
            binding=False,
            meaning="coasting first, until the trajectory grazes the ground, would need only this: full throttle from"
            " the"
            f" perilune to the ground is one burn and needs more than {SPENDS:g} times as much",
            advice="a perilune next to the ground; or the kind powered_descent with throttle.lower = 0, which coasts",
        ),
    )


def one_burn_velocity_change(p: Any, xp: Any) -> Any:
    """Return roughly the velocity change [m/s] of full thrust from the perilune to rest on the ground.

    Parameters
    ----------
    p, xp
        As in `hybrid_landing`, and the maths namespace.
    """
    speed = xp.fmax(perilune_speed(p, xp) - getattr(p, "retro_delta_v", 0.0), 1.0)
    return full_burn(speed, 0.0, p.orbit_perilune_altitude - p.landing_altitude, p, xp)


def two_impulse_velocity_change(p: Any, xp: Any) -> Any:
    """Return the velocity change [m/s] of two impulses from the orbit of the perilune.

    The first where it is highest, so that the fall grazes the ground half a turn later; the second stops there.

    Parameters
    ----------
    p, xp
        As in `hybrid_landing`, and the maths namespace.
    """
    mu, ground = p.body_gravitational_parameter, p.body_radius + p.landing_altitude
    high, low = p.body_radius + p.orbit_parking_altitude, p.body_radius + p.orbit_perilune_altitude
    before, after = (xp.sqrt(mu * xp.fmax(2 / high - 2 / (high + r), 0.0)) for r in (low, ground))
    return (
        before - after + xp.sqrt(mu * xp.fmax(2 / ground - 2 / (high + ground), 0.0)) - speed_of_ground(ground, p, xp)
    )
