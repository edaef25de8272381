"""Tape of a function: the physics as data, written down as the list of elementary operations it does.

The user's function is called once with *symbols*, and every operation on them is noted, in its order and with its own
rounding: nothing is rewritten, but equal operations on equal values are one value. A `Tape` so made runs over any maths
namespace `xp` (NumPy floats and arrays, complex steps, CasADi symbols) exactly as the function would. It is data: it is
compared, pickled and written as JSON; `perilune.io.tape_json` reads it from a file.

Source of value numbering: Cocke & Schwartz, *Programming Languages and Their Compilers*, 1970.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from numbers import Real
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import NUMPY_NAMES, Table

# Operations that Python writes with a sign, and those of the namespace `xp`, each with its number of operands.
_SIGNS: dict[str, Callable[..., Any]] = {
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "pow": operator.pow,
    "neg": operator.neg, "lt": operator.lt, "le": operator.le, "eq": operator.eq, "ne": operator.ne,
}  # fmt: skip
_BINARY = {"atan2", "fmin", "fmax"}
ARITY = {
    **{name: 2 for name in _SIGNS}, "neg": 1, "where": 3, "table": 1,
    **{name: 2 if name in _BINARY else 1 for name in NUMPY_NAMES},
}  # fmt: skip
_REAL_ELSEWHERE = {"fabs", "atan2"}  # only those of `xp` carry a complex step
# Arguments of the physics: states, controls, parameters, the time from the begin of the flight, first and last state.
ROLES = ("x", "u", "p", "t", "first", "last")

# (role, component), the time itself having none: ""; ("const", repr of a float); or (operation, operand, ...), operands
# being indices before it; ("table", operand, digest of the table).
Instruction = tuple[Any, ...]
_Placed = tuple[Instruction, list[int], int]  # an operation, where its operands lie, and where its value goes
_Step = tuple[int, Any, int, int, int, int]  # the same of one namespace: number of operands, function, places


class NotAFormula(Exception):
    """A function used a symbol in a way that a formula cannot; `advice` says what to write instead."""

    def __init__(self, got: str, advice: str) -> None:
        super().__init__(got)
        self.got: str = got
        self.advice: str = advice


class Symbol:
    """A value that is not known yet, with which a user's function computes while it is recorded."""

    __slots__ = ("_index", "_recorder")
    __hash__: Any = None  # type: ignore[assignment]

    def __init__(self, recorder: Recorder, index: int) -> None:
        self._recorder, self._index = recorder, index

    def __getattr__(self, name: str) -> Any:
        # NumPy asks an object for its own sqrt(), arcsin()...
        for ours, numpy_name in NUMPY_NAMES.items():
            if name in (ours, numpy_name):
                return lambda *others: self._recorder.by_another(f"np.{numpy_name}", ours, self, *others)
        raise AttributeError(f"a single value has no attribute {name!r}", name=name, obj=self)

    def __bool__(self) -> bool:
        raise NotAFormula(
            "it branches (if, and, or, min, max, np.minimum, np.where) on a value that is known only in flight",
            "xp.where(condition, value, otherwise), xp.fmin or xp.fmax",
        )

    def __float__(self) -> float:
        raise NotAFormula(
            "it converts a value that is known only in flight to a plain number (float, math.sin, np.interp)",
            "the functions of xp: xp.sin, xp.sqrt, ...; xp.table for tabulated data",
        )

    __int__: Any = __float__
    __index__: Any = __float__
    __complex__: Any = __float__

    def __array_function__(self, function: Any, types: Any, arguments: Any, keywords: Any) -> Any:
        raise NotAFormula(
            f"it calls np.{function.__name__} on a value that is known only in flight",
            "the functions of xp: xp.where for np.where, xp.table for np.interp, xp.sin for np.sin",
        )

    def __pos__(self) -> Symbol:
        return self

    def __neg__(self) -> Symbol:
        return self._recorder.do("neg", self)

    def __abs__(self) -> Symbol:
        return self._recorder.by_another("abs", "fabs", self)


def _sign(name: str, reflected: bool = False) -> Callable[[Symbol, Any], Any]:
    def method(self: Symbol, other: Any) -> Any:
        if not _is_scalar_number(other):
            return NotImplemented
        return self._recorder.do(name, other, self) if reflected else self._recorder.do(name, self, other)

    return method


for _name, _python in (("add", "add"), ("sub", "sub"), ("mul", "mul"), ("div", "truediv"), ("pow", "pow")):
    setattr(Symbol, f"__{_python}__", _sign(_name))
    setattr(Symbol, f"__r{_python}__", _sign(_name, reflected=True))
for _name in ("lt", "le", "eq", "ne"):
    setattr(Symbol, f"__{_name}__", _sign(_name))
Symbol.__gt__, Symbol.__ge__ = _sign("lt", reflected=True), _sign("le", reflected=True)  # type: ignore[attr-defined]


