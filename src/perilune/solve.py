"""`solve`: compare the problem with what physics allows, run a method, prove the answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, cast

from perilune.core.callbacks import (
    Iteration,
    Progress,
    TimeLimitReached,
    Watch,
    enter_computation,
    remember_best,
    sign_of_life,
)
from perilune.core.errors import NotConvergedError, Outcome, PeriluneError
from perilune.core.units import format_quantity
from perilune.core.validation import (
    check_call,
    require_callable,
    require_level,
    require_si_number,
    require_type,
    wrong_type_error,
)
from perilune.methods import Indirect, Method
from perilune.problem.display.quantity_names import objective_text
from perilune.problem.presolve import preflight, refuse_impossible
from perilune.problem.problem import Problem
from perilune.problem.results.extremal import Nature
from perilune.problem.results.solution import Solution
from perilune.problem.tolerance import Tolerance
from perilune.problem.verification import LEVELS, THEOREM, Verification
from perilune.structures.monotone_limits import with_budgets

TIME_LIMIT = 600.0  # s, where none is stated: the hardest answers take a minute or two
SECOND_VARIATION = ("conjugate_point", "second_variation", "nothing_gained")  # checks of level 3

if TYPE_CHECKING:
    from perilune.methods import Pseudospectral
    from perilune.proof import Resolve


@check_call
def solve(
    problem: Problem,
    method: Method | None = None,
    *,
    guess: Solution | None = None,
    level: int = 3,
    tolerance: Tolerance | None = None,
    watch: Watch | None = None,
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
    level
        Verification level to prove, 0 for none; 4 solves the problem by another method too, 5 proves a theorem.
    tolerance
        Differences that do not matter to the proof, which then says so; by default only rounding does not.
    watch
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
    require_level(level, (0, *LEVELS))
    if level == THEOREM:
        _theorem()  # what is not installed is said before the work
    require_callable(watch, "a watch")
    require_tolerance(tolerance)
    with ended_in_time(problem, watch, require_time_limit(time_limit, level)) as work:
        refuse_impossible(preflight(problem))
        try:
            return _solved_and_proved(method_or_default(method), problem, guess, level, tolerance, work)
        except NotConvergedError as error:
            from perilune.methods import with_binding_limit

            # Of the problem as it came: a limit that is said at the end too gives nowhere alone.
            raise with_binding_limit(problem, error, work) from None


@contextmanager
def ended_in_time(problem: Problem, watch: Watch | None, limit: float) -> Iterator[Progress]:
    """Enter the search for a problem, which ends with `NotConvergedError` where its time [s] is over."""
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
    solution = prove(solution, level, tolerance, work)
    if guess is None and isinstance(method, Indirect) and _no_minimum(solution):
        further = method.beyond(problem, solution, work)
        if further is not None and (better := prove(further, level, tolerance, work)).verification.level >= 3:
            return better
    return solution


def require_time_limit(stated: float | None, level: int) -> float:
    """Return the time limit [s] that holds."""
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
        partial={"tried": list(end.tried)},
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


def method_or_default(method: Method | None) -> Method:
    """Return the method that was asked for, ``Indirect()`` for none.

    Raises
    ------
    PeriluneError
        If it is not a method, such as a name or a class.
    """
    if method is None:
        return Indirect()
    if isinstance(method, type) or not callable(getattr(method, "run", None)):
        raise wrong_type_error(method, "Indirect(), Pseudospectral(), Hybrid(...) or None", "a method")
    return method


def require_tolerance(tolerance: Tolerance | None) -> None:
    """Refuse anything but a `Tolerance`."""
    if tolerance is not None:
        require_type(tolerance, Tolerance, "a tolerance of the proof", "Tolerance(position=0.001), numbers in SI")


@check_call
def prove(
    solution: Solution, level: int = 3, tolerance: Tolerance | None = None, watch: Watch | None = None
) -> Solution:
    """Prove a solution, wherever it comes from.

    Parameters
    ----------
    solution
        As a method or `perilune.load` gives it.
    level
        Verification level; 0 proves nothing.
    tolerance
        As for `solve`; by default that with which the solution was solved, if any: ``Tolerance()`` is none.
    watch
        Is told of what takes long.

    Returns
    -------
    Solution
        The same with its verification, and the outcome that follows. Of a solution that was loaded, the extremals that
        its file lists are found again by Newton's method, or left out (`perilune.proof.recheck`). Where a check fails,
        its own extremal is called an optimum no longer.
    """
    require_type(solution, Solution, "a solution to prove")
    require_level(level, (0, *LEVELS))
    require_tolerance(tolerance)
    if tolerance is not None:
        solution = replace(solution, verification=Verification(tolerance=tolerance))
    if level == 0:
        return solution
    solution, notes = _keep_confirmed_extremals(solution)
    if solution.statistics.claimed:
        solution = replace(solution, structure=())  # a file's words, which nothing here has read off the tables
    verification = verify(solution, level=level, watch=watch)
    if not verification.passed and solution.extremals:
        first, *others = solution.extremals
        named = replace(first, nature=nature_up_to_level(first.nature, verification.level))
        solution = replace(solution, extremals=(named, *others))
    return with_verification(solution, replace(verification, notes=(*notes, *verification.notes)), level)


def nature_up_to_level(nature: Nature, level: int) -> Nature:
    """Return the nature that a proof up to a level confirms; an optimum is then only a local one.

    Parameters
    ----------
    nature
        Nature of an extremal.
    level
        Highest level of proof that it passed.
    """
    local = nature.dominated
    optimum = local in (Nature.LOCAL_OPTIMUM, Nature.LOCAL_OPTIMUM_AT_BOUND)
    return local if level >= (3 if optimum else 2) else Nature.UNPROVED


def with_verification(solution: Solution, verification: Verification, level: int) -> Solution:
    """Return the solution with a verification, and the outcome that follows for the level that was asked for.

    Parameters
    ----------
    solution, verification
        The solution, and the result of its proof.
    level
        Level that was asked for.
    """
    proved = verification.passed and verification.level >= level
    return replace(solution, verification=verification, outcome=Outcome.PROVED if proved else Outcome.NOT_PROVED)


def _keep_confirmed_extremals(solution: Solution) -> tuple[Solution, tuple[str, ...]]:
    """Return the solution with the confirmed ones of its listed extremals, and notes on the others."""
    if not solution.listed:
        return solution, ()
    from perilune.proof import confirm_listed_extremals

    extremals, notes = confirm_listed_extremals(solution, _solve_again)
    return replace(solution, extremals=extremals, listed=()), notes


@check_call
def verify(
    solution: Solution,
    level: int = 3,
    resolve: Resolve | None = None,
    other: Method | None = None,
    tolerance: Tolerance | None = None,
    watch: Watch | None = None,
) -> Verification:
    """Check a solution; see `perilune.proof.levels.examine`, and for level 5 `perilune.rigorous.verified`.

    Parameters
    ----------
    solution, level
        What to check, and how far.
    resolve
        Solves the neighbouring problems of level 3; by default ``Indirect()``, from the solution.
    other
        The other method of level 4; by default ``Pseudospectral()``, and ``Indirect()`` for an answer of that.
    tolerance
        As for `prove`.
    watch
        Is told of what takes long.
    """
    from perilune.proof import examine

    require_type(solution, Solution, "a solution to verify")
    require_callable(resolve, "the method that solves again")
    require_tolerance(tolerance)
    require_callable(watch, "a watch")
    require_level(level, LEVELS)
    add_theorem = _theorem() if level == THEOREM else None
    usual = level if add_theorem is None else THEOREM - 2
    another = other if other is None else method_or_default(other)
    with enter_computation(watch) as work:
        work.at_work("proof: independent re-integration")
        found = examine(solution, usual, resolve or _solve_again, another, tolerance)
        if add_theorem is not None and found.level < usual:
            why = f"no theorem: it is attempted only from level {usual}, and this solution reaches level {found.level}"
            return replace(found, notes=(why, *found.notes))
        return found if add_theorem is None else add_theorem(found, solution, work)


def _theorem() -> Callable[[Verification, Solution, Watch | None], Verification]:
    """Return the function that adds level 5.

    Raises
    ------
    PeriluneError
        If ball arithmetic is not installed.
    """
    try:
        from perilune.rigorous import add_theorem_checks
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "flint":
            raise
        raise PeriluneError(
            "a theorem needs python-flint, which is not installed", advice="pip install 'perilune[rigorous]'"
        ) from None
    return add_theorem_checks


def _solve_again(problem: Problem, guess: Solution) -> Solution:
    def work(_: Iteration | str) -> None:
        sign_of_life("proof: neighbouring problems are solved")

    return Indirect().run(problem, guess, work)
