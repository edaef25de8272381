"""Old names of what is public: they work for one minor version, each use with a `DeprecationWarning`."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from importlib import import_module
from types import FrameType, ModuleType
from typing import Any, TypeVar, cast

from perilune.core.errors import PeriluneError

Asked = TypeVar("Asked", bound=Callable[..., Any])


def warn_renamed(old: str, new: str, depth: int = 1) -> None:
    """Warn that a name is another one now.

    Parameters
    ----------
    old, new
        The two names, as a user writes them.
    depth
        Number of calls between the user's line and the caller of this function; those of `dataclasses.replace` are
        not counted.
    """
    frame = sys._getframe(depth + 1)
    while frame.f_back is not None and _copies_records(frame):
        frame, depth = frame.f_back, depth + 1
    warnings.warn(
        f"{old} is {new} now; the old name goes with the next minor version", DeprecationWarning, stacklevel=depth + 2
    )


def _copies_records(frame: FrameType) -> bool:
    """Return True for a frame of `dataclasses.replace` or `copy.replace`."""
    return frame.f_globals.get("__name__") in ("dataclasses", "copy")


def renamed_names(module: str, new: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a module that is asked for its old names.

    Parameters
    ----------
    module
        Its dotted name.
    new
        By old name, the dotted name by which it is found now.
    """

    def attribute(name: str) -> Any:
        if name not in new:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        home, _, own = new[name].rpartition(".")
        warn_renamed(f"{module}.{name}", new[name])
        return getattr(import_module(home), own)

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


def renamed_keywords(**new: str) -> Callable[[Asked], Asked]:
    """Let a function, method or class take keywords by their old names too (``old="new"``).

    Where `dataclasses.replace` gives a field by its old name, and by its new one the value of before, the old name
    counts.
    """

    def by_new_names(called: str, keywords: dict[str, Any]) -> dict[str, Any]:
        for old in [old for old in new if old in keywords]:
            if new[old] in keywords and not _copies_records(sys._getframe(2)):
                raise PeriluneError(
                    f"{called} takes a value by one name only",
                    got=f"{old}=..., {new[old]}=...",
                    expected=f"{new[old]}=...",
                    advice=f"leave {old} out; it is the old name of the same",
                )
            warn_renamed(f"{old}= of {called}", f"{new[old]}=", 2)
            keywords[new[old]] = keywords.pop(old)
        return keywords

    return rewritten_keywords(by_new_names)


def rewritten_keywords(rewrite: Callable[[str, dict[str, Any]], dict[str, Any]]) -> Callable[[Asked], Asked]:
    """Let a function, method or class take keywords that are rewritten first.

    Parameters
    ----------
    rewrite
        Returns the keywords to call with, from the name of what is called and those given; may warn or refuse.
    """

    def of(asked: Asked) -> Asked:
        given: Any = asked
        function, called = given.__init__ if isinstance(given, type) else given, given.__name__

        @wraps(function)
        def call(*args: Any, **keywords: Any) -> Any:
            return function(*args, **rewrite(called, keywords))

        if not isinstance(given, type):
            return cast("Asked", call)
        given.__init__ = call
        return asked

    return of


class RenamedAttribute:
    """Old name of an attribute or method of a class.

    Parameters
    ----------
    new
        The name by which it is found now.
    """

    def __init__(self, new: str) -> None:
        self.new: str = new
        self.old: str = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.old = f"{owner.__name__}.{name}"

    def __get__(self, instance: Any, owner: type) -> Any:
        if instance is None:
            return self
        warn_renamed(self.old, f"{owner.__name__}.{self.new}")
        return getattr(instance, self.new)
