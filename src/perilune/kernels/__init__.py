"""Arcs as machine code: traced equations in, compiled flights out. Contains no physics.

`algebra` makes programs of expressions, `code` makes machine code of programs, `flight` flies arcs with it; each knows
those before it. `compile_arcs` makes an engine from a right-hand side, `compile_map` evaluates a function, `prune`
drops what decouples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from perilune.kernels.algebra.prune import prune
    from perilune.kernels.algebra.system import Event
    from perilune.kernels.code.batch_map import Map, compile_map
    from perilune.kernels.flight.bound_buffers import BoundArcs, Engine
    from perilune.kernels.flight.dense import DenseArc
    from perilune.kernels.flight.engine import LANES, compile_arcs
    from perilune.kernels.flight.records import Arcs, ArcStatus, Request

_HOME = {
    "prune": "algebra.prune",
    "Event": "algebra.system",
    "Map": "code.batch_map",
    "compile_map": "code.batch_map",
    "Arcs": "flight.records",
    "ArcStatus": "flight.records",
    "Engine": "flight.bound_buffers",
    "Request": "flight.records",
    "BoundArcs": "flight.bound_buffers",
    "DenseArc": "flight.dense",
    "LANES": "flight.engine",
    "compile_arcs": "flight.engine",
}
__all__ = [
    "LANES", "ArcStatus", "Arcs", "BoundArcs", "DenseArc", "Engine", "Event", "Map", "Request", "compile_arcs",
    "compile_map", "prune",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import on first use: opening the package costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
