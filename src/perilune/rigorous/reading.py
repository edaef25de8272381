"""From the tape of a problem's function (`perilune.problem.tape`) to expressions with exact constants.

The tape is what is proved of: each of its operations is taken for the function of real numbers that it names, and each
constant for the rational number that its double is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from perilune.problem.tape import ROLES, Expression as Taped
from perilune.rigorous.graph import Graph, GraphExpression
from perilune.words.outcome import PeriluneError


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
    **dict.fromkeys(("where", "lt", "le", "eq", "ne"), "a choice (m.where), at which a Taylor series would end"),
    **dict.fromkeys(("fabs", "fmin", "fmax"), "a kink (m.fabs, m.fmin, m.fmax), at which a Taylor series would end"),
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
