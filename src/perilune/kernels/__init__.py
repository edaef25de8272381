"""Arcs as machine code: traced equations in, compiled flights out. Contains no physics.

`algebra` makes programs of expressions, `code` makes machine code of programs, `flight` flies arcs with it; each knows
those before it. `compile_arcs` makes an engine from a right-hand side, `compile_map` evaluates a function, `prune`
drops what decouples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.kernels.algebra.prune import prune
    from perilune.kernels.algebra.system import Event
    from perilune.kernels.code.batch_map import Map, compile_map
    from perilune.kernels.code.cache import clear_cache, report_cache
    from perilune.kernels.flight.bound_buffers import BoundArcs, Engine
    from perilune.kernels.flight.dense import DenseArc
    from perilune.kernels.flight.engine import LANES, compile_arcs
    from perilune.kernels.flight.records import Arcs, ArcStatus, Request

__all__ = [
    "LANES", "ArcStatus", "Arcs", "BoundArcs", "DenseArc", "Engine", "Event", "Map", "Request", "clear_cache",
    "compile_arcs", "compile_map", "prune", "report_cache",
]  # fmt: skip

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "algebra.prune": "prune",
        "algebra.system": "Event",
        "code.batch_map": "Map compile_map",
        "code.cache": "clear_cache report_cache",
        "flight.records": "Arcs ArcStatus Request",
        "flight.bound_buffers": "Engine BoundArcs",
        "flight.dense": "DenseArc",
        "flight.engine": "LANES compile_arcs",
    },
)
