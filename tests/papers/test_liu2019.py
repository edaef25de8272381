"""The report on Liu, Liu, Wu 2019: what it computes, against truth from elsewhere, and that its verdicts can turn."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perilune import Genetic
from perilune.atlas.query import minimum_search as descending
from perilune.atlas.query.minimum_search import MinimumSearch
from perilune.atlas.query.query import open_atlas
from perilune.cli import run_command_line
from perilune.core import NUMERIC, NotConvergedError, Outcome, PeriluneError
from perilune.problem import Problem, Solution
from perilune.solve import solve
from perilune_papers.liu2019 import equations, fast as fast_method
from perilune_papers.liu2019.case import CASE, paper_costates, paper_state, paper_units, site_fixed, site_free
from perilune_papers.liu2019.compute import (
    PASSES,
    LiuReproduction,
    compare_off_plane,
    fly_printed,
    printed_refusal,
    propagate_extremals,
    sideways_reach,
    thrust_angles,
)
from perilune_papers.liu2019.csv_tables import table_2, table_3
from perilune_papers.liu2019.equations import compare, corrected_rates
from perilune_papers.liu2019.fast import AXES, time_fast_methods
from perilune_papers.liu2019.members import ManoeuvreMember, prediction_error, solve_members
from perilune_papers.liu2019.printed import TABLE_2, TABLES_1_AND_3
from perilune_papers.liu2019.report import liu_figures, liu_report
from perilune_papers.liu2019.searches import Searches, by_hybrid
from perilune_papers.liu2019.surfaces import _triangles_between, fit_table, surfaces
from perilune_papers.liu2019.times import time_section
from perilune_papers.liu2019.trajectories import trajectory_figures, trajectory_rows, trajectory_section
from perilune_papers.papers import reproduce_paper
from perilune_papers.starts import Starts, run_starts

FIRST, REACHED = 22, 3  # manoeuvre points of Table 2 that are solved here; the others stand as not solved
#: Manoeuvre points of the atlas [deg]: at the last the flight stays above the interface by itself.
MAPPED = (18.05, 40.35), (18.2, 40.45), (18.45, 40.55)


def _unsolved(points: Sequence[tuple[float, float]]) -> list[ManoeuvreMember]:
    return [
        ManoeuvreMember(
            longitude=longitude, latitude=latitude, solution=None, message="left out here", processor_time=0.0
        )
        for longitude, latitude in points
    ]


@pytest.fixture(scope="module")
def region(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the atlas is built over the manoeuvre points that are solved here."""
    return tmp_path_factory.mktemp("liu") / "region"


@pytest.fixture(scope="module")
def alone() -> list[float]:
    """Return the times of flight at the points of the atlas, from nothing, once `made` has solved there."""
    return []


