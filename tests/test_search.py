"""What a search lists: every extremal once, and the better one among them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import perilune as pl
from problems.constrained import brachistochrone


def test_mirror_images_are_listed_once() -> None:
    """Cycloids from rest to the line x = 1 m, free of the slope: T = sqrt((2k + 1) pi) s, and v may be negative."""
    problem = brachistochrone()
    free = replace(problem, phases=(replace(problem.phases[0], path=None, path_conditions=()),))
    times = [extremal.free["T"] for extremal in pl.solve(free, level=0).extremals]
    assert times[0] == pytest.approx(np.sqrt(np.pi), abs=1e-9) and len(times) > 2
    turns = np.square(times) / np.pi
    assert turns == pytest.approx(np.round(turns), abs=1e-8)
    assert len(set(np.round(turns))) == len(turns)
