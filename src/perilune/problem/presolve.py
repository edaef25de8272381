"""Feasibility checks before solving: bounds from physics that a problem can miss, in the user's words.

A model states *comparisons*, each of a value with a limit (`Problem.preflight`). A **binding** one that fails is a
proof that there is no flight; the others warn. They are formulas of the given parameters without branches on values,
so that one call judges one problem or, with arrays of values, a whole sweep. Bounds that are parameters are compared as
well: where they lie the wrong way round there is no flight.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from perilune.core import (
    NUMERIC,
    InfeasibleError,
    PeriluneError,
    RenamedAttribute,
    check_call,
    format_quantity,
    require_type,
    unknown_name,
    wrong_type_error,
)
from perilune.problem.controls import scalars
from perilune.problem.display.quantity_names import limit_name, quantity_name, stating_keys
from perilune.problem.problem import Problem
from perilune.problem.variables import Variable

_BEGUN = 1e-9  # canonical: by so little a start is on its limits
_ROUNDOFF = 1e-13  # of the greater of two numbers that are compared


@check_call
@dataclass(frozen=True, kw_only=True)
class Finding:
    """One comparison: ``value <= limit``, or ``value >= limit`` where `at_least`.

    `value` and `limit` are what the parameters were: numbers, arrays or symbols. Missing a binding one is fatal. All
    else is the same whatever the parameters are. Of one that is `lasting` a miss is said with the answer as well, as
    air that a model leaves out; others are of what is hard to solve. A miss of a `contradiction` is bad input: what is
    stated excludes itself, whatever flies.
    """

    name: str
    value: Any
    limit: Any
    at_least: bool
    unit: str
    binding: bool
    meaning: str
    advice: str = ""
    lasting: bool = False
    contradiction: bool = False
    told: ClassVar[RenamedAttribute] = RenamedAttribute("formatted")

    def __post_init__(self) -> None:
        for text in ("name", "unit", "meaning", "advice"):
            require_type(getattr(self, text), str, f"the {text} of a comparison")
        for side in ("at_least", "binding", "lasting", "contradiction"):
            if not isinstance(stated := getattr(self, side), bool | np.bool_):
                raise wrong_type_error(
                    stated, "True or False, independent of the parameters", f"a valid value of {side} in a comparison"
                )
            object.__setattr__(self, side, bool(stated))

    @property
    def passed(self) -> Any:
        """Return True if the value is on the right side of the limit, an array where they are; NaN never is."""
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    @property
    def formatted(self) -> tuple[str, str]:
        """The value and the limit of one problem, formatted; one that is round-off relative to the other is zero."""
        roundoff = _ROUNDOFF * max((abs(x) for x in (self.value, self.limit) if math.isfinite(x)), default=0.0)
        value, limit = (format_quantity(0.0 if abs(x) < roundoff else x, self.unit) for x in (self.value, self.limit))
        return value, f"{'at least' if self.at_least else 'at most'} {limit}"

    @property
    def verdict(self) -> str:
        """``ok``, ``warning`` or ``impossible``."""
        return "ok" if self.passed else "impossible" if self.binding else "warning"


@check_call
def preflight(problem: Problem, over: Mapping[str, Any] | None = None) -> tuple[Finding, ...]:
    """Compare a problem with what physics allows; nothing is solved, and no error is raised for a failed comparison.

    Parameters
    ----------
    problem
        Any problem; one whose model states no comparisons has none, but of bounds that lie the wrong way round.
    over
        Other values of parameters in SI, numbers or arrays of one shape: ``{"vehicle_thrust": [300.0, 440.0]}``
        judges two problems at once. A free parameter named here counts as given.

    Returns
    -------
    tuple of Finding
        All comparisons, in the order in which they make sense; with arrays inside where `over` has arrays.
    """
    require_type(problem, Problem, "a problem to compare with physical bounds")
    if over is not None and not isinstance(over, Mapping):
        raise wrong_type_error(over, "{name: values} of parameters, in SI", "a valid set of parameter values")
    for name in over or ():
        if name not in problem.given and name not in problem.free_names:
            raise unknown_name("parameter", name, sorted({*problem.given, *problem.free_names}))
    # NumPy's numbers, for which a division by zero is a limit that is none and not an error.
    values = {name: np.float64(g.value) for name, g in problem.given.items()}
    values |= {name: np.asarray(value, dtype=float)[()] for name, value in (over or {}).items()}
    p = SimpleNamespace(**values)
    with np.errstate(all="ignore"):
        stated = () if problem.preflight is None else problem.preflight(p, NUMERIC)
        # Of a start that its kind refuses, in better words, no more is said.
        begun = at_start(problem, p) if np.any(is_possible(stated)) else ()
        general = (*between_bounds(problem, p), *begun, *_of_constant(problem))
        return (*stated, *(f for f in general if not np.all(f.passed)))


def between_bounds(problem: Problem, p: Any) -> tuple[Finding, ...]:
    """Compare the two bounds of each control, state and end: no lower one lies above its upper one.

    Only bounds are compared whose parameters p has.

    Parameters
    ----------
    problem
        Problem with its controls, states and ends.
    p
        Parameters [SI], numbers or arrays of one shape.
    """
    bounded = [
        one
        for phase in problem.phases
        for one in (*(control for _, control in scalars(phase.controls)), *phase.states, *phase.end_conditions)
        if (names := [limit for limit in (one.lower, one.upper) if isinstance(limit, str)])
        and all(hasattr(p, name) for name in names)  # and are not free to be chosen
        and one.lower != -math.inf and one.upper != math.inf
    ]  # fmt: skip
    both = [(one, *one.limits(p)) for one in bounded]
    return tuple(
        Finding(
            name=f"the upper bound of {one.name}", value=upper, limit=lower, at_least=True, unit=one.unit, binding=True,
            meaning=f"bounds of {one.name} are empty", contradiction=True,
        )
        for one, lower, upper in both
    )  # fmt: skip


def at_start(problem: Problem, p: Any) -> tuple[Finding, ...]:
    """Compare what is known of the start with the bounds of the states, and with the conditions of the first path.

    Known is what depends on given parameters alone: a flight begins with it, whatever follows.

    Parameters
    ----------
    problem
        Problem with its start and its first phase.
    p
        Given parameters [SI], numbers or arrays of one shape.
    """
    phase, free = problem.phases[0], {name: math.nan for name in problem.free_names if not hasattr(p, name)}
    record, unknown = SimpleNamespace(**free, **vars(p)), {("p", name) for name in free}
    tape, start = problem.form.expressions["start"].tape, tuple(problem.start(record, NUMERIC))
    unknown |= {("x", s.name) for row, s in enumerate(phase.states) if unknown & tape.needed(row)}
    found = list[Finding]()
    for state, value in zip(phase.states, start, strict=True):
        if ("x", state.name) not in unknown:
            for side, limit in zip(("lower", "upper"), state.limits(record), strict=True):
                stated = limit_name(problem, state, side)
                meaning, advice = f"the start puts {state.name} outside its bounds", f"another start, or {stated}"
                found.append(_compared_at_start(problem, state, value, limit, side == "lower", meaning, advice))
    if phase.path_conditions:
        tape = problem.form.expressions[0, "path"].tape
        along = phase.evaluate("path", start, [math.nan] * len(phase.control_names), record)
        for row, (condition, value) in enumerate(zip(phase.path_conditions, along, strict=True)):
            needed = tape.needed(row)
            if not (unknown & needed or any(op[0] == "u" for op in needed)):
                keys = ", ".join(stating_keys(problem, 0, "path", row))
                meaning = f"the start violates a path condition: {keys or quantity_name(condition)}"
                advice = f"another start, or relax {keys or 'the condition'}"
                found.append(_compared_at_start(problem, condition, value, 0.0, True, meaning, advice))
    return tuple(found)


def _compared_at_start(
    problem: Problem, one: Variable, value: Any, limit: Any, at_least: bool, meaning: str, way: str
) -> Finding:
    """Compare a value at the start with its limit; within rounding of it, and where it is no number, it keeps it."""
    over = (limit - value if at_least else value - limit) > _BEGUN * problem.size_of(one)
    return Finding(
        name=f"{one.name} at the start", value=np.where(over, value, limit)[()], limit=limit, at_least=at_least,
        unit=one.unit, binding=True, meaning=meaning, advice=way,
    )  # fmt: skip


def _of_constant(problem: Problem) -> tuple[Finding, ...]:
    """Warn of an objective that is the same for every flight."""
    inputs = {op for op in problem.form.expressions["objective"].tape.needed(0) if op[0] in ("x", "p")}
    chosen = {op for op in inputs if op[0] == "x" or op[1] in problem.free_names}
    return (
        Finding(
            name="optimised quantities on which the objective depends", value=len(chosen), limit=1, at_least=True,
            unit="1", binding=False, lasting=True,
            meaning="the objective is a constant: it depends on no final state and on no free parameter, so that all"
            " feasible flights are equally good",
            advice="an objective that differs between flights, such as the final mass or a free duration",
        ),
    )  # fmt: skip


def is_possible(found: Sequence[Finding]) -> Any:
    """Return True if no binding comparison is missed; an array for findings of arrays."""
    return np.logical_and.reduce(np.broadcast_arrays(True, *(f.passed for f in found if f.binding)))


def select_findings(found: Sequence[Finding], index: int) -> tuple[Finding, ...]:
    """Return the findings of one of many problems that were judged together.

    Parameters
    ----------
    found
        Findings of arrays, or of numbers that all problems share.
    index
        Number of the problem.
    """

    def pick(values: Any) -> float:
        return float(values if np.ndim(values) == 0 else values[index])

    return tuple(replace(f, value=pick(f.value), limit=pick(f.limit)) for f in found)


def refuse_impossible(found: Sequence[Finding]) -> None:
    """Refuse the first binding comparison that is missed: as infeasible, and a contradiction as bad input."""
    for f in found:
        if f.binding and not f.passed:
            kind = PeriluneError if f.contradiction else InfeasibleError
            raise kind(f.meaning, got=f"{f.name} {f.formatted[0]}", expected=f.formatted[1], advice=f.advice)
