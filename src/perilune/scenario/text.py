"""From a file to a tree of sections: limits first, then TOML, then the changes of the command line."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from perilune.words.outcome import PeriluneError

LARGEST_FILE = 64 * 1024  # bytes; a complete scenario takes about one thousand
LONGEST_LINE = 1000  # characters; keeps the time of the TOML parser linear in practice
DEEPEST_NESTING = 4  # brackets; a scenario needs one


def read(path: Path) -> str:
    """Text of a file of bounded size."""
    # A pipe or a device would make reading wait or never end.
    if not path.is_file():
        raise PeriluneError(
            "there is no scenario file here" if not path.exists() else "this is not a file",
            got=str(path),
            expected="a TOML file",
            advice=f"perilune new {path.name if path.suffix == '.toml' else 'my_lander.toml'}",
        )
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise PeriluneError(
            "the scenario file cannot be read",
            got=f"{path}: {error.strerror}",
            expected="a file you may read",
            advice="look at its rights",
        ) from error
    if len(raw) > LARGEST_FILE:
        raise PeriluneError(
            "the scenario file is too large",
            got=f"more than {LARGEST_FILE} bytes",
            expected="about one thousand bytes",
            advice="compare with `perilune new`",
        )
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise PeriluneError(
            "the scenario file is not text in UTF-8",
            got=f"byte {raw[error.start]:#04x} at {error.start}",
            expected="a TOML file, which is text in UTF-8",
            advice="save it in this encoding, or start from `perilune new`",
        ) from None


def parse(text: str) -> dict[str, Any]:
    """Tree of a text that keeps the limits."""
    longest = max(map(len, text.splitlines()), default=0)
    if len(text) > LARGEST_FILE or longest > LONGEST_LINE:
        raise PeriluneError(
            "the scenario is too long",
            got=f"{len(text)} characters, {longest} in a line",
            expected=f"at most {LARGEST_FILE}, and {LONGEST_LINE} in a line",
            advice="compare with `perilune new`",
        )
    _check_nesting(text)
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise PeriluneError(
            "the scenario is not valid TOML",
            got=str(error)[:200],
            expected='lines such as mass = "300 kg"',
            advice="compare with `perilune new`",
        ) from None
    if not document:
        raise PeriluneError(
            "the scenario is empty",
            expected="sections [body], [vehicle], [orbit]",
            advice="start from the template: perilune new my_lander.toml",
        )
    return document


def _check_nesting(text: str) -> None:
    bare = re.sub(r'"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*', "", text)
    depth = deepest = 0
    for character in re.findall(r"[\[\]{}]", bare):
        depth = depth + 1 if character in "[{" else max(depth - 1, 0)
        deepest = max(deepest, depth)
    if deepest > DEEPEST_NESTING:
        raise PeriluneError(
            "the scenario is nested too deeply",
            got=f"{deepest} brackets inside each other",
            expected="sections with keys, nothing deeper",
            advice="compare with `perilune new`",
        )


def apply(document: dict[str, Any], change: str) -> None:
    """Put ``section.key=value`` into the tree."""
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


def written(document: Mapping[str, Any], changes: Sequence[str]) -> str:
    """TOML of a tree of sections, with the changes in a comment."""
    lines = [f"# changed with --set {json.dumps(change, ensure_ascii=False)}" for change in changes]
    for section, table in document.items():
        lines += ["", f"[{section}]"]
        items = table.items() if isinstance(table, dict) else ()
        lines += [f"{name} = {json.dumps(value, ensure_ascii=False, default=str)}" for name, value in items]
    return "\n".join(lines) + "\n"
