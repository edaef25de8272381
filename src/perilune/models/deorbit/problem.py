"""Return from orbit to the ground: coast, finite burn, coast to the interface, entry; Liu, Liu, Wu 2019, and beyond.

The phases are `coast` (where the orbit has a `longest_coast`: ignition is chosen), `burn`, `drift` (where the
transition has a `longest_coast`; otherwise the engine burns all the way, as in the paper), `entry` (where there is an
atmosphere) and `parachute` (where there is one). There is no air above the interface, and `burn` and `drift` never come
below it. `flight_time` counts from ignition; a coast before it has a time of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import numpy as np

from perilune.core.arrays import Physics
from perilune.core.errors import PeriluneError
from perilune.core.units import STANDARD_GRAVITY, Scales
from perilune.core.validation import check_call, require_records
from perilune.models.deorbit import (
    checks,
    dynamics as flight,
    initial_guess as times,
    orbit,
    outputs as told,
    parachute as parachutes,
)
from perilune.models.deorbit.ballistic_fall import entry_end_altitude, fall
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
    least_mass_left,
)
from perilune.models.deorbit.site_passes import apsis_radii
from perilune.models.deorbit.trajectory_atmosphere import rough_air
from perilune.models.landing.problem import mass_state
from perilune.models.physics import atmosphere, ellipsoid
from perilune.models.physics.atmosphere import Air
from perilune.models.physics.bodies import EARTH, Planet, catalogue_name
from perilune.models.physics.coast import SHORTEST
from perilune.models.physics.delta_v_budget import SPENT
from perilune.models.physics.vehicle import THROTTLE, Throttle
from perilune.problem.parameters import given_of
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.variables import Free, Given, Variable

_DURATIONS = {
    "coast": "coast_time",
    "burn": "burn_time",
    "drift": "drift_time",
    "entry": "entry_time",
    "parachute": "parachute_time",
}
_CONDITIONS = {"altitude": "m", "speed": "m/s", "angle": "rad"}


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


def _next_phase_link(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """The next phase begins where one ends."""
    return tuple(x)


def _entry_link(x: Any, p: Any, xp: Any, *, heat: bool, weighed: bool) -> Sequence[Any]:
    """Return the link into the air: the entering mass, and if counted a heat load of 0 and the whole vehicle's mass."""
    entering = *tuple(x)[:-1], getattr(p, "separation_mass", x.m)
    return *entering, *((0.0,) if heat else ()), *((x.m,) if weighed else ())


def _interface_conditions(interface: Interface, *, left: str | None) -> tuple[Variable, ...]:
    found = [Variable(name="interface_altitude", unit="m")]
    for name in ("speed", "angle"):
        fixed, lower, upper = (getattr(interface, f"{name}{ending}") for ending in ("", "_lower", "_upper"))
        if fixed is None and lower is None and upper is None:
            continue
        bounds: dict[str, Any] = {}
        if lower is not None:
            bounds["lower"] = f"interface_{name}_lower"
        if upper is not None:
            bounds["upper"] = f"interface_{name}_upper"
        found.append(Variable(name=f"interface_{name}", unit=_CONDITIONS[name], **bounds))
    if left is not None:
        found.append(Variable(name="mass_left", unit="kg", lower=left))
    return tuple(found)


def _vacuum_phase(name: str, *, last: bool, interface: Interface, left: str | None, throttled: bool) -> Phase:
    """A phase between the orbit and the interface, under thrust or without; `left` names what its end must weigh."""
    burns = name == "burn"
    outputs = told.PLACED + ((told.PUSHED,) if burns else ())
    return Phase(
        name=name,
        states=(*flight.STATES, mass_state(False)),
        controls=(flight.STEERING, *((THROTTLE,) if throttled else ())) if burns else (),
        dynamics=flight.burn_rates if burns else flight.coast_rates,
        duration=_DURATIONS[name],
        end=flight.interface_end_values if last else None,
        end_conditions=_interface_conditions(interface, left=left if throttled else None) if last else (),
        path=None if name == "coast" else flight.height_above_interface,
        path_conditions=() if name == "coast" else (Variable(name="height_above_interface", unit="m"),),
        outputs=told.burn_outputs if burns else told.position_outputs,
        output_variables=outputs,
        integrals=told.burn_loss_rates if burns else None,
        integral_variables=SPENT if burns else (),
        marks=told.interface_outputs if last else None,
        mark_variables=told.AT_INTERFACE if last else (),
        inertial=told.inertial_burn if burns else told.inertial_without_thrust,
    )