@pytest.fixture(scope="module")
def made(region: Path, alone: list[float]) -> LiuReproduction:
    """Everything that the report is made of, at a few manoeuvre points and without proofs."""

    def solve_alone(problem: Problem, **options: Any) -> Solution:
        found = solve(problem, **options)
        alone.append(found.objective)
        return found

    fixed = solve(site_fixed(), verify=0)
    near = solve_members(
        fixed, [(row.longitude, row.latitude) for row in TABLE_2[FIRST : FIRST + REACHED]], lambda _: None
    )
    nowhere = _unsolved([(row.longitude, row.latitude) for row in (*TABLE_2, *TABLES_1_AND_3)])
    grid = (*nowhere[:FIRST], *near, *nowhere[FIRST + REACHED : len(TABLE_2)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fast_method, "solve", solve_alone)
        fast = time_fast_methods(fixed.problem, (), _unsolved(MAPPED), 1, region, lambda _: None)
    return LiuReproduction(
        equations=compare(),
        off_plane=compare_off_plane(fixed.results["entry_time"].value),
        refusals={going: printed_refusal(going) for going in PASSES},
        flown=(fly_printed(1.0), fly_printed(-1.0)),
        site_free={going: solve(site_free(going), verify=0) for going in PASSES},
        site_fixed=fixed,
        slowest=fixed,
        grid=grid,
        experiments=(*near, *nowhere[len(TABLE_2) + REACHED :]),
        searches=Searches(
            cold=0.5, ours=Starts(flight_times=(2631.7156256,), processor_times=(0.01,)),
            hybrid=Starts(flight_times=(2631.7156256, 3000.0, math.nan), processor_times=(1.0, 2.0, 9.0)),
            on_fixed=Starts(flight_times=(math.nan,), processor_times=(3.0,)),
        ),
        fast=fast,
    )  # fmt: skip


# -- the printed tables and equations -------------------------------------------------------------------------------


def test_tables_are_whole() -> None:
    """Forty grid points and a hundred experiments; ranges that the paper's text gives."""
    assert (len(TABLE_2), len(TABLES_1_AND_3)) == (40, 100)
    assert [e.number for e in TABLES_1_AND_3] == list(range(1, 101))
    assert (TABLE_2[0].longitude, TABLE_2[-1].longitude) == (13.0, 19.0)
    assert all(7.5 < row.speed < 8.8 and -9 < row.angle < -6 for row in TABLE_2)


def test_newton_judges_the_equations() -> None:
    """The corrected rows agree to rounding, the printed do not, and the slips are all of the difference."""
    found = compare(samples=50, seed=3)
    for printed, right in found.off.values():
        assert right < 1e-13 < 1e-3 < printed
    assert found.unexplained < 1e-14
    assert len(found.slips) == 5
    assert found.gravity["∂g_r/∂Φ"] == pytest.approx(-6 / 9, abs=1e-12)
    assert [name for name, ratio in found.gravity.items() if abs(ratio - 1) > 1e-12] == ["∂g_r/∂Φ"]


def test_rows_that_were_differentiated_rightly_are_known() -> None:
    """Those of V, gamma and m come from the printed (1); those of psi, r and Phi have slips of their own."""
    wrong = {c.row for c in compare().coefficients if c.own > 0}
    assert wrong == {"λ_ψ'", "λ_r'", "λ_Φ'"}


def test_a_slip_more_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """In (1) and in (6) alike."""
    plain = compare(samples=20)
    rates, matrix = equations.printed_rates, equations.printed_costate_matrix

    def spoilt(x: Any, alpha: Any, beta: Any) -> Any:
        found = rates(x, alpha, beta)
        return (*found[:3], 1.01 * found[3], *found[4:])

    monkeypatch.setattr(equations, "printed_rates", spoilt)
    assert compare(samples=20).unexplained > 1e-4 > plain.unexplained
    monkeypatch.setattr(equations, "printed_rates", rates)
    monkeypatch.setattr(equations, "printed_costate_matrix", lambda *args: 1.01 * matrix(*args))
    assert len(compare(samples=20).coefficients) > len(plain.coefficients)


# -- the printed example --------------------------------------------------------------------------------------------


def test_the_site_is_out_of_reach(made: LiuReproduction) -> None:
    """33 to 38 degrees on a descending pass, 70 to 77 on an ascending one, where thrust moves five."""
    away = {going: np.degrees(angle) for going, angle in made.off_plane.away.items()}
    assert 33 < away["descending"].min() and away["descending"].max() < 39
    assert 70 < away["ascending"].min() and away["ascending"].max() < 77
    assert 5.0 < np.degrees(made.off_plane.reach).min() < np.degrees(made.off_plane.reach).max() < 5.7
    assert all("out of the plane" in text for text in made.refusals.values())


def test_sideways_thrust_is_that_of_a_driven_oscillator() -> None:
    """For half a turn and little mass lost: z'' + n^2 z = a has z = 2 a/n^2 after it."""
    radius = CASE.orbit.radius or 0.0
    speed = math.sqrt(CASE.earth.gravitational_parameter / radius)
    half = math.pi * radius / speed
    burn = 1.0  # s: an impulse
    assert sideways_reach(burn, half / 2) == pytest.approx(0.2 / speed, rel=1e-3)
    assert sideways_reach(half, half) == pytest.approx(0.2 * 2 * (radius / speed) ** 2 / radius, rel=0.12)


def test_flown_costates_of_an_extremal_lead_to_its_end(made: LiuReproduction) -> None:
    """The same code that flies the printed costates, of neighbour A: to 120 km under -6 degrees, ending at 0."""
    solution, unit = made.site_free["descending"], paper_units()
    trajectory = solution.trajectories[0]
    x, costates = paper_state(trajectory.state(0.0)), paper_costates(solution, 0, 0.0)
    y = propagate_extremals(x[:, None], costates[:, None], np.array([trajectory.duration / unit.time]), -1.0)[:, 0]
    assert (y[3] - 1) * unit.length == pytest.approx(120e3, abs=10.0)
    assert math.degrees(y[1]) == pytest.approx(-6.0, abs=1e-3)
    assert y[[9, 11, 12, 13]] == pytest.approx(0.0, abs=1e-3)
    missed = [float(np.abs(f.altitude - 120).min()) for f in made.flown]
    assert min(missed) > 500.0


# -- neighbours -----------------------------------------------------------------------------------------------------


def test_neighbour_a_has_the_known_numbers(made: LiuReproduction) -> None:
    """Computed elsewhere by an indirect method of its own."""
    for going, time, mass in (("descending", 2631.72, 412.28), ("ascending", 2609.31, 413.02)):
        found = made.site_free[going].results
        assert found["transition_time"].value == pytest.approx(time, abs=0.02)
        assert found["mass_at_interface"].value == pytest.approx(mass, abs=0.01)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.9])
