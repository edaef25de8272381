"""Declarations of a model's numbers, made once in its records: unit, example, range, hint, meaning.

    @record("vehicle")
    class Vehicle:
        mass: float = quantity("kg", "300 kg", above=0.0, about="before the retro burn, propellant included")

From that follow the section and the key of a scenario (``[vehicle]`` ``mass``), the parameter ``vehicle_mass`` of the
problem, the check of its range wherever a value enters, the template and the reference page. A record is a frozen
dataclass with keywords only, and checks itself when it is made.

Inside, a value is a float in SI; one that was read is a `StatedNumber`, which remembers the text it was stated in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache, wraps
from types import MappingProxyType
from typing import Any, TypeVar, dataclass_transform

from perilune.core.errors import PeriluneError, unknown_name
from perilune.core.stated_number import StatedNumber
from perilune.core.units import parse_quantity, parse_unit
from perilune.core.validation import check_call

LONGEST_VALUE = 200  # characters
ORDINARY = 1e30  # in SI: the Sun's mu is 1.3e20 m^3/s^2; beyond it, squares and cubes of values overflow
T = TypeVar("T")


def parameter_name(key: str) -> str:
    """Return the parameter that a key of a scenario states: ``vehicle_thrust`` for ``vehicle.thrust``."""
    return key.replace(".", "_")


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Declaration of one number: unit, example, bounds in SI, and the message for a value outside of them."""

    unit: str
    example: str
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    outside: str = "is out of range"
    hint: str = ""
    about: str = ""
    also: tuple[str, ...] = ()

    def read(self, value: object) -> StatedNumber:
        """Return the value in SI of a scenario's text, or of a bare number where there is no unit to guess.

        Raises
        ------
        PeriluneError
            If the text is not such a quantity; the message does not name the key.
        """
        if self.unit == "1" and _is_plain_number(value):
            value = repr(value)
        if not isinstance(value, str):
            raise PeriluneError(
                "must be a number and a unit in quotes",
                got=f"{str(value)[:60]} without a unit" if _is_plain_number(value) else str(value)[:60],
                expected=f'for example "{self.example}"',
                advice="a bare number is refused, because its unit could only be guessed",
            )
        if len(value) > LONGEST_VALUE:
            raise PeriluneError(
                "the text is too long",
                got=f"{len(value)} characters",
                expected=f'for example "{self.example}"',
                advice="only a number and a unit",
            )
        number = parse_quantity(value, self.spoken_unit, self.example, self.hint)
        self.check(number, repr(value))
        return StatedNumber(number, value.strip())

    def check(self, value: float, got: str = "") -> None:
        """Raise PeriluneError, without the key, for a value in SI that is no number, not finite or out of range.

        Parameters
        ----------
        value
            Value in SI.
        got
            Text as the user wrote it, for the message; "" for the value itself.

        Raises
        ------
        PeriluneError
            If it cannot be the value.
        """
        try:
            if isinstance(value, bool):
                raise TypeError
            finite = math.isfinite(value)
        except TypeError:
            text = "a text with a unit belongs in a scenario file" if isinstance(value, str) else self._advice
            raise PeriluneError(
                "must be a number in SI", got=repr(value)[:60], expected=f"a number in {self.unit}", advice=text
            ) from None
        if not finite:
            raise PeriluneError("is not finite", got=str(value), expected="a finite number")
        if abs(value) > ORDINARY or (self.low == 0 and self.open_low and 0 < value < 1 / ORDINARY):
            size = f"between {1 / ORDINARY:g} and {ORDINARY:g} in SI"
            raise PeriluneError(
                "has an implausible magnitude", got=got or str(value), expected=size, advice=self._advice
            )
        above = value > self.low if self.open_low else value >= self.low
        below = value < self.high if self.open_high else value <= self.high
        if not (above and below):
            raise PeriluneError(
                self.outside,
                got=got or self.shown(value),
                expected=self.range,
                advice=self._advice,
            )

    @property
    def _advice(self) -> str:
        return self.hint or f'for example "{self.example}"'

    @property
    def spoken_unit(self) -> str:
        """Return the unit for people: degrees for angles, else SI."""
        return "deg" if self.unit == "rad" else self.unit

    def shown(self, value: float) -> str:
        """Format a value in SI in its spoken unit."""
        return f"{value / parse_unit(self.spoken_unit)[0]:g} {self.spoken_unit}".removesuffix(" 1")

    @property
    def range(self) -> str:
        """Return the range in words; empty for none."""
        if math.isfinite(self.low) and math.isfinite(self.high):
            low, high = f"{self.low / parse_unit(self.spoken_unit)[0]:g}", self.shown(self.high)
            if not (self.open_low or self.open_high):
                return f"between {low} and {high}"
            least, most = "more than" if self.open_low else "at least", "less than" if self.open_high else "at most"
            return f"{least} {low} and {most} {high}"
        if math.isfinite(self.low):
            return f"{'>' if self.open_low else '>='} {self.shown(self.low)}"
        return f"{'<' if self.open_high else '<='} {self.shown(self.high)}" if math.isfinite(self.high) else ""


