"""One run of the indirect method: the sequence of starts, the continuation along a free parameter, the choice.

`Search` holds what is known so far, so that a failure can say what was tried and how near it came.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from perilune.conditions import Held, attainable_conditions
from perilune.core.arrays import Vector
from perilune.core.callbacks import Watch
from perilune.core.errors import NotConvergedError, PeriluneError
from perilune.methods.indirect.admissibility import ALLOWED, AdmissibilityTest
from perilune.methods.indirect.coarse_direct import Coarse, nearly_active_conditions
from perilune.methods.indirect.continuation.homotopy import SMOOTH, Smoothing
from perilune.methods.indirect.continuation.parameter_scan import (
    ExtremalRoot,
    HeldFamily,
    same_vector,
    scan_family,
    unknown_extremals,
)
from perilune.methods.indirect.diagnosis import (
    NOT_ISOLATED,
    best_misses_bound_error,
    bound_unreachable_objective,
    explain_refusal,
    no_start_converged_error,
)
from perilune.methods.indirect.guess_newton import GuessNewton
from perilune.methods.indirect.initializers import ColdStarts, StartMembers
from perilune.methods.indirect.newton_trials import Trials, found_at
from perilune.methods.indirect.random_costates import active_set_of_guess, unknowns_of_guess
from perilune.methods.indirect.result import compose_solution
from perilune.methods.indirect.settings import SearchSettings
from perilune.methods.indirect.unknowns import free_values, unknowns_from_solution
from perilune.methods.indirect.violations import ConstraintViolation
from perilune.problem.casadi_trace import free_scales
from perilune.problem.display.quantity_names import free_name, kept_text
from perilune.problem.perturbed import is_neighbour
from perilune.problem.problem import Problem
from perilune.problem.results.solution import Solution, Statistics
from perilune.shooting import Member, Root

_MOST_FOLLOWED = 24  # extremals from which families along other parameters are followed
_MOST_OUTDOING = 6  # extremals that break the path, in whose basins admissible ones are looked for
_LITTLE = 1e-2  # canonical: what is broken by more a mesh has seen, and its flight shows the arcs that keep it


@dataclass
class Search:
    """One run on one problem."""

    settings: SearchSettings
    problem: Problem
    watch: Watch
    keep: Held = ()
    tried: list[str] = field(default_factory=list)
    compared: bool = False

    def __post_init__(self) -> None:
        self.began: float = time.perf_counter()
        self.trials: Trials = Trials(self.problem, self.watch, self.keep)
        self.keepable: tuple[str, ...] = tuple(n for n in attainable_conditions(self.problem) if n not in self.keep)
        self.newton: GuessNewton = GuessNewton(self.trials, self.settings.segments, self.compared)
        self.judge: AdmissibilityTest = AdmissibilityTest(self.problem, self.trials.conditions, self.trials.p)
        self.walked: dict[float, list[Vector]] = {}  # members of the families followed, by the held value
        self.followed: list[ExtremalRoot] = []  # along all parameters between bounds, where there are several
        self.base: Member | None = None
        self.rung: str = ""
        # By extremals found with the scanned parameter held, and these; which search answered; what it is dominated by.
        self.broken: list[ConstraintViolation] = []
        self.breaking: list[Root] = []
        self.answering: Search = self
        self.answered: bool = False  # by an extremal of known arcs: what takes long is left out
        self.flown: float = math.inf  # J of the best flight of known arcs
        self.better_inadmissible: list[Root] = []
        self.coarse: Coarse = Coarse(self.settings, self.problem, self.tried, self.watch)

    # -- the two ways in ------------------------------------------------------------------------------------------

    def solve(self, guess: Solution | None = None, base: Member | None = None) -> Solution:
        """Solve from a guess; or from all starts, after the family through `base` (of another run) if any."""
        if guess is not None:
            return self.near(guess)[0]  # whether it keeps the rest of the path is for the proof to say
        search, found = self.all_extremals(base)
        self.answering, search.better_inadmissible = search, search._better_inadmissible(found)
        if not search._answers(found):
            raise search._refusal(found)
        return search.compose([f for f in found if search.judge.breach(f.root) is None], search.rung)

    def near(
        self, guess: Solution, *, family: bool = False
    ) -> tuple[Solution, Callable[[], ConstraintViolation | None]]:
        """Return what Newton's method reaches from a guess, and a callable for the first condition that it breaks.

        With `family` the best of all extremals on the family through it, along a free parameter between bounds.
        """
        search, found = self._from_guess(guess)
        if not family or search.trials.scanned is None:
            return search.compose(found, "guess"), lambda: search.judge.breach(found[0].root)
        found += [f for f in search._others(found[0]) if search.judge.breach(f.root) is None]
        found = sorted(found, key=lambda f: (not f.minimum, f.root.cost))
        return search.compose(found, "family"), lambda: search.judge.breach(found[0].root)

    def along_families(
        self, known: Solution
    ) -> tuple[list[ExtremalRoot], Callable[[Sequence[ExtremalRoot]], Solution]]:
        """Return the extremal of a solution, those on families through it, and what makes solutions of some of them."""
        search, found = self._from_guess(known)
        return [*found, *search._others(found[0])], lambda some: search.compose(some, "family")

    def smoothed(self, rough: Solution) -> tuple[Solution, Callable[[], ConstraintViolation | None]]:
        """Solve as `near`, but by way of smooth controls, with what a rough answer of many switches holds."""
        trials = self.trials
        smoothing = Smoothing(trials=trials, segments=self.settings.segments)
        root = None
        if trials.scanned is None:
            root = smoothing.root(
                active_set_of_guess(trials, rough, unknowns_from_solution(self.problem, trials.conditions, rough))
            )
        self.tried += [smoothing.summary] if smoothing.summary else []
        if root is None or trials.outside(root) is not None:
            raise self._failure()
        return self.compose([ExtremalRoot(root=root, minimum=True)], SMOOTH), lambda: self.judge.breach(root)

    def all_extremals(self, base: Member | None = None, *, last: bool = False) -> tuple[Search, list[ExtremalRoot]]:
        """Return extremals from all starts, and their search: this one, or one whose control keeps more of the path.

        With `last` only by its last rung.
        """
        found: list[ExtremalRoot] = []
        given = [(base, "continuation")] if base is not None else []
        ways = ColdStarts(self.settings, self.trials, self.keep, self.coarse, self.tried)
        rungs = [
            given,
            self._judged(ways.from_random_costates()),
            self._judged(ways.from_shorter_flights()),
            ways.from_transcription(),
        ]
        for i, rung in enumerate(rungs):
            if (last and i < 3) or (i == 3 and self.answered):
                continue
            if self._answers(found) and (i == 3 or (i == 2 and (base is not None or ways.agreed))):
                continue  # the last rung is for those that the others left without an answer
            if i == 3 and (held := self._conditions_reached_by(self.coarse.solve())):
                return self._keeping(held).all_extremals(last=True)
            for first, name in rung:
                if not self._walked_through(first):
                    new, members = self._all_extremals(first)
                    if self._answers(new) and (self.base is None or self._isolated_and_better(first)):
                        self.base, self.rung = first, name
                    found += unknown_extremals(new, found)
                    for member in members:
                        self.walked.setdefault(member.value, []).append(member.root.y)
            if i > 0 and (more := self._worth_keeping(found)):
                search, kept = self._keeping(more).all_extremals()
                if search._answers(kept) or not self._answers(found):
                    answers = [f for f in found if self.judge.breach(f.root) is None]
                    return search, [*kept, *unknown_extremals(answers, kept)]
        return self, found

    def _conditions_reached_by(self, flight: Solution | None) -> Held:
        """Return conditions that the control could keep, which may hold a flight back."""
        near = nearly_active_conditions(flight) if self.keepable and flight is not None else set[str]()
        return tuple(name for name in self.keepable if name in near)

    def _worth_keeping(self, found: list[ExtremalRoot]) -> Held:
        """Return conditions that the control could keep, broken by extremals that are better than every answer."""
        if not self.keepable:
            return ()
        answers = [f.root.cost for f in found if f.minimum and not self._broken(f.root)]
        best, names = min(answers, default=math.inf), set[str]()
        for root in (*(f.root for f in found), *self.breaking):
            broken = self._broken(root)
            if root.cost < best and (not answers or broken <= {*self.keepable}):
                names |= broken
        return tuple(name for name in self.keepable if name in names)

    def _broken(self, root: Root) -> set[str]:
        """Return the names of what an extremal breaks; of what the control could keep by however little."""
        grazed = self.judge.grazed(root) & {*self.keepable}
        return {breach.name for breach in self.judge.breaches(root)} | grazed

    def _better_inadmissible(self, found: list[ExtremalRoot]) -> list[Root]:
        """Return extremals that break the path and beat every answer: what keeps it near them may be better as well."""
        answers = (f.root.cost for f in found if f.minimum and self.judge.breach(f.root) is None)
        best = min(answers, default=math.inf)
        roots = (*(f.root for f in sorted(found, key=lambda f: (not f.minimum, f.root.cost))), *self.breaking)
        better = (root for root in roots if root.cost < best)
        outdoing = (root for root in better if all(breach.path for breach in self.judge.breaches(root)))
        return list(islice(outdoing, _MOST_OUTDOING))

    def flights_near_better(self) -> Iterator[Solution]:
        """Yield the direct method's flights near extremals better than the answer, with the path conditions kept."""
        if not self.answering.better_inadmissible:
            return
        yield from filter(None, [self.coarse.solve()])
        for root in self.answering.better_inadmissible if self.trials.bounded else ():
            guess = self.answering.compose([ExtremalRoot(root=root, minimum=True)], "")
            yield from filter(None, [Coarse(self.settings, self.problem, self.tried, self.watch).solve(guess)])

    def breaking_path(self) -> Iterator[Solution]:
        """Yield as solutions the extremals that are better than every answer and break only the path, by little."""
        search = self.answering
        for root in search.better_inadmissible:
            if all(breach.canonical <= _LITTLE for breach in search.judge.breaches(root)):
                yield search.compose([ExtremalRoot(root=root, minimum=True)], "")

    def _keeping(self, more: Held) -> Search:
        """Return the same search with a control that keeps more conditions of the path."""
        self.watch(f"{kept_text(self.problem, more)} is active: the control keeps it")
        keep = tuple(name for name in attainable_conditions(self.problem) if name in {*self.keep, *more})
        search = Search(self.settings, self.problem, self.watch, keep, self.tried)
        search.coarse, search.trials.history = self.coarse, self.trials.history
        return search

    def _all_extremals(self, first: Member) -> tuple[list[ExtremalRoot], list[Member]]:
        trials, shooting = self.trials, self.trials.shooting
        if trials.scanned is None:
            return self._over_ranges(first.root), [first]
        found, members = self._scan_parameter(trials.scanned, first)
        if len(trials.bounded) > 1:
            found += self._scan_other_parameters(found)
        down = (
            bool(shooting.curving_down(f.root, trials.p)) or not shooting.curved_upwards(f.root, trials.bounded)
            for f in found
        )
        return [replace(f, minimum=f.minimum and not is_down) for f, is_down in zip(found, down, strict=True)], members

    def _scan_other_parameters(self, found: list[ExtremalRoot]) -> list[ExtremalRoot]:
        """Return more extremals: along one parameter the others stay in their basins, and at their bounds."""
        trials, more = self.trials, list[ExtremalRoot]()
        left = [(f, trials.scanned) for f in unknown_extremals(found, self.followed)]
        while left:
            if len(self.followed) >= _MOST_FOLLOWED:
                self.tried.append(f"{len(left)} more extremals, from which no further family was followed")
                break
            one, along = left.pop(0)
            self.followed.append(one)
            for index in trials.bounded:
                if index != along and (here := self._held_at(one.root, index)) is not None:
                    new = unknown_extremals(self._scan_parameter(index, here)[0], [*found, *more, *self.followed])
                    more += new
                    left += [(f, index) for f in new]
        return more

    def _others(self, known: ExtremalRoot) -> list[ExtremalRoot]:
        """Return extremals on the families through one, along parameters between bounds."""
        scanned = self.trials.scanned
        if scanned is None or (member := self._held_at(known.root, scanned)) is None:
            return []
        return unknown_extremals(self._all_extremals(member)[0], [known])

    def _scan_parameter(self, index: int, first: Member) -> tuple[list[ExtremalRoot], list[Member]]:
        """Return extremals of the family through a member along one free parameter, and the members visited."""
        trials, free = self.trials, self.problem.free[index]
        self.watch(f"following the family of extremals along {free_name(self.problem, free.name)}")
        family = HeldFamily(
            shooting=trials.shooting, p=trials.p, index=index, limits=trials.limits.without(index), watch=self.watch,
            keeps=lambda root: trials.outside(root) is None,
        )  # fmt: skip
        found, members = scan_family(family, first, trials.bounds(index), self.settings.scan_points)
        scale = free_scales(self.problem.free, self.problem)[index]
        low, high = (members[end].value * scale for end in (0, -1))
        ends, count = f"{low:.6g} to {high:.6g} {free.unit}", _count_extremals(len(found))
        self.tried.append(f"a family along {free_name(self.problem, free.name)} from {ends}: {count}")
        return found, members

    def _held_at(self, root: Root, index: int) -> Member | None:
        """Return an extremal as a member of the family along a free parameter; None where Newton's method loses it."""
        trials = self.trials
        value, choice = float(root.y[trials.conditions.free_at.start + index]), root.choice.copy()
        trials.shooting.plan.hold(choice, index, value)
        held = trials.settled(root.y[None], choice, limits=trials.limits.without(index))[0]
        return Member(value=value, root=held) if held.converged else None

    def _over_ranges(self, root: Root) -> list[ExtremalRoot]:
        """Return an extremal, and those at the limits of ranges of an end over which J is at a maximum there."""
        trials, shooting = self.trials, self.trials.shooting
        if not (curved := shooting.curving_down(root, trials.p)):
            return [ExtremalRoot(root=root, minimum=True)]
        found, first = [ExtremalRoot(root=root, minimum=False)], shooting.plan.free
        for i in (first + k for k in curved):
            for limit in (trials.limits.lower[i], trials.limits.upper[i]):
                choice = root.choice.copy()
                shooting.plan.hold(choice, i, limit)
                held = trials.settled(root.y[None], choice, limits=trials.limits)[0] if np.isfinite(limit) else root
                if held.converged and held.choice[i]:
                    minimum = not shooting.curving_down(held, trials.p)
                    found += unknown_extremals([ExtremalRoot(root=held, minimum=minimum)], found)
        return found

    def _walked_through(self, member: Member) -> bool:
        return any(same_vector(y, member.root.y, 1e-5) for y in self.walked.get(member.value, []))

    def _isolated_and_better(self, first: Member) -> bool:
        """Return True if an extremal that is no member of a family is better than the one known."""
        return self.trials.scanned is None and self.base is not None and first.root.cost < self.base.root.cost

    def _answers(self, found: list[ExtremalRoot]) -> bool:
        return any(f.minimum and self.judge.breach(f.root) is None for f in found)

    def _from_guess(self, guess: Solution) -> tuple[Search, list[ExtremalRoot]]:
        """Solve from a guess; what lies on a bound there begins on it, what the path holds back there is kept."""
        own = guess.method == self.settings.name and guess.unknowns is not None  # which has costates
        if not own and any(flown.costate is None for flown in guess.trajectories):
            guess = self.coarse.solve(guess) or guess
        held = self._conditions_reached_by(guess)
        search = self._keeping(held) if held else self
        y = unknowns_of_guess(search.settings, search.trials, guess)
        found = search._near(y, active_set_of_guess(search.trials, guess, y), guess)
        # A neighbour has the contact points of its guess.
        if not is_neighbour(self.problem) and (more := search._worth_keeping(found)):
            search, root = search._keeping(more), found[0].root
            found = search._near(root.y, root.choice)
        return search, found

    def _near(self, y: Vector, choice: Vector, guess: Solution | None = None) -> list[ExtremalRoot]:
        """Solve from unknowns; by multiple shooting from the curves of a guess where that fails."""
        trials, root = self.trials, self.newton.root_from(y, choice, guess)
        name = trials.outside(root)
        if root.converged and name is None:
            return [found_at(trials.shooting, self.problem, self.newton.completed(root))]
        if name is not None:
            raise NotConvergedError(
                f"from this guess the extremal lies outside the bounds of {name}",
                got=f"{free_values(self.problem, trials.conditions, root.y)[name]:.6g} {self.problem.unit_of(name)}",
                advice="solve without a guess",
            )
        self.tried.append("Newton from the guess")
        raise self._failure()

    def _judged(self, ways: Iterable[StartMembers]) -> Iterator[tuple[Member, str]]:
        """Yield members within the bounds, start by start.

        Those that break a condition come last, and only where nothing else was found.
        """
        for members, name, tried in ways:
            yield from self._keeping_bounds(members, name, tried)

    def _keeping_bounds(self, members: list[Member], name: str, tried: str) -> Iterator[tuple[Member, str]]:
        breaking, met = list[Member](), 0
        for member in members:
            if self.trials.outside(member.root) is not None:
                continue
            met += 1
            if self._walked_through(member):
                continue
            breach = self.judge.breach(member.root)
            if breach is None:
                yield member, name
            else:
                breaking.append(member)
                self.broken.append(breach)
                self.breaking.append(member.root)
        breaks = f"{len(breaking)} of them break{'s' if len(breaking) == 1 else ''} a condition" if met else ""
        self.tried.append(", ".join(filter(None, (tried, _count_extremals(met), breaks))))
        if any(member.root.open_directions for member in members):
            self.tried.append(NOT_ISOLATED)
        if self.base is None:
            yield from ((member, name) for member in breaking)

    # -- the answer, or why there is none -------------------------------------------------------------------------

    def compose(self, found: Sequence[ExtremalRoot], rung: str) -> Solution:
        """Make a solution of extremals, which says by which rung they were found."""
        statistics = Statistics(
            rung=rung,
            tried=tuple(self.tried),
            iterations=self.trials.shooting.iterations,
            arcs=self.trials.shooting.arcs,
            wall_time=time.perf_counter() - self.began,
            history=tuple(self.trials.history),
        )
        return compose_solution(self.settings.name, self.problem, self.trials.conditions, found, statistics)

    def _refusal(self, found: list[ExtremalRoot]) -> PeriluneError:
        breaches = [breach for f in found if (breach := self.judge.breach(f.root)) is not None]
        return explain_refusal(self.coarse, breaches or self.broken) or self._failure()

    def refuse_if_missed(self, root: Root) -> None:
        """Raise `InfeasibleError` for an optimum that misses a bound, by however little, where no other can keep it."""
        grazing = (b for b in self.answering.judge.grazing(root) if b.canonical > ALLOWED)
        missed = [b for b in grazing if bound_unreachable_objective(self.problem, b) is not None]
        if missed:
            told = "each flight that keeps it would be better than this optimum"
            raise best_misses_bound_error(self.problem, missed, 1, told, {"tried": list(self.tried)})

    def _failure(self) -> NotConvergedError:
        trials = self.trials
        return no_start_converged_error(trials.conditions, self.coarse, trials.shooting.iterations, trials.best_failure)


def _count_extremals(count: int) -> str:
    return f"{count} extremal{'' if count == 1 else 's'}"
