"""Checks of a return's records that are valid one by one, but together incomplete, without effect or impossible."""

from __future__ import annotations

from datetime import datetime
from itertools import pairwise

from perilune.core import PeriluneError
from perilune.models.deorbit.records import (
    Aim,
    Heating,
    Interface,
    Landing,
    Limits,
    Manoeuvre,
    Parachute,
    Returner,
    ReturnOrbit,
    Separation,
)
from perilune.models.physics.atmosphere import Air


def require_epoch(aim: Aim) -> datetime:
    """Return the epoch; refuse a return without one."""
    epoch = aim.instant()
    if epoch is None:
        raise PeriluneError(
            "the epoch of the nrlmsis atmosphere is not stated", expected="problem.epoch, the time at t = 0",
            advice='model = "us1976" depends on no epoch',
        )  # fmt: skip
    return epoch


def refuse_impossible_masses(vehicle: Returner, separation: Separation | None) -> None:
    """Refuse a vehicle that is heavier after a part of it is left behind, or the propellant is burnt.

    Parameters
    ----------
    vehicle
        Mass at t = 0, and dry mass where stated [kg].
    separation
        Mass that enters the air [kg]; None where nothing is left behind.

    Raises
    ------
    PeriluneError
        If the entering mass is not below that of the vehicle, or above the dry mass.
    """
    if separation is not None and separation.mass >= vehicle.mass:
        raise PeriluneError(
            "separation.mass is not below the mass of the vehicle", got=f"{separation.mass:g} kg of {vehicle.mass:g}"
            f" kg",
            expected="separation.mass < vehicle.mass", advice="the part that enters the atmosphere",
        )  # fmt: skip
    if separation is not None and vehicle.dry_mass is not None and separation.mass > vehicle.dry_mass:
        raise PeriluneError(
            "separation.mass exceeds the mass that the burn may leave",
            got=f"{separation.mass:g} kg of vehicle.dry_mass = {vehicle.dry_mass:g} kg",
            expected="separation.mass <= vehicle.dry_mass", advice="a greater vehicle.dry_mass",
        )  # fmt: skip


def refuse_undetermined_lift(aim: Aim, vehicle: Returner, air: Air | None, site: Landing | None) -> None:
    """Refuse a bank that changes neither what is minimised nor a place where the flight ends.

    Parameters
    ----------
    aim
        What is minimised.
    vehicle, air
        The vehicle, which may have lift, and the air, None where there is none.
    site
        End of the flight, which need not state a longitude.

    Raises
    ------
    PeriluneError
        If the lift changes neither the objective nor the end.
    """
    above = aim.minimise in ("propellant", "transition_time")
    if above and vehicle.lift_to_drag is not None and air is not None and (site is None or site.longitude is None):
        raise PeriluneError(
            "the lift is undetermined",
            got=f'minimise = "{aim.minimise}", which lift does not change, and no site to reach',
            expected="a quantity that depends on the lift, or no lift",
            advice='minimise = "flight_time" or "heat_load", a site.longitude and site.latitude, or no'
            " vehicle.lift_to_drag",
        )  # fmt: skip


def refuse_without_effect(
    vehicle: Returner,
    air: Air | None,
    heating: Heating | None,
    separation: Separation | None,
    limits: Limits | None,
    parachute: Parachute | None,
) -> None:
    """Refuse values that only matter in air where there is none, and heat without a nose.

    Parameters
    ----------
    vehicle
        Its nose radius is what heat needs.
    air
        None where the flight ends at the interface.
    heating, separation, limits, parachute
        Sections of the scenario that only matter in air; None where not stated.

    Raises
    ------
    PeriluneError
        If one of them is stated without air, or heat without a nose radius.
    """
    named = {"heating": heating, "separation": separation, "limits": limits, "parachute": parachute}
    for name in (name for name, made in named.items() if made is not None and air is None):
        raise PeriluneError(
            f"[{name}] needs an atmosphere",
            got=f"a section [{name}], and no [atmosphere]",
            expected="both of them, or neither",
        )
    heated = heating is not None or (limits is not None and limits.heat_rate is not None)
    if heated and vehicle.nose_radius is None:
        raise PeriluneError(
            "vehicle.nose_radius is missing", expected="the radius at the stagnation point, for its heat rate"
        )


