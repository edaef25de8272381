"""Figures of a return: the map without a line across it, the entry corridor against a formula, phases marked."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.core import PeriluneError
from perilune.models.deorbit.outputs import return_views
from perilune.problem import Solution
from perilune.report.figures import solution_figures
from perilune.report.ground import coastline, track_on_map
from perilune.report.hamiltonian_figure import optimality_figure
from perilune.scenario import load_file, load_text
from perilune.scenario.reference import template
from perilune.solve import solve

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def flown() -> Solution:
    """The return of the example, with a nose."""
    changes = ["vehicle.nose_radius=0.3 m"]
    return solve(load_file(EXAMPLES / "minimum_duration_return.toml", changes).problem, verify=0)


@pytest.fixture(scope="module")
def drawn(flown: Solution) -> dict[str, Any]:
    return solution_figures(flown)


def test_every_figure_of_a_return_is_there(drawn: dict[str, Any]) -> None:
    assert set(drawn) == {
        "altitude", "speed_and_angle", "air", "mass", "steering", "ground_track", "corridor", "path", "costates",
        "hamiltonian",
    }  # fmt: skip


def test_the_condition_of_a_fall_that_counts_for_nothing_is_drawn() -> None:
    """Least propellant to any place: all costates of the entry are 0, and H with them, which is no error of it."""
    solution = solve(load_text(template("deorbit_entry")), verify=0)
    lines = optimality_figure(solution).axes[0].lines
    assert np.all([np.isfinite(line.get_ydata()).all() for line in lines])


# -- the map --------------------------------------------------------------------------------------------------------


def test_coasts_lie_on_the_map_and_do_not_cross_it() -> None:
    """Known places are near a coast, and a place far inland is not; the file is small."""
    lines = coastline()
    points = np.concatenate(lines)
    assert np.abs(points[:, 0]).max() <= 180 and np.abs(points[:, 1]).max() <= 90
    assert max(float(np.abs(np.diff(line[:, 0])).max()) for line in lines) < 15
    # Lisbon, the Cape, Land's End, the tip of Florida; Kazan is far from any sea.
    for place in ((-9.4, 38.7), (18.4, -34.2), (-5.7, 50.1), (-80.6, 25.2)):
        assert np.hypot(*(points - place).T).min() < 1.0
    assert np.hypot(*(points - (49.1, 55.8)).T).min() > 5.0
    file = Path(pl.__file__).parent / "report" / "coastline.csv"
    assert file.stat().st_size < 60_000
    assert "public domain" in file.read_text(encoding="utf-8").splitlines()[2]


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_track_leaves_the_map_at_one_edge_and_comes_in_at_the_other(way: float) -> None:
    """Twice round in either sense: at the seam there is a gap, and the latitude on both sides is one."""
    east = way * np.linspace(100.0, 890.0, 91)
    wrapped = (east + 180) % 360 - 180
    x, y = track_on_map(wrapped, 0.05 * east)
    assert np.nanmax(np.abs(x)) <= 180.0
    steps = np.abs(np.diff(x))
    assert np.nanmax(steps) < 20.0
    gaps = np.flatnonzero(np.isnan(x))
    assert len(gaps) == 2
    for gap in gaps:
        assert (x[gap - 1], x[gap + 1]) == (180.0 * way, -180.0 * way)
        assert y[gap - 1] == y[gap + 1]
    assert [float(y[gap - 1]) for gap in gaps] == pytest.approx([way * 0.05 * seam for seam in (180, 540)])


def test_the_track_goes_to_its_site(drawn: dict[str, Any]) -> None:
    """From the manoeuvre over the seam to the place; coasts are drawn as the body is the Earth."""
    ax = drawn["ground_track"].axes[0]
    assert len(ax.lines) > len(coastline())
    end = ax.lines[-1]
    assert (float(end.get_xdata()[0]), float(end.get_ydata()[0])) == pytest.approx((-98.0, 38.0), abs=1e-5)
    for line in ax.lines:
        assert not (np.abs(np.diff(np.asarray(line.get_xdata(), dtype=float))) > 100).any()


def test_another_body_has_no_coasts(flown: Solution) -> None:
    shown = replace(flown.problem.views, ground=replace(flown.problem.views.ground, coasts=False))  # type: ignore[type-var]
    problem = replace(flown.problem, views=shown)
    ax = solution_figures(replace(flown, problem=problem))["ground_track"].axes[0]
    assert len(ax.lines) < 10


# -- the corridor ---------------------------------------------------------------------------------------------------


def test_lines_of_the_corridor_are_those_of_the_formulas(drawn: dict[str, Any], flown: Solution) -> None:
    """Load and heat rate of exponential air at the points of each line, by hand."""
    ax, p = drawn["corridor"].axes[0], flown.parameters
    mass = flown.results["mass_at_interface"].value

    def by_hand(name: str, speed: Any, height: Any) -> Any:
        density = 1.225 * np.exp(-height / 7200.0)
        if name == "load":
            return 0.5 * density * speed**2 * 0.6 / mass / 9.80665
        return 1.7415e-4 * np.sqrt(density / 0.3) * speed**3 / 1e3

    seen = 0
    for name, lines in zip(("load", "heat_rate"), ax.collections, strict=True):
        for level, path in zip(lines.levels, lines.get_paths(), strict=True):
            if not len(path.vertices):
                continue
            seen += 1
            speed, height = 1e3 * path.vertices.T
            # Straight between the points of the grid, which are 100 m/s and 1.5 km apart.
            assert np.median(np.abs(by_hand(name, speed, height) / level - 1)) < 0.02
    assert seen == 10
    assert p.vehicle_nose_radius == 0.3


def test_names_in_views_are_checked(flown: Solution) -> None:
    """A map or a corridor of what no phase has is refused."""
    stated = flown.problem.views
    assert stated.ground is not None and stated.corridor is not None
    for spoilt in (
        replace(stated, ground=replace(stated.ground, longitude="lon")),
        replace(stated, corridor=replace(stated.corridor, equal=("weight",))),
    ):
        with pytest.raises(PeriluneError, match=r"lon|weight"):
            replace(flown.problem, views=spoilt)
    assert return_views(air=None, heat=False, coasts=True, given=()).corridor is None


# -- against time ---------------------------------------------------------------------------------------------------


def test_phases_are_marked(drawn: dict[str, Any], flown: Solution) -> None:
    """A dotted line at the interface; what the air does is shown from there on."""
    at = flown.results["transition_time"].value
    ax = drawn["altitude"].axes[0]
    marks = [float(line.get_xdata()[0]) for line in ax.lines if line.get_linestyle() == ":"]
    assert marks == pytest.approx([at])
    assert {text.get_text() for text in ax.texts} == {"burn", "entry"}
    air = drawn["air"].axes
    assert len(air) == 3
    assert air[0].get_xlim()[0] == pytest.approx(at)
    assert {text.get_text() for text in air[0].texts} == {"entry"}
    assert math.isclose(max(air[1].lines[0].get_ydata()), flown.results["peak_load"].value, rel_tol=1e-3)


def test_a_whole_turn_is_seen_round_the_body(drawn: dict[str, Any]) -> None:
    """Without bars of scale that only a limb has room for."""
    ax = drawn["path"].axes[0]
    texts = {text.get_text() for text in ax.texts}
    assert not any("km" in text for text in texts)
    assert any(text.startswith("height") for text in texts)
