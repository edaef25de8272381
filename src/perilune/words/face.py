"""What methods of records do by rooms above theirs: the package's face knows where, and is asked when one is called.

So a solution draws itself, and its room knows none of those that draw; nothing is loaded before it is used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def method(name: str) -> Callable[..., Any]:
    """The function that a method of this name calls with its record."""
    import perilune

    return perilune._method(name)
