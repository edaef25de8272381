"""Outputs of a return: quantities along the way, at the interface and at the end, and their figures.

A speed or an angle is relative to the turning body where both exist, and the inertial one says so in its name.
Longitude and latitude are those of the point below the vehicle, geodetic above an ellipsoid.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from perilune.models.deorbit.dynamics import engine_thrust, path_angle, position_vector, relative_speed, velocity_vector
from perilune.models.deorbit.orbit import AXIS
from perilune.models.deorbit.records import engine_exhaust_speed, throttled
from perilune.models.physics import aerodynamics, ellipsoid
from perilune.models.physics.atmosphere import Air
from perilune.models.physics.delta_v_budget import velocity_loss_rates
from perilune.models.physics.rotating_frame import (
    INERTIAL_AXES,
    Triple,
    combine,
    cross_product,
    inertial_triples,
    scalar_product,
    zonal_gravity,
)
from perilune.problem import Variable, views

PLACED = (
    Variable(name="altitude", unit="m"),
    Variable(name="longitude", unit="rad", description="of the point below the vehicle"),
    Variable(name="latitude", unit="rad", description="of the point below the vehicle"),
    Variable(name="speed", unit="m/s", description="relative to the rotating body"),
    Variable(name="path_angle", unit="rad", description="of the velocity relative to the body, above the horizon"),
)
PUSHED = Variable(name="thrust_acceleration", unit="m/s^2")
FELT = (
    Variable(name="dynamic_pressure", unit="Pa"),
    Variable(name="load", unit="1", description="drag and lift in units of g0", label="load (g0)"),
)
HEATED = Variable(name="heat_rate", unit="W/m^2", description="convective, at the stagnation point")
HEAT_LOAD = Variable(name="heat_load", unit="J/m^2", description="integral of the heat rate")
AT_INTERFACE = (
    Variable(name="interface_speed", unit="m/s", description="relative to the rotating body, at the interface"),
    Variable(name="interface_angle", unit="rad", description="of this velocity, above the horizon"),
    Variable(name="interface_inertial_speed", unit="m/s", description="in inertial axes"),
    Variable(name="interface_inertial_angle", unit="rad", description="in inertial axes"),
    Variable(name="interface_longitude", unit="rad"),
    Variable(name="interface_latitude", unit="rad"),
    Variable(name="mass_at_interface", unit="kg"),
)
AT_OPENING = (
    Variable(name="opening_speed", unit="m/s", description="where the parachute opens, relative to the body"),
)
_CONVECTIVE, _RADIATING = 1e6, 10e3  # W/m^2, m/s: up to which the heat of convection alone tells
_TIMES = {
    "flight_time": "from ignition to the end",
    "transition_time": "from ignition to the interface",
    "coast_time": "on the orbit, before ignition",
    "burn_time": "engine on",
    "drift_time": "from the end of the burn to the interface",
    "entry_time": "through the air, without a parachute",
    "parachute_time": "below the parachute",
}


def return_result_variables(names: Sequence[str]) -> tuple[Variable, ...]:
    """Return the results of a flight with these phases."""
    known = {"transition_time", "flight_time", *(f"{name}_time" for name in names)}
    landed = (
        Variable(name="landing_speed", unit="m/s", description="at the end, relative to the rotating body"),
        Variable(name="landing_longitude", unit="rad"),
        Variable(name="landing_latitude", unit="rad"),
    )
    return (
        *(Variable(name=name, unit="s", description=text) for name, text in _TIMES.items() if name in known),
        Variable(name="propellant", unit="kg"),
        Variable(name="delta_v", unit="m/s", description="by the rocket equation"),
        *(landed if "entry" in names else ()),
    )


def return_results(first: Any, last: Any, p: Any, xp: Any, *, names: Sequence[str]) -> Sequence[Any]:
    """Values of `return_result_variables`.

    Parameters
    ----------
    first, last
        States at t = 0 and at the end [SI].
    p, xp
        Parameters [SI] and maths namespace.
    names
        Phases in order of flight.
    """
    lengths = {name: getattr(p, f"{name}_time") for name in names}
    to_interface = sum(lengths.get(name, 0.0) for name in ("burn", "drift"))
    in_air = sum(lengths.get(name, 0.0) for name in ("entry", "parachute"))
    times = {"flight_time": to_interface + in_air, "transition_time": to_interface}
    times |= {f"{name}_time": length for name, length in lengths.items()}
    burnt = p.vehicle_mass - getattr(last, "whole", last.m)
    if not throttled(p):
        burnt = p.vehicle_thrust / engine_exhaust_speed(p) * p.burn_time
    change = engine_exhaust_speed(p) * xp.log(p.vehicle_mass / (p.vehicle_mass - burnt))
    landed = (relative_speed(last, xp), *_subpoint(last, p, xp)) if "entry" in names else ()
    return *(times[name] for name in _TIMES if name in times), burnt, change, *landed


def _subpoint(x: Any, p: Any, xp: Any) -> tuple[Any, Any]:
    return xp.atan2(x.y, x.x), ellipsoid.latitude(position_vector(x), p, xp)


def position_outputs(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Values of `PLACED`.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.
    """
    return ellipsoid.altitude(position_vector(x), p, xp), *_subpoint(x, p, xp), relative_speed(x, xp), path_angle(x, xp)


