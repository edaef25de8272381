"""Neighbour B over the region of manoeuvre points: solved from each other, and predicted by the paper's (16)."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perilune import PeriluneError, Solution, solve
from perilune.core import Matrix, Vector, Watch
from perilune_papers.liu2019.case import CASE, paper_costates


@dataclass(frozen=True, kw_only=True)
class ManoeuvreMember:
    """Neighbour B at a manoeuvre point [deg]: its solution, or why there is none, and the processor time [s]."""

    longitude: float
    latitude: float
    solution: Solution | None
    message: str
    processor_time: float

    def value(self, name: str) -> float:
        """Return one of its results in SI; NaN where there is no solution."""
        return math.nan if self.solution is None else self.solution.results[name].value

    def costates(self) -> Vector:
        """Seven costates at ignition in the paper's coordinates and units, NaN where there is no solution."""
        return np.full(7, math.nan) if self.solution is None else paper_costates(self.solution, 0, 0.0)


def solve_members(first: Solution, points: Sequence[tuple[float, float]], watch: Watch) -> tuple[ManoeuvreMember, ...]:
    """Solve at every manoeuvre point [deg], each from the nearest that is known; in the order of the points.

    Parameters
    ----------
    first
        Solution at the manoeuvre point of the paper.
    points
        Longitude and latitude of each manoeuvre point [deg].
    watch
        Called with a line for each point.
    """
    known = {(math.degrees(CASE.place[0]), math.degrees(CASE.place[1])): first}
    made: dict[int, ManoeuvreMember] = {}
    begin = next(iter(known))
    for i in sorted(range(len(points)), key=lambda k: math.dist(points[k], begin)):
        longitude, latitude = points[i]
        near = min(known, key=lambda point: math.dist(point, points[i]))
        began, message, solution = time.process_time(), "", None
        try:
            stated = first.problem.with_given(
                manoeuvre_longitude=math.radians(longitude), manoeuvre_latitude=math.radians(latitude)
            )
            solution = solve(stated, guess=known[near], verify=0)
        except PeriluneError as error:
            message = " ".join(str(error).split())
        else:
            known[points[i]] = solution
        made[i] = ManoeuvreMember(
            longitude=longitude, latitude=latitude, solution=solution, message=message,
            processor_time=time.process_time() - began,
        )  # fmt: skip
        watch(f"manoeuvre point {longitude:g}°, {latitude:g}° ({len(made)} of {len(points)})")
    return tuple(made[i] for i in range(len(points)))


def prediction_error(
    grid: Sequence[ManoeuvreMember], at: Sequence[ManoeuvreMember], known: Vector, right: Vector
) -> Vector:
    """Error of the paper's prediction (16) at manoeuvre points, over the largest size of the quantity.

    Parameters
    ----------
    grid, known
        Points that the prediction is made from, and the values there.
    at, right
        Points that it is made for, and the values there.
    """
    there = np.isfinite(known)
    members = [m for m, here in zip(grid, there, strict=True) if here]
    errors = [predict_by_cubic(members, m, known[None, there])[0] - value for m, value in zip(at, right, strict=True)]
    return np.abs(np.array(errors)) / np.abs(known[there]).max()


def predict_by_cubic(grid: Sequence[ManoeuvreMember], at: ManoeuvreMember, known: Matrix) -> Vector:
    """The paper's prediction (16) at one manoeuvre point of several quantities, known on the grid (quantities, points).

    Ten coefficients, found from the ten nearest points of the grid; the smallest where these leave them open.

    Parameters
    ----------
    grid
        Members at the points of the grid.
    at
        Member whose manoeuvre point is predicted.
    known
        Values on the grid, shape (quantities, points).

    Returns
    -------
    Vector
        Predicted values, shape (quantities,), in the units of `known`.
    """
    off = np.array([(m.longitude, m.latitude) for m in grid]) - (at.longitude, at.latitude)
    near = np.argsort((off**2).sum(axis=1))[:10]
    u, v = off[near].T
    columns = np.array([u**0, u, v, u**2, v**2, u**3, v**3, u * v, u * v**2, u**2 * v]).T
    return np.linalg.lstsq(columns, known[:, near].T, rcond=1e-9)[0][0]


def is_variable(values: Vector) -> bool:
    """Return True if a quantity is more than one number and the noise of its last digits."""
    known = values[np.isfinite(values)]
    return bool(len(known) and np.ptp(known) > 1e-6 * np.abs(known).max())
