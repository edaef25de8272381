"""Atlases: interpolation, exact sensitivities, second flights, building, answers, refusals, what a kill leaves."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import math
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy as copied
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import perilune as pl
from cho import cho_landing
from command_line import ENVIRONMENT, HYBRID, ROOT, read_json, snapshot
from perilune.atlas.building import build as building
from perilune.atlas.building.verify import verify_atlas
from perilune.atlas.hermite import binary_digits, corner_terms, interpolated
from perilune.atlas.query.batch_answers import Answered
from perilune.atlas.query.query import Atlas, open_atlas
from perilune.atlas.query.reader import LoadedBrick
from perilune.atlas.region import region_of
from perilune.atlas.store.cells import WHOLE, Status
from perilune.atlas.store.checksums import with_checksum
from perilune.atlas.store.manifest import written_line
from perilune.atlas.store.schema import cell_type, node_type
from perilune.atlas.store.store import HEADER, MANIFEST, AtlasStore
from perilune.atlas.survey.neighbour_seeds import Key, seeds_for_neighbours
from perilune.charts import polish
from perilune.charts.chart import Chart, Holds
from perilune.charts.extrapolated_midpoint import extrapolated_step
from perilune.charts.reintegrate import ChartReintegration
from perilune.charts.sheet import Sheet
from perilune.cli import run_command_line
from perilune.core import InfeasibleError, NotConvergedError, Outcome, PeriluneError
from perilune.io.presolve_json import comparisons_document, read_comparisons, same_comparisons
from perilune.kernels import compile_map
from perilune.problem import Finding, Nature, Problem
from perilune.scenario import load_file
from perilune.solve import solve
from problems.constrained import bryson_denham, bryson_denham_truth

build = partial(building.build, sample=0)  # proofs have tests of their own
#: Across the Isp of 277.867 s at which the retro burn stops paying, Cho et al. 2015, Figs 9 and 10.
AXES = {"vehicle.thrust": (430.0, 450.0), "retro.specific_impulse": (270.0, 310.0)}
JUMP = 277.867
RNG = np.random.default_rng


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of an atlas of two axes."""
    return build(cho_landing(), AXES, tmp_path_factory.mktemp("atlas") / "hybrid")


@pytest.fixture
def atlas(built: Path) -> Atlas:
    return open_atlas(built)


@pytest.fixture
def copy(built: Path, tmp_path: Path) -> Path:
    """The same, to be damaged."""
    return Path(shutil.copytree(built, tmp_path / "copy"))


# -- interpolation ----------------------------------------------------------------------------------------------------


@given(d=st.integers(1, 4), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_products_of_cubics_are_met_exactly(d: int, seed: int) -> None:
    rng = RNG(seed)
    coefficients, size = rng.normal(size=(d, 4)), rng.uniform(0.1, 3.0, d)
    low = rng.normal(size=d)

    def value(x: np.ndarray, term: int = 0) -> float:
        parts = [np.polynomial.Polynomial(c) for c in coefficients]
        return float(np.prod([p.deriv()(v) if term >> i & 1 else p(v) for i, (p, v) in enumerate(zip(parts, x))]))  # noqa: B905

    terms = np.array([[value(low + corner * size, b) for b in range(2**d)] for corner in binary_digits(d)])
    at = rng.uniform(size=d)
    found = interpolated(terms[None, :, :, None], at[None], size[None])[0, 0]
    assert found == pytest.approx(value(low + at * size), rel=1e-9, abs=1e-9 * np.abs(terms).max())


def test_a_march_is_its_step_many_times_in_machine_code_and_without() -> None:
    z, a = ca.SX.sym("z", 2), ca.SX.sym("a")
    step = ca.Function("step", [z, a], [ca.vertcat(z[0] + a * z[1], z[1] - a * ca.sin(z[0]))])
    start, lengths = np.array([[0.3, 0.1], [1.0, 0.0], [-2.0, 0.5]]), np.array([[0.1], [0.05], [0.2]])
    wanted = start.copy()
    for _ in range(7):
        wanted = np.array([np.array(step(row, h)).ravel() for row, h in zip(wanted, lengths, strict=True)])
    for backend in ("native", "scipy"):
        np.testing.assert_allclose(compile_map(step, times=7, backend=backend)(start, lengths)[0], wanted, rtol=1e-13)


# -- extremals as functions of parameters -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def chart() -> Chart:
    return Chart(
        cho_landing(),
        ("vehicle_thrust", "retro_specific_impulse", "orbit_perilune_altitude"),
        np.array([300.0, 40.0, 15e3]),
    )


def test_sensitivities_are_exact(chart: Chart) -> None:
    """dy/dp and dJ/dp by columns of the inverse against differences of extremals, and mixed ones of fourth order."""
    problem = cho_landing()
    best = solve(problem, verify=0)
    values = np.array([[problem.given[name].value for name in chart.names]]) / chart.scale
    y = chart.from_problem_unknowns(np.array(best.extremals[0].unknowns))[None]
    nothing = Holds(np.zeros(2 * chart.shooting.plan.held))
    here = chart.solve(values, y, nothing)
    assert here.converged[0] and here.cost[0] * problem.objective_size == pytest.approx(best.objective, rel=1e-12)
    terms = corner_terms(chart, here, lambda _: nothing)[0]
    for i in range(3):
        step = 1e-4 * chart.widths[i] * np.eye(3)[i]
        ahead, behind = (chart.solve(values + way * step, here.y, nothing) for way in (1, -1))
        slope = (ahead.y - behind.y)[0] / (2 * step[i])
        np.testing.assert_allclose(terms[1 << i, :-1], slope, atol=1e-6 * np.abs(slope).max())
        assert terms[1 << i, -1] == pytest.approx((ahead.cost - behind.cost)[0] / (2 * step[i]), rel=1e-6)
        for k in range(3):
            if k != i:
                mixed = (ahead.slopes - behind.slopes)[0, k] / (2 * step[i])
                np.testing.assert_allclose(terms[1 << i | 1 << k, :-1], mixed, atol=1e-3 * np.abs(mixed).max() + 1e-6)


def test_a_parameter_far_from_its_canonical_unit_is_told_by_its_share_of_a_size() -> None:
    problem = cho_landing()
    best, names = solve(problem, verify=0), ("body_gravitational_parameter", "vehicle_thrust")
    slopes = []
    for width in (1e-7 * problem.given[names[0]].value, problem.given[names[0]].value):
        chart = Chart(problem, names, np.array([width, 300.0]))
        values = np.array([[problem.given[name].value for name in names]]) / chart.scale
        y = chart.from_problem_unknowns(np.array(best.extremals[0].unknowns))[None]
        here = chart.solve(values, y, Holds(np.zeros(2 * chart.shooting.plan.held)))
        assert here.converged[0]
        slopes.append(here.cost_slopes[0] / chart.scale)
    assert chart.scale[0] != pytest.approx(width)  # a range of about 1 needs none
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-9)


