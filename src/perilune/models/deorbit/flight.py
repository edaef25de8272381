"""Functions of the phases of a return: motion in axes that turn with the body, path and end conditions.

    r'' = g(r) + (T/m) d - 2 Omega x r' - Omega x (Omega x r),   m' = -T/c      above the interface, engine on
    r'' = g(r) + drag + lift - 2 Omega x r' - Omega x (Omega x r)               below it

z is the rotation axis and x points to longitude 0. Velocities are relative to the body, as are the speed V and the path
angle gamma at the interface, sin gamma = r.V/(|r| |V|).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from perilune.models import aerodynamics, ellipsoid
from perilune.models.atmosphere import Air
from perilune.models.deorbit.orbit import AXIS
from perilune.models.deorbit.records import exhaust_speed, is_something_left, throttled
from perilune.models.rotating import Triple, combine, dot, free_acceleration, local_axes
from perilune.problem.controls import Bounded, Direction
from perilune.problem.variables import Variable

STEERING = Direction(names=("toward_x", "toward_y", "toward_z"))
BANKS: dict[str, Direction | Bounded] = {
    "free": Direction(names=("lift_up", "lift_right")),
    # Bank reversals cancel its lateral part.
    "reversed": Bounded(name="lift_up", lower=-1.0, upper=1.0),
}
STATES = (
    *(Variable(name=name, unit="m") for name in ("x", "y", "z")),
    *(Variable(name=name, unit="m/s", description="beside the turning body") for name in ("vx", "vy", "vz")),
)
SITE = ("site_up", "site_north", "site_east")
HEAT_SIZE = 1e7  # J/m^2
# What the vehicle weighed before a part of it was left behind, kept where a throttle decides it.
WHOLE = Variable(name="whole", unit="kg", description="mass at the interface, before separation")
HEAT = Variable(name="heat", unit="J/m^2", description="heat load at the stagnation point", scale=HEAT_SIZE)


def beside_motion(*, heat: bool, weighed: bool) -> tuple[Variable, ...]:
    """Return the states of the phases in the air in addition to motion and mass."""
    return (*((HEAT,) if heat else ()), *((WHOLE,) if weighed else ()))


def where(x: Any) -> Triple:
    """Position [m]."""
    return x.x, x.y, x.z


def how_fast(x: Any) -> Triple:
    """Velocity relative to the body [m/s]."""
    return x.vx, x.vy, x.vz


def speed(x: Any, m: Any) -> Any:
    """Speed relative to the body [m/s]."""
    return m.sqrt(dot(how_fast(x), how_fast(x)))


def path_angle(x: Any, m: Any) -> Any:
    """Angle of the velocity above the horizon [rad]."""
    r, v = where(x), how_fast(x)
    return m.asin(dot(r, v) / m.sqrt(dot(r, r) * dot(v, v)))


def thrust(u: Any, p: Any) -> Any:
    """Thrust [N]: full, or throttled where `throttle` is a control."""
    return p.vehicle_thrust * getattr(u, "throttle", 1.0)


def coasting(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    """Rates without thrust, above the air."""
    return *how_fast(x), *free_acceleration(where(x), how_fast(x), AXIS, p, m), 0.0


def burning(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    """Rates with the engine on."""
    push = combine(
        (1, free_acceleration(where(x), how_fast(x), AXIS, p, m)),
        (thrust(u, p) / x.m, (u.toward_x, u.toward_y, u.toward_z)),
    )
    return *how_fast(x), *push, -thrust(u, p) / exhaust_speed(p)


def falling(x: Any, u: Any, p: Any, m: Any, *, air: Air) -> Sequence[Any]:
    """Rates in the air: x, y, z, vx, vy, vz, m, and the heat load and the whole mass where they are states."""
    r, v = where(x), how_fast(x)
    density = air.density(ellipsoid.altitude(r, p, m), p, m)
    felt = aerodynamics.drag(density, v, x.m, p, m)
    if hasattr(p, "vehicle_lift_to_drag"):
        upward, right = aerodynamics.lift_axes(r, v, m)
        lift = p.vehicle_lift_to_drag * aerodynamics.drag_acceleration(density, v, x.m, p, m)
        felt = combine((1, felt), (lift * u.lift_up, upward), (lift * getattr(u, "lift_right", 0.0), right))
    heat = (aerodynamics.heat_rate(density, v, p, m),) if hasattr(x, "heat") else ()
    rates = *v, *combine((1, free_acceleration(r, v, AXIS, p, m)), (1, felt)), 0.0, *heat
    return *rates, *((0.0,) if hasattr(x, "whole") else ())


def within_limits(x: Any, u: Any, p: Any, m: Any, *, air: Air) -> Sequence[Any]:
    """Return the margin to each stated limit: load [m/s^2], heat rate [W/m^2], dynamic pressure [Pa]."""
    density, v = air.density(ellipsoid.altitude(where(x), p, m), p, m), how_fast(x)
    left = []
    if hasattr(p, "limits_load"):
        left.append(p.limits_load - aerodynamics.load(density, v, x.m, p, m))
    if hasattr(p, "limits_heat_rate"):
        left.append(p.limits_heat_rate - aerodynamics.heat_rate(density, v, p, m))
    if hasattr(p, "limits_dynamic_pressure"):
        left.append(p.limits_dynamic_pressure - aerodynamics.dynamic_pressure(density, v))
    return left


LIMITED = {"load": "m/s^2", "heat_rate": "W/m^2", "dynamic_pressure": "Pa"}


def above_interface(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    """Height above the interface [m], below which there is air."""
    return (ellipsoid.altitude(where(x), p, m) - p.interface_altitude,)


def below_interface(x: Any, u: Any, p: Any, m: Any) -> Sequence[Any]:
    """Depth below the interface [m]: an entry that comes above it again has left the air."""
    return (p.interface_altitude - ellipsoid.altitude(where(x), p, m),)


def in_the_air(x: Any, u: Any, p: Any, m: Any, *, air: Air) -> Sequence[Any]:
    """Return the path conditions of an entry: depth below the interface, and the margins to the limits."""
    return *below_interface(x, u, p, m), *within_limits(x, u, p, m, air=air)


def at_interface(x: Any, p: Any, m: Any) -> Sequence[Any]:
    """Return what ends the transition: altitude, speed and path angle where stated, mass where no time gives it."""
    ends = [ellipsoid.altitude(where(x), p, m) - p.interface_altitude]
    for name, value in (("speed", speed(x, m)), ("angle", path_angle(x, m))):
        if hasattr(p, f"interface_{name}"):
            ends.append(value - getattr(p, f"interface_{name}"))
        elif hasattr(p, f"interface_{name}_lower") or hasattr(p, f"interface_{name}_upper"):
            ends.append(value)
    return [*ends, *((x.m,) if throttled(p) and is_something_left(p) else ())]


def beside_site(x: Any, p: Any, m: Any) -> Sequence[Any]:
    """End of the flight, `SITE` [m]: the height above the site, and how far north and east of a place."""
    if not hasattr(p, "site_longitude"):
        return (ellipsoid.altitude(where(x), p, m) - p.site_altitude,)
    site = ellipsoid.at(p.site_longitude, p.site_latitude, p.site_altitude, p, m)
    away = combine((1, where(x)), (-1, site))
    return tuple(dot(away, axis) for axis in local_axes(p.site_longitude, p.site_latitude, m))


def at_site(x: Any, p: Any, m: Any) -> Sequence[Any]:
    """Return the same with the speed."""
    return *beside_site(x, p, m), speed(x, m)


def at_opening(x: Any, p: Any, m: Any) -> Sequence[Any]:
    """End of the entry where a parachute opens: the height above that altitude, and the speed."""
    return ellipsoid.altitude(where(x), p, m) - p.parachute_altitude, speed(x, m)
