"""Conditions that are held all along a phase, by the indirect method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from perilune.methods.indirect.indirect import Indirect
from perilune.models.descent.coordinates import variables_of_unit
from perilune.problem import Conditions, FreeParameter, Parameter, Phase, Problem, ScalarControl


def _rates(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    return x.v, u.a, 0.5 * u.a * u.a


def bryson_denham(wall: float) -> Problem:
    """x'' = a, J = int a^2/2, from (0, 1) to (0, -1) in 1 s, x <= wall: in three phases, the second along the wall.

    Bryson and Ho (1975), section 3.11: J = 4/(9 wall) where wall <= 1/6.
    """

    def phase(name: str, **more: Any) -> Phase:
        return Phase(
            name=name,
            states=(
                *variables_of_unit("m", "x"),
                *variables_of_unit("m/s", "v"),
                *variables_of_unit("m^2/s^3", "cost"),
            ),
            controls=(ScalarControl(name="a", unit="m/s^2"),),
            dynamics=_rates,
            duration=f"T_{name}",
            **more,
        )

    return Problem(
        name="bryson_denham",
        phases=(
            phase(
                "up",
                end=Conditions(lambda x, p, xp: (x.x - p.wall, x.v), on_wall="m", at_rest="m/s"),
            ),
            phase("along", held=Conditions(lambda x, u, p, xp: (u.a,), stays="m/s^2")),
            phase(
                "down",
                end=Conditions(
                    lambda x, p, xp: (x.x, x.v + p.speed, p.T_up + p.T_along + p.T_down - p.T),
                    back="m",
                    speed="m/s",
                    time="s",
                ),
            ),
        ),
        links=(lambda x, p, xp: (x.x, x.v, x.cost),) * 2,
        start=lambda p, xp: (0 * p.wall, p.speed, 0 * p.speed * p.speed / p.T),
        given={
            "wall": Parameter(value=wall, unit="m"),
            "speed": Parameter(value=1.0, unit="m/s"),
            "T": Parameter(value=1.0, unit="s"),
        },
        free=tuple(FreeParameter(name=f"T_{name}", unit="s", guess=0.3) for name in ("up", "along", "down")),
        objective=lambda x, p, xp: x.cost,
        objective_unit="m^2/s^3",
    )


def test_a_boundary_arc_of_second_order() -> None:
    """J = 4/(9 wall); the wall is met at 3 wall and left at 1 - 3 wall; lambda_x = 2/(9 wall^2) before."""
    wall = 1 / 9
    problem = bryson_denham(wall)
    solution = Indirect().run(problem)
    assert solution.objective == pytest.approx(4 / (9 * wall), abs=1e-10)
    assert solution.free["T_up"] == pytest.approx(3 * wall, abs=1e-12)
    assert solution.free["T_down"] == pytest.approx(3 * wall, abs=1e-12)
    first, middle, last = solution.trajectories
    assert first.costate is not None and last.costate is not None
    assert np.abs(middle.control.values).max() < 1e-12
    # a = -(2/(3 wall)) (1 - t/(3 wall)) on the way up, lambda_v = -a, lambda_x = -lambda_v'.
    assert first.costate.values[0, 1] == pytest.approx(2 / (3 * wall), abs=1e-8)
    assert first.costate.values[0, 0] == pytest.approx(2 / (9 * wall**2), abs=1e-7)
    assert last.costate.values[-1, 0] == pytest.approx(-2 / (9 * wall**2), abs=1e-7)
