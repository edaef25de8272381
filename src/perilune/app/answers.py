"""Flights at values of the parameters: from an atlas, or followed from the last flight."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from perilune import InfeasibleError, NotConvergedError, Parameter, PeriluneError, Problem, Solution, solve
from perilune.atlas import Atlas, Mapped
from perilune.conditions import extremal_parameters
from perilune.core import CANNOT_BE_FLOWN, Iteration, Watch, ignore_events
from perilune.methods import Curves, solution_violations
from perilune.shooting import Shooting

_SAME = 1e-12  # relative: a value that was not moved
_FAMILY = 24  # extremals of a family to either side
# Times of CPU [s], as others may keep the machine busy.
_FOLLOW = 20.0  # from the flight before, which takes no more where it leads anywhere
_PATIENT = 1.0, 4.0  # for one step of it at least; times what the step before took
_STEP = 1 / 3  # of that time, for one step: what leads nowhere leaves some to smaller ones
_SMALLEST = 1 / 16  # of the way: a step that is not halved again
_LOOK = 0.5  # without an initial guess, where no neighbour leads to an extremal
_QUICK = 3.0  # without a guess before smaller steps, if the first flight was found in less; then for these
_SLACK = 1e-6  # canonical, that is far above the errors of a flight, and far below what anybody sees of it


@dataclass(frozen=True, kw_only=True)
class FlightAnswer:
    """Flight with its origin, and the time that it took.

    Parameters
    ----------
    solution
        The flight.
    source
        ``map``, ``neighbour``, or ``nothing``.
    words
        The same for people.
    latency
        Until it was there [s].
    """

    solution: Solution
    source: str
    words: str
    latency: float


class NoNearbyFlight(PeriluneError):
    """Failure to follow the flight before; a cold start may find one."""


@dataclass
class Answering:
    """Answers one client.

    Parameters
    ----------
    problem
        What is explored.
    atlas
        Where it is mapped, if it is.
    last
        The flight from which neighbours begin, of a file if there is one at first.
    patience
        How long a step from there may take until a smaller one is tried [s].
    """

    problem: Problem
    atlas: Atlas | None = None
    last: Solution | None = field(default=None)
    patience: float = _FOLLOW
    _from_first: bool = field(default=True, init=False)  # whether the flight at the first values may still be tried
    _quick: bool = field(default=False, init=False)  # whether the last without a guess took less than `_QUICK`
    _saved: bool = field(default=False, init=False)  # whether the last flight is that of a file, as it stands there

    def __post_init__(self) -> None:
        """Note that a flight known at the start comes from a file."""
        self._saved = self.last is not None

    def at(
        self, values: Mapping[str, float], watch: Watch = ignore_events, patient: Watch | None = None
    ) -> FlightAnswer:
        """Return the flight at values of given parameters [SI]; all others are as the problem has them.

        `patient` replaces `watch` while the flight at the first values is found, from which all others are followed.

        Parameters
        ----------
        values
            Values of given parameters by name [SI].
        watch
            Called with each iteration and with lines of text.
        patient
            The same for the longer search of the flight at the first values.

        Raises
        ------
        NoneNear
            If none is near the flight before, and a short cold start found none.
        PeriluneError
            If there is none, with the reason.
        """
        began, why = time.perf_counter(), ""
        try:
            found = self._mapped(values)
        except InfeasibleError:
            raise
        except PeriluneError as error:
            found, why = None, f" (the map: {error.what})"  # which ends here; a neighbour may know more
        if found is None:
            near, source, words = self._near(values, watch, patient or watch)
            found = near, source, words + why
        self._saved &= found[0] is self.last
        self.last = found[0]
        return FlightAnswer(solution=found[0], source=found[1], words=found[2], latency=time.perf_counter() - began)

    def _mapped(self, values: Mapping[str, float]) -> tuple[Solution, str, str] | None:
        atlas = self.atlas
        if atlas is None:
            return None
        axes = set(atlas.region.names)
        for name, value in values.items():
            if name not in axes and abs(value - self.problem.given[name].value) > _SAME * (1.0 + abs(value)):
                return None
        asked = {name: values.get(name, self._middle(atlas, name)) for name in axes}
        found: Mapped = atlas.query(**asked)
        steps = "step" if found.query.steps == 1 else "steps"
        words = f"from the map, polished in {found.query.steps} {steps}, re-integrated independently"
        return found, "map", words

    def _middle(self, atlas: Atlas, name: str) -> float:
        if name in self.problem.given:
            return float(self.problem.given[name].value)
        axis = next(axis for axis in atlas.region.axes if axis.name == name)
        return 0.5 * (float(axis.low) + float(axis.high))

    def problem_at(self, values: Mapping[str, float]) -> Problem:
        """Return the problem at values of given parameters [SI].

        Raises
        ------
        PeriluneError
            If one of them is outside its declared range.
        """
        return self.problem.with_given(**{name: value for name, value in values.items() if name in self.problem.given})

    def _near(self, values: Mapping[str, float], watch: Watch, patient: Watch) -> tuple[Solution, str, str]:
        problem = self.problem_at(values)
        if self.last is None:
            return self._begun(problem, watch, patient)
        if self._saved:
            if _same_given_values(problem, self.last.problem):
                return self.last, "neighbour", "as it was saved"
            self._saved = False
            with suppress(PeriluneError):  # its arcs, which a file does not hold, are found once for all neighbours
                self.last = solve(self.last.problem, guess=self.last, verify=0, callback=patient)
        words = "an extremal near the previous flight"
        longest = min(self.patience, _STEP * _FOLLOW)
        if (near := self._stepped(problem, self.last, watch, longest)) is not None:
            return near, "neighbour", words
        why = None
        if self._quick:  # that there is none is told as soon as a solve would
            try:
                return self._found(problem, _limit_cpu_time(watch, _QUICK))
            except _CpuTimeExceeded:
                self._quick = False
            except NotConvergedError as error:
                why = error
        limit = _FOLLOW if why is None else _QUICK
        near, steps = self._followed(problem, self.last, watch, step=0.5, limit=limit)
        if near is not None:
            return near, "neighbour", words + (f", followed in {steps} steps" if steps > 1 else "")
        if why is not None:
            raise why
        try:  # a family that ends here: without a guess another may be found
            return self._found(problem, _limit_cpu_time(watch, _LOOK))
        except _CpuTimeExceeded:
            what = "there is no extremal near the previous flight"
            advice = "wait: a search without an initial guess is running"
            raise NoNearbyFlight(what, advice=advice) from None

    def _begun(self, problem: Problem, watch: Watch, patient: Watch) -> tuple[Solution, str, str]:
        """Find the first flight; a link may hold values that a slider reached, and a cold start does not, or not soon.

        Then it is followed from the flight at the first values, which is searched for once.
        """
        if _same_given_values(problem, self.problem):
            self._from_first = False
            return self._found(problem, patient)
        if not self._from_first:
            return self._found(problem, watch)
        try:
            return self._found(problem, _limit_cpu_time(watch, _FOLLOW))
        except (NotConvergedError, _CpuTimeExceeded) as error:
            why = error
        self._from_first = False
        with suppress(PeriluneError):
            self.last = self._found(self.problem, patient)[0]
            near, _ = self._followed(problem, self.last, watch)
            if near is not None:
                soon = "" if isinstance(why, NotConvergedError) else f" in {_FOLLOW:g} s of CPU"
                words = "an extremal near the flight at the first values; "
                words += f"a search without an initial guess found none{soon}"
                return near, "neighbour", words
        if isinstance(why, NotConvergedError):
            raise why
        return self._found(problem, watch)

    def _found(self, problem: Problem, watch: Watch) -> tuple[Solution, str, str]:
        began = time.thread_time()
        found = solve(problem, verify=0, callback=watch)
        took = time.thread_time() - began
        self._quick = took < _QUICK
        self.patience = max(_PATIENT[0], took)  # to follow need not take longer than to find
        return found, "nothing", f"found without an initial guess, best of {len(found.extremals)} found"

    def _followed(
        self, problem: Problem, last: Solution, watch: Watch, *, step: float = 1.0, limit: float = _FOLLOW
    ) -> tuple[Solution | None, int]:
        """Follow the flight before to a problem, halving steps that fail; returns also the number of steps.

        Each flight on the way is the start of the next step, also of one to newer values, for which this may be
        dropped. After the smallest step the whole rest of the way is tried while there is time.

        Raises
        ------
        InfeasibleError
            If nothing flies there, whatever is tried.
        """
        end, begin = time.thread_time() + limit, last.problem.given
        reached, steps = 0.0, 0
        while step >= _SMALLEST:
            to = min(reached + step, 1.0)
            try:
                at = self._between(begin, problem, to)
                longest = min(self.patience, _STEP * limit, end - time.thread_time())
                found = self._stepped(at, last, watch, longest)
            except PeriluneError:
                if to == 1.0:
                    raise
                found = None  # what lies between two problems need not make sense
            if found is None:
                step *= 0.5
                watch(f"following the previous flight in smaller steps: {reached:.0%} of the way")
                continue
            self.last, reached, steps = found, to, steps + 1
            if reached == 1.0:
                return found, steps
            last = found
        return self._stepped(problem, last, watch, end - time.thread_time()), steps + 1

    def _between(self, begin: Mapping[str, Parameter], problem: Problem, share: float) -> Problem:
        if share == 1.0:
            return problem
        ways = {name: (begin[name].value, given.value) for name, given in problem.given.items()}
        return problem.with_given(**{name: a + share * (b - a) for name, (a, b) in ways.items() if a != b})

    def _stepped(self, problem: Problem, last: Solution, watch: Watch, limit: float) -> Solution | None:
        """Follow a flight to other values within `limit` seconds of CPU; None if that fails or breaks the path.

        Raises
        ------
        InfeasibleError
            If nothing flies there, whatever is tried.
        """
        began = time.thread_time()
        try:
            found = solve(problem, guess=last, verify=0, callback=_limit_cpu_time(watch, limit))
        except (PeriluneError, _CpuTimeExceeded) as error:
            if isinstance(error, InfeasibleError) and error.reason == CANNOT_BE_FLOWN:
                raise
            return None
        if not meets_path_constraints(found):
            return None
        self.patience = max(_PATIENT[0], _PATIENT[1] * (time.thread_time() - began))
        return found


def _same_given_values(problem: Problem, other: Problem) -> bool:
    """Return True if the given values of two problems are equal, however they were stated."""
    return all(given.value == other.given[name].value for name, given in problem.given.items())


def meets_path_constraints(solution: Solution) -> bool:
    """Return True if a flight keeps the bounds and conditions along its path, which a neighbour of one need not."""
    return next(solution_violations(solution, _SLACK), None) is None


class _CpuTimeExceeded(BaseException):
    """End of the time of a short solve; no `Exception`, which a method would try to recover from."""


def _limit_cpu_time(watch: Watch, seconds: float) -> Watch:
    """Return the watch with a limit of CPU time [s], after which it raises `_CpuTimeExceeded`."""
    end = time.thread_time() + seconds

    def seen(event: Iteration | str) -> None:
        watch(event)
        if time.thread_time() > end:
            raise _CpuTimeExceeded

    return seen


def cost_along_free_parameter(solution: Solution) -> dict[str, object] | None:
    """Compute J of extremals with the first free parameter held, over the range of those found and a little more.

    None if nothing is free, or the answer has several arcs; else {"name", "unit", "values", "objective"}, SI.
    """
    curves = solution.trajectories
    if not isinstance(curves, Curves) or not solution.problem.free:
        return None
    shooting, root, problem = Shooting(curves.conditions), curves.root, curves.problem
    held, first = problem.free[0], curves.conditions.free_at.start
    scale = problem.scales.of(held.unit)
    here = float(root.y[first])
    width = 0.3 * max(abs(here), 0.1 * min(abs(held.upper - held.lower) / scale, 10.0))
    others = [extremal.free[held.name] / scale for extremal in solution.extremals if held.name in extremal.free]
    points = [(here, root.cost)]
    p = extremal_parameters(problem)
    for end in (min(here - width, *others), max(here + width, *others)):
        end = min(max(end, held.lower / scale), held.upper / scale)
        y = root.y
        for value in np.linspace(here, end, _FAMILY + 1)[1:]:
            found = shooting.root(y, p, shooting.holding({0: float(value)}), limit=20)
            if end == here or not found.converged:
                break
            y = found.y
            points.append((float(value), found.cost))
    points.sort()
    return {
        "name": held.name,
        "unit": held.unit,
        "values": [value * scale for value, _ in points],
        "objective": [cost * problem.objective_size for _, cost in points],
    }
