"""Expressions with exact rational constants: simplified as they are made, each distinct one once, differentiated.

A `Graph` holds nodes in order of computation; an `GraphExpression` is one of them, and computes like a number.
Constants are rationals and stay so: a double is the rational that it is. Derivatives are expressions again, by the
reverse mode (Griewank, Walther, *Evaluating Derivatives*, 2008, chapter 3), so that adjoint equations and tangents need
nothing but the rules that stand here.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any

from flint import fmpq

Node = tuple[Any, ...]
# How many operands each operation has; ("input", key), ("const", rational) and ("pi",) have none.
OPERANDS = {
    "add": 2, "sub": 2, "mul": 2, "div": 2, "neg": 1, "sqrt": 1, "exp": 1, "log": 1, "sin": 1, "cos": 1,
    "asin": 2, "atan": 2, "atan2": 3, "pow": 2,
}  # fmt: skip
_MOST_FACTORS = 64  # a whole power that is written as products


def exact_rational(value: Any) -> Any:
    """A number as the rational that it is."""
    if isinstance(value, fmpq):
        return value
    if isinstance(value, int):
        return fmpq(value)
    return fmpq(*float(value).as_integer_ratio())


class GraphExpression:
    """A node of a graph."""

    __slots__ = ("graph", "index")

    def __init__(self, graph: Graph, index: int) -> None:
        self.graph, self.index = graph, index

    def __repr__(self) -> str:
        return f"<{self.index}: {' '.join(map(str, self.graph.nodes[self.index]))}>"

    def __add__(self, other: Any) -> GraphExpression:
        return self.graph.do("add", self, other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> GraphExpression:
        return self.graph.do("sub", self, other)

    def __rsub__(self, other: Any) -> GraphExpression:
        return self.graph.do("sub", other, self)

    def __mul__(self, other: Any) -> GraphExpression:
        return self.graph.do("mul", self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> GraphExpression:
        return self.graph.do("div", self, other)

    def __rtruediv__(self, other: Any) -> GraphExpression:
        return self.graph.do("div", other, self)

    def __neg__(self) -> GraphExpression:
        return self.graph.do("neg", self)

    @property
    def constant(self) -> Any:
        """Return its rational value, None where it has none."""
        node = self.graph.nodes[self.index]
        return node[1] if node[0] == "const" else None

    def vanishes(self) -> bool:
        """Return True if it is the constant 0."""
        return self.constant is not None and self.constant == 0

    def inputs(self) -> set[Hashable]:
        """Keys of the inputs on which it depends."""
        nodes = self.graph.nodes
        return {nodes[i][1] for i in self.graph.needed([self]) if nodes[i][0] == "input"}


class Graph:
    """Nodes, each (operation, indices of operands before it)."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._index: dict[Any, int] = {}

    def constant(self, value: Any) -> GraphExpression:
        """A constant, exactly."""
        exact = exact_rational(value)
        return self._node(("const", exact), ("const", int(exact.p), int(exact.q)))

    def input(self, key: Hashable) -> GraphExpression:
        """A value that is given when the graph is evaluated."""
        return self._node(("input", key))

    def pi(self) -> GraphExpression:
        """The ratio of a circle's circumference to its diameter."""
        return self._node(("pi",))

    def _node(self, node: Node, key: Any = None) -> GraphExpression:
        key = node if key is None else key
        number = self._index.get(key)
        if number is None:
            number = self._index[key] = len(self.nodes)
            self.nodes.append(node)
        return GraphExpression(self, number)

    def of(self, value: Any) -> GraphExpression:
        """An expression of what is one, or a number."""
        return value if isinstance(value, GraphExpression) else self.constant(value)

    def do(self, name: str, *operands: Any) -> GraphExpression:
        """Return an operation, simplified where an operand is a constant."""
        a, *others = (self.of(operand) for operand in operands)
        b = others[0] if others else None
        simple = _simplified(self, name, a, b)
        if simple is not None:
            return simple
        if name in ("add", "mul") and b is not None and b.index < a.index:
            a, others = b, [a]
        return self._node((name, a.index, *(o.index for o in others)))

    def power(self, a: GraphExpression, exponent: Any) -> GraphExpression:
        """``a`` to a rational power; whole ones are products, and ``a`` has to be positive for others.

        Parameters
        ----------
        a
            Expression of the base.
        exponent
            Rational number, or a double, which is taken as the rational that it is.
        """
        r = exact_rational(exponent)
        if r.q == 1 and abs(int(r.p)) <= _MOST_FACTORS:
            count, product, square = abs(int(r.p)), self.constant(1), a
            while count:
                product = product * square if count & 1 else product
                square, count = square * square, count >> 1
            return product if r.p >= 0 else 1 / product
        if r == fmpq(1, 2):
            return self.do("sqrt", a)
        return self._node(("pow", a.index, self.constant(r).index))

    def needed(self, outputs: Iterable[GraphExpression]) -> list[int]:
        """Indices of all nodes that outputs depend on, in order."""
        found, waiting = set[int](), [e.index for e in outputs]
        while waiting:
            index = waiting.pop()
            if index not in found:
                found.add(index)
                waiting += node_operands(self.nodes[index])
        return sorted(found)

    def substitute(
        self, outputs: Sequence[GraphExpression], known: Mapping[Any, GraphExpression]
    ) -> list[GraphExpression]:
        """Return expressions with inputs replaced by others.

        Parameters
        ----------
        outputs
            Expressions to rewrite.
        known
            Expressions by the key of the input that they replace; other inputs stay.
        """
        new: dict[int, GraphExpression] = {}
        for index in self.needed(outputs):
            node = self.nodes[index]
            if node[0] == "input":
                new[index] = known.get(node[1], GraphExpression(self, index))
            elif not node_operands(node):
                new[index] = GraphExpression(self, index)
            elif node[0] == "pow":
                new[index] = self.power(new[node[1]], self.nodes[node[2]][1])
            else:
                new[index] = self.do(node[0], *(new[i] for i in node_operands(node)))
        return [new[e.index] for e in outputs]

    def gradient(self, of: GraphExpression, keys: Sequence[Hashable]) -> list[GraphExpression]:
        """Derivatives of an expression by inputs.

        Parameters
        ----------
        of
            Expression to differentiate.
        keys
            Keys of the inputs; the derivatives are returned in this order.
        """
        slopes: dict[int, GraphExpression] = {of.index: self.constant(1)}
        found: dict[Hashable, GraphExpression] = {}
        for index in reversed(self.needed([of])):
            if index not in slopes:
                continue
            node, slope = self.nodes[index], slopes[index]
            if node[0] == "input":
                found[node[1]] = slope
            for operand, partial in _partials(self, index):
                slopes[operand] = slopes[operand] + slope * partial if operand in slopes else slope * partial
        zero = self.constant(0)
        return [found.get(key, zero) for key in keys]

    def jacobian(self, outputs: Sequence[GraphExpression], keys: Sequence[Hashable]) -> list[list[GraphExpression]]:
        """The gradient of each output.

        Parameters
        ----------
        outputs
            Expressions to differentiate, one for each row.
        keys
            Keys of the inputs, one for each column.
        """
        return [self.gradient(output, keys) for output in outputs]


