"""All extremals along one free parameter q: hold q, follow the family of extremals, find where dJ/dq = 0.

Cho et al. 2015 solve for the root of the transversality condition (19) directly; but a root may be a maximum, a
minimum, or not be the best one. Along the family of extremals with q held, the residual of (19) *is* dJ/dq. Its sign
changes are the interior extremals, its slope there tells minimum from maximum of J, and its sign at the bounds tells
whether the bound itself is an extremal (Karush, Kuhn, Tucker).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from perilune.shooting.continuation import Member, follow
from perilune.shooting.function import Shooting
from perilune.shooting.lanes import lanes
from perilune.shooting.rootfind import Root, Watch
from perilune.words.types import Vector


@dataclass(frozen=True, kw_only=True)
class Found:
    """An extremal: its root, the value of q [canonical], its bound (-1, 0, +1), and whether J is least there."""

    root: Root
    value: float
    bound: int
    minimum: bool


@dataclass(frozen=True, kw_only=True)
class HeldFamily:
    """The family of extremals of `shooting` in which free parameter number `index` is held.

    Parameters
    ----------
    shooting, p
        The shooting function and the given parameters, canonical.
    index
        Which free parameter is held.
    """

    shooting: Shooting
    p: Vector
    index: int

    def at_once(self, first: Member, values: Vector) -> list[tuple[float, Vector | None]]:
        """(value, Y) for each value, all lanes started from `first`; None where a lane found no root."""
        together = lanes(self.shooting.conditions, self.index)
        if together is None or len(first.root.y) != len(self.shooting.conditions.unknowns):
            return [(float(v), None) for v in values]
        start = np.tile(first.root.y, (len(values), 1))
        start[:, self.shooting.conditions.free_at.start + self.index] = values
        Y, converged = together.solve(start, self.p, values)
        return [(float(v), y if ok else None) for v, y, ok in zip(values, Y, converged, strict=True)]

    def correct(self, y: Vector, value: float, watch: Watch | None = None) -> Root:
        """Newton with q held at `value`."""
        return self.shooting.root(y, self.p, {self.index: value}, watch)

    def release(self, y: Vector, watch: Watch | None = None) -> Root:
        """Newton with q free: the transversality condition (19) in place of the held value."""
        return self.shooting.root(y, self.p, {}, watch)

    def tangent(self, root: Root, value: float) -> Vector:
        """dY/dq at a root with q held; NaN where the Jacobian is singular."""
        unit = np.zeros(len(root.y))
        unit[self.shooting.conditions.stationarity_at.start + self.index] = 1.0
        try:
            return np.linalg.solve(root.jacobian, unit)
        except np.linalg.LinAlgError:
            return np.full(len(root.y), np.nan)

    def slope(self, root: Root) -> float:
        """dJ/dq at a root with q held."""
        return float(self.shooting.stationarity(root.y, self.p)[self.index])

    def curvature(self, root: Root) -> float:
        """d2J/dq2 along the family at a root of the free system, from its Jacobian."""
        row = self.shooting.conditions.stationarity_at.start + self.index
        at = self.shooting.conditions.free_at.start + self.index
        held = np.array(root.jacobian)
        held[row] = 0.0
        held[row, at] = 1.0
        return float(root.jacobian[row] @ self.tangent(replace(root, jacobian=held), float(root.y[at])))


def scan(
    family: HeldFamily, first: Member, bounds: tuple[float, float], points: int, say: Callable[[str], None]
) -> tuple[list[Found], list[Member]]:
    """Walk from `first` towards both bounds; the extremals met, and the members visited.

    Parameters
    ----------
    first
        A member anywhere within the bounds.
    points
        How many values between the bounds are visited; extremals closer together than two of them may be missed
        unless dJ/dq dips towards zero between them, which is looked at more closely.
    say
        Receives one line about a family that ends before a bound.
    """
    tried = family.at_once(first, np.linspace(*bounds, points))
    below = _chain(family, first, [(v, y) for v, y in tried[::-1] if v < first.value])
    above = _chain(family, first, [(v, y) for v, y in tried if v > first.value])
    members = [*below[::-1], first, *above]
    slopes = [family.slope(m.root) for m in members]
    found = []
    for end, bound, limit in ((0, -1, bounds[0]), (-1, 1, bounds[1])):
        if members[end].value != limit:
            say(f"the family of extremals ends at {members[end].value:.6g}, before {limit:.6g} (canonical)")
        elif slopes[end] * bound < 0:  # J rises into the interior; otherwise the bound is no extremal at all
            found.append(Found(root=members[end].root, value=limit, bound=bound, minimum=True))
    for (a, slope_a), (b, slope_b) in pairwise(zip(members, slopes, strict=True)):
        root = _between(family, a, b, slope_a, slope_b) if slope_a * slope_b < 0 else None
        if root is not None:
            value = float(root.y[family.shooting.conditions.free_at.start + family.index])
            found.append(Found(root=root, value=value, bound=0, minimum=family.curvature(root) > 0))
    return [*found, *_dips(family, members, slopes)], members


def _chain(family: HeldFamily, first: Member, tried: list[tuple[float, Vector | None]]) -> list[Member]:
    """Members outwards from `first`: a lane's root where it continues the branch, else one reached step by step."""
    members, here, stride = [], first, np.inf
    for value, y in tried:
        if y is not None and np.linalg.norm(y - here.root.y) <= 3 * stride + 0.05 * (1 + np.linalg.norm(here.root.y)):
            member = Member(value=value, root=replace(first.root, y=y))
        else:
            origin = Member(value=here.value, root=family.correct(here.root.y, here.value))
            member = next(iter(follow(origin, [value], family.correct, family.tangent)))
            if member is None:
                break
        stride = float(np.linalg.norm(member.root.y - here.root.y))
        members.append(member)
        here = member
    return members


