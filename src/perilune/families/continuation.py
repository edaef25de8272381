"""Continuation along one parameter, each member from its neighbour.

The base extremal (with any bounded free parameter held) is continued: predicted by its sensitivity to the parameter,
corrected by Newton, the step halved where that fails. At each value all extremals are then sought again, so that the
family follows the best of them through a jump, such as that of Cho et al. 2015, Figs 9 and 10.
"""

from __future__ import annotations

from dataclasses import replace

from perilune.core import Vector, Watch
from perilune.methods import Indirect, Search
from perilune.problem import Problem, Solution
from perilune.shooting import ActiveSetBounds, Member, Root, follow_family


class Continuation:
    """State of the continuation: the base extremal of the member before."""

    def __init__(self, settings: Indirect, name: str) -> None:
        self.settings, self.name = settings, name
        self.forget()

    def forget(self) -> None:
        """Reset: the member before has no answer."""
        self.base: Member | None = None
        self.before = 0.0
        self.limits: ActiveSetBounds | None = None

    def solve(self, problem: Problem, watch: Watch) -> Solution:
        """Solve a member by continuation from the base extremal, or by the whole ladder without one; unverified.

        Parameters
        ----------
        problem
            Problem of the member.
        watch
            Receives each iteration.
        """
        search = Search(self.settings, problem, watch)
        base = None if self.base is None else self._continued(problem, self.base, search)
        solution = self.settings.answer(search, base=base)
        self.base, self.before = search.state.base, problem.given[self.name].value
        self.limits = search.state.trials.others
        return solution

    def _continued(self, problem: Problem, base: Member, search: Search) -> Member | None:
        """Continue the base extremal from the value before to the problem's own value of the parameter."""
        target, before = problem.given[self.name].value, self.before
        if before == target:
            return base
        at, scale = list(problem.given).index(self.name), problem.scales.of(problem.unit_of(self.name))

        def numbers(value: float) -> Vector:
            p = search.state.trials.p.copy()
            p[at] = value / scale
            return p

        like, limits = base.root, search.state.trials.others
        if self.limits is not None:  # what varies may be the limit itself
            like = replace(like, choice=limits.taken_over(like.choice, self.limits))

        def correct(y: Vector, value: float) -> Root:
            return search.state.trials.correct(y, like, numbers(value))

        def tangent(root: Root, value: float) -> Vector:
            step = 1e-6 * max(abs(value), abs(target - before))  # a central difference of the residual
            return search.state.trials.shooting.shift(root, numbers(value + step), numbers(value - step)) / (2 * step)

        reached = next(iter(follow_family(Member(value=before, root=base.root), [target], correct, tangent)))
        return None if reached is None else Member(value=base.value, root=reached.root)
