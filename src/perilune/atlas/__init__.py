"""Extremals mapped over a region of parameters, kept on disk, and answers read from them.

perilune.atlas.build(problem, {"vehicle.thrust": (350.0, 650.0)}, "thrusts")
atlas = perilune.atlas.open("thrusts")
solution = atlas.query(vehicle_thrust=440.0)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from perilune.words.face import public_names

if TYPE_CHECKING:
    from perilune.atlas.building import build
    from perilune.atlas.exporting import export
    from perilune.atlas.extending import extend
    from perilune.atlas.many import Answered, Answers
    from perilune.atlas.mapped import Mapped, Query
    from perilune.atlas.merging import merge
    from perilune.atlas.query import Atlas, open_atlas as open
    from perilune.atlas.slices import Slice, sliced

_HOME = {
    "build": ("building", "build"),
    "export": ("exporting", "export"),
    "extend": ("extending", "extend"),
    "merge": ("merging", "merge"),
    "open": ("query", "open_atlas"),
    "Atlas": ("query", "Atlas"),
    "Mapped": ("mapped", "Mapped"),
    "Query": ("mapped", "Query"),
    "Answers": ("many", "Answers"),
    "Answered": ("many", "Answered"),
    "Slice": ("slices", "Slice"),
    "sliced": ("slices", "sliced"),
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
