"""Revision of contact points and boundary arcs by the extremal that was found with them.

- a contact point whose multiplier has the wrong sign is none: the condition holds nothing back there;
- an arc of no length is a contact point, or none where its condition admits none;
- an arc is left where the multiplier of its condition becomes negative (`perilune.structures.multiplier_signs`);
  where it is so all along, contact points remain where the arc begins and ends;
- an arc on a bound is cut where H is less at the other one, a singular arc where its control is beyond a bound;
- contact points between which the condition is not left are a boundary arc;
- a condition that is broken elsewhere has a contact point there too; one broken next to its contact, a boundary arc.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise

import numpy as np

from perilune.core import Matrix, Vector
from perilune.problem import Problem, Solution
from perilune.structures.detect_arcs import CLOSEST, Contact, arcs_of
from perilune.structures.detect_regimes import stays_of
from perilune.structures.multiplier_signs import paying_intervals
from perilune.structures.revise_regimes import revised_stays
from perilune.structures.split_join import JoinedTrajectories
from perilune.structures.state_constraints import Condition, conditions_of, margins, state_conditions
from perilune.structures.state_margins import (
    EXACTLY,
    POINTS,
    broken_intervals,
    is_constant_condition,
    margin_along,
    margin_at,
    margin_rounding,
    refine_minima,
)
from perilune.structures.structure import Structure, part_name

_BESIDE = 0.1  # of the time for which a condition is broken: so near to that a contact point belongs to it
_NO_TIME = 1e-5  # of a phase: an arc that is shorter is none


StatesAt = Callable[[int, Vector], Matrix]  # (phase of the restated problem, shares of its length) -> states [SI]


def revise_structure(
    problem: Problem, structure: Structure, solved: Solution, whole: Solution, states_at: StatesAt
) -> Structure | None:
    """Return the structure if the extremal keeps to it; else the one that it asks for; None where that is none.

    Parameters
    ----------
    problem, structure
        The user's problem, and its arcs with the times of the extremal.
    solved, whole
        The extremal, of the problem restated and in the user's phases.
    states_at
        States (n, shares) of the extremal, whose curves need not be made for that.
    """
    phases, same, way = [], True, ConstraintMargins(problem, structure, whole, states_at)
    for k, arcs in enumerate(structure.phases):
        known = list(_structure_contacts(structure, k))
        found = list(_supported_contacts(problem, structure, solved, k, known))
        found = _join_contacts(way, k, known, _with_violations(way, k, found))
        stays = stays_of(structure, k)
        asked = revised_stays(whole, k, stays, _NO_TIME)
        if asked is None:
            return None
        same &= found == known and asked == stays
        phases.append(arcs_of(problem, k, found, arcs[-1].until, asked))
    revised = Structure(tuple(phases))
    return structure if same else None if revised.plain else revised


def _supported_contacts(
    problem: Problem, structure: Structure, solved: Solution, k: int, known: list[Contact]
) -> Iterator[Contact]:
    """Yield the contacts that have a length, or a multiplier of the right sign, as far as they have."""
    phase, arcs = problem.phases[k], structure.phases[k]
    first = sum(len(before) for before in structure.phases[:k])
    conditions = conditions_of(problem, k, [contact.name for contact in known])
    for contact in known:
        condition = conditions[contact.name]
        j = next(j for j, arc in enumerate(arcs) if arc.until == contact.end)
        if contact.is_arc:
            if contact.end - contact.begin > _NO_TIME * arcs[-1].until:
                worth = paying_intervals(solved, first + j, condition)
                yield from _keep_paying_parts(contact, condition, arcs[-1].until, worth)
            elif condition.order > 1:
                yield replace(contact, end=contact.begin, is_arc=False)
            continue
        at = f"{part_name(phase.name, j, len(arcs))}.{condition.rated(0, 'touch_', 1.0).name}"
        if solved.multipliers[at] <= 0:  # J falls where the condition gives way
            yield contact


def _with_violations(way: ConstraintMargins, k: int, found: list[Contact]) -> list[Contact]:
    """Return the contacts and those that are missing: where a condition is broken."""
    found = list(found)
    for name in state_conditions(way.problem, k):
        size = way.problem.size_of(margins(way.problem, k)[name][0])
        for begin, end, at in broken_intervals(*way.room_along(k, name), size):
            reach = _BESIDE * (end - begin)
            near = [c for c in found if c.name == name and begin - reach <= c.end and c.begin <= end + reach]
            condition = conditions_of(way.problem, k, (name,))[name]
            ridden = condition.steered and (bool(near) or condition.order == 1)
            begin, end = (begin, end) if ridden else (at, at)
            for contact in near:
                begin, end = min(begin, contact.begin), max(end, contact.end)
                found.remove(contact)
            found.append(Contact(name=name, begin=begin, end=end, is_arc=ridden))
    return found


def _join_contacts(way: ConstraintMargins, k: int, known: Sequence[Contact], found: list[Contact]) -> list[Contact]:
    """Return the contacts; contact points between which the extremal does not leave are joined to one arc."""
    for name in {c.name for c in known}:
        condition, (t, room) = conditions_of(way.problem, k, (name,))[name], way.room_along(k, name)
        near = np.abs(room) <= margin_rounding(room, way.problem.size_of(margins(way.problem, k)[name][0]))
        runs = list[list[Contact]]()
        for contact in (c for c in known if c.name == name):
            before = runs[-1][-1] if runs else contact
            between = (t > before.end) & (t < contact.begin)
            stays = before is not contact and not (before.is_arc or contact.is_arc) and near[between].all()
            runs = [*runs[:-1], [*runs[-1], contact]] if stays else [*runs, [contact]]
        for run in runs if condition.steered else ():
            if len(run) > 1 and all(c in found for c in run):
                found = [c for c in found if c not in run]
                found.append(Contact(name=name, begin=run[0].end, end=run[-1].begin, is_arc=True))
    return found


def _keep_paying_parts(
    contact: Contact, condition: Condition, last: float, worth: list[tuple[float, float]] | None
) -> Iterator[Contact]:
    """Yield the parts of an arc that pay [s of the arc], or contact points in its place; itself where this is unknown.

    An arc to the end of the phase that gains by leaving for a time g before, returns there: with mu linear in time
    the hop begins q/(q + 1) g before mu changes sign (for x^(q) = u). Where that is before the arc a contact point is
    left.

    Parameters
    ----------
    contact
        Boundary arc with its times of begin and end [s of the phase].
    condition
        Active condition of order q.
    last
        Time at which the phase ends [s].
    worth
        Begin and end of each part whose multiplier has the right sign [s from the begin of the arc]; None if unknown.
    """
    length, order = contact.end - contact.begin, condition.order
    parts = [(0.0, length)] if worth is None else list(worth)
    if parts and contact.end == last and parts[-1][1] < length:
        begin, end = parts.pop()
        parts.append((begin, max(begin, end - order / (order + 1) * (length - end))))
    ends = [0.0, length] if not parts else [begin for begin, end in parts if end == begin]
    for at in (contact.begin + share for share in ends):
        if order > 1 and 0.0 < at < last:
            yield replace(contact, begin=at, end=at, is_arc=False)
    for begin, end in parts:
        if end > begin:
            yield replace(
                contact, begin=contact.begin + begin, end=contact.end if end >= length else contact.begin + end
            )


def _structure_contacts(structure: Structure, k: int) -> Iterator[Contact]:
    """Yield boundary arcs and contact points of a structure with times in phase k.

    Parameters
    ----------
    structure
        Arcs of each phase, each with the time at which it ends [s].
    k
        Index of the phase.
    """
    begin = 0.0
    for arc in structure.phases[k]:
        for name in arc.along:
            yield Contact(name=name, begin=begin, end=arc.until, is_arc=True)
        for name in arc.touches:
            yield Contact(name=name, begin=arc.until, end=arc.until, is_arc=False)
        begin = arc.until


@dataclass(frozen=True)
class HoppingStructure:
    """A structure with a contact point in the place of each boundary arc to the end of a phase, where that begins.

    Attributes
    ----------
    hopped
        (phase, condition) of each arc that was replaced.
    """

    problem: Problem
    structure: Structure
    hopped: tuple[tuple[int, str], ...]

    @classmethod
    def of(cls, problem: Problem, structure: Structure) -> HoppingStructure:
        """Replace the boundary arcs of a structure of the user's problem.

        Parameters
        ----------
        problem
            The user's problem.
        structure
            Its arcs.
        """
        phases, hopped = [], list[tuple[int, str]]()
        for k, arcs in enumerate(structure.phases):
            known, last = list(_structure_contacts(structure, k)), arcs[-1].until
            conditions = conditions_of(problem, k, [contact.name for contact in known])
            found = list[Contact]()
            for contact in known:
                hops = contact.is_arc and contact.end == last and conditions[contact.name].order > 1
                found += _keep_paying_parts(contact, conditions[contact.name], last, []) if hops else [contact]
                hopped += [(k, contact.name)] if hops else []
            phases.append(arcs_of(problem, k, found, last, stays_of(structure, k)))
        return cls(problem, Structure(tuple(phases)), tuple(hopped))

    def left_behind(self, answer: Solution) -> bool:
        """Return True if an answer leaves each of the conditions behind its last contact point; else it rides along."""
        return all(self._leaves(answer, *at) for at in self.hopped)

    def _leaves(self, answer: Solution, k: int, name: str) -> bool:
        known, (t, room) = answer.trajectories, margin_along(answer, k, name)
        assert isinstance(known, JoinedTrajectories), "of arcs"
        touch = max((c.end for c in _structure_contacts(known.structure, k) if c.name == name), default=0.0)
        size = self.problem.size_of(margins(self.problem, k)[name][0])
        return bool((room[t > touch] > margin_rounding(room, size)).any())


@dataclass
class ConstraintMargins:
    """The margins to conditions of an extremal of a structure, whose curves need not be made for that.

    Parameters
    ----------
    problem, structure
        The user's problem, and its arcs with the times of the extremal.
    whole
        The extremal, in the user's phases.
    states_at
        Its states.
    """

    problem: Problem
    structure: Structure
    whole: Solution
    states_at: StatesAt

    def room_along(self, k: int, name: str) -> tuple[Vector, Vector]:
        """Return the times of phase k [s] and how far a condition is from its limit there [SI].

        Parameters
        ----------
        k
            Index of the user's phase.
        name
            Name of a condition of its path.
        """
        if is_constant_condition(self.problem, k, name):
            return (t := np.zeros(1)), self._room(k, name, t, self.states_at(self._first(k), t))
        parts = [self._closely(k, name, *part) for part in self._phases(k)]
        return np.concatenate([t for t, _ in parts]), np.concatenate([room for _, room in parts])

    def _closely(self, k: int, name: str, j: int, times: Vector, x: Matrix) -> tuple[Vector, Vector]:
        """Return the times of an arc and S there, the closer together the nearer S may be to its limit between them."""
        room, begin, length = self._room(k, name, times, x), times[0], times[-1] - times[0]
        for _ in range(CLOSEST):
            between = refine_minima(times, room, EXACTLY * self._size(k, name)) if length > 0.0 else times[:0]
            if not len(between):
                break
            states = self.states_at(self._first(k) + j, np.clip((between - begin) / length, 0.0, 1.0))
            times, at = np.unique(np.append(times, between), return_index=True)
            room = np.append(room, self._room(k, name, between, states))[at]
        return times, room

    def _room(self, k: int, name: str, t: Vector, x: Matrix) -> Vector:
        return margin_at(self.problem, self.whole.parameters, k, name, t, x)

    def _size(self, k: int, name: str) -> float:
        return self.problem.size_of(margins(self.problem, k)[name][0])

    @cached_property
    def _phases(self) -> Callable[[int], list[tuple[int, Vector, Matrix]]]:
        return cache(self._phase)

    def _phase(self, k: int) -> list[tuple[int, Vector, Matrix]]:
        """Return for each arc of phase k its number, times [s of the phase], and states there."""
        begins, found = [0.0, *(arc.until for arc in self.structure.phases[k])], list[tuple[int, Vector, Matrix]]()
        for j, (begin, end) in enumerate(pairwise(begins)):
            shares = np.linspace(0.0, 1.0, 2 + math.ceil(POINTS * (end - begin) / begins[-1]))
            found.append((j, begin + shares * (end - begin), self.states_at(self._first(k) + j, shares)))
        return found

    def _first(self, k: int) -> int:
        return sum(map(len, self.structure.phases[:k]))
