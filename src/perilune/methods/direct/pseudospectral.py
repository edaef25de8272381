"""Direct method: collocate, solve the NLP, measure the mesh by simulation, refine it, map the covectors.

Peng, Li, Shen, Tang 2012, (5)-(16); Garg et al. 2010 for Radau. From no guess the first mesh holds a straight
line from the start to `Phase.end_guess`, under the control that fits the line best
(`perilune.direct.initialization`).

The answer is a local minimum of the transcribed problem. It carries the costates of the covector mapping, so
that it is checked by the same conditions as an answer of the indirect method, and starts that method.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from perilune.core import Watch, check_call, ignore_events, renamed_keywords
from perilune.direct import MeshRefinement, Transcription
from perilune.problem import Problem, Solution


@check_call
@dataclass(frozen=True, kw_only=True)
class Pseudospectral(Transcription):
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
        (`perilune.methods.polish`); `run` itself never does.
    """

    @renamed_keywords(watch="callback")
    def run(self, problem: Problem, guess: Solution | None = None, callback: Watch | None = None) -> Solution:
        """Solve the problem.

        Parameters
        ----------
        problem
            Any problem.
        guess
            A solution of any method for the same phases; None starts from a straight line.
        callback
            Receives one line for each NLP and each mesh.

        Returns
        -------
        Solution
            With costates; `statistics.residual` is the largest relative mesh error and `statistics.attempts` the
            history.

        Raises
        ------
        InfeasibleError
            If bounds and conditions contradict each other.
        NotConvergedError
            If no feasible trajectory was found, or the accuracy was not reached; the message names the
            conditions that are missed, in SI.
        """
        *_, finest = self.meshes(problem, guess, callback)
        return finest

    def meshes(self, problem: Problem, guess: Solution | None = None, watch: Watch | None = None) -> Iterator[Solution]:
        """Yield the answers of `run` on one mesh after the other, each finer than the last.

        Parameters
        ----------
        problem
            The problem to transcribe.
        guess
            Trajectory to start from, of this problem or of one with the same phases; None to start without one.
        watch
            Called with each iteration and with lines of text; None for silence.

        Raises
        ------
        InfeasibleError
            If two conditions contradict each other.
        NotConvergedError
            If the NLP of a mesh is not solved.
        """
        yield from MeshRefinement(settings=self, problem=problem, watch=watch or ignore_events).answers(guess)

    def near(self, guess: Solution, watch: Watch | None = None, *, close: bool = False) -> Solution:
        """Solve near a guess for its problem, as `run`; no other start and no search for the least miss.

        With `close` the search does not leave where the guess lies next to bounds, as one does from anywhere.

        Parameters
        ----------
        guess
            Trajectory to start from; its problem is the one solved.
        watch
            Called with each iteration and with lines of text; None for silence.
        close
            True if the guess lies close to the answer.

        Raises
        ------
        NotConvergedError
            If the NLP is not solved from the guess.
        """
        *_, finest = MeshRefinement(settings=self, problem=guess.problem, watch=watch or ignore_events).answers(
            guess, near=True, close=close
        )
        return finest
