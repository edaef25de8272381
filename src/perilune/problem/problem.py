"""An optimal-control problem as data: phases, the links between them, what is given, what is free, what is minimised.

A `Problem` holds the user's functions and nothing of any method. In SI units throughout:

    minimise  J = objective(x(end of last phase), p)
    subject to  x' = dynamics(x, u, p)                on each phase, time from the phase's ignition
                x(0) = start(p)                       first phase
                x(0) = link(x(end of phase before), p)   later phases
                end(x(T), p) = 0,  path(x, u, p) >= 0

A *free initial state* is a `start` that depends on free parameters; a free duration is a free parameter named by the
phase. Running costs are states of their own. Every number that may be varied is a named parameter, *given* or *free*,
so a sweep, a continuation and a table are the same walk.

All functions take records with attribute access (``x.r``, ``p.thrust``) that also unpack in order, and the maths
namespace ``m`` of `perilune.words.maths`. Numbers with a dimension belong into parameters, not into the functions: the
problem is solved in canonical units, and construction tests that the physics is dimensionally homogeneous.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType, SimpleNamespace
from typing import Any

from perilune.problem.controls import Control, scalars
from perilune.problem.verification import Check
from perilune.problem.views import Views, check_views
from perilune.words.maths import NUMERIC
from perilune.words.outcome import PeriluneError, unknown_name
from perilune.words.types import Physics
from perilune.words.units import Scales, dimension_text, unit


def _in_si(name: str, text: str) -> None:
    """Inside, every number is in SI: a unit that would scale it is a mistake waiting to happen."""
    factor, dimension = unit(text)
    if factor != 1.0:
        raise PeriluneError(
            f"inside a problem numbers are in SI: {name}",
            got=f"the unit {text!r}",
            expected=repr(dimension_text(dimension)),
            advice="convert the number, or read it with units.parse_quantity",
        )


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A named component with its unit: a state, an end condition, a path condition or an output.

    `lower` and `upper` bound a state where a method can use it (direct transcription, verification); `label` is its
    name on the axis of a figure, where that is not `name` with blanks.
    """

    name: str
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ""
    label: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise PeriluneError("a name must be a Python identifier", got=repr(self.name))
        _in_si(self.name, self.unit)
        if not self.lower < self.upper:
            raise PeriluneError(
                f"bounds of {self.name} are empty",
                got=f"[{self.lower}, {self.upper}]",
                expected="lower < upper",
            )


@dataclass(frozen=True, kw_only=True)
class Given:
    """A parameter with a value in SI and its SI unit."""

    value: float
    unit: str = "1"

    def __post_init__(self) -> None:
        _in_si("a given value", self.unit)


@dataclass(frozen=True, kw_only=True)
class Free:
    """A parameter that the optimiser chooses, in SI.

    `typical` is its order of magnitude (a first value for methods that need one); a bound that is reached is reported
    as an extremal of its own.
    """

    name: str
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf
    typical: float = 1.0

    def __post_init__(self) -> None:
        _in_si(self.name, self.unit)