def _between(family: HeldFamily, a: Member, b: Member, slope_a: float, slope_b: float) -> Root | None:
    """The extremal between two members of opposite slope: secant and bisection with q held, then Newton with q free."""
    at = family.shooting.conditions.free_at.start + family.index
    for attempt in range(12):
        share = slope_a / (slope_a - slope_b) if attempt % 3 < 2 else 0.5
        value = a.value + share * (b.value - a.value)
        guess = a.root.y + share * (b.root.y - a.root.y)
        root = family.release(guess)
        if root.converged and a.value <= root.y[at] <= b.value:
            return root
        held = family.correct(guess, value)
        if not held.converged:
            return None
        middle, slope = Member(value=value, root=held), family.slope(held)
        if slope * slope_a > 0:
            a, slope_a = middle, slope
        else:
            b, slope_b = middle, slope
    return None


def _dips(family: HeldFamily, members: list[Member], slopes: list[float]) -> Iterator[Found]:
    """Pairs of extremals between grid points: where |dJ/dq| has a least value without a sign change, look closer."""
    at = family.shooting.conditions.free_at.start + family.index
    for i in range(1, len(members) - 1):
        left, here, right = (slopes[j] for j in (i - 1, i, i + 1))
        if left * here <= 0 or here * right <= 0 or not abs(left) > abs(here) < abs(right):
            continue
        # The parabola through three slopes; only if its vertex comes near zero can two roots hide there.
        x = np.array([members[j].value for j in (i - 1, i, i + 1)])
        c = np.polyfit(x - x[1], [left, here, right], 2)
        vertex = c[2] - c[1] ** 2 / (4 * c[0])
        if vertex * here > 0 and abs(vertex) > 0.5 * abs(here):
            continue
        found: list[float] = []
        for share in (-0.5, 0.5):
            root = family.release(_towards(members, i, share))
            if root.converged and x[0] <= root.y[at] <= x[2] and all(abs(root.y[at] - v) > 1e-7 for v in found):
                found.append(float(root.y[at]))
                yield Found(root=root, value=found[-1], bound=0, minimum=family.curvature(root) > 0)


def _towards(members: list[Member], i: int, share: float) -> Vector:
    """Y a share of the way from member i to its neighbour on that side."""
    other = members[i + (1 if share > 0 else -1)].root.y
    return members[i].root.y + abs(share) * (other - members[i].root.y)
