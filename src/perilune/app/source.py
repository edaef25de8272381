"""Subject of the explorer: a scenario, a saved solution, an atlas, or the landing of the template."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from perilune import PeriluneError, Problem, Solution
from perilune.app.sliders import Knob, knobs
from perilune.atlas import HEADER, Atlas, open as open_atlas
from perilune.core import parse_quantity
from perilune.io import SOLUTION_FILE, claims_of, load_with_tree
from perilune.scenario import apply_change, load_file, load_text, parse, scenario_toml, template


@dataclass(frozen=True, kw_only=True)
class Subject:
    """Problem to explore, with an atlas, a flight and a scenario of it where there are such.

    Parameters
    ----------
    problem, atlas
        The problem, and where it is mapped, if it is.
    known
        A flight of it, to begin with; None where there is none.
    text
        Of the scenario; "" where none says all of it.
    unwritten
        Why there is none.
    knobs
        What can be moved.
    """

    problem: Problem
    knobs: tuple[Knob, ...]
    atlas: Atlas | None = None
    known: Solution | None = None
    text: str = ""
    unwritten: str = "the problem was stated in Python"

    @property
    def title(self) -> str:
        """Return the title of the page."""
        return self.problem.title or self.problem.name

    def scenario(self, values: Mapping[str, float]) -> str:
        """Return the scenario with values of the knobs [SI] in it.

        Raises
        ------
        PeriluneError
            If there is no scenario.
        """
        if not self.text:
            raise PeriluneError("there is no scenario to download", got=self.unwritten)
        moved = {knob: values[knob.name] for knob in self.knobs if values.get(knob.name, knob.value) != knob.value}
        document = parse(self.text)
        if "name" in document.get("body", {}) and any(knob.key.startswith("body.") for knob in moved):
            del document["body"]  # a known body has the quantities it has: with another it is stated by all of them
            moved = {knob: knob.value for knob in self.knobs if knob.key.startswith("body.")} | moved
        changes = [
            f"{knob.key}={exact_quantity_text(value, knob.unit, self.problem.unit_of(knob.name))}"
            for knob, value in moved.items()
        ]
        for change in changes:
            apply_change(document, change)
        return scenario_toml(document, changes) if changes else self.text


def exact_quantity_text(value: float, shown: str, unit: str) -> str:
    """Format a value in SI in its display unit if that reads back to the last bit; else in SI.

    Parameters
    ----------
    value
        The value [SI].
    shown
        Display unit; "1" for none.
    unit
        SI unit of the value.
    """
    near = value / parse_quantity("1" if shown == "1" else f"1 {shown}", unit)
    below, above = math.nextafter(near, -math.inf), math.nextafter(near, math.inf)
    for number in (near, below, above, math.nextafter(below, -math.inf), math.nextafter(above, math.inf)):
        text = f"{repr(number).removesuffix('.0')} {shown}".removesuffix(" 1")
        if parse_quantity(text, unit) == value:
            return text
    return f"{value!r} {unit}".removesuffix(" 1")


def subject_of(target: Path | None, changes: Sequence[str] = ()) -> Subject:
    """Return the subject that a path leads to.

    Parameters
    ----------
    target
        A scenario, a directory that `perilune solve --out` or `perilune atlas build --out` made; None for the template.
    changes
        ``section.key=value`` for a scenario.

    Raises
    ------
    PeriluneError
        If it is none of these.
    """
    if target is not None and target.name in (HEADER, SOLUTION_FILE):
        target = target.parent  # the file by which its directory is known
    if target is not None and not any(map(Path.is_file, (target, target / HEADER, target / SOLUTION_FILE))):
        expected = "a scenario, or a directory of `perilune solve --out` or `perilune atlas build --out`"
        raise PeriluneError("there is nothing to explore here", got=str(target), expected=expected)
    if target is None or target.is_file():
        if target is None:
            text = template("hybrid_landing")
            return _subject_of_scenario(load_text(text), text)
        scenario = load_file(target, changes)
        unwritten = "" if scenario.text else "the scenario refers to another file"
        return _subject_of_scenario(scenario.problem, scenario.text or "", unwritten=unwritten)
    if changes:
        raise PeriluneError("--set changes a scenario", got=str(target), expected="a file")
    if (target / HEADER).is_file():
        atlas = open_atlas(target)
        unwritten = "an atlas stores the problem, not the scenario that stated it"
        return Subject(problem=atlas.problem, atlas=atlas, knobs=knobs(atlas.problem, atlas), unwritten=unwritten)
    solution, document = load_with_tree(target)
    text, _ = claims_of(document)
    return _subject_of_scenario(
        solution.problem, text, known=solution, unwritten="the solution was saved without a scenario"
    )


def _subject_of_scenario(problem: Problem, text: str, known: Solution | None = None, unwritten: str = "") -> Subject:
    """Return the subject of a scenario, whose sections decide what can be moved; everything movable without one."""
    sections = parse(text) if text else {}
    movable = [knob for knob in knobs(problem) if not sections or knob.key.partition(".")[0] in sections]
    # A section more would state another problem.
    return Subject(problem=problem, text=text, known=known, knobs=tuple(movable), unwritten=unwritten)
