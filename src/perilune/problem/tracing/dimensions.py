"""Dimensional analysis of formulas: carries dimensions through their operations, to find where units are mixed.

Called once the physics is known to be inhomogeneous, to name the place in the user's words; and for every comparison,
as values of both sides in other units need not show a mismatch. Zero has any dimension, and so has what is not finite.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from perilune.core import Dimension, dimension_text, parse_unit
from perilune.problem.tracing.tape import ROLES, Expression, Tape, operands

_NONE: Dimension = (0, 0, 0, 0)
_COMPARISONS = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}
_INFIX = {**_COMPARISONS, "add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "**"}
_ALIKE = {*_COMPARISONS, "add", "sub", "atan2", "fmin", "fmax", "where"}  # whose last two operands have one unit
_BARE = {*_COMPARISONS, "atan2"}  # of these, what leaves a number without a unit
_SAME = {"neg", "fabs"}
_BINDING = {"add": 1, "sub": 1, "neg": 2, "mul": 3, "div": 3, "pow": 4}
_LONGEST = 64  # characters of a formula in a message


@dataclass(frozen=True)
class Clash:
    """An error of units in a formula: what it has, and what would be right."""

    got: str
    expected: str


def clash(expression: Expression, output: int, unit_of: Callable[[str, str], str], wanted: str) -> Clash | None:
    """Find the first operation of an output that mixes units, or its own unit if wrong; None if all agrees.

    Parameters
    ----------
    expression, output
        The function as it was recorded, and which of its values.
    unit_of
        Unit of a component of a record, ``unit_of("x", "v")``.
    wanted
        Unit that the value should have.
    """
    walk = _DimensionWalk(expression.tape, unit_of)
    place = expression.tape.outputs[output]
    for number in sorted(_needed(expression.tape, place)):
        if (found := walk.visit(number)) is not None:
            return found
    has = walk.dimensions[place]
    if has is None or has == parse_unit(wanted)[1]:
        return None
    return Clash(walk.told(place), f"a quantity in {_dimension_name(parse_unit(wanted)[1])}")


def mixed_comparison(expression: Expression, unit_of: Callable[[str, str], str]) -> Clash | None:
    """Find the first comparison of two units. Other operations may mix them: ``xp.fmax(distance, 1e-300)`` is fine.

    Parameters
    ----------
    expression
        Traced function.
    unit_of
        Returns the unit of an input by its role and name.

    Returns
    -------
    Clash | None
        Units that were found, and what would be right; None where all comparisons agree.
    """
    instructions = expression.tape.instructions
    if not any(op[0] in _COMPARISONS for op in instructions):
        return None
    walk = _DimensionWalk(expression.tape, unit_of)
    found = ((op[0], walk.visit(number)) for number, op in enumerate(instructions))
    return next((mixed for name, mixed in found if mixed is not None and name in _COMPARISONS), None)


def _needed(tape: Tape, place: int) -> set[int]:
    needed, waiting = set[int](), [place]
    while waiting:
        number = waiting.pop()
        if number not in needed:
            needed.add(number)
            waiting += operands(tape.instructions[number])
    return needed


@dataclass
class _DimensionWalk:
    """Dimensions of the values met so far, by their place; None fits anything."""

    tape: Tape
    unit_of: Callable[[str, str], str]
    dimensions: dict[int, Dimension | None] = field(default_factory=dict)

    def visit(self, number: int) -> Clash | None:
        """Find the dimension of one value, and what is wrong with it."""
        name, *rest = self.tape.instructions[number]
        of = [self.dimensions[i] for i in operands(self.tape.instructions[number])]
        found: Dimension | None = _NONE
        wrong: Clash | None = None
        if name in ROLES:
            found = parse_unit("s" if name == "t" else self.unit_of(name, rest[0]))[1]
        elif name == "const":
            found = _NONE if math.isfinite(float(rest[0])) and float(rest[0]) else None
        elif name in _ALIKE:
            a, b = of[-2:]
            if a is not None and b is not None and a != b:
                first, second = (self.told(place) for place in rest[-2:])
                wrong = Clash(f"{first}, beside {second}, in {self.text(number)}", "the same unit for both")
            found = _NONE if name in _BARE else a or b if a != _NONE else b or a
        elif name in ("mul", "div"):
            found = _product(of[0], of[1], 1 if name == "mul" else -1)
        elif name == "pow" and (power := self._number(rest[1])) is not None:
            found = _raise_dimension(of[0], power)
        elif name == "sqrt":
            found = _raise_dimension(of[0], 0.5)
        elif name in _SAME:
            found = of[0]
        elif any(dimension not in (None, _NONE) for dimension in of):
            told = next(self.told(i) for i, dimension in zip(rest, of, strict=False) if dimension not in (None, _NONE))
            wrong = Clash(f"{told}, in {self.text(number)}", "a number without a unit there")
        self.dimensions[number] = found
        return wrong

    def told(self, place: int) -> str:
        """Format a value and its unit."""
        dimension = self.dimensions[place] or _NONE
        return f"{self.text(place)} {'without a unit' if dimension == _NONE else 'in ' + _dimension_name(dimension)}"

    def text(self, place: int) -> str:
        """Format a value as its formula, shortened where it is long."""
        whole = self._formula(place, depth=6)
        return whole if len(whole) <= _LONGEST else f"{whole[:_LONGEST]}..."

    def _number(self, place: int) -> float | None:
        name, *rest = self.tape.instructions[place]
        return float(rest[0]) if name == "const" else None

    def _formula(self, place: int, depth: int) -> str:
        name, *rest = self.tape.instructions[place]
        if name in ROLES:
            return f"{name}.{rest[0]}" if rest[0] else name
        if name == "const":
            return f"{float(rest[0]):g}"
        if depth == 0:
            return "..."
        parts = [self._formula(i, depth - 1) for i in operands(self.tape.instructions[place])]
        if name not in _INFIX and name != "neg":
            return f"xp.{name}({', '.join(parts)})"
        inner = [self.tape.instructions[i][0] for i in operands(self.tape.instructions[place])]
        binds = _BINDING.get(name, 0)
        parts = [
            f"({part})" if _BINDING.get(op, 9) < binds or (k and _BINDING.get(op, 9) == binds) else part
            for k, (part, op) in enumerate(zip(parts, inner, strict=True))
        ]
        if name == "neg":
            return f"-{parts[0]}"
        sign = _INFIX[name]
        return f"{parts[0]}{sign}{parts[1]}" if binds > 2 else f"{parts[0]} {sign} {parts[1]}"


def _dimension_name(dimension: Dimension) -> str:
    return next((name for name in ("N", "J", "W", "Pa") if parse_unit(name)[1] == dimension), dimension_text(dimension))


def _product(a: Dimension | None, b: Dimension | None, sign: int) -> Dimension | None:
    if a is None or b is None:
        return None
    length, time, mass, temperature = (x + sign * y for x, y in zip(a, b, strict=True))
    return length, time, mass, temperature


def _raise_dimension(a: Dimension | None, power: float) -> Dimension | None:
    if a is None:
        return None
    length, time, mass, temperature = (x * power for x in a)
    return length, time, mass, temperature
