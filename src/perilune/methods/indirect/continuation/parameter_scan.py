"""Scan of one free parameter q: hold q, continue the family of extremals, find where dJ/dq = 0.

Cho et al. 2015 solve for the root of the transversality condition (19) directly; but a root may be a maximum, a
minimum, or dominated by another. Along the family of extremals with q held, the residual of (19) *is* dJ/dq. Its sign
changes are the interior extremals, its slope there distinguishes minimum from maximum of J, and its sign at the bounds
shows whether the bound itself is an extremal (Karush, Kuhn, Tucker).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from perilune.core import Matrix, Vector, Watch, ignore_events
from perilune.shooting import ActiveSetBounds, Member, Root, Roots, Shooting, follow_family

_HALVINGS = 18  # of a step along a family: where a flight becomes short its costates grow a hundredfold in a step
_ATTEMPTS = 24  # at an extremal between two members: from 1 mm over the site dJ/dq is a step of some cm/s in 50 m/s


@dataclass(frozen=True, kw_only=True)
class ExtremalRoot:
    """An extremal: its root, with its active bounds, and whether J has a minimum there."""

    root: Root
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
    limits
        Limits that the members keep; those of the held parameter are infinite.
    keeps
        Whether a root has its free parameters within their bounds: no flight ends before it begins.
    watch
        Receives what Newton's method reports.
    """

    shooting: Shooting
    p: Vector
    index: int
    limits: ActiveSetBounds
    keeps: Callable[[Root], bool]
    watch: Watch = ignore_events

    def held(self, Y: Matrix, values: Vector, like: Root) -> Roots:
        """Solve in lanes with q held at `values`; the initial active set is otherwise that of `like`.

        Parameters
        ----------
        Y
            Initial unknowns, shape (lanes, unknowns), canonical.
        values
            Values of q, shape (lanes,), canonical.
        like
            A root near by, from whose active set each lane begins.
        """
        choices = np.tile(like.choice, (len(values), 1))
        self.shooting.plan.hold(choices, self.index, values)
        return self.limits.solve(self.shooting, Y, self.p, choices, self.watch)

    def released(self, Y: Matrix, like: Root) -> Roots:
        """Solve in lanes with q free: the transversality condition (19) in place of the held value.

        Parameters
        ----------
        Y
            Initial unknowns, shape (lanes, unknowns), canonical.
        like
            A root near by, from whose active set each lane begins, but for q.
        """
        choice = like.choice.copy()
        choice[[self.index, self.shooting.plan.held + self.index]] = 0.0
        return self.limits.solve(self.shooting, Y, self.p, np.tile(choice, (len(Y), 1)), self.watch)

    def value(self, root: Root) -> float:
        """Return q at a root."""
        return float(root.y[self.shooting.conditions.free_at.start + self.index])

    def slope(self, root: Root) -> float:
        """Return dJ/dq at a root with q held."""
        return float(root.slopes[self.index])

    def reach(self, here: Member, target: float) -> Member | None:
        """Follow the family to the member at another value, step by step.

        Parameters
        ----------
        here
            Member to start from.
        target
            Value of q to reach, canonical.

        Returns
        -------
        Member or None
            None if Newton's method fails on the way, with steps halved `_HALVINGS` times.
        """

        def correct(y: Vector, value: float) -> Root:
            return self.held(y[None], np.array([value]), here.root)[0]

        def tangent(root: Root, value: float) -> Vector:
            return self.shooting.tangent(root, self.index)

        return next(iter(follow_family(here, [target], correct, tangent, halvings=_HALVINGS)))


def scan_family(
    family: HeldFamily, first: Member, bounds: tuple[float, float], points: int
) -> tuple[list[ExtremalRoot], list[Member]]:
    """Continue from `first` towards both bounds; return the extremals found, and the members visited.

    Parameters
    ----------
    family
        Extremals with one free parameter held.
    first
        A member anywhere within the bounds.
    bounds
        Least and greatest value of the parameter, canonical.
    points
        How many values between the bounds are visited; extremals closer together than two of them may be missed
        unless dJ/dq dips towards zero between them, which is looked at more closely.
    """
    values = np.linspace(*bounds, points)
    tried = list(zip(values.tolist(), family.held(np.tile(first.root.y, (points, 1)), values, first.root), strict=True))
    below = _connected_members(family, first, [pair for pair in tried[::-1] if pair[0] < first.value])
    above = _connected_members(family, first, [pair for pair in tried if pair[0] > first.value])
    members = [*below[::-1], first, *above]
    slopes = [family.slope(m.root) for m in members]
    found = []
    for end, bound, limit in ((0, -1, bounds[0]), (-1, 1, bounds[1])):
        if members[end].value != limit:
            family.watch(f"the family of extremals ends at {members[end].value:.6g}, before {limit:.6g} (canonical)")
        elif slopes[end] * bound < 0:  # J rises into the interior; otherwise the bound is no extremal at all
            found.append(ExtremalRoot(root=members[end].root, minimum=True))
    brackets = [
        _Bracket(a, b, slope_a, slope_b)
        for (a, slope_a), (b, slope_b) in pairwise(zip(members, slopes, strict=True))
        if slope_a * slope_b < 0
    ]
    inner = [*_solve_brackets(family, brackets), *_extremal_pairs(family, members, slopes)]
    for root in inner:
        found.append(ExtremalRoot(root=root, minimum=family.shooting.curvature(root, family.index) > 0))
    return found, members


