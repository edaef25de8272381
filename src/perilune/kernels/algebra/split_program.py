"""Partition of a long program into several, each of which passes on the values that later ones need.

What LLVM spends on a function grows faster than its length: forty thousand values in one take more than twice as long
as in pieces. Few values are needed across a border, and those wait in memory for most of a long function anyway.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from perilune.kernels.algebra.program import PLAIN, Instruction, Program, instruction_operands

#: Instructions in a piece.
MOST = 2000
#: The argument of a piece that holds what pieces before it have handed on.
HELD = -1


@dataclass(frozen=True)
class Piece:
    """A stretch of a program.

    Attributes
    ----------
    instructions
        As in a `Program`; an input of the argument `HELD` is a value of a piece before.
    results
        Index in the result of the whole -> the instruction that it is.
    kept
        Place among what is held -> the instruction whose value is handed on there.
    """

    instructions: Sequence[Instruction]
    results: Mapping[int, int]
    kept: Mapping[int, int]


def split_program(program: Program) -> tuple[list[Piece], int]:
    """Divide a program.

    Returns
    -------
    pieces, held
        In order, one where the program is short; and how many values are held at most. A piece keeps no value where
        it reads another.
    """
    count = len(program.instructions)
    number = max(-(-count // MOST), 1)
    length = -(-count // number)
    last = {used: n // length for n, one in enumerate(program.instructions) for used in instruction_operands(one)}
    wanted: dict[int, list[int]] = {}
    for index, n in enumerate(program.outputs):
        wanted.setdefault(n, []).append(index)
    found, free, held = list[Piece](), list[int](), 0
    place: dict[int, int] = {}  # among what is held
    for k in range(number):
        inside = _PieceBuilder(program, place)
        results, kept = dict[int, int](), dict[int, int]()
        for n in range(k * length, min((k + 1) * length, count)):
            computed = program.instructions[n][0] not in PLAIN
            if computed:
                inside.compute(n)
            results |= {index: inside.at(n) for index in wanted.get(n, ())}
            if computed and last.get(n, k) > k:
                if free:
                    place[n] = free.pop()
                else:
                    place[n], held = held, held + 1
                kept[place[n]] = inside.at(n)
        free += [place[n] for n in place if last[n] == k]
        found.append(Piece(inside.instructions, results, kept))
    return found, held


class _PieceBuilder:
    """The instructions of a piece in the making."""

    def __init__(self, program: Program, place: Mapping[int, int]) -> None:
        self.instructions: list[Instruction] = []
        self._program, self._place = program, place
        self._at: dict[int, int] = {}  # number in the program -> number here

    def at(self, n: int) -> int:
        """Return the place of a value here: what is plain is written again, what was computed before is read."""
        if n not in self._at:
            one = self._program.instructions[n]
            self._add(n, one if one[0] in PLAIN else ("input", HELD, self._place[n]))
        return self._at[n]

    def compute(self, n: int) -> None:
        """Append an operation of the program."""
        one = self._program.instructions[n]
        self._add(n, (one[0], *map(self.at, instruction_operands(one))))

    def _add(self, n: int, instruction: Instruction) -> None:
        self._at[n] = len(self.instructions)
        self.instructions.append(instruction)
