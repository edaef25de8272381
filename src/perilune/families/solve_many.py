"""`solve_many`: solve one problem at very many values of its parameters, each answer integrated twice.

Points are reached from one known extremal in lanes of machine code (`perilune.charts`), and integrated again by another
integrator. What the lanes do not reach, as where the optimal flight has other arcs, is solved alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from perilune.charts import Allowed, PointSolver, point_feasibility
from perilune.core import (
    NotConvergedError,
    Outcome,
    PeriluneError,
    Vector,
    Watch,
    check_call,
    ignore_events,
    require_callable,
    require_level,
    require_type,
)
from perilune.families.batch import OUTCOMES, Batch, BatchPart, solution_in_parts
from perilune.families.family import failure_outcome
from perilune.families.points import Points, PointTable, read_points
from perilune.methods import Indirect
from perilune.problem import LEVELS, Problem, Solution, rows_out_of_range
from perilune.solve import require_time_limit, solve
from perilune.verify import verify as verify_solution

_TOGETHER = 4096  # points in lanes at once, so that their numbers fit into a cache
_UNSOLVED = OUTCOMES.index(Outcome.INTERRUPTED)  # what has no other outcome when the user stops it

_UNREACHED = "the known solution does not lead there, and nothing else was tried (search=False)"


@check_call
def solve_many(
    problem: Problem,
    points: Points,
    guess: Solution | None = None,
    *,
    verify: int = 0,
    search: bool = True,
    callback: Watch | None = None,
    time_limit: float | None = None,
) -> Batch:
    """Solve a problem at many points, from one known solution.

    At each point this is the best of the extremals to which the known one leads, with its bounds or with one held more
    or less; `solve` searches anew for others. Each has been integrated independently and keeps bounds and path (level
    0 of a batch). Where the known one does not lead, `solve` solves a point of a lattice near by, from which the same
    is done, and then the point itself. The answer of a point is the same to the last bit whatever others are asked for
    with it.

    Parameters
    ----------
    problem
        The problem; its own values of the parameters of `points` are not used, but for the known solution.
    points
        A list of points ``{name: value, ...}``, or the columns ``{name: values, ...}`` of a table, a frame of pandas or
        a data set of xarray. Values are in SI; a name may end in a unit in brackets, ``"vehicle.thrust [kN]"``.
    guess
        The known solution, of this problem or a similar one; `solve` finds it if None.
    verify
        Verification level of each point, as of `perilune.solve.solve`. It takes much longer than the solving.
    search
        False to leave the points that the lanes do not reach unsolved: they may take a second each, or half a minute
        where nothing can land.
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
        If the points are no table of parameters, or the problem has no known solution to begin with.
    """
    require_type(problem, Problem, "a problem to solve at many points")
    require_level(verify, (0, *LEVELS))
    require_callable(callback, "a callback")
    require_type(search, bool, "a choice whether points are searched one by one")
    limit, say = require_time_limit(time_limit, verify), callback or ignore_events
    table = read_points(problem, points)
    known = solve(problem, callback=callback) if guess is None else Indirect().run(problem, guess, say)
    if named := {name: known.free[name] for name in table.names if name in known.free}:  # no longer free
        problem = problem.with_given(**named)
        known = Indirect().run(problem, known, say)
    return _Work(problem, table, known).done(say, verify, search=search, limit=limit)


class _Work:
    """Arrays of a batch while they are filled."""

    def __init__(self, problem: Problem, table: PointTable, known: Solution) -> None:
        count = len(table.values)
        self.problem, self.names, self.values, self.known = problem, table.names, table.values, known
        self.codes, self.levels = np.full(count, _UNSOLVED, dtype=np.int8), np.zeros(count, dtype=np.int8)
        self.messages, self.alone = dict[int, str](), dict[int, Solution]()
        self.parts = list[BatchPart]()

        self.messages.update(table.unreadable)
        self.codes[list(table.unreadable)] = OUTCOMES.index(Outcome.REFUSED)

    def done(self, say: Callable[[str], None], level: int, *, search: bool, limit: float) -> Batch:
        """Solve everything, or until the user stops it."""
        stopped = False
        try:
            self.solve_in_lanes(say)
            if search:
                self.solve_around_nodes(say, limit)
            else:
                self.leave_unreached()
            self.solve_alone(say, level, limit)
        except KeyboardInterrupt:
            stopped = True
        return self.batch(stopped)

    def solve_in_lanes(self, say: Callable[[str], None]) -> None:
        """Refuse what cannot be flown, and solve what the lanes reach from the known solution."""
        allowed, solver = point_feasibility(self.problem, self.names), None
        try:
            solver = PointSolver(self.problem, self.known, self.names)
        except PeriluneError as error:
            say(f"every point is solved alone: {error.what}")
        readable = np.nonzero(self.codes == _UNSOLVED)[0]
        done = 0
        for chunk in _chunks(readable):
            some = self._screened(chunk, allowed)
            if solver is not None:
                self._solve_part(solver, some)
            done += len(chunk)
            say(f"{done} of {len(readable)} points")

    def _screened(self, points: NDArray[np.int64], allowed: Allowed) -> NDArray[np.int64]:
        """Return the points whose values are some of the problem and not forbidden by physics; refuse the others."""
        refused = rows_out_of_range(self.problem, self.names, self.values[points])
        self.codes[points[refused]] = OUTCOMES.index(Outcome.REFUSED)
        points = points[~refused]
        flies = allowed(self.values[points]) if len(points) else np.zeros(0, dtype=bool)
        self.codes[points[~flies]] = OUTCOMES.index(Outcome.INFEASIBLE)
        return points[flies]

    def solve_around_nodes(self, say: Callable[[str], None], limit: float) -> None:
        """Solve nodes of the lattice around the known solution anew, and from each the points near it that are left.

        So points at which the best flight has other arcs are solved together too.
        """
        left = np.nonzero(self.codes == _UNSOLVED)[0]
        if not (len(left) and self.parts):
            return
        nodes, which = np.unique(self.parts[0].solver.nearest_nodes(self.values[left]), axis=0, return_inverse=True)
        for number, node in enumerate(nodes):
            say(f"{number + 1} of {len(nodes)} neighbourhoods of points that the known solution does not lead to")
            try:
                problem = self._problem_at(node)
                known = solve(problem, verify=1, time_limit=limit)
                solver = PointSolver(problem, known, self.names)
            except PeriluneError:
                continue
            if known.outcome is Outcome.PROVED:
                for some in _chunks(left[which.reshape(-1) == number]):
                    self._solve_part(solver, some)

    def _solve_part(self, solver: PointSolver, points: NDArray[np.int64]) -> None:
        """Solve points together from the solution of a solver, and enter what it finds."""
        if len(points):
            found = solver.solve(self.values[points])
            its = np.nonzero(found.found)[0]
            self.codes[points[its]] = OUTCOMES.index(Outcome.SOLVED)
            if len(its) or not self.parts:
                self.parts.append(BatchPart(solver, points[its], found.of(its)))

    def _problem_at(self, values: Vector) -> Problem:
        return self.problem.with_given(**dict(zip(self.names, values.tolist(), strict=True)))

    def leave_unreached(self) -> None:
        """Enter the points that the lanes do not reach as not converged."""
        left = np.nonzero(self.codes == _UNSOLVED)[0]
        self.codes[left] = OUTCOMES.index(Outcome.NOT_CONVERGED)
        self.messages.update(dict.fromkeys(left.tolist(), _UNREACHED))

    def solve_alone(self, say: Callable[[str], None], level: int, limit: float) -> None:
        """Prove what the lanes found, where a level is asked for, and solve one by one what is left."""
        solved = OUTCOMES.index(Outcome.SOLVED)
        todo = np.nonzero((self.codes == _UNSOLVED) | (self.codes == solved) & (level > 0))[0].tolist()
        for number, i in enumerate(todo, 1):
            say(f"{number} of {len(todo)} points {'proved or ' if level else ''}solved alone")
            try:
                problem = self._problem_at(self.values[i])
                if self.codes[i] == solved and self._proves(problem, i, level):
                    continue
                solution = _solved_alone(problem, self.known, max(level, 1), limit)
            except PeriluneError as error:
                if self.codes[i] != solved:
                    self.codes[i], self.messages[i] = OUTCOMES.index(failure_outcome(error)), str(error)
                continue
            proved = solution.outcome is Outcome.PROVED
            self.alone[i], self.levels[i] = solution, solution.verification.level
            self.codes[i] = solved if proved and not level else OUTCOMES.index(solution.outcome)

    def _proves(self, problem: Problem, i: int, level: int) -> bool:
        """Return True if what the lanes found at a point proves to the level; enter how far it does."""
        solution = verify_solution(solution_in_parts(self.parts, problem, i), level)
        self.codes[i], self.levels[i] = OUTCOMES.index(solution.outcome), solution.verification.level
        return solution.outcome is Outcome.PROVED

    def batch(self, stopped: bool) -> Batch:
        """Return the arrays in SI."""
        count, problem, alone = len(self.values), self.problem, list(self.alone)
        free = {name: np.full(count, np.nan) for name in problem.free_names}
        objective, error_bound = np.full(count, np.nan), np.full(count, np.nan)
        slopes, results = np.full(self.values.shape, np.nan), dict[str, Vector]()
        for part in self.parts:
            its = np.nonzero(~np.isin(part.points, alone))[0]
            lanes, found = part.points[its], part.found.of(its)
            objective[lanes] = found.cost * problem.objective_size
            slopes[lanes], error_bound[lanes] = found.slopes, found.error_bound
            for name, column in zip(free, part.solver.free(found).T, strict=True):
                free[name][lanes] = column
            named = {name: column[lanes] for name, column in free.items()}
            named |= {name: self.values[lanes, k] for k, name in enumerate(self.names)}
            for name, column in part.solver.results(found, named).items():
                results.setdefault(name, np.full(count, np.nan))[lanes] = column
        for i, solution in self.alone.items():
            objective[i] = solution.objective
            for name, column in free.items():
                column[i] = solution.free[name]
            for name, result in solution.results.items():
                if name in results or not self.parts:
                    results.setdefault(name, np.full(count, np.nan))[i] = float(result.value)
        return Batch(
            problem=problem, guess=self.known, parameters=self.names, values=self.values, codes=self.codes,
            levels=self.levels, objective=objective, free=free, results=results, slopes=slopes,
            error_bound=error_bound, interrupted=stopped, _messages=self.messages, _alone=self.alone,
            _parts=self.parts,
        )  # fmt: skip


def _chunks(points: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield points in parts that are solved together."""
    for start in range(0, len(points), _TOGETHER):
        yield points[start : start + _TOGETHER]


def _solved_alone(problem: Problem, known: Solution, level: int, limit: float) -> Solution:
    """Return the answer of a search without a guess, or that near the known solution where it finds none."""
    try:
        return solve(problem, verify=level, time_limit=limit)
    except NotConvergedError:
        with suppress(PeriluneError):
            near = solve(problem, guess=known, verify=level, time_limit=limit)
            if near.outcome is Outcome.PROVED:
                return near
        raise
