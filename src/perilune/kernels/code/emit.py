"""Code generation: a straight-line program as a function of machine code, one lane per trajectory.

Each value of the program is one LLVM instruction on a vector of lanes; the arguments and the result are
buffers of vectors. LLVM chooses registers and order. A long program is several functions, called one after another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from perilune.kernels.algebra.program import Instruction, Program
from perilune.kernels.algebra.split_program import HELD, Piece, split_program
from perilune.kernels.code import vecmath
from perilune.kernels.code.ir import NUM, Bits, Mask, Num, Ptr, Vec, Writer

_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_INTRINSICS = {"sqrt", "fabs", "copysign", "floor", "ceil"}
_RECENT = 20  # operations for which an input read stays in a register; 12 to 32 measure the same
_CONSTANTS = HELD - 1  # the argument of a piece that holds those of its constants in which it differs from others
_WORTH_SHARING = 500  # instructions: in a shorter piece the call of what is shared would be felt
_COMPARISONS = {"lt": "olt", "le": "ole", "eq": "oeq", "ne": "une"}


@dataclass(frozen=True, kw_only=True)
class KernelSource:
    """A function of a module: ``void name(inputs..., result)``, each a pointer to vectors of lanes.

    Attributes
    ----------
    name
        Name of the function in the module, without ``@``.
    program
        Values to compute.
    arguments
        Arguments of the program that the function takes, in order.
    cleared
        Whether the result is handed over as zeros: those of a sparse matrix, most of it, are then not written.
    """

    name: str
    program: Program
    arguments: tuple[int, ...]
    cleared: bool = False


@dataclass(frozen=True)
class _Function:
    """A piece of a kernel: its name, what it takes, and the entries of the result that it does not write."""

    name: str
    piece: Piece
    arguments: tuple[int, ...]
    left: frozenset[int]

    @property
    def shape(self) -> Any:
        """All but the values of its constants."""
        piece = self.piece
        bare = tuple(one[:1] if one[0] == "const" else one for one in piece.instructions)
        return bare, *map(tuple, (piece.results.items(), piece.kept.items())), self.arguments, self.left


def emit_kernels(kernels: Iterable[KernelSource], width: int) -> str:
    """Return the IR of the kernels of a module.

    Modes of the dynamics are often the same equations with other numbers, as those of two layers of an atmosphere:
    long pieces that differ only in constants become one function, which takes those.

    Parameters
    ----------
    kernels
        Functions of the module.
    width
        Number of lanes.
    """
    made = [(kernel, *_pieces(kernel)) for kernel in kernels]
    alike: dict[Any, list[_Function]] = {}
    for function in (f for _, functions, _ in made for f in functions):
        long = len(function.piece.instructions) >= _WORTH_SHARING
        alike.setdefault(function.shape if long else function.name, []).append(function)
    texts, called = list[str](), dict[str, tuple[str, list[str]]]()
    for group in alike.values():
        merged, differing = _merge_constants(group)
        texts.append(_write_piece(merged, width))
        for function, values in zip(group, differing, strict=True):
            called[function.name] = merged.name, [f"@{function.name}.constants"] if values else []
            if values:
                texts.append(_write_constants(f"@{function.name}.constants", values, width))
    for kernel, functions, held in made:
        if called[functions[0].name] != (kernel.name, []):
            texts.append(_write_calls(kernel, functions, held, width, called))
    return "\n".join(texts)


def _pieces(kernel: KernelSource) -> tuple[list[_Function], int]:
    """Return a kernel in pieces, and how many values are held between them."""
    zero, program = ("const", (0.0).hex()), kernel.program
    left = frozenset(i for i, n in enumerate(program.outputs) if kernel.cleared and program.instructions[n] == zero)
    parts, held = split_program(program)
    if len(parts) == 1:
        return [_Function(kernel.name, parts[0], kernel.arguments, left)], held
    taken = (*kernel.arguments, HELD)
    return [_Function(f"{kernel.name}.{number}", part, taken, left) for number, part in enumerate(parts)], held


def _merge_constants(group: Sequence[_Function]) -> tuple[_Function, list[list[str]]]:
    """Return the function that all of one shape are, and the constants that each hands to it: those that differ."""
    first, bodies = group[0], [function.piece.instructions for function in group]
    if len(group) == 1:
        return first, [[]]
    merged, place = list(bodies[0]), dict[tuple[str, ...], int]()
    for number, one in enumerate(merged):
        values = tuple(body[number][1] for body in bodies) if one[0] == "const" else ()
        if len({*values}) > 1:
            merged[number] = "input", _CONSTANTS, place.setdefault(values, len(place))
    if not place:
        return first, [[] for _ in group]
    piece, taken = replace(first.piece, instructions=merged), (*first.arguments, _CONSTANTS)
    return _Function(f"{first.name}.shared", piece, taken, first.left), [[*of] for of in zip(*place, strict=True)]


def _write_constants(name: str, values: Iterable[str], width: int) -> str:
    """Write vectors of constants next to the functions."""
    w = Writer(width)
    vectors = [f"{w.vector} {w.const(float.fromhex(value))}" for value in values]
    kind = f"[{len(vectors)} x {w.vector}]"
    return f"{name} = internal constant {kind} [{', '.join(vectors)}], align {w.vector.align}\n"


def _write_calls(
    kernel: KernelSource,
    functions: Iterable[_Function],
    held: int,
    width: int,
    called: Mapping[str, tuple[str, list[str]]],
) -> str:
    """Write a kernel as calls of its pieces."""
    w = Writer(width)
    between = w.buffer(held)
    for function in functions:
        name, constants = called[function.name]
        taken = [str(between) if x == HELD else _argument(x) for x in function.arguments]
        w.run(f"call void @{name}({', '.join(f'ptr {x}' for x in (*taken, *constants, '%out'))})")
    return _define_body(kernel.name, kernel.arguments, w)


def _write_piece(function: _Function, width: int) -> str:
    """Write a piece as a function."""
    name, piece, arguments = function.name, function.piece, function.arguments
    w = Writer(width)
    fetch = _inputs(w, piece.instructions)
    names: dict[int, Vec] = {}
    tables: dict[int, Ptr[Num]] = {}
    found: dict[tuple[int, int], Bits] = {}  # places of values among knots
    places: dict[int, list[tuple[str, int]]] = {}
    for index, number in piece.results.items():
        if index not in function.left:
            places.setdefault(number, []).append(("%out", index))
    for index, number in piece.kept.items():
        places.setdefault(number, []).append((_argument(HELD), index))
    for number, (op, *operands) in enumerate(piece.instructions):
        if op == "const":
            names[number] = w.const(float.fromhex(operands[0]))
        elif op == "table":
            tables[number] = Ptr(f"@{name}.table{number}", NUM)
        elif op == "read":
            x, knots, values = operands
            if (x, knots) not in found:
                numbers = map(float.fromhex, piece.instructions[knots][1])
                found[x, knots] = w.place(names.get(x) or fetch(x, number), numbers)
            names[number] = w.read(tables[values], found[x, knots])
        elif op != "input":
            names[number] = operation(w, op, *(names.get(i) or fetch(i, number) for i in operands))
        for pointer, index in places.get(number, ()):
            value = names.get(number) or fetch(number, number)
            # Volatile, lest LLVM look for each among all reads before it whether it may go first.
            w.store(value, Ptr(pointer, w.vector), index, volatile=pointer == _argument(HELD))
    constants = [w.constant(at, map(float.fromhex, piece.instructions[n][1])) for n, at in tables.items()]
    return "".join([*constants, _define_body(name, arguments, w)])


def _define_body(name: str, arguments: Iterable[int], w: Writer) -> str:
    """Define a function of a body, its buffers distinct from each other but for what is held, read and written."""
    pointers = [f"ptr noalias nocapture {'' if i == HELD else 'readonly '}align 8 {_argument(i)}" for i in arguments]
    result = "ptr noalias nocapture writeonly align 8 %out"
    head = f"define internal void @{name}({', '.join([*pointers, result])})"
    return f"{head} nounwind alignstack({max(16, 8 * w.width)}) {{\n{w.body()}\n  ret void\n}}\n"


def _argument(number: int) -> str:
    return {HELD: "%held", _CONSTANTS: "%constants"}.get(number, f"%in{number}")


def _inputs(w: Writer, instructions: Sequence[Instruction]) -> Callable[[int, int], Vec]:
    """Return (input, where it is used) -> its value, read again unless it was read a moment ago.

    A large field has more inputs than a processor has registers. Left to itself LLVM reads each once and moves
    it to the stack and back; a volatile read it has to leave where it is, next to its use, which saves those
    stores: a field of 70 entries takes three quarters of the time.
    """
    read: dict[int, tuple[Vec, int]] = {}

    def fetch(number: int, at: int) -> Vec:
        if number not in read or at - read[number][1] > _RECENT:
            _, argument, index = instructions[number]
            value = w.load(Ptr(_argument(argument), w.vector), index, volatile=True)
        else:
            value = read[number][0]
        read[number] = value, at
        return value

    return fetch


def library(programs: list[Program], width: int) -> str:
    """Return the IR of the transcendental functions that these programs call.

    Parameters
    ----------
    programs
        Programs of one module.
    width
        Number of lanes, one for each trajectory.
    """
    used = {op for program in programs for op in program.operations if op in vecmath.NAMES}
    return vecmath.definitions(width, used)


def operation(w: Writer, op: str, *operands: Vec) -> Vec:
    """Append one operation; every name of `program.OPERATIONS` that survives tracing is known.

    Parameters
    ----------
    w
        Writer of the function that the operation is appended to.
    op
        Name of the operation, as in `program.OPERATIONS`.
    *operands
        One or two values of each lane.
    """
    if op in _ARITHMETIC:
        return w.arith(_ARITHMETIC[op], *operands)
    if op in _INTRINSICS:
        return w.intrinsic(op, *operands)
    if op == "neg":
        return w.neg(*operands)
    if op in _COMPARISONS:
        return _mask_as_number(w, w.compare(_COMPARISONS[op], *operands))
    if op in vecmath.NAMES:
        return vecmath.call(w, op, *operands)
    return _logic(w, op, *operands)


def _logic(w: Writer, op: str, *operands: Vec) -> Vec:
    zero = w.const(0.0)
    true = [w.compare("une", x, zero) for x in operands]
    match op:
        case "not":
            return _mask_as_number(w, w.compare("oeq", operands[0], zero))
        case "and":
            return _mask_as_number(w, w.both(*true))
        case "or":
            return _mask_as_number(w, w.either(*true))
        case "if_else_zero":
            return w.select(true[0], operands[1], zero)
        case "sign":
            x = operands[0]
            signed = w.intrinsic("copysign", w.const(1.0), x)
            return w.select(w.compare("one", x, zero), signed, x)  # zero and NaN are their own sign
        case "fmin" | "fmax":  # NaN of either argument is kept, where C's fmin would hide it
            a, b = operands
            first = w.compare("olt" if op == "fmin" else "ogt", a, b)
            return w.select(w.either(first, w.compare("uno", a, a)), a, b)
    raise KeyError(op)


def _mask_as_number(w: Writer, mask: Mask) -> Vec:
    return w.select(mask, w.const(1.0), w.const(0.0))
