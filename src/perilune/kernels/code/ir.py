"""Writer of LLVM IR as text, for vectors of lanes.

A `Writer` holds the lines of one function and offers the few words that the kernels are made of: arithmetic
on vectors of `width` doubles (one lane per trajectory), comparisons to masks, buffers in memory, variables,
loops and conditions. Nothing here is a mathematical decision except the floating-point flag: `contract`
alone, which lets a product and a sum fuse. The flags that assume no NaN are left out, because a NaN has to be
seen.

The name of a value is a string of a type of its own, and memory is typed by what lies in it, so that a type checker
distinguishes a mask from a vector before LLVM does.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar


class Vec(str):
    """A double in each lane."""


class Mask(str):
    """A bit in each lane."""


class Bits(str):
    """A 64-bit integer in each lane."""


class Num(str):
    """One double."""


class Int(str):
    """One 64-bit integer."""


class Bit(str):
    """One bit."""


T = TypeVar("T", bound=str)
Index = Int | int


@dataclass(frozen=True)
class ValueKind(Generic[T]):
    """A type as LLVM writes it, the class that names its values, and the alignment in bytes that buffers keep."""

    text: str
    named: Callable[[str], T]
    align: int

    def __str__(self) -> str:
        return self.text


NUM, INT, BIT = ValueKind("double", Num, 8), ValueKind("i64", Int, 8), ValueKind("i1", Bit, 1)


class Ptr(str, Generic[T]):
    """The address of values of one kind."""

    kind: ValueKind[T]

    def __new__(cls, name: str, kind: ValueKind[T]) -> Ptr[T]:
        """Name it."""
        pointer = super().__new__(cls, name)
        pointer.kind = kind
        return pointer


def literal(value: float) -> str:
    """Write a double so that every bit of it arrives."""
    return f"0x{struct.unpack('>Q', struct.pack('>d', value))[0]:016X}"


class Writer:
    """The body of one function, in vectors of `width` lanes."""

    def __init__(self, width: int) -> None:
        self.width = width
        self.vector = ValueKind(f"<{width} x double>", Vec, 8 * width)
        self.mask = ValueKind(f"<{width} x i1>", Mask, 1)
        self.integers = ValueKind(f"<{width} x i64>", Bits, 8 * width)
        self.lines: list[str] = []
        self.head: list[str] = []  # allocations, which belong at the entry of the function
        self._count = 0

    # -- names and lines
    # ---------------------------------------------------------------------------------------
    def fresh(self, stem: str) -> str:
        """Return a name not used before."""
        self._count += 1
        return f"{stem}{self._count}"

    def let(self, kind: ValueKind[T], text: str) -> T:
        """Append an instruction whose result is of a kind; returns its name.

        Parameters
        ----------
        kind
            Type of the result.
        text
            Instruction in LLVM IR, without the name of its result.
        """
        name = f"%{self.fresh('v')}"
        self.lines.append(f"  {name} = {text}")
        return kind.named(name)

    def run(self, text: str) -> None:
        """Append an instruction without a result."""
        self.lines.append(f"  {text}")

    def label(self, name: str) -> None:
        """Begin a block."""
        self.lines.append(f"{name}:")

    def body(self) -> str:
        """Return the text, allocations first."""
        return "\n".join(["entry:", *self.head, *self.lines])

    # -- vectors
    # -----------------------------------------------------------------------------------------------
    def const(self, value: float) -> Vec:
        """Return a vector with the same number in each lane."""
        return Vec("<" + ", ".join([f"double {literal(value)}"] * self.width) + ">")

    def bits(self, value: int) -> Bits:
        """Return a vector of the same 64-bit integer."""
        return Bits("<" + ", ".join([f"i64 {value}"] * self.width) + ">")

    def arith(self, op: str, a: Vec, b: Vec) -> Vec:
        """Append fadd, fsub, fmul or fdiv.

        Parameters
        ----------
        op
            "fadd", "fsub", "fmul" or "fdiv".
        a, b
            A double in each lane.
        """
        return self.let(self.vector, f"{op} contract {self.vector} {a}, {b}")

    def add(self, a: Vec, b: Vec) -> Vec:
        """Return a + b.

        Parameters
        ----------
        a, b
            A double in each lane.
        """
        return self.arith("fadd", a, b)

    def sub(self, a: Vec, b: Vec) -> Vec:
        """Return a - b.

        Parameters
        ----------
        a, b
            A double in each lane.
        """
        return self.arith("fsub", a, b)

    def mul(self, a: Vec, b: Vec) -> Vec:
        """Return a b.

        Parameters
        ----------
        a, b
            A double in each lane.
        """
        return self.arith("fmul", a, b)

    def div(self, a: Vec, b: Vec) -> Vec:
        """Return a / b.

        Parameters
        ----------
        a, b
            A double in each lane.
        """
        return self.arith("fdiv", a, b)

    def fma(self, a: Vec, b: Vec, c: Vec) -> Vec:
        """Return a b + c, fused where the processor can.

        Parameters
        ----------
        a, b, c
            A double in each lane.
        """
        return self.intrinsic("fmuladd", a, b, c)

    def neg(self, a: Vec) -> Vec:
        """Return -a."""
        return self.let(self.vector, f"fneg {self.vector} {a}")

    def intrinsic(self, name: str, *operands: Vec) -> Vec:
        """Append one of LLVM's own functions: sqrt, fabs, copysign, rint, floor, ceil, fmuladd."""
        arguments = ", ".join(f"{self.vector} {x}" for x in operands)
        return self.let(self.vector, f"call contract {self.vector} @llvm.{name}.v{self.width}f64({arguments})")

    def horner(self, x: Vec, coefficients: tuple[float, ...]) -> Vec:
        """Append a polynomial, highest power first.

        Parameters
        ----------
        x
            Argument of the polynomial, a double in each lane.
        coefficients
            Coefficients from the highest power down to the constant, the same in all lanes.
        """
        value = self.const(coefficients[0])
        for c in coefficients[1:]:
            value = self.fma(value, x, self.const(c))
        return value

    def smaller(self, a: Vec, b: Vec) -> Vec:
        """Return the smaller; b where either is NaN.

        Parameters
        ----------
        a, b
            A double in each lane.
        """
        return self.select(self.compare("olt", a, b), a, b)

    def larger(self, a: Vec, b: Vec) -> Vec:
        """Return the larger; b where either is NaN.

        Parameters
        ----------
        a, b
            A double in each lane.
        """
        return self.select(self.compare("ogt", a, b), a, b)

    # -- lanes of vectors
    # -----------------------------------------------------------------------------------------------
    def lane(self, vector: Vec, number: int) -> Num:
        """Return one lane.

        Parameters
        ----------
        vector
            A double in each lane.
        number
            Index of the lane, 0 to `width` - 1.
        """
        return self.let(NUM, f"extractelement {self.vector} {vector}, i32 {number}")

    def gathered(self, value: Callable[[int], Num]) -> Vec:
        """Return a vector from a number for each lane."""
        result = Vec("poison")
        for lane in range(self.width):
            number = value(lane)
            result = self.let(self.vector, f"insertelement {self.vector} {result}, double {number}, i32 {lane}")
        return result

    def broadcast(self, integer: Int) -> Vec:
        """Return a vector with a whole number in each lane."""
        value = self.let(NUM, f"sitofp i64 {integer} to double")
        return self.gathered(lambda _: value)

    # -- tables
    # -----------------------------------------------------------------------------------------------
    def constant(self, name: Ptr[Num], values: Iterable[float]) -> str:
        """Return the text of an array of doubles next to the functions.

        Parameters
        ----------
        name
            Global name of the array, with its "@".
        values
            Entries of the array.
        """
        numbers = [f"double {literal(value)}" for value in values]
        return f"{name} = internal constant [{len(numbers)} x double] [{', '.join(numbers)}]\n"

    def place(self, x: Vec, knots: Iterable[float]) -> Bits:
        """Return how many of the knots do not lie above x, none where that is NaN.

        Parameters
        ----------
        x
            A double in each lane.
        knots
            Knots in ascending order, the same in all lanes.
        """
        count = self.bits(0)
        for knot in knots:
            beyond = self.let(
                self.integers, f"sext {self.mask} {self.compare('ole', self.const(knot), x)} to {self.integers}"
            )
            count = self.let(self.integers, f"sub {self.integers} {count}, {beyond}")
        return count

    def read(self, table: Ptr[Num], place: Bits) -> Vec:
        """Return the entry of an array at a place of each lane.

        Parameters
        ----------
        table
            Address of the first entry of an array of doubles.
        place
            Index of the entry, an integer in each lane.
        """
        return self.gathered(
            lambda lane: self.load(table, self.let(INT, f"extractelement {self.integers} {place}, i32 {lane}"))
        )

    # -- masks and bits
    # -----------------------------------------------------------------------------------------------
    def compare(self, predicate: str, a: Vec, b: Vec) -> Mask:
        """Append a comparison to a mask: oeq, olt, ole, ogt, oge (false on NaN), uno (either is NaN), ...

        Parameters
        ----------
        predicate
            Condition of LLVM's ``fcmp``.
        a, b
            A double in each lane.
        """
        return self.let(self.mask, f"fcmp {predicate} {self.vector} {a}, {b}")

    def const_mask(self, value: bool) -> Mask:
        """Return a mask that holds everywhere or nowhere."""
        return Mask("splat (i1 true)" if value else "splat (i1 false)")

    def both(self, a: Mask, b: Mask) -> Mask:
        """Return mask and mask.

        Parameters
        ----------
        a, b
            A bit in each lane.
        """
        return self.let(self.mask, f"and {self.mask} {a}, {b}")

    def either(self, a: Mask, b: Mask) -> Mask:
        """Return mask or mask.

        Parameters
        ----------
        a, b
            A bit in each lane.
        """
        return self.let(self.mask, f"or {self.mask} {a}, {b}")

    def opposite(self, mask: Mask) -> Mask:
        """Return not mask."""
        return self.let(self.mask, f"xor {self.mask} {mask}, splat (i1 true)")

    def but_not(self, a: Mask, b: Mask) -> Mask:
        """Return mask and not mask.

        Parameters
        ----------
        a, b
            A bit in each lane; b is negated.
        """
        return self.both(a, self.opposite(b))

    def select(self, mask: Mask, yes: Vec, no: Vec) -> Vec:
        """Select lane by lane, one or the other.

        Parameters
        ----------
        mask
            A bit in each lane.
        yes, no
            Values where the bit is 1 and where it is 0.
        """
        return self.let(self.vector, f"select {self.mask} {mask}, {self.vector} {yes}, {self.vector} {no}")

    def choose(self, bit: Bit, kind: ValueKind[T], yes: T, no: T) -> T:
        """Return one or the other, in all lanes.

        Parameters
        ----------
        bit
            Condition, one for all lanes.
        kind
            Type of both values.
        yes, no
            Values where the bit is 1 and where it is 0.
        """
        return self.let(kind, f"select i1 {bit}, {kind} {yes}, {kind} {no}")

    def any(self, mask: Mask) -> Bit:
        """Return the bit that is set if the mask holds in any lane."""
        return self.let(BIT, f"call i1 @llvm.vector.reduce.or.v{self.width}i1({self.mask} {mask})")

    def and_bit(self, a: Bit, b: Bit) -> Bit:
        """Return bit and bit.

        Parameters
        ----------
        a, b
            One bit each.
        """
        return self.let(BIT, f"and i1 {a}, {b}")

    def not_bit(self, a: Bit) -> Bit:
        """Return not bit."""
        return self.let(BIT, f"xor i1 {a}, true")

    def positive(self, number: Num) -> Bit:
        """Return the bit that is set if one double is above zero."""
        return self.let(BIT, f"fcmp ogt double {number}, 0.0")

    # -- whole numbers
    # -----------------------------------------------------------------------------------------------
    def integer(self, op: str, a: Index, b: Index) -> Int:
        """Append add, sub, mul or shl.

        Parameters
        ----------
        op
            "add", "sub", "mul" or "shl".
        a, b
            64-bit integers, names of values or literal numbers.
        """
        return self.let(INT, f"{op} i64 {a}, {b}")

    def entry(self, row: Index, length: int, column: Index) -> Int:
        """Return where an entry of a matrix lies, row by row.

        Parameters
        ----------
        row, column
            Indices of the entry, from 0.
        length
            Number of columns of the matrix.
        """
        return self.integer("add", self.integer("mul", row, length), column)

    def below(self, a: Index, b: Index) -> Bit:
        """Return a < b.

        Parameters
        ----------
        a, b
            64-bit signed integers.
        """
        return self.let(BIT, f"icmp slt i64 {a}, {b}")

    # -- memory
    # ------------------------------------------------------------------------------------------------
    def allocate(self, kind: ValueKind[T], count: int) -> Ptr[T]:
        """Allocate values for the duration of the function.

        Parameters
        ----------
        kind
            Type of each value.
        count
            Number of values; for 0 there is room for one.
        """
        name = f"%{self.fresh('b')}"
        self.head.append(f"  {name} = alloca [{max(count, 1)} x {kind}], align 64")
        return Ptr(name, kind)

    def buffer(self, count: int) -> Ptr[Vec]:
        """Allocate vectors."""
        return self.allocate(self.vector, count)

    def several(self, kind: ValueKind[T], count: Int) -> Ptr[T]:
        """Allocate values whose number only the function knows, outside of its loops.

        Parameters
        ----------
        kind
            Type of each value.
        count
            Number of values, known when the function runs.
        """
        return Ptr(self.let(ValueKind("ptr", str, 8), f"alloca {kind}, i64 {count}, align 64"), kind)

    def at(self, pointer: Ptr[T], index: Index) -> Ptr[T]:
        """Return the address of an element.

        Parameters
        ----------
        pointer
            Address of the first element.
        index
            Index of the element, in elements and not in bytes.
        """
        name = f"%{self.fresh('v')}"
        self.lines.append(f"  {name} = getelementptr inbounds {pointer.kind}, ptr {pointer}, i64 {index}")
        return Ptr(name, pointer.kind)

    def load(self, pointer: Ptr[T], index: Index = 0, *, volatile: bool = False) -> T:
        """Read an element.

        Parameters
        ----------
        pointer
            Address of the first element.
        index
            Index of the element.
        volatile
            True for a read that the compiler has to leave where it is.
        """
        kind, how = pointer.kind, "load volatile" if volatile else "load"
        return self.let(kind, f"{how} {kind}, ptr {self.at(pointer, index)}, align {kind.align}")

    def store(self, value: T, pointer: Ptr[T], index: Index = 0, *, volatile: bool = False) -> None:
        """Write an element.

        Parameters
        ----------
        value
            The value to write.
        pointer
            Address of the first element.
        index
            Index of the element.
        volatile
            True for a write that the compiler has to leave where it is.
        """
        kind, how = pointer.kind, "store volatile" if volatile else "store"
        self.run(f"{how} {kind} {value}, ptr {self.at(pointer, index)}, align {kind.align}")

    def by_lane(self, pointer: Ptr[Vec]) -> Ptr[Num]:
        """Return the same memory as doubles, lane after lane of vector after vector."""
        return Ptr(pointer, NUM)

    def address(self, table: Ptr[Int], index: Index, kind: ValueKind[T]) -> Ptr[T]:
        """Read the address of values of a kind from a table.

        Parameters
        ----------
        table
            Address of a table of addresses, 8 bytes each.
        index
            Index in the table.
        kind
            Type of the values at the address read.
        """
        return Ptr(self.load(Ptr(table, ValueKind("ptr", str, 8)), index), kind)

    # -- control
    # -----------------------------------------------------------------------------------------------
    @contextmanager
    def loop(self, start: Index, stop: Index) -> Iterator[Int]:
        """Count an i64 from start to stop - 1.

        Parameters
        ----------
        start, stop
            First value of the counter, and the one before which it ends.

        Yields
        ------
        Int
            The counter; what is appended before it is asked for again is the body.
        """
        head, body, done = self.fresh("head"), self.fresh("body"), self.fresh("done")
        counter = self.allocate(INT, 1)
        self.store(Int(start), counter)
        self.run(f"br label %{head}")
        self.label(head)
        index = self.load(counter)
        self.run(f"br i1 {self.below(index, stop)}, label %{body}, label %{done}")
        self.label(body)
        yield index
        self.store(self.integer("add", index, 1), counter)
        self.run(f"br label %{head}")
        self.label(done)

    @contextmanager
    def when(self, condition: Bit) -> Iterator[None]:
        """Do it if the i1 holds."""
        yes, done = self.fresh("yes"), self.fresh("done")
        self.run(f"br i1 {condition}, label %{yes}, label %{done}")
        self.label(yes)
        yield
        self.run(f"br label %{done}")
        self.label(done)

    @contextmanager
    def repeat_while_any(self, mask_variable: Ptr[Mask]) -> Iterator[None]:
        """Repeat while the mask in a variable holds in any lane."""
        head, body, done = self.fresh("head"), self.fresh("body"), self.fresh("done")
        self.run(f"br label %{head}")
        self.label(head)
        again = self.any(self.load(mask_variable))
        self.run(f"br i1 {again}, label %{body}, label %{done}")
        self.label(body)
        yield
        self.run(f"br label %{head}")
        self.label(done)
