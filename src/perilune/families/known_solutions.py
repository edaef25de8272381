"""Known solutions from which a batch begins: those of the user, or of the problem and of extreme points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import product

import numpy as np

from perilune.charts import KnownExtremal, PointSolver
from perilune.core import Matrix, PeriluneError, Vector, Watch, require_type
from perilune.methods import Indirect
from perilune.problem import Problem, Solution
from perilune.solve import solve

_MANY = 100  # points from which on extreme ones are solved first
_CORNERS = 3  # parameters up to which all combinations of their extreme values are among them
_LESS = 1e-7  # of 0.1 + |J|, canonical: a solution is better than another if J is less by this


def known_solutions(
    problem: Problem,
    names: Sequence[str],
    values: Matrix,
    guess: Solution | Sequence[Solution] | None,
    limit: float,
    say: Watch,
) -> tuple[Problem, tuple[Solution, ...]]:
    """Return the problem with every parameter of the points given, and solutions from which points are reached.

    Parameters
    ----------
    problem, names
        The user's problem, and the parameters that vary; one that is free is given from here on.
    values
        Values of the parameters at the points [SI], (points, d).
    guess
        What the user knows.
    limit
        Time limit of each search [s].
    say
        Receives lines of text.

    Raises
    ------
    PeriluneError
        If there is no solution to begin with.
    """
    given = [guess] if isinstance(guess, Solution) else list(guess or ())
    for one in given:
        require_type(one, Solution, "a known solution")
    first = Indirect().run(problem, given[0], say) if given else _first_solution(problem, names, values, limit, say)
    own = {name: given.value for name, given in first.problem.given.items()} | dict(first.free)
    problem = problem.with_given(**{name: own[name] for name in names if name in problem.free_names})  # no longer free
    if any(name in first.free for name in names):
        first = Indirect().run(problem, first, say)
    others = [_refined(problem, names, one, say) for one in given[1:]]
    if guess is None and len(values) >= _MANY:
        others = list(_of_extreme_points(problem, names, values, first, limit, say))
    return problem, (first, *others)


def _first_solution(problem: Problem, names: Sequence[str], values: Matrix, limit: float, say: Watch) -> Solution:
    """Return the solution of the problem as it is, or of the first of some points that has one."""
    try:
        return solve(problem, callback=say, time_limit=limit)
    except PeriluneError as error:
        say(f"the problem as it is has no solution ({error.what}): points are solved in its place")
        for row in _extreme_rows(values):
            with suppress(PeriluneError):
                return solve(_problem_at(problem, names, row), verify=0, time_limit=limit)
        raise


def _refined(problem: Problem, names: Sequence[str], guess: Solution, say: Watch) -> Solution:
    """Return a guess as an extremal of the problem at the values that it has for the parameters itself."""
    own = {name: given.value for name, given in guess.problem.given.items()} | dict(guess.free)
    at = {name: own[name] for name in names if name in own}
    return Indirect().run(problem.with_given(**at), guess, say)


def _of_extreme_points(
    problem: Problem, names: Sequence[str], values: Matrix, first: Solution, limit: float, say: Watch
) -> Iterator[Solution]:
    """Yield solutions of extreme points that are better than what the solutions before lead to there."""
    solvers = list[PointSolver]()
    with suppress(PeriluneError):
        solvers.append(PointSolver(KnownExtremal.of(first), names))
    rows = _extreme_rows(values)
    for number, row in enumerate(rows, 1):
        say(f"{number} of {len(rows)} extreme points")
        with suppress(PeriluneError):
            solution = solve(_problem_at(problem, names, row), verify=0, time_limit=limit)
            if all(_is_better(solution, solver, row) for solver in solvers):
                solvers.append(PointSolver(KnownExtremal.of(solution), names))
                yield solution


def _problem_at(problem: Problem, names: Sequence[str], row: Vector) -> Problem:
    return problem.with_given(**dict(zip(names, row.tolist(), strict=True)))


def _is_better(solution: Solution, solver: PointSolver, row: Vector) -> bool:
    found = solver.solve(row[None])
    cost = solution.objective / solver.objective_size
    return not found.found[0] or bool(cost < found.cost[0] - _LESS * (0.1 + abs(cost)))


def _extreme_rows(values: Matrix) -> Matrix:
    """Return the finite points that are furthest along combinations of the parameters, and the middlemost."""
    values = values[np.isfinite(values).all(axis=1)]
    low, high = values.min(axis=0, initial=np.inf), values.max(axis=0, initial=-np.inf)
    varied = np.nonzero(high > low)[0]
    if not len(values) or not varied.size:
        return values[:1]
    at = (2 * values - low - high)[:, varied] / (high - low)[varied]
    count = len(varied)
    if count <= _CORNERS:
        ways = np.array(list(product((-1.0, 1.0), repeat=count)))
    else:
        ways = np.concatenate([np.eye(count), -np.eye(count)])
    far = np.argmax(ways @ at.T, axis=1)
    return values[list(dict.fromkeys([int(np.argmin(np.abs(at).max(axis=1))), *far.tolist()]))]
