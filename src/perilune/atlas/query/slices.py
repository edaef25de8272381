"""Slices of an atlas: answers over one or two of its axes, with reasons for points without one.

The points of a slice are answered as any others are (`perilune.atlas.query.batch`), so a slice shows what queries
return.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.query.batch_answers import Answered, Answers
from perilune.atlas.query.query import Atlas
from perilune.atlas.query.reader import SERVING
from perilune.atlas.region import Axis
from perilune.atlas.store.cells import WHOLE
from perilune.core import (
    Matrix,
    PeriluneError,
    RenamedAttribute,
    Vector,
    check_call,
    format_value_range,
    parameter_name,
    require_type,
    unknown_name,
)
from perilune.models import key_of
from perilune.problem import Problem, preflight

POINTS = 101  # along each axis
_MOST = 2000
_WHY = {
    Answered.NOT_BUILT: "not built yet, or damaged",
    Answered.NONE: "no sheet has an answer here",
    Answered.ENDS: "a sheet that might be better ends here",
}


@dataclass(frozen=True, kw_only=True, repr=False)
class Slice:
    """Answers over one or two axes, the others held.

    Attributes
    ----------
    problem
        The problem that is mapped.
    axes, at
        Names of its axes, and values of the others [SI].
    values
        Values of the axes at its points [SI], an array for each axis.
    answers
        Answers at all points, the last axis changing fastest.
    sheets
        Labels of all sheets, as `answers.sheet` counts them.
    reason_index
        Number of the reason of each point without an answer, -1 for others, (points,).
    reasons
        Texts of the reasons.
    size
        Of the cell from which each answer was read: length along each of the axes as a share of the region, NaN
        where there is none, (points, axes).
    nodes
        Values of the axes at the corners of these cells [SI], (nodes, axes).
    """

    problem: Problem
    axes: tuple[Axis, ...]
    at: Mapping[str, float]
    values: tuple[Vector, ...]
    answers: Answers
    sheets: tuple[str, ...]
    reason_index: NDArray[np.int64]
    reasons: tuple[str, ...]
    size: Matrix
    nodes: Matrix
    why: ClassVar[RenamedAttribute] = RenamedAttribute("reason_index")

    def __repr__(self) -> str:
        along = ", ".join(axis.extent for axis in self.axes)
        good, cost = self.answers.good, format_value_range(self.answers.objective, self.problem.objective_unit)
        points = f"{np.count_nonzero(good)} of {len(good)} points"
        return f"<Slice of {self.problem.name}, {along}: {points}; J {cost or 'nowhere'}>"

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape of an array over its points."""
        return tuple(len(values) for values in self.values)

    @property
    def counts(self) -> dict[str, int]:
        """Return the number of points answered by each sheet, and of those refused for each reason."""
        found = Counter[str]()
        for number, label in enumerate(self.sheets):  # two of them may be called alike
            found[label] += int((self.answers.sheet == number).sum())
        for number, text in enumerate(self.reasons):
            found[text] += int((self.reason_index == number).sum())
        return {text: count for text, count in found.items() if count}


@check_call
def sliced(
    atlas: Atlas, axes: Sequence[str] = (), at: Mapping[str, float] | None = None, *, points: int = POINTS
) -> Slice:
    """Query an atlas over one or two of its axes.

    Parameters
    ----------
    atlas
        Which.
    axes
        Names of one or two; by default the first two of those that `at` does not name.
    at
        Values of the others [SI]; by default in the middle of their ranges.
    points
        How many along each axis, 2 to 2000.

    Raises
    ------
    PeriluneError
        If a name is no axis, a value lies outside of its range, or the points are too few or too many.
    """
    require_type(atlas, Atlas, "an atlas", "atlas.open(DIRECTORY)")
    region = atlas.region
    held = _held_axis_values(atlas, at or {})
    names = [parameter_name(name) for name in axes] or [name for name in region.names if name not in held][:2]
    for name in names:
        if name not in region.names:
            raise unknown_name("axis", name, [axis.key for axis in region.axes])
        if name in held or names.count(name) > 1:
            raise PeriluneError(
                f"{key_of(name)} is given twice", expected="each axis either along the slice or at one value"
            )
    if len(names) not in (1, 2):
        raise PeriluneError("a slice goes along one axis or two", got=str(len(names)), expected="1 or 2 names")
    if isinstance(points, bool) or not isinstance(points, int) or not 2 <= points <= _MOST:
        raise PeriluneError("a slice has too few points, or too many", got=str(points)[:40], expected=f"2 to {_MOST}")
    along = tuple(next(axis for axis in region.axes if axis.name == name) for name in names)
    others = {axis.name: held.get(axis.name, 0.5 * (axis.low + axis.high)) for axis in region.axes}
    others = {name: value for name, value in others.items() if name not in names}
    values = tuple(np.linspace(axis.low, axis.high, points) for axis in along)
    grid = {name: rows.ravel() for name, rows in zip(names, np.meshgrid(*values, indexing="ij"), strict=True)}
    whole = np.column_stack([grid.get(name, np.full(points ** len(names), others.get(name))) for name in region.names])
    answers = atlas.query_many(whole)
    why, reasons = _refusal_reasons(atlas.problem, dict(zip(region.names, whole.T, strict=True)), answers)
    size, nodes = _answering_cells(atlas, whole, answers, [region.names.index(name) for name in names])
    sheets = tuple(charted.labels[n] for charted in atlas.charted for n in range(len(charted.sheets)))
    return Slice(
        problem=atlas.problem, axes=along, at=others, values=values, answers=answers, sheets=sheets, reason_index=why,
        reasons=reasons, size=size, nodes=nodes,
    )  # fmt: skip


