"""BatchRows: what is found at some points of a batch, one row of arrays for each, filled while they are solved."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.charts import PointSolver
from perilune.core import Matrix, Outcome, PeriluneError, Vector
from perilune.families.family import failure_outcome
from perilune.problem import Problem, Solution

OUTCOMES = tuple(Outcome)  # an outcome of a batch is its place here
UNSOLVED, SOLVED, REFUSED = (OUTCOMES.index(o) for o in (Outcome.INTERRUPTED, Outcome.SOLVED, Outcome.REFUSED))
#: Where the answer of a point comes from: the number of a known solution, or one of these.
NEAREST_NODE, ALONE, NOWHERE = -1, -2, -3
_UNKNOWN = {"codes": UNSOLVED, "levels": 0, "origin": NOWHERE}  # where nothing is known; NaN in the other columns


@dataclass(kw_only=True)
class BatchRows:
    """Answers at some points; NaN where there is none.

    Parameters
    ----------
    values
        Values of the parameters [SI], (points, d).
    codes, levels
        Outcome of each point, as a place in `OUTCOMES`, and its verification level.
    origin
        Number of the known solution that leads to it, or `NEAREST_NODE`, `ALONE` or `NOWHERE`.
    objective, slopes, error_bound
        J [SI], dJ/dp [SI] (points, d), and how far the unknowns can be from those of the extremal, relative.
    free, results
        Free parameters and results by name [SI], (points,) each.
    messages, alone
        Why a point has no answer, and solutions that were found one by one, by the number of the point.
    """

    values: Matrix
    codes: NDArray[np.int8]
    levels: NDArray[np.int8]
    origin: NDArray[np.int16]
    objective: Vector
    slopes: Matrix
    error_bound: Vector
    free: Mapping[str, Vector]
    results: Mapping[str, Vector]
    messages: dict[int, str] = field(default_factory=dict)
    alone: dict[int, Solution] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.values)

    @property
    def columns(self) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield the arrays with their names, ``free.NAME`` and ``results.NAME`` among them."""
        for f in fields(self)[:-2]:
            content = getattr(self, f.name)
            if isinstance(content, Mapping):
                yield from ((f"{f.name}.{name}", column) for name, column in content.items())
            else:
                yield f.name, content

    def where(self, code: int) -> NDArray[np.int64]:
        """Return the numbers of the points with an outcome."""
        return np.nonzero(self.codes == code)[0]

    def clear(self, points: NDArray[np.int64]) -> None:
        """Make points again such of which nothing is known.

        Parameters
        ----------
        points
            Their numbers.
        """
        for name, column in self.columns:
            if name != "values":
                column[points] = _UNKNOWN.get(name, np.nan)
        for i in points.tolist():
            self.messages.pop(i, None)
            self.alone.pop(i, None)

    def part(self, start: int, count: int) -> BatchRows:
        """Return some of the rows, whose arrays are part of these.

        Parameters
        ----------
        start, count
            Number of the first, and how many at most.
        """
        its = slice(start, start + count)
        arrays: dict[str, Any] = {}
        for f in fields(self)[:-2]:
            content = getattr(self, f.name)
            mapped = isinstance(content, Mapping)
            arrays[f.name] = {name: column[its] for name, column in content.items()} if mapped else content[its]
        for name in ("messages", "alone"):
            arrays[name] = {i - start: value for i, value in getattr(self, name).items() if start <= i < its.stop}
        return BatchRows(**arrays)

    def put(self, start: int, rows: BatchRows) -> None:
        """Enter the rows of other points.

        Parameters
        ----------
        start, rows
            Number of the first of them here, and the rows.
        """
        for (_, mine), (_, its) in zip(self.columns, rows.columns, strict=True):
            mine[start : start + len(rows)] = its
        self.messages |= {start + i: message for i, message in rows.messages.items()}
        self.alone |= {start + i: solution for i, solution in rows.alone.items()}

    def enter_solution(self, point: int, solution: Solution, level: int) -> None:
        """Enter a solution that was found alone.

        Parameters
        ----------
        point, solution
            Number of the point and its solution.
        level
            Level that was asked for; at 0 a proved one is called solved, as all the others are.
        """
        proved = solution.outcome is Outcome.PROVED
        self.codes[point] = SOLVED if proved and not level else OUTCOMES.index(solution.outcome)
        self.levels[point] = solution.verification.level if level else 0
        self.alone[point], self.origin[point] = solution, ALONE
        self.objective[point] = solution.objective
        self.slopes[point], self.error_bound[point] = np.nan, np.nan
        for name, column in self.free.items():
            column[point] = solution.free[name]
        for name, column in self.results.items():
            column[point] = float(solution.results[name].value)

    def enter_failure(self, point: int, error: PeriluneError) -> None:
        """Enter why a point has no answer.

        Parameters
        ----------
        point, error
            Number of the point, and the refusal or failure of its search.
        """
        self.codes[point], self.messages[point] = OUTCOMES.index(failure_outcome(error)), str(error)


def empty_rows(problem: Problem, values: Matrix) -> BatchRows:
    """Return rows for points of which nothing is known.

    Parameters
    ----------
    problem
        Problem of the batch.
    values
        Values of the parameters [SI], (points, d).
    """
    count = len(values)

    def columns(names: Sequence[str]) -> dict[str, Vector]:
        return {name: np.full(count, np.nan) for name in names}

    return BatchRows(
        values=values, codes=np.full(count, UNSOLVED, dtype=np.int8), levels=np.zeros(count, dtype=np.int8),
        origin=np.full(count, NOWHERE, dtype=np.int16), objective=np.full(count, np.nan),
        slopes=np.full(values.shape, np.nan), error_bound=np.full(count, np.nan),
        free=columns([*problem.free_names]), results=columns([*PointSolver.end_results(problem)]),
    )  # fmt: skip
