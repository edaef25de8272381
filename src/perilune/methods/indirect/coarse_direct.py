"""Coarse direct solution behind the indirect method: a start, a flight to keep, or the reason for none."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from perilune.core import PeriluneError, Vector, Watch, ignore_events, remember_best
from perilune.methods.indirect.settings import SearchSettings
from perilune.problem import Problem, Solution, Variable, objective_text, scalars
from perilune.structures import contacts_in_phase, stays_between_bounds

_SEGMENTS = 8  # of a phase; of several phases together at first
_FOLLOWED = 1e-3  # relative mesh error up to which a mesh has followed a flight, and a finer one shows no other
_CLOSE = 1e-4  # the same up to which Newton's method starts as well from there as from what a finer mesh shows
_BROKEN = 1e-3  # of its range: what a path condition may be broken by between the points of a mesh that is not refined
_NOT_KEPT = 0.02  # the same beyond which a flight is not said to keep it
_TOUCHING = 1e-3  # of its range
_FEW = 3  # switches that a mesh of eight segments follows
_FINER = 100  # most iterations of an attempt on the finer mesh
_NO_LENGTH = 1e-4  # of a flight: a phase that is shorter has none
_LOOKS = 400  # times of a phase at which its conditions are looked at


def path_condition_values(problem: Problem, flight: Solution, ends: float = 0.0) -> Iterator[tuple[Variable, Vector]]:
    """Yield each path condition with its values [SI] along a flight, less a share of the phase at both ends.

    Where such a share is left out, so are phases that have shrunk to nothing: they are all ends.

    Parameters
    ----------
    problem, flight
        The problem and a solution of it.
    ends
        Share of each phase that is left out at either end.
    """
    least = _NO_LENGTH * flight.duration if ends else 0.0
    for k, (phase, flown) in enumerate(zip(problem.phases, flight.trajectories, strict=True)):
        if flown.duration < least:
            continue
        x, u = flight.evaluate(k, np.linspace(ends, 1.0 - ends, _LOOKS) * flown.duration)
        yield from phase.path_along(x, u, flight.parameters)


@dataclass
class Coarse:
    """The direct method's attempts at one problem.

    Parameters
    ----------
    settings, problem
        What it runs with, and on what.
    tried
        Receives a line of all attempts of a run.
    watch
        Receives one of each attempt.

    Attributes
    ----------
    solution
        Its answer, however rough.
    refusal
        What it said where it had none.
    finer
        Segments of the finer meshes that were not tried yet.
    """

    settings: SearchSettings
    problem: Problem
    tried: list[str]
    watch: Watch = ignore_events
    solution: Solution | None = field(default=None, init=False)
    refusal: PeriluneError | None = field(default=None, init=False)
    finer: list[int] = field(init=False)

    def __post_init__(self) -> None:
        self.finer = [16, 24, 48] if self.settings.transcription is None else []

    def solve(self, guess: Solution | None = None) -> Solution | None:
        """Solve directly, without an initial guess or from a guess."""
        if self.solution is not None or self.refusal is not None:
            return self.solution
        # Phases are segments already: of several the mesh of one would be too fine to be found from straight lines.
        lines = self.settings.transcription is None and self.problem.initial_guess is None
        few = max(2, _SEGMENTS // len(self.problem.phases)) if lines else _SEGMENTS
        for segments in dict.fromkeys((few, _SEGMENTS)):
            try:
                self.solution = self._run(segments=segments, guess=self.solution or guess)
            except PeriluneError as error:
                self.refusal = error
            if self.solution is not None and _is_usable(self.solution):
                _report_rough_flight(self.problem, self.solution)
                break
        return self.solution

    @property
    def lost(self) -> bool:
        """Return True if its answer is one of many arcs that the mesh has not followed.

        Arcs along a condition on states are none: there the control of a mesh wavers, whatever the mesh.
        """
        known = self.solution
        return known is not None and known.statistics.residual > _FOLLOWED and switches_often(known)

    @property
    def blurred(self) -> bool:
        """Return True if no condition on states holds its answer, and a finer mesh comes closer to it.

        Where a control wavers, which may be singular, it does so on any mesh that has followed the flight.
        """
        known = self.solution
        if known is None or known.statistics.residual <= (_FOLLOWED if stays_between_bounds(known) else _CLOSE):
            return False
        least = _NO_LENGTH * known.duration
        lengths = [k for k, flown in enumerate(known.trajectories) if flown.duration >= least]
        return not any(contacts_in_phase(known, k) for k in lengths)

    def resolved(self) -> Iterator[Solution]:
        """Yield its answer, and where no mesh has followed that yet those on finer meshes, one by one."""
        if (known := self.solve()) is not None:
            yield known
        while known is not None and self.finer and (self.lost or self.blurred):
            with suppress(PeriluneError):
                self.solution = known = self._run(segments=self.finer.pop(0), iterations=_FINER, guess=known)
                yield known

    def without_limits(self) -> Solution | None:
        """Return its answer where nothing limits the states on the way; None where that has none either.

        Nor do extremals without arcs know of such limits. A program whose limits leave no room, as that of a dry mass
        that is only just reached, has no inside from which to be solved; without them it is solved at once, from a
        straight line or from the flight that misses least, and what is not has other reasons.
        """
        phases = tuple(
            replace(
                phase,
                path=None,
                states=tuple(replace(state, lower=-np.inf, upper=np.inf) for state in phase.states),
            )
            for phase in self.problem.phases
        )
        if all(new == old for new, old in zip(phases, self.problem.phases, strict=True)):
            return None
        self.watch("direct method: without the limits of the states")
        loose = Coarse(self.settings, self.problem.changed(phases=phases, form=None), self.tried, self.watch)
        nearest = getattr(self.refusal, "flight", None)
        for guess in (None,) if nearest is None else (None, nearest):
            with suppress(PeriluneError):
                return replace(loose._run(segments=_SEGMENTS, guess=guess, near=True), problem=self.problem)
        return None

    def without_bounds(self, name: str, guess: Solution) -> Solution | None:
        """Return its answer on a finer mesh, from a flight, where nothing bounds one state; None where it has none.

        Parameters
        ----------
        name
            Name of the state whose bounds are lifted, in every phase that has it.
        guess
            Trajectory to start from.
        """
        free = {"lower": -np.inf, "upper": np.inf}
        phases = tuple(
            replace(phase, states=tuple(replace(s, **free) if s.name == name else s for s in phase.states))
            for phase in self.problem.phases
        )
        loose = Coarse(self.settings, self.problem.changed(phases=phases, form=None), self.tried, self.watch)
        with suppress(PeriluneError):
            return loose._run(segments=2 * _SEGMENTS, iterations=_FINER, guess=guess)
        return None

    @cached_property
    def flight(self) -> Solution | None:
        """Its answer if that is good enough to keep; what is rough is solved again on a finer mesh, within bounds."""
        known = self.solution
        if known is None:
            return None
        if not _is_usable(known) or self._broken(known, _BROKEN):
            with suppress(PeriluneError):  # then the first is all there is
                finer = self._run(segments=16, iterations=_FINER, guess=known)
                known = finer if _is_usable(finer) else known
        return known if _is_usable(known) and not self._broken(known, _NOT_KEPT) else None

    def _broken(self, flight: Solution, share: float) -> bool:
        return any(-values.min() > share * np.ptp(values) for _, values in path_condition_values(self.problem, flight))

    def _run(
        self, segments: int, iterations: int = 300, guess: Solution | None = None, *, near: bool = False
    ) -> Solution:
        from perilune.methods.direct.pseudospectral import Pseudospectral  # and with it much of SciPy

        method = self.settings.transcription or Pseudospectral(
            nodes=5, segments=segments, refine=0, iterations=iterations
        )
        try:
            if near:
                from perilune.direct import MeshRefinement

                refinement = MeshRefinement(settings=method, problem=self.problem, watch=self.watch)
                *_, solution = refinement.answers(guess, near=True)
            else:
                solution = method.run(self.problem, guess, self.watch)
        except PeriluneError as error:
            self._say(getattr(error, "partial", {}).get("attempts", (error.what,)))
            raise
        self._say(solution.statistics.attempts)
        return solution

    def _say(self, lines: tuple[str, ...]) -> None:
        """Report one line; what a mesh missed, condition by condition, stays with the direct method."""
        self.tried.append("direct transcription: " + "; ".join(line.partition(" (")[0] for line in lines))


def _report_rough_flight(problem: Problem, rough: Solution) -> None:
    """Report a rough flight, which is what a time limit would leave."""

    def told_of() -> str:
        return f"a rough flight with {objective_text(rough)}, mesh error {rough.statistics.residual:.1g}"

    remember_best(problem, rough.objective, told_of, lambda: rough, extremal=False)


def nearly_active_conditions(flight: Solution) -> set[str]:
    """Return path conditions that a flight comes so near to, at the nodes of its tables, that they may hold it back."""
    found = set[str]()
    for phase, flown in zip(flight.problem.phases, flight.trajectories, strict=True):
        if not phase.path_conditions:
            continue
        t = flown.state.time
        u = flown.control.values if np.array_equal(flown.control.time, t) else flown.control(t)
        along = phase.path_along(flown.state.values.T, u.T, flight.parameters)
        found |= {condition.name for condition, room in along if np.min(room) <= _TOUCHING * np.ptp(room)}
    return found


def switches_often(flight: Solution) -> bool:
    """Return True if a bounded control goes through the middle of its range more often than a few times.

    Crossings where a condition on states is at its limit are not counted.
    """
    for k, (phase, flown) in enumerate(zip(flight.problem.phases, flight.trajectories, strict=True)):
        t = np.linspace(0.0, flown.duration, _LOOKS)
        if not scalars(phase.controls):
            continue
        for contact in contacts_in_phase(flight, k):
            t = t[(t < contact.begin) | (t > contact.end)]
        u = flown.control(t)
        for at, control in scalars(phase.controls):
            if control.bounded:
                high = control.share(u[:, at], flight.parameters) > 0.5
                if np.count_nonzero(high[1:] != high[:-1]) > _FEW:
                    return True
    return False


def _is_usable(solution: Solution) -> bool:
    from perilune.direct import ROUGHEST

    return solution.statistics.residual < ROUGHEST
