"""Where a sheet goes on from one brick into another that did not know of it there.

A brick begins with what the survey found at its corners. A sheet that enters it through a side alone is known to its
neighbour: the nodes which that has on their common side, where this one has nothing, are what it goes on from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.brick import ENDING, WHOLE, Status

Rows = Any  # an array with columns
Key = tuple[int, ...]  # chart and numbers of a brick
Shards = tuple[Rows, Rows]  # nodes and cells

_COARSER = 4  # of the lattice over 4 axes, along a side of which there are three more


def spilled(
    keys: Sequence[Key], shards: Callable[[Key], Shards | None], minima: Callable[[int], list[int]]
) -> Iterator[tuple[Key, Rows]]:
    """Nodes on the sides of bricks that go on into them, with their places as these have them.

    Parameters
    ----------
    keys
        Bricks that there may be.
    shards
        Nodes and cells of those that there are.
    minima
        The sheets of a chart that can be answers.
    """
    sides: dict[tuple[Key, int, int], Rows] = {}
    for key in keys:
        if (known := shards(key)) is None:
            continue
        nodes = known[0]
        # Beyond its border a sheet may turn back, and come to the same place with other extremals.
        can = np.isin(nodes["sheet"], minima(key[0])) & (nodes["margin"] >= 0)
        for axis in range(len(key) - 1):
            for side, way in ((WHOLE, 1), (0, -1)):
                here = can & (nodes["place"][:, axis] == side)
                if here.any():
                    sides[key, axis, way] = _coarse(np.array(nodes[here]))
    for key in keys:
        found = list[Rows]()
        for axis in range(len(key) - 1):
            for way in (1, -1):
                beside = (*key[: axis + 1], key[axis + 1] - way, *key[axis + 2 :])
                if (nodes := sides.get((beside, axis, way))) is not None:
                    moved = nodes.copy()
                    moved["place"][:, axis] = 0 if way == 1 else WHOLE
                    found.append(moved)
        if not found:
            continue
        every: Rows = np.concatenate(found)
        every = every[_news(every, shards(key))]
        if len(every):
            _, once = np.unique(np.column_stack([every["sheet"], every["place"]]), axis=0, return_index=True)
            yield key, every[once]


def _coarse(nodes: Rows) -> Rows:
    """Those of the nodes of a side that lie on the lattice of the least cells in which a sheet may end; else all."""
    step = ENDING * (_COARSER if nodes["place"].shape[1] > 3 else 1)
    chosen = nodes[(nodes["place"] % step == 0).all(axis=1)]
    return chosen if len(chosen) else nodes


def _news(nodes: Rows, known: Shards | None) -> NDArray[np.bool_]:
    """Which nodes lie where a brick has nothing of their sheet."""
    if known is None:
        return np.ones(len(nodes), dtype=bool)
    cells = known[1]
    news = ~np.isin(nodes["sheet"], cells["sheet"])
    for cell in cells[cells["status"] == Status.ABSENT]:
        low, high = cell["low"], cell["low"] + cell["size"]
        news |= (nodes["sheet"] == cell["sheet"]) & ((nodes["place"] >= low) & (nodes["place"] <= high)).all(axis=1)
    return news
