"""Functions of the phases of a return: motion in axes that turn with the body, path and end conditions.

    r'' = g(r) + (T/m) d - 2 Omega x r' - Omega x (Omega x r),   m' = -T/c      above the interface, engine on
    r'' = g(r) + drag + lift - 2 Omega x r' - Omega x (Omega x r)               below it

z is the rotation axis and x points to longitude 0. Velocities are relative to the body, as are the speed V and the path
angle gamma at the interface, sin gamma = r.V/(|r| |V|).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from perilune.models.deorbit.orbit import AXIS
from perilune.models.deorbit.records import engine_exhaust_speed, is_something_left, throttled
from perilune.models.physics import aerodynamics, ellipsoid
from perilune.models.physics.atmosphere import Air
from perilune.models.physics.rotating_frame import Triple, combine, free_acceleration, local_axes, scalar_product
from perilune.problem import ScalarControl, UnitVectorControl, Variable

STEERING = UnitVectorControl(names=("toward_x", "toward_y", "toward_z"))
BANKS: dict[str, UnitVectorControl | ScalarControl] = {
    "free": UnitVectorControl(names=("lift_up", "lift_right")),
    # Bank reversals cancel its lateral part.
    "reversed": ScalarControl(name="lift_up", lower=-1.0, upper=1.0),
}
STATES = (
    *(Variable(name=name, unit="m") for name in ("x", "y", "z")),
    *(Variable(name=name, unit="m/s", description="relative to the rotating body") for name in ("vx", "vy", "vz")),
)
SITE = ("site_up", "site_north", "site_east")
HEAT_SIZE = 1e7  # J/m^2
# What the vehicle weighed before a part of it was left behind, kept where a throttle decides it.
WHOLE = Variable(name="whole", unit="kg", description="mass at the interface, before separation")
HEAT = Variable(name="heat", unit="J/m^2", description="heat load at the stagnation point", scale=HEAT_SIZE)


def extra_entry_states(*, heat: bool, weighed: bool) -> tuple[Variable, ...]:
    """Return the states of the phases in the air in addition to motion and mass.

    Parameters
    ----------
    heat
        Count the heat load [J/m^2].
    weighed
        Keep the mass of the whole vehicle [kg], which a throttle decides before a part is left behind.
    """
    return (*((HEAT,) if heat else ()), *((WHOLE,) if weighed else ()))


def position_vector(x: Any) -> Triple:
    """Position [m]."""
    return x.x, x.y, x.z


def velocity_vector(x: Any) -> Triple:
    """Velocity relative to the body [m/s]."""
    return x.vx, x.vy, x.vz


def relative_speed(x: Any, xp: Any) -> Any:
    """Speed relative to the body [m/s].

    Parameters
    ----------
    x
        State [SI], components by name.
    xp
        Maths namespace.
    """
    return xp.sqrt(scalar_product(velocity_vector(x), velocity_vector(x)))


def path_angle(x: Any, xp: Any) -> Any:
    """Angle of the velocity above the horizon [rad].

    Parameters
    ----------
    x
        State [SI], components by name.
    xp
        Maths namespace.
    """
    r, v = position_vector(x), velocity_vector(x)
    return xp.asin(scalar_product(r, v) / xp.sqrt(scalar_product(r, r) * scalar_product(v, v)))


def engine_thrust(u: Any, p: Any) -> Any:
    """Thrust [N]: full, or throttled where `throttle` is a control.

    Parameters
    ----------
    u
        Control of the burn.
    p
        Parameters [SI].
    """
    return p.vehicle_thrust * getattr(u, "throttle", 1.0)


def coast_rates(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Rates without thrust, above the air.

    Parameters
    ----------
    x, u
        State [SI] in axes that turn with the body, and the control, of which there is none.
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        Rates of x, y, z [m/s], vx, vy, vz [m/s^2] and m [kg/s].
    """
    return *velocity_vector(x), *free_acceleration(position_vector(x), velocity_vector(x), AXIS, p, xp), 0.0


