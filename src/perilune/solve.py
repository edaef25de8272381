"""`solve`: compare the problem with what physics allows, run a method, prove the answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

from perilune.core import (
    NotConvergedError,
    PeriluneError,
    Progress,
    TimeLimitReached,
    Watch,
    check_call,
    enter_computation,
    format_quantity,
    remember_best,
    renamed_keywords,
    renamed_names,
    require_callable,
    require_level,
    require_si_number,
    require_type,
)
from perilune.methods import Indirect, Method
from perilune.problem import LEVELS, THEOREM, Problem, Solution, Tolerance, objective_text, preflight, refuse_impossible
from perilune.structures import with_budgets
from perilune.verify import method_or_default, require_tolerance, theorem_prover, verify

TIME_LIMIT = 600.0  # s, where none is stated: the hardest answers take a minute or two
SECOND_VARIATION = ("conjugate_point", "second_variation", "nothing_gained")  # checks of level 3

if TYPE_CHECKING:
    from perilune.methods import Pseudospectral


@renamed_keywords(level="verify", watch="callback")
@check_call
def solve(
    problem: Problem,
    method: Method | None = None,
    *,
    guess: Solution | None = None,
    verify: int = 3,
    tolerance: Tolerance | None = None,
    callback: Watch | None = None,
    time_limit: float | None = None,
) -> Solution:
    """Solve a problem and prove the answer.

    Parameters
    ----------
    problem
        What to solve.
    method
        ``Indirect()`` unless another is given. The answer of ``Pseudospectral()`` is made exact
        (`perilune.methods.polish`); ``Pseudospectral(polish=False)`` leaves it as its mesh has it.
    guess
        A solution of any method for this or a similar problem. None is needed.
    verify
        Verification level to prove, 0 for none; 4 solves the problem by another method too, 5 proves a theorem.
    tolerance
        Differences that do not matter to the proof, which then says so; by default only rounding does not.
    callback
        Receives each iteration, and lines of text; nothing takes much longer than a second without one.
    time_limit
        Time [s] after which the search, or the proof, ends with `NotConvergedError` and the best flight so far; by
        default `TIME_LIMIT`, and none for a theorem. ``math.inf`` is none. Whatever ends before it depends on no clock.

    Returns
    -------
    Solution
        With `verification` and outcome PROVED or NOT_PROVED; SOLVED at level 0.

    Raises
    ------
    InfeasibleError
        If a binding comparison of `perilune.problem.presolve` is missed, or as the method says.
    NotConvergedError
        As the method says, or where the time limit is reached.
    """
    require_type(
        problem, Problem, "a problem to solve", "a scenario file is read by perilune.scenario.load_file(FILE).problem"
    )
    require_level(verify, (0, *LEVELS))
    if verify == THEOREM:
        theorem_prover()  # what is not installed is said before the work
    require_callable(callback, "a callback")
    require_tolerance(tolerance)
    with ended_in_time(problem, callback, require_time_limit(time_limit, verify)) as work:
        refuse_impossible(preflight(problem))
        try:
            return _solved_and_proved(method_or_default(method), problem, guess, verify, tolerance, work)
        except NotConvergedError as error:
            from perilune.methods import with_binding_limit

            # Of the problem as it came: a limit that is said at the end too gives nowhere alone.
            raise with_binding_limit(problem, error, work) from None


@contextmanager
def ended_in_time(problem: Problem, watch: Watch | None, limit: float) -> Iterator[Progress]:
    """Enter the search for a problem, which ends with `NotConvergedError` where its time [s] is over.

    Parameters
    ----------
    problem
        The problem whose best flight the error reports.
    watch
        Called with each iteration and with lines of text; None for silence.
    limit
        Time that the search may take [s].

    Raises
    ------
    NotConvergedError
        If the time is over, with the best flight known.
    """
    with enter_computation(watch, problem, limit) as work:
        try:
            yield work
        except TimeLimitReached as end:
            raise _out_of_time(problem, work, limit, end) from None


def _solved_and_proved(
    method: Method, problem: Problem, guess: Solution | None, level: int, tolerance: Tolerance | None, work: Progress
) -> Solution:
    """Return the answer of a method with its proof; if that is no minimum, a better answer beyond it."""
    problem = with_budgets(problem, linear=False)
    solution = _run_method(method, problem, guess, work)

    def told_of() -> str:
        return f"{objective_text(solution, 9)}, which is not proved yet"

    remember_best(problem, solution.objective, told_of, lambda: solution, extremal=True)
    solution = verify(solution, level, tolerance, work)
    if guess is None and isinstance(method, Indirect) and _no_minimum(solution):
        further = method.beyond(problem, solution, work)
        if further is not None and (better := verify(further, level, tolerance, work)).verification.level >= 3:
            return better
    return solution


def require_time_limit(stated: float | None, level: int) -> float:
    """Return the time limit [s] that holds.

    Parameters
    ----------
    stated
        The limit that the caller gave [s]; None for the default: `TIME_LIMIT`, or none for a theorem.
    level
        Verification level that was asked for.

    Raises
    ------
    PeriluneError
        If the limit is not a positive number.
    """
    if stated is None:
        return math.inf if level == THEOREM else TIME_LIMIT
    require_si_number(stated, "a time limit", 'time_limit=60.0; --time-limit "60 s" on the command line')
    if not stated > 0:
        raise PeriluneError("a time limit is a positive time", got=f"{stated:g} s", expected="more than 0 s")
    return float(stated)


def _out_of_time(problem: Problem, work: Progress, limit: float, end: TimeLimitReached) -> NotConvergedError:
    """Return the error for the end of the time limit, with the best flight known."""
    found, known = work.flight(), "no flight is known yet"
    if found is not None:
        flight, extremal = found
        kind = "an extremal" if extremal else "a rough flight of the direct method"
        known = f"best so far: {kind} with {objective_text(flight, 9)}, which is not proved"
    return NotConvergedError(
        f"the time limit of {format_quantity(limit, 's')} is reached",
        got=f"{known}; at work on: {work.stage or 'the start'}",
        expected="an answer and its proof",
        advice='more time (--time-limit "20 min", or time_limit=1200.0), a guess, or a lower --level; with --out DIR '
        "the best flight is kept",
        partial={"attempts": list(end.tried)},
        flight=None if found is None else found[0],
    )


def _no_minimum(solution: Solution) -> bool:
    """Return True if the second variation shows a better arc close by."""
    return solution.verification.level == 2 and any(c.name in SECOND_VARIATION for c in solution.verification.failed)


def _run_method(method: Method, problem: Problem, guess: Solution | None, watch: Watch | None) -> Solution:
    """Return the solution of a method, polished if the method asks for it."""
    try:
        if not getattr(method, "polish", False):
            return method.run(problem, guess, watch)
        from perilune.methods import solve_and_polish

        return solve_and_polish(cast("Pseudospectral", method), problem, guess, watch)
    except NotConvergedError:
        if (stated := with_budgets(problem, linear=True)) is not problem:
            return _run_method(method, stated, guess, watch)
        raise


__getattr__: Callable[[str], Any] = renamed_names(__name__, {"prove": "perilune.verify.verify"})
