"""Deorbit opportunities of the days ahead: the passes over a site, the turn each needs, and who can make it.

Three verdicts: *reachable*, where there is a tenth more than what a typical descent with the turn in its burn takes,
and the problem allows this descent: engine off before the interface, and at the interface a speed within its bounds;
*out of reach*, where no flight comes to the site on that pass, by the bound that also refuses to solve; *doubtful* in
between.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, ClassVar

import numpy as np

from perilune.core import (
    NUMERIC,
    InfeasibleError,
    PeriluneError,
    RenamedAttribute,
    check_call,
    require_type,
)
from perilune.models.deorbit.ballistic_fall import turning_speed
from perilune.models.deorbit.initial_guess import estimate_descent
from perilune.models.deorbit.orbit import plane_axes, radius_and_speeds
from perilune.models.deorbit.presolve import OFF_PLANE
from perilune.models.deorbit.records import (
    Aim,
    Manoeuvre,
    engine_exhaust_speed,
    total_velocity_change,
)
from perilune.models.deorbit.secular_drift import Drift, drift
from perilune.models.deorbit.site_passes import Pass, apsis_radii, find_passes, nearest_approach_to_plane
from perilune.models.physics import ellipsoid
from perilune.models.physics.delta_v_bounds import greatest_thrust
from perilune.models.physics.rotating_frame import scalar_product
from perilune.problem import Problem

MOST_DAYS = 60.0  # after which secular rates of first order, and no drag on the orbit, say little
_DAY = 86400.0  # s
_SPARE = 1.1  # times what a typical descent takes
_SHORT = 0.5  # of the way to the interface: a burn beside which that descent, of an impulse, is a picture of the flight
_ROUGHLY = 20.0  # m/s, of oblateness and of a burn that is no impulse
REACHABLE, DOUBTFUL, OUT_OF_REACH = "reachable", "doubtful", "out of reach"


@dataclass(frozen=True, kw_only=True)
class Opportunity(Pass):
    """A pass, and what can be made of it; SI units and radians.

    Parameters
    ----------
    distance
        Of the site from the plane of the orbit, along the ground [m].
    available_velocity_change
        Velocity change of all propellant [m/s].
    verdict
        ``"reachable"``, ``"doubtful"`` or ``"out of reach"``.
    utc
        Time of ignition, where the problem has an epoch.
    settings
        Changes of the scenario, by key, with which the flight to this pass is solved.
    """

    distance: float
    available_velocity_change: float
    verdict: str
    utc: datetime | None
    settings: Mapping[str, str]
    available: ClassVar[RenamedAttribute] = RenamedAttribute("available_velocity_change")


@check_call
def opportunities(problem: Problem, days: float) -> tuple[Opportunity, ...]:
    """Return all passes over the site of a return whose ignition is within some days from t = 0.

    Parameters
    ----------
    problem
        A return of `perilune.models.deorbit.problem.deorbit_entry` to a place, as its own model or a scenario made it.
    days
        How far ahead to look, at most `MOST_DAYS`.

    Raises
    ------
    PeriluneError
        If the problem is no return, names no site or no dry mass, or the days are out of range.
    """
    require_type(problem, Problem, "a problem to list opportunities of")
    _refuse_unfit(problem, days)
    p = problem.parameters({})
    if apsis_radii(p)[0] < p.body_radius + p.interface_altitude:
        raise InfeasibleError(
            "the orbit enters the atmosphere by itself before any other pass", got="a perigee below the interface",
            expected="a perigee above it", advice="a higher orbit, or a lower interface.altitude",
        )  # fmt: skip
    state = [float(value) for value in problem.start(p, NUMERIC)]
    orbit, entry = drift(state[:3], state[3:6], p), _typical_entry(problem, p)
    found = find_passes(p, orbit, entry, drifts="drift_time" in problem.free_names, until=days * _DAY)
    return tuple(_classify_pass(problem, p, one, orbit, entry) for one in found)


def refuse_no_opportunity(found: Sequence[Opportunity], days: float) -> None:
    """Raise InfeasibleError, naming the nearest pass, if no pass can be made.

    Parameters
    ----------
    found
        Passes, as `opportunities` returns them.
    days
        How far ahead was looked [days].
    """
    if any(one.verdict != OUT_OF_REACH for one in found):
        return
    near = min(found, key=lambda one: abs(one.out_of_plane_angle), default=None)
    raise InfeasibleError(
        f"the site is out of reach on every pass within {days:g} days",
        got="no pass"
        if near is None
        else f"the nearest is {math.degrees(abs(near.out_of_plane_angle)):.3g} deg"
        f" ({near.distance / 1e3:.0f} km) off, {near.ignition / 3600:.2f} h after t = 0",
        expected="a pass for which the propellant suffices to turn the plane of the orbit",
        advice="more --days, more propellant, or another site",
    )


def _refuse_unfit(problem: Problem, days: float) -> None:
    if problem.name != "deorbit_entry" or problem.initial_guess is None:
        raise PeriluneError(
            "only a return from orbit has opportunities", got=f"a problem called {problem.name}"[:80],
            expected='a scenario of kind = "deorbit_entry"',
        )  # fmt: skip
    if "site_longitude" not in problem.given:
        raise PeriluneError(
            "opportunities need a site", expected="site.longitude and site.latitude",
            advice="without a site any time is as good",
        )  # fmt: skip
    if "vehicle_dry_mass" not in problem.given:
        raise PeriluneError(
            "the amount of propellant is not stated", expected="vehicle.dry_mass",
            advice="state the mass that must be left after the burn",
        )  # fmt: skip
    if not 0 < days <= MOST_DAYS:
        raise PeriluneError(
            "the number of days is out of range", got=f"{days:g}", expected=f"above 0, at most {MOST_DAYS:g}",
            advice="the neglected drag on the orbit matters sooner: start from a newer orbit",
        )  # fmt: skip


def _typical_entry(problem: Problem, p: Any) -> tuple[float, float]:
    """Time [s] of a typical fall through the air, and the angle swept [rad] in inertial axes."""
    assert problem.parameter_bounds is not None and problem.initial_guess is not None
    times = {name: typical() for name, (_, _, typical) in problem.parameter_bounds(p, NUMERIC).items()}
    rows = problem.initial_guess(problem.parameters(times))[problem.duration_names.index("entry_time")]
    place = rows[:, :3] / np.linalg.norm(rows[:, :3], axis=1)[:, None]
    first, last, turned = place[0], place[-1], p.body_rotation_rate * times["entry_time"]
    carried = [
        last[0] * math.cos(turned) - last[1] * math.sin(turned),
        last[0] * math.sin(turned) + last[1] * math.cos(turned),
        last[2],
    ]
    return times["entry_time"], math.acos(max(-1.0, min(1.0, scalar_product(first, carried))))


def _classify_pass(problem: Problem, p: Any, found: Pass, orbit: Drift, entry: tuple[float, float]) -> Opportunity:
    available = total_velocity_change(p)
    start = max(found.ignition - 0.5 * getattr(p, "orbit_longest_coast", 0.0), 0.0)
    if _SPARE * found.velocity_change <= available and _allows_descent(problem, p, found, orbit, entry[0]):
        verdict = REACHABLE
    else:
        away, turned = nearest_approach_to_plane(p, orbit.later(start), entry, found.landing - start)
        beyond = away > turned + OFF_PLANE and not hasattr(p, "vehicle_lift_to_drag")
        verdict = OUT_OF_REACH if beyond else DOUBTFUL
    aim = next((record for record in problem.records if isinstance(record, Aim)), Aim())
    utc = aim.instant()
    settings = _orbit_settings_at(problem, p, orbit, start)
    if utc is not None:
        settings["problem.epoch"] = f"{utc + timedelta(seconds=start):%Y-%m-%dT%H:%M:%SZ}"
    return Opportunity(
        **vars(found), distance=abs(found.out_of_plane_angle) * float(p.body_radius),
        available_velocity_change=available, verdict=verdict,
        utc=None if utc is None else utc + timedelta(seconds=found.ignition), settings=settings,
    )  # fmt: skip


def _allows_descent(problem: Problem, p: Any, found: Pass, orbit: Drift, entry: float) -> bool:
    """Return True if the problem allows the typical descent: a short burn, a coast, and its speed at the interface."""
    exhaust, gate = engine_exhaust_speed(p), p.body_radius + p.interface_altitude
    burn = p.vehicle_mass * exhaust / greatest_thrust(p) * (1 - math.exp(-found.velocity_change / exhaust))
    if "drift_time" not in problem.free_names or burn > _SHORT * (found.landing - found.ignition - entry):
        return False
    angle = float(orbit.at(found.ignition)[0]) - orbit.perigee_rate * found.ignition
    radius, rise, level = (float(v) for v in radius_and_speeds(angle, p, NUMERIC))
    left = math.hypot(rise, level) - estimate_descent(p, angle, drifts=True).velocity_change
    fallen = 2 * p.body_gravitational_parameter * (1 / gate - 1 / radius)
    speed = math.sqrt(max(left * left + fallen, 0.0)) - turning_speed(p, gate)
    stated = getattr(p, "interface_speed", None)
    lower, upper = getattr(p, "interface_speed_lower", stated), getattr(p, "interface_speed_upper", stated)
    return (lower is None or speed > lower - _ROUGHLY) and (upper is None or speed < upper + _ROUGHLY)


def _orbit_settings_at(problem: Problem, p: Any, orbit: Drift, start: float) -> dict[str, str]:
    """Return the orbit at a time [s], in the keys with which the problem states it."""
    angle, node = (float(value) for value in orbit.at(start))
    perigee = {}
    if hasattr(p, "orbit_argument_of_perigee"):
        perigee["orbit.argument_of_perigee"] = _degrees(orbit.perigee + orbit.perigee_rate * start)
    if any(isinstance(record, Manoeuvre) for record in problem.records):
        up, _ = plane_axes(angle, node, p, NUMERIC)
        distance = float(radius_and_speeds(angle - orbit.perigee_rate * start, p, NUMERIC)[0])
        latitude = float(ellipsoid.latitude([distance * part for part in up], p, NUMERIC))
        return {
            "manoeuvre.longitude": _degrees(math.atan2(up[1], up[0])), "manoeuvre.latitude": _degrees(latitude),
            "manoeuvre.pass": "ascending" if math.cos(angle) > 0 else "descending", **perigee,
        }  # fmt: skip
    return {"orbit.node_longitude": _degrees(node), "orbit.argument_of_latitude": _degrees(angle), **perigee}


def _degrees(angle: float) -> str:
    return f"{math.degrees(math.remainder(angle, 2 * math.pi)):.6f} deg"
