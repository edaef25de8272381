"""Precision landing in the tangent plane of a site: problem, path constraints, presolve."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.models.precision.path_constraints import Corridor
    from perilune.models.precision.problem import Approach, precision_landing
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)

__all__ = ["Approach", "Corridor", "precision_landing"]
