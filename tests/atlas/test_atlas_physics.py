"""What physics allows of points of a map, traced, against the same comparisons point by point."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.charts.borders import Borders
from perilune.charts.chart import Chart
from perilune.charts.feasibility import point_feasibility
from perilune.problem import Finding, is_possible, preflight
from perilune.scenario import load_file

EXAMPLES = Path(__file__).parents[2] / "examples"
OVER = {
    "hybrid_lander": {"vehicle_thrust": (0.0, 650.0), "orbit_perilune_altitude": (-5e3, 25e3)},
    "precision_landing": {"vehicle_thrust": (0.0, 2e4), "body_gravitational_parameter": (1e12, 2e13)},
    "capsule_return": {"vehicle_dry_mass": (100.0, 3e4), "interface_altitude": (5e4, 5e5)},
}


def judged(problem: pl.Problem, names: list[str], points: Any) -> Any:
    return is_possible(preflight(problem, dict(zip(names, points.T, strict=True))))


@pytest.mark.parametrize("name", OVER)
def test_traced_physics_judges_as_it_is_stated(name: str) -> None:
    problem, axes = load_file(EXAMPLES / f"{name}.toml").problem, OVER[name]
    low, high = np.array(list(axes.values())).T
    points = np.random.default_rng(3).uniform(low, high, (400, len(axes)))
    found = point_feasibility(problem, list(axes))(points)
    assert 20 < found.sum() < 380
    np.testing.assert_array_equal(found, judged(problem, list(axes), points))


def test_what_is_no_number_passes_nothing() -> None:
    """A descent from rest: with a speed of 0 times a time without an end physics says nothing, and allows nothing."""
    problem, points = load_file(EXAMPLES / "polar_descent.toml").problem, np.array([[0.0], [np.nan], [1e4]])
    found = point_feasibility(problem, ["vehicle_thrust"])(points)
    np.testing.assert_array_equal(found, judged(problem, ["vehicle_thrust"], points))
    assert not found[:2].any()


def test_comparisons_that_only_numpy_reads_are_made_point_by_point() -> None:
    """Nor is what CasADi makes of NumPy's functions taken for what they say."""

    def compare(p: Any, xp: Any) -> list[Finding]:
        held = np.float64(p.vehicle_thrust) if np.ndim(p.vehicle_thrust) == 0 else np.asarray(p.vehicle_thrust)
        limits = {"at_least": True, "unit": "N", "meaning": "too weak"}
        return [
            Finding(name="binding", value=np.maximum(held, 0.0), limit=400.0, binding=True, **limits),
            Finding(name="warning", value=held, limit=1e9, binding=False, **limits),
        ]

    problem = replace(load_file(EXAMPLES / "hybrid_lander.toml").problem, preflight=compare)
    points = np.array([[399.0], [401.0], [400.0]])
    assert point_feasibility(problem, ["vehicle_thrust"])(points).tolist() == [False, True, True]


def test_what_states_no_physics_is_allowed_everywhere() -> None:
    problem = replace(load_file(EXAMPLES / "hybrid_lander.toml").problem, preflight=None)
    assert point_feasibility(problem, ["vehicle_thrust"])(np.array([[-1.0], [1.0]])).all()


@pytest.mark.parametrize("name", ["hybrid_lander", "polar_descent", "precision_landing"])
def test_traced_bounds_are_those_that_are_stated(name: str) -> None:
    problem = load_file(EXAMPLES / f"{name}.toml").problem
    chart = Chart(problem, ("vehicle_thrust", "vehicle_mass"), np.array([100.0, 50.0]))
    stated = problem.given["vehicle_thrust"].value, problem.given["vehicle_mass"].value
    points = np.random.default_rng(3).uniform(0.8, 1.2, (20, 2)) * stated / chart.scale
    traced, plain = Borders(chart), Borders(chart)
    vars(plain)["_traced"] = None  # as where what is stated cannot be traced
    for found, told in zip(traced.at(points), plain.at(points), strict=True):
        np.testing.assert_allclose(found, told, rtol=1e-14)
        np.testing.assert_array_equal(traced.at(points[:0])[0], found[:0])


def test_bounds_that_only_numpy_states_are_made_point_by_point() -> None:
    """As those that refuse what makes no sense; of that nothing is told."""

    def ranges(p: Any, xp: Any) -> dict[str, tuple[float, float, float]]:
        if p.vehicle_thrust < 300.0:
            raise pl.PeriluneError("too weak")
        return {"flight_time": (0.0, float(np.interp(p.vehicle_thrust, [300.0, 500.0], [1e3, 3e3])), 1e3)}

    problem = replace(load_file(EXAMPLES / "hybrid_lander.toml").problem, parameter_bounds=ranges)
    chart = Chart(problem, ("vehicle_thrust",), np.array([100.0]))
    _, upper = Borders(chart).at(np.array([[200.0], [400.0]]) / chart.scale)
    at, size = chart.free.free_names.index("flight_time"), problem.scales.of("s")
    assert upper[:, at] * size == pytest.approx([problem.free[at].upper, 2e3])


@pytest.mark.parametrize(
    "value",
    [
        lambda x, xp: xp.sqrt(x - 400.0) ** 2,
        lambda x, m: (x - 400.0) / (x - 400.0),
        lambda x, xp: 0.0 * xp.log(x - 400.0),
        lambda x, xp: xp.fmax(xp.sqrt(x - 400.0), 0.0),
    ],
    ids=["square of a root", "0/0", "0 log", "greater"],
)
def test_what_symbols_make_simpler_allows_no_more_than_what_is_stated(value: Any) -> None:
    """Each is NaN at 399 or at 400, of which CasADi's own simplifications and functions make a number."""

    def compare(p: Any, xp: Any) -> list[Finding]:
        one = {"limit": -1.5, "at_least": True, "unit": "N", "binding": True, "meaning": "too weak"}
        return [Finding(name="shown", value=value(p.vehicle_thrust, xp), **one)]

    problem = replace(load_file(EXAMPLES / "hybrid_lander.toml").problem, preflight=compare)
    points = np.array([[399.0], [400.0], [401.0]])
    found = point_feasibility(problem, ["vehicle_thrust"])(points)
    np.testing.assert_array_equal(found, judged(problem, ["vehicle_thrust"], points))
    assert found[2] and not found.all()
