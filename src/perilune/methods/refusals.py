"""Why a search has no answer: refused because nothing can fly it, or not converged, with what was found kept.

That every extremal breaks something is an answer of the method, not of physics. A refusal needs a bound that holds for
every flight, or a direct method that found no flight from any of its starts.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from perilune.conditions.pontryagin import Conditions
from perilune.methods.assemble import beyond_shooting, free_values, residual_scales
from perilune.methods.breaches import Breach
from perilune.methods.coarse import Coarse, along_path
from perilune.methods.undetermined import undetermined
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution
from perilune.shooting.continuum import nearly_open
from perilune.shooting.function import Root
from perilune.words.outcome import BEST_MISSES, InfeasibleError, NotConvergedError, PeriluneError
from perilune.words.units import told

_BROKEN = "every extremal breaks a condition"
NOT_ISOLATED = "extremals are not isolated here: beside one lie others with the same J (spare time, a free angle)"


def refusal(coarse: Coarse, breaches: list[Breach]) -> PeriluneError | None:
    """Why every extremal that was found is no answer; None where none was found, and nothing else says why."""
    direct, bounds = coarse.refusal, [breach for breach in breaches if not breach.path]
    known = getattr(direct, "partial", {})
    if isinstance(direct, InfeasibleError) or (direct is not None and "least_miss" in known and not breaches):
        known["tried"] = list(coarse.tried)
        return direct
    if bounds and known.get("all_missed"):
        return best_misses(coarse.problem, bounds, len(breaches), direct, coarse.tried)
    flight = coarse.flight
    if flight is not None and (breaches or ridden_condition(coarse.problem, flight)):
        return kept_flight(coarse.problem, flight, breaches, coarse.tried)
    return undecided(breaches, coarse.refusal, coarse.tried) if breaches else None


def best_misses(problem: Problem, bounds: list[Breach], count: int, direct: Any, tried: list[str]) -> InfeasibleError:
    """No flight was found: the best of so many extremals misses a bound, and the direct method misses something too."""
    best = min(bounds, key=lambda breach: breach.canonical)
    return InfeasibleError(
        f"the best of {count} found misses {best.name} by {told(best.miss, best.unit)}",
        got=f"{best.text}; the direct method found no flight either: {direct.partial['missed'][0]}",
        expected=f"{best.name} within its bounds all along",
        advice=f"a wider bound; {_easier(problem)}",
        reason=BEST_MISSES,
        partial={**direct.partial, "tried": list(tried)},
    )


def kept_flight(problem: Problem, flight: Solution, breaches: list[Breach], tried: list[str]) -> NotConvergedError:
    """A flight that keeps every condition was found, but no extremal does."""
    words = [f"J = {flight.objective:.6g} {problem.objective_unit}", f"mesh error {flight.statistics.residual:.1g}"]
    for condition, values in along_path(problem, flight):
        broken = -float(values.min())
        if broken > 1e-6 * np.ptp(values):
            words.append(f"{condition.name} broken by {broken:.2g} {condition.unit} between the points of the mesh")
    best = "direct method: " + ", ".join(words)
    ridden = ridden_condition(problem, flight)
    parts = [_mildest(problem, flight, breaches)] if breaches else []
    if ridden is not None:
        parts.append(f"the best path that keeps {ridden} rides along it ({best})")
    else:
        parts.append(f"a flight that keeps every condition is known ({best})")
    return NotConvergedError(
        f"{_BROKEN} of the path" if breaches else "no extremal was found",
        got="; ".join(parts),
        expected="not negative, and not zero along the way" if breaches else "all residuals zero",
        advice="the direct method (--method direct, Pseudospectral()) may ride it; " + _easier(problem),
        partial={"tried": list(tried)},
        flight=flight,
    )


def _mildest(problem: Problem, flight: Solution, breaches: list[Breach]) -> str:
    """How extremals break a condition, by the one that breaks it least.

    What goes further beyond it than any flight that keeps it stays within is no flight, and its depth says nothing.
    """
    least = min(breaches, key=lambda breach: breach.canonical)
    room = {condition.name: float(values.max()) for condition, values in along_path(problem, flight)}
    if least.path and least.miss > room.get(least.name, math.inf):
        return f"what is optimal where {least.name} is left out does not come near to keeping it"
    return least.text


def _easier(problem: Problem) -> str:
    """What makes a problem easier, in its own terms."""
    if "vehicle_thrust" in problem.given:
        return "more thrust, less mass or a higher start"
    return "given values that leave more room"


def undecided(breaches: list[Breach], direct: PeriluneError | None, tried: list[str]) -> NotConvergedError:
    """Every extremal breaks something, and the direct method did not settle whether any flight keeps everything."""
    known = "its flight is too rough to tell" if direct is None else "; ".join(filter(None, (direct.what, direct.got)))
    return NotConvergedError(
        f"{_BROKEN}, and whether any flight keeps them all is not settled",
        got=f"{breaches[0].text}; direct method: {known}",
        expected="not negative" if breaches[0].path else "within its bounds all along",
        advice="the direct method on a finer mesh (Pseudospectral(nodes=8, segments=10)); a wider bound",
        partial={**getattr(direct, "partial", {}), "tried": list(tried)},
    )


def ridden_condition(problem: Problem, flight: Solution) -> str | None:
    """Path condition along which a flight runs, away from its ends."""
    for condition, values in along_path(problem, flight, ends=0.05):
        if np.min(values) <= 1e-4 * problem.scales.of(condition.unit):
            return condition.name
    return None


def not_converged(conditions: Conditions, coarse: Coarse, iterations: int, nearest: Root | None) -> NotConvergedError:
    """Every rung failed: the nearest approach, in physical units, and what to try."""
    problem, tried, flight = coarse.problem, coarse.tried, coarse.flight
    partial: dict[str, Any] = {"tried": list(tried), "iterations": iterations}
    got = "no start could even be flown to its end"
    if nearest is not None:
        scaled = nearest.residual[: len(conditions.residuals)]
        values = scaled * residual_scales(problem, conditions)
        partial["residuals"] = {
            name: {"value": float(v), "unit": unit}
            for (name, unit), v in zip(conditions.residuals, values, strict=True)
        }
        partial["free"] = free_values(problem, conditions, nearest.y)
        k = int(np.argmax(np.abs(scaled)))
        name, unit = conditions.residuals[k]
        got = f"nearest approach leaves {name} = {told(values[k], unit, 4)}"
    advice = (
        "what physics says (perilune check, perilune.preflight); more starts (Indirect(starts=100)), a nearby guess"
    )
    if nearest is not None and nearly_open(nearest):
        got += f"; {NOT_ISOLATED}"
        advice = "a condition more at the end, a shorter or a free duration; " + advice
    if coarse.solution is not None and (loose := undetermined(coarse.solution)):
        got += f"; in the direct method's flight nothing determines {' and '.join(loose)}: any that arrives is as good"
        advice = "minimise what depends on it, as the time of flight; " + advice
    if flight is not None and (beyond := beyond_shooting(flight, conditions)) is not None:
        got, advice = beyond
    return NotConvergedError(
        "no extremal was found",
        got=got,
        expected="all residuals zero; tried " + "; ".join(tried or ["nothing"]),
        advice=advice,
        partial=partial,
        flight=flight,
    )
