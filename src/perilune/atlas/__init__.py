"""Atlas: extremals mapped over a region of parameters, kept on disk, and answers read from them.

perilune.atlas.build(problem, {"vehicle.thrust": (350.0, 650.0)}, "thrusts")
atlas = perilune.atlas.open("thrusts")
solution = atlas.query(vehicle_thrust=440.0)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred, public_names

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

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

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "building.audit": "covered_share sample_of",
        "building.build": "build",
        "building.export": "FORMS export",
        "building.extend": "extend",
        "building.merge": "merge",
        "building.verify": "verify_atlas",
        "query.query": "open=open_atlas Atlas",
        "query.answer": "Mapped Query",
        "query.batch_answers": "Answers Answered",
        "query.slices": "Slice sliced",
        "region": "Axis",
        "store.store": "HEADER",
    },
)


def __dir__() -> list[str]:
    return public_names(__all__)
