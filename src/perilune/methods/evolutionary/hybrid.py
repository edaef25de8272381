"""Hybrid of two methods: a genetic algorithm from random values, and another method from its best individuals.

Peng, Li, Shen, Tang 2012, section 3.2, hand the transcribed program itself to the genetic algorithm: several
hundred variables tied by nearly as many equations. Here it searches what is left when the dynamics hold
(`perilune.methods.evolutionary.fitness`): controls at a few nodes for a direct method, initial costates for the
indirect one. Each of its k best distinct individuals starts the second method, and the best answer is returned: one
that has converged, never the population's own.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

from perilune.core import (
    NotConvergedError,
    PeriluneError,
    Watch,
    check_call,
    ignore_events,
    renamed_keywords,
    require_integers,
)
from perilune.methods.direct.pseudospectral import Pseudospectral
from perilune.methods.evolutionary.genetic import Generation, Genetic
from perilune.methods.indirect.indirect import Indirect
from perilune.problem import Extremal, Nature, Problem, Solution


@check_call
@dataclass(frozen=True)
class Hybrid:
    """A population search, then another method.

    Parameters
    ----------
    first
        Settings of the search; its `best` is the number of starts it hands on.
    second
        ``Indirect(...)`` or ``Pseudospectral(...)``.
    nodes
        Control nodes of each phase in the search for a direct method.
    """

    first: Genetic
    second: Indirect | Pseudospectral
    nodes: int = 5

    name = "hybrid"

    def __post_init__(self) -> None:
        if not isinstance(self.first, Genetic) or not isinstance(self.second, Indirect | Pseudospectral):
            raise PeriluneError(
                "a hybrid consists of a genetic search and another method",
                got=f"Hybrid({type(self.first).__name__}, {type(self.second).__name__})",
                expected="Hybrid(Genetic(...), Pseudospectral(...)) or Hybrid(Genetic(...), Indirect(...))",
            )
        require_integers(self, nodes=2)

    @renamed_keywords(watch="callback")
    def run(self, problem: Problem, guess: Solution | None = None, callback: Watch | None = None) -> Solution:
        """Solve from random values.

        Parameters
        ----------
        problem
            What to solve.
        guess
            Not used: the search starts from random values within the bounds.
        callback
            Receives one line for each generation, and what the second method says.

        Returns
        -------
        Solution
            Of the second method, unverified; `extremals` names every different objective reached, best first.

        Raises
        ------
        NotConvergedError
            If the second method converged from no individual; the message is that of its first failure.
        InfeasibleError
            As the second method says.
        KeyboardInterrupt
            If the user stopped it; `callback` has then received the best fitness so far.
        """
        from perilune.methods.evolutionary.fitness import ControlFitness, CostateFitness

        say = callback or ignore_events
        began = time.perf_counter()
        fitness = CostateFitness(problem) if isinstance(self.second, Indirect) else ControlFitness(problem, self.nodes)
        survivors = self.first.search(fitness, fitness.lower, fitness.upper, lambda g: say(_generation_line(g)))
        tried = [_generation_line(survivors.generations[-1])] if survivors.generations else []
        if survivors.interrupted:
            say("interrupted; " + (tried[0] if tried else "no generation was finished"))
            raise KeyboardInterrupt
        answers: list[Solution] = []
        failure: NotConvergedError | None = None
        for number, (genes, value) in enumerate(zip(survivors.points, survivors.values, strict=True), 1):
            start = f"individual {number} of fitness {value:.3g}"
            try:
                answers.append(self.second.run(problem, fitness.guess(genes), say))
            except NotConvergedError as error:
                failure = failure or error
                tried.append(f"{start}: {error.what}")
            else:
                tried.append(f"{start}: J = {answers[-1].objective:.9g} {problem.objective_unit}")
        if not answers:
            assert failure is not None
            failure.partial["attempts"] = [*tried, *failure.partial.get("attempts", ())]
            raise failure
        return _choose_best_refined(answers, tuple(tried), time.perf_counter() - began)


def _choose_best_refined(answers: list[Solution], tried: tuple[str, ...], wall_time: float) -> Solution:
    answers = sorted(answers, key=lambda s: s.objective)
    best = answers[0]
    known = list(best.extremals) or [_extremal(best, Nature.NEAR_GUESS)]
    # Each answer is near the individual that it began from; of these the first is the best.
    known[0] = replace(known[0], nature=known[0].nature.unguided)
    for other in answers[1:]:
        # Nearer than the methods' own accuracy is the same answer.
        if other.objective - known[-1].objective > 1e-6 * abs(best.objective):
            known.append(_extremal(other, Nature.LOCAL_OPTIMUM))
    statistics = replace(
        best.statistics,
        initialization=f"genetic search, then {best.statistics.initialization}",
        attempts=(*tried, *best.statistics.attempts),
        iterations=sum(a.statistics.iterations for a in answers),
        arcs=sum(a.statistics.arcs for a in answers),
        wall_time=wall_time,
    )
    return replace(best, extremals=tuple(known), statistics=statistics)


def _extremal(answer: Solution, nature: Nature) -> Extremal:
    own = answer.extremals[0].unknowns if answer.extremals else ()
    return Extremal(free=answer.free, objective=answer.objective, nature=nature, unknowns=own)


def _generation_line(generation: Generation) -> str:
    return f"generation {generation.number}: fitness {generation.least:.4g}, median {generation.median:.4g}"
