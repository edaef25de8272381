"""Newton's method on one problem within its bounds: keeps the nearest iterates, and counts all flights."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from perilune.conditions import Held, OptimalityConditions, derive, extremal_parameters
from perilune.core import Iteration, Matrix, Vector, Watch
from perilune.methods.indirect.continuation.parameter_scan import ExtremalRoot
from perilune.methods.indirect.unknowns import joints_from_solution
from perilune.problem import Problem, Solution, free_scales
from perilune.shooting import FINEST, ActiveSetBounds, Root, Roots, Shooting, complete_open_roots

AT_BOUND = 1e-8  # canonical distance at which a value counts as lying on a bound
_ROUNDED = 1e-8  # residual of pieces that are an answer by themselves: rounding, as in the air of a day


class Trials:
    """Runs of Newton's method on one problem.

    Attributes
    ----------
    conditions, p, shooting, limits
        Of the problem with a control that keeps conditions `keep` of the path.
    scanned
        Index of the first of those, None where there is none.
    bounded
        Indices of the free parameters between finite bounds that are no durations.
    history
        Iterations of all runs of single lanes.
    best_failure
        What came nearest of all that failed.
    """

    def __init__(self, problem: Problem, watch: Watch, keep: Held = ()) -> None:
        self.problem: Problem = problem
        self.watch: Watch = watch
        self.conditions: OptimalityConditions = derive(problem, keep, watch)
        self.p: Vector = extremal_parameters(problem)
        self.shooting: Shooting = Shooting(self.conditions)
        self.limits: ActiveSetBounds = ActiveSetBounds.of(problem, self.conditions)
        self.bounded: tuple[int, ...] = bounded_parameters(problem)
        self.scanned: int | None = next(iter(self.bounded), None)
        self.history: list[Iteration] = []
        self.best_failure: Root | None = None

    @cached_property
    def others(self) -> ActiveSetBounds:
        """Limits of all but the parameter that is scanned."""
        return self.limits.without(self.scanned)

    def settled(
        self,
        Y: Matrix,
        choice: Matrix,
        p: Matrix | None = None,
        *,
        limits: ActiveSetBounds,
        shooting: Shooting | None = None,
        **settings: float,
    ) -> Roots:
        """Return roots within their limits; count flights, keep the nearest failure at the problem's own numbers.

        Parameters
        ----------
        Y
            Initial unknowns, shape (lanes, unknowns), canonical.
        choice
            Initial active set (`Shooting.holding`) of k free parameters and ranges, shape (lanes, 2 k) or (2 k,).
        p
            Given parameters, shape (np,) or (lanes, np), canonical; None for those of the problem.
        limits
            Bounds of free parameters and ranges that the active set is found for.
        shooting
            Shooting function to solve; None for that of this problem in one piece.
        **settings
            As for `Shooting.solve`: accuracy of the integration, tolerance of the residual.
        """
        function = shooting or self.shooting
        numbers = self.p if p is None else p
        roots = complete_open_roots(
            function, limits.solve(function, Y, numbers, choice, self.watch, **settings), numbers
        )
        self.history += roots.history
        if function is not self.shooting:
            self.shooting.arcs += function.arcs
            self.shooting.iterations += function.iterations
        if p is None and function is self.shooting and not roots.converged.all():
            failed = np.where(roots.converged | ~np.isfinite(roots.residuals), np.inf, roots.residuals)
            nearest, worst = int(np.argmin(failed)), self.best_failure
            if np.isfinite(failed[nearest]) and (worst is None or failed[nearest] < np.abs(worst.residual).max()):
                self.best_failure = roots[nearest]
        return roots

    def by_pieces(self, rough: Solution, y: Vector, choice: Vector, segments: int, limits: ActiveSetBounds) -> Root:
        """Solve from a rough solution with so many segments for each phase, then in one piece.

        Parameters
        ----------
        rough
            Trajectory with costates, from which the states and costates at the joints are read.
        y
            Initial unknowns of single shooting, shape (unknowns,), canonical.
        choice
            Initial active set (`Shooting.holding`) of k free parameters and ranges, shape (2 k,).
        segments
            Segments of each phase in multiple shooting.
        limits
            Bounds of free parameters and ranges that the active set is found for.
        """
        Y = np.concatenate([y, joints_from_solution(self.problem, self.conditions, rough, segments)])
        return self.from_pieces(Y, choice, segments, limits)

    def from_pieces(self, Y: Vector, choice: Vector, segments: int, limits: ActiveSetBounds) -> Root:
        """Solve from unknowns and states at the joints of so many segments for each phase, then in one piece.

        Parameters
        ----------
        Y
            Initial unknowns of multiple shooting, shape (unknowns and joints,), canonical.
        choice
            Initial active set (`Shooting.holding`) of k free parameters and ranges, shape (2 k,).
        segments
            Segments of each phase in multiple shooting.
        limits
            Bounds of free parameters and ranges that the active set is found for.
        """
        shooting = Shooting(self.conditions, segments=segments)
        root = self.settled(Y[None], choice, limits=limits, shooting=shooting)[0]
        if segments > 1 and (root.converged or shooting.rounding(root)):  # one piece again, for what follows
            y = root.y[None, : len(self.conditions.unknowns)]
            one = self.settled(y, root.choice, limits=limits, accuracy=FINEST)[0]
            if one.converged or root.converged or np.abs(root.residual).max() <= _ROUNDED:
                root = self.shooting.in_one(one, root)
        return root

    def correct(self, y: Vector, like: Root, p: Vector) -> Root:
        """Solve at other given parameters p, with what is held as in `like` to begin with.

        Parameters
        ----------
        y
            Initial unknowns, shape (unknowns,), canonical.
        like
            A root near by, from whose active set Newton's method begins.
        p
            Given parameters, canonical, as `Shooting.solve` takes them.
        """
        return self.settled(y[None], like.choice, p, limits=self.others)[0]

    def bounds(self, index: int) -> tuple[float, float]:
        """Return the bounds of a free parameter, canonical."""
        return float(self.limits.lower[index]), float(self.limits.upper[index])

    def outside(self, root: Root) -> str | None:
        """Return the first free parameter that is out of its bounds, or None."""
        scales = free_scales(self.problem.free, self.problem)
        values = root.y[self.conditions.free_at] * scales
        for f, value, scale in zip(self.problem.free, values, scales, strict=True):
            if not f.lower - AT_BOUND * scale <= value <= f.upper + AT_BOUND * scale:
                return f.name
        return None


def found_at(shooting: Shooting, problem: Problem, root: Root) -> ExtremalRoot:
    """Return a root with whether J is least there along the free parameters that are scanned, if any.

    Parameters
    ----------
    shooting
        The shooting function.
    problem
        The problem.
    root
        A root of the shooting function.
    """
    return ExtremalRoot(root=root, minimum=shooting.curved_upwards(root, bounded_parameters(problem)))


def bounded_parameters(problem: Problem) -> tuple[int, ...]:
    """Return indices of the free parameters between finite bounds that are no durations."""
    return tuple(
        i
        for i, f in enumerate(problem.free)
        if math.isfinite(f.upper - f.lower) and f.name not in problem.duration_names
    )
