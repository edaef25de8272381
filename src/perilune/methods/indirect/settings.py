"""Settings of the sequence of starts that the indirect method tries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from perilune.core import require_integers

if TYPE_CHECKING:
    from perilune.methods.direct.pseudospectral import Pseudospectral


STRUCTURE = "structure"  # ends the start of an answer with contact points or boundary arcs
TRANSCRIBED = "direct transcription"  # the same, from the direct method's answer in one piece


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """Settings of the search; `perilune.methods.indirect.indirect.Indirect` says what each means."""

    starts: int = 24
    seed: int = 0
    scan_points: int = 33
    segments: int = 6
    transcription: Pseudospectral | None = None

    name = "indirect"

    def __post_init__(self) -> None:
        require_integers(self, starts=1, seed=0, scan_points=3, segments=1)
