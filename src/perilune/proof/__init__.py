"""Proof of a solution by other code than the solver's: SciPy and the numpy physics, no symbols, no kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.proof.feasible.phase_data import PhaseData
    from perilune.proof.levels import examine
    from perilune.proof.necessary.terminal_bounds import end_bound_multipliers
    from perilune.proof.recheck import confirm_listed_extremals
    from perilune.proof.sufficient.second_order import check_local_optimality
    from perilune.proof.sufficient.sensitivities import Resolve

__all__ = [
    "PhaseData",
    "Resolve",
    "check_local_optimality",
    "confirm_listed_extremals",
    "end_bound_multipliers",
    "examine",
]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "feasible.phase_data": "PhaseData",
        "levels": "examine",
        "necessary.terminal_bounds": "end_bound_multipliers",
        "recheck": "confirm_listed_extremals",
        "sufficient.second_order": "check_local_optimality",
        "sufficient.sensitivities": "Resolve",
    },
)
