"""Region of an atlas: some parameters between bounds, divided into blocks (bricks)."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.core import (
    Matrix,
    PeriluneError,
    Vector,
    format_quantity,
    format_value_range,
    parameter_name,
    unknown_name,
    wrong_type_error,
)
from perilune.models import key_of
from perilune.problem import Problem

MOST_AXES = 4
_MOST_BRICKS = 10**6
_NARROWEST, _LEAST = 1e-9, 1e-280  # range of an axis, as a share of its values, and SI
_LOOKS = 16  # at points within a region, in addition to its corners, between which a function may go and come back
_PARTS = {1: 8, 2: 4, 3: 2, 4: 2}  # blocks along each of so many axes


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Parameter that varies between two values.

    Parameters
    ----------
    name, unit
        Of the parameter; the unit in SI.
    edges
        Where the blocks along it begin and end [SI], rising.
    first
        Number of the first block: what is added below what was there has numbers below 0.
    """

    name: str
    unit: str
    edges: tuple[float, ...]
    first: int = 0

    @property
    def low(self) -> float:
        """Return the lower end [SI]."""
        return self.edges[0]

    @property
    def high(self) -> float:
        """Return the upper end [SI]."""
        return self.edges[-1]

    @property
    def key(self) -> str:
        """Return the user's name of the axis, such as ``vehicle.thrust``."""
        return key_of(self.name)

    @property
    def extent(self) -> str:
        """Return the range in words: ``vehicle.thrust from 430 N to 450 N``."""
        return f"{self.key} from {format_value_range(self.edges, self.unit)}"

    def format_value(self, value: float) -> str:
        """Format a value of it [SI]."""
        return f"{self.key} {format_quantity(value, self.unit)}"

    @property
    def numbers(self) -> range:
        """Return the numbers of the blocks along it."""
        return range(self.first, self.first + len(self.edges) - 1)

    def edge(self, number: int) -> float:
        """Return the lower end of a block [SI]."""
        return self.edges[number - self.first]


