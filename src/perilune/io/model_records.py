"""Problem of a model as data: the kind of the model and the values of its records.

So a problem that is read back has what is no formula: its ranges, its comparisons before the flight, its bookkeeping.
The kinds and their keys are those of scenario files (`perilune.models.catalogue`); nothing else can be named, and what
is made has to be the problem whose expressions stand beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from perilune.core import PeriluneError, Quantity, record_keys, record_of_values, record_values, section_of
from perilune.io.json_checks import finite_number, part, refuse_entry, short_text
from perilune.models import KINDS, Body, Section, kind_named, kind_names, recognise_body, unknown_kind
from perilune.problem import Parameter, Problem


def model_document(problem: Problem) -> dict[str, Any] | None:
    """Return the model and records that make a problem; None if no model makes exactly this one."""
    if problem.name not in KINDS:
        return None
    sections = {
        section_of(type(made)): {name: value for name, value in record_values(made).items() if value is not None}
        for made in problem.records
    }
    document = {"kind": problem.name, "sections": sections}
    try:
        same = read_model(document, problem.given) == problem
    except PeriluneError:  # records of a model, in a problem of another making
        same = False
    return document if same else None


def read_model(document: Mapping[str, Any], given: Mapping[str, Parameter]) -> Problem:
    """Make the problem by its model, with the given values of the solution.

    Parameters
    ----------
    document
        Tree with the kind of the model and the values of its sections.
    given
        Given parameters of the solution, by name [SI].

    Raises
    ------
    PeriluneError
        If there is no such kind, section, key or parameter, or a value is outside what is declared of it.
    """
    name, sections = short_text(document, "kind"), part(document, "sections", dict)
    if name not in KINDS and name not in kind_names():
        raise unknown_kind("model.kind", name[:40])
    kind = kind_named(name)
    for section in sections:
        if section not in kind.sections:
            refuse_entry(f"model.sections.{section}"[:80], "an unknown section", ", ".join(kind.sections))
    records = {
        section: _record_of_section(stated, sections.get(section), f"model.sections.{section}")
        for section, stated in kind.sections.items()
    }
    if isinstance(body := records.get("body"), Body):
        records["body"] = recognise_body(body)
    problem = kind.make(**records)
    known = {name: g.value for name, g in problem.given.items()}
    changed = {name: g.value for name, g in given.items() if known.get(name) != g.value}  # what is free is not known
    return problem.with_given(**changed) if changed else problem


def _record_of_section(section: Section, values: Any, where: str) -> Any:
    if values is None:
        if not section.required:
            return section.otherwise
        values = {}
    if not isinstance(values, dict):
        refuse_entry(where, str(values)[:40], "a record")
    record = section.stated(values)
    keys = record_keys(record)
    for key in values:
        if key not in keys:
            refuse_entry(f"{where}.{key}"[:80], "an unknown key", ", ".join(keys))
        if getattr(keys[key].declared, "file", False):
            refuse_entry(f"{where}.{key}", "the path of a file", "content that can be read without further files")
    for key, found in keys.items():
        if found.required and key not in values:
            refuse_entry(f"{where}.{key}", "nothing", "a value")
    read = {
        k: finite_number(values, k, where) if isinstance(keys[k].declared, Quantity) else short_text(values, k)
        for k in values
    }
    return record_of_values(record, read)
