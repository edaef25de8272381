"""Engine without a compiler: SciPy's DOP853 on CasADi's functions, lane by lane, some hundred times slower.

The equations are those of the machine code (`perilune.kernels.algebra.system`), the steps are SciPy's. An event is
looked for on the dense output of a step, then flown to, its time moved by Newton's method until the event function
vanishes there. Two crossings inside one step are found where the event function turns between the ends.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DOP853
from scipy.optimize import brentq

from perilune.core import Matrix, Vector
from perilune.kernels.algebra.system import ArcSystem
from perilune.kernels.flight.bound_buffers import BoundArcs
from perilune.kernels.flight.dense import DenseArc, dense_arc
from perilune.kernels.flight.records import MAX_EVENTS, Arcs, ArcStatus, Request, request

_FINEST = 100 * np.finfo(float).eps  # the least relative tolerance that SciPy takes
_AFTER = 1e-150  # stands for "just beyond zero"
_NEAR = 1e-13  # how near to the zero, as a fraction of the duration, an event is located


class ScipyEngine:
    """Flies arcs of one `ArcSystem` by SciPy. Use `compile_arcs`."""

    backend = "scipy"

    def __init__(self, system: ArcSystem) -> None:
        self.system = system
        self._functions = {False: _SystemFunctions(system.without_columns() if system.nc else system)}
        self._functions[True] = _SystemFunctions(system) if system.nc else self._functions[False]

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
        """Fly a batch of arcs; see `NativeEngine.propagate`. `threads` has no effect.

        Parameters
        ----------
        z0, p, duration, columns
            States at the start, parameters, durations and derivatives of z0, shaped as for `NativeEngine.propagate`.
        threads
            Number of threads, taken so that both engines are called alike.
        **settings
            As for `perilune.kernels.flight.records.request`.
        """
        sizes = (self.system.nz, self.system.np, self.system.nc)
        flight = self.bind(request(sizes, len(self.system.modes), z0, p, duration, columns, **settings))
        flight()
        return flight.ends()

    def dense(self, z0: ArrayLike, p: ArrayLike, duration: float, **settings: Any) -> DenseArc:
        """Fly one arc and return it as a function of time; see `NativeEngine.dense`.

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
        sizes = (self.system.nz, self.system.np, 0)
        asked = request(sizes, len(self.system.modes), z0, p, duration, None, **settings)
        nodes: list[Vector] = []
        flight = self.bind(asked, nodes)
        flight()
        fields = self._functions[False].fields

        def rates(z: Matrix, mode: Vector) -> Matrix:
            return np.array([np.asarray(fields[int(m)](x, asked.p[0])).ravel() for x, m in zip(z, mode, strict=True)])

        return dense_arc(flight.ends(), np.array(nodes).reshape(-1, 3 + self.system.nz), rates)

    def bind(self, asked: Request, nodes: list[Vector] | None = None) -> BoundArcs:
        """Return what flies a request as often as is wanted; see `NativeEngine.bind`.

        Parameters
        ----------
        asked
            The request, whose arrays are read at each flight.
        nodes
            List that receives the start of each step of the one arc, (3 + nz) numbers each; None for none.
        """
        functions, lanes = self._functions[asked.seeds is not None], len(asked.z0)
        system = functions.system

        def bind(flight: BoundArcs) -> Callable[[int | None], None]:
            columns = flight.columns.reshape(lanes, -1)

            def fly(_: int | None) -> None:
                for lane in range(lanes):
                    flown = _Lane(functions, asked, lane)
                    with np.errstate(all="ignore"):
                        status = flown.fly()
                    if status in (ArcStatus.REACHED, ArcStatus.EVENT) and not np.all(np.isfinite(flown.y)):
                        status = ArcStatus.NON_FINITE
                    flight.z[lane], columns[lane, system.offsets] = flown.y[: system.nz], flown.y[system.nz :]
                    flight.rates[lane] = flown.rate(flown.y)[: system.nz]
                    flight.info[lane] = flown.t, status, flown.steps, flown.mode, len(flown.events)
                    flight.log[lane, : len(flown.events)] = np.reshape(flown.events, (-1, 2))
                    if nodes is not None:
                        nodes[:] = flown.nodes

            return fly

        return BoundArcs(self.system, asked, bind)


