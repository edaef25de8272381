"""Arcs as machine code: traced equations in, compiled flights out. Knows no rockets.

`compile_arcs` makes an engine from a right-hand side; `prune` drops what decouples; `batch` solves boundary
value problems by the thousand; `cache.report` says what is kept on disk.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from perilune.kernels.arcs import Arcs, ArcStatus, Engine, Event
    from perilune.kernels.dense import DenseArc
    from perilune.kernels.engine import compile_arcs

_HOME = {
    "Arcs": "arcs",
    "ArcStatus": "arcs",
    "Engine": "arcs",
    "Event": "arcs",
    "DenseArc": "dense",
    "compile_arcs": "engine",
}
__all__ = ["ArcStatus", "Arcs", "DenseArc", "Engine", "Event", "compile_arcs"]


def __getattr__(name: str) -> Any:
    """Import on first use: opening the package costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