def test_a_second_flight_ends_where_the_first_does_and_sees_what_is_wrong(chart: Chart) -> None:
    problem = cho_landing()
    best = solve(problem, verify=0)
    values = np.array([[problem.given[name].value for name in chart.names]]) / chart.scale
    nothing = Holds(np.zeros(2 * chart.shooting.plan.held))
    here = chart.solve(values, chart.from_problem_unknowns(np.array(best.extremals[0].unknowns))[None], nothing)
    again = ChartReintegration(chart)
    good = again(here.roots.y, chart.p[None], here.roots.choice)
    assert good.margins.good[0] and good.margins.residual[0] < 1e-11 and good.margins.drift[0] < 1e-12
    assert good.margins.cost[0] == pytest.approx(here.cost[0], rel=1e-11)
    for place in chart.active:  # every unknown matters
        wrong = here.roots.y.copy()
        wrong[0, place] += 1e-6 * (1 + abs(wrong[0, place]))
        assert not again(wrong, chart.p[None], here.roots.choice).margins.good[0]


def precision(**more: float) -> Problem:
    """The landing of examples/precision_landing.toml."""
    return load_file(ROOT / "examples" / "precision_landing.toml").problem.with_given(**more)


def test_a_second_flight_goes_over_switches_and_sees_a_broken_path() -> None:
    problem = precision()
    best = solve(problem, verify=0)
    names = ("approach_east", "corridor_slope")
    chart = Chart(problem, names, np.array([100.0, 0.1]))
    values = np.array([[problem.given[name].value for name in names]]) / chart.scale
    nothing = Holds(np.zeros(2 * chart.shooting.plan.held))
    again = ChartReintegration(chart)
    for slope, kept in ((problem.given["corridor_slope"].value, True), (np.radians(30.0), False)):
        values[0, 1] = slope
        here = chart.solve(values, chart.from_problem_unknowns(np.array(best.extremals[0].unknowns))[None], nothing)
        flown = again(here.roots.y, chart.p[None], here.roots.choice)
        assert flown.margins.residual[0] < 1e-10 and flown.margins.minimum[0] > -1e-9
        assert [modes for _, _, modes in flown.arcs] == [(1, 0, 1)]  # full, least, full thrust
        assert bool(flown.margins.path[0] >= -1e-9) is kept


# -- answers ----------------------------------------------------------------------------------------------------------


def test_answers_are_those_of_a_solve_from_nothing(atlas: Atlas) -> None:
    for thrust, isp in RNG(1).uniform([430.0, 270.0], [450.0, 310.0], (25, 2)):
        found = atlas.query(vehicle_thrust=thrust, retro_specific_impulse=isp)
        alone = solve(cho_landing().with_given(vehicle_thrust=thrust, retro_specific_impulse=isp), verify=0)
        assert found.objective == pytest.approx(alone.objective, rel=1e-10)
        for name, value in alone.free.items():
            assert found.free[name] == pytest.approx(value, rel=1e-9, abs=1e-9)
        assert found.query.error_bound < 1e-9 and found.query.residual < 1e-9
        assert found.results["landed_mass"].value == pytest.approx(-alone.objective, rel=1e-10)


def test_one_lane_is_polished_as_it_is_among_many_and_stays_as_it_was_found(atlas: Atlas) -> None:
    """Arrays of one lane are used again; a lane that Newton's method leads nowhere is told so in both."""
    charted, points = atlas.charted[0], RNG(2).uniform([430.0, 270.0], [450.0, 310.0], (12, 2))
    guess, which = atlas.begins(points)[0][:, 2:] * RNG(3).choice([1.0, 1.2], (12, 1)), np.zeros(12, dtype=np.int64)
    values = points / charted.chart.scale
    together = charted.polish(values, which, guess)
    alone = [charted.polish(values[i : i + 1], which[:1], guess[i : i + 1]) for i in range(12)]
    assert 0 < together.reached.sum() < 12
    for name in ("y", "choice", "course", "verdicts", "passed", "slopes", "reached"):
        np.testing.assert_array_equal(
            np.vstack([getattr(one, name) for one in alone]).squeeze(), np.vstack(getattr(together, name)).squeeze()
        )
    np.testing.assert_array_equal(np.vstack([one.reintegrated.shown for one in alone]), together.reintegrated.shown)


