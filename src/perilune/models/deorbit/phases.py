"""Phases of a return: coast, burn and drift in vacuum, and the entry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from perilune.models.deorbit import dynamics as flight, outputs as told
from perilune.models.deorbit.records import Interface, Limits
from perilune.models.landing.problem import mass_state
from perilune.models.physics.atmosphere import Air
from perilune.models.physics.delta_v_budget import SPENT
from perilune.models.physics.vehicle import THROTTLE
from perilune.problem import Conditions, Phase, Quantities, Variable

DURATION_NAMES = {
    "coast": "coast_time",
    "burn": "burn_time",
    "drift": "drift_time",
    "entry": "entry_time",
    "parachute": "parachute_time",
}
_CONDITIONS = {"altitude": "m", "speed": "m/s", "angle": "rad"}


def continuity_link(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """Return the state at the end of a phase, with which the next begins.

    Parameters
    ----------
    x
        State [SI], components by name.
    p, xp
        Parameters [SI] and maths namespace.
    """
    return tuple(x)


def entry_link(x: Any, p: Any, xp: Any, *, heat: bool, weighed: bool) -> Sequence[Any]:
    """Return the link into the air: the entering mass, and if counted a heat load of 0 and the whole vehicle's mass.

    Parameters
    ----------
    x
        State at the interface [SI].
    p, xp
        Parameters [SI] and maths namespace.
    heat, weighed
        Count the heat load [J/m^2], and keep the mass of the whole vehicle [kg].

    Returns
    -------
    Sequence[Any]
        State with which the entry begins [SI].
    """
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


def vacuum_phase(name: str, *, last: bool, interface: Interface, left: str | None, throttled: bool) -> Phase:
    """Return a phase between the orbit and the interface, with or without thrust; `left` names its least final mass.

    Parameters
    ----------
    name
        "coast", "burn" or "drift".
    last
        Let it end at the interface.
    interface
        What is stated there: altitude, speed, path angle.
    left
        Parameter that is the least mass at the end of a throttled burn [kg]; None for no such bound.
    throttled
        Let the throttle of the burn be a control.
    """
    burns = name == "burn"
    outputs = told.PLACED + ((told.PUSHED,) if burns else ())
    return Phase(
        name=name,
        states=(*flight.STATES, mass_state(False)),
        controls=(flight.STEERING, *((THROTTLE,) if throttled else ())) if burns else (),
        dynamics=flight.burn_rates if burns else flight.coast_rates,
        duration=DURATION_NAMES[name],
        end=Conditions(flight.interface_end_values, *_interface_conditions(interface, left=left if throttled else None))
        if last
        else None,
        path=None if name == "coast" else Conditions(flight.height_above_interface, height_above_interface="m"),
        outputs=Quantities(told.burn_outputs if burns else told.position_outputs, *outputs),
        integrals=Quantities(told.burn_loss_rates, *SPENT) if burns else None,
        end_outputs=Quantities(told.interface_outputs, *told.AT_INTERFACE) if last else None,
        inertial=told.inertial_burn if burns else told.inertial_without_thrust,
    )


def entry_phase(
    air: Air, *, bank: str | None, nose: bool, kept: tuple[Variable, ...], placed: bool, limits: Limits, opens: bool
) -> Phase:
    """Return the phase in the air; it ends at the site, or where the parachute opens.

    Parameters
    ----------
    air
        Density of the air against altitude.
    bank
        Key of `dynamics.BANKS`, the directions of the lift; None for a vehicle without lift.
    nose
        Return heat rate and heat load as well.
    kept
        States in addition to the motion: heat load, mass of the whole vehicle.
    placed
        Let it end at a place rather than at an altitude.
    limits
        Greatest load, heat rate and dynamic pressure, None where not stated.
    opens
        Let it end where the parachute opens.
    """
    names = flight.SITE if placed else flight.SITE[:1]
    ends = ("height_above_opening",) if opens else names
    limited = [name for name in flight.LIMITED if getattr(limits, name) is not None]
    return Phase(
        name="entry",
        states=(*flight.STATES, mass_state(False), *kept),
        controls=() if bank is None else (flight.BANKS[bank],),
        dynamics=partial(flight.entry_rates, air=air),
        duration=DURATION_NAMES["entry"],
        end=Conditions(
            flight.parachute_opening_end if opens else flight.site_arrival,
            *(Variable(name=name, unit="m") for name in ends),
            Variable(name="opening_speed" if opens else "landing_speed", unit="m/s", upper="site_speed_upper"),
        ),
        end_outputs=Quantities(told.opening_outputs, *told.AT_OPENING) if opens else None,
        path=Conditions(
            partial(flight.entry_path_margins, air=air) if limited else flight.depth_below_interface,
            _IN_THE_AIR,
            *(_limit_variable(name, limits) for name in limited),
        ),
        outputs=Quantities(
            partial(told.entry_outputs, air=air), *told.PLACED, *told.FELT, *((told.HEATED,) if nose else ())
        ),
        integrals=Quantities(partial(told.heat_load_rate, air=air), told.HEAT_LOAD) if nose else None,
        inertial=told.inertial_without_thrust,
    )


_IN_THE_AIR = Variable(
    name="depth_below_interface", unit="m", description="negative where the entry leaves the air again"
)
_PARTS = 20  # of a limit: so many g0, the unit of a load, are a hard entry, and its touch is as well told


def _limit_variable(name: str, limits: Limits) -> Variable:
    """Return the variable of a limit's margin, with a scale of its own where mass and radius give a poor one."""
    own = float(getattr(limits, name)) / _PARTS if name in ("heat_rate", "dynamic_pressure") else None
    return Variable(name=f"{name}_left", unit=flight.LIMITED[name], scale=own)
