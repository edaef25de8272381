"""The explorer: a page on this machine only, on which the optimal flight follows the sliders."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.app.client import MESSAGE
    from perilune.app.server import Explorer
    from perilune.app.sliders import Knob
    from perilune.app.source import Subject, subject_of
    from perilune.app.static_page import build_static_page, default_sliders

__all__ = ["MESSAGE", "Explorer", "Knob", "Subject", "build_static_page", "default_sliders", "subject_of"]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "client": "MESSAGE",
        "server": "Explorer",
        "sliders": "Knob",
        "source": "Subject subject_of",
        "static_page": "default_sliders build_static_page",
    },
)
