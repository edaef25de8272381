"""Arcs bound to arrays: integrated from and into the same arrays as often as wanted, without allocation.

Machine code is given the addresses of its arrays once. A batch is bound, integrated and read; a shooting iteration,
which flies one arc thousands of times, keeps the binding, fills the arrays of its `Request` again and runs again. What
was returned before is thereby overwritten: copy what has to outlive the next flight. A binding belongs to one thread at
a time.

    flight = engine.bind(request)       # once, and kept
    request.z0[:] = start
    flight()
    use(flight.z, flight.columns)       # valid until the next flight
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perilune.core import Matrix, Stack
from perilune.kernels.flight.dense import DenseArc
from perilune.kernels.flight.records import INFO, MAX_EVENTS, Arcs, ArcStatus, Request

_STATUS, _EVENTS = INFO.index("status"), INFO.index("events")
_LAST_SUCCESS = float(ArcStatus.EVENT)
_NONE = np.zeros(0, dtype=np.intp)


class BoundArcs:
    """Flies the arcs of a request. Use `Engine.bind`; one object for each thread.

    Parameters
    ----------
    system
        What is flown.
    asked
        The request, whose arrays are read at each flight.
    bind
        Given this object, returns what flies it, on so many threads or (None) on all.
    nodes
        Where the start of each step of the one arc goes, (steps, 3 + nz).

    Attributes
    ----------
    order
        In which the lanes are flown.
    z, rates
        State at the end, and z' there in the mode at the end, (lanes, nz). Overwritten by the next flight, as all here.
    columns
        Columns there, (lanes, nz, nc); nc = 0 where none are asked.
    info
        `INFO` of each lane, (lanes, 5).
    log
        Number and time of each event, (lanes, MAX_EVENTS, 2); beyond those of this flight they are not this one's.
    """

    def __init__(
        self,
        system: Any,
        asked: Request,
        bind: Callable[[BoundArcs], Callable[[int | None], None]],
        nodes: Matrix | None = None,
    ) -> None:
        lanes, nz = asked.z0.shape
        self.asked, self.nodes = asked, nodes
        self.order: NDArray[np.int64] = np.arange(lanes)
        self.z: Matrix = np.full((lanes, nz), np.nan)
        self.rates: Matrix = np.full((lanes, nz), np.nan)
        # Entries that are zero for every arc are never written.
        self.columns: Stack = np.zeros((lanes, nz, 0) if asked.seeds is None else asked.seeds.shape)
        self.info: Matrix = np.full((lanes, len(INFO)), np.nan)
        self._status = self.info[:, _STATUS]
        self.log: Stack = np.empty((lanes, MAX_EVENTS if system.events else 0, 2))
        self._fly = bind(self)

    def __call__(self, threads: int | None = None) -> None:
        """Fly; `threads` at most, where the batch is wide enough."""
        self._fly(threads)

    @property
    def lost(self) -> NDArray[np.intp]:
        """Lanes that reached neither their end nor a terminal event."""
        if np.maximum.reduce(self._status, initial=0.0) <= _LAST_SUCCESS:
            return _NONE
        return np.nonzero(self._status > _LAST_SUCCESS)[0]

    def ends(self) -> Arcs:
        """Return the ends of the last flight; the arrays are those of this object."""
        count = self.log.shape[1]
        met = np.arange(count) < self.info[:, [_EVENTS]]
        time, status, steps, mode, _ = self.info.T
        return Arcs(
            z=self.z,
            rates=self.rates,
            columns=self.columns,
            time=time,
            status=status.astype(np.int64),
            steps=steps.astype(np.int64),
            mode=mode.astype(np.int64),
            event_index=np.where(met, self.log[:, :, 0], -1.0).astype(np.int64),
            event_time=np.where(met, self.log[:, :, 1], np.nan),
        )


class Engine(Protocol):
    """The engine that `compile_arcs` returns, whichever way it computes."""

    backend: str
    system: Any

    def propagate(
        self,
        z0: ArrayLike,
        p: ArrayLike,
        duration: ArrayLike,
        columns: ArrayLike | None = None,
        **settings: Any,
    ) -> Arcs:
        """Fly a batch of arcs; see `perilune.kernels.flight.engine.NativeEngine.propagate`.

        Parameters
        ----------
        z0
            States at the start, shape (lanes, nz) or (nz,).
        p
            Parameters, shape (lanes, np), or (np,) for all.
        duration
            Durations, shape (lanes,) or one for all, in the unit of time of the system; negative backward in time.
        columns
            Derivatives of z0 by nc numbers, shape (lanes, nz, nc) or (nz, nc); None for the states only.
        **settings
            Tolerances, limits of steps and the mode at the start, as for `perilune.kernels.flight.records.request`.
        """
        ...

    def dense(self, z0: ArrayLike, p: ArrayLike, duration: float, **settings: Any) -> DenseArc:
        """Fly one arc and return it as a function of time; see `perilune.kernels.flight.dense.DenseArc`.

        Parameters
        ----------
        z0
            State at the start, shape (nz,).
        p
            Parameters, shape (np,).
        duration
            Duration of the arc, in the unit of time of the system.
        **settings
            As for `propagate`.
        """
        ...

    def bind(self, asked: Request) -> BoundArcs:
        """Return what flies a request, whose arrays are not checked, as often as is wanted."""
        ...
