"""Facade of modules: their public names, and methods of records that higher rooms implement.

The package knows where a method is implemented, and is asked when one is called. So a solution can draw itself while
its room imports nothing that draws, and nothing is loaded before it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any


def public_names(public: Iterable[str]) -> list[str]:
    """Return the names that ``dir`` shows of a module: public ones, loaded or not yet, and no other import."""
    return sorted({*public, "__all__", "__doc__"})


def method_function(name: str) -> Callable[..., Any]:
    """Return the function that a method of this name calls with its record."""
    import perilune

    return perilune._import_method_function(name)
