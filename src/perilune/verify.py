"""`verify`: check a solution by mathematics of its own, and state the level of proof that it reaches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from perilune.core import (
    Iteration,
    Outcome,
    PeriluneError,
    Watch,
    check_call,
    enter_computation,
    renamed_keywords,
    require_callable,
    require_level,
    require_type,
    sign_of_life,
    wrong_type_error,
)
from perilune.methods import Indirect, Method
from perilune.problem import LEVELS, THEOREM, Nature, Problem, Solution, Tolerance, Verification

if TYPE_CHECKING:
    from perilune.proof import Resolve


@renamed_keywords(watch="callback")
@check_call
def verify(
    solution: Solution,
    level: int = 3,
    tolerance: Tolerance | None = None,
    callback: Watch | None = None,
    *,
    resolve: Resolve | None = None,
    other: Method | None = None,
) -> Solution:
    """Verify a solution, wherever it comes from.

    Parameters
    ----------
    solution
        As a method or `perilune.load` gives it.
    level
        Verification level, of `perilune.proof.levels.examine` and for 5 of `perilune.rigorous`; 0 verifies nothing.
    tolerance
        As for `solve`; by default that with which the solution was solved, if any: ``Tolerance()`` is none.
    callback
        Is told of what takes long.
    resolve
        Solves the neighbouring problems of level 3; by default ``Indirect()``, from the solution.
    other
        The other method of level 4; by default ``Pseudospectral()``, and ``Indirect()`` for an answer of that.

    Returns
    -------
    Solution
        The same with the record of its checks as its `verification`, and the outcome that follows. Of a solution that
        was loaded, the extremals that its file lists are found again by Newton's method, or left out
        (`perilune.proof.recheck`). Where a check fails, its own extremal is called an optimum no longer.
    """
    require_type(solution, Solution, "a solution to verify")
    require_level(level, (0, *LEVELS))
    require_tolerance(tolerance)
    require_callable(resolve, "the method that solves again")
    require_callable(callback, "a callback")
    another = other if other is None else method_or_default(other)
    if tolerance is not None:
        solution = replace(solution, verification=Verification(tolerance=tolerance))
    if level == 0:
        return solution
    solution, notes = _keep_confirmed_extremals(solution)
    if solution.statistics.from_file:
        solution = replace(solution, structure=())  # a file's words, which nothing here has read off the tables
    found = check_solution(solution, level, callback, resolve=resolve, other=another)
    if not found.passed and solution.extremals:
        first, *others = solution.extremals
        named = replace(first, nature=nature_up_to_level(first.nature, found.level))
        solution = replace(solution, extremals=(named, *others))
    return with_verification(solution, replace(found, notes=(*notes, *found.notes)), level)


def check_solution(
    solution: Solution,
    level: int,
    watch: Watch | None = None,
    *,
    resolve: Resolve | None = None,
    other: Method | None = None,
) -> Verification:
    """Return the record of the checks of a solution, which is taken as it is.

    Parameters
    ----------
    solution, level
        What to check, and how far, from 1.
    watch
        Is told of what takes long.
    resolve, other
        As for `verify`.
    """
    from perilune.proof import examine

    add_theorem = theorem_prover() if level == THEOREM else None
    usual = level if add_theorem is None else THEOREM - 2
    with enter_computation(watch) as work:
        work.at_work("proof: independent re-integration")
        found = examine(solution, usual, resolve or _solve_again, other)
        if add_theorem is not None and found.level < usual:
            why = f"no theorem: it is attempted only from level {usual}, and this solution reaches level {found.level}"
            return replace(found, notes=(why, *found.notes))
        return found if add_theorem is None else add_theorem(found, solution, work)


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
    if not solution.unverified_extremals:
        return solution, ()
    from perilune.proof import confirm_listed_extremals

    extremals, notes = confirm_listed_extremals(solution, _solve_again)
    return replace(solution, extremals=extremals, unverified_extremals=()), notes


def theorem_prover() -> Callable[[Verification, Solution, Watch | None], Verification]:
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
