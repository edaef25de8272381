"""Level 5: a theorem about the stated problem, by ball arithmetic (FLINT) and nothing of the solver's."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.rigorous.verified import add_theorem_checks

__all__ = ["add_theorem_checks"]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "verified": "add_theorem_checks",
    },
)
