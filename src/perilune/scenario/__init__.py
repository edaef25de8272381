"""Scenario files: TOML in, a `Problem` out; they may come from a stranger, and are checked before use.

Size, nesting and lengths are limited before anything is parsed; every quantity is a text with a whitelisted
unit; every refusal names the key as the user writes it (``vehicle.specific_impulse``). Beside what is wrong,
what *looks* wrong is refused too, with the slip it looks like: an exhaust velocity for a specific impulse, km
for m, degrees for radians.

Which sections and keys there are follows from the kinds of problems and their records, `perilune.models.catalogue`; the
page docs/reference.md lists them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from perilune.core import Quantity, check_call, public_names, require_path, require_type
from perilune.models import KINDS, kind_names
from perilune.problem import Problem, Tolerance
from perilune.scenario.ranges import bounds_of, values_of
from perilune.scenario.reader import names_files, problem_of, quantities_in, tolerance_of
from perilune.scenario.reference import template
from perilune.scenario.text import apply_change, parse, read_scenario_file, scenario_toml

__all__ = [
    "KINDS",
    "Scenario",
    "bounds_of",
    "kind_names",
    "load_file",
    "load_text",
    "quantities_of",
    "template",
    "values_of",
]


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Problem, the tolerance stated for its proof, and the text they were made of, with every change made to it.

    The text is None if it names another file, and so does not state all of the problem.
    """

    text: str | None = field(repr=False)
    problem: Problem
    tolerance: Tolerance


@check_call
def load_file(path: str | Path, changes: Sequence[str] = ()) -> Scenario:
    """Read a scenario file.

    Parameters
    ----------
    path
        The TOML file.
    changes
        ``"section.key=value"`` each; checked like the file itself.

    Raises
    ------
    PeriluneError
        If the file cannot be read, is no scenario, or a value is wrong or looks wrong.
    """
    text, document = _changed_document(path, changes)
    problem = problem_of(document, Path(path).parent)
    whole = scenario_toml(document, changes) if changes else text
    return Scenario(
        text=None if names_files(document) else whole,
        problem=problem,
        tolerance=tolerance_of(document),
    )


@check_call
def quantities_of(path: str | Path, changes: Sequence[str] = ()) -> dict[str, Quantity]:
    """Return the declaration of each key that is a quantity in a file of this kind, which may be incomplete.

    Parameters
    ----------
    path
        The TOML file.
    changes
        ``"section.key=value"`` texts that replace values of the file.
    """
    return quantities_in(_changed_document(path, changes)[1])


def _changed_document(path: str | Path, changes: Sequence[str]) -> tuple[str, dict[str, Any]]:
    text = read_scenario_file(require_path(path, "a scenario file"))
    require_type(changes, Sequence, "a list of changes", '["vehicle.thrust=500 N"]')
    document = parse(text)
    for change in [changes] if isinstance(changes, str) else changes:
        apply_change(document, change)
    return text, document


@check_call
def load_text(text: str) -> Problem:
    """Return the problem of a scenario's text; errors as `load_file`."""
    require_type(text, str, "the text of a scenario", "perilune.scenario.load_file(FILE) reads a file")
    return problem_of(parse(text))


def __dir__() -> list[str]:
    return public_names(__all__)