@dataclass(frozen=True, kw_only=True)
class Phase:
    """One arc with smooth dynamics.

    Parameters
    ----------
    name
        Name of the phase.
    states, controls
        Components of x and u in order.
    dynamics
        ``dynamics(x, u, p, m)`` returns the rates of all states.
    duration
        Name of the parameter (given or free) that is the length of the phase in seconds.
    end, end_conditions
        ``end(x, p, m)`` returns residuals that vanish at the end of the phase, one for each named condition.
    path, path_conditions
        ``path(x, u, p, m)`` returns values that must not be negative on the phase.
    outputs, output_variables
        ``outputs(x, u, p, m)`` returns further quantities of interest (altitude, steering angle) for tables.
    integrals, integral_variables
        ``integrals(x, u, p, m)`` returns rates; their integrals along the flight are results, named with the unit of
        the integral (delta-v spent, gravity loss). Phases that name the same one add to it.
    inertial
        ``inertial(x, u, t, p, m)`` returns nine values in inertial axes with the body at their origin, t seconds after
        the first ignition: position [m], velocity [m/s], acceleration by thrust [m/s^2]. `Views.frame` says which.
    track
        ``track(x, p, m)`` returns how far the flight has come along its way, how far to the left of it, how high, and
        where `Views.floor` names one, the least height there [m].
    typical_end
        ``typical_end(p, m)`` returns a rough end state; only its order matters (a direct method starts there).
    """

    name: str
    states: tuple[Variable, ...]
    controls: tuple[Control, ...] = ()
    dynamics: Physics
    duration: str
    end: Physics | None = None
    end_conditions: tuple[Variable, ...] = ()
    path: Physics | None = None
    path_conditions: tuple[Variable, ...] = ()
    outputs: Physics | None = None
    output_variables: tuple[Variable, ...] = ()
    integrals: Physics | None = None
    integral_variables: tuple[Variable, ...] = ()
    inertial: Physics | None = None
    track: Physics | None = None
    typical_end: Physics | None = None

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(s.name for s in self.states)

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the control components, in order."""
        return tuple(name for control in self.controls for name in control.names)

    @cached_property
    def state_record(self) -> Callable[..., Any]:
        """Record type of x."""
        return namedtuple("State", self.state_names)

    @cached_property
    def control_record(self) -> Callable[..., Any]:
        """Record type of u."""
        return namedtuple("Control", self.control_names)

    def rates(self, x: Any, u: Any, p: Any, m: Any = NUMERIC) -> Sequence[Any]:
        """Rates of the states for plain sequences x and u (each component may itself be an array)."""
        return self.dynamics(self.state_record(*x), self.control_record(*u), p, m)

    def evaluate(self, function: str, x: Any, u: Any, p: Any, m: Any = NUMERIC) -> Sequence[Any]:
        """Values of ``path``, ``outputs``, ``integrals``, or of ``end`` and ``track``, which take no control.

        Empty where the phase has none.
        """
        physics = getattr(self, function)
        if physics is None:
            return ()
        control = () if function in ("end", "track") else (self.control_record(*u),)
        return physics(self.state_record(*x), *control, p, m)

    def seen_inertially(self, x: Any, u: Any, t: Any, p: Any, m: Any = NUMERIC) -> Sequence[Any]:
        """Values of ``inertial``; empty where the phase has none."""
        if self.inertial is None:
            return ()
        return self.inertial(self.state_record(*x), self.control_record(*u), t, p, m)


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Phases, links, parameters and the objective.

    Parameters
    ----------
    name
        Name of the problem.
    phases
        In order of flight.
    start
        ``start(p, m)`` returns the first phase's initial state.
    links
        One ``link(x, p, m)`` for each later phase: its initial state from the end state of the phase before.
    given
        Parameters with values.
    free
        Parameters to be chosen, the durations among them.
    objective, objective_unit
        ``objective(x, p, m)`` of the last end state, minimised, and its unit.
    results, result_variables
        ``results(first, last, p, m)`` of the first phase's initial and the last phase's end state returns what is asked
        of a solution (landed mass, flight time), beside the phases' `integrals`.
    maximised
        Name of the result that J is the negative of, or "".
    ranges
        ``ranges(p, m)`` of the given parameters returns ``{name: (lower, upper, typical)}`` for free parameters whose
        range depends on what is given; it replaces what `free` says. It raises `PeriluneError` for given values that
        make no sense together.
    bookkeeping
        ``bookkeeping(solution)`` returns checks of level 1 in the model's own terms (the rocket equation).
    views
        What figures show of it.
    scales
        Canonical units.
    title
        One line for reports.
    """

    name: str
    phases: tuple[Phase, ...]
    start: Physics
    links: tuple[Physics, ...] = ()
    given: Mapping[str, Given] = field(default_factory=dict)
    free: tuple[Free, ...] = ()
    objective: Physics
    objective_unit: str = "1"
    results: Physics | None = None
    result_variables: tuple[Variable, ...] = ()
    maximised: str = ""
    ranges: Physics | None = None
    bookkeeping: Callable[[Any], Sequence[Check]] | None = None
    views: Views = field(default_factory=Views)
    scales: Scales = field(default_factory=Scales)
    title: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "given", MappingProxyType(dict(self.given)))
        if self.ranges is not None:
            found = self.ranges(self.parameters({}), NUMERIC)
            free = (
                replace(f, lower=r[0], upper=r[1], typical=r[2])
                for f in self.free
                if (r := found.get(f.name, _range(f)))
            )
            object.__setattr__(self, "free", tuple(free))
        _check_structure(self)
        _check_homogeneous(self)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters, in order."""
        return tuple(f.name for f in self.free)

    @property
    def duration_names(self) -> tuple[str, ...]:
        """Names of the parameters that are durations of phases."""
        return tuple(phase.duration for phase in self.phases)

    def unit_of(self, parameter: str) -> str:
        """Unit text of a parameter."""
        if parameter in self.given:
            return self.given[parameter].unit
        return next(f.unit for f in self.free if f.name == parameter)

    def parameters(self, free: Mapping[str, Any]) -> SimpleNamespace:
        """Record ``p`` of all parameters in SI, with the free ones' values as passed."""
        return SimpleNamespace(**{name: g.value for name, g in self.given.items()}, **dict(free))

    def with_given(self, **values: float) -> Problem:
        """Give parameters new values in SI; a free parameter named here is fixed.

        Raises
        ------
        PeriluneError
            If a name is no parameter of the problem.
        """
        given, known = dict(self.given), {*self.given, *self.free_names}
        for name, value in values.items():
            if name not in known:
                raise unknown_name("parameter", name, sorted(known))
            given[name] = Given(value=float(value), unit=self.unit_of(name))
        return replace(self, given=given, free=tuple(f for f in self.free if f.name not in values))


