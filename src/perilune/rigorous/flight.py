"""All arcs of a boundary value problem flown one after the other: plainly for Newton's method, or in enclosures.

Where a box of unknowns is flown, each state is enclosed twice: by its own flight, and by the mean value theorem from
the flight of the box's centre, z(y) = z(c) + (dz/dy)(box) (y - c); what both allow is smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb, arb_mat

from perilune.rigorous.boundary import BoundaryProblem, matrix
from perilune.rigorous.flow import Step, coefficients, horner, step
from perilune.rigorous.taylor import Ball

_LONGEST = 0.5  # of a step that the size of the last coefficients suggests, at most this part of the radius
Grid = Sequence[Sequence[float]]  # for each arc the times where its steps begin


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """What was flown.

    Attributes
    ----------
    ends, tangents
        z at the end of each arc, and its derivative by y (None where it was not asked for).
    nodes
        z where each step begins, and at the end.
    steps
        Of each arc; none where nothing was proved.
    """

    ends: list[list[Ball]]
    tangents: list[Any]
    nodes: list[list[list[Ball]]]
    steps: list[list[Step]]


def middle(values: Sequence[Ball]) -> list[Ball]:
    """The centres of balls."""
    return [value.mid() for value in values]


def enclosed(
    boundary: BoundaryProblem, y: Sequence[Ball], grid: Grid, order: int, centre: Flight | None = None,
    tangents: bool = True,
) -> Flight:  # fmt: skip
    """Fly all y of a box, proved.

    Parameters
    ----------
    boundary
        Arcs, starts and durations.
    y
        The unknowns.
    grid, order
        Where the steps begin, and the order of their remainders.
    centre
        The flight of the centre of the box, on the same grid.
    tangents
        Whether dz/dy is wanted.

    Raises
    ------
    NotEnclosed
        If a step is not enclosed.
    """
    found = Flight(ends=[], tangents=[], nodes=[], steps=[])
    aside = [value - value.mid() for value in y]
    z, D = list[Ball](), arb_mat(0, 0)
    for i, arc in enumerate(boundary.arcs):
        z, D = _start(boundary, i, y, z, D, tangents)
        V = matrix(boundary.columns[i], D) if tangents else None
        (duration,), (by_y,) = boundary.durations[i].slopes(y)
        nodes, steps = [z], list[Step]()
        own = arb_mat([[aside[j]] for j in boundary.columns[i]])
        for number, begin in enumerate(grid[i]):
            last = number + 1 == len(grid[i])
            length = (duration if last else arb(grid[i][number + 1])) - arb(begin)
            z, V, proved = step(arc, z, V, arb(begin), length, order)
            if last and tangents:
                D = _at_end(boundary, i, V, z, by_y)
            if centre is not None and tangents:
                moved = D * arb_mat([[a] for a in aside]) if last else V * own
                near = centre.nodes[i][number + 1]
                z = [a.intersection(b + c) for a, b, c in zip(z, near, moved.entries(), strict=True)]
            nodes.append(z)
            steps.append(proved)
        found.ends.append(z)
        found.tangents.append(D if tangents else None)
        found.nodes.append(nodes)
        found.steps.append(steps)
    return found


def plainly(
    boundary: BoundaryProblem, y: Sequence[Ball], order: int, tolerance: float, grid: Grid | None = None
) -> tuple[Flight, list[list[float]]]:
    """Fly one y in many digits, with nothing proved: for Newton's method. Returns the flight, and the grid it chose."""
    found, chosen = Flight(ends=[], tangents=[], nodes=[], steps=[]), list[list[float]]()
    z, D = list[Ball](), arb_mat(0, 0)
    for i, arc in enumerate(boundary.arcs):
        z, D = _start(boundary, i, y, z, D, True)
        V = matrix(boundary.columns[i], D)
        (duration,), (by_y,) = boundary.durations[i].slopes(y)
        begins, nodes, sizes = list[float](), [z], [0.0] * len(z)
        known = None if grid is None else grid[i]
        following: float | None = 0.0
        while following is not None:
            begin = following
            begins.append(begin)
            c, tangents = coefficients(arc, middle(z), V.mid(), order)
            left = duration - arb(begin)
            if known is not None:
                following = known[len(begins)] if len(begins) < len(known) else None
            else:
                sizes = [max(a, abs(float(own[0]))) for a, own in zip(sizes, c, strict=True)]
                parts = -(-float(left) // _length(c, sizes, tolerance))
                following = begin + float(left) / parts if parts > 1 else None
            # Up to the very number at which the next begins: else the first flight is that of another duration.
            length = left if following is None else arb(following) - arb(begin)
            z = middle([horner(own, length) for own in c])
            V = horner(tangents, length).mid()
            nodes.append(z)
        chosen.append(begins)
        found.ends.append(z)
        found.tangents.append(_at_end(boundary, i, V, z, by_y))
        found.nodes.append(nodes)
        found.steps.append([])
        D = found.tangents[-1]
    return found, chosen


def _length(c: Sequence[Sequence[Ball]], sizes: Sequence[float], tolerance: float) -> float:
    """How long a step may be for its last coefficients to be below the tolerance."""
    most = float("inf")
    for own, size in zip(c, sizes, strict=True):
        reference = max(size, 1e-3 * abs(float(own[1])))
        for k in (len(own) - 1, len(own) - 2):
            last = abs(float(own[k]))
            if last > 0 and reference > 0:
                radius = (reference / last) ** (1 / k)
                most = min(most, radius * min(tolerance ** (1 / k), _LONGEST))
    return most


def _start(
    boundary: BoundaryProblem, i: int, y: Sequence[Ball], before: Sequence[Ball], D: Any, tangents: bool
) -> tuple[list[Ball], Any]:
    start = boundary.starts[i]
    known = before if i else []
    if not tangents:
        return start.values(y, known), None
    z, (by_y, by_before) = start.slopes(y, known)
    return z, by_y + by_before * D if i else by_y


def _at_end(boundary: BoundaryProblem, i: int, V: Any, z: Sequence[Ball], by_y: Any) -> Any:
    """dz/dy where an arc ends: by what moves its start, and by its duration, whose derivative is `by_y`."""
    rates = arb_mat([[rate] for rate in boundary.arcs[i].plain.values(z)])
    D = rates * by_y
    for at, column in enumerate(boundary.columns[i]):
        for row in range(V.nrows()):
            D[row, column] += V[row, at]
    return D


def residual(boundary: BoundaryProblem, y: Sequence[Ball], flown: Flight) -> list[Ball]:
    """F of a flight."""
    return boundary.residual.values(y, *flown.ends)


def slopes(boundary: BoundaryProblem, y: Sequence[Ball], flown: Flight) -> tuple[list[Ball], Any]:
    """F of a flight, and dF/dy."""
    values, (total, *others) = boundary.residual.slopes(y, *flown.ends)
    for by_end, D in zip(others, flown.tangents, strict=True):
        total += by_end * D
    return values, total
