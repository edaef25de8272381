"""Seeds from neighbours: nodes from which a branch continues into a block that did not know it there.

A block begins with the survey's extremals at its corners. A sheet that enters it only through a side is known to its
neighbour: the sheet continues from the neighbour's nodes on the common side at which this block has none. So it does
from nodes at which this block has other extremals of the same sheet, as nodes or in its cells: there the sheet has
several branches.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.store.cells import WHOLE, Status, shortest_ending_edge
from perilune.charts import Sheet, same_unknowns

Rows = Any  # an array with columns
Key = tuple[int, ...]  # chart and numbers of a block
Shards = tuple[Rows, Rows]  # nodes and cells

_DIGITS = 5  # behind the point, of what is distinguished on sides
_COARSER = 4  # of the lattice over 4 axes, along a side of which there are three more


def _no_seeds(_: Key, nodes: Rows) -> NDArray[np.bool_]:
    return np.zeros(len(nodes), dtype=bool)


def seeds_for_neighbours(
    keys: Sequence[Key],
    shards: Callable[[Key], Shards | None],
    sheets: Callable[[int], Sequence[Sheet]],
    passed_over: Callable[[Key, Rows], NDArray[np.bool_]] = _no_seeds,
) -> Iterator[tuple[Key, Rows]]:
    """Yield nodes on the sides of blocks that continue into them, with their places in these.

    Parameters
    ----------
    keys
        Blocks that there may be.
    shards
        Nodes and cells of those that there are.
    sheets
        Those of a chart.
    passed_over
        Of nodes on the sides of a block that there is which lie in cells of their sheets that do not give them.
    """
    sides: dict[tuple[Key, int, int], Rows] = {}
    for key in keys:
        if (known := shards(key)) is None:
            continue
        nodes = known[0]
        # Beyond its border a sheet may turn back, and come to the same place with other extremals.
        minimum = np.array([sheet.minimum for sheet in sheets(key[0])])
        can = minimum[nodes["sheet"]] & (nodes["margin"] >= 0)
        for axis in range(len(key) - 1):
            for side, way in ((WHOLE, 1), (0, -1)):
                here = can & (nodes["place"][:, axis] == side)
                if here.any():
                    sides[key, axis, way] = _nodes_on_coarse_lattice(np.array(nodes[here]))
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
        news, had = _unknown_to_brick(every, shards(key), sheets(key[0]))
        if (others := np.nonzero(~news & ~had)[0]).size:
            news[others] = passed_over(key, every[others])
        every = every[news]
        if len(every):
            yield key, every[np.sort(np.unique(_node_keys(every), axis=0, return_index=True)[1])]


def _nodes_on_coarse_lattice(nodes: Rows) -> Rows:
    """Return the nodes of a side on the lattice of the smallest cells in which a sheet may end; all if none are."""
    d = nodes["place"].shape[1]
    step = shortest_ending_edge(d) * (_COARSER if d > 3 else 1)
    chosen = nodes[(nodes["place"] % step == 0).all(axis=1)]
    return chosen if len(chosen) else nodes


def _node_keys(nodes: Rows) -> NDArray[Any]:
    """Return rows that are equal for equal nodes: sheet, place, and rounded unknowns and J."""
    return np.column_stack([nodes["sheet"], nodes["place"], nodes["terms"][:, 0].round(_DIGITS)])


def _unknown_to_brick(
    nodes: Rows, known: Shards | None, sheets: Sequence[Sheet]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of nodes where a block lacks their sheet or has only others of it, and of nodes that it has."""
    had = np.zeros(len(nodes), dtype=bool)
    if known is None:
        return ~had, had
    own, cells = known
    news = ~np.isin(nodes["sheet"], cells["sheet"])
    for cell in cells[(cells["status"] == Status.ABSENT) & (cells["corners"] < 0).all(axis=1)]:
        if cell["branch"] == cell["sheet"]:  # a later branch has but part of the block
            low, high = cell["low"], cell["low"] + cell["size"]
            news |= (nodes["sheet"] == cell["sheet"]) & ((nodes["place"] >= low) & (nodes["place"] <= high)).all(axis=1)
    alike = [next(i for i, other in enumerate(sheets) if other.alike(sheet)) for sheet in sheets]
    at = dict[tuple[int, ...], list[int]]()
    for row in np.nonzero(((own["place"] == 0) | (own["place"] == WHOLE)).any(axis=1))[0].tolist():
        at.setdefault((alike[int(own["sheet"][row])], *own["place"][row].tolist()), []).append(row)
    for i, node in enumerate(nodes):
        there = own[at.get((alike[int(node["sheet"])], *node["place"].tolist()), [])]
        had[i] = same_unknowns(node["terms"][0, :-1], there["terms"][:, 0, :-1]).any()
        news[i] = not had[i] and (news[i] or (there["sheet"] == node["sheet"]).any())
    return news, had
