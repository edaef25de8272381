"""Outcome of a failed search: infeasible because nothing can fly it, or not converged, with what was found kept.

That every extremal found breaks something is an answer of the method, not of physics. A refusal needs a bound that
holds for every flight, or a direct method that found no flight from any of its starts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from perilune.conditions import OptimalityConditions
from perilune.core import (
    BEST_MISSES,
    NUMERIC,
    InfeasibleError,
    NotConvergedError,
    PeriluneError,
    Vector,
    format_quantity,
)
from perilune.methods.indirect.chattering import detect_chattering
from perilune.methods.indirect.coarse_direct import Coarse, path_condition_values
from perilune.methods.indirect.unknowns import free_values, residual_scales, unreachable_by_shooting
from perilune.methods.indirect.violations import ConstraintViolation
from perilune.problem import (
    Problem,
    Solution,
    control_scales,
    control_slices,
    end_text,
    limit_name,
    objective_text,
    preflight,
    quantity_name,
    stating_keys,
)
from perilune.shooting import Root, nearly_open

_DEFECT = "the dynamics of "  # in a least miss: it is no flight, and nothing that was stated stands in the way
_BROKEN = "every extremal found violates a condition"
NO_EXTREMAL = "no extremal was found (a flight that meets every condition of an optimum)"
CHATTERS = "no optimal flight was found: it chatters, or switches more often than any mesh resolves"
_STATIONARITY, _TRANSVERSALITY = "stationarity in ", ": transversality of "  # as `conditions.residuals` names them
_ARRIVED = 1e-4  # canonical: an end that is missed by less is satisfied, as far as messages go
NOT_ISOLATED = (
    "extremals are not isolated here: others with the same J are arbitrarily close (spare time, a free angle)"
)


def explain_refusal(coarse: Coarse, breaches: list[ConstraintViolation]) -> PeriluneError | None:
    """Return why no extremal that was found is an answer; None where none was found, and nothing else says why.

    Parameters
    ----------
    coarse
        The direct method's attempts at the same problem.
    breaches
        Violated conditions, one for each extremal that was found and breaks any.
    """
    direct, bounds = coarse.refusal, [breach for breach in breaches if not breach.path]
    known = getattr(direct, "partial", {})
    if isinstance(direct, InfeasibleError):
        known["attempts"] = list(coarse.tried)
        return direct
    if direct is not None and "least_miss" in known and not breaches:
        known["attempts"] = list(coarse.tried)
        warned = _physics_warnings(coarse.problem)
        if not warned:
            return direct
        got, flight = direct.got + warned, getattr(direct, "flight", None)
        return NotConvergedError(
            direct.what, got=got, expected=direct.expected, advice=direct.advice, partial=known, flight=flight
        )
    if bounds and known.get("all_infeasible"):
        got = "the direct method found no flight either"
        return best_misses_bound_error(
            coarse.problem, bounds, len(breaches), got, {**known, "attempts": list(coarse.tried)}
        )
    flight = coarse.flight
    if flight is not None and (
        priced := [b for b in bounds if bound_unreachable_objective(coarse.problem, b) is not None]
    ):
        if _by_the_mesh_alone(coarse, flight, priced[0]):
            got = "the direct method's flight keeps it by a margin below its mesh error"
            return best_misses_bound_error(coarse.problem, priced, len(breaches), got, {"attempts": list(coarse.tried)})
    if flight is not None and (breaches or active_path_condition(coarse.problem, flight)):
        return no_extremal_error(coarse.problem, flight, breaches, coarse.tried)
    return undecided_error(coarse.problem, breaches, coarse.refusal, coarse.tried) if breaches else None


def bound_unreachable_objective(problem: Problem, breach: ConstraintViolation) -> float | None:
    """Return J on a broken bound where each flight that keeps it is better than that, else None.

    So it is where J is the end of only one state, as the mass that is landed: an optimum that misses the bound says
    that nothing keeps it.

    Parameters
    ----------
    problem
        The problem, whose objective is minimised.
    breach
        Violated bound of a state at the end of the last phase.
    """
    last = problem.phases[-1]
    if _read_by_objective(problem) != {("x", breach.name)}:
        return None
    state = next(state for state in last.states if state.name == breach.name)

    def J(value: float) -> float:
        ends = (value if other is state else problem.size_of(other) for other in last.states)
        return float(problem.objective(last.state_record(*ends), problem.parameters({}), NUMERIC))

    lower, upper = state.limits(problem.parameters({}))
    for side, bound, way in (("lower", lower, 1.0), ("upper", upper, -1.0)):
        if breach.limit == limit_name(problem, state, side) and J(bound + way * problem.size_of(state)) < J(bound):
            return J(bound)
    return None


def bounds_its_objective(problem: Problem) -> bool:
    """Return True if J is the end of one state that has a bound, so that an optimum may say that nothing keeps it."""
    read, p = _read_by_objective(problem), problem.parameters({})
    bounded = (state.name for state in problem.phases[-1].states if np.isfinite(state.limits(p)).any())
    return any(read == {("x", name)} for name in bounded)


def _read_by_objective(problem: Problem) -> set[Any]:
    """Return the states and parameters that J depends on, as operations of its tape."""
    instructions = problem.form.expressions["objective"].tape.instructions
    return {op[:2] for op in instructions if op[0] in ("x", "p")}


def _by_the_mesh_alone(coarse: Coarse, flight: Solution, breach: ConstraintViolation) -> bool:
    """Return True if a rough flight keeps a bound, of which only J depends, by no more than its J changes."""
    bound, finer = bound_unreachable_objective(coarse.problem, breach), coarse.without_bounds(breach.name, flight)
    if bound is None or finer is None:
        return False
    return bound - finer.objective <= abs(finer.objective - flight.objective)


def best_misses_bound_error(
    problem: Problem, bounds: Sequence[ConstraintViolation], count: int, direct: str, partial: dict[str, Any]
) -> InfeasibleError:
    """Return the error for no flight: the best of so many extremals misses a bound, and the direct method has none.

    Parameters
    ----------
    problem, bounds, count
        What is refused, the bounds that were missed, and how many extremals there are.
    direct, partial
        What the direct method found, and what is kept of the search.
    """
    best = min(bounds, key=lambda breach: breach.canonical)
    return InfeasibleError(
        f"the best of {count} found violates {best.limit or best.name} by {format_quantity(best.miss, best.unit)}",
        got=f"{best.text}; {direct}",
        expected=best.kept,
        advice="; or ".join(filter(None, (best.enough, _suggest_easier_problem(problem)))),
        reason=BEST_MISSES,
        partial=partial,
    )


def no_extremal_error(
    problem: Problem, flight: Solution, breaches: list[ConstraintViolation], tried: list[str]
) -> NotConvergedError:
    """Return the error for a flight that keeps every condition, but no extremal that does.

    Parameters
    ----------
    problem, flight
        The problem, and the direct method's flight that keeps everything.
    breaches
        Violations of the extremals that were found.
    tried
        Lines of what was tried.
    """
    words = [objective_text(flight), f"mesh error {flight.statistics.residual:.1g}"]
    for condition, values in path_condition_values(problem, flight):
        broken = -float(values.min())
        if broken > 1e-6 * np.ptp(values):
            called = quantity_name(condition)
            words.append(
                f"{called} violated by {format_quantity(broken, condition.unit, 2)} between the points of the mesh"
            )
    best = "direct method: " + ", ".join(words)
    ridden = active_path_condition(problem, flight)
    parts = [_describe_mildest_violation(problem, flight, breaches)] if breaches else []
    if ridden is not None:
        parts.append(f"the optimal path that keeps {ridden} has a boundary arc along it ({best})")
    else:
        parts.append(f"a flight that keeps every condition is known ({best})")
    return NotConvergedError(
        f"{_BROKEN} of the path" if breaches else NO_EXTREMAL,
        got="; ".join(parts),
        expected="an optimal flight that keeps every condition" if breaches else "a flight that no variation improves",
        advice="the direct method (--method direct, Pseudospectral()) may find this arc; "
        + _suggest_easier_problem(problem),
        partial={"attempts": list(tried)},
        flight=flight,
    )


def flight_without_extremal_error(flight: Solution, tried: list[str]) -> NotConvergedError:
    """Return the error for a flight of arcs that the model knows, where no extremal was found.

    Parameters
    ----------
    flight
        It keeps every condition, as far as its steps tell.
    tried
        Lines of what was tried.
    """
    return NotConvergedError(
        NO_EXTREMAL,
        got=f"a rough flight that keeps every condition is known ({objective_text(flight, 7)}), but no extremal of its "
        "arcs was found: others, such as another burn, may better it",
        expected="a flight that no change improves",
        advice="a throttle floor above 0, with which few burns pay; the flight as a guess for another method",
        partial={"attempts": list(tried)},
        flight=flight,
    )


def _describe_mildest_violation(problem: Problem, flight: Solution, breaches: list[ConstraintViolation]) -> str:
    """Describe how extremals break a condition, by the one that breaks it least.

    What goes further beyond it than any flight that keeps it stays within is no flight, and its depth says nothing.
    """
    least = min(breaches, key=lambda breach: breach.canonical)
    room = {condition.name: float(values.max()) for condition, values in path_condition_values(problem, flight)}
    if least.path and least.miss > room.get(least.name, math.inf):
        return f"the optimum without {least.limit or least.name} is far from keeping it"
    return least.text


def _suggest_easier_problem(problem: Problem) -> str:
    """Return what makes a problem easier, in its own terms."""
    if "vehicle_thrust" in problem.given:
        return "more thrust, less mass or a higher start"
    return "given values that leave more margin"


def undecided_error(
    problem: Problem, breaches: list[ConstraintViolation], direct: PeriluneError | None, tried: list[str]
) -> NotConvergedError:
    """Return the error for extremals that all break something while no flight is known to keep everything.

    The mildest extremal says it: a least miss of the direct method that is no flight blames what is held loosely.

    Parameters
    ----------
    problem
        The problem.
    breaches
        Violations of the extremals that were found, one at least.
    direct
        The direct method's error, if any.
    tried
        Lines of what was tried.
    """
    least = min(breaches, key=lambda breach: breach.canonical)
    keys = _stating_keys_of_violation(problem, least)
    called, stated = least.limit or least.name, f" ({', '.join(keys)})" if keys else ""
    ends = "its flight is too inaccurate to tell" if direct is None else direct.what
    if _DEFECT in ends:
        ends = "it found none either"
    return NotConvergedError(
        f"{_BROKEN}, the nearest {called}{stated} by {format_quantity(least.miss, least.unit)}, and whether any"
        f" flight keeps them all remains open",
        got=f"{least.text}; direct method: {ends}",
        expected=least.kept or f"{called} never below 0",
        advice=f"relax {keys[0] if keys else called}, and tighten it step by step from a solved value (perilune sweep)",
        partial={**getattr(direct, "partial", {}), "attempts": list(tried)},
        flight=getattr(direct, "flight", None),
    )


def _stating_keys_of_violation(problem: Problem, breach: ConstraintViolation) -> list[str]:
    """Return the keys that state a condition of the path, the limit's own first; none for a bound."""
    for k, phase in enumerate(problem.phases):
        for row, condition in enumerate(phase.path_conditions):
            if breach.path and condition.name == breach.name:
                keys = stating_keys(problem, k, "path", row)
                return sorted(keys, key=lambda key: not key.startswith("limits."))
    return []


