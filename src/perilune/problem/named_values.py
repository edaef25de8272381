"""Functions of a problem that return several values, each with its name and unit: conditions and quantities."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self

from perilune.core import (
    Asked,
    PeriluneError,
    Physics,
    require_callable,
    require_distinct,
    rewritten_keywords,
    warn_renamed,
    wrong_type_error,
)
from perilune.problem.variables import Variable


@dataclass(frozen=True, init=False, repr=False)
class NamedValues:
    """A function with the names and units of its values, in their order.

    Parameters
    ----------
    function
        Returns as many values as are named; of another record of this kind, its function is taken.
    variables
        Values with more than a unit: bounds, a description, a scale. They come first.
    units
        SI unit of each further value by its name, "1" for a plain number.

    Raises
    ------
    PeriluneError
        If no value is named, or a unit is not SI.
    """

    function: Physics
    variables: tuple[Variable, ...]

    def __init__(self, function: Physics | None = None, /, *variables: Variable, **units: str) -> None:
        what = type(self).__name__
        if function is None:
            raise wrong_type_error(function, "a function", f"the function of {what}")
        require_callable(function, f"the function of {what}")
        for variable in variables:
            if not isinstance(variable, Variable):
                example = variable if isinstance(variable, str) and variable.isidentifier() else "altitude"
                raise wrong_type_error(
                    variable, "Variable(...), or NAME=UNIT", f"a value of {what}", f'{what}(function, {example}="m")'
                )
        named = (*variables, *(Variable(name=name, unit=unit) for name, unit in units.items()))
        if not named:
            raise PeriluneError(
                f"{what} names no value",
                got="a function only",
                expected=f'{what}(function, altitude="m", speed="m/s")',
                advice="name each value that the function returns, in its order",
            )
        require_distinct(
            what.lower(), [variable.name for variable in named]
        )  # results and multipliers have their names
        own = function.function if isinstance(function, NamedValues) else function
        object.__setattr__(self, "function", own)
        object.__setattr__(self, "variables", named)

    @classmethod
    def of(cls, function: Physics | None, variables: Iterable[Variable]) -> Self | None:
        """Return the record of a function and the variables of its values; None where there are none.

        Parameters
        ----------
        function
            Returns the values; None where there are no variables.
        variables
            One for each value, in order.
        """
        named = tuple(variables)
        return cls(function, *named) if named else None  # type: ignore[arg-type]  # None is refused

    def with_function(self, function: Physics) -> Self:
        """Return the same names with another function."""
        return type(self)(function, *self.variables)

    def __call__(self, *arguments: Any) -> Any:
        """Return the values of the function."""
        return self.function(*arguments)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{v.name} [{v.unit}]' for v in self.variables)})"


class Conditions(NamedValues):
    """Conditions of a phase: ``Conditions(g, altitude="m", speed="m/s")``.

    Name the values of the function in their order, each with its SI unit; a `Variable` with bounds or a scale comes
    before these.
    """


class Quantities(NamedValues):
    """Quantities that a phase or a problem computes: ``Quantities(o, altitude="m", pitch="rad")``."""


# By the function of a phase or a problem: the old keyword of the row of its variables, and what it is now.
PAIRS: Mapping[str, tuple[str, type[NamedValues]]] = {
    "end": ("end_conditions", Conditions),
    "path": ("path_conditions", Conditions),
    "held": ("held_conditions", Conditions),
    "outputs": ("output_variables", Quantities),
    "integrals": ("integral_variables", Quantities),
    "end_outputs": ("mark_variables", Quantities),
    "results": ("result_variables", Quantities),
}


def named_variables(values: NamedValues | None) -> tuple[Variable, ...]:
    """Return the variables of named values, in order; none of None."""
    return () if values is None else values.variables


def accept_pairs(*functions: str) -> Callable[[Asked], Asked]:
    """Let a class or method take a function and the row of its variables by two keywords, as before `NamedValues`.

    Parameters
    ----------
    functions
        The fields, of `PAIRS`.
    """

    def joined(called: str, keywords: dict[str, Any]) -> dict[str, Any]:
        if old := [name for name in functions if PAIRS[name][0] in keywords]:
            for name in old:
                row, made = PAIRS[name]
                keywords[name] = made.of(keywords.get(name), _row(keywords.pop(row), row))
            row, made = PAIRS[old[0]]
            warn_renamed(f"{row}= of {called}", f'{old[0]}={made.__name__}(function, name="unit")', 3)
        return keywords

    return rewritten_keywords(joined)


def _row(variables: Any, name: str) -> Any:
    if isinstance(variables, str) or not isinstance(variables, Iterable):
        raise wrong_type_error(variables, "(Variable(...), ...)", f"a row of {name.replace('_', ' ')}")
    return variables


def require_named(values: Any, kind: type[NamedValues], what: str) -> None:
    """Refuse anything but a function with the names of its values, or None.

    Parameters
    ----------
    values, kind
        The value, and the record that it has to be.
    what
        Its use, for the message: "a valid value of `end` of a phase".

    Raises
    ------
    PeriluneError
        If it is neither.
    """
    if values is not None and not isinstance(values, kind):
        raise wrong_type_error(
            values,
            f'{kind.__name__}(function, altitude="m", ...)',
            what,
            "name each value with its unit; with_function(f) of the record before keeps its names",
        )
