"""Units: text to SI at the boundary, and SI to canonical (scaled) units before the mathematics.

A quantity is a number and a product of powers of whitelisted units, such as ``"4902.7779 km^3/s^2"`` or
``"1.74e-4 kg^0.5/m"``. Nothing is evaluated: the grammar is a number, then ``unit[^power]`` joined by ``*`` or ``/``,
the power whole or half. A general unit library would accept arithmetic in the text, which a scenario from a stranger
must not have. ``g`` is the gram; an acceleration in multiples of standard gravity is in ``g0``.

`Scales` holds one length, time, mass and temperature. As physics is dimensionally homogeneous, the same dynamics run
unchanged in canonical units when states *and* parameters are divided by the scale of their unit; `Problem` tests that.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from numbers import Real
from typing import Any

from perilune.core.errors import PeriluneError
from perilune.core.validation import check_call, require_type

Dimension = tuple[float, float, float, float]  # exponents of length, time, mass, temperature; halves are exact

STANDARD_GRAVITY = 9.80665  # m/s^2, exact: 3rd CGPM (1901)
_FOOT, _POUND = 0.3048, 0.45359237  # m, kg, exact: international yard and pound agreement (1959)

# unit: (factor to SI, exponents of metre, second, kilogram, kelvin). Angles are dimensionless and kept in radians.
_UNITS: dict[str, tuple[float, tuple[int, ...]]] = {
    "m": (1.0, (1, 0, 0)),
    "km": (1e3, (1, 0, 0)),
    "cm": (1e-2, (1, 0, 0)),
    "mm": (1e-3, (1, 0, 0)),
    "s": (1.0, (0, 1, 0)),
    "ms": (1e-3, (0, 1, 0)),
    "min": (60.0, (0, 1, 0)),
    "h": (3600.0, (0, 1, 0)),
    "day": (86400.0, (0, 1, 0)),
    "kg": (1.0, (0, 0, 1)),
    "g": (1e-3, (0, 0, 1)),
    "t": (1e3, (0, 0, 1)),
    "N": (1.0, (1, -2, 1)),
    "kN": (1e3, (1, -2, 1)),
    "MN": (1e6, (1, -2, 1)),
    "lbf": (_POUND * STANDARD_GRAVITY, (1, -2, 1)),
    "lb": (_POUND, (0, 0, 1)),
    "slug": (_POUND * STANDARD_GRAVITY / _FOOT, (0, 0, 1)),
    "ft": (_FOOT, (1, 0, 0)),
    "g0": (STANDARD_GRAVITY, (1, -2, 0)),
    "Pa": (1.0, (-1, -2, 1)),
    "kPa": (1e3, (-1, -2, 1)),
    "J": (1.0, (2, -2, 1)),
    "kJ": (1e3, (2, -2, 1)),
    "MJ": (1e6, (2, -2, 1)),
    "W": (1.0, (2, -3, 1)),
    "kW": (1e3, (2, -3, 1)),
    "MW": (1e6, (2, -3, 1)),
    "K": (1.0, (0, 0, 0, 1)),
    "%": (1e-2, (0, 0, 0)),
    "rad": (1.0, (0, 0, 0)),
    "deg": (math.pi / 180.0, (0, 0, 0)),
    "1": (1.0, (0, 0, 0)),
}

_NUMBER = r"[+-]?(?:\d{1,40}(?:\.\d{0,40})?|\.\d{1,40})(?:[eE][+-]?\d{1,3})?"
_FACTOR = re.compile(r"([A-Za-z]+0?|1|%)(?:\^(-?\d(?:\.[05])?))?", re.ASCII)
_NO_FINITE = "[+-]?(?i:nan|inf|infinity)(?![A-Za-z])"  # read too, so that this is what is said of it
_QUANTITY = re.compile(rf"\s*({_NUMBER}|{_NO_FINITE})\s*(.{{0,60}}?)\s*", re.DOTALL | re.ASCII)
_BASE_NAMES = ("m", "s", "kg", "K")
# Factors that are no decimal of a few digits.
_EXACT = {"slug": Fraction(repr(_POUND)) * Fraction(repr(STANDARD_GRAVITY)) / Fraction(repr(_FOOT))}


@lru_cache(maxsize=256)
def parse_unit(text: str) -> tuple[float, Dimension]:
    """Return the factor to SI and the dimension of a unit expression.

    Parameters
    ----------
    text
        For example ``"km^3/s^2"``; ``"1"`` or empty is dimensionless.

    Returns
    -------
    factor, dimension
        ``value * factor`` is in SI; exponents of (metre, second, kilogram, kelvin).

    Raises
    ------
    PeriluneError
        If a unit is not on the whitelist or the expression is malformed.
    """
    if not text or text == "1":
        return 1.0, (0, 0, 0, 0)
    factor, exponents = 1.0, [0.0, 0.0, 0.0, 0.0]
    for name, power in _powers(text):
        size, dimension = _UNITS[name]
        factor *= size**power
        exponents = [e + power * d for e, d in zip(exponents, (*dimension, 0), strict=False)]
    return factor, (exponents[0], exponents[1], exponents[2], exponents[3])


def _powers(text: str) -> Iterator[tuple[str, float]]:
    """Yield each unit of an expression, with its power."""
    parts = re.split(r"([*/])", text.replace("**", "^").replace(" ", ""))
    for operator, part in zip(["*", *parts[1::2]], parts[::2], strict=True):
        match = _FACTOR.fullmatch(part)
        if match is None or match.group(1) not in _UNITS:
            raise PeriluneError(
                "this is not a unit perilune knows",
                got=repr(text[:60]),
                expected="products and powers of " + ", ".join(u for u in _UNITS if u != "1") + ', as "km^3/s^2"',
                advice=_nearest_unit_advice(match.group(1) if match else part),
            )
        yield match.group(1), float(match.group(2) or 1) * (1 if operator == "*" else -1)


def _nearest_unit_advice(name: str) -> str:
    """Return the advice to use the unit that is spelt most like a name, if any is."""
    import difflib  # which nothing needs that is right

    if name.startswith(","):
        return "a decimal point in place of the comma"
    found = {known.lower(): known for known in _UNITS}
    near = [known for known in found if len(known) > 2 and name.lower().startswith(known)]  # of degrees, deg
    near = near or difflib.get_close_matches(name.lower(), found, n=1, cutoff=0.75)  # of short ones few are meant
    return f'did you mean "{found[near[0]]}"?' if near else ""


def require_si_unit(text: Any, what: str) -> None:
    """Refuse a unit that is not SI: inside, a unit that scales numbers invites mistakes.

    Parameters
    ----------
    text
        Unit as the user wrote it.
    what
        Quantity of the unit.

    Raises
    ------
    PeriluneError
        With `what`, the quantity of the unit, in the message.
    """
    require_type(text, str, f"the unit of {what}", 'write for example "m/s"')
    factor, dimension = parse_unit(text)
    if factor != 1.0:
        raise PeriluneError(
            f"inside a problem numbers are in SI: {what}",
            got=f"the unit {text!r}",
            expected=repr(dimension_text(dimension)),
            advice="convert the number, or read it with perilune.core.units.parse_quantity",
        )


def dimension_text(dimension: Dimension) -> str:
    """Return the SI unit of a dimension, such as ``"m^3/s^2"``."""
    powers = [(n if abs(e) == 1 else f"{n}^{abs(e):g}", e) for n, e in zip(_BASE_NAMES, dimension, strict=True)]
    over, under = [text for text, e in powers if e > 0], [text for text, e in powers if e < 0]
    return "*".join(over or ["1"]) + "".join("/" + u for u in under)


def format_quantity(value: float, unit_text: str, digits: int = 6) -> str:
    """Format a value in SI for people: angles in degrees, no unit for a pure number.

    Parameters
    ----------
    value, unit_text
        In SI, with its SI unit.
    digits
        Significant digits.
    """
    if unit_text == "rad":
        value, unit_text = math.degrees(value), "deg"
    return f"{value:z.{digits}g} {unit_text}".removesuffix(" 1")


def format_bound(value: float, unit_text: str, side: str, digits: int = 5) -> str:
    """Return a bound for people, rounded so that what lies on it is within: a `lower` one down, an `upper` one up.

    Parameters
    ----------
    value, unit_text
        In SI, with its SI unit.
    side
        ``lower`` or ``upper``.
    digits
        Significant digits.
    """
    if unit_text == "rad":
        value, unit_text = math.degrees(value), "deg"
    if value and math.isfinite(value):
        step = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - digits)
        value = (math.floor if side == "lower" else math.ceil)(value / step) * step
    return f"{value:.{digits}g} {unit_text}".removesuffix(" 1")


def format_value_range(values: Iterable[float], unit_text: str) -> str:
    """Format the range of finite values, as ``-3 kg to 4.5 kg``; one value if all are equal, empty for none.

    Parameters
    ----------
    values
        Values in SI; those not finite are ignored.
    unit_text
        SI unit.
    """
    finite = [value for value in values if math.isfinite(value)]
    ends = (format_quantity(end, unit_text) for end in (min(finite), max(finite))) if finite else ()
    return " to ".join(dict.fromkeys(ends))


def quotient_unit(numerator: str, denominator: str) -> str:
    """Return the SI unit of a quotient of two units, as of a costate.

    Parameters
    ----------
    numerator, denominator
        Units, as ``kg`` and ``m/s``.
    """
    above, below = parse_unit(numerator)[1], parse_unit(denominator)[1]
    a, b, c, d = (x - y for x, y in zip(above, below, strict=True))
    return dimension_text((a, b, c, d))


def parse_quantity(text: str, expected_unit: str, example: str = "", hint: str = "") -> float:
    """Parse a quantity such as ``"15 km"`` into its value in SI.

    Parameters
    ----------
    text
        Number and unit.
    expected_unit
        Any unit of the dimension that is wanted here, for the check and the message.
    example, hint
        For the message: such a quantity, and what a wrong number or dimension comes from.

    Returns
    -------
    float
        The value in SI (radians for angles).

    Raises
    ------
    PeriluneError
        If it is no quantity, is not finite, or has another dimension.
    """
    match = _QUANTITY.fullmatch(text)
    such = f'for example "{example or _unit_example(expected_unit)}"'
    if match is None or not (match.group(2) or expected_unit == "1"):
        raise PeriluneError(
            "this is not a quantity: a number and a unit",
            got=repr(text[:60]),
            expected=such,
            advice=hint or "put the number and its unit in one pair of quotes",
        )
    try:
        factor, dimension = parse_unit(match.group(2))
    except PeriluneError as error:
        advice = error.advice or f"write {such}"
        raise PeriluneError(error.what, got=error.got, expected=error.expected, advice=advice) from None
    if dimension != parse_unit(expected_unit)[1]:
        raise PeriluneError(
            "the unit has the wrong dimension",
            got=f"{text!r}, which is in {dimension_text(dimension)}",
            expected=such,
            advice=hint or f"write it in {expected_unit}, or in another unit of that dimension",
        )
    value = float(match.group(1)) * factor
    if not math.isfinite(value):
        advice = hint or "write a number of plausible magnitude"
        raise PeriluneError("the value is not finite", got=repr(text[:60]), expected=such, advice=advice)
    return value


def exact_quantity(text: str) -> tuple[Fraction, int] | None:
    """Return the value in SI of a quantity with its decimals taken exactly.

    Parameters
    ----------
    text
        What `parse_quantity` reads.

    Returns
    -------
    number, power
        The value is number * pi^power; None where it is no rational number times a whole power of pi, as with the root
        of a kilometre.
    """
    match = _QUANTITY.fullmatch(text)
    if match is None:
        return None
    number, around = Fraction(match.group(1)), 0.0
    for name, power in _powers(match.group(2) or "1"):
        degrees = name == "deg"
        # Every other factor is a decimal of a few digits, which are those of its double.
        factor = _EXACT.get(name) or Fraction(repr(_UNITS[name][0]))
        size = Fraction(1, 180) if degrees else factor
        around += power * degrees
        if not power.is_integer():
            size, power = Fraction(math.isqrt(size.numerator), math.isqrt(size.denominator)), 2 * power
            if degrees or size**2 != factor:
                return None
        number *= size ** int(power)
    return number, int(around)


def _unit_example(unit_text: str) -> str:
    return f"100 {unit_text}" if unit_text != "1" else "1.0"


_LARGEST = 1e15  # of a scale in SI: a tenth of a light year


@check_call
@dataclass(frozen=True, kw_only=True)
class Scales:
    """Scales of length [m], time [s], mass [kg] and temperature [K] that make the numbers of a problem of order one."""

    length: float = 1.0
    time: float = 1.0
    mass: float = 1.0
    temperature: float = 1.0

    def __post_init__(self) -> None:
        for name in ("length", "time", "mass", "temperature"):
            value = getattr(self, name)
            number = isinstance(value, Real) and not isinstance(value, bool)
            if not number or not 1 / _LARGEST <= float(value) <= _LARGEST:
                got, expected = f"{str(value)[:60]} in SI", f"{1 / _LARGEST:g} to {_LARGEST:g}"
                raise PeriluneError(f"this is not a valid scale of a {name}", got=got, expected=expected)
            object.__setattr__(self, name, float(value))  # numpy's numbers show in every answer, and are slow alone

    @cached_property
    def _sizes(self) -> dict[str, float]:
        return {}  # asked for a score of times in each solve

    def of(self, unit_text: str) -> float:
        """Return the SI size of one canonical unit of the given unit's dimension: ``canonical = SI / scale``."""
        size = self._sizes.get(unit_text) if isinstance(unit_text, str) else None
        if size is None:
            if not isinstance(unit_text, str):
                raise PeriluneError("this is not a unit", got=repr(unit_text)[:60], expected='a text, as "km/s"')
            a, b, c, d = parse_unit(unit_text)[1]
            size = self._sizes[unit_text] = self.length**a * self.time**b * self.mass**c * self.temperature**d
        return size