def test_hamiltonian_in_the_papers_units(made: LiuReproduction, share: float) -> None:
    """Costates carried into its coordinates, with the corrected (1): -1 along the flight, as (14) says."""
    for solution in (*made.site_free.values(), made.site_fixed):
        t = share * solution.trajectories[0].duration
        x, costates = paper_state(solution.trajectories[0].state(t)), paper_costates(solution, 0, t)
        x, costates = x[:, None], costates[:, None]
        rates = np.array(corrected_rates(x, *thrust_angles(x, costates, -1.0)))
        assert float((costates * rates).sum()) == pytest.approx(-1.0, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "step"),
    [("manoeuvre_longitude", 1e-4), ("manoeuvre_latitude", 1e-4), ("orbit_radius", 100.0), ("vehicle_mass", 0.05)],
)
def test_costates_at_ignition_are_what_the_time_changes_by(made: LiuReproduction, name: str, step: float) -> None:
    """Figs 7 to 12 are slopes of the time of flight over the state: solved again from states beside it."""
    solution, times, states = made.site_fixed, [], []
    for sign in (-1, 1):
        stated = solution.problem.with_given(**{name: solution.problem.given[name].value + sign * step})
        p = stated.parameters({})
        states.append(paper_state(np.array(stated.start(p, NUMERIC), dtype=float)))
        times.append(solve(stated, guess=solution, verify=0).objective / paper_units().time)
    expected = paper_costates(solution, 0, 0.0) @ (states[1] - states[0])
    assert times[1] - times[0] == pytest.approx(expected, rel=1e-4)


def test_members_stand_in_the_order_of_their_points(made: LiuReproduction) -> None:
    """Each with the flight from its own point."""
    for row, member in zip(TABLE_2[FIRST:][:REACHED], made.grid[FIRST:][:REACHED], strict=True):
        assert member.solution is not None
        given = member.solution.problem.given
        assert math.degrees(float(given["manoeuvre_longitude"].value)) == pytest.approx(row.longitude)
        assert math.degrees(float(given["manoeuvre_latitude"].value)) == pytest.approx(row.latitude)


