"""Provenance of an export, in every file: the problem, the proof and the program behind it.

A proof is told as far as it is known: of a solution that was loaded and not proved again only what its file claims.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from perilune.io.atomic_files import finite
from perilune.io.load import claims_of
from perilune.io.save import program_versions, results_document
from perilune.problem import Solution


def provenance(solution: Solution, scenario_text: str | None = None, document: Any = None) -> dict[str, str]:
    """Return texts on the origin of a solution, by name.

    Parameters
    ----------
    solution
        What is exported.
    scenario_text
        The scenario that its problem was made of, if it was.
    document
        What ``solution.json`` holds, of a solution that was loaded.
    """
    problem, views = solution.problem, solution.problem.views
    scenario, made_by = claims_of(document) if document is not None else ("", {})
    found = {
        "title": problem.heading,
        "source": _program(made_by or program_versions()),
        "method": solution.method,
        "outcome": solution.outcome.name,
        "proof": solution.verification.summary,
        "objective": f"{float(solution.objective)!r} {problem.objective_unit}",
        "free_parameters": _parameters_json(
            {name: (value, problem.unit_of(name)) for name, value in solution.free.items()}
        ),
        "given_parameters": _parameters_json({name: (g.value, g.unit) for name, g in problem.given.items()}),
        "results": _parameters_json({name: (r["value"], r["unit"]) for name, r in results_document(solution).items()}),
        "frame": views.frame,
        "chosen": views.space.chosen if views.space is not None else "",
        "body": views.space.body if views.space is not None else "",
        "scenario": scenario_text or scenario,
    }
    return {name: text for name, text in found.items() if text}


def _program(found: Mapping[str, str]) -> str:
    own, *others = (f"{name} {version}" for name, version in found.items())
    return f"{own} ({', '.join(others)})"


def _parameters_json(values: Mapping[str, tuple[float, str]]) -> str:
    """Return JSON of values with their units."""
    return json.dumps(finite({name: [float(value), unit] for name, (value, unit) in values.items()}))
