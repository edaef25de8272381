"""Code generation: a straight-line program as a function of machine code, one lane per trajectory.

Each value of the program is one LLVM instruction on a vector of lanes; the arguments and the result are
buffers of vectors. LLVM chooses registers and order. A long program is several functions, called one after another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence, Set

from perilune.kernels.algebra.program import Instruction, Program
from perilune.kernels.algebra.split_program import HELD, Piece, split_program
from perilune.kernels.code import vecmath
from perilune.kernels.code.ir import NUM, Bits, Mask, Num, Ptr, Vec, Writer

_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_INTRINSICS = {"sqrt", "fabs", "copysign", "floor", "ceil"}
_RECENT = 20  # operations for which an input read stays in a register; 12 to 32 measure the same
_COMPARISONS = {"lt": "olt", "le": "ole", "eq": "oeq", "ne": "une"}


def emit_kernel(name: str, program: Program, arguments: Iterable[int], width: int, *, cleared: bool = False) -> str:
    """Return the IR of ``void name(inputs..., result)``, each a pointer to vectors of `width` lanes.

    Parameters
    ----------
    name
        Name of the function in the module, without ``@``.
    program
        What to compute.
    arguments
        Which arguments of the program the function takes, in order.
    width
        Number of lanes.
    cleared
        Whether the result is handed over as zeros: those of a sparse matrix, most of it, are then not written.
    """
    zero = ("const", (0.0).hex())
    left = {index for index, n in enumerate(program.outputs) if cleared and program.instructions[n] == zero}
    parts, held = split_program(program)
    if len(parts) == 1:
        return _function(name, parts[0], [*arguments], width, left)
    w, taken = Writer(width), [*arguments]
    passed = ", ".join(f"ptr {x}" for x in (*map(_argument, taken), w.buffer(held), "%out"))
    functions = list[str]()
    for number, part in enumerate(parts):
        functions.append(_function(f"{name}.{number}", part, [*taken, HELD], width, left))
        w.run(f"call void @{name}.{number}({passed})")
    return "\n".join([*functions, _define_body(name, taken, w)])


def _function(name: str, piece: Piece, arguments: list[int], width: int, left: Set[int]) -> str:
    """Write a piece; `left` are the entries of the result that it does not write."""
    w = Writer(width)
    fetch = _inputs(w, piece.instructions)
    names: dict[int, Vec] = {}
    tables: dict[int, Ptr[Num]] = {}
    found: dict[tuple[int, int], Bits] = {}  # places of values among knots
    places: dict[int, list[tuple[str, int]]] = {}
    for index, number in piece.results.items():
        if index not in left:
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
            w.store(names.get(number) or fetch(number, number), Ptr(pointer, w.vector), index)
    constants = [w.constant(at, map(float.fromhex, piece.instructions[n][1])) for n, at in tables.items()]
    return "".join([*constants, _define_body(name, arguments, w)])


def _define_body(name: str, arguments: list[int], w: Writer) -> str:
    """Define a function of a body, its buffers distinct from each other but for what is held, read and written."""
    pointers = [f"ptr noalias nocapture {'' if i == HELD else 'readonly '}align 8 {_argument(i)}" for i in arguments]
    result = "ptr noalias nocapture writeonly align 8 %out"
    head = f"define internal void @{name}({', '.join([*pointers, result])})"
    return f"{head} nounwind alignstack({max(16, 8 * w.width)}) {{\n{w.body()}\n  ret void\n}}\n"


def _argument(number: int) -> str:
    return "%held" if number == HELD else f"%in{number}"


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
