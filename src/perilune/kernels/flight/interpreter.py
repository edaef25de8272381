"""Arcs on CasADi's interpreter: the algorithm of `driver` and `crossing` in NumPy, without llvmlite.

Lanes are the columns of arrays and step together; the field is CasADi's own function mapped over them.
Slower by some hundred times, and the twin that the machine code is tested against.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perilune.kernels.algebra.system import ArcSystem
from perilune.kernels.flight import tableau
from perilune.kernels.flight.arcs import MAX_EVENTS, MAX_STEPS, Arcs, ArcStatus, Request, request
from perilune.kernels.flight.dense import DenseArc, dense_arc
from perilune.kernels.flight.interpreted_crossing import Crossings
from perilune.kernels.flight.single import SingleArc
from perilune.words.types import Matrix, Vector

_SAFETY, _SHRINK, _GROW, _RESOLVED, _FIRST, _LEAST = 0.9, 0.2, 10.0, 1e-14, 3.0, 0.01**0.125  # as in `driver`
Mask = NDArray[np.bool_]


class InterpretedEngine:
    """Flies arcs of one `ArcSystem` without machine code. Use `compile_arcs`."""

    backend = "interpreter"

    def __init__(self, system: ArcSystem) -> None:
        self.system = system
        bare = system.without_columns() if system.nc else system
        self._equations = {True: Equations(system), False: Equations(bare)}

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
        """Fly a batch of arcs; see `NativeEngine.propagate`. `threads` has no effect."""
        asked = request(
            (self.system.nz, self.system.np, self.system.nc),
            len(self.system.modes),
            z0,
            p,
            duration,
            columns,
            **settings,
        )
        return Flight(self._equations[asked.seeds is not None], asked).fly()

    def dense(self, z0: ArrayLike, p: ArrayLike, duration: float, **settings: Any) -> DenseArc:
        """Fly one arc and return it as a function of time; see `NativeEngine.dense`."""
        asked = request((self.system.nz, self.system.np, 0), len(self.system.modes), z0, p, duration, None, **settings)
        equations, nodes = self._equations[False], []
        end = Flight(equations, asked, nodes).fly()
        starts = np.array(nodes).reshape(-1, 3 + self.system.nz)
        return dense_arc(end, starts, lambda z, mode: equations.field(z.T, asked.p.T, mode).T)

    def single(
        self, columns: bool = False, *, rtol: float = 1e-12, atol: float = 1e-12, max_steps: int = MAX_STEPS
    ) -> SingleArc:
        """Return what flies one arc at a time; see `NativeEngine.single`."""
        equations = self._equations[columns and bool(self.system.nc)]

        def bind(held: dict[str, NDArray[Any]]) -> Callable[[], None]:
            def fly() -> None:
                asked = Request(
                    z0=held["z0"][None],
                    p=held["p"][None],
                    duration=held["duration"].copy(),
                    seeds=held["seeds"][None] if equations.system.nc else None,
                    rtol=held["rtol"],
                    atol=held["atol"],
                    mode=held["mode"].astype(np.int64),
                    max_steps=max_steps,
                    fixed_steps=0,
                )
                arcs = Flight(equations, asked).fly()
                met = np.count_nonzero(arcs.event_index[0] >= 0)
                held["z"][:], held["rates"][:], held["columns"][:] = arcs.z[0], arcs.rates[0], arcs.columns[0]
                held["info"][:] = arcs.time[0], arcs.status[0], arcs.steps[0], arcs.mode[0], met
                held["log"][:, 0], held["log"][:, 1] = arcs.event_index[0], arcs.event_time[0]

            return fly

        return SingleArc(self.system, columns, bind, rtol=rtol, atol=atol, max_steps=max_steps)


class Equations:
    """The functions of a system, evaluated for all lanes at once: arrays are (entries, lanes)."""

    def __init__(self, system: ArcSystem) -> None:
        self.system = system
        self._fields = [system.field(mode)[0] for mode in range(len(system.modes))]
        self._crossings = system.crossings() if system.events else None
        self._transitions = {(e, i): system.transition(e, i) for e, i, _ in system.transitions}

    def field(self, y: Matrix, p: Matrix, mode: Vector) -> Matrix:
        """Y' of each lane in its mode."""
        result = np.empty_like(y)
        for number, function in enumerate(self._fields):
            here = mode == number
            if np.all(here):
                return over_lanes(function, y, p)
            if np.any(here):
                result[:, here] = over_lanes(function, y, p)[:, here]
        return result

    def crossings(self, y: Matrix, rate: Matrix, p: Matrix) -> Matrix:
        """(g, g') of all events, (2 ne, lanes)."""
        nz = self.system.nz
        return over_lanes(self._crossings, y[:nz], rate[:nz], p)

    def transition(self, event: int, before: int, y: Matrix, p: Matrix) -> Matrix:
        """Y after an event."""
        return over_lanes(self._transitions[event, before], y, p)


