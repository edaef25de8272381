"""One arc at a time, without ceremony: what a shooting iteration calls thousands of times.

Arrays are allocated once and the machine code is bound to their addresses, so that a call copies its
arguments in, runs, and leaves its results in the same arrays. What it returned before is thereby overwritten:
copy what has to outlive the next call. An object belongs to one thread at a time; each thread makes its own
(the machine code behind it is shared and costs nothing).

    fly = engine.single(columns=True)                  # once, and kept
    if fly(z0, p, duration, seeds) == ArcStatus.REACHED:
        use(fly.z, fly.S)                              # views, valid until the next call
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.kernels.flight.arcs import INFO, MAX_EVENTS
from perilune.words.outcome import PeriluneError
from perilune.words.types import Matrix, Vector

#: Given the arrays of a call by name, return what runs it.
Binder = Callable[[dict[str, NDArray[Any]]], Callable[[], Any]]

_TIME, _STATUS, _STEPS, _MODE, _EVENTS = range(len(INFO))


class SingleArc:
    """Flies one arc at a time into arrays of its own. Use `Engine.single`; one object for each thread.

    Attributes
    ----------
    z
        State at the end of the last arc, (nz,). Overwritten by the next call, as are `rate` and `S`.
    rate
        z' there, in the mode at the end, (nz,).
    S
        Columns there, (nz, nc); nc = 0 for an object without columns.
    """

    def __init__(self, system: Any, columns: bool, bind: Binder, *, rtol: float, atol: float, max_steps: int) -> None:
        nz, nc = system.nz, system.nc if columns else 0
        self.z: Vector = np.full(nz, np.nan)
        self.rate: Vector = np.full(nz, np.nan)
        self.S: Matrix = np.zeros((nz, nc))  # entries that are zero for every arc are never written
        self._z0, self._p, self._seeds = np.zeros(nz), np.zeros(system.np), np.zeros((nz, nc))
        self._shapes = (nz,), (system.np,), (nz, nc)
        self._duration, self._mode, self._info = np.zeros(1), np.zeros(1), np.zeros(len(INFO))
        self._log = np.full((MAX_EVENTS if system.events else 0, 2), np.nan)
        self._modes = len(system.modes)
        self._rtol, self._atol = np.array([rtol]), np.array([atol])
        held: dict[str, NDArray[Any]] = {
            "lanes": np.array(1),
            "order": np.zeros(1, dtype=np.int64),
            "z0": self._z0,
            "p": self._p,
            "p_stride": np.array(0),
            "duration": self._duration,
            "seeds": self._seeds,
            "rtol": self._rtol,
            "atol": self._atol,
            "mode": self._mode,
            "max_steps": np.array(max_steps),
            "fixed_steps": np.array(0),
            "z": self.z,
            "rates": self.rate,
            "columns": self.S,
            "info": self._info,
            "log": self._log,
        }
        self._held = held  # the machine code knows only their addresses
        self._fly = bind(held)

    def demand(self, tolerance: float) -> None:
        """Fly with this local error, relative and absolute, from the next call on."""
        self._rtol[0] = self._atol[0] = tolerance

    def __call__(self, z0: Vector, p: Vector, duration: float, seeds: Matrix | None = None, mode: int = 0) -> int:
        """Fly one arc.

        Parameters
        ----------
        z0
            Start, (nz,).
        p
            Parameters, (np,).
        duration
            Length; negative flies backward.
        seeds
            S(0), (nz, nc), to be given exactly if the object has columns.
        mode
            Mode at the start.

        Returns
        -------
        status
            `ArcStatus` as a whole number; the rest lies in `z`, `S`, `time`, `mode`, `steps`.

        Raises
        ------
        PeriluneError
            On arrays of the wrong shape, seeds where there are no columns or the reverse, or a mode that does
            not exist.
        """
        given = self._seeds if seeds is None and not self._shapes[2][1] else seeds
        if given is None or (z0.shape, p.shape, given.shape) != self._shapes:
            raise PeriluneError(
                "one arc takes z0, p and seeds of fixed shapes",
                got=f"{np.shape(z0)}, {np.shape(p)}, {None if seeds is None else np.shape(seeds)}",
                expected=", ".join(map(str, self._shapes)),
            )
        if not 0 <= mode < self._modes:
            raise PeriluneError(
                "an arc starts in a mode that does not exist", got=str(mode), expected=f"0 to {self._modes - 1}"
            )
        self._z0[:] = z0
        self._p[:] = p
        if seeds is not None:
            self._seeds[:] = seeds
        self._duration[0] = duration
        self._mode[0] = mode
        self._fly()
        return int(self._info[_STATUS])

    @property
    def time(self) -> float:
        """Time flown by the last arc."""
        return float(self._info[_TIME])

    @property
    def steps(self) -> int:
        """Steps that it took."""
        return int(self._info[_STEPS])

    @property
    def mode(self) -> int:
        """Mode at its end."""
        return int(self._info[_MODE])

    @property
    def events(self) -> list[tuple[int, float]]:
        """Events that it met, in order: index and time."""
        met = min(int(self._info[_EVENTS]), len(self._log))
        return [(int(index), float(time)) for index, time in self._log[:met]]
