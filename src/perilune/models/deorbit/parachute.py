"""Descent below a parachute: steady, at the speed at which its drag on the drag area S holds the weight.

    rho V^2 S/2 = m |g|,   r' = g sqrt(2 m/(rho S |g|)),   g with the centrifugal acceleration

in air that turns with the body. The velocity is no state: below a parachute it follows the forces within V/g, seconds,
and what a costate of it grows by, exp(2 g t/V) over t, is 1e100 and more in a descent of minutes, which no shooting
bears and no costate needs. So the seconds are left out in which the parachute opens and slows the vehicle, along some
lengths 2 m/(rho S); with them the Coriolis acceleration (a metre on the ground), and the change of V with the height
(a part V^2/(2 g H) of it, a thousandth).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import NUMERIC
from perilune.models.deorbit import dynamics as flight, outputs as told
from perilune.models.deorbit.orbit import AXIS
from perilune.models.landing.problem import mass_state
from perilune.models.physics import ellipsoid
from perilune.models.physics.atmosphere import Air
from perilune.models.physics.rotating_frame import Triple, apparent_gravity, combine, scalar_product
from perilune.problem import Conditions, Phase, Quantities, Variable


def sinking_velocity(x: Any, p: Any, xp: Any, *, air: Air) -> Triple:
    """Steady velocity [m/s] relative to the turning body.

    Parameters
    ----------
    x
        State [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.
    air
        Density of the air against altitude.

    Returns
    -------
    Triple
        Along the apparent gravity, (3,).
    """
    pull = apparent_gravity(flight.position_vector(x), AXIS, p, xp)
    density = air.density(ellipsoid.altitude(flight.position_vector(x), p, xp), p, xp)
    return combine((xp.sqrt(2 * x.m / (density * p.parachute_drag_area * xp.sqrt(scalar_product(pull, pull)))), pull))


def with_steady_velocity(x: Any, p: Any, xp: Any, *, air: Air) -> Any:
    """The state with its velocity.

    Parameters
    ----------
    x
        State without a velocity [SI].
    p, xp
        Parameters [SI] and maths namespace.
    air
        Density of the air against altitude.

    Returns
    -------
    Any
        Record with vx, vy, vz [m/s] as well.
    """
    vx, vy, vz = sinking_velocity(x, p, xp, air=air)
    return SimpleNamespace(**x._asdict(), vx=vx, vy=vy, vz=vz)


def sinking_rates(x: Any, u: Any, p: Any, xp: Any, *, air: Air) -> Sequence[Any]:
    """Rates: x, y, z, m, and the heat load and the whole mass where they are states.

    Parameters
    ----------
    x, u
        State without a velocity [SI], and the control, of which there is none.
    p, xp
        Parameters [SI] and maths namespace.
    air
        Density of the air against altitude.

    Returns
    -------
    Sequence[Any]
        In m/s for the position, and 0 for all else.
    """
    return *sinking_velocity(x, p, xp, air=air), *(0.0 for _ in x._fields[3:])


def parachute_link(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Link from the entry: all but the velocity.

    Parameters
    ----------
    x
        State at the end of the entry [SI].
    p, xp
        Parameters [SI] and maths namespace.
    """
    return tuple(value for name, value in zip(x._fields, x, strict=True) if name not in ("vx", "vy", "vz"))


def parachute_outputs(x: Any, u: Any, p: Any, xp: Any, *, air: Air) -> Sequence[Any]:
    """Values of `outputs.PLACED` without the path angle, which is nearly straight down.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.
    air
        Density of the air against altitude.
    """
    return told.position_outputs(with_steady_velocity(x, p, xp, air=air), u, p, xp)[:-1]


def inertial_descent(x: Any, u: Any, t: Any, p: Any, xp: Any, *, air: Air) -> Sequence[Any]:
    """`perilune.problem.phase.Phase.inertial`.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    t
        Time from the begin of the flight [s].
    p, xp
        Parameters [SI] and maths namespace.
    air
        Density of the air against altitude.

    Returns
    -------
    Sequence[Any]
        Position [m], velocity [m/s] and an acceleration of 0 [m/s^2] in inertial axes, (9,).
    """
    return told.inertial_without_thrust(with_steady_velocity(x, p, xp, air=air), u, t, p, xp)


def parachute_results(first: Any, last: Any, p: Any, xp: Any, *, names: Sequence[str], air: Air) -> Sequence[Any]:
    """`outputs.return_results` of a flight that ends below a parachute.

    Parameters
    ----------
    first, last
        States at t = 0 and at the end [SI], the last without a velocity.
    p, xp
        Parameters [SI] and maths namespace.
    names
        Phases in order of flight.
    air
        Density of the air against altitude.
    """
    return told.return_results(first, with_steady_velocity(last, p, xp, air=air), p, xp, names=names)


def parachute_phase(air: Air, *, kept: tuple[Variable, ...], placed_: bool) -> Phase:
    """Return the phase from the opening to the altitude of the site, with the states kept in addition to the motion.

    Parameters
    ----------
    air
        Density of the air against altitude.
    kept
        States in addition to the motion: heat load, mass of the whole vehicle.
    placed_
        Let it end at a place rather than at an altitude.
    """
    names = flight.SITE if placed_ else flight.SITE[:1]
    return Phase(
        name="parachute",
        states=(*flight.STATES[:3], mass_state(False), *kept),
        dynamics=partial(sinking_rates, air=air),
        duration="parachute_time",
        end=Conditions(flight.offset_from_site, *(Variable(name=name, unit="m") for name in names)),
        outputs=Quantities(partial(parachute_outputs, air=air), *told.PLACED[:-1]),
        inertial=partial(inertial_descent, air=air),
    )


def typical_parachute_time(p: Any, air: Air) -> float:
    """Return a typical time [s] from the opening to the altitude of the site.

    Parameters
    ----------
    p
        Parameters [SI].
    air
        Density of the air against altitude.
    """
    from scipy.integrate import quad

    mass = getattr(p, "separation_mass", p.vehicle_mass)
    pull = p.body_gravitational_parameter / p.body_radius**2

    def slowness(height: float) -> float:
        return float(np.sqrt(air.density(height, p, NUMERIC) * p.parachute_drag_area / (2 * mass * pull)))

    return float(quad(slowness, p.site_altitude, p.parachute_altitude)[0])
