"""The maths namespace `xp` that is passed to the user's physics: one text for floats, arrays and symbols.

``dynamics(x, u, p, xp)`` uses ``xp.sin``, ``xp.sqrt``, ... and never imports a maths library itself, so that the same
text flies in the verifier (numpy, real or complex) and is traced into symbols by `perilune.problem.casadi_trace`.

``xp.where(a < b, value, otherwise)`` chooses; where the choice changes in flight an arc ends and another begins.
``xp.table(table, x)`` reads a `Table`.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np

from perilune.core.errors import PeriluneError
from perilune.core.units import format_value_range
from perilune.core.validation import check_call, wrong_type_error

# name in `xp`: name in numpy. The symbolic twin takes the same keys.
NUMPY_NAMES = {
    "sqrt": "sqrt",
    "sin": "sin",
    "cos": "cos",
    "tan": "tan",
    "asin": "arcsin",
    "acos": "arccos",
    "atan": "arctan",
    "atan2": "arctan2",
    "sinh": "sinh",
    "cosh": "cosh",
    "tanh": "tanh",
    "exp": "exp",
    "log": "log",
    "fabs": "abs",
    "fmin": "minimum",
    "fmax": "maximum",
}

MOST_KNOTS = 200  # each is a choice in machine code
_SPLINES = {"smooth": 5, "smoother": 7}  # degrees

Choose = Callable[[Any, Any, Any], Any]  # (condition, yes, no)


def comparison_fails(condition: Any) -> bool:
    """Return True if a comparison fails, for arrays anywhere; False for symbols, of which nothing is known."""
    known = isinstance(condition, bool | np.bool_ | np.ndarray)
    return known and not np.all(condition)


def _knots(name: str, values: Any) -> tuple[float, ...]:
    try:
        return tuple(float(v) for v in values)
    except (TypeError, ValueError):
        raise wrong_type_error(values, "a list of numbers", f"a column {name} of a table") from None


@check_call
@dataclass(frozen=True, repr=False)
class Table:
    """Tabulated data as a function of one number without a dimension.

    Divide by given parameters: ``p.rho0 * xp.table(density, x.h / p.H)``. Beyond its ends a table goes on along its
    last slope.

    Parameters
    ----------
    x, y
        Knots in increasing order and the values there.
    kind
        ``"smooth"``: quintic spline, four times differentiable, so that steps of high order hardly see its knots (cubic
        for less than six points); ``"smoother"``: of degree seven, six times differentiable, for flights so sensitive
        that they see them; ``"monotone"``: once differentiable, and without a turn that the data do not have (Fritsch,
        Carlson 1980); ``"linear"``.

    Raises
    ------
    PeriluneError
        If the data are not at least three finite points in increasing order.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]
    kind: Literal["smooth", "smoother", "monotone", "linear"] = "smooth"

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            object.__setattr__(self, name, _knots(name, getattr(self, name)))
        good = 3 <= len(self.x) == len(self.y) <= MOST_KNOTS and np.isfinite([*self.x, *self.y]).all()
        if not good or not (np.diff(self.x) > 0).all():
            raise PeriluneError(
                "a table needs as many finite values as knots, and increasing knots",
                got=f"{len(self.x)} knots and {len(self.y)} values",
                expected=f"3 to {MOST_KNOTS} points",
            )
        if self.kind not in (*_SPLINES, "monotone", "linear"):
            expected = "smooth, smoother, monotone or linear"
            raise PeriluneError("unknown kind of table", got=repr(self.kind), expected=expected)

    def __repr__(self) -> str:
        ends = (f"{format_value_range(values, '1')}" for values in (self.x, self.y))
        return f"<Table of {len(self.x)} points, {self.kind}: {' onto '.join(ends)}>"

    @cached_property
    def pieces(self) -> Any:
        """Return coefficients (powers, pieces) of polynomials in x less the left knot, highest power first."""
        from scipy.interpolate import PchipInterpolator, PPoly, make_interp_spline

        x, y = np.array(self.x), np.array(self.y)
        if self.kind == "linear":
            inner = np.array([np.diff(y) / np.diff(x), y[:-1]])
        elif self.kind == "monotone":
            inner = np.asarray(PchipInterpolator(x, y).c)
        else:
            degrees = (_SPLINES[self.kind], 5, 3, 2)
            degree = next(k for k in degrees if k <= _SPLINES[self.kind] and len(x) > k)
            whole = PPoly.from_spline(make_interp_spline(x, y, k=degree))
            inner = np.array([whole(x[:-1], nu) / math.factorial(nu) for nu in range(len(whole.c) - 1, -1, -1)])
        ends = np.zeros((len(inner), 2))
        ends[-1] = y[0], y[-1]
        ends[-2] = inner[-2, 0], np.polyval(np.polyder(inner[:, -1]), x[-1] - x[-2])
        return np.column_stack([ends[:, 0], inner, ends[:, 1]])

    @property
    def knots(self) -> Any:
        """Return the left knot of each of `pieces`; the first piece, before the table, counts from its first knot."""
        return np.array([self.x[0], *self.x])

    @cached_property
    def digest(self) -> str:
        """Return a short hash of the content of the table."""
        return hashlib.sha256(json.dumps([self.x, self.y, self.kind]).encode()).hexdigest()[:16]

    def __call__(self, value: Any) -> Any:
        """Return values at numbers or arrays, real or complex."""
        return self.piece(np.searchsorted(self.x, np.real(value), side="right"), value)

    def piece(self, i: Any, value: Any) -> Any:
        """Return values of its pieces i, wherever the numbers lie; piece 0 lies before the first knot.

        Parameters
        ----------
        i
            Number of the piece for each value, from 0 before the first knot, (...).
        value
            Places, (...).
        """
        return _horner_sum(self.pieces[:, i], value - self.knots[i])

    @property
    def kinks(self) -> tuple[float, ...]:
        """Return the knots where a high derivative jumps: all of them, or the ends of a smooth spline."""
        return (self.x[0], self.x[-1]) if self.is_spline else self.x

    @property
    def is_spline(self) -> bool:
        """Return True if it is smooth between its ends."""
        return self.kind in _SPLINES

    def chosen(self, value: Any, choose: Choose, side: int | None = None) -> Any:
        """Return values by choices between pieces, for symbols; the `side` between two `kinks` goes on beyond them.

        Parameters
        ----------
        value
            Place, a symbol.
        choose
            ``choose(condition, yes, no)`` of the symbols.
        side
            Number of the interval between `kinks`, 0 before the first; None for all pieces.
        """
        first, last = 0, len(self.x)
        if side is not None:
            inner = self.is_spline
            first, last = [(0, 0), (1, last - 1), (last, last)][side] if inner else (side, side)
        return self._chosen(self.pieces, value, choose, first, last)

    def slope(self, value: Any, choose: Choose) -> Any:
        """Return the derivative by choices between pieces; at a knot where it jumps, that of the piece above.

        Parameters
        ----------
        value
            Place, a symbol.
        choose
            ``choose(condition, yes, no)`` of the symbols.
        """
        powers = np.arange(len(self.pieces))[::-1, None]
        return self._chosen((powers * self.pieces)[:-1], value, choose, 0, len(self.x))

    def _chosen(self, pieces: Any, value: Any, choose: Choose, first: int, last: int) -> Any:
        """Evaluate the piece of coefficients `pieces` in which a value lies, of the pieces from `first` to `last`."""
        rows = [[float(v) for v in row] for row in (self.knots, *pieces)]
        found = [row[first] for row in rows]
        for k in range(first + 1, last + 1):
            beyond = value >= self.x[k - 1]
            found = [choose(beyond, row[k], before) for row, before in zip(rows, found, strict=True)]
        return _horner_sum(found[1:], value - found[0])


def _horner_sum(coefficients: Any, s: Any) -> Any:
    total = coefficients[0]
    for c in coefficients[1:]:
        total = total * s + c
    return total


def _evaluate_table(table: Table, value: Any) -> Any:
    return table(value)


NUMERIC = SimpleNamespace(
    **{name: getattr(np, numpy_name) for name, numpy_name in NUMPY_NAMES.items()}, where=np.where, table=_evaluate_table
)
