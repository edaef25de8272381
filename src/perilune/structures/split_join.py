"""Conversion between a problem and its reformulation: split a solution into arcs, join arcs into phases.

A cubic is the same between any two of its points, so nothing is lost in cutting; at a joint a table has the time twice,
with the values of either side, as costates may jump there.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from perilune.core import Deferred, Outcome, PeriluneError, Vector
from perilune.problem import Curve, Extremal, Problem, Solution, Trajectory, Verification
from perilune.structures.describe import with_names
from perilune.structures.multiphase import refuse_unstated_ends, restate
from perilune.structures.structure import Structure, check_arc_structure, part_name

_NEAR = 1e-9  # of a phase: a cut so near to a node is at it
_NOTHING = 1e-13  # of a phase: nodes of a shorter arc would fall together


def split_solution(solution: Solution, structure: Structure, restated: Problem | None = None) -> Solution:
    """Cut a solution of a problem where the arcs of the structure end: one of the problem restated.

    Parameters
    ----------
    solution
        Of the user's problem.
    structure
        Its arcs; where their times are not known, in equal parts.
    restated
        What the pieces are a solution of; `restate(solution.problem, structure)` if None.

    Returns
    -------
    Solution
        A guess: multipliers of new conditions are not known, and it has no unknowns of any method.

    Raises
    ------
    PeriluneError
        If an arc has no length.
    """
    problem = solution.problem
    check_arc_structure(problem, structure)
    pieces, free, multipliers = list[Trajectory](), dict(solution.free), dict[str, float]()
    for k, (phase, flown) in enumerate(zip(problem.phases, solution.trajectories, strict=True)):
        count, ends = len(structure.phases[k]), structure.ends(k, flown.duration)
        begins = [0.0, *ends[:-1]]
        if not all(end > begin for begin, end in zip(begins, ends, strict=True)):
            raise PeriluneError(
                f"an arc of {phase.name} has no length",
                got=", ".join(f"{end:.9g} s" for end in ends),
                expected="ends in increasing order, each before the end of the phase",
            )
        for j, (begin, end) in enumerate(zip(begins, ends, strict=True)):
            pieces.append(_cut_trajectory(flown, begin, end, part_name(phase.name, j, count)))
        if count > 1:
            lengths = [piece.duration for piece in pieces[-count:]]
            free |= dict(zip(structure.part_durations(problem, k), lengths, strict=True))
        last = part_name(phase.name, count - 1, count)
        known = {c.name: solution.multipliers.get(f"{phase.name}.{c.name}") for c in phase.end_conditions}
        multipliers |= {f"{last}.{name}": nu for name, nu in known.items() if nu is not None}
    restated = restate(problem, structure) if restated is None else restated
    return replace(
        solution,
        problem=restated,
        free={f.name: free.get(f.name, f.guess) for f in restated.free},
        trajectories=tuple(pieces),
        multipliers=multipliers,
        outcome=_without_proof(solution.outcome),
        extremals=(),
        unverified_extremals=(),
        unknowns=None,
        verification=Verification(),
        structure=(),
    )


class JoinedTrajectories(Deferred):
    """Trajectories in the user's phases, made when first looked at of those of a restated problem.

    Attributes
    ----------
    structure
        The arcs, with the times of this solution.
    restated
        The solution of the restated problem.
    """

    def __init__(self, problem: Problem, structure: Structure, restated: Solution) -> None:
        super().__init__(len(problem.phases), self._trajectories)
        self.structure, self.restated = structure, restated
        self._names = [phase.name for phase in problem.phases]

    def refuse_unstated_ends(self, problem: Problem, varied: Collection[str] = ()) -> None:
        """Refuse a problem of other values, or varied ones, at which an arc to the end no longer says what it did.

        Parameters
        ----------
        problem
            The user's problem at the other values.
        varied
            Names of parameters that vary from there.
        """
        refuse_unstated_ends(self.restated.problem, problem, self.structure, varied)

    def _trajectories(self) -> tuple[Trajectory, ...]:
        parts = iter(self.restated.trajectories)
        arcs = zip(self._names, self.structure.phases, strict=True)
        return tuple(_join_trajectories(name, list(islice(parts, len(own)))) for name, own in arcs)


def join_solution(problem: Problem, restated: Solution, structure: Structure, *, named: bool = True) -> Solution:
    """Join a solution of the restated problem to one of the user's.

    Parameters
    ----------
    problem
        The user's.
    restated
        A solution of `restate(problem, structure)`.
    structure
        The arcs.
    named
        Whether its arcs are named.

    Returns
    -------
    Solution
        In the user's phases, unverified. Of its multipliers those of the user's conditions are
        kept; those of contact points and entries are the jumps of its costates.
    """
    check_arc_structure(problem, structure)
    counts, multipliers = [len(arcs) for arcs in structure.phases], dict[str, float]()
    for phase, count in zip(problem.phases, counts, strict=True):
        last = part_name(phase.name, count - 1, count)
        known = {c.name: restated.multipliers.get(f"{last}.{c.name}") for c in phase.end_conditions}
        multipliers |= {f"{phase.name}.{name}": nu for name, nu in known.items() if nu is not None}
    structure = _structure_with_times(structure, restated)
    whole = replace(
        restated,
        problem=problem,
        free=_user_free_values(problem, structure, restated.free),
        trajectories=JoinedTrajectories(problem, structure, restated),
        multipliers=multipliers,
        outcome=_without_proof(restated.outcome),
        extremals=tuple(
            Extremal(free=_user_free_values(problem, structure, e.free), objective=e.objective, nature=e.nature)
            for e in restated.extremals
        ),
        unverified_extremals=(),
        unknowns=None,
        verification=Verification(),
    )
    return with_names(whole, structure) if named else whole


def _structure_with_times(structure: Structure, restated: Solution) -> Structure:
    """Return the structure with the times of a solution of its restated problem, whose curves need not be made.

    Parameters
    ----------
    structure
        Arcs of each of the user's phases.
    restated
        Solution with a phase for each arc, in the same order.
    """
    p = restated.parameters
    lengths = iter([float(getattr(p, phase.duration)) for phase in restated.problem.phases])
    return structure.timed([list(islice(lengths, len(arcs))) for arcs in structure.phases])


def _user_free_values(problem: Problem, structure: Structure, free: Mapping[str, float]) -> dict[str, float]:
    """Return the values of the user's free parameters: durations that are sums are summed."""
    sums = {
        name: sum(free[part] for part in structure.part_durations(problem, k))
        for name, k in structure.summed_durations(problem).items()
    }
    return {name: sums[name] if name in sums else free[name] for name in problem.free_names}


