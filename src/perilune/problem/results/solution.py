"""`Solution`, the one result type of every method: trajectories with costates, choices, history, proof.

A trajectory is stored as values *and rates* at nodes, and cubic Hermite interpolation between them is part of the
record: what is exported is exactly what the verifier flies. `perilune.problem.results.hermite_nodes` chooses nodes so
that this loses nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from perilune.core import (
    NUMERIC,
    Iteration,
    Matrix,
    Named,
    Outcome,
    PeriluneError,
    RenamedAttribute,
    Vector,
    check_call,
    renamed_keywords,
    require_index,
    warn_renamed,
)
from perilune.problem.controls import normalised
from perilune.problem.display.reprs import ShownSolution
from perilune.problem.problem import Problem
from perilune.problem.results.arc_sequence import NamedArc
from perilune.problem.results.dispersion import dispersion
from perilune.problem.results.equality import equal_fields
from perilune.problem.results.extrema import peaks
from perilune.problem.results.extremal import Extremal
from perilune.problem.results.trajectory import Trajectory, read_only_array
from perilune.problem.results.warnings import warnings_of
from perilune.problem.variables import Variable
from perilune.problem.verification import Verification

# The public parts of a `Verification`, by the names that they had when `verify` returned one.
_OF_VERIFICATION = {
    **{name: name for name in (*(f.name for f in fields(Verification)), "level", "title", "headline", "passed")},
    "failed": "failed", "text": "source", "told": "summary", "within": "tolerance_used",
}  # fmt: skip


@check_call
@dataclass(frozen=True, kw_only=True)
class Result:
    """A number requested of a solution, in SI; `label` is its name where that is not the result's with blanks."""

    value: float
    unit: str
    description: str = ""
    label: str = ""


@renamed_keywords(claimed="from_file", rung="initialization", tried="attempts")
@check_call
@dataclass(frozen=True, kw_only=True)
class Statistics:
    """A record of how the answer was found; `from_file` where only a file says so.

    `initialization` is the kind of start that led to it, `attempts` what was done for all. `iterations` and `arcs`
    count all that was done for it, in all starts together; `history` has the iterations of starts solved singly.
    """

    initialization: str = ""
    attempts: tuple[str, ...] = ()
    iterations: int = 0
    arcs: int = 0
    residual: float = float("nan")
    wall_time: float = float("nan")
    history: tuple[Iteration, ...] = field(default=(), repr=False)
    from_file: bool = False
    claimed: ClassVar[RenamedAttribute] = RenamedAttribute("from_file")
    rung: ClassVar[RenamedAttribute] = RenamedAttribute("initialization")
    tried: ClassVar[RenamedAttribute] = RenamedAttribute("attempts")


