"""Protocol of every method."""

from __future__ import annotations

from typing import Protocol

from perilune.core.callbacks import Watch
from perilune.problem.problem import Problem
from perilune.problem.results.solution import Solution


class Method(Protocol):
    """A frozen record of settings with a `run`."""

    def run(self, problem: Problem, guess: Solution | None = None, watch: Watch | None = None) -> Solution:
        """Solve the problem, from a guess or without an initial guess."""
        ...
