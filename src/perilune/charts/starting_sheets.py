"""Sheets with which a search around one known extremal begins: its own, and those that hold one bound more or less."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from perilune.charts.borders import Borders, held_at
from perilune.charts.chart import Chart, Holds
from perilune.charts.continuation import Lanes, StraightContinuation
from perilune.charts.lattice import LatticeNodes
from perilune.charts.sheet import Sheet
from perilune.core import Matrix, Vector
from perilune.problem import Nature

_LANE = np.zeros(1, dtype=np.int64)  # number of the sheet of a single lane


@dataclass(frozen=True, kw_only=True)
class StartingSheet:
    """Sheet with its extremal at the values of the known one: as a node, and all unknowns, (1, size)."""

    sheet: Sheet
    node: LatticeNodes
    whole: Matrix


def starting_sheets(chart: Chart, start: Vector, y: Vector) -> Iterator[StartingSheet]:
    """Yield the sheet of an extremal, then those that hold one of the user's bounds more or less.

    None are yielded where Newton's method does not find the extremal again.

    Parameters
    ----------
    chart
        Chart of the extremal.
    start, y
        Values of the parameters, (d,), and its unknowns there, (n,), canonical.
    """
    borders = Borders(chart)
    first = _extremal_at(borders, start, y, held_at(borders, start, y))
    if first is None:
        return
    yield first
    held, names = first.sheet.holds, borders.names
    for name in held:
        less = {n: s for n, s in held.items() if n != name}
        if (one := _extremal_at(borders, start, y, less)) is not None:
            yield one
    limits = [bound[0] for bound in borders.at(start[None])]
    for name, side in borders.bounds:
        number = names.index(name)
        if borders.users[number] and name not in held and name not in chart.names:
            led = _led_to_bound(borders, start, first, number, float(limits[side == "upper"][number]))
            if (one := _extremal_at(borders, start, led, {**held, name: side})) is not None:
                yield one


def _extremal_at(borders: Borders, start: Vector, y: Vector, holds: Mapping[str, str]) -> StartingSheet | None:
    """Return the extremal with these bounds held that Newton's method reaches from unknowns; None for none."""
    sheet = Sheet(holds=holds, orientation=1.0, nature=Nature.UNPROVED)
    found = borders.chart.solve(start[None], y[None], borders.holds([sheet], _LANE, start[None]))
    if not found.converged[0]:
        return None
    return StartingSheet(
        sheet=Sheet(holds=holds, orientation=float(found.orientation[0]), nature=Nature.UNPROVED),
        node=LatticeNodes(start[None], found.y, found.slopes, found.cost, found.cost_slopes),
        whole=found.roots.y,
    )


def _led_to_bound(borders: Borders, start: Vector, first: StartingSheet, number: int, bound: float) -> Vector:
    """Return unknowns of the first sheet led to where a free parameter, by its number, has the value of its bound."""
    plan, y = borders.chart.shooting.plan, first.node.y
    if number >= plan.free or not np.isfinite(bound):
        return y[0]
    held = borders.holds([first.sheet], _LANE, start[None]).choice[0]

    def holds(_: Lanes, places: Matrix) -> Holds:
        choice = np.tile(held, (len(places), 1))
        choice[:, number], choice[:, plan.held + number] = 1.0, places[:, -1]
        return Holds(choice)

    own = first.whole[0, borders.chart.conditions.free_at][number]
    walk = StraightContinuation(borders.chart, holds, np.append(start, own)[None], y, at=[number])
    walk.go(_LANE, np.append(start, bound)[None])
    return walk.y[0]
