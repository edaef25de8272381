"""Members of a family: what each is asked, in what order or where they are computed, and how far it is.

Every member passes the gate that `perilune.solve.solve` has, then its method, then the proof. Members along one
parameter lead to each other (`perilune.families.continued`); all others are independent, so that any executor may
compute them in any order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from perilune.families.continued import Continuation
from perilune.families.family import FamilyPoint, failed_point
from perilune.methods.indirect import Indirect
from perilune.methods.method import Method
from perilune.problem.preflight import Finding, member, preflight, refuse_impossible
from perilune.problem.problem import Problem
from perilune.solve import prove, solve
from perilune.words.outcome import PeriluneError
from perilune.words.watch import Watch

Found = Iterator[tuple[int, FamilyPoint]]
_AHEAD = 1000  # members handed to an executor before the first of them is back
_PATIENCE = 0.2  # seconds between looks whether the user pressed Ctrl-C


class Submits(Protocol):
    """What a `concurrent.futures.Executor` and a Dask client have in common."""

    def submit(self, function: Any, /, *arguments: Any) -> Any:
        """Begin a call; what is returned has ``result``, ``cancel`` and ``add_done_callback``."""


@dataclass(frozen=True, kw_only=True)
class Members:
    """The members of a family and how each is solved.

    Parameters
    ----------
    problem, names, values
        What is varied, the parameters, and their values [SI] of each member.
    method, level
        How each is solved, and to which verification level it is proved.
    watch
        Receives a line of text for each member, and the iterations of those that are solved here.
    """

    problem: Problem
    names: tuple[str, ...]
    values: Sequence[tuple[float, ...]]
    method: Method
    level: int
    watch: Watch

    def solved(self, todo: Sequence[int], executor: Submits | None) -> Found:
        """Each of the members `todo` with its number, as soon as it is there."""
        if executor is None and len(self.names) == 1 and isinstance(self.method, Indirect):
            yield from self._continued(todo, self.method)
            return
        try:
            yield from self._one_by_one(todo) if executor is None else self._elsewhere(todo, executor)
        except BrokenExecutor as error:
            raise PeriluneError(
                "a worker of the sweep was lost",
                got=f"{type(error).__name__}: {error}",
                advice="with store=DIR (--out DIR) what was done is kept: run it again there (--resume)",
            ) from error

    def problem_of(self, i: int) -> Problem:
        """The problem of a member, which its own records may refuse."""
        return self.problem.with_given(**dict(zip(self.names, self.values[i], strict=True)))

    @cached_property
    def _findings(self) -> Sequence[Finding]:
        """What physics says of all members at once."""
        return preflight(self.problem, dict(zip(self.names, zip(*self.values, strict=True), strict=True)))

    def _gate(self, i: int) -> Problem:
        """The problem of a member that nothing forbids."""
        problem = self.problem_of(i)
        refuse_impossible(member(self._findings, i))
        return problem

    def _say(self, i: int, more: str = "") -> None:
        pairs = zip(self.names, self.values[i], strict=True)
        named = ", ".join(f"{name} = {value:g} {self.problem.unit_of(name)}" for name, value in pairs)
        self.watch(f"{named} ({i + 1} of {len(self.values)}){more}")

    def _one_by_one(self, todo: Sequence[int]) -> Found:
        for i in todo:
            self._say(i)
            try:
                solution = solve(self._gate(i), self.method, level=self.level, watch=self.watch)
                yield i, FamilyPoint(values=self.values[i], solution=solution)
            except PeriluneError as error:
                yield i, failed_point(self.values[i], error)

    def _continued(self, todo: Sequence[int], settings: Indirect) -> Found:
        chain = Continuation(settings, self.names[0], self.watch)
        for i in todo:
            self._say(i)
            try:
                solution = prove(chain.solve(self._gate(i)), self.level)
                yield i, FamilyPoint(values=self.values[i], solution=solution)
            except PeriluneError as error:
                chain.forget()
                yield i, failed_point(self.values[i], error)

    def _elsewhere(self, todo: Sequence[int], executor: Submits) -> Found:
        """By an executor, in the order in which they come back."""
        begun: dict[int, Any] = {}
        back: SimpleQueue[int] = SimpleQueue()
        waiting, done = iter(todo), len(self.values) - len(todo)
        refused: list[tuple[int, FamilyPoint]] = []
        try:
            while True:
                while len(begun) < _AHEAD and (i := next(waiting, None)) is not None:
                    try:
                        here = self._gate(i)
                    except PeriluneError as error:
                        refused.append((i, failed_point(self.values[i], error)))
                        continue
                    begun[i] = executor.submit(solved_member, here, self.method, self.level, self.values[i])
                    begun[i].add_done_callback(lambda _, i=i: back.put(i))
                found = refused or ([self._taken(back, begun)] if begun else [])
                if not found:
                    return
                refused = []
                for i, point in found:
                    done += 1
                    self._say(i, f": {point.outcome.name}, {done} of {len(self.values)} done")
                    yield i, point
        finally:
            for future in begun.values():
                future.cancel()

    def _taken(self, back: SimpleQueue[int], begun: dict[int, Any]) -> tuple[int, FamilyPoint]:
        """The next member that is back."""
        while True:
            try:
                i = back.get(timeout=_PATIENCE)
                break
            except Empty:
                continue
        point: FamilyPoint = begun.pop(i).result()
        if point.solution is None:
            return i, point
        # What came back has a copy of the problem; the caller has the problem itself.
        return i, replace(point, solution=replace(point.solution, problem=self.problem_of(i)))


def solved_member(problem: Problem, method: Method, level: int, values: tuple[float, ...]) -> FamilyPoint:
    """One member, in whichever process; what is refused comes back as a member with its reason."""
    try:
        return FamilyPoint(values=values, solution=solve(problem, method, level=level))
    except PeriluneError as error:
        return failed_point(values, error)
