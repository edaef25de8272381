"""Old names of what is public: they work for one minor version, each use with a `DeprecationWarning`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import wraps
from importlib import import_module
from types import ModuleType
from typing import Any, TypeVar, cast

from perilune.core.errors import PeriluneError
from perilune.core.renaming import copies_records, warn_renamed

Asked = TypeVar("Asked", bound=Callable[..., Any])


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
            if new[old] in keywords and not copies_records(sys._getframe(2)):
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
    """Old name of an attribute or method of a class, which `dir` and `help` do not show.

    Parameters
    ----------
    new
        The name by which it is found now.
    """

    def __init__(self, new: str) -> None:
        self.new: str = new

    def __get__(self, instance: Any, owner: type) -> Any: ...  # only for type checkers: no class keeps one of these

    def __set_name__(self, owner: Any, name: str) -> None:
        delattr(owner, name)
        if "_renamed_attributes" not in vars(owner):
            owner._renamed_attributes = dict(getattr(owner, "_renamed_attributes", {}))
            owner.__getattr__ = _attribute_by_old_name(getattr(owner, "__getattr__", object.__getattribute__))
        owner._renamed_attributes[name] = self.new


def _attribute_by_old_name(otherwise: Callable[[Any, str], Any]) -> Callable[[Any, str], Any]:
    """Return the ``__getattr__`` of a class with old names; `otherwise` finds the others, or raises."""

    def attribute(instance: Any, name: str) -> Any:
        if (new := type(instance)._renamed_attributes.get(name)) is None:
            return otherwise(instance, name)
        kind = type(instance).__name__
        warn_renamed(f"{kind}.{name}", f"{kind}.{new}")
        return getattr(instance, new)

    return attribute
