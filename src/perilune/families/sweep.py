"""Families: solve along a given parameter, each member from its neighbour.

The base extremal (with any bounded free parameter held) is continued: predicted by its sensitivity to the parameter,
corrected by Newton, the step halved where that fails. At each value all extremals are then sought again, so that the
family follows the *global* optimum through a jump, such as that of Cho et al. 2015, Figs 9 and 10.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from perilune.methods.indirect import Indirect
from perilune.methods.search import Search
from perilune.problem.preflight import member, preflight, refuse_impossible
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution
from perilune.shooting.continuation import Member, follow
from perilune.shooting.function import Root
from perilune.solve import prove
from perilune.words.declared import parameter_name
from perilune.words.outcome import NotConvergedError, Outcome, PeriluneError, unknown_name
from perilune.words.types import Vector
from perilune.words.watch import Watch, silent


@dataclass(frozen=True, kw_only=True)
class FamilyPoint:
    """One member: the parameter's value in SI, the solution, or why there is none."""

    value: float
    solution: Solution | None
    message: str = ""
    failure: Outcome = Outcome.NOT_CONVERGED

    @property
    def outcome(self) -> Outcome:
        """The solution's outcome, or how the member failed."""
        return self.failure if self.solution is None else self.solution.outcome


@dataclass(frozen=True, kw_only=True)
class Family:
    """Solutions along one parameter, in the order that was asked for."""

    problem: Problem
    parameter: str
    unit: str
    points: tuple[FamilyPoint, ...]
    interrupted: bool = False


def sweep(
    problem: Problem,
    over: Mapping[str, Sequence[float]],
    method: Indirect | None = None,
    *,
    level: int = 0,
    watch: Watch | None = None,
) -> Family:
    """Solve along one parameter.

    Parameters
    ----------
    problem
        The problem; its own value of the parameter is not used.
    over
        ``{name: values}`` of one parameter, values in SI; a dot in the name may stand for an underscore. A free
        parameter named here is fixed to the values.
    method
        Settings of the indirect method.
    level
        Verification level of each member, 0 for none.
    watch
        Receives each iteration, and lines of text.

    Returns
    -------
    Family
        What was computed before Ctrl-C, if it was pressed.
    """
    name, values = _the_one_parameter(problem, over)
    settings, say = method or Indirect(), watch or silent
    points: list[FamilyPoint] = []
    base: Member | None = None
    interrupted = False
    found = preflight(problem, {name: values})  # of all members at once
    try:
        for i, value in enumerate(values):
            say(f"{name} = {value:g} {problem.unit_of(name)}")
            before = points[-1].value if points else None
            try:
                here = problem.with_given(**{name: value})
                refuse_impossible(member(found, i))
                solution, base = _solve_one(here, name, before, base, settings, level, say)
                points.append(FamilyPoint(value=value, solution=solution))
            except PeriluneError as error:
                base = None
                points.append(failed_point(value, error))
    except KeyboardInterrupt:
        interrupted = True
    return Family(
        problem=problem,
        parameter=name,
        unit=problem.unit_of(name),
        points=tuple(points),
        interrupted=interrupted,
    )


def failed_point(value: float, error: PeriluneError) -> FamilyPoint:
    """The member that an error stands in for: physics forbids it, or the search for it failed."""
    failure = Outcome.NOT_CONVERGED if isinstance(error, NotConvergedError) else Outcome.INFEASIBLE
    return FamilyPoint(value=value, solution=None, message=str(error), failure=failure)


def _the_one_parameter(problem: Problem, over: Mapping[str, Sequence[float]]) -> tuple[str, list[float]]:
    if len(over) != 1:
        raise PeriluneError("a sweep runs along one parameter", got=", ".join(over) or "none", expected="one name")
    name, values = next(iter(over.items()))
    name = parameter_name(name)
    known = sorted({*problem.given, *problem.free_names})
    if name not in known:
        raise unknown_name("parameter", name, known)
    numbers = [float(v) for v in values]
    if not numbers or not np.all(np.isfinite(numbers)):
        raise PeriluneError(f"the values of {name} must be finite numbers", got=str(numbers[:5]))
    return name, numbers


def _solve_one(
    problem: Problem,
    name: str,
    before: float | None,
    base: Member | None,
    settings: Indirect,
    level: int,
    say: Watch,
) -> tuple[Solution, Member | None]:
    """One member, by continuation from the base of the one before, else by the whole ladder; and its own base."""
    search = Search(settings, problem, say)
    continued = _continue(problem, name, before, base, search) if base is not None and before is not None else None
    return prove(search.solve(base=continued), level), search.base


def _continue(problem: Problem, name: str, before: float, base: Member, search: Search) -> Member | None:
    """The base extremal at the problem's own value of the parameter, from that at the value before."""
    target = problem.given[name].value
    if before == target:
        return base
    at, scale = list(problem.given).index(name), problem.scales.of(problem.unit_of(name))

    def numbers(value: float) -> Vector:
        p = search.p.copy()
        p[at] = value / scale
        return p

    def correct(y: Vector, value: float) -> Root:
        return search.correct(y, base.root, numbers(value))

    def tangent(root: Root, value: float) -> Vector:
        step = 1e-6 * max(abs(value), abs(target - before))  # a central difference of the residual
        return search.shooting.shift(root, numbers(value + step), numbers(value - step)) / (2 * step)

    reached = next(iter(follow(Member(value=before, root=base.root), [target], correct, tangent)))
    return None if reached is None else Member(value=base.value, root=reached.root)
