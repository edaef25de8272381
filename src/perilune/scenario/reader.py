"""Reader of a tree of sections: the problem it states, by the records that its kind declares."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from perilune.core import (
    Key,
    PeriluneError,
    Quantity,
    TextField,
    record_keys,
    record_of_values,
    unknown_name,
    with_key_named,
)
from perilune.models import KINDS, PROOF, Body, Kind, Section, kind_named, recognise_body
from perilune.problem import Problem, Tolerance
from perilune.scenario.plausible import refuse_slips

_USUAL = next(iter(KINDS))
KIND = TextField(example=_USUAL, choices=tuple(KINDS), about="the kind of problem that the file states")


def problem_of(document: Mapping[str, Any], folder: Path | None = None) -> Problem:
    """Build the problem that a file states.

    Parameters
    ----------
    document
        Tree of sections.
    folder
        Where the file lies, and with it the files that it names; None for a text alone, which can name none.

    Raises
    ------
    PeriluneError
        For the first thing that is wrong, with its key: a misspelt one before what it leaves missing.
    """
    kind = _kind_of(document)
    for name, table in document.items():
        _check_section_names(kind, name, table)
    records = {
        name: _record_from_section(kind, name, section, document.get(name), folder)
        for name, section in kind.sections.items()
    }
    if isinstance(body := records.get("body"), Body):
        records["body"] = recognise_body(body)
    refuse_slips(records)
    return kind.make(**records)


def tolerance_of(document: Mapping[str, Any]) -> Tolerance:
    """Return the tolerance that a file states for the proof; errors as `problem_of`."""
    section = _kind_of(document).in_file[PROOF]
    return _record_from_section(_kind_of(document), PROOF, section, document.get(PROOF))


def quantities_in(document: Mapping[str, Any]) -> dict[str, Quantity]:
    """Return the declaration of each key, such as ``"vehicle.thrust"``, that is a quantity in a file of this kind.

    Raises
    ------
    PeriluneError
        If there is no such kind.
    """
    return {
        f"{name}.{key}": found.declared
        for name, section in _kind_of(document).sections.items()
        for key, found in section.keys.items()
        if isinstance(found.declared, Quantity)
    }


def names_files(document: Mapping[str, Any]) -> bool:
    """Return True if a tree of sections, of a problem that could be built, names another file."""
    return any(
        getattr(found.declared, "file", False) and key in document.get(name, {})
        for name, section in _kind_of(document).sections.items()
        for key, found in section.keys.items()
    )


def names_of(section_name: str, section: Section) -> dict[str, Key]:
    """Return the keys that a section may have, in order.

    Parameters
    ----------
    section_name
        Name of the section.
    section
        Records that declare its keys.
    """
    kind = {"kind": Key(field="kind", declared=KIND, default=_USUAL)} if section_name == "problem" else {}
    return {**kind, **section.keys}


def _kind_of(document: Mapping[str, Any]) -> Kind:
    stated = document.get("problem")
    name = stated.get("kind", _USUAL) if isinstance(stated, Mapping) else _USUAL
    if not isinstance(name, str):
        return KINDS[_USUAL]  # what is no text is refused with its section
    return kind_named(name)


def _check_section_names(kind: Kind, name: str, table: Any) -> None:
    sections = kind.in_file
    if name not in sections:
        elsewhere = [other.name for other in KINDS.values() if name in other.sections]
        if elsewhere:
            raise PeriluneError(
                f"[{name}] belongs to another kind of problem",
                got=f"a section [{name}]",
                expected="sections of the problem.kind that the file states",
                advice="or ".join(f'kind = "{other}" ' for other in elsewhere).strip() + " in a section [problem]",
            )
        raise unknown_name("section", name[:60], list(sections))
    known = names_of(name, sections[name])
    for key in table if isinstance(table, Mapping) else ():
        if key not in known:
            also = {other: k for k, found in known.items() for other in getattr(found.declared, "also", ())}
            error = unknown_name("key", key[:60], list(known), also)
            what = f"{error.what} in [{name}]"
            raise PeriluneError(what, got=error.got, expected=error.expected, advice=error.advice)


def _record_from_section(kind: Kind, name: str, section: Section, table: Any, folder: Path | None = None) -> Any:
    """Return the record that a section states."""
    compare = f"compare with `perilune new {kind.name}`"
    if table is None:
        if not section.required:
            return section.otherwise
        raise PeriluneError(f"{name} is missing", expected=f"a section [{name}]", advice=compare)
    if not isinstance(table, Mapping):
        expected = f"a section [{name}]"
        raise PeriluneError(f"{name} has the wrong type", got=str(table)[:60], expected=expected, advice=compare)
    values = {
        key: _read_key(f"{name}.{key}", found, table[key], folder)
        for key, found in names_of(name, section).items()
        if key in table
    }
    values.pop("kind", None)
    record = section.stated(values)
    if record is section.instead:
        return record_of_values(record, values)
    if section.instead is not None:
        _refuse_both(name, section, values)
    if section.known:
        values = _values_of_named_record(name, section, values)
    for key, found in record_keys(record).items():
        if key not in values and found.required:
            raise PeriluneError(f"{name}.{key} is missing", expected=_example_line(key, found), advice=compare)
    return record_of_values(record, values)


def _refuse_both(name: str, section: Section, values: Mapping[str, Any]) -> None:
    """Refuse a section that states parts of two alternative records."""
    one = next((key for key in values if key not in record_keys(section.record)), None)
    if one is not None:
        others = [key for key in values if key in record_keys(section.record)]
        raise PeriluneError(
            f"{name}.{one} replaces other quantities, which are also stated",
            got=", ".join(f"{name}.{key}" for key in (one, *others)),
            expected="one or the other",
            advice=f"omit {name}.{one}, or all the others",
        )


def _values_of_named_record(name: str, section: Section, values: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a record that may be stated by its name in place of all required keys."""
    own = {key: k for key, k in record_keys(section.record).items() if k.required and key != "name"}
    if "name" not in values:
        missing = next((key for key in own if key not in values), None)
        if missing is not None:
            alone = [key for key in section.keys if key not in record_keys(section.record)]
            raise PeriluneError(
                f"{name}.{missing} is missing",
                expected=" or ".join(["a name, or " + ", ".join(own), *(f"only {key}" for key in alone)]),
                advice=f'{_example_line(missing, own[missing])}, or only name = "{next(iter(section.known))}"',
            )
        return {**values, "name": name}
    if own.keys() & values.keys():
        raise PeriluneError(
            f"{name} has a name and quantities of its own",
            got=values["name"][:60],
            expected="one or the other",
            advice=f"omit {name}.name to use the quantities",
        )
    if values["name"].lower() not in section.known:
        raise unknown_name(name, values["name"][:60], list(section.known))
    return {**vars(section.known[values["name"].lower()]), **values, "name": values["name"].lower()}


def _read_key(key: str, found: Key, stated: Any, folder: Path | None) -> Any:
    try:
        value = found.declared.read(stated)
    except PeriluneError as error:
        raise with_key_named(key, error) from None
    return _file_in_folder(key, str(value), folder) if getattr(found.declared, "file", False) else value


def _file_in_folder(key: str, stated: str, folder: Path | None) -> str:
    """Return the file that a scenario names, in its own folder or below it, so that a stranger's reaches no other."""
    way = PurePosixPath(stated)
    within = bool(stated) and stated.isprintable() and not way.is_absolute() and ".." not in way.parts
    found = None if folder is None or not within or any(c in stated for c in ":\\") else folder / way
    if found is None or folder is None or not found.resolve().is_relative_to(folder.resolve()):
        raise PeriluneError(
            f"{key} names no file in the scenario's folder",
            got=repr(stated[:60]) + (" in a text without a folder" if folder is None else ""),
            expected="the name of a file in the scenario's own folder or below it, without ..",
            advice="copy the file there",
        )
    return str(found)


def _example_line(key: str, found: Key) -> str:
    return f'{key} = "{found.declared.example}"'
