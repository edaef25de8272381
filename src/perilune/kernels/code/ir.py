"""Writing LLVM IR as text, in vectors of lanes.

A `Writer` holds the lines of one function and offers the few words that the kernels are made of: arithmetic
on vectors of `width` doubles (one lane per trajectory), comparisons to masks, buffers in memory, variables,
loops and conditions. Nothing here is a mathematical decision except the floating-point flag: `contract`
alone, which lets a product and a sum fuse. The flags that assume no NaN are left out, because a NaN has to be
seen.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager


def literal(value: float) -> str:
    """Write a double so that every bit of it arrives."""
    return f"0x{struct.unpack('>Q', struct.pack('>d', value))[0]:016X}"


class Writer:
    """The body of one function, in vectors of `width` lanes."""

    def __init__(self, width: int) -> None:
        self.width = width
        self.vector = f"<{width} x double>"
        self.mask = f"<{width} x i1>"
        self.integers = f"<{width} x i64>"
        self.lines: list[str] = []
        self.head: list[str] = []  # allocations, which belong at the entry of the function
        self._count = 0

    # -- names and lines
    # ---------------------------------------------------------------------------------------
    def fresh(self, stem: str) -> str:
        """Return a name not used before."""
        self._count += 1
        return f"{stem}{self._count}"

    def let(self, text: str) -> str:
        """Append an instruction with a result; returns its name."""
        name = f"%{self.fresh('v')}"
        self.lines.append(f"  {name} = {text}")
        return name

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
    def const(self, value: float) -> str:
        """Return a vector with the same number in each lane."""
        return "<" + ", ".join([f"double {literal(value)}"] * self.width) + ">"

    def bits(self, value: int) -> str:
        """Return a vector of the same 64-bit integer."""
        return "<" + ", ".join([f"i64 {value}"] * self.width) + ">"

    def arith(self, op: str, a: str, b: str) -> str:
        """Append fadd, fsub, fmul or fdiv."""
        return self.let(f"{op} contract {self.vector} {a}, {b}")

    def add(self, a: str, b: str) -> str:
        """a + b."""
        return self.arith("fadd", a, b)

    def sub(self, a: str, b: str) -> str:
        """a - b."""
        return self.arith("fsub", a, b)

    def mul(self, a: str, b: str) -> str:
        """a b."""
        return self.arith("fmul", a, b)

    def div(self, a: str, b: str) -> str:
        """a / b."""
        return self.arith("fdiv", a, b)

    def fma(self, a: str, b: str, c: str) -> str:
        """a b + c, fused where the processor can."""
        return self.intrinsic("fmuladd", a, b, c)

    def neg(self, a: str) -> str:
        """-a."""
        return self.let(f"fneg {self.vector} {a}")

    def intrinsic(self, name: str, *operands: str) -> str:
        """Append one of LLVM's own functions: sqrt, fabs, copysign, rint, floor, ceil, fmuladd."""
        arguments = ", ".join(f"{self.vector} {x}" for x in operands)
        return self.let(f"call contract {self.vector} @llvm.{name}.v{self.width}f64({arguments})")

    def horner(self, x: str, coefficients: tuple[float, ...]) -> str:
        """Append a polynomial, highest power first."""
        value = self.const(coefficients[0])
        for c in coefficients[1:]:
            value = self.fma(value, x, self.const(c))
        return value

    def compare(self, predicate: str, a: str, b: str) -> str:
        """Append a comparison to a mask: oeq, olt, ole, ogt, oge (false on NaN), uno (either is NaN), ..."""
        return self.let(f"fcmp {predicate} {self.vector} {a}, {b}")

    def const_mask(self, value: bool) -> str:
        """Return a mask that holds everywhere or nowhere."""
        return "splat (i1 true)" if value else "splat (i1 false)"

    def both(self, a: str, b: str) -> str:
        """Mask and mask."""
        return self.let(f"and {self.mask} {a}, {b}")

    def either(self, a: str, b: str) -> str:
        """Mask or mask."""
        return self.let(f"or {self.mask} {a}, {b}")

    def but_not(self, a: str, b: str) -> str:
        """Mask and not mask."""
        return self.both(a, self.let(f"xor {self.mask} {b}, splat (i1 true)"))

    def select(self, mask: str, yes: str, no: str) -> str:
        """Lane by lane, one or the other."""
        return self.let(f"select {self.mask} {mask}, {self.vector} {yes}, {self.vector} {no}")

    def smaller(self, a: str, b: str) -> str:
        """Return the smaller; b where either is NaN."""
        return self.select(self.compare("olt", a, b), a, b)

    def larger(self, a: str, b: str) -> str:
        """Return the larger; b where either is NaN."""
        return self.select(self.compare("ogt", a, b), a, b)

    def any(self, mask: str) -> str:
        """Return i1: is it so in any lane."""
        return self.let(f"call i1 @llvm.vector.reduce.or.v{self.width}i1({self.mask} {mask})")

    # -- memory
    # ------------------------------------------------------------------------------------------------
    def buffer(self, count: int, kind: str | None = None) -> str:
        """Allocate `count` vectors (or values of another kind) for the duration of the function."""
        name = f"%{self.fresh('b')}"
        self.head.append(f"  {name} = alloca [{max(count, 1)} x {kind or self.vector}], align 64")
        return name

    def at(self, pointer: str, index: str | int, kind: str | None = None) -> str:
        """Return the address of an element."""
        return self.let(f"getelementptr inbounds {kind or self.vector}, ptr {pointer}, i64 {index}")

    def load(self, pointer: str, index: str | int = 0, kind: str | None = None) -> str:
        """Read an element."""
        kind = kind or self.vector
        return self.let(f"load {kind}, ptr {self.at(pointer, index, kind)}, align {self.align(kind)}")

    def store(self, value: str, pointer: str, index: str | int = 0, kind: str | None = None) -> None:
        """Write an element."""
        kind = kind or self.vector
        self.run(f"store {kind} {value}, ptr {self.at(pointer, index, kind)}, align {self.align(kind)}")

    def align(self, kind: str) -> int:
        """Return the alignment in bytes that the buffers keep."""
        return 8 * self.width if kind == self.vector else 1 if kind == self.mask else 8

    # -- control
    # -----------------------------------------------------------------------------------------------
    @contextmanager
    def loop(self, start: str | int, stop: str | int) -> Iterator[str]:
        """Count an i64 from start to stop - 1."""
        head, body, done = self.fresh("head"), self.fresh("body"), self.fresh("done")
        counter = self.buffer(1, "i64")
        self.store(str(start), counter, kind="i64")
        self.run(f"br label %{head}")
        self.label(head)
        index = self.load(counter, kind="i64")
        self.run(f"br i1 {self.let(f'icmp slt i64 {index}, {stop}')}, label %{body}, label %{done}")
        self.label(body)
        yield index
        self.store(self.let(f"add i64 {index}, 1"), counter, kind="i64")
        self.run(f"br label %{head}")
        self.label(done)

    @contextmanager
    def when(self, condition: str) -> Iterator[None]:
        """Do it if the i1 holds."""
        yes, done = self.fresh("yes"), self.fresh("done")
        self.run(f"br i1 {condition}, label %{yes}, label %{done}")
        self.label(yes)
        yield
        self.run(f"br label %{done}")
        self.label(done)

    @contextmanager
    def repeat_while_any(self, mask_variable: str) -> Iterator[None]:
        """Repeat while the mask in a variable holds in any lane."""
        head, body, done = self.fresh("head"), self.fresh("body"), self.fresh("done")
        self.run(f"br label %{head}")
        self.label(head)
        again = self.any(self.load(mask_variable, kind=self.mask))
        self.run(f"br i1 {again}, label %{body}, label %{done}")
        self.label(body)
        yield
        self.run(f"br label %{head}")
        self.label(done)
