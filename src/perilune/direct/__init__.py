"""Collocation, its nonlinear program, its mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.direct.elastic_constraint import ElasticLimit, elastic_limits
    from perilune.direct.initialization import ROUGHEST
    from perilune.direct.mesh_refinement import MeshRefinement
    from perilune.direct.propagated_guess import segments_by_simulation
    from perilune.direct.transcription import Transcription

__all__ = [
    "ROUGHEST",
    "ElasticLimit",
    "MeshRefinement",
    "Transcription",
    "elastic_limits",
    "segments_by_simulation",
]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "elastic_constraint": "ElasticLimit elastic_limits",
        "initialization": "ROUGHEST",
        "mesh_refinement": "MeshRefinement",
        "propagated_guess": "segments_by_simulation",
        "transcription": "Transcription",
    },
)
