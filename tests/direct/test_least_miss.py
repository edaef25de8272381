"""The search for the flight that misses least ends where it gains nothing, and only there."""

from __future__ import annotations

import math

import pytest

from perilune.direct.ipopt_events import LeastMissProgress


def ended(misses: list[tuple[float, float]]) -> int | None:
    """Iteration at which a search with these misses and violations ends; None where it goes on."""
    progress = LeastMissProgress()
    return next((k for k, each in enumerate(misses) if progress.is_stalled(*each)), None)


def test_a_miss_that_stays_is_stalled() -> None:
    """What falls to 1.1 and stays there ends thirty iterations later, at a flight."""
    falling = [(1.1 + 5.0 * math.exp(-0.3 * k), 1e-4) for k in range(40)]
    end = ended(falling + [(1.1, 1e-4)] * 110)
    assert end is not None and 40 < end < 60
    rough = [(1.1, 1e-1)] * 100  # no flights: their misses say nothing
    assert ended(rough) is None
    assert ended([*rough, (1.1, 1e-4)]) is None
    assert ended([(1.1, 1e-4), *rough, (1.09, 1e-4)]) == 101


@pytest.mark.parametrize("late", [25, 45])
def test_a_miss_that_becomes_less_is_not_stalled(late: int) -> None:
    """A plateau that a step leaves, and a slow way down; what is nearly nothing may become nothing."""
    plateau = [(1.1, 1e-4)] * 25 + [(1.1, 1.0)] * (late - 25) + [(0.5 * 0.9**k, 1e-4) for k in range(100)]
    assert ended(plateau) is None
    assert ended([(0.99**k, 1e-4) for k in range(150)]) is None
    assert ended([(5e-3, 1e-4)] * 150) is None
    assert ended([(1.4, 3e-3), *[(55.0, 1e-4)] * 100]) is None
