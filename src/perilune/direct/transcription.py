"""Settings of the direct method, and the state of one run: programs solved, their answers simulated and tested."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from perilune.core import (
    Deferred,
    Iteration,
    Matrix,
    Outcome,
    PeriluneError,
    Vector,
    Watch,
    ignore_events,
    require_integers,
    require_number,
    wrong_type_error,
)
from perilune.direct.collocation import Mesh, Scheme, rule
from perilune.problem import Problem, Solution, Statistics

if TYPE_CHECKING:
    from perilune.direct.collocated_solution import Segment
    from perilune.direct.layout import PhaseValues
    from perilune.direct.nlp import ProgramSolution, TranscribedProgram
    from perilune.problem import Trajectory


# Of one segment: beyond, its dense blocks make a program slow that many short segments make fast.
_MOST_NODES = 200


@dataclass(frozen=True, kw_only=True)
class Transcription:
    """Settings of a direct run; `perilune.methods.direct.pseudospectral.Pseudospectral` says what each means."""

    scheme: Scheme = "gauss"
    nodes: int = 20
    segments: int = 1
    tolerance: float = 1e-6
    refine: int = 8
    iterations: int = 300
    nlp_tolerance: float = 1e-10
    polish: bool = True

    def __post_init__(self) -> None:
        require_integers(self, nodes=1, segments=1, refine=0, iterations=1)
        if not isinstance(self.scheme, str):
            raise wrong_type_error(self.scheme, "'gauss' or 'radau'", "a collocation scheme")
        if self.nodes > _MOST_NODES:
            raise PeriluneError(
                "a segment has too many collocation points", got=str(self.nodes), expected=f"<= {_MOST_NODES}",
                advice="refinement cuts segments where a mesh is not accurate enough",
            )  # fmt: skip
        rule(self.scheme, self.nodes)
        for name in ("tolerance", "nlp_tolerance"):
            require_number(getattr(self, name), name)
            if not 0 < getattr(self, name) < 1:
                raise PeriluneError(
                    f"{name} must lie between 0 and 1", got=str(getattr(self, name)),
                    expected="more than 0 and less than 1",
                )  # fmt: skip
        if not isinstance(self.polish, bool):
            raise PeriluneError("polish must be True or False", got=repr(self.polish)[:60], expected="True or False")


class Look(NamedTuple):
    """Segments of an answer, and the mesh errors of each: in SI, and relative; phase by phase."""

    segments: list[list[Segment]]
    errors: list[Matrix]
    relative: list[Matrix]

    @property
    def worst(self) -> float:
        """The largest relative error."""
        return max(float(relative.max()) for relative in self.relative)


@dataclass(kw_only=True)
class Run:
    """One run: the history grows, everything else is fixed."""

    settings: Transcription
    problem: Problem
    watch: Watch = ignore_events
    began: float = field(default_factory=time.perf_counter)
    tried: list[str] = field(default_factory=list)
    history: list[Iteration] = field(default_factory=list)
    iterations: int = 0
    _look: tuple[ProgramSolution, Look] | None = None

    def say(self, line: str) -> None:
        """Report one line to the watcher and keep it in the history."""
        self.tried.append(line)
        self.watch(line)

    def program(self, meshes: tuple[Mesh, ...]) -> TranscribedProgram:
        """Return the program on the given meshes."""
        from perilune.direct.nlp import TranscribedProgram

        return TranscribedProgram(problem=self.problem, scheme=self.settings.scheme, meshes=meshes)

    def attempt(
        self,
        program: TranscribedProgram,
        free: Vector,
        values: tuple[PhaseValues, ...],
        name: str,
        nearest: bool = False,
        most: int | None = None,
        close: bool = False,
    ) -> ProgramSolution:
        """Solve one NLP, from `close` by or anywhere; with `nearest`, path and ends are missed by the least.

        Parameters
        ----------
        program
            The transcribed problem.
        free
            Initial values of the free parameters, canonical, in the order of the problem.
        values
            Initial states and controls at the nodes, canonical, phase by phase.
        name
            Name of the start, in the lines that are reported.
        nearest
            True to minimise the violation of path and end conditions in place of J.
        most
            Most iterations, up to those of the settings; None for these.
        close
            True if the initial values lie close to the answer.
        """
        s = self.settings
        self.watch(f"direct method: {name}")
        iterations = s.iterations if most is None else min(most, s.iterations)
        answer = program.solve(
            free, values, iterations=iterations, tolerance=s.nlp_tolerance, nearest=nearest, close=close
        )
        self.iterations += answer.iterations
        outcome = "solved" if answer.converged else "not solved"
        self.say(f"{name}: {outcome} in {answer.iterations} iterations")
        return answer

    def looked_at(self, program: TranscribedProgram, answer: ProgramSolution) -> Look:
        """Return an answer as a flight; it is simulated once.

        Parameters
        ----------
        program
            The transcribed problem.
        answer
            Its solution, canonical.
        """
        if self._look is None or self._look[0] is not answer:
            self._look = answer, self._looked_at(program, answer)
        return self._look[1]

    def _looked_at(self, program: TranscribedProgram, answer: ProgramSolution) -> Look:
        from perilune.direct.collocated_solution import flown_segments
        from perilune.direct.mesh_error import mesh_errors, relative_errors

        segments, p = flown_segments(program, answer), self.problem.parameters(answer.free_si(self.problem))
        errors = mesh_errors(self.problem, segments, p, self.settings.tolerance)
        return Look(segments, errors, relative_errors(self.problem, segments, errors))

    def solution(self, program: TranscribedProgram, answer: ProgramSolution, look: Look) -> Solution:
        """Return the answer in SI.

        Parameters
        ----------
        program
            The transcribed problem.
        answer
            Its solution, canonical.
        look
            The same as segments with their mesh errors, of `looked_at`.
        """
        from perilune.direct.collocated_solution import interpolate_segments

        problem, worst = self.problem, look.worst
        # Interpolation adds a hundredth of the mesh error, so that what is exported is as good as what was solved.
        fine = 1e-2 * min(worst, self.settings.tolerance)
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
            trajectories=Deferred(
                len(problem.phases),
                lambda: tuple(interpolate_segments(problem, k, flown, fine) for k, flown in enumerate(look.segments)),
            ),
            multipliers=multipliers,
            statistics=Statistics(
                initialization=f"{self.settings.scheme} collocation, {sum(m.nodes for m in program.meshes)} nodes",
                attempts=tuple(self.tried),
                iterations=self.iterations,
                residual=worst,
                wall_time=time.perf_counter() - self.began,
                history=tuple(self.history),
            ),
        )

    def missing(self, program: TranscribedProgram, answer: ProgramSolution) -> Solution:
        """Return a trajectory that misses conditions, whose multipliers are costates of nothing.

        Parameters
        ----------
        program
            The transcribed problem.
        answer
            The trajectory, canonical, as far as its NLP came.
        """

        def made() -> tuple[Trajectory, ...]:
            with np.errstate(all="ignore"):
                return tuple(replace(flown, costate=None) for flown in found.trajectories)

        with np.errstate(all="ignore"):  # it may lead where the physics is not defined
            found = self.solution(program, answer, self.looked_at(program, answer))
        return replace(found, trajectories=Deferred(len(self.problem.phases), made))