def refuse_out_of_order(interface: Interface, site: Landing | None, parachute: Parachute | None) -> None:
    """Refuse a site above the air, and a parachute that opens above the one or below the other.

    Parameters
    ----------
    interface, site, parachute
        Altitudes of the interface, of the opening parachute and of the site [m], from above.

    Raises
    ------
    PeriluneError
        If one of them does not lie below the one before.
    """
    named = {"interface": interface, "parachute": parachute, "site": site}
    found = [(name, made.altitude) for name, made in named.items() if made is not None]
    for (upper, high), (lower, low) in pairwise(found):
        if low >= high:
            raise PeriluneError(
                f"{lower}.altitude is not below {upper}.altitude", got=f"{low / 1e3:g} km below {high / 1e3:g} km",
                expected=" above ".join(f"{name}.altitude" for name, _ in found),
                advice="check for m in place of km, or km in place of m",
            )  # fmt: skip


def refuse_below_centre(altitude: float, radius: float) -> None:
    """Refuse a flight that would end below the centre of the body, altitude and radius in m.

    Parameters
    ----------
    altitude
        Where the flight would end, above the radius of the body [m].
    radius
        Radius of the body [m].

    Raises
    ------
    PeriluneError
        If the end is not above the centre.
    """
    if not altitude > -radius:
        raise PeriluneError(
            "an altitude lies below the centre of the body", got=f"{altitude / 1e3:g} km",
            expected=f"above {-radius / 1e3:g} km", advice="altitudes are above the radius of the body",
        )  # fmt: skip


def refuse_beyond_data(air: Air | None, interface: Interface, site: Landing | None) -> None:
    """Refuse a table of air that ends somewhere on the way: beyond its ends it extrapolates, but holds no data.

    Parameters
    ----------
    air
        Air with the altitudes of its first and last datum [m].
    interface, site
        Altitudes between which the flight passes through the air [m].

    Raises
    ------
    PeriluneError
        If the data do not reach one of them.
    """
    if air is None or site is None:
        return
    reached = {"interface.altitude": interface.altitude, "site.altitude": site.altitude}
    for name, altitude in reached.items():
        if not air.bottom <= altitude <= air.top:
            read = f"add rows, or choose another {name}; its file was read as {air.said}"
            raise PeriluneError(
                f"{air.name} ends before the flight does",
                got=f"data from {air.bottom / 1e3:g} to {air.top / 1e3:g} km, and {name} = {altitude / 1e3:g} km",
                expected="data from the site to the interface",
                advice=read if air.said else f"another {name}",
            )


def refuse_incomplete(
    aim: Aim, vehicle: Returner, orbit_: ReturnOrbit, manoeuvre: Manoeuvre | None, air: Air | None, site: Landing | None
) -> None:
    """Refuse what is left out, or stated and of no effect.

    Parameters
    ----------
    aim, vehicle, orbit_
        Sections that every return has.
    manoeuvre, air, site
        Sections that it may have; None where not stated.

    Raises
    ------
    PeriluneError
        If the place on the orbit, the drag, the atmosphere of a site or the nose of a heat load is missing.
    """
    if manoeuvre is None and (orbit_.node_longitude is None or orbit_.argument_of_latitude is None):
        raise PeriluneError(
            "the position of the vehicle on its orbit is not stated",
            expected="a section [manoeuvre]; or orbit.node_longitude and orbit.argument_of_latitude at t = 0",
        )
    if air is not None and not vehicle.flies_through_air:
        raise PeriluneError(
            "vehicle.drag_area is missing", got="an atmosphere, and a vehicle without drag",
            expected="vehicle.drag_area, ballistic_coefficient, or base_radius and cone_angle",
        )  # fmt: skip
    if air is None and site is not None:
        raise PeriluneError(
            "a site needs an atmosphere", got="a section [site], and no [atmosphere]",
            expected="both of them, or neither: the flight then ends at the interface",
        )  # fmt: skip
    if aim.minimise == "heat_load" and (air is None or vehicle.nose_radius is None):
        raise PeriluneError(
            "vehicle.nose_radius is missing" if air is not None else "without an atmosphere there is no heat load",
            expected="an atmosphere and vehicle.nose_radius, for the least heat load",
        )
