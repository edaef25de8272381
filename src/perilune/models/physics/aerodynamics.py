"""Forces and heat of air that turns with its body, on a vehicle without fins.

Velocities are relative to the turning body, and so to the air. Drag is along them, lift in the plane normal to them:

    drag = rho V^2 S/2 / m,  S = C_D A, or m/S a ballistic coefficient;   lift = (L/D) drag

**Load** is what an accelerometer shows, drag and lift together, in units of g0. **Heat rate** is
that of convection at the stagnation point of a nose of radius R_n, to a cold wall (Sutton, Graves, NASA TR R-376,
1971):

    q = k sqrt(rho/R_n) V^3,   k = 1.7415e-4 kg^(1/2)/m for the Earth's air

Radiation of the gas is left out: it is small below about 9 km/s.

**Sphere-cone.** In Newtonian flow the pressure coefficient is 2 sin^2 of the angle between the surface and the stream,
so that at no angle of attack a cone of half angle d with a spherical nose R_n and the base radius R_b has

    C_D A = pi R_n^2 (1 - sin^4 d) + 2 pi sin^2 d (R_b^2 - R_n^2 cos^2 d)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from perilune.models.physics.rotating_frame import Triple, combine, cross_product, scalar_product

SUTTON_GRAVES = 1.7415e-4  # kg^(1/2)/m, air; carbon dioxide has 1.9027e-4


def dynamic_pressure(density: Any, velocity: Sequence[Any]) -> Any:
    """Dynamic pressure [Pa].

    Parameters
    ----------
    density, velocity
        Of the air [kg/m^3], and relative to it [m/s], (3,).
    """
    return 0.5 * density * scalar_product(velocity, velocity)


def drag_acceleration(density: Any, velocity: Sequence[Any], mass: Any, p: Any, xp: Any) -> Any:
    """Size of the drag [m/s^2], of the vehicle's ballistic coefficient, drag area or sphere-cone.

    Parameters
    ----------
    density, velocity, mass
        Of the air [kg/m^3]; relative to it [m/s], (3,); of the vehicle [kg].
    p, xp
        Parameters [SI] and maths namespace.
    """
    pressure = dynamic_pressure(density, velocity)
    if hasattr(p, "vehicle_ballistic_coefficient"):
        return pressure / p.vehicle_ballistic_coefficient
    if hasattr(p, "vehicle_drag_area"):
        return pressure * p.vehicle_drag_area / mass
    nose = getattr(p, "vehicle_nose_radius", 0.0 * p.vehicle_base_radius)
    return pressure * sphere_cone_drag_area(nose, p.vehicle_base_radius, p.vehicle_cone_angle, xp) / mass


def drag(density: Any, velocity: Sequence[Any], mass: Any, p: Any, xp: Any) -> Triple:
    """Acceleration by drag [m/s^2].

    Parameters
    ----------
    density, velocity, mass
        As of `drag_acceleration`.
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Triple
        Acceleration against the velocity [m/s^2], (3,).
    """
    strength = drag_acceleration(density, velocity, mass, p, xp) / xp.sqrt(scalar_product(velocity, velocity))
    return combine((-strength, velocity))


def lift_axes(position: Sequence[Any], velocity: Sequence[Any], xp: Any) -> tuple[Triple, Triple]:
    """Unit vectors across the velocity: in its vertical plane, upwards, and level to the right of it.

    There are none straight up or down.

    Parameters
    ----------
    position, velocity
        From the centre [m], (3,), and relative to the air [m/s], (3,).
    xp
        Maths namespace.
    """
    across = cross_product(velocity, position)
    level = combine((1 / xp.sqrt(scalar_product(across, across)), across))
    return combine((1 / xp.sqrt(scalar_product(velocity, velocity)), cross_product(level, velocity))), level


def aerodynamic_load(density: Any, velocity: Sequence[Any], mass: Any, p: Any, xp: Any) -> Any:
    """Load [m/s^2]: with lift (``vehicle_lift_to_drag``) where there is one.

    Parameters
    ----------
    density, velocity, mass
        As of `drag_acceleration`.
    p, xp
        Parameters [SI] and maths namespace.
    """
    found = drag_acceleration(density, velocity, mass, p, xp)
    if hasattr(p, "vehicle_lift_to_drag"):
        return found * xp.sqrt(1 + p.vehicle_lift_to_drag * p.vehicle_lift_to_drag)
    return found


def heat_rate(density: Any, velocity: Sequence[Any], p: Any, xp: Any) -> Any:
    """Heat rate [W/m^2] at the stagnation point of ``vehicle_nose_radius``, with ``heating_constant``.

    Parameters
    ----------
    density, velocity
        Of the air [kg/m^3], and relative to it [m/s], (3,).
    p, xp
        Parameters [SI] and maths namespace.
    """
    squared = scalar_product(velocity, velocity)
    return p.heating_constant * xp.sqrt(density / p.vehicle_nose_radius) * squared * xp.sqrt(squared)


def sphere_cone_drag_area(nose_radius: Any, base_radius: Any, half_angle: Any, xp: Any) -> Any:
    """Drag coefficient times area [m^2] of a sphere-cone in Newtonian flow, without an angle of attack.

    Parameters
    ----------
    nose_radius, base_radius
        Radii [m] of the nose, which is 0 for a sharp cone, and of the base, which is at least R_n cos d.
    half_angle
        Half angle of the cone [rad].
    xp
        Maths namespace.
    """
    sine, cosine = xp.sin(half_angle), xp.cos(half_angle)
    squared, nose = sine * sine, nose_radius * nose_radius
    return math.pi * (
        nose * (1 - squared * squared) + 2 * squared * (base_radius * base_radius - nose * cosine * cosine)
    )