@renamed_keywords(listed="unverified_extremals")
@check_call
@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Solution(ShownSolution):
    """An answer of any method. Solutions are equal when everything in them is.

    Parameters
    ----------
    problem
        What was solved.
    method
        Name of the method.
    outcome
        How it ended.
    objective
        J in SI.
    free
        Values of the free parameters in SI, durations included.
    trajectories
        One for each phase.
    multipliers
        nu of the end conditions, by phase and condition name (``"descent.touchdown_altitude"``), in J per unit.
    extremals
        Every extremal found, best first; this solution is the first.
    unverified_extremals
        The same of a loaded solution, as its file states them. They were not found here, and are no `extremals`
        until `perilune.verify` has found each again.
    unknowns
        The method's own unknowns, so that it can start again from here (`method` says whose they are).
    structure
        The arcs that it consists of, by name, where they were detected.
    """

    problem: Problem
    method: str
    outcome: Outcome
    objective: float
    free: Mapping[str, float]
    trajectories: Sequence[Trajectory]
    multipliers: Mapping[str, float] = field(default_factory=dict)
    extremals: tuple[Extremal, ...] = ()
    unverified_extremals: tuple[Extremal, ...] = ()
    unknowns: Vector | None = None
    statistics: Statistics = field(default_factory=Statistics)
    verification: Verification = field(default_factory=Verification)
    structure: Sequence[NamedArc] = ()

    def __post_init__(self) -> None:
        for name, kind in (("free", "free parameter"), ("multipliers", "multiplier")):
            object.__setattr__(self, name, MappingProxyType(Named(kind, getattr(self, name))))
        if self.unknowns is not None:
            object.__setattr__(self, "unknowns", read_only_array(self.unknowns))

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Find what `perilune.verify` returned in earlier versions, the record itself, for one minor version."""
            if name not in _OF_VERIFICATION:
                raise AttributeError(f"'Solution' object has no attribute {name!r}", name=name, obj=self)
            new = _OF_VERIFICATION[name]
            warn_renamed(f"{name} of what verify returns", f"verify(...).verification.{new}")
            return getattr(self.verification, new)

    def __getstate__(self) -> dict[str, Any]:
        plain = {"free": dict(self.free), "multipliers": dict(self.multipliers), "trajectories": (*self.trajectories,)}
        plain["structure"] = (*self.structure,)
        return {f.name: getattr(self, f.name) for f in fields(self)} | plain

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Solution) and equal_fields(self, other))

    def __hash__(self) -> int:
        return hash((self.problem, self.method, self.outcome, tuple(self.free)))

    @property
    def parameters(self) -> Any:
        """Record ``p`` of all parameters in SI, as the physics receives it."""
        return self.problem.parameters(self.free)

    @property
    def duration(self) -> float:
        """Return the duration of the whole flight, all phases of it [s]."""
        return sum(trajectory.duration for trajectory in self.trajectories)

    @property
    def results(self) -> dict[str, Result]:
        """Return the results that the problem defines, by name.

        They are its `results`, the `end_outputs` and `integrals` of its phases, and what its `views` ask for; for a
        problem that defines no `results`, the flight time and the objective. NaN where they cannot be computed.
        """
        return Named("result", self._results)  # the caller's own copy

    @cached_property
    def _results(self) -> Mapping[str, Result]:
        problem, p = self.problem, self.parameters
        if problem.results is None:
            found = {
                "flight_time": Result(value=self.duration, unit="s"),
                "objective": Result(value=float(self.objective), unit=problem.objective_unit, description="J"),
            }
        else:
            first, last = (self.trajectories[i].state.values[i] for i in (0, -1))
            found = results_between(problem, first, last, p)
        for k, phase in enumerate(problem.phases):
            with np.errstate(all="ignore"):
                found |= _results_by_name(
                    phase.end_output_variables,
                    phase.evaluate("end_outputs", self.trajectories[k].state.values[-1], (), p),
                )
            for name, part in _results_by_name(phase.integral_variables, self._integrals(k)).items():
                so_far = found[name].value if name in found else 0.0
                found[name] = replace(part, value=so_far + part.value)
        return found | _results_by_name(*peaks(self)) | _results_by_name(*dispersion(self))

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Return what should be said with the answer: bounds that hold it back, ground, limits, ranges of the model.

        Each is a sentence; they change neither the outcome nor the proof, which are those of the problem as stated.
        """
        return warnings_of(self)

    @check_call
    def evaluate(self, phase: int, t: Vector) -> tuple[Matrix, Matrix]:
        """Return the state (states, n) and control (components, n) at times t [s], as the physics receives them.

        Cubic Hermite between nodes, then each `UnitVectorControl` normalised.

        Parameters
        ----------
        phase
            Number of the phase.
        t
            Times from the begin of the phase, (n,).
        """
        require_index(phase, len(self.trajectories), f"a phase of {self.problem.name}")
        trajectory = self.trajectories[phase]
        control = normalised(self.problem.phases[phase].controls, np.asarray(trajectory.control(t), dtype=float).T)
        return np.asarray(trajectory.state(t), dtype=float).T, control

    flown: ClassVar[RenamedAttribute] = RenamedAttribute("evaluate")
    listed: ClassVar[RenamedAttribute] = RenamedAttribute("unverified_extremals")

    @check_call
    def outputs(self, phase: int, t: Vector) -> dict[str, Vector]:
        """Return the phase's named outputs at times t, in SI.

        Parameters
        ----------
        phase
            Number of the phase.
        t
            Times from the begin of the phase [s], (n,).
        """
        flown = self.evaluate(phase, t)
        definition = self.problem.phases[phase]
        values = definition.evaluate("outputs", *flown, self.parameters)
        return {v.name: full(value, t) for v, value in zip(definition.output_variables, values, strict=True)}

    @check_call
    def inertial(self, phase: int, t: Vector) -> tuple[Matrix, Matrix, Matrix]:
        """Return position [m], velocity [m/s] and acceleration by thrust [m/s^2] in inertial axes, each (3, n).

        Parameters
        ----------
        phase
            Number of the phase.
        t
            Times from the phase's ignition [s].

        Raises
        ------
        PeriluneError
            If the problem states no inertial view of that phase.
        """
        flown, t = self.evaluate(phase, t), np.asarray(t, dtype=float)
        definition = self.problem.phases[phase]
        since = sum(trajectory.duration for trajectory in self.trajectories[:phase])
        values = definition.seen_inertially(*flown, since + t, self.parameters)
        if not values:
            raise PeriluneError(
                f"the phase {definition.name} of {self.problem.name} has no inertial view",
                advice="state it: Phase(inertial=...)",
            )
        rows = np.array([full(value, t) for value in values])
        return rows[:3], rows[3:6], rows[6:]

    def _integrals(self, phase: int) -> list[float]:
        """Integrate along a phase by Gauss's rule between the nodes of its curves, which have no kink inside."""
        definition, flown = self.problem.phases[phase], self.trajectories[phase]
        if definition.integrals is None:
            return []
        nodes = np.union1d(flown.state.time, flown.control.time)
        point, weight = np.polynomial.legendre.leggauss(5)
        half = 0.5 * np.diff(nodes)[:, None]
        t = (nodes[:-1, None] + half * (1 + point)).ravel()
        rates = definition.evaluate("integrals", *self.evaluate(phase, t), self.parameters)
        return [float((half * weight).ravel() @ full(rate, t)) for rate in rates]