@dataclass(frozen=True, kw_only=True)
class TextField:
    """Declaration of a text of a record: any text, one of `choices`, or a path relative to the stating file."""

    example: str
    choices: tuple[str, ...] = ()
    about: str = ""
    file: bool = False

    def read(self, value: object) -> str:
        """The text."""
        if not isinstance(value, str):
            raise PeriluneError(
                "has the wrong type",
                got=str(value)[:60],
                expected=f'a text such as "{self.example}"',
                advice="quote it",
            )
        return value


@dataclass(frozen=True, kw_only=True)
class Key:
    """Key of a record's section: the field that it fills, and the place in a pair.

    `default` is MISSING (of `dataclasses`) where the key must be stated.
    """

    field: str
    declared: Quantity | TextField
    default: Any
    place: int | None = None

    @property
    def required(self) -> bool:
        """Return True if it must be stated."""
        return self.default is MISSING


def quantity(
    unit: str,
    example: str,
    *,
    default: Any = MISSING,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    outside: str = "is out of range",
    hint: str = "",
    about: str = "",
    also: tuple[str, ...] = (),
) -> Any:
    """Declare a field of a record that is a number in SI.

    Parameters
    ----------
    unit, example
        SI unit, and the text of a value as a scenario would state it.
    default
        None where the number may be left open.
    above, least, below, most
        Range in SI, without (above, below) or with (least, most) its end.
    outside
        What is said of a value outside, after its name.
    hint, about
        What to try, and what it is.
    also
        Other names of it in the field, for which this one is offered.
    """
    declared = Quantity(
        unit=unit,
        example=example,
        low=next((v for v in (above, least) if v is not None), -math.inf),
        high=next((v for v in (below, most) if v is not None), math.inf),
        open_low=above is not None,
        open_high=below is not None,
        outside=outside,
        hint=hint,
        about=about,
        also=also,
    )
    return field(default=default, metadata={"keys": {"": declared}})


def span(unit: str, lower: str, upper: str, *, default: tuple[float, float], name: str, about: str = "") -> Any:
    """Declare a field that is a pair of numbers, lower and upper, within the default; keys ``…_lower``, ``…_upper``.

    Parameters
    ----------
    unit
        SI unit of both numbers.
    lower, upper
        Examples of the two as a scenario states them.
    default
        Default of the pair, which also bounds both [SI].
    name, about
        Name in messages; meaning of the pair.
    """
    low, high = (v * (1 + 1e-12) for v in default)  # a bound in degrees need not be the same to the last digit
    declared = {
        f"_{side}": Quantity(
            unit=unit,
            example=example,
            low=low,
            high=high,
            about=f"{word} {about or name}",
        )
        for side, word, example in (("lower", "least", lower), ("upper", "greatest", upper))
    }
    return field(default=default, metadata={"keys": declared, "span": name})


def text_field(
    example: str, *choices: str, default: Any = MISSING, called: str = "", about: str = "", file: bool = False
) -> Any:  # fmt: skip
    """Declare a field of a record that is a text, one of the choices if there are any, or the path of a `file`.

    `called` is its key if that is a reserved word of Python.

    Parameters
    ----------
    example
        Text for templates.
    *choices
        Texts that are allowed; any, if there are none.
    default
        Value where the key is left out; required without one.
    called
        Key in a scenario, where the name of the field cannot be it.
    about
        Meaning, for the reference page.
    file
        Let it be the path of a file, relative to the scenario.
    """
    declared = TextField(example=example, choices=choices, about=about, file=file)
    return field(default=default, metadata={"keys": {"": declared}, "called": called})


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(quantity, span, text_field))
def record(section: str) -> Callable[[type[T]], type[T]]:
    """Make a class a declared record, whose numbers are the keys of a section."""

    def make(cls: type[T]) -> type[T]:
        together = cls.__dict__.get("__post_init__")

        def check(self: Any) -> None:
            _check_fields(self)
            if together is not None:
                together(self)

        cls.__post_init__ = check  # type: ignore[attr-defined]
        cls.__section__ = section  # type: ignore[attr-defined]
        made = dataclass(frozen=True, kw_only=True)(cls)
        made.__init__ = _record_constructor(made)  # type: ignore[misc]
        return check_call(made)

    return make


