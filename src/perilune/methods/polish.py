"""Indirect solution of a direct answer: its structure, and Newton's method on the conditions along each arc.

A direct answer has costates, and so starts the indirect method. That needs no fine mesh: the first one is tried before
any refinement, a refined one where it shows another structure, and at last the best one, whether or not refinement got
as far as was asked; one of many switches that starts no Newton also by way of smooth controls. What Newton's method
reaches replaces the direct answer if it is a minimum that keeps every bound and condition and is no worse than the mesh
can show; else the direct answer stays, and says so.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

from perilune.core import NotConvergedError, PeriluneError, Watch, ignore_events
from perilune.direct import ROUGHEST
from perilune.methods.direct.pseudospectral import Pseudospectral
from perilune.methods.indirect.coarse_direct import switches_often
from perilune.methods.indirect.continuation.homotopy import SMOOTH
from perilune.methods.indirect.indirect import Indirect
from perilune.methods.indirect.refinement.structure_search import StructureRefinement
from perilune.methods.indirect.search import Search
from perilune.methods.indirect.settings import STRUCTURE, SearchSettings
from perilune.methods.indirect.violations import ConstraintViolation
from perilune.problem import Nature, Problem, Solution
from perilune.structures import detect_structures

NEWTON = "Newton"  # ends the `initialization` of an answer that was made exact in the user's own phases
APART = 30.0  # times its mesh error J may be better than the exact one's: so far two good answers were seen apart


def solve_and_polish(
    method: Pseudospectral, problem: Problem, guess: Solution | None = None, watch: Watch | None = None
) -> Solution:
    """Solve by the direct method and make its answer exact.

    Parameters
    ----------
    method, problem, guess, watch
        As for `Pseudospectral.run`.

    Returns
    -------
    Solution
        Of the indirect method, its `initialization` ending with what refined it; the direct answer where nothing did.
        `statistics.attempts` says what was done.

    Raises
    ------
    InfeasibleError, NotConvergedError
        As the direct method says, where nothing exact was reached from its best flight either.
    """
    finish = _DirectPolish(settings=Indirect(), problem=problem, watch=watch or ignore_events, guided=guess is not None)
    direct, exact = None, None
    try:
        for direct in method.meshes(problem, guess, watch):
            if (exact := finish.soon(direct)) is not None:
                return exact
    except NotConvergedError as error:
        exact = None if direct is None else finish.of(error.flight)
        if exact is None:
            error.partial["attempts"] = (*error.partial["attempts"], *finish.tried)
            raise
        return exact
    assert direct is not None
    return finish.of(direct) or finish.unpolished(direct)


@dataclass(kw_only=True)
class _DirectPolish:
    """The steps that make answers of one run exact; `tried` has a line for each failure."""

    settings: SearchSettings
    problem: Problem
    watch: Watch
    guided: bool
    began: float = field(default_factory=time.perf_counter)
    tried: list[str] = field(default_factory=list)
    seen: set[str] = field(default_factory=set)
    settled: Solution | None = None  # that of which there is no more to try

    def soon(self, direct: Solution) -> Solution | None:
        """Return the exact answer in brief, from a mesh that may not be the last, for a structure not tried yet."""
        if not direct.statistics.residual < ROUGHEST:
            return None
        found = detect_structures(self.problem, direct, states_only=True)
        text = "".join(structure.text for structure in found)
        if text in self.seen:
            return None
        self.seen.add(text)
        self.settled = None if found else direct
        return self._by_any_way(direct, brief=True)

    def of(self, direct: Solution) -> Solution | None:
        """Return the exact answer near a direct one; None, with the reason in `tried`, where none was found."""
        return self._by_any_way(direct, brief=False)

    def _by_any_way(self, direct: Solution, *, brief: bool) -> Solution | None:
        ways = [(partial(self._structured, brief=brief), STRUCTURE), (self._in_one_piece, NEWTON)]
        if not brief and self.settled is direct:
            ways = []  # tried on the way
        if not brief and not self.guided and switches_often(direct):
            ways.append((self._smoothed, SMOOTH))
        for way, name in ways:
            self.watch(f"polish: {name}")
            found = self._found(way, direct)
            if found is not None and not self._worse(found, direct):
                return self._with_history(found, direct, name)
        return None

    def unpolished(self, direct: Solution) -> Solution:
        """Return the direct answer, which says why it is not exact."""
        tried = (*direct.statistics.attempts, *self.tried, "polish: the direct answer is kept unchanged")
        return replace(direct, statistics=replace(direct.statistics, attempts=tried))

    def _found(self, way: Callable[[Solution], Solution | None], direct: Solution) -> Solution | None:
        try:
            return way(direct)
        except PeriluneError as error:
            self.tried.append(f"polish: {error.what}")
            return None

    def _structured(self, direct: Solution, *, brief: bool) -> Solution | None:
        run = StructureRefinement(
            settings=self.settings, problem=self.problem, watch=self.watch, tried=self.tried, brief=brief
        )
        return run.run(direct)

    def _in_one_piece(self, direct: Solution) -> Solution | None:
        return self._admissible_minimum(*self._search().near(direct, family=not self.guided))

    def _smoothed(self, direct: Solution) -> Solution | None:
        """Solve by way of the smoothed problem: for many switches Newton's method needs more than a mesh knows."""
        return self._admissible_minimum(*self._search().smoothed(direct))

    def _search(self) -> Search:
        return Search(self.settings, self.problem, self.watch, tried=self.tried)

    def _admissible_minimum(self, found: Solution, breach: Callable[[], ConstraintViolation | None]) -> Solution | None:
        """Return an extremal if it is a minimum that keeps every condition."""
        if found.extremals[0].nature is Nature.WORST:
            self.tried.append("polish: an extremal that is not a minimum")
        elif (broken := breach()) is not None:
            self.tried.append(f"polish: an extremal, but {broken.text}")
        else:
            return found
        return None

    def _worse(self, found: Solution, direct: Solution) -> bool:
        size = self.problem.objective_size + abs(direct.objective)
        worse = found.objective - direct.objective > APART * direct.statistics.residual * size
        if worse:
            told = f"{found.objective:.9g} against {direct.objective:.9g} {self.problem.objective_unit}"
            self.tried.append(f"polish: another extremal, which is worse: J = {told}")
        return worse

    def _with_history(self, found: Solution, direct: Solution, name: str) -> Solution:
        """Return the exact answer with what led to it."""
        gain = (
            f"polish: by {name}, J = {found.objective:.12g} for {direct.objective:.12g} {self.problem.objective_unit}"
        )
        self.watch(gain)
        mesh = direct.statistics
        statistics = replace(
            found.statistics,
            initialization=f"{mesh.initialization}, then {name}",
            attempts=(*mesh.attempts, *self.tried, gain),
            iterations=mesh.iterations + found.statistics.iterations,
            wall_time=time.perf_counter() - self.began,
            history=(*mesh.history, *found.statistics.history),
        )
        extremals = (e if self.guided else replace(e, nature=e.nature.unguided) for e in found.extremals)
        return replace(found, extremals=tuple(extremals), statistics=statistics)
