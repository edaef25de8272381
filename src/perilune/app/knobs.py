"""What can be dragged: the given parameters of a problem, each with its unit and a range."""

from __future__ import annotations

import math
from dataclasses import dataclass

from perilune.atlas.query import Atlas
from perilune.models.kinds import key_of
from perilune.problem.problem import Problem

_WIDE, _TURN = 0.25, math.radians(10.0)  # of a value to either side; of an angle that is 0
_FAR = 1e4  # m: lengths from here on are shown in km


@dataclass(frozen=True, kw_only=True)
class Knob:
    """One parameter that can be moved.

    Parameters
    ----------
    name, key
        Of the parameter, and as a scenario states it; the name where no scenario does.
    unit, size
        Unit in which it is shown, and that unit in SI.
    low, high, value
        Range and first value [SI].
    mapped
        Whether it is an axis of the atlas.
    """

    name: str
    key: str
    unit: str
    size: float
    low: float
    high: float
    value: float
    mapped: bool = False


def knobs(problem: Problem, atlas: Atlas | None = None) -> tuple[Knob, ...]:
    """Every given parameter that can be moved, the axes of an atlas first, and the body, which nobody chooses, last.

    Where some are keys of a scenario, the others follow from these, and are left out.
    """
    axes = () if atlas is None else atlas.region.axes
    found = [_knob(problem, axis.name, float(axis.low), float(axis.high), mapped=True) for axis in axes]
    stated = {name for name in problem.given if key_of(name) != name} or set(problem.given)
    for name in stated - {axis.name for axis in axes}:
        given = problem.given[name]
        reach = _reach(float(given.value), given.unit)
        if reach is not None:
            found.append(_knob(problem, name, *reach))
    order = {name: place for place, name in enumerate([*(axis.name for axis in axes), *problem.given])}
    return tuple(sorted(found, key=lambda knob: (not knob.mapped, knob.key.startswith("body."), order[knob.name])))


def _knob(problem: Problem, name: str, low: float, high: float, mapped: bool = False) -> Knob:
    given = problem.given.get(name)
    value = 0.5 * (low + high) if given is None else min(max(float(given.value), low), high)
    unit, size = _shown(problem.unit_of(name), max(abs(low), abs(high)))
    return Knob(name=name, key=key_of(name), unit=unit, size=size, low=low, high=high, value=value, mapped=mapped)


def _reach(value: float, unit: str) -> tuple[float, float] | None:
    """A range around a value; None where it says nothing of its size."""
    if value:
        return min(value * (1 - _WIDE), value * (1 + _WIDE)), max(value * (1 - _WIDE), value * (1 + _WIDE))
    return (-_TURN, _TURN) if unit == "rad" else None


def _shown(unit: str, most: float) -> tuple[str, float]:
    """The unit in which a designer reads it, and its size in SI."""
    if unit == "rad":
        return "deg", math.pi / 180
    if unit == "m" and most >= _FAR:
        return "km", 1000.0
    return unit, 1.0