def _is_scalar_number(value: Any) -> bool:
    return isinstance(value, (Symbol, Real, np.number, np.bool_)) or (isinstance(value, np.ndarray) and not value.ndim)


class Recorder:
    """Recorder of operations, each distinct one once; if `differentiated`, only those that take complex steps."""

    def __init__(self, differentiated: bool = False) -> None:
        self.differentiated = differentiated
        self.instructions: list[Instruction] = []
        self._index: dict[Instruction, int] = {}
        self.tables: dict[str, Table] = {}
        names = (*NUMPY_NAMES, "where")
        self.namespace: SimpleNamespace = SimpleNamespace(
            **{name: self._function(name) for name in names}, table=self._table
        )

    def by_another(self, called: str, ours: str, *operands: Any) -> Symbol:
        """Apply our operation in place of a function of Python or NumPy; refuse where that loses a derivative.

        Parameters
        ----------
        called
            Function as the user called it, such as "np.fabs".
        ours
            Name in the maths namespace of the operation that does the same.
        *operands
            Symbols and numbers.

        Raises
        ------
        NotAFormula
            If the function has no derivative, and one is needed.
        """
        if self.differentiated and ours in _REAL_ELSEWHERE:
            raise NotAFormula(f"it calls {called}, which has no derivative for the proof", f"xp.{ours}, which has one")
        return self.namespace.__dict__[ours](*operands)

    def _function(self, name: str) -> Callable[..., Symbol]:
        def function(*operands: Any) -> Symbol:
            if len(operands) != ARITY[name] or not all(_is_scalar_number(o) for o in operands):
                raise NotAFormula(
                    f"xp.{name} gets {', '.join(type(o).__name__ for o in operands) or 'nothing'}",
                    f"xp.{name} of {ARITY[name]} single value{'s' if ARITY[name] > 1 else ''}",
                )
            return self.do(name, *operands)

        return function

    def _table(self, table: Any, value: Any) -> Any:
        if not isinstance(table, Table) or not _is_scalar_number(value):
            raise NotAFormula(
                f"xp.table gets {type(table).__name__} and {type(value).__name__}",
                "xp.table(table, value) with a perilune.Table and a single value",
            )
        if not isinstance(value, Symbol):
            return float(table(float(value)))
        self.tables[table.digest] = table
        return Symbol(self, self._append(("table", self.index_of(value), table.digest)))

    def input(self, role: str, name: str) -> Symbol:
        """Return the symbol of a component of a record, or of the time itself.

        Parameters
        ----------
        role
            "x", "u" or "p", a record; "t", the time.
        name
            Name of the component.
        """
        return Symbol(self, self._append((role, name)))

    def index_of(self, value: Any) -> int:
        """Return the place of a symbol or a number."""
        if isinstance(value, Symbol):
            return value._index
        if isinstance(value, np.ndarray) and value.dtype == object:
            return self.index_of(value.item())
        return self._append(("const", repr(float(value))))

    def do(self, name: str, *operands: Any) -> Symbol:
        """Note one operation."""
        return Symbol(self, self._append((name, *(self.index_of(o) for o in operands))))

    def _append(self, instruction: Instruction) -> int:
        number = self._index.get(instruction)
        if number is None:
            number = self._index[instruction] = len(self.instructions)
            self.instructions.append(instruction)
        return number

    def tape(self, results: Sequence[Any]) -> Tape:
        """Return the tape of the noted operations that the results need."""
        outputs = [self.index_of(r) for r in results]
        needed = set(outputs)
        for number in range(len(self.instructions) - 1, -1, -1):
            if number in needed:
                needed.update(operands(self.instructions[number]))
        place = {number: k for k, number in enumerate(sorted(needed))}
        kept = [self.instructions[number] for number in place]
        moved = tuple(
            (op[0], *(place[i] for i in operands(op)), *op[1 + ARITY[op[0]] :]) if operands(op) else op for op in kept
        )
        used = {op[2] for op in kept if op[0] == "table"}
        tables = tuple(table for digest, table in sorted(self.tables.items()) if digest in used)
        return Tape(moved, tuple(place[i] for i in outputs), tables)


def operands(instruction: Instruction) -> tuple[int, ...]:
    """Return the places of the values that an instruction works on."""
    return instruction[1 : 1 + ARITY.get(instruction[0], 0)]


@dataclass(frozen=True)
class Tape:
    """Values in order of computation.

    Attributes
    ----------
    instructions
        Value i is what instruction i makes of values before it.
    outputs
        The results, as indices into `instructions`.
    tables
        Those that it reads.
    """

    instructions: tuple[Instruction, ...]
    outputs: tuple[int, ...]
    tables: tuple[Table, ...] = ()

    def needed(self, row: int) -> set[Instruction]:
        """Return the instructions, inputs among them, that one of the results needs."""
        places = {self.outputs[row]}
        for at in range(len(self.instructions) - 1, -1, -1):
            places |= {*operands(self.instructions[at])} if at in places else set()
        return {self.instructions[at] for at in places}

    def document(self) -> dict[str, Any]:
        """Return the tape for JSON."""
        tables = [{"x": list(t.x), "y": list(t.y), "kind": t.kind} for t in self.tables]
        found = {"instructions": [list(op) for op in self.instructions], "outputs": list(self.outputs)}
        return {**found, "tables": tables} if tables else found


