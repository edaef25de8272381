"""Margins of an extremal of several arcs to the conditions on states along the path."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import numpy as np

from perilune.methods.answer import Curves
from perilune.methods.flown import PropagatedStates
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution
from perilune.structures.read import CLOSEST, EXACTLY, POINTS, is_constant_condition, margin_at, refine_minima
from perilune.structures.structure import Structure, margins
from perilune.words.types import Matrix, Vector


@dataclass
class ConstraintMargins:
    """The margins to conditions of an extremal of a structure, whose curves need not be made for that.

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
        """Return the times of phase k [s] and how far a condition is from its limit there [SI]."""
        if is_constant_condition(self.problem, k, name):
            return (t := np.zeros(1)), self._room(k, name, t, self._aloft.at(self._first(k), t))
        parts = [self._closely(k, name, *part) for part in self._phases(k)]
        return np.concatenate([t for t, _ in parts]), np.concatenate([room for _, room in parts])

    def _closely(self, k: int, name: str, j: int, times: Vector, x: Matrix) -> tuple[Vector, Vector]:
        """Return the times of an arc and S there, the closer together the nearer S may be to its limit between them."""
        room, begin, length = self._room(k, name, times, x), times[0], times[-1] - times[0]
        for _ in range(CLOSEST):
            between = refine_minima(times, room, EXACTLY * self._size(k, name)) if length > 0.0 else times[:0]
            if not len(between):
                break
            states = self._aloft.at(self._first(k) + j, np.clip((between - begin) / length, 0.0, 1.0))
            times, at = np.unique(np.append(times, between), return_index=True)
            room = np.append(room, self._room(k, name, between, states))[at]
        return times, room

    def _room(self, k: int, name: str, t: Vector, x: Matrix) -> Vector:
        return margin_at(self.problem, self.whole.parameters, k, name, t, x)

    def _size(self, k: int, name: str) -> float:
        return self.problem.size_of(margins(self.problem, k)[name][0])

    @cached_property
    def _aloft(self) -> PropagatedStates:
        curves = self.solved.trajectories
        assert isinstance(curves, Curves), "of a search, which ends at a root"
        return curves.aloft()

    @cached_property
    def _phases(self) -> Callable[[int], list[tuple[int, Vector, Matrix]]]:
        return cache(self._phase)

    def _phase(self, k: int) -> list[tuple[int, Vector, Matrix]]:
        """Return for each arc of phase k its number, times [s of the phase], and states there."""
        begins, found = [0.0, *(arc.until for arc in self.structure.phases[k])], list[tuple[int, Vector, Matrix]]()
        for j, (begin, end) in enumerate(pairwise(begins)):
            shares = np.linspace(0.0, 1.0, 2 + math.ceil(POINTS * (end - begin) / begins[-1]))
            found.append((j, begin + shares * (end - begin), self._aloft.at(self._first(k) + j, shares)))
        return found

    def _first(self, k: int) -> int:
        return sum(map(len, self.structure.phases[:k]))
