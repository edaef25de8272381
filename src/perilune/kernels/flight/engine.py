"""Engine of arc propagation: compiled when first needed, kept on disk, run on every core.

Four lanes are the width that measures fastest (the stages of eight leave the first cache). One arc goes with the code
for four, which takes a tenth longer than code of its own would: so it is what it is among many, to the last bit. Only
the nodes of a dense arc are written by code for one lane. The equations of each pair (columns or not, lanes) are an
object of their own, compiled when first asked for; the loop that steps them is that of all whose events are located
alike, which for a small system would be most of its code.
"""

from __future__ import annotations

import ctypes
import logging
import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perilune.core import Matrix, Vector
from perilune.kernels.algebra.system import ArcSystem, Event
from perilune.kernels.code import cache as disk, native
from perilune.kernels.code.threads import run_in_threads
from perilune.kernels.flight.bound_buffers import BoundArcs, Engine
from perilune.kernels.flight.dense import DenseArc, dense_arc
from perilune.kernels.flight.records import EQUATIONS, TABLE, Arcs, Request, request

_LOG = logging.getLogger("perilune.kernels")
LANES = 4
_GROUPS_PER_THREAD = 16  # below this a second thread costs more than it gives
_loops = dict[str, native.MachineCode]()  # those loaded, by what they depend on
_told: list[str] = []  # the fallback is mentioned once for each process


def compile_arcs(
    rhs: Any | Sequence[Any],
    *,
    columns: int | NDArray[np.bool_] = 0,
    events: Sequence[Event] = (),
    solved: Sequence[Any] = (),
    cache: bool = True,
    backend: str | None = None,
) -> Engine:
    """Make an engine that flies arcs of z' = rhs(z, p).

    Parameters
    ----------
    rhs
        SX ``casadi.Function`` (z[nz], p[np]) -> z'[nz], or one for each mode of the dynamics.
    columns
        Number nc of variational columns S' = (drhs/dz) S; or which entries of S(0) may be nonzero, bool (nz,
        nc), which lets those that stay zero be left out.
    events
        Zero crossings to meet.
    solved
        For each mode None or an SX function (z, p) -> w of numbers that the mode takes behind its parameters, (z,
        [p; w]) -> z'. Derivatives are taken at fixed w, so the mode has to close with a Newton step from w.
    cache
        Whether to keep the machine code on disk.
    backend
        "native", "scipy", or None: native where llvmlite is installed.

    Raises
    ------
    PeriluneError
        On an operation without machine code, on functions that do not fit together, or an unknown backend.
    """
    modes = tuple(rhs) if isinstance(rhs, Sequence) else (rhs,)
    seeds = (
        np.ones((modes[0].size1_in(0), columns), dtype=bool) if isinstance(columns, int) else np.array(columns, bool)
    )
    system = ArcSystem(modes=modes, solved=tuple(solved) or (None,) * len(modes), events=tuple(events), seeds=seeds)
    if native.choose_native(backend):
        return NativeEngine(system, cache=cache)
    from perilune.kernels.flight.scipy_engine import ScipyEngine

    if backend is None and not _told:
        _told.append("told")
        _LOG.warning("llvmlite is not installed: arcs are integrated by SciPy, about a hundred times slower")
    return ScipyEngine(system)


