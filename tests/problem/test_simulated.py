"""A solution is flown by another program: SciPy's integrator on `Problem.rates` comes to the same end."""

from __future__ import annotations

import pickle
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import perilune as pl
from command_line import ROOT
from perilune.scenario import load_file

# Files, and changes of them: one phase, two with a coast, stages that are told by name, air and heat.
FLIGHTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "hybrid": ("hybrid_lander.toml", ()),
    "descent": ("polar_descent.toml", ("problem.target=anywhere", "start.latitude=60 deg")),
    "coast": ("precision_landing.toml", ("approach.longest_coast=100 s",)),
    "return": ("minimum_duration_return.toml", ()),
}


@cache
def solved(name: str) -> pl.Solution:
    file, changes = FLIGHTS[name]
    return pl.solve(load_file(ROOT / "examples" / file, changes).problem, verify=0)


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_solution_is_flown_to_its_end(name: str) -> None:
    """From jump to jump of the control; measured: 4e-8 of each state's size at most."""
    solution = solved(name)
    for k, trajectory in enumerate(solution.trajectories):
        phase, time = solution.problem.phases[k], trajectory.time

        def along(t: float, x: Any, k: int = k) -> Any:
            u = solution.evaluate(k, np.array([t]))[1][:, 0]
            return solution.problem.rates(x, u, t, phase=k, free=solution.free)

        jumps = [end for begin, end in pairwise(time) if end - begin < 1e-6 * trajectory.duration]
        x = trajectory.state.values[0]
        for begin, end in pairwise([0.0, *jumps, trajectory.duration]):
            if end > begin:
                x = solve_ivp(along, (begin, end), x, method="DOP853", rtol=1e-8, atol=1e-8).y[:, -1]
        size = np.abs(trajectory.state.values).max(axis=0) + 1e-12
        worst = np.abs((x - trajectory.state.values[-1]) / size).max()
        assert worst < 1e-7, phase.name


def test_shapes() -> None:
    """One state or many, one control for all of them or one for each, lists as well as arrays."""
    solution = solved("hybrid")
    problem, t = solution.problem, np.linspace(0.0, 0.9 * solution.duration, 7)
    x, u = solution.evaluate(0, t)
    many = problem.rates(x, u)
    assert many.shape == x.shape and many.dtype == float
    for j in range(len(t)):
        one = problem.rates(x[:, j].tolist(), tuple(u[:, j]), t[j])
        assert one.shape == (len(x),)
        np.testing.assert_array_equal(one, many[:, j])
    np.testing.assert_array_equal(problem.rates(x, u[:, 2]), problem.rates(x, np.tile(u[:, 2:3], 7)))
    assert problem.rates(x[:, 0], u).shape == x.shape
    assert problem.rates(x[:, 0], u[:, 0], phase=problem.phases[0].name) == pytest.approx(many[:, 0])
    again = pickle.loads(pickle.dumps(problem))
    np.testing.assert_array_equal(again.rates(x, u), many)