def test_where_newton_stops_near_an_extremal_it_goes_on_from_there(
    atlas: Atlas, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From 3 % away its steps shrink too slowly in 5 of 8 lanes: such points were refused."""
    charted, points = atlas.charted[0], RNG(2).uniform([430.0, 270.0], [450.0, 310.0], (12, 2))
    guess, which, values = atlas.begins(points)[0][:, 2:], np.zeros(12, dtype=np.int64), points / charted.chart.scale
    near, far = (charted.polish(values, which, guess * by) for by in (1.0, 1.03))
    monkeypatch.setattr(polish, "_AGAIN", 0)
    assert charted.polish(values, which, guess * 1.03).reached.sum() < far.reached.sum() == 8
    np.testing.assert_array_equal(far.reached, near.reached)
    np.testing.assert_allclose(far.y[far.reached], near.y[near.reached], rtol=1e-9, atol=1e-9)
    assert (
        far.steps[far.reached].sum() > near.steps[near.reached].sum()
        and (far.relative_error[far.reached] > 0.005).all()
    )


def test_the_answer_jumps_where_the_retro_burn_stops_paying(atlas: Atlas) -> None:
    below, above = (atlas.query(vehicle_thrust=440.0, retro_specific_impulse=JUMP + by) for by in (-0.01, 0.01))
    assert below.free["retro_delta_v"] == 0.0 and above.free["retro_delta_v"] == pytest.approx(1086.0, abs=2.0)
    assert len(below.extremals) == len(above.extremals) == 2  # both were polished, as they cost nearly the same
    assert below.objective == pytest.approx(above.objective, abs=0.01)


def test_a_query_is_a_solution_that_proves(atlas: Atlas) -> None:
    found = pl.verify(atlas.query(vehicle_thrust=440.0, retro_specific_impulse=300.0))
    assert found.outcome is Outcome.PROVED and found.verification.level == 3


def test_what_nobody_looks_at_of_an_answer_is_not_made(atlas: Atlas) -> None:
    answer, again = (atlas.query(vehicle_thrust=441.0, retro_specific_impulse=290.0) for _ in range(2))
    assert answer.free["flight_time"] > 0 and "unknowns" not in vars(again)
    assert pickle.loads(pickle.dumps(again)) == replace(answer, query=again.query)


@pytest.mark.parametrize("wrong", [3, (0,), "ab", ([], 0), None])
def test_what_is_no_place_or_point_is_refused_of_every_question(atlas: Atlas, wrong: Any) -> None:
    for ask in (atlas.damage, atlas.missing):
        with pytest.raises(PeriluneError, match=r"not the position of a brick(.|\n)*along each of: vehicle_thrust"):
            ask(wrong)
    with pytest.raises(PeriluneError, match="not points of the region"):
        atlas.begins(wrong)


@pytest.mark.parametrize("place", [(0, 3), (0, (0,)), ("a", (0, 0)), (0, ([], 0))])
def test_what_is_no_place_of_a_brick_is_refused(atlas: Atlas, place: Any) -> None:
    with pytest.raises(PeriluneError, match=r"not the position of a brick(.|\n)*along each of: vehicle_thrust"):
        atlas.brick(*place)


def test_slopes_of_the_cost_are_those_of_solves(atlas: Atlas) -> None:
    at = {"vehicle_thrust": 437.0, "retro_specific_impulse": 301.0}
    slopes = atlas.query(**at).query.slopes
    for name, value in at.items():
        step = 1e-4 * value
        ahead, behind = (
            solve(cho_landing().with_given(**{**at, name: value + way * step}), verify=0).objective for way in (1, -1)
        )
        assert slopes[name] == pytest.approx((ahead - behind) / (2 * step), rel=1e-6)


def test_many_points_at_once_are_the_same_points(atlas: Atlas) -> None:
    points = RNG(2).uniform([430.0, 270.0], [450.0, 310.0], (300, 2))
    found = atlas.query_many(points)
    assert found.good.all() and found.error_bound.max() < 1e-9
    burn = found.free["retro_delta_v"]  # where none pays it is 0, to the last bit
    assert ((burn == 0.0) | (burn > 100.0)).all() and (burn == 0.0).any()
    for i in range(0, 300, 30):
        alone = atlas.query(vehicle_thrust=points[i, 0], retro_specific_impulse=points[i, 1])
        assert found.objective[i] == pytest.approx(alone.objective, rel=1e-12)
        assert found.free["flight_time"][i] == pytest.approx(alone.free["flight_time"], rel=1e-11)
        assert found.slopes[i, 0] == pytest.approx(alone.query.slopes["vehicle_thrust"], rel=1e-9)
    outside = atlas.query_many(np.array([[429.0, 300.0], [440.0, np.nan], [440.0, 300.0]]))
    assert outside.answered.tolist() == [Answered.OUTSIDE, Answered.OUTSIDE, Answered.YES]
    assert np.isnan(outside.objective[:2]).all()
    with pytest.raises(PeriluneError, match="rows of the values"):
        atlas.query_many(np.zeros((3, 5)))
    with pytest.raises(PeriluneError, match="points of an atlas") as masked:
        atlas.query_many(np.ma.masked_less([[440.0, 300.0], [450.0, -1.0]], 0.0))
    assert "masked" in masked.value.expected


def test_switches_are_mapped_too(tmp_path: Path) -> None:
    problem = precision()
    atlas = open_atlas(
        build(problem, {"approach.east": (-1900.0, -1700.0), "approach.up": (950.0, 1050.0)}, tmp_path / "p")
    )
    for east, up in RNG(3).uniform([-1900.0, 950.0], [-1700.0, 1050.0], (4, 2)):
        alone = solve(problem.with_given(approach_east=east, approach_up=up), verify=0)
        found = atlas.query(approach_east=east, approach_up=up)
        assert found.objective == pytest.approx(alone.objective, rel=1e-10)


def test_what_physics_refuses_is_refused_though_it_has_extremals(tmp_path: Path) -> None:
    """Below its perilune no parking orbit is: the equations do not know, as `solve` says."""
    axes = {"orbit.parking_altitude": (10e3, 20e3)}
    atlas = open_atlas(build(cho_landing(), axes, tmp_path / "map", bricks=2))
    with pytest.raises(InfeasibleError, match="the perilune lies above the parking orbit"):
        atlas.query(orbit_parking_altitude=14.9e3)
    assert atlas.query(orbit_parking_altitude=15.1e3).objective < 0
    found = atlas.query_many(np.array([[14.9e3], [15.1e3]]))
    assert found.answered.tolist() == [Answered.IMPOSSIBLE, Answered.YES] and np.isnan(found.objective[0])


def away(p: Any, xp: Any) -> tuple[Finding, ...]:
    """Comparisons of a user's own: not where a brick is in the middle."""
    value = xp.fabs(p.orbit_parking_altitude - 100e3)
    one = Finding(name="away", value=value, limit=1e3, at_least=True, unit="m", binding=True, meaning="too near")
    return (one, replace(one, name="root", value=xp.sqrt(value - 5e3), binding=False))


def test_what_physics_refuses_inside_a_brick_alone_is_refused_there(tmp_path: Path) -> None:
    """As ignition on an ellipse may be below the interface between two places above it: corners do not tell.

    The function is the user's, and no model makes it again: an atlas that is opened once lost it, and answered.
    """
    problem = replace(cho_landing(), preflight=away)
    atlas = open_atlas(build(problem, {"orbit.parking_altitude": (90e3, 110e3)}, tmp_path / "map", bricks=1))
    at = {"orbit_parking_altitude": np.array([93e3, 99e3])}
    assert [str(f) for f in pl.preflight(atlas.problem, at)] == [str(f) for f in pl.preflight(problem, at)]
    assert atlas.query_many(np.array([[95e3], [100e3]])).answered.tolist() == [Answered.YES, Answered.IMPOSSIBLE]
    assert atlas.query(orbit_parking_altitude=95e3).objective < 0
    with pytest.raises(InfeasibleError, match="too near"):
        atlas.query(orbit_parking_altitude=100e3)


@pytest.mark.parametrize(
    ("preflight", "words"),
    [
        (lambda p, xp: away(p, xp) if p.orbit_parking_altitude < 1e5 else (), "branches"),
        (lambda p, xp: [replace(f, meaning=f"{p.orbit_parking_altitude} m") for f in away(p, xp)], "words or values"),
        (lambda p, xp: [replace(f, limit=np.interp(f.value, (0, 1), (0, 1))) for f in away(p, xp)], r"xp\.table"),
        (lambda p, xp: away(p, xp)[: 1 + isinstance(p.orbit_parking_altitude, float)], "more or fewer"),
        (lambda p, xp: [f.name for f in away(p, xp)], "AttributeError"),
        (
            lambda p, xp: [replace(f, binding=p.orbit_parking_altitude > 0) for f in away(p, xp)],
            "value of binding in a comparison",
        ),
        (lambda p, xp: [replace(f, limit=np.array([f.limit])) for f in away(p, xp)], "scalars"),
    ],
    ids=["branches", "words", "NumPy", "fewer", "no findings", "a side that varies", "an array"],
)
def test_comparisons_that_an_atlas_cannot_keep_are_refused(preflight: Callable[[Any, Any], Any], words: str) -> None:
    problem = replace(cho_landing(), preflight=preflight)
    with pytest.raises(PeriluneError, match=words):
        comparisons_document(problem, [{"orbit_parking_altitude": 90e3}])


def test_comparisons_are_looked_at_within_a_region_too(tmp_path: Path) -> None:
    """As with its corners alone: of this function an atlas kept what it says there, and answered at 100 km."""

    def hidden(p: Any, xp: Any) -> Any:
        try:
            inside = bool(abs(p.orbit_parking_altitude - 100e3) < 8e3)
        except Exception:  # a symbol
            inside = False
        return [replace(f, value=0.0 * f.value if inside else f.value) for f in away(p, xp)]

    axes = {"orbit.parking_altitude": (90e3, 110e3)}
    with pytest.raises(PeriluneError, match="words or values"):
        build(replace(cho_landing(), preflight=hidden), axes, tmp_path / "map", bricks=1)


@pytest.mark.parametrize(
    "change",
    [
        {"findings": 3}, {"findings": [3]}, {"findings": [{"name": "a"}]}, {"findings": []}, {"values": {}},
        {"values": {"instructions": [["p", "other"]], "outputs": [0] * 4}},
    ],
    ids=["no list", "no records", "no side", "too few", "no tape", "no parameter"],
)  # fmt: skip
def test_comparisons_of_another_hand_are_refused(change: dict[str, Any]) -> None:
    problem = replace(cho_landing(), preflight=away)
    document = comparisons_document(problem, [{}])
    assert len(pl.preflight(problem.changed(preflight=read_comparisons(document, problem)))) == 2
    older = {**document, "findings": [{n: v for n, v in f.items() if n != "lasting"} for f in document["findings"]]}
    assert read_comparisons(older, problem).found == read_comparisons(document, problem).found
    with pytest.raises(PeriluneError, match="comparisons"):
        read_comparisons({**document, **change}, problem)


def test_a_model_of_which_physics_is_asked_nothing_stays_so_in_an_atlas() -> None:
    """Opened again it is made of its records, and would ask what the model does."""
    silent, places = replace(cho_landing(), preflight=None), [{}]
    assert same_comparisons(cho_landing(), cho_landing(), places) and not same_comparisons(
        silent, cho_landing(), places
    )
    assert not same_comparisons(replace(cho_landing(), preflight=away), cho_landing(), places)
    assert read_comparisons(comparisons_document(silent, places), silent)(None, None) == ()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"vehicle_thrust": 440.0}, "every axis"),
        ({"vehicle_thrust": 440.0, "retro_specific_impulse": 311.0}, "outside"),
        ({"vehicle_thrust": 440.0, "retro_specific_impulse": 310.0000000001}, r"310\.0{5,}\d+ s, which is mapped"),
        ({"vehicle_thrust": 440.0, "retro_specific_impulse": float("nan")}, "finite"),
        ({"vehicle_thrust": "much", "retro_specific_impulse": 300.0}, "numbers"),
        ({"vehicle_thrust": 10**400, "retro_specific_impulse": 300.0}, "numbers"),
        ({"vehicle_thrust": "440", "retro_specific_impulse": 300.0}, "numbers"),
        ({"vehicle_thrust": True, "retro_specific_impulse": 300.0}, "numbers"),
        ({"vehicle.thrust": 440.0, "vehicle_thrust": 430.0, "retro_specific_impulse": 300.0}, "twice"),
        ({"vehicle_thurst": 440.0, "retro_specific_impulse": 300.0}, "no axis"),
    ],
)
def test_points_that_are_none_are_refused(atlas: Atlas, values: dict[str, float], words: str) -> None:
    with pytest.raises(PeriluneError, match=words):
        atlas.query(**values)


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ({}, "a valid region of an atlas"),
        ({"vehicle.thrst": (1.0, 2.0)}, "no parameter"),
        ({"vehicle.thrust": (500.0, 400.0)}, "empty"),
        ({"vehicle.thrust": (400.0, float("inf"))}, "empty"),
        ({"vehicle.thrust": (400.0, 10**400)}, "range of"),
        ({"vehicle.thrust": 400.0}, "range of"),
        ({"vehicle.thrust": (400.0, 500.0), "vehicle_thrust": (400.0, 500.0)}, "twice"),
        ({"vehicle.thrust": (-400.0, 500.0)}, "thrust"),
        (
            dict.fromkeys(
                ("vehicle.thrust", "vehicle.mass", "body.radius", "landing.altitude", "body.rotation_rate"), (1.0, 2.0)
            ),
            "many",
        ),
    ],
)
def test_regions_that_are_none_are_refused(axes: dict[str, tuple[float, float]], words: str) -> None:
    with pytest.raises(PeriluneError, match=words):
        region_of(cho_landing(), axes)


