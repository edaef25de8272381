"""Variables of a problem other than controls: states, conditions, given and free parameters. All in SI."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from perilune.core import (
    NUMERIC,
    PeriluneError,
    RenamedAttribute,
    check_call,
    renamed_keywords,
    require_identifier,
    require_si_number,
    require_si_unit,
    require_type,
    stated_text,
)
from perilune.problem.controls import Limit, demand_limits, limit_value


def positive_scale(name: str, scale: Any) -> float | None:
    """Return the size of a canonical unit, where one is stated.

    Parameters
    ----------
    name
        Name of the variable in messages.
    scale
        Size [SI], None where not stated.

    Raises
    ------
    PeriluneError
        If it is not a positive, finite number.
    """
    if scale is None:
        return None
    number = isinstance(scale, (int, float)) and not isinstance(scale, bool)  # NumPy's float64 is a float
    if not (number and 0 < scale < math.inf):
        raise PeriluneError(
            f"the scale of {name} is not a magnitude",
            got=repr(scale)[:60],
            expected="a positive, finite number in SI",
            advice="state its typical magnitude, in its unit; without a scale that of the unit is used"
            " (Problem.scales)",
        )
    return float(scale)


@check_call
@dataclass(frozen=True, kw_only=True)
class Variable:
    """A named component with its unit: a state, a condition at the end or on the way, or an output.

    `lower` and `upper` bound a state, in SI: a number, or the name of the given parameter that is the bound. An end
    condition with one of them is a range: its value has to lie between the bounds, and not to vanish. `label` is its
    name on the axis of a figure, where that is not `name` with blanks.

    `scale` is the size of a state or condition in SI, where it is not of the size of its unit in `Problem.scales`: an
    altitude next to a downrange, a heat load of 1e8 J/m^2. The methods compute in it; it does not change the answer.
    """

    name: str
    unit: str = "1"
    lower: Limit = -math.inf
    upper: Limit = math.inf
    description: str = ""
    label: str = ""
    scale: float | None = None

    def __post_init__(self) -> None:
        require_identifier(self.name)
        require_si_unit(self.unit, self.name)
        object.__setattr__(self, "scale", positive_scale(self.name, self.scale))
        demand_limits(self)
        if not (isinstance(self.lower, str) or isinstance(self.upper, str) or self.lower < self.upper):
            raise PeriluneError(
                f"bounds of {self.name} are empty",
                got=f"[{self.lower}, {self.upper}]",
                expected="lower < upper",
            )

    @property
    def ranged(self) -> bool:
        """Return True if an end condition of this name is a range and no equality."""
        return any(isinstance(limit, str) or math.isfinite(limit) for limit in (self.lower, self.upper))

    def limits(self, p: Any) -> tuple[Any, Any]:
        """Return the bounds in SI; those that are parameters from the record p."""
        return limit_value(self.lower, p), limit_value(self.upper, p)

    def missed(self, value: Any, p: Any) -> Any:
        """Return by how much an end condition of this value is missed, 0 where it is met; a number or an array.

        Parameters
        ----------
        value
            Value of the condition [SI].
        p
            Parameters [SI], with the bounds that are named.
        """
        lower, upper = self.limits(p)
        return value - NUMERIC.fmin(NUMERIC.fmax(value, lower), upper) if self.ranged else value


@check_call
@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter with a value in SI and its SI unit.

    `stated` is the decimal text and unit in which a person stated it; a Python float is itself, and has none.
    """

    value: float
    unit: str = "1"
    stated: str = ""

    def __post_init__(self) -> None:
        require_si_unit(self.unit, "a given value")
        if not self.stated:
            object.__setattr__(self, "stated", stated_text(self.value))
        require_si_number(self.value, "a given value")
        object.__setattr__(self, "value", float(self.value))


def given_as(name: str, value: Any, unit: str) -> Parameter:
    """Return a given parameter of this value in SI; `name` is named in a refusal.

    Parameters
    ----------
    name
        Name of the parameter, for the message of a refusal.
    value
        Value in SI.
    unit
        Its SI unit.
    """
    require_si_number(value, f"a value of {name}")
    return Parameter(value=value, unit=unit)


@renamed_keywords(typical="guess")
@check_call
@dataclass(frozen=True, kw_only=True)
class FreeParameter:
    """A parameter that the optimiser chooses, in SI.

    `guess` is its order of magnitude (a first value for methods that need one); a bound that is reached is reported
    as an extremal of its own.
    """

    name: str
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf
    guess: float = 1.0
    typical: ClassVar[RenamedAttribute] = RenamedAttribute("guess")

    def __post_init__(self) -> None:
        require_type(self.name, str, "the name of a free parameter")
        require_si_unit(self.unit, self.name)
        for side in ("lower", "upper"):
            require_si_number(getattr(self, side), f"the {side} bound of {self.name}", f"omit {side} for no bound")
        require_si_number(self.guess, f"the guess of {self.name}")
