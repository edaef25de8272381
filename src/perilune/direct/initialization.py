"""Initialization of a direct run: its first solved program, from one of several starts, or the reason for none.

Most problems are solved from the first start in a few iterations. For the others it is asked first whether there is
anything to find: from each start the flight that misses the path and the ends by the least. One that misses nothing is
the better start. Where all of them miss something, there is nothing to solve.

A flight that goes round a body is no straight line, and one that does so several times is more than a few nodes can
follow. Where the first start leads nowhere the flight under the same controls is a start as well, on a mesh that has
segments for each swing; where it winds it is the next one, also if the first led to an answer that is none between the
nodes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

from perilune.core import Vector
from perilune.direct.collocation import Mesh
from perilune.direct.transcription import Run
from perilune.problem import Solution

if TYPE_CHECKING:
    from perilune.direct.collocated_solution import Sampler
    from perilune.direct.layout import PhaseValues
    from perilune.direct.nlp import ProgramSolution, TranscribedProgram

# Most iterations of the first attempt and of a search for the least miss; what ends well takes 10 to 60 and 10 to 130.
BRIEF, PATIENT = 60, 150
# Starts that all end at a least miss that is not zero, before nothing more is tried.
CONVINCED = 2
# Relative difference of least misses that are one and the same.
SAME = 1e-5
# Values on a mesh beyond which a search for the least miss takes a second, so that one more has to promise something.
LARGE = 1000
# Iterations of all further searches together on such a mesh, once a start has ended at a miss.
FURTHER = 200
# Of its typical duration: what a phase has left that has shrunk to nothing.
VANISHED = 1e-3
# A condition violated by less, in canonical units, is satisfied.
MISSED = 1e-7
# Relative error of a mesh beyond which its answer is no flight.
ROUGHEST = 0.05


class Start(NamedTuple):
    """A program, first values of its unknowns in canonical units, what they are called, and whether its miss counts."""

    program: TranscribedProgram
    free: Vector
    values: tuple[PhaseValues, ...]
    name: str
    counts: bool = True

    @property
    def large(self) -> bool:
        """Return True if a search on its mesh takes long."""
        return sum(values.state.size + values.control.size for values in self.values) > LARGE


class LeastMisses(NamedTuple):
    """Programs with their least misses, those where a phase has vanished, flights that miss nothing, sizes of misses.

    `agreed` is True if the last of these was there before.
    """

    misses: list[tuple[TranscribedProgram, ProgramSolution]]
    vanished: list[tuple[TranscribedProgram, ProgramSolution]]
    flights: list[tuple[TranscribedProgram, ProgramSolution]]
    known: list[float]
    agreed: bool = False


class FirstMesh:
    """The first answer of one run.

    Parameters
    ----------
    run
        Whose.
    guess
        To start from; straight lines and flights without.
    near, close
        Only from there; and as one that lies close to the answer.
    """

    def __init__(self, run: Run, guess: Solution | None, *, near: bool = False, close: bool = False) -> None:
        self.run, self.problem, self.guess, self.near, self.close = run, run.problem, guess, near, close
        self.all_missed = self.settled = False
        self.first: tuple[Vector, list[Sampler]] | None = None  # what the first straight line is, once it was drawn

    def answer(self) -> tuple[TranscribedProgram, ProgramSolution]:
        """Return the first program that was solved, with its solution."""
        every = self.starts()
        begin = next(every)
        first = self.attempt(begin, BRIEF, close=self.close)
        if self.close and not first.converged:
            first = self.attempt(begin, BRIEF)
        if first.converged and (self.guess is not None or not self.rough(begin.program, first)):
            return begin.program, first
        if self.near:
            self.fail(begin.program, first)
        flown = self.simulated_start()
        winding = flown is not None and flown.counts
        if first.converged:
            better = self.from_least_miss(flown)[1] if flown is not None and winding else None
            return (begin.program, first) if flown is None or better is None else (flown.program, better)
        starts = [begin] if flown is None else [flown, begin] if winding else [begin, flown]
        return self.any_answer([*starts, *every], begin, first)

    def any_answer(
        self, starts: list[Start], begin: Start, first: ProgramSolution
    ) -> tuple[TranscribedProgram, ProgramSolution]:
        """Return the answer from one of the starts, of which the first attempt has failed.

        Parameters
        ----------
        starts
            All starts, in the order in which they are tried.
        begin, first
            That of the first attempt, and how it failed.

        Raises
        ------
        NotConvergedError
            If no start leads to an answer, with the conditions that the best trajectory misses.
        """
        tries = [(begin.program, first)]
        missed = self.least_misses(starts, tries)
        if tries[-1][1].converged:
            return tries[-1]
        misses, vanished = missed.misses, missed.vanished
        if len(misses) + missed.agreed >= CONVINCED and misses and len(tries) == 1:
            self.raise_least_violation(*min(misses, key=_violation), max(len(misses), CONVINCED))
        tries += self.in_short_steps(missed.flights)
        if tries[-1][1].converged:
            return tries[-1]
        if not misses and not missed.agreed:
            # A start that leads nowhere spends all it is given: what one of them may take, all of them share.
            share = max(1, self.run.settings.iterations // len(starts))
            for start in starts:
                if start is begin and share <= BRIEF:
                    continue  # the first attempt again
                tries.append((start.program, self.attempt(start, share)))
                if tries[-1][1].converged:
                    return tries[-1]
        self.fail(*min(misses or vanished or tries, key=_violation))

    def least_misses(self, starts: list[Start], tries: list[tuple[TranscribedProgram, ProgramSolution]]) -> LeastMisses:
        """Return the least misses near the starts, up to the first answer.

        On a large mesh no further than to a miss that two of them lead to.

        Parameters
        ----------
        starts
            In the order in which they are tried.
        tries
            Receives what flights that miss nothing lead to; an answer is its last.
        """
        found, counted, left = LeastMisses([], [], [], []), 0, FURTHER
        for start in starts:
            nearest, answer = self.from_least_miss(start)
            left -= nearest.iterations if found.known else 0
            counted += start.counts
            if answer is not None:
                tries.append((start.program, answer))
                if answer.converged:
                    return found
                found.flights.append((start.program, nearest))
            elif nearest.converged and nearest.violation > MISSED:
                if start.counts:
                    (found.vanished if self.vanished(nearest) else found.misses).append((start.program, nearest))
                if len(tries) == 1 and start.large and self.is_missed_again(start.program, nearest, found.known):
                    found = found._replace(agreed=True)
                found.known.append(nearest.violation)
            if found.agreed or (left <= 0 and start.large):
                break
        self.settled = bool(found.misses)
        # A single start may owe its miss to the mesh.
        enough = found.agreed or (counted >= CONVINCED and counted == sum(start.counts for start in starts))
        self.all_missed = enough and counted == len(found.misses + found.vanished) and self.guess is None
        return found

    def attempt(self, start: Start, most: int | None = None, *, close: bool = False) -> ProgramSolution:
        """Solve a program from its start.

        Parameters
        ----------
        start
            Program and initial values of its unknowns, canonical.
        most
            Most iterations of the NLP, up to those of the settings; None for these.
        close
            True if the start lies close to the answer: the search then does not leave bounds that it lies next to.
        """
        return self.run.attempt(start.program, start.free, start.values, start.name, most=most, close=close)

    def from_least_miss(self, start: Start) -> tuple[ProgramSolution, ProgramSolution | None]:
        """Return the flight near a start that misses least, and what is reached from there if it misses nothing."""
        program, free, values, name, _ = start
        nearest = self.run.attempt(program, free, values, f"nearest miss, {name}", nearest=True, most=PATIENT)
        if nearest.violation > MISSED:
            return nearest, None
        found = self.run.attempt(program, nearest.free, nearest.phases, "from there")
        if not found.converged:
            # First steps as long as the adaptive barrier allows may lose the flight, as air is far from linear: with
            # little barrier it is kept.
            name = "from there, with a small barrier"
            found = self.run.attempt(program, nearest.free, nearest.phases, name, most=BRIEF, close=True)
        return nearest, found

    def in_short_steps(
        self, flights: list[tuple[TranscribedProgram, ProgramSolution]]
    ) -> Iterator[tuple[TranscribedProgram, ProgramSolution]]:
        """Yield what J is lowered to with little barrier from flights that miss nothing, up to the first optimum.

        The last resort of what is not found in a few steps: a heat load takes two hundred.
        """
        for program, nearest in flights:
            found = self.run.attempt(program, nearest.free, nearest.phases, "from there, in short steps", close=True)
            yield program, found
            if found.converged:
                return

    def starts(self) -> Iterator[Start]:
        """Yield the starts: the guess, or straight lines."""
        from perilune.direct.collocated_solution import sample_guess
        from perilune.direct.first_guess import first_guesses

        s = self.run.settings
        program = self.run.program(tuple(Mesh.uniform(s.segments, s.nodes) for _ in self.problem.phases))
        for free, by, name in first_guesses(self.problem, self.guess):
            self.first = self.first or (free, by)
            yield Start(program, free, sample_guess(program, by), name)

    def simulated_start(self) -> Start | None:
        """Return a start flown under the controls of the first straight line; None where it cannot be.

        Its miss counts where it winds, as no straight line does. Else it is one more way to an answer, on a mesh that
        may be too coarse for more.
        """
        from perilune.direct.collocated_solution import sample_guess
        from perilune.direct.propagated_guess import NODES, fitting_segments, simulate_guess, winds_repeatedly

        if self.guess is not None or self.first is None:
            return None
        s, (free, lines) = self.run.settings, self.first
        flown = simulate_guess(self.problem, free, lines)
        if flown is None:
            return None
        # Without refinement the mesh is the user's choice.
        counts = fitting_segments(flown)
        meshes = [Mesh.uniform(count, NODES) if s.refine else Mesh.uniform(s.segments, s.nodes) for count in counts]
        program = self.run.program(tuple(meshes))
        return Start(
            program, free, sample_guess(program, flown), "integrated under its controls", winds_repeatedly(flown)
        )

    def rough(self, program: TranscribedProgram, answer: ProgramSolution) -> bool:
        """Return True if the flight between the nodes is another one.

        Parameters
        ----------
        program
            The transcribed problem.
        answer
            Its solution, whose nodes are compared with a simulation under the same control.
        """
        return self.run.looked_at(program, answer).worst > ROUGHEST

    def error_of_states(self, program: TranscribedProgram, answer: ProgramSolution) -> float:
        """Return the largest relative error of the mesh in a state.

        Parameters
        ----------
        program, answer
            Program, and its solution.
        """
        errors = zip(self.problem.phases, self.run.looked_at(program, answer).relative, strict=True)
        return max(float(relative[:, : len(phase.states)].max()) for phase, relative in errors)

    def is_missed_again(self, program: TranscribedProgram, nearest: ProgramSolution, known: list[float]) -> bool:
        """Return True if another start led to the same least miss, and no finer mesh would make up for it.

        Further starts seldom lead elsewhere then.

        Parameters
        ----------
        program, nearest
            Program with its least miss.
        known
            Sizes of the least misses before it, canonical.
        """
        again = any(abs(nearest.violation - other) <= SAME * other for other in known)
        return again and nearest.violation > self.error_of_states(program, nearest)

    def vanished(self, answer: ProgramSolution) -> bool:
        """Return True if a phase has shrunk to nothing: then its miss says nothing of flights with a length."""
        values = answer.free_si(self.problem)
        durations = [f for f in self.problem.free if f.name in self.problem.duration_names]
        return any(values[f.name] < VANISHED * f.guess for f in durations)

    def raise_least_violation(self, program: TranscribedProgram, best: ProgramSolution, count: int) -> None:
        """Raise not converged with what the best of so many misses, if that is more than the error of the mesh.

        Each is the least only of its surroundings, so no number of them shows that nothing flies.

        Parameters
        ----------
        program
            The transcribed problem.
        best
            The least violation found near any start, canonical.
        count
            Number of starts whose least violation is not zero, for the message.

        Raises
        ------
        NotConvergedError
            If the violation is larger than the error of the mesh.
        """
        from perilune.core import NotConvergedError
        from perilune.direct.inconsistent_conditions import missed_conditions

        error = self.error_of_states(program, best)
        self.run.say(f"the least violation is {best.violation:.2g}, the error of the mesh {error:.1g}")
        if best.violation > error:
            missed = missed_conditions(program, best, MISSED)
            told = [f"{name} is missed by {much}" for name, much in missed]
            raise NotConvergedError(
                f"the best of {count} found violates {missed[0][0]} by {missed[0][1]}",
                got="; ".join(told[:4]),
                expected="every condition met",
                advice="relax the first condition named, or give a guess (a solution of a nearby problem)",
                partial=self.partial(best, told) | {"least_miss": float(best.violation)},
                flight=self.run.missing(program, best),
            )

    def partial(self, answer: ProgramSolution, missed: list[str]) -> dict[str, Any]:
        """Return what a failure keeps; `all_infeasible` is True if every start led to a least miss.

        `least_miss` is its size in canonical units, where it is more than the error of the mesh; `converged` whether
        any start led to one that is a flight.

        Parameters
        ----------
        answer
            The best trajectory, canonical; its free parameters are returned in SI.
        missed
            A sentence for each condition that it misses.
        """
        told = {
            "violations": missed,
            "all_infeasible": self.all_missed,
            "converged": self.settled,
            "attempts": tuple(self.run.tried),
        }
        return told | {"free": answer.free_si(self.problem)}

    def fail(self, program: TranscribedProgram, answer: ProgramSolution) -> NoReturn:
        """Raise not converged with the conditions that the best trajectory misses.

        Parameters
        ----------
        program
            The transcribed problem.
        answer
            The best trajectory that was found for it, canonical.

        Raises
        ------
        NotConvergedError
            Always.
        """
        from perilune.core import NotConvergedError
        from perilune.direct.inconsistent_conditions import missed_conditions

        missed = [f"{name} is missed by {much}" for name, much in missed_conditions(program, answer, MISSED)]
        raise NotConvergedError(
            "no trajectory was found that meets every condition" if missed else "the optimum was not reached",
            got="; ".join(missed[:4]) or f"feasible after {answer.iterations} iterations, but not yet optimal",
            expected="every condition met",
            advice="relax the first condition named, or give a guess (a solution of a nearby problem)"
            if missed
            else "raise iterations, give a guess, or loosen nlp_tolerance",
            partial=self.partial(answer, missed),
            flight=None if self.near else self.run.missing(program, answer),
        )


def _violation(found: tuple[TranscribedProgram, ProgramSolution]) -> float:
    return found[1].violation
