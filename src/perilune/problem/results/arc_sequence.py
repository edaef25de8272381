"""Arc sequence of an answer in words: arcs and contact points of its phases, each with its time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from perilune.core import (
    RenamedAttribute,
    check_call,
    renamed_keywords,
)


@renamed_keywords(words="description")
@check_call
@dataclass(frozen=True, kw_only=True)
class NamedArc:
    """A condition or regime that holds on an interval of a phase, or at an instant.

    Parameters
    ----------
    phase
        Name of the phase.
    begin, end
        Interval in which it holds [s], from the beginning of the phase; both are the same at a contact point.
    description
        In words: ``throttle at its upper bound``, ``along glide slope``, ``glide slope touched``.
    """

    phase: str
    begin: float
    end: float
    description: str
    words: ClassVar[RenamedAttribute] = RenamedAttribute("description")

    @property
    def text(self) -> str:
        """Describe the arc and its time."""
        when = f"at {self.end:.4g} s" if self.begin == self.end else f"{self.begin:.4g} to {self.end:.4g} s"
        return f"{self.description} {when}"


def format_arcs(arcs: Sequence[NamedArc]) -> str:
    """Format all arcs as one line; for several phases, each after its name."""
    phases = dict.fromkeys(arc.phase for arc in arcs)
    lines = ["; ".join(arc.text for arc in arcs if arc.phase == phase) for phase in phases]
    if len(lines) < 2:
        return "".join(lines)
    return ". ".join(f"{phase}: {line}" for phase, line in zip(phases, lines, strict=True))
