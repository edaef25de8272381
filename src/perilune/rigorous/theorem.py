"""The theorem: what is proved of a solution, by enclosures alone, and what is not."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from flint import arb, ctx

from perilune.problem.solution import Solution
from perilune.rigorous.boundary import BoundaryProblem, boundary_problem
from perilune.rigorous.flow import NotEnclosed
from perilune.rigorous.guess import pieces_of, unknowns_of
from perilune.rigorous.limits import Limits, Statement
from perilune.rigorous.reading import Unsupported
from perilune.rigorous.root import NotProved, Refined, Root, Settings, prove_root, refine

# Tried in order: longer steps of high order first, then shorter ones.
EFFORTS = (Settings(), Settings(tolerance=1e-62, bits=256), Settings(tolerance=1e-80, bits=320))


@dataclass(frozen=True, kw_only=True, eq=False)
class Theorem:
    """What was proved.

    Attributes
    ----------
    boundary, root, refined, settings
        The equations, their root and how it was enclosed; None where there is none.
    statements
        Everything that was to be proved beside the root.
    distance
        From the published answer to the root: the largest over the unknowns, beside their size.
    unsaid
        Why there is no theorem, or "".
    seconds
        How long it took.
    """

    boundary: BoundaryProblem | None = None
    root: Root | None = None
    refined: Refined | None = None
    settings: Settings | None = None
    statements: tuple[Statement, ...] = ()
    distance: float = math.nan
    unsaid: str = ""
    seconds: float = math.nan

    @property
    def proved(self) -> bool:
        """Whether there is an extremal that keeps every limit."""
        return self.root is not None and all(statement.proved for statement in self.statements)


def theorem_of(solution: Solution, tell: Callable[[str], None]) -> Theorem:
    """Prove what can be proved of a solution.

    Parameters
    ----------
    solution
        With costates; it is where the search begins, and nothing in it is trusted.
    tell
        Is told of every part.
    """
    began = time.monotonic()
    try:
        pieces, lengths = pieces_of(solution)
        boundary = boundary_problem(solution.problem, pieces)
        guess = unknowns_of(solution, boundary, lengths)
    except Unsupported as error:
        return Theorem(unsaid=error.what, seconds=time.monotonic() - began)
    unsaid = ""
    for settings in EFFORTS:
        with ctx.workprec(settings.bits):
            try:
                refined = refine(boundary, guess, settings, tell)
                root = prove_root(boundary, refined, settings, tell)
            except (NotProved, NotEnclosed) as error:
                unsaid = str(error).replace("\n", ";")
                tell(unsaid)
                continue
            try:
                statements = tuple(Limits(boundary, root.flight.steps, root.box).all())
            except Unsupported as error:
                return Theorem(unsaid=error.what, seconds=time.monotonic() - began)
            far = max(
                float((a - b).abs_upper()) / max(float(b.abs_upper()), 1e-9 * float(max(guess, key=abs).abs_upper()))
                for a, b in zip(root.y, guess, strict=True)
            )
            return Theorem(boundary=boundary, root=root, refined=refined, settings=settings, statements=statements,
                           distance=far, seconds=time.monotonic() - began)  # fmt: skip
    return Theorem(boundary=boundary, unsaid=unsaid, seconds=time.monotonic() - began)


def objective(theorem: Theorem) -> arb:
    """J of the proved extremal."""
    assert theorem.boundary is not None and theorem.root is not None
    return theorem.boundary.objective.values(theorem.root.y, theorem.root.flight.ends[-1])[0]
