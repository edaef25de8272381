"""Rough burn-coast-burn flight, from which the search for the landing of a strong lander begins.

Landings by two burns (`perilune.models.descent.two_burns`) near those by two impulses
(`perilune.models.descent.two_impulses`), in axes that turn with the body. Velocities there are relative to it, so that
the costate of place is lam_r - omega x lam_v.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from perilune.core import NUMERIC, Matrix
from perilune.models.descent.two_impulses import landing_start_of, two_impulses
from perilune.models.physics.delta_v_bounds import exhaust_speed, greatest_thrust
from perilune.problem import Curve, Problem, Solution, guess
from perilune.structures import Arc, Structure

if TYPE_CHECKING:
    from perilune.models.descent.two_burns import BurnArc, TwoBurns

_GROUND = "height_above_site"  # the condition that the coast touches
_MOST = 2  # of the best, of which better ones are looked for
_ALIKE = 1e-9  # relative difference of what lands
_BELOW = 1e-7  # of the radius: a flight that is lower meets the ground
_ROWS = (40, 5, 60, 5, 25)  # of the arcs


def rough_landing(problem: Problem) -> list[tuple[Solution, Structure]]:
    """Return burn-coast-burn flights of a powered descent, the best first.

    Parameters
    ----------
    problem
        In Cartesian coordinates, throttled, to rest anywhere.

    Returns
    -------
    list
        Rough flights with their arcs; none where there is no landing by two impulses, or the engine cannot be off.
    """
    from perilune.models.descent.burn_search import add_brief_burn, advance_second_burn, two_burns  # and with it CasADi
    from perilune.models.descent.two_burns import Burning

    p = problem.parameters({f.name: f.guess for f in problem.free})
    start = np.array(problem.start(p, NUMERIC), dtype=float)
    if p.throttle_lower > 0.0:
        return []
    burning = Burning(mass=float(start[6]), force=greatest_thrust(p), exhaust=exhaust_speed(p))
    landings = two_impulses(around := landing_start_of(p, start))
    at_once = bool(landings) and landings[0].wait == 0.0  # else it lies on an apsis, and waits for a moment
    found = (two_burns(around, landing, burning, at_once=at_once and landing.wait == 0.0) for landing in landings)
    best = _distinct_landings(filter(None, found))
    for another in (advance_second_burn, add_brief_burn):
        more = [another(one, at_once=at_once and one.lengths[0] == 0.0) for one in best[:_MOST]]
        best = _distinct_landings([*more, *best[_MOST:]])
    return [_guess_of_flight(problem, one, p.body_rotation_rate, (p.throttle_lower, p.throttle_upper)) for one in best]


def _distinct_landings(found: Iterable[TwoBurns]) -> list[TwoBurns]:
    """Return landings of different masses, the greatest first; of those alike the shortest, as a turn later is."""
    kept: list[TwoBurns] = []
    for one in sorted(found, key=lambda one: float(one.lengths.sum())):
        if all(abs(one.landed - known.landed) > _ALIKE * one.landed for known in kept):
            kept.append(one)
    return sorted(kept, key=lambda one: -one.landed)


def _guess_of_flight(
    problem: Problem, flight: TwoBurns, rate: float, throttle: tuple[float, float]
) -> tuple[Solution, Structure]:
    """Return a flight as a guess in axes that turn at a rate [rad/s], with its arcs and costates."""
    legs = list(flight.legs(_ROWS[:2] * flight.brief + _ROWS[2:]))
    arcs = tuple(
        Arc(
            regimes=(("throttle", "upper" if leg.burns else "lower"),),
            touches=(_GROUND,) if leg.touches else (),
            until=float(leg.times[-1]),
        )
        for leg, after in zip(legs, [*legs[1:], None], strict=True)
        if leg.touches or after is None or after.burns is not leg.burns
    )
    seen = [_leg_in_body_axes(leg, rate) for leg in legs]
    rows = [(0 if k == 0 else 1, leg, one) for k, (leg, one) in enumerate(zip(legs, seen, strict=True))]
    times = np.concatenate([leg.times[first:] for first, leg, _ in rows])
    states = np.concatenate([one[0][first:] for first, _, one in rows])
    controls = np.concatenate([
        np.column_stack([-primer / np.linalg.norm(primer, axis=1)[:, None], np.full(len(primer), throttle[leg.burns])])
        for first, leg, (_, costates) in rows
        for primer in (costates[first:, 3:6],)
    ])  # fmt: skip
    solution = guess(problem, times, states, controls)
    costate = Curve(
        time=np.concatenate([leg.times for leg in legs]),
        values=np.concatenate([one[1] for one in seen]),
        rates=np.concatenate([np.gradient(one[1], leg.times, axis=0) for leg, one in zip(legs, seen, strict=True)]),
    )
    trajectories = (replace(solution.trajectories[0], costate=costate),)
    lowest = min(float(np.linalg.norm(leg.states[:3], axis=0).min()) for leg in legs)
    landed = flight.landed if lowest > flight.around.radius * (1 - _BELOW) else math.nan  # none that is flown
    return replace(solution, objective=-landed, trajectories=trajectories), Structure((arcs,))


def _leg_in_body_axes(leg: BurnArc, rate: float) -> tuple[Matrix, Matrix]:
    """Return the states and costates (n, 7) of an arc in axes that turn with the body."""
    turning = np.array([0.0, 0.0, rate])
    states, costates = leg.states.T.copy(), leg.costates.T.copy()
    states[:, 3:6] -= np.cross(turning, states[:, :3])
    costates[:, :3] -= np.cross(turning, costates[:, 3:6])
    for k, t in enumerate(leg.times):
        c, s = math.cos(rate * t), math.sin(rate * t)
        turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        for row in (states[k], costates[k]):
            row[:3], row[3:6] = turned @ row[:3], turned @ row[3:6]
    return states, costates
