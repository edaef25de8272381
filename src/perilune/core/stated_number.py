"""Numbers in SI that remember the text in which they were stated."""

from __future__ import annotations

from typing import Any


class StatedNumber(float):
    """Number in SI that remembers the decimal text and unit in which it was stated; results of computing do not."""

    text: str

    def __new__(cls, value: float, text: str) -> StatedNumber:
        """Number and text."""
        number = super().__new__(cls, value)
        number.text = text
        return number

    def __reduce__(self) -> tuple[Any, ...]:
        return StatedNumber, (float(self), self.text)


def stated_text(value: float) -> str:
    """Return the text in which a value was stated; empty for a plain number."""
    return value.text if isinstance(value, StatedNumber) else ""
