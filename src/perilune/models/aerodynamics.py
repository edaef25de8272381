"""Forces and heat of air that turns with its body, on a vehicle without fins.

Velocities are relative to the turning body, and so to the air. Drag is along them, lift in the plane normal to them:

    drag = rho V^2 S/2 / m,  S = C_D A, or m/S a ballistic coefficient;   lift = (L/D) drag

**Load** is what an accelerometer shows, drag and lift together, in units of g0. **Heat rate** is that of convection at
the stagnation point of a nose of radius R_n, to a cold wall (Sutton, Graves, NASA TR R-376, 1971):

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

from perilune.models.rotating import Triple, combine, cross, dot
from perilune.words.outcome import PeriluneError

SUTTON_GRAVES = 1.7415e-4  # kg^(1/2)/m, air; carbon dioxide has 1.9027e-4


def dynamic_pressure(density: Any, velocity: Sequence[Any]) -> Any:
    """Dynamic pressure [Pa]."""
    return 0.5 * density * dot(velocity, velocity)


def drag_acceleration(density: Any, velocity: Sequence[Any], mass: Any, p: Any) -> Any:
    """Size of the drag [m/s^2], of ``vehicle_drag_area`` or ``vehicle_ballistic_coefficient``."""
    pressure = dynamic_pressure(density, velocity)
    if hasattr(p, "vehicle_ballistic_coefficient"):
        return pressure / p.vehicle_ballistic_coefficient
    return pressure * p.vehicle_drag_area / mass


def drag(density: Any, velocity: Sequence[Any], mass: Any, p: Any, m: Any) -> Triple:
    """Acceleration by drag [m/s^2]."""
    strength = drag_acceleration(density, velocity, mass, p) / m.sqrt(dot(velocity, velocity))
    return combine((-strength, velocity))


def lift_axes(position: Sequence[Any], velocity: Sequence[Any], m: Any) -> tuple[Triple, Triple]:
    """Unit vectors across the velocity: in its vertical plane, upwards, and level to the right of it.

    There are none straight up or down.
    """
    across = cross(velocity, position)
    level = combine((1 / m.sqrt(dot(across, across)), across))
    return combine((1 / m.sqrt(dot(velocity, velocity)), cross(level, velocity))), level


def load(density: Any, velocity: Sequence[Any], mass: Any, p: Any, m: Any) -> Any:
    """Load [m/s^2]: with lift (``vehicle_lift_to_drag``) where there is one."""
    found = drag_acceleration(density, velocity, mass, p)
    if hasattr(p, "vehicle_lift_to_drag"):
        return found * m.sqrt(1 + p.vehicle_lift_to_drag * p.vehicle_lift_to_drag)
    return found


def heat_rate(density: Any, velocity: Sequence[Any], p: Any, m: Any) -> Any:
    """Heat rate [W/m^2] at the stagnation point of ``vehicle_nose_radius``, with ``heating_constant``."""
    squared = dot(velocity, velocity)
    return p.heating_constant * m.sqrt(density / p.vehicle_nose_radius) * squared * m.sqrt(squared)


def sphere_cone_drag_area(nose_radius: float, base_radius: float, half_angle: float) -> float:
    """Drag coefficient times area [m^2] of a sphere-cone in Newtonian flow, without an angle of attack.

    Parameters
    ----------
    nose_radius, base_radius
        Radii [m] of the nose and of the base; a nose of radius 0 is a sharp cone.
    half_angle
        Half angle of the cone [rad].

    Raises
    ------
    PeriluneError
        If the nose is wider than the base: R_n cos d is where it meets the cone.
    """
    sine, cosine = math.sin(half_angle), math.cos(half_angle)
    if not (0 <= half_angle < math.pi / 2 and 0 <= nose_radius * cosine <= base_radius > 0):
        raise PeriluneError(
            "this is no sphere-cone",
            got=f"nose {nose_radius:g} m, base {base_radius:g} m, half angle {math.degrees(half_angle):g} deg",
            expected="a nose that meets the cone within its base: nose radius times cos(half angle) <= base radius",
        )
    cap = nose_radius**2 * (1 - sine**4)
    return math.pi * (cap + 2 * sine**2 * (base_radius**2 - nose_radius**2 * cosine**2))
