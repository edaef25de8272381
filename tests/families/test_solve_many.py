"""Batches: closed forms, the same to the last bit alone, other arcs and bounds, and bad rows among good ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune import Outcome, PeriluneError, Problem, Solution
from perilune.families.batch import Batch
from perilune.families.points import read_points
from perilune.families.solve_many import solve_many
from problems.constrained import (
    bryson_denham,
    bryson_denham_truth,
    speed_limit,
    speed_limit_truth,
    timed_bryson_denham,
    timed_bryson_denham_truth,
)
from problems.landings import constant_mass

THRUSTS = np.linspace(400.0, 480.0, 7)


@pytest.fixture(scope="module")
def known(landing: Problem) -> Solution:
    return pl.solve(landing, verify=0)


@pytest.fixture(scope="module")
def grid(landing: Problem, known: Solution) -> Batch:
    """Engines with the better of which the lander does without the retro burn."""
    thrust, impulse = (axis.ravel() for axis in np.meshgrid([330.0, 440.0, 620.0], [280.0, 310.0, 370.0]))
    return solve_many(landing, {"vehicle.thrust": thrust, "vehicle.specific_impulse": impulse}, known)


def test_the_arcs_of_bryson_denham_change_along_a_batch() -> None:
    """Free, touching and along the ceiling: below 1/4 and 1/6 a free flight leads no further, but nodes near by do."""
    ceilings = np.linspace(0.09, 0.3, 40)
    batch = solve_many(bryson_denham(0.3), {"ceiling": ceilings})
    assert batch.objective == pytest.approx([bryson_denham_truth(h) for h in ceilings], rel=1e-9)
    assert (batch.outcomes == "SOLVED").all() and len(batch.solved_alone) < 5
    assert [bool(batch.solution(i).structure) for i in (0, -1)] == [True, False]


def test_points_that_are_not_reached_may_be_left() -> None:
    batch = solve_many(bryson_denham(0.3), {"ceiling": [0.28, 0.2]}, search=False)
    assert batch.outcomes.tolist() == ["SOLVED", "NOT_CONVERGED"] and "search=False" in batch.message(1)


def test_a_batch_on_a_boundary_arc_stays_in_lanes() -> None:
    ceilings = np.linspace(0.09, 0.13, 9)
    batch = solve_many(bryson_denham(0.11), {"ceiling": ceilings})
    assert batch.objective == pytest.approx([bryson_denham_truth(h) for h in ceilings], rel=1e-9)
    assert not batch.solved_alone.size
    assert batch.slopes[:, 0] == pytest.approx(-4 / (9 * ceilings**2), rel=1e-6)  # of J = 4/(9 h)


def test_bounds_are_taken_and_released() -> None:
    """The duration lies at its upper bound for a low price of time, inside for a higher one."""
    ceilings = np.array([0.12, 0.13, 0.14])
    problem = timed_bryson_denham(0.13, 0.5, 2.0, price=3.0)
    batch = solve_many(problem, {"ceiling": ceilings})
    truth = [min(timed_bryson_denham_truth(h, T, 3.0) for T in np.linspace(0.5, 2.0, 200001)) for h in ceilings]
    assert batch.objective == pytest.approx(truth, rel=1e-8)


def braked(most: float) -> Problem:
    """From rest to rest over 1 m in 1 s with the least int u^2/2, where u = 6 - 12 t, and u >= -most on the path."""
    swing = bryson_denham(0.3).phases[0]
    phase = replace(
        swing,
        end=pl.Conditions(lambda x, p, xp: (x.x - p.way, x.v), place="m", rest="m/s"),
        path=pl.Conditions(lambda x, u, p, xp: (u.u + p.most,), room="m/s^2"),
        end_guess=lambda p, xp: (p.way, 0 * p.way, 6 * p.way**2),
    )
    given = {"T": (1.0, "s"), "way": (1.0, "m"), "most": (most, "m/s^2")}
    return replace(
        bryson_denham(0.3),
        phases=(phase,),
        start=lambda p, xp: (0 * p.way, 0 * p.way / p.T, 0 * p.way),
        given={name: pl.Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
    )


def test_a_control_that_breaks_the_path_at_the_end_does_not_answer() -> None:
    """Below 6 m/s^2 the brakes are too weak just before the end: u is linear until t = 3/2 - 3/most."""
    brakes = np.array([6.1, 5.99, 5.95, 5.8, 5.5])
    batch = solve_many(braked(6.2), {"most": brakes})
    truth = np.where(brakes < 6, brakes**2 * (2 / (3 * (1.5 - 3 / brakes)) - 0.5), 6.0)
    assert batch.objective == pytest.approx(truth, rel=1e-11)
    assert pl.verify(batch.solution(2), 2).outcome is Outcome.PROVED


def test_a_control_that_breaks_the_path_between_two_steps_does_not_answer() -> None:
    """u = 6 - 12 t must keep off a value that it passes half-way between two of the 48 steps, by less than a step."""
    problem = braked(6.2)
    path = pl.Conditions(lambda x, u, p, xp: ((u.u - p.most) ** 2 - 0.01 * p.way**2 / p.T**4,), room="m^2/s^4")
    problem = replace(problem, phases=(replace(problem.phases[0], path=path),))
    between = [6 - 12 * (step + 0.5) / 48 for step in (0, 1, 2)]
    batch = solve_many(
        problem, {"most": [*between, 8.0]}, pl.solve(problem.with_given(most=7.0), verify=0), search=False
    )
    assert batch.outcomes.tolist() == [*["NOT_CONVERGED"] * 3, "SOLVED"]
    assert batch.objective[3] == pytest.approx(6.0, rel=1e-12)


def test_lanes_have_the_effort_of_a_constant_mass() -> None:
    """Of several parameters at once, in closed form."""
    problem = constant_mass(1.6, 100.0, 5.0, 100.0)
    names = [n for n in problem.given if problem.unit_of(n) in ("m", "m/s", "m/s^2")]
    assert names
    rng = np.random.default_rng(5)
    base = {n: problem.given[n].value for n in names}
    points = [{n: v * float(1 + 0.05 * rng.uniform(-1, 1)) for n, v in base.items()} for _ in range(20)]
    batch = solve_many(problem, points)
    for point, objective in zip(points, batch.objective, strict=True):
        assert objective == pytest.approx(solve_alone(problem, point).objective, rel=1e-9)


def solve_alone(problem: Problem, point: dict[str, float]) -> Solution:
    return pl.solve(problem.with_given(**point), verify=0)


def test_points_have_the_best_of_the_bounds(landing: Problem, grid: Batch) -> None:
    """Where the retro burn is at its bound, and where it is not, J and all results are those of a search anew."""
    for i in range(len(grid)):
        alone = pl.solve(grid.problem_of(i), verify=0)
        assert grid.objective[i] == pytest.approx(alone.objective, rel=1e-8), i
        assert grid.free["retro_delta_v"][i] == pytest.approx(alone.free["retro_delta_v"], abs=1e-3)
        for name, column in grid.results.items():
            assert column[i] == pytest.approx(float(alone.results[name].value), rel=1e-6, abs=1e-3), name
    assert (grid.free["retro_delta_v"] == 0.0).any() and (grid.free["retro_delta_v"] > 1000.0).any()


def test_a_worse_bound_does_not_answer_for_a_branch_that_is_hard_to_follow(landing: Problem, known: Solution) -> None:
    """Beside the fold of the branch of the guess, where it flies long and low, and where it has come to its end."""
    points = [(253.8, 290.0), (340.0, 290.0), (584.1, 330.0), (623.1, 330.0)]
    batch = solve_many(landing, [{"vehicle.thrust": t, "vehicle.specific_impulse": s} for t, s in points], known)
    for i in range(len(batch)):
        assert batch.objective[i] == pytest.approx(pl.solve(batch.problem_of(i), verify=0).objective, rel=1e-8)


def test_a_point_is_the_same_to_the_last_bit_alone(landing: Problem, known: Solution, grid: Batch) -> None:
    for i in np.nonzero(~np.isin(np.arange(len(grid)), grid.solved_alone))[0]:
        one = solve_many(landing, [dict(zip(grid.parameters, grid.values[i], strict=True))], known)
        assert one.objective[0] == grid.objective[i] and (one.slopes[0] == grid.slopes[i]).all()
        assert all(one.results[name][0] == column[i] for name, column in grid.results.items())


def test_a_solution_of_a_batch_proves(grid: Batch) -> None:
    solution = grid.solution(4)
    assert solution.objective == pytest.approx(grid.objective[4], rel=1e-13)
    assert pl.verify(solution, 3).outcome is Outcome.PROVED
    assert grid.outcomes[4] == "SOLVED" and grid.levels[4] == 0


def test_points_are_proved_on_demand(landing: Problem, known: Solution) -> None:
    batch = solve_many(landing, {"vehicle.thrust": [430.0, 450.0]}, known, verify=3)
    assert batch.outcomes.tolist() == ["PROVED", "PROVED"] and batch.levels.tolist() == [3, 3]


def test_forms_of_points_are_the_same(landing: Problem, known: Solution) -> None:
    pandas = pytest.importorskip("pandas")
    forms: list[Any] = [
        np.array([(thrust,) for thrust in THRUSTS], dtype=[("vehicle_thrust", float)]),
        {"vehicle_thrust": THRUSTS},
        {"vehicle.thrust [kN]": THRUSTS / 1e3},
        [{"vehicle.thrust": thrust} for thrust in THRUSTS],
        pandas.DataFrame({"vehicle.thrust (N)": THRUSTS}),
    ]
    found = [solve_many(landing, form, known) for form in forms]
    assert all(batch.parameters == ("vehicle_thrust",) for batch in found)
    for batch in found[1:]:
        assert batch.objective == pytest.approx(found[0].objective, rel=1e-12)


def test_slopes_of_a_limit_and_of_a_bound_are_apart() -> None:
    """Gravity moves the thrust along the speed limit, and the bounds of thrust do not, although they vary with it."""
    problem, h = speed_limit(60.0), 1e-4
    names = ("g", "least", "limit")
    batch = solve_many(problem, [{name: problem.given[name].value for name in names}])
    more, less = (speed_limit_truth(60.0, g=1.62 + way * h)[2] for way in (1, -1))
    assert batch.slopes[0, 0] == pytest.approx((less - more) / (2 * h), rel=1e-7)


def test_values_that_are_hidden_or_no_numbers_refuse_their_points(landing: Problem) -> None:
    pandas = pytest.importorskip("pandas")
    columns: list[Any] = [
        np.ma.array([430.0, 440.0], mask=[False, True]), [430.0, 440 + 0j], [430.0, True],
        pandas.Series([430, None], dtype="Int64", index=[7, 7]),
    ]  # fmt: skip
    for column in columns:
        refused = read_points(landing, {"vehicle.thrust": column}).unreadable
        assert list(refused) == [1] and refused[1].startswith("vehicle_thrust is no finite number")


def test_points_may_name_a_free_parameter(landing: Problem, known: Solution) -> None:
    """It is given then, and no longer chosen: at its best value the answer is that of the problem."""
    best = known.free["retro_delta_v"]
    batch = solve_many(landing, {"retro_delta_v": [best, 0.8 * best, -1.0]}, known)
    assert batch.outcomes.tolist() == ["SOLVED", "SOLVED", "REFUSED"] and set(batch.free) == {"flight_time"}
    assert batch.objective[0] == pytest.approx(known.objective, rel=1e-10)
    assert batch.slopes[0, 0] == pytest.approx(0.0, abs=1e-6) and batch.slopes[1, 0] < 0.0
    alone = pl.solve(batch.problem_of(1), verify=0)
    assert batch.solution(1).objective == pytest.approx(alone.objective, rel=1e-9) == batch.objective[1]


def test_bad_rows_lose_no_others(landing: Problem, known: Solution) -> None:
    rows: list[dict[str, Any]] = [
        {"vehicle.thrust": 440.0}, {"vehicle.thrust": -1.0}, {"vehicle.thrust": float("nan")}, {},
        {"vehicle.thrust": "440 N"}, {"vehicle.thrust": 1e300}, {"vehicle.thrust": True}, {"vehicle.thrust": 450.0},
    ]  # fmt: skip
    batch = solve_many(landing, rows, known)
    assert batch.outcomes.tolist() == ["SOLVED", *6 * ["REFUSED"], "SOLVED"]
    assert batch.solved.tolist() == [True, *6 * [False], True]
    for i, words in ((1, "out of range"), (2, "no finite number"), (3, "is missing"), (4, "440 N"), (5, "magnitude")):
        assert words in batch.message(i)
    assert batch.message(0) == ""
    with pytest.raises(PeriluneError, match="out of range"):
        batch.solution(1)


def test_what_physics_forbids_is_infeasible_in_the_words_of_solve(landing: Problem, known: Solution) -> None:
    batch = solve_many(landing, {"landing.altitude": [0.0, 20e3]}, known)
    with pytest.raises(pl.InfeasibleError) as refused:
        pl.solve(landing.with_given(landing_altitude=20e3))
    assert batch.outcomes.tolist() == ["SOLVED", "INFEASIBLE"]
    assert batch.message(1) == str(refused.value)


def test_an_interruption_keeps_what_is_done(landing: Problem, known: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perilune.families.solve_many._TOGETHER", 3)

    def stop(event: Any) -> None:
        if event == "3 of 7 points":
            raise KeyboardInterrupt

    batch = solve_many(landing, {"vehicle.thrust": THRUSTS}, known, callback=stop)
    assert batch.interrupted and batch.solved.tolist() == [True] * 3 + [False] * 4
    assert set(batch.outcomes[3:]) == {"INTERRUPTED"}
    assert "stopped" in batch.message(6) and "3 of 7" in repr(batch)


def test_frames_have_a_row_for_each_point(landing: Problem, known: Solution) -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    batch = solve_many(landing, {"vehicle.thrust": [440.0, -1.0]}, known)
    frame, data = batch.to_dataframe(), batch.to_xarray()
    assert frame["outcome"].tolist() == data["outcome"].values.tolist() == ["SOLVED", "REFUSED"]
    assert frame["landed_mass"][0] == -batch.objective[0] and np.isnan(frame["landed_mass"][1])
    assert frame.attrs["units"]["vehicle_thrust"] == "N" == data["vehicle_thrust"].attrs["units"]


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([], "no parameter"),
        (3, "valid set of points"),
        ("vehicle.thrust", "valid set of points"),
        ([3], "a point"),
        ({"thrust": [1.0]}, "no parameter of this name|there is no parameter"),
        ({"vehicle.thrust": 3.0}, "valid column"),
        ({"vehicle.thrust": [[1.0], [1.0, 2.0]]}, "valid column"),
        ({"vehicle.thrust [kg]": [1.0]}, "another kind"),
        ({"vehicle.thrust [frob]": [1.0]}, "unknown"),
        ({"vehicle.thrust": [1.0, 2.0], "vehicle.mass": [1.0]}, "differ in length"),
        ({"vehicle.thrust": [1.0], "vehicle_thrust [kN]": [1.0]}, "two columns"),
    ],
)
def test_what_is_no_table_is_refused(landing: Problem, known: Solution, points: Any, words: str) -> None:
    with pytest.raises(PeriluneError, match=words):
        solve_many(landing, points, known)


def test_no_points_are_an_empty_batch(landing: Problem, known: Solution) -> None:
    batch = solve_many(landing, {"vehicle.thrust": []}, known)
    assert len(batch) == 0 and not batch.interrupted
