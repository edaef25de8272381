"""Theorem about a solution: what is proved of it, by enclosures only, and what is not."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from flint import ctx

from perilune.problem import Solution
from perilune.rigorous.boundary_equations import boundary_problem
from perilune.rigorous.boundary_value_problem import BoundaryProblem
from perilune.rigorous.candidate import sides_of, suggested_pieces, unknowns_of
from perilune.rigorous.enclosure_step import NotEnclosed
from perilune.rigorous.exact_tape import Unsupported
from perilune.rigorous.inequalities import FlightLimits, Statement
from perilune.rigorous.krawczyk import (
    EnclosedRoot,
    NotProved,
    ProofEffort,
    RefinedRoot,
    enlarge_uniqueness_box,
    prove_root,
    refine_root,
)
from perilune.rigorous.second_order import OptimumStatement, prove_local_optimum
from perilune.rigorous.taylor import Ball

# Tried in order: shorter steps and more bits where the first are not enclosed.
EFFORTS = (ProofEffort(), ProofEffort(tolerance=1e-78, bits=256), ProofEffort(tolerance=1e-94, bits=320))
_NEARLY_ZERO = 1e-6  # of the largest unknown


@dataclass(frozen=True, kw_only=True, eq=False)
class ProvedExtremal:
    """A root that is proved, with everything that was to be proved of it.

    Attributes
    ----------
    boundary, refined, settings
        The equations, and how their root was found.
    root, unique
        The root in a small box, whose flight encloses it; and in a large one, in which there is no other.
    objective
        J.
    statements
        That everything limited is strictly inside.
    optimum
        That it is a strict local optimum.
    distance
        From the answer to the root: the largest over the unknowns, relative to their size.
    reached
        Whether the answer lies in the large box.
    """

    boundary: BoundaryProblem
    refined: RefinedRoot
    settings: ProofEffort
    root: EnclosedRoot
    unique: EnclosedRoot
    objective: Ball
    statements: tuple[Statement, ...]
    optimum: OptimumStatement
    distance: float
    reached: bool

    @property
    def missing(self) -> tuple[Statement, ...]:
        """Return the statements that are not proved."""
        return tuple(statement for statement in self.statements if not statement.proved)


@dataclass(frozen=True, kw_only=True, eq=False)
class Attempt:
    """Result of an attempt: a proved root, or why there is none; and its duration [s]."""

    proved: ProvedExtremal | None
    unsaid: str
    seconds: float


def attempt_proof(solution: Solution, tell: Callable[[str], None], efforts: Sequence[ProofEffort] = EFFORTS) -> Attempt:
    """Prove what can be proved of a solution.

    Parameters
    ----------
    solution
        With costates; it is where the search begins, and nothing in it is trusted.
    tell
        Called with a line for every part.
    efforts
        Tried in order, until one proves a root.
    """
    began, unsaid = time.monotonic(), ""
    try:
        pieces, lengths = suggested_pieces(solution)
        boundary = boundary_problem(solution.problem, pieces, sides_of(solution))
        guess = unknowns_of(solution, boundary, lengths)
        for settings in efforts:
            with ctx.workprec(settings.bits):
                try:
                    found = _prove_extremal(boundary, guess, settings, tell)
                    return Attempt(proved=found, unsaid="", seconds=time.monotonic() - began)
                except (NotProved, NotEnclosed) as error:
                    unsaid = error.what + (f": {error.got}" if error.got else "")
                    tell(unsaid)
    except Unsupported as error:
        unsaid = error.what
    except (ArithmeticError, ValueError) as error:  # of FLINT, where a number has no value
        unsaid = f"ball arithmetic has no value somewhere ({error})"
    return Attempt(proved=None, unsaid=unsaid, seconds=time.monotonic() - began)


def _prove_extremal(
    boundary: BoundaryProblem, guess: Sequence[Ball], settings: ProofEffort, tell: Callable[[str], None]
) -> ProvedExtremal:
    refined = refine_root(boundary, guess, settings, tell)
    root = prove_root(boundary, refined, settings, tell)
    distance = _distance(boundary, root, guess)
    large = enlarge_uniqueness_box(boundary, refined, root, settings, tell)
    tell("signs along the flight")
    statements = tuple(FlightLimits(boundary, root).all())
    optimum = prove_local_optimum(boundary, root, settings.order, tell)
    known = [b for b, value in zip(large.box, guess, strict=True) if not b.contains(value)]
    return ProvedExtremal(
        boundary=boundary, refined=refined, settings=settings, root=root, unique=large,
        objective=boundary.objective.values(root.y, root.flight.ends[-1])[0],
        statements=statements, optimum=optimum, distance=distance, reached=not known,
    )  # fmt: skip


def _distance(boundary: BoundaryProblem, root: EnclosedRoot, guess: Sequence[Ball]) -> float:
    """Return the distance from the guess, without costates of constant states, which no solution gives."""
    told = [i for i in range(len(guess)) if i not in boundary.unguessed]
    least = _NEARLY_ZERO * max(float(guess[i].abs_upper()) for i in told)
    far = [float((root.y[i] - guess[i]).abs_upper()) / max(float(guess[i].abs_upper()), least) for i in told]
    return max(far, default=math.nan)
