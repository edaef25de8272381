"""A problem as a tree, however it was stated, and back: by its scenario, by its model's records, or by its expressions.

Whatever states it beside the expressions must agree with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from perilune.core import PeriluneError, UnknownKindError
from perilune.io.format import FORMAT_NAME, FORMAT_VERSION, WITH_SCENARIO_ONLY, hash_of
from perilune.io.json_checks import part, refuse_entry, short_text, valued_numbers
from perilune.io.problem_json import physics_document, read_physics
from perilune.problem import Parameter, Problem

_COMPARISONS = "comparisons"  # key of what physics says of a problem of the user's own
_ROUNDING = 1e-12  # relative, between the numbers of a scenario and those beside it


def stated_problem_document(problem: Problem, scenario_text: str | None = None) -> dict[str, Any]:
    """Return a problem as a tree from which `read_problem` makes it again, however it was stated.

    Parameters
    ----------
    problem
        Problem to save.
    scenario_text
        Text of the scenario that states it; None without one.
    """
    scenario = None if scenario_text is None else {"sha256": hash_of(scenario_text), "text": scenario_text}
    return {
        "scenario": scenario,
        "model": _model_document_or_none(problem) if scenario is None else None,
        "problem": physics_document(problem),
        "given": {name: {"value": g.value, "unit": g.unit} for name, g in problem.given.items()},
    }


def _model_document_or_none(problem: Problem) -> dict[str, Any] | None:
    if not problem.records:
        return None
    from perilune.io.model_records import model_document  # and with it all models, which an own problem has no use for

    return model_document(problem)


def read_problem(document: Mapping[str, Any], problem_from_scenario: Callable[[str], Problem]) -> Problem:
    """Build the problem by its scenario or its model, if any, which must agree with the expressions.

    The problem is built from the expressions only if the package that brings its kind is not installed. Its presolve
    checks are those of the document, where it has any.

    Parameters
    ----------
    document
        Tree of a saved solution, or of anything with the entries of `stated_problem_document`.
    problem_from_scenario
        Makes the problem of a scenario's text.

    Raises
    ------
    PeriluneError
        If an entry is not valid, or scenario or model and the expressions differ.
    """
    problem = _stated_problem(document, problem_from_scenario)
    if _COMPARISONS not in document:
        return problem
    from perilune.io.presolve_json import read_comparisons

    return problem.changed(preflight=read_comparisons(document[_COMPARISONS], problem))


def _stated_problem(document: Mapping[str, Any], problem_from_scenario: Callable[[str], Problem]) -> Problem:
    alone = document["format"]["version"] == WITH_SCENARIO_ONLY and document["format"]["name"] == FORMAT_NAME
    stated = None
    try:
        if document.get("scenario") is not None:
            stated = problem_from_scenario(unaltered_scenario(document))
    except UnknownKindError:
        if alone:
            raise
    if alone:
        stated = stated or part(document, "scenario", dict)
        _check_saved_given(document, stated)
        return stated
    entries, values = part(document, "given", dict), valued_numbers(document, "given")
    given = {name: Parameter(value=value, unit=short_text(entries[name], "unit")) for name, value in values.items()}
    source = "scenario"
    if stated is not None:
        _check_saved_given(document, stated)
    elif document.get("model") is not None:
        from perilune.io.model_records import read_model

        source = "model"
        with suppress(UnknownKindError):
            stated = read_model(part(document, "model", dict), given)
    written = read_physics(part(document, "problem", dict), given)
    if stated is None:
        return written
    if stated.form != written.form or not _equal_but_rounding(stated.numbers, written.numbers):
        raise PeriluneError(
            f"the {source} in the saved solution and its stored expressions state different problems",
            got=f"expressions with digest {written.form.digest[:16]}",
            expected=f"{stated.form.digest[:16]} and the numbers of the {source}",
            advice=f"solve the {source} again: the file was altered, or written by a version with different models",
        )
    return stated


def reread_problem(problem: Problem, places: Sequence[Mapping[str, float]]) -> tuple[dict[str, Any], Problem]:
    """Return a problem as a tree, and the problem that is made of it again without a scenario.

    Presolve checks that are lost with the user's function are stored as formulas in the tree.

    Parameters
    ----------
    problem
        Problem to save.
    places
        Values of given parameters [SI], by name, at each of which the formulas must say what the function says.

    Raises
    ------
    PeriluneError
        If the presolve checks are no formulas, or their words tell values.
    """
    from perilune.io.presolve_json import comparisons_document, same_comparisons

    document = stated_problem_document(problem)
    again = read_problem({**document, "format": {"name": FORMAT_NAME, "version": FORMAT_VERSION}}, _no_scenario)
    if not same_comparisons(problem, again, places):
        document[_COMPARISONS] = comparisons_document(problem, places)
    return document, again


def _no_scenario(_: str) -> Problem:
    raise AssertionError("a document made without a scenario has none")


def unaltered_scenario(document: Mapping[str, Any]) -> str:
    """Return the text of the scenario of a document; refuse one that is not what its hash says."""
    scenario = part(document, "scenario", dict)
    said = part(scenario, "text", str)
    found = hash_of(said)
    if found != scenario.get("sha256"):
        raise PeriluneError(
            "the scenario in the saved solution was altered",
            got=f"text with SHA-256 {found[:16]}…",
            expected=f"{str(scenario.get('sha256'))[:16]}…",
            advice="solve the altered scenario again",
        )
    return said


def _check_saved_given(document: Mapping[str, Any], problem: Problem) -> None:
    """Refuse a file whose parameters differ from those of its scenario."""
    saved = valued_numbers(document, "given")
    for name, given in problem.given.items():
        if name not in saved or not math.isclose(saved[name], given.value, rel_tol=_ROUNDING, abs_tol=0.0):
            refuse_entry(f"given.{name}", str(saved.get(name, "none")), f"{given.value!r}, as in the scenario")
    if extra := set(saved) - set(problem.given):
        refuse_entry("given", ", ".join(sorted(extra)), "only parameters that the scenario gives")


def _equal_but_rounding(one: Any, other: Any) -> bool:
    """Return True if two trees of names and numbers are equal to rounding."""
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_equal_but_rounding, one, other))
    if isinstance(one, float | int) and isinstance(other, float | int):
        return math.isclose(one, other, rel_tol=_ROUNDING, abs_tol=0.0)
    return one == other
