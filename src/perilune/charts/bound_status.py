"""Bound status of an extremal: traced, so that one text serves a single lane and many.

A side is +1 if a branch holds something at its lower bound, -1 at its upper one, and 0 if it does not hold it.
"""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

#: Canonical: by what a bound, an end, a condition, H or its minimum may be missed, or a multiplier have the other sign.
SLACK = 1e-9


class BoundStatus(NamedTuple):
    """Symbols of one extremal, all canonical.

    Attributes
    ----------
    at, rises
        Values of what can be held, and dJ/d(value), as `Shooting.held_values` has them.
    held
        1 where it is held, at a bound or as a parameter that varies.
    side
        Side at which the branch holds it.
    lower, upper
        Its bounds.
    touched
        Multipliers of contact points.
    """

    at: ca.SX
    rises: ca.SX
    held: ca.SX
    side: ca.SX
    lower: ca.SX
    upper: ca.SX
    touched: ca.SX

    @staticmethod
    def symbols(count: int, touched: int) -> BoundStatus:
        """Return symbols for `count` values that can be held, and `touched` contact points.

        Parameters
        ----------
        count
            Number of free parameters and ranges.
        touched
            Number of contact points.
        """
        names = BoundStatus._fields
        return BoundStatus(*(ca.SX.sym(name, touched if name == "touched" else count) for name in names))

    @property
    def margin(self) -> ca.SX:
        """Return the margin to the border within which its branch answers; below zero beyond it.

        It is the least of three: for what is free the distance to its bounds, for what is held dJ/d(value) into the
        interior, and for each contact point the multiplier by which J would fall if the condition gave way.
        """
        least = ca.SX(ca.inf)
        for i in range(self.at.numel()):
            room = ca.fmin(self.at[i] - self.lower[i], self.upper[i] - self.at[i])
            nearer = ca.logic_and(ca.logic_not(self.held[i] > 0), room < least)  # not NaN, where nothing limits it
            least = ca.if_else(nearer, room, least)
        for multiplier in ca.vertsplit(self.touched) if self.touched.numel() else []:
            least = ca.fmin(least, -multiplier)
        for i in range(self.at.numel()):
            least = ca.if_else(ca.fabs(self.side[i]) > 0, ca.fmin(least, self.side[i] * self.rises[i]), least)
        return least

    @property
    def outside(self) -> tuple[ca.SX, ca.SX]:
        """Return masks of values below their lower bound, and above their upper one; NaN is neither."""
        return self.at < self.lower - SLACK, self.at > self.upper + SLACK

    @property
    def free_outside(self) -> ca.SX:
        """Return 1 if anything that is not held lies beyond a bound."""
        below, above = self.outside
        return ca.mmax(ca.logic_and(ca.logic_not(self.held > 0), ca.logic_or(below, above)))

    def beyond(self, users: NDArray[np.bool_]) -> ca.SX:
        """Return a mask of bounds, user-stated and not held, that it lies beyond: lower ones, then upper ones."""
        free = ca.logic_and(ca.logic_not(self.held > 0), ca.DM(users.astype(float)))
        return ca.vertcat(*(ca.logic_and(free, side) for side in self.outside))

    def short(self, users: NDArray[np.bool_]) -> ca.SX:
        """Return 1 if it is an answer but for a negative arc duration, judged by values only."""
        (below, above), stated, touched = self.outside, ca.DM(users.astype(float)), self.touched > SLACK
        against = ca.vertcat(ca.logic_and(ca.logic_or(below, above), stated), touched)
        arc = ca.mmax(ca.logic_and(below, 1 - stated))
        return ca.logic_and(arc, ca.logic_not(ca.mmax(against)))

    def within(self) -> BoundStatus:
        """Return the status with all values within their bounds."""
        return self._replace(at=ca.fmin(ca.fmax(self.at, self.lower), self.upper))


def conjunction(*conditions: ca.SX) -> ca.SX:
    """Return the logical conjunction of conditions."""
    return reduce(ca.logic_and, conditions)
