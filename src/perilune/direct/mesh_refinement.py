"""Refinement of meshes by simulation, until one is accurate enough or the next gains no more."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NoReturn

from perilune.core import Iteration, NotConvergedError
from perilune.direct.initialization import FirstMesh
from perilune.direct.transcription import Look, Run
from perilune.problem import Problem, Solution

if TYPE_CHECKING:
    from perilune.direct.nlp import ProgramSolution, TranscribedProgram

# Refinements in a row that do not halve the least error so far, before no more is expected of them.
STALLED = 3


class MeshRefinement(Run):
    """A run with all its meshes."""

    def answers(self, guess: Solution | None, *, near: bool = False, close: bool = False) -> Iterator[Solution]:
        """Yield the first mesh, then refinement until the mesh is accurate enough or no longer gains.

        Parameters
        ----------
        guess
            Trajectory to start from; None to start without one.
        near
            True for no other start than the guess, and no search for the least violation.
        close
            True if the guess lies close to the answer: the search then does not leave bounds that it lies next to.

        Raises
        ------
        NotConvergedError
            If no first mesh is solved, or the last mesh allowed is not accurate enough.
        """
        s, problem = self.settings, self.problem
        if not near:
            from perilune.direct.inconsistent_conditions import check_consistent

            check_consistent(problem)
        program, answer = FirstMesh(self, guess, near=near, close=close).answer()
        best, gained = None, 0
        for number in range(s.refine + 1):
            look = self.looked_at(program, answer)
            self.say(_mesh_line(problem, program, look, number))
            self.history.append(Iteration(number=number, residual=look.worst, step=float("nan"), damping=1.0))
            found = self.solution(program, answer, look)
            yield found
            if look.worst <= s.tolerance or not s.refine:
                return
            if best is None or look.worst < 0.5 * best[1].worst:
                gained = number
            if best is None or look.worst < best[1].worst:
                best = found, look
            if number == s.refine:
                self.fail_mesh(*best, f"{s.refine} refinements")
            if number - gained == STALLED:
                self.fail_mesh(*best, f"{number} refinements, the last {STALLED} of which gained little")
            program, answer = self.finer(program, answer, look, f"mesh {number + 1}")
            if not answer.converged:
                self.fail_mesh(*best, f"{number} refinements, because the next was not solved")

    def finer(
        self, program: TranscribedProgram, answer: ProgramSolution, look: Look, name: str
    ) -> tuple[TranscribedProgram, ProgramSolution]:
        """Return the same on a mesh that is better where this one is not good enough.

        Parameters
        ----------
        program
            The problem transcribed on the mesh so far.
        answer
            Its solution, canonical.
        look
            The same as segments with their mesh errors.
        name
            Name of the new mesh, in the lines that are reported.
        """
        from perilune.direct.collocated_solution import sample_guess, sampler
        from perilune.direct.mesh import refine_mesh

        p = self.problem.parameters(answer.free_si(self.problem))
        meshes = tuple(
            refine_mesh(phase, mesh, flown, r, self.settings.tolerance, p)
            for phase, mesh, flown, r in zip(
                self.problem.phases, program.meshes, look.segments, look.relative, strict=True
            )
        )
        program = self.program(meshes)
        first = sample_guess(program, [sampler(flown) for flown in look.segments])
        return program, self.attempt(program, answer.free, first, name)

    def fail_mesh(self, best: Solution, look: Look, after: str) -> NoReturn:
        """Refuse an answer whose mesh is not as accurate as asked for; the best is kept.

        Parameters
        ----------
        best
            Solution on the most accurate mesh.
        look
            Its segments with their mesh errors.
        after
            What was tried, for the message.

        Raises
        ------
        NotConvergedError
            Always.
        """
        from perilune.direct.mesh_error import error_text

        jumps = [phase.name for k, phase in enumerate(self.problem.phases) if self.problem.form.chooses(k)]
        cause = "an arc whose control is not determined by H_u may need its own phase"
        if jumps:
            cause = (
                f"the dynamics of {', '.join(jumps)} switch (xp.where), and no polynomial approximates a jump: give"
                f" each side its own phase, or let the indirect method find the switch"
            )
        raise NotConvergedError(
            "the mesh did not reach the requested accuracy",
            got=f"relative error {look.worst:.2g} after {after}; {error_text(self.problem, look.errors)}",
            expected=f"<= {self.settings.tolerance:g}",
            advice=f"raise refine or tolerance; {cause}",
            partial={"attempts": tuple(self.tried), "free": dict(best.free), "objective": best.objective},
            flight=best,
        )


def _mesh_line(problem: Problem, program: TranscribedProgram, look: Look, number: int) -> str:
    from perilune.direct.mesh_error import error_text

    nodes = sum(mesh.nodes for mesh in program.meshes)
    segments = sum(len(mesh.degrees) for mesh in program.meshes)
    return (
        f"mesh {number}: {nodes} nodes in {segments} segments, relative error {look.worst:.1e} "
        f"({error_text(problem, look.errors)})"
    )
