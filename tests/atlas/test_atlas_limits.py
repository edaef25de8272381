"""Atlases over the limits themselves: what is held there moves with the parameters."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune import PeriluneError
from perilune.atlas.building import build as building
from perilune.atlas.building.extend import extend
from perilune.atlas.hermite import corner_terms
from perilune.atlas.query.query import open_atlas
from perilune.charts.arc_sequence import ArcSequence
from perilune.charts.borders import Borders
from perilune.charts.chart import Chart, Holds
from perilune.charts.sheet import Sheet
from perilune.core import Matrix, Vector
from perilune.models import MOON, Orbit, Retro, Vehicle, hybrid_landing
from perilune.problem import Nature, Parameter, Variable
from perilune.structures import Arc, Structure
from problems.constrained import timed_bryson_denham

build = partial(building.build, sample=0)  # proofs have tests of their own

REWARD = 12.0  # m/s^3 for each m
LONGEST = 1.1  # s


def haul(patient: bool) -> pl.Problem:
    """From rest to rest with the least int u^2/2 - 12 x(T): a haul of at most `high`.

    Over X in T the effort is 6 X^2/T^3, so that one goes as far as one may, or X = T^3; where it is a `patient` one, T
    is free up to 1.1 s times patience^2, and otherwise is given.
    """
    phase = pl.Phase(
        name="haul",
        states=tuple(Variable(name=n, unit=unit) for n, unit in (("x", "m"), ("v", "m/s"), ("c", "m^2/s^3"))),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u),
        duration="T",
        end=pl.Conditions(
            lambda x, p, xp: (x.v, x.x),
            Variable(name="still", unit="m/s"),
            Variable(name="far", unit="m", upper="high"),
        ),
    )
    values = {"high": (0.6, "m"), "reward": (REWARD, "m/s^3"), "longest": (LONGEST, "s")}
    values |= {"patience": (1.0, "1")} if patient else {"T": (LONGEST, "s")}
    return pl.Problem(
        name="haul",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given={name: Parameter(value=value, unit=unit) for name, (value, unit) in values.items()},
        free=(pl.FreeParameter(name="T", unit="s", lower=0.0, upper=2.0, guess=1.0),) if patient else (),
        parameter_bounds=(lambda p, xp: {"T": (0.0, p.longest * p.patience**2, 1.0)}) if patient else None,
        objective=lambda x, p, xp: x.c - p.reward * x.x,
        objective_unit="m^2/s^3",
    )


def truth(high: Vector, T: Vector) -> tuple[Vector, Vector, Vector]:
    """J, dJ/dhigh and dJ/dT."""
    X = np.minimum(high, REWARD * T**3 / 12.0)
    return 6.0 * X**2 / T**3 - REWARD * X, np.where(X == high, 12.0 * X / T**3 - REWARD, 0.0), -18.0 * X**2 / T**4


def test_a_flight_of_no_length_is_no_answer() -> None:
    """It meets every condition, as none asks for anything at its end, and J = 0: all 24 random starts led there."""
    problem = haul(True).with_given(high=1.61056, patience=0.71583, reward=2.59797)
    longest, solution = LONGEST * 0.71583**2, pl.solve(problem)
    assert solution.outcome is pl.Outcome.PROVED
    assert solution.free["T"] == pytest.approx(longest, rel=1e-9)
    assert solution.objective == pytest.approx(-(2.59797**2) * longest**3 / 24.0, rel=1e-9)  # X = reward T^3/12


def test_derivatives_by_a_limit_that_holds_are_those_of_closed_forms(tmp_path: Path) -> None:
    """Of an end condition whose limit varies, held on one side of X = T^3 and free on the other."""
    problem, axes = haul(False), {"high": (0.4, 1.6), "T": (0.95, 1.1)}
    atlas = open_atlas(build(problem, axes, tmp_path / "map"), lambda _: problem)
    points = np.random.default_rng(0).uniform([0.4, 0.95], [1.6, 1.1], (300, 2))
    found = atlas.query_many(points)
    assert found.good.all()
    J, by_high, by_T = truth(*points.T)
    assert 50 < np.count_nonzero(by_high) < len(J) - 50
    np.testing.assert_allclose(found.objective, J, rtol=1e-10)
    np.testing.assert_allclose(found.slopes, np.stack([by_high, by_T], axis=1), rtol=1e-8, atol=1e-8)
    alone = atlas.query(high=0.5, T=1.0)
    assert alone.query is not None
    np.testing.assert_allclose([alone.query.slopes[n] for n in axes], [6.0 - REWARD, -4.5], rtol=1e-8)


def test_values_and_derivatives_move_with_every_bound_that_is_held() -> None:
    """A range of a free parameter by a function of the user's, of two parameters, and the limit of an end."""
    sheet = Sheet(holds={"T": "upper", "far": "upper"}, orientation=1.0, nature=Nature.LOCAL_OPTIMUM_AT_BOUND)
    values = np.array([[0.6, 1.0, LONGEST], [0.55, 1.03, 1.05]])
    chart = Chart(haul(True), ("high", "patience", "longest"), np.array([0.2, 0.1, 0.2]))
    np.testing.assert_array_equal(chart.scale, 1.0)

    def holds(at: Matrix) -> Holds:
        return borders.holds([sheet], np.zeros(len(at), dtype=np.int64), at)

    borders = Borders(chart)
    known = pl.solve(haul(True)).unknowns
    assert known is not None
    found = chart.solve(values, chart.from_problem_unknowns(np.array(known))[None].repeat(2, axis=0), holds(values))
    terms = corner_terms(chart, found, holds)
    assert found.converged.all()
    high, patience, longest = values.T
    T = longest * patience**2
    J, by_high, by_T = truth(high, T)
    np.testing.assert_allclose(found.cost, J, rtol=1e-12)
    by_patience, by_longest = 2.0 * longest * patience * by_T, patience**2 * by_T
    np.testing.assert_allclose(found.cost_slopes, np.stack([by_high, by_patience, by_longest], axis=1), rtol=1e-9)
    mixed = -36.0 * high / T**4 * patience**2  # d2J/dhigh dlongest
    np.testing.assert_allclose(terms[:, 0b101, -1], mixed, rtol=1e-6)
    both = -18.0 * high**2 * (2.0 * patience) * (1.0 - 4.0) / T**4  # d2J/dpatience dlongest
    np.testing.assert_allclose(terms[:, 0b110, -1], both, rtol=1e-6)


