"""Precision landing in the tangent plane of a site: problem, path constraints, presolve."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.models.precision.path_constraints import Corridor
    from perilune.models.precision.problem import Approach, precision_landing

__all__ = ["Approach", "Corridor", "precision_landing"]

__getattr__: Callable[[str], Any] = deferred(
    __name__, {"problem": "Approach precision_landing", "path_constraints": "Corridor"}
)
