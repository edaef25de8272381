"""A scenario file: TOML in, a `Problem` out; it may come from a stranger, so it is checked before it is used.

Size, nesting and lengths are limited before anything is parsed; every quantity is a text with a whitelisted
unit; every refusal names the key as the user writes it (``vehicle.specific_impulse``). Beside what is wrong,
what *looks* wrong is refused too, with the slip it looks like: an exhaust velocity for a specific impulse, km
for m, degrees for radians.

A landing from orbit has these sections (``problem.kind = "hybrid_landing"``, which need not be stated):

    [body]      name, or gravitational_parameter, radius and rotation_rate
    [vehicle]   mass, thrust, specific_impulse; standard_gravity, dry_mass may be given
    [retro]     specific_impulse; delta_v fixes the burn; without the section the landing is an ordinary one
    [orbit]     parking_altitude, perilune_altitude
    [landing]   altitude (0 m unless given)

A descent in three dimensions has [body], which may have j2, and [vehicle], and for ``kind = "powered_descent"``

    [problem]   kind; coordinates, target, minimise as of `perilune.models.descent.powered_descent`
    [start]     altitude, longitude, latitude, heading, forward_speed; sideways_speed, vertical_speed
    [site]      altitude, longitude, latitude
    [steering]  elevation_lower, elevation_upper, azimuth_lower, azimuth_upper; may be left out
    [throttle]  lower, upper: shares of full thrust; without the section thrust is constant

or for ``kind = "precision_landing"`` [problem], [site], [throttle] and

    [approach]  east, north, up from the site; east_speed, north_speed, up_speed
    [corridor]  tilt, slope; pad_radius
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from perilune.problem.problem import Problem
from perilune.scenario.build import problem_of
from perilune.scenario.schema import checked, quantity_of, values_of
from perilune.scenario.text import apply, parse, read, written

__all__ = ["Scenario", "load_file", "load_text", "quantity_of", "template", "values_of"]


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A problem and the text it was made of, with every change made to it."""

    text: str
    problem: Problem


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
    InfeasibleError
        If the orbit it states is impossible.
    """
    text = read(Path(path))
    document = parse(text)
    if changes:
        for change in changes:
            apply(document, change)
        text = written(document, changes)
    return Scenario(text=text, problem=_problem(document))


def load_text(text: str) -> Problem:
    """The problem of a scenario's text; errors as `load_file`."""
    return _problem(parse(text))


def template() -> str:
    """A commented scenario to start from."""
    return resources.files("perilune.scenario").joinpath("template.toml").read_text(encoding="utf-8")


def _problem(document: Mapping[str, Any]) -> Problem:
    return problem_of(checked(document))
