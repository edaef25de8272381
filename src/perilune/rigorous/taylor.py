"""Taylor coefficients of expressions, one order after the other, in balls.

Along a flow z' = F(z) the coefficients of z to order k give those of F(z) to order k, and these give z's of order
k + 1. Each operation has a recurrence (Moore 1966; Griewank, Walther 2008, table 13.2). Coefficients are plain lists,
as long as the orders that were computed: there is no length that could be wrong and cut something off unseen. What is
known along the flow already goes through FLINT's power series (`TaylorProgram.along`), which is quicker, but wider
where balls are wide; they know how long they are, and what has become shorter than it should be is no result.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from operator import mul
from typing import Any

from flint import arb, arb_series, ctx

from perilune.core import PeriluneError
from perilune.rigorous.graph import Graph, GraphExpression, node_operands

Ball = Any  # flint.arb, which comes without types
Coefficients = list[Ball]


class TaylorProgram:
    """Expressions that are evaluated together.

    Parameters
    ----------
    graph
        Of all of them.
    inputs
        Keys, in the order in which values are passed.
    outputs
        What is wanted.
    """

    def __init__(self, graph: Graph, inputs: Sequence[Hashable], outputs: Sequence[GraphExpression]) -> None:
        self.inputs, self.outputs = tuple(inputs), [e.index for e in outputs]
        place = {key: k for k, key in enumerate(self.inputs)}
        self._fixed: list[tuple[int, Any]] = []  # nodes without an input below them
        self._steps: list[tuple[int, Any]] = []
        self._inputs: dict[int, int] = {}
        self._moving = set[int]()
        for index in graph.needed(outputs):
            node = graph.nodes[index]
            if node[0] == "input":
                self._inputs[index] = place[node[1]]
                self._moving.add(index)
            elif any(i in self._moving for i in node_operands(node)):
                self._moving.add(index)
                self._steps.append((index, node))
            else:
                self._fixed.append((index, node))

    def values(self, at: Sequence[Ball]) -> list[Ball]:
        """The outputs where the inputs have these values."""
        found = self._constants()
        for index, k in self._inputs.items():
            found[index] = at[k]
        for index, node in self._steps:
            found[index] = _ball_value(node, found)
        return [found[i] for i in self.outputs]

    def _constants(self) -> dict[int, Ball]:
        found: dict[int, Ball] = {}
        for index, node in self._fixed:
            found[index] = (
                arb(node[1]) if node[0] == "const" else arb.pi() if node[0] == "pi" else _ball_value(node, found)
            )
        return found

    def flow(self, start: Sequence[Ball], orders: int) -> tuple[list[Coefficients], list[Coefficients]]:
        """Coefficients along the flow whose rates are the first outputs.

        Parameters
        ----------
        start
            Values of the inputs at time 0. Those without a rate among the outputs do not move.
        orders
            How many coefficients of the outputs are wanted; the inputs get one more.

        Returns
        -------
        Coefficients of the inputs, orders 0 to `orders`, and of the outputs, orders 0 to `orders` - 1.
        """
        known = self._constants()
        zero = arb(0)
        moving = list(zip(range(len(start)), self.outputs, strict=False))
        inputs: list[Coefficients] = [[value] for value in start]
        table: dict[int, Coefficients] = {index: inputs[k] for index, k in self._inputs.items()}
        table |= {index: [] for index, _ in self._steps}
        steps = _Recurrences(table, known).of(self._steps)
        rates = [(inputs[k], table.get(i), known.get(i)) for k, i in moving]
        still = inputs[len(moving) :]
        for k in range(orders):
            for step in steps:
                step(k)
            for own, rate, fixed in rates:
                following: Any = rate[k] if rate is not None else fixed if k == 0 else zero
                own.append(following / (k + 1))
            for own in still:
                own.append(zero)
        padding = [zero] * (orders - 1)
        return inputs, [table[i][:orders] if i in table else [known[i], *padding] for i in self.outputs]

    def along(self, inputs: Sequence[Coefficients], orders: int) -> list[Coefficients]:
        """Coefficients of the outputs, orders 0 to `orders` - 1, along known coefficients of the inputs.

        Parameters
        ----------
        inputs
            Coefficients of each input, from order 0 up, at least `orders` of each.
        orders
            Number of coefficients to compute.

        Raises
        ------
        CutOff
            If a series is shorter than its use.
        """
        before, ctx.cap = ctx.cap, orders
        try:
            found = self._constants()
            for index, k in self._inputs.items():
                found[index] = arb_series(inputs[k][:orders], orders)
            for index, node in self._steps:
                found[index] = _series_value(node, found)
            return [_series_orders(found[i], orders) for i in self.outputs]
        finally:
            ctx.cap = before


class CutOff(PeriluneError):
    """A series that has lost some of its orders: an error of the prover."""


def _series_orders(series: Any, orders: int) -> Coefficients:
    if not isinstance(series, arb_series):
        return [series, *[arb(0)] * (orders - 1)]
    if series.prec < orders:
        raise CutOff(f"a series has {series.prec} orders of {orders}")
    c = series.coeffs()[:orders]
    return [*c, *[arb(0)] * (orders - len(c))]


def _series_value(node: Any, found: dict[int, Any]) -> Any:
    name, a, *others = node[0], *(found[i] for i in node[1:])
    if name == "pow":
        return (a.log() * others[0]).exp()
    if name == "atan2":
        y, x = arb_series(a), arb_series(others[0])
        return ((x * y.derivative() - y * x.derivative()) / others[1]).integral() + _smooth_atan2(y[0], x[0])
    return getattr(a, name)() if name == "asin" else _ball_value(node, found)


def _ball_value(node: Any, found: dict[int, Ball]) -> Ball:
    name, a, *others = node[0], *(found[i] for i in node[1:])
    if name == "add":
        return a + others[0]
    if name == "sub":
        return a - others[0]
    if name == "mul":
        return a * others[0]
    if name == "div":
        return a / others[0]
    if name == "neg":
        return -a
    if name == "pow":
        return a ** others[0]
    if name == "atan2":
        return _smooth_atan2(a, others[0])
    return getattr(a, name)()


def _smooth_atan2(y: Ball, x: Ball) -> Ball:
    """The angle where it is smooth; nothing is known of it at its jump by 2 pi, which no recurrence of slopes sees."""
    return arb.atan2(y, x) if x > 0 or y > 0 or y < 0 else arb.nan()


Step = Callable[[int], None]


class _Recurrences:
    """Recurrences that append the next coefficient of each node to its list, once those of its operands are there."""

    def __init__(self, table: dict[int, Coefficients], known: dict[int, Ball]) -> None:
        self.table, self.known = table, known

    def of(self, steps: Sequence[tuple[int, Any]]) -> list[Step]:
        """Return one step for each node, and a common one for sine and cosine of the same angle."""
        found, turned = list[Step](), dict[tuple[str, int], Coefficients]()
        for index, (name, *at) in steps:
            if name in ("sin", "cos"):
                turned[name, at[0]] = self.table[index]
        done = set[int]()
        for index, (name, *at) in steps:
            c, a = self.table[index], self.table.get(at[0])
            if name in ("sin", "cos"):
                if at[0] not in done and a is not None:
                    found.append(
                        _sine_cosine_recurrence(a, turned.get(("sin", at[0]), []), turned.get(("cos", at[0]), []))
                    )
                done.add(at[0])
            elif name in ("add", "sub", "mul", "div"):
                found.append(self._binary(c, name, *at))
            elif name == "atan2":
                found.append(_atan2_recurrence(c, *(self._all(i) for i in at)))
            elif name == "pow":
                found.append(_power_recurrence(c, self.table[at[0]], self.known[at[1]]))
            else:
                assert a is not None  # else it would not move
                found.append(_OF_ONE[name](c, a, *(self.table[i] for i in at[1:])))
        return found

    def _all(self, index: int) -> Coefficients:
        """Coefficients of a node, those of a constant far enough."""
        return self.table[index] if index in self.table else _Constant(self.known[index])

    def _binary(self, c: Coefficients, name: str, left: int, right: int) -> Step:
        a, b = self.table.get(left), self.table.get(right)
        if a is not None and b is not None:
            if name == "mul" and a is b:
                return lambda k: c.append(_square_coefficient(a, k))
            return {
                "add": lambda k: c.append(a[k] + b[k]),
                "sub": lambda k: c.append(a[k] - b[k]),
                "mul": lambda k: c.append(sum(map(mul, a, b[::-1]))),
                "div": lambda k: c.append((a[k] - sum(map(mul, b[1:], c[::-1]))) / b[0]),
            }[name]
        if a is not None:
            fixed = self.known[right]
            return {
                "add": lambda k: c.append(a[k] if k else a[0] + fixed),
                "sub": lambda k: c.append(a[k] if k else a[0] - fixed),
                "mul": lambda k: c.append(a[k] * fixed),
                "div": lambda k: c.append(a[k] / fixed),
            }[name]
        assert b is not None  # else it would not move
        fixed = self.known[left]
        return {
            "add": lambda k: c.append(b[k] if k else fixed + b[0]),
            "sub": lambda k: c.append(-b[k] if k else fixed - b[0]),
            "mul": lambda k: c.append(fixed * b[k]),
            "div": lambda k: c.append((-sum(map(mul, b[1:], c[::-1])) if k else fixed) / b[0]),
        }[name]


class _Constant(list[Ball]):
    """Coefficients of a constant, to any order."""

    def __init__(self, value: Ball) -> None:
        super().__init__([value])

    def __getitem__(self, k: Any) -> Any:
        return super().__getitem__(0) if k == 0 else arb(0)


def _square_coefficient(a: Coefficients, k: int) -> Ball:
    half = 2 * sum(map(mul, a[: (k + 1) // 2], a[: k // 2 : -1])) if k else arb(0)
    return half if k % 2 else half + a[k // 2] * a[k // 2]


def _neg_recurrence(c: Coefficients, a: Coefficients) -> Step:
    return lambda k: c.append(-a[k])


def _sqrt_recurrence(c: Coefficients, a: Coefficients) -> Step:
    """c c = a."""
    return lambda k: c.append((a[k] - sum(map(mul, c[1:], c[:0:-1]))) / (2 * c[0]) if k else a[0].sqrt())


def _exp_recurrence(c: Coefficients, a: Coefficients) -> Step:
    """c' = a' c."""
    rates = list[Ball]()

    def step(k: int) -> None:
        if k:
            rates.append(k * a[k])
        c.append(sum(map(mul, rates, c[::-1])) / k if k else a[0].exp())

    return step


def _sine_cosine_recurrence(a: Coefficients, sine: Coefficients, cosine: Coefficients) -> Step:
    """sine' = a' cosine, cosine' = -a' sine."""
    rates = list[Ball]()

    def step(k: int) -> None:
        if not k:
            sine.append(a[0].sin())
            cosine.append(a[0].cos())
            return
        rates.append(k * a[k])
        following = sum(map(mul, rates, cosine[::-1])) / k
        cosine.append(-sum(map(mul, rates, sine[::-1])) / k)
        sine.append(following)

    return step


def _quotient_recurrence(name: str) -> Callable[..., Step]:
    """c' w = a', where w is a itself if there is no other."""

    def make(c: Coefficients, a: Coefficients, w: Coefficients | None = None) -> Step:
        below, rates = a if w is None else w, list[Ball]()

        def step(k: int) -> None:
            if not k:
                c.append(getattr(a[0], name)())
                return
            rate = (k * a[k] - sum(map(mul, rates, below[k - 1 : 0 : -1]))) / below[0]
            rates.append(rate)
            c.append(rate / k)

        return step

    return make


def _atan2_recurrence(c: Coefficients, y: Coefficients, x: Coefficients, w: Coefficients) -> Step:
    """c' w = x y' - y x'."""
    rates = list[Ball]()

    def step(k: int) -> None:
        if not k:
            c.append(_smooth_atan2(y[0], x[0]))
            return
        turning = sum((j * (y[j] * x[k - j] - x[j] * y[k - j]) for j in range(1, k + 1)), arb(0))
        rate = (turning - sum((rates[j - 1] * w[k - j] for j in range(1, k)), arb(0))) / w[0]
        rates.append(rate)
        c.append(rate / k)

    return step


def _power_recurrence(c: Coefficients, a: Coefficients, exponent: Ball) -> Step:
    """c' a = exponent a' c."""
    rates = list[Ball]()

    def step(k: int) -> None:
        if not k:
            c.append(a[0] ** exponent)
            return
        rates.append(k * a[k])
        both = (exponent + 1) * sum(map(mul, rates, c[::-1])) - k * sum(map(mul, a[1:], c[::-1]))
        c.append(both / (k * a[0]))

    return step


_OF_ONE: dict[str, Callable[..., Step]] = {
    "neg": _neg_recurrence, "sqrt": _sqrt_recurrence, "exp": _exp_recurrence,
    "log": _quotient_recurrence("log"), "atan": _quotient_recurrence("atan"), "asin": _quotient_recurrence("asin"),
}  # fmt: skip
