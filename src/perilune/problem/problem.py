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
import pickle
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType, SimpleNamespace
from typing import Any

from perilune.problem.checks import check_free, check_given, check_homogeneous, check_structure
from perilune.problem.controls import Control, Limit, limit_value, scalars
from perilune.problem.form import OWN_TEXT, PHASE_FUNCTIONS, Form, trace
from perilune.problem.tape import Expression
from perilune.problem.verification import Check
from perilune.problem.views import Views
from perilune.words.declared import stated_text
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

    `lower` and `upper` bound a state, in SI: a number, or the name of the given parameter that is the bound. An end
    condition with one of them is a range: its value has to lie between the bounds, and not to vanish. `label` is its
    name on the axis of a figure, where that is not `name` with blanks.
    """

    name: str
    unit: str = "1"
    lower: Limit = -math.inf
    upper: Limit = math.inf
    description: str = ""
    label: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise PeriluneError("a name must be a Python identifier", got=repr(self.name))
        _in_si(self.name, self.unit)
        if not (isinstance(self.lower, str) or isinstance(self.upper, str) or self.lower < self.upper):
            raise PeriluneError(
                f"bounds of {self.name} are empty",
                got=f"[{self.lower}, {self.upper}]",
                expected="lower < upper",
            )

    @property
    def ranged(self) -> bool:
        """Whether an end condition of this name is a range and no equality."""
        return any(isinstance(limit, str) or math.isfinite(limit) for limit in (self.lower, self.upper))

    def limits(self, p: Any) -> tuple[Any, Any]:
        """Bounds in SI, where they are parameters those of the record p."""
        return limit_value(self.lower, p), limit_value(self.upper, p)

    def missed(self, value: Any, p: Any) -> Any:
        """By how much an end condition of this value is not met, 0 where it is; a number, or an array of them."""
        lower, upper = self.limits(p)
        return value - NUMERIC.fmin(NUMERIC.fmax(value, lower), upper) if self.ranged else value


@dataclass(frozen=True, kw_only=True)
class Given:
    """A parameter with a value in SI and its SI unit.

    `stated` is the decimal text and unit in which a person stated it; a Python float is itself, and has none.
    """

    value: float
    unit: str = "1"
    stated: str = ""

    def __post_init__(self) -> None:
        _in_si("a given value", self.unit)
        if not self.stated:
            object.__setattr__(self, "stated", stated_text(self.value))
        object.__setattr__(self, "value", float(self.value))


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
        ``end(x, p, m)`` returns residuals that vanish at the end of the phase, one for each named condition; one whose
        condition has bounds has to lie between them instead.
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

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}  # record types are made anew where it arrives

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """Phases, links, parameters and the objective.

    Problems are equal when their forms (`perilune.problem.form`) and all their numbers are. A copy in another process
    (pickle) carries its formulas as expressions; `ranges`, `preflight` and `bookkeeping` go along where they are found
    by name, as functions of a module are, and are left behind otherwise.

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
    declared
        Classes of records (`perilune.words.declared`) whose numbers are parameters; each checks its values here again,
        whoever gave them.
    preflight
        ``preflight(p, m)`` of the given parameters returns what physics says before anything is solved, as
        `perilune.problem.preflight.Finding`. Which comparisons there are may depend on which parameters `p` has,
        but not on their values, which may be arrays or symbols; ``inf`` is no limit.
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
    declared: tuple[type, ...] = ()
    ranges: Physics | None = None
    preflight: Callable[[Any, Any], Sequence[Any]] | None = None
    bookkeeping: Callable[[Any], Sequence[Check]] | None = None
    views: Views = field(default_factory=Views)
    scales: Scales = field(default_factory=Scales)
    title: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "given", MappingProxyType(dict(self.given)))
        check_given(self)
        self._take_ranges()
        check_structure(self)
        check_homogeneous(self)
        _ = self.form  # so that what is no formula is refused where it is stated

    def _take_ranges(self) -> None:
        if self.ranges is not None:
            found = self.ranges(self.parameters({}), NUMERIC)
            free = (
                replace(f, lower=r[0], upper=r[1], typical=r[2])
                for f in self.free
                if (r := found.get(f.name, _range(f)))
            )
            object.__setattr__(self, "free", tuple(free))

    @cached_property
    def form(self) -> Form:
        """What is stated, without the numbers: traced once, and shared by all `with_given`."""
        return trace(self)

    @cached_property
    def structure(self) -> tuple[Any, ...]:
        """What a derivation depends on: the form, what is given and what is free, and which bounds there are.

        Whether a limit is a number, and of which sign, decides on the regimes of a control; whether an end condition is
        a range decides on its row.
        """
        bounds = tuple(
            limit if isinstance(limit, str) else (math.isfinite(limit), limit < 0)
            for phase in self.phases
            for _, c in scalars(phase.controls)
            for limit in (c.lower, c.upper)
        )
        ranges = tuple(c.ranged for phase in self.phases for c in phase.end_conditions)
        return (self.form.digest, tuple(self.given), self.free_names, bounds, ranges)

    @property
    def text(self) -> str:
        """Which text of the physics its functions are: the user's own, or expressions and where they came from."""
        return f"expressions from {self.start.origin}" if isinstance(self.start, Expression) else OWN_TEXT

    @cached_property
    def expressed(self) -> Problem:
        """The same problem with its functions as expressions."""
        found = self.form.expressions
        phases = tuple(
            replace(phase, **{name: found.get((k, name)) for name in PHASE_FUNCTIONS})
            for k, phase in enumerate(self.phases)
        )
        links = tuple(found["links", k] for k in range(len(self.links)))
        own = {name: found[name] for name in ("start", "objective", "results") if name in found}
        return self._changed(phases=phases, links=links, **own)

    def _changed(self, **changes: Any) -> Problem:
        """A problem of the same form, which is not traced or tried again."""
        new = object.__new__(Problem)
        kept = {f.name: getattr(self, f.name) for f in fields(self)}
        new.__dict__.update(kept, form=self.form, **changes)
        return new

    def __getstate__(self) -> dict[str, Any]:
        own = self.expressed
        state = {f.name: getattr(own, f.name) for f in fields(own)}
        hooks = {name: _by_name(state[name]) for name in ("ranges", "preflight", "bookkeeping")}
        hooks["declared"] = _by_name(self.declared) or ()
        return {**state, "given": dict(self.given), "form": self.form, **hooks}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, given=MappingProxyType(state["given"]))

    def __deepcopy__(self, memo: Any) -> Problem:
        return self  # nothing in it can change

    def __copy__(self) -> Problem:
        return self

    @property
    def numbers(self) -> tuple[Any, ...]:
        """Every number of the problem, in order."""
        bounds = [
            (c.lower, c.upper)
            for phase in self.phases
            for c in (*phase.states, *phase.end_conditions, *(c for _, c in scalars(phase.controls)))
        ]
        given = sorted((name, g.value) for name, g in self.given.items())
        free = tuple((f.name, *_range(f)) for f in self.free)
        return (self.name, tuple(given), free, tuple(bounds), astuple(self.scales))

    def __eq__(self, other: object) -> bool:
        if self is other or not isinstance(other, Problem):
            return self is other
        return self.form == other.form and self.numbers == other.numbers

    def __hash__(self) -> int:
        return hash((self.form, self.numbers))

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

    def bounds(self, bounded: Any) -> tuple[float, float]:
        """Lower and upper bound [SI] of a state or a scalar control, which may name a given parameter."""
        return bounded.limits(self.parameters({}))

    def parameters(self, free: Mapping[str, Any]) -> SimpleNamespace:
        """Record ``p`` of all parameters in SI, with the free ones' values as passed."""
        return SimpleNamespace(**{name: g.value for name, g in self.given.items()}, **dict(free))

    def with_given(self, **values: float) -> Problem:
        """Give parameters new values in SI; a free parameter named here is fixed.

        Raises
        ------
        PeriluneError
            If a name is no parameter of the problem, or a value is outside what is declared of it.
        """
        given, known = dict(self.given), {*self.given, *self.free_names}
        for name, value in values.items():
            if name not in known:
                raise unknown_name("parameter", name, sorted(known))
            given[name] = Given(value=value, unit=self.unit_of(name))
        free = tuple(f for f in self.free if f.name not in values)
        same = {"structure": self.structure} if len(free) == len(self.free) else {}  # values do not enter it
        new = self._changed(given=MappingProxyType(given), free=free, **same)
        check_given(new)
        new._take_ranges()
        check_free(new)
        return new


def _by_name(function: Any) -> Any:
    """The function where another process finds it by its name, else None; a script's own it would not find."""
    try:
        name = pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    return None if b"__main__" in name else function


def _range(f: Free) -> tuple[float, float, float]:
    return f.lower, f.upper, f.typical