def test_bricks_share_their_corners() -> None:
    region = region_of(cho_landing(), AXES)
    for brick in region.bricks:
        low, high = region.box(brick)
        assert region.brick_of(0.5 * (low + high)) == brick
        if brick[0]:
            assert region.box((brick[0] - 1, *brick[1:]))[1][0] == low[0]
    assert region.brick_of(region.high) == (3, 3)


# -- the store --------------------------------------------------------------------------------------------------------


def test_shards_are_read_with_numpy_alone(built: Path) -> None:
    lines = [json.loads(line) for line in (built / MANIFEST).read_text().splitlines()]
    bricks = [line for line in lines if line["kind"] == "brick"]
    nodes = np.load(built / bricks[0]["nodes"]["file"], allow_pickle=False)
    assert {"sheet", "values", "terms", "margin", "residual"} <= set(nodes.dtype.names or ())
    assert nodes["residual"].max() < 1e-9


def test_a_copy_of_an_atlas_opens_it_again(built: Path) -> None:
    """What it has looked at is machine code and maps of files, of this process alone."""
    atlas = open_atlas(built)
    point = np.mean([atlas.region.low, atlas.region.high], axis=0)
    asked = dict(zip(atlas.region.names, point.tolist(), strict=True))
    J = atlas.query(**asked).objective
    for other in (copied(atlas), pickle.loads(pickle.dumps(atlas))):
        assert other.query(**asked).objective == J


