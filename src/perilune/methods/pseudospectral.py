"""Direct method: collocate, solve the NLP, measure the mesh by simulation, refine it, map the covectors.

Peng, Li, Shen, Tang 2012, (5)-(16); Garg et al. 2010 for Radau. From no guess the first mesh holds a straight
line from the start to `Phase.typical_end`, under the control that fits the line best.

The answer is a local minimum of the transcribed problem. It carries the costates of the covector mapping, so
that it is checked by the same conditions as an answer of the indirect method, and starts that method.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from perilune.direct.collocation import Mesh, Scheme, rule
from perilune.problem.problem import Problem
from perilune.problem.solution import Deferred, Solution, Statistics
from perilune.words.asked import demand_whole
from perilune.words.outcome import Outcome, PeriluneError
from perilune.words.types import Matrix, Vector
from perilune.words.watch import Iteration, Watch, silent

if TYPE_CHECKING:
    from perilune.direct.layout import PhaseValues
    from perilune.direct.nlp import Answer, Program
    from perilune.direct.segments import Segment

# Most iterations of the first attempt and of a search for the least miss; what ends well takes 10 to 60 and 10 to 130.
BRIEF, PATIENT = 60, 150
# Starts that all end at a least miss that is not zero, before the problem is said to have no flight.
CONVINCED = 2
# Of its typical duration: what a phase has left that has shrunk to nothing.
VANISHED = 1e-3
# A condition violated by less, in canonical units, is met.
MISSED = 1e-7


@dataclass(frozen=True, kw_only=True)
class Pseudospectral:
    """Settings of the direct method.

    Parameters
    ----------
    scheme
        ``"gauss"`` (Legendre-Gauss) or ``"radau"`` (Legendre-Gauss-Radau).
    nodes, segments
        Collocation points of each segment and segments of each phase on the first mesh.
    tolerance
        Accuracy asked of the mesh: difference from explicit simulation on each segment, relative to 1 +
        max|x| in canonical units.
    refine
        Most refinements; 0 keeps the first mesh, and then the error is reported but nothing is asked of it.
    iterations
        Most iterations of one NLP.
    nlp_tolerance
        Of the NLP's optimality conditions, in canonical units.
    polish
        Whether `perilune.solve` makes the answer exact by Newton's method on its structure
        (`perilune.methods.polished`); `run` itself never does.
    """

    scheme: Scheme = "gauss"
    nodes: int = 20
    segments: int = 1
    tolerance: float = 1e-6
    refine: int = 8
    iterations: int = 300
    nlp_tolerance: float = 1e-10
    polish: bool = True

    def __post_init__(self) -> None:
        demand_whole(self, nodes=1, segments=1, refine=0, iterations=1)
        rule(self.scheme, self.nodes)
        for name in ("tolerance", "nlp_tolerance"):
            if not 0 < getattr(self, name) < 1:
                raise PeriluneError(f"{name} must lie between 0 and 1", got=str(getattr(self, name)))

    def run(self, problem: Problem, guess: Solution | None = None, watch: Watch | None = None) -> Solution:
        """Solve the problem.

        Parameters
        ----------
        problem
            Any problem.
        guess
            A solution of any method for the same phases; None starts from a straight line.
        watch
            Receives one line for each NLP and each mesh.

        Returns
        -------
        Solution
            With costates; `statistics.residual` is the largest relative mesh error and `statistics.tried` the
            history.

        Raises
        ------
        InfeasibleError
            If bounds and conditions contradict each other.
        NotConvergedError
            If no feasible trajectory was found, or the accuracy was not reached; the message names the
            conditions that are missed, in SI.
        """
        *_, finest = self.meshes(problem, guess, watch)
        return finest

    def meshes(self, problem: Problem, guess: Solution | None = None, watch: Watch | None = None) -> Iterator[Solution]:
        """The answers of `run` on one mesh after the other, each finer than the last."""
        from perilune.direct.contradictions import check_consistent

        check_consistent(problem)
        yield from _Run(settings=self, problem=problem, watch=watch or silent).answers(guess)

    def near(self, guess: Solution) -> Solution:
        """What lies near a guess for its problem, as `run`; no other start and no search for the least miss."""
        *_, finest = _Run(settings=self, problem=guess.problem, watch=silent, near=True).answers(guess)
        return finest


@dataclass
class _Run:
    """One run: the history grows, everything else is fixed."""

    settings: Pseudospectral
    problem: Problem
    watch: Watch
    near: bool = False
    began: float = field(default_factory=time.perf_counter)
    tried: list[str] = field(default_factory=list)
    history: list[Iteration] = field(default_factory=list)
    iterations: int = 0
    all_missed: bool = False

    def say(self, line: str) -> None:
        """One line for the watcher and for the history."""
        self.tried.append(line)
        self.watch(line)

    def answers(self, guess: Solution | None) -> Iterator[Solution]:
        """First mesh, then refinement until the mesh is accurate enough."""
        from perilune.direct.errors import error_text
        from perilune.direct.mesh import refined
        from perilune.direct.segments import sampled, sampler

        s, problem = self.settings, self.problem
        program, answer = self.first_answer(guess)
        best, missed = None, ""
        for round_number in range(s.refine + 1):
            segments, errors, relative = self.looked_at(program, answer)
            worst = max(float(r.max()) for r in relative)
            self.say(_mesh_line(problem, program, errors, worst, round_number))
            self.history.append(Iteration(number=round_number, residual=worst, step=float("nan"), damping=1.0))
            found = self.solution(program, answer, segments, worst)
            yield found
            if worst <= s.tolerance or not s.refine:
                return
            if best is None or worst < best.statistics.residual:
                best, missed = found, error_text(problem, errors)
            if round_number == s.refine:
                self.fail_mesh(best, missed, f"{s.refine} refinements")
            p = problem.parameters(answer.free_si(problem))
            meshes = tuple(
                refined(phase, mesh, flown, r, s.tolerance, p)
                for phase, mesh, flown, r in zip(problem.phases, program.meshes, segments, relative, strict=True)
            )
            samplers = [sampler(flown) for flown in segments]
            program = self.program(meshes)
            finer = self.attempt(program, answer.free, sampled(program, samplers), f"mesh {round_number + 1}")
            if not finer.converged:
                self.fail_mesh(best, missed, f"{round_number} refinements, as the next was not solved")
            answer = finer

    def looked_at(self, program: Program, answer: Answer) -> tuple[list[list[Segment]], list[Matrix], list[Matrix]]:
        """Segments of an answer, and the mesh errors of each: in SI, and relative."""
        from perilune.direct.errors import mesh_errors, relative_errors
        from perilune.direct.segments import flown_segments

        segments, p = flown_segments(program, answer), self.problem.parameters(answer.free_si(self.problem))
        errors = mesh_errors(self.problem, segments, p, self.settings.tolerance)
        return segments, errors, relative_errors(self.problem, segments, errors)

    def program(self, meshes: tuple[Mesh, ...]) -> Program:
        """The NLP on the given meshes."""
        from perilune.direct.nlp import Program

        return Program(problem=self.problem, scheme=self.settings.scheme, meshes=meshes)

    def first_answer(self, guess: Solution | None) -> tuple[Program, Answer]:
        """Solve on the first mesh from the guess, or from the straight lines.

        Most problems are solved from the first start in a few iterations. For the others it is asked first whether
        there is anything to find: from each start the flight that misses the path and the ends by the least. One that
        misses nothing is the better start. Where all of them miss something, there is nothing to solve.
        """
        from perilune.direct.first_guess import first_guesses
        from perilune.direct.segments import sampled

        s = self.settings
        program = self.program(tuple(Mesh.uniform(s.segments, s.nodes) for _ in self.problem.phases))
        every = ((free, sampled(program, by), name) for free, by, name in first_guesses(self.problem, guess))
        starts = [next(every)]
        first = self.attempt(program, *starts[0], most=BRIEF)
        if first.converged:
            return program, first
        if self.near:
            return self.fail(program, first)
        starts += every
        tries: list[Answer] = [first]
        misses: list[Answer] = []
        vanished: list[Answer] = []
        for free, values, name in starts:
            nearest = self.attempt(program, free, values, f"nearest miss, {name}", nearest=True, most=PATIENT)
            if nearest.converged and nearest.violation > MISSED:
                (vanished if self.vanished(nearest) else misses).append(nearest)
            elif nearest.violation <= MISSED:
                tries.append(self.attempt(program, nearest.free, nearest.phases, "from there"))
                if tries[-1].converged:
                    return program, tries[-1]
        # One start alone may owe its miss to the mesh.
        self.all_missed = CONVINCED <= len(starts) == len(misses) + len(vanished) and guess is None
        if len(misses) >= CONVINCED and len(tries) == 1:
            self.refuse(program, min(misses, key=_violation), len(misses))
        if not misses:
            for start in starts:
                tries.append(self.attempt(program, *start))
                if tries[-1].converged:
                    return program, tries[-1]
        return self.fail(program, min(misses or vanished or tries, key=_violation))

    def attempt(
        self,
        program: Program,
        free: Vector,
        values: tuple[PhaseValues, ...],
        name: str,
        nearest: bool = False,
        most: int | None = None,
    ) -> Answer:
        """Solve one NLP; with `nearest`, hold all but path and ends and miss these by the least."""
        s = self.settings
        iterations = s.iterations if most is None else min(most, s.iterations)
        answer = program.solve(free, values, iterations=iterations, tolerance=s.nlp_tolerance, nearest=nearest)
        self.iterations += answer.iterations
        outcome = "solved" if answer.converged else "not solved"
        self.say(f"{name}: {outcome} in {answer.iterations} iterations")
        return answer

    def vanished(self, answer: Answer) -> bool:
        """Whether a phase has shrunk to nothing: the miss of no flight says nothing of those that have a length."""
        values = answer.free_si(self.problem)
        durations = [f for f in self.problem.free if f.name in self.problem.duration_names]
        return any(values[f.name] < VANISHED * f.typical for f in durations)

    def refuse(self, program: Program, best: Answer, count: int) -> None:
        """InfeasibleError with what the best of so many misses, if that is more than the error of the mesh."""
        from perilune.direct.contradictions import missed_conditions
        from perilune.words.outcome import BEST_MISSES, InfeasibleError

        errors = zip(self.problem.phases, self.looked_at(program, best)[2], strict=True)
        error = max(float(relative[:, : len(phase.states)].max()) for phase, relative in errors)
        self.say(f"the least miss is {best.violation:.2g}, the error of the mesh {error:.1g}")
        if best.violation > error:
            missed = missed_conditions(program, best, MISSED)
            told = [f"{name} is missed by {much}" for name, much in missed]
            raise InfeasibleError(
                f"the best of {count} found misses {missed[0][0]} by {missed[0][1]}",
                got="; ".join(told[:4]),
                expected="every condition met",
                advice="relax the condition named first",
                reason=BEST_MISSES,
                partial=self.partial(best, told),
            )

    def partial(self, answer: Answer, missed: list[str]) -> dict[str, Any]:
        """What a failure keeps; `all_missed` says that every start led to a least miss, if only that of no flight."""
        told = {"missed": missed, "all_missed": self.all_missed, "tried": tuple(self.tried)}
        return told | {"free": answer.free_si(self.problem)}

    def fail(self, program: Program, answer: Answer) -> tuple[Program, Answer]:
        """Not converged, with the conditions that the best trajectory misses."""
        from perilune.direct.contradictions import missed_conditions
        from perilune.words.outcome import NotConvergedError

        missed = [f"{name} is missed by {much}" for name, much in missed_conditions(program, answer, MISSED)]
        raise NotConvergedError(
            "no trajectory was found that meets every condition" if missed else "the optimum was not reached",
            got="; ".join(missed[:4]) or f"feasible after {answer.iterations} iterations, but not yet optimal",
            expected="every condition met",
            advice="relax the condition named first, or give a guess (a solution of a nearby problem)"
            if missed
            else "raise iterations, give a guess, or loosen nlp_tolerance",
            partial=self.partial(answer, missed),
            flight=self.missing(program, answer),
        )

    def fail_mesh(self, best: Solution, missed: str, after: str) -> NoReturn:
        """Refuse an answer whose mesh is not as accurate as asked for; the best is kept."""
        from perilune.words.outcome import NotConvergedError

        jumps = [phase.name for k, phase in enumerate(self.problem.phases) if self.problem.form.chooses(k)]
        cause = "an arc whose control H_u leaves open may need its own phase"
        if jumps:
            cause = (
                f"the dynamics of {', '.join(jumps)} choose (m.where), and no polynomial follows a jump: give each "
                "side a phase of its own, or let the indirect method find where it changes"
            )
        raise NotConvergedError(
            "the mesh did not reach the requested accuracy",
            got=f"relative error {best.statistics.residual:.2g} after {after}; {missed}",
            expected=f"<= {self.settings.tolerance:g}",
            advice=f"raise refine or tolerance; {cause}",
            partial={"tried": tuple(self.tried), "free": dict(best.free), "objective": best.objective},
            flight=best,
        )

    def missing(self, program: Program, answer: Answer) -> Solution:
        """A trajectory that misses conditions, whose multipliers are costates of nothing."""
        with np.errstate(all="ignore"):  # it may lead where the physics is not defined
            segments, _, relative = self.looked_at(program, answer)
            found = self.solution(program, answer, segments, max(float(r.max()) for r in relative))
            return replace(found, trajectories=tuple(replace(flown, costate=None) for flown in found.trajectories))

    def solution(self, program: Program, answer: Answer, segments: list[list[Segment]], worst: float) -> Solution:
        """The answer in SI."""
        from perilune.direct.segments import trajectory

        s, problem = self.settings, self.problem
        objective_scale = problem.objective_size
        multipliers = {
            f"{phase.name}.{condition.name}": float(nu * objective_scale) / problem.size_of(condition)
            for k, phase in enumerate(problem.phases)
            for condition, nu in zip(phase.end_conditions, answer.rows[k, "end"], strict=True)
        }
        return Solution(
            problem=problem,
            method="pseudospectral",
            outcome=Outcome.SOLVED,
            objective=float(answer.objective * objective_scale),
            free=answer.free_si(problem),
            # Interpolation adds a hundredth of the mesh error, so that what is exported is as good as what
            # was solved.
            trajectories=Deferred(
                len(problem.phases),
                lambda: tuple(
                    trajectory(problem, k, flown, 1e-2 * min(worst, s.tolerance)) for k, flown in enumerate(segments)
                ),
            ),
            multipliers=multipliers,
            statistics=Statistics(
                rung=f"{self.settings.scheme} collocation, {sum(m.nodes for m in program.meshes)} nodes",
                tried=tuple(self.tried),
                iterations=self.iterations,
                residual=worst,
                wall_time=time.perf_counter() - self.began,
                history=tuple(self.history),
            ),
        )


def _violation(answer: Answer) -> float:
    return answer.violation


def _mesh_line(problem: Problem, program: Program, errors: list[Matrix], worst: float, number: int) -> str:
    from perilune.direct.errors import error_text

    nodes = sum(mesh.nodes for mesh in program.meshes)
    segments = sum(len(mesh.degrees) for mesh in program.meshes)
    return (
        f"mesh {number}: {nodes} nodes in {segments} segments, relative error {worst:.1e} "
        f"({error_text(problem, errors)})"
    )