def _held_axis_values(atlas: Atlas, at: Mapping[str, float]) -> dict[str, float]:
    """Return the checked values of axes that are held."""
    held, region = dict[str, float](), atlas.region
    for stated, value in at.items():
        name = parameter_name(stated)
        if name not in region.names:
            raise unknown_name("axis", stated, [axis.key for axis in region.axes])
        if name in held:
            raise PeriluneError("an axis is given twice", got=f"{key_of(name)} = {held[name]} and {value!s:.40}")
        try:
            held[name] = float(value)
        except (TypeError, ValueError, OverflowError):
            raise PeriluneError("values of the axes as numbers in SI", got=str(value)[:80]) from None
    middle = [held.get(axis.name, 0.5 * (axis.low + axis.high)) for axis in region.axes]
    if (outside := region.outside(middle)) is not None:
        raise PeriluneError("the slice lies outside of the atlas", got=outside)
    return held


def _refusal_reasons(
    problem: Problem, over: Mapping[str, Vector], answers: Answers
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the number of each point's reason, and the reasons; a refusal by physics is the comparison's."""
    texts, of_status = list[str](), np.zeros(len(answers.answered), dtype=np.int64)
    why = np.full(len(answers.answered), -1)
    for status, text in _WHY.items():
        of_status[answers.answered == status] = len(texts)
        texts.append(text)
    why[~answers.good] = of_status[~answers.good]
    decided = answers.good.copy()
    for finding in preflight(problem, over):
        missed = np.broadcast_to(~np.asarray(finding.passed), decided.shape) & ~decided
        if finding.binding and missed.any():
            why[missed], decided = len(texts), decided | missed
            texts.append(finding.meaning)
    met = [number for number in range(len(texts)) if (why == number).any()]
    numbers = np.full(len(texts) + 1, -1)  # the last stands for -1
    numbers[met] = range(len(met))
    return numbers[why], tuple(texts[number] for number in met)


def _answering_cells(atlas: Atlas, points: Matrix, answers: Answers, along: list[int]) -> tuple[Matrix, Matrix]:
    """Return the size of the cells of answers along some axes, as shares of the region, and the nodes at corners."""
    region, first = atlas.region, 0
    size, nodes = np.full((len(points), len(along)), np.nan), [np.empty((0, len(along)))]
    places, whole = region.bricks_of(points), (region.high - region.low) * WHOLE
    for number, charted in enumerate(atlas.charted):
        for place in np.unique(places, axis=0).tolist():
            brick = atlas.brick(number, tuple(place))
            if brick is None:
                continue
            low, high = region.box(tuple(place))
            here = (places == place).all(axis=1)
            for sheet, root in brick.minima:
                lanes = np.nonzero(here & (answers.sheet == first + sheet))[0]
                cells = brick.cells[brick.leaves(root, (points[lanes] - low) / (high - low) * WHOLE)]
                serving = np.isin(cells["status"], SERVING)  # of its branches that which answers
                lanes, cells = lanes[serving], cells[serving]
                size[lanes] = (cells["size"] * (high - low) / whole)[:, along]
                nodes.append(brick.nodes["values"][np.unique(cells["corners"])][:, along])
        first += len(charted.sheets)
    return size, np.unique(np.concatenate(nodes), axis=0)