class _SystemFunctions:
    """The functions of a system, for every lane."""

    def __init__(self, system: ArcSystem) -> None:
        self.system = system
        self.fields = [system.field(mode)[0] for mode in range(len(system.modes))]
        self.crossings = system.crossings() if system.events else None
        self.targets = {(event, i): j for event, i, j in system.transitions}
        self.carried = {way: system.transition(*way) for way in system.carried}


class _Lane:
    """One arc in flight: its time, Y, mode, its events and the starts of its steps."""

    def __init__(self, functions: _SystemFunctions, asked: Request, lane: int) -> None:
        system = functions.system
        seeds = np.zeros(0) if asked.seeds is None else asked.seeds[lane].ravel()[system.offsets]
        self.system, self.targets, self.carried = system, functions.targets, functions.carried
        self.y, self.p = np.concatenate([asked.z0[lane], seeds]), asked.p[lane if len(asked.p) > 1 else 0]
        self.t, self.duration, self.mode = 0.0, float(asked.duration[lane]), int(asked.mode[lane])
        self.steps, self.most, self.fixed = 0, asked.max_steps, asked.fixed_steps
        self.events: list[tuple[float, float]] = []
        self.nodes: list[Vector] = []
        share = np.sqrt(system.nz / len(self.y))  # the error is that of z: the columns are carried along
        self.rtol = max(share * asked.rtol[lane], _FINEST)
        self.atol = np.full(len(self.y), np.inf)
        if not self.fixed:
            self.atol[: system.nz] = share * asked.atol[lane]
        self._fields = [_unwrapped_call(field) for field in functions.fields]
        self._crossings = _unwrapped_call(functions.crossings) if functions.crossings is not None else None

    def rate(self, y: Vector) -> Vector:
        """Return Y' in the present mode."""
        return self._fields[self.mode](y, self.p)

    def crossings(self, y: Vector) -> Matrix:
        """Return the event functions and their rates along the flight, (2, events)."""
        if self._crossings is None:
            return np.zeros((2, 0))
        nz = self.system.nz
        return self._crossings(y[:nz], self.rate(y)[:nz], self.mode, self.p).reshape(2, -1)

    def fly(self) -> ArcStatus:
        """Fly from event to event."""
        if not np.all(np.isfinite(np.concatenate([self.y, self.rate(self.y)]))):
            return ArcStatus.NON_FINITE
        self.g = _just_after(self.crossings(self.y))
        status = None
        while status is None:
            status = self._leg()
        return status

    def _leg(self) -> ArcStatus | None:
        """Fly in one mode to the next event; None where the flight goes on after it."""
        solver = self._solver(self.duration)
        while solver.status == "running":
            if self.steps >= self.most:
                return ArcStatus.STEP_LIMIT
            solver.step()
            if solver.status == "failed":
                ahead = self.y + 1e-12 * self.duration * self.rate(self.y)
                return ArcStatus.STALLED if np.all(np.isfinite(self.rate(ahead))) else ArcStatus.NON_FINITE
            new = self.crossings(solver.y)
            found = self._first(solver, new)
            if found is not None:
                return self._happen(*found, new[0])
            self._commit(solver)
            self.g = new
        return ArcStatus.REACHED

    def _solver(self, end: float) -> Any:
        """Return SciPy's integrator from here to a time."""
        settings: dict[str, Any] = {"rtol": self.rtol, "atol": self.atol}
        if self.fixed:
            each = (1 + 1e-12) * abs(self.duration) / self.fixed
            settings |= {"max_step": each, "first_step": min(each, abs(end - self.t))} if each else {}
        return DOP853(lambda _, y: self.rate(y), self.t, self.y, end, **settings)

    def _commit(self, solver: Any) -> None:
        self.nodes.append(np.array([self.t, solver.t - self.t, self.mode, *self.y[: self.system.nz]]))
        self.t, self.y, self.steps = float(solver.t), solver.y, self.steps + 1

    def _first(self, solver: Any, new: Matrix) -> tuple[float, int] | None:
        """Return the time and number of the first event in the step just taken."""
        found, curve = [], None
        near = _NEAR * abs(self.duration)
        for number, event in enumerate(self.system.events):
            (g0, r0), (g1, r1) = self.g[:, number], new[:, number]
            if not event.watched(self.mode):
                continue
            heads, leaves = solver.direction * g0 * r0 < 0, solver.direction * g1 * r1 > 0
            if not leaves and abs(g1) <= near * abs(r1):
                g1 = 0.0
            turns = heads and leaves and g0 * g1 > 0
            if not turns and not _crosses(event.direction, g0, g1):
                continue
            curve = curve or solver.dense_output()

            def at(t: float, row: int = 0, number: int = number, curve: Any = curve) -> float:
                return self.crossings(curve(t))[row, number]

            points = [(self.t, g0), (solver.t, g1)]
            if turns:
                middle = _interval_root(lambda t, at=at: at(t, 1), (self.t, r0), (solver.t, r1))
                points.insert(1, (middle, at(middle)))
            pairs = [(a, b) for a, b in pairwise(points) if _crosses(event.direction, a[1], b[1])]
            found += [(_interval_root(at, *pair), number) for pair in pairs[:1]]
        return min(found, default=None)

    def _happen(self, time: float, number: int, beyond: Vector) -> ArcStatus | None:
        """Fly to an event, note it, and end there or go on in what comes after it."""
        event, before = self.system.events[number], self.g[0]
        self._fly_to(time, number)
        self.events.append((number, self.t))
        way = number, self.mode
        if way in self.carried:
            self.y = np.asarray(self.carried[way](self.y, self.p)).ravel()
        self.mode = self.targets.get(way, self.mode)
        # The event itself counts as passed; one that crossed in the same step is still ahead.
        self.g = _just_after(self.crossings(self.y))
        ahead = before * beyond < 0
        self.g[0, ahead] = before[ahead]
        if not event.levels:  # else its next level lies ahead
            self.g[0, number] = -before[number]
        if event.terminal:
            return ArcStatus.EVENT
        if len(self.events) >= MAX_EVENTS:
            return ArcStatus.STEP_LIMIT
        return ArcStatus.REACHED if self.t == self.duration else None

    def _fly_to(self, time: float, number: int) -> None:
        start, nodes = (self.t, self.y, self.steps), len(self.nodes)
        for _ in range(4):
            self.t, self.y, self.steps = start
            del self.nodes[nodes:]
            solver = self._solver(time) if time != self.t else None
            while solver and solver.status == "running":
                solver.step()
                self._commit(solver)
            g, rate = self.crossings(self.y)[:, number]
            move = -g / rate if rate else 0.0
            if abs(move) <= 0.5 * _NEAR * abs(self.duration) or not np.isfinite(move):
                break
            earliest, latest = sorted((start[0], self.duration))
            time = float(min(max(time + move, earliest), latest))


