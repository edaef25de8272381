"""Problem as a tree for JSON and back: its formulas as expressions, so that no code is needed to prove it again.

What was read is a `Problem` like any other: its structure and its units are checked, and its digest must be the one
that the file names. Functions that are no formulas stay behind (`parameter_bounds`, `preflight`,
`consistency_checks`), unless a model makes the problem again (`perilune.io.model_records`): the ranges of the free
parameters are those that were saved.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from string import Formatter
from typing import Any

from perilune.core import Scales
from perilune.io.json_checks import (
    MOST_ENTRIES,
    checked_record,
    finite_number,
    part,
    record_tree,
    refuse_entry,
    short_text,
)
from perilune.io.tape_json import tape_of
from perilune.problem import (
    PAIRS,
    PHASE_FUNCTIONS,
    Expression,
    FreeParameter,
    Parameter,
    Phase,
    Problem,
    Quantities,
    ScalarControl,
    UnitVectorControl,
    Variable,
    named_variables,
    roles_of,
    views,
)

_CONTROLS = {kind.kind: kind for kind in (UnitVectorControl, ScalarControl)}
# In files, the row of the variables of each field of a phase; what came last is left out where it is empty.
_ROWS = {name: PHASE_FUNCTIONS[name][1] for name in PAIRS if name != "results"}
_ALWAYS = set(_ROWS.values()) - {"held_conditions", "end_output_variables"}
_NAME = re.compile(r"[A-Za-z_][\w-]{0,80}", re.ASCII)  # what becomes part of a file's name
_SPEC = re.compile(r"(\.\d{1,2})?[efg]?", re.ASCII)


def physics_document(problem: Problem) -> dict[str, Any]:
    """Return the tree of a problem without its given values."""
    expressions = problem.form.expressions
    return {
        "name": problem.name,
        "title": problem.title,
        "digest": problem.form.digest,
        "scales": record_tree(problem.scales),
        "free": record_tree(problem.free),
        "objective_unit": problem.objective_unit,
        "objective_scale": problem.objective_scale,
        "result_variables": record_tree(problem.result_variables),
        "maximised": problem.maximised,
        **({"minimised": problem.minimised} if problem.minimised else {}),
        "views": record_tree(problem.views),
        "phases": [_phase_physics_document(phase) for phase in problem.phases],
        "functions": {_function_key(key): e.tape.document() for key, e in expressions.items()},
    }


def _function_key(key: Any) -> str:
    """Return the key of a function as a text: ``start``, ``0.dynamics``, ``links.0``."""
    return key if isinstance(key, str) else ".".join(map(str, key))


def _phase_physics_document(phase: Phase) -> dict[str, Any]:
    variables = {"states": record_tree(phase.states)} | {
        row: record_tree(named)
        for name, row in _ROWS.items()
        if (named := named_variables(getattr(phase, name))) or row in _ALWAYS
    }
    controls = [{"kind": c.kind, **record_tree(c)} for c in phase.controls]
    return {"name": phase.name, "duration": phase.duration, "controls": controls, **variables}


def read_physics(document: Mapping[str, Any], given: Mapping[str, Parameter]) -> Problem:
    """Build the problem of a document, with expressions for its functions.

    Parameters
    ----------
    document
        Tree that `physics_document` wrote.
    given
        Given parameters, by name [SI].

    Raises
    ------
    PeriluneError
        If anything in it is not what `physics_document` writes, or its digest is another.
    """
    free = _read_rows(document, "free", FreeParameter)
    entries = part(document, "phases", list)
    if not 0 < len(entries) <= MOST_ENTRIES:
        refuse_entry("phases", str(len(entries)), "at least one")
    bare = [_read_phase(entry, f"problem.phases[{k}]") for k, entry in enumerate(entries)]
    read = _DocumentFunctions(part(document, "functions", dict), bare, {*given, *(f.name for f in free)})
    phases = tuple(_with_read_functions(phase, entries[k], read, k) for k, phase in enumerate(bare))
    named = _read_rows(document, "result_variables", Variable)
    if named and "results" not in read.tapes:
        refuse_entry("functions.results", "nothing", "a function")
    problem = Problem(
        name=short_text(document, "name"),
        title=short_text(document, "title"),
        phases=phases,
        start=read("start", 0) or refuse_entry("functions.start", "nothing", "a function"),
        links=tuple(link for k in range(len(phases) - 1) if (link := read(("links", k), k))),
        given=given,
        free=free,
        objective=read("objective", len(phases) - 1) or refuse_entry("functions.objective", "nothing", "a function"),
        objective_unit=short_text(document, "objective_unit"),
        objective_scale=_scale(document),
        results=Quantities.of(read("results", 0), named),
        maximised=short_text(document, "maximised"),
        minimised=short_text(document, "minimised") if "minimised" in document else "",
        views=_read_views(document),
        scales=checked_record(Scales, document.get("scales"), "problem.scales"),
    )
    if problem.form.digest != (said := short_text(document, "digest")):
        refuse_entry("problem.digest", said[:16], f"{problem.form.digest[:16]}, of the stored expressions")
    return problem


def _scale(document: Mapping[str, Any]) -> float | None:
    """Return the scale of the objective; None in files of earlier versions."""
    return None if document.get("objective_scale") is None else finite_number(document, "objective_scale", "problem")


def _read_rows(document: Mapping[str, Any], name: str, kind: type) -> tuple[Any, ...]:
    entries = part(document, name, list)
    if len(entries) > MOST_ENTRIES:
        refuse_entry(name, f"{len(entries)} entries", f"at most {MOST_ENTRIES}")
    return tuple(checked_record(kind, entry, f"problem.{name}[{i}]") for i, entry in enumerate(entries))


def _read_phase(entry: Any, where: str) -> Phase:
    """Read a phase without its functions."""
    if not isinstance(entry, dict):
        refuse_entry(where, str(entry)[:40], "a record")
    name = short_text(entry, "name")
    if not _NAME.fullmatch(name):
        refuse_entry(f"{where}.name", repr(name[:40]), "letters, digits, _ and -")
    controls = []
    for i, control in enumerate(part(entry, "controls", list)[:MOST_ENTRIES]):
        kind = _CONTROLS.get(str(control.get("kind"))) if isinstance(control, dict) else None
        if kind is None:
            refuse_entry(f"{where}.controls[{i}]", str(control)[:40], "a control of kind " + " or ".join(_CONTROLS))
        controls.append(
            checked_record(kind, {k: v for k, v in control.items() if k != "kind"}, f"{where}.controls[{i}]")
        )
    return Phase(
        name=name,
        duration=short_text(entry, "duration"),
        states=_read_rows(entry, "states", Variable),
        controls=tuple(controls),
        dynamics=_unread_dynamics,
    )


def _with_read_functions(phase: Phase, entry: Mapping[str, Any], read: _DocumentFunctions, k: int) -> Phase:
    """Return phase k with its functions, and with the names of their values, which its entry has."""
    found: dict[str, Any] = {name: read((k, name), k) for name in PHASE_FUNCTIONS}
    for name, row in _ROWS.items():
        variables = _read_rows(entry, row, Variable) if row in entry or row in _ALWAYS else ()
        if found[name] is None and variables:
            refuse_entry(f"functions.{_function_key((k, name))}", "nothing", "a function")
        if found[name] is not None and not variables:
            refuse_entry(f"problem.phases[{k}].{row}", "nothing", f"a name for each value of {name}")
        found[name] = PAIRS[name][1].of(found[name], variables)
    return replace(phase, **found)


def _unread_dynamics(*arguments: Any) -> None:
    """Stand in for the dynamics until they are read."""


def _read_views(document: Mapping[str, Any]) -> views.Views:
    """Read views, whose texts are checked to be harmless when formatted and as file names."""
    found = checked_record(views.Views, document.get("views"), "problem.views")
    for history in found.histories:
        if not _NAME.fullmatch(history.name):
            refuse_entry("problem.views.histories", repr(history.name[:40]), "names of letters, digits, _ and -")
    try:
        fields_of_label = list(Formatter().parse(found.label))
    except ValueError:
        refuse_entry("problem.views.label", found.label[:40], "a text with {name:format}")
    for _, name, spec, conversion in fields_of_label:
        if name is not None and (conversion or not _SPEC.fullmatch(spec or "")):
            refuse_entry("problem.views.label", found.label[:40], "formats such as {name:.1f}")
    return found


class _DocumentFunctions:
    """Functions of a document by their key; None for a missing one."""

    def __init__(self, tapes: Mapping[str, Any], phases: list[Phase], parameters: set[str]) -> None:
        self.tapes, self.phases, self.parameters = tapes, phases, parameters

    def __call__(self, key: Any, k: int) -> Any:
        """Return the function of a key, which takes states and controls of phase k."""
        name, phase = _function_key(key), self.phases[k]
        if name not in self.tapes:
            return None
        known = {
            "x": phase.state_names,
            "u": phase.control_names,
            "p": self.parameters,
            "t": ("",),
            "first": self.phases[0].state_names,
            "last": self.phases[-1].state_names,
        }
        roles = roles_of(key)
        tape = tape_of(self.tapes[name], {role: known[role] for role in roles}, name)
        return Expression(tape, roles, scalar=key == "objective", origin="a file")