def node_operands(node: Node) -> tuple[int, ...]:
    """Return the nodes on which a node operates."""
    return node[1:] if node[0] in OPERANDS else ()


def _simplified(graph: Graph, name: str, a: GraphExpression, b: GraphExpression | None) -> GraphExpression | None:
    known, other = a.constant, None if b is None else b.constant
    if name in _EXACT and known is not None and (b is None or other is not None):
        if name != "div" or other != 0:
            return graph.constant(_EXACT[name](known, other))
    elif name == "neg" and graph.nodes[a.index][0] == "neg":
        return GraphExpression(graph, graph.nodes[a.index][1])
    elif b is not None and name in _NEUTRAL:
        return _NEUTRAL[name](graph, a, b, known, other)
    return None


_EXACT = {
    "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b, "div": lambda a, b: a / b,
    "neg": lambda a, _: -a,
}  # fmt: skip


def _simplified_sum(
    graph: Graph, a: GraphExpression, b: GraphExpression, known: Any, other: Any
) -> GraphExpression | None:
    if known == 0:
        return b
    return a if other == 0 else None


def _simplified_difference(
    graph: Graph, a: GraphExpression, b: GraphExpression, known: Any, other: Any
) -> GraphExpression | None:
    if other == 0:
        return a
    if known == 0:
        return graph.do("neg", b)
    return graph.constant(0) if a.index == b.index else None


def _simplified_product(
    graph: Graph, a: GraphExpression, b: GraphExpression, known: Any, other: Any
) -> GraphExpression | None:
    for number, factor in ((known, b), (other, a)):
        if number is not None and number in (0, 1, -1):
            return graph.constant(0) if number == 0 else factor if number == 1 else graph.do("neg", factor)
    return None


def _simplified_ratio(
    graph: Graph, a: GraphExpression, b: GraphExpression, known: Any, other: Any
) -> GraphExpression | None:
    if known == 0:
        return graph.constant(0)
    return None if other is None or other == 0 else graph.do("mul", a, graph.constant(1 / other))


_NEUTRAL = {"add": _simplified_sum, "sub": _simplified_difference, "mul": _simplified_product, "div": _simplified_ratio}


def _partials(graph: Graph, index: int) -> list[tuple[int, GraphExpression]]:
    """(operand, derivative by it) of a node."""
    name, *at = graph.nodes[index] if graph.nodes[index][0] in OPERANDS else ("",)
    here, one = GraphExpression(graph, index), graph.constant(1)
    a, *others = (GraphExpression(graph, i) for i in at) if at else (here,)
    b = others[0] if others else here
    if name in ("add", "sub"):
        return [(at[0], one), (at[1], one if name == "add" else -one)]
    if name == "mul":
        return [(at[0], b), (at[1], a)]
    if name == "div":
        return [(at[0], 1 / b), (at[1], -here / b)]
    if name == "pow":
        return [(at[0], b * here / a)]
    if name == "atan2":  # (y, x, x^2 + y^2)
        return [(at[0], b / others[1]), (at[1], -a / others[1])]
    if name in ("asin", "atan"):  # (a, the denominator of the derivative)
        return [(at[0], 1 / b)]
    if not name:
        return []
    slope = {
        "neg": lambda: -one,
        "sqrt": lambda: fmpq(1, 2) / here,
        "exp": lambda: here,
        "log": lambda: 1 / a,
        "sin": lambda: graph.do("cos", a),
        "cos": lambda: -graph.do("sin", a),
    }[name]()
    return [(at[0], slope)]
