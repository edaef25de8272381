"""What makes an extremal an answer: it keeps the bounds and the path conditions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from perilune.conditions.canonical import PhaseExtremal
from perilune.conditions.pontryagin import Conditions
from perilune.methods.assemble import controls, free_values, objective_scale
from perilune.methods.breaches import Breach, breaches_along, outside
from perilune.methods.flown import Flown, exported, in_one_piece
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.symbolic import state_scales
from perilune.shooting.function import Root
from perilune.words.types import Vector

_POINTS = 201  # of a phase, at which its conditions are looked at
_SLACK = 1e-9  # canonical
_ACCURACY = 1e-11  # of the flights that are looked at


class Judge:
    """Judges the roots of one problem; what it found of a root is kept.

    Attributes
    ----------
    unit
        SI size of the canonical unit of J.
    """

    def __init__(self, problem: Problem, conditions: Conditions, p: Vector) -> None:
        self.problem: Problem = problem
        self.conditions: Conditions = conditions
        self.p: Vector = p
        self.unit: float = objective_scale(problem)
        self._known: dict[bytes, tuple[Breach, ...]] = {}

    def breach(self, root: Root) -> Breach | None:
        """What the flight breaks first, or None."""
        return next(iter(self.breaches(root)), None)

    def breaches(self, root: Root) -> tuple[Breach, ...]:
        """All that the flight breaks."""
        key = root.y.tobytes()
        if key not in self._known:
            self._known[key] = tuple(self._breaches(root))
        return self._known[key]

    def _breaches(self, root: Root) -> Iterator[Breach]:
        values = free_values(self.problem, self.conditions, root.y)
        for free in self.problem.free:
            # A flight does not end before it begins, whatever the bounds say.
            lower = max(free.lower, 0.0) if free.name in self.problem.duration_names else free.lower
            yield from outside(self.problem, free, np.array([values[free.name]]), (lower, free.upper), _SLACK)
        settings = {"rtol": _ACCURACY, "atol": _ACCURACY}
        found = self._on_the_way(in_one_piece(self.problem, self.conditions, root.y, **settings), values)
        if found:  # where errors grow, one flight alone may break what its pieces keep
            found = self._on_the_way(exported(self.problem, self.conditions, root, _SLACK, **settings), values)
        yield from found

    def _on_the_way(self, flights: list[Flown], values: dict[str, float]) -> list[Breach]:
        phases = zip(self.problem.phases, self.conditions.phases, flights, strict=True)
        return [breach for phase, extremal, arc in phases for breach in self._along(phase, extremal, arc, values)]

    def _along(self, phase: Phase, extremal: PhaseExtremal, arc: Flown, values: dict[str, float]) -> Iterator[Breach]:
        t, p = np.linspace(0.0, arc.duration, _POINTS), self.problem.parameters(values)
        x = arc(t)[:, : extremal.state_count].T * state_scales(self.problem, phase)[:, None]
        u = controls(extremal, arc, t, self.p).T if phase.path_conditions else x[:0]
        yield from breaches_along(self.problem, phase, x, u, p, _SLACK)