def opening_outputs(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Value of `AT_OPENING`.

    Parameters
    ----------
    x
        State where the parachute opens [SI].
    p, xp
        Parameters [SI] and maths namespace.
    """
    return (relative_speed(x, xp),)


def burn_outputs(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Values of `PLACED`, and the acceleration by thrust.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        In SI, the acceleration in m/s^2.
    """
    return *position_outputs(x, u, p, xp), engine_thrust(u, p) / x.m


def entry_outputs(x: Any, u: Any, p: Any, xp: Any, *, air: Air) -> Sequence[Any]:
    """Values of `PLACED` and `FELT`, and of the heat rate of a vehicle with a nose radius.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.
    air
        Density of the air against altitude.

    Returns
    -------
    Sequence[Any]
        In SI, the load in units of g0.
    """
    density, v = air.density(ellipsoid.altitude(position_vector(x), p, xp), p, xp), velocity_vector(x)
    load = aerodynamics.aerodynamic_load(density, v, x.m, p, xp) / p.standard_gravity
    heat = (aerodynamics.heat_rate(density, v, p, xp),) if hasattr(p, "vehicle_nose_radius") else ()
    return *position_outputs(x, u, p, xp), aerodynamics.dynamic_pressure(density, v), load, *heat


def heat_load_rate(x: Any, u: Any, p: Any, xp: Any, *, air: Air) -> Sequence[Any]:
    """Rate of the heat load.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.
    air
        Density of the air against altitude.

    Returns
    -------
    Sequence[Any]
        One value [W/m^2].
    """
    density = air.density(ellipsoid.altitude(position_vector(x), p, xp), p, xp)
    return (aerodynamics.heat_rate(density, velocity_vector(x), p, xp),)


def interface_outputs(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Values of `AT_INTERFACE`.

    Parameters
    ----------
    x
        State at the interface [SI].
    p, xp
        Parameters [SI] and maths namespace.
    """
    r, v = position_vector(x), _inertial_velocity(x, p)
    fast = xp.sqrt(scalar_product(v, v))
    steep = xp.asin(scalar_product(r, v) / (xp.sqrt(scalar_product(r, r)) * fast))
    return relative_speed(x, xp), path_angle(x, xp), fast, steep, *_subpoint(x, p, xp), x.m


def _inertial_velocity(x: Any, p: Any) -> Triple:
    return combine((1, velocity_vector(x)), (p.body_rotation_rate, cross_product(AXIS, position_vector(x))))


def burn_loss_rates(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Rates of the velocity losses of a burn, from the inertial velocity.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        In m/s^2, in the order of `perilune.models.physics.delta_v_budget.SPENT`.
    """
    pull = zonal_gravity(position_vector(x), AXIS, p, xp)
    return velocity_loss_rates(
        _inertial_velocity(x, p), engine_thrust(u, p) / x.m, (u.toward_x, u.toward_y, u.toward_z), pull, xp
    )


def inertial_burn(x: Any, u: Any, t: Any, p: Any, xp: Any) -> Sequence[Any]:
    """`perilune.problem.phase.Phase.inertial` of a burn.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    t
        Time from the begin of the flight [s].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        Position [m], velocity [m/s] and acceleration by thrust [m/s^2] in inertial axes, (9,).
    """
    push = combine((engine_thrust(u, p) / x.m, (u.toward_x, u.toward_y, u.toward_z)))
    return inertial_triples(position_vector(x), velocity_vector(x), push, t, p, xp)


def inertial_without_thrust(x: Any, u: Any, t: Any, p: Any, xp: Any) -> Sequence[Any]:
    """`perilune.problem.phase.Phase.inertial` of a coast or an entry.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    t
        Time from the begin of the flight [s].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        Position [m], velocity [m/s] and an acceleration of 0 [m/s^2] in inertial axes, (9,).
    """
    none = 0.0 * p.vehicle_thrust / x.m
    return inertial_triples(position_vector(x), velocity_vector(x), (none, none, none), t, p, xp)


# Of each way to state a drag, the percent that its parameters change by where drag and lift grow by one percent.
_DRAG = (
    (("vehicle_ballistic_coefficient", -1.0),),
    (("vehicle_drag_area", 1.0),),
    (("vehicle_base_radius", 0.5), ("vehicle_nose_radius", 0.5)),
)


def return_dispersion(given: Iterable[str]) -> views.Dispersion:
    """Return the disturbances of the landing point of a problem with these given parameters."""
    shares = next(found for ways in _DRAG if (found := tuple(way for way in ways if way[0] in given)))
    return views.Dispersion(
        disturbances=(
            views.Disturbance(name="second_late", begins="burn", without=("vehicle_thrust",)),
            views.Disturbance(name="percent_thrust", shares=(("vehicle_thrust", 1.0),)),
            views.Disturbance(name="percent_drag", shares=shares),
        ),
        position=("x", "y", "z"), velocity=("vx", "vy", "vz"), track="entry",
    )  # fmt: skip


def validity_ranges(air: Air | None, *, heat: bool) -> tuple[views.ValidRange, ...]:
    """Return the ranges in which the model of the air and of its heat hold.

    Parameters
    ----------
    air
        Air with the altitudes of its first and last datum [m]; None where there is none.
    heat
        Add the ranges of the heat rate [W/m^2] and of the speed [m/s].
    """
    if air is None:
        return ()
    told_air = f"{air.name}, whose data range from {air.bottom / 1e3:g} to {air.top / 1e3:g} km"
    known = views.ValidRange(quantity="altitude", lower=air.bottom, upper=air.top, phases=("entry",), because=told_air)
    hot = "only convection at a cold wall (Sutton and Graves 1971); beyond, heat shields ablate and the gas also "
    hot += "radiates (Tauber and Sutton 1991)"
    heats = (
        views.ValidRange(
            quantity="heat_rate", upper=_CONVECTIVE, phases=("entry",), because=f"up to 1000 kW/m^2, {hot}"
        ),
        views.ValidRange(quantity="speed", upper=_RADIATING, phases=("entry",), because=f"up to 10 km/s, {hot}"),
    )
    return (*((known,) if math.isfinite(air.top) else ()), *(heats if heat else ()))


def return_views(
    *, air: Air | None, heat: bool, coasts: bool, given: Iterable[str], body: str = "", epoch: str = ""
) -> views.Views:
    """Return the figures of a return, for its air, heat and body (whose coasts are drawn where they are known).

    Parameters
    ----------
    air
        Density of the air against altitude; None where the flight ends at the interface.
    heat
        Draw the heat rate.
    coasts
        Draw the coastlines of the body.
    given
        Names of the parameters that the problem states, of which some are dispersed.
    body, epoch
        Name of the body, and UTC of t = 0 in ISO 8601; "" where not known.
    """
    flown = air is not None
    peaks = (("dynamic_pressure", "load") if flown else ()) + (("heat_rate",) if flown and heat else ())
    return views.Views(
        histories=(
            views.History(name="altitude", quantities=("altitude",), caption="Altitude"),
            views.History(
                name="speed_and_angle", quantities=("speed", "path_angle"),
                caption="Speed relative to the rotating body, and its angle above the horizon",
            ),
            *((views.History(name="air", quantities=peaks, caption="Aerodynamics"),) if flown else ()),
            views.History(name="mass", quantities=("m",), caption="Mass"),
            views.History(
                name="steering", quantities=("toward_x", "toward_y", "toward_z", "throttle", "lift_up", "lift_right"),
                caption="Thrust direction in body-fixed axes, and lift in the atmosphere",
            ),
        ),
        height="altitude", radius="body_radius", frame=INERTIAL_AXES, peaks=peaks,
        ground=views.Ground(longitude="longitude", latitude="latitude", coasts=coasts),
        meant_for=validity_ranges(air, heat=heat),
        corridor=views.Corridor(
            height="altitude", speed="speed", equal=peaks[1:], position=("x", "y", "z"), velocity=("vx", "vy", "vz")
        ) if flown else None,
        dispersion=return_dispersion(given) if flown else None,
        space=views.Space(
            body=body, rotation="body_rotation_rate", epoch=epoch,
            longitude="longitude", latitude="latitude", height="altitude",
        ),
        inputs=(f"{air.name}: {air.said}",) if air and air.said else (),
    )  # fmt: skip
