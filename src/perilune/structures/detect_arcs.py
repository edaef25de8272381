"""Detection of free arcs, boundary arcs and contact points of conditions S >= 0 in an answer without arcs.

On a mesh S is near 0 and not 0: between its points S falls below 0, and bulges above by some times as much. A flight
with a *contact point* S = 0 leaves it like t^2: S is below 4 times a level for twice as long as below it. On a
*boundary arc* it is there for about as long. What the control moves in its first derivative has no contact points, as
no condition on the state says so: it has a boundary arc, if only for a moment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from weakref import ref

import numpy as np

from perilune.core import Vector
from perilune.problem import Problem, Solution
from perilune.structures.detect_regimes import (
    EXACT,
    LEVELS,
    Stay,
    brief_stays,
    gain_along,
    leaves_bounds,
    linear_scalars,
    read_stays,
    regimes_at,
    runs_by_kind,
    seen_stays,
    stays_around_singular,
)
from perilune.structures.state_constraints import conditions_of, margins, state_conditions
from perilune.structures.state_margins import margin_along
from perilune.structures.structure import Arc, Structure

NEAR = (1e-4, 5e-2)  # of what S goes through: as near as counts at least and at most, whatever the mesh
BULGE = 8.0  # times what S falls below 0 it may rise above on a boundary arc; 1 to 6 were observed
CLOSEST = 4  # times that is done: from a share 1/200 of a phase on, it ends below the last digit of a time
WIDER, STAYS = 4.0, 0.6  # a wider level; a boundary arc where such a share of the time is spent below the wider one
STAYS_EXACTLY = 0.4  # the same of a level wider by its cube: what goes to zero like t^4 stays for 0.35


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Boundary arc of a condition from `begin` to `end` [s] of a phase, or a contact point at both."""

    name: str
    begin: float
    end: float
    is_arc: bool


def detect_structures(
    problem: Problem, solution: Solution, least: float | None = None, *, states_only: bool = False
) -> list[Structure]:
    """Return every structure a solution may have: by exact tables, with singular arcs (few arcs first), without.

    Where a switched control keeps a condition of order 2 or more, first the one with all other arcs on its bounds; so
    where a burn or a coast lasts but for an instant of its phase.
    Next to a contact point a mesh wavers where nothing is singular: there singular arcs are read only off exact tables.

    Parameters
    ----------
    problem
        The problem that the solution is one of, or one of its form.
    solution
        A solution that knows no arcs.
    least
        Share of its range below which S is at its limit, whatever the mesh.
    states_only
        Return the one of conditions on states only, with nothing said of controls; none where it is plain.
    """
    least = NEAR[0] if least is None else least
    if states_only:
        met, nothing = _contacts_by_phase(problem, solution, least), [list[Stay]() for _ in problem.phases]
        structure = _assemble_structure(problem, solution, met, nothing)
        return [] if structure.plain else [structure]
    if problem.phases is solution.problem.phases:  # as of the guess that a neighbour begins with
        return list(_remembered_structures(_Guess(solution), least))
    return _detect_structures(problem, solution, least)


def _detect_structures(problem: Problem, solution: Solution, least: float) -> list[Structure]:
    met, nothing = _contacts_by_phase(problem, solution, least), [list[Stay]() for _ in problem.phases]
    without = _assemble_structure(problem, solution, met, nothing)
    touched = any(arc.touches for arcs in without.phases for arc in arcs)
    stays = [read_stays(solution, k) for k in range(len(problem.phases))]
    # Near a slow switch the gain is small for long: exact tables that never leave the bounds are singular nowhere.
    told = touched or (least < NEAR[0] and not any(leaves_bounds(solution, k) for k in range(len(met))))
    by_level = {level: [own[level] for own in stays] for level in ((EXACT,) if told else (EXACT, *LEVELS))}
    structures = {
        level: _assemble_structure(problem, solution, met, own) for level, own in by_level.items() if own != nothing
    }
    different = dict[str, Structure]()
    if (brief := [brief_stays(solution, k) for k in range(len(met))]) != nothing:
        structure = _assemble_structure(problem, solution, met, brief)
        different[structure.text] = structure
    if (switched := [_switched_stays(problem, solution, k, met[k]) for k in range(len(met))]) != nothing:
        structure = _assemble_structure(problem, solution, met, switched)
        different[structure.text] = structure
    for level in sorted(structures, key=lambda level: (level != EXACT, level[0], structures[level].count)):
        different.setdefault(structures[level].text, structures[level])
    if not without.plain:
        different.setdefault(without.text, without)
    # Where a pair of switches begins no law finds it: last the arcs stay on the bounds on which they are seen.
    if touched and (bound := [seen_stays(solution, k) for k in range(len(met))]) != nothing:
        structure = _assemble_structure(problem, solution, met, bound)
        different.setdefault(structure.text, structure)
    return list(different.values())


class _Guess:
    """A solution as a key: equal only to itself, and not kept alive."""

    def __init__(self, solution: Solution) -> None:
        self.solution, self._hash = ref(solution), id(solution)

    def __eq__(self, other: object) -> bool:
        own = self.solution()
        return isinstance(other, _Guess) and own is not None and own is other.solution()

    def __hash__(self) -> int:
        return self._hash


@lru_cache(maxsize=8)
def _remembered_structures(guess: _Guess, least: float) -> tuple[Structure, ...]:
    solution = guess.solution()
    assert solution is not None, "which the caller holds"
    return tuple(_detect_structures(solution.problem, solution, least))