def test_a_place_that_cannot_be_left_says_why(made: LiuReproduction) -> None:
    """The orbit never comes to 60 degrees north."""
    (member,) = solve_members(made.site_fixed, [(16.0, 60.0)], lambda _: None)
    assert member.solution is None
    assert "latitude" in member.message
    assert math.isnan(member.value("transition_time"))


def test_a_cubic_is_predicted_and_a_quartic_not() -> None:
    """Between the points of a grid, from the ten that are nearest."""

    def points(count: int, seed: int) -> list[ManoeuvreMember]:
        places = np.random.default_rng(seed).uniform((13, 38), (19, 41), (count, 2))
        return [
            ManoeuvreMember(longitude=u, latitude=v, solution=None, message="", processor_time=0.0)
            for u, v in places.tolist()
        ]

    def at(of: list[ManoeuvreMember], power: int) -> Any:
        u, v = (np.array([getattr(m, name) for m in of]) - centre for name, centre in PLACES)
        return 1 + u**power - u * v**2

    grid, between = points(200, 1), points(20, 2)
    missed = [prediction_error(grid, between, at(grid, n), at(between, n)).max() for n in (3, 4)]
    assert missed[0] < 1e-7
    assert missed[1] > 1e-5


PLACES = (("longitude", 16.0), ("latitude", 39.5))


# -- the paper's own method -----------------------------------------------------------------------------------------


def test_the_hybrid_method_finds_neighbour_a() -> None:
    """From random values the same flight as without any."""
    found = run_starts(lambda seed: by_hybrid(site_free("descending"), seed + 1), 2, lambda _: None)
    assert found.found(2631.7156256) == 2
    assert found.spread(2631.7156256) < 1e-8


def test_a_start_without_an_answer_counts() -> None:
    """As not found, with the time that it took."""

    def attempt(seed: int) -> float:
        if seed == 1:
            raise NotConvergedError("no")
        return 472.0 + seed

    found = run_starts(attempt, 4, lambda _: None)
    assert [math.isnan(t) for t in found.flight_times] == [False, True, False, False]
    assert (found.found(472.0), found.elsewhere(472.0), len(found.processor_times)) == (1, 2, 4)
    assert found.spread(472.0) == 0.0
    assert math.isnan(found.spread(471.0))


def test_how_often_the_method_found_it_is_told(made: LiuReproduction) -> None:
    row = next(line for line in liu_report(made).splitlines() if line.startswith("| A, hybrid"))
    assert row == "| A, hybrid | 1 of 3 | 1 | 0e+00 | 2.000 | 9.000 |"


def test_seeds_of_a_paper_without_a_search_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["reproduce", "cho-2015", "--out", str(tmp_path / "out"), "--seeds", "3"]) == 2
    assert "no setting of cho-2015 of this name" in capsys.readouterr().err
    with pytest.raises(PeriluneError, match="seed"):
        reproduce_paper("liu-2019", tmp_path / "out", seed=3)


# -- what is written ------------------------------------------------------------------------------------------------


def test_report_states_what_was_computed(made: LiuReproduction) -> None:
    """Every figure that the text shows is drawn; what was not solved is named."""
    text, drawn = liu_report(made), liu_figures(made)
    assert all(f"](figures/{name}.png)" in text for name in drawn)
    assert text.count("](figures/") == len(drawn)
    assert text.count("left out here") == len(TABLE_2) + len(TABLES_1_AND_3) - 2 * REACHED
    assert "2631.7" in text
    assert "rows 6 and 7" in text
    rows = list(csv.reader(io.StringIO(table_2(made))))
    assert len(rows) == 1 + len(TABLE_2)
    assert float(rows[1][-1]) == TABLE_2[0].time
    assert len(list(csv.reader(io.StringIO(table_3(made))))) == 1 + len(TABLES_1_AND_3)


