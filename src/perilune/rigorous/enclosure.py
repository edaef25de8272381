"""Integration of all arcs of a boundary value problem: plainly for Newton's method, or in enclosures.

Where a box of unknowns is flown, each state is enclosed twice: by its own flight, and by the mean value theorem from
the flight of the box's centre, z(y) = z(c) + (dz/dy)(box) (y - c), in a frame that goes with the flow; what both allow
is smaller.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from flint import arb, arb_mat

from perilune.rigorous.boundary_value_problem import BoundaryProblem, matrix_columns
from perilune.rigorous.enclosure_step import EnclosedStep, NotEnclosed, enclose_step, horner_value, taylor_orders
from perilune.rigorous.equations import CanonicalArc
from perilune.rigorous.taylor import Ball

_LONGEST = 0.5  # of a step that the size of the last coefficients suggests, at most this part of the radius
_SHORTEST = 2.0**-5  # step that is tried, of the shortest of a grid
Grid = Sequence[Sequence[float]]  # for each arc the times where its steps begin


@dataclass(frozen=True, kw_only=True, eq=False)
class EnclosedFlight:
    """Propagated arcs of a boundary value problem.

    Attributes
    ----------
    ends, tangents
        z at the end of each arc, and its derivative by y (None where not requested).
    nodes
        z where each step begins, and at the end.
    steps
        Of each arc; none where nothing was proved.
    centre
        z at the end of each arc of the centre of the box that was flown.
    """

    ends: list[list[Ball]]
    tangents: list[Any]
    nodes: list[list[list[Ball]]]
    steps: list[list[EnclosedStep]]
    centre: list[list[Ball]]


def ball_centres(values: Sequence[Ball]) -> list[Ball]:
    """The centres of balls."""
    return [value.mid() for value in values]


def enclose_flight(
    boundary: BoundaryProblem, y: Sequence[Ball], grid: Grid, order: int, finest: float = math.inf
) -> EnclosedFlight:
    """Fly all y of a box, proved.

    Parameters
    ----------
    boundary
        Arcs, starts and durations.
    y
        The unknowns.
    grid, order
        Where the steps begin, and the order of their remainders.
    finest
        Where it is finite, steps keep their remainders below this, relative to the size of each entry.

    Raises
    ------
    NotEnclosed
        If a step is not enclosed.
    """
    found = EnclosedFlight(ends=[], tangents=[], nodes=[], steps=[], centre=[])
    centre, aside = ball_centres(y), ball_column([value - value.mid() for value in y])
    z, near, D = list[Ball](), list[Ball](), arb_mat(0, 0)
    for i, arc in enumerate(boundary.arcs):
        near = boundary.starts[i].values(centre, near if i else [])
        z, D = _arc_start(boundary, i, y, z, D)
        frame = _ParallelepipedFrame(near, D)
        (duration,), (by_y,) = boundary.durations[i].slopes(y)
        (lasting,) = boundary.durations[i].values(centre)
        nodes, steps, unit = [z], list[EnclosedStep](), ball_identity(len(z))
        begin, pace = 0.0, _StepLengths(grid[i], float(duration), finest)
        while begin is not None:
            following = pace.following(begin)
            last = following is None
            length = (duration if last else arb(following)) - arb(begin)
            around = [a.union(m) for a, m in zip(z, frame.middle, strict=True)]
            try:
                direct, moved, proved = enclose_step(arc, around, unit, arb(begin), length, order)
            except NotEnclosed:
                if not pace.slower(float(length)):
                    raise
                continue
            if not pace.accept(float(length), proved):
                continue
            own = lasting - arb(begin) if last else length
            frame.go(taylor_orders(arc, frame.middle, None, order - 1)[0], proved.remainder, own, moved)
            by_length = arc_rates(arc, direct) * by_y if last else arb_mat(len(z), len(y))
            near_by = frame.all(aside, by_length)
            if not all(a.overlaps(b) for a, b in zip(direct, near_by, strict=True)):
                raise NotEnclosed("two enclosures of the same flight exclude each other: an error of the prover")
            z = [a.intersection(b) for a, b in zip(direct, near_by, strict=True)]
            nodes.append(z)
            steps.append(proved)
            D = frame.tangents + by_length
            begin = following
        near = frame.near
        found.ends.append(z)
        found.tangents.append(D)
        found.nodes.append(nodes)
        found.steps.append(steps)
        found.centre.append(near)
    return found


class _StepLengths:
    """Lengths of steps: those of a grid, or as long as their remainders allow.

    Parameters
    ----------
    begins, lasting
        Where the steps of the grid begin, and how long the arc lasts.
    finest
        Largest remainder relative to the size of each entry; infinite where the grid is to be kept.
    """

    def __init__(self, begins: Sequence[float], lasting: float, finest: float) -> None:
        self._begins, self._lasting, self._finest = begins, lasting, finest
        lengths = [b - a for a, b in pairwise([*begins, lasting])]
        self._longest, self._shortest = lengths[0], min(lengths) * _SHORTEST

    def following(self, begin: float) -> float | None:
        """Return where a step ends; None where that is the end of the arc."""
        if self._finest == math.inf:
            return next((time for time in self._begins if time > begin), None)
        return begin + self._longest if self._lasting - begin > self._longest else None

    def slower(self, length: float, by: float = 0.5) -> bool:
        """Shorten the steps after one that failed; return True if it may be tried again."""
        self._longest = by * length
        return self._shortest < self._longest and self._finest < math.inf

    def accept(self, length: float, proved: EnclosedStep) -> bool:
        """Return True if the remainder of a step is small enough, or cannot be made so; adapt the length of steps."""
        order = len(proved.polynomial[0])
        lost = [float((own * proved.length**order).abs_upper()) for own in proved.remainder]
        sizes = [float(value.abs_upper()) for value in proved.at(arb(0).union(proved.length))]
        most = max((own / size for own, size in zip(lost, sizes, strict=True) if size), default=0.0)
        by = 0.9 * (self._finest / most) ** (1 / order) if most else 2.0
        if most > self._finest and self.slower(length, max(by, 0.25)):
            return False
        self._longest = length * min(by, 2.0)
        return True


class _ParallelepipedFrame:
    """All z = m + B (S (y - c) + r), so that rounding is not blown up from step to step.

    Over a step with the tangents P what begins at m + B s ends in z(m) + P B s, by the mean value theorem. B becomes
    the middle of P B, so that B^-1 P B, in which everything uncertain is, is about 1 (the parallelepiped method, Lohner
    1988; numbers have digits enough for a B that is nearly singular).

    Parameters
    ----------
    near, tangents
        z(c), and dz/dy, where an arc begins.
    """

    def __init__(self, near: Sequence[Ball], tangents: Any) -> None:
        self.middle = ball_centres(near)
        self._B, self._S = ball_identity(len(near)), tangents
        self._r = ball_column([a - b for a, b in zip(near, self.middle, strict=True)])

    def go(self, polynomial: Sequence[Sequence[Ball]], remainder: Sequence[Ball], length: Ball, moved: Any) -> None:
        """A step on, by the polynomial from the middle, its remainder, and the tangents of the step."""
        order = len(polynomial[0])
        end = [horner_value(c, length) + last * length**order for c, last in zip(polynomial, remainder, strict=True)]
        together = moved * self._B
        B = together.mid()
        back = _inverted(B)
        M = back * together
        if not all(abs(M[i, i] - 1) < 1 for i in range(len(end))):
            raise NotEnclosed("the flights of a box diverge too far")
        self.middle = ball_centres(end)
        self._r = M * self._r + back * ball_column([a - b for a, b in zip(end, self.middle, strict=True)])
        self._S, self._B = M * self._S, B

    @property
    def near(self) -> list[Ball]:
        """z(c)."""
        return [m + off for m, off in zip(self.middle, (self._B * self._r).entries(), strict=True)]

    @property
    def tangents(self) -> Any:
        """dz/dy."""
        return self._B * self._S

    def all(self, aside: Any, more: Any) -> list[Ball]:
        """z of a whole box, `aside` from its centre; `more` is what else y moves."""
        off = self._B * (self._S * aside + self._r) + more * aside
        return [m + own for m, own in zip(self.middle, off.entries(), strict=True)]


def _inverted(B: Any) -> Any:
    try:
        return B.inv()
    except ZeroDivisionError:
        raise NotEnclosed("the tangents of a step are singular at this precision") from None


def fly_unproved(
    boundary: BoundaryProblem, y: Sequence[Ball], order: int, tolerance: float, grid: Grid | None = None
) -> tuple[EnclosedFlight, list[list[float]]]:
    """Fly one y in many digits, with nothing proved: for Newton's method. Returns the flight, and the grid it chose.

    Parameters
    ----------
    boundary
        Arcs, starts and durations.
    y
        The unknowns.
    order, tolerance
        Of the Taylor series, and of their last terms relative to the size of each entry.
    grid
        Where the steps of each arc begin [s]; chosen where None.
    """
    found, chosen = EnclosedFlight(ends=[], tangents=[], nodes=[], steps=[], centre=[]), list[list[float]]()
    z, D = list[Ball](), arb_mat(0, 0)
    for i, arc in enumerate(boundary.arcs):
        z, D = _arc_start(boundary, i, y, z, D)
        V = matrix_columns(boundary.columns[i], D)
        (duration,), (by_y,) = boundary.durations[i].slopes(y)
        begins, nodes, sizes = list[float](), [z], [0.0] * len(z)
        known = None if grid is None else grid[i]
        following: float | None = 0.0
        while following is not None:
            begin = following
            begins.append(begin)
            c, tangents = taylor_orders(arc, ball_centres(z), V.mid(), order)
            left = duration - arb(begin)
            if known is not None:
                following = known[len(begins)] if len(begins) < len(known) else None
            else:
                sizes = [max(a, abs(float(own[0]))) for a, own in zip(sizes, c, strict=True)]
                parts = -(-float(left) // _step_length(c, sizes, tolerance))
                following = begin + float(left) / parts if parts > 1 else None
            # Up to the very number at which the next begins: else the first flight is that of another duration.
            length = left if following is None else arb(following) - arb(begin)
            z = ball_centres([horner_value(own, length) for own in c])
            V = horner_value(tangents, length).mid()
            nodes.append(z)
        chosen.append(begins)
        found.ends.append(z)
        found.tangents.append(_slopes_at_arc_end(boundary, i, V, z, by_y))
        found.nodes.append(nodes)
        found.steps.append([])
        D = found.tangents[-1]
    return found, chosen


def _step_length(c: Sequence[Sequence[Ball]], sizes: Sequence[float], tolerance: float) -> float:
    """Return the longest step whose last coefficients are below the tolerance."""
    most = float("inf")
    for own, size in zip(c, sizes, strict=True):
        reference = max(size, 1e-3 * abs(float(own[1])))
        for k in (len(own) - 1, len(own) - 2):
            last = abs(float(own[k]))
            if last > 0 and reference > 0:
                radius = (reference / last) ** (1 / k)
                most = min(most, radius * min(tolerance ** (1 / k), _LONGEST))
    return most


def _arc_start(
    boundary: BoundaryProblem, i: int, y: Sequence[Ball], before: Sequence[Ball], D: Any
) -> tuple[list[Ball], Any]:
    z, (by_y, by_before) = boundary.starts[i].slopes(y, before if i else [])
    return z, by_y + by_before * D if i else by_y


def _slopes_at_arc_end(boundary: BoundaryProblem, i: int, V: Any, z: Sequence[Ball], by_y: Any) -> Any:
    """dz/dy where an arc ends: by what moves its start, and by its duration, whose derivative is `by_y`."""
    D = arc_rates(boundary.arcs[i], z) * by_y
    for at, column in enumerate(boundary.columns[i]):
        for row in range(V.nrows()):
            D[row, column] += V[row, at]
    return D


def arc_rates(arc: CanonicalArc, z: Sequence[Ball]) -> Any:
    """z', as a column.

    Parameters
    ----------
    arc
        Canonical equations of the arc.
    z
        States, constant states and costates, balls [SI].
    """
    return ball_column(arc.plain.values(z))


def ball_column(entries: Sequence[Ball]) -> Any:
    """A matrix of one column."""
    return arb_mat([[entry] for entry in entries])


def ball_identity(size: int) -> Any:
    """The matrix that changes nothing."""
    return arb_mat([[int(i == j) for j in range(size)] for i in range(size)])


def residual(boundary: BoundaryProblem, y: Sequence[Ball], flown: EnclosedFlight) -> list[Ball]:
    """F of the centre of a box that was flown.

    Parameters
    ----------
    boundary
        The boundary value problem.
    y
        Box of the unknowns, balls [SI]; only its centre counts.
    flown
        Its flight, with the ends of the arcs from the centre.
    """
    return boundary.residual.values(ball_centres(y), *flown.centre)


def slopes(boundary: BoundaryProblem, y: Sequence[Ball], flown: EnclosedFlight) -> tuple[list[Ball], Any]:
    """F of a flight, and dF/dy.

    Parameters
    ----------
    boundary, y
        The problem and its unknowns.
    flown
        A flight with tangents.
    """
    values, (total, *others) = boundary.residual.slopes(y, *flown.ends)
    for by_end, D in zip(others, flown.tangents, strict=True):
        total += by_end * D
    return values, total
