"""Indirect method without an initial guess: Pontryagin's conditions, shooting, and ways to start it.

They are tried in order, the last two only where those before failed:

1. *random costates*: the conditions are linear in the costates up to a factor, and `Problem.scales` make
   their components comparable, so random directions of length one cover the possibilities;
2. *continuation in the duration*, where every duration is given and nothing is free: extremals of shorter flights are
   carried to the whole one (`continuation.duration_continuation`), and those with smoothed controls where there are
   several, unless most of the random directions led to a single one;
3. *direct transcription*: a coarse pseudospectral solution and the costates that its multipliers give;
4. *multiple shooting* from the same, for arcs too unstable to fly in one piece; where no coarse mesh follows the flight
   from finer ones, and of many switches by way of *smoothed controls* (`continuation.homotopy`).

Where the proof says that the answer is no minimum, `beyond` asks the direct method for a better one.

A free parameter between finite bounds (the retro burn) is held at first; then the whole family along it is followed
and every extremal on it found (`perilune.methods.indirect.continuation.parameter_scan`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from perilune.core import (
    InfeasibleError,
    NotConvergedError,
    PeriluneError,
    TimeLimitReached,
    Watch,
    check_call,
    format_quantity,
    ignore_events,
    remember_best,
    renamed_keywords,
)
from perilune.methods.indirect.diagnosis import flight_without_extremal_error
from perilune.methods.indirect.result import Curves
from perilune.methods.indirect.search import Search
from perilune.methods.indirect.settings import STRUCTURE, TRANSCRIBED, SearchSettings
from perilune.problem import KNOWN_BETTER, Problem, Solution, fitting_guess, is_neighbour, objective_text
from perilune.shooting import Member
from perilune.structures import JoinedTrajectories, Structure

_ROUGH = 1e-6  # relative: what flights of known arcs err in J
_STEPS_OWE, _TIMES_OWE = 1e-5, 1e-2  # the same, and of the flight's times, where an extremal of the same arcs was found
_ALIKE = 1e-9  # relative difference of J: extremals that differ by less are the same


@check_call
@dataclass(frozen=True, kw_only=True)
class Indirect(SearchSettings):
    """Settings of the indirect method.

    Parameters
    ----------
    starts
        Random starts: directions of the costates at the start of the flight.
    seed
        Of the random starts; the same seed gives the same answer.
    scan_points
        Values visited along a free parameter between finite bounds.
    segments
        Arcs for each phase in multiple shooting, which is the last way of starting.
    transcription
        The direct method from which the search goes on where random costates lead to nothing; its mesh need not be
        fine. None: 8 segments of 5 nodes, of several phases fewer for each, not refined.
    """

    @renamed_keywords(watch="callback")
    def run(self, problem: Problem, guess: Solution | None = None, callback: Watch | None = None) -> Solution:
        """Solve.

        Parameters
        ----------
        problem
            What to solve.
        guess
            A solution of any method for this problem or one of the same form.
        callback
            Receives each Newton iteration, or a line of text for each round of many starts and each way of starting.

        Returns
        -------
        Solution
            Unverified; its `extremals` list every extremal found, best first, itself the first.

        Raises
        ------
        NotConvergedError
            If every way of starting failed; its `flight` is the direct method's, where one keeps every condition.
        InfeasibleError
            If bounds and conditions contradict each other, or if every extremal found violates a condition and the
            direct method finds no flight either.
        """
        search = Search(self, problem, callback or ignore_events)
        if guess is not None and _may_be_structured(guess := fitting_guess(problem, guess)):
            found = self._structured(search, guess, guessed=True)
            if found is not None:
                return found
        return self.answer(search, guess)

    def answer(self, search: Search, guess: Solution | None = None, base: Member | None = None) -> Solution:
        """Return what a search finds, or the extremal of a structure where that is no answer or is worse.

        Parameters
        ----------
        search
            Of a problem, with these settings.
        guess, base
            As for `Search.solve`.

        Raises
        ------
        NotConvergedError, InfeasibleError
            As `run`.
        """
        drawn = [] if guess is not None or base is not None else self._of_known_arcs(search)
        search.answered = bool(drawn) or search.flown is not None
        for one in drawn:
            _report_best(search, one, "from an arc sequence that the model proposes")
        try:
            solution = search.solve(guess, base)
        except (NotConvergedError, InfeasibleError) as error:
            if drawn:
                return self._compared(search, _merge_searches(drawn, search))
            if search.flown is not None:
                raise flight_without_extremal_error(search.flown, search.tried) from error
            # What no single arc keeps, a structure of arcs may.
            rough = search.state.coarse.solution if guess is None else None
            if rough is not None and (found := self._structured(search, rough)) is not None:
                return found
            # So may an extremal that breaks the path by little: a mesh need not show the moment for which it does.
            for known in search.breaking_path() if guess is None else ():
                if (found := self._structured(search, known, brief=True)) is not None:
                    return found
            error.partial["attempts"] = list(search.tried)
            raise
        except TimeLimitReached as end:
            end.tried = (*search.tried, *end.tried)
            raise
        if drawn:
            solution = _merge_searches([solution, *drawn], search)
        _report_best(search, solution, "and whether another is better remains open")
        outdoing = () if any(solution.objective == one.objective for one in drawn) else search.flights_near_better()
        for rough in outdoing:
            if not rough.objective < solution.objective:
                continue
            found = self._structured(search, rough)
            if found is not None and found.objective < solution.objective:
                others = (replace(e, nature=e.nature.dominated) for e in solution.extremals)
                solution = replace(found, extremals=(*found.extremals, *others))
        return self._compared(search, self._exactly(search, solution)) if guess is None else solution

    def _compared(self, search: Search, solution: Solution) -> Solution:
        """Return an answer; with a line that says so where a flight of known arcs is better by more than its error."""
        gain = 0.0 if search.flown is None else solution.objective - search.flown.objective
        if not gain > _ROUGH * abs(solution.objective):
            return solution
        gained = format_quantity(gain, search.problem.objective_unit, 3)
        said = f"{KNOWN_BETTER} {gained}, but no extremal of its arcs was found"
        statistics = replace(solution.statistics, attempts=(*solution.statistics.attempts, said))
        return replace(solution, statistics=statistics)

    def _exactly(self, search: Search, solution: Solution) -> Solution:
        """Return an answer that breaks the path by less than a search minds with the arcs that keep it, if any do."""
        known = solution.trajectories
        if not isinstance(known, Curves) or not search.answering.judge.grazed(known.root):
            return solution
        found = self._structured(search, solution, brief=True)
        if found is None:
            search.refuse_if_missed(known.root)
        return solution if found is None else replace(found, extremals=(*found.extremals, *solution.extremals[1:]))

    def beyond(self, problem: Problem, solution: Solution, watch: Watch | None = None) -> Solution | None:
        """Return the extremal found from an unguided direct solution, if better than this one, which is no minimum.

        Parameters
        ----------
        problem
            The problem solved.
        solution
            An extremal of it that the proof has shown to be no minimum.
        watch
            Called with each iteration and with lines of text; None for silence.

        Returns
        -------
        Solution or None
            None if the direct method, or the extremal found from it, is not better.
        """
        search = Search(self, problem, watch or ignore_events)
        rough = search.state.coarse.solve()
        if rough is None or not rough.objective < solution.objective:
            return None
        search.watch("the extremal is not a minimum: restart from the direct method's answer")
        try:
            found = self.run(problem, rough, watch)
        except PeriluneError:
            return None
        if not found.objective < solution.objective:
            return None
        others = (replace(e, nature=e.nature.dominated) for e in solution.extremals)
        tried = (*solution.statistics.attempts, *search.tried, *found.statistics.attempts)
        return replace(
            found,
            extremals=(*(replace(e, nature=e.nature.unguided) for e in found.extremals), *others),
            statistics=replace(found.statistics, initialization=TRANSCRIBED, attempts=tried),
        )

    def _of_known_arcs(self, search: Search) -> list[Solution]:
        """Return the extremals that the problem's own guesses of known arcs lead to."""
        if search.problem.switching_guesses is None or is_neighbour(search.problem):
            return []
        from perilune.methods.indirect.refinement.structure_search import StructureRefinement

        search.watch("start: arc sequences that the model proposes")
        found = list[Solution]()
        try:
            for rough, structure in search.problem.switching_guesses(search.problem):
                polish = StructureRefinement(
                    settings=self, problem=search.problem, watch=search.watch, tried=search.tried, brief=True
                )  # fmt: skip
                exact = polish.followed(rough, structure, set())
                if exact is None or not _is_exactly(exact, rough, structure):
                    search.flown = _better_flight(search.flown, rough)
                if exact is not None:
                    found.append(exact)
                    break
        except (PeriluneError, ArithmeticError, ValueError) as error:  # a guess of numbers that no flight has
            search.tried.append(f"arc sequences that the model proposes: {error}".partition("\n")[0])
        return found

    def _structured(
        self, search: Search, rough: Solution, *, guessed: bool = False, brief: bool = False
    ) -> Solution | None:
        from perilune.methods.indirect.refinement.structure_search import StructureRefinement

        found = StructureRefinement(
            settings=self, problem=search.problem, watch=search.watch, tried=search.tried, guessed=guessed,
            brief=brief or is_neighbour(search.problem),
        ).run(rough)  # fmt: skip
        if found is None:
            return None
        took = time.perf_counter() - search.state.began
        return replace(found, statistics=replace(found.statistics, wall_time=took))