def test_ranges_are_asked_of_no_values_that_were_not_set() -> None:
    """Arrays that wait for them hold anything, and what a range follows from may take for ever with that."""
    asked = list[float]()

    def ranges(p: Any, xp: Any) -> Any:
        asked.append(p.longest if p.longest > 0.0 else -1.0)  # what has no value is not compared
        return {"T": (0.0, p.longest * p.patience**2, 1.0)}

    borders = Borders(Chart(replace(haul(True), parameter_bounds=ranges), ("longest",), np.array([0.2])))
    values = np.full((1, 1), np.nan)
    (_, upper), fill = borders.bind(values)
    values[:] = 1.05
    fill()
    assert upper[0, 0] == asked[-1] == 1.05
    assert min(asked) > 0.0


def test_ranges_that_an_atlas_cannot_keep_are_refused(tmp_path: Path) -> None:
    """By a function of the user's, which no file has; what does not move them may vary."""
    problem = haul(True)
    with pytest.raises(PeriluneError, match="the range of T depends on the varied parameters") as refused:
        build(problem, {"patience": (0.9, 1.1)}, tmp_path / "map")
    assert "0.891 s" in str(refused.value)
    assert not (tmp_path / "map").exists()
    there_and_back = replace(
        problem.with_given(high=0.5),
        parameter_bounds=lambda p, xp: {"T": (0.0, LONGEST + (p.high - 0.5) * (0.7 - p.high), 1.0)},
    )
    with pytest.raises(PeriluneError, match="the range of T depends on the varied parameters"):
        build(there_and_back, {"high": (0.5, 0.7)}, tmp_path / "map")
    atlas = open_atlas(build(problem, {"high": (0.5, 0.7)}, tmp_path / "map"), lambda _: problem)
    J, by_high, _ = truth(np.array([0.6]), np.array([LONGEST]))
    answer = atlas.query(high=0.6)
    assert answer.query is not None
    np.testing.assert_allclose([answer.objective, answer.query.slopes["high"]], [J[0], by_high[0]], rtol=1e-10)


