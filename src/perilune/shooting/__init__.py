"""Propagation of arcs, Newton's method and continuation for the boundary value problem."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.shooting.active_set import ActiveSetBounds
    from perilune.shooting.continuation import Member, follow_family
    from perilune.shooting.contracting_phases import propagate_settling_phase, settling_equations
    from perilune.shooting.flat_direction import root_across
    from perilune.shooting.newton import FINEST
    from perilune.shooting.nonisolated import complete_open_roots, nearly_open, reach_open_roots
    from perilune.shooting.propagate import propagate_arc, propagate_lanes
    from perilune.shooting.shooting_function import Root, Roots, Shooting

__all__ = [
    "FINEST",
    "ActiveSetBounds",
    "Member",
    "Root",
    "Roots",
    "Shooting",
    "complete_open_roots",
    "follow_family",
    "nearly_open",
    "propagate_arc",
    "propagate_lanes",
    "propagate_settling_phase",
    "reach_open_roots",
    "root_across",
    "settling_equations",
]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "active_set": "ActiveSetBounds",
        "continuation": "Member follow_family",
        "contracting_phases": "propagate_settling_phase settling_equations",
        "flat_direction": "root_across",
        "newton": "FINEST",
        "nonisolated": "complete_open_roots nearly_open reach_open_roots",
        "propagate": "propagate_arc propagate_lanes",
        "shooting_function": "Root Roots Shooting",
    },
)