def _report_best(search: Search, one: Solution, beside: str) -> None:
    """Report an extremal that is the best so far."""
    remember_best(
        search.problem, one.objective, lambda: f"{objective_text(one, 9)}, {beside}", lambda: one, extremal=True
    )


def _merge_searches(found: Sequence[Solution], search: Search) -> Solution:
    """Return the best of several answers, with the extremals of the others behind its own."""
    best = min(found, key=lambda one: one.objective)  # of equals the first
    alike = _ALIKE * abs(best.objective)
    others = (one for one in found if one is not best and one.objective - best.objective > alike)
    dominated = (replace(e, nature=e.nature.dominated) for one in others for e in one.extremals)
    took = time.perf_counter() - search.state.began
    statistics = replace(best.statistics, attempts=tuple(search.tried), wall_time=took)
    return replace(best, extremals=(*best.extremals, *dominated), statistics=statistics)


def _better_flight(known: Solution | None, other: Solution) -> Solution | None:
    """Return the better one of two flights; one without an objective is none that can be flown."""
    least = math.inf if known is None else known.objective
    return other if other.objective < least else known


def _is_exactly(exact: Solution, rough: Solution, structure: Structure) -> bool:
    """Return True if an extremal is a rough flight of known arcs itself, better or worse by what steps of that owe."""
    if not isinstance(known := exact.trajectories, JoinedTrajectories):
        return False
    arcs, others = ([arc for own in of.phases for arc in own] for of in (known.structure, structure))
    return (
        known.structure.text == structure.text
        and abs(exact.objective - rough.objective) <= _STEPS_OWE * abs(exact.objective)
        and all(
            abs(arc.until - other.until) <= _TIMES_OWE * others[-1].until
            for arc, other in zip(arcs, others, strict=True)
        )
    )


def _may_be_structured(guess: Solution) -> bool:
    """Return True if a guess may have contact points or boundary arcs; an indirect one says so itself."""
    return (
        isinstance(guess.trajectories, JoinedTrajectories)  # an atlas's answer of arcs, too
        or guess.statistics.initialization.endswith(STRUCTURE)
        or guess.method != Indirect.name
    )