def test_ranges_of_the_users_in_a_problem_of_a_model_are_refused_where_they_move(tmp_path: Path) -> None:
    """Records of a model let its own ranges be made again, and no others: also where both agree at its own values."""
    vehicle, orbit = (
        Vehicle(mass=300.0, thrust=440.0, specific_impulse=310.0),
        Orbit(parking_altitude=100e3, perilune_altitude=15e3),
    )
    model = hybrid_landing(vehicle, Retro(specific_impulse=310.0), orbit, body=MOON)
    ranges = model.parameter_bounds
    assert ranges is not None and model.records

    def slower(p: Any, xp: Any) -> Any:
        found = dict(ranges(p, xp))
        least, most, typical = found["retro_delta_v"]
        return {**found, "retro_delta_v": (least, most - 10.0 * (p.vehicle_thrust - 440.0), typical)}

    for name in ("hybrid_landing", "landing_of_my_own"):
        problem = replace(model, name=name, parameter_bounds=slower)
        with pytest.raises(PeriluneError, match=r"the range of retro\.delta_v depends on the varied parameters"):
            build(problem, {"vehicle.thrust": (435.0, 445.0)}, tmp_path / "map")


def test_an_atlas_that_has_lost_what_its_ranges_follow_from_is_not_extended(tmp_path: Path) -> None:
    """Within its axes they do not move; what they do beyond nobody who opens it knows."""
    problem = replace(
        haul(True).with_given(high=0.6),
        parameter_bounds=lambda p, xp: {"T": (0.0, LONGEST - xp.fmax(p.high - 0.7, 0.0), 1.0)},
    )
    directory = build(problem, {"high": (0.5, 0.7)}, tmp_path / "map", bricks=1)
    with pytest.raises(PeriluneError, match="follow from a function that this atlas does not keep"):
        extend(directory, {"high": (0.5, 0.9)})
    extend(directory, {}, sample=0)
    assert open_atlas(directory).query_many(np.array([[0.6]])).good.all()


def two_hauls() -> pl.Problem:
    """As far as `q` tells: nowhere at its lower bound for nothing, or 2 m at its upper for 24/T^3 + 28 - 2 K/T^3."""
    phase = pl.Phase(
        name="haul",
        states=tuple(Variable(name=n, unit=unit) for n, unit in (("x", "m"), ("v", "m/s"), ("c", "m^2/s^3"))),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.v, x.x - p.q - p.way), still="m/s", there="m"),
    )
    values = {"T": (1.0, "s"), "way": (1.0, "m"), "bend": (100.0, "1/s^3"), "toll": (14.0, "m/s^3"), "K": (24.0, "m")}
    return pl.Problem(
        name="two_hauls",
        phases=(phase,),
        start=lambda p, xp: (0.0 * p.way, 0.0, 0.0),
        given={name: Parameter(value=value, unit=unit) for name, (value, unit) in values.items()},
        free=(pl.FreeParameter(name="q", unit="m", lower=-1.0, upper=1.0, guess=1.0),),
        objective=lambda x, p, xp: x.c - 0.5 * p.bend * (p.q**2 - p.way**2) + (p.toll - p.K / p.T**3) * (p.q + p.way),
        objective_unit="m^2/s^3",
    )


def test_where_the_conditions_are_linear_the_better_of_two_bounds_answers_too(tmp_path: Path) -> None:
    """A step leads to the extremal from anywhere there, and J of what is interpolated may be far from its own."""
    problem, axes = two_hauls(), {"T": (0.6, 3.0), "K": (20.0, 60.0)}
    atlas = open_atlas(build(problem, axes, tmp_path / "map"), lambda _: problem)
    points = np.random.default_rng(0).uniform([0.6, 20.0], [3.0, 60.0], (1000, 2))
    found, (T, K) = atlas.query_many(points), points.T
    assert found.good.all()
    np.testing.assert_allclose(found.objective, np.minimum(24.0 / T**3 + 28.0 - 2.0 * K / T**3, 0.0), atol=1e-9)