def test_what_is_there_is_not_computed_again_and_what_is_missing_comes_back_the_same(built: Path, copy: Path) -> None:
    whole, said = snapshot(copy), list[str]()
    build(cho_landing(), AXES, copy, callback=lambda line: said.append(str(line)))
    assert snapshot(copy) == whole and said[0].startswith("16 of 16 bricks")
    lines = (copy / MANIFEST).read_text().splitlines(keepends=True)[:-1]  # without that of the end
    (copy / MANIFEST).write_text("".join(lines[:-2]) + lines[-2][:40])  # killed in the middle of a line
    assert len(open_atlas(copy).said) == len(open_atlas(built).said) - 2
    build(cho_landing(), AXES, copy)
    again = snapshot(copy)
    assert {k: v for k, v in again.items() if k.endswith(".npy")} == {
        k: v for k, v in whole.items() if k.endswith(".npy")
    }
    assert len(open_atlas(copy).said) == len(open_atlas(built).said)


def test_processes_make_the_same_nodes(built: Path, tmp_path: Path) -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        build(cho_landing(), AXES, tmp_path / "other", pool)
    one, other = snapshot(built), snapshot(tmp_path / "other")
    assert {k: v for k, v in one.items() if k.endswith(".npy")} == {
        k: v for k, v in other.items() if k.endswith(".npy")
    }


def test_a_damaged_shard_is_named_and_the_rest_serves(copy: Path) -> None:
    atlas = open_atlas(copy)
    key = next(k for k in atlas.said if k[1:] == atlas.region.brick_of(np.array([431.0, 309.0])))
    file = copy / atlas.said[key]["nodes"]["file"]
    content = bytearray(file.read_bytes())
    content[-9] ^= 1
    file.write_bytes(content)
    with pytest.raises(PeriluneError, match=file.name):
        atlas.query(vehicle_thrust=431.0, retro_specific_impulse=309.0)
    assert atlas.query(vehicle_thrust=449.0, retro_specific_impulse=300.0).objective < 0
    many = open_atlas(copy).query_many(np.array([[431.0, 309.0], [449.0, 300.0]]))
    assert many.answered.tolist() == [Answered.NOT_BUILT, Answered.YES]
    found = verify_atlas(atlas, sample=0)
    assert not found.passed and len(found.damaged) == 1 and file.name in found.damaged[0]
    file.unlink()
    with pytest.raises(PeriluneError, match=file.name):
        open_atlas(copy).query(vehicle_thrust=431.0, retro_specific_impulse=309.0)


def test_what_is_not_built_is_said(copy: Path) -> None:
    lines = (copy / MANIFEST).read_text().splitlines(keepends=True)[:-1]  # without that of the end
    (copy / MANIFEST).write_text("".join(lines[:-1]))
    with pytest.raises(PeriluneError, match="not built") as said:
        open_atlas(copy).query(vehicle_thrust=450.0, retro_specific_impulse=310.0)
    assert run_command_line([*ordered(said.value.advice, copy), "--sample", "0"]) == 0
    assert open_atlas(copy).query(vehicle_thrust=450.0, retro_specific_impulse=310.0).objective < 0


def ordered(advice: str, directory: Path) -> list[str]:
    """The command that an advice names, of a directory."""
    return [*re.findall(r"perilune ((?:[a-z]+ )+)DIR", advice)[-1].split(), str(directory)]


def test_no_shard_is_read_from_elsewhere(copy: Path) -> None:
    lines = (copy / MANIFEST).read_text().replace('"file": "brick-', '"file": "../brick-').splitlines()
    (copy / MANIFEST).write_text("".join(written_line(json.loads(line)) + "\n" for line in lines))
    with pytest.raises(PeriluneError, match="damaged"):
        open_atlas(copy).query(vehicle_thrust=450.0, retro_specific_impulse=310.0)


