"""What cells give at a point, before and behind Newton's method, and what of it leaves an answer in doubt."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perilune.atlas.charted import Charted
from perilune.atlas.polish import Polished
from perilune.atlas.reflight import SLACK
from perilune.words.types import Vector


@dataclass(slots=True)
class Offer:
    """What a cell of one sheet gives at the point: unknowns (None where there are none to polish) and J, canonical.

    Where it was `polished`, and is an answer, J is that.
    """

    charted: Charted
    number: int
    y: Vector | None
    cost: float
    cell: Vector
    breaks: bool = False  # the path: all over the cell
    polished: Polished | None = None

    @property
    def label(self) -> str:
        """Of its sheet."""
        return self.charted.labels[self.number]

    @property
    def vouches(self) -> bool:
        """Whether it is made of arcs and keeps the path, as far as is known."""
        known = self.y is not None if self.polished is None else bool(self.polished.answers[0])
        return self.charted.of_arcs and not self.breaks and known

    @property
    def beyond(self) -> list[tuple[str, str]]:
        """Names of what lies beyond a bound, each with the side."""
        assert self.polished is not None
        bounds = self.charted.borders.bounds
        return [bounds[i] for i in np.nonzero(self.polished.beyond[0])[0].tolist()]

    @property
    def why(self) -> str:
        """Why it is no answer, and casts doubt on others."""
        polished, sheet = self.polished, f"the sheet '{self.label}'"
        if polished is not None and (beyond := self.beyond):
            name, side = beyond[0]
            return f"an extremal of {sheet} lies beyond the {side} bound of {name}, and one held there may be better"
        if polished is not None and polished.gains[0]:
            return f"an extremal of {sheet} would gain by leaving what it holds, and what it would become is not known"
        if self.breaks or (polished is not None and polished.breaking[0]):
            return f"an extremal of {sheet} breaks a condition, and a flight that keeps it may be better than is known"
        if polished is None:
            return f"{sheet} ends in this cell"
        if not polished.reached[0]:
            return f"Newton's method leads to no extremal of {sheet} from what its cell gives"
        if polished.flown.good[0]:
            return f"the extremal of {sheet} is known to {polished.bound[0]:.1e} alone (relative; limit {SLACK:g})"
        return f"the second flight does not bear out the extremal of {sheet}: {polished.flown.told}"


def unanswered_of(
    best: Offer | None, alike: Sequence[Offer], breaking: Sequence[Offer], offers: Sequence[Offer]
) -> list[Offer]:
    """Extremals that break the path, and of which no answer of arcs is what becomes of them where they keep it.

    Each well has one extremal of each chart at most, and one of arcs that keeps the path, of which there are as many.
    """
    if best is None or not any(one.charted.of_arcs for one in alike):
        return [one for one in breaking if best is None or not one.charted.breaks_controls_alone]
    arcs = Counter(id(one.charted) for one in offers if one.vouches)
    better = [one for one in breaking if one.cost < best.cost and not one.charted.breaks_controls_alone]
    wells = arcs + Counter(id(one.charted) for one in better)
    return [one for one in better if wells[id(one.charted)] > arcs.total()]
