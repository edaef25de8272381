"""Members of a family: the problem of each, the order and place of computing, and the progress.

Every member passes the gate that `perilune.solve.solve` has, then its method, then the proof. Members along one
parameter lead to each other (`perilune.families.continuation`); all others are independent, so that any executor may
compute them in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

from perilune.core import Outcome, PeriluneError, Watch, format_quantity
from perilune.families.continuation import Continuation
from perilune.families.executors import Call, Submits, run_calls
from perilune.families.family import FamilyPoint, failed_point
from perilune.methods import Indirect, Method
from perilune.problem import (
    Finding,
    Problem,
    Solution,
    Tolerance,
    Verification,
    free_name,
    preflight,
    refuse_impossible,
    select_findings,
)
from perilune.solve import ended_in_time, solve
from perilune.verify import check_solution, verify, with_verification

Found = Iterator[tuple[int, FamilyPoint]]


@dataclass(frozen=True, kw_only=True)
class Members:
    """Members of a family, with the method and proof of each.

    Parameters
    ----------
    problem, names, values
        What is varied, the parameters, and their values [SI] of each member.
    method, level, tolerance
        How each is solved, to which verification level it is proved, and what differences do not matter to that.
    watch
        Receives a line of text for each member, and the iterations of those that are solved here.
    time_limit
        Of each [s].
    """

    problem: Problem
    names: tuple[str, ...]
    values: Sequence[tuple[float, ...]]
    method: Method
    level: int
    tolerance: Tolerance
    watch: Watch
    time_limit: float

    def solved(self, todo: Sequence[int], executor: Submits | None) -> Found:
        """Yield each of the members `todo` with its number, as soon as it is solved.

        Parameters
        ----------
        todo
            Numbers of the members.
        executor
            Where they are computed; None for this process.
        """
        if executor is None and len(self.names) == 1 and isinstance(self.method, Indirect):
            return self._continued(todo, self.method)
        return self._one_by_one(todo) if executor is None else self._elsewhere(todo, executor)

    def taken_over(
        self, stored: Mapping[int, FamilyPoint], executor: Submits | None, note: Callable[[str], None]
    ) -> Found:
        """Yield the stored members that hold, with their numbers: proved again, or marked as only stored.

        Parameters
        ----------
        stored
            Members as a store gives them, unverified.
        executor
            As for `solved`.
        note
            Receives a sentence for each member that does not hold, which is to be solved again.
        """
        claims: dict[int, Solution] = {}
        for i, point in stored.items():
            try:
                self._gate(i)
            except PeriluneError as error:
                yield i, failed_point(self.values[i], error)
                continue
            if point.solution is None or not self.level:
                yield i, replace(point, message=f"as stored: {point.message}".removesuffix(": "))
            else:
                claims[i] = point.solution

        def calls() -> Iterator[tuple[int, Call]]:
            for i, solution in claims.items():
                try:
                    solution.trajectories[0]  # read here, and not where it is sent away
                    yield i, (proof_of_member, solution, self.level)
                except PeriluneError as error:
                    note(f"stored member {i:06d} cannot be used ({error.what}) and is solved again")

        for number, (i, verification) in enumerate(run_calls(executor, calls()), 1):
            self.watch(f"stored members proved again: {number} of {len(claims)}")
            proved = verification and with_verification(claims[i], verification, self.level)
            if proved and proved.outcome is Outcome.PROVED:
                yield i, replace(stored[i], solution=proved)
            else:
                note(f"stored member {i:06d} does not prove and is solved again")

    def problem_of(self, i: int) -> Problem:
        """Return the problem of a member, whose values its records may refuse."""
        return self.problem.with_given(**dict(zip(self.names, self.values[i], strict=True)))

    @cached_property
    def _findings(self) -> Sequence[Finding]:
        """Return the comparisons with what physics allows, for all members at once."""
        return preflight(self.problem, dict(zip(self.names, zip(*self.values, strict=True), strict=True)))

    def _gate(self, i: int) -> Problem:
        """Return the problem of a member; raise if physics forbids it."""
        problem = self.problem_of(i)
        refuse_impossible(select_findings(self._findings, i))
        return problem

    def _say(self, i: int, more: str = "") -> None:
        problem, pairs = self.problem, zip(self.names, self.values[i], strict=True)
        named = ", ".join(
            f"{free_name(problem, name)} = {format_quantity(value, problem.unit_of(name))}" for name, value in pairs
        )
        self.watch(f"{named} ({i + 1} of {len(self.values)}){more}")

    def _one_by_one(self, todo: Sequence[int]) -> Found:
        for i in todo:
            self._say(i)
            try:
                solution = solve(
                    self._gate(i), self.method, verify=self.level, tolerance=self.tolerance, callback=self.watch,
                    time_limit=self.time_limit,
                )  # fmt: skip
                yield i, FamilyPoint(values=self.values[i], solution=solution)
            except PeriluneError as error:
                yield i, failed_point(self.values[i], error)

    def _continued(self, todo: Sequence[int], settings: Indirect) -> Found:
        walk = Continuation(settings, self.names[0])
        for i in todo:
            self._say(i)
            try:
                problem = self._gate(i)
                with ended_in_time(problem, self.watch, self.time_limit) as work:
                    solution = verify(walk.solve(problem, work), self.level, self.tolerance, work)
                yield i, FamilyPoint(values=self.values[i], solution=solution)
            except PeriluneError as error:
                walk.forget()
                yield i, failed_point(self.values[i], error)

    def _elsewhere(self, todo: Sequence[int], executor: Submits) -> Found:
        """Yield members solved by an executor, in the order of completion."""
        done, refused = len(self.values) - len(todo), list[tuple[int, FamilyPoint]]()
        how = self.method, self.level, self.tolerance, self.time_limit

        def calls() -> Iterator[tuple[int, Call]]:
            for i in todo:
                try:
                    yield i, (solved_member, self._gate(i), *how, self.values[i])
                except PeriluneError as error:
                    refused.append((i, failed_point(self.values[i], error)))

        for found in chain(run_calls(executor, calls()), (None,)):
            # What came back has a copy of the problem; the caller has the problem itself.
            back = [] if found is None else [(found[0], self._own(*found))]
            for i, point in (*refused, *back):
                done += 1
                said = " ".join(text for text in (point.outcome.name, point.tolerance_used) if text)
                self._say(i, f": {said}, {done} of {len(self.values)} done")
                yield i, point
            refused.clear()

    def _own(self, i: int, point: FamilyPoint) -> FamilyPoint:
        if point.solution is None:
            return point
        return replace(point, solution=replace(point.solution, problem=self.problem_of(i)))


def solved_member(
    problem: Problem, method: Method, level: int, tolerance: Tolerance, time_limit: float, values: tuple[float, ...]
) -> FamilyPoint:
    """Solve one member, in any process; a refusal is returned as a member with its reason.

    Parameters
    ----------
    problem, values
        The problem at the values of the member, and these [SI].
    method
        Method of solution.
    level, tolerance
        Level and tolerance of the proof.
    time_limit
        Time for the member [s].
    """
    try:
        solution = solve(problem, method, verify=level, tolerance=tolerance, time_limit=time_limit)
        return FamilyPoint(values=values, solution=solution)
    except PeriluneError as error:
        return failed_point(values, error)


def proof_of_member(solution: Solution, level: int) -> Verification | None:
    """Prove a stored member; None if its content cannot be computed with.

    Parameters
    ----------
    solution
        Stored solution of the member.
    level
        Level up to which it is proved.
    """
    try:
        return check_solution(solution, level)
    except PeriluneError:
        return None
