"""Propagation of arcs, Newton's method and continuation for the boundary value problem."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.shooting.active_set import ActiveSetBounds
    from perilune.shooting.continuation import Member, follow_family
    from perilune.shooting.contracting_phases import propagate_settling_phase, settling_equations
    from perilune.shooting.flat_direction import root_across
    from perilune.shooting.newton import FINEST
    from perilune.shooting.nonisolated import complete_open_roots, nearly_open, reach_open_roots
    from perilune.shooting.propagate import propagate_arc, propagate_lanes
    from perilune.shooting.shooting_function import Root, Roots, Shooting
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
