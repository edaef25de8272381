"""Exact number of a given value: the decimal in which it was stated, or else the double."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb, fmpq

from perilune.problem.variables import Given
from perilune.rigorous.graph import Graph, GraphExpression
from perilune.rigorous.taylor import Ball
from perilune.words.outcome import PeriluneError
from perilune.words.units import exact_quantity, parse_quantity


@dataclass(frozen=True, kw_only=True)
class ExactValue:
    """rational * pi^power, and the text that says so; "" where the number is that of a double."""

    rational: Fraction
    power: int = 0
    text: str = ""

    def expression(self, graph: Graph) -> GraphExpression:
        """Return the number in a graph."""
        return graph.constant(self._fmpq) * graph.power(graph.pi(), self.power)

    def ball(self) -> Ball:
        """Return the number as a ball in the precision that is set."""
        return arb(self._fmpq) * arb.pi() ** self.power

    def document(self) -> dict[str, Any]:
        """Return the number as a certificate states it."""
        around = {"power_of_pi": self.power} if self.power else {}
        return {"taken": "text" if self.text else "double", "text": self.text, "number": str(self.rational)} | around

    @property
    def _fmpq(self) -> Any:
        return fmpq(self.rational.numerator, self.rational.denominator)


def exact_value(given: Given) -> ExactValue:
    """Return the exact number of a given value, of which a theorem is proved.

    A text that does not give the value in its unit is none: the solver would have flown something else.
    """
    try:
        told = bool(given.stated) and parse_quantity(given.stated, given.unit) == given.value
    except PeriluneError:
        told = False
    found = exact_quantity(given.stated) if told else None
    if found is not None:
        return ExactValue(rational=found[0], power=found[1], text=given.stated)
    return ExactValue(rational=Fraction(given.value))
