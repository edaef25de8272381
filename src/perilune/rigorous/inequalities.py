"""Inequalities of a problem, enclosed along the whole flight of a proved root: strictly inside, or named.

These are the conditions of the path, the bounds of states and controls, the sign of dH/du where a control is on its
bound, the convexity of H where it is between them, the ranges of free parameters and the lengths of arcs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from flint import arb

from perilune.problem import UnitVectorControl
from perilune.rigorous.boundary_value_problem import BoundaryProblem
from perilune.rigorous.enclosure_step import EnclosedStep
from perilune.rigorous.equations import ArcScalar, CanonicalArc, Key
from perilune.rigorous.exact_tape import exact_value, read_tape
from perilune.rigorous.graph import Graph, GraphExpression
from perilune.rigorous.hamiltonian_minimum import HamiltonianMinimum
from perilune.rigorous.krawczyk import EnclosedRoot
from perilune.rigorous.taylor import Ball, TaylorProgram


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
        By so much it may fall below 0 at an end where it is at its limit; 0 where it does not.
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
                (c for c in arc.phase.controls if isinstance(c, UnitVectorControl)), arc.strengths, strict=True
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
        at = minimum.unproved_time(self.steps[i])
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
        # What no formula gives of the control begins afresh with each arc: behind the costate stands something else.
        arc = self.boundary.arcs[at]
        count = 2 * arc.half if side else len(arc.rates)
        known = {("z", j): arc.graph.input(("end", at, j)) for j in range(count)}
        return vanishing_order(quantity, self.boundary.meets[at], known)


def _unproved_place(seen: SignResult) -> str:
    return "" if seen.proved else f"at {seen.at:.6g} s"


_DEEPEST = 12  # halvings of a step
_SLACK = 1e-12  # SI: by less may be missed what vanishes at an end
_HIGHEST = 4  # derivative that is looked at

Affine = dict[Any, Any]  # input key (None: the constant) -> rational


@dataclass(frozen=True, kw_only=True)
class SignResult:
    """Result of the proof of a sign.

    Attributes
    ----------
    proved
        True if it is positive all along.
    least
        Lower bound over all pieces that needed no derivative; infinite where there is none.
    at
        Where it is not proved [s] of its arc.
    slack
        Amount by which it may fall below 0 towards the end of its arc, where nothing says that it vanishes exactly.
    """

    proved: bool
    least: float
    slack: float = 0.0
    at: float = float("nan")


class SignedQuantity:
    """An expression of z on an arc, and of the unknowns y, with its derivatives along the flow."""

    def __init__(self, arc: CanonicalArc, of: GraphExpression, unknowns: Sequence[Ball]) -> None:
        self.arc, self.of, self.unknowns = arc, of, unknowns
        self._derivatives = [of]
        self._programs: dict[int, TaylorProgram] = {}

    @cached_property
    def _keys(self) -> list[Key]:
        return [*self.arc.keys, *(("y", i) for i in range(len(self.unknowns)))]

    def derivative(self, order: int) -> GraphExpression:
        """Return its derivative of an order by time, along the flow."""
        while len(self._derivatives) <= order:
            graph, last = self.arc.graph, self._derivatives[-1]
            slopes = graph.gradient(last, self.arc.keys)
            products = (slope * rate for slope, rate in zip(slopes, self.arc.rates, strict=True))
            self._derivatives.append(sum(products, graph.constant(0)))
        return self._derivatives[order]

    def value(self, z: Sequence[Ball], order: int = 0) -> Ball:
        """Itself, or a derivative, at some z.

        Parameters
        ----------
        z
            States, constant states and costates, balls [SI].
        order
            Order of the time derivative along the flow, 0 for the quantity itself [SI, per s^order].
        """
        if order not in self._programs:
            self._programs[order] = TaylorProgram(self.arc.graph, self._keys, [self.derivative(order)])
        return self._programs[order].values([*z, *self.unknowns])[0]


def prove_positive(
    quantity: SignedQuantity, steps: Sequence[EnclosedStep], zeros: tuple[int, int] = (0, 0), touching: bool = False
) -> SignResult:
    """Prove, if possible, that a quantity is positive along an arc.

    Parameters
    ----------
    quantity, steps
        The quantity, and the proved steps of the arc.
    zeros
        How many of its derivatives, itself the first, vanish where the arc begins, and where it ends: there it has to
        be positive only inside.
    touching
        Whether it may miss 0 by a slack where the arc ends: a limit may, what minimises H may not.
    """
    least, slack = float("inf"), 0.0
    for number, step in enumerate(steps):
        at_begin, at_end = (zeros[0] if number == 0 else 0), (zeros[1] if number + 1 == len(steps) else 0)
        waiting = [(0.0, 1.0, 0)]
        while waiting:
            a, b, depth = waiting.pop()
            span = step.length * arb(a).union(arb(b))
            z = step.at(span)
            value = quantity.value(z)
            if value > 0:
                least = min(least, float(value.lower()))
                continue
            if a == 0.0 and at_begin and quantity.value(z, at_begin) > 0:
                continue
            if b == 1.0 and at_end and (-1) ** at_end * quantity.value(z, at_end) > 0:
                continue
            if (
                touching
                and b == 1.0
                and number + 1 == len(steps)
                and not at_end
                and (lost := _end_slack(quantity, step, span, z)) is not None
            ):
                slack = max(slack, lost)
                continue
            if depth == _DEEPEST or value < 0:
                return SignResult(proved=False, least=least, at=float((step.begin + span).mid()))
            middle = 0.5 * (a + b)
            waiting += [(a, middle, depth + 1), (middle, b, depth + 1)]
    return SignResult(proved=True, least=least, slack=slack)


def _end_slack(quantity: SignedQuantity, step: EnclosedStep, span: Ball, z: Sequence[Ball]) -> float | None:
    """Return how far a quantity may lie below 0 on an arc's last piece, if only by the uncertainty of its end.

    It falls up to the end, g' < 0, or g'' > 0 with g' about 0 there: then g >= g(T), or g >= g(T) - |g'(T)| (T - a).
    """
    end = step.at(step.length)
    here = quantity.value(end)
    if not -_SLACK < here < _SLACK:
        return None
    lost = here.abs_upper()
    if not quantity.value(z, 1) < 0:
        if not quantity.value(z, 2) > 0:
            return None
        lost += quantity.value(end, 1).abs_upper() * 2 * span.rad()
    return float(lost.upper()) if lost < _SLACK else None


def vanishing_order(
    quantity: SignedQuantity, known: Sequence[GraphExpression], at: Mapping[Any, GraphExpression]
) -> int:
    """Return how many derivatives of a quantity, itself the first, vanish where equations hold.

    Parameters
    ----------
    quantity
        The quantity.
    known
        Expressions of which each is zero there.
    at
        Expressions that stand for z there.
    """
    graph = quantity.arc.graph
    same = {e.index for one in known for e in (one, -one)}
    forms = [form for one in known if (form := affine_form(graph, one)) is not None]
    for order in range(_HIGHEST):
        here = graph.substitute([quantity.derivative(order)], at)[0]
        own = None if here.index in same else affine_form(graph, here)
        if here.index not in same and (own is None or not any(_is_proportional(own, one) for one in forms)):
            return order
    return 0  # as far as was looked: nothing can be said of its sign


def affine_form(graph: Graph, of: GraphExpression) -> Affine | None:
    """An expression as exact rational factors of its inputs; None where it is not affine.

    Parameters
    ----------
    graph
        Graph of the expression.
    of
        The expression.

    Returns
    -------
    dict or None
        Factor of each input by its key, and the constant term by None; zeros may be left out.
    """
    found: dict[int, Affine | None] = {}
    for index in graph.needed([of]):
        name, *at = graph.nodes[index]
        if name == "input":
            found[index] = {at[0]: graph.constant(1).constant}
        elif name == "const":
            found[index] = {None: at[0]} if at[0] != 0 else {}
        else:
            found[index] = _combine_affine(name, [found.get(i) for i in at])
    return found[of.index]


def _combine_affine(name: str, parts: list[Affine | None]) -> Affine | None:
    if any(part is None for part in parts):
        return None
    a, *others = (part for part in parts if part is not None)
    if name == "neg":
        return {key: -factor for key, factor in a.items()}
    if name in ("add", "sub"):
        sign, total = (1 if name == "add" else -1), dict(a)
        for key, factor in others[0].items():
            total[key] = total.get(key, 0) + sign * factor
        return {key: factor for key, factor in total.items() if factor != 0}
    if name == "mul":
        for number, other in ((a, others[0]), (others[0], a)):
            if set(number) == {None}:
                return {key: number[None] * factor for key, factor in other.items()}
    return None


def _is_proportional(a: Affine, b: Affine) -> bool:
    if set(a) != set(b) or not a:
        return not a and not b
    ratios = [a[key] / b[key] for key in a]
    return all(ratio == ratios[0] for ratio in ratios)