def _switched_stays(problem: Problem, solution: Solution, k: int, met: Sequence[Contact]) -> list[Stay]:
    """Return the bounds that the one switched scalar of phase k is on, except where it keeps a boundary arc."""
    ridden = sorted((c for c in met if c.is_arc), key=lambda c: c.begin)
    known = linear_scalars(problem, k)
    if not ridden or len(known) != 1 or solution.trajectories[k].costate is None:
        return []
    at, control = known[0]
    conditions = conditions_of(problem, k, tuple({c.name for c in ridden}))
    if any(c.order < 2 or c.steering_controls != {control.name} for c in conditions.values()):
        return []
    t, _, share = gain_along(solution, k, at, control)
    return stays_around_singular(control.name, t, share > 0.5, [(c.begin, c.end) for c in ridden])


def _contacts_by_phase(problem: Problem, solution: Solution, least: float) -> list[list[Contact]]:
    """Return for each phase the contacts of conditions on states only."""
    return [
        [c for name in state_conditions(problem, k) for c in _find_contacts(solution, k, name, least)]
        for k in range(len(problem.phases))
    ]


def _assemble_structure(
    problem: Problem, solution: Solution, met: Sequence[Sequence[Contact]], stays: Sequence[Sequence[Stay]]
) -> Structure:
    return Structure(
        tuple(
            arcs_of(problem, k, [c for c in met[k] if not _follows_from_bounds(c, stays[k])], flown.duration, stays[k])
            for k, flown in enumerate(solution.trajectories)
        )
    )


def _follows_from_bounds(contact: Contact, stays: Sequence[Stay]) -> bool:
    """Return True if a condition stays active while all scalars are on their bounds, which keep to it by themselves."""
    names = {s.control for s in stays}
    here = [s for s in stays if s.begin < 0.5 * (contact.begin + contact.end) < s.end]
    return contact.is_arc and bool(names) and all(s.regime != "singular" for s in here)


def contacts_in_phase(solution: Solution, k: int) -> list[Contact]:
    """Return where conditions of phase k on states only are at their limits on the way.

    Parameters
    ----------
    solution
        An answer without arcs.
    k
        Number of the phase.
    """
    return [c for name in state_conditions(solution.problem, k) for c in _find_contacts(solution, k, name)]


def _find_contacts(solution: Solution, k: int, name: str, share: float = NEAR[0]) -> Iterator[Contact]:
    """Yield where a condition of phase k is at its limit on the way; a start or an end that lies on it is none.

    Parameters
    ----------
    solution, k
        The solution and the number of the phase.
    name
        Name of the condition, as `margins` has it.
    share
        Share of its range along the phase below which S is at its limit.
    """
    t, room = margin_along(solution, k, name)
    least, most = share * float(np.ptp(room)), NEAR[1] * float(np.ptp(room))
    near = min(max(-BULGE * float(room.min()), least), most)
    for first, last in runs_by_kind(room <= near):
        inside = first > 0 and last < len(t) - 1
        length = _time_below(t, room, first, near)
        stays = length > STAYS * _time_below(t, room, first, WIDER * near)
        if share < NEAR[0] and not inside:  # exact tables: S goes to zero at an end like t^3 where a low hop begins
            stays &= length > STAYS_EXACTLY * _time_below(t, room, first, WIDER**3 * near)
        condition = conditions_of(solution.problem, k, (name,))[name]
        here = t[first : last + 1]
        if condition.steered and (stays or (inside and condition.order == 1)):
            on = here[room[first : last + 1] <= near / BULGE + max(0.0, float(room[first : last + 1].min()))]
            yield Contact(name=name, begin=float(on[0]), end=float(on[-1]), is_arc=True)
        elif inside:
            at = float(here[np.argmin(room[first : last + 1])])
            yield Contact(name=name, begin=at, end=at, is_arc=False)


def _time_below(t: Vector, room: Vector, first: int, level: float) -> float:
    """Return how long S stays below a level about the point `first` [s]."""
    low, high = next((a, b) for a, b in runs_by_kind(room <= level) if a <= first <= b)
    begin, end = float(t[low]), float(t[high])
    if low > 0:
        begin = float(np.interp(-level, -room[low - 1 : low + 1], t[low - 1 : low + 1]))
    if high < len(t) - 1:
        end = float(np.interp(level, room[high : high + 2], t[high : high + 2]))
    return end - begin


def arcs_of(
    problem: Problem, k: int, found: Sequence[Contact], duration: float, stays: Sequence[Stay] = ()
) -> tuple[Arc, ...]:
    """Return the arcs of phase k between the times at which something begins, ends or is in contact.

    Conditions active at once are named in the order in which the problem states it, so that the same arcs read the
    same.

    Parameters
    ----------
    problem, k
        The problem and the number of the phase.
    found
        Contacts with conditions on states.
    duration
        Length of the phase [s].
    stays
        Regimes of its scalar controls.
    """
    order = list(margins(problem, k))
    found = sorted(found, key=lambda contact: order.index(contact.name))
    known = conditions_of(problem, k, tuple({c.name for c in found})) if stays else {}
    cuts = sorted({t for c in (*found, *stays) for t in (c.begin, c.end) if 0.0 < t < duration})
    arcs = list[Arc]()
    for begin, end in zip([0.0, *cuts], [*cuts, duration], strict=True):
        middle = 0.5 * (begin + end)
        along = tuple(c.name for c in found if c.is_arc and c.begin < middle < c.end)
        touches = tuple(c.name for c in found if not c.is_arc and c.end == end)
        held = {name for condition in along if condition in known for name in known[condition].steering_controls}
        arc = Arc(along=along, touches=touches, regimes=regimes_at(stays, middle, held), until=end)
        if arcs and arc.regimes and replace(arcs[-1], touches=touches, until=end) == arc and not arcs[-1].touches:
            arcs.pop()  # nothing begins where two regimes of a control meet that is held along both
        arcs.append(arc)
    return tuple(arcs)