def test_what_is_drawn_lies_between_points_that_are_near(made: LiuReproduction) -> None:
    """Along the edge of the region no triangle is a sliver from end to end, and none is lost inside."""
    spread = [replace(m, longitude=r.longitude, latitude=r.latitude) for r, m in zip(TABLE_2, made.grid, strict=True)]
    between = _triangles_between(np.array([(m.longitude, m.latitude) for m in spread]))
    left = between.get_masked_triangles()
    corners = np.stack([between.x[left], between.y[left]], axis=-1)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    assert len(left) < len(between.triangles) and set(left.ravel().tolist()) == set(range(len(TABLE_2)))
    assert sides.max() < 1.6


def test_flights_of_the_figures_point_by_point(made: LiuReproduction) -> None:
    """Of the experiments that were solved: from the orbit over the interface to 10 km above the site."""
    number = next(r.number for r, m in zip(TABLES_1_AND_3, made.experiments, strict=True) if m.solution is not None)
    assert not trajectory_figures(made).axes[0].lines and "Not solved: No. 5, No. 45, No. 85." in "".join(
        trajectory_section(made)
    )
    moved = list(made.experiments)
    moved[44] = moved[number - 1]
    spoilt = replace(made, experiments=tuple(moved))
    found = np.array(trajectory_rows(spoilt))
    assert set(found[:, 0]) == {45.0}
    altitude = found[:, 4]
    assert altitude[0] == pytest.approx(6678.14 - 6371.0) and altitude[-1] == pytest.approx(10.0, abs=1e-6)
    assert altitude[found[:, 1] < 4000].min() == pytest.approx(120.0, abs=0.05)
    assert found[-1, 2:4] == pytest.approx([-98.0, 38.0], abs=1e-6)
    assert (np.diff(found[:, 1]) >= 0).all() and (np.diff(found[:, 7]) <= 0).all()
    assert [len(ax.lines) for ax in trajectory_figures(spoilt).axes] == [1, 1, 1]


def test_fits_are_told_in_the_units_of_the_paper(made: LiuReproduction) -> None:
    """At points of the grid itself (16) misses nothing; a quantity that is off by a share of its size is told so."""
    text = fit_table(made.grid, [replace(m) for m in made.grid])
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()[2:]]
    assert [c[0] for c in cells] == ["λ_V", "λ_γ", "λ_ψ", "λ_r", "λ_Θ", "λ_m", "V_a", "γ_a", "t_a"]
    assert all(float(c[3]) < 1e-6 for c in cells)
    assert cells[8][1] == "5.0e-04 s"


def on_target(made: LiuReproduction) -> Any:
    """The printed costates as if they had led to the interface."""
    return tuple(replace(f, altitude=np.full_like(f.altitude, 120.0)) for f in made.flown)


def test_points_on_a_line_have_no_surface(made: LiuReproduction) -> None:
    """They are drawn as points; of nothing solved nothing is drawn."""
    one = made.grid[FIRST]
    line = [replace(m, longitude=16.0, latitude=39.0 + k) for k, m in enumerate((*made.grid[FIRST:][:REACHED], one))]
    assert [len(ax.collections) for ax in surfaces(line).axes[:6]] == [1] * 6
    assert not any(ax.collections or ax.texts for ax in surfaces(made.grid[:FIRST]).axes)


@pytest.mark.parametrize(
    ("spoil", "claim"),
    [
        (lambda xp: {"flown": on_target(xp)}, "printed costates lead"),
        (lambda m: {"off_plane": replace(m.off_plane, reach=np.full(len(TABLE_2), 1.0))}, "within reach"),
    ],
)
def test_verdicts_can_turn(made: LiuReproduction, spoil: Any, claim: str) -> None:
    """What is on the right side of its limit is a "yes" in its own row."""

    def row(of: LiuReproduction) -> str:
        return next(line for line in liu_report(of).splitlines() if line.startswith("|") and claim in line)

    assert row(made).endswith("**no** |")
    assert row(replace(made, **spoil(made))).endswith("| yes |")


