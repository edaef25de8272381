"""Arc structure of a solution, and the multi-phase reformulation of its problem."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
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
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
