"""Delta-v budget of a landing: masses, and the losses that make up the velocity change of the burn.

Along the thrust's path the speed V relative to the ground, where a lander must come to rest, changes by
``dV/dt = a.v/V + g.v/V``. Here a is the acceleration by thrust and g gravity as the turning ground feels it (with the
centrifugal part; the Coriolis part is across v and does no work). What the engine spends, the integral of |a|, is so
split without a rest into

    speed lost     V(0) - V(end)
    gravity loss   integral of g.v/V: speed that gravity adds on the way down, to be taken away again
    steering loss  integral of |a| + a.v/V, not negative: thrust that does not point straight against v

It is the split of an ascent (Curtis, Orbital Mechanics for Engineering Students, rocket vehicle dynamics) read for a
descent, where thrust takes speed away and gravity gives it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from perilune.models.physics.rotating_frame import scalar_product
from perilune.problem import Variable

# Below any speed, in any unit: at rest nothing is lost and no direction is asked for.
_REST = 1e-300

LANDED_MASS = Variable(name="landed_mass", unit="kg", description="mass at touchdown")
PROPELLANT = Variable(
    name="propellant", unit="kg", description="all propellant burnt, including an impulsive burn before ignition"
)
FLIGHT_TIME = Variable(name="flight_time", unit="s", description="from ignition to touchdown")
LANDING = (LANDED_MASS, PROPELLANT, FLIGHT_TIME)

SPENT = (
    Variable(name="main_delta_v", unit="m/s", description="integral of the main engine's thrust acceleration"),
    Variable(name="gravity_loss", unit="m/s", description="ground speed that gravity adds and that must be removed"),
    Variable(name="steering_loss", unit="m/s", description="loss by thrust not opposite to the ground velocity"),
)


def landing_results(first: Any, last: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Values of `LANDING`, and of the times of a free fall before ignition and of the parts of a burn with a gate.

    Parameters
    ----------
    first, last
        States at the begin and the end of the flight [SI].
    p, xp
        Parameters [SI] and maths namespace.
    """
    fall = (p.coast_time,) if hasattr(p, "coast_time") else ()
    parts = (p.gate_time, p.final_time) if hasattr(p, "gate_time") else ()
    return last.m, p.vehicle_mass - last.m, sum(parts) if parts else p.flight_time, *fall, *parts


def velocity_loss_rates(
    velocity: Sequence[Any], push: Any, direction: Sequence[Any], pull: Sequence[Any], xp: Any
) -> Sequence[Any]:
    """Rates of `SPENT` [m/s^2].

    Parameters
    ----------
    velocity
        Over the ground, along any three right-angled axes [m/s].
    push, direction
        Acceleration by thrust [m/s^2], and its unit vector.
    pull
        Gravity and centrifugal acceleration [m/s^2].
    xp
        Maths namespace.
    """
    speed = xp.fmax(xp.sqrt(scalar_product(velocity, velocity)), _REST)
    return push, scalar_product(pull, velocity) / speed, push * (1 + scalar_product(direction, velocity) / speed)
