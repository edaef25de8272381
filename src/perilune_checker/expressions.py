"""Expressions of numbers and symbols: differentiated, substituted, evaluated with balls and series of them.

Nothing is rounded before it is done with balls, and nothing is simplified but a 0 that is so by its form (`ZERO`, of
which derivatives are made: what does not depend on a symbol) and factors of `ONE`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import count
from operator import add, methodcaller, mul, neg, sub, truediv
from typing import Any

from flint import arb, arb_mat, arb_series

_ORDER = count()  # an expression is made after its parts


class Failed(Exception):
    """Claim of the certificate that is false, or cannot be proved."""


class StepTooLong(Failed):
    """Failure that shorter steps may avoid."""


def require_claim(held: bool, told: str, kind: type[Failed] = Failed) -> None:
    """Raise `kind` with a text unless a claim holds.

    Parameters
    ----------
    held
        Whether the claim holds.
    told
        The text of the error.
    kind
        Class of the error.
    """
    if not held:
        raise kind(told)


class CertifiedExpression:
    """An operation on others, a number, or a symbol."""

    __slots__ = ("at", "parts", "word")

    def __init__(self, word: str, *parts: Any) -> None:
        self.word, self.parts, self.at = word, parts, next(_ORDER)

    def __add__(self, other: Any) -> CertifiedExpression:
        return make_operation("add", self, other)

    def __radd__(self, other: Any) -> CertifiedExpression:
        return make_operation("add", other, self)

    def __sub__(self, other: Any) -> CertifiedExpression:
        return make_operation("sub", self, other)

    def __rsub__(self, other: Any) -> CertifiedExpression:
        return make_operation("sub", other, self)

    def __mul__(self, other: Any) -> CertifiedExpression:
        return make_operation("mul", self, other)

    def __rmul__(self, other: Any) -> CertifiedExpression:
        return make_operation("mul", other, self)

    def __truediv__(self, other: Any) -> CertifiedExpression:
        return make_operation("div", self, other)

    def __rtruediv__(self, other: Any) -> CertifiedExpression:
        return make_operation("div", other, self)

    def __neg__(self) -> CertifiedExpression:
        return make_operation("neg", self)


ZERO, ONE = CertifiedExpression("number", arb(0)), CertifiedExpression("number", arb(1))
NUMBERS = {0: ZERO, 1: ONE, -1: CertifiedExpression("number", arb(-1)), 2: CertifiedExpression("number", arb(2))}
SIMPLE = {
    ("add", 0): lambda a, b: b, ("add", 1): lambda a, b: a, ("sub", 1): lambda a, b: a, ("neg", 0): lambda a: ZERO,
    ("mul", 0): lambda a, b: ZERO, ("mul", 1): lambda a, b: ZERO, ("div", 0): lambda a, b: ZERO,
}  # fmt: skip


def symbol() -> CertifiedExpression:
    """A new symbol."""
    return CertifiedExpression("symbol")


def make_operation(word: str, *parts: Any) -> CertifiedExpression:
    """Return an operation on expressions, or on the few numbers in `NUMBERS`."""
    own = [p if isinstance(p, CertifiedExpression) else NUMBERS[p] for p in parts]
    for i, part in enumerate(own):
        if part is ZERO and (word, i) in SIMPLE:
            return SIMPLE[word, i](*own)
    if word in ("mul", "div") and own[1] is ONE:
        return own[0]
    return own[1] if word == "mul" and own[0] is ONE else CertifiedExpression(word, *own)


def sum_of_products(a: Iterable[Any], b: Iterable[Any]) -> Any:
    """The sum of products.

    Parameters
    ----------
    a, b
        Factors, as many of the one as of the other.
    """
    return sum((x * y for x, y in zip(a, b, strict=True)), ZERO)


SLOPES: dict[str, Any] = {  # by its parts, of e = word(a, b)
    "add": lambda e, a, b: (ONE, ONE),
    "sub": lambda e, a, b: (ONE, -1),
    "neg": lambda e, a: (-1,),
    "mul": lambda e, a, b: (b, a),
    "div": lambda e, a, b: (1 / b, -e / b),
    "sqrt": lambda e, a: (1 / (2 * e),),
    "exp": lambda e, a: (e,),
    "log": lambda e, a: (1 / a,),
    "sin": lambda e, a: (make_operation("cos", a),),
    "cos": lambda e, a: (-make_operation("sin", a),),
    "tan": lambda e, a: (1 + e * e,),
    "atan": lambda e, a: (1 / (1 + a * a),),
    "asin": lambda e, a: (1 / make_operation("sqrt", 1 - a * a),),
    "acos": lambda e, a: (-1 / make_operation("sqrt", 1 - a * a),),
    "atan2": lambda e, y, x: (x / (x * x + y * y), -y / (x * x + y * y)),
}


def all_parts(outputs: Iterable[CertifiedExpression]) -> list[CertifiedExpression]:
    """Return all expressions of which the outputs are made, each behind its parts."""
    found, waiting = dict[int, CertifiedExpression](), [*outputs]
    while waiting:
        e = waiting.pop()
        if e.at not in found:
            found[e.at] = e
            waiting += [part for part in e.parts if isinstance(part, CertifiedExpression)]
    return [found[at] for at in sorted(found)]


def backward_gradient(output: CertifiedExpression, by: Sequence[CertifiedExpression]) -> list[Any]:
    """Return derivatives by symbols, backwards from the output.

    Parameters
    ----------
    output
        Expression to differentiate.
    by
        Symbols; the derivatives are returned in this order.
    """
    slopes: dict[int, Any] = {output.at: ONE}
    for e in reversed(all_parts([output])):
        if e.at in slopes and e.word in SLOPES:
            for part, slope in zip(e.parts, SLOPES[e.word](e, *e.parts), strict=True):
                slopes[part.at] = slopes.get(part.at, ZERO) + slopes[e.at] * slope
    return [slopes.get(own.at, ZERO) for own in by]


def replace_symbols(outputs: Sequence[CertifiedExpression], values: Mapping[CertifiedExpression, Any]) -> list[Any]:
    """Return expressions with symbols replaced by others.

    Parameters
    ----------
    outputs
        Expressions to rewrite.
    values
        Expressions, or numbers, by the symbol that they replace; other symbols stay.
    """
    new: dict[int, Any] = {own.at: make_operation("add", value, ZERO) for own, value in values.items()}
    for e in all_parts(outputs):
        if e.at not in new:
            same = e.word not in SLOPES or all(new[part.at] is part for part in e.parts)
            new[e.at] = e if same else make_operation(e.word, *(new[part.at] for part in e.parts))
    return [new[own.at] for own in outputs]


def smooth_angle(y: Any, x: Any) -> Any:
    """atan2 away from its jump.

    Parameters
    ----------
    y, x
        Balls or power series; NaN unless one sign is seen that excludes the jump at y = 0, x < 0.
    """
    if isinstance(y, arb_series) or isinstance(x, arb_series):
        y, x = arb_series(y), arb_series(x)
        turning = (x * y.derivative() - y * x.derivative()) / (x * x + y * y)
        return turning.integral() + smooth_angle(y[0], x[0])
    return arb.atan2(y, x) if x > 0 or y > 0 or y < 0 else arb("nan")


DONE: dict[str, Any] = {
    "add": add, "sub": sub, "mul": mul, "div": truediv, "neg": neg, "atan2": smooth_angle,
    **{word: methodcaller(word) for word in ("sqrt", "exp", "log", "sin", "cos", "tan", "atan", "asin", "acos")},
}  # fmt: skip


class CertifiedProgram:
    """Expressions of groups of symbols, done with balls or with series; and their derivatives by the first groups."""

    def __init__(
        self, groups: Sequence[Sequence[CertifiedExpression]], outputs: Sequence[Any], slopes: int = 0, rows: int = 1
    ) -> None:
        own, known, places = [make_operation("add", e, ZERO) for e in outputs], dict[Any, int](), dict[int, int]()
        inputs = {e.at: (g, i) for g, group in enumerate(groups) for i, e in enumerate(group)}
        self.blank, self.inputs, self.operations = list[Any](), list[tuple[int, ...]](), list[tuple[Any, ...]]()
        for e in all_parts(own):
            parts = [places[part.at] for part in e.parts] if e.word in DONE else [e.at]
            at = places[e.at] = known.setdefault((e.word, *parts), len(known))
            if at == len(self.blank):  # it is new
                require_claim(e.word in DONE or e.word == "number" or e.at in inputs, "something has no value")
                self.blank.append(e.parts[0] if e.word == "number" else None)
                if e.word in DONE:
                    self.operations.append((at, DONE[e.word], *parts))
                elif e.at in inputs:
                    self.inputs.append((at, *inputs[e.at]))
        self.outputs, self.shape = [places[e.at] for e in own], (rows, len(own) // rows if rows else 0)
        self.slopes = [
            CertifiedProgram(groups, [d for e in own for d in backward_gradient(e, group)], rows=len(own))
            for group in groups[:slopes]
        ]

    def __call__(self, *groups: Sequence[Any]) -> list[Any]:
        """The outputs."""
        w = [*self.blank]
        for at, g, i in self.inputs:
            w[at] = groups[g][i]
        try:
            for at, do, *parts in self.operations:
                w[at] = do(*(w[i] for i in parts))
        except ValueError as error:  # of series
            raise ZeroDivisionError from error
        return [w[i] for i in self.outputs]

    def matrix(self, *groups: Sequence[Any]) -> Any:
        """The outputs as a matrix, row by row."""
        return arb_mat(*self.shape, self(*groups))
