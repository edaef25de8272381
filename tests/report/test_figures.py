"""Figures of what is not the paper's landing: sites below the datum, names of several words, flights of two phases."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perilune import Family, FamilyPoint
from perilune.core import Outcome
from perilune.io import Column
from perilune.io.save import trajectory_csv
from perilune.problem import Solution
from perilune.report.family import family_csv, family_document
from perilune.report.figures import label, save_figure, solution_figures
from perilune.report.time_histories import _costate_symbol
from perilune.scenario import load_file
from perilune.solve import solve

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def below() -> Solution:
    """A landing 5 km below the body's radius."""
    return solve(load_file(EXAMPLES / "ordinary_lander.toml", ["landing.altitude=-5 km"]).problem, verify=0)


@pytest.fixture(scope="module")
def descent() -> Solution:
    """The descent over the pole, whose angles are stated in degrees."""
    return solve(load_file(EXAMPLES / "polar_descent.toml").problem, verify=0)


def test_a_flight_that_is_not_proved_is_drawn_with_a_line_that_says_so(hybrid: Solution, ordinary: Solution) -> None:
    proved = replace(hybrid, outcome=Outcome.PROVED)
    said = [solution_figures(*flights)["altitude"].get_supxlabel() for flights in ((hybrid,), (proved, ordinary))]
    assert said == ["level 0: unverified", f"{label(ordinary)}: level 0: unverified"]
    assert not solution_figures(proved)["altitude"].get_supxlabel()
    both = solution_figures(ordinary, replace(ordinary, outcome=Outcome.PROVED))["altitude"]  # of one label
    assert both.get_supxlabel() == f"{label(ordinary)}: level 0: unverified"
    assert [text.get_text() for text in both.legends[0].get_texts()] == [
        label(ordinary),
        f"{label(ordinary)}, the other",
    ]


def test_a_site_below_the_datum_is_in_the_picture(below: Solution, ordinary: Solution, tmp_path: Path) -> None:
    axes = solution_figures(below)["altitude"].axes[0]
    assert axes.get_ylim()[0] == pytest.approx(-5.0, abs=1e-6)
    heights = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.lines])
    assert heights.min() >= axes.get_ylim()[0] and heights.max() <= axes.get_ylim()[1]
    assert solution_figures(ordinary)["altitude"].axes[0].get_ylim()[0] == pytest.approx(0.0, abs=1e-6)

    path = solution_figures(below)["path"]
    path.draw_without_rendering()
    (drawn,) = path.axes
    ground, flight = drawn.lines[0].get_xydata(), drawn.lines[1].get_xydata()
    assert isinstance(ground, np.ndarray) and isinstance(flight, np.ndarray)
    under = np.interp(flight[:, 0], ground[:, 0], ground[:, 1])
    assert (flight[:, 1] - under).min() > -1e-2  # km on the paper: it comes down to the ground, and not below
    assert abs(flight[-1, 1] - under[-1]) < 0.02 * np.ptp(flight[:, 1])
    save_figure(path, tmp_path, "path")


def test_a_switch_is_drawn_as_a_step() -> None:
    """Both its values at one time, and nothing between them; so is the costate that jumps where a slope is touched."""
    solution = solve(load_file(EXAMPLES / "mars_pinpoint.toml").problem, verify=0)
    figures = solution_figures(solution)
    throttle = next(axes for axes in figures["steering"].axes if axes.get_ylabel().startswith("throttle"))
    costate = next(axes for axes in figures["costates"].axes if "mathrm{east}" in axes.get_ylabel())
    for axes, values, jumps in ((throttle, (0.3, 0.8), 2), (costate, (0.0362, 0.0321), 1)):
        (line,) = [line for line in axes.lines if len(np.asarray(line.get_xdata())) > 600]
        time, shown = (np.asarray(part, dtype=float) for part in (line.get_xdata(), line.get_ydata()))
        assert np.abs(shown[:, None] - values).min(axis=1).max() < 1e-3
        there = np.flatnonzero(np.abs(np.diff(shown)) > 1e-3)
        assert len(there) == jumps and np.diff(time)[there].max() < 1e-12


@pytest.mark.parametrize(
    ("name", "drawn"),
    [
        ("lambda_v_east", r"$\lambda_{v,\mathrm{east}}$"),
        ("lambda_m", r"$\lambda_{m}$"),
        ("lambda_phi", r"$\lambda_{\phi}$"),
        ("lambda_vx", r"$\lambda_{\mathrm{vx}}$"),
    ],
)
def test_costates_of_several_words_are_words(name: str, drawn: str) -> None:
    assert _costate_symbol(Column(name=name, unit="1", values=np.zeros(1))) == drawn


def test_angles_leave_as_they_were_stated(descent: Solution) -> None:
    rows = list(csv.DictReader(io.StringIO(trajectory_csv(descent))))
    assert rows[0]["latitude [deg]"] == "90.0"
    digits = [re.sub(r"[-.]|e.*", "", row["thrust_elevation [deg]"]).lstrip("0") for row in rows]
    assert max(map(len, digits)) <= 15
    stated = [0.1, 30.0, 76.3, 110.0]
    assert np.degrees(30.0 * (np.pi / 180)) == 29.999999999999996  # as pi/180 is rounded
    points = tuple(
        FamilyPoint(values=(deg * (np.pi / 180),), solution=None, failure=Outcome.NOT_CONVERGED) for deg in stated
    )
    family = Family(problem=descent.problem, parameters=("site_latitude",), points=points)
    assert [point["value"] for point in family_document(family)["points"]] == stated
    assert [row.split(",")[0] for row in family_csv(family).splitlines()[1:]] == list(map(str, stated))


def test_a_title_is_no_formula_in_a_legend(descent: Solution) -> None:
    views = replace(descent.problem.views, label="")
    priced = replace(descent, problem=replace(descent.problem, views=views, title=r"for $\frac{$ a go"))
    drawn = solution_figures(priced, descent)
    (figure,) = {drawn[history.name] for history in views.histories[:1]}
    figure.draw_without_rendering()
    assert r"for \$\frac{\$ a go" in {text.get_text() for text in figure.legends[0].get_texts()}


def test_every_phase_is_in_the_figures_of_a_problem_that_says_nothing_of_them(descent: Solution) -> None:
    problem = replace(descent.problem, views=replace(descent.problem.views, histories=()))
    drawn = solution_figures(replace(descent, problem=problem))
    assert {"states", "controls"} <= drawn.keys()
    assert len(drawn["states"].axes) == len(problem.phases[0].states)
