"""Conditions on states alone that a flight touches or rides along: their multipliers are jumps of the costates.

Where S(x, p) >= 0 is touched, at a time of the flight's own choice,

    lam(t-) = lam(t+) + nu dS/dx,   nu <= 0,   H(t-) = H(t+),

nu being the change of J as the condition is moved, J + nu S. The flight is cut there, and at the beginning and the end
of every arc that rides along S = 0, and proved as an answer of the problem restated with these arcs as phases
(`perilune.structures.restate`), whose conditions at the cuts are S = 0 and its derivatives. Where to cut is found here,
by the tables themselves. A neighbour of the flight that does not touch S pays to first order where nu < 0 strictly.

Arcs that are ridden have a file of their own (`ridden`).

Source: Bryson and Ho (1975), sections 3.11-3.13; Hartl, Sethi, Vickson (1995), sections 4 and 5.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from perilune.problem.controls import scalars
from perilune.problem.solution import Solution
from perilune.problem.verification import Check
from perilune.proof.arc import Arc
from perilune.proof.extremal import STATIONARY_LIMIT, end_multipliers
from perilune.proof.switching import on_bounds
from perilune.structures.carry import split
from perilune.structures.read import Contact, arcs_of, of_states, room_along
from perilune.structures.structure import Condition, Structure, conditions_of, moved_by
from perilune.words.outcome import PeriluneError
from perilune.words.types import Vector

_ON = 1e-7  # of what a condition goes through: it is met
_JUMP = 1e-9  # of a costate's size: less is no jump
# The multiplier along an arc is a polynomial in time, to rounding; its derivatives are noise below a share of it.
_DEGREE, _ROUGH, _ALONG = 12, 1e-6, 1e-4
_LEAST, _LOOKS = 1e-8, 200  # of H, and the points of an arc at which other controls are tried
_MET = 1e-9  # of its size: a condition that is met, or its rate
_SIDEWAYS = 1e-6  # the same of what H told: it is continuous there to a double root only
_STRICT = 1e-6  # of J per condition, canonical: a touch with a smaller multiplier may be none


def cut(solution: Solution) -> tuple[Solution, Structure]:
    """The solution as one of the problem restated with what it touches and rides along; itself if nothing."""
    phases = []
    for k, flown in enumerate(solution.trajectories):
        arc = Arc(solution=solution, index=k)
        names = of_states(solution.problem, k) if flown.costate is not None else []
        phases.append(arcs_of(solution.problem, k, [c for name in names for c in _contacts(arc, name)], flown.duration))
    structure = Structure(tuple(phases))
    return solution if structure.plain else split(solution, structure), structure


def _contacts(arc: Arc, name: str) -> Iterator[Contact]:
    """Where a condition is met between the edges of the tables, or at one where the costates jump."""
    edges = _edges(arc)
    if not len(edges):
        return
    t, room = room_along(arc.solution, arc.index, name)
    met = np.abs(room) <= _ON * float(np.ptp(room))
    if not met.any() or (order := _order(arc, name)) is None:
        return
    ends = [0.0, *edges.tolist(), arc.duration]
    riding = [bool(met[(t >= a) & (t <= b)].all()) for a, b in pairwise(ends)]
    begin = None
    for i, rides in enumerate([*riding, False]):
        if rides and begin is None:
            begin = ends[i]
        elif not rides and begin is not None:
            if not _by_bounds(arc, name, begin, ends[i]):
                yield Contact(name=name, begin=begin, end=ends[i], ridden=True)
            begin = None
    for i, time in enumerate(edges.tolist()):
        if order > 1 and not (riding[i] or riding[i + 1]) and met[np.argmin(np.abs(t - time))] and _jumps(arc, time):
            yield Contact(name=name, begin=time, end=time, ridden=False)


def _order(arc: Arc, name: str) -> int | None:
    """Of a condition; None where no control moves it."""
    try:
        return conditions_of(arc.problem, arc.index, (name,))[name].order
    except PeriluneError:
        return None


def _by_bounds(arc: Arc, name: str, begin: float, end: float) -> bool:
    """Whether a condition is met and holds nothing back: the controls that move it are on bounds, lam does not jump.

    An empty tank stays empty while the engine is off. Then it has no multiplier, and the checks are made without one.
    """
    condition = conditions_of(arc.problem, arc.index, (name,))[name]
    moving = moved_by(condition)
    u = arc.control(np.linspace(begin, end, _LOOKS + 2)[1:-1])
    on = {
        control.name: bool(np.logical_or(*on_bounds(arc, at, control, u)).all())
        for at, control in scalars(arc.phase.controls)
    }
    return all(on.get(control, False) for control in moving) and not any(_jumps(arc, t) for t in (begin, end))


def _edges(arc: Arc) -> Vector:
    """Times inside the phase at which a table begins anew [s]."""
    found = [curve.time[1:][np.diff(curve.time) == 0] for curve in arc.curves]
    times = np.unique(np.concatenate(found))
    return times[(times > 0) & (times < arc.duration)]


def _jumps(arc: Arc, time: float) -> bool:
    """Whether the costates jump at a time, where the physics does not."""
    curve = arc.trajectory.costate
    if curve is None or np.isin(time, arc.crossed).any():
        return False
    at = np.nonzero(curve.time == time)[0]
    size = np.abs(curve.values).max(axis=0)
    return len(at) > 1 and bool((np.abs(curve.values[at[-1]] - curve.values[at[0]]) > _JUMP * size).any())


def signs(solution: Solution, parts: Solution, structure: Structure) -> Iterator[Check]:
    """Checks of levels 2 and 3: the multipliers at what is touched.

    Parameters
    ----------
    solution, parts, structure
        Of `cut`.
    """
    number = 0
    for k, arcs in enumerate(structure.phases):
        conditions = conditions_of(solution.problem, k, structure.named(k))
        for arc in arcs:
            part = Arc(solution=parts, index=number)
            number += 1
            yield from (check for name in arc.touches for check in _touch(part, conditions[name]))


def _touch(part: Arc, condition: Condition) -> Iterator[Check]:
    nu, _ = end_multipliers(part)
    name, row = condition.name, {c.name: i for i, c in enumerate(part.phase.end_conditions)}
    at, rate = (row[condition.rated(i, "touch_", 1.0).name] for i in (0, 1))
    scaled = nu * part.end_scale / part.objective_scale
    yield _met(part, [at, rate], name)
    yield Check(
        name=f"{part.prefix}touch", level=2, unit="1", limit=STATIONARY_LIMIT, value=max(0.0, float(scaled[at])),
        meaning=f"what J would gain if the flight left {name} where it touches it (scaled): the multiplier is not "
        "positive",
    )  # fmt: skip
    yield Check(
        name=f"{part.prefix}touch_jump", level=2, unit="1", limit=_SIDEWAYS, value=abs(float(scaled[rate])),
        meaning=f"jump of the costates along the slope of the rate of {name}, where it is touched (scaled): they jump "
        "along its own slope alone",
    )  # fmt: skip
    yield Check(
        name=f"{part.prefix}strict_touch", level=3, unit="1", limit=-_STRICT, value=float(scaled[at]),
        meaning=f"multiplier of {name} where it is touched (scaled): strictly negative, so that a flight that does not "
        "touch it pays to first order",
    )  # fmt: skip


def _met(part: Arc, rows: list[int], name: str) -> Check:
    """What was taken as a contact is one: the conditions at the end of the part vanish."""
    end = part.state(np.array([part.duration]))[:, 0].tolist()
    values = np.array(part.phase.evaluate("end", end, (), part.p), dtype=float) / part.end_scale
    return Check(
        name=f"{part.prefix}met", level=2, unit="1", limit=_MET, value=float(np.abs(values[rows]).max()),
        meaning=f"{name} and its rates where the flight is said to meet it (scaled): they vanish",
    )  # fmt: skip
