"""Events of interpreted arcs: `crossing` in NumPy, rule for rule."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from perilune.kernels.algebra.system import Event
from perilune.kernels.flight.arcs import MAX_EVENTS, ArcStatus
from perilune.kernels.flight.crossing import _AFTER, _WHOLE, TOLERANCE
from perilune.words.types import Vector

if TYPE_CHECKING:
    from perilune.kernels.flight.interpreter import Flight, Trial

Mask = NDArray[np.bool_]


class Crossings:
    """The events of a batch in flight: values and rates at the start of each step."""

    def __init__(self, flight: Flight) -> None:
        self.flight, self.events = flight, flight.equations.system.events
        self.fired = np.zeros((len(self.events), len(flight.time)), dtype=bool)
        self.crossed = self.fired.copy()
        if self.events:
            self.old = flight.equations.crossings(flight.y, flight.slope, flight.p)

    def locate(self, trial: Trial) -> None:
        """Refuse accepted steps that cross and limit the next; mark events that fire at the end."""
        if not self.events:
            return
        f, count = self.flight, len(self.events)
        new = f.equations.crossings(trial.new, trial.slope, f.p)
        theta, ahead = np.full(len(f.time), 2.0), np.full(len(f.time), np.inf)
        self.fired[:] = False
        for number, event in enumerate(self.events):
            ends = (
                self.old[number],
                new[number],
                trial.h * self.old[count + number],
                trial.h * new[count + number],
            )
            self._examine(number, event, trial, ends, theta, ahead)
        early = trial.accepted & (theta < 1.5)
        done = np.zeros_like(early)
        for number in range(count):
            self.fired[number] &= ~early & ~done
            done |= self.fired[number]
        trial.accepted = kept = trial.accepted & ~early
        approaching = kept & ~done & np.isfinite(f.limit)
        f.limit = np.where(
            early, theta * np.abs(trial.h), np.where(approaching, ahead, np.where(kept, np.inf, f.limit))
        )
        self.old = np.where(kept & ~done, new, self.old)

    def _examine(
        self, number: int, event: Event, trial: Trial, ends: tuple[Vector, ...], theta: Vector, ahead: Vector
    ) -> None:
        f = self.flight
        g0, g1, rate0, rate1 = ends
        watched = trial.accepted & np.isin(
            f.mode, [m for m in range(len(f.equations.system.modes)) if event.watched(m)]
        )
        up, down = event.direction >= 0, event.direction <= 0
        crosses = watched & ((up & (g0 < 0) & (g1 >= 0)) | (down & (g0 > 0) & (g1 <= 0)))
        heads = watched & ~crosses & ((up & (g1 < 0) & (rate1 > 0)) | (down & (g1 > 0) & (rate1 < 0)))
        step, resolution = np.abs(trial.h), TOLERANCE * np.abs(f.duration)
        away = step * np.abs(g1 / rate1)
        near = (away <= resolution) | (g1 == 0)
        same_side = g0 * g1 > 0
        self.fired[number] = (crosses & (near | (step <= resolution))) | (heads & same_side & near)
        self.crossed[number] = crosses
        ahead[heads] = np.fmin(away, ahead)[heads]
        inside = crosses & ~self.fired[number]
        dips = watched & ~crosses & same_side & (g0 * rate0 < 0) & (g1 * rate1 > 0)
        for mask, derivative in ((inside, False), (dips, True)):
            if np.any(mask):
                _aim(mask, ends, theta, derivative)

    def fire(self, status: Vector) -> None:
        """Note what fired at the end of the committed step; end arcs or change their mode."""
        fired = np.any(self.fired, axis=0) if self.events else np.zeros(0, dtype=bool)
        if not np.any(fired):
            return
        f, count = self.flight, len(self.events)
        for number in range(count):
            for lane in np.flatnonzero(self.fired[number] & (f.met < MAX_EVENTS)):
                f.log[lane, f.met[lane]] = number, f.time[lane]
        f.met += fired
        status[fired & (f.met >= MAX_EVENTS)] = ArcStatus.STEP_LIMIT
        for number, event in enumerate(self.events):
            if event.terminal:
                status[self.fired[number]] = ArcStatus.EVENT
        system, mode = f.equations.system, f.mode
        for number, before, after in system.transitions:
            here = self.fired[number] & (mode == before)
            if np.any(here):
                f.y = np.where(here, f.equations.transition(number, before, f.y, f.p), f.y)
                f.mode = np.where(here, float(after), f.mode)
        if system.transitions:
            f.slope = np.where(fired, f.equations.field(f.y, f.p, f.mode), f.slope)
        again = f.equations.crossings(f.y, f.slope, f.p)
        value = np.where(fired, again[:count], self.old[:count])
        value = np.where(fired & self.crossed, np.copysign(_AFTER, self.old[:count]), value)
        value = np.where(self.fired, np.copysign(_AFTER, -self.old[:count]), value)
        self.old = np.concatenate([value, np.where(fired, again[count:], self.old[count:])])
        f.limit = np.where(fired, np.inf, f.limit)
        self.fired[:] = False


def _aim(mask: Mask, ends: tuple[Vector, ...], theta: Vector, derivative: bool) -> None:
    g0, g1, rate0, rate1 = ends
    c2, c3 = 3 * (g1 - g0) - 2 * rate0 - rate1, rate0 + rate1 - 2 * (g1 - g0)

    def cubic(x: Vector) -> Vector:
        return ((c3 * x + c2) * x + rate0) * x + g0

    def slope(x: Vector) -> Vector:
        return (3 * c3 * x + 2 * c2) * x + rate0

    at, start = (slope, rate0) if derivative else (cubic, g0)
    low, high = np.zeros_like(theta), np.ones_like(theta)
    for _ in range(52):
        middle = 0.5 * (low + high)
        before = at(middle) * np.copysign(1.0, start) > 0
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    if derivative:
        mask = mask & (cubic(high) * g0 < 0) & (high > 1e-9) & (high < _WHOLE)
    found = np.clip(high, 1e-3, _WHOLE)
    np.copyto(theta, found, where=mask & (found < theta))