def _entry_phase(
    air: Air, *, bank: str | None, nose: bool, kept: tuple[Variable, ...], placed: bool, limits: Limits, opens: bool
) -> Phase:
    names = flight.SITE if placed else flight.SITE[:1]
    ends = ("height_above_opening",) if opens else names
    limited = [name for name in flight.LIMITED if getattr(limits, name) is not None]
    return Phase(
        name="entry",
        states=(*flight.STATES, mass_state(False), *kept),
        controls=() if bank is None else (flight.BANKS[bank],),
        dynamics=partial(flight.entry_rates, air=air),
        duration=_DURATIONS["entry"],
        end=flight.parachute_opening_end if opens else flight.site_arrival,
        end_conditions=(
            *(Variable(name=name, unit="m") for name in ends),
            Variable(name="opening_speed" if opens else "landing_speed", unit="m/s", upper="site_speed_upper"),
        ),
        marks=told.opening_outputs if opens else None,
        mark_variables=told.AT_OPENING if opens else (),
        path=partial(flight.entry_path_margins, air=air) if limited else flight.depth_below_interface,
        path_conditions=(
            _IN_THE_AIR,
            *(_limit_variable(name, limits) for name in limited),
        ),
        outputs=partial(told.entry_outputs, air=air),
        output_variables=(*told.PLACED, *told.FELT, *((told.HEATED,) if nose else ())),
        integrals=partial(told.heat_load_rate, air=air) if nose else None,
        integral_variables=(told.HEAT_LOAD,) if nose else (),
        inertial=told.inertial_without_thrust,
    )


_LEVEL = 1e-12  # rad, of an orbit above the equator
_IN_THE_AIR = Variable(
    name="depth_below_interface", unit="m", description="negative where the entry leaves the air again"
)
_PARTS = 20  # of a limit: so many g0, the unit of a load, are a hard entry, and its touch is as well told


def _limit_variable(name: str, limits: Limits) -> Variable:
    """Return the variable of a limit's margin, with a scale of its own where mass and radius give a poor one."""
    own = float(getattr(limits, name)) / _PARTS if name in ("heat_rate", "dynamic_pressure") else None
    return Variable(name=f"{name}_left", unit=flight.LIMITED[name], scale=own)


def _return_ranges(
    p: Any, xp: Any, *, angles: Physics, air: Air | None, names: tuple[str, ...]
) -> dict[str, tuple[float, float, Callable[[], float]]]:
    """Bounds and orders of magnitude of the times; refuses a manoeuvre where the orbit never comes."""
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
        longest["entry_time"] = 10 * fall(p, air).time
        if hasattr(p, "parachute_altitude"):
            longest["parachute_time"] = 10 * parachutes.typical_parachute_time(p, air)
    least = {"coast_time": SHORTEST, "drift_time": SHORTEST}
    inside = {"coast_time": 0.98}  # of its longest: by how late it begins a flight knows its site
    typical = cache(partial(times.typical_times, p, angles, air, coasts=coasts, drifts=drifts))

    def likely(name: str) -> float:
        return min(typical()[name], inside.get(name, 0.9) * longest[name])

    return {name: (least.get(name, 0.0), most, partial(likely, name)) for name, most in longest.items()}


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
    given = {**given_of(*numbers), "standard_gravity": Given(value=STANDARD_GRAVITY, unit="m/s^2")}
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
        _vacuum_phase(name, last=name == above[-1], interface=interface, left=left, throttled=throttle is not None)
        for name in above
    ]  # fmt: skip
    if flown is not None and site is not None:
        lifts, placed = vehicle.lift_to_drag is not None, site.longitude is not None
        bank = (vehicle.bank or "free") if lifts else None
        bound = limits or Limits()
        opens = parachute is not None
        phases.append(_entry_phase(flown, bank=bank, nose=nose, kept=kept, placed=placed, limits=bound, opens=opens))
        if parachute is not None:
            phases.append(parachutes.parachute_phase(flown, kept=kept, placed_=placed))
    enter = partial(_entry_link, heat=heat, weighed=weighed)
    links = [{"entry": enter, "parachute": parachutes.parachute_link}.get(name, _next_phase_link) for name in names[1:]]
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
        free=tuple(Free(name=_DURATIONS[name], unit="s") for name in names),
        objective=objective,
        objective_unit=objective_unit,
        objective_scale=_objective_size_for_time(objective_unit, time),
        results=told_results,
        result_variables=told.return_result_variables(names),
        minimised=minimise,
        views=told.return_views(
            air=flown, heat=nose, coasts=_is_the_earth(body), given=given, body=catalogue_name(body), epoch=epoch or ""
        ),
        declared=stated,
        preflight=partial(
            compare_return, angles=angles, air=flown, drifts="drift" in names, standard=_is_the_earth(body)
        ),
        ranges=partial(_return_ranges, angles=angles, air=flown, names=names),
        rough_flight=partial(times.rough_trajectory, angles=angles, air=flown, names=names, heat=heat),
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
