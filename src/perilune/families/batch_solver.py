"""BatchSolver: the answers at arrays of points of one problem, each independent of which others are asked for.

Points are reached from known extremals in lanes of machine code (`perilune.charts`), and integrated again by another
integrator. What the lanes do not reach, as where the optimal flight has other arcs, is solved alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from threading import local

import numpy as np
from numpy.typing import NDArray

from perilune.charts import Allowed, KnownExtremal, PointSolver, point_feasibility
from perilune.core import NotConvergedError, Outcome, PeriluneError, Vector, ignore_events
from perilune.families.batch_rows import ALONE, NEAREST_NODE, OUTCOMES, REFUSED, SOLVED, UNSOLVED, BatchRows
from perilune.problem import Problem, Solution, rows_out_of_range
from perilune.solve import solve
from perilune.verify import verify

_LESS = 1e-9  # of 0.1 + |J|, canonical: an extremal that another known solution leads to answers if J is less by this

_UNREACHED = "the known solution does not lead there, and nothing else was tried (search=False)"
Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class BatchRequest:
    """Request for an answer at every point of a batch.

    Parameters
    ----------
    problem, names
        The problem, and the parameters that vary.
    known
        Extremals from which points are reached.
    guess
        Solution near which a point is solved that no search without a guess solves.
    level
        Verification level of each answer, 0 for none.
    search
        False to leave unsolved what the lanes do not reach.
    limit
        Time limit of a point that is solved alone [s].
    """

    problem: Problem
    names: tuple[str, ...]
    known: tuple[KnownExtremal, ...]
    guess: Solution
    level: int
    search: bool
    limit: float


class BatchSolver:
    """Solver of a request, at as many arrays of points as are given to it.

    Parameters
    ----------
    request
        What is asked for.
    """

    def __init__(self, request: BatchRequest) -> None:
        self.request: BatchRequest = request
        self._around = dict[tuple[float, ...], PointSolver | None]()

    @cached_property
    def _flies(self) -> Allowed:
        return point_feasibility(self.request.problem, self.request.names)

    @cached_property
    def _solvers(self) -> Sequence[PointSolver | None]:
        """Return the solver that begins with each known extremal; None for one that leads nowhere."""
        return [self._solver(known) for known in self.request.known]

    def _solver(self, known: KnownExtremal) -> PointSolver | None:
        with suppress(PeriluneError):
            return PointSolver(known, self.request.names)
        return None

    def complete(self, rows: BatchRows, say: Say) -> None:
        """Solve the points that have no answer, and prove those that are not proved to the level of the request.

        Parameters
        ----------
        rows
            Rows to fill.
        say
            Receives lines of text.
        """
        if len(rows.where(UNSOLVED)):
            self._solve_in_lanes(rows)
            if self.request.search:
                self._solve_around_nodes(rows, say)
            self._solve_left(rows, say)
        self._prove(rows, say)

    def has_to(self, rows: BatchRows) -> bool:
        """Return True if `complete` has something to do."""
        return bool(len(rows.where(UNSOLVED)) or len(self._unproved(rows)))

    def _unproved(self, rows: BatchRows) -> NDArray[np.int64]:
        return np.nonzero((rows.codes == SOLVED) & (rows.levels < self.request.level))[0]

    def _solve_in_lanes(self, rows: BatchRows) -> None:
        """Refuse what cannot be flown, and solve what the lanes reach from the known solutions."""
        points = self._screened(rows)
        with _whole_or_not(rows, points):
            for number, solver in enumerate(self._solvers):
                if solver is not None and len(points):
                    self._solve_from(rows, points, solver, number)

    def _screened(self, rows: BatchRows) -> NDArray[np.int64]:
        """Return the points whose values are some of the problem and not forbidden by physics; refuse the others."""
        points = rows.where(UNSOLVED)
        refused = rows_out_of_range(self.request.problem, self.request.names, rows.values[points])
        rows.codes[points[refused]] = REFUSED
        points = points[~refused]
        flies = self._flies(rows.values[points]) if len(points) else np.zeros(0, dtype=bool)
        rows.codes[points[~flies]] = OUTCOMES.index(Outcome.INFEASIBLE)
        return points[flies]

    def _solve_from(self, rows: BatchRows, points: NDArray[np.int64], solver: PointSolver, origin: int) -> None:
        """Solve points together from one solution, and enter what is found and better than what was."""
        found = solver.solve(rows.values[points])
        with np.errstate(invalid="ignore"):
            its = found.found & ~(found.doubt < found.cost)
            if origin > 0:  # what was found before answers unless this is less; what was in doubt, as if solved anew
                size = solver.objective_size
                before = rows.objective[points]
                its &= ~(before <= found.cost * size + _LESS * (0.1 * size + np.abs(before)))
        found, points = found.of(np.nonzero(its)[0]), points[its]
        rows.codes[points], rows.origin[points] = SOLVED, origin
        rows.objective[points] = found.cost * solver.objective_size
        rows.slopes[points], rows.error_bound[points] = found.slopes, found.error_bound
        for column, values in zip(rows.free.values(), solver.free(found).T, strict=True):
            column[points] = values
        named = {name: column[points] for name, column in rows.free.items()}
        named |= dict(zip(self.request.names, rows.values[points].T, strict=True))
        for name, values in solver.results(found, named).items():
            rows.results[name][points] = values

    def _solve_around_nodes(self, rows: BatchRows, say: Say) -> None:
        """Solve nodes of the lattice around the first known solution anew, and from each the points near it.

        So points at which the best flight has other arcs are solved together too.
        """
        left = rows.where(UNSOLVED)
        if not (len(left) and self._solvers and self._solvers[0]):
            return
        nodes, which = np.unique(self._solvers[0].nearest_nodes(rows.values[left]), axis=0, return_inverse=True)
        for number, node in enumerate(nodes):
            say(f"{number + 1} of {len(nodes)} neighbourhoods of points that no known solution leads to")
            if (solver := self._around_node(node)) is not None:
                points = left[which.reshape(-1) == number]
                with _whole_or_not(rows, points):
                    self._solve_from(rows, points, solver, NEAREST_NODE)

    def _around_node(self, node: Vector) -> PointSolver | None:
        """Return the solver that begins with the solution of a node; None if there is none."""
        key = tuple(node.tolist())
        if key not in self._around:
            self._around[key] = None
            with suppress(PeriluneError):
                known = solve(self.problem_at(node), verify=1, time_limit=self.request.limit)
                if known.outcome is Outcome.PROVED:
                    self._around[key] = self._solver(KnownExtremal.of(known))
        return self._around[key]

    def problem_at(self, values: Vector) -> Problem:
        """Return the problem at values of the parameters [SI], which its records may refuse."""
        return self.request.problem.with_given(**dict(zip(self.request.names, values.tolist(), strict=True)))

    def _solve_left(self, rows: BatchRows, say: Say) -> None:
        """Solve one by one what has no answer yet, or say that it was not tried."""
        left = rows.where(UNSOLVED).tolist()
        if not self.request.search:
            rows.codes[left] = OUTCOMES.index(Outcome.NOT_CONVERGED)
            rows.messages.update(dict.fromkeys(left, _UNREACHED))
            return
        for number, i in enumerate(left, 1):
            say(f"{number} of {len(left)} points solved alone")
            with _whole_or_not(rows, np.array([i])):
                try:
                    rows.enter_solution(i, self._solved_alone(rows.values[i]), self.request.level)
                except PeriluneError as error:
                    rows.enter_failure(i, error)

    def _solved_alone(self, values: Vector) -> Solution:
        """Return the answer of a search without a guess, or that near the first known solution where it finds none."""
        problem, level, limit = self.problem_at(values), max(self.request.level, 1), self.request.limit
        try:
            return solve(problem, verify=level, time_limit=limit)
        except NotConvergedError:
            with suppress(PeriluneError):
                near = solve(problem, guess=self.request.guess, verify=level, time_limit=limit)
                if near.outcome is Outcome.PROVED:
                    return near
            raise

    def _prove(self, rows: BatchRows, say: Say) -> None:
        """Prove each answer of the lanes to the level of the request, and solve alone those that do not prove."""
        todo = self._unproved(rows)
        for number, i in enumerate(todo.tolist(), 1):
            say(f"{number} of {len(todo)} points proved")
            try:
                solution = verify(self.solution(rows, i), self.request.level)
                rows.codes[i], rows.levels[i] = OUTCOMES.index(solution.outcome), solution.verification.level
                if solution.outcome is not Outcome.PROVED:
                    rows.enter_solution(i, self._solved_alone(rows.values[i]), self.request.level)
            except PeriluneError:
                continue

    def solution(self, rows: BatchRows, point: int) -> Solution:
        """Return the answer of a point as a solution, found again: to the last bit what it was.

        Parameters
        ----------
        rows, point
            Answers, and the number of a point that has one.
        """
        origin, values = int(rows.origin[point]), rows.values[point]
        if origin == ALONE:
            return rows.alone.get(point) or self._solved_alone(values)
        solver = self._solvers[max(origin, 0)]
        if origin == NEAREST_NODE and solver is not None:
            solver = self._around_node(solver.nearest_nodes(values[None])[0])
        assert solver is not None, "of an answer"
        return solver.solution(self.problem_at(values), solver.solve(values[None]), 0)


@contextmanager
def _whole_or_not(rows: BatchRows, points: NDArray[np.int64]) -> Iterator[None]:
    """Leave points that Ctrl-C breaks off unsolved: the next known solution might have led to a better answer."""
    try:
        yield
    except KeyboardInterrupt:
        rows.clear(points)
        raise


_OWN = local()  # of each thread of a worker: its rows of one batch have one solver


def completed_rows(token: str, request: BatchRequest, rows: BatchRows) -> BatchRows:
    """Return rows completed, in any process.

    Parameters
    ----------
    token
        Name of the batch, by which its next rows find the solver again.
    request, rows
        What is asked for, and the rows.
    """
    if getattr(_OWN, "token", "") != token:
        _OWN.token, _OWN.solver = token, BatchSolver(request)
    _OWN.solver.complete(rows, ignore_events)
    return rows
