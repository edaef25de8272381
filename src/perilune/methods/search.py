"""One run of the indirect method: the ladder of starts, the walk along a bounded free parameter, the choice.

`Search` holds what is known so far, so that a failure can say what was tried and how near it came.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from perilune.conditions.canonical import extremal_parameters
from perilune.conditions.held import Held
from perilune.conditions.pontryagin import Conditions, derive, keepable_conditions
from perilune.methods.answer import composed
from perilune.methods.assemble import free_values, joints_from, unknowns_from
from perilune.methods.coarse import Coarse, touched
from perilune.methods.flown import may_be_cut
from perilune.methods.judge import Breach, Judge
from perilune.methods.ladder import Ladder
from perilune.methods.refusals import not_converged, refusal
from perilune.problem.neighbours import is_neighbour
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution, Statistics
from perilune.problem.symbolic import canonical_free, free_scales
from perilune.shooting.active import Limits, limits_of, settle
from perilune.shooting.continuation import Member
from perilune.shooting.extremals import Found, HeldFamily, new_among, same, scan
from perilune.shooting.function import Root, Roots, Shooting
from perilune.words.outcome import NotConvergedError, PeriluneError
from perilune.words.types import Matrix, Vector
from perilune.words.watch import Iteration, Watch

_RANDOM = "random costates"  # on the unit sphere, as H has no scale
_PATIENCE = 24  # evaluations of a random start: the first to reach an extremal take 6 to 24, on nearly all landers
_STRIDE = 0.5  # largest component of a step from a random start, whose costates have length one
_AT_BOUND = 1e-8  # canonical distance at which a guess counts as lying on a bound
_SIGNED = 1e-6  # canonical multiplier of a range beyond which a guess counts as holding it


@dataclass
class Search:
    """One run on one problem."""

    settings: Ladder
    problem: Problem
    watch: Watch
    keep: Held = ()
    tried: list[str] = field(default_factory=list)
    best_failure: Root | None = None

    def __post_init__(self) -> None:
        self.began = time.perf_counter()
        self.conditions: Conditions = derive(self.problem, self.keep)
        self.keepable = tuple(name for name in keepable_conditions(self.problem) if name not in self.keep)
        self.p: Vector = extremal_parameters(self.problem)
        self.shooting = Shooting(self.conditions)
        self.judge = Judge(self.problem, self.conditions, self.p)
        self.history: list[Iteration] = []
        self.scanned = self._scanned_parameter()
        self.limits = limits_of(self.problem, self.conditions)
        self.walked: dict[float, list[Vector]] = {}  # members of the families followed, by the held value
        self.base: Member | None = None
        self.rung, self.met = "", 0
        # By extremals met with the scanned parameter held, and these; which search answered; whether it was outdone.
        self.broken: list[Breach] = []
        self.breaking: list[Root] = []
        self.answering, self.outdone = self, False
        self.coarse = Coarse(self.settings, self.problem, self.tried)

    @cached_property
    def others(self) -> Limits:
        """Limits of all but the parameter that is scanned."""
        return self.limits.without(self.scanned)

    # -- the two ways in ------------------------------------------------------------------------------------------

    def solve(self, guess: Solution | None = None, base: Member | None = None) -> Solution:
        """From a guess; or by the ladder, after the family through `base` (of another run) where there is one."""
        if guess is not None:
            search, found = self._from_guess(guess)
            # Whether it keeps the rest of the path is for the proof to say.
            return search._compose(found, "guess")
        search, found = self.all_extremals(base)
        if not search._answers(found):
            raise search._refusal(found)
        self.answering, self.outdone = search, search._outdone(found)
        return search._compose([f for f in found if search.judge.breach(f.root) is None], search.rung)

    def all_extremals(self, base: Member | None = None) -> tuple[Search, list[Found]]:
        """By the ladder; and of which search they are: this one, or one whose control keeps more of the path."""
        found: list[Found] = []
        rungs = [[(base, "continuation")] if base is not None else [], self._sphere_members(), self._transcription()]
        for i, rung in enumerate(rungs):
            if i == 2 and self._answers(found):
                break  # the last rung is for those that the others left without an answer
            for first, name in rung:
                if not self._walked_through(first):
                    new, members = self._all_extremals(first)
                    if self._answers(new) and self.base is None:
                        self.base, self.rung = first, name
                    found += new_among(new, found)
                    for member in members:
                        self.walked.setdefault(member.value, []).append(member.root.y)
            if i > 0 and (more := self._worth_keeping(found)):
                search, kept = self._keeping(more).all_extremals()
                if search._answers(kept) or not self._answers(found):
                    answers = [f for f in found if self.judge.breach(f.root) is None]
                    return search, [*kept, *new_among(answers, kept)]
        return self, found

    def _worth_keeping(self, found: list[Found]) -> Held:
        """Conditions that the control could keep, broken by extremals that are better than every answer."""
        if not self.keepable:
            return ()
        answers = [f.root.cost for f in found if f.minimum and self.judge.breach(f.root) is None]
        best, names = min(answers, default=math.inf), set[str]()
        for root in (*(f.root for f in found), *self.breaking):
            broken = {breach.name for breach in self.judge.breaches(root)}
            if root.cost < best and (not answers or broken <= {*self.keepable}):
                names |= broken
        return tuple(name for name in self.keepable if name in names)

    def _outdone(self, found: list[Found]) -> bool:
        """Whether an extremal that breaks the path is better than every answer: one that keeps it may be as well."""
        best = min(f.root.cost for f in found if f.minimum and self.judge.breach(f.root) is None)
        better = (root for root in (*(f.root for f in found), *self.breaking) if root.cost < best)
        return any(all(breach.path for breach in self.judge.breaches(root)) for root in better)

    def _keeping(self, more: Held) -> Search:
        """The same search with a control that keeps more conditions of the path."""
        self.watch(f"extremals break {', '.join(more)}: the control keeps to it")
        keep = tuple(name for name in keepable_conditions(self.problem) if name in {*self.keep, *more})
        search = Search(self.settings, self.problem, self.watch, keep, self.tried)
        search.coarse, search.history = self.coarse, self.history
        return search

    def correct(self, y: Vector, like: Root, p: Vector) -> Root:
        """Newton at other given parameters p, with what is held as in `like` to begin with."""
        return self._settled(y[None], like.choice, p, limits=self.others)[0]

    def _all_extremals(self, first: Member) -> tuple[list[Found], list[Member]]:
        if self.scanned is None:
            return [Found(root=first.root, minimum=True)], [first]
        free = self.problem.free[self.scanned]
        self.watch(f"following the family of extremals along {free.name}")
        found, members = scan(self._family(), first, self._bounds(self.scanned), self.settings.scan_points)
        scale = free_scales(self.problem.free, self.problem)[self.scanned]
        low, high = (members[end].value * scale for end in (0, -1))
        count = f"{len(found)} extremal{'' if len(found) == 1 else 's'}"
        self.tried.append(f"a family along {free.name} from {low:.6g} to {high:.6g} {free.unit}: {count}")
        return found, members

    def _family(self) -> HeldFamily:
        assert self.scanned is not None
        return HeldFamily(
            shooting=self.shooting, p=self.p, index=self.scanned, limits=self.others, watch=self.watch,
            keeps=lambda root: self._outside(root) is None,
        )  # fmt: skip

    def _walked_through(self, member: Member) -> bool:
        return any(same(y, member.root.y, 1e-5) for y in self.walked.get(member.value, []))

    def _answers(self, found: list[Found]) -> bool:
        return any(f.minimum and self.judge.breach(f.root) is None for f in found)

    def _from_guess(self, guess: Solution) -> tuple[Search, list[Found]]:
        """Newton from a guess; what lies on a bound there begins on it, what the path holds back there is kept."""
        if any(flown.costate is None for flown in guess.trajectories):
            guess = self.coarse.solve(guess) or guess
        near = touched(guess) if self.keepable else set[str]()
        held = tuple(name for name in self.keepable if name in near)
        search = self._keeping(held) if held else self
        y = search._known(guess)
        found = search._near(y, search._held_in(guess, y), guess)
        # A neighbour touches what its guess touches.
        if not is_neighbour(self.problem) and (more := search._worth_keeping(found)):
            search, root = search._keeping(more), found[0].root
            found = search._near(root.y, root.choice)
        return search, found

    def _near(self, y: Vector, choice: Vector, guess: Solution | None = None) -> list[Found]:
        """Newton from unknowns; by multiple shooting from the curves of a guess where that fails."""
        root = self._settled(y[None], choice, limits=self.limits)[0]
        stuck = not root.converged and (not is_neighbour(self.problem) or self.shooting.rounding(root))
        if stuck and guess is not None and may_be_cut(self.conditions, self.settings.segments):
            root = self._by_pieces(guess, y, choice, self.settings.segments, self.limits)
        name = self._outside(root)
        if root.converged and name is None:
            root = self.shooting.met(root) if is_neighbour(self.problem) else root  # its J is compared to last digits
            held = self.scanned is None or root.choice[self.scanned] > 0
            return [Found(root=root, minimum=held or self.shooting.curvature(root, self.scanned or 0) > 0)]
        if name is not None:
            raise NotConvergedError(
                f"from this guess the extremal lies outside the bounds of {name}",
                got=f"{free_values(self.problem, self.conditions, root.y)[name]:.6g} {self.problem.unit_of(name)}",
                advice="solve without a guess",
            )
        self.tried.append("Newton from the guess")
        raise self._failure()

    def _known(self, guess: Solution) -> Vector:
        """Unknowns of a guess: its own where it is of this method and form, else read off its curves.

        So do neighbours for a proof begin, which looks at the curves and believes no numbers beside them.
        """
        own = guess.unknowns if guess.method == self.settings.name and not is_neighbour(self.problem) else None
        same = own is not None and (
            (guess.problem.scales, guess.problem.structure) == (self.problem.scales, self.problem.structure)
        )
        if own is not None and same and len(own) == len(self.conditions.unknowns):
            return np.array(own)
        return unknowns_from(self.problem, self.conditions, guess)

    def _held_in(self, guess: Solution, y: Vector) -> Vector:
        """What a guess holds: free parameters on a bound, and ranges whose multiplier says so."""
        limits, free = self.limits, y[self.conditions.free_at]
        held = {
            i: limit
            for i, value in enumerate(free.tolist())
            for limit in (limits.lower[i], limits.upper[i])
            if abs(value - limit) <= _AT_BOUND or limits.lower[i] == limits.upper[i]
        }
        ranges = {}
        for i, (_, unknown) in enumerate(self.conditions.ranges):
            nu = y[unknown]
            limit = (limits.lower if nu < 0 else limits.upper)[len(free) + i]
            if abs(nu) > _SIGNED and np.isfinite(limit):
                ranges[i] = float(limit)
        return self.shooting.holding(held, ranges)

    # -- the ladder -----------------------------------------------------------------------------------------------

    def _sphere_members(self) -> Iterator[tuple[Member, str]]:
        """Extremals from random costates with the bounded parameter held at several values.

        One family need not reach from bound to bound, so each value gives a chance to meet another. Those that break
        a path condition come last, and only where nothing else was found.
        """
        holds = [0.0] if self.scanned is None else np.linspace(*self._bounds(self.scanned), 5).tolist()
        starts = [self.settings.starts if i == 0 else self.settings.starts // 2 for i in range(len(holds))]
        where = f" keeping {', '.join(self.keep)}" if self.keep else ""
        if self.scanned is not None:
            where += f" with {self.problem.free[self.scanned].name} held at {len(holds)} values"
        self.watch(f"start: {_RANDOM}{where}")
        Y = np.vstack([self._sphere_starts(count) for count in starts])
        held = np.repeat(holds, starts)
        choices = np.tile(self.shooting.holding({}), (len(Y), 1))
        if self.scanned is not None:
            choices[:, self.scanned], choices[:, self.shooting.plan.held + self.scanned] = 1.0, held
        roots = self._settled(Y, choices, limits=self.others, limit=_PATIENCE, max_step=_STRIDE, doubt=0.0)
        if not roots.converged.any():
            self._hold_ranges(choices)
            roots = self._settled(roots.y, choices, limits=self.others, limit=3 * _PATIENCE, max_step=_STRIDE)
        breaking: list[Member] = []
        for value in holds:
            for root in self._distinct(roots, np.nonzero((held == value) & roots.converged)[0].tolist()):
                member = Member(value=value, root=root)
                if self._walked_through(member):
                    continue
                breach = self.judge.breach(root)
                if breach is None:
                    yield member, _RANDOM
                else:
                    breaking.append(member)
                    self.broken.append(breach)
                    self.breaking.append(root)
        met = f"{self.met} extremals, {len(breaking)} of them break a condition"
        self.tried.append(f"{_RANDOM}{where}: {len(Y)} starts, {met}")
        if self.base is None:
            yield from ((member, _RANDOM) for member in breaking)

    def _hold_ranges(self, choices: Matrix) -> None:
        """Hold in one start none of the ranges, in the next the first at a bound, and so on."""
        first, held = self.shooting.plan.free, self.shooting.plan.held
        bounds = [
            (i, side[i])
            for side in (self.limits.lower, self.limits.upper)
            for i in range(first, held)
            if np.isfinite(side[i])
        ]
        for number, (i, bound) in enumerate(bounds, 1):
            choices[number :: len(bounds) + 1, i] = 1.0
            choices[number :: len(bounds) + 1, held + i] = bound

    def _distinct(self, roots: Roots, lanes: list[int]) -> list[Root]:
        """Different roots within the bounds, best first."""
        kept: list[Root] = []
        for lane in lanes:
            if not any(same(root.y, roots.y[lane], 1e-6) for root in kept):
                root = roots[lane]
                kept += [root] if self._outside(root) is None else []
        self.met += len(kept)
        return sorted(kept, key=lambda root: root.cost)

    def _sphere_starts(self, count: int) -> Matrix:
        """Unknowns with random costates of length one and free parameters around their typical values."""
        rng, c = np.random.default_rng(self.settings.seed), self.conditions
        Y = np.zeros((count, len(c.unknowns)))
        directions = rng.normal(size=(count, c.free_at.start))
        Y[:, : c.free_at.start] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        typical = canonical_free(self.problem, {f.name: f.typical for f in self.problem.free})
        Y[:, c.free_at] = typical * np.exp(rng.uniform(-0.4, 0.4, size=(count, len(typical))))
        return Y

    def _transcription(self) -> Iterator[tuple[Member, str]]:
        """An extremal from a coarse direct solution, in one piece or, where that fails, by multiple shooting."""
        rough = self.coarse.solve()
        if rough is None:
            return
        y = unknowns_from(self.problem, self.conditions, rough)
        choice, value = self._held_in(rough, y), 0.0
        if self.scanned is not None:
            value = float(y[self.conditions.free_at.start + self.scanned])
            choice[[self.scanned, self.shooting.plan.held + self.scanned]] = 1.0, value
        for segments, rung in ((1, "direct transcription"), (self.settings.segments, "multiple shooting")):
            root = self._by_pieces(rough, y, choice, segments, self.others)
            if root.converged:
                yield Member(value=value, root=root), rung
                return
            self.tried.append(f"{rung}: Newton ended at residual {np.abs(root.residual).max():.2g}")

    def _by_pieces(self, rough: Solution, y: Vector, choice: Vector, segments: int, limits: Limits) -> Root:
        """Newton from a rough solution with so many segments for each phase, then in one piece."""
        shooting = Shooting(self.conditions, segments=segments)
        Y = np.concatenate([y, joints_from(self.problem, self.conditions, rough, segments)])
        root = self._settled(Y[None], choice, limits=limits, shooting=shooting)[0]
        if root.converged and segments > 1:  # one piece again, for what follows
            root = self.shooting.in_one(self._settled(root.y[None, : len(y)], root.choice, limits=limits)[0], root)
        return root

    def _settled(
        self,
        Y: Matrix,
        choice: Matrix,
        p: Vector | None = None,
        *,
        limits: Limits,
        shooting: Shooting | None = None,
        **settings: float,
    ) -> Roots:
        """Roots within their limits; the nearest failure is remembered, and the flights are counted."""
        function = shooting or self.shooting
        numbers = self.p if p is None else p
        roots = settle(function, Y, numbers, choice, limits, self.watch, **settings)
        self.history += roots.history
        if function is not self.shooting:
            self.shooting.arcs += function.arcs
            self.shooting.iterations += function.iterations
        if not roots.converged.all():
            failed = np.where(roots.converged | ~np.isfinite(roots.residuals), np.inf, roots.residuals)
            nearest, worst = int(np.argmin(failed)), self.best_failure
            if np.isfinite(failed[nearest]) and (worst is None or failed[nearest] < np.abs(worst.residual).max()):
                self.best_failure = roots[nearest]
        return roots

    # -- bounds ---------------------------------------------------------------------------------------------------

    def _scanned_parameter(self) -> int | None:
        """Index of the first free parameter between finite bounds that is no duration; None where there is none."""
        for i, f in enumerate(self.problem.free):
            if math.isfinite(f.upper - f.lower) and f.name not in self.problem.duration_names:
                return i
        return None

    def _bounds(self, index: int) -> tuple[float, float]:
        return float(self.limits.lower[index]), float(self.limits.upper[index])

    def _outside(self, root: Root) -> str | None:
        """The first free parameter that is out of its bounds, or None."""
        scales = free_scales(self.problem.free, self.problem)
        values = root.y[self.conditions.free_at] * scales
        for f, value, scale in zip(self.problem.free, values, scales, strict=True):
            if not f.lower - _AT_BOUND * scale <= value <= f.upper + _AT_BOUND * scale:
                return f.name
        return None

    # -- the answer, or why there is none -------------------------------------------------------------------------

    def _compose(self, found: list[Found], rung: str) -> Solution:
        statistics = Statistics(
            rung=rung,
            tried=tuple(self.tried),
            iterations=self.shooting.iterations,
            arcs=self.shooting.arcs,
            wall_time=time.perf_counter() - self.began,
            history=tuple(self.history),
        )
        return composed(self.settings.name, self.problem, self.conditions, found, statistics)

    def _refusal(self, found: list[Found]) -> PeriluneError:
        breaches = [breach for f in found if (breach := self.judge.breach(f.root)) is not None]
        return refusal(self.coarse, breaches or self.broken) or self._failure()

    def _failure(self) -> NotConvergedError:
        return not_converged(self.conditions, self.coarse, self.shooting.iterations, self.best_failure)
