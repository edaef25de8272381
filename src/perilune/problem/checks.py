"""Consistency checks of a problem: names that exist, values in their declared ranges, physics that keeps its units.

The physics is tried where it is stated: called at a sample of states and controls, once in SI and once in other units.
The functions here take a `Problem`, whose file stands above this one.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from perilune.core import (
    Matrix,
    PeriluneError,
    Scales,
    check_values,
    declared_parameters,
    parse_unit,
    require_callable,
    require_row,
    require_type,
    unknown_name,
    wrong_type_error,
)
from perilune.problem.controls import scalars
from perilune.problem.display.views import Views, check_views
from perilune.problem.named_values import Quantities, require_named
from perilune.problem.names import check_names
from perilune.problem.phase import Phase
from perilune.problem.tracing.dimensions import Clash, clash, mixed_comparison
from perilune.problem.tracing.traced_problem import StatedFunction, stated_functions
from perilune.problem.variables import FreeParameter, Parameter

# Functions that are not formulas.
HOOKS = ("parameter_bounds", "preflight", "consistency_checks", "initial_guess", "switching_guesses")


def check_parts(problem: Any) -> None:
    """Refuse parts of types that a problem does not have."""
    require_row(problem.phases, "phases", Phase)
    require_row(problem.links, "links", Callable)
    require_row(problem.free, "free parameters", FreeParameter)
    require_named(problem.results, Quantities, "a valid value of `results` of a problem")
    for name, kind, advice in (
        ("given", Mapping, 'given={"mass": pl.Parameter(value=300.0, unit="kg")}'),
        ("records", Sequence, ""),
        ("views", Views, "pl.Views(...), or omit it"),
        ("scales", Scales, "pl.Scales(length=1e3, time=60.0, mass=300.0), or omit it"),
    ):
        require_type(getattr(problem, name), kind, f"a valid {name} of a problem", advice)
    for name in HOOKS:
        require_callable(getattr(problem, name), f"a valid {name} of a problem")
    for record in problem.records:
        if not hasattr(record, "__section__"):
            raise wrong_type_error(record, "a record of a class below @record(...)", "a record of a problem")
    for name, value in problem.given.items():
        require_type(name, str, "the name of a given parameter")
        shown = value if isinstance(value, float | int) else 3000.0
        advice = f'write pl.Parameter(value={shown}, unit="m/s"), with its own SI unit'
        require_type(value, Parameter, f"a given value of {name}", advice)


def check_structure(problem: Any) -> None:
    """Refuse phases, links, parameters and views that do not fit together."""
    if not problem.phases:
        raise PeriluneError("a problem needs at least one phase", got="none")
    check_names(problem)
    if len(problem.links) != len(problem.phases) - 1:
        raise PeriluneError(
            "each phase after the first needs a link from the one before",
            got=f"{len(problem.links)} links for {len(problem.phases)} phases",
            expected=f"{len(problem.phases) - 1} links",
        )
    both = set(problem.given) & set(problem.free_names)
    if both:
        raise PeriluneError("a parameter cannot be both given and free", got=", ".join(sorted(both)))
    check_free(problem)
    limits = [limit for phase in problem.phases for _, c in scalars(phase.controls) for limit in (c.lower, c.upper)]
    for name in (*problem.duration_names, *(limit for limit in limits if isinstance(limit, str))):
        if name not in problem.given and name not in problem.free_names:
            raise unknown_name("parameter", name, sorted({*problem.given, *problem.free_names}))
    for state in (v for phase in problem.phases for v in (*phase.states, *phase.end_conditions)):
        for name in (limit for limit in (state.lower, state.upper) if isinstance(limit, str)):
            if name not in problem.given:
                raise unknown_name(f"given parameter for a bound of {state.name}", name, sorted(problem.given))
    for phase in problem.phases:
        _check_bound_units(problem, (*phase.states, *phase.end_conditions, *(c for _, c in scalars(phase.controls))))
    _check_scales(problem)
    results = [v.name for v in problem.result_variables]
    if problem.maximised and problem.maximised not in results:
        raise unknown_name("result", problem.maximised, results)
    also = [v.name for phase in problem.phases for v in (*phase.integral_variables, *phase.end_output_variables)]
    if problem.minimised and problem.minimised not in (*results, *also):
        raise unknown_name("result", problem.minimised, [*results, *also])
    if problem.minimised and problem.maximised:
        raise PeriluneError(
            "an objective is minimised or maximised",
            got=f"minimised={problem.minimised!r} and maximised={problem.maximised!r}",
            expected="one of the two",
        )
    quantities = {
        name
        for phase in problem.phases
        for name in (*phase.state_names, *phase.control_names, *(v.name for v in phase.output_variables))
    }
    names = [phase.name for phase in problem.phases]
    check_views(problem.views, quantities, {*problem.given, *problem.free_names}, results, names)
    _check_meant_units(problem)


def check_given(problem: Any) -> None:
    """Refuse given values that are not finite, or outside what is declared of them."""
    for name, g in problem.given.items():
        if not math.isfinite(g.value):
            raise PeriluneError(f"the value of {name} is not finite", got=str(g.value), expected="a finite number")
        if name in problem.duration_names and not g.value > 0:
            _refuse_no_length(name, g.value)
    for record in problem.records:
        check_values(record, vars(problem.parameters({})))


def rows_out_of_range(problem: Any, names: Sequence[str], values: Matrix) -> NDArray[np.bool_]:
    """Return True for rows of values that `Problem.with_given` would refuse as they are no values of the parameters.

    Parameters
    ----------
    problem
        The problem.
    names
        Names of parameters, d of them.
    values
        Their values [SI], (rows, d), finite.
    """
    refused = np.zeros(len(values), dtype=bool)
    for k, name in enumerate(names):
        if name in problem.duration_names:
            refused |= values[:, k] <= 0.0
    own = vars(problem.parameters({}))
    for declared in problem.records:
        if not any(parameter in declared_parameters(declared) for parameter in names):
            continue
        for i in np.nonzero(~refused)[0].tolist():
            try:
                check_values(declared, own | dict(zip(names, values[i].tolist(), strict=True)))
            except PeriluneError:
                refused[i] = True
    return refused


def _check_bound_units(problem: Any, bounded: Sequence[Any]) -> None:
    """Refuse a parameter that is a bound without the dimension of what it bounds."""
    for one in bounded:
        for name in (limit for limit in (one.lower, one.upper) if isinstance(limit, str)):
            _demand_unit(problem, name, one.unit, f"the bound {name} of {one.name}")


def _check_meant_units(problem: Any) -> None:
    """Refuse a parameter that is a duration, or places flights, without the dimension of that.

    The physics need not ask it: of its own time a flight may know nothing.
    """
    for phase in problem.phases:
        _demand_unit(problem, phase.duration, "s", f"the duration {phase.duration} of {phase.name}")
    if problem.views is not None:
        space = problem.views.space
        meant = {problem.views.radius: ("m", "radius"), space.rotation if space else "": ("rad/s", "rate of rotation")}
        for name, (wanted, what) in meant.items():
            if name:
                _demand_unit(problem, name, wanted, f"the {what} {name} of the views")


def _demand_unit(problem: Any, name: str, wanted: str, what: str) -> None:
    of = problem.unit_of(name)
    if parse_unit(of)[1] != parse_unit(wanted)[1]:
        raise PeriluneError(f"{what} has another dimension", got=f"{name} in {of}", expected=f"a parameter in {wanted}")


def _check_scales(problem: Any) -> None:
    """Refuse scales of what no method computes with; they would be without effect."""
    told = [v for phase in problem.phases for v in
            (*phase.output_variables, *phase.integral_variables, *phase.end_output_variables)]  # fmt: skip
    for variable in (*told, *problem.result_variables):
        if variable.scale is not None:
            raise PeriluneError(
                f"{variable.name} has a scale, but is only an output of the solution",
                got=f"scale={variable.scale:g}",
                expected="scales of states and of end, path and held conditions; objective_scale of the problem",
            )


def check_free(problem: Any) -> None:
    """Refuse ranges of free parameters that are empty."""
    for f in problem.free:
        if not f.lower <= f.upper:
            raise PeriluneError(
                f"bounds of {f.name} are empty", got=f"[{f.lower}, {f.upper}]", expected="lower <= upper"
            )
        if f.name in problem.duration_names and not f.upper > 0:
            _refuse_no_length(f.name, f.upper)


def _refuse_no_length(name: str, longest: float) -> NoReturn:
    raise PeriluneError(
        f"{name} is the length of a phase and must be positive", got=f"at most {longest:g} s", expected="> 0 s"
    )


_PLACES = 4  # points at which the physics is tried before it counts as undefined


def _sample(problem: Any, scales: Scales, place: int) -> tuple[SimpleNamespace, list[tuple[list[float], list[float]]]]:
    """Return parameters and one (x, u) for each phase, the same physical point in the given canonical units."""
    fractions = iter((0.618034 * k) % 1.0 for k in range(1 + 1000 * place, 1_000_000))
    si = problem.scales
    inside = {
        f.name: f.lower + 0.3 * (f.upper - f.lower) if math.isfinite(f.upper - f.lower) else f.guess
        for f in problem.free
    }
    known = problem.parameters(inside)
    p = SimpleNamespace(**{name: v / scales.of(problem.unit_of(name)) for name, v in vars(known).items()})
    points = []
    for phase in problem.phases:
        x = [(0.7 + 0.5 * next(fractions)) * problem.size_of(s) / scales.of(s.unit) for s in phase.states]
        u: list[float] = []
        for control in phase.controls:
            value = control.example(fractions, known, si.of(control.unit))
            u += [v / scales.of(control.unit) for v in value]
        points.append((x, u))
    return p, points


def _sampled_results(problem: Any, scales: Scales, place: int) -> list[tuple[StatedFunction, int, float]]:
    """Return (function, result's place, value) of all that the user's functions return at the sample, canonical."""
    p, points = _sample(problem, scales, place)
    everywhere = {
        "p": p, "t": 0.7 * problem.scales.time / scales.time, "first": points[0][0], "last": points[-1][0]
    }  # fmt: skip
    found: list[tuple[StatedFunction, int, float]] = []
    for function in stated_functions(problem):
        if not function.rough:
            x, u = points[function.phase]
            values = function.numbers({"x": x, "u": u, **everywhere})
            found.extend((function, k, value) for k, value in enumerate(values))
    return found


def check_homogeneous(problem: Any) -> None:
    """Evaluate the physics in SI and in other units; a result that does not scale hides a dimensional constant."""
    # Incommensurate with each other, so that no product of their powers is 1 by accident.
    scales, undefined = Scales(length=7.3, time=0.19, mass=23.0, temperature=1.7), []
    for place in range(_PLACES):
        values = _sampled_results(problem, Scales(), place)
        undefined = [function.told(k) for function, k, si in values if math.isnan(si)]
        if not undefined:
            break
    else:
        raise PeriluneError(
            f"{undefined[0]} is not a number (NaN)",
            got=f"NaN at each of {_PLACES} points that were tried",
            expected="a number for states of the magnitude of the problem's scales",
            advice="check for the root or logarithm of a negative number, and for 0/0; check units, scales and values",
        )
    for (function, k, si), (_, _, other) in zip(values, _sampled_results(problem, scales, place), strict=True):
        unit_text = function.results[k][1]
        scaled = other * scales.of(unit_text)
        if math.isfinite(si) and not math.isclose(
            si, scaled, rel_tol=1e-6, abs_tol=1e-9 * problem.scales.of(unit_text)
        ):
            wanted = function.results[k][1]
            parameters = sorted({*problem.given, *problem.free_names})
            found = clash(function.traced(parameters), k, _component_units(problem, function), wanted)
            raise _inhomogeneous(function.told(k), found, wanted)
    for function in stated_functions(problem):
        if mixed := mixed_comparison(problem.form.expressions[function.key], _component_units(problem, function)):
            raise _inhomogeneous(function.what, mixed)


def _component_units(problem: Any, function: StatedFunction) -> Callable[[str, str], str]:
    """Return the unit of each component that a function takes, as a function of role and name."""
    phase = problem.phases[function.phase]
    units = {
        "p": {name: problem.unit_of(name) for name in (*problem.given, *problem.free_names)},
        "x": {s.name: s.unit for s in phase.states},
        "u": {name: c.unit for c in phase.controls for name in c.names},
        "first": {s.name: s.unit for s in problem.phases[0].states},
        "last": {s.name: s.unit for s in problem.phases[-1].states},
    }
    if isinstance(function.key, tuple) and function.key[0] == "links":  # it takes the state of the phase before
        units["x"] = {s.name: s.unit for s in problem.phases[function.key[1]].states}
    return lambda role, name: units[role][name]


def _inhomogeneous(what: str, found: Clash | None, wanted: str = "") -> PeriluneError:
    return PeriluneError(
        f"the physics is not dimensionally homogeneous: {what}",
        got=found.got if found else "a value that depends on the units used for computing it",
        expected=found.expected if found else f"a quantity in {wanted}",
        advice="move constants with a dimension out of the function into `given`, with their unit; or check for a"
        " missing factor",
    )


def _importable_or_none(function: Any) -> Any:
    """Return the function where another process finds it by its name, else None; a script's own it would not find."""
    try:
        name = pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    return None if b"__main__" in name else function


def importable_hooks(problem: Any) -> dict[str, Any]:
    """Return the hooks and records of a problem that another process finds by name; None and no records for others."""
    hooks = {name: _importable_or_none(getattr(problem, name)) for name in HOOKS}
    return {**hooks, "records": _importable_or_none(problem.records) or ()}
