"""Validation of the arguments of the library's functions, with refusals in the user's words."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import wraps
from inspect import signature
from keyword import iskeyword
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar, cast

from perilune.core.errors import PeriluneError, unknown_name

Asked = TypeVar("Asked", bound=Callable[..., Any])
Kind = TypeVar("Kind")
_FEW = 4  # of a list that is shown whole
_SPOKEN: dict[Any, str] = {str: "a text", Callable: "a function"}


def check_call(asked: Asked) -> Asked:
    """Make a function, method or class report a wrong call: an unknown keyword, too many or too few values."""
    given: Any = asked
    # What is itself called is named by its class, as what is made of that would be: curve(t).
    name = given.__qualname__.split(".")[-2].lower() if given.__name__ == "__call__" else given.__name__
    function = given.__init__ if isinstance(given, type) else given

    @wraps(function)
    def call(*args: Any, **keywords: Any) -> Any:
        try:
            return function(*args, **keywords)
        except TypeError:  # looked at here alone, so that a call that is right costs nothing
            wrong = _wrong_call_error(name, function, args, keywords)
            if wrong is None:
                raise
            raise wrong from None

    if not isinstance(given, type):
        return cast("Asked", call)
    given.__init__ = call
    return asked


def check_operands(expected: str, *names: str) -> Callable[[type[Kind]], type[Kind]]:
    """Make methods of a class report values that they cannot compute with, and what they expect.

    Parameters
    ----------
    expected
        Text on what the methods expect.
    names
        Names of the methods.
    """

    def of(kind: type[Kind]) -> type[Kind]:
        for name in names:
            setattr(kind, name, _checked_operand(vars(kind)[name], f"{name} of a {kind.__name__}", expected))
        return kind

    return of


def _checked_operand(method: Callable[..., Any], name: str, expected: str) -> Callable[..., Any]:
    @wraps(method)
    def call(*args: Any, **keywords: Any) -> Any:
        try:
            return method(*args, **keywords)
        except PeriluneError:
            raise
        except (TypeError, ValueError, IndexError, AttributeError) as error:
            wrong = _wrong_call_error(method.__name__, method, args, keywords)
            if wrong is None:
                got = ", ".join(map(_value_text, (*args[1:], *keywords.values())))[:80]
                wrong = PeriluneError(f"{name} cannot be computed of this", got=got, expected=expected)
            raise wrong from error

    return call


def _wrong_call_error(
    name: str, function: Callable[..., Any], args: Sequence[Any], keywords: Mapping[str, Any]
) -> PeriluneError | None:
    """Return the error of a call that does not fit a function's signature; None for a call that fits."""
    stated = list(signature(function).parameters.values())
    if stated[:1] and stated[0].name == "self":
        stated, args = stated[1:], args[1:]
    any_name = any(p.kind is p.VAR_KEYWORD for p in stated)
    known = [p.name for p in stated if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    for keyword in () if any_name else keywords:
        if keyword not in known:
            return unknown_name(f"keyword of {name}", keyword, known)
    placed = [p.name for p in stated if p.kind is p.POSITIONAL_OR_KEYWORD]
    if len(args) > len(placed):
        named = [f"{word}=..." for word in known[len(placed) :]] + ["NAME=VALUE"] * any_name
        most = f"at most {len(placed)}" if placed else "none"
        return PeriluneError(
            f"{name} takes {most} of its arguments by position",
            got=", ".join(map(_value_text, args))[:80],
            expected=f"{name}({', '.join((*placed, *named))})",
        )
    taken = {*placed[: len(args)], *keywords}
    missing = [p.name for p in stated if p.name in known and p.default is p.empty and p.name not in taken]
    return PeriluneError(f"{name} needs {', '.join(missing)}") if missing else None


def require_type(value: Any, kind: type, what: str, advice: str = "") -> None:
    """Refuse a value that is not of a kind.

    Parameters
    ----------
    value, kind
        What was given, and its class.
    what, advice
        What it is needed for, as "a problem to solve"; what to try.

    Raises
    ------
    PeriluneError
        If it is anything else.
    """
    if not isinstance(value, kind):
        raise wrong_type_error(value, _SPOKEN.get(kind, kind.__name__), what, advice)


def require_row(values: Any, what: str, *kinds: Any) -> None:
    """Refuse anything but a row of records of these kinds; a single record is not a row.

    Parameters
    ----------
    values, kinds
        The row, and the classes of its records.
    what
        Plural name of the records for the message.

    Raises
    ------
    PeriluneError
        Named by `what`, their plural.
    """
    one, named = what.removesuffix("s"), " or ".join(_SPOKEN.get(kind, f"{kind.__name__}(...)") for kind in kinds)
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise wrong_type_error(values, f"({named}, ...)", f"a row of {what}", "a row of one ends with a comma: (one,)")
    for value in values:
        if not isinstance(value, kinds):
            by_name = isinstance(value, str) and kinds[-1] not in _SPOKEN
            advice = f"{kinds[-1].__name__}(name={_value_text(value)}, ...)" if by_name else ""
            raise wrong_type_error(value, named, f"{_article(one)} {one}", advice)


def require_records(*pairs: tuple[Any, type]) -> None:
    """Refuse values that are not records of the class paired with each."""
    for value, kind in pairs:
        require_type(
            value, kind, f"{_article(kind.__name__)} {kind.__name__}", f"{kind.__name__}(...) with its numbers in SI"
        )


def require_callable(value: Any, what: str) -> None:
    """Refuse a value that can neither be called nor is None.

    Parameters
    ----------
    value, what
        The value, and its use for the message.

    Raises
    ------
    PeriluneError
        If it is neither.
    """
    if value is not None and not callable(value):
        raise wrong_type_error(value, "a function, or None", what)


def require_path(value: Any, what: str) -> Path:
    """Return a value as a path, which need not exist.

    Parameters
    ----------
    value, what
        The value, and its use for the message.

    Raises
    ------
    PeriluneError
        If it is no path, or one that cannot even be looked at.
    """
    if not isinstance(value, str | os.PathLike) or not isinstance(os.fspath(value), str):
        raise wrong_type_error(value, "a path, as a text or a pathlib.Path", what)
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            os.stat(value)
    except (OSError, ValueError) as error:
        got = f"{str(value)[:60]!r}: {getattr(error, 'strerror', None) or error}"
        raise PeriluneError(f"this cannot be {what}", got=got, expected="a path that can be accessed") from None
    return Path(value)


def wrong_type_error(value: Any, expected: str, what: str, advice: str = "") -> PeriluneError:
    """Return the error for a value of a wrong kind.

    Parameters
    ----------
    value, expected
        The value, and a text on what was expected.
    what, advice
        Use of the value, for the message; advice on what to try.
    """
    got = f"the class {value.__name__} instead of {value.__name__}()" if isinstance(value, type) else _value_text(value)
    return PeriluneError(f"this is not {what}", got=got, expected=expected, advice=advice)


def require_level(level: Any, known: Sequence[int]) -> None:
    """Refuse an unknown verification level.

    Parameters
    ----------
    level
        Level as the user gave it.
    known
        Levels that there are.

    Raises
    ------
    PeriluneError
        If it is none of those known.
    """
    if isinstance(level, bool) or not isinstance(level, Integral) or level not in known:
        *most, last = map(str, known)
        raise PeriluneError(
            "there is no such verification level", got=repr(level)[:60], expected=f"{', '.join(most)} or {last}"
        )


def require_number(value: Any, name: str) -> None:
    """Refuse a setting that is not a real number; NaN and infinity are accepted.

    Parameters
    ----------
    value, name
        The value of the setting, and its name.

    Raises
    ------
    PeriluneError
        Named.
    """
    if not _is_real_number(value):
        raise PeriluneError(f"{name} must be a number", got=_value_text(value))


def _is_real_number(value: Any) -> bool:
    """Return True for a real number; a truth value is none, though Python makes a float of it."""
    return isinstance(value, Real) and not isinstance(value, bool)


_READING = "perilune.core.units.parse_quantity('440 N', 'N') reads a text"


def require_si_number(value: Any, what: str, advice: str = _READING) -> None:
    """Refuse anything but a single real number: NaN, truth values and texts too, though Python makes floats of them.

    Parameters
    ----------
    value, what
        The value, and the quantity for the message.
    advice
        Advice on what to try.

    Raises
    ------
    PeriluneError
        Named.
    """
    plain = value.item() if getattr(value, "ndim", None) == 0 else value  # of NumPy and xarray
    if not _is_real_number(plain):
        raise wrong_type_error(value, "a number in SI", what, advice)
    if plain != plain:  # as NaN alone is
        raise wrong_type_error(value, "a finite number in SI", what)


def require_numbers(values: Any, what: str, most: float = math.inf) -> Any:
    """Return a number, or an array of numbers with at most `most` axes, as NumPy has it.

    Parameters
    ----------
    values, what
        The value, and its meaning for the message.
    most
        Largest number of axes.

    Raises
    ------
    PeriluneError
        If it is neither.
    """
    import numpy as np  # which no refusal needs

    expected = f"a number, or {'a list' if most == 1 else 'an array'} of numbers"
    try:
        told = np.asarray(values)
        if told.dtype.kind not in "iuf" and not all(map(_is_real_number, told.flat)):
            raise TypeError  # of texts and None NumPy makes numbers
        found = np.asarray(told, dtype=float)[()]
    except (TypeError, ValueError, OverflowError):
        raise wrong_type_error(values, expected, what) from None
    if found.ndim > most:
        raise wrong_type_error(values, expected, what)
    if np.ma.is_masked(values):  # an array forgets what hides some of them
        raise wrong_type_error(values, f"{expected}, none of them masked", what)
    return found


def require_index(value: Any, count: int, what: str) -> None:
    """Refuse anything but an index below `count`.

    Parameters
    ----------
    value, count
        The index, and the number of entries.
    what
        Kind of the entries for the message.

    Raises
    ------
    PeriluneError
        Named.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or not -count <= int(value) < count:
        raise wrong_type_error(value, f"its number, 0 to {count - 1}", what)


def require_distinct(what: str, names: Sequence[str]) -> None:
    """Refuse names of which two are alike.

    Parameters
    ----------
    what, names
        The quantities that are named, in the plural; their names.

    Raises
    ------
    PeriluneError
        For the first that comes again.
    """
    if again := next((name for i, name in enumerate(names) if name in names[:i]), None):
        raise PeriluneError(f"two {what} are called {again}", expected="different names")


def require_identifier(value: Any) -> None:
    """Refuse a name that could not follow a dot.

    Raises
    ------
    PeriluneError
        Named.
    """
    if not isinstance(value, str):
        raise wrong_type_error(value, "a text", "a name")
    if not value.isidentifier():
        raise PeriluneError("a name must be a Python identifier", got=repr(value[:60]))
    if iskeyword(value) or value.startswith("_"):
        raise PeriluneError("a name must not be a Python keyword or begin with _", got=repr(value[:60]))


def require_integers(settings: Any, **least: int) -> None:
    """Refuse settings that are not whole numbers of at least so much.

    Raises
    ------
    PeriluneError
        For the first.
    """
    for name, smallest in least.items():
        value = getattr(settings, name)
        if isinstance(value, bool) or not isinstance(value, int):
            raise PeriluneError(f"{name} must be a whole number", got=repr(value)[:60], expected=f">= {smallest}")
        if value < smallest:
            raise PeriluneError(f"{name} is too small", got=str(value), expected=f">= {smallest}")


def _article(name: str) -> str:
    return "an" if name[:1].upper() in "AEIO" else "a"


def _value_text(value: Any) -> str:
    few = list(value) if isinstance(value, (list, tuple)) and len(value) <= _FEW else [value]
    plain = all(v is None or isinstance(v, (str, int, float)) for v in few)
    return repr(value)[:60] if plain else type(value).__name__
