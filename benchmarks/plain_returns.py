"""Returns that nobody optimised: thrust in one direction beside the flight until its way down is steep enough.

From ignition on the thrust keeps a yaw beside the direction against the velocity, and a pitch below it, which may grow
evenly. It ends when the
coast that follows comes to the interface at a path angle; from there the vehicle falls. SciPy flies it through the
equations of the problem, and nothing is sought but the length of the burn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from perilune.core import NUMERIC
from perilune.models import Triple
from perilune.models.deorbit.dynamics import path_angle, position_vector, velocity_vector
from perilune.models.physics import ellipsoid
from perilune.problem import Phase, Problem

BURNS = 16  # lengths that are tried
SPENT = 0.98  # of the propellant, at most
HALVINGS = 40
NEAR = 1e-7  # rad
LONGEST_ENTRY = 4000.0  # s
RELATIVE, ABSOLUTE = 1e-6, 1.0  # tolerances of the flight


def landing(
    problem: Problem, coast: float, pitch: float, yaw: float, angle: float, turning: float = 0.0
) -> Triple | None:
    """Position [m] beside the body where the return of the shortest such burn lands; None where there is none.

    Parameters
    ----------
    problem
        A return to any place at an altitude: a coast or none, burn, drift, entry.
    coast
        Before ignition [s].
    pitch, yaw
        Of the thrust [rad], below the direction against the inertial velocity and to the left of it.
    angle
        At the interface, beside the body [rad].
    turning
        By how much the pitch grows with each radian of the way round the body.
    """
    p, phases = problem.parameters({}), {phase.name: phase for phase in problem.phases}
    state = np.array(problem.start(p, NUMERIC), dtype=float)
    if "coast" in phases:
        state, _ = _flown(phases["coast"], state, coast, p)
    ignited, thrust = state, _beside(state, pitch, yaw, turning, p)

    def down(length: float) -> tuple[Any, float]:
        """Where the flight with a burn comes to the interface, and by how much it is too flat there."""
        burnt, low = _flown(phases["burn"], ignited, length, p, thrust, p.interface_altitude)
        if low:  # with the engine on
            return burnt, -math.inf
        there, low = _flown(phases["drift"], burnt, p.transition_longest_coast, p, lowest=p.interface_altitude)
        return there, path_angle(phases["drift"].state_record(*there), NUMERIC) - angle if low else math.inf

    most = SPENT * (p.vehicle_mass - p.vehicle_dry_mass) * p.vehicle_exhaust_velocity / p.vehicle_thrust
    long = next((length for length in np.linspace(0.0, most, BURNS + 1)[1:] if down(length)[1] < 0), None)
    if long is None:
        return None
    short, there, flat = long - most / BURNS, state, math.inf
    for _ in range(HALVINGS):
        if abs(flat) < NEAR:
            break
        middle = (short + long) / 2
        there, flat = down(middle)
        short, long = (middle, long) if flat > 0 else (short, middle)
    if not abs(flat) < NEAR:  # the engine burns down to the interface before it is so steep
        return None
    entry = phases["entry"]
    ended, low = _flown(entry, there, LONGEST_ENTRY, p, lowest=p.site_altitude, highest=p.interface_altitude)
    slow = math.hypot(*velocity_vector(entry.state_record(*ended))) <= p.site_speed_upper
    return position_vector(entry.state_record(*ended)) if low and slow else None


def _beside(ignited: Any, first: float, yaw: float, turning: float, p: SimpleNamespace) -> Callable[[float, Any], Any]:
    """Direction of the thrust at a time [s] from ignition and a state."""
    radius = float(np.linalg.norm(ignited[:3]))
    rate = turning * math.sqrt(p.body_gravitational_parameter / radius**3)

    def thrust(t: float, state: Any) -> Any:
        pitch, position = first + rate * t, np.array(state[:3])
        velocity = np.array(state[3:6]) + p.body_rotation_rate * np.array([-position[1], position[0], 0.0])
        ahead = velocity / np.linalg.norm(velocity)
        left = np.cross(position, velocity)
        left /= np.linalg.norm(left)
        up = np.cross(ahead, left)
        return math.cos(yaw) * (-math.cos(pitch) * ahead - math.sin(pitch) * up) + math.sin(yaw) * left

    return thrust


def _flown(
    phase: Phase,
    state: Any,
    longest: float,
    p: SimpleNamespace,
    control: Callable[[float, Any], Any] = lambda *_: (),
    lowest: float = -math.inf,
    highest: float = math.inf,
) -> tuple[Any, bool]:
    """State after a time [s], or where an altitude [m] is reached on the way down; whether it is."""

    def down(_: float, y: Any) -> float:
        return float(ellipsoid.altitude(y[:3], p, NUMERIC)) - max(lowest, -p.body_radius)

    def up(_: float, y: Any) -> float:
        return float(ellipsoid.altitude(y[:3], p, NUMERIC)) - min(highest, 1e3 * p.body_radius)

    down.terminal = up.terminal = True  # type: ignore[attr-defined]
    down.direction, up.direction = -1.0, 1.0  # type: ignore[attr-defined]

    def rates(t: float, y: Any) -> Any:
        return phase.rates(y, control(t, y), p)

    flown = solve_ivp(rates, (0.0, longest), state, method="DOP853", events=(down, up), rtol=RELATIVE, atol=ABSOLUTE)
    return flown.y[:, -1], bool(len(flown.t_events[0]))