def test_an_extremal_beyond_a_bound_is_followed_to_one_that_is_held_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Just short of X = T^3 the haul that goes on beyond is no answer; held at the limit it is, of a cell or not."""
    problem = haul(False)
    atlas = open_atlas(build(problem, {"high": (0.4, 1.6)}, tmp_path / "map"), lambda _: problem)
    short = LONGEST**3 - 1e-3
    least = truth(np.array([short]), np.array([LONGEST]))[0][0]
    assert atlas.query(high=short).objective == pytest.approx(least)
    place = atlas.region.brick_of(np.array([short]))
    brick = atlas.brick(0, place)
    assert brick is not None
    free = [(sheet, root) for sheet, root in brick.minima if not atlas.charted[0].sheets[sheet].holds]
    assert len(free) < len(brick.minima)
    monkeypatch.setattr(brick, "minima", free)
    assert atlas.query(high=short).objective == pytest.approx(least)
    assert atlas.query_many(np.array([[short]])).objective[0] == pytest.approx(least)


def test_a_sum_of_arcs_lies_between_bounds_that_follow_from_what_varies() -> None:
    """A duration of several arcs, and each of them: all stayed within the bounds of the problem as it was stated."""
    base = timed_bryson_denham(0.1, 0.5, 1.0, 0.5)
    problem = replace(
        base, given={**base.given, "longest": Parameter(value=1.0, unit="s")},
        parameter_bounds=lambda p, xp: {"T": (0.5 * p.longest, p.longest, 0.9)},
    )  # fmt: skip
    rides = Structure(((Arc(until=0.3), Arc(until=0.7, along=("room",)), Arc()),))
    borders = Borders(Chart(problem, ("longest",), np.array([0.4]), ArcSequence(structure=rides)))
    at, second = borders.names.index("T"), borders.chart.problem.scales.time
    for longest in ([0.8], [0.8, 1.1]):
        lower, upper = borders.at(np.array(longest)[:, None] / borders.chart.scale)
        assert (lower[:, at] * second).tolist() == pytest.approx([0.5 * each for each in longest])
        for name in ("T", "T-1", "T-3"):
            assert (upper[:, borders.names.index(name)] * second).tolist() == pytest.approx(longest)
    assert {(at, 0), (at, 1)} <= borders._moving


def lure(far: float = 0.3) -> pl.Problem:
    """From rest to rest between -0.5 m and `far`, drawn by -15 x^2 - x: J = -9 X^2 - X has a maximum between them."""
    base = haul(False)
    still, far_bounds = base.phases[0].end_conditions[0], Variable(name="far", unit="m", lower="low", upper="high")
    phase = replace(base.phases[0], end=pl.Conditions.of(base.phases[0].end, (still, far_bounds)))
    given = {"T": (1.0, "s"), "low": (-0.5, "m"), "high": (far, "m"), "pull": (30.0, "1/s^3"), "push": (1.0, "m/s^3")}
    return pl.Problem(
        name="lure",
        phases=(phase,),
        start=base.start,
        given={name: Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        objective=lambda x, p, xp: x.c - 0.5 * p.pull * x.x**2 - p.push * x.x,
        objective_unit="m^2/s^3",
    )


@pytest.mark.parametrize("far", [0.3, 0.8])
def test_a_maximum_over_a_range_at_the_end_is_no_answer(far: float) -> None:
    """What is stationary between the limits has J = 1/36, the worst; both limits are extremals, the best answers."""
    found = pl.solve(lure(far), verify=2)
    assert found.objective == pytest.approx(min(-9.0 * z * z - z for z in (-0.5, far)), rel=1e-12)
    assert found.outcome is pl.Outcome.PROVED
    assert sorted(e.objective for e in found.extremals)[-1] == pytest.approx(1.0 / 36.0, rel=1e-9)
    assert [e.nature for e in found.extremals].count(Nature.WORST) == 1


def test_an_atlas_answers_at_the_better_limit_of_a_range(tmp_path: Path) -> None:
    problem = lure()
    atlas = open_atlas(build(problem, {"high": (0.1, 1.2)}, tmp_path / "map"), lambda _: problem)
    points = np.linspace(0.1, 1.2, 100)[:, None]
    found = atlas.query_many(points)
    assert found.good.all()
    np.testing.assert_allclose(found.objective, np.minimum(-9.0 * points[:, 0] ** 2 - points[:, 0], -1.75), rtol=1e-10)
