"""A rough end state is a help and no hidden guess: a bad one is no worse than none."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import perilune as pl
from problems.ascents import tangent_steering
from problems.landings import ordinary
from problems.orbit_raising import orbit_raising


def with_ends(problem: pl.Problem, factor: float | None) -> pl.Problem:
    """The same problem with its rough ends multiplied by a factor, or left out."""

    def phases():
        for phase in problem.phases:
            rough = phase.end_guess
            assert rough is not None
            wrong = None if factor is None else lambda p, xp, rough=rough: tuple(factor * v for v in rough(p, xp))
            yield replace(phase, end_guess=wrong)

    return replace(problem, phases=tuple(phases()))


@pytest.mark.parametrize("factor", [None, 0.1, 10.0, -1.0])
@pytest.mark.parametrize("make", [tangent_steering, ordinary, orbit_raising])
def test_a_wrong_rough_end_changes_no_answer(make, factor: float | None) -> None:
    method = pl.Pseudospectral(nodes=12, segments=2, refine=0)
    known = method.run(make()).objective
    assert method.run(with_ends(make(), factor)).objective == pytest.approx(known, rel=1e-6)


def test_a_rough_end_that_is_no_number_is_refused() -> None:
    with pytest.raises(pl.PeriluneError, match=r"end_guess of .* is not a number\n.*nan"):
        pl.Pseudospectral().run(with_ends(ordinary(), math.nan))
