"""Straight-line program of a traced expression: read from CasADi, numbered, simplified.

CasADi keeps an SX function as a tape of elementary operations that reuse work slots. Here the tape becomes a
list of values in which each is computed once (value numbering: equal operations on equal values are one
value), so the physics, its derivatives and its variational columns share all that they have in common. Three
rewrites make it cheaper and keep its meaning but for rounding: several divisions by one value become
one reciprocal, constant powers become products and square roots, and what depends on parameters only is
hoisted out (`hoist`).

Choices by which CasADi writes tables are read off them (`tables`).

Source of value numbering: Cocke & Schwartz, *Programming Languages and Their Compilers*, 1970.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from functools import cache
from typing import Any

from perilune.core import PeriluneError
from perilune.kernels.algebra.tables import with_tables

#: Operations by CasADi's name for them (without ``OP_``), and ours.
OPERATIONS = {
    "ADD": "add", "SUB": "sub", "MUL": "mul", "DIV": "div", "NEG": "neg", "SQRT": "sqrt", "SQ": "sq",
    "TWICE": "twice", "INV": "inv", "POW": "pow", "CONSTPOW": "pow", "EXP": "exp", "LOG": "log", "SIN":
    "sin", "COS": "cos", "TAN": "tan", "ASIN": "asin", "ACOS": "acos", "ATAN": "atan", "ATAN2": "atan2",
    "SINH": "sinh", "COSH": "cosh", "TANH": "tanh", "ASINH": "asinh", "ACOSH": "acosh", "ATANH": "atanh",
    "LOG1P": "log1p", "EXPM1": "expm1", "HYPOT": "hypot", "FABS": "fabs", "FMIN": "fmin", "FMAX": "fmax",
    "FLOOR": "floor", "CEIL": "ceil", "SIGN": "sign", "COPYSIGN": "copysign", "LT": "lt", "LE": "le", "EQ":
    "eq", "NE": "ne", "NOT": "not", "AND": "and", "OR": "or", "IF_ELSE_ZERO": "if_else_zero", "ASSIGN":
    "assign",
}  # fmt: skip

_COMMUTATIVE = {"add", "mul", "eq", "ne", "and", "or"}
#: Operations that a processor with fused multiply-add does at full rate: what a share of its peak counts.
ARITHMETIC = {"add", "sub", "mul", "neg"}

#: Instructions without operands.
PLAIN = ("input", "const", "table")

# An instruction: ("input", argument, index), ("const", value), ("table", values) or (operation, operand, ...), operands
# being indices. ("read", x, knots, values) is that one of the values, of which there is one more than knots, at the
# place of x among the knots.
Instruction = tuple[Any, ...]


@dataclass(frozen=True)
class Program:
    """Values in order of computation, and those that are the results.

    Attributes
    ----------
    instructions
        Value i is what instruction i computes from values before it.
    outputs
        The result as indices into `instructions`.
    """

    instructions: tuple[Instruction, ...]
    outputs: tuple[int, ...]

    @property
    def cost(self) -> int:
        """Operations counted with the weight that a vector unit gives them."""
        weights = {"input": 0, "const": 0, "table": 0, "div": 6, "sqrt": 7}
        return sum(weights.get(op[0], 1 if op[0] in ARITHMETIC else 20) for op in self.instructions)

    @property
    def operations(self) -> Counter[str]:
        """Count how often each operation occurs."""
        return Counter(op[0] for op in self.instructions if op[0] not in PLAIN)


class _Numbering:
    """Appends operations, simplified, each distinct one once."""

    def __init__(self, shared_divisors: frozenset[int] = frozenset()) -> None:
        self.instructions: list[Instruction] = []
        self._index: dict[Instruction, int] = {}
        self._shared_divisors = shared_divisors  # those of the program being rewritten

    def append(self, instruction: Instruction) -> int:
        number = self._index.get(instruction)
        if number is None:
            number = self._index[instruction] = len(self.instructions)
            self.instructions.append(instruction)
        return number

    def const(self, value: float) -> int:
        # The sign of zero and NaN are part of a constant; their bits distinguish them where == does not.
        return self.append(("const", float(value).hex()))

    def value(self, number: int) -> float | None:
        instruction = self.instructions[number]
        return float.fromhex(instruction[1]) if instruction[0] == "const" else None

    def do(self, op: str, *operands: int) -> int:
        """Append one operation after the rewrites that need no knowledge of its uses."""
        if op in ("add", "sub"):
            return self._sum(op, *operands)
        if op == "assign":
            return operands[0]
        if op == "sq":
            return self.do("mul", operands[0], operands[0])
        if op == "twice":
            return self.do("add", operands[0], operands[0])
        if op == "inv":
            return self.do("div", self.const(1.0), operands[0])
        if op == "pow":
            return self._power(*operands)
        if op == "div" and (divisor := self.value(operands[1])) and math.isfinite(1 / divisor):
            return self.do("mul", operands[0], self.const(1 / divisor))
        if op == "mul":
            for one, other in (operands, operands[::-1]):
                if self.value(one) == 1.0:
                    return other
                if self.value(one) == -1.0:
                    return self.do("neg", other)
        if op == "neg" and self.instructions[operands[0]][0] == "neg":
            return self.instructions[operands[0]][1]
        if op in _COMMUTATIVE and operands[0] > operands[1]:
            operands = operands[::-1]
        return self.append((op, *operands))

    def _sum(self, op: str, left: int, right: int) -> int:
        """Simplify a sum: a + (-b) is a - b, and a - (-b) is a + b; adding zero is nothing."""
        if self.instructions[right][0] == "neg":
            return self._sum("sub" if op == "add" else "add", left, self.instructions[right][1])
        if op == "add" and self.instructions[left][0] == "neg":
            return self._sum("sub", right, self.instructions[left][1])
        if self.value(right) == 0.0:
            return left
        if self.value(left) == 0.0:
            return right if op == "add" else self.do("neg", right)
        return self.append((op, right, left) if op == "add" and left > right else (op, left, right))

    def _power(self, base: int, exponent: int) -> int:
        """Write whole and half powers up to 16 by repeated squaring and a square root."""
        power = self.value(exponent)
        if power is None or 2 * power != int(2 * power) or abs(power) > 16:
            return self.append(("pow", base, exponent))
        whole, half = divmod(int(abs(2 * power)), 2)
        result = self.do("sqrt", base) if half else None
        square = base
        while whole:
            if whole & 1:
                result = square if result is None else self.do("mul", result, square)
            whole >>= 1
            if whole:
                square = self.do("mul", square, square)
        if result is None:
            return self.const(1.0)
        return self.do("inv", result) if power < 0 else result

    def rewrite(self, program: Program) -> list[int]:
        """Append a program; returns where its values went."""
        place: list[int] = []
        for number, (op, *operands) in enumerate(program.instructions):
            if op in PLAIN:
                place.append(self.append(program.instructions[number]))
            elif op == "div" and operands[1] in self._shared_divisors:
                place.append(self.do("mul", place[operands[0]], self.do("inv", place[operands[1]])))
            else:
                place.append(self.do(op, *[place[i] for i in operands]))
        return place


@cache
def _operation_names() -> dict[int, str]:
    import casadi as ca

    return {getattr(ca, f"OP_{name}"): ours for name, ours in OPERATIONS.items() if hasattr(ca, f"OP_{name}")}


@cache
def _casadi_names() -> dict[int, str]:
    import casadi as ca

    return {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}


def trace_function(function: Any) -> Program:
    """Read an SX `casadi.Function` as a program.

    Parameters
    ----------
    function
        A ``casadi.Function`` made of SX expressions; the nonzeros of its outputs, one output after another,
        become the result.

    Raises
    ------
    PeriluneError
        On an operation that the emitter does not know, by its name, or on a function that is not SX.
    """
    import casadi as ca

    if not function.is_a("SXFunction"):
        raise PeriluneError(
            "only SX functions can be compiled",
            got=f"{function.class_name()} {function.name()!r}",
            expected="SXFunction",
            advice="trace the physics on casadi.SX, or call expand()",
        )
    names = _operation_names()
    numbering = _Numbering()
    slots: dict[int, int] = {}
    results: dict[tuple[int, int], int] = {}
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        if op == ca.OP_OUTPUT:
            results[tuple(function.instruction_output(k))] = slots[function.instruction_input(k)[0]]
            continue
        target = function.instruction_output(k)[0]
        if op == ca.OP_CONST:
            slots[target] = numbering.const(function.instruction_constant(k))
        elif op == ca.OP_INPUT:
            slots[target] = numbering.append(("input", *function.instruction_input(k)))
        elif op in names:
            slots[target] = numbering.do(names[op], *[slots[i] for i in function.instruction_input(k)])
        else:
            raise PeriluneError(
                f"the operation {_casadi_names().get(op, op)} in {function.name()!r} has no machine code",
                expected="one of " + ", ".join(sorted(set(OPERATIONS.values()) - {"assign"})),
                advice="write the model without it, or integrate it by SciPy (backend='scipy')",
            )
    zero = numbering.const(0.0)  # entries that casadi leaves out of the tape
    shape = [(i, j) for i in range(function.n_out()) for j in range(function.nnz_out(i))]
    return _simplify(Program(tuple(numbering.instructions), tuple(results.get(entry, zero) for entry in shape)))


def _simplify(program: Program) -> Program:
    """Share reciprocals of common divisors, then drop what no result needs."""
    divisors = Counter(op[2] for op in program.instructions if op[0] == "div")
    numbering = _Numbering(frozenset(number for number, uses in divisors.items() if uses > 1))
    place = numbering.rewrite(program)
    return _drop_unused(Program(*with_tables(tuple(numbering.instructions), tuple(place[i] for i in program.outputs))))


def instruction_operands(instruction: Instruction) -> tuple[int, ...]:
    """Return the values that an instruction is computed from."""
    return () if instruction[0] in PLAIN else instruction[1:]


def _drop_unused(program: Program) -> Program:
    instructions = program.instructions
    needed = set(program.outputs)
    for number in range(len(instructions) - 1, -1, -1):
        if number in needed and instructions[number][0] not in PLAIN:
            needed.update(instructions[number][1:])
    if len(needed) == len(instructions):
        return program
    place: dict[int, int] = {}
    kept: list[Instruction] = []
    for number in sorted(needed):
        instruction = instructions[number]
        place[number] = len(kept)
        if instruction[0] not in PLAIN:
            instruction = (instruction[0], *[place[i] for i in instruction[1:]])
        kept.append(instruction)
    return Program(tuple(kept), tuple(place[i] for i in program.outputs))


def hoist(program: Program, argument: int) -> tuple[Program, Program]:
    """Split off what depends on only one argument.

    Parameters
    ----------
    program
        Straight-line program of a traced function.
    argument
        Index of the argument (of the traced function) whose dependents are computed once, the parameters p as a rule.

    Returns
    -------
    before, during
        `before` computes from that argument a list of values, once; `during` is the program with those values
        in the argument's place. Running the one and then the other is the program.
    """
    alone: list[bool] = []
    for instruction in program.instructions:
        if instruction[0] == "input":
            alone.append(instruction[1] == argument)
        else:
            of = instruction_operands(instruction)
            plain = all(alone[i] or program.instructions[i][0] in ("const", "table") for i in of)
            alone.append(plain and any(alone[i] for i in of))
    used = set(program.outputs)
    for number, instruction in enumerate(program.instructions):
        if not alone[number]:
            used.update(instruction_operands(instruction))
    handed = [number for number in sorted(used) if alone[number]]
    before = _drop_unused(Program(program.instructions, tuple(handed)))
    position = {number: k for k, number in enumerate(handed)}
    body = tuple(
        ("input", argument, position[number]) if number in position else instruction
        for number, instruction in enumerate(program.instructions)
    )
    return before, _drop_unused(Program(body, program.outputs))
