"""Why a search has no answer: refused because nothing can fly it, or not converged, with what was found kept."""

from __future__ import annotations

from typing import Any

import numpy as np

from perilune.conditions.pontryagin import Conditions
from perilune.methods.assemble import beyond_shooting, free_values, residual_scales
from perilune.methods.judge import Breach
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution
from perilune.shooting.function import Root
from perilune.words.outcome import InfeasibleError, NotConvergedError


def best_misses(breaches: list[Breach]) -> InfeasibleError:
    """Every extremal that was found breaks something, and no other method found a flight either."""
    best = min(breaches, key=lambda breach: breach.canonical)
    return InfeasibleError(
        f"the best of {len(breaches)} found misses {best.name} by {best.miss:.6g} {best.unit}",
        got=f"{best.text} on the way; the direct method found no flight that keeps every condition",
        expected=f"{best.name} within its bounds all along",
        advice="more thrust or a higher start, or a wider bound",
        reason="the best of n found misses it",
    )


def kept_flight(problem: Problem, flight: Solution, breaches: list[Breach]) -> NotConvergedError:
    """A flight that keeps every condition exists, but no extremal does."""
    best = f"J = {flight.objective:.6g} {problem.objective_unit}"
    ridden = ridden_condition(problem, flight)
    parts = [f"{breaches[0].text} on the way"] if breaches else []
    if ridden is not None:
        parts.append(f"the best path that keeps {ridden} rides along it (direct method: {best})")
    else:
        parts.append(f"a flight that keeps every condition is known (direct method: {best})")
    return NotConvergedError(
        "every extremal breaks a condition of the path" if breaches else "no extremal was found",
        got="; ".join(parts),
        expected="not negative, and not zero along the way" if breaches else "all residuals zero",
        advice="the direct method (--method direct, Pseudospectral()) may ride it; more thrust or a higher start",
        flight=flight,
    )


def ridden_condition(problem: Problem, flight: Solution) -> str | None:
    """Path condition along which a flight runs, away from its ends."""
    for phase, flown in zip(problem.phases, flight.trajectories, strict=True):
        t = np.linspace(0.05, 0.95, 400) * flown.duration
        values = phase.evaluate("path", flown.state(t).T, flown.control(t).T, flight.parameters)
        for condition, value in zip(phase.path_conditions, values, strict=True):
            if np.min(value) <= 1e-4 * problem.size_of(condition):
                return condition.name
    return None


def not_converged(
    problem: Problem,
    conditions: Conditions,
    tried: list[str],
    iterations: int,
    nearest: Root | None,
    flight: Solution | None,
) -> NotConvergedError:
    """Every rung failed: the nearest approach, in physical units, and what to try."""
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
        got = f"nearest approach leaves {name} = {values[k]:.4g} {unit}"
    advice = "perilune check for what physics says; then more starts (Indirect(starts=100)) or a nearby guess"
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