def _range(f: Free) -> tuple[float, float, float]:
    return f.lower, f.upper, f.typical


def _check_structure(problem: Problem) -> None:
    if not problem.phases:
        raise PeriluneError("a problem needs at least one phase", got="none")
    if len(problem.links) != len(problem.phases) - 1:
        raise PeriluneError(
            "each phase after the first needs a link from the one before",
            got=f"{len(problem.links)} links for {len(problem.phases)} phases",
            expected=f"{len(problem.phases) - 1} links",
        )
    both = set(problem.given) & set(problem.free_names)
    if both:
        raise PeriluneError("a parameter cannot be given and free at once", got=", ".join(sorted(both)))
    for name, g in problem.given.items():
        if not math.isfinite(g.value):
            raise PeriluneError(f"the value of {name} is not finite", got=str(g.value), expected="a finite number")
    for f in problem.free:
        if not f.lower <= f.upper or math.isnan(f.typical):
            raise PeriluneError(
                f"bounds of {f.name} are empty", got=f"[{f.lower}, {f.upper}]", expected="lower <= upper"
            )
    limits = [limit for phase in problem.phases for _, c in scalars(phase.controls) for limit in (c.lower, c.upper)]
    for name in (*problem.duration_names, *(limit for limit in limits if isinstance(limit, str))):
        if name not in problem.given and name not in problem.free_names:
            raise unknown_name("parameter", name, sorted({*problem.given, *problem.free_names}))
    results = [v.name for v in problem.result_variables]
    if problem.maximised and problem.maximised not in results:
        raise unknown_name("result", problem.maximised, results)
    quantities = {
        name
        for phase in problem.phases
        for name in (*phase.state_names, *phase.control_names, *(v.name for v in phase.output_variables))
    }
    check_views(problem.views, quantities, {*problem.given, *problem.free_names}, results)


def _sample(problem: Problem, scales: Scales) -> tuple[SimpleNamespace, list[tuple[list[float], list[float]]]]:
    """Parameters and one (x, u) for each phase, the same physical point written in the given canonical units."""
    fractions = iter((0.618034 * (k + 1)) % 1.0 for k in range(10_000))
    si = problem.scales
    inside = {
        f.name: f.lower + 0.3 * (f.upper - f.lower) if math.isfinite(f.upper - f.lower) else f.typical
        for f in problem.free
    }
    known = problem.parameters(inside)
    p = SimpleNamespace(**{name: v / scales.of(problem.unit_of(name)) for name, v in vars(known).items()})
    points = []
    for phase in problem.phases:
        x = [(0.7 + 0.5 * next(fractions)) * si.of(s.unit) / scales.of(s.unit) for s in phase.states]
        u: list[float] = []
        for control in phase.controls:
            value = control.example(fractions, known, si.of(control.unit))
            u += [v / scales.of(control.unit) for v in value]
        points.append((x, u))
    return p, points