@dataclass(frozen=True)
class Region:
    """Region spanned by its axes.

    Parameters
    ----------
    axes
        At least one, at most `MOST_AXES`.
    """

    axes: tuple[Axis, ...]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the names of the parameters."""
        return tuple(axis.name for axis in self.axes)

    @cached_property
    def low(self) -> Vector:
        """Return lower bounds [SI], (d,)."""
        return np.array([axis.low for axis in self.axes])

    @cached_property
    def high(self) -> Vector:
        """Return upper bounds [SI], (d,)."""
        return np.array([axis.high for axis in self.axes])

    @property
    def ends(self) -> list[dict[str, float]]:
        """Return its own corners, each as values [SI] by name."""
        return [dict(zip(self.names, at, strict=True)) for at in product(*((a.low, a.high) for a in self.axes))]

    @property
    def looks(self) -> list[dict[str, float]]:
        """Return its corners and inner points, at which saved functions are compared with stated ones."""
        within = np.random.default_rng(0).uniform(self.low, self.high, (_LOOKS, len(self.axes))).tolist()
        return [*self.ends, *(dict(zip(self.names, row, strict=True)) for row in within)]

    @property
    def bricks(self) -> list[tuple[int, ...]]:
        """Return the numbers of all blocks, the last axis changing fastest."""
        return list(product(*(axis.numbers for axis in self.axes)))

    def box(self, brick: tuple[int, ...]) -> tuple[Vector, Vector]:
        """Return the low and high corner of a block [SI]; neighbours share them exactly."""
        low, high = (
            np.array([axis.edge(n + side) for axis, n in zip(self.axes, brick, strict=True)]) for side in (0, 1)
        )
        return low, high

    def corners(self) -> tuple[NDArray[np.int64], Matrix]:
        """Return the numbers of the corners of all blocks, (k, d), and their values [SI]."""
        numbers = [range(axis.first, axis.first + len(axis.edges)) for axis in self.axes]
        return np.array(list(product(*numbers))), np.array(list(product(*(axis.edges for axis in self.axes))))

    def brick_of(self, values: Vector) -> tuple[int, ...]:
        """Return the block in which a point [SI] of the region lies."""
        inner = zip(self.axes, values.tolist(), strict=True)
        return tuple(axis.first + bisect_right(axis.edges, value, 1, len(axis.edges) - 1) - 1 for axis, value in inner)

    def bricks_of(self, points: Matrix) -> NDArray[np.int64]:
        """Return the blocks in which points [SI] lie, (points, d); a nearby one for points outside of the region."""
        columns = [
            axis.first + np.searchsorted(axis.edges[1:-1], values, side="right")
            for axis, values in zip(self.axes, points.T, strict=True)
        ]
        return np.column_stack(columns)

    def format_point(self, values: Iterable[float]) -> str:
        """Format a point [SI]."""
        return ", ".join(axis.format_value(value) for axis, value in zip(self.axes, values, strict=True))

    def outside(self, values: Sequence[float]) -> str | None:
        """Describe the first value of a point that lies outside; None for a point of the region."""
        for axis, value in zip(self.axes, values, strict=True):
            if not axis.low <= value <= axis.high:
                near = axis.low if value < axis.low else axis.high
                digits = (
                    6 if format_quantity(value, axis.unit) != format_quantity(near, axis.unit) else 17
                )  # just outside
                said, low, high = (format_quantity(v, axis.unit, digits) for v in (value, axis.low, axis.high))
                return f"{axis.key} {said}, which is mapped from {low} to {high}"
        return None


def region_of(problem: Problem, axes: Mapping[str, Any], bricks: int | None = None) -> Region:
    """Return the region that is asked for.

    Parameters
    ----------
    problem
        Whose parameters vary.
    axes
        ``{name: (low, high)}`` in SI; a dot in a name may stand for an underscore.
    bricks
        How many there are along each axis; of one axis 8, along each of two 4, of more 2, if it is not given.

    Raises
    ------
    PeriluneError
        If a name is no parameter, bounds are none, or there are too many.
    """
    if not isinstance(axes, Mapping) or not axes:
        raise wrong_type_error(axes, "{name: (low, high)} of parameters, in SI", "a valid region of an atlas")
    if len(axes) > MOST_AXES:
        raise PeriluneError(
            "an atlas has too many axes", got=str(len(axes)), expected=f"at most {MOST_AXES}",
            advice="vary fewer parameters, and build an atlas for each value of the others",
        )  # fmt: skip
    if bricks is not None and (isinstance(bricks, bool) or not isinstance(bricks, int) or bricks < 1):
        raise wrong_type_error(bricks, "a whole number from 1, or None", "a valid number of bricks along an axis")
    parts = bricks or _PARTS[len(axes)]
    if parts ** len(axes) > _MOST_BRICKS:
        raise PeriluneError(
            "the region has too many bricks", got=f"{parts} along each of {len(axes)} axes",
            expected=f"at most {_MOST_BRICKS}",
        )  # fmt: skip
    found, known = list[Axis](), sorted({*problem.given, *problem.free_names})
    for stated, bounds in axes.items():
        name = parameter_name(stated) if isinstance(stated, str) else stated
        if name not in known:
            raise unknown_name("parameter", name, known)
        if name in (axis.name for axis in found):
            raise PeriluneError(f"{key_of(name)} is an axis twice", expected="each parameter once")
        try:
            low, high = (float(v) for v in bounds)
        except (TypeError, ValueError, OverflowError):
            raise wrong_type_error(bounds, "(low, high), two numbers in SI", f"the range of {key_of(name)}") from None
        if not (math.isfinite(high - low) and low < high):
            raise PeriluneError(
                f"the range of {key_of(name)} is empty",
                got=f"{format_quantity(low, problem.unit_of(name))} to {format_quantity(high, problem.unit_of(name))}",
                expected="low < high, both finite",
            )  # fmt: skip
        if high - low < max(_NARROWEST * max(abs(low), abs(high)), _LEAST):  # numbers between them would be one
            raise PeriluneError(
                f"the range of {key_of(name)} is too narrow", got=f"{low!r} to {high!r} {problem.unit_of(name)}",
                expected=f"at least {_NARROWEST:g} of its values",
            )  # fmt: skip
        found.append(Axis(name=name, unit=problem.unit_of(name), edges=_equal_parts(low, high, parts)))
    region = Region(tuple(found))
    refuse_untaken(problem, region)
    return region


def refuse_untaken(problem: Problem, region: Region) -> None:
    """Refuse a region with values that the records of a problem refuse.

    Parameters
    ----------
    problem
        Problem that is mapped.
    region
        Region whose corners are tried.

    Raises
    ------
    PeriluneError
        If a record refuses the values at a corner.
    """
    for corner in region.ends:
        problem.with_given(**corner)


def refuse_moving_ranges(problem: Problem, kept: Problem, region: Region) -> None:
    """Refuse ranges of free parameters that move differently in the problem as an atlas saves it.

    An atlas saves formulas and numbers, and models with the values of their records: of a user's function of ranges a
    reader would have the values at one point only.

    Parameters
    ----------
    problem
        Problem that is mapped.
    kept
        The same, as it is read from its file.
    region
        Region at whose points the ranges are compared.

    Raises
    ------
    PeriluneError
        If a range differs somewhere.
    """
    if problem.parameter_bounds is None:
        return
    for at in region.looks:
        values = {n: v for n, v in at.items() if n in problem.given}
        for here, f in zip(kept.with_given(**values).free, problem.with_given(**values).free, strict=True):
            if (here.lower, here.upper) != (f.lower, f.upper):
                raise PeriluneError(
                    f"the range of {key_of(f.name)} depends on the varied parameters by a function that an atlas"
                    f" cannot store",
                    got=f"{format_quantity(f.lower, f.unit)} to {format_quantity(f.upper, f.unit)} where "
                    f"{region.format_point(list(at.values()))}",
                    expected=f"{format_quantity(here.lower, here.unit)} to {format_quantity(here.upper, here.unit)} "
                    f"there, as it is stored",
                    advice="state a range that holds everywhere, and the binding limit as an end condition whose"
                    " limit is a parameter",
                )


def _equal_parts(low: float, high: float, count: int) -> tuple[float, ...]:
    return (*(low + (high - low) * number / count for number in range(count)), high)


def wider(region: Region, axes: Mapping[str, tuple[float, float]]) -> Region:
    """Return the region with more blocks, no wider than the present ones, below and above these.

    Parameters
    ----------
    region
        What there is.
    axes
        ``{name: (low, high)}`` [SI] of the axes that become wider; a dot in a name may stand for an underscore.

    Raises
    ------
    PeriluneError
        If a name is no axis, or a range leaves out some of what is there.
    """
    stated, found = {parameter_name(name): bounds for name, bounds in axes.items()}, list[Axis]()
    for name in stated:
        if name not in region.names:
            raise unknown_name("axis", name, [axis.key for axis in region.axes])
    for axis in region.axes:
        low, high = stated.get(axis.name, (axis.low, axis.high))
        if not (math.isfinite(high - low) and low <= axis.low and high >= axis.high):
            raise PeriluneError(
                f"the range of {axis.key} excludes a part of the mapped region",
                got=f"{format_quantity(low, axis.unit)} to {format_quantity(high, axis.unit)}",
                expected=f"at least {format_quantity(axis.low, axis.unit)} to {format_quantity(axis.high, axis.unit)}",
                advice="choose wider ranges, or build another atlas",
            )
        below = _parts_of(low, axis.low, axis.edges[1] - axis.edges[0])
        above = _parts_of(axis.high, high, axis.edges[-1] - axis.edges[-2])
        edges = (*below[:-1], *axis.edges, *above[1:])
        found.append(replace(axis, edges=edges, first=axis.first - max(0, len(below) - 1)))
    return Region(tuple(found))


def _parts_of(low: float, high: float, most: float) -> tuple[float, ...]:
    """Return the edges of equal parts, none longer than `most`; none for an empty range."""
    return _equal_parts(low, high, math.ceil((high - low) / most - 1e-9)) if high > low else ()


def stated_region(region: Region, edges: Sequence[Mapping[str, Any]]) -> Region:
    """Return a region with the edges that a manifest states for each axis.

    Parameters
    ----------
    region
        Region whose axes keep their names and units.
    edges
        For each axis its edges ``at`` [SI], and the number of the ``first`` block.

    Raises
    ------
    ValueError
        If they are not valid edges.
    """
    found = []
    for axis, said in zip(region.axes, edges, strict=True):
        at = tuple(float(value) for value in said["at"])
        if len(at) < 2 or not all(a < b for a, b in pairwise(at)) or not math.isfinite(at[-1] - at[0]):
            raise ValueError("edges of bricks that do not increase")
        found.append(replace(axis, edges=at, first=int(said["first"])))
    return Region(tuple(found))