def over_lanes(function: Any, *arguments: Matrix) -> Matrix:
    """Evaluate a function at every column; an argument of one column serves all."""
    lanes = max(a.shape[1] for a in arguments)
    full = [np.broadcast_to(a, (len(a), lanes)) for a in arguments]
    return np.asarray(function.map(lanes)(*full)).reshape(-1, lanes)


@dataclass
class Trial:
    """One attempted step of all lanes."""

    h: Vector
    new: Matrix
    slope: Matrix  # at its end
    accepted: Mask


class Flight:
    """The state of a batch while it flies."""

    def __init__(self, equations: Equations, asked: Request, nodes: list[Vector] | None = None) -> None:
        system, lanes = equations.system, len(asked.z0)
        self.equations, self.asked, self.nodes = equations, asked, nodes
        self.nz, self.duration, self.p = system.nz, asked.duration, asked.p.T
        flat = (np.zeros((lanes, 0)) if asked.seeds is None else asked.seeds.reshape(lanes, -1))[:, system.offsets]
        self.y = np.concatenate([asked.z0, flat], axis=1).T.copy()
        self.mode = asked.mode.astype(float)
        self.time, self.limit = np.zeros(lanes), np.full(lanes, np.inf)
        self.steps, self.tries = np.zeros(lanes, dtype=np.int64), 0
        self.status = np.full(lanes, -1)
        self.refused, self.active = np.zeros(lanes, dtype=bool), np.ones(lanes, dtype=bool)
        self.h_before, self.root_before = np.zeros(lanes), np.ones(lanes)  # no trend yet
        self.log = np.full((lanes, MAX_EVENTS if system.events else 0, 2), np.nan)
        self.met = np.zeros(lanes, dtype=np.int64)

    def fly(self) -> Arcs:
        """Step until every lane has ended."""
        with np.errstate(all="ignore"):
            self.slope = self.equations.field(self.y, self.p, self.mode)
            self.h = self._first_step()
            crossings = Crossings(self)
            while np.any(self.active):
                self._step(crossings)
        lanes, system = len(self.time), self.equations.system
        columns = np.zeros((lanes, self.nz * system.nc))
        columns[:, system.offsets] = self.y[self.nz :].T
        return Arcs(
            z=self.y[: self.nz].T.copy(),
            rates=self.slope[: self.nz].T.copy(),
            columns=columns.reshape(lanes, self.nz, system.nc),
            time=self.time,
            status=self.status,
            steps=self.steps,
            mode=self.mode.astype(np.int64),
            event_index=np.nan_to_num(self.log[:, :, 0], nan=-1.0).astype(np.int64),
            event_time=self.log[:, :, 1],
        )

    def _first_step(self) -> Vector:
        if self.asked.fixed_steps:
            return np.abs(self.duration) / self.asked.fixed_steps
        z, length = self.y[: self.nz], np.abs(self.duration)
        scale = self.asked.atol + self.asked.rtol * np.abs(z)
        d0, d1 = (_rms(x[: self.nz] / scale) for x in (self.y, self.slope))
        h0 = np.minimum(np.where((d0 < 1e-5) | (d1 < 1e-5), 1e-6, 0.01 * d0 / d1), length)
        probe = self.y + np.copysign(h0, self.duration) * self.slope
        change = self.equations.field(probe, self.p, self.mode) - self.slope
        d = np.fmax(_rms(change[: self.nz] / scale) / h0, d1)
        h1 = np.where(d <= 1e-15, np.maximum(1e-6, 1e-3 * h0), _FIRST * (0.01 / d) ** 0.125)
        return np.minimum(np.minimum(h1, 100 * h0), length)

    def _step(self, crossings: Crossings) -> None:
        remaining = self.duration - self.time
        limited = self.limit < self.h
        wanted = np.minimum(self.h, self.limit)
        last = wanted * (1 + 1e-10) >= np.abs(remaining)
        h = np.where(self.active, np.where(last, remaining, np.copysign(wanted, self.duration)), 0.0)
        new, error = self._attempt(h)
        good = np.isfinite(error) if self.asked.fixed_steps else error <= 1.0
        self.tries += 1
        trial = Trial(h=h, new=new, slope=self.equations.field(new, self.p, self.mode), accepted=self.active & good)
        crossings.locate(trial)
        self._adapt(h, error, good, limited)
        self._commit(trial, last)
        self._end(trial, error, last, crossings)

    def _attempt(self, h: Vector) -> tuple[Matrix, Vector]:
        slopes = [self.slope]
        for stage in range(1, tableau.STAGES):
            point = self.y + h * sum(weight * slopes[j] for j, weight in tableau.A[stage].items())
            slopes.append(self.equations.field(point, self.p, self.mode))
        new = self.y + h * sum(weight * slopes[j] for j, weight in tableau.B.items())
        old_z, new_z = self.y[: self.nz], new[: self.nz]
        scale = self.asked.atol + self.asked.rtol * np.maximum(np.abs(old_z), np.abs(new_z))
        e5, e3 = (
            np.sum((sum(weight * slopes[j][: self.nz] for j, weight in row.items()) / scale) ** 2, axis=0)
            for row in (tableau.E5, tableau.E3)
        )
        return new, np.abs(h) * e5 / np.fmax(np.sqrt((e5 + 0.01 * e3) * self.nz), 1e-300)

    def _adapt(self, h: Vector, error: Vector, good: Mask, limited: Mask) -> None:
        if self.asked.fixed_steps:
            return
        root, size = error**0.125, np.abs(h)
        trend = np.where(good, np.fmin(self.root_before * (size / self.h_before) / root, 1.0), 1.0)
        usual = good & ~limited
        self.h_before = np.where(usual, size, self.h_before)
        self.root_before = np.where(usual, np.fmax(root, _LEAST), self.root_before)
        factor = np.fmin(np.fmax(_SAFETY / root * trend, _SHRINK), _GROW)
        factor = np.where(self.refused | ~good, np.minimum(factor, 1.0), factor)
        self.h = np.where(self.active & ~(limited & good), size * factor, self.h)
        self.refused = ~good

    def _commit(self, trial: Trial, last: Mask) -> None:
        if self.nodes is not None and trial.accepted[0]:
            self.nodes.append(np.array([self.time[0], trial.h[0], self.mode[0], *self.y[: self.nz, 0]]))
        end = np.where(last, self.duration, self.time + trial.h)
        self.time = np.where(trial.accepted, end, self.time)
        self.steps += trial.accepted
        self.y = np.where(trial.accepted, trial.new, self.y)
        self.slope = np.where(trial.accepted, trial.slope, self.slope)

    def _end(self, trial: Trial, error: Vector, last: Mask, crossings: Crossings) -> None:
        status, active, nan = np.full(len(self.time), -1), self.active, np.isnan(error)
        stuck = active & ~(self.h >= _RESOLVED * np.abs(self.duration))
        if self.tries >= self.asked.max_steps:
            status[active] = ArcStatus.STEP_LIMIT
        status[stuck] = ArcStatus.STALLED
        status[active & nan & (stuck | bool(self.asked.fixed_steps))] = ArcStatus.NON_FINITE
        status[trial.accepted & last] = ArcStatus.REACHED
        crossings.fire(status)
        ended = active & (status >= 0)
        status[ended & ~np.all(np.isfinite(self.y), axis=0)] = ArcStatus.NON_FINITE
        self.status = np.where(ended, status, self.status)
        self.active = active & ~ended


def _rms(x: Matrix) -> Vector:
    return np.sqrt(np.mean(x**2, axis=0))
