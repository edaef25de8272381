"""`solve_many`: solve one problem at very many values of its parameters, each answer integrated twice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

from perilune.charts import KnownExtremal
from perilune.core import (
    PeriluneError,
    Watch,
    check_call,
    ignore_events,
    require_callable,
    require_level,
    require_path,
    require_type,
)
from perilune.families.batch import Batch, batch_of
from perilune.families.batch_rows import REFUSED, UNSOLVED, BatchRows, empty_rows
from perilune.families.batch_solver import BatchRequest, BatchSolver, Say, completed_rows
from perilune.families.batch_store import BatchStore
from perilune.families.executors import Submits, require_executor, run_calls
from perilune.families.known_solutions import known_solutions
from perilune.families.points import Points, PointTable, read_points
from perilune.problem import LEVELS, Problem, Solution
from perilune.solve import require_time_limit

_TOGETHER = 4096  # points in lanes at once, so that their numbers fit into a cache


@check_call
def solve_many(
    problem: Problem,
    points: Points,
    guess: Solution | Sequence[Solution] | None = None,
    *,
    verify: int = 0,
    search: bool = True,
    executor: Submits | None = None,
    store: str | Path | None = None,
    callback: Watch | None = None,
    time_limit: float | None = None,
) -> Batch:
    """Solve a problem at many points, from known solutions.

    At each point this is the best of the extremals to which the known ones lead, with their bounds or with one held
    more or less; `solve` searches anew for others. Each has been integrated independently and keeps bounds and path
    (level 0 of a batch). Where no known one leads, `solve` solves a point of a lattice near by, from which the same is
    done, and then the point itself. Given the known solutions, the answer of a point is the same to the last bit
    whatever others are asked for with it, in any process, and after any interruption.

    Parameters
    ----------
    problem
        The problem; its own values of the parameters of `points` are not used, but for the known solution.
    points
        A list of points ``{name: value, ...}``, or the columns ``{name: values, ...}`` of a table, a frame of pandas or
        a data set of xarray. Values are in SI; a name may end in a unit in brackets, ``"vehicle.thrust [kN]"``.
    guess
        Known solutions, of this problem or similar ones. If None, that of the problem as it is (if it has none, of the
        middlemost or an extreme point), and of a hundred points or more those of the extreme ones and of the middle
        that are better than what it leads to.
    verify
        Verification level of each point, as of `perilune.solve.solve`. It takes much longer than the solving.
    search
        False to leave the points that the lanes do not reach unsolved: they may take a second each, or half a minute
        where nothing can land.
    executor
        Where the points are solved, 4096 at a time: a `concurrent.futures.Executor` (a process pool, say) or a Dask
        client.
    store
        Directory into which each 4096 points are written as soon as they are solved. The same call with the same
        directory goes on where it was broken off; answers in it are taken over as stored, and proved again where a
        level is asked for.
    callback
        Receives lines of text, ``... of N points``.
    time_limit
        Of each point that is solved alone [s], as of `perilune.solve.solve`.

    Returns
    -------
    Batch
        In the order of the points. What was done before Ctrl-C, if it was pressed.

    Raises
    ------
    PeriluneError
        If the points are no table of parameters, the problem has no known solution to begin with, the store is of
        another batch, or a worker was lost.
    """
    require_type(problem, Problem, "a problem to solve at many points")
    require_level(verify, (0, *LEVELS))
    require_callable(callback, "a callback")
    require_type(search, bool, "a choice whether points are searched one by one")
    require_executor(executor)
    limit, say = require_time_limit(time_limit, verify), callback or ignore_events
    table = read_points(problem, points)
    problem, solutions = known_solutions(problem, table.names, table.values, guess, limit, say)
    known = list[KnownExtremal]()
    for solution in solutions:
        try:
            known.append(KnownExtremal.of(solution))
        except PeriluneError as error:
            say(f"points are not reached from one of {len(solutions)} known solutions: {error.what}")
    request = BatchRequest(
        problem=problem, names=table.names, known=tuple(known), guess=solutions[0], level=verify, search=search,
        limit=limit,
    )  # fmt: skip
    kept = None if store is None else BatchStore(require_path(store, "the directory of a store"), request, table.values)
    return _Work(request, table, kept, say).done(executor)


class _Work:
    """Rows of a batch while they are filled, some thousand at a time."""

    def __init__(self, request: BatchRequest, table: PointTable, kept: BatchStore | None, say: Say) -> None:
        self.request, self.kept, self.say = request, kept, say
        self.rows: BatchRows = empty_rows(request.problem, table.values)
        self.rows.messages.update(table.unreadable)
        self.rows.codes[list(table.unreadable)] = REFUSED
        self.solver: BatchSolver = BatchSolver(request)
        self.notes = list[str]()

    def done(self, executor: Submits | None) -> Batch:
        """Solve everything, or until the user stops it."""
        stopped, starts, count = False, range(0, len(self.rows), _TOGETHER), len(self.rows)
        try:
            if self.kept is not None:
                self._take_over(self.kept, starts)
            todo = [start for start in starts if self.solver.has_to(self.rows.part(start, _TOGETHER))]
            for start in todo if executor is None else self._elsewhere(executor, todo):
                if executor is None:
                    self._complete_here(start)
                if self.kept is not None:
                    self.kept.write(start, self.rows.part(start, _TOGETHER))
                self.say(f"{min(start + _TOGETHER, count)} of {count} points")
        except KeyboardInterrupt:
            stopped = True
        return batch_of(self.rows, self.solver, stopped, self.notes)

    def _take_over(self, kept: BatchStore, starts: Iterable[int]) -> None:
        taken = 0
        for start, rows in kept.open(
            [(start, self.rows.part(start, _TOGETHER)) for start in starts], self.notes.append
        ):
            self.rows.put(start, rows)
            taken += len(rows) - len(rows.where(UNSOLVED))
        if taken:
            self.notes.append(f"{taken} of {len(self.rows)} points are as stored")
        for note in self.notes:
            self.say(note)

    def _complete_here(self, start: int) -> None:
        part = self.rows.part(start, _TOGETHER)
        try:
            self.solver.complete(part, self.say)
        except KeyboardInterrupt:
            if self.kept is not None:
                with suppress(PeriluneError):  # the answers are returned in any case
                    self.kept.write(start, part)
            raise
        finally:
            self.rows.put(start, part)

    def _elsewhere(self, executor: Submits, starts: Iterable[int]) -> Iterator[int]:
        """Yield the begin of rows as they come back from an executor."""
        token = uuid4().hex
        calls = ((start, (completed_rows, token, self.request, self.rows.part(start, _TOGETHER))) for start in starts)
        for start, rows in run_calls(executor, calls):
            self.rows.put(start, rows)
            yield start
