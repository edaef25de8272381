"""Newton's method with an active set of bounds, for many extremals at once.

A free parameter q between bounds and an end condition psi with a range are treated alike. Each has a value that must
lie between its limits, and a multiplier, dJ/d(value) along the family in which the value is held: dJ/dq, and -nu where
J + nu psi is stationary. An extremal holds none, or holds the value at a limit with J rising into the interior (Karush,
Kuhn, Tucker). Start with the caller's active set; add violated limits, release those that would gain, a bounded number
of times.

Source: Nocedal & Wright, *Numerical Optimization*, 2nd ed., Springer 2006, sections 12.3 and 16.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.conditions import OptimalityConditions
from perilune.core import Matrix, Vector, Watch
from perilune.problem import Problem
from perilune.shooting.shooting_function import Roots, Shooting

_SLACK = 1e-9  # by which a multiplier may be on the wrong side; canonical
_BEYOND = 1e-11  # by which a limit may be missed: a tenth of what the proof allows; canonical


@dataclass(frozen=True, kw_only=True)
class ActiveSetBounds:
    """Limits of free parameters, then of ranges, canonical, (k,) or (lanes, k); infinite where there is none."""

    lower: Vector | Matrix
    upper: Vector | Matrix

    @classmethod
    def of(cls, problem: Problem, conditions: OptimalityConditions) -> ActiveSetBounds:
        """Return the bounds of the free parameters and of the ranges of a problem.

        Parameters
        ----------
        problem
            The problem, with bounds in SI.
        conditions
            Its boundary value problem, which says which end conditions are ranges.
        """
        free = problem.free
        ends = [c for phase in problem.phases for c in phase.end_conditions]
        ranges = [ends[row] for row, _ in conditions.ranges]
        size_of, p = problem.size_of, problem.parameters({})
        both = [(size_of(f), f.lower, f.upper) for f in free] + [(size_of(v), *v.limits(p)) for v in ranges]
        canonical = [(low / size, high / size) for size, low, high in both]
        lower, upper = np.array(canonical, dtype=float).reshape(-1, 2).T
        if len(problem.phases) == 1 and problem.duration_names[0] in problem.free_names:
            # The only phase cannot vanish: a flight of zero length is none.
            at = problem.free_names.index(problem.duration_names[0])
            lower[at] = -np.inf if lower[at] == 0 else lower[at]
        return cls(lower=lower, upper=upper)

    @property
    def count(self) -> int:
        """Return the number of limits, of a lane at most."""
        return int((np.isfinite(self.lower).sum(axis=-1) + np.isfinite(self.upper).sum(axis=-1)).max())

    def without(self, index: int | None) -> ActiveSetBounds:
        """Return the limits without those of one free parameter."""
        if index is None:
            return self
        lower, upper = self.lower.copy(), self.upper.copy()
        lower[index], upper[index] = -np.inf, np.inf
        return ActiveSetBounds(lower=lower, upper=upper)

    def taken_over(self, choice: Vector, before: ActiveSetBounds) -> Vector:
        """Return the choice of another problem with the values that it holds at its limits moved to the limits here.

        Parameters
        ----------
        choice
            Active set (`Shooting.holding`) of the other problem, shape (2 k,), canonical.
        before
            Limits of the other problem, in the same order.
        """
        count = len(self.lower)
        masks, held = choice[:count], choice[count:]
        at_lower, at_upper = held == before.lower, held == before.upper
        held = np.where(masks > 0, np.where(at_lower, self.lower, np.where(at_upper, self.upper, held)), held)
        return np.concatenate([masks, held])

    def revised(self, shooting: Shooting, roots: Roots) -> Matrix:
        """Return what to hold at each root instead, (lanes, choice); their own choice where all may stay.

        Parameters
        ----------
        shooting
            The shooting function that the roots belong to.
        roots
            Roots in lanes, each with its active set.
        """
        values, rises = shooting.held_values(roots)
        count = self.lower.shape[-1]
        within = (values >= self.lower) & (values <= self.upper)
        if np.count_nonzero(within) == within.size and not np.count_nonzero(roots.choice[:, :count]):
            return roots.choice
        masks, held = roots.choice[:, :count] > 0, roots.choice[:, count:]
        low, high = ~masks & (values < self.lower - _BEYOND), ~masks & (values > self.upper + _BEYOND)
        free = masks & (held == self.lower) & (rises < -_SLACK) | masks & (held == self.upper) & (rises > _SLACK)
        free &= self.lower < self.upper
        held = np.where(low, self.lower, np.where(high, self.upper, np.where(free, 0.0, held)))
        return np.hstack([((masks & ~free) | low | high).astype(float), held])

    def solve(
        self, shooting: Shooting, Y: Matrix, p: Matrix, choice: Matrix, watch: Watch | None = None, **settings: Any
    ) -> Roots:
        """Solve for roots that keep the limits, each with its own choice of what is held.

        A lane in which no active set is found counts as not converged.

        Parameters
        ----------
        shooting
            The shooting function.
        Y, p, choice, watch, **settings
            As for `Shooting.solve`; `choice` is where the search for the active set begins.
        """
        roots = shooting.solve(Y, p, choice, watch, **settings)
        wanted = self.revised(shooting, roots)
        if wanted is roots.choice:
            return roots
        for _ in range(2 * self.count + 1):
            changed = np.nonzero(roots.converged & (wanted != roots.choice).any(axis=1))[0]
            if not len(changed):
                return roots
            lanes_p = p if np.ndim(p) == 1 or len(p) == 1 else p[changed]
            again = shooting.solve(roots.y[changed], lanes_p, wanted[changed], watch, **settings)
            roots = roots.replaced(changed, again)
            wanted = self.revised(shooting, roots)
        return roots.failed((wanted != roots.choice).any(axis=1))
