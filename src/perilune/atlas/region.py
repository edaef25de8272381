"""The region of an atlas: some parameters between bounds, divided into bricks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.problem.problem import Problem
from perilune.words.asked import refused
from perilune.words.declared import parameter_name
from perilune.words.outcome import PeriluneError, unknown_name
from perilune.words.types import Matrix, Vector

MOST_AXES = 4
_PARTS = {1: 8, 2: 4, 3: 2, 4: 2}  # bricks along each of so many axes


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A parameter that varies between two values [SI]."""

    name: str
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Region:
    """All axes.

    Parameters
    ----------
    axes
        At least one, at most `MOST_AXES`.
    """

    axes: tuple[Axis, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(axis.name for axis in self.axes)

    @property
    def low(self) -> Vector:
        """Lower bounds [SI], (d,)."""
        return np.array([axis.low for axis in self.axes])

    @property
    def high(self) -> Vector:
        """Upper bounds [SI], (d,)."""
        return np.array([axis.high for axis in self.axes])

    @property
    def parts(self) -> int:
        """How many bricks there are along each axis."""
        return _PARTS[len(self.axes)]

    @property
    def bricks(self) -> list[tuple[int, ...]]:
        """Places of all bricks, the last axis changing fastest."""
        return list(product(range(self.parts), repeat=len(self.axes)))

    def box(self, brick: tuple[int, ...]) -> tuple[Vector, Vector]:
        """Corners of a brick [SI]; neighbours have the very same."""
        low = [self._edge(axis, n) for axis, n in zip(self.axes, brick, strict=True)]
        high = [self._edge(axis, n + 1) for axis, n in zip(self.axes, brick, strict=True)]
        return np.array(low), np.array(high)

    def _edge(self, axis: Axis, number: int) -> float:
        if number == self.parts:
            return axis.high
        return axis.low + (axis.high - axis.low) * number / self.parts

    def corners(self) -> tuple[NDArray[np.int64], Matrix]:
        """Places of the corners of all bricks, (k, d), and their values [SI]."""
        places = np.array(list(product(range(self.parts + 1), repeat=len(self.axes))))
        values = np.array([[self._edge(a, n) for a, n in zip(self.axes, row, strict=True)] for row in places.tolist()])
        return places, values

    def brick_of(self, values: Vector) -> tuple[int, ...]:
        """The brick in which a point [SI] of the region lies."""
        share = (values - self.low) / (self.high - self.low) * self.parts
        return tuple(np.clip(share.astype(np.int64), 0, self.parts - 1).tolist())

    def told(self, values: Sequence[float]) -> str:
        """A point [SI] in words."""
        return ", ".join(f"{name} {value:.6g}" for name, value in zip(self.names, values, strict=True))

    def outside(self, values: Sequence[float]) -> str | None:
        """What of a point lies outside, in words; None for a point of the region."""
        for axis, value in zip(self.axes, values, strict=True):
            if not axis.low <= value <= axis.high:
                return f"{axis.name} {value:.6g}, which is mapped from {axis.low:.6g} to {axis.high:.6g} {axis.unit}"
        return None


def region_of(problem: Problem, axes: Mapping[str, Any]) -> Region:
    """The region that is asked for.

    Parameters
    ----------
    problem
        Whose parameters vary.
    axes
        ``{name: (low, high)}`` in SI; a dot in a name may stand for an underscore.

    Raises
    ------
    PeriluneError
        If a name is no parameter, bounds are none, or there are too many.
    """
    if not isinstance(axes, Mapping) or not axes:
        raise refused(axes, "{name: (low, high)} of parameters, in SI", "what an atlas is built over")
    if len(axes) > MOST_AXES:
        raise PeriluneError(
            "an atlas has too many axes", got=str(len(axes)), expected=f"at most {MOST_AXES}",
            advice="vary fewer parameters, and build an atlas for each value of the others",
        )  # fmt: skip
    found, known = list[Axis](), sorted({*problem.given, *problem.free_names})
    for stated, bounds in axes.items():
        name = parameter_name(stated) if isinstance(stated, str) else stated
        if name not in known:
            raise unknown_name("parameter", str(name), known)
        if name in (axis.name for axis in found):
            raise PeriluneError(f"{name} is an axis twice", expected="each parameter once")
        try:
            low, high = (float(v) for v in bounds)
        except (TypeError, ValueError):
            raise refused(bounds, "(low, high), two numbers in SI", f"the range of {name}") from None
        if not (math.isfinite(high - low) and low < high):
            raise PeriluneError(
                f"the range of {name} is empty", got=f"{low:g} to {high:g} {problem.unit_of(name)}",
                expected="low < high, both finite",
            )  # fmt: skip
        found.append(Axis(name=name, low=low, high=high, unit=problem.unit_of(name)))
    region = Region(tuple(found))
    for corner in product(*((axis.low, axis.high) for axis in found)):
        # So that records refuse what they do not take.
        problem.with_given(**dict(zip(region.names, corner, strict=True)))
    return region
