"""Final descent of a precision landing: straight down on the site, upright, to a touchdown not always at rest.

The flight before ends at the gate: above the site, at a stated height, with no horizontal velocity. It does not come
below that height. From there on the thrust points straight up and the vehicle moves along the vertical,

    up'' = throttle T/m + (apparent gravity)_up,   m' = -throttle T/(Isp g0)

until it meets the ground with a stated speed. The speed at the gate is chosen with everything else. What the turning of
a body pushes sideways, the attitude takes away; the tilt that this needs is left out, and stands in the pre-flight
(over the Moon it is less than a thousandth of a degree).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

from perilune.core import Physics, quantity, record
from perilune.models.physics.delta_v_bounds import gravity_at
from perilune.models.precision.path_constraints import Corridor, corridor_conditions
from perilune.problem import Conditions, FreeParameter, Phase, Quantities, Variable


@record("final")
class FinalDescent:
    """A vertical, upright end of the landing."""

    height: float = quantity(
        "m", "50 m", above=0.0, outside="must be positive",
        about="above the site, where the vertical, upright descent starts",
    )  # fmt: skip
    touchdown_speed: float = quantity(
        "m/s", "1 m/s", default=0.0, least=0.0, most=30.0, hint="a downward speed, without a sign",
        about="vertical speed at which the vehicle touches down",
    )  # fmt: skip


# In place of the time from ignition to touchdown, which is their sum.
GATE_TIME, FINAL_TIME = FreeParameter(name="gate_time", unit="s"), FreeParameter(name="final_time", unit="s")
TIMES = (
    Variable(name=GATE_TIME.name, unit="s", description="from ignition to the gate"),
    Variable(name=FINAL_TIME.name, unit="s", description="from the gate to touchdown"),
)


def with_final_descent(burn: Phase, corridor: Corridor) -> tuple[Phase, Phase]:
    """The burn to the gate, and the vertical descent, from the burn to rest on the site.

    Parameters
    ----------
    burn
        Phase of the burn to rest on the site.
    corridor
        Glide slope and tilt, None where not stated.
    """
    to_gate = replace(
        burn,
        duration=GATE_TIME.name,
        end=Conditions(
            _gate, gate_east="m", gate_north="m", gate_up="m", gate_east_speed="m/s", gate_north_speed="m/s"
        ),
        path=Conditions.of(burn.path, corridor_conditions(corridor, to_gate=True)),
        end_guess=_typical_gate,
    )
    kept = [burn.state_names.index(name) for name in _STATES]

    def seen(function: Physics | None) -> Physics | None:
        return function and partial(_on_the_vertical, function=function)

    def named(quantities: Quantities | None) -> Quantities | None:
        return quantities and quantities.with_function(partial(_on_the_vertical, function=quantities.function))

    descent = replace(
        burn,
        name="final_descent",
        states=tuple(burn.states[k] for k in kept),
        controls=tuple(c for c in burn.controls if c.names == ("throttle",)),
        dynamics=partial(_vertical_rates, function=burn.dynamics, kept=kept),
        duration=FINAL_TIME.name,
        end=Conditions(_vertical_touchdown, site_up="m", touchdown_speed="m/s"),
        path=Conditions(_vertical_height, height_above_site="m"),
        outputs=named(burn.outputs),
        integrals=named(burn.integrals),
        inertial=seen(burn.inertial),
        track=burn.track and partial(_vertical_track, function=burn.track),
        end_guess=_typical_touchdown,
    )
    return to_gate, descent


_STATES = ("up", "v_up", "m")


def at_gate(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """The vertical descent begins where the flight to the gate ends.

    Parameters
    ----------
    x
        State at the gate [SI].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        State of the vertical descent [SI].
    """
    return tuple(getattr(x, name) for name in _STATES)


def final_ranges(p: Any, typical_time: float) -> dict[str, tuple[float, float, float]]:
    """Return bounds and orders of magnitude of both times, given that of the whole.

    Parameters
    ----------
    p
        Parameters [SI].
    typical_time
        Order of magnitude of the duration of the whole flight [s].

    Returns
    -------
    dict[str, tuple[float, float, float]]
        By the name of the duration: least, greatest and typical [s].
    """
    # Its mean speed is half that of a fall from the gate.
    speed = math.sqrt(0.5 * gravity_at(getattr(p, "body_radius", 0.0), p) * p.final_height)
    down = p.final_height / max(speed, p.final_touchdown_speed)
    return {GATE_TIME.name: (0.0, math.inf, typical_time), FINAL_TIME.name: (0.0, math.inf, down)}


def _gate(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    return x.east, x.north, x.up - p.final_height, x.v_east, x.v_north


def _typical_gate(p: Any, xp: Any) -> Sequence[Any]:
    return 0.0, 0.0, p.final_height, 0.0, 0.0, 0.0, 0.8 * p.vehicle_mass


def _vertical_touchdown(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    return x.up, x.v_up + p.final_touchdown_speed


def _typical_touchdown(p: Any, xp: Any) -> Sequence[Any]:
    return 0.0, -p.final_touchdown_speed, 0.8 * p.vehicle_mass


def _vertical_height(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    return (x.up,)


def _expand_states(x: Any) -> Any:
    """Return all states of the burn from those on the vertical."""
    return SimpleNamespace(east=0.0, north=0.0, up=x.up, v_east=0.0, v_north=0.0, v_up=x.v_up, m=x.m)


def _expand_controls(u: Any) -> Any:
    """Return all components of the burn's control from an upright one."""
    return SimpleNamespace(toward_east=0.0, toward_north=0.0, toward_up=1.0, throttle=u.throttle)


def _on_the_vertical(x: Any, u: Any, *rest: Any, function: Physics) -> Sequence[Any]:
    """A function of (x, u, p, xp) or (x, u, t, p, xp) of the burn."""
    return function(_expand_states(x), _expand_controls(u), *rest)


def _vertical_rates(x: Any, u: Any, p: Any, xp: Any, *, function: Physics, kept: Sequence[int]) -> Sequence[Any]:
    rates = function(_expand_states(x), _expand_controls(u), p, xp)
    return [rates[k] for k in kept]


def _vertical_track(x: Any, p: Any, xp: Any, *, function: Physics) -> Sequence[Any]:
    return function(_expand_states(x), p, xp)
