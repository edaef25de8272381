"""What a fixed start breaks, and what an objective leaves out, is said before anything is solved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perilune import Indirect, Pseudospectral
from perilune.core import InfeasibleError
from perilune.methods.method import Method
from perilune.problem import Conditions, FreeParameter, Parameter, Problem, end_text, kept_text, preflight
from perilune.scenario import load_file
from perilune.solve import solve
from problems.integrators import least_energy, least_time

EXAMPLES = Path(__file__).parents[2] / "examples"


def walled(room: Callable[..., Any], **given: Parameter) -> Problem:
    """Least time over 1 m from x = 0, v = 0, and a condition of the path."""
    problem = least_time()
    phase = replace(problem.phases[0], path=Conditions(lambda x, u, p, xp: (room(x, u, p),), room="m"))
    return replace(problem, phases=(phase,), given={**problem.given, **given})


@pytest.mark.parametrize("method", [Indirect(), Pseudospectral()])
def test_by_how_much_a_start_breaks_the_path_is_told(method: Method) -> None:
    problem = walled(lambda x, u, p: x.x - p.wall, wall=Parameter(value=0.25, unit="m"))
    with pytest.raises(InfeasibleError, match="the start violates a path condition: wall") as refused:
        solve(problem, method)
    assert (refused.value.got, refused.value.expected) == ("room at the start -0.25 m", "at least 0 m")
    many = preflight(problem, {"wall": [0.25, 0.0, -1.0]})
    assert [np.asarray(f.passed).tolist() for f in many] == [[False, True, True]]


def test_what_a_kind_says_of_its_start_is_not_said_twice() -> None:
    low = load_file(EXAMPLES / "precision_landing.toml").problem.with_given(approach_up=100.0)
    assert [f.name for f in preflight(low) if f.name.startswith(("height above", "height_above"))] == [
        "height above the glide slope"
    ]


@pytest.mark.parametrize("off", [0.0, -1e-12])
def test_a_start_on_its_limit_keeps_it(off: float) -> None:
    assert preflight(walled(lambda x, u, p: x.x + off)) == ()


def test_what_is_chosen_is_not_judged_at_the_start() -> None:
    """A control, and a free parameter, may keep what their typical values break."""
    push = Parameter(value=1.0, unit="m/s^2")
    assert preflight(walled(lambda x, u, p: (x.x + p.distance) * (u.u / p.push) - p.distance, push=push)) == ()
    assert (
        preflight(walled(lambda x, u, p: x.x - p.distance * (p.t_f / p.wait), wait=Parameter(value=1.0, unit="s")))
        == ()
    )
    moved = replace(
        walled(lambda x, u, p: x.x - p.distance),
        start=lambda p, xp: (p.begin, 0.0 * p.begin / p.t_f),
        free=(*least_time().free, FreeParameter(name="begin", unit="m", lower=0.0, upper=2.0)),
    )
    assert preflight(moved) == ()


def test_a_start_outside_the_bounds_of_a_state_is_refused_by_both_methods() -> None:
    problem = least_energy(ceiling=-0.5)
    for method in (Indirect(), Pseudospectral()):
        with pytest.raises(InfeasibleError, match="the start puts x outside its bounds") as refused:
            solve(problem, method)
        assert refused.value.expected == "at most -0.5 m"


def test_an_objective_that_is_the_same_for_all_is_told_of() -> None:
    constant = replace(least_energy(), objective=lambda x, p, xp: p.v0 * p.v0 / p.T)
    (said,) = preflight(constant)
    assert said.verdict == "warning" and "the objective is a constant" in said.meaning
    assert preflight(least_energy()) == () and preflight(least_time()) == ()


def test_ends_and_limits_are_told_by_their_keys() -> None:
    """As who states a return writes them, and not by states and conditions of its equations."""
    problem = load_file(EXAMPLES / "maps" / "capsule.toml").problem
    assert end_text(problem, "drift") == (
        "interface.altitude 100 km, interface.angle_lower -3 deg, interface.angle_upper -1.2 deg"
    )
    assert end_text(problem, "burn") == ""
    assert kept_text(load_file(EXAMPLES / "capsule_return.toml").problem, ["load_left"]) == "limits.load"
