"""Share of its region in which the cells of an atlas answer, judged by the cells only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from perilune.atlas.cells import WHOLE
from perilune.atlas.columns import cell_type, node_type, sheets_of
from perilune.atlas.read import SERVING, AtlasReader
from perilune.atlas.reflight import SLACK
from perilune.atlas.store import AtlasStore
from perilune.words.outcome import NotConvergedError, PeriluneError

LOOKED_AT = 1000  # points of a region


class RegionCoverage(NamedTuple):
    """Shares of a region: where cells answer, and where physics refuses points."""

    answered: float
    impossible: float


def covered_share(atlas: AtlasReader, points: int = LOOKED_AT) -> RegionCoverage:
    """Compute the share of points of a region that lie in a cell of some sheet which answers; the draw is fixed.

    Queries answer only there, and may refuse some of these points: another sheet can cast doubt on their answer.

    Parameters
    ----------
    atlas
        The atlas.
    points
        Number of points to draw.
    """
    region = atlas.region
    drawn = np.random.default_rng(0).uniform(region.low, region.high, (points, len(region.axes)))
    places, good, allowed = region.bricks_of(drawn), np.zeros(points, dtype=bool), atlas.allowed(drawn)
    for place in map(tuple, np.unique(places, axis=0).tolist()):
        lanes, (low, high) = np.nonzero((places == place).all(axis=1))[0], region.box(place)
        inside = (drawn[lanes] - low) / (high - low) * WHOLE
        for number in range(len(atlas.charted)):
            if (brick := atlas.brick(number, place)) is not None:
                for _, root in brick.minima:
                    good[lanes] |= np.isin(brick.arrays[3][brick.leaves(root, inside)], SERVING)
    return RegionCoverage(answered=float((good & allowed).mean()), impossible=float((~allowed).mean()))


def refuse_nowhere(kept: AtlasStore, survey: Mapping[str, Any], axes: int) -> None:
    """Refuse a complete atlas without an answering cell, which would refuse every query."""
    lines, nodes, poor = kept.latest(survey, axes).values(), 0, 0
    for line in lines:
        try:
            cells = kept.shard(line["cells"], cell_type(axes))
            known = kept.shard(line["nodes"], node_type(axes, survey["charts"][line["chart"]]["unknowns"]))
        except PeriluneError:  # it is damaged, and may have answered
            return
        minimum = np.array([sheet.minimum for sheet in sheets_of(survey["charts"][line["chart"]])])
        if (np.isin(cells["status"], SERVING) & minimum[cells["sheet"]]).any():
            return
        nodes, poor = nodes + len(known), poor + int((known["residual"] > SLACK).sum())
    sensitive = f"; second flights of {poor} of them miss their ends by more than {SLACK:g}" if poor else ""
    raise NotConvergedError(
        "the atlas answers nowhere in its region: no sheet was followed from one of its extremals to another",
        got=f"{nodes} extremals in {len(lines)} bricks{sensitive}",
        expected="extremals that Newton's method follows, of flights that rounding does not throw off",
        advice="another region, or perilune solve at single points",
    )
