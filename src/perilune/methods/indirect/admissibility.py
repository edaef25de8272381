"""Admissibility of an extremal as an answer: it keeps the bounds and the path conditions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np

from perilune.conditions import OptimalityConditions, PhaseExtremal
from perilune.core import NotConvergedError, Vector
from perilune.methods.indirect.export_arcs import PropagatedPhase, propagate_for_export, propagate_in_one_piece
from perilune.methods.indirect.exported_phases import minimising_controls
from perilune.methods.indirect.unknowns import free_values, objective_scale
from perilune.methods.indirect.violations import ConstraintViolation, bound_violations, violations_along
from perilune.problem import Phase, Problem, Variable, state_scales
from perilune.shooting import Root
from perilune.structures import CLOSEST, refine_minima

_POINTS = 201  # of a phase, at which its conditions are looked at first, in addition to its switches
_BEFORE = 1e-9  # of the phase: how long before a switch
_SLACK, ALLOWED = 1e-9, 1e-10  # canonical; the second is what the proof allows
_GRAZED = 0.5 * ALLOWED  # as its flight is another, and rounds otherwise
_NO_FLIGHT = 1e-6  # of its typical length: what vanishes satisfies all conditions where nothing is asked of its end
_ACCURACY = 1e-11  # of the flights that are looked at


class AdmissibilityTest:
    """Judges the roots of one problem; what it found of a root is kept.

    Attributes
    ----------
    unit
        SI size of the canonical unit of J.
    """

    def __init__(self, problem: Problem, conditions: OptimalityConditions, p: Vector) -> None:
        self.problem: Problem = problem
        self.conditions: OptimalityConditions = conditions
        self.p: Vector = p
        self.unit: float = objective_scale(problem)
        self._known: dict[bytes, tuple[ConstraintViolation, ...]] = {}

    def breach(self, root: Root) -> ConstraintViolation | None:
        """Return the first constraint that the flight breaks, or None."""
        return next(iter(self.breaches(root)), None)

    def breaches(self, root: Root) -> tuple[ConstraintViolation, ...]:
        """Return all constraints that the flight breaks."""
        return tuple(breach for breach in self._all(root) if breach.canonical > _SLACK)

    def grazed(self, root: Root) -> set[str]:
        """Return the names of what the flight breaks by so little that it may be an answer, and the proof objects."""
        return {breach.name for breach in self.grazing(root)}

    def grazing(self, root: Root) -> tuple[ConstraintViolation, ...]:
        """Return all constraints that the flight breaks by so little."""
        return tuple(breach for breach in self._all(root) if breach.canonical <= _SLACK)

    def _all(self, root: Root) -> tuple[ConstraintViolation, ...]:
        key = root.y.tobytes()
        if key not in self._known:
            self._known[key] = tuple(self._breaches(root))
        return self._known[key]

    def _breaches(self, root: Root) -> Iterator[ConstraintViolation]:
        values = free_values(self.problem, self.conditions, root.y)
        for free in self.problem.free:
            # A flight does not end before it begins, whatever the bounds say.
            lower = max(free.lower, 0.0) if free.name in self.problem.duration_names else free.lower
            yield from bound_violations(self.problem, free, np.array([values[free.name]]), (lower, free.upper), _SLACK)
            if self.problem.duration_names == (free.name,) and 0.0 <= values[free.name] < _NO_FLIGHT * free.guess:
                text, much = f"{free.name} vanishes, and a flight needs a positive duration", free.guess
                canonical = much / self.problem.size_of(free)
                yield ConstraintViolation(name=free.name, text=text, miss=much, unit=free.unit, canonical=canonical)
        settings = {"rtol": _ACCURACY, "atol": _ACCURACY}
        found = self._on_the_way(propagate_in_one_piece(self.problem, self.conditions, root.y, **settings), values)
        if _exceeds_slack(found):  # where errors grow, a single flight may break what its pieces keep
            with suppress(NotConvergedError):
                found = self._on_the_way(
                    propagate_for_export(self.problem, self.conditions, root, _SLACK, **settings), values
                )
        yield from found

    def _on_the_way(self, flights: list[PropagatedPhase], values: dict[str, float]) -> list[ConstraintViolation]:
        phases = zip(self.problem.phases, self.conditions.phases, flights, strict=True)
        return [breach for phase, extremal, arc in phases for breach in self._along(phase, extremal, arc, values)]

    def _along(
        self, phase: Phase, extremal: PhaseExtremal, arc: PropagatedPhase, values: dict[str, float]
    ) -> list[ConstraintViolation]:
        p, far = self.problem.parameters(values), arc.duration
        switches = np.array(arc.switches)
        t = np.unique([*np.linspace(0.0, far, _POINTS), *switches, *np.maximum(switches - _BEFORE * far, 0.0)])
        found = list[ConstraintViolation]()
        for _ in range(1 + CLOSEST):  # what is broken for a moment only, where a limit begins to bind
            with np.errstate(all="ignore"):  # where errors grow, the flight may lead where the physics is not defined
                found, between = self._looked(phase, extremal, arc, t, p)
            if _exceeds_slack(found) or not len(between):
                break
            t = np.union1d(t, between)
        return found

    def _looked(
        self, phase: Phase, extremal: PhaseExtremal, arc: PropagatedPhase, t: Vector, p: Any
    ) -> tuple[list[ConstraintViolation], Vector]:
        """Return what is broken at times, and times between them at which something may be."""
        x = arc(t)[:, : extremal.state_count].T * state_scales(self.problem, phase)[:, None]
        u = minimising_controls(extremal, arc, t, self.p).T if phase.path_conditions else x[:0]
        along = phase.path_along(x, u, p) if phase.path_conditions else ()
        rooms: list[tuple[Variable, Vector]] = [*along]
        for state, values in zip(phase.states, x, strict=True):
            lower, upper = state.limits(p)
            rooms += [(state, room) for room in (values - lower, upper - values) if np.isfinite(room).all()]
        near = [refine_minima(t, room, _GRAZED * self.problem.size_of(named)) for named, room in rooms]
        return list(violations_along(self.problem, phase, x, u, p, _GRAZED)), np.concatenate([*near, t[:0]])


def _exceeds_slack(found: list[ConstraintViolation]) -> bool:
    return any(breach.canonical > _SLACK for breach in found)