def full(values: Any, t: Vector) -> Vector:
    """Return a quantity at every time, also where the physics returns one number for all.

    Parameters
    ----------
    values
        A number, or one for each time.
    t
        Times, (n,).

    Returns
    -------
    Vector
        A read-only view, (n,).
    """
    return np.broadcast_to(np.asarray(values, dtype=float), np.shape(t))


def results_between(problem: Problem, first: Sequence[float], last: Sequence[float], p: Any) -> dict[str, Result]:
    """Return the values of `Problem.results` for the states at both ends of a flight, NaN where it cannot be computed.

    The states come to the problem's function as the records that all its functions receive; components that are not
    known may be NaN.

    Parameters
    ----------
    problem
        The problem whose results are asked for.
    first, last
        States at the start of the first phase and at the end of the last one [SI].
    p
        Record of all parameters in SI.
    """
    if problem.results is None:
        return {}
    ends = [phase.state_record(*x) for phase, x in ((problem.phases[0], first), (problem.phases[-1], last))]
    try:
        with np.errstate(all="ignore"):
            values = problem.results(*ends, p, NUMERIC)
    except ArithmeticError:  # a file may hold what nothing can be computed with
        values = [np.nan] * len(problem.result_variables)
    return _results_by_name(problem.result_variables, values)


def _results_by_name(variables: Sequence[Variable], values: Sequence[Any]) -> dict[str, Result]:
    return {
        v.name: Result(value=float(value), unit=v.unit, description=v.description, label=v.label)
        for v, value in zip(variables, values, strict=True)
    }
