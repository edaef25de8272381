"""Batch: the answers of one problem at many points, as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from perilune.core import Matrix, PeriluneError, Vector, check_call, method_function, require_index
from perilune.families.batch_rows import ALONE, OUTCOMES, BatchRows
from perilune.families.batch_solver import BatchSolver
from perilune.problem import Problem, Solution, preflight, refuse_impossible, select_findings

if TYPE_CHECKING:
    import pandas
    import xarray


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
    notes
        What was taken over from a store.
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
    interrupted: bool
    notes: tuple[str, ...]
    _rows: BatchRows
    _solver: BatchSolver

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
        return np.nonzero(self._rows.origin == ALONE)[0]

    def problem_of(self, point: int) -> Problem:
        """Return the problem of a point, whose values its records may refuse."""
        return self._solver.problem_at(self.values[self._number(point)])

    def _number(self, point: int) -> int:
        """Return the number of a point, which may count from the end."""
        require_index(point, len(self), "a point")
        return point % len(self)

    def message(self, point: int) -> str:
        """Return why a point has no answer, in words; empty where it has one."""
        return self.messages[self._number(point)]

    @cached_property
    def messages(self) -> Sequence[str]:
        """Return why each point has no answer, in words; empty where it has one."""
        known, solved = self._rows.messages, self.solved
        left = [i for i in range(len(self)) if not solved[i] and i not in known]
        values = zip(self.parameters, self.values[left].T, strict=True)
        findings = preflight(self.problem, dict(values)) if left else ()
        said = dict(known)
        for number, i in enumerate(left):
            said[i] = "not solved before the batch was stopped"
            try:
                self.problem_of(i)
                refuse_impossible(select_findings(findings, number))
            except PeriluneError as error:
                said[i] = str(error)
        return [said.get(i, "") for i in range(len(self))]

    @check_call
    def solution(self, point: int) -> Solution:
        """Return the answer of a point as a solution, unverified where its level is 0.

        Raises
        ------
        PeriluneError
            If the point has no answer; the message says why.
        """
        problem, point = self.problem_of(point), self._number(point)
        if not self.solved[point]:
            raise PeriluneError(f"point {point} has no solution", got=self.message(point), expected="a solved point")
        return replace(self._solver.solution(self._rows, point), problem=problem)

    @check_call
    def to_dataframe(self) -> pandas.DataFrame:
        """Return the points as rows of a frame of pandas, with the columns of `Family.to_dataframe`.

        Raises
        ------
        PeriluneError
            If pandas is not installed.
        """
        return method_function("member_frame")(self)

    @check_call
    def to_xarray(self) -> xarray.Dataset:
        """Return the points as a data set of xarray.

        Its dimensions are the parameters where the points are a grid, else the one dimension ``point``.

        Raises
        ------
        PeriluneError
            If xarray is not installed.
        """
        return method_function("member_dataset")(self)


def batch_of(rows: BatchRows, solver: BatchSolver, interrupted: bool, notes: Sequence[str]) -> Batch:
    """Return a batch.

    Parameters
    ----------
    rows, solver
        Answers, and what found them.
    interrupted, notes
        As of the batch.
    """
    request = solver.request
    return Batch(
        problem=request.problem, guess=request.guess, parameters=request.names, values=rows.values,
        codes=rows.codes, levels=rows.levels, objective=rows.objective, free=rows.free, results=rows.results,
        slopes=rows.slopes, error_bound=rows.error_bound, interrupted=interrupted, notes=tuple(notes), _rows=rows,
        _solver=solver,
    )  # fmt: skip
