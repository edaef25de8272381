"""Maps of families along two parameters, and panels that do not blow up what is small."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex

from cho import cho_landing
from command_line import ROOT
from perilune import Family, FamilyPoint, sweep
from perilune.cli import run_command_line
from perilune.core import Outcome, PeriluneError
from perilune.problem import Solution
from perilune.report import contour_map as contours
from perilune.report.contour_map import OVER_WEIGHT, family_map, map_names, require_map
from perilune.report.family import write_family
from perilune.report.figures import solution_drawings
from perilune.scenario import load_file
from perilune.solve import solve

THRUSTS, MASSES = [420.0, 460.0, 500.0], [290.0, 300.0, 310.0, 320.0]


@pytest.fixture(scope="module")
def family() -> Family:
    return sweep(cho_landing().with_given(retro_delta_v=0.0), {"vehicle.thrust": THRUSTS, "vehicle.mass": MASSES})


def without(family: Family, *numbers: int, failure: Outcome = Outcome.INFEASIBLE) -> Family:
    """The family as if some members could not be flown."""
    points = [
        FamilyPoint(values=p.values, solution=None, message="no", failure=failure) if i in numbers else p
        for i, p in enumerate(family.points)
    ]
    return replace(family, points=tuple(points))


def coloured(figure: Any) -> np.ndarray:
    """Corners of all that has a colour."""
    filled = figure.axes[0].collections
    paths = [path for c in filled if type(c).__name__ == "TriContourSet" and c.filled for path in c.get_paths()]
    return np.concatenate([path.vertices for path in paths if len(path.vertices)])


def test_a_map_has_contours_with_their_values(family: Family) -> None:
    figure = family_map(family)
    axes, bar = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("vehicle thrust (N)", "vehicle mass (kg)")
    assert bar.get_ylabel() == "landed mass (kg)"
    labels = [text for text in axes.texts if text.get_text()]
    assert len(labels) >= 3
    solved = np.array([p.solution.results["landed_mass"].value if p.solution else np.nan for p in family.points])
    mass = np.array([p.values[1] for p in family.points])
    for text in labels:  # at its height the mass landed is what it says, within a step of the grid
        near = np.interp(text.get_position()[1], mass[:4], solved[4:8])
        assert float(text.get_text()) == pytest.approx(near, abs=3.0)


def test_no_label_is_cut_at_the_edge(family: Family) -> None:
    """At a line that crosses a corner of the map alone the middle of its value lies on the edge."""
    figure = family_map(family, z="flight_time")
    axes = figure.axes[0]
    low, high = np.asarray(axes.get_window_extent().min), np.asarray(axes.get_window_extent().max)
    for text in (text for text in axes.texts if text.get_text()):
        box = text.get_window_extent()
        assert np.all(box.min > low - 0.5) and np.all(box.max < high + 0.5), text.get_text()
    corner = axes.texts[0]
    corner.set_position((THRUSTS[0], MASSES[-1]))
    contours.move_labels_inside(figure, axes)
    box = corner.get_window_extent()
    assert np.all(box.min > low - 0.5) and np.all(box.max < high + 0.5)


def test_what_cannot_be_flown_is_hatched_and_has_no_colour(family: Family) -> None:
    gone = without(family, 0, 1)  # 420 N with 290 and 300 kg
    figure = family_map(gone)
    (axes, _) = figure.axes
    hatched = [c for c in axes.collections if c.get_hatch()]
    assert len(hatched) == 1 and to_hex(tuple(np.asarray(hatched[0].get_facecolor())[0])) == "#f4f4f4"
    assert not np.any((coloured(figure)[:, 0] < 459.9) & (coloured(figure)[:, 1] < 299.9))
    assert axes.get_title("left") == "lines, crosses: infeasible"
    crosses = [line for line in axes.lines if line.get_marker() == "x"]
    assert np.asarray(crosses[0].get_xydata()).tolist() == [[420.0, 290.0], [420.0, 300.0]]
    assert not [c for c in family_map(family).axes[0].collections if c.get_hatch()]


def test_what_was_not_solved_is_told_from_what_is_infeasible(family: Family, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = without(without(family, 0), 11, failure=Outcome.NOT_CONVERGED)
    (axes, _) = family_map(gone).axes
    assert [c.get_hatch() for c in axes.collections if c.get_hatch()] == ["////", "...."]
    assert axes.get_title("left") == "lines, crosses: infeasible; dots, plus signs: not solved"
    marks = {line.get_marker(): np.asarray(line.get_xydata()).tolist() for line in axes.lines}
    assert (marks["x"], marks["+"]) == ([[420.0, 290.0]], [[500.0, 320.0]]) and len(marks["."]) == 10
    monkeypatch.setattr(contours, "_MOST_DOTS", 11)
    (axes, _) = family_map(gone).axes
    assert axes.get_title("left") == "lines: infeasible; dots: not solved"
    assert not any(np.asarray(line.get_xydata()).size for line in axes.lines)


def test_axes_may_be_results_and_thrust_over_weight(family: Family) -> None:
    figure = family_map(family, x="thrust_over_weight", y="vehicle.mass", z="propellant")
    dots = np.asarray(next(line for line in figure.axes[0].lines if line.get_marker() == ".").get_xydata(), dtype=float)
    given = {name: value.value for name, value in family.problem.given.items()}
    pull = given["body_gravitational_parameter"] / given["body_radius"] ** 2
    known = [p.values[0] / (p.values[1] * pull) for p in family.points]
    np.testing.assert_allclose(dots[:, 0], known, rtol=1e-12)
    assert figure.axes[0].get_xlabel() == "thrust over weight" and figure.axes[1].get_ylabel() == "propellant (kg)"
    by_result = family_map(without(family, 3), x="propellant", z="landed_mass").axes[0]
    assert "1 without a solution are not shown here" in by_result.get_title("left")


def test_members_on_a_curve_are_no_contours(family: Family) -> None:
    """Both axes are one quantity: no triangle has an area."""
    axes = family_map(family, x="vehicle.mass", y="vehicle.mass").axes[0]
    assert not [c for c in axes.collections if type(c).__name__ == "TriContourSet"]
    assert "only the members" in axes.get_title("left")


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda f: family_map(f, z="nothing"), ("no quantity of a family of this name", "landed_mass")),
        (lambda f: family_map(replace(f, points=f.points[:-1])), ("along two parameters", "11 members")),
        (lambda f: family_map(without(f, *range(12)), z="propellant"), ("no quantity of a family",)),
        (lambda f: family_map(without(f, *range(11))), ("nothing to draw of", "three neighbouring members")),
        (lambda f: require_map(f.problem, ("vehicle_thrust",), {"x": "m"}), ("two parameters", "leave out x")),
        (lambda f: require_map(f.problem, f.parameters, {"z": "speed"}), ("no quantity", "thrust_over_weight")),
    ],
)  # fmt: skip
def test_a_map_that_cannot_be_drawn_is_refused(
    family: Family, ask: Callable[[Family], Any], words: tuple[str, ...]
) -> None:
    with pytest.raises(PeriluneError) as refused:
        ask(family)
    assert all(word in str(refused.value) for word in words), str(refused.value)


def test_names_that_are_known_beforehand_are_those_of_the_members(family: Family) -> None:
    solution = family.points[0].solution
    assert solution is not None
    assert {*solution.results, *solution.free, OVER_WEIGHT, *family.parameters} <= set(
        map_names(family.problem, family.parameters)
    )


def test_the_command_draws_what_is_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ask = ["sweep", str(ROOT / "examples" / "ordinary_lander.toml"), "--level", "0", "--vary",
           "vehicle.thrust=440:500:60 N", "--vary", "vehicle.mass=290:300:10 kg"]  # fmt: skip
    assert run_command_line([*ask, "--x", OVER_WEIGHT]) == 2 and "--out DIR" in capsys.readouterr().err
    assert run_command_line([*ask, "--z", "speed", "--out", str(tmp_path / "a")]) == 2 and not (tmp_path / "a").exists()
    assert "landed_mass" in capsys.readouterr().err
    assert run_command_line([*ask[:-2], "--y", "propellant", "--out", str(tmp_path / "a")]) == 2
    assert "two parameters" in capsys.readouterr().err
    assert run_command_line([*ask, "--x", OVER_WEIGHT, "--z", "propellant", "--out", str(tmp_path / "a")]) == 0
    text = (tmp_path / "a" / "family.svg").read_text(encoding="utf-8")
    assert "<svg" in text and (tmp_path / "a" / "family.png").stat().st_size > 5000


def test_a_family_without_a_map_has_its_tables(family: Family, tmp_path: Path) -> None:
    """An interrupted grid, and one with no three neighbours."""
    for number, few in enumerate(
        (replace(family, points=family.points[:5], interrupted=True), without(family, *range(11)))
    ):
        write_family(few, tmp_path / str(number))
        assert sorted(path.name for path in (tmp_path / str(number)).iterdir()) == ["family.csv", "family.json"]


@pytest.fixture(scope="module")
def level_flight() -> Solution:
    """Its start is 2 mm beside the plane of the site."""
    return solve(load_file(ROOT / "examples" / "mars_pinpoint.toml", ["approach.north=2 mm"]).problem, verify=0)


def test_two_millimetres_are_not_blown_up(level_flight: Solution) -> None:
    """Beside a way of 3.2 km the panel spans 3.2 m, and a thousandth of the largest change of speed."""
    drawn = solution_drawings(level_flight)
    _, top = drawn["track"]().axes
    assert "cross-range" in top.get_ylabel() and np.ptp(top.get_ylim()) == pytest.approx(3.22e-3, rel=0.01)
    east, north, up = drawn["velocities"]().axes
    spans = [np.ptp(np.concatenate([np.asarray(line.get_ydata()) for line in ax.lines])) for ax in (east, north, up)]
    assert spans[1] < 1e-3 and np.ptp(north.get_ylim()) == pytest.approx(1e-3 * max(spans), rel=1e-6)
    assert np.ptp(up.get_ylim()) == pytest.approx(1.1 * spans[2], rel=1e-6)  # the others as before
