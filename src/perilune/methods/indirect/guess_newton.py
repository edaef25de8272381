"""Newton's method from a guess: from its unknowns, from where its extremal is followed to, or in pieces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from perilune.core import Vector
from perilune.methods.indirect.export_arcs import can_use_multiple_shooting, correct_last_digits, ends_well
from perilune.methods.indirect.newton_trials import Trials
from perilune.methods.indirect.random_costates import NEARLY, beside_flat, continue_from_guess
from perilune.problem import Solution, is_neighbour
from perilune.shooting import FINEST, Root

_ROUNDED = 1e-9  # residual: no step of Newton lowers it, as each is rounding; a flight that ends so near is exported
_NEXT = 40  # evaluations of Newton's method from an extremal to a neighbour: with more it is led elsewhere


@dataclass(frozen=True)
class GuessNewton:
    """Newton's method from guesses of one problem.

    Parameters
    ----------
    trials
        Newton's method on the problem.
    segments
        Arcs of multiple shooting, where a flight in one piece does not do.
    compared
        True if the extremal is compared with that of the guess, to last digits.
    """

    trials: Trials
    segments: int
    compared: bool

    @property
    def near(self) -> bool:
        """Return True if the extremal is near that of the guess: its J is then compared to last digits."""
        return self.compared or is_neighbour(self.trials.problem)

    def root_from(self, y: Vector, choice: Vector, guess: Solution | None) -> Root:
        """Return the root from unknowns; by multiple shooting from the curves of a guess where that fails.

        Parameters
        ----------
        y, choice
            Unknowns to begin with, canonical, and the active set there.
        guess
            The solution that they were read off, if any.
        """
        attempts = self._attempts(y, choice, guess)
        root = next(attempts)
        while not root.converged and (another := next(attempts, None)) is not None:
            root = another
        if not root.converged and guess is not None and (not is_neighbour(self.trials.problem) or self._lost(root)):
            root = self._in_pieces(root, guess, y, choice)
        return root

    def completed(self, root: Root) -> Root:
        """Return a converged root as it is exported."""
        return self.trials.shooting.with_corrected_cost(root) if self.near else self.to_last_digits(root)

    def _attempts(self, y: Vector, choice: Vector, guess: Solution | None) -> Iterator[Root]:
        """Yield roots from unknowns, and from where the extremal of a guess is followed to.

        That comes first of so many arcs that they are not cut: from the unknowns only most are lost, and it takes long
        until they are.
        """
        trials = self.trials
        # Where one wait is about as good as another, what rough flights leave leads a neighbour along them all.
        finest: dict[str, Any] = {"accuracy": FINEST} if self.near else {}
        finest |= {"limit": _NEXT} if self.compared else {}

        def led(**settings: Any) -> Iterator[Root]:
            if guess is not None and (there := continue_from_guess(trials, guess, y)) is not None:
                start, held, limits = there[0][None], there[1], trials.limits
                yield trials.settled(start, held, limits=limits, **settings)[0]

        if self.near and (beside := beside_flat(trials, y, choice)) is not None:
            yield beside
        if can_use_multiple_shooting(trials.conditions):
            yield trials.settled(y[None], choice, limits=trials.limits, **finest)[0]
            yield from led()
            if self.near and (beyond := self._full_step(y, choice)) is not None:
                yield trials.settled(beyond[None], choice, limits=trials.limits, **finest)[0]
        else:
            yield from map(self._met, led(accuracy=FINEST, tolerance=NEARLY))
            yield self._met(trials.settled(y[None], choice, limits=trials.limits, **finest)[0])

    def _full_step(self, y: Vector, choice: Vector) -> Vector | None:
        """Return the unknowns a whole step of Newton's method on; None where there is none.

        A guess may lie on a kink, as with an arc of no length where it begins: from there the residual rises along the
        step of the one side before it falls along that of the other, and no share of the step is taken.
        """
        shooting, plan = self.trials.shooting, self.trials.shooting.plan
        here, there = shooting.at(y[None], self.trials.p, choice)[0], y.copy()
        there[plan.active] -= here.inverse @ here.residual[plan.rows]
        return there if np.isfinite(there).all() else None

    def _met(self, root: Root) -> Root:
        """Correct a root in one piece whose exported flight misses its end as Newton's method flies it more roughly."""
        if not root.converged or is_neighbour(self.trials.problem):
            return root
        left, (best, missed) = float(np.abs(root.residual).max()), self._mended(root)
        return replace(best, converged=min(left, missed) <= _ROUNDED)

    def _lost(self, root: Root) -> bool:
        """Return True if a neighbour, no further than rounding from its guess, is lost as that grows beyond all use.

        Of what settles the derivatives are rough: a fall that climbs again before it is down is found only in pieces.
        """
        shooting = self.trials.shooting
        return shooting.plan.settles or shooting.rounding(root) or not np.isfinite(root.residual).all()

    def _in_pieces(self, root: Root, guess: Solution, y: Vector, choice: Vector) -> Root:
        """Solve by multiple shooting where a flight in one piece misses its end by more than rounding."""
        trials, segments = self.trials, self.segments
        if np.abs(root.residual).max() <= _ROUNDED and trials.shooting.rounding(root):
            return replace(self._mended(root)[0], converged=True)
        if segments == 1 or not can_use_multiple_shooting(trials.conditions, segments):
            return root
        return trials.by_pieces(guess, y, choice, segments, trials.limits)

    def to_last_digits(self, root: Root) -> Root:
        """Return the root; one of amplified rounding, whose pieces may be none, moved until its flight ends best.

        So is one of several phases whose flight misses its ends: pieces leave as much again where phases meet.
        """
        exact = root.exact
        if exact and (
            len(self.trials.problem.phases) == 1 or ends_well(self.trials.problem, self.trials.conditions, root)
        ):
            return root
        best, missed = self._mended(root)
        return root if exact and missed > _ROUNDED else best

    def _mended(self, root: Root) -> tuple[Root, float]:
        plan = self.trials.shooting.plan
        return correct_last_digits(self.trials.problem, self.trials.conditions, root, plan.rows, plan.active)
