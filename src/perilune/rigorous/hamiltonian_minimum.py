"""Proof that a control is the only minimiser of H where no formula says so: boxes cover all others.

On a piece of the flight let W be balls around the control, and B a box of others. B holds no other minimum if

- H(B) > H(W), by their enclosures, or by the slopes in the box around both: the mean value theorem;
- some dH/du does not vanish in B, and B does not lie at the bound to which H falls (else its face there is left);
- H is strictly convex in the box around both, as the control itself is stationary, or H rises from the bound it is on.

Boxes are halved until one of these is seen, and pieces of the flight where boxes have become too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement
from typing import Any

from flint import arb, arb_mat, ctx

from perilune.rigorous.enclosure_step import EnclosedStep
from perilune.rigorous.equations import CanonicalArc
from perilune.rigorous.taylor import Ball, TaylorProgram

_BITS = 80
_BOXES = 4000  # of a piece of the flight
_DEEPEST = 12  # halvings of a step
_NARROWEST = 2.0**-24  # of the range of a control
Box = list[Ball]


class HamiltonianMinimum:
    """The scalars of an arc, and H as a function of them."""

    def __init__(self, arc: CanonicalArc) -> None:
        graph, names = arc.graph, [scalar.control.name for scalar in arc.scalars]
        keys = [("u", name) for name in names]
        gradient = graph.gradient(arc.reduced, keys)
        self._pairs = list(combinations_with_replacement(range(len(keys)), 2))
        curvature = [graph.gradient(gradient[i], [keys[j]])[0] for i, j in self._pairs]
        self._slopes = TaylorProgram(graph, [*arc.keys, *keys], [*gradient, arc.reduced])
        self._all = TaylorProgram(graph, [*arc.keys, *keys], [*gradient, *curvature])
        self._controls = TaylorProgram(graph, arc.keys, [scalar.value for scalar in arc.scalars])
        limits = [limit for scalar in arc.scalars for limit in scalar.limits]
        self.bounded = all(limit is not None for limit in limits)
        self._limits = TaylorProgram(graph, arc.keys, [limit for limit in limits if limit is not None])
        self._count, self._regimes = len(keys), [scalar.regime for scalar in arc.scalars]

    def unproved_time(self, steps: Sequence[EnclosedStep]) -> float | None:
        """A time [s] of the arc at which it is not seen that the control is the only minimum; None where it always is.

        A control that is on a bound has to have been seen to be the least next to it (`limits`).
        """
        with ctx.workprec(_BITS):
            for step in steps:
                waiting = [(0.0, 1.0, 0)]
                while waiting:
                    a, b, depth = waiting.pop()
                    span = step.length * arb(a).union(arb(b))
                    if self._only(step.at(span)):
                        continue
                    if depth == _DEEPEST:
                        return float((step.begin + span).mid())
                    waiting += [(a, (a + b) / 2, depth + 1), ((a + b) / 2, b, depth + 1)]
        return None

    def _only(self, z: Sequence[Ball]) -> bool:
        """Return True if no other control is as good, for all z of a box."""
        W, limits = self._controls.values(z), self._limits.values(z)
        low, high = limits[::2], limits[1::2]
        waiting = [[a.union(b) for a, b in zip(low, high, strict=True)]]
        least = [_NARROWEST * float((b - a).abs_upper()) for a, b in zip(low, high, strict=True)]
        for _ in range(_BOXES):
            if not waiting:
                return True
            left = self._left(z, waiting.pop(), W, low, high)
            if left is None:
                continue
            widths = [2 * float(b.rad()) / max(narrow, 1e-300) for b, narrow in zip(left, least, strict=True)]
            i = max(range(self._count), key=widths.__getitem__)
            if widths[i] <= 1.0:
                return False
            for part in (left[i].lower().union(left[i].mid()), left[i].mid().union(left[i].upper())):
                waiting.append([*left[:i], part, *left[i + 1 :]])
        return False

    def _left(self, z: Sequence[Ball], B: Box, W: Box, low: Box, high: Box) -> Box | None:
        """Return the part of a box that may hold another minimum; None where there is none."""
        B, other = list(B), list[int]()  # in which entries it may differ from the control
        *slopes, H = self._slopes.values([*z, *B])
        if H > self._slopes.values([*z, *W])[-1]:
            return None
        for i, slope in enumerate(slopes):
            side = "lower" if slope > 0 else "upper" if slope < 0 else ""
            bound = (low if slope > 0 else high)[i]
            if (side == "lower" and B[i] > bound) or (side == "upper" and B[i] < bound):
                return None
            if side:
                B[i] = bound
            if not side or side != self._regimes[i]:
                other.append(i)
        around = [a.union(b) for a, b in zip(B, W, strict=True)]
        found = self._all.values([*z, *around])
        if sum((found[i] * (B[i] - W[i]) for i in other), arb(0)) > 0:
            return None
        at = dict(zip(self._pairs, found[self._count :], strict=True))
        form = [[at[min(i, j), max(i, j)] for j in other] for i in other]
        return None if not other or positive_definite(arb_mat(form)) else B


def positive_definite(form: Any) -> bool:
    """Return True if every symmetric matrix in these balls is positive definite, by its elimination's pivots."""
    rows = form.tolist()
    for k in range(len(rows)):
        if not rows[k][k] > 0:
            return False
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return True