def hop(**more: Any) -> pl.Problem:
    """Two phases straight up: thrust, whose size is free, then a fall."""
    height, speed = pl.Variable(name="h", unit="m"), pl.Variable(name="v", unit="m/s")
    rise = pl.Phase(
        name="rise", states=(height, speed), controls=(pl.ScalarControl(name="throttle", lower=0.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (x.v, u.throttle * p.push - p.g), duration="t1",
    )  # fmt: skip
    fall = pl.Phase(
        name="fall", states=(height, speed), dynamics=lambda x, u, p, xp: (x.v, -p.g), duration="t2",
        end=pl.Conditions(lambda x, p, xp: (x.h,), ground="m"), 
    )  # fmt: skip
    times = tuple(pl.FreeParameter(name=name, unit="s", upper=100.0, guess=10.0) for name in ("t1", "t2"))
    push = pl.FreeParameter(name="push", unit="m/s^2", lower=2.0, upper=5.0, guess=3.0)
    return pl.Problem(**{
        "name": "hop", "phases": (rise, fall), "start": lambda p, xp: (0.0 * p.g * p.t1**2, 0.0 * p.g * p.t1),
        "links": (lambda x, p, xp: (x.h, x.v),), "given": {"g": pl.Parameter(value=1.62, unit="m/s^2")},
        "free": (*times, push), "objective": lambda x, p, xp: x.v, "objective_unit": "m/s", **more,
    })  # fmt: skip


def test_rates_are_those_of_the_formula() -> None:
    problem = hop()
    assert problem.rates([3.0, 4.0], [0.5], phase="rise", free={"push": 3.0}).tolist() == [4.0, 0.5 * 3.0 - 1.62]
    assert problem.rates([3.0, 4.0], phase="fall").tolist() == [4.0, -1.62]  # it takes no free parameter
    assert problem.rates([3.0, 4.0], (), 12.0, phase=1).tolist() == [4.0, -1.62]
    falling = problem.rates(np.array([[3.0, 2.0, 1.0], [4.0, 5.0, 6.0]]), phase="fall")
    assert falling.tolist() == [[4.0, 5.0, 6.0], [-1.62, -1.62, -1.62]]  # a rate that does not vary has all its columns
    assert hop().with_given(push=4.0).rates([0.0, 0.0], [1.0], phase="rise")[1] == pytest.approx(4.0 - 1.62)


@pytest.mark.parametrize(
    ("arguments", "keywords", "said"),
    [
        (([1.0, 2.0],), {}, "hop has several phases[\\s\\S]*one of rise, fall"),
        (([1.0, 2.0],), {"phase": "glide"}, "no phase of this name[\\s\\S]*rise"),
        (([1.0, 2.0],), {"phase": 2}, "no phase of this name"),
        (([1.0, 2.0],), {"phase": True}, "no phase of this name"),
        (([1.0, 2.0, 3.0],), {"phase": "fall"}, "the state of fall[\\s\\S]*2 components: h, v"),
        ((5.0,), {"phase": "fall"}, "2 components: h, v"),
        (("up",), {"phase": "fall"}, "the state of fall"),
        (([1.0, None],), {"phase": "fall"}, "the state of fall"),
        ((np.zeros((2, 2, 2)),), {"phase": "fall"}, "the state of fall"),
        (([1.0, 2.0], [0.3]), {"phase": "fall"}, "the control of fall[\\s\\S]*0 components: none"),
        (([1.0, 2.0],), {"phase": "rise"}, "the control of rise[\\s\\S]*1 components: throttle"),
        (([1.0, 2.0], [0.3, 0.4]), {"phase": "rise"}, "1 components: throttle"),
        (
            (np.zeros((2, 3)), np.zeros((1, 4))),
            {"phase": "rise"},
            "numbers of states and controls differ[\\s\\S]*3 states and 4 controls",
        ),
        (([1.0, 2.0], [0.3]), {"phase": "rise"}, "depend on the free parameter push[\\s\\S]*free=solution.free"),
        (([1.0, 2.0], [0.3]), {"phase": "rise", "free": {"g": 2.0}}, "no free parameter of this name"),
        (([1.0, 2.0], [0.3]), {"phase": "rise", "free": 3}, "free"),
        (([1.0, 2.0],), {"phase": "fall", "free": {"pusch": 2.0}}, "no free parameter of this name[\\s\\S]*push"),
        ((np.zeros((3, 2)),), {"phase": "fall"}, "an array of shape \\(3, 2\\)"),
        (([1.0, 2.0], [0.3], "now"), {"phase": "fall"}, "control of fall|a time"),
        (([1.0, 2.0], (), "now"), {"phase": "fall"}, "a time"),
        ((), {"phase": "fall"}, "rates"),
        (([1.0, 2.0],), {"fase": "fall"}, "fase"),
    ],
)
def test_what_cannot_be_computed_is_refused(arguments: Any, keywords: Any, said: str) -> None:
    with pytest.raises(pl.PeriluneError, match=said):
        hop().rates(*arguments, **keywords)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mass", [0.0, np.nan])
def test_a_state_at_which_the_dynamics_are_not_defined_is_refused(mass: float) -> None:
    """A mass of 0 was a warning of NumPy, and rates that are no numbers."""
    problem = load_file(ROOT / "examples" / "ordinary_lander.toml").problem
    x = np.array([[1753e3, 1740e3], [0.0, 0.1], [0.0, -1.0], [1600.0, 10.0], [300.0, mass]])
    assert np.isfinite(problem.rates(x[:, 0], [1.0, 0.0])).all()
    for state in (x[:, 1], x):
        with pytest.raises(pl.PeriluneError, match=f"rate of u in descent is not finite[\\s\\S]*m = {mass:g}, "):
            problem.rates(state, [1.0, 0.0])
