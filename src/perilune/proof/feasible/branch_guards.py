"""Guards of the physics: each comparison in it, found by computing with numbers that record their comparisons.

``xp.where(a < b, ...)``, ``xp.fmin``, ``xp.fmax``, ``xp.fabs`` and the knots of a table that bends there are decided by
the sign of a difference, a *guard*. The physics is a formula without branches, so it makes its comparisons always in
the same order, and the k-th of them is the k-th guard wherever it is evaluated. A guard may also be *held*: its
comparisons are answered as on one side, which continues the physics of that side smoothly across.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import COMPLEX, Table, stack_broadcast
from perilune.problem import Phase

_COMPARISONS = {np.less, np.less_equal, np.greater, np.greater_equal}


class ComparisonWatch:
    """Notes the differences that are compared, and answers: truly, or as `held` says, one answer for each guard."""

    def __init__(self, held: Any = None) -> None:
        self.held, self.differences, self.answers = held, [], []

    def decide(self, difference: Any, truth: Any) -> Any:
        """The answer to the next comparison.

        Parameters
        ----------
        difference
            Left side of the comparison minus its right side, a number or an array, possibly complex.
        truth
            Result of the comparison, with the same shape; it is returned unless answers are given.
        """
        truth = truth if self.held is None else np.broadcast_to(self.held[len(self.answers)], np.shape(truth))
        self.differences.append(difference)
        self.answers.append(truth)
        return truth


def _arithmetic(operation: Callable[[Any, Any], Any]) -> tuple[Callable[..., Watched], Callable[..., Watched]]:
    """An operator and its reflection, done on the plain values at once: a ufunc's dispatch takes ten times as long."""

    def forward(self: Watched, other: Any) -> Watched:
        return Watched(operation(self.value, other.value if isinstance(other, Watched) else other), self.watch)

    def reflected(self: Watched, other: Any) -> Watched:
        return Watched(operation(other, self.value), self.watch)

    return forward, reflected


class Watched(np.lib.mixins.NDArrayOperatorsMixin):
    """An array that is watched, with everything computed from it."""

    __slots__ = "value", "watch"

    def __init__(self, value: Any, watch: ComparisonWatch) -> None:
        self.value, self.watch = value, watch

    __add__, __radd__ = _arithmetic(operator.add)
    __sub__, __rsub__ = _arithmetic(operator.sub)
    __mul__, __rmul__ = _arithmetic(operator.mul)
    __truediv__, __rtruediv__ = _arithmetic(operator.truediv)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **keywords: Any) -> Any:
        if method != "__call__":
            return NotImplemented
        if ufunc is np.absolute:
            return _fabs(self)
        keywords.pop("out", None)  # of ``a -= b``: a name that is bound to another array
        plain = [_plain_value(value) for value in inputs]
        if ufunc in _COMPARISONS:
            return self.watch.decide(plain[0] - plain[1], ufunc(np.real(plain[0]), np.real(plain[1])))
        return Watched(ufunc(*plain, **keywords), self.watch)


def _plain_value(value: Any) -> Any:
    return value.value if isinstance(value, Watched) else value


def _watched_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of the namespace `xp` for watched numbers, its first argument with the watch where it has one."""

    def watching(*values: Any) -> Any:
        watch = next((value.watch for value in values if isinstance(value, Watched)), None)
        plain = function(watch, *(_plain_value(value) for value in values))
        return plain if watch is None else Watched(plain, watch)

    return watching


def _decide(watch: ComparisonWatch | None, difference: Any, truth: Any) -> Any:
    return truth if watch is None else watch.decide(difference, truth)


def _watched_table(watch: ComparisonWatch | None, table: Table, value: Any) -> Any:
    if watch is None:
        return table(value)
    # A choice at each of its kinks; between the two of a smooth one it is read as it comes.
    beyond = sum(watch.decide(value - knot, np.real(value) >= knot) * 1 for knot in table.kinks)
    if table.is_spline:
        last = len(table.x)
        inner = np.clip(np.searchsorted(table.x, np.real(value), side="right"), 1, last - 1)
        beyond = np.choose(beyond, [0, inner, last])
    return table.piece(beyond, value)


def _choose(watch: ComparisonWatch | None, difference: Any, truth: Any, yes: Any, no: Any) -> Any:
    return np.where(_decide(watch, difference, truth), yes, no)


_fabs = _watched_function(lambda watch, x: _choose(watch, x, np.real(x) < 0, -np.asarray(x), x))
WATCHING = SimpleNamespace(
    **{
        **vars(COMPLEX),
        "atan2": _watched_function(lambda _, y, x: COMPLEX.atan2(y, x)),
        "fabs": _fabs,
        "table": _watched_function(_watched_table),
    },
)
WATCHING.where = _watched_function(lambda _, truth, yes, no: np.where(truth, yes, no))
WATCHING.fmin = _watched_function(lambda watch, a, b: _choose(watch, a - b, np.real(a) <= np.real(b), a, b))
WATCHING.fmax = _watched_function(lambda watch, a, b: _choose(watch, a - b, np.real(a) >= np.real(b), a, b))


def watched_rates(phase: Phase, x: Any, u: Any, p: Any, held: Any = None) -> tuple[Any, Any, Any]:
    """Rates of a phase, complex-safe, the differences its guards compare, and the answers.

    Parameters
    ----------
    phase, x, u, p
        As for `Arc.rates`: x (n, ...) and u (k, ...).
    held
        One answer for each guard, broadcast; None answers truly.

    Returns
    -------
    Arrays (n, ...), (guards, ...) and (guards, ...).
    """
    watch, shape = ComparisonWatch(held), np.broadcast_shapes(np.shape(x)[1:], np.shape(u)[1:])
    values = phase.rates([Watched(v, watch) for v in x], [Watched(v, watch) for v in u], p, WATCHING)
    return (
        stack_broadcast([_plain_value(v) for v in values], shape),
        stack_broadcast(watch.differences, shape),
        stack_broadcast(watch.answers, shape, bool),
    )
