"""State that a run of the indirect method passes on: problem, Newton's method, what was tried and found so far."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from perilune.conditions import Held, attainable_conditions
from perilune.core import NotConvergedError, Vector, Watch
from perilune.methods.indirect.admissibility import AdmissibilityTest
from perilune.methods.indirect.coarse_direct import Coarse
from perilune.methods.indirect.continuation.parameter_scan import ExtremalRoot, same_vector
from perilune.methods.indirect.diagnosis import no_start_converged_error
from perilune.methods.indirect.guess_newton import GuessNewton
from perilune.methods.indirect.newton_trials import Trials
from perilune.methods.indirect.result import compose_solution
from perilune.methods.indirect.settings import SearchSettings
from perilune.methods.indirect.violations import ConstraintViolation
from perilune.problem import Problem, Solution, Statistics, kept_text
from perilune.shooting import Member, Root


@dataclass
class SearchState:
    """Knowledge of one run, with a control that keeps the conditions `keep` of the path.

    Attributes
    ----------
    settings, problem, watch, keep
        As given.
    tried
        Lines on what was tried, of all states of a run.
    compared
        True if the extremal is compared with that of a guess, to last digits.
    trials, newton, judge
        Newton's method on the problem, from guesses, and the test of admissibility.
    keepable
        Names of the conditions that the control could keep besides.
    walked
        Unknowns of the members of the families followed, by the held value.
    followed
        Extremals from which families along all parameters between bounds were followed, where there are several.
    base, start
        The member from which the best family was followed, and the way of starting that led to it.
    broken, breaking
        What extremals with the scanned parameter held break, and these extremals.
    coarse
        The direct method's flights, of all states of a run.
    """

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
        self.walked: dict[float, list[Vector]] = {}
        self.followed: list[ExtremalRoot] = []
        self.base: Member | None = None
        self.start: str = ""
        self.broken: list[ConstraintViolation] = []
        self.breaking: list[Root] = []
        self.coarse: Coarse = Coarse(self.settings, self.problem, self.tried, self.watch)

    def keeping(self, more: Held) -> SearchState:
        """Return a fresh state of the same run, whose control keeps more conditions of the path."""
        self.watch(f"{kept_text(self.problem, more)} is active: the control keeps it")
        keep = tuple(name for name in attainable_conditions(self.problem) if name in {*self.keep, *more})
        state = SearchState(self.settings, self.problem, self.watch, keep, self.tried)
        state.coarse, state.trials.history = self.coarse, self.trials.history
        return state

    def has_answer(self, found: Sequence[ExtremalRoot]) -> bool:
        """Return True if one of the extremals is admissible and a minimum along the free parameters."""
        return any(f.minimum and self.judge.breach(f.root) is None for f in found)

    def walked_through(self, member: Member) -> bool:
        """Return True if a family that was followed holds the member."""
        return any(same_vector(y, member.root.y, 1e-5) for y in self.walked.get(member.value, []))

    def compose(self, found: Sequence[ExtremalRoot], start: str) -> Solution:
        """Make a solution of extremals, which says by which start they were found.

        Parameters
        ----------
        found
            Extremals in any order; the best becomes the answer.
        start
            Name of the way of starting, in `Statistics.initialization`.
        """
        statistics = Statistics(
            initialization=start,
            attempts=tuple(self.tried),
            iterations=self.trials.shooting.iterations,
            arcs=self.trials.shooting.arcs,
            wall_time=time.perf_counter() - self.began,
            history=tuple(self.trials.history),
        )
        return compose_solution(self.settings.name, self.problem, self.trials.conditions, found, statistics)

    def failure(self) -> NotConvergedError:
        """Return the error of a run that no start brought to an extremal."""
        trials = self.trials
        return no_start_converged_error(trials.conditions, self.coarse, trials.shooting.iterations, trials.best_failure)


def count_extremals(count: int) -> str:
    """Return the number of extremals in words."""
    return f"{count} extremal{'' if count == 1 else 's'}"