_SEEN = [(f"{what} {axis}", unit) for what, unit in (("position", "m"), ("velocity", "m/s"), ("thrust", "m/s^2"))
         for axis in "xyz"]  # fmt: skip
_TRACK = [("along", "m"), ("across", "m"), ("height", "m"), ("least height", "m")]


def _values(problem: Problem, scales: Scales) -> list[tuple[str, str, float]]:
    """(what, unit, value) of everything the user's functions return at the sample, written in canonical units."""
    p, points = _sample(problem, scales)
    found: list[tuple[str, str, float]] = []

    def add(what: str, names: Sequence[tuple[str, str]], values: Sequence[Any]) -> None:
        if len(values) != len(names):
            raise PeriluneError(
                f"{what} returns the wrong number of values",
                got=str(len(values)),
                expected=f"{len(names)}: " + ", ".join(n for n, _ in names),
            )
        found.extend((f"{what}, {n}", u, float(v)) for (n, u), v in zip(names, values, strict=True))

    def pairs(variables: Sequence[Variable], per: str = "") -> list[tuple[str, str]]:
        return [(v.name, v.unit + per) for v in variables]

    first = problem.phases[0]
    add("start", pairs(first.states), problem.start(p, NUMERIC))
    for k, (phase, (x, u)) in enumerate(zip(problem.phases, points, strict=True)):
        add(f"dynamics of {phase.name}", pairs(phase.states, "/s"), phase.rates(x, u, p))
        add(f"end of {phase.name}", pairs(phase.end_conditions), phase.evaluate("end", x, u, p))
        add(f"path of {phase.name}", pairs(phase.path_conditions), phase.evaluate("path", x, u, p))
        add(f"outputs of {phase.name}", pairs(phase.output_variables), phase.evaluate("outputs", x, u, p))
        add(f"integrals of {phase.name}", pairs(phase.integral_variables, "/s"), phase.evaluate("integrals", x, u, p))
        time = 0.7 * problem.scales.time / scales.time
        add(f"inertial view of {phase.name}", _SEEN if phase.inertial else (), phase.seen_inertially(x, u, time, p))
        places = _TRACK[: 4 if problem.views.floor else 3] if phase.track else ()
        add(f"track of {phase.name}", places, phase.evaluate("track", x, u, p))
        if k < len(problem.links):
            after = problem.phases[k + 1]
            add(
                f"link to {after.name}",
                pairs(after.states),
                problem.links[k](phase.state_record(*x), p, NUMERIC),
            )
    end = problem.phases[-1].state_record(*points[-1][0])
    add("objective", [("J", problem.objective_unit)], [problem.objective(end, p, NUMERIC)])
    if problem.results is not None:
        values = problem.results(first.state_record(*points[0][0]), end, p, NUMERIC)
        add("results", pairs(problem.result_variables), values)
    return found


def _check_homogeneous(problem: Problem) -> None:
    """Evaluate the physics in SI and in other units; a result that does not scale hides a dimensional constant."""
    # Incommensurate with each other, so that no power product of them is 1 by accident.
    scales = Scales(length=7.3, time=0.19, mass=23.0, temperature=1.7)
    for (what, unit_text, si), (_, _, other) in zip(_values(problem, Scales()), _values(problem, scales), strict=True):
        scaled = other * scales.of(unit_text)
        if math.isfinite(si) and not math.isclose(
            si, scaled, rel_tol=1e-6, abs_tol=1e-9 * problem.scales.of(unit_text)
        ):
            raise PeriluneError(
                f"the physics is not dimensionally homogeneous: {what}",
                got=f"{si:.6g} computed in SI, {scaled:.6g} computed in other units",
                expected=f"a quantity in {unit_text}",
                advice="move constants with a dimension out of the function into `given`, with their unit",
            )