def _record_constructor(kind: type) -> Callable[..., None]:
    """Return the constructor of a record, which refuses unknown names and reports missing ones."""
    constructor, known = kind.__init__, {f.name: f for f in fields(kind)}  # type: ignore[misc]

    @wraps(constructor)
    def init(self: Any, **values: Any) -> None:
        for name in values:
            if name not in known:
                also = {other: key for key, k in record_keys(kind).items() for other in getattr(k.declared, "also", ())}
                raise unknown_name(f"field of {kind.__name__}", name, list(known), also)
        for name, f in known.items():
            if name not in values and f.default is MISSING:
                examples = [f"{k.declared.example}" for k in record_keys(kind).values() if k.field == name]
                raise PeriluneError(f"{kind.__name__}.{name} is missing", expected=f"for example {', '.join(examples)}")
        constructor(self, **values)

    return init


def section_of(kind: type) -> str:
    """Return the section of a record's class."""
    return kind.__section__  # type: ignore[attr-defined]


@cache
def record_keys(kind: type) -> Mapping[str, Key]:
    """Return the keys of a record's section, in order."""
    found = dict[str, Key]()
    for f in fields(kind):
        for place, (ending, declared) in enumerate(f.metadata.get("keys", {}).items()):
            default = f.default
            paired = "span" in f.metadata
            if paired and default is not MISSING:
                default = default[place]
            found[(f.metadata.get("called") or f.name) + ending] = Key(
                field=f.name, declared=declared, default=default, place=place if paired else None
            )
    return MappingProxyType(found)


@cache
def _pair_fields(kind: type) -> tuple[Field[Any], ...]:
    """Return the fields of a record that are pairs."""
    return tuple(f for f in fields(kind) if "span" in f.metadata)


def record_values(made: Any) -> dict[str, Any]:
    """Return the value of each key of a record."""
    return {
        name: getattr(made, key.field) if key.place is None else getattr(made, key.field)[key.place]
        for name, key in record_keys(type(made)).items()
    }


def record_of_values(kind: type[T], values: Mapping[str, Any]) -> T:
    """Build a record with these values of its keys, checked; other keys have their defaults.

    Parameters
    ----------
    kind
        Class of the record.
    values
        Values by key, in SI.

    Raises
    ------
    PeriluneError
        If a value is outside what is declared of its key.
    """
    arguments: dict[str, Any] = {}
    for name, key in record_keys(kind).items():
        value = values.get(name, key.default)
        if key.place is None:
            if value is not MISSING:
                arguments[key.field] = value
        else:
            arguments[key.field] = (*arguments.get(key.field, ()), value)
    return kind(**arguments)


def declared_parameters(made: Any) -> set[str]:
    """Return the names of the parameters that a record declares."""
    return {f"{section_of(type(made))}_{name}" for name in record_keys(type(made))}


def check_values(made: Any, parameters: Mapping[str, float]) -> None:
    """Raise PeriluneError if parameters that a record declares could not be its values; others are ignored.

    Parameters
    ----------
    made
        Record whose class declares the parameters.
    parameters
        Values by the names of parameters [SI].

    Raises
    ------
    PeriluneError
        If a value is outside what is declared of its key.
    """
    section, keys, own = section_of(type(made)), record_keys(type(made)), record_values(made)
    values = {n: parameters[f"{section}_{n}"] for n in keys if f"{section}_{n}" in parameters}
    texts = {n: own[n] for n, key in keys.items() if isinstance(key.declared, TextField)}
    if values and all(n in values or n in texts or key.default is not MISSING for n, key in keys.items()):
        record_of_values(type(made), {**texts, **values})


def _check_fields(made: Any) -> None:
    section = section_of(type(made))
    values = record_values(made)
    for name, key in record_keys(type(made)).items():
        if values[name] is None and key.default is None:
            continue
        if isinstance(key.declared, Quantity) and key.place is None:
            try:
                key.declared.check(values[name])
            except PeriluneError as error:
                raise with_key_named(f"{section}.{name}", error) from None
        elif isinstance(key.declared, TextField) and key.declared.choices and values[name] not in key.declared.choices:
            known = ", ".join(map(repr, key.declared.choices))
            raise PeriluneError(f"unknown {name}", got=repr(values[name])[:60], expected=f"one of {known}")
    for f in _pair_fields(type(made)):
        (lower, upper), bound = getattr(made, f.name), next(iter(f.metadata["keys"].values()))
        if not bound.low <= lower < upper <= bound.high:
            raise PeriluneError(
                f"the bounds of {f.metadata['span']} are not a range",
                got=f"{bound.shown(lower)} to {bound.shown(upper)}",
                expected=f"lower < upper, {bound.range}",
            )


def with_key_named(key: str, error: PeriluneError) -> PeriluneError:
    """Return the same error with the key in front.

    Parameters
    ----------
    key
        Key of the scenario, as ``vehicle.mass``.
    error
        Error of a check that does not know the key.
    """
    what = f"- {error.what}" if error.what.startswith(("this ", "the ")) else error.what
    return PeriluneError(f"{key} {what}", got=error.got, expected=error.expected, advice=error.advice)


def _is_plain_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
