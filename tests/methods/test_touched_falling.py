"""A limit on a phase in which nothing is steered: kept by how that phase begins, touched where it would be broken."""

from __future__ import annotations

import numpy as np
import pytest

import perilune as pl
from perilune.conditions.pontryagin import derive
from perilune.core import PeriluneError
from perilune.scenario import load_file
from perilune.structures import Arc, Structure
from perilune.structures.multiphase import restate
from problems.thrown import thrown, thrown_truth

LOW = 0.5  # m, below what the free throw rises to


@pytest.fixture(scope="module")
def below() -> pl.Solution:
    return pl.solve(thrown(LOW))


def test_a_throw_below_a_ceiling_touches_it_and_is_proved(below: pl.Solution) -> None:
    J, v, slope = thrown_truth(LOW)
    assert below.outcome is pl.Outcome.PROVED and below.verification.level == 3
    assert below.objective == pytest.approx(J, abs=1e-10)
    (arc,) = below.structure
    assert arc.description == "contact point of room" and arc.begin == arc.end == pytest.approx(v, abs=1e-9)
    assert slope < 0  # to raise the ceiling pays
    curve = below.trajectories[1].costate
    assert curve is not None
    at = np.nonzero(curve.time == arc.begin)[0]
    # lam(t-) = lam(t+) + nu dS/dx with S = l - h, and J falls by nu for each metre of room.
    assert curve.values[at[0], 0] - curve.values[at[-1], 0] == pytest.approx(-slope, rel=1e-8)


def test_a_ceiling_above_the_free_throw_is_not_touched() -> None:
    free = pl.solve(thrown(9.0))
    assert free.outcome is pl.Outcome.PROVED and free.structure == ()


@pytest.mark.parametrize("limit", ["load", "heat_rate", "dynamic_pressure"])
def test_the_costates_jump_along_the_slope_of_a_limit_alone(limit: str) -> None:
    """Of S and S' of a pressure both are 1e-14 in units of a mass and a radius: the row of the touch is that of S'."""
    stated = {"load": "20 g0", "heat_rate": "3.9 MW/m^2", "dynamic_pressure": "115 kPa"}[limit]
    nose, limited = "vehicle.nose_radius=0.5 m", f"limits.{limit}={stated}"
    problem = load_file("examples/minimum_duration_return.toml", (nose, limited)).problem
    falling = (Arc(touches=(f"{limit}_left",)), Arc())
    conditions = derive(restate(problem, Structure(((Arc(),), falling)), repeated=False))
    (row,) = (i for i, (name, _) in enumerate(conditions.residuals) if "jump along the rate" in name)
    rows, columns = conditions.residual.jac_sparsity(0, 0).get_triplet()
    (at,) = (c for r, c in zip(rows, columns, strict=True) if r == row)
    assert f"touch_{limit}_left_rate" in conditions.unknowns[at][0]


def test_what_nothing_steers_cannot_be_ridden() -> None:
    riding = Structure(((Arc(),), (Arc(), Arc(along=("room",)), Arc())))
    with pytest.raises(PeriluneError, match="no control acts on room"):
        restate(thrown(LOW), riding)
