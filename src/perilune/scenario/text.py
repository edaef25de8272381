"""Text of a scenario file to a tree of sections: limits first, then TOML, then changes of the command line."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from perilune.core import PeriluneError, bounded_text, refuse_nested
from perilune.models import KINDS

LARGEST_FILE = 64 * 1024  # bytes; a complete scenario takes about one thousand
LONGEST_LINE = 1000  # characters; keeps the time of the TOML parser linear in practice
_COMPARE = "compare with `perilune new KIND`, " + " or ".join(KINDS)
DEEPEST_NESTING = 4  # brackets; a scenario needs one


def read_scenario_file(path: Path) -> str:
    """Read the text of a file of bounded size."""
    advice = f"perilune new {path.name if path.suffix == '.toml' else 'my_lander.toml'}"
    return bounded_text(path, "scenario file", LARGEST_FILE, expected="a TOML file, which is text", advice=advice)


def parse(text: str) -> dict[str, Any]:
    """Parse a text within the limits into a tree of sections."""
    longest = max(map(len, text.splitlines()), default=0)
    if len(text) > LARGEST_FILE or longest > LONGEST_LINE:
        raise PeriluneError(
            "the scenario is too long",
            got=f"{len(text)} characters, {longest} in a line",
            expected=f"at most {LARGEST_FILE}, and {LONGEST_LINE} in a line",
            advice=_COMPARE,
        )
    refuse_nested(
        text, "scenario", DEEPEST_NESTING, expected="sections with keys, without deeper nesting",
        advice=_COMPARE,
    )  # fmt: skip
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise PeriluneError(
            "the scenario is not valid TOML",
            got=_parse_error(text, str(error)),
            expected='lines such as mass = "300 kg"',
            advice=_COMPARE,
        ) from None
    if not document:
        raise PeriluneError(
            "the scenario is empty",
            expected="sections [body], [vehicle], [orbit]",
            advice="start from the template: perilune new my_lander.toml",
        )
    return document


def _parse_error(text: str, message: str) -> str:
    """Return the parser's message with the line that it names."""
    lines, number = text.splitlines(), re.search(r"at line (\d+)", message)
    line = lines[int(number[1]) - 1].strip() if number and int(number[1]) <= len(lines) else ""
    return f"{message[:200]}: {line[:60]}" if line else message[:200]


def apply_change(document: dict[str, Any], change: str) -> None:
    """Put ``section.key=value`` into the tree.

    Parameters
    ----------
    document
        Tree of sections, which is changed.
    change
        Text of the command line.

    Raises
    ------
    PeriluneError
        If it is not of this form.
    """
    key, equals, value = change.partition("=")
    section, dot, name = key.strip().partition(".")
    if not equals or not dot or not name:
        raise PeriluneError(
            "this is not a change",
            got=repr(change[:60]),
            expected="SECTION.KEY=VALUE",
            advice='for example --set "vehicle.thrust=500 N"',
        )
    table = document.setdefault(section, {})  # a section that there is not is refused later, as one of the file is
    if isinstance(table, dict):  # and so is anything else, with the file's own fault named
        table[name] = value.strip().strip("\"'")


def scenario_toml(document: Mapping[str, Any], changes: Sequence[str]) -> str:
    """Return TOML of a tree of sections, with the changes in a comment.

    Parameters
    ----------
    document
        Tree of sections.
    changes
        Texts of the command line that were applied to it.
    """
    lines = [f"# changed with --set {json.dumps(change, ensure_ascii=False)}" for change in changes]
    for section, table in document.items():
        lines += ["", f"[{section}]"]
        items = table.items() if isinstance(table, dict) else ()
        lines += [f"{name} = {json.dumps(value, ensure_ascii=False, default=str)}" for name, value in items]
    return "\n".join(lines) + "\n"