def test_other_directories_are_refused(copy: Path, tmp_path: Path) -> None:
    with pytest.raises(PeriluneError, match=r"differs in its axes(.|\n)*perilune atlas extend"):
        build(cho_landing(), {"vehicle.thrust": (430.0, 460.0), **dict(list(AXES.items())[1:])}, copy)
    with pytest.raises(PeriluneError, match="given"):
        build(cho_landing().with_given(vehicle_mass=310.0), AXES, copy)
    with pytest.raises(PeriluneError, match="tolerance"):
        build(cho_landing(), AXES, tmp_path / "new", tolerance=0.5)
    (tmp_path / "some").mkdir()
    (tmp_path / "some" / "letter.txt").write_text("dear")
    with pytest.raises(PeriluneError, match="cannot be used"):
        build(cho_landing(), AXES, tmp_path / "some")
    with pytest.raises(PeriluneError):
        open_atlas(tmp_path / "nowhere")
    header = json.loads((copy / HEADER).read_text())
    header["format"]["version"] = 99
    (copy / HEADER).write_text(json.dumps(header))
    with pytest.raises(PeriluneError, match="version"):
        open_atlas(copy)


def test_nodes_drawn_at_random_are_proved(atlas: Atlas) -> None:
    found = verify_atlas(atlas, sample=3, seed=1)
    assert found.passed and found.proved == found.drawn == 3 and found.share == pytest.approx(0.01 ** (1 / 3))
    assert replace(found, drawn=459, proved=459).share == pytest.approx(0.99, abs=1e-4)
    assert replace(found, proved=2).share == 0.0 and not replace(found, proved=2).passed


# -- the command line -------------------------------------------------------------------------------------------------

VARY = ["--vary", "vehicle.thrust=430:450 N", "--vary", "retro.specific_impulse=270:310 s"]


def test_the_command_line_builds_asks_and_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "atlas")
    assert run_command_line(["atlas", "build", HYBRID, *VARY, "--out", out, "--json"]) == 0
    told = read_json(capsys.readouterr().out)
    assert told["nodes"] > 16 and len(told["sheets"]) == 3
    assert run_command_line(["atlas", "build", HYBRID, *VARY, "--out", out]) == 2
    assert "--resume" in capsys.readouterr().err
    assert run_command_line(["atlas", "build", HYBRID, *VARY, "--out", out, "--resume"]) == 0
    capsys.readouterr()
    at = ["--at", "vehicle.thrust=440 N", "--at", "retro.specific_impulse=300 s"]
    assert run_command_line(["atlas", "query", out, *at, "--json"]) == 0
    answer = read_json(capsys.readouterr().out)
    assert answer["results"]["landed_mass"]["value"] == pytest.approx(-atlas_objective(out), rel=1e-12)
    assert {"cell", "steps", "error_bound", "latency", "sheet"} <= set(answer["query"])
    assert run_command_line(["atlas", "query", out, *at, "--verify", "3"]) == 0
    assert "level 3" in capsys.readouterr().out
    answered = open_atlas(out).query(vehicle_thrust=440.0, retro_specific_impulse=300.0)
    pl.save(answered, tmp_path / "answer")
    assert (
        run_command_line(ordered(answered.outcome.value, tmp_path / "answer")) == 0
        and "PROVED" in capsys.readouterr().out
    )
    assert (
        run_command_line(["atlas", "query", out, "--at", "vehicle.thrust=440 N", "--at", "retro.specific_impulse=1 km"])
        == 2
    )
    assert "retro.specific_impulse - the unit has the wrong dimension" in capsys.readouterr().err
    assert run_command_line(["atlas", "query", out, "--at", "vehicle.thrust"]) == 2
    assert run_command_line(["atlas", "query", str(tmp_path), *at]) == 2
    assert run_command_line(["atlas", "info", out]) == 0
    assert run_command_line(["atlas", "verify", out, "--sample", "1", "--json"]) == 0
    assert run_command_line(["atlas", "bild", HYBRID]) == 2


