"""Initializers of the indirect method without an initial guess, each by itself.

What they are worth is for the search to judge (`perilune.methods.indirect.search`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from perilune.conditions import Held
from perilune.core import InfeasibleError, Matrix
from perilune.methods.indirect.coarse_direct import Coarse
from perilune.methods.indirect.continuation.duration_continuation import FinalTimeContinuation, given_durations
from perilune.methods.indirect.continuation.homotopy import SMOOTH, Smoothing
from perilune.methods.indirect.continuation.parameter_scan import distinct_roots
from perilune.methods.indirect.diagnosis import bounds_its_objective
from perilune.methods.indirect.export_arcs import can_use_multiple_shooting
from perilune.methods.indirect.newton_trials import Trials
from perilune.methods.indirect.random_costates import (
    PATIENCE,
    STRIDE,
    active_set_of_guess,
    hold_ranges,
    leave_out_vanishing,
    random_costate_unknowns,
    vanishing_durations,
)
from perilune.methods.indirect.settings import TRANSCRIBED, SearchSettings
from perilune.methods.indirect.unknowns import unknowns_from_solution
from perilune.problem import Solution, free_name, kept_text
from perilune.shooting import Member, Roots

_RANDOM = "random costates"  # on the unit sphere, as H has no scale
_DURATION = "continuation in the duration"
_AGREED = 0.5  # of the random starts, ending at one and the same extremal, which is then called the only one


class StartMembers(NamedTuple):
    """Members of families that one way of starting led to, what it is called, and what was tried."""

    members: list[Member]
    name: str
    tried: str


@dataclass
class ColdStarts:
    """The ways of starting, of one search.

    Parameters
    ----------
    settings, trials, keep, coarse
        Of the search.
    tried
        Receives what was tried in vain.
    agreed
        Whether most random costates led to one and the same extremal, once they were flown.
    found_any
        Whether random costates led to any extremal, within the bounds or not.
    """

    settings: SearchSettings
    trials: Trials
    keep: Held
    coarse: Coarse
    tried: list[str]
    agreed: bool = field(default=False, init=False)
    found_any: bool = field(default=False, init=False)

    def from_random_costates(self) -> Iterator[StartMembers]:
        """Yield members from random costates, with the bounded parameter held at several values.

        One family need not reach from bound to bound, so each value gives a chance to meet another.
        """
        trials, settings = self.trials, self.settings
        holds = [0.0] if trials.scanned is None else np.linspace(*trials.bounds(trials.scanned), 5).tolist()
        starts = [settings.starts if i == 0 else settings.starts // 2 for i in range(len(holds))]
        where = f" keeping {kept_text(trials.problem, self.keep)}" if self.keep else ""
        if trials.scanned is not None:
            name = free_name(trials.problem, trials.problem.free[trials.scanned].name)
            where += f" with {name} held at {len(holds)} values"
        trials.watch(f"start: {_RANDOM}{where}")
        Y = np.vstack([random_costate_unknowns(trials, count, settings.seed) for count in starts])
        held = np.repeat(holds, starts)
        choices = np.tile(trials.shooting.holding({}), (len(Y), 1))
        if trials.scanned is not None:
            trials.shooting.plan.hold(choices, trials.scanned, held)
        roots = self._settled(Y, choices)
        if not roots.converged.any() and vanishing_durations(trials):
            trials.watch(f"start: {_RANDOM}{where}, without the conditions that may be left out")
            leave_out_vanishing(trials, Y, choices)
            roots = self._settled(Y, choices)
        members: list[Member] = []
        for value in holds:
            lanes = np.nonzero((held == value) & roots.converged)[0].tolist()
            members += [Member(value=value, root=root) for root in distinct_roots(roots[lane] for lane in lanes)]
        self.found_any = bool(members)
        self.agreed = len(members) == 1 and bool(np.mean(roots.converged) >= _AGREED)
        yield StartMembers(members, _RANDOM, f"{_RANDOM}{where}: {len(Y)} starts")

    def _settled(self, Y: Matrix, choices: Matrix) -> Roots:
        """Return roots from starts with what they hold; where there is none, from where they came, with ranges held."""
        trials = self.trials
        roots = trials.settled(Y, choices, limits=trials.others, limit=PATIENCE, max_step=STRIDE, doubt=0.0)
        if roots.converged.any():
            return roots
        holding = choices.copy()
        hold_ranges(trials, holding)
        return trials.settled(roots.y, holding, limits=trials.others, limit=3 * PATIENCE, max_step=STRIDE)

    def from_shorter_flights(self) -> Iterator[StartMembers]:
        """Yield members carried from shorter flights, and by way of smooth controls where there are several."""
        if not given_durations(self.trials):
            return
        self.trials.watch(f"start: {_DURATION}")
        walk = FinalTimeContinuation(trials=self.trials, starts=self.settings.starts, seed=self.settings.seed)
        yield StartMembers([Member(value=0.0, root=root) for root in walk.extremals()], _DURATION, walk.summary)
        if walk.family_count > 1 and not self.keep:  # where there are several, the best may not have arrived
            self.trials.watch(f"start: {_DURATION}, {SMOOTH}")
            smoothing = Smoothing(trials=self.trials, segments=1)
            members = [
                Member(value=0.0, root=root)
                for root in distinct_roots(smoothing.from_short_flights(walk.starts, walk.seed))
            ]
            if smoothing.summary:
                yield StartMembers(members, f"{_DURATION}, {SMOOTH}", smoothing.summary)

    def from_transcription(self) -> Iterator[tuple[Member, str]]:
        """Yield an extremal from a direct solution, in one piece or by multiple shooting.

        Where the mesh has not followed it from finer ones in more pieces; of many switches by way of smooth controls.
        """
        trials, some, smoothing = self.trials, self.settings.segments, None
        pieces = ((1, some), (some, 2 * some), (2 * some, 3 * some, 4 * some), (2 * some, 3 * some, 4 * some))
        for rough, counts in zip(self._rough(), pieces, strict=False):
            y = unknowns_from_solution(trials.problem, trials.conditions, rough)
            choice, value = active_set_of_guess(trials, y), 0.0
            if trials.scanned is not None:
                value = float(y[trials.conditions.free_at.start + trials.scanned])
                trials.shooting.plan.hold(choice, trials.scanned, value)
            for segments in counts:
                if not can_use_multiple_shooting(trials.conditions, segments):
                    continue
                start = TRANSCRIBED if segments == 1 else "multiple shooting"
                trials.watch(f"start: {start}")
                root = trials.by_pieces(rough, y, choice, segments, trials.others)
                if root.converged:
                    yield Member(value=value, root=root), start
                    return
                left = float(np.abs(root.residual).max())
                self.tried.append(f"{start}: Newton {f'ended at residual {left:.2g}' if left < np.inf else 'was lost'}")
            if smoothing is None and self.coarse.lost and not self.keep:
                trials.watch(f"start: {SMOOTH}")
                smoothing = Smoothing(trials=trials, segments=some)
                root = smoothing.root(choice)
                self.tried += [smoothing.summary] if smoothing.summary else []
                if root is not None:
                    yield Member(value=value, root=root), SMOOTH
                    return

    def _rough(self) -> Iterator[Solution]:
        """Yield flights of the direct method, or one without limits of the states where nothing is known yet.

        Where not even a least miss came of any start, limits are not what stands in the way; where one is more than
        the error of the mesh, they are relaxed one by one, but for a limit of J itself, which an optimum without it
        says to be out of reach.
        """
        yield from self.coarse.resolved()
        refused = self.coarse.refusal
        if self.found_any or self.coarse.solution is not None or isinstance(refused, InfeasibleError):
            return
        known = getattr(refused, "partial", {})
        if known.get("converged", True) and ("least_miss" not in known or bounds_its_objective(self.trials.problem)):
            yield from filter(None, [self.coarse.without_limits()])
