"""Facade of modules: their public names, and methods of records that higher rooms implement.

The package knows where a method is implemented, and is asked when one is called. So a solution can draw itself while
its room imports nothing that draws, and nothing is loaded before it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

from perilune.core.deprecation import warn_renamed


def public_names(public: Iterable[str]) -> list[str]:
    """Return the names that ``dir`` shows of a module: public ones, loaded or not yet, and no other import."""
    return sorted({*public, "__all__", "__doc__"})


def deferred(package: str, home: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package whose public names are imported on first use: opening it costs nothing.

    Parameters
    ----------
    package
        Its dotted name.
    home
        By submodule (``.other.module`` for one beside the package), the names that are defined there, separated by
        blanks; ``public=own`` where the submodule calls it otherwise.
    """
    places = dict[str, tuple[str, str]]()
    for module, names in home.items():
        for name in names.split():
            public, _, own = name.partition("=")
            places[public] = (module, own or public)

    def attribute(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, own = places[name]
        return getattr(import_module(f".{module}", package), own)

    return attribute


def moved_module(old: str, new: str) -> ModuleType:
    """Import a module from its new place and warn that the old one goes with the next minor version.

    Parameters
    ----------
    old, new
        Full names of the module before and now.
    """
    warn_renamed(old, new, 2)
    return import_module(new)


def method_function(name: str) -> Callable[..., Any]:
    """Return the function that a method of this name calls with its record."""
    import perilune

    return perilune._import_method_function(name)
