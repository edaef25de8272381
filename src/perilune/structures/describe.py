"""Description of an answer's arcs: positions of its scalar controls, boundary arcs and contact points, with times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from perilune.core import Deferred, Vector
from perilune.problem import NamedArc, Phase, Solution, Variable, depends_on_control, scalars
from perilune.structures.detect_regimes import Stay, stays_of
from perilune.structures.state_constraints import margins
from perilune.structures.structure import Structure

AT = 1e-4  # of its range: so near to a bound a control is at it, as a mesh leaves it between its points
_SINGULAR = 2
_PLACES = {1: "at its upper bound", 0: "between its bounds", -1: "at its lower bound", _SINGULAR: "singular"}
ON = 1e-6  # the same of a condition that a control can hold at once, of all that its value goes through


def with_names(solution: Solution, structure: Structure | None = None) -> Solution:
    """Return the solution with its arcs in words, which are found when they are first asked for.

    Parameters
    ----------
    solution
        Of the user's problem.
    structure
        Its boundary arcs and contact points, with the times of this solution; nothing where None.
    """

    def found() -> tuple[NamedArc, ...]:
        return tuple(arc for k in range(len(solution.problem.phases)) for arc in _of_phase(solution, k, structure))

    return replace(solution, structure=Deferred(None, found))


def _of_phase(solution: Solution, k: int, structure: Structure | None) -> list[NamedArc]:
    singular = [] if structure is None else [s for s in stays_of(structure, k) if s.regime == "singular"]
    found = [*_control_arcs_in_words(solution, k, singular), *_held_at_once(solution, k)]
    if structure is not None:
        found += _boundary_arcs_in_words(solution, k, structure)
    return sorted(found, key=lambda arc: (arc.begin, arc.end))


def _control_arcs_in_words(solution: Solution, k: int, singular: Sequence[Stay]) -> Iterator[NamedArc]:
    """Yield the arcs on which each bounded scalar is at a bound, between its bounds, or singular."""
    phase, flown = solution.problem.phases[k], solution.trajectories[k]
    edges = np.unique(flown.control.time)
    values = solution.evaluate(k, 0.5 * (edges[1:] + edges[:-1]))[1]
    for at, control in scalars(phase.controls):
        lower, upper = control.limits(solution.parameters)
        if not np.isfinite([lower, upper]).any():
            continue
        size = upper - lower if np.isfinite(upper - lower) else float(np.ptp(values[at])) or 1.0
        low, high = control.on_bounds(values[at], AT * size, solution.parameters)
        places = np.where(high, 1, np.where(low, -1, 0))
        for stay in (s for s in singular if s.control == control.name):
            places[(edges[1:] > stay.begin) & (edges[:-1] < stay.end)] = _SINGULAR
        if places.any():
            name = control.name.replace("_", " ")
            yield from _merge_pieces(
                phase, edges, places, {place: f"{name} {words}" for place, words in _PLACES.items()}
            )


def _held_at_once(solution: Solution, k: int) -> Iterator[NamedArc]:
    """Yield the arcs on which path conditions with a control in them are at their limit."""
    phase, flown = solution.problem.phases[k], solution.trajectories[k]
    edges = np.unique(flown.control.time)
    x, u = solution.evaluate(k, 0.5 * (edges[1:] + edges[:-1]))
    known = margins(solution.problem, k)
    for variable, room in phase.path_along(x, u, solution.parameters):
        if depends_on_control(known[variable.name][1]):
            places = (room <= ON * max(float(np.ptp(room)), ON * solution.problem.size_of(variable))).astype(int)
            runs = _merge_pieces(phase, edges, places, {0: "", 1: f"along {_variable_in_words(variable)}"})
            yield from (arc for arc in runs if arc.description)


def _merge_pieces(phase: Phase, edges: Vector, places: Vector, words: dict[int, str]) -> Iterator[NamedArc]:
    """Merge neighbouring pieces of the same kind into one arc each."""
    for place, run in groupby(range(len(places)), key=lambda i: int(places[i])):
        pieces = list(run)
        begin, end = float(edges[pieces[0]]), float(edges[pieces[-1] + 1])
        yield NamedArc(phase=phase.name, begin=begin, end=end, description=words[place])


def _boundary_arcs_in_words(solution: Solution, k: int, structure: Structure) -> Iterator[NamedArc]:
    """Yield the boundary arcs and contact points that the structure has."""
    phase, arcs = solution.problem.phases[k], structure.phases[k]
    ends = structure.ends(k, solution.trajectories[k].duration)
    called = {name: _margin_in_words(name, variable) for name, (variable, _, _) in margins(solution.problem, k).items()}
    for name in structure.named(k):
        ridden = [name in arc.along for arc in arcs]
        for along, run in groupby(range(len(arcs)), key=ridden.__getitem__):
            pieces = list(run)
            if along:
                begin = ends[pieces[0] - 1] if pieces[0] else 0.0
                yield NamedArc(phase=phase.name, begin=begin, end=ends[pieces[-1]], description=f"along {called[name]}")
        for arc, end in zip(arcs, ends, strict=True):
            if name in arc.touches:
                yield NamedArc(phase=phase.name, begin=end, end=end, description=f"contact point of {called[name]}")


def _margin_in_words(name: str, variable: Variable) -> str:
    state, _, side = name.partition(".")
    return f"the {side} bound of {state.replace('_', ' ')}" if side else _variable_in_words(variable)


def _variable_in_words(variable: Variable) -> str:
    return variable.label or variable.name.replace("_", " ")
