"""How a text becomes a number in SI, and which slip stands behind one that cannot be right."""

from __future__ import annotations

import math
from dataclasses import dataclass

from perilune.words.outcome import PeriluneError
from perilune.words.units import parse_quantity

LONGEST_VALUE = 200  # characters


@dataclass(frozen=True)
class Quantity:
    """How one key's text becomes a number in SI.

    The wanted unit, an example, the range, and the slip behind a miss.
    """

    unit: str
    example: str
    low: float = -math.inf
    high: float = math.inf
    above_low: bool = True
    hint: str = ""

    def __call__(self, value: object) -> float:
        """Value in SI; PeriluneError with what is wrong, without the key."""
        if self.unit == "1" and _is_number(value):
            value = repr(value)  # without a unit there is nothing to guess
        if not isinstance(value, str):
            raise PeriluneError(
                "must be a number and a unit in quotes",
                got=f"{str(value)[:60]} without a unit" if _is_number(value) else str(value)[:60],
                expected=f'for example "{self.example}"',
                advice="a bare number is refused, as its unit could only be guessed",
            )
        if len(value) > LONGEST_VALUE:
            raise PeriluneError(
                "the text is too long",
                got=f"{len(value)} characters",
                expected=f'for example "{self.example}"',
                advice="a number and a unit, nothing else",
            )
        number = self._parse(value)
        if number < self.low or number > self.high or (self.above_low and number == self.low):
            raise PeriluneError(
                "is out of range",
                got=repr(value),
                expected=self._range(),
                advice=self.hint or f'for example "{self.example}"',
            )
        return number

    def _parse(self, text: str) -> float:
        try:
            return parse_quantity(text, self.unit)
        except PeriluneError as error:
            raise PeriluneError(
                error.what,
                got=error.got,
                expected=f'for example "{self.example}"',
                advice=self.hint or error.advice or "write a number of ordinary size",
            ) from None

    def _range(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        if math.isinf(self.high):
            return f"{'above' if self.above_low else 'at least'} {self.low:g}{unit}"
        return f"between {self.low:g} and {self.high:g}{unit}"


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
