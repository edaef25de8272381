"""Reference of all keys, written out of the declarations, and templates to start from."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator

from perilune.core import Key, PeriluneError, Quantity, check_call, wrong_type_error
from perilune.models import KINDS, Kind, Section, kind_named, kind_names, one_line_error, unknown_kind
from perilune.scenario.reader import names_files, names_of, problem_of, tolerance_of
from perilune.scenario.text import parse

_COMMENT_COLUMN = 38
_HEAD = """\
# {about}
# Every quantity is a text with its unit.
# Solve it:        perilune solve THIS_FILE --out my_landing
# Change a value:  perilune solve THIS_FILE --set "{change}"
"""


@check_call
def template(kind: str = "hybrid_landing") -> str:
    """Return a commented scenario to start from.

    Raises
    ------
    PeriluneError
        If there is no such kind of problem, or the example of one that a package brings is no scenario.
    """
    if not isinstance(kind, str):
        raise wrong_type_error(kind, "a text", "a kind of problem")
    if kind not in KINDS and kind not in kind_names():
        raise unknown_kind("kind of problem", kind)
    found = kind_named(kind)
    sections = ("\n".join(_section(found, name, section)) for name, section in found.in_file.items())
    body = "\n\n".join(sections)
    if found.package:
        _refuse_no_scenario(found, body)
    return _HEAD.format(about=found.about, change=_first_quantity(found, body)) + "\n" + body + "\n"


def _refuse_no_scenario(kind: Kind, body: str) -> None:
    """Refuse the example of a package that cannot be read back, unless it names a file, which is not there yet."""
    try:
        document = parse(body)
        if not names_files(document):
            problem_of(document)
        tolerance_of(document)
    except PeriluneError as error:
        raise PeriluneError(
            f"the example of the kind of problem {kind.name} is not a scenario",
            got=f"{kind.package}: {one_line_error(error)}",
            expected="Kind(example=...) whose values are a problem",
            advice="report it to the author of the package",
        ) from error


def _first_quantity(kind: Kind, body: str) -> str:
    """Return a change of the first quantity of a template as it is typed; a made-up one for a kind without any."""
    stated = (
        f"{name}.{key}={value}"
        for name, values in tomllib.loads(body).items()
        for key, value in values.items()
        if isinstance(names_of(name, kind.in_file[name])[key].declared, Quantity)
    )
    return next(stated, "section.key=1 m")


def _section(kind: Kind, name: str, section: Section) -> Iterator[str]:
    stated = {key.partition(".")[2] for key in kind.example if key.startswith(f"{name}.")}
    away = not section.required and not stated
    head = f"{'# ' if away else ''}[{name}]"
    yield head if section.required or section.otherwise is not None else _line_with_comment(head, section.absent)
    for key, found in names_of(name, section).items():
        by_name = bool(section.known) and key != "name" and found.required
        needed = (found.required and not by_name) or (key == "kind" and section.required)
        value = kind.name if key == "kind" else kind.example.get(f"{name}.{key}", found.declared.example)
        text = str(value) if _is_dimensionless(found) else f'"{value}"'
        used = not away and (needed or key in stated)
        yield _line_with_comment(f"{'' if used else '# '}{key} = {text}", found.declared.about)


def _is_dimensionless(found: Key) -> bool:
    return isinstance(found.declared, Quantity) and found.declared.unit == "1"


def _line_with_comment(line: str, comment: str) -> str:
    return f"{line:{_COMMENT_COLUMN - 1}} # {comment}"


def reference() -> str:
    """Return the reference page of all keys, in Markdown."""
    lines = [
        "# Every key of a scenario",
        "",
        "Written by `python docs/make_reference.py` from the declarations in `perilune.models`. A quantity is a number",
        'and a unit of its dimension in quotes, `"15 km"`; values without a unit need no quotes. The parameter of',
        "the problem, for `p.`, `with_given` and `pl.sweep`, is section and key with `_` for the dot: `vehicle.thrust`",
        "is `vehicle_thrust`. `[proof]` is no part of the problem: it states tolerances of the",
        "[proof](verification.md#a-stated-tolerance). `perilune new KIND` writes a file to start from.",
    ]
    for kind in KINDS.values():
        lines += ["", f"## {kind.name}", "", kind.about]
        for name, section in kind.in_file.items():
            left_out = "" if section.required else f", {section.absent}"
            lines += ["", f"### [{name}]{left_out}", ""]
            lines += ["| key | unit | range | default | for example | what it is |", "|---|---|---|---|---|---|"]
            lines += [
                _reference_row(key, found, key in section.alone) for key, found in names_of(name, section).items()
            ]
    return "\n".join(lines) + "\n"


def _reference_row(key: str, found: Key, alone: bool) -> str:
    declared = found.declared
    if isinstance(declared, Quantity):
        unit, span = "–" if declared.unit == "1" else declared.spoken_unit, declared.range
    else:
        unit, span = "text", " or ".join(f"`{c}`" for c in declared.choices)
    if found.required:
        default = "in place of the others" if alone else "must be stated"
    elif found.default is None:
        default = "left open"
    else:
        default = declared.shown(found.default) if isinstance(declared, Quantity) else f"`{found.default}`"
    return f"| `{key}` | {unit} | {span} | {default} | `{declared.example}` | {declared.about} |"