def _just_after(g: Matrix) -> Matrix:
    """Return event functions and rates, (2, events); where a function is 0, with the sign it is about to have."""
    return np.array([np.where(g[0] == 0.0, np.copysign(_AFTER, g[1]), g[0]), g[1]])


def _crosses(direction: int, before: float, after: float) -> bool:
    rises, falls = before < 0 <= after, before > 0 >= after
    return (rises and direction >= 0) or (falls and direction <= 0)


def _interval_root(function: Callable[[float], float], start: tuple[float, float], end: tuple[float, float]) -> float:
    """Return the zero between two points (time, value) of opposite signs, whose values are taken as given."""
    if end[1] == 0.0:
        return end[0]
    told = dict((start, end))
    return float(np.asarray(brentq(lambda t: told.get(t) or function(t), start[0], end[0], xtol=1e-14)))


def _unwrapped_call(function: Any) -> Callable[..., Vector]:
    """Return a CasADi function on vectors without the conversions of its call, which take ten times its time."""
    buffer, run = function.buffer()
    arguments: list[Any] = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
    result: Any = np.zeros(function.nnz_out(0))
    for i, argument in enumerate(arguments):
        if argument.size:
            buffer.set_arg(i, memoryview(argument))
    buffer.set_res(0, memoryview(result))

    def call(*given: Vector) -> Vector:
        for argument, value in zip(arguments, given, strict=True):
            argument[:] = value
        run()
        return result.copy()

    call.__dict__["held"] = buffer, function  # what `run` works on
    return call
