"""Contact points and boundary arcs of pure state conditions: their multipliers are jumps of the costates.

Where S(x, p) >= 0 has a contact point, at a time of the flight's own choice,

    lam(t-) = lam(t+) + nu dS/dx,   nu <= 0,   H(t-) = H(t+),

nu being the change of J as the condition is moved, J + nu S. The flight is cut there, and at the beginning and the end
of every boundary arc S = 0, and proved as an answer of the problem restated with these arcs as phases
(`perilune.structures.multiphase`), whose conditions at the cuts are S = 0 and its derivatives. Where to cut is found
here, by the tables themselves. A neighbour of the flight without the contact pays to first order where nu < 0
strictly.

Boundary arcs have files of their own (`boundary_arc` here, `boundary_arcs` in `perilune.proof.sufficient`).

Source: Bryson and Ho (1975), sections 3.11-3.13; Hartl, Sethi, Vickson (1995), sections 4 and 5.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np

from perilune.core import NUMERIC, Vector
from perilune.problem import Check, Expression, Solution, depends_on_control, full, scalars
from perilune.proof.feasible.phase_data import PhaseData, phase_data_of
from perilune.proof.necessary.constraint_activity import LEAST, table_edges
from perilune.proof.necessary.first_order import STATIONARY_LIMIT, phase_end_multipliers
from perilune.proof.necessary.minimum_principle import on_bounds
from perilune.structures import (
    Condition,
    Contact,
    Structure,
    arcs_of,
    conditions_of,
    margins,
    plain_bounds,
    restate,
    split_solution,
)

_ON = 1e-7  # of what a condition goes through: it is active
_HELD = 1e-7  # of the most that its rate with the control in it is: that vanishes
_SAID = 1e-6  # of the costates where a phase ends, scaled: what end conditions leave of them is nothing
_JUMP = 1e-9  # of a costate's size: less is no jump
MET = 1e-9  # of its size: a condition that is active, or its rate
SIDEWAYS = 1e-6  # of a multiplier, relative to that from H, which is continuous there to a double root only
_POINTS = 2000  # times of a phase, in addition to the nodes of its tables
_LOOKS = 200  # times of an arc
STRICT = 1e-6  # of J per condition, canonical: a contact point with a smaller multiplier may be none


def restate_with_contacts(solution: Solution) -> tuple[Solution, Structure]:
    """Return the solution of the problem restated with its contact points and boundary arcs; itself if none."""
    phases = []
    for k, flown in enumerate(solution.trajectories):
        arc = phase_data_of(solution)[k]
        known = margins(solution.problem, arc.index) if flown.costate is not None else {}
        found = [
            c for name, (_, S, _) in known.items() if not depends_on_control(S) for c in _contact_times(arc, name, S)
        ]
        phases.append(arcs_of(solution.problem, k, found, arc.duration))
    structure = Structure(tuple(phases))
    if structure.plain:
        return solution, structure
    if any(arcs[-1].along for arcs in structure.phases):
        # The costates may be those of end conditions that the arc says again, or of a statement without: both are one.
        # Where multipliers are claimed of these it is the first, in which they can be compared.
        fewer = split_solution(solution, structure, restate(solution.problem, structure, repeated=False))
        stated = {f"{phase.name}.{c.name}" for phase in fewer.problem.phases for c in phase.end_conditions}
        arcs = phase_data_of(fewer)
        if fewer.multipliers.keys() <= stated and all(
            np.abs(phase_end_multipliers(arc)[1]).max() <= _SAID for arc in arcs
        ):
            return fewer, structure
    return split_solution(solution, structure), structure


def _contact_times(arc: PhaseData, name: str, S: Expression) -> Iterator[Contact]:
    """Yield the contacts of a condition: arcs between edges of the tables, and edges at which the costates jump."""
    edges, size = table_edges(arc), LEAST * _condition_size(arc, name)
    t = np.union1d(arc.trajectory.time, np.linspace(0.0, arc.duration, _POINTS))
    room = _condition_along(arc, S, t)
    met = np.abs(room) <= _ON * max(float(np.ptp(room)), size)
    if not met.any():
        return
    condition = conditions_of(arc.problem, arc.index, (name,))[name]
    # Between two contact points, or one and the end, a flight may stay that near without a boundary arc.
    rate = np.abs(_condition_along(arc, condition.values[-1], t))
    held, order = met & (rate <= _HELD * rate.max()), condition.order
    ends = [0.0, *edges.tolist(), arc.duration]
    riding = [bool(held[(t > a) & (t < b)].all()) and bool(met[(t >= a) & (t <= b)].all()) for a, b in pairwise(ends)]
    begin = None
    for i, rides in enumerate([*riding, False]):
        if rides and begin is None:
            begin = ends[i]
        elif not rides and begin is not None:
            if condition.steered and not _kept_by_control_bounds(arc, condition, begin, ends[i]):
                yield Contact(name=name, begin=begin, end=ends[i], is_arc=True)
            begin = None
    for i, time in enumerate(edges.tolist()):
        if (
            order > 1
            and not (riding[i] or riding[i + 1])
            and met[np.argmin(np.abs(t - time))]
            and _costates_jump(arc, time)
        ):
            yield Contact(name=name, begin=time, end=time, is_arc=False)


def _condition_along(arc: PhaseData, S: Expression, t: Vector) -> Vector:
    """S at times of a phase [SI]."""
    bounds = {given: g.value for given, g in plain_bounds(arc.problem).items()}
    p, x, u = SimpleNamespace(**vars(arc.p), **bounds), arc.state(t), arc.control(t)
    return full(S(arc.phase.state_record(*x), arc.phase.control_record(*u), p, NUMERIC)[0], t)


def _condition_size(arc: PhaseData, name: str) -> float:
    """Size of a condition that goes through nothing [SI]: of the path condition, or of the state whose bound it is."""
    paths = [condition.name for condition in arc.phase.path_conditions]
    if name in paths:
        return float(arc.path_scale[paths.index(name)])
    return float(arc.state_scale[arc.phase.state_names.index(name.rpartition(".")[0])])


def _kept_by_control_bounds(arc: PhaseData, condition: Condition, begin: float, end: float) -> bool:
    """Return True if an active condition has no multiplier: the controls that move it are on bounds, lam does not jump.

    An empty tank stays empty while the engine is off. The checks are then made without the condition.
    """
    moving = condition.steering_controls
    u = arc.control(np.linspace(begin, end, _LOOKS + 2)[1:-1])
    on = {
        control.name: bool(np.logical_or(*on_bounds(arc, at, control, u)).all())
        for at, control in scalars(arc.phase.controls)
    }
    return all(on.get(control, False) for control in moving) and not any(_costates_jump(arc, t) for t in (begin, end))


def _costates_jump(arc: PhaseData, time: float) -> bool:
    """Return True if the costates jump at a time, where the physics does not."""
    curve = arc.trajectory.costate
    if curve is None or np.isin(time, arc.crossed).any():
        return False
    at = np.nonzero(curve.time == time)[0]
    size = np.abs(curve.values).max(axis=0)
    return len(at) > 1 and bool((np.abs(curve.values[at[-1]] - curve.values[at[0]]) > _JUMP * size).any())


def check_contact_multipliers(solution: Solution, parts: Solution, structure: Structure) -> Iterator[Check]:
    """Checks of levels 2 and 3: the multipliers at contact points.

    Parameters
    ----------
    solution, parts, structure
        Of `restate_with_contacts`.
    """
    number = 0
    for k, arcs in enumerate(structure.phases):
        conditions = conditions_of(solution.problem, k, structure.named(k))
        for arc in arcs:
            part = phase_data_of(parts)[number]
            number += 1
            yield from (check for name in arc.touches for check in _check_contact_point(part, conditions[name]))


def _check_contact_point(part: PhaseData, condition: Condition) -> Iterator[Check]:
    nu, _ = phase_end_multipliers(part)
    name, row = condition.name, {c.name: i for i, c in enumerate(part.phase.end_conditions)}
    at, rate = (row[condition.rated(i, "touch_", 1.0).name] for i in (0, 1))
    scaled = nu * part.end_scale / part.objective_scale
    yield _check_contact(part, [at, rate], name)
    yield Check(
        name=f"{part.prefix}touch", level=2, unit="1", limit=STATIONARY_LIMIT, value=float(np.maximum(0.0, scaled[at])),
        meaning=f"positive part of the multiplier at the contact point of {name} (scaled): the decrease of J if the"
        f" flight left it",
    )  # fmt: skip
    yield Check(
        name=f"{part.prefix}touch_jump", level=2, unit="1", limit=SIDEWAYS, value=abs(float(scaled[rate])),
        meaning=f"component of the costates' jump along the gradient of the rate of {name} at its contact point"
        f" (scaled): they may jump only along the gradient of {name} itself",
    )  # fmt: skip
    yield Check(
        name=f"{part.prefix}strict_touch", level=3, unit="1", limit=-STRICT, value=float(scaled[at]),
        meaning=f"multiplier at the contact point of {name} (scaled): strictly negative, so that J rises to first"
        f" order if the flight leaves it",
    )  # fmt: skip


def relax_strict_check(strict: Check) -> Check:
    """Return the check of a multiplier that need not be strict, as the second variation is positive without that."""
    return replace(
        strict, limit=STATIONARY_LIMIT,
        meaning=strict.meaning.partition(":")[0] + ": almost zero, but not positive; the second variation is positive"
        " also for flights that leave the condition, so that it need not be strictly negative",
    )  # fmt: skip


def _check_contact(part: PhaseData, rows: list[int], name: str) -> Check:
    """Check that the conditions of a contact vanish at the end of the part."""
    end = part.state(np.array([part.duration]))[:, 0].tolist()
    values = np.array(part.phase.evaluate("end", end, (), part.p), dtype=float) / part.end_scale
    return Check(
        name=f"{part.prefix}met", level=2, unit="1", limit=MET, value=float(np.abs(values[rows]).max()),
        meaning=f"{name} and its rates at the stated contact point (scaled): they vanish",
    )  # fmt: skip
