"""Atlas: extremals mapped over a region of parameters, kept on disk, and answers read from them.

perilune.atlas.build(problem, {"vehicle.thrust": (350.0, 650.0)}, "thrusts")
atlas = perilune.atlas.open("thrusts")
solution = atlas.query(vehicle_thrust=440.0)
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.atlas.building.audit import covered_share as covered_share, sample_of as sample_of
    from perilune.atlas.building.build import build
    from perilune.atlas.building.export import FORMS as FORMS, export
    from perilune.atlas.building.extend import extend
    from perilune.atlas.building.merge import merge
    from perilune.atlas.building.verify import verify_atlas as verify_atlas
    from perilune.atlas.query.answer import Mapped, Query
    from perilune.atlas.query.batch_answers import Answered, Answers
    from perilune.atlas.query.query import Atlas, open_atlas as open
    from perilune.atlas.query.slices import Slice, sliced
    from perilune.atlas.region import Axis as Axis
    from perilune.atlas.store.store import HEADER as HEADER
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)

# What users are offered; the command line, the explorer and the figures take the rest too.
__all__ = [
    "Answered",
    "Answers",
    "Atlas",
    "Mapped",
    "Query",
    "Slice",
    "build",
    "export",
    "extend",
    "merge",
    "open",
    "sliced",
]
