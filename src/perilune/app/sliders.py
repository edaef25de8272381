"""Sliders of the page: the given parameters of a problem, each with its unit and a range."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from perilune import PeriluneError, Problem, preflight
from perilune.atlas import Atlas
from perilune.core import Quantity, Vector
from perilune.models import KINDS, key_of
from perilune.problem import is_possible

_WIDE, _TURN = 0.25, math.radians(10.0)  # of a value to either side; of an angle at most
_FURTHER = 12.0  # times as far, where nothing near by can be flown
_LOOKS = 32  # values between one and the end of its range
_HALVINGS = 6  # towards the last value that can be stated
_NATURE = ("body", "atmosphere")  # sections that nobody chooses
_FAR = 1e4  # m: lengths from here on are shown in km


@dataclass(frozen=True, kw_only=True)
class Knob:
    """Parameter that can be moved.

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
    natural
        Whether it is a number of nature, which nobody chooses.
    """

    name: str
    key: str
    unit: str
    size: float
    low: float
    high: float
    value: float
    mapped: bool = False
    natural: bool = False

    def shown(self, value: float) -> str:
        """Format a value [SI] in its display unit."""
        return f"{value / self.size:.6g} {self.unit}".removesuffix(" 1")


def knobs(problem: Problem, atlas: Atlas | None = None) -> tuple[Knob, ...]:
    """Return every given parameter that can be moved, the axes of an atlas first, natural constants last.

    If some are keys of a scenario, the others follow from these, and are left out.

    Parameters
    ----------
    problem
        The problem that is explored.
    atlas
        Its atlas, whose axes give ranges; None for none.
    """
    axes = () if atlas is None else atlas.region.axes
    found = [_knob(problem, axis.name, float(axis.low), float(axis.high), mapped=True) for axis in axes]
    stated = {name for name in problem.given if key_of(name) != name} or set(problem.given)
    for name in stated - {axis.name for axis in axes}:
        reach = _slider_range(problem, name)
        if reach is not None:
            found.append(_knob(problem, name, *reach))
    order = {name: place for place, name in enumerate([*(axis.name for axis in axes), *problem.given])}
    return tuple(sorted(found, key=lambda knob: (not knob.mapped, knob.natural, order[knob.name])))


def _knob(problem: Problem, name: str, low: float, high: float, mapped: bool = False) -> Knob:
    given, key = problem.given.get(name), key_of(name)
    value = 0.5 * (low + high) if given is None else min(max(float(given.value), low), high)
    unit, size = _slider_unit(problem.unit_of(name), max(abs(low), abs(high)))
    natural = key.partition(".")[0] in _NATURE or key.endswith("standard_gravity")
    return Knob(
        name=name, key=key, unit=unit, size=size, low=low, high=high, value=value, mapped=mapped, natural=natural
    )  # fmt: skip


def _slider_range(problem: Problem, name: str) -> tuple[float, float] | None:
    """Return a range around a value within which it can be stated and flown; None if its width is unknown."""
    value, room = float(problem.given[name].value), _half_width_of_range(problem, name)
    if not room:
        return None
    section, _, key = key_of(name).partition(".")
    kind = KINDS.get(problem.name)
    entry = kind.sections[section].keys.get(key) if kind is not None and section in kind.sections else None
    least, most = -math.inf, math.inf
    if entry is not None and isinstance(entry.declared, Quantity):
        least, most = entry.declared.low, entry.declared.high
    low, high = (_slider_end(problem, name, value, min(max(value + way * room, least), most)) for way in (-1, 1))
    return (low, high) if low < high else None


def _half_width_of_range(problem: Problem, name: str) -> float:
    """Return the half-width of a range: by the value's size, else by those of its section, else of its unit."""
    given = problem.given[name]
    if given.value:
        room = _WIDE * abs(given.value)
        return min(room, _TURN) if given.unit == "rad" else room
    if given.unit == "rad":
        return _TURN
    own = key_of(name).partition(".")[0]
    alike = {other: abs(g.value) for other, g in problem.given.items() if g.unit == given.unit}
    sections = {other: key_of(other).partition(".")[0] for other in alike}
    beside = max(size for other, size in alike.items() if sections[other] == own)
    chosen = (size for other, size in alike.items() if not {own, sections[other]} & set(_NATURE))
    return _WIDE * (beside or max(chosen, default=0.0))


def _slider_end(problem: Problem, name: str, value: float, end: float) -> float:
    """Return the end of a range: all values up to it can be stated and, if any there can, be flown."""
    values = np.linspace(value, end, _LOOKS + 1)
    flown = _can_be_flown(problem, name, values)
    if not flown[0]:  # nor is the value itself: as far as something can be flown, if it is not much further
        further = value + _FURTHER * (values - value)
        flown = _can_be_flown(problem, name, further)
        return float(further[-1] if flown.any() and _can_be_stated(problem, name, further[-1]) else values[-1])
    good, bad = value, float(values[-1] if flown.all() else values[np.argmin(flown) - 1])
    if _can_be_stated(problem, name, bad):
        return bad
    for _ in range(_HALVINGS):
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if _can_be_stated(problem, name, middle) else (good, middle)
    return good


def _can_be_flown(problem: Problem, name: str, values: Vector) -> Vector:
    return np.broadcast_to(is_possible(preflight(problem, over={name: values})), values.shape)


def _can_be_stated(problem: Problem, name: str, value: float) -> bool:
    try:
        with np.errstate(all="ignore"):  # a model may find out by its numbers
            problem.with_given(**{name: float(value)})
    except PeriluneError:
        return False
    return True


def _slider_unit(unit: str, most: float) -> tuple[str, float]:
    """Return the display unit, and its size in SI."""
    if unit == "rad":
        return "deg", math.pi / 180
    if unit == "m" and most >= _FAR:
        return "km", 1000.0
    return unit, 1.0
