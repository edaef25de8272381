"""Ranges and orders of magnitude of the durations of a return."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from perilune.core import PeriluneError, Physics
from perilune.models.deorbit import checks, initial_guess as times, parachute as parachutes
from perilune.models.deorbit.ballistic_fall import entry_end_altitude, fall
from perilune.models.deorbit.records import least_mass_left
from perilune.models.deorbit.site_passes import apsis_radii
from perilune.models.physics import ellipsoid
from perilune.models.physics.atmosphere import Air
from perilune.models.physics.coast import SHORTEST

LONGEST_ENTRY = 10.0  # times a typical fall
_LEVEL = 1e-12  # rad, of an orbit above the equator


def return_time_ranges(
    p: Any, xp: Any, *, angles: Physics, air: Air | None, names: tuple[str, ...]
) -> dict[str, tuple[float, float, Callable[[], float]]]:
    """Return bounds and orders of magnitude of the times [s]; refuse a manoeuvre where the orbit never comes.

    Parameters
    ----------
    p, xp
        Parameters [SI] and maths namespace.
    angles
        ``angles(p, xp)`` returns the argument of latitude and the longitude of the node at t = 0 [rad].
    air
        Density of the air against altitude; None where the flight ends at the interface.
    names
        Phases in order of flight.

    Returns
    -------
    dict[str, tuple[float, float, Callable[[], float]]]
        By the name of the duration: least and greatest [s], and a function that returns the typical value [s].

    Raises
    ------
    PeriluneError
        If the orbit never comes to the latitude of the manoeuvre.
    """
    checks.refuse_below_centre(p.interface_altitude if air is None else entry_end_altitude(p), p.body_radius)
    highest = math.asin(math.sin(p.orbit_inclination))
    low, _ = apsis_radii(p)
    low = xp.fmax(low, p.body_radius)  # what is lower is refused as such
    if hasattr(p, "manoeuvre_latitude") and not highest > _LEVEL:
        raise PeriluneError(
            "an orbit above the equator has no ascending and no descending side", got="orbit.inclination = "
            f"{math.degrees(p.orbit_inclination):g} deg, and a [manoeuvre] on a pass",
            expected="orbit.node_longitude and orbit.argument_of_latitude in place of [manoeuvre]",
            advice="or another orbit.inclination",
        )  # fmt: skip
    reaches = not hasattr(p, "manoeuvre_latitude")
    if not reaches and abs(ellipsoid.geocentric(p.manoeuvre_latitude, low, p, xp)) < highest:
        with np.errstate(invalid="ignore"):  # higher up on an ellipse it may be beyond after all
            reaches = bool(np.isfinite(angles(p, xp)[0]))
    if not reaches:
        raise PeriluneError(
            "the orbit never comes to the latitude of the manoeuvre",
            got=f"{math.degrees(p.manoeuvre_latitude):g} deg",
            expected=f"less than {math.degrees(highest):g} deg, which the inclination allows",
            advice="a lower manoeuvre.latitude, or another orbit.inclination",
        )
    burnt = (p.vehicle_mass - least_mass_left(p)) * times.engine_exhaust_speed(p) / p.vehicle_thrust
    if hasattr(p, "throttle_lower"):
        burnt = burnt / p.throttle_lower if p.throttle_lower > 0 else math.inf
    longest = {"burn_time": burnt}
    if coasts := "coast" in names:
        longest["coast_time"] = getattr(p, "orbit_longest_coast", math.inf)
    if drifts := "drift" in names:
        longest["drift_time"] = getattr(p, "transition_longest_coast", math.inf)
    if air is not None:
        longest["entry_time"] = LONGEST_ENTRY * fall(p, air).time
        if hasattr(p, "parachute_altitude"):
            longest["parachute_time"] = 10 * parachutes.typical_parachute_time(p, air)
    least = {"coast_time": SHORTEST, "drift_time": SHORTEST}
    inside = {"coast_time": 0.98}  # of its longest: by how late it begins a flight knows its site
    typical = cache(partial(times.typical_times, p, angles, air, coasts=coasts, drifts=drifts))

    def likely(name: str) -> float:
        return min(typical()[name], inside.get(name, 0.9) * longest[name])

    return {name: (least.get(name, 0.0), most, partial(likely, name)) for name, most in longest.items()}
