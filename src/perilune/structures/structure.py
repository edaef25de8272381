"""Structure of an answer: the arcs of each phase, with their active conditions and contact points.

On an *arc* nothing of the state is held, or it is a boundary arc *along* conditions: path conditions, or bounds of
states, S >= 0 that are 0 all along it. Of order q (`perilune.problem.tracing.lie_derivatives`) such an arc is entered
with S = S' = ... = S^(q-1) = 0, and S^(q) = 0 says what the control does on it. At the end of an arc a condition may
have a *contact point*: S = 0 and S' = 0.

Source: Bryson, Ho, *Applied Optimal Control*, 1975, sections 3.11 to 3.13.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate
from types import MappingProxyType
from typing import Any

from perilune.core.errors import PeriluneError, unknown_name
from perilune.core.units import quotient_unit
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.tracing.lie_derivatives import component, depends_on_control, derivatives_to_control
from perilune.problem.tracing.tape import Expression, Recorder
from perilune.problem.variables import Parameter, Variable

SIDES = ("lower", "upper")
Regimes = tuple[tuple[str, str], ...]  # scalar controls with "lower", "upper", "singular" or "held"


@dataclass(frozen=True)
class Arc:
    """One arc.

    Parameters
    ----------
    along
        Names of the conditions whose boundary arc it is, as `conditions_of` has them.
    touches
        Names of those with a contact point at its end.
    regimes
        Scalar controls that are on a bound, or singular, all along it, or held by its boundary conditions; of the
        others the control law decides.
    until
        When it ends, in seconds from the beginning of its phase, as far as that is known; NaN otherwise.
    """

    along: tuple[str, ...] = ()
    touches: tuple[str, ...] = ()
    regimes: Regimes = ()
    until: float = math.nan

    @property
    def text(self) -> str:
        """The arc in short."""
        held = [f"{name} singular" if regime == "singular" else f"{name} at its {regime} bound"
                for name, regime in self.regimes if regime != "held"]  # fmt: skip
        held = ["along " + ", ".join(self.along)] * bool(self.along) + held
        return " and ".join((*(held or ["free"]), *(f"touches {name}" for name in self.touches)))


@dataclass(frozen=True)
class Structure:
    """The arcs of every phase, in order of flight."""

    phases: tuple[tuple[Arc, ...], ...]

    @classmethod
    def free(cls, problem: Problem) -> Structure:
        """Return one arc for each phase, on which nothing is held."""
        return cls(tuple((Arc(),) for _ in problem.phases))

    def timed(self, durations: Sequence[Sequence[float]]) -> Structure:
        """Return the same with the times at which the arcs of each phase end, from how long each of them lasts [s]."""
        phases = []
        for arcs, lasting in zip(self.phases, durations, strict=True):
            ends = accumulate(lasting)
            phases.append(tuple(replace(arc, until=float(end)) for arc, end in zip(arcs, ends, strict=True)))
        return Structure(tuple(phases))

    @property
    def count(self) -> int:
        """Return the number of arcs."""
        return sum(len(arcs) for arcs in self.phases)

    @property
    def singular(self) -> bool:
        """Return True if a control is singular along an arc."""
        return any(regime == "singular" for arcs in self.phases for arc in arcs for _, regime in arc.regimes)

    @property
    def switched(self) -> bool:
        """Return True if scalars keep boundary arcs, and are on a bound everywhere else."""
        regimes = [regime for arcs in self.phases for arc in arcs for _, regime in arc.regimes]
        return "held" in regimes and "singular" not in regimes

    @property
    def plain(self) -> bool:
        """Return True if there is no boundary arc or contact point, and no phase is cut."""
        return all(len(arcs) == 1 and not (arcs[0].along or arcs[0].touches or arcs[0].regimes) for arcs in self.phases)

    def named(self, k: int) -> tuple[str, ...]:
        """Return every condition with a boundary arc or contact point in phase k, once each."""
        return tuple(dict.fromkeys(name for arc in self.phases[k] for name in (*arc.along, *arc.touches)))

    def ends(self, k: int, duration: float) -> list[float]:
        """Return the end of each arc of phase k [s] in a flight of that duration; in equal parts where not known.

        Parameters
        ----------
        k
            Index of the phase.
        duration
            Duration of the phase [s], to which known ends are stretched.
        """
        count, known = len(self.phases[k]), [arc.until for arc in self.phases[k]]
        if not all(math.isfinite(t) for t in known) or not known[-1] > 0:
            known = [float(i + 1) for i in range(count)]
        return [*(t / known[-1] * duration for t in known[:-1]), duration]

    @property
    def text(self) -> str:
        """The structure in short: ``descent: free, touches glide; along glide``."""
        parts = []
        for arcs in self.phases:
            parts.append(", ".join(arc.text for arc in arcs))
        return "; ".join(parts)


@dataclass(frozen=True, kw_only=True)
class Condition:
    """A condition that may have boundary arcs or contact points: a path condition, or the bound of a state.

    Parameters
    ----------
    name
        Of the path condition; of a bound ``state.lower`` or ``state.upper``.
    variable
        Unit and scale of S, and a name that is an identifier.
    values
        (S, S', ..., S^(q)) as functions of (x, u, p); the last is the first with a control in it, or S'' where none is
        in any. A bound that is a number is among the parameters as `plain_bounds` has it.
    bound
        (number of the state, side) of a bound; None for a path condition.
    """

    name: str
    variable: Variable
    values: tuple[Expression, ...]
    bound: tuple[int, str] | None = None

    @property
    def order(self) -> int:
        """Return the number of derivatives until a control appears; 2 where none does."""
        return len(self.values) - 1

    @property
    def steered(self) -> bool:
        """Return True if a control moves it. Else its phase's start determines it: it has contact points only."""
        return depends_on_control(self.values[-1])

    def rated(self, i: int, prefix: str, time: float) -> Variable:
        """Return the i-th derivative as a variable: name, unit and scale; `time` is the size of a second.

        Parameters
        ----------
        i
            Order of the time derivative, 0 for the condition itself.
        prefix
            Beginning of the name of the variable.
        time
            Canonical unit of time [s].
        """
        own, unit = self.variable, self.variable.unit
        for _ in range(i):
            unit = quotient_unit(unit, "s")
        name = prefix + own.name + ("_rate" if i else "") + (f"_{i}" if i > 1 else "")
        return Variable(name=name, unit=unit, scale=None if own.scale is None else own.scale / time**i)


Margins = Mapping[str, tuple[Variable, Expression, tuple[int, str] | None]]


def margins(problem: Problem, k: int) -> Margins:
    """Return every S >= 0 of phase k by its name: path conditions, then finite bounds of states.

    Parameters
    ----------
    problem
        The problem.
    k
        Index of the phase.
    """
    phase = problem.phases[k]
    path = problem.form.expressions.get((k, "path"))
    return _margins(path, phase.name, tuple(phase.path_conditions), tuple(phase.states))


@lru_cache(maxsize=64)
def _margins(
    path: Expression | None, phase: str, path_conditions: tuple[Variable, ...], states: tuple[Variable, ...]
) -> Margins:
    found = {}
    for i, variable in enumerate(path_conditions):
        assert path is not None, "stated with its conditions"
        found[variable.name] = (variable, component(path, i), None)
    for i, state in enumerate(states):
        for side in SIDES:
            limit = getattr(state, side)
            if isinstance(limit, str) or math.isfinite(limit):
                own = Variable(name=f"{state.name}_{side}", unit=state.unit, scale=state.scale)
                held = limit if isinstance(limit, str) else plain_bound(phase, state, side)
                found[f"{state.name}.{side}"] = (own, _bound_margin(state, side, held), (i, side))
    return MappingProxyType(found)


def conditions_of(problem: Problem, k: int, names: Sequence[str]) -> dict[str, Condition]:
    """Return the conditions of phase k that have these names, with their derivatives along the flight.

    Parameters
    ----------
    problem, k
        The problem and the number of the phase.
    names
        Names of conditions, as `margins` has them.

    Raises
    ------
    PeriluneError
        If there is no such condition.
    """
    phase, known, found = problem.phases[k], margins(problem, k), {}
    dynamics = problem.form.expressions[k, "dynamics"]
    for name in names:
        if name not in known:
            raise unknown_name(f"condition of {phase.name}", name, sorted(known))
        variable, value, bound = known[name]
        values = derivatives_to_control(value, dynamics, phase.state_names)
        found[name] = Condition(name=name, variable=variable, values=values, bound=bound)
    return found


def steering_controls(condition: Condition) -> set[str]:
    """Return the components of the control that keep a condition along its boundary arc."""
    return {op[1] for op in condition.values[-1].tape.instructions if op[0] == "u"}


def plain_bound(phase: str, state: Variable, side: str) -> str:
    """Return the given parameter, by name, that holds a numeric bound: formulas hold no numbers with a unit.

    Parameters
    ----------
    phase
        Name of the phase.
    state
        The bounded state.
    side
        "lower" or "upper".
    """
    return f"{phase}.{state.name}.{side}"


def plain_bounds(problem: Problem) -> dict[str, Parameter]:
    """Return the parameters, of all states, that hold a bound which is a number."""
    return {
        plain_bound(phase.name, state, side): Parameter(value=limit, unit=state.unit)
        for phase in problem.phases
        for state in phase.states
        for side in SIDES
        if not isinstance(limit := getattr(state, side), str) and math.isfinite(limit)
    }


def _bound_margin(state: Variable, side: str, limit: str) -> Expression:
    """Return the margin of a state to its bound, positive inside."""
    recorder = Recorder()
    x: Any = recorder.input("x", state.name)
    bound = recorder.input("p", limit)
    room = x - bound if side == "lower" else bound - x
    return Expression(recorder.tape([room]), ("x", "u", "p"), origin="a bound")


def without_bounds(phase: Phase, bounds: Sequence[tuple[int, str]]) -> tuple[Variable, ...]:
    """Return the states of a phase without some of their bounds.

    Parameters
    ----------
    phase
        The phase.
    bounds
        (number of the state, "lower" or "upper") of each bound to leave out.
    """
    states = list(phase.states)
    for i, side in bounds:
        states[i] = replace(states[i], **{side: -math.inf if side == "lower" else math.inf})
    return tuple(states)


def check_arc_structure(problem: Problem, structure: Structure) -> None:
    """Refuse a structure that is none of the problem's.

    Parameters
    ----------
    problem
        The user's problem.
    structure
        Arcs of each phase.

    Raises
    ------
    PeriluneError
        If it has other phases, or a phase without an arc.
    """
    if len(structure.phases) != len(problem.phases) or not all(structure.phases):
        raise PeriluneError(
            "a structure has at least one arc for each phase",
            got=f"{[len(arcs) for arcs in structure.phases]} arcs",
            expected=f"{len(problem.phases)} phases",
        )
