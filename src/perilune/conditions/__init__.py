"""Pontryagin's conditions of a problem, and the control that minimises H."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

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

__all__ = [
    "Held",
    "OptimalityConditions",
    "PhaseExtremal",
    "attainable_conditions",
    "derive",
    "extremal_parameters",
    "hamiltonian_at",
    "limit_symbols",
    "minimising_control_at",
    "select_by_mode",
]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "active_constraints": "Held",
        "canonical_equations": "PhaseExtremal extremal_parameters hamiltonian_at limit_symbols minimising_control_at",
        "mode_events": "select_by_mode",
        "pontryagin": "OptimalityConditions attainable_conditions derive",
    },
)
