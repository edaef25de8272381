"""Proof of a solution by other code than the solver's: NumPy and the physics as stated, no symbols, no kernels."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.proof.feasible.phase_data import PhaseData
    from perilune.proof.levels import examine
    from perilune.proof.necessary.terminal_bounds import end_bound_multipliers
    from perilune.proof.recheck import confirm_listed_extremals
    from perilune.proof.sufficient.second_order import check_local_optimality
    from perilune.proof.sufficient.sensitivities import Resolve
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
