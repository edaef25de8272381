"""Forward differentiation of tapes over balls and power series: what the checker of certificates computes with.

Nothing of perilune is used here but what a certificate holds; the prover differentiates in another way.
"""

from __future__ import annotations

from operator import add, mul, sub, truediv
from typing import Any

from flint import arb, arb_mat, arb_series, fmpq


class Failed(Exception):
    """What the certificate claims is not so, or cannot be seen."""


class Jet:
    """A value with its first derivatives by some directions; jets of a higher level hold those of a lower."""

    def __init__(self, level: int, value: Any, slopes: dict[Any, Any]) -> None:
        self.level, self.value, self.slopes = level, value, slopes

    def _with(self, other: Any, value: Any, mine: Any, others: Any) -> Jet:
        slopes = {key: mine * d for key, d in self.slopes.items()} if mine is not None else dict(self.slopes)
        if isinstance(other, Jet) and other.level == self.level:
            for key, d in other.slopes.items():
                slopes[key] = slopes[key] + others * d if key in slopes else others * d
        return Jet(self.level, value, slopes)

    def _plain(self, other: Any) -> Any:
        return other.value if isinstance(other, Jet) and other.level == self.level else other

    def _below(self, other: Any) -> bool:
        return isinstance(other, Jet) and other.level > self.level

    def __add__(self, other: Any) -> Any:
        return (
            other.__radd__(self) if self._below(other) else self._with(other, self.value + self._plain(other), None, 1)
        )

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __neg__(self) -> Jet:
        return Jet(self.level, -self.value, {key: -d for key, d in self.slopes.items()})

    def __sub__(self, other: Any) -> Any:
        return self + (-other)

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        if self._below(other):
            return other * self
        b = self._plain(other)
        return self._with(other, self.value * b, b, self.value)

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __truediv__(self, other: Any) -> Any:
        return self * (1 / other)

    def __rtruediv__(self, other: Any) -> Any:
        inverse = 1 / self.value
        return other * Jet(self.level, inverse, {key: -inverse * inverse * d for key, d in self.slopes.items()})


def of(name: str, a: Any) -> Any:
    """A function of one value, of a ball, a series or a jet."""
    if not isinstance(a, Jet):
        return getattr(a, name)()
    v = a.value
    value = of(name, v)
    slope = {
        "sqrt": lambda: 1 / (2 * value), "exp": lambda: value, "log": lambda: 1 / v, "sin": lambda: of("cos", v),
        "cos": lambda: -of("sin", v), "tan": lambda: 1 + value * value, "atan": lambda: 1 / (1 + v * v),
        "asin": lambda: 1 / of("sqrt", 1 - v * v), "acos": lambda: -1 / of("sqrt", 1 - v * v),
    }[name]()  # fmt: skip
    return Jet(a.level, value, {key: slope * d for key, d in a.slopes.items()})


def power(a: Any, b: Any) -> Any:
    """A power; whole ones as products."""
    if isinstance(b, arb) and b.is_integer() and abs(float(b)) < 64:
        product = a
        for _ in range(abs(int(float(b))) - 1):
            product = product * a
        return arb(1) if float(b) == 0 else product if float(b) > 0 else 1 / product
    return of("exp", b * of("log", a))


def _hyperbolic(a: Any) -> tuple[Any, Any]:
    up, down = of("exp", a), of("exp", -a)
    return (up - down) / 2, (up + down) / 2


_TWO = {"add": add, "sub": sub, "mul": mul, "div": truediv, "pow": power}
_ONE: dict[str, Any] = {
    "neg": lambda a: -a, "sinh": lambda a: _hyperbolic(a)[0], "cosh": lambda a: _hyperbolic(a)[1],
    "tanh": lambda a: truediv(*_hyperbolic(a)),
}  # fmt: skip


def run(tape: dict[str, Any], values: dict[tuple[str, str], Any]) -> list[Any]:
    """The outputs of a tape."""
    found: list[Any] = []
    for word, *rest in tape["instructions"]:
        if word in ("x", "u", "p"):
            found.append(values[word, rest[0]])
            continue
        if word == "const":
            found.append(arb(fmpq(*float(rest[0]).as_integer_ratio())))
            continue
        a, *b = (found[i] for i in rest)
        found.append(_TWO[word](a, b[0]) if b else _ONE[word](a) if word in _ONE else of(word, a))
    return [found[i] for i in tape["outputs"]]


def slope(of_what: Any, key: Any) -> Any:
    """The derivative that the outermost jet holds."""
    return of_what.slopes.get(key, arb(0)) if isinstance(of_what, Jet) and of_what.level == 2 else arb(0)


def dot(a: list[Any], b: list[Any]) -> Any:
    """The sum of products."""
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))


def horner(c: list[Any], t: Any) -> Any:
    """A polynomial, lowest order first."""
    total = c[-1]
    for k in range(len(c) - 2, -1, -1):
        total = total * t + c[k]
    return total


def over(c: list[Any], t: Any) -> Any:
    """A polynomial over an interval, by its slope there."""
    middle = t.mid()
    return horner(c, middle) + horner([k * own for k, own in enumerate(c)][1:] or [arb(0)], t) * (t - middle)


def listed(series: Any, count: int) -> list[Any]:
    """Coefficients of a series that is known far enough, or of a constant."""
    if isinstance(series, Jet):
        return listed(series.value, count)
    if not isinstance(series, arb_series):
        return [arb(series), *[arb(0)] * (count - 1)]
    if series.prec < count:  # a series that is too short has cut something off
        raise Failed("a series is shorter than its use")
    c = series.coeffs()[:count]
    return [*c, *[arb(0)] * (count - len(c))]


def plain(value: Any) -> Any:
    """The ball without derivatives."""
    return plain(value.value) if isinstance(value, Jet) else arb(value)


def matrix(rows: list[Any], kind: Any, columns: int) -> Any:
    """Derivatives of level 1 by one kind of directions."""
    found = arb_mat(len(rows), columns)
    for a, row in enumerate(rows):
        for b in range(columns):
            key = (*kind, b) if isinstance(kind, tuple) else (kind, b)
            if isinstance(row, Jet) and key in row.slopes:
                found[a, b] = row.slopes[key]
    return found


def rational(text: str) -> Any:
    """A number written as a quotient."""
    return arb(fmpq(*map(int, text.split("/"))) if "/" in text else int(text))


def given(told: dict[str, Any]) -> Any:
    """A given value: a rational number times a power of pi."""
    return rational(told["number"]) * arb.pi() ** told.get("power_of_pi", 0)


def exact(text: str) -> Any:
    """A number written as mantissa*2^exponent."""
    mantissa, exponent = text.split("*2^")
    return arb(int(mantissa)) * arb(2) ** int(exponent)
