"""Arcs as machine code: traced equations in, compiled flights out. Contains no physics.

`algebra` makes programs of expressions, `code` makes machine code of programs, `flight` flies arcs with it; each knows
those before it. `compile_arcs` makes an engine from a right-hand side, `compile_map` evaluates a function, `prune`
drops what decouples.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.kernels.algebra.prune import prune
    from perilune.kernels.algebra.system import Event
    from perilune.kernels.code.batch_map import Map, compile_map
    from perilune.kernels.code.cache import clear_cache, report_cache
    from perilune.kernels.flight.bound_buffers import BoundArcs, Engine
    from perilune.kernels.flight.dense import DenseArc
    from perilune.kernels.flight.engine import LANES, compile_arcs
    from perilune.kernels.flight.records import Arcs, ArcStatus, Request
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
