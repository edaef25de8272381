"""Velocity-change bounds that hold for every flight, whatever its steering: shared by the models' presolve checks.

No flight goes below the radius r_s of its site, and thrust never exceeds T, the greatest that the throttle allows.

*Speed.* Let w^2 = V^2 + 2 mu (1/r_s - 1/r) with the inertial speed V, so w >= V. Gravity of a point mass leaves w as it
is, and thrust acceleration a gives |w w'| <= a V <= a w. At rest on the ground w <= |omega| r_s. So the whole ideal
velocity change is at least w(start) - |omega| r_s, and the rocket equation turns it into mass. An impulsive burn lowers
w by at most its size.

*Touchdown* from above at rest needs r'' >= 0 there, so T/m_f >= mu/r_s^2 - omega^2 r_s.

*Stopping* a descent at radial speed -v, from the speed V_a across. In inertial axes r'' = V_h^2/r + a_r - mu/r^2, and r
V_h changes by r a_h at most (J2 apart, which adds to both). Whatever the throttle did before, a_r and a_h are at most
T/(m0 - q s) at the time s, q = T/c the greatest flow, as more mass is left wherever less was burnt. Until a time t let
L(s) = c log(m0/(m0 - q s)) <= L(t) s/t. While r_s <= r <= r(0),

    V_h <= (V_a + L(t) s/t) r(0)/r
    r'' <= T/(m0 - q s) - mu/r(0)^2 + (V_a + L(t) s/t)^2 r(0)^2/r_s^3
    r(t) <= Z(t) = r(0) - v t + c t - (m0 - q t) c/T L(t) - mu/r(0)^2 t^2/2
                   + (V_a^2/2 + V_a L(t)/3 + L(t)^2/12) t^2 r(0)^2/r_s^3

The bound of r'' increases with s, so that Z falls, and then rises if at all before t. Let Z(t) < r_s for any one t. As
long as Z falls no flight is at rest; then, or at t, it is below the site: there is no flight. Tried are t_b, 1.3 t_b
and so on, t_b = (m0/q) (1 - exp(-v/c)) being the time in which full thrust stops v without gravity. What thrust gives
across does not take from what it gives upwards here: the bound is sharp for steep descents only.

*A speed u that may be left on the ground.* With v - u for v, Z(t) + u t is compared with r_s. Until Z' = -u no flight
is slow enough, and there Z <= Z(t) + u t, so that it is below the site.

*Flat ground.* Under uniform gravity g, r is the height over the ground, the fall from it mu (1/r_s - 1/r) is g (r -
r_s), mu/r^2 is g, and what has r in its denominator otherwise is nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from perilune.models.physics.bodies import Body
from perilune.models.physics.rotating_frame import combine, cross_product, scalar_product
from perilune.problem import Finding

SLACK = 1.02  # of what the rocket equation allows, for J2, which the speed w leaves out
_TIMES = tuple(1.3**k for k in range(13))  # of t_b, for the stopping distance
_MOST_BURNT = 0.99
_SAME_ORBIT = 1e-6  # of the speed: what changes an orbit by less does not choose a place on it


def is_flat(p: Any) -> bool:
    """Return True if the ground is flat and gravity uniform: a radius is then the height over it."""
    return hasattr(p, "body_gravity")


def gravity_at(r: Any, p: Any) -> Any:
    """Gravity [m/s^2] of a sphere at a radius, or uniform gravity.

    Parameters
    ----------
    r
        Distance from the centre [m]; not used over flat ground.
    p
        Parameters [SI].
    """
    return p.body_gravity if is_flat(p) else p.body_gravitational_parameter / (r * r)


def _pull_of_j2(r_site: Any, p: Any, xp: Any) -> Any:
    """Return the most [m/s^2] that oblateness pulls above the site."""
    if not hasattr(p, "body_j2"):
        return 0.0
    r_ratio = p.body_radius / r_site
    return 3 * xp.fabs(p.body_j2) * gravity_at(r_site, p) * r_ratio * r_ratio


def _centrifugal(speed: Any, r: Any, p: Any) -> Any:
    """Return the centrifugal acceleration [m/s^2] of a horizontal speed where the ground is round."""
    return 0.0 if is_flat(p) else speed * speed / r


def greatest_thrust(p: Any) -> Any:
    """Thrust [N] at the upper bound of the throttle."""
    return p.vehicle_thrust * getattr(p, "throttle_upper", 1.0)


def exhaust_speed(p: Any) -> Any:
    """Exhaust speed [m/s] of the engine."""
    return p.vehicle_specific_impulse * p.vehicle_standard_gravity


def inertial_speed(position: Sequence[Any], velocity: Sequence[Any], axis: Sequence[Any], p: Any, xp: Any) -> Any:
    """Speed [m/s] in inertial axes, of a position from the centre and a velocity relative to the turning body.

    Parameters
    ----------
    position, velocity
        In axes that turn with the body [m, m/s], (3,) each.
    axis
        Unit vector of the rotation in them, (3,).
    p, xp
        Parameters [SI] and maths namespace.
    """
    seen = velocity if is_flat(p) else combine((1, velocity), (p.body_rotation_rate, cross_product(axis, position)))
    return xp.sqrt(scalar_product(seen, seen))


def speed_with_fall(speed: Any, r_start: Any, r_site: Any, p: Any, xp: Any) -> Any:
    """The speed w of the head of this file [m/s], which only thrust changes.

    Parameters
    ----------
    speed
        Inertial speed V at the start [m/s].
    r_start, r_site
        Radii of the start and of the site [m]; altitudes over flat ground.
    p, xp
        Parameters [SI] and maths namespace.
    """
    drop = r_start - r_site
    fall = p.body_gravity * drop if is_flat(p) else p.body_gravitational_parameter * (1 / r_site - 1 / r_start)
    return xp.sqrt(speed * speed + 2 * fall)


def speed_of_ground(r_site: Any, p: Any, xp: Any) -> Any:
    """Greatest inertial speed [m/s] of a place at rest on the ground.

    Parameters
    ----------
    r_site
        Radius of the site [m].
    p, xp
        Parameters [SI] and maths namespace.
    """
    return 0.0 if is_flat(p) else xp.fabs(p.body_rotation_rate) * r_site


def largest_mass_stopped(r_site: Any, p: Any, xp: Any) -> Any:
    """Largest mass [kg] that can come to rest on the ground from above, anywhere at this radius.

    Parameters
    ----------
    r_site
        Radius of the site [m].
    p, xp
        Parameters [SI] and maths namespace.
    """
    lifted = _centrifugal(speed_of_ground(r_site, p, xp), r_site, p)
    return greatest_thrust(p) / xp.fmax(gravity_at(r_site, p) - _pull_of_j2(r_site, p, xp) - lifted, 0.0)


def compare_thrust_and_weight(r_site: Any, p: Any) -> Finding:
    """Compare the thrust at ignition with the weight at the site: whether the vehicle could hover.

    Parameters
    ----------
    r_site
        Radius of the site [m].
    p
        Parameters [SI].
    """
    return Finding(
        name="thrust-to-weight ratio at ignition",
        value=greatest_thrust(p) / (p.vehicle_mass * gravity_at(r_site, p)),
        limit=1.0,
        at_least=True,
        unit="1",
        binding=False,
        meaning="the lander cannot hover when it ignites: it must brake while its speed still carries it",
    )


def compare_dry_mass(held: Any, p: Any) -> tuple[Finding, ...]:
    """Compare the dry mass with the largest mass [kg] that the engine can stop; empty where no dry mass is given.

    Parameters
    ----------
    held
        Largest mass that the engine can stop [kg].
    p
        Parameters [SI].
    """
    if not hasattr(p, "vehicle_dry_mass"):
        return ()
    return (
        Finding(
            name="landed mass that the thrust can hold",
            value=held,
            limit=p.vehicle_dry_mass,
            at_least=True,
            unit="kg",
            binding=True,
            meaning="even at its greatest throttle the engine cannot stop the descent of an empty vehicle",
            advice="more thrust, or a lighter vehicle",
        ),
    )


def compare_start_height(start: Any, site: Any) -> Finding:
    """Compare the altitudes [m] of start and site; a millimetre stands for "strictly above".

    Parameters
    ----------
    start, site
        Altitudes above the same zero [m].
    """
    return Finding(
        name="start above the site",
        value=start - site,
        limit=1e-3,
        at_least=True,
        unit="m",
        binding=True,
        meaning="the descent does not start above its site, and no flight of this model goes below the site",
        advice="a higher start, or a lower site",
    )


def compare_neglected_air(body: Body) -> tuple[Finding, ...]:
    """Warn about the air of a body that has some: no model here has drag, lift or heat."""
    if not body.surface_pressure:
        return ()
    return (
        Finding(
            name="atmospheric pressure at the surface",
            value=body.surface_pressure,
            limit=0.0,
            at_least=False,
            unit="Pa",
            binding=False,
            meaning=f"{body.display_name} has an atmosphere, which is neglected: the answer is that of an airless body",
            advice="use it only for the last part, where the lander is slow, and note that drag is neglected",
            lasting=True,
        ),
    )


def braking_distance_and_time(speed: Any, p: Any, xp: Any, lever: Any = 1.0) -> tuple[Any, Any]:
    """Distance [m] and time [s] to stop from `speed` by full thrust in free space, each push times a lever.

    Parameters
    ----------
    speed
        Speed that is braked [m/s].
    p, xp
        Parameters [SI] and maths namespace.
    lever
        Factor on the acceleration of the thrust [1].
    """
    tau = p.vehicle_mass * exhaust_speed(p) / greatest_thrust(p)
    exhaust = lever * exhaust_speed(p)
    time = tau * (1 - xp.exp(-speed / exhaust))
    return speed * tau - exhaust * time, time


def longest_burn(p: Any) -> Any:
    """Time [s] in which full thrust burns all propellant."""
    return (p.vehicle_mass - getattr(p, "vehicle_dry_mass", 0.0)) * exhaust_speed(p) / greatest_thrust(p)


def velocity_change(p: Any, xp: Any) -> Any:
    """Velocity change [m/s] that all propellant above the dry mass gives, by the rocket equation.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.
    """
    return exhaust_speed(p) * xp.log(p.vehicle_mass / p.vehicle_dry_mass)


def speed_to_lose(
    position: Sequence[Any], velocity: Sequence[Any], axis: Sequence[Any], r_site: Any, p: Any, xp: Any
) -> Any:
    """Return the least ideal velocity change [m/s] from a start to rest; arguments as `compare_stopping_distance`.

    Parameters
    ----------
    position, velocity, axis, r_site
        As in `compare_stopping_distance`.
    p, xp
        Parameters [SI] and maths namespace.
    """
    r = xp.sqrt(scalar_product(position, position))
    speed = inertial_speed(position, velocity, axis, p, xp)
    return speed_with_fall(speed, r, r_site, p, xp) - speed_of_ground(r_site, p, xp)


def compare_propellant(
    position: Sequence[Any], velocity: Sequence[Any], axis: Sequence[Any], r_site: Any, p: Any, xp: Any, left: Any = 0.0
) -> Finding:
    """Compare the speed to be removed with what the propellant gives; arguments as `compare_stopping_distance`.

    Parameters
    ----------
    position, velocity, axis, r_site
        As in `compare_stopping_distance`.
    p, xp
        Parameters [SI] and maths namespace.
    left
        Speed that may be left on the ground [m/s].
    """
    return Finding(
        name="speed to be removed",
        value=speed_to_lose(position, velocity, axis, r_site, p, xp) - left,
        limit=SLACK * velocity_change(p, xp),
        at_least=False,
        unit="m/s",
        binding=True,
        meaning="the propellant cannot remove the initial speed and the speed gained by falling to the site",
        advice="more propellant, a higher specific impulse, or a slower start",
    )


def compare_stopping_distance(
    position: Sequence[Any], velocity: Sequence[Any], axis: Sequence[Any], r_site: Any, p: Any, xp: Any, left: Any = 0.0
) -> Finding:
    """Compare the least stopping distance with the height above the site: the proof is at the head of this file.

    Parameters
    ----------
    position, velocity
        From the centre [m], and relative to the turning body [m/s], in axes that turn with it; over flat ground
        from the point under the vehicle.
    axis
        Unit vector of the rotation in them.
    r_site
        Radius of the site [m].
    p, xp
        Parameters [SI] and maths namespace.
    left
        Speed [m/s] straight down that may be left on the ground.
    """
    r = xp.sqrt(scalar_product(position, position))
    rising = scalar_product(position, velocity) / r
    speed = inertial_speed(position, velocity, axis, p, xp)
    across = xp.sqrt(xp.fmax(speed * speed - rising * rising, 0.0))
    return Finding(
        name="stopping distance at full thrust",
        value=_stopping_distance(xp.fmax(-rising - left, 0.0), across, r, r_site, p, xp),
        limit=r - r_site,
        at_least=False,
        unit="m",
        binding=True,
        meaning="the descent is too fast: even full thrust straight up cannot stop it above the site",
        advice="a slower or higher start, or more thrust",
    )


def _stopping_distance(down: Any, across: Any, r: Any, r_site: Any, p: Any, xp: Any) -> Any:
    """Return the least way [m] in which a fall ends, the greatest r(0) - Z of the head of this file."""
    exhaust = exhaust_speed(p)
    tau = p.vehicle_mass * exhaust / greatest_thrust(p)
    oblate = _pull_of_j2(r_site, p, xp)
    pull, round_ground = gravity_at(r, p) - oblate, 0.0 if is_flat(p) else r * r / (r_site * r_site * r_site)
    stop, longest = 1 - xp.exp(-down / exhaust), 0.0
    for times in _TIMES:
        burnt = xp.fmin(times * stop, _MOST_BURNT)  # part of the mass
        gained, t = -exhaust * xp.log(1 - burnt), burnt * tau
        side = gained + oblate * t
        lifted = round_ground * (across * across / 2 + across * side / 3 + side * side / 12)
        lost = down * t - exhaust * t + (tau - t) * gained
        longest = xp.fmax(longest, lost + (0.5 * pull - lifted) * t * t)
    return longest


def compare_late_ignition(position: Any, velocity: Any, p: Any, xp: Any) -> Finding:
    """Compare what the place and the time of the first burn change with nothing, for a landing anywhere.

    On a circular orbit over a sphere that does not turn every place is as good as every other, so that a flight that
    may coast first may do so for any time at no cost: the best flights are a continuum, and none is strictly the best.

    Parameters
    ----------
    position, velocity
        Where the flight begins, relative to the body [m, m/s].
    p, xp
        Parameters of a descent whose throttle has bounds, and the maths namespace.

    Returns
    -------
    Finding
        The eccentricity, the speed of the ground over that of the orbit, and the least throttle, added up.
    """
    mu, square = p.body_gravitational_parameter, scalar_product(velocity, velocity)
    r, rising = xp.sqrt(scalar_product(position, position)), scalar_product(position, velocity)
    apse = [((square - mu / r) * place - rising * rate) / mu for place, rate in zip(position, velocity, strict=True)]
    ground = xp.fabs(p.body_rotation_rate) * r / xp.sqrt(mu / r)
    return Finding(
        name="cost of a later ignition",
        value=xp.sqrt(scalar_product(apse, apse))
        + ground
        + xp.fabs(p.throttle_lower)
        + xp.fabs(getattr(p, "body_j2", 0.0)),
        limit=_SAME_ORBIT,
        at_least=True,
        unit="1",
        binding=False,
        meaning="the orbit is circular, the body does not rotate, and any place is allowed: equally good flights"
        " ignite later, so that none is strictly optimal, and local optimality (level 3) cannot be proved",
        advice="any of them may be flown; a site, a rotating body, or a non-circular orbit selects one",
        lasting=True,
    )
