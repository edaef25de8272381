"""Powered descent over a turning body: problem, coordinates, starts with two impulses or burns."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.models.descent.problem import Ignition, Site, Steering, powered_descent

__all__ = ["Ignition", "Site", "Steering", "powered_descent"]

__getattr__: Callable[[str], Any] = deferred(__name__, {"problem": "Ignition Site Steering powered_descent"})