def _without_proof(outcome: Outcome) -> Outcome:
    return Outcome.SOLVED if outcome in (Outcome.PROVED, Outcome.NOT_PROVED) else outcome


def _cut_trajectory(flown: Trajectory, begin: float, end: float, name: str) -> Trajectory:
    curves = (flown.state, flown.control, flown.costate)
    begin, end = (_at_node(flown, t) for t in (begin, end))
    state, control, costate = (None if curve is None else _cut_curve(curve, begin, end) for curve in curves)
    assert state is not None and control is not None
    return Trajectory(phase=name, state=state, control=control, costate=costate)


def _at_node(flown: Trajectory, t: float) -> float:
    """Return the node next to a time, where one is as near as rounding."""
    nodes = np.concatenate([c.time for c in (flown.state, flown.control, flown.costate) if c is not None])
    nearest = float(nodes[np.argmin(np.abs(nodes - t))])
    return nearest if abs(nearest - t) <= _NEAR * flown.duration else t


def _cut_curve(curve: Curve, begin: float, end: float) -> Curve:
    """Cut a curve between two times, which become 0 and the length; at a double node, on its own side of it."""
    inside = (curve.time > begin) & (curve.time < end)
    first, last = _one_sided_value(curve, begin, "right"), _one_sided_value(curve, end, "left")
    return Curve(
        time=np.concatenate([[0.0], curve.time[inside] - begin, [end - begin]]),
        values=np.vstack([first[0], curve.values[inside], last[0]]),
        rates=np.vstack([first[1], curve.rates[inside], last[1]]),
    )


def _one_sided_value(curve: Curve, t: float, side: str) -> tuple[Vector, Vector]:
    """Return the value and rate of a curve at a time, on the side that is asked for where it breaks."""
    at = np.nonzero(curve.time == t)[0]
    if len(at):
        i = at[-1] if side == "right" else at[0]
        return curve.values[i], curve.rates[i]
    i = int(np.clip(np.searchsorted(curve.time, t) - 1, 0, len(curve.time) - 2))
    h = curve.time[i + 1] - curve.time[i]
    s = (t - curve.time[i]) / h
    chord = (curve.values[i + 1] - curve.values[i]) / h
    left, right = curve.rates[i], curve.rates[i + 1]
    rate = left + s * (6 * chord - 4 * left - 2 * right + 3 * s * (left + right - 2 * chord))
    return np.asarray(curve(t)), rate


def _join_trajectories(name: str, parts: Sequence[Trajectory]) -> Trajectory:
    costates = [part.costate for part in parts if part.costate is not None]
    return Trajectory(
        phase=name,
        state=_join_curves([part.state for part in parts]),
        control=_join_curves([part.control for part in parts]),
        costate=_join_curves(costates) if len(costates) == len(parts) else None,
    )


def _join_curves(curves: Sequence[Curve]) -> Curve:
    shortest = _NOTHING * sum(float(curve.time[-1]) for curve in curves)
    curves = [curve for curve in curves if curve.time[-1] > shortest] or curves[:1]  # one of no length leaves nothing
    begins = np.concatenate([[0.0], np.cumsum([curve.time[-1] for curve in curves])])
    time = [np.append(begin + c.time[:-1], end) for begin, end, c in zip(begins[:-1], begins[1:], curves, strict=True)]
    return Curve(
        time=np.concatenate(time),
        values=np.concatenate([curve.values for curve in curves]),
        rates=np.concatenate([curve.rates for curve in curves]),
    )