@dataclass(frozen=True)
class Expression:
    """A user's function as a tape: called as the function would be, ``f(x, u, p, xp)``.

    Attributes
    ----------
    tape
        Its operations.
    roles
        Which records it takes before `xp`, of `ROLES`.
    scalar
        Whether it returns one value instead of a sequence.
    origin
        Where the tape came from; no part of what it is.
    """

    tape: Tape
    roles: tuple[str, ...]
    scalar: bool = False
    origin: str = field(default="", compare=False)

    def __call__(self, *arguments: Any) -> Any:
        """Compute the values with the maths namespace that is the last argument."""
        *records, xp = arguments
        inputs, constants, operations, outputs, size = self._plan
        values = [getattr(records[k], name) if name else records[k] for k, name in inputs]
        values += constants
        values += [None] * (size - len(values))
        for arity, function, i, j, k, at in self._bound(xp, operations):
            if arity == 2:
                values[at] = function(values[i], values[j])
            elif arity == 1:
                values[at] = function(values[i])
            else:
                values[at] = function(values[i], values[j], values[k])
        if self.scalar:
            return values[outputs[0]]
        return [values[k] for k in outputs]

    def rescaled(self, inputs: Mapping[tuple[str, str], float], outputs: Sequence[float]) -> Expression:
        """Return the same function in other units.

        Parameters
        ----------
        inputs
            By (role, component), what it is multiplied by before; others stay as they are.
        outputs
            What each value is divided by after; empty where they stay as they are.
        """
        recorder = Recorder()
        records: dict[str, Any] = {role: SimpleNamespace() for role in self.roles}
        for role, name in (op for op in self.tape.instructions if op[0] in ROLES):
            symbol, factor = recorder.input(role, name), inputs.get((role, name), 1.0)
            if name:
                setattr(records[role], name, symbol if factor == 1.0 else recorder.do("mul", symbol, factor))
            else:
                records[role] = symbol
        found = self(*records.values(), recorder.namespace)
        values = zip([found] if self.scalar else found, outputs or (1.0,) * len(self.tape.outputs), strict=True)
        tape = recorder.tape([value if factor == 1.0 else value / factor for value, factor in values])
        return Expression(tape, self.roles, self.scalar, self.origin)

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("tape", "roles", "scalar", "origin")}

    @cached_property
    def _plan(self) -> tuple[list[tuple[int, str]], list[float], list[_Placed], list[int], int]:
        """Inputs and constants first, then the operations on them; where each value lies; how many places there are.

        A value takes the place of one that nothing needs any more. Of long arrays all that were ever made would be more
        than a cache holds, and each would have to be asked of the system again, which takes longer than to fill it.
        """
        operations = self.tape.instructions
        inputs = [k for k, op in enumerate(operations) if op[0] in ROLES]
        constants = [k for k, op in enumerate(operations) if op[0] == "const"]
        rest = [k for k, op in enumerate(operations) if operands(op)]
        place = {number: k for k, number in enumerate([*inputs, *constants])}
        last = {i: k for k in rest for i in operands(operations[k])}
        last |= dict.fromkeys(self.tape.outputs, len(operations))
        size, idle, placed = len(place), list[int](), list[_Placed]()
        for k in rest:
            at = [place[i] for i in operands(operations[k])]
            idle += {place[i] for i in operands(operations[k]) if last[i] == k}
            if not idle:
                idle, size = [size], size + 1
            place[k] = idle.pop()
            placed.append((operations[k], at, place[k]))
        return (
            [(self.roles.index(operations[k][0]), operations[k][1]) for k in inputs],
            [float(operations[k][1]) for k in constants],
            placed,
            [place[k] for k in self.tape.outputs],
            size,
        )

    @cached_property
    def _steps(self) -> dict[int, tuple[Any, list[_Step]]]:
        return {}

    def _bound(self, xp: Any, operations: Sequence[_Placed]) -> list[_Step]:
        """Return the operations with the functions of one namespace, which are kept for the few there are."""
        found = self._steps.get(id(xp))
        if found is None or found[0] is not xp:
            steps = [
                (len(of), self._meaning(op, xp), of[0], of[min(1, len(of) - 1)], of[-1], at)
                for op, of, at in operations
            ]
            if len(self._steps) > 8:
                self._steps.clear()
            found = self._steps[id(xp)] = (xp, steps)
        return found[1]

    def _meaning(self, operation: Instruction, xp: Any) -> Callable[..., Any]:
        if operation[0] == "table":
            return partial(xp.table, next(t for t in self.tape.tables if t.digest == operation[2]))
        return _SIGNS.get(operation[0]) or getattr(xp, operation[0])
