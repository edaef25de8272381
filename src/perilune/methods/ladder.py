"""Settings of the ladder that the indirect method climbs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.methods.pseudospectral import Pseudospectral


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """What the rungs are tried with; see `perilune.methods.indirect.Indirect`.

    Parameters
    ----------
    starts
        Random starts of the first rung.
    seed
        Of the random starts; the same seed gives the same answer.
    scan_points
        Values visited along a free parameter between finite bounds.
    segments
        Arcs for each phase in multiple shooting (third rung).
    transcription
        The direct method of the second rung; its mesh need not be fine. None: 40 nodes, not refined.
    """

    starts: int = 24
    seed: int = 0
    scan_points: int = 33
    segments: int = 6
    transcription: Pseudospectral | None = None

    name = "indirect"
