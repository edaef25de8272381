"""Result assembly: the roots that a search found, ranked, as a `Solution`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from perilune.conditions import OptimalityConditions
from perilune.core import Deferred, Outcome, Vector
from perilune.methods.indirect.continuation.parameter_scan import ExtremalRoot, same_vector
from perilune.methods.indirect.export_arcs import PropagatedStates, propagate_for_export
from perilune.methods.indirect.exported_phases import assemble_trajectories
from perilune.methods.indirect.unknowns import free_values, objective_scale, scaled_end_multipliers
from perilune.problem import Extremal, Nature, Problem, Solution, Statistics, Trajectory
from perilune.shooting import Root

_SAME = 1e-9  # of J and of the free parameters, canonical: what two extremals may differ by and be listed as one


class Curves(Deferred):
    """Trajectories of a root, exported when first looked at; its states can be looked at before."""

    def __init__(self, problem: Problem, conditions: OptimalityConditions, root: Root) -> None:
        super().__init__(len(problem.phases), self._exported)
        self.problem, self.conditions, self.root = problem, conditions, root

    def _exported(self) -> tuple[Trajectory, ...]:
        of = self.problem, self.conditions
        return assemble_trajectories(*of, self.root.y, propagate_for_export(*of, self.root))

    def propagated(self) -> PropagatedStates:
        """Return the flight of the root, for its states."""
        return PropagatedStates(self.problem, self.conditions, self.root.y)


def compose_solution(
    method: str,
    problem: Problem,
    conditions: OptimalityConditions,
    found: Sequence[ExtremalRoot],
    statistics: Statistics,
) -> Solution:
    """Make the best of the roots the answer, and list all of them.

    Parameters
    ----------
    method, problem, conditions
        Whose roots.
    found
        At least one.
    statistics
        Of the run; `initialization` says whether a guess led to the root. The residual is added.
    """
    ranked = drop_mirror_images(conditions, sorted(found, key=lambda f: (not f.minimum, f.root.cost)))
    # Near a locally worst extremal there is a better one: none that is worse than it is the best.
    unit, guessed, least = (
        objective_scale(problem),
        statistics.initialization == "guess",
        min(f.root.cost for f in ranked),
    )
    extremals = tuple(
        Extremal(
            free=free_values(problem, conditions, f.root.y),
            objective=float(f.root.cost * unit),
            nature=_classify_root(f, len(problem.free), best=place == 0 and f.root.cost <= least, guessed=guessed),
            unknowns=tuple(f.root.y.tolist()),
        )
        for place, f in enumerate(ranked)
    )
    best = ranked[0].root
    return Solution(
        problem=problem,
        method=method,
        outcome=Outcome.SOLVED,
        objective=extremals[0].objective,
        free=extremals[0].free,
        trajectories=Curves(problem, conditions, best),
        multipliers=scaled_end_multipliers(problem, conditions, best.y),
        extremals=extremals,
        unknowns=best.y,
        statistics=replace(statistics, residual=float(np.abs(best.residual).max())),
    )


def drop_mirror_images(conditions: OptimalityConditions, ranked: Iterable[ExtremalRoot]) -> list[ExtremalRoot]:
    """Return the extremals whose J or free parameters differ.

    Mirror images, or a coast flown before the burn or behind it, are one extremal to a reader of the list.

    Parameters
    ----------
    conditions
        Boundary conditions of the shooting problem, which say where the free parameters are among the unknowns.
    ranked
        Extremals, best first; the first of each kind is kept.
    """
    kept: list[ExtremalRoot] = []
    for found in ranked:
        values = _reported_values(conditions, found)
        if not any(same_vector(values, _reported_values(conditions, other), _SAME) for other in kept):
            kept.append(found)
    return kept


def _reported_values(conditions: OptimalityConditions, found: ExtremalRoot) -> Vector:
    return np.append(found.root.y[conditions.free_at], found.root.cost)


def _classify_root(found: ExtremalRoot, free: int, *, best: bool, guessed: bool) -> Nature:
    """Classify a root; the one that a guess leads to was compared with no other."""
    bound = bool(found.root.choice[:free].any())
    if not found.minimum:
        return Nature.WORST
    if guessed:
        return Nature.NEAR_GUESS_AT_BOUND if bound else Nature.NEAR_GUESS
    if bound:
        return Nature.BEST_AT_BOUND if best else Nature.LOCAL_OPTIMUM_AT_BOUND
    return Nature.BEST if best else Nature.LOCAL_OPTIMUM