def active_path_condition(problem: Problem, flight: Solution) -> str | None:
    """Return the path condition along which a flight runs, away from its ends.

    Parameters
    ----------
    problem
        The problem with the path conditions.
    flight
        Trajectory of it; 5 % of each phase at its start and at its end are left out.

    Returns
    -------
    str or None
        The condition as messages name it; None if none is within 1e-4 of its canonical unit.
    """
    for condition, values in path_condition_values(problem, flight, ends=0.05):
        if np.min(values) <= 1e-4 * problem.scales.of(condition.unit):
            return quantity_name(condition)
    return None


def no_start_converged_error(
    conditions: OptimalityConditions, coarse: Coarse, iterations: int, nearest: Root | None
) -> NotConvergedError:
    """Return the error for starts that all failed: the nearest approach, in the user's words, and what to try.

    Parameters
    ----------
    conditions
        The boundary value problem.
    coarse
        The direct method's attempts at it.
    iterations
        Iterations of Newton's method in all.
    nearest
        The nearest approach, if any start could be flown to its end.
    """
    problem, tried, flight = coarse.problem, coarse.tried, coarse.flight
    partial: dict[str, Any] = {"attempts": list(tried), "iterations": iterations}
    what, got = NO_EXTREMAL, "no start could be integrated to its end"
    if nearest is not None:
        scaled = nearest.residual[: len(conditions.residuals)]
        values = scaled * residual_scales(problem, conditions)
        partial["residuals"] = {
            name: {"value": float(v), "unit": unit}
            for (name, unit), v in zip(conditions.residuals, values, strict=True)
        }
        partial["free"] = free_values(problem, conditions, nearest.y)
        got = _nearest_approach(problem, conditions, scaled, values)
    got += (warned := _physics_warnings(problem))
    advice = "more starts (Indirect(starts=100)), a nearby guess"
    if not warned:
        advice = "compare with physical bounds (perilune check, perilune.preflight);  " + advice
    if nearest is not None and nearly_open(nearest):
        got += f"; {NOT_ISOLATED}"
        advice = "an additional end condition, a shorter or a free duration; " + advice
    if coarse.solution is not None and (loose := undetermined_controls(coarse.solution)):
        got += f"; in the direct method's flight nothing determines {' and '.join(loose)}: all values are equally good"
        advice = "minimise a quantity that depends on it, such as the time of flight; " + advice
    if flight is not None and (beyond := unreachable_by_shooting(flight, conditions)) is not None:
        got, advice = beyond
    elif flight is None and coarse.solution is not None and (found := detect_chattering(coarse.solution)) is not None:
        what, got, advice = CHATTERS, f"in the best flight found {found.text}", found.advice
    return NotConvergedError(
        what,
        got=got,
        expected="a flight that meets every end condition and that no variation improves",
        advice=advice,
        partial={**_direct_misses(coarse), **partial},
        flight=flight or getattr(coarse.refusal, "flight", None),
    )


