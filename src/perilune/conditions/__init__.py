"""Pontryagin's conditions of a problem, and the control that minimises H."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.conditions.active_constraints import Held
    from perilune.conditions.canonical_equations import (
        PhaseExtremal,
        extremal_parameters,
        hamiltonian_at,
        limit_symbols,
        minimising_control_at,
    )
    from perilune.conditions.mode_events import select_by_mode
    from perilune.conditions.pontryagin import OptimalityConditions, attainable_conditions, derive
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
