"""Optimal control problem as data: phases, the links between them, given and free parameters, and the objective.

A `Problem` holds the user's functions and nothing of any method. In SI units throughout:

    minimise  J = objective(x(end of last phase), p)
    subject to  x' = dynamics(x, u, p)                on each phase, time from the phase's ignition
                x(0) = start(p)                       first phase
                x(0) = link(x(end of phase before), p)   later phases
                end(x(T), p) = 0,  path(x, u, p) >= 0,  held(x, u, p) = 0

A *free initial state* is a `start` that depends on free parameters; a free duration is a free parameter named by the
phase. Running costs are states of their own. Every number that may be varied is a named parameter, *given* or *free*,
so a sweep, a continuation and a table are the same walk.

All functions take records with attribute access (``x.r``, ``p.thrust``) that also unpack in order, and the maths
namespace ``xp`` of `perilune.core.maths`. Numbers with a dimension belong into parameters, not into the functions: the
problem is solved in canonical units, and construction tests that the physics is dimensionally homogeneous.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, fields, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, ClassVar, get_args

import numpy as np

from perilune.core import (
    NUMERIC,
    Matrix,
    Physics,
    RenamedAttribute,
    Scales,
    check_call,
    renamed_keywords,
    require_type,
    unknown_name,
    wrong_type_error,
)
from perilune.problem.checks import (
    check_free,
    check_given,
    check_homogeneous,
    check_parts,
    check_structure,
    importable_hooks,
)
from perilune.problem.controls import Control, scalars
from perilune.problem.display.reprs import ShownProblem
from perilune.problem.display.views import Views
from perilune.problem.named_values import Quantities, accept_pairs, named_variables
from perilune.problem.parameters import read_only_given
from perilune.problem.phase import Phase
from perilune.problem.tracing.numeric_rates import SimulatedProblem
from perilune.problem.tracing.tape import Expression
from perilune.problem.tracing.traced_problem import (
    OWN_TEXT,
    PHASE_FUNCTIONS,
    TracedProblem,
    canonical_expressions,
    trace,
)
from perilune.problem.variables import FreeParameter, Parameter, Variable, given_as, positive_scale
from perilune.problem.verification import Check

_TRACED = ("form", "structure")  # properties found once for a problem, and possibly known
_SIZED, _BOUNDED = (Variable, FreeParameter, *get_args(Control)), (Variable, *get_args(Control))

_OLD_NAMES = {
    "declared": "records",
    "ranges": "parameter_bounds",
    "bookkeeping": "consistency_checks",
    "rough_flight": "initial_guess",
}


@renamed_keywords(**_OLD_NAMES)
@accept_pairs("results")
@check_call
@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Problem(ShownProblem, SimulatedProblem):
    """Phases, links, parameters and the objective.

    Problems are equal when their forms (`perilune.problem.tracing.traced_problem`) and all their numbers are. A copy in
    another process (pickle) carries its formulas as expressions; `parameter_bounds`, `preflight`, `consistency_checks`,
    `initial_guess` and `switching_guesses` go along where they are found by name, as functions of a module are, and are
    left behind otherwise.

    Parameters
    ----------
    name
        Name of the problem.
    phases
        In order of flight.
    start
        ``start(p, xp)`` returns the first phase's initial state.
    links
        One ``link(x, p, xp)`` for each later phase: its initial state from the end state of the phase before.
    given
        Parameters with values.
    free
        Parameters to be chosen, the durations among them.
    objective, objective_unit, objective_scale
        ``objective(x, p, xp)`` of the last end state, minimised, its unit, and its size in SI where that is not the
        size of its unit in `scales`.
    results
        `Quantities` of ``results(first, last, p, xp)``, which returns of the first phase's initial and the last phase's
        end state what is asked of a solution (landed mass, flight time), in addition to the phases' `integrals`.
    maximised
        Name of the result that J is the negative of, or "".
    minimised
        Name of the result that J is but for a constant, or "": in its words the objective is shown.
    parameter_bounds
        ``parameter_bounds(p, xp)`` of the given parameters returns ``{name: (lower, upper, guess)}`` for free
        parameters whose range depends on what is given; it replaces what `free` says. The guess may be a function
        without arguments, where that takes long: an atlas asks for bounds only, at thousands of values. It raises
        `PeriluneError` for given values that make no sense together.
    records
        Records (`perilune.core.fields`) that the problem was made of, whose numbers are parameters; each checks new
        values too, whoever gave them. With them `perilune.save` writes what a model is made of again.
    preflight
        ``preflight(p, xp)`` of the given parameters returns what physics says before anything is solved, as
        `perilune.problem.presolve.Finding`. Which comparisons there are may depend on which parameters `p` has,
        but not on their values, which may be arrays or symbols; ``inf`` is no limit.
    consistency_checks
        ``consistency_checks(solution)`` returns checks of level 1 in the model's own terms (the rocket equation).
    initial_guess
        ``initial_guess(p)`` of all parameters, durations included, returns a picture of the flight where straight lines
        are none: for each phase rough states in SI at times evenly apart, shape (times, states). A direct method starts
        there in place of `Phase.end_guess`.
    switching_guesses
        ``switching_guesses(problem)`` returns rough flights whose arcs are known, each with its
        `perilune.structures.structure.Structure`: the indirect method looks for their extremals in addition to those
        that it finds by itself.
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
    given: Mapping[str, Parameter] = field(default_factory=dict)
    free: tuple[FreeParameter, ...] = ()
    objective: Physics
    objective_unit: str = "1"
    objective_scale: float | None = None
    results: Quantities | None = None
    maximised: str = ""
    minimised: str = ""
    records: tuple[Any, ...] = ()
    parameter_bounds: Physics | None = None
    preflight: Callable[[Any, Any], Sequence[Any]] | None = None
    consistency_checks: Callable[[Any], Sequence[Check]] | None = None
    initial_guess: Callable[[Any], Sequence[Matrix]] | None = None
    switching_guesses: Callable[[Any], Sequence[tuple[Any, Any]]] | None = None
    views: Views = field(default_factory=Views)
    scales: Scales = field(default_factory=Scales)
    title: str = ""
    ranges: ClassVar[RenamedAttribute] = RenamedAttribute("parameter_bounds")
    bookkeeping: ClassVar[RenamedAttribute] = RenamedAttribute("consistency_checks")
    text: ClassVar[RenamedAttribute] = RenamedAttribute("source")
    declared: ClassVar[RenamedAttribute] = RenamedAttribute("records")
    rough_flight: ClassVar[RenamedAttribute] = RenamedAttribute("initial_guess")

    def __post_init__(self) -> None:
        check_parts(self)
        object.__setattr__(self, "given", read_only_given(self.given))
        object.__setattr__(self, "objective_scale", positive_scale("the objective", self.objective_scale))
        check_given(self)
        self.take_ranges()
        check_structure(self)
        check_homogeneous(self)
        _ = self.form  # so that what is not a formula is refused where it is stated

    def take_ranges(self) -> None:
        """Let the free parameters have the ranges that follow from the given ones; of one that is being made."""
        if self.parameter_bounds is None:
            return
        with np.errstate(all="ignore"):  # what is no number is refused by name, where the free parameter is made
            found = self.parameter_bounds(self.parameters({}), NUMERIC)
            free = (
                replace(f, lower=r[0], upper=r[1], guess=r[2]() if callable(r[2]) else r[2])
                for f in self.free
                if (r := found.get(f.name, _free_range(f)))
            )
            object.__setattr__(self, "free", tuple(free))

    @cached_property
    def form(self) -> TracedProblem:
        """Return the problem without its numbers: traced once, and shared by all `with_given`."""
        return trace(self)

    @cached_property
    def structure(self) -> tuple[Any, ...]:
        """Return all that a derivation depends on: form, names of given and free parameters, and which bounds exist.

        Whether a limit is a number, and of which sign, decides on the regimes of a control; whether an end condition is
        a range decides on its row. What has a scale of its own has other canonical values.
        """
        bounds = tuple(
            limit if isinstance(limit, str) else (math.isfinite(limit), limit < 0)
            for phase in self.phases
            for _, c in scalars(phase.controls)
            for limit in (c.lower, c.upper)
        )
        ranges = tuple(c.ranged for phase in self.phases for c in phase.end_conditions)
        ratios = tuple((place, scale / self.scales.of(unit)) for place, unit, scale in self._own_scales)
        return (self.form.digest, tuple(self.given), self.free_names, bounds, ranges, ratios)

    def differs_in_values(self, other: Problem) -> bool:
        """Return True if another problem differs in nothing but values of parameters and ranges of free ones."""
        alike = self.structure == other.structure and self.scales == other.scales
        return alike and (self.phases is other.phases or self._bounds == other._bounds)

    @property
    def _bounds(self) -> list[tuple[Any, Any]]:
        """Return the bounds of states, end conditions and controls."""
        return [
            (c.lower, c.upper)
            for phase in self.phases
            for c in (*phase.states, *phase.end_conditions, *(c for _, c in scalars(phase.controls)))
        ]

    @property
    def source(self) -> str:
        """Name the origin of its functions: the user's own, or expressions and where they came from."""
        return f"expressions from {self.start.origin}" if isinstance(self.start, Expression) else OWN_TEXT

    @cached_property
    def expressed(self) -> Problem:
        """The same problem with its functions as expressions."""
        return self.stated_by(self.form.expressions)

    @cached_property
    def canonical(self) -> Problem:
        """The same problem with functions of canonical values, which is what methods compute with.

        Homogeneous physics has one text in all units: the problem itself, unless something has a scale of its own.
        """
        return self.stated_by(canonical_expressions(self)) if self._own_scales else self

    def stated_by(self, found: Mapping[Any, Expression]) -> Problem:
        """Return a problem of the same form with these functions by their key."""
        phases = tuple(
            phase.with_functions({name: found.get((k, name)) for name in PHASE_FUNCTIONS})
            for k, phase in enumerate(self.phases)
        )
        own: dict[str, Any] = {name: found[name] for name in ("start", "objective") if name in found}
        if self.results is not None and "results" in found:
            own["results"] = self.results.with_function(found["results"])
        new = self.changed(phases=phases, links=tuple(found["links", k] for k in range(len(self.links))), **own)
        new.__dict__["expressed"] = new
        return new

    @renamed_keywords(**_OLD_NAMES)
    @accept_pairs("results")
    @check_call
    def changed(self, **changes: Any) -> Problem:
        """Return a changed problem, not checked again; of the same form, or traced on demand with `form=None`.

        Raises
        ------
        PeriluneError
            If something is changed that a problem has not, or to what is no mapping or no tuple where it is one.
        """
        new = object.__new__(Problem)
        kept = {f.name: getattr(self, f.name) for f in fields(self)}
        for name, value in changes.items():
            if name not in kept and name not in _TRACED:
                raise unknown_name("part of a problem", name, sorted(kept))
            if kind := next((kind for kind in (Mapping, tuple) if isinstance(kept.get(name), kind)), None):
                require_type(value, kind, f"a valid {name} of a problem")
        new.__dict__.update(kept, **{"form": self.__dict__.get("form"), **changes})
        if new.__dict__["form"] is None:
            del new.__dict__["form"]
        return new

    def __getstate__(self) -> dict[str, Any]:
        own = self.expressed
        state = {f.name: getattr(own, f.name) for f in fields(own)}
        return {**state, "given": dict(self.given), "form": self.form, **importable_hooks(own)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, given=read_only_given(state["given"]))

    def __deepcopy__(self, memo: Any) -> Problem:
        return self  # nothing in it can change

    def __copy__(self) -> Problem:
        return self

    @property
    def numbers(self) -> tuple[Any, ...]:
        """Every number of the problem, in order."""
        given = sorted((name, g.value) for name, g in self.given.items())
        free = tuple((f.name, *_free_range(f)) for f in self.free)
        return (self.name, tuple(given), free, tuple(self._bounds), (*astuple(self.scales), *self._own_scales))

    def __eq__(self, other: object) -> bool:
        if self is other or not isinstance(other, Problem):
            return self is other
        return self.form == other.form and self.numbers == other.numbers

    def __hash__(self) -> int:
        return hash((self.form, self.numbers))

    @property
    def result_variables(self) -> tuple[Variable, ...]:
        """Quantities of `results`, in order."""
        return named_variables(self.results)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters, in order."""
        return tuple(f.name for f in self.free)

    @property
    def duration_names(self) -> tuple[str, ...]:
        """Names of the parameters that are durations of phases."""
        return tuple(phase.duration for phase in self.phases)

    @property
    def _own_scales(self) -> tuple[tuple[int, str, float], ...]:
        """(place, unit, scale) of what has a scale of its own, of all states and conditions, then J."""
        sized = [(v.unit, v.scale) for phase in self.phases for v in phase.sized]
        sized.append((self.objective_unit, self.objective_scale))
        return tuple((place, unit, scale) for place, (unit, scale) in enumerate(sized) if scale is not None)

    @check_call
    def size_of(self, named: Variable | FreeParameter | Control) -> float:
        """Return the SI size of the canonical unit of a state, condition, control or free parameter.

        It is its own `scale`, else the size of its unit in `scales`.

        Raises
        ------
        PeriluneError
            If it is none of these.
        """
        if not isinstance(named, _SIZED):
            raise wrong_type_error(
                named, "its record, as problem.phases[0].states[0]", "a state, condition, control or parameter"
            )
        own = named.scale if isinstance(named, Variable) else None
        return self.scales.of(named.unit) if own is None else own

    @property
    def objective_size(self) -> float:
        """SI size of the canonical unit of J."""
        return self.scales.of(self.objective_unit) if self.objective_scale is None else self.objective_scale

    @check_call
    def unit_of(self, parameter: str) -> str:
        """Return the unit text of a parameter.

        Raises
        ------
        PeriluneError
            If there is no such parameter.
        """
        if not isinstance(parameter, str):
            raise wrong_type_error(parameter, "a text", "the name of a parameter")
        known: dict[str, Parameter | FreeParameter] = {**{f.name: f for f in self.free}, **self.given}
        if parameter not in known:
            raise unknown_name("parameter", parameter, sorted(known))
        return known[parameter].unit

    @check_call
    def bounds(self, bounded: Any) -> tuple[float, float]:
        """Return the lower and upper bound [SI] of a state or a scalar control, which may name a given parameter.

        Raises
        ------
        PeriluneError
            If it is neither.
        """
        if not isinstance(bounded, _BOUNDED):
            raise wrong_type_error(bounded, "its record, as problem.phases[0].states[0]", "a state or a control")
        return bounded.limits(self.parameters({}))

    @check_call
    def parameters(self, free: Mapping[str, Any]) -> SimpleNamespace:
        """Return the record ``p`` of all parameters in SI, with the free ones' values as passed.

        Raises
        ------
        PeriluneError
            If what is passed is no mapping from names of parameters that are not given.
        """
        try:
            return SimpleNamespace(**{name: g.value for name, g in self.given.items()}, **free)
        except TypeError:
            require_type(free, Mapping, "a mapping of values of free parameters")
            wrong = next(name for name in free if name in self.given or not isinstance(name, str))
            raise unknown_name("free parameter", wrong, self.free_names) from None

    @check_call
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
            given[name] = given_as(name, value, self.unit_of(name))
        free = tuple(f for f in self.free if f.name not in values)
        # Values do not enter it.
        same = {"structure": self.structure} if len(free) == len(self.free) and "form" in self.__dict__ else {}
        new = self.changed(given=read_only_given(given), free=free, **same)
        check_given(new)
        new.take_ranges()
        check_free(new)
        return new


def _free_range(f: FreeParameter) -> tuple[float, float, float]:
    return f.lower, f.upper, f.guess
