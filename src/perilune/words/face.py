"""What a module shows of itself, and what methods of records do by rooms above theirs.

The package's face knows where a method is done, and is asked when one is called. So a solution draws itself, and its
room knows none of those that draw; nothing is loaded before it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any


def listed(public: Iterable[str]) -> list[str]:
    """Return the names that ``dir`` shows of a module: public ones, loaded or not yet, and no other import."""
    return sorted({*public, "__all__", "__doc__"})


def method(name: str) -> Callable[..., Any]:
    """The function that a method of this name calls with its record."""
    import perilune

    return perilune._method(name)