def _physics_warnings(problem: Problem) -> str:
    """Return what to append to a message where comparisons before the search warn."""
    warned = [finding.meaning for finding in preflight(problem) if finding.verdict == "warning"]
    return "".join(f"; before solving, physics warns: {meaning}" for meaning in warned)


def _direct_misses(coarse: Coarse) -> dict[str, Any]:
    """Return what the direct method's flight misses, where it found none that misses nothing."""
    known = getattr(coarse.refusal, "partial", {}) if coarse.flight is None else {}
    return {name: known[name] for name in ("violations", "all_infeasible", "converged") if name in known}


def _nearest_approach(problem: Problem, conditions: OptimalityConditions, scaled: Vector, values: Vector) -> str:
    """Describe what the flight nearest to an optimum lacks: an end that it misses, else what would improve it."""
    ends = conditions.transversality_at
    worst = int(np.argmax(np.abs(scaled)))
    if ends and (missed := float(np.abs(scaled[:ends]).max())) > max(_ARRIVED, 1e-2 * abs(float(scaled[worst]))):
        k = int(np.argmax(np.abs(scaled[:ends]) >= missed))
        name, unit = conditions.residuals[k]
        return f"the nearest approach misses {name} by {format_quantity(abs(float(values[k])), unit, 4)}"
    name, _ = conditions.residuals[worst]
    if name.startswith(_STATIONARITY):
        return (
            f"the nearest approach meets the end conditions, but another {name.removeprefix(_STATIONARITY)} is better"
        )
    if _TRANSVERSALITY in name:
        phase = name.partition(_TRANSVERSALITY)[0]
        ends = end_text(problem, phase)
        end = f"another end of {phase}{f' ({ends})' * bool(ends)}"
        return f"the nearest approach meets the end conditions, but {end} would be better"
    return f"the nearest approach meets the end conditions, but is not optimal yet ({name})"


