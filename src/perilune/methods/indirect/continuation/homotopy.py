"""Homotopy to an extremal of many switches: the smoothed problem solved, and its smoothing reduced to none.

What a coarse mesh makes of a flight of many burns begins Newton's method in the wrong place. The smoothed problem
(`regularized`) has no switches to miss: the same mesh follows it, and its costates begin multiple
shooting. Then the smoothing is made less and less, each root predicted from the one before to first order, until the
switched problem is reached by one more run of Newton's method.

Multiple shooting, as a flight in one piece hardly converges while each of dozens of burns changes its length.

Where the duration is given there are many extremals, of very different cost. Smoothed ones are carried from short
flights to the whole like those of the problem itself (`duration_continuation`), and each then made sharp.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from perilune.conditions import OptimalityConditions
from perilune.core import PeriluneError, Vector
from perilune.methods.indirect.continuation.duration_continuation import FinalTimeContinuation
from perilune.methods.indirect.continuation.regularized import RATE, smooth_problem
from perilune.methods.indirect.export_arcs import can_use_multiple_shooting
from perilune.methods.indirect.newton_trials import Trials
from perilune.methods.indirect.unknowns import joints_from_solution, unknowns_from_solution
from perilune.problem import Problem, Solution
from perilune.shooting import Root, Shooting

SMOOTH = "smoothed controls"  # what this way of starting is called
_SHARES = (0.3, 0.03)  # of J: so much smoothed, a burn's thrust differs little from the middle of its range
_LEVELS = (1e-3, 1e-4, 1e-5)  # of the first smoothing, at which the switched extremal may be in reach
_NODES, _FINER = 4, 2  # of a segment, and segments for each of those that a flown guess asks for
_FEW = 8  # the least that it asks for
_CARRIED = 8  # the best of the smoothed extremals of a given duration
_REFINE, _FOLLOWED = 2, 1e-3  # a mesh for first values
_EVALUATIONS = 16  # of Newton's method from one smoothing to the next
_ROUGHLY = 1e-8  # residual of a root that only leads to the next
_STRIDE, _LONGER, _SHORTER, _SHORTEST = 1.0, 1.5, 0.5, 0.01  # steps in the logarithm of the smoothing
_PROBE = 1e-4  # difference in it for the prediction


@dataclass(kw_only=True)
class Smoothing:
    """Ways to extremals of many switches.

    Parameters
    ----------
    trials
        Newton's method on the problem.
    segments
        Arcs for each phase in multiple shooting; twice as many are tried as well.
    summary
        What was done last.
    """

    trials: Trials
    segments: int
    summary: str = ""

    def root(self, choice: Vector) -> Root | None:
        """Return an extremal; None, with the reason in `summary`, where none was reached.

        Parameters
        ----------
        choice
            What is held (`Shooting.holding`).
        """
        for share in _SHARES:
            smooth = smooth_problem(self.trials.problem, share)
            found = None if smooth is None else self._by_mesh(smooth, choice)
            if smooth is None or found is not None:
                return found
        return None

    def _by_mesh(self, smooth: Problem, choice: Vector) -> Root | None:
        """Solve from a direct answer of the smoothed problem."""
        rough = self._rough(smooth)
        if rough is None:
            self.summary = "smoothed controls: no direct solution"
            return None
        there = Trials(smooth, self.trials.watch)
        y = unknowns_from_solution(smooth, there.conditions, rough)
        for segments in (self.segments, 2 * self.segments):
            if not can_use_multiple_shooting(there.conditions, segments):
                break
            shooting = Shooting(there.conditions, segments=segments)
            Y = np.concatenate([y, joints_from_solution(smooth, there.conditions, rough, segments)])
            root = there.settled(Y[None], choice, limits=there.others, shooting=shooting)[0]
            self.summary = (
                f"smoothed controls, multiple shooting: Newton ended at residual {np.abs(root.residual).max():.2g}"
            )
            if root.converged and (found := self._sharpened(there, shooting, root)) is not None:
                return found
        return None

    def from_short_flights(self, starts: int, seed: int) -> list[Root]:
        """Return extremals that smoothed ones lead to, carried from short flights; every duration is given.

        Smoothed extremals begin and end less often on the way, and lie farther apart.

        Parameters
        ----------
        starts, seed
            Of the random starts at each share of the duration.
        """
        smooth = smooth_problem(self.trials.problem, _SHARES[0])
        if smooth is None:
            return []
        there = Trials(smooth, self.trials.watch)
        walk = FinalTimeContinuation(trials=there, starts=starts, seed=seed)
        roots = walk.extremals()[:_CARRIED]
        found = [root for near in roots if (root := self._sharpened(there, there.shooting, near)) is not None]
        self.summary = f"smoothed controls: {walk.summary}, {len(found)} of {len(roots)} with the smoothing taken back"
        return found

    def _rough(self, smooth: Problem) -> Solution | None:
        from perilune.direct import segments_by_simulation
        from perilune.methods.direct.pseudospectral import Pseudospectral  # and with it much of SciPy

        count = max((_FEW, *segments_by_simulation(smooth)))
        mesh = Pseudospectral(nodes=_NODES, segments=_FINER * count, refine=_REFINE, tolerance=_FOLLOWED)
        try:
            return mesh.run(smooth)
        except PeriluneError as error:
            flight = getattr(error, "flight", None)
            known = flight is not None and all(flown.costate is not None for flown in flight.trajectories)
            return flight if known else None

    def _sharpened(self, there: Trials, shooting: Shooting, root: Root) -> Root | None:
        """Return the switched extremal that a smoothed one leads to."""
        for left, nearly in self._less(there, shooting, root):
            self.summary = f"smoothed controls: followed to {left:.2g} of the smoothing"
            if (found := self._switched(there.conditions, shooting.segments, nearly)) is not None:
                return found
        return None

    def _less(self, there: Trials, shooting: Shooting, root: Root) -> Iterator[tuple[float, Root]]:
        """Yield roots with less and less of the smoothing, and how much of it is left."""
        at, step, here, levels = 0.0, _STRIDE, root, list(_LEVELS)
        while levels and step > _SHORTEST:
            ahead, behind = self._numbers(there, at - _PROBE), self._numbers(there, at)
            change = shooting.shift(here, ahead, behind) * (step / _PROBE)
            near = np.linalg.norm(change) < 0.5 * np.linalg.norm(here.y)  # a NaN is not
            next_root = there.settled(
                (here.y + change if near else here.y)[None], here.choice, self._numbers(there, at - step),
                limits=there.others, shooting=shooting, limit=_EVALUATIONS, tolerance=_ROUGHLY, accuracy=_ROUGHLY,
            )[0]  # fmt: skip
            if not next_root.converged:
                step *= _SHORTER
                continue
            at, here, step = at - step, next_root, step * _LONGER
            if np.exp(at) <= levels[0]:
                levels = [level for level in levels if level < np.exp(at)]
                yield float(np.exp(at)), here
        if at < 0.0 and levels:
            yield float(np.exp(at)), here

    def _numbers(self, there: Trials, at: float) -> Vector:
        p = there.p.copy()
        p[list(there.problem.given).index(RATE)] *= np.exp(at)
        return p

    def _switched(self, smooth: OptimalityConditions, segments: int, root: Root) -> Root | None:
        """Solve the problem itself, from a smoothed root that is nearly one of its own."""
        trials, count = self.trials, len(smooth.unknowns)
        values = dict(zip((name for name, _ in smooth.unknowns), root.y[:count].tolist(), strict=True))
        Y, at = [np.array([values[name] for name, _ in trials.conditions.unknowns])], count
        for extremal in smooth.phases:
            gained = extremal.state_count - 1
            for _ in range(segments - 1):
                z = root.y[at : at + 2 * extremal.half]
                Y.append(np.delete(z, [gained, extremal.half + gained]))
                at += len(z)
        found = trials.from_pieces(np.concatenate(Y), root.choice, segments, trials.others)
        return found if found.converged else None