class NativeEngine:
    """Flies arcs of one `ArcSystem` in machine code. Use `compile_arcs`."""

    backend = "native"

    def __init__(self, system: ArcSystem, *, cache: bool) -> None:
        self.system = system
        self._bare = system.without_columns() if system.nc else system
        self._cache = cache
        self._flown = dict[tuple[bool, int], _CompiledSystem]()
        self._rate: Callable[..., None] | None = None

    def _code(self, columns: bool, width: int) -> _CompiledSystem:
        which = (columns, width)
        if which not in self._flown:
            system = self.system if columns else self._bare

            def build() -> bytes:
                from perilune.kernels.flight import equations_code as equations

                return native.compile_ir(equations.equations_module(system, width))

            name = disk.object_key(system.key, str(width), *native.host_processor(), *native.code_versions())
            code = native.MachineCode(disk.fetch_object(name, build, enabled=self._cache))
            table = native.argument_table([0] * (len(EQUATIONS) + len(system.transitions)))
            code.function("equations", ctypes.c_void_p)(table)
            stepping = _stepping_loop(system, width)
            call = stepping.function("arcs", ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p)
            self._flown[which] = _CompiledSystem(call, stepping, ctypes.addressof(table), (table, code))
        return self._flown[which]

    def propagate(
        self,
        z0: ArrayLike,
        p: ArrayLike,
        duration: ArrayLike,
        columns: ArrayLike | None = None,
        *,
        threads: int | None = None,
        **settings: Any,
    ) -> Arcs:
        """Fly a batch of arcs.

        Parameters
        ----------
        z0
            Starts, (lanes, nz) or (nz,).
        p
            Parameters, (np,) for all lanes or (lanes, np).
        duration
            Lengths, (lanes,) or one for all; negative flies backward.
        columns
            S(0), (lanes, nz, nc) or (nz, nc); None flies without columns.
        threads
            Cores to use; None: all, where the batch is wide enough.
        **settings
            `rtol`, `atol` (1e-12; numbers or one for each lane) for the local error of z: columns are carried along;
            `fixed_steps` takes that many equal steps instead; `max_steps` attempts; `mode` at the start.

        Raises
        ------
        PeriluneError
            On shapes that do not fit.
        """
        asked = request(
            (self.system.nz, self.system.np, self.system.nc),
            len(self.system.modes),
            z0,
            p,
            duration,
            columns,
            **settings,
        )
        flight = self.bind(asked)
        flight(threads)
        return flight.ends()

    def dense(self, z0: ArrayLike, p: ArrayLike, duration: float, **settings: Any) -> DenseArc:
        """Fly one arc and return it as a function of time; settings as for `propagate`.

        Parameters
        ----------
        z0
            State at the start, shape (nz,).
        p
            Parameters, shape (np,).
        duration
            Duration of the arc, in the unit of time of the system.
        **settings
            As for `propagate`, but for columns and threads.
        """
        asked = request((self.system.nz, self.system.np, 0), len(self.system.modes), z0, p, duration, None, **settings)
        nodes = np.empty((asked.max_steps + 1, 3 + self.system.nz))
        flight = self.bind(asked, nodes)
        flight()
        arcs = flight.ends()
        return dense_arc(arcs, nodes[: arcs.steps[0]], lambda z, mode: self._rates(z, asked.p[0], mode))

    def bind(self, asked: Request, nodes: Matrix | None = None) -> BoundArcs:
        """Return what flies a request as often as is wanted; see `perilune.kernels.flight.bound_buffers`.

        Parameters
        ----------
        asked
            Arrays that fit the system: they are not checked.
        nodes
            Where the start of each step of the one arc goes: (steps, 3 + nz).
        """
        width = LANES if nodes is None else 1  # nodes are written by the code for one lane only
        flown = self._code(asked.seeds is not None, width)
        return BoundArcs(self.system, asked, lambda flight: _bound_flight(flown, width, flight), nodes)

    def _rates(self, z: Matrix, p: Vector, mode: Vector) -> Matrix:
        """Return z' at many points, (count, nz)."""
        flown, out = self._code(False, 1), np.empty(z.shape)
        rates = self._rate
        if rates is None:
            rates = self._rate = flown.stepping.function("rates", ctypes.c_int64, *[ctypes.c_void_p] * 5)
        held = [np.ascontiguousarray(array) for array in (z, p, mode, out)]
        rates(len(z), *map(native.array_address, held), flown.equations)
        return out


class _CompiledSystem(NamedTuple):
    """A system in machine code: the stepping loop of its course, and where its equations are."""

    call: Callable[..., None]
    stepping: native.MachineCode
    equations: int
    held: Any  # what has to live as long


def _stepping_loop(system: ArcSystem, width: int) -> native.MachineCode:
    """Return the stepping loop of all systems whose events are located alike."""
    name = disk.object_key("arcs", system.course, str(width), *native.host_processor(), *native.code_versions())
    if name not in _loops:

        def build() -> bytes:
            from perilune.kernels.flight import stepping_code

            return native.compile_ir(stepping_code.stepping_module(system, width))

        _loops[name] = native.MachineCode(disk.fetch_object(name, build, enabled=True))
    return _loops[name]


def _bound_flight(flown: _CompiledSystem, width: int, flight: BoundArcs) -> Callable[[int | None], None]:
    """Return what flies bound arcs, whose arrays live as long as they do."""
    asked, order, duration, lanes = flight.asked, flight.order, flight.asked.duration, len(flight.order)
    call = flown.call
    counts = {"lanes": lanes, "p_stride": asked.p.shape[1] if len(asked.p) > 1 else 0}
    held = {**vars(asked), **vars(flight), **counts, "equations": flown.equations}
    table = native.argument_table(
        native.array_address(v) if isinstance(v, np.ndarray) else v or 0 for v in map(held.get, TABLE)
    )
    table.of = flown  # which lives as long as what points to it
    groups = -(-lanes // width)
    most = groups // _GROUPS_PER_THREAD

    def fly(threads: int | None) -> None:
        order[:] = np.argsort(np.abs(duration), kind="stable")
        count = min(threads or os.cpu_count() or 1, most)
        if count <= 1:
            call(0, groups, table)
            return
        # Sorted by length, the last groups are the longest: small pieces, longest first, keep all cores busy.
        piece = max(4, groups // (8 * count))
        run_in_threads(
            lambda first: call(first, min(first + piece, groups), table), list(range(0, groups, piece)), count
        )

    return fly if groups > 1 else lambda _: call(0, groups, table)