def burn_rates(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Rates with the engine on.

    Parameters
    ----------
    x, u
        State [SI] in axes that turn with the body; direction of the thrust, and throttle where there is one.
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        Rates of x, y, z [m/s], vx, vy, vz [m/s^2] and m [kg/s].
    """
    push = combine(
        (1, free_acceleration(position_vector(x), velocity_vector(x), AXIS, p, xp)),
        (engine_thrust(u, p) / x.m, (u.toward_x, u.toward_y, u.toward_z)),
    )
    return *velocity_vector(x), *push, -engine_thrust(u, p) / engine_exhaust_speed(p)


def entry_rates(x: Any, u: Any, p: Any, xp: Any, *, air: Air) -> Sequence[Any]:
    """Rates in the air: x, y, z, vx, vy, vz, m, and the heat load and the whole mass where they are states.

    Parameters
    ----------
    x, u
        State [SI] in axes that turn with the body; lift upwards and to the right, as shares of the whole.
    p, xp
        Parameters [SI] and maths namespace.
    air
        Density of the air against altitude.

    Returns
    -------
    Sequence[Any]
        In SI: m/s, m/s^2, kg/s, W/m^2 and kg/s.
    """
    r, v = position_vector(x), velocity_vector(x)
    density = air.density(ellipsoid.altitude(r, p, xp), p, xp)
    felt = aerodynamics.drag(density, v, x.m, p, xp)
    if hasattr(p, "vehicle_lift_to_drag"):
        upward, right = aerodynamics.lift_axes(r, v, xp)
        lift = p.vehicle_lift_to_drag * aerodynamics.drag_acceleration(density, v, x.m, p, xp)
        felt = combine((1, felt), (lift * u.lift_up, upward), (lift * getattr(u, "lift_right", 0.0), right))
    heat = (aerodynamics.heat_rate(density, v, p, xp),) if hasattr(x, "heat") else ()
    rates = *v, *combine((1, free_acceleration(r, v, AXIS, p, xp)), (1, felt)), 0.0, *heat
    return *rates, *((0.0,) if hasattr(x, "whole") else ())


def limit_margins(x: Any, u: Any, p: Any, xp: Any, *, air: Air) -> Sequence[Any]:
    """Return the margin to each stated limit: load [m/s^2], heat rate [W/m^2], dynamic pressure [Pa].

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.
    air
        Density of the air against altitude.
    """
    density, v = air.density(ellipsoid.altitude(position_vector(x), p, xp), p, xp), velocity_vector(x)
    left = []
    if hasattr(p, "limits_load"):
        left.append(p.limits_load - aerodynamics.aerodynamic_load(density, v, x.m, p, xp))
    if hasattr(p, "limits_heat_rate"):
        left.append(p.limits_heat_rate - aerodynamics.heat_rate(density, v, p, xp))
    if hasattr(p, "limits_dynamic_pressure"):
        left.append(p.limits_dynamic_pressure - aerodynamics.dynamic_pressure(density, v))
    return left


LIMITED = {"load": "m/s^2", "heat_rate": "W/m^2", "dynamic_pressure": "Pa"}


def height_above_interface(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Height above the interface [m], below which there is air.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.
    """
    return (ellipsoid.altitude(position_vector(x), p, xp) - p.interface_altitude,)


def depth_below_interface(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Depth below the interface [m]: an entry that comes above it again has left the air.

    Parameters
    ----------
    x, u
        State and control [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.
    """
    return (p.interface_altitude - ellipsoid.altitude(position_vector(x), p, xp),)


def entry_path_margins(x: Any, u: Any, p: Any, xp: Any, *, air: Air) -> Sequence[Any]:
    """Return the path conditions of an entry: depth below the interface, and the margins to the limits.

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
        First the depth [m], then what `limit_margins` returns.
    """
    return *depth_below_interface(x, u, p, xp), *limit_margins(x, u, p, xp, air=air)


def interface_end_values(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Return what ends the transition: altitude, speed and path angle where stated, mass where no time gives it.

    Parameters
    ----------
    x
        State at the interface [SI].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        Residuals of what is stated, values of what has bounds: m, m/s, rad, kg.
    """
    ends = [ellipsoid.altitude(position_vector(x), p, xp) - p.interface_altitude]
    for name, value in (("speed", relative_speed(x, xp)), ("angle", path_angle(x, xp))):
        if hasattr(p, f"interface_{name}"):
            ends.append(value - getattr(p, f"interface_{name}"))
        elif hasattr(p, f"interface_{name}_lower") or hasattr(p, f"interface_{name}_upper"):
            ends.append(value)
    return [*ends, *((x.m,) if throttled(p) and is_something_left(p) else ())]


def offset_from_site(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """End of the flight, `SITE` [m]: the height above the site, and how far north and east of a place.

    Parameters
    ----------
    x
        State at the end [SI].
    p, xp
        Parameters [SI] and maths namespace.
    """
    if not hasattr(p, "site_longitude"):
        return (ellipsoid.altitude(position_vector(x), p, xp) - p.site_altitude,)
    site = ellipsoid.geodetic_position(p.site_longitude, p.site_latitude, p.site_altitude, p, xp)
    away = combine((1, position_vector(x)), (-1, site))
    return tuple(scalar_product(away, axis) for axis in local_axes(p.site_longitude, p.site_latitude, xp))


def site_arrival(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Return the same with the speed.

    Parameters
    ----------
    x
        State at the end [SI].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        Offset from the site [m] and speed relative to the body [m/s].
    """
    return *offset_from_site(x, p, xp), relative_speed(x, xp)


def parachute_opening_end(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """End of the entry where a parachute opens: the height above that altitude, and the speed.

    Parameters
    ----------
    x
        State where the parachute opens [SI].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        In m and m/s, relative to the body.
    """
    return ellipsoid.altitude(position_vector(x), p, xp) - p.parachute_altitude, relative_speed(x, xp)
