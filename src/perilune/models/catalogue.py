"""Catalogue of the kinds of problems that a file can state, each in a file of the folder `stated`.

Nothing else knows of them: the reader of scenarios, the templates and the reference page follow from here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping
from dataclasses import replace
from functools import cache, wraps
from importlib import import_module
from typing import TYPE_CHECKING, Any

from perilune.core import PeriluneError, UnknownKindError, parameter_name, unknown_name
from perilune.models.kind import Kind
from perilune.problem import Problem

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "perilune.models"  # of entry points


class KnownKinds(MutableMapping[str, Kind]):
    """Kinds by name, of which each is imported when it is asked for: their records are half of all models."""

    def __init__(self, *names: str) -> None:
        self._made: dict[str, Kind | None] = dict.fromkeys(names)

    def __getitem__(self, name: str) -> Kind:
        found = self._made[name]
        if found is None:
            found = self._made[name] = import_module(f"perilune.models.stated.{name}").STATED
        return found

    def __setitem__(self, name: str, kind: Kind) -> None:
        self._made[name] = kind

    def __delitem__(self, name: str) -> None:
        del self._made[name]

    def __contains__(self, name: object) -> bool:
        return name in self._made

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


KINDS = KnownKinds("hybrid_landing", "powered_descent", "precision_landing", "deorbit_entry")


def kind_names() -> list[str]:
    """Names of all kinds, and of those that installed packages bring."""
    from importlib.metadata import entry_points

    return list(dict.fromkeys([*KINDS, *sorted(entry.name for entry in entry_points(group=GROUP))]))


def unknown_kind(called: str, name: str) -> UnknownKindError:
    """Error for a kind of this name.

    Parameters
    ----------
    called
        Description of the value in the message, such as "problem.kind".
    name
        Kind that no record and no entry point provides.
    """
    error = unknown_name(called, name, kind_names())
    advice = error.advice or f"install the package that provides it (an entry point of the group {GROUP})"
    return UnknownKindError(error.what, got=error.got, expected=error.expected, advice=advice)


def kind_named(name: str) -> Kind:
    """A kind by its name: one of these, or one that an installed package brings as an entry point of `GROUP`.

    Nothing of a package is loaded before a file asks for its kind.

    Raises
    ------
    PeriluneError
        If there is none of this name, packages bring more than one, or it cannot be loaded.
    """
    if name in KINDS:
        return KINDS[name]
    from importlib.metadata import entry_points

    brought = {_describe_entry_point(entry): entry for entry in entry_points(group=GROUP, name=name)}
    if not brought:
        raise unknown_kind("problem.kind", name)
    if len(brought) > 1:
        got = ", ".join(sorted(brought))[:300]
        raise PeriluneError(
            f"packages provide more than one kind {name}", got=got, advice="uninstall all but one of them"
        )
    package, entry = next(iter(brought.items()))
    try:
        found = entry.load()
    except (Exception, SystemExit) as error:
        raise PeriluneError(
            f"the kind of problem {name} cannot be loaded", got=f"{package}: {one_line_error(error)}"
        ) from error
    if not isinstance(found, Kind) or found.name != name:
        raise PeriluneError(
            f"the object provided by {package} is not a kind of problem", expected=f"Kind(name={name!r}, ...)"
        )
    found = replace(found, make=_check_package_kind(found, package), package=package)
    KINDS[name] = found  # its keys are known like those of the others from now on
    _keys_by_parameter.cache_clear()
    return found


def _describe_entry_point(entry: EntryPoint) -> str:
    return f"{entry.value} of {entry.dist.name if entry.dist is not None else 'a package'}"


def one_line_error(error: BaseException) -> str:
    """Return the message of a package's error in one line, to be quoted in our own."""
    return f"{type(error).__name__}: {'; '.join(map(str.strip, str(error).splitlines()))}"[:300]


def _check_package_kind(kind: Kind, package: str) -> Callable[..., Problem]:
    """Return the kind's `make`, with errors in it reported as the package's, not as ones of this program."""

    @wraps(kind.make)
    def make(**records: Any) -> Problem:
        try:
            made = kind.make(**records)
        except PeriluneError:
            raise
        except Exception as error:
            raise PeriluneError(
                f"the kind of problem {kind.name} fails", got=f"{package}: {one_line_error(error)}",
                advice="it is called with the record of each section by name; PERILUNE_TRACEBACK=1 shows where",
            ) from error  # fmt: skip
        if not isinstance(made, Problem):
            got = f"{package}: {type(made).__name__}"
            raise PeriluneError(f"the kind of problem {kind.name} returns no problem", got=got, expected="Problem")
        return made

    return make


@cache
def _keys_by_parameter() -> dict[str, str]:
    """Keys of all files by the names of the parameters that they state."""
    stated = [
        f"{name}.{key}" for kind in KINDS.values() for name, section in kind.sections.items() for key in section.keys
    ]
    return {parameter_name(key): key for key in stated}


def key_of(parameter: str) -> str:
    """The key of a file that states a parameter, as ``vehicle.thrust``; its name where it is of another making."""
    return _keys_by_parameter().get(parameter, parameter)
