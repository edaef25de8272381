"""Engineering tolerance that may be stated for a proof: the admissible error of a flight, by quantity.

The limits of a proof follow from the problem, and are of the order of rounding. A user who needs less states how much
less; the proof then says so wherever it says what it proved.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from perilune.core import (
    RenamedAttribute,
    dimension_text,
    parse_unit,
    quantity,
    record,
    record_keys,
    record_values,
)

_NO_PROOF = "is too large for a proof"
LARGEST = 1e-3  # of the range of a quantity along the flight
SIZED = ("angle", "optimality")  # which have a size where no state is measured in them, 1
_SPOKEN = {"m": ("km", "m", "mm"), "m/s": ("m/s", "mm/s"), "kg": ("kg", "g"), "rad": ("deg",), "s": ("s", "ms")}


@record("proof")
class Tolerance:
    """Admissible differences, each in SI (angles in radians) and each left out unless it is stated.

    A limit of level 1 that compares quantities in m, m/s, kg, rad or s is raised to what is stated of them, a relative
    limit of level 2 to `optimality`. None is lowered, and what has another unit, or none, keeps its limit.

    Parameters
    ----------
    position, speed, mass, angle, time
        In m, m/s, kg, rad, s. Nothing is proved with more than a thousandth of what the flight changes in it; more than
        a thousandth of a radian is refused.
    optimality
        Of costates, H and its derivatives, relative to their sizes in the problem: at most 1e-3.
    """

    position: float | None = quantity("m", "1 mm", default=None, above=0.0, about="tolerance of lengths")
    speed: float | None = quantity("m/s", "1 mm/s", default=None, above=0.0, about="tolerance of speeds")
    mass: float | None = quantity("kg", "1 g", default=None, above=0.0, about="tolerance of masses")
    angle: float | None = quantity(
        "rad", "1e-4 deg", default=None, above=0.0, most=LARGEST, outside=_NO_PROOF, about="tolerance of angles"
    )
    time: float | None = quantity("s", "1 ms", default=None, above=0.0, about="tolerance of times")
    optimality: float | None = quantity(
        "1", "1e-6", default=None, above=0.0, most=LARGEST, outside=_NO_PROOF,
        about="relative tolerance of the conditions of optimality",
    )  # fmt: skip

    told: ClassVar[RenamedAttribute] = RenamedAttribute("describe")

    @property
    def stated(self) -> dict[str, float]:
        """Return the stated values, in SI, by name."""
        return {name: float(value) for name, value in record_values(self).items() if value is not None}

    def describe(self, names: Iterable[str] = ()) -> str:
        """Format what is stated of these (of all, if none is named): ``position 1 mm, mass 1 g``."""
        shown = {name: value for name, value in self.stated.items() if name in (tuple(names) or self.stated)}
        return ", ".join(f"{name} {format_tolerance(name, value)}" for name, value in shown.items())


def unit_of(name: str) -> str:
    """Return the SI unit of a quantity of the tolerance."""
    declared: Any = record_keys(Tolerance)[name].declared
    return declared.unit


def format_tolerance(name: str, value: float) -> str:
    """Format a value in the unit in which it is best read, the same however it was stated.

    Parameters
    ----------
    name
        Field of `Tolerance`.
    value
        Value [SI].
    """
    choices = _SPOKEN.get(unit_of(name), ("1",))
    best = next((text for text in choices if value >= parse_unit(text)[0]), choices[-1])
    return f"{value / parse_unit(best)[0]:.6g} {best}".removesuffix(" 1")


def quantity_in(unit_text: str) -> str:
    """Return the quantity that is measured in a unit; empty of one for which nothing can be stated.

    An angle is what is in radians: a number without a unit is none.
    """
    spoken = unit_text if unit_text == "rad" else dimension_text(parse_unit(unit_text)[1])
    return next((name for name in record_keys(Tolerance) if unit_of(name) == spoken != "1"), "")
