"""Independent re-integration of an extremal by Gragg's extrapolated midpoint rule of order 8.

The machine code of shooting uses Dormand and Prince's pair of order 8 with adaptive steps. Here the canonical equations
are integrated in equal steps by extrapolation of Gragg's midpoint rule to order 8, from the unknowns only, and the
conditions at the ends are evaluated again. Each step evaluates the conditions of the path and the bounds of the states
(those on states only inside it too, by cubics), and compares H of some admissible controls with H of the flown one. All
of it is one call of machine code for each interval between switches, for one extremal or for many in lanes.

Source: E. Hairer, S. P. Norsett, G. Wanner, *Solving Ordinary Differential Equations I*, 2nd ed., Springer 1993,
section II.9 (9.10), (9.13).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.charts.bound_status import SLACK
from perilune.charts.chart import Chart
from perilune.charts.extrapolated_midpoint import (
    NOTHING_SEEN,
    MarchedMargins,
    end_function,
    start_function,
    step_along,
    step_settling,
)
from perilune.charts.multiplier_signs import ChartBoundaryArcs
from perilune.conditions import OptimalityConditions
from perilune.core import Matrix, Vector
from perilune.kernels import Map, compile_map
from perilune.shooting import propagate_lanes

STEPS = 48  # of a piece, or a multiple of it
_MOST, _EXACT = 32, 1e-11  # times as many, and what the end of a phase may be wrong by, where they are chosen
_FINER = 4  # times as many for a lane that misses something by as little as coarse steps may

Arcs = tuple[NDArray[np.int64], tuple[int, ...]]  # lanes, and the modes that they go through in a phase


@dataclass(frozen=True)
class ReintegratedExtremals:
    """Results of independent re-integrations, in lanes; canonical.

    Attributes
    ----------
    residuals
        Residuals of all conditions, (lanes, conditions); 0 for those of held parameters.
    shown
        Columns of `seen`.
    rates
        dJ/dq of each free parameter along the family of extremals, held or not, (lanes, k).
    ranges
        Value of each end condition that is a range, (lanes, r).
    ends
        States at the start of the flight, then at the end of each phase, (lanes, e).
    arcs
        (phase, lanes, modes that they go through in it) of all phases and lanes.
    """

    residuals: Matrix
    shown: Matrix
    rates: Matrix
    ranges: Matrix
    ends: Matrix
    arcs: tuple[tuple[int, NDArray[np.int64], tuple[int, ...]], ...]

    @property
    def rows(self) -> tuple[Matrix, ...]:
        """Return all arrays but its arcs."""
        return self.residuals, self.shown, self.rates, self.ranges, self.ends

    @property
    def margins(self) -> MarchedMargins:
        """Return margins and errors, (lanes,) each."""
        return MarchedMargins(*self.shown.T)

    @property
    def sequence(self) -> NDArray[np.int64]:
        """Return a number for the sequence of modes of each lane, the same in every process."""
        told = [""] * len(self.shown)
        for phase, lanes, modes in self.arcs:
            for lane in lanes.tolist():
                told[lane] += f"{phase}:{modes};"
        known = {text: zlib.crc32(text.encode()) for text in set(told)}
        return np.array([known[text] for text in told], dtype=np.int64)

    @property
    def violation(self) -> str:
        """Describe the largest violation of the first extremal."""
        first = MarchedMargins(*self.shown[0].tolist())
        against = {
            "its end conditions are missed by": first.residual,
            "a path condition or a bound is violated by": -first.path,
            "another control lowers H by": -first.minimum,
            "H drifts by": first.drift,
        }
        words = max(against, key=lambda name: against[name])
        return f"{words} {against[words]:.1e} (canonical; limit {SLACK:g})"

    def copy(self) -> ReintegratedExtremals:
        """In arrays of its own."""
        return ReintegratedExtremals(*(array.copy() for array in self.rows), arcs=self.arcs)

    def replace(self, lanes: NDArray[np.int64], by: ReintegratedExtremals) -> None:
        """Replace some flights by others of the same arcs.

        Parameters
        ----------
        lanes
            Numbers of the lanes that are replaced, (lanes,).
        by
            Their re-integrations, in that order.
        """
        for own, other in zip(self.rows, by.rows, strict=True):
            own[lanes] = other


@dataclass(frozen=True)
class _ModeInterval:
    """Interval between two switches, of some lanes: mode, lengths, and the map of z across the switch at its end."""

    mode: int
    length: Vector
    jump: Any


class ChartReintegration:
    """Independent re-integration of extremals of a chart.

    Parameters
    ----------
    chart
        Whose extremals.
    times
        For each phase how many times `STEPS` a piece of it has, as `fine_enough` finds them; once by default.
    """

    def __init__(self, chart: Chart, times: Sequence[int] = ()) -> None:
        self.chart: Chart = chart
        self.conditions: OptimalityConditions = chart.conditions
        self.times: tuple[int, ...] = tuple(times) or (1,) * len(self.conditions.phases)
        self._idle: dict[tuple[int, ...], list[tuple[tuple[Matrix, Matrix, Matrix], BoundReintegration]]] = {}
        self._start_maps: dict[int, Map] = {}
        self._marches: dict[tuple[int, int], Map] = {}
        self._jumps: dict[tuple[int, int], Map] = {}

    @cached_property
    def _boundary_arcs(self) -> ChartBoundaryArcs:
        return ChartBoundaryArcs(self.chart)

    @cached_property
    def _modes(self) -> list[Map]:
        return [compile_map(extremal.mode) for extremal in self.conditions.phases]

    def __call__(self, y: Matrix, p: Matrix, choice: Matrix) -> ReintegratedExtremals:
        """Integrate extremals again.

        Parameters
        ----------
        y
            Unknowns of single shooting, (lanes, n).
        p
            Numbers of the canonical equations, (lanes, np) or (1, np).
        choice
            Which free parameters, then ranges, are held, and not chosen, and their values, (lanes, 2 k).
        """
        return self._propagate(y, p, choice, self.times)

    def finer(self, y: Matrix, p: Matrix, choice: Matrix) -> ReintegratedExtremals:
        """Integrate again, and by finer steps where violations are as small as coarse steps may cause.

        Parameters
        ----------
        y, p, choice
            As of a call.
        """
        found = self._propagate(y, p, choice, self.times)
        if (poor := np.nonzero(found.margins.nearly)[0]).size:
            numbers = p if len(p) == 1 else p[poor]
            found.replace(
                poor, self._propagate(y[poor], numbers, choice[poor], tuple(_FINER * times for times in self.times))
            )
        return found

    def _propagate(self, y: Matrix, p: Matrix, choice: Matrix, times: tuple[int, ...]) -> ReintegratedExtremals:
        if len(y) != 1:
            return BoundReintegration(self, y, p, choice, times)()
        idle = self._idle.setdefault(times, [])  # of one lane; pop and append are atomic
        try:
            given, one = idle.pop()
        except IndexError:
            given = y.copy(), p.copy(), choice.copy()
            one = BoundReintegration(self, *given, times)
        for own, array in zip(given, (y, p, choice), strict=True):
            own[:] = array
        flown = one().copy()
        idle.append((given, one))
        return flown

    def fine_enough(self, y: Matrix, p: Matrix) -> tuple[int, ...]:
        """Return the multiple of `STEPS` that each phase needs so that twice as many steps end at the same state.

        Parameters
        ----------
        y
            Unknowns of extremals, canonical, (lanes, n).
        p
            Given numbers, canonical.
        """
        before, found = np.zeros((len(y), 0)), list[int]()

        def flown(k: int, times: int) -> Matrix:
            leg = _MarchedPhase(self, k, (y, p, before), times)
            leg()
            return leg.state

        for k, extremal in enumerate(self.conditions.phases):
            times, wrong, size = 1, np.inf, extremal.half if extremal.settles else 2 * extremal.half
            fine = flown(k, times)
            while wrong > _EXACT and times < _MOST:
                coarse, times = fine[:, :size], 2 * times
                fine = flown(k, times)
                away = np.abs(fine[:, :size] - coarse) / (1.0 + np.abs(fine[:, :size]))
                wrong = float(np.fmax.reduce(away, axis=None))
            found.append(times // 2 if wrong <= _EXACT else times)
            before = fine
        return tuple(found)

    def start_map(self, k: int) -> Map:
        """Compile `extrapolated_midpoint.start_function`."""
        if k not in self._start_maps:
            self._start_maps[k] = compile_map(start_function(self.conditions, k))
        return self._start_maps[k]

    @cached_property
    def ended(self) -> Map:
        """Compile `extrapolated_midpoint.end_function`."""
        return compile_map(end_function(self.conditions, self._boundary_arcs))

    def march(self, k: int, mode: int) -> Map:
        """Compile `STEPS` steps of a phase in a mode.

        Parameters
        ----------
        k, mode
            Numbers of the phase, and of its mode between two switches.

        Returns
        -------
        Map
            Map (z and margins so far, numbers, free parameters, length of a step) -> the same behind the steps.
        """
        if (k, mode) not in self._marches:
            step = step_settling if self.conditions.phases[k].settles else step_along
            self._marches[k, mode] = compile_map(step(self._boundary_arcs, k, mode), times=STEPS)
        return self._marches[k, mode]

    def over_switches(
        self, k: int, state: Matrix, z: Matrix, duration: Vector, p: Matrix, free: Matrix, times: int
    ) -> list[Arcs]:
        """March a phase that may switch, in place; return lanes with their sequences of modes.

        Parameters
        ----------
        k
            Number of the phase.
        state
            z and margins at its start, which become those at its end, (lanes, s).
        z
            State and costate at its start, canonical, (lanes, 2 n).
        duration
            Its duration, canonical, (lanes,).
        p
            Numbers of the canonical equations, (lanes, np) or (1, np).
        free
            Free parameters, canonical, (lanes, k).
        times
            Times `STEPS` that a piece between switches has.
        """
        arcs, last = list[Arcs](), state.shape[1] - len(NOTHING_SEEN)
        for lanes, pieces in self._sequences(k, z, duration, p):
            numbers, chosen, here = p if len(p) == 1 else p[lanes], free[lanes], state[lanes]
            for piece in pieces:
                march, length = self.march(k, piece.mode), piece.length[:, None] / (STEPS * times)
                for _ in range(times):
                    here = march(here, numbers, chosen, length)[0]
                if piece.jump is not None:
                    here[:, :last] = piece.jump(np.ascontiguousarray(here[:, :last]), numbers)[0]
            arcs.append((lanes, tuple(piece.mode for piece in pieces)))
            state[lanes] = here
        return arcs

    def _sequences(
        self, k: int, z: Matrix, duration: Vector, p: Matrix
    ) -> Iterator[tuple[NDArray[np.int64], list[_ModeInterval]]]:
        """Yield lanes with the same sequence of modes, and their intervals between switches."""
        extremal = self.conditions.phases[k]
        first = self._modes[k](z, p)[0][:, 0]
        flown = propagate_lanes(extremal, z, p, duration, first)
        met = flown.event_index
        keys = np.column_stack([first.astype(np.int64), met[:, : max(1, int((met >= 0).sum(axis=1).max()))]])
        for key in np.unique(keys, axis=0):
            lanes = np.nonzero((keys == key).all(axis=1))[0]
            mode, at, pieces = int(key[0]), np.zeros(len(lanes)), list[_ModeInterval]()
            for i, number in enumerate(key[1:][key[1:] >= 0].tolist()):
                event, time = extremal.events[number], flown.event_time[lanes, i]
                if event.jump is not None and (k, number) not in self._jumps:
                    self._jumps[k, number] = compile_map(event.jump)
                jump = self._jumps.get((k, number))
                pieces.append(_ModeInterval(mode, time - at, jump))
                mode, at = event.switches.get(mode, mode), time
            yield lanes, [*pieces, _ModeInterval(mode, duration[lanes] - at, None)]


class _MarchedPhase:
    """Phase of independent re-integrations, bound to arrays: (unknowns, numbers, state at the end of the phase before).

    Attributes
    ----------
    state
        Marched state at the end.
    """

    def __init__(self, own: ChartReintegration, k: int, given: tuple[Matrix, Matrix, Matrix], times: int) -> None:
        self._own, self._k, self._times = own, k, times
        (y, self._p, _), self._steps = given, np.empty((len(given[0]), 1))
        self._free = y[:, own.conditions.free_at]
        self._start_map = own.start_map(k).bind(*given)
        self._start, self._z, self._duration = self._start_map.outputs
        self._switches = bool(own.conditions.phases[k].events)
        self._all: list[Arcs] = [(np.arange(len(y)), (0,))]
        if self._switches:
            self.state = self._start
        else:
            self._march = own.march(k, 0).bind(self._start, self._p, self._free, self._steps)
            self.state = self._march.outputs[0]

    def __call__(self) -> list[Arcs]:
        """March the phase; return lanes with their sequences of modes."""
        self._start_map()
        if self._switches:
            duration = self._duration[:, 0]
            return self._own.over_switches(self._k, self.state, self._z, duration, self._p, self._free, self._times)
        np.divide(self._duration, STEPS * self._times, out=self._steps)
        self._march()
        for _ in range(1, self._times):
            self._start[:] = self.state
            self._march()
        return self._all


class BoundReintegration:
    """Re-integrations bound to arrays, read at each call: those of `ChartReintegration.__call__`, and its `times`.

    Attributes
    ----------
    rows
        Arrays of results, overwritten by the next call.
    """

    def __init__(self, own: ChartReintegration, y: Matrix, p: Matrix, choice: Matrix, times: Sequence[int]) -> None:
        self._legs, before = list[_MarchedPhase](), np.zeros((len(y), 0))
        for k in range(len(own.conditions.phases)):
            leg = _MarchedPhase(own, k, (y, p, before), times[k])
            self._legs.append(leg)
            before = leg.state
        self._ended = own.ended.bind(y, p, choice, *(leg.state for leg in self._legs))
        self.rows: tuple[Matrix, ...] = self._ended.outputs

    def __call__(self) -> ReintegratedExtremals:
        """Make the flights."""
        arcs = [(k, *arc) for k, leg in enumerate(self._legs) for arc in leg()]
        self._ended()
        return ReintegratedExtremals(*self.rows, arcs=tuple(arcs))