def atlas_objective(directory: str) -> float:
    return open_atlas(directory).query(vehicle_thrust=440.0, retro_specific_impulse=300.0).objective


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("450:430 N", "is empty"),
        ("430:450:10 N", "two parts"),
        ("430 N", "two parts"),
        ("430:nan N", "the value is not finite\n  got: 'nan N'"),
        ("-inf:450 N", "the value is not finite\n  got: '-inf N'"),
    ],
)
def test_ranges_that_are_none_are_refused(text: str, words: str, tmp_path: Path, capsys: Any) -> None:
    order = ["atlas", "build", HYBRID, "--vary", f"vehicle.thrust={text}", "--out", str(tmp_path / "a")]
    assert run_command_line(order) == 2 and words in capsys.readouterr().err
    assert not (tmp_path / "a").exists()


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="a POSIX signal")
def test_a_killed_builder_leaves_what_another_goes_on_from(built: Path, tmp_path: Path) -> None:
    out = tmp_path / "killed"
    order = [sys.executable, "-m", "perilune", "atlas", "build", HYBRID, *VARY, "--out", str(out)]
    killed = subprocess.Popen(order, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until = time.monotonic() + 60
    while time.monotonic() < until and not (out / MANIFEST).exists():
        time.sleep(0.01)
    time.sleep(0.1)
    os.kill(killed.pid, signal.SIGKILL)
    killed.wait()
    subprocess.run([*order, "--resume"], env=ENVIRONMENT, check=True, capture_output=True)
    one, other = open_atlas(built), open_atlas(out)
    assert one.said.keys() == other.said.keys()
    for key, line in other.said.items():
        dtype = node_type(2, other.charted[0].unknowns)
        nodes = [a.store.shard(said["nodes"], dtype) for a, said in ((one, one.said[key]), (other, line))]
        np.testing.assert_allclose(nodes[0]["terms"], nodes[1]["terms"], rtol=1e-9)


def test_two_builders_share_the_work(built: Path, tmp_path: Path) -> None:
    out = tmp_path / "two"
    order = [sys.executable, "-m", "perilune", "atlas", "build", HYBRID, *VARY, "--out", str(out), "--resume"]
    both = [
        subprocess.Popen(order, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) for _ in range(2)
    ]
    for process in both:
        assert process.wait(120) == 0
    atlas = open_atlas(out)
    assert atlas.said.keys() == open_atlas(built).said.keys()
    names = [line["name"] for line in atlas.store.lines() if line["kind"] == "brick"]
    assert len(names) == len(set(names))  # no brick twice


# -- what a sheet hides ------------------------------------------------------------------------------------------------


def test_a_sheet_without_a_corner_of_a_cell_is_not_passed_over(atlas: Atlas) -> None:
    """Where the better sheet was not found the worse one is no answer."""
    at = {"vehicle_thrust": 441.0, "retro_specific_impulse": 292.0}
    best, point = atlas.query(**at), np.array([441.0, 292.0])
    assert len(best.query.candidates) > 1 and best.free["retro_delta_v"] > 0.0
    place = atlas.region.brick_of(point)
    whole, sheets = atlas.brick(0, place), atlas.charted[0].sheets
    assert whole is not None
    sheet = next(n for n, s in enumerate(sheets) if s.label == best.query.sheet)
    kept = np.nonzero(whole.cells["sheet"] != sheet)[0]
    others = np.array(whole.cells[kept])
    others["child"] = np.where(others["child"] >= 0, 3 + np.searchsorted(kept, others["child"]), -1)
    ours = np.repeat(np.array(whole.cells[dict(whole.minima)[sheet]])[None], 3)
    ours["axis"], ours["child"], ours["status"] = (0, -1, -1), (1, -1, -1), (Status.CUT, Status.ENDS, Status.ENDS)
    ours["size"][1:, 0] //= 2
    ours["low"][2, 0] = ours["size"][2, 0]
    ours["corners"][1:] = -1
    atlas._bricks[0, *place] = LoadedBrick(whole.nodes, np.concatenate([ours, others]), sheets, whole.step)
    with pytest.raises(PeriluneError, match="ends in this cell"):
        atlas.query(**at)
    assert atlas.query_many(point[None]).answered[0] == Answered.ENDS


def test_an_axis_may_be_a_parameter_that_the_problem_chooses(tmp_path: Path) -> None:
    atlas = open_atlas(build(cho_landing(), {"retro.delta_v": (1050.0, 1150.0)}, tmp_path / "held"))
    found = atlas.query(retro_delta_v=1101.0)
    wanted = solve(cho_landing().with_given(retro_delta_v=1101.0), verify=0)
    assert found.objective == pytest.approx(wanted.objective, rel=1e-9)


@pytest.mark.parametrize(
    ("key", "value"),
    [("axes", "x"), ("axes", []), ("axes", [{"name": "vehicle_thrust", "low": 2, "high": 1}]), ("tolerance", "x")],
)
def test_a_header_of_another_hand_is_refused_in_words(copy: Path, key: str, value: object) -> None:
    header = json.loads((copy / HEADER).read_text())
    (copy / HEADER).write_text(json.dumps(with_checksum({**header, key: value})))
    with pytest.raises(PeriluneError):
        open_atlas(copy)
    lines = (copy / MANIFEST).read_text().splitlines()
    (copy / HEADER).write_text(json.dumps(header))
    (copy / MANIFEST).write_text("\n".join([written_line({**json.loads(lines[0]), "charts": [7]}), *lines[1:], ""]))
    with pytest.raises(PeriluneError, match="has an entry that no atlas has"):
        open_atlas(copy).query(vehicle_thrust=440.0, retro_specific_impulse=300.0)


@pytest.mark.parametrize(
    ("column", "value"),
    [("child", 0), ("child", 99999), ("corners", 99999), ("corners", -7), ("axis", 5), ("sheet", 99)],
)
def test_numbers_that_lead_nowhere_are_damage(copy: Path, column: str, value: int) -> None:
    """A circle of cells, or nodes that are not there, with a checksum that is right."""
    lines = [json.loads(line) for line in (copy / MANIFEST).read_text().splitlines()]
    for line in lines:
        if line["kind"] == "brick":
            cells = np.load(copy / line["cells"]["file"])
            cells[column][0] = value
            np.save(copy / line["cells"]["file"], cells)
            line["cells"]["sha256"] = hashlib.sha256((copy / line["cells"]["file"]).read_bytes()).hexdigest()
    (copy / MANIFEST).write_text("".join(written_line(line) + "\n" for line in lines))
    with pytest.raises(PeriluneError, match="damaged"):
        open_atlas(copy).query(vehicle_thrust=440.0, retro_specific_impulse=300.0)


# -- where sheets go on and end ----------------------------------------------------------------------------------------


def test_sheets_go_on_into_bricks_of_which_they_reach_no_corner(tmp_path: Path) -> None:
    """The retro burn pays from some Isp on, whatever the thrust; its sheet folds before it ends there."""
    axes = {"vehicle.thrust": (300.0, 700.0), "retro.specific_impulse": (262.0, 318.0)}
    atlas = open_atlas(build(cho_landing(), axes, tmp_path / "wide"))
    points = RNG(7).uniform(atlas.region.low, atlas.region.high, (60, 2))
    found = atlas.query_many(points)
    assert found.good.mean() > 0.9
    assert set(found.answered[~found.good].tolist()) <= {Answered.ENDS, Answered.NONE}
    for i in np.nonzero(found.good)[0][::4]:
        given = dict(zip(atlas.region.names, points[i].tolist(), strict=True))
        assert found.objective[i] == pytest.approx(
            solve(cho_landing().with_given(**given), verify=0).objective, rel=1e-9
        )
    status = np.concatenate([brick.cells["status"] for key in atlas.said if (brick := atlas.brick(key[0], key[1:]))])
    assert {Status.ABSENT, Status.ENDS} <= set(status.tolist())


def test_nodes_on_a_common_side_go_on_where_the_neighbour_has_nothing() -> None:
    """Two bricks side by side along the first axis: of sheet 0 the second knows its upper half, of sheet 1 nothing."""

    def nodes(*rows: tuple[int, tuple[int, int], float]) -> np.ndarray:
        found = np.zeros(len(rows), dtype=node_type(2, 1))
        for row, (sheet, place, margin) in zip(found, rows, strict=True):
            row["sheet"], row["place"], row["margin"] = sheet, place, margin
        return found

    def cells(*rows: tuple[int, tuple[int, int], tuple[int, int], Status]) -> np.ndarray:
        found = np.zeros(len(rows), dtype=cell_type(2))
        for row, (sheet, low, size, status) in zip(found, rows, strict=True):
            row["sheet"], row["low"], row["size"], row["status"] = sheet, low, size, status
            row["corners"] = -1
        return found

    half, side = WHOLE // 2, WHOLE
    first = nodes((0, (side, 0), 1.0), (0, (side, side), 1.0), (1, (side, half), 1.0), (1, (side, 0), -1.0)), cells()
    second = (
        nodes((0, (0, side), 1.0)),
        cells(
            (0, (0, 0), (side, side), Status.CUT),
            (0, (0, 0), (side, half), Status.ABSENT),
            (0, (0, half), (side, half), Status.ENDS),
        ),
    )
    keys: list[Key] = [(0, 0, 0), (0, 1, 0), (0, 2, 0)]
    known = {keys[0]: first, keys[1]: second}
    sheets = [Sheet(holds={}, orientation=way, nature=Nature.LOCAL_OPTIMUM) for way in (1.0, -1.0)]
    found = dict(seeds_for_neighbours(keys, known.get, lambda _: sheets))
    told = {key: [(int(n["sheet"]), *n["place"].tolist()) for n in rows] for key, rows in found.items()}
    # Not the upper node, which the neighbour has; not the one beyond its border; nothing goes on from itself.
    assert told == {keys[1]: [(0, 0, 0), (1, 0, half)]}
    worst = [replace(sheets[0], nature=Nature.WORST), sheets[1]]
    alone = dict(seeds_for_neighbours(keys, known.get, lambda _: worst))
    assert {key: rows["sheet"].tolist() for key, rows in alone.items()} == {keys[1]: [1]}
    first[0]["terms"][1] = 0.5  # the neighbour has another extremal at the upper node
    others = dict(seeds_for_neighbours(keys, known.get, lambda _: sheets))
    assert [n["place"].tolist() for n in others[keys[1]] if n["sheet"] == 0] == [[0, 0], [0, side]]


# -- answers of several arcs -------------------------------------------------------------------------------------------


def test_answers_that_touch_a_condition_are_mapped_beside_those_that_do_not(tmp_path: Path) -> None:
    """Bryson, Denham, Dreyfus 1963: touched where the ceiling is below 1/4, where J rises from 2 on."""
    atlas = open_atlas(build(bryson_denham(1 / 5), {"ceiling": (0.17, 0.3)}, tmp_path / "ceilings"))
    ceilings = np.linspace(0.17, 0.3, 201)
    found = atlas.query_many(ceilings[:, None])
    truth = [bryson_denham_truth(c) if c < 0.25 else 2.0 for c in ceilings.tolist()]
    assert found.good.all()
    np.testing.assert_allclose(found.objective, truth, rtol=1e-11)
    touching, free = atlas.query(ceiling=0.2), atlas.query(ceiling=0.29)
    assert [arc.description for arc in touching.structure] == ["contact point of room"] and not free.structure
    assert "touches room" in touching.query.sheet and "touches" not in free.query.sheet
    assert len(touching.query.candidates) == 2  # the one that breaks the ceiling would cost less
    slope = (bryson_denham_truth(0.2001) - bryson_denham_truth(0.1999)) / 2e-4
    assert touching.query.slopes["ceiling"] == pytest.approx(slope, rel=1e-6)
    assert pl.verify(touching).outcome is Outcome.PROVED


def test_an_answer_that_breaks_the_path_is_none_where_nothing_that_keeps_it_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what breaks it casts doubt by the J that it has, whatever the corners of its cell promise."""
    atlas = open_atlas(build(bryson_denham(0.3), {"ceiling": (0.2, 0.3)}, tmp_path / "ceilings"))
    assert atlas.charted.pop().of_arcs and len(atlas.charted) == 1
    with pytest.raises(NotConvergedError, match="no answer here"):
        atlas.query(ceiling=0.22)
    assert atlas.query_many(np.array([[0.22], [0.29]])).answered.tolist() == [Answered.ENDS, Answered.YES]
    monkeypatch.setattr(LoadedBrick, "least", lambda brick, numbers, places: np.ones(len(numbers)))
    again = open_atlas(tmp_path / "ceilings")
    touching = again.brick(1, again.region.brick_of(np.array([0.29])))
    assert touching is not None
    touching.status[:] = [int(Status.BREAKS)] * len(touching.status)
    assert again.query(ceiling=0.29).objective == pytest.approx(2.0, rel=1e-12)
    assert again.query_many(np.array([[0.29]])).good.all()


def test_the_maps_of_the_examples_are_stated_rightly() -> None:
    spec = importlib.util.spec_from_file_location("maps", ROOT / "examples" / "maps" / "build.py")
    assert spec is not None and spec.loader is not None
    maps = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(maps)
    assert set(maps.MAPS) == {"hybrid", "precision", "capsule"}
    for scenario, axes in maps.MAPS.values():
        assert len(region_of(load_file(scenario).problem, axes).axes) == len(axes)


def test_second_flights_lose_little_to_rounding() -> None:
    """Once round a circle in 2048 steps: each rounds the state once, and 2.8e-14 were lost where it did ten times."""
    z, h = ca.SX.sym("z", 2), ca.SX.sym("h")
    step = ca.Function("step", [z, h], [extrapolated_step(lambda point: ca.vertcat(-point[1], point[0]), z, h)])
    around = step.mapaccum(2048)
    for angle in np.linspace(0.1, 1.4, 8).tolist():
        begin = np.array([math.cos(angle), math.sin(angle)])
        end = np.array(around(begin, 2 * math.pi / 2048))[:, -1]
        np.testing.assert_allclose(end, begin, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("news", "rounds"), [(3, 4), (20, 8)])
def test_bricks_go_on_from_their_neighbours_while_that_gives_something_new(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, news: int, rounds: int
) -> None:
    """A sheet that enters one brick through another is known to the next behind it a round later."""
    done = list[int]()
    monkeypatch.setattr(building, "first_tasks", lambda *_: [((0, 0), "task")])
    monkeypatch.setattr(building, "tasks_going_on", lambda *given: [((0, given[-1] + 1), "task")])
    monkeypatch.setattr(building, "_complete_round", lambda *given: done.append(given[4]))
    monkeypatch.setattr(building, "_shard_checksums", lambda *given: min(given[-1], news - 1))
    problem = cho_landing()
    region = region_of(problem, {"vehicle.thrust": (430.0, 450.0)})
    building.complete_atlas(
        AtlasStore(tmp_path), problem, region, {"digest": "d", "charts": []}, 1e-9, None, lambda _: None
    )
    assert done == list(range(rounds))
