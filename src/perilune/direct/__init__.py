"""Collocation, its nonlinear program, its mesh."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.direct.elastic_constraint import ElasticLimit, elastic_limits
    from perilune.direct.initialization import ROUGHEST
    from perilune.direct.mesh_refinement import MeshRefinement
    from perilune.direct.propagated_guess import segments_by_simulation
    from perilune.direct.transcription import Transcription
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