_LOOKS = 40  # times of a phase
_FLAT = 1e-6  # of the largest sum of the parts of H on the flight; what counts for little still has some 1e-4


def undetermined_controls(flight: Solution) -> tuple[str, ...]:
    """Name the controls of a flight with costates that nothing determines, each with its phase before it."""
    found, size = list[tuple[float, str]](), 0.0
    for k, (phase, flown) in enumerate(zip(flight.problem.phases, flight.trajectories, strict=True)):
        if flown.costate is None:
            return ()
        t = np.linspace(0.0, flown.duration, _LOOKS)
        x, u = flight.evaluate(k, t)
        costate, p = flown.costate(t).T, flight.parameters
        rates = np.array(np.broadcast_arrays(*phase.rates(x, u, p), t)[:-1])
        size = max(size, float(np.abs(costate * rates).sum(axis=0).max()))
        scales = control_scales(phase.controls, flight.problem.scales)
        for at, control in control_slices(phase.controls):
            changes = [0.0]
            for values in control.samples(u[at], float(scales[at.start]), p):
                other = u.copy()
                other[at] = values
                changed = np.array(np.broadcast_arrays(*phase.rates(x, other, p), t)[:-1])
                changes.append(float(np.abs((costate * (changed - rates)).sum(axis=0)).max()))
            found.append((max(changes), f"{phase.name}.{', '.join(phase.control_names[at])}"))
    return tuple(name for change, name in found if change <= _FLAT * size)
