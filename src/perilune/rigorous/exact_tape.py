"""Expressions with exact constants from the tape of a problem's function (`perilune.problem.tracing.tape`).

The tape is what is proved of: each of its operations is taken for the function of real numbers that it names, and each
constant for the rational number that its double is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb, fmpq

from perilune.core import PeriluneError, exact_quantity, parse_quantity
from perilune.problem import ROLES, Expression as Taped, Parameter
from perilune.rigorous.graph import Graph, GraphExpression
from perilune.rigorous.taylor import Ball


class Unsupported(PeriluneError):
    """Property of a problem for which no theorem can be stated yet."""

    def __init__(self, what: str) -> None:
        super().__init__(what, advice="levels 1 to 4 do not need it")


def read_tape(graph: Graph, taped: Taped, values: Mapping[tuple[str, str], Any]) -> list[GraphExpression]:
    """The outputs of a tape as expressions.

    Parameters
    ----------
    graph
        Where they stand.
    taped
        A function of a problem.
    values
        By (role, component), what it works on.

    Raises
    ------
    Unsupported
        If it has an operation without a Taylor series here.
    """
    found: list[GraphExpression] = []
    for word, *rest in taped.tape.instructions:
        if word in ROLES:
            found.append(graph.of(values[word, rest[0]]))
        elif word == "const":
            found.append(graph.constant(float(rest[0])))
        else:
            make = _MEANING.get(word)
            if make is None:
                raise Unsupported(f"the physics has {_TOLD.get(word, f'the operation {word}')}")
            found.append(make(graph, *(found[i] for i in rest)))
    return [found[i] for i in taped.tape.outputs]


_TOLD = {
    **dict.fromkeys(("where", "lt", "le", "eq", "ne"), "a choice (xp.where), at which a Taylor series would end"),
    **dict.fromkeys(("fabs", "fmin", "fmax"), "a kink (xp.fabs, xp.fmin, xp.fmax), at which a Taylor series would end"),
    "table": "a table, whose knots end a Taylor series",
}


def _same_operation(name: str) -> Callable[..., GraphExpression]:
    return lambda graph, *at: graph.do(name, *at)


def _exact_power_node(graph: Graph, a: GraphExpression, b: GraphExpression) -> GraphExpression:
    exponent = b.constant
    if exponent is None:
        return graph.do("exp", b * graph.do("log", a))
    return graph.power(a, exponent)


def _arcsine(graph: Graph, a: GraphExpression) -> GraphExpression:
    return graph.do("asin", a, graph.do("sqrt", 1 - a * a))


def _hyperbolic(graph: Graph, a: GraphExpression) -> tuple[GraphExpression, GraphExpression]:
    up, down = graph.do("exp", a), graph.do("exp", -a)
    return (up - down) / 2, (up + down) / 2


def _quotient_of_pair(both: tuple[GraphExpression, GraphExpression]) -> GraphExpression:
    return both[0] / both[1]


_MEANING: dict[str, Callable[..., GraphExpression]] = {
    **{name: _same_operation(name) for name in ("add", "sub", "mul", "div", "neg", "sqrt", "exp", "log", "sin", "cos")},
    "pow": _exact_power_node,
    "tan": lambda graph, a: graph.do("sin", a) / graph.do("cos", a),
    "asin": _arcsine,
    "acos": lambda graph, a: graph.pi() / 2 - _arcsine(graph, a),
    "atan": lambda graph, a: graph.do("atan", a, 1 + a * a),
    "atan2": lambda graph, y, x: graph.do("atan2", y, x, x * x + y * y),
    "sinh": lambda graph, a: _hyperbolic(graph, a)[0],
    "cosh": lambda graph, a: _hyperbolic(graph, a)[1],
    "tanh": lambda graph, a: _quotient_of_pair(_hyperbolic(graph, a)),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ExactValue:
    """rational * pi^power, and the text that says so; "" where the number is that of a double."""

    rational: Fraction
    power: int = 0
    text: str = ""

    def expression(self, graph: Graph) -> GraphExpression:
        """Return the number in a graph."""
        return graph.constant(self._fmpq) * graph.power(graph.pi(), self.power)

    def ball(self) -> Ball:
        """Return the number as a ball in the precision that is set."""
        return arb(self._fmpq) * arb.pi() ** self.power

    def document(self) -> dict[str, Any]:
        """Return the number as a certificate states it."""
        around = {"power_of_pi": self.power} if self.power else {}
        return {"taken": "text" if self.text else "double", "text": self.text, "number": str(self.rational)} | around

    @property
    def _fmpq(self) -> Any:
        return fmpq(self.rational.numerator, self.rational.denominator)


def exact_value(given: Parameter) -> ExactValue:
    """Return the exact number of a given value, of which a theorem is proved.

    A text that does not give the value in its unit is none: the solver would have flown something else.
    """
    try:
        told = bool(given.stated) and parse_quantity(given.stated, given.unit) == given.value
    except PeriluneError:
        told = False
    found = exact_quantity(given.stated) if told else None
    if found is not None:
        return ExactValue(rational=found[0], power=found[1], text=given.stated)
    return ExactValue(rational=Fraction(given.value))
