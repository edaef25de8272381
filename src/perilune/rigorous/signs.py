"""Signs along an enclosed flight: that a quantity stays positive, over every step, subdivided where it has to be.

Where a quantity is known to vanish at an end of its arc, as the height at touchdown or the switching function at a
switch, no enclosure of it can be positive up to there. Then its first derivative that does not vanish there is enclosed
on the last piece: g(T) = g'(T) = 0 and g'' > 0 on [a, T] make g > 0 on [a, T). That it vanishes is never read off an
enclosure: it is an equation of the extremal, found as one by `affine_form`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from flint import arb

from perilune.rigorous.equations import CanonicalArc, Key
from perilune.rigorous.flow import EnclosedStep
from perilune.rigorous.graph import Graph, GraphExpression
from perilune.rigorous.taylor import Ball, TaylorProgram

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
        """Itself, or a derivative, at some z."""
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
    """An expression as exact rational factors of its inputs; None where it is not affine."""
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
