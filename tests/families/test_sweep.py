"""Families: along a given parameter, along a free one, through a jump, and what cannot be solved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from perilune.core import Outcome, PeriluneError
from perilune.families.sweep import sweep
from perilune.problem import Problem, Solution
from perilune.shooting.continuation import Member, follow_family
from perilune.shooting.shooting_function import Root
from perilune.solve import solve


def test_landed_mass_against_delta_v(landing: Problem) -> None:
    """Fig 8's shape: down from 0 to about 130 m/s, up to 1200, down again."""
    family = sweep(landing, {"retro.delta_v": [0.0, 130.0, 600.0, 1200.0, 1600.0]})
    mass = [-p.solution.objective for p in family.points if p.solution]
    assert len(mass) == 5
    assert mass[0] == pytest.approx(154.54135, abs=1e-5)
    assert mass[1] < mass[0] < mass[2] < mass[3] > mass[4]
    assert [p.solution.statistics.initialization for p in family.points[1:] if p.solution] == ["continuation"] * 4


def test_members_equal_separate_solves(landing: Problem) -> None:
    """Continuation arrives where a solve from nothing does."""
    fixed = landing.with_given(retro_delta_v=0.0)
    family = sweep(fixed, {"vehicle.thrust": [440.0, 700.0]})
    alone = solve(fixed.with_given(vehicle_thrust=700.0), verify=0)
    assert family.points[1].solution is not None
    assert family.points[1].solution.objective == pytest.approx(alone.objective, rel=1e-10)


def walked(
    reach: float, power: int = 2, halvings: int = 6, told: float = 1.0, base: float = 0.0
) -> tuple[list[float], Member | None]:
    """Steps tried from 0 to 1 along base + value^power, and the member that was reached.

    Newton's method converges from as near to the root as `reach`; the slope that predicts is `told` times the true one.
    """
    tried, at, none = list[float](), [0.0], np.zeros(0)

    def root(y: float, converged: bool) -> Root:
        return Root(y=np.array([y]), residual=none, inverse=np.zeros((0, 0)), slopes=none, ranges=none, cost=0.0,
                    choice=none, converged=converged)  # fmt: skip

    def tangent(here: Root, value: float) -> np.ndarray:
        at[0] = value
        return np.array([told * power * value ** (power - 1)])

    def correct(predicted: np.ndarray, value: float) -> Root:
        tried.append(value - at[0])
        y = base + value**power
        return root(y, abs(predicted[0] - y) <= reach)

    (end,) = follow_family(Member(value=0.0, root=root(base, True)), [1.0], correct, tangent, halvings)
    return tried, end


def test_steps_of_a_walk_are_halved_and_doubled() -> None:
    """The tangent misses a parabola by the step squared: what fails is halved, and after a success twice is tried."""
    tried, end = walked(0.02)
    assert end is not None and end.value == 1.0 and end.root.y[0] == 1.0
    assert tried == [1.0, 0.5, 0.25, *[0.125, 0.25] * 6, 0.125, 0.125]
    assert walked(0.0, power=1)[0] == [1.0]
    tried, end = walked(1e-6, halvings=3)
    assert end is None and tried == [1.0, 0.5, 0.25, 0.125]


def test_a_correction_longer_than_its_prediction_is_of_another_branch() -> None:
    """Newton's method converges from anywhere here; from 0, where a parabola is level, only a near root is believed."""
    tried, end = walked(9.0)
    assert tried[:4] == [1.0, 0.5, 0.25, 0.125] and end is not None
    assert walked(9.0, base=3.0)[0][:4] == [1.0, 0.5, 0.25, 0.5]  # near beside the root: 0.02 (1 + |y|)
    # Of the way to 1, 0.7 is predicted, and then 0.6: the corrections are 3/7 and 2/3 of it.
    assert walked(9.0, power=1, told=0.7)[0] == [1.0]
    assert walked(9.0, power=1, told=0.6)[0][:2] == [1.0, 0.5]


def test_unsolvable_members_are_reported(landing: Problem) -> None:
    """A mass below nothing is no question of what can be flown; the rest of the family is there."""
    family = sweep(landing.with_given(retro_delta_v=0.0), {"vehicle.mass": [300.0, -1.0, 310.0]})
    assert family.points[0].solution is not None
    assert family.points[1].solution is None
    assert family.points[1].outcome is Outcome.REFUSED and family.points[1].outcome.exit_code == 2
    assert family.points[1].message
    assert family.points[2].solution is not None


def test_interruption_keeps_what_is_there(landing: Problem) -> None:
    """Ctrl-C at the third member leaves two."""
    lines: list[Any] = []

    def press(line: Any) -> None:
        lines.append(line)
        if sum(str(entry).startswith("vehicle.thrust =") for entry in lines) == 3:
            raise KeyboardInterrupt

    family = sweep(landing.with_given(retro_delta_v=0.0), {"vehicle.thrust": [440.0, 450.0, 460.0]}, callback=press)
    assert family.interrupted
    assert len(family.points) == 2


@pytest.mark.parametrize(
    ("over", "words"),
    [
        ({"retro.specific_impuls": [300.0]}, "did you mean 'retro_specific_impulse'"),
        ({}, "along one parameter"),
        ({"vehicle.mass": []}, "must be finite numbers"),
        ({"vehicle.mass": [np.nan]}, "must be finite numbers"),
    ],
)
def test_unusable_sweeps(landing: Problem, over: dict[str, list[float]], words: str) -> None:
    """Refused before anything is solved."""
    with pytest.raises(PeriluneError, match=words):
        sweep(landing, over)


def test_family_order_is_kept(landing: Problem, ordinary: Solution) -> None:
    """Values come back in the order asked for, also downwards and repeated."""
    values = [460.0, 450.0, 450.0]
    family = sweep(landing.with_given(retro_delta_v=0.0), {"vehicle_thrust": values})
    assert [p.value for p in family.points] == values
    assert all(p.solution and p.solution.objective < ordinary.objective for p in family.points)
