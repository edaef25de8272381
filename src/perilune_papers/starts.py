"""Runs of a method from random values, seed after seed: how often it finds what, and in what time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

from perilune import PeriluneError
from perilune.core import Watch


@dataclass(frozen=True, kw_only=True)
class Starts:
    """Times of flight [s] by seed (NaN: no answer), and the processor times that they took [s].

    What is nearer than `within` to another time of flight is the same answer.
    """

    flight_times: tuple[float, ...]
    processor_times: tuple[float, ...]
    within: float = 1e-5

    def found(self, flight_time: float) -> int:
        """Return how many found the answer that has this time of flight."""
        return len(self._near(flight_time))

    def elsewhere(self, flight_time: float) -> int:
        """Return how many found another answer."""
        return sum(math.isfinite(t) for t in self.flight_times) - self.found(flight_time)

    def spread(self, flight_time: float) -> float:
        """Largest difference [s] among the answers that are that one."""
        near = self._near(flight_time)
        return max(near) - min(near) if near else math.nan

    @property
    def median_time(self) -> float:
        """Median of the processor time [s]."""
        return median(self.processor_times)

    def _near(self, flight_time: float) -> list[float]:
        return [t for t in self.flight_times if abs(t - flight_time) < self.within]


def run_starts(run: Callable[[int], float], seeds: int, watch: Watch) -> Starts:
    """Run every seed; one that ends without an answer counts as NaN.

    Parameters
    ----------
    run
        ``run(seed)`` returns a time of flight [s].
    seeds
        How many.
    watch
        Receives a line for each.
    """
    flight_times, processor_times = [], []
    for seed in range(seeds):
        began = time.process_time()
        try:
            flight_times.append(run(seed))
        except PeriluneError:
            flight_times.append(math.nan)
        processor_times.append(time.process_time() - began)
        watch(f"seed {seed}: flight time {flight_times[-1]:.6f} s after {processor_times[-1]:.1f} s")
    return Starts(flight_times=tuple(flight_times), processor_times=tuple(processor_times))
