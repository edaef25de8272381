"""Continuation in the given durations: extremals found for shorter flights and carried to the whole.

Random costates fly a long arc anywhere; of a short one many lead to an extremal. So extremals are looked for at rising
fractions of the durations, and each is carried from one to the next by Newton's method, its step halved where that
fails. Random costates and neighbours of those known are tried at every fraction as well, as families begin and end on
the way. All of them go in lanes.

After Haberkorn, Martinon, Gergaud, "Low-thrust minimum-fuel orbital transfer: a homotopic approach", J. Guidance,
Control, and Dynamics 27(6), 2004, here with the time of flight as the parameter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perilune.core import Matrix, Vector
from perilune.methods.indirect.continuation.parameter_scan import distinct_roots, same_extremal
from perilune.methods.indirect.newton_trials import Trials
from perilune.methods.indirect.random_costates import PATIENCE, STRIDE, random_costate_unknowns
from perilune.shooting import Root, Roots, reach_open_roots

LEAST, RATIO = 0.2, 1.12  # the shortest share, and of each to the one before
_STARTS = 8  # random starts at each share, in those of the settings
_KEPT = 16  # best extremals of a share that are carried on
_AROUND, _SPREAD = 4, 0.2  # starts around each, and how far their costates go, relative to their length
_LENGTH = 1.0  # of random costates: up to e times longer or shorter than one
_HALVINGS = 4
_NEAR = 0.3  # of 1 + |y|: a root farther from the one before belongs to another family


def given_durations(trials: Trials) -> list[int]:
    """Return the places of the durations among the given parameters; none where something is free."""
    problem = trials.problem
    names = list(problem.given)
    return [] if problem.free else [names.index(name) for name in dict.fromkeys(problem.duration_names)]


@dataclass(kw_only=True)
class FinalTimeContinuation:
    """A continuation from short flights to the whole; `summary` says what it found, `family_count` how many families.

    Parameters
    ----------
    trials
        Newton's method on the problem.
    starts, seed
        Of the random starts.
    """

    trials: Trials
    starts: int
    seed: int

    def __post_init__(self) -> None:
        self.at = given_durations(self.trials)
        self.rng = np.random.default_rng(self.seed)
        self.summary, self.family_count = "", 0

    def extremals(self) -> list[Root]:
        """Return the extremals of the whole flight, best first."""
        count = int(np.ceil(np.log(1 / LEAST) / np.log(RATIO)))
        known: list[Root] = []
        for number, share in enumerate(RATIO ** np.arange(-count, 1.0)):
            carried = self._carried(known, share / RATIO, share)
            Y = [self._random_costates(number), *(self._around(root) for root in (*known, *carried))]
            fresh = self._roots(np.vstack(Y), share, doubt=0.0)
            known = distinct_roots([*carried, *(root for root in fresh if root.converged)])[:_KEPT]
            self.family_count += sum(not any(same_extremal(root, other) for other in carried) for root in known)
        shares = f"{count + 1} fractions of the duration from {RATIO**-count:.2g} on"
        self.summary = f"{shares}, where {self.family_count} families were met"
        return known

    def _carried(self, known: list[Root], share: float, target: float, halvings: int = _HALVINGS) -> list[Root]:
        """Carry roots at one share to another."""
        if not known:
            return []
        arrived, lost = list[Root](), list[Root]()
        for root, here in zip(self._corrected(known, target), known, strict=True):
            near = np.linalg.norm(root.y - here.y) <= _NEAR * (1 + np.linalg.norm(here.y))
            (arrived if root.converged and near else lost).append(root if root.converged and near else here)
        if lost and halvings:
            middle = 0.5 * (share + target)
            half = self._carried(lost, share, middle, halvings - 1)
            arrived += self._carried(half, middle, target, halvings - 1)
        return arrived

    def _corrected(self, known: list[Root], share: float) -> list[Root]:
        """Correct each by Newton's method; those that are not isolated by the shortest steps."""
        leave, found = np.array([root.open_directions for root in known]), dict[int, Root]()
        for lanes in (np.nonzero(leave == 0)[0], np.nonzero(leave)[0]):
            if not len(lanes):
                continue
            Y, choice = (np.array([getattr(known[i], name) for i in lanes]) for name in ("y", "choice"))
            if leave[lanes[0]]:
                roots = reach_open_roots(self.trials.shooting, Y, self._numbers(share), choice, leave[lanes])
            else:
                roots = self._roots(Y, share)
            found.update(zip(lanes.tolist(), roots, strict=True))
        return [found[i] for i in range(len(known))]

    def _roots(self, Y: Matrix, share: float, doubt: float = 0.25) -> Roots:
        trials, p = self.trials, None if share == 1.0 else self._numbers(share)
        choices = np.tile(trials.shooting.holding({}), (len(Y), 1))
        return trials.settled(Y, choices, p, limits=trials.limits, limit=2 * PATIENCE, max_step=STRIDE, doubt=doubt)

    def _random_costates(self, number: int) -> Matrix:
        """Draw costates of lengths about one: with the duration given H is no condition, and they have a scale."""
        Y = random_costate_unknowns(self.trials, _STARTS * self.starts, self.seed + number)
        Y[:, : self.trials.conditions.free_at.start] *= np.exp(self.rng.uniform(-_LENGTH, _LENGTH, size=(len(Y), 1)))
        return Y

    def _around(self, root: Root) -> Matrix:
        Y, count = np.tile(root.y, (_AROUND, 1)), self.trials.conditions.free_at.start
        towards = self.rng.normal(size=(_AROUND, count))
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        Y[:, :count] += _SPREAD * np.linalg.norm(root.y[:count]) * self.rng.uniform(size=(_AROUND, 1)) * towards
        return Y

    def _numbers(self, share: float) -> Vector:
        p = self.trials.p.copy()
        p[self.at] *= share
        return p
