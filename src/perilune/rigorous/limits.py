"""Everything that a problem limits, enclosed along the whole flight of a proved root: strictly inside, or named.

These are the conditions of the path, the bounds of states and controls, the sign of dH/du where a control is on its
bound, the convexity of H where it is between them, the ranges of free parameters and the lengths of arcs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from perilune.problem.controls import Direction
from perilune.rigorous.boundary import BoundaryProblem
from perilune.rigorous.equations import ArcScalar
from perilune.rigorous.given import exact_value
from perilune.rigorous.graph import GraphExpression
from perilune.rigorous.minimum import HamiltonianMinimum
from perilune.rigorous.reading import read_tape
from perilune.rigorous.root import EnclosedRoot
from perilune.rigorous.signs import SignedQuantity, SignResult, prove_positive, vanishing_order


@dataclass(frozen=True, kw_only=True)
class Statement:
    """Something that was to be proved.

    Attributes
    ----------
    words
        What it says.
    proved
        Whether it is proved.
    least
        The least value that was enclosed away from the ends where it vanishes; NaN or infinite where there is none.
    where
        Where it is not proved, in words.
    slack
        By so much it may fall below 0 at an end where it touches its limit; 0 where it does not.
    """

    words: str
    proved: bool
    least: float = math.nan
    where: str = ""
    slack: float = 0.0


class FlightLimits:
    """The statements of one flight."""

    def __init__(self, boundary: BoundaryProblem, root: EnclosedRoot) -> None:
        self.boundary, self.steps, self.box, self.ends = boundary, root.flight.steps, root.y, root.flight.ends

    def all(self) -> Iterator[Statement]:
        """Yield every statement."""
        yield from self._parameters()
        for words, value in zip(self.boundary.signed, self.boundary.signs.values(self.box, *self.ends), strict=True):
            yield Statement(words=words, proved=bool(value > 0), least=float(value.lower()))
        for i, arc in enumerate(self.boundary.arcs):
            where = arc.phase.name + (f", arc {i + 1}" if len(self.boundary.arcs) > 1 else "")
            yield from self._path(i, where)
            for direction, strength in zip(
                (c for c in arc.phase.controls if isinstance(c, Direction)), arc.strengths, strict=True
            ):
                told = f"the direction ({', '.join(direction.names)}) is the only one that minimises H ({where})"
                yield self._along(i, told, strength)
            for scalar in arc.scalars:
                yield from self._scalar(i, where, scalar)
            if arc.joint:
                yield self._only(i, where)

    def _parameters(self) -> Iterator[Statement]:
        y = dict(zip(self.boundary.names, self.box, strict=True))
        for f in self.boundary.problem.free:
            for limit, sign in ((f.lower, 1), (f.upper, -1)):
                side = "lower" if sign > 0 else "upper"
                if math.isfinite(limit) and self.boundary.sides.free.get(f.name) != side:
                    room = sign * (y[f.name] - limit)
                    words = f"{f.name} {'>' if sign > 0 else '<'} {float(limit):.17g}"
                    yield Statement(words=words, proved=bool(room > 0), least=float(room.lower()))
        for i, duration in enumerate(self.boundary.durations):
            (length,) = duration.values(self.box)
            words = f"arc {i + 1} lasts longer than 0 s"
            yield Statement(words=words, proved=bool(length > 0), least=float(length.lower()))

    def _path(self, i: int, where: str) -> Iterator[Statement]:
        arc, problem = self.boundary.arcs[i], self.boundary.problem
        phase, k = arc.phase, arc.phase_index
        taped = problem.form.expressions.get((k, "path"))
        if taped is not None and phase.path_conditions:
            for c, e in zip(phase.path_conditions, self._read(i, taped), strict=True):
                yield self._along(i, f"{c.name} > 0 ({where})", e, touching=True)
        graph = arc.graph
        for at, state in enumerate(phase.states):
            for limit, sign in ((state.lower, 1), (state.upper, -1)):
                if isinstance(limit, str) or math.isfinite(limit):
                    value = self._parameter(i, limit) if isinstance(limit, str) else graph.constant(limit)
                    room = sign * (graph.input(("z", at)) - value)
                    yield self._along(
                        i, f"{state.name} {'>' if sign > 0 else '<'} {limit} ({where})", room, touching=True
                    )

    def _read(self, i: int, taped: Any) -> list[GraphExpression]:
        arc = self.boundary.arcs[i]
        graph = arc.graph
        values: dict[tuple[str, str], Any] = {}
        for name in (*self.boundary.problem.given, *self.boundary.problem.free_names):
            values["p", name] = self._parameter(i, name)
        values |= {("x", name): graph.input(("z", at)) for at, name in enumerate(arc.phase.state_names)}
        values |= {("u", name): graph.input(("u", name)) for name in arc.phase.control_names}
        return graph.substitute(read_tape(graph, taped, values), arc.control)

    def _parameter(self, i: int, name: str) -> GraphExpression:
        arc, problem = self.boundary.arcs[i], self.boundary.problem
        if name in problem.given:
            return exact_value(problem.given[name]).expression(arc.graph)
        if name in arc.constants:
            return arc.graph.input(("z", len(arc.phase.states) + arc.constants.index(name)))
        return arc.graph.input(("y", self.boundary.names.index(name)))

    def _scalar(self, i: int, where: str, scalar: ArcScalar) -> Iterator[Statement]:
        name = scalar.control.name
        if not (scalar.regime != "interior" and scalar.curvature.vanishes()):
            yield self._along(i, f"H is strictly convex in {name} ({where})", scalar.curvature)
        if scalar.regime == "interior":
            for limit, sign, told in zip(scalar.limits, (1, -1), ("lower", "upper"), strict=True):
                if limit is not None:
                    yield self._along(i, f"{name} is inside its {told} bound ({where})", sign * (scalar.value - limit))
        else:
            sign, told = (1, "lower") if scalar.regime == "lower" else (-1, "upper")
            yield self._along(i, f"H is least with {name} at its {told} bound ({where})", sign * scalar.slope)

    def _only(self, i: int, where: str) -> Statement:
        arc = self.boundary.arcs[i]
        words = f"({', '.join(s.control.name for s in arc.scalars)}) is the only minimum of H ({where})"
        minimum = HamiltonianMinimum(arc)
        if not minimum.bounded:
            return Statement(words=words, proved=False, where="as it has no bounds")
        at = minimum.unseen(self.steps[i])
        return Statement(words=words, proved=at is None, where="" if at is None else f"at {at:.6g} s")

    def _along(self, i: int, words: str, of: GraphExpression, touching: bool = False) -> Statement:
        quantity = SignedQuantity(self.boundary.arcs[i], of, self.box)
        if of.constant is not None:
            return Statement(words=words, proved=of.constant > 0, least=float(of.constant.p) / float(of.constant.q))
        seen = prove_positive(
            quantity, self.steps[i], (self._zeros(i, quantity, -1), self._zeros(i, quantity, 0)), touching
        )
        return Statement(
            words=words, proved=seen.proved, least=seen.least, where=_unproved_place(seen), slack=seen.slack
        )

    def _zeros(self, i: int, quantity: SignedQuantity, side: int) -> int:
        """Return how many derivatives of a quantity vanish at the begin (side -1) or the end (0) of arc i."""
        at = i + side
        if at < 0 or (side and self.boundary.pieces[at].phase != self.boundary.pieces[i].phase):
            return 0
        # What no formula gives of the control begins anew with an arc: behind the costate stands something else.
        arc = self.boundary.arcs[at]
        count = 2 * arc.half if side else len(arc.rates)
        known = {("z", j): arc.graph.input(("end", at, j)) for j in range(count)}
        return vanishing_order(quantity, self.boundary.meets[at], known)


def _unproved_place(seen: SignResult) -> str:
    return "" if seen.proved else f"at {seen.at:.6g} s"
