"""One run of the indirect method, from a guess or without one: the entry, and the solution made of its extremals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from perilune.core import NotConvergedError, Vector, Watch
from perilune.methods.indirect.admissibility import ALLOWED
from perilune.methods.indirect.coarse_direct import Coarse
from perilune.methods.indirect.cold_search import (
    better_inadmissible_roots,
    conditions_reached_by,
    conditions_worth_keeping,
    extremals_without_guess,
)
from perilune.methods.indirect.continuation.family_search import others_through
from perilune.methods.indirect.continuation.homotopy import SMOOTH, Smoothing
from perilune.methods.indirect.continuation.parameter_scan import ExtremalRoot
from perilune.methods.indirect.diagnosis import best_misses_bound_error, bound_unreachable_objective, explain_refusal
from perilune.methods.indirect.newton_trials import found_at
from perilune.methods.indirect.random_costates import active_set_of_guess, unknowns_of_guess
from perilune.methods.indirect.search_state import SearchState
from perilune.methods.indirect.settings import SearchSettings
from perilune.methods.indirect.unknowns import free_values, unknowns_from_solution
from perilune.methods.indirect.violations import ConstraintViolation
from perilune.problem import Problem, Solution, is_neighbour
from perilune.shooting import Member, Root

_LITTLE = 1e-2  # canonical: what is broken by more a mesh has seen, and its flight shows the arcs that keep it


@dataclass
class Search:
    """One run on one problem.

    Attributes
    ----------
    state
        What is known with no condition of the path kept by the control.
    answering
        The state whose extremals answer: `state`, or one whose control keeps more.
    better_inadmissible
        Extremals that break the path and are better than the answer.
    answered
        True if a flight of known arcs is at hand: what takes long is left out.
    flown
        The best flight of known arcs of which no extremal was found.
    """

    settings: SearchSettings
    problem: Problem
    watch: Watch
    tried: list[str] = field(default_factory=list)
    compared: bool = False

    def __post_init__(self) -> None:
        self.state: SearchState = SearchState(
            self.settings, self.problem, self.watch, tried=self.tried, compared=self.compared
        )
        self.answering: SearchState = self.state
        self.better_inadmissible: list[Root] = []
        self.answered: bool = False
        self.flown: Solution | None = None

    def solve(self, guess: Solution | None = None, base: Member | None = None) -> Solution:
        """Solve from a guess; or from all starts, after the family through `base` (of another run) if any.

        Parameters
        ----------
        guess
            Trajectory to start Newton's method from, the only start if it is given.
        base
            Member of a family of extremals (canonical) that another run found.

        Raises
        ------
        InfeasibleError
            If a bound that holds for every flight shows that none exists.
        NotConvergedError
            If no admissible extremal was found.
        """
        if guess is not None:
            return self.near(guess)[0]  # whether it keeps the rest of the path is for the proof to say
        state, found = extremals_without_guess(self.state, base, answered=self.answered)
        self.answering, self.better_inadmissible = state, better_inadmissible_roots(state, found)
        if not state.has_answer(found):
            breaches = [breach for f in found if (breach := state.judge.breach(f.root)) is not None]
            raise explain_refusal(state.coarse, breaches or state.broken) or state.failure()
        return state.compose([f for f in found if state.judge.breach(f.root) is None], state.start)

    def near(
        self, guess: Solution, *, family: bool = False
    ) -> tuple[Solution, Callable[[], ConstraintViolation | None]]:
        """Return what Newton's method reaches from a guess, and a callable for the first condition that it breaks.

        With `family` the best of all extremals on the family through it, along a free parameter between bounds.

        Parameters
        ----------
        guess
            Trajectory to start Newton's method from.
        family
            True to follow the family of extremals through the one found.

        Raises
        ------
        NotConvergedError
            If Newton's method does not converge from the guess.
        """
        state, found = self._from_guess(guess)
        if not family or state.trials.scanned is None:
            return state.compose(found, "guess"), lambda: state.judge.breach(found[0].root)
        found += [f for f in others_through(state, found[0]) if state.judge.breach(f.root) is None]
        found = sorted(found, key=lambda f: (not f.minimum, f.root.cost))
        return state.compose(found, "family"), lambda: state.judge.breach(found[0].root)

    def along_families(
        self, known: Solution
    ) -> tuple[list[ExtremalRoot], Callable[[Sequence[ExtremalRoot]], Solution]]:
        """Return the extremal of a solution, those on families through it, and what makes solutions of some of them."""
        state, found = self._from_guess(known)
        return [*found, *others_through(state, found[0])], lambda some: state.compose(some, "family")

    def smoothed(self, rough: Solution) -> tuple[Solution, Callable[[], ConstraintViolation | None]]:
        """Solve as `near`, but by way of smooth controls, with what a rough answer of many switches holds."""
        state, trials = self.state, self.state.trials
        smoothing = Smoothing(trials=trials, segments=self.settings.segments)
        root = None
        if trials.scanned is None:
            root = smoothing.root(
                active_set_of_guess(trials, unknowns_from_solution(self.problem, trials.conditions, rough))
            )
        self.tried += [smoothing.summary] if smoothing.summary else []
        if root is None or trials.outside(root) is not None:
            raise state.failure()
        return state.compose([ExtremalRoot(root=root, minimum=True)], SMOOTH), lambda: state.judge.breach(root)

    def flights_near_better(self) -> Iterator[Solution]:
        """Yield the direct method's flights near extremals better than the answer, with the path conditions kept."""
        if not self.better_inadmissible:
            return
        yield from filter(None, [self.state.coarse.solve()])
        for root in self.better_inadmissible if self.state.trials.bounded else ():
            guess = self.answering.compose([ExtremalRoot(root=root, minimum=True)], "")
            yield from filter(None, [Coarse(self.settings, self.problem, self.tried, self.watch).solve(guess)])

    def breaking_path(self) -> Iterator[Solution]:
        """Yield as solutions the extremals that are better than every answer and break only the path, by little."""
        state = self.answering
        for root in self.better_inadmissible:
            if all(breach.canonical <= _LITTLE for breach in state.judge.breaches(root)):
                yield state.compose([ExtremalRoot(root=root, minimum=True)], "")

    def refuse_if_missed(self, root: Root) -> None:
        """Raise `InfeasibleError` for an optimum that misses a bound, by however little, where no other can keep it."""
        grazing = (b for b in self.answering.judge.grazing(root) if b.canonical > ALLOWED)
        missed = [b for b in grazing if bound_unreachable_objective(self.problem, b) is not None]
        if missed:
            told = "each flight that keeps it would be better than this optimum"
            raise best_misses_bound_error(self.problem, missed, 1, told, {"attempts": list(self.tried)})

    def _from_guess(self, guess: Solution) -> tuple[SearchState, list[ExtremalRoot]]:
        """Solve from a guess; what lies on a bound there begins on it, what the path holds back there is kept."""
        own = guess.method == self.settings.name and guess.unknowns is not None  # which has costates
        if not own and any(flown.costate is None for flown in guess.trajectories):
            guess = self.state.coarse.solve(guess) or guess
        held = conditions_reached_by(self.state, guess)
        state = self.state.keeping(held) if held else self.state
        y = unknowns_of_guess(self.settings, state.trials, guess)
        found = _extremals_near(state, y, active_set_of_guess(state.trials, y), guess)
        # A neighbour has the contact points of its guess.
        if not is_neighbour(self.problem) and (more := conditions_worth_keeping(state, found)):
            state, root = state.keeping(more), found[0].root
            found = _extremals_near(state, root.y, root.choice)
        return state, found


def _extremals_near(state: SearchState, y: Vector, choice: Vector, guess: Solution | None = None) -> list[ExtremalRoot]:
    """Solve from unknowns; by multiple shooting from the curves of a guess where that fails."""
    trials, root = state.trials, state.newton.root_from(y, choice, guess)
    name = trials.outside(root)
    if root.converged and name is None:
        return [found_at(trials.shooting, state.problem, state.newton.completed(root))]
    if name is not None:
        raise NotConvergedError(
            f"from this guess the extremal lies outside the bounds of {name}",
            got=f"{free_values(state.problem, trials.conditions, root.y)[name]:.6g} {state.problem.unit_of(name)}",
            advice="solve without a guess",
        )
    state.tried.append("Newton from the guess")
    raise state.failure()