def test_the_command_writes_it_all(
    made: LiuReproduction, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Report, data and figures; the exit code is that of the worst of the flights to be proved."""
    doubtful: Solution = replace(made.site_free["ascending"], outcome=Outcome.NOT_PROVED)
    flights = {**made.site_free, "ascending": doubtful}
    spoilt = replace(made, site_free=flights)
    monkeypatch.setattr("perilune_papers.liu2019.compute.compute_liu", lambda watch: spoilt)
    out = tmp_path / "report"
    assert run_command_line(["reproduce", "liu-2019", "--out", str(out)]) == Outcome.NOT_PROVED.exit_code
    assert "report.md" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"report.md", "table2.csv", "table3.csv", "fig16_18.csv", "figures"}
    assert len(list((out / "figures").glob("*.png"))) == len(liu_figures(made))


def test_the_fast_methods_answer_and_say_how_long_they_take(made: LiuReproduction) -> None:
    """Neighbour B touches the interface on its way, and falls: both are mapped, and flown again."""
    found = made.fast
    assert np.isfinite(found.queried[:REACHED]).all() and not found.refused
    assert any("touches" in kind for kind in found.kinds)
    assert found.apart < 1e-10
    assert found.queried[0] < 0.1 * found.alone[0]
    text = " ".join(time_section(made))
    assert "ours, from the atlas, re-integrated" in text and f"answers {REACHED} of {REACHED}" in text


def test_the_papers_fast_method_searches_beside_what_its_grid_predicts(
    made: LiuReproduction, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Within 2 % of the prediction it finds what is nearer to the extremal; Newton's method leads there from both."""
    places = [(row.longitude, row.latitude) for row in TABLE_2[FIRST : FIRST + 11]]
    (one,) = fast_method._predictions(
        solve_members(made.site_fixed, places, lambda _: None), _unsolved([(16.75, 39.9)])
    )
    monkeypatch.setattr(fast_method, "Genetic", partial(Genetic, population=8, generations=2))
    found = fast_method._by_search(one, one.guess)
    assert (np.abs(found - one.guess) <= 0.0201 * np.abs(one.guess) + 1e-9).all()
    assert one.missed(found[None])[0] < 0.5 * one.missed(one.guess[None])[0]
    direct, after = (one.near.roots(one.values, begin=begin[None]) for begin in (one.guess, found))
    assert direct.converged[0] and after.converged[0]
    assert after.y[0] == pytest.approx(direct.y[0], rel=1e-8, abs=1e-8)
    assert math.isfinite(fast_method._newton_time(one, fast_method._by_search))


@pytest.mark.usefixtures("made")
def test_an_answer_beside_what_breaks_the_path_is_not_followed(
    region: Path, alone: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plain flight would arrive sooner, through the interface; the flight that touches this lies a second away.

    Followed down it comes to the same, by extremals that errors of so sensitive a flight leave rough.
    """
    atlas, points = open_atlas(region), np.radians(MAPPED).tolist()
    assert len(atlas.charted) == 2 and len(alone) == len(MAPPED)

    def asked() -> list[float]:
        return [atlas.query(**dict(zip(AXES, point, strict=True))).objective for point in points]

    ways = list[int]()
    way = MinimumSearch._best_along_lines
    monkeypatch.setattr(MinimumSearch, "_best_along_lines", lambda *args: (ways.append(1), way(*args))[1])
    assert asked() == pytest.approx(alone, rel=1e-10)
    assert not ways
    monkeypatch.setattr(descending, "_BESIDE", -1.0)
    assert asked() == pytest.approx(alone, rel=1e-10)
    assert len(ways) >= 2
