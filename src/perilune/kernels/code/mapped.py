"""A traced function as machine code: over a batch, out[lane] = f(a[lane], b[lane], ...), or at one point.

The kernels of `emit` between a loop that gathers lanes and one that scatters them; the same cache, threads
and fallback as arcs. At one point the kernel has one lane, so that nothing is computed four times.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np

from perilune.kernels.algebra.program import trace
from perilune.kernels.code import cache as disk, native
from perilune.kernels.code.emit import kernel, library
from perilune.kernels.code.ir import INT, NUM, Int, Num, Ptr, Vec, Writer
from perilune.words.outcome import PeriluneError
from perilune.words.types import Matrix, Vector

_WIDTH = 4
_LANES_PER_THREAD = 512


class SingleMap:
    """Evaluates a traced function at one point into arrays of its own. Use `compile_single`.

    Attributes
    ----------
    outputs
        The outputs of the function, each (rows, columns). Overwritten by the next call.
    """

    def __init__(
        self, inputs: list[int], shapes: list[tuple[int, int]], bind: Callable[[list[Any]], Callable[[], Any]]
    ) -> None:
        cuts = np.cumsum([0, *(rows * columns for rows, columns in shapes)])
        result = np.full(int(cuts[-1]), np.nan)
        self._inputs = [np.zeros(size) for size in inputs]
        self._shapes = [(size,) for size in inputs]
        self.outputs: tuple[Matrix, ...] = tuple(
            result[first:last].reshape(shape) for first, last, shape in zip(cuts, cuts[1:], shapes, strict=False)
        )
        self._held: list[Any] = [result, *self._inputs]  # the machine code knows only their addresses
        self._evaluate = bind(self._held)

    def __call__(self, *arguments: Vector) -> tuple[Matrix, ...]:
        """Evaluate; arguments (n,) each, empty ones included; returns `outputs`.

        Raises
        ------
        PeriluneError
            On arguments of the wrong number or shape.
        """
        if [a.shape for a in arguments] != self._shapes:
            raise PeriluneError(
                "a compiled function takes vectors of fixed lengths",
                got=str([np.shape(a) for a in arguments]),
                expected=str(self._shapes),
            )
        for held, given in zip(self._inputs, arguments, strict=True):
            held[:] = given
        self._evaluate()
        return self.outputs


def compile_map(function: Any, *, cache: bool = True, backend: str | None = None) -> Callable[..., Matrix]:
    """Compile an SX ``casadi.Function`` of column vectors with one dense output.

    Returns
    -------
    mapped
        (a (lanes, na), b (lanes, nb), ...) -> (lanes, m); an argument of one row serves every lane.
    """
    if not native.chosen(backend):
        return lambda *arguments: _interpreted(function, arguments)

    call = _native(function, _WIDTH, cache)
    sizes = [function.size1_in(i) for i in range(function.n_in())]
    rows = function.size1_out(0)

    def mapped(*arguments: Matrix) -> Matrix:
        held = [_rows_in_one_piece(a, n) for a, n in zip(arguments, sizes, strict=True)]
        lanes = max(len(a) for a in held)
        out = np.empty((lanes, rows))
        entries = [native.address(out)]
        for a in held:
            place = native.address(a) if a.flags.c_contiguous else a.ctypes.data
            entries += [place, a.strides[0] // a.itemsize if len(a) == lanes else 0]
        table = np.array([lanes, *entries], dtype=np.int64)
        most = lanes // _LANES_PER_THREAD
        threads = min(os.cpu_count() or 1, most) if most > 1 else 1
        groups = -(-lanes // _WIDTH)
        share = -(-groups // threads)
        if threads == 1:
            call(0, groups, native.address(table))
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(
                    pool.map(
                        lambda k: call(k * share, min((k + 1) * share, groups), native.address(table)),
                        range(threads),
                    )
                )
        return out

    return mapped


def _rows_in_one_piece(array: Matrix, size: int) -> Matrix:
    """The array as (lanes, size), the entries of a row beside each other; rows may lie apart, as in a slice."""
    rows = np.asarray(array, dtype=float).reshape(-1, size)
    apart, beside = rows.strides
    whole = beside == rows.itemsize and apart >= 0 and apart % rows.itemsize == 0
    return rows if whole else np.ascontiguousarray(rows)


def compile_single(function: Any, *, cache: bool = True, backend: str | None = None) -> SingleMap:
    """Compile an SX ``casadi.Function`` of column vectors, with any outputs, for one evaluation at a time.

    Returns
    -------
    evaluate
        (a (na,), b (nb,), ...) -> the outputs, each dense and (rows, columns), in arrays that the next call
        overwrites: copy what has to outlive it. One object for each thread.
    """
    import casadi as ca

    sizes = [function.size1_in(i) for i in range(function.n_in())]
    shapes = [tuple(function.size_out(i)) for i in range(function.n_out())]
    symbols = [ca.SX.sym(f"a{i}", size) for i, size in enumerate(sizes)]
    rows = [ca.vec(ca.densify(output).T) for output in function.call(symbols)]  # row by row, as NumPy reads them
    flat = ca.Function("flat", symbols, [ca.vertcat(*rows)])

    def interpret(held: list[Any]) -> Callable[[], None]:
        def evaluate() -> None:
            held[0][:] = np.asarray(flat(*held[1:])).ravel()

        return evaluate

    def bind(held: list[Any]) -> Callable[[], None]:
        inputs = [entry for a in held[1:] for entry in (native.address(a), 0)]
        table = np.array([1, native.address(held[0]), *inputs], dtype=np.int64)
        held.append(table)  # as long-lived as what it points to
        return partial(_native(flat, 1, cache), 0, 1, native.address(table))

    return SingleMap(sizes, shapes, bind if native.chosen(backend) else interpret)


def _native(function: Any, width: int, cache: bool) -> Any:
    """Return ``map(first group, last group, table)`` of a function, from disk or compiled."""

    def build() -> bytes:
        return native.compile_ir(_module(function, width))

    name = disk.key(function.serialize(), f"map {width}", *native.processor(), *native.versions())
    code = native.MachineCode(disk.fetch(name, build, enabled=cache))
    return code.function("map", ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p)


def _interpreted(function: Any, arguments: tuple[Matrix, ...]) -> Matrix:
    lanes = max(len(np.atleast_2d(a)) for a in arguments)
    columns = [np.broadcast_to(np.atleast_2d(a), (lanes, np.shape(a)[-1])).T for a in arguments]
    return np.asarray(function.map(lanes)(*columns)).reshape(-1, lanes).T.copy()


def _module(function: Any, width: int) -> str:
    program = trace(function)
    count, rows = function.n_in(), function.size1_out(0)
    w, table = Writer(width), Ptr("%table", INT)
    inputs = [w.buffer(function.size1_in(i)) for i in range(count)]
    result = w.buffer(rows)
    lanes, out = w.load(table, 0), w.address(table, 1, NUM)
    with w.loop(Int("%first"), Int("%last")) as group:
        base = w.integer("mul", group, width)
        for i, held in enumerate(inputs):
            source, stride = w.address(table, 2 + 2 * i, NUM), w.load(table, 3 + 2 * i)
            _rows(w, (base, lanes), source, stride, held, function.size1_in(i))
        w.run(f"call void @kernel({', '.join(f'ptr {x}' for x in (*inputs, result))})")
        with w.loop(0, width) as k:
            lane = w.integer("add", base, k)
            with w.when(w.below(lane, lanes)), w.loop(0, rows) as c:
                value = w.load(w.by_lane(result), w.entry(c, width, k))
                w.store(value, out, w.entry(lane, rows, c))
    mapping = f"define void @map(i64 %first, i64 %last, ptr %table) nounwind {{\n{w.body()}\n  ret void\n}}\n"
    return "\n".join([library([program], width), kernel("kernel", program, range(count), width), mapping])


def _rows(w: Writer, group: tuple[Int, Int], source: Ptr[Num], stride: Int, target: Ptr[Vec], size: int) -> None:
    """Gather one argument of a group (its first lane, lanes of all); places beyond repeat the last lane."""
    base, lanes = group
    final = w.integer("sub", lanes, 1)
    with w.loop(0, w.width) as k:
        place = w.integer("add", base, k)
        inside = w.below(place, lanes)
        lane = w.choose(inside, INT, place, final)
        start = w.integer("mul", lane, stride)
        with w.loop(0, size) as c:
            value = w.load(source, w.integer("add", start, c))
            w.store(value, w.by_lane(target), w.entry(c, w.width, k))
