"""What an extremal that lies beyond bounds, or gains by leaving one, becomes where it keeps them.

It is held at what it is beyond, lets go of what it gains by leaving, and Newton's method goes on from there, until
neither is left. Whether an answer that is known is that one, or better than it, is told by its J.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perilune.atlas.chart import Chart
from perilune.atlas.sheets import SLACK, Borders, Sheet
from perilune.atlas.walking import MOST
from perilune.problem.extremal import Nature
from perilune.words.types import Matrix, Vector

_TURNS = 8  # times that bounds are taken and let go


def kept(chart: Chart, borders: Borders, sheets: Sequence[Sheet], number: int, values: Matrix, y: Matrix) -> Vector:
    """J of what extremals become, canonical, (lanes,); NaN where that is not found, or is no minimum that is known of.

    Parameters
    ----------
    chart, borders, sheets, number
        Whose, and the number of the sheet on which the extremals lie.
    values, y
        Of the parameters, (lanes, d), and the unknowns there, (lanes, n).
    """
    cost, y, going = np.full(len(y), np.nan), y.copy(), np.arange(len(y))
    own, which = [sheets[number]], np.zeros(len(y), dtype=np.int64)
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
            if any(sheet.minimum and sheet.alike(alike) for sheet in sheets):
                cost[going[k]] = found.cost[k]
        on = np.nonzero(found.converged & crossed.any(axis=1))[0]
        turns, turn = np.unique(np.column_stack([which[going[on]], crossed[on]]), axis=0, return_inverse=True)
        which[going[on]] = len(own) + turn.reshape(-1)
        own += [_turned(own[row[0]], [borders.bounds[i] for i in np.nonzero(row[1:])[0]]) for row in turns]
        going = going[on]
    return cost


def _turned(sheet: Sheet, crossed: Sequence[tuple[str, str]]) -> Sheet:
    """What holds the bounds that were crossed, without those among them that were held."""
    held = set(sheet.holds.items())
    more = {name: side for name, side in crossed if (name, side) not in held}
    left = {name: side for name, side in sheet.holds.items() if (name, side) not in crossed}
    return Sheet(holds=left | more, orientation=0.0, nature=Nature.UNPROVED)
