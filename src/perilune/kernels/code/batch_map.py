"""Batch map: a traced function as machine code over a batch, out[lane] = f(a[lane], b[lane], ...).

The kernels of `emit` between a loop that gathers lanes and one that scatters them; the same cache, threads
and fallback as arcs, and like them bound to arrays that may be filled and evaluated again.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from perilune.core import Matrix, PeriluneError
from perilune.kernels.algebra.program import trace_function
from perilune.kernels.code import cache as disk, native
from perilune.kernels.code.emit import KernelSource, emit_kernels, library
from perilune.kernels.code.ir import INT, NUM, Index, Int, Ptr, Vec, Writer
from perilune.kernels.code.threads import run_in_threads

_WIDTH = 4
_LANES_PER_THREAD = 512
# What begins the table of a map: the kernel, how often it is applied, the lanes, how many inputs and outputs there are,
# and the lengths of all inputs and of all outputs. Behind it are address, stride and length of each of them.
_TABLE = 7


class BoundMap:
    """A map bound to arrays: evaluated from the same into the same as often as is wanted. Use `Map.bind`.

    Attributes
    ----------
    inputs
        What is read, each (lanes, n) or (1, n): the arrays that were given where their rows are in one piece.
    outputs
        What is written, each (lanes, m). Overwritten by the next call.
    """

    def __init__(
        self, inputs: Sequence[Matrix], widths: Sequence[int], bind: Callable[[BoundMap], Callable[[], Any]]
    ) -> None:
        self.inputs = inputs
        self.lanes: int = max(map(len, inputs)) if all(map(len, inputs)) else 0  # one row serves no empty array
        self.outputs: tuple[Matrix, ...] = tuple(np.empty((self.lanes, m)) for m in widths)
        self._evaluate = bind(self)

    def __call__(self) -> None:
        """Evaluate in all lanes."""
        self._evaluate()


class Map:
    """A traced function over lanes. Use `compile_map`."""

    def __init__(self, function: Any, times: int, cache: bool, compiled: bool) -> None:
        self._sizes = [function.size1_in(i) for i in range(function.n_in())]
        self._widths = [function.numel_out(i) for i in range(function.n_out())]
        self._flat, self._times = _flat(function), times
        self._kernel = _native(self._flat, times, cache) if compiled else None
        self._ones = [1] * len(self._sizes)
        self._idle = list[BoundMap]()  # of one lane, which is asked again and again; its pop and append are atomic

    def bind(self, *arguments: Matrix) -> BoundMap:
        """Bind to arrays (lanes, n); one of one row serves every lane.

        Raises
        ------
        PeriluneError
            On arguments of the wrong number or width.
        """
        if [a.shape[1:] for a in arguments] != [(n,) for n in self._sizes]:
            raise self._of_other_widths(arguments)
        bind = self._interpreted if self._kernel is None else partial(_evaluation, self._kernel)
        return BoundMap([_in_rows(a) for a in arguments], self._widths, bind)

    def __call__(self, *arguments: Matrix) -> tuple[Matrix, ...]:
        """Return the outputs of one evaluation."""
        if [len(a) for a in arguments] != self._ones:
            bound = self.bind(*arguments)
            bound()
            return bound.outputs
        try:
            bound = self._idle.pop()
        except IndexError:
            bound = self.bind(*(np.array(a, dtype=float) for a in arguments))
        for own, given in zip(bound.inputs, arguments, strict=True):
            if own.shape != given.shape:
                raise self._of_other_widths(arguments)
            own[:] = given
        bound()
        found = tuple([out.copy() for out in bound.outputs])  # a list is filled faster than a generator is run
        self._idle.append(bound)
        return found

    def _of_other_widths(self, arguments: Sequence[Matrix]) -> PeriluneError:
        return PeriluneError(
            "a compiled function takes rows of fixed lengths",
            got=str([a.shape for a in arguments]),
            expected=", ".join(f"(lanes, {n})" for n in self._sizes),
        )

    def _interpreted(self, bound: BoundMap) -> Callable[[], None]:
        if not bound.lanes:
            return lambda: None
        function, cuts = self._flat.map(bound.lanes), np.cumsum(self._widths)[:-1]

        def evaluate() -> None:
            columns = [np.broadcast_to(a, (bound.lanes, a.shape[1])).T for a in bound.inputs]
            rows = np.asarray(function(*columns)).reshape(-1, bound.lanes).T
            for _ in range(1, self._times):
                rows = np.asarray(function(rows.T, *columns[1:])).reshape(-1, bound.lanes).T
            for out, found in zip(bound.outputs, np.split(rows, cuts, axis=1), strict=True):
                out[:] = found

        return evaluate


def compile_map(function: Any, *, times: int = 1, cache: bool = True, backend: str | None = None) -> Map:
    """Compile an SX ``casadi.Function`` of column vectors.

    Parameters
    ----------
    function
        What to compile.
    times
        How often it is applied: its one output takes the place of its first argument and the others stay, as in a march
        of equal steps.
    cache, backend
        As for `compile_arcs`.

    Returns
    -------
    mapped
        (a (lanes, na), b (lanes, nb), ...) -> its outputs, each (lanes, m), matrices row by row as NumPy reads them; an
        argument of one row serves every lane.
    """
    return Map(function, times, cache, native.choose_native(backend))


def _flat(function: Any) -> Any:
    """Return the function with one output, a column: all of its outputs row by row."""
    import casadi as ca

    symbols = [ca.SX.sym(f"a{i}", function.size1_in(i)) for i in range(function.n_in())]
    rows = [ca.vec(ca.densify(output).T) for output in function.call(symbols)]
    return ca.Function("flat", symbols, [ca.vertcat(*rows)])


def _evaluation(kernel: _Kernel, bound: BoundMap) -> Callable[[], Any]:
    """Return what evaluates a bound map in machine code; its arrays live as long as it does."""
    counts = [len(bound.inputs), len(bound.outputs)]
    sizes = [sum(a.shape[1] for a in arrays) for arrays in (bound.inputs, bound.outputs)]
    entries = [kernel.place, kernel.times, bound.lanes, *counts, *sizes]
    for a in (*bound.inputs, *bound.outputs):
        place = native.array_address(a) if a.flags.c_contiguous else a.ctypes.data
        entries += [place, a.strides[0] // a.itemsize if len(a) == bound.lanes else 0, a.shape[1]]
    call, table, groups = _rows_of_groups(), native.argument_table(entries), -(-bound.lanes // _WIDTH)
    most = bound.lanes // _LANES_PER_THREAD
    threads = min(os.cpu_count() or 1, most) if most > 1 else 1
    share = max(-(-groups // threads), 1)
    # What each share computes with, as no stack holds a large Jacobian; zeros stay where the function has them.
    rooms = {first: np.zeros(_WIDTH * (sum(sizes) + 1)) for first in range(0, max(groups, 1), share)}
    aligned = 8 * _WIDTH
    begins = {first: -(-native.array_address(room) // aligned) * aligned for first, room in rooms.items()}
    table.of = kernel, rooms  # which live as long as what points to them; of two kernels made at once one is let go
    if threads == 1:
        return partial(call, 0, groups, table, begins[0])

    def evaluate() -> None:
        run_in_threads(
            lambda first: call(first, min(first + share, groups), table, begins[first]), list(begins), threads
        )

    return evaluate


def _in_rows(array: Matrix) -> Matrix:
    """Return the array with the entries of a row next to each other; rows may lie apart, as in a slice."""
    rows = np.asarray(array, dtype=float)
    apart, beside = rows.strides
    whole = beside == rows.itemsize and apart >= 0 and apart % rows.itemsize == 0
    return rows if whole else np.ascontiguousarray(rows)


class _Kernel(NamedTuple):
    """A flat function in machine code, ``kernel(inputs, result)``: vectors, the inputs one behind another."""

    code: Any
    place: int
    times: int


def _native(function: Any, times: int, cache: bool) -> _Kernel:
    """Return the kernel of a flat function, from disk or compiled."""
    name = disk.object_key(function.serialize(), f"kernel {_WIDTH}", *native.host_processor(), *native.code_versions())
    content = disk.fetch_object(name, lambda: native.compile_ir(_map_module(function)), enabled=cache)
    code = native.MachineCode(content).function("kernel", ctypes.c_void_p, ctypes.c_void_p)
    return _Kernel(code, ctypes.cast(code, ctypes.c_void_p).value or 0, times)


def _map_module(function: Any) -> str:
    program, w, begin = trace_function(function), Writer(_WIDTH), 0
    inputs = list[str]()
    for i in range(function.n_in()):
        inputs.append(w.at(Ptr("%held", w.vector), begin))
        begin += function.size1_in(i)
    w.run(f"call void @flat({', '.join(f'ptr {x}' for x in (*inputs, '%out'))})")
    entry = f"define void @kernel(ptr %held, ptr %out) nounwind {{\n{w.body()}\n  ret void\n}}\n"
    flat = KernelSource(name="flat", program=program, arguments=(*range(len(inputs)),), cleared=True)
    return "\n".join([library([program], _WIDTH), emit_kernels([flat], _WIDTH), entry])


@cache
def _rows_of_groups() -> Callable[..., None]:
    """Return ``map(first group, last group, table, room)``, one for all: their own would be most of their code."""
    name = disk.object_key("map", f"{_WIDTH}", *native.host_processor(), *native.code_versions())
    code = native.MachineCode(disk.fetch_object(name, lambda: native.compile_ir(_mapping()), enabled=True))
    return code.function("map", ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)


def _mapping() -> str:
    """Write the loop over groups of lanes by `_TABLE`. The stride of an input is 0 where one row serves all lanes."""
    w, table = Writer(_WIDTH), Ptr("%table", INT)
    times, lanes, count_in, count_out, size_in, size_out = (w.load(table, k) for k in range(1, _TABLE))
    kernel = w.address(table, 0, w.vector)
    inputs = Ptr("%room", w.vector)
    results = w.at(inputs, size_in)
    place = w.allocate(INT, 1)

    def carried(name: str, first: Index, count: Int, held: Ptr[Vec], base: Int) -> None:
        w.store(Int("0"), place)
        with w.loop(0, count) as k:
            at = w.integer("add", w.integer("mul", k, 3), first)
            rows, stride, size = w.address(table, at, NUM), *(w.load(w.at(table, at), j) for j in (1, 2))
            own = w.at(held, w.load(place))
            w.run(f"call void @{name}(ptr {rows}, i64 {stride}, i64 {size}, i64 {base}, i64 {lanes}, ptr {own})")
            w.store(w.integer("add", w.load(place), size), place)

    with w.loop(Int("%first"), Int("%last")) as group:
        base = w.integer("mul", group, _WIDTH)
        carried("gather", _TABLE, count_in, inputs, base)
        w.run(f"call void {kernel}(ptr {inputs}, ptr {results})")
        with w.loop(1, times):
            with w.loop(0, size_out) as entry:
                w.store(w.load(results, entry), inputs, entry)
            w.run(f"call void {kernel}(ptr {inputs}, ptr {results})")
        carried("scatter", w.integer("add", w.integer("mul", count_in, 3), _TABLE), count_out, results, base)
    mapping = (
        f"define void @map(i64 %first, i64 %last, ptr %table, ptr %room) nounwind {{\n{w.body()}\n  ret void\n}}\n"
    )
    return "\n".join([_write_row_transfer("gather"), _write_row_transfer("scatter"), mapping])


def _write_row_transfer(name: str) -> str:
    """Write what gathers the rows of a group into vectors, or scatters them; places beyond repeat the last lane."""
    w, base, lanes, size = Writer(_WIDTH), Int("%base"), Int("%lanes"), Int("%size")
    rows, held = Ptr("%rows", NUM), Ptr("%held", w.vector)
    final = w.integer("sub", lanes, 1)
    with w.loop(0, w.width) as k:
        place = w.integer("add", base, k)
        lane = w.choose(w.below(place, lanes), INT, place, final)
        row = w.at(rows, w.integer("mul", lane, Int("%stride")))
        with w.loop(0, size) as c:
            beside = w.entry(c, w.width, k)
            if name == "gather":
                w.store(w.load(row, c), w.by_lane(held), beside)
            else:
                w.store(w.load(w.by_lane(held), beside), row, c)
    head = f"define internal void @{name}(ptr %rows, i64 %stride, i64 %size, i64 %base, i64 %lanes, ptr %held)"
    return f"{head} nounwind noinline {{\n{w.body()}\n  ret void\n}}\n"
