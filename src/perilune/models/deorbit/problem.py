"""Return from orbit to the ground: coast, finite burn, coast to the interface, entry; Liu, Liu, Wu 2019, and beyond.

The phases are `coast` (where the orbit has a `longest_coast`: ignition is chosen), `burn`, `drift` (where the
transition has a `longest_coast`; otherwise the engine burns all the way, as in the paper), `entry` (where there is an
atmosphere) and `parachute` (where there is one). There is no air above the interface, and `burn` and `drift` never come
below it. `flight_time` counts from ignition; a coast before it has a time of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

from perilune.core import STANDARD_GRAVITY, Physics, Scales, check_call, require_records
from perilune.models.deorbit import (
    checks,
    dynamics as flight,
    initial_guess as times,
    orbit,
    outputs as told,
    parachute as parachutes,
)
from perilune.models.deorbit.duration_ranges import return_time_ranges
from perilune.models.deorbit.phases import DURATION_NAMES, continuity_link, entry_link, entry_phase, vacuum_phase
from perilune.models.deorbit.presolve import compare_return
from perilune.models.deorbit.records import (
    Aim,
    Atmosphere,
    Heating,
    Interface,
    Landing,
    Limits,
    Manoeuvre,
    Parachute,
    Returner,
    ReturnOrbit,
    Separation,
    Transition,
    engine_exhaust_speed,
)
from perilune.models.deorbit.trajectory_atmosphere import rough_air
from perilune.models.physics import atmosphere
from perilune.models.physics.atmosphere import Air
from perilune.models.physics.bodies import EARTH, Planet, catalogue_name
from perilune.models.physics.vehicle import Throttle
from perilune.problem import FreeParameter, Parameter, Problem, Quantities, given_of


def _total_time(x: Any, p: Any, xp: Any) -> Any:
    names = ("burn_time", "drift_time", "entry_time", "parachute_time")
    return sum(getattr(p, name) for name in names if hasattr(p, name))


def _transition_time(x: Any, p: Any, xp: Any) -> Any:
    return sum(getattr(p, name) for name in ("burn_time", "drift_time") if hasattr(p, name))


def _minus_mass(x: Any, p: Any, xp: Any) -> Any:
    """Return minus the mass left of the whole vehicle, of which another part may go on into the air."""
    if hasattr(x, "whole"):
        return -x.whole
    if hasattr(p, "separation_mass"):
        return p.vehicle_thrust / engine_exhaust_speed(p) * p.burn_time - p.vehicle_mass
    return -x.m


def _heat_load(x: Any, p: Any, xp: Any) -> Any:
    return x.heat


_OBJECTIVES = {
    "flight_time": (_total_time, "s"), "transition_time": (_transition_time, "s"),
    "propellant": (_minus_mass, "kg"), "heat_load": (_heat_load, "J/m^2"),
}  # fmt: skip


def _return_start(p: Any, xp: Any, *, angles: Physics) -> Sequence[Any]:
    angle, node = angles(p, xp)
    position, velocity = orbit.orbit_state(angle, node, p, xp)
    return *position, *velocity, p.vehicle_mass


@check_call
def deorbit_entry(
    vehicle: Returner,
    orbit_: ReturnOrbit,
    interface: Interface,
    body: Planet = EARTH,
    *,
    manoeuvre: Manoeuvre | None = None,
    transition: Transition | None = None,
    air: Atmosphere | Air | None = None,
    site: Landing | None = None,
    heating: Heating | None = None,
    separation: Separation | None = None,
    limits: Limits | None = None,
    parachute: Parachute | None = None,
    throttle: Throttle | None = None,
    minimise: str = "flight_time",
    epoch: str | None = None,
) -> Problem:
    """Return from an orbit to a place, or to the interface where there is no air.

    Parameters
    ----------
    vehicle, orbit_, interface, body
        What returns, from where, where the air begins, and on what body.
    manoeuvre
        Where on the orbit the flight begins; None: where the orbit says.
    transition
        The way to the interface after the burn; None: the engine burns all the way.
    air
        Atmosphere below the interface; None: the flight ends there.
    site
        Where the flight ends; None: anywhere at altitude 0.
    heating
        Constant of the heat rate, where the vehicle has a nose radius.
    separation
        What enters the air; None: the whole vehicle.
    limits
        Greatest load, heat rate and dynamic pressure in the air.
    parachute
        What takes over from the entry above the site; None: the flight ends where the entry does.
    throttle
        Range of the engine's throttle; None: it burns at full thrust.
    minimise
        ``"flight_time"`` from ignition to the end, ``"transition_time"`` to the interface, ``"propellant"`` or
        ``"heat_load"``.
    epoch
        Time at t = 0 in ISO 8601, for air that depends on it.

    Returns
    -------
    Problem
        States x, y, z [m], vx, vy, vz [m/s] in axes that turn with the body, m [kg]; free `burn_time` [s], and
        `coast_time`, `drift_time`, `entry_time`, `parachute_time` [s] of the phases that there are. Below the parachute
        the velocity is no state.

    Raises
    ------
    PeriluneError
        If the given values make no sense together. What physics forbids, `Problem.preflight` says.
    """
    aim, transition = Aim(minimise=minimise, epoch=epoch), transition or Transition()
    require_records((vehicle, Returner), (orbit_, ReturnOrbit), (interface, Interface), (body, Planet))
    flown = _resolve_air(air)
    site = Landing() if site is None and flown is not None else site
    if heating is None and flown is not None and vehicle.nose_radius is not None:
        heating = Heating()
    checks.refuse_incomplete(aim, vehicle, orbit_, manoeuvre, flown, site)
    checks.refuse_out_of_order(interface, site if flown is not None else None, parachute)
    checks.refuse_impossible_masses(vehicle, separation)
    checks.refuse_undetermined_lift(aim, vehicle, flown, site)
    checks.refuse_without_effect(vehicle, flown, heating, separation, limits, parachute)
    stated = (aim, body, orbit_, manoeuvre, vehicle, transition, interface, separation, heating, limits, parachute)
    named = air if isinstance(air, Atmosphere) else None
    stated = tuple(record for record in (*stated, throttle, site, named) if record is not None)
    # Of air in a table nothing but the table is left to be changed.
    numbers = (record for record in stated if not isinstance(record, Atmosphere) or record.model == "exponential")
    given = {**given_of(*numbers), "standard_gravity": Parameter(value=STANDARD_GRAVITY, unit="m/s^2")}
    angles = orbit.angles_of_node if manoeuvre is None else orbit.angles_of_place(manoeuvre.going)
    names = ("coast",) * (orbit_.longest_coast is not None) + ("burn",)
    names += ("drift",) * (transition.longest_coast is not None) + ("entry",) * (flown is not None)
    names += ("parachute",) * (parachute is not None)
    if named is not None and named.model == "nrlmsis":
        flown = rough_air(named, checks.require_epoch(aim), given, angles, names)
    checks.refuse_beyond_data(flown, interface, site)
    if flown is not None:
        given = {**flown.given, **given}
    above = [name for name in names if name not in ("entry", "parachute")]
    heat, nose = minimise == "heat_load", vehicle.nose_radius is not None
    left = next((name for name in ("vehicle_dry_mass", "separation_mass") if name in given), None)
    weighed = throttle is not None and separation is not None
    kept = flight.extra_entry_states(heat=heat, weighed=weighed)
    phases = [
        vacuum_phase(name, last=name == above[-1], interface=interface, left=left, throttled=throttle is not None)
        for name in above
    ]  # fmt: skip
    if flown is not None and site is not None:
        lifts, placed = vehicle.lift_to_drag is not None, site.longitude is not None
        bank = (vehicle.bank or "free") if lifts else None
        bound = limits or Limits()
        opens = parachute is not None
        phases.append(entry_phase(flown, bank=bank, nose=nose, kept=kept, placed=placed, limits=bound, opens=opens))
        if parachute is not None:
            phases.append(parachutes.parachute_phase(flown, kept=kept, placed_=placed))
    enter = partial(entry_link, heat=heat, weighed=weighed)
    links = [{"entry": enter, "parachute": parachutes.parachute_link}.get(name, continuity_link) for name in names[1:]]
    told_results = partial(told.return_results, names=names)
    if parachute is not None and flown is not None:
        told_results = partial(parachutes.parachute_results, names=names, air=flown)
    objective, objective_unit = _OBJECTIVES[minimise]
    time = math.sqrt(body.radius**3 / body.gravitational_parameter)
    return Problem(
        name="deorbit_entry",
        title=f"{vehicle.mass:g} kg from orbit to the {'interface' if flown is None else 'ground'}",
        phases=tuple(phases),
        links=tuple(links),
        start=partial(_return_start, angles=angles),
        given=given,
        free=tuple(FreeParameter(name=DURATION_NAMES[name], unit="s") for name in names),
        objective=objective,
        objective_unit=objective_unit,
        objective_scale=_objective_size_for_time(objective_unit, time),
        results=Quantities(told_results, *told.return_result_variables(names)),
        minimised=minimise,
        views=told.return_views(
            air=flown, heat=nose, coasts=_is_the_earth(body), given=given, body=catalogue_name(body), epoch=epoch or ""
        ),
        records=stated,
        preflight=partial(
            compare_return, angles=angles, air=flown, drifts="drift" in names, standard=_is_the_earth(body)
        ),
        parameter_bounds=partial(return_time_ranges, angles=angles, air=flown, names=names),
        initial_guess=partial(times.rough_trajectory, angles=angles, air=flown, names=names, heat=heat),
        scales=Scales(length=float(body.radius), time=time, mass=float(vehicle.mass)),
    )


def _is_the_earth(body: Planet) -> bool:
    """Return True for the Earth by any set of constants, so that its coasts lie below the flight."""
    same = (body.radius / EARTH.radius, body.rotation_rate / EARTH.rotation_rate)
    return all(abs(ratio - 1) < 0.01 for ratio in same)


def _objective_size_for_time(objective_unit: str, time: float) -> float | None:
    """Size of J: a state that is off by its canonical unit costs some ten to a hundred units of time."""
    return {"s": 10 * time, "J/m^2": 10 * flight.HEAT_SIZE}.get(objective_unit)


def _resolve_air(air: Atmosphere | Air | None) -> Air | None:
    """Return the air to fly through; the standard one in place of an epoch's, which depends on the trajectory."""
    if not isinstance(air, Atmosphere):
        return air
    if air.density is not None and air.scale_height is not None:
        return atmosphere.exponential(air.density, air.scale_height)
    if air.file is not None:
        return atmosphere.from_file(air.file)
    return atmosphere.standard()
