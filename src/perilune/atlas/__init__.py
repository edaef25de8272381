"""Atlas: extremals mapped over a region of parameters, kept on disk, and answers read from them.

perilune.atlas.build(problem, {"vehicle.thrust": (350.0, 650.0)}, "thrusts")
atlas = perilune.atlas.open("thrusts")
solution = atlas.query(vehicle_thrust=440.0)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from perilune.core.facade import public_names

if TYPE_CHECKING:
    from perilune.atlas.building.build import build
    from perilune.atlas.building.export import export
    from perilune.atlas.building.extend import extend
    from perilune.atlas.building.merge import merge
    from perilune.atlas.query.answer import Mapped, Query
    from perilune.atlas.query.batch_answers import Answered, Answers
    from perilune.atlas.query.query import Atlas, open_atlas as open
    from perilune.atlas.query.slices import Slice, sliced

_HOME = {
    "build": ("building.build", "build"),
    "export": ("building.export", "export"),
    "extend": ("building.extend", "extend"),
    "merge": ("building.merge", "merge"),
    "open": ("query.query", "open_atlas"),
    "Atlas": ("query.query", "Atlas"),
    "Mapped": ("query.answer", "Mapped"),
    "Query": ("query.answer", "Query"),
    "Answers": ("query.batch_answers", "Answers"),
    "Answered": ("query.batch_answers", "Answered"),
    "Slice": ("query.slices", "Slice"),
    "sliced": ("query.slices", "sliced"),
}
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


def __getattr__(name: str) -> Any:
    """Import on first use: opening the package costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    module, attribute = _HOME[name]
    return getattr(import_module(f"{__name__}.{module}"), attribute)


def __dir__() -> list[str]:
    return public_names(__all__)
