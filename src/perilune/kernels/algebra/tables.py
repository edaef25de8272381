"""Tables in a program: nested choices between constants become one interval search and one lookup.

CasADi writes a table of pieces as a choice for each knot, ``if x >= knot: this number, else what was chosen before``,
and that for each coefficient: thousands of operations. The place of x among the knots is found once, and each
coefficient is read there. The numbers are the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Instruction = tuple[Any, ...]  # as a program has them
_LEAVES = ("input", "const", "table")
_LEAST = 4  # knots of a table that is read; of fewer the choices cost less


@dataclass(frozen=True)
class _ChoiceChain:
    """Values between knots of x, one more than these."""

    x: int
    knots: tuple[float, ...]
    values: tuple[float, ...]


class _ChoiceChains:
    """The values of a program that are chains, in order of computation."""

    def __init__(self, instructions: tuple[Instruction, ...]) -> None:
        self._of, self.found = instructions, dict[int, _ChoiceChain]()
        chosen = {number for number, one in enumerate(instructions) if one[0] == "if_else_zero"}
        for number, (op, *operands) in enumerate(instructions) if chosen else ():
            begins = number in chosen or (op == "add" and chosen.issuperset(operands))
            if begins and (chain := self._chain(number)) is not None:
                self.found[number] = chain

    def _chain(self, number: int) -> _ChoiceChain | None:
        """Return the chain of an ``if condition: yes, else no``, of which CasADi leaves out what is 0; None if none."""
        op, *operands = self._of[number]
        parts = operands if op == "add" else [number] if op == "if_else_zero" else []
        yes, no = dict[int, int](), dict[int, int]()  # the value by its condition
        for part in parts:
            condition, value = self._of[part][1:]
            opposite = self._of[condition][0] == "not"
            (no if opposite else yes)[self._of[condition][1] if opposite else condition] = value
        if len(parts) != len(yes) + len(no) or len({*yes, *no}) != 1:
            return None
        (condition,) = {*yes, *no}
        number_there = self._number(yes[condition]) if yes else 0.0
        return self._longer(condition, number_there, no.get(condition))

    def _longer(self, condition: int, value: float | None, before: int | None) -> _ChoiceChain | None:
        """Return the chain of what is chosen before, with a number from a knot on; None where it is none."""
        op, *operands = self._of[condition]
        if op != "le" or value is None:
            return None
        (knot, x), start = (self._number(operands[0]), operands[1]), 0.0 if before is None else self._number(before)
        if knot is None:
            return None
        if start is not None:
            return _ChoiceChain(x, (knot,), (start, value))
        known = None if before is None else self.found.get(before)
        if known is None or known.x != x or not known.knots[-1] < knot:
            return None
        return _ChoiceChain(x, (*known.knots, knot), (*known.values, value))

    def _number(self, number: int) -> float | None:
        instruction = self._of[number]
        return float.fromhex(instruction[1]) if instruction[0] == "const" else None


def with_tables(
    program: tuple[Instruction, ...], outputs: tuple[int, ...]
) -> tuple[tuple[Instruction, ...], tuple[int, ...]]:
    """Return instructions and outputs of a program with long chains read off tables, and without their parts.

    Parameters
    ----------
    program
        Instructions in the order of their computation; an operand is the index of an earlier instruction.
    outputs
        Indices of the instructions that the program returns.
    """
    chains = {n: c for n, c in _ChoiceChains(program).found.items() if len(c.knots) >= _LEAST}
    if not chains:
        return program, outputs
    instructions, place = list[Instruction](), dict[int, int]()
    known = dict[tuple[float, ...], int]()

    def table(values: tuple[float, ...]) -> int:
        if values not in known:
            known[values] = len(instructions)
            instructions.append(("table", tuple(value.hex() for value in values)))
        return known[values]

    for number in _used_after_tables(program, outputs, chains):
        instruction = program[number]
        if (chain := chains.get(number)) is not None:
            at = table(chain.knots), table(tuple(value + 0.0 for value in chain.values))
            instruction = ("read", place[chain.x], *at)
        elif instruction[0] not in _LEAVES:
            instruction = (instruction[0], *(place[i] for i in instruction[1:]))
        place[number] = len(instructions)
        instructions.append(instruction)
    return tuple(instructions), tuple(place[i] for i in outputs)


def _used_after_tables(
    program: tuple[Instruction, ...], outputs: tuple[int, ...], chains: Mapping[int, _ChoiceChain]
) -> list[int]:
    """Return the values in use once chains are read off tables: of all that a chain is made of only x."""
    used = set(outputs)
    for number in reversed(range(len(program))):
        if number in used:
            op, *operands = program[number]
            used |= {chains[number].x} if number in chains else set() if op in _LEAVES else {*operands}
    return sorted(used)
