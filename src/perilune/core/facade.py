"""Facade of modules: their public names, and methods of records that higher rooms implement.

The package knows where a method is implemented, and is asked when one is called. So a solution can draw itself while
its room imports nothing that draws, and nothing is loaded before it is used.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterable
from functools import cache
from importlib import import_module
from typing import Any


def public_names(public: Iterable[str]) -> list[str]:
    """Return the names that ``dir`` shows of a module: public ones, loaded or not yet, and no other import."""
    return sorted({*public, "__all__", "__doc__"})


@cache
def face_imports(package: str) -> dict[str, tuple[str, str]]:
    """Return by name what a package offers of its modules: the module, and the name there.

    They are read off the block ``if TYPE_CHECKING`` of its own source, which is all that type checkers see, so that
    each is stated once; Python would import all of it at once.
    """
    loader: Any = sys.modules[package].__loader__
    found = dict[str, tuple[str, str]]()
    for block in ast.parse(loader.get_source(package)).body:
        for node in block.body if isinstance(block, ast.If) else ():
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("perilune"):
                found |= {one.asname or one.name: (node.module, one.name) for one in node.names}
    return found


def import_of_face(package: str, name: str) -> Any:
    """Import what a package offers by this name.

    Parameters
    ----------
    package
        Full name of the package.
    name
        Name that its face offers.
    """
    if name not in (found := face_imports(package)):
        raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name, obj=sys.modules[package])
    home, own = found[name]
    if home != package:
        if (value := getattr(sys.modules.get(home), own, None)) is not None:
            return value
        if hasattr(module := import_module(home), own):
            return getattr(module, own)
    return import_module(f"{home}.{own}")


def lazy_face(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package that imports what it offers on first use.

    Opening it costs nothing. What ``dir`` shows of it is its ``__all__``, or all that it offers if it has none.
    """

    def attribute(name: str) -> Any:
        return import_of_face(package, name)

    def names() -> list[str]:
        stated = vars(sys.modules[package]).get("__all__")
        return public_names(stated) if stated else sorted(face_imports(package))

    return attribute, names


def method_function(name: str) -> Callable[..., Any]:
    """Return the function that a method of this name calls with its record."""
    import perilune

    return perilune._import_method_function(name)
