"""Arc structure of a solution, and the multi-phase reformulation of its problem."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.structures.detect_arcs import CLOSEST, Contact, arcs_of, contacts_in_phase, detect_structures
    from perilune.structures.detect_regimes import linear_scalars, stays_between_bounds
    from perilune.structures.monotone_limits import AT_END, with_budgets
    from perilune.structures.multiphase import renumber_restated, restate
    from perilune.structures.revise_arcs import HoppingStructure, revise_structure
    from perilune.structures.revise_regimes import with_bound_regimes
    from perilune.structures.split_join import JoinedTrajectories, join_solution, split_solution
    from perilune.structures.state_constraints import Condition, conditions_of, margins, plain_bounds
    from perilune.structures.state_margins import refine_minima
    from perilune.structures.structure import Arc, Structure, part_name

__all__ = [
    "AT_END",
    "CLOSEST",
    "Arc",
    "Condition",
    "Contact",
    "HoppingStructure",
    "JoinedTrajectories",
    "Structure",
    "arcs_of",
    "conditions_of",
    "contacts_in_phase",
    "detect_structures",
    "join_solution",
    "linear_scalars",
    "margins",
    "part_name",
    "plain_bounds",
    "refine_minima",
    "renumber_restated",
    "restate",
    "revise_structure",
    "split_solution",
    "stays_between_bounds",
    "with_bound_regimes",
    "with_budgets",
]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "detect_arcs": "CLOSEST Contact arcs_of contacts_in_phase detect_structures",
        "detect_regimes": "linear_scalars stays_between_bounds",
        "monotone_limits": "AT_END with_budgets",
        "multiphase": "renumber_restated restate",
        "revise_arcs": "HoppingStructure revise_structure",
        "revise_regimes": "with_bound_regimes",
        "split_join": "JoinedTrajectories join_solution split_solution",
        "state_constraints": "Condition conditions_of margins plain_bounds",
        "state_margins": "refine_minima",
        "structure": "Arc Structure part_name",
    },
)
