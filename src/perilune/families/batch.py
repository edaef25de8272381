"""Batch: the answers of one problem at many points, as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from perilune.charts import PointExtremals, PointSolver
from perilune.core import Matrix, Outcome, PeriluneError, Vector, check_call, method_function, require_index
from perilune.problem import Problem, Solution, preflight, refuse_impossible

if TYPE_CHECKING:
    import pandas
    import xarray

OUTCOMES = tuple(Outcome)  # an outcome of a batch is its place here


@dataclass(frozen=True)
class BatchPart:
    """Points that were reached from one solution: its solver, their numbers in order, and their extremals."""

    solver: PointSolver
    points: NDArray[np.int64]
    found: PointExtremals


def solution_in_parts(parts: Sequence[BatchPart], problem: Problem, point: int) -> Solution:
    """Return the extremal of a point of a batch as a solution.

    Parameters
    ----------
    parts
        Parts of the batch, one of which has the point.
    problem, point
        Problem of the point, and its number.
    """
    part = next(part for part in parts if point in part.points)
    return part.solver.solution(problem, part.found, int(np.searchsorted(part.points, point)))


@check_call
@dataclass(frozen=True, kw_only=True, repr=False)
class Batch:
    """Answers at many points, arrays of one row for each; NaN where there is none.

    Parameters
    ----------
    problem
        Problem that was solved; its own values of the parameters are not used.
    guess
        The extremal from which the points were reached.
    parameters, values
        Names of the parameters, and their values [SI], (points, d).
    codes
        Outcome of each point, as a place in ``tuple(perilune.Outcome)``; see `outcomes`.
    levels
        Verification level that each answer reached; 0 where only the independent re-integration of the lanes is known.
    objective
        J [SI], (points,).
    free, results
        Free parameters, and results at the ends of the flight, by name [SI], (points,) each.
    slopes
        dJ/dp [SI], (points, d); NaN for a point that was solved alone.
    error_bound
        How far the unknowns can be from those of the extremal, relative; NaN for a point that was solved alone.
    interrupted
        True if the user stopped it.
    """

    problem: Problem
    guess: Solution
    parameters: tuple[str, ...]
    values: Matrix
    codes: NDArray[np.int8]
    levels: NDArray[np.int8]
    objective: Vector
    free: Mapping[str, Vector]
    results: Mapping[str, Vector]
    slopes: Matrix
    error_bound: Vector
    interrupted: bool = False
    _messages: Mapping[int, str] = field(default_factory=dict)
    _alone: Mapping[int, Solution] = field(default_factory=dict)
    _parts: Sequence[BatchPart] = ()

    def __repr__(self) -> str:
        stopped = ", interrupted" if self.interrupted else ""
        return f"<Batch of {self.problem.name}: {np.count_nonzero(self.solved)} of {len(self)} points solved{stopped}>"

    def __len__(self) -> int:
        return len(self.values)

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Return a mask of the points that have an answer."""
        return np.isfinite(self.objective)

    @property
    def outcomes(self) -> NDArray[np.str_]:
        """Return the name of each point's outcome: ``"SOLVED"``, ``"PROVED"``, ``"INFEASIBLE"``, ..."""
        return np.array([outcome.name for outcome in OUTCOMES])[self.codes]

    @property
    def solved_alone(self) -> NDArray[np.int64]:
        """Return the numbers of the points that were solved one by one, as the lanes did not lead to them."""
        return np.array(sorted(self._alone), dtype=np.int64)

    def problem_of(self, point: int) -> Problem:
        """Return the problem of a point, whose values its records may refuse."""
        values = self.values[self._number(point)].tolist()
        return self.problem.with_given(**dict(zip(self.parameters, values, strict=True)))

    def _number(self, point: int) -> int:
        """Return the number of a point, which may count from the end."""
        require_index(point, len(self), "a point")
        return point % len(self)

    def message(self, point: int) -> str:
        """Return why a point has no answer, in words; empty where it has one."""
        point = self._number(point)
        if point in self._messages or self.solved[point]:
            return self._messages.get(point, "")
        try:
            refuse_impossible(preflight(self.problem_of(point)))
        except PeriluneError as error:
            return str(error)
        return "not solved before the batch was stopped"

    def solution(self, point: int) -> Solution:
        """Return the answer of a point as a solution, unverified where its level is 0.

        Raises
        ------
        PeriluneError
            If the point has no answer; the message says why.
        """
        problem, point = self.problem_of(point), self._number(point)
        if point in self._alone:
            return self._alone[point]
        if not self.solved[point]:
            raise PeriluneError(f"point {point} has no solution", got=self.message(point), expected="a solved point")
        return solution_in_parts(self._parts, problem, point)

    @check_call
    def to_dataframe(self) -> pandas.DataFrame:
        """Return the points as rows of a frame of pandas: parameters, free ones, results, objective and outcome.

        Angles are in degrees and everything else in SI (``attrs["units"]``).

        Raises
        ------
        PeriluneError
            If pandas is not installed.
        """
        return method_function("batch_frame")(self)

    @check_call
    def to_xarray(self) -> xarray.Dataset:
        """Return the points as a data set of xarray with the dimension ``point``; columns as of `to_dataframe`.

        Raises
        ------
        PeriluneError
            If xarray is not installed.
        """
        return method_function("batch_dataset")(self)