def _connected_members(family: HeldFamily, first: Member, tried: list[tuple[float, Root]]) -> list[Member]:
    """Return members outwards from `first`: a lane's root where it continues the branch, else one by single steps."""
    members, here, stride = [], first, np.inf
    for value, root in tried:
        near = 3 * stride + 0.05 * (1 + np.linalg.norm(here.root.y))
        if root.converged and np.linalg.norm(root.y - here.root.y) <= near:
            member = Member(value=value, root=root)
        else:
            member = family.reach(here, value)
            if member is None:
                break
        stride = float(np.linalg.norm(member.root.y - here.root.y))
        members.append(member)
        here = member
    return members


@dataclass
class _Bracket:
    """Two members of a family with slopes of opposite sign."""

    a: Member
    b: Member
    slope_a: float
    slope_b: float

    def guess(self, share: float) -> tuple[Vector, float]:
        """Return Y and the value a share of the way from a to b."""
        y = self.a.root.y + share * (self.b.root.y - self.a.root.y)
        return y, self.a.value + share * (self.b.value - self.a.value)

    def middle(self, family: HeldFamily, root: Root, value: float) -> Member | None:
        """Return the member at a value between: the root where there is one, else reached from either end.

        From a straight line between two members Newton does not find it where the costates grow a hundredfold from one
        to the other, as they do where a flight from low over the site becomes a short one.
        """
        if root.converged and family.keeps(root):
            return Member(value=value, root=root)
        return family.reach(self.a, value) or family.reach(self.b, value)

    def narrow(self, middle: Member, slope: float) -> None:
        """Replace the end whose sign a member between has by that member."""
        if slope * self.slope_a > 0:
            self.a, self.slope_a = middle, slope
        else:
            self.b, self.slope_b = middle, slope


def _solve_brackets(family: HeldFamily, brackets: list[_Bracket]) -> list[Root]:
    """Solve for the extremals in brackets, all at once.

    By secant and bisection with q held, then by Newton's method with q free.
    """
    found: dict[int, Root] = {}
    left = dict(enumerate(brackets))
    for attempt in range(_ATTEMPTS):
        if not left:
            break
        shares = [b.slope_a / (b.slope_a - b.slope_b) if attempt % 3 < 2 else 0.5 for b in left.values()]
        guesses = [b.guess(share) for b, share in zip(left.values(), shares, strict=True)]
        Y = np.array([y for y, _ in guesses])
        free = family.released(Y, next(iter(left.values())).a.root)
        held: Roots | None = None
        for lane, (number, bracket) in enumerate(list(left.items())):
            root = free[lane]
            within = bracket.a.value <= family.value(root) <= bracket.b.value
            if root.converged and within and family.keeps(root):
                found[number] = root
                del left[number]
                continue
            if held is None:
                held = family.held(Y, np.array([value for _, value in guesses]), bracket.a.root)
            middle = bracket.middle(family, held[lane], guesses[lane][1])
            if middle is None:
                del left[number]
                continue
            bracket.narrow(middle, family.slope(middle.root))
    return [found[number] for number in sorted(found)]


def _extremal_pairs(family: HeldFamily, members: list[Member], slopes: list[float]) -> list[Root]:
    """Look closer where |dJ/dq| has a minimum without a sign change: for pairs of extremals between grid points."""
    starts, ranges = [], []
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
        starts += [0.5 * (members[i].root.y + members[j].root.y) for j in (i - 1, i + 1)]
        ranges += [(x[0], x[2])] * 2
    found: list[Root] = []
    if starts:
        for root, (low, high) in zip(family.released(np.array(starts), members[0].root), ranges, strict=True):
            new = all(abs(family.value(root) - family.value(other)) > 1e-7 for other in found)
            if root.converged and low <= family.value(root) <= high and new and family.keeps(root):
                found.append(root)
    return found


def distinct_roots(roots: Iterable[Root]) -> list[Root]:
    """Return different extremals, best first."""
    kept: list[Root] = []
    for root in roots:
        if not any(same_extremal(root, other) for other in kept):
            kept.append(root)
    return sorted(kept, key=lambda root: root.cost)


def same_extremal(one: Root, other: Root) -> bool:
    """Return True if two roots are one extremal: the same, or members of one continuum with the same J.

    Parameters
    ----------
    one, other
        Roots of the same shooting function.
    """
    if same_vector(one.y, other.y, 1e-6):
        return True
    alike = abs(one.cost - other.cost) <= 1e-8 * (1.0 + abs(other.cost))
    return alike and one.open_directions > 0 and other.open_directions > 0


def unknown_extremals(found: list[ExtremalRoot], known: list[ExtremalRoot]) -> list[ExtremalRoot]:
    """Return those of the extremals found that are not known yet.

    Parameters
    ----------
    found
        Extremals to filter; they are compared by the unknowns of their roots, canonical.
    known
        Extremals that are not to be returned again.
    """
    return [f for f in found if not any(same_vector(f.root.y, other.root.y, 1e-6) for other in known)]


def same_vector(one: Vector, other: Vector, tolerance: float) -> bool:
    """Return True if two vectors of unknowns are one root.

    Parameters
    ----------
    one, other
        Unknowns, (n,), canonical.
    tolerance
        Largest difference of a component, relative to 1 + max|other|.
    """
    return bool(np.abs(one - other).max() <= tolerance * (1.0 + np.abs(other).max()))
