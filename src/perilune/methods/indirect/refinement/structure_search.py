"""Refinement of a rough answer to an extremal: detect arcs, reformulate the problem, apply Newton, revise arcs.

A pure state condition is kept by boundary arcs or contact points, which no single smooth arc does; nor does one
know when a control becomes singular, as H says nothing of it then. The structure is read off the direct method's answer
(`perilune.structures.detect_arcs`, `perilune.structures.detect_regimes`), and each of its arcs becomes a phase. The
extremal of that shows whether it is the right one, and changes it by rule, a bounded number of times
(`perilune.structures.revise_arcs`). A boundary arc to the end is first tried as a contact point
where it begins.

Bounds and conditions of the control the law of each arc keeps by itself, as far as it can hold them; an extremal that
breaks one is no answer.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

from perilune.core import PeriluneError, Watch
from perilune.methods.indirect.chattering import find_chattering_arc
from perilune.methods.indirect.newton_trials import bounded_parameters
from perilune.methods.indirect.refinement.switch_pair import with_pair
from perilune.methods.indirect.result import Curves
from perilune.methods.indirect.search import Search
from perilune.methods.indirect.settings import STRUCTURE, SearchSettings
from perilune.methods.indirect.violations import violation_by_control
from perilune.problem import Problem, Solution, is_neighbour
from perilune.structures import (
    HoppingStructure,
    JoinedTrajectories,
    Structure,
    contacts_in_phase,
    detect_structures,
    join_solution,
    renumber_restated,
    restate,
    revise_structure,
    split_solution,
    stays_between_bounds,
)

ATTEMPTS, MOST_ARCS = 6, 12
_GUESSED = 1e-2  # of what it goes through: as near to a condition as a guess may only mean to be on it
_EXACT = 1e-7  # the same of what a neighbour begins with, which is on it or is not
_ROUGH = 1e-2  # relative mesh error from which on a finer mesh is asked first
_FINE = 1e-3  # relative mesh error up to which a finer one shows no more
_WITHOUT_NEWTON = 1e-8  # relative mesh error up to which a flight of a structure is one without Newton's method
_FEW = 2  # arcs of multiple shooting in a trial that is to be cheap


@dataclass(kw_only=True)
class StructureRefinement:
    """One run from one rough answer.

    Parameters
    ----------
    settings, problem, watch
        Of the search that needs it.
    tried
        Receives a line for each structure.
    guessed
        Whether it begins with the user's guess, and not with what a search found.
    brief
        Whether each structure is tried only from the rough answer, and on no mesh of its own.
    """

    settings: SearchSettings
    problem: Problem
    watch: Watch
    tried: list[str]
    guessed: bool = False
    brief: bool = False
    chattering: Solution | None = None  # along a structure of which no flight is the best

    def run(self, rough: Solution) -> Solution | None:
        """Return the extremal of the structure of a rough answer, in the user's phases; None where none was found."""
        found = self._first(rough)
        alone = self.guessed or self.brief or is_neighbour(self.problem) or not bounded_parameters(self.problem)
        return found if found is None or alone or self.chattering is not None else self._best_along_families(found)

    def _first(self, rough: Solution) -> Solution | None:
        if (found := self._known_by_arcs(rough)) is not None:
            return found
        least = _EXACT if is_neighbour(self.problem) else _GUESSED if self.guessed else None
        for known in self._known(rough):
            seen = set[str]()  # where one flight leads to nothing another one may
            structures = detect_structures(self.problem, known, least)
            few = [structure for structure in structures if structure.count <= MOST_ARCS]
            for structure in few or structures:
                if (found := self._hopping(known, structure)) is not None:
                    return found
                if (found := self.followed(known, structure, seen)) is not None:
                    return found
        return None

    def _hopping(self, rough: Solution, structure: Structure) -> Solution | None:
        """Return the extremal with a contact point where a boundary arc to the end begins, if there is one.

        A mesh resolves no hop of centimetres, and along the arc that it shows Newton's method takes seconds to fail.
        """
        hopping = HoppingStructure.of(self.problem, structure)
        if is_neighbour(self.problem) or hopping.structure == structure:
            return None
        quick = replace(self, brief=True, settings=replace(self.settings, segments=_FEW))
        answer = quick.followed(rough, hopping.structure, set())
        return answer if answer is not None and hopping.left_behind(answer) else None

    def _known_by_arcs(self, guess: Solution) -> Solution | None:
        """Solve from a guess known arc by arc, of a problem that differs in values of its parameters."""
        known = guess.trajectories
        if self.brief or not isinstance(known, JoinedTrajectories) or not self.problem.differs_in_values(guess.problem):
            return None
        structure = known.structure
        self.watch(f"structure: {structure.text}")
        try:
            known.refuse_unstated_ends(self.problem)
            problem = renumber_restated(known.restated.problem, self.problem, structure)
            solved = Search(self.settings, problem, self.watch).solve(known.restated)
            return self._kept_to(structure, solved, join_solution(self.problem, solved, structure))[0]
        except PeriluneError as error:
            self.tried.append(f"structure {structure.text}: {error.what}")
            return None

    def _known(self, rough: Solution) -> Iterator[Solution]:
        """Yield the rough answer, and of some that of a finer mesh: the better one first.

        Where a control wavers between its bounds it may be singular, or held by a condition on states; a boundary arc
        of one may be two contact points. A rougher mesh shows it worse, so that a finer one comes last in any case.
        """
        exact = self.guessed or self.brief
        wavers = not exact and stays_between_bounds(rough)
        finer = wavers or (not exact and self._rides(rough))
        if not (finer and rough.statistics.residual > _ROUGH):
            yield rough
        if finer:
            yield from self._finer(rough, 32 if wavers else 24, close=not wavers)
        if finer and rough.statistics.residual > _ROUGH:
            yield rough
        near = self.guessed or self.brief or is_neighbour(self.problem)
        if not (finer or near) and rough.statistics.residual > _FINE:
            yield from self._finer(rough, 24, close=True)

    def _finer(self, rough: Solution, segments: int, *, close: bool) -> Iterator[Solution]:
        """Yield the same flight of a mesh of so many segments, where that finds one."""
        from perilune.methods.direct.pseudospectral import Pseudospectral  # and with it much of SciPy

        with suppress(PeriluneError):
            yield Pseudospectral(nodes=6, segments=segments, refine=0).near(rough, self.watch, close=close)

    def _rides(self, rough: Solution) -> bool:
        phases = range(len(self.problem.phases))
        return any(contact.is_arc for k in phases for contact in contacts_in_phase(rough, k))

    def followed(self, rough: Solution, structure: Structure | None, seen: set[str]) -> Solution | None:
        """Follow the structures from the first that an answer has to the one that its extremal keeps to.

        Parameters
        ----------
        rough
            Trajectory to start Newton's method from on the first structure.
        structure
            First structure; None for none to follow.
        seen
            Texts of the structures tried already, which are not tried again; those tried here are added.

        Returns
        -------
        Solution or None
            The extremal in the user's phases; None if a structure fails, returns, or has more than `MOST_ARCS` arcs.
        """
        while structure is not None and structure.text not in seen and len(seen) < ATTEMPTS:
            if structure.count > MOST_ARCS:
                self._say(f"structure of more than {MOST_ARCS} arcs: not tried")
                return None
            seen.add(structure.text)
            self.watch(f"structure: {structure.text}")
            whole, revised = rough, None
            try:
                for solved in self._extremals(rough, structure):
                    whole = join_solution(self.problem, solved, structure, named=not is_neighbour(self.problem))
                    answer, revised = self._kept_to(structure, solved, whole)
                    if answer is not None:
                        return answer
            except PeriluneError as error:
                if self.chattering is not None:
                    return self._composed(join_solution(self.problem, self.chattering, structure))
                self.tried.append(f"structure {structure.text}: {error.what}")
                return None
            rough, structure = whole, revised
        return None

    def _kept_to(
        self, structure: Structure, solved: Solution, whole: Solution
    ) -> tuple[Solution | None, Structure | None]:
        """Return the answer if the extremal of a structure keeps to it; else the structure that it asks for, if any."""
        known, curves = whole.trajectories, solved.trajectories
        assert isinstance(known, JoinedTrajectories), "of arcs"
        assert isinstance(curves, Curves), "of a search, which ends at a root"
        kept = known.structure
        # A neighbour has the arcs of its guess.
        revised = (
            kept
            if is_neighbour(self.problem)
            else revise_structure(self.problem, kept, solved, whole, curves.propagated().at)
        )
        if revised is not kept:
            self._say(f"structure {structure.text}: an extremal of another structure")
            return None, revised
        if not is_neighbour(self.problem) and (breach := violation_by_control(kept, whole)) is not None:
            self._say(f"structure {structure.text}: an extremal, but {breach.text}")
            return None, None
        self.tried.append(f"structure {structure.text}: an extremal")
        return self._composed(whole), None

    def _say(self, line: str) -> None:
        """Report a line of what was tried, once."""
        self.tried += [] if line in self.tried else [line]

    def _best_along_families(self, first: Solution) -> Solution:
        """Return the best of an answer and of those along families of parameters between bounds, with its arcs.

        Where these are no longer its arcs they are revised, and what comes of that is followed in its turn.
        """
        answers, left, seen = list[Solution](), [first], set[str]()
        while left and len(answers) < ATTEMPTS:
            known = left.pop(0).trajectories
            assert isinstance(known, JoinedTrajectories), "of arcs"
            if known.structure.text in seen:
                continue
            seen.add(known.structure.text)
            search = Search(self.settings, known.restated.problem, self.watch)
            found, solution_of = search.along_families(known.restated)
            kept = found[:1]
            for one in found[1:]:
                solved = solution_of([one])
                whole = join_solution(self.problem, solved, known.structure)
                answer, revised = self._kept_to(known.structure, solved, whole)
                if answer is not None:
                    kept.append(one)
                elif one.minimum and (turned := self.followed(whole, revised, {known.structure.text})) is not None:
                    left.append(turned)
            answers.append(self._composed(join_solution(self.problem, solution_of(kept), known.structure)))
        best = min(answers, key=lambda one: one.objective)
        others = (replace(e, nature=e.nature.dominated) for one in answers if one is not best for e in one.extremals)
        return replace(best, extremals=(*best.extremals, *others))

    def _composed(self, found: Solution) -> Solution:
        """Near a guess of this run's own it is the best, as it is the only one."""
        extremals = (e if self.guessed else replace(e, nature=e.nature.unguided) for e in found.extremals)
        statistics = replace(found.statistics, initialization=STRUCTURE, attempts=tuple(self.tried))
        return replace(found, extremals=tuple(extremals), statistics=statistics)

    def _extremals(self, rough: Solution, structure: Structure) -> Iterator[Solution]:
        """Yield the extremals of a structure: by Newton's method from a rough answer at once, then by a mesh.

        Raises
        ------
        PeriluneError
            If it finds neither.
        """
        from perilune.methods.direct.pseudospectral import Pseudospectral  # and with it much of SciPy

        restated = restate(self.problem, structure, repeated=False)
        guess, failure, found = split_solution(rough, structure, restated), None, False
        # A neighbour begins next to its own extremal, which has the pair.
        if not is_neighbour(self.problem) and (pair := structure.begun_pair(self.problem)) is not None:
            self.watch("structure: a new pair of switches")
            search = Search(self.settings, guess.problem, self.watch)
            if (solved := with_pair(search, guess, pair)) is not None:
                yield solved
                found = True
        # Phases that are smooth need one mesh; those in which a bounded control jumps need it where it does.
        # Where a control chatters no mesh is fine enough.
        refine = 0 if structure.singular else 3
        meshes = [
            Pseudospectral(refine=0).near,
            Pseudospectral(segments=4, nodes=6, refine=refine, tolerance=1e-3).near,
        ]
        if structure.switched:  # every arc is smooth and known, but for the costates of boundary arcs
            meshes.insert(0, partial(Pseudospectral(segments=4, nodes=5, refine=0).near, close=True))
        # Most answers are near enough as they are; from others it leaps to an extremal of another structure.
        for mesh in (None,) if self.brief else (None, *meshes):
            start = guess
            try:
                compared = is_neighbour(self.problem)
                # Where there is no control law the search says so.
                search = Search(self.settings, guess.problem, self.watch, compared=compared)
                start = guess if mesh is None else mesh(guess, self.watch)
                self.watch("structure: Newton's method")
                solved = search.solve(start)
            except PeriluneError as error:
                failure = error
            else:
                yield solved
                found = True
                if mesh is not None or self.guessed:
                    return
                continue
            exact = mesh is not None and start.statistics.residual < _WITHOUT_NEWTON
            if exact and (name := find_chattering_arc(start)) is not None:
                self._say(
                    f"structure {structure.text}: no optimal flight follows it (chattering), because faster switching"
                    f" of {name} between its bounds lowers J further: a flight along it, not an extremal"
                )
                self.chattering = start
                break
        if failure is not None and not found:
            raise failure
