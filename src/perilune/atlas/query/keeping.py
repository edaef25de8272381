"""Active-set correction of an extremal that violates bounds, or gains by leaving one.

It is held at the bounds that it is beyond and released from those that it gains by leaving, and Newton's method goes on
from there, until neither is left. Its J shows if a known answer is the same, or better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perilune.charts import MOST, SLACK, Borders, Chart, Sheet
from perilune.core import Matrix, Vector
from perilune.problem import Nature

_TURNS = 8  # times that bounds are taken and let go


@dataclass(frozen=True)
class CorrectedExtremals:
    """Corrected extremals: number of the branch, -1 where none is found, unknowns and J, canonical, (lanes,) each."""

    sheet: NDArray[np.int64]
    y: Matrix
    cost: Vector


def correct_active_set(
    chart: Chart, borders: Borders, sheets: Sequence[Sheet], first: Sheet, values: Matrix, y: Matrix
) -> CorrectedExtremals:
    """Correct the active set of bounds of extremals, or of guesses, until no bound is crossed; known maxima excluded.

    Parameters
    ----------
    chart, borders, sheets
        Of the extremals.
    first
        The bounds that are active at the start.
    values, y
        Of the parameters, (lanes, d), and the unknowns there, (lanes, n).
    """
    cost, y, going = np.full(len(y), np.nan), y.copy(), np.arange(len(y))
    own, which, number = [first], np.zeros(len(y), dtype=np.int64), np.full(len(y), -1)
    for _ in range(_TURNS):
        if not len(going):
            break
        holds = borders.holds(own, which[going], values[going])
        found = chart.solve(values[going], y[going], holds, limit=MOST)
        y[going] = found.y
        crossed = borders.crossed(own, which[going], found)
        done = found.converged & ~crossed.any(axis=1)
        done &= borders.margins_of(own, which[going], found) >= -SLACK
        for k in np.nonzero(done)[0].tolist():
            alike = Sheet(holds=own[which[going[k]]].holds, orientation=found.orientation[k], nature=Nature.UNPROVED)
            if (its := next((i for i, s in enumerate(sheets) if s.minimum and s.alike(alike)), None)) is not None:
                cost[going[k]], number[going[k]] = found.cost[k], its
        on = np.nonzero(found.converged & crossed.any(axis=1))[0]
        turns, turn = np.unique(np.column_stack([which[going[on]], crossed[on]]), axis=0, return_inverse=True)
        which[going[on]] = len(own) + turn.reshape(-1)
        own += [
            _exchange_held_bounds(own[row[0]], [borders.bounds[i] for i in np.nonzero(row[1:])[0]]) for row in turns
        ]
        going = going[on]
    return CorrectedExtremals(number, y, cost)


def _exchange_held_bounds(sheet: Sheet, crossed: Sequence[tuple[str, str]]) -> Sheet:
    """Return a branch that also holds the bounds that were crossed, and lets go of crossed ones that it held."""
    held = set(sheet.holds.items())
    more = {name: side for name, side in crossed if (name, side) not in held}
    left = {name: side for name, side in sheet.holds.items() if (name, side) not in crossed}
    return Sheet(holds=left | more, orientation=0.0, nature=Nature.UNPROVED)
