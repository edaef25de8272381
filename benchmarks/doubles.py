"""Balls whose centre and radius are doubles, many at once: what a cover by thousands of boxes is computed with.

One `Doubles` holds a ball for each lane, as two arrays. Every operation encloses the exact result for all numbers of
its operands: what rounding to nearest may lose is added to the radius, and radii are computed a little too large. A
lane that has no value, as one over a ball with zero in it, is not a number from then on, and no comparison with it is
true.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from flint import arb

from perilune.core import Stack

# Of a result rounded to nearest 2^-53 is lost at most, and of a radius of up to eight operations not 2^-49.
_LOST, _UP, _TINY = 2.0**-52, 1 + 2.0**-49, 1e-300  # the last covers what underflows


class Doubles:
    """Balls in lanes.

    Parameters
    ----------
    c, r
        Centres and radii, numbers or arrays of one shape.
    """

    __slots__ = ("c", "r")

    def __init__(self, c: Any, r: Any = 0.0) -> None:
        self.c, self.r = c, r

    def __repr__(self) -> str:
        return f"<{self.c} +/- {self.r}>"

    def __add__(self, other: Any) -> Doubles:
        b = ball(other)
        c = self.c + b.c
        return Doubles(c, (self.r + b.r + np.abs(c) * _LOST) * _UP)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Doubles:
        b = ball(other)
        c = self.c - b.c
        return Doubles(c, (self.r + b.r + np.abs(c) * _LOST) * _UP)

    def __rsub__(self, other: Any) -> Doubles:
        return ball(other) - self

    def __mul__(self, other: Any) -> Doubles:
        b = ball(other)
        c = self.c * b.c
        r = np.abs(self.c) * b.r + self.r * (np.abs(b.c) + b.r) + np.abs(c) * _LOST
        return Doubles(c, r * _UP + _TINY)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Doubles:
        return self * ball(other).inverse()

    def __rtruediv__(self, other: Any) -> Doubles:
        return ball(other) * self.inverse()

    def __neg__(self) -> Doubles:
        return Doubles(-self.c, self.r)

    def __getitem__(self, lanes: Any) -> Doubles:
        return Doubles(self.c[lanes], self.r[lanes])

    def inverse(self) -> Doubles:
        """1 over it: the ends of [c - r, c + r] inverted."""
        with np.errstate(all="ignore"):
            product = (self.c - self.r) * (self.c + self.r)
            fine = product > 0
            c, r = self.c / product, self.r / product
            return Doubles(np.where(fine, c, np.nan), np.where(fine, (r + np.abs(c) * 4 * _LOST) * _UP + _TINY, np.nan))

    def sqrt(self) -> Doubles:
        """Its root, where it is positive."""
        with np.errstate(all="ignore"):
            low, high = self.low, self.high
            a, b = np.sqrt(low), np.sqrt(high)
            c = 0.5 * (a + b)
            fine = low > 0
            return Doubles(np.where(fine, c, np.nan), np.where(fine, (0.5 * (b - a) + b * 4 * _LOST) * _UP, np.nan))

    @property
    def low(self) -> Stack:
        """No number of it is smaller."""
        return _down(self.c - self.r)

    @property
    def high(self) -> Stack:
        """No number of it is larger."""
        return -_down(-self.c - self.r)

    @property
    def size(self) -> Stack:
        """No number of it is farther from zero."""
        return (np.abs(self.c) + self.r) * _UP

    def wider(self, by: Any) -> Doubles:
        """It with a larger radius."""
        return Doubles(self.c, (self.r + by) * _UP)

    def holds(self, other: Doubles) -> Stack:
        """In which lanes another lies in it."""
        return np.abs(other.c - self.c) * _UP + other.r * _UP <= self.r

    def excludes(self, value: float) -> Stack:
        """In which lanes a number does not lie in it."""
        return (self.low > value) | (self.high < value)


def _down(value: Any) -> Any:
    return value - np.abs(value) * _LOST - _TINY


def ball(value: Any) -> Doubles:
    """A ball around a number: FLINT's, a double, or a ball itself."""
    if isinstance(value, Doubles):
        return value
    if not isinstance(value, arb):
        return Doubles(float(value) if isinstance(value, int) else value)
    centre = float(value.mid())
    return Doubles(centre, float((value - arb(centre)).abs_upper()) * _UP)


def between(low: Any, high: Any) -> Doubles:
    """Balls that hold everything from `low` to `high`."""
    c = 0.5 * (low + high)
    return Doubles(c, np.maximum(high - c, c - low) * _UP + np.abs(c) * _LOST)


def joined(a: Doubles, b: Doubles) -> Doubles:
    """Balls that hold both."""
    return between(np.minimum(a.low, b.low), np.maximum(a.high, b.high))
