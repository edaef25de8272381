"""How far an extremal of several arcs is from conditions on states on its way."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import numpy as np

from perilune.methods.answer import Curves
from perilune.methods.flown import Aloft
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution
from perilune.structures.read import POINTS, room_at, still
from perilune.structures.structure import Structure
from perilune.words.types import Matrix, Vector


@dataclass
class Way:
    """What an extremal of a structure goes through, whose curves need not be made for that.

    Parameters
    ----------
    problem, structure
        The user's problem, and its arcs with the times of the extremal.
    solved, whole
        The extremal, of the problem restated and in the user's phases.
    """

    problem: Problem
    structure: Structure
    solved: Solution
    whole: Solution

    def room_along(self, k: int, name: str) -> tuple[Vector, Vector]:
        """Times of phase k [s] and how far a condition is from its limit there [SI]."""
        t, x = self._still(k) if still(self.problem, k, name) else self._phases(k)
        return t, room_at(self.problem, self.whole.parameters, k, name, t, x)

    @cached_property
    def _aloft(self) -> Aloft:
        curves = self.solved.trajectories
        assert isinstance(curves, Curves), "of a search, which ends at a root"
        return curves.aloft()

    @cached_property
    def _phases(self) -> Callable[[int], tuple[Vector, Matrix]]:
        return cache(self._phase)

    def _phase(self, k: int) -> tuple[Vector, Matrix]:
        begins, times, states = [0.0, *(arc.until for arc in self.structure.phases[k])], list[Vector](), list[Matrix]()
        for j, (begin, end) in enumerate(pairwise(begins)):
            shares = np.linspace(0.0, 1.0, 2 + math.ceil(POINTS * (end - begin) / begins[-1]))
            times.append(begin + shares * (end - begin))
            states.append(self._aloft.at(self._first(k) + j, shares))
        return np.concatenate(times), np.concatenate(states, axis=1)

    def _still(self, k: int) -> tuple[Vector, Matrix]:
        return np.zeros(1), self._aloft.at(self._first(k), np.zeros(1))

    def _first(self, k: int) -> int:
        return sum(map(len, self.structure.phases[:k]))
