"""Why there is no answer: what refuses, what only has not converged, and what is kept."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from cho import CHO_MOON
from command_line import HYBRID, read_json, snapshot
from perilune.cli import run_command_line
from perilune.core import InfeasibleError, NotConvergedError, Outcome, PeriluneError, format_bound
from perilune.methods.indirect.coarse_direct import Coarse
from perilune.methods.indirect.diagnosis import active_path_condition, explain_refusal
from perilune.methods.indirect.indirect import Indirect
from perilune.methods.indirect.refinement.structure_search import StructureRefinement
from perilune.methods.indirect.violations import ConstraintViolation, bound_violations
from perilune.models import MOON, Orbit, Retro, Vehicle, hybrid_landing
from perilune.problem import (
    Curve,
    Parameter,
    Phase,
    Problem,
    ScalarControl,
    Solution,
    Statistics,
    Trajectory,
    Variable,
    stating_keys,
)
from perilune.scenario import load_file
from perilune.solve import solve
from problems.ascents import tangent_steering

EXAMPLES = Path(__file__).parents[2] / "examples"

LOW = ConstraintViolation(name="height", text="height falls to -3 m", miss=3.0, unit="m", canonical=3e-6)
WIDE = ConstraintViolation(name="angle", text="angle falls to -0.5 rad", miss=0.5, unit="rad", canonical=0.5)
NEAREST = "the best of 4 found violates the end condition landing.rest by 2 m/s"


def known(direct: PeriluneError) -> Coarse:
    """What a direct method knows that has ended so."""
    coarse = Coarse(Indirect(), tangent_steering(), ["costates on the unit sphere: 2 extremals"])
    coarse.refusal = direct
    return coarse


def test_what_is_no_number_keeps_no_bounds() -> None:
    """Not even where there are none."""
    problem = tangent_steering()
    state = problem.phases[0].states[0]
    anywhere = (-math.inf, math.inf)
    assert not list(bound_violations(problem, state, np.array([0.0, 1e9]), anywhere, 0.0))
    assert list(bound_violations(problem, state, np.array([0.0, math.nan]), anywhere, 0.0))


def test_what_would_be_wide_enough_is_rounded_outwards() -> None:
    """Away from the side that is allowed, also of negative values; nothing and infinity stay as they are."""
    assert [format_bound(0.999956, "1", side) for side in ("lower", "upper")] == ["0.99995", "0.99996"]
    assert [format_bound(-1234.567, "kg", side) for side in ("lower", "upper")] == ["-1234.6 kg", "-1234.5 kg"]
    assert format_bound(math.pi / 180, "rad", "upper", 3) == "1 deg"
    assert [format_bound(value, "m", "upper") for value in (0.0, math.inf)] == ["0 m", "inf m"]


def test_a_condition_of_the_path_is_named_with_the_key_that_states_it() -> None:
    """The slope and the tilt by what stands in the file; a bound of an end by its key; a bare end by nothing."""
    problem = load_file(EXAMPLES / "precision_landing.toml").problem
    keys = {c.name: stating_keys(problem, 0, "path", i) for i, c in enumerate(problem.phases[0].path_conditions)}
    assert keys == {
        "height_above_glide_slope": ["corridor.slope", "corridor.pad_radius"],
        "pointing_margin": ["corridor.tilt"],
    }
    problem = load_file(EXAMPLES / "capsule_return.toml").problem
    k = len(problem.phases) - 1
    ends = {c.name: stating_keys(problem, k, "end", i) for i, c in enumerate(problem.phases[k].end_conditions)}
    assert ends["landing_speed"] == ["site.speed_upper"] and ends["site_up"] == []
    limited = {c.name: stating_keys(problem, k, "path", i) for i, c in enumerate(problem.phases[k].path_conditions)}
    assert limited["load_left"] == ["limits.load"]


def test_the_best_of_those_that_miss_is_named() -> None:
    """Compared in canonical units: 3 m of 1000 km are less than half a radian."""
    partial = {"violations": ["the rest is missed by 2 m/s"], "all_infeasible": True}
    error = explain_refusal(known(NotConvergedError(NEAREST, partial=partial)), [WIDE, LOW])
    assert isinstance(error, InfeasibleError) and error.exit_code == 3
    assert (
        error.what == "the best of 2 found violates height by 3 m"
        and "the direct method found no flight either" in error.got
    )
    assert error.reason == "the best found violates it" and error.reason in str(error)
    assert error.partial == {**partial, "attempts": ["costates on the unit sphere: 2 extremals"]}
    undecided = explain_refusal(
        known(NotConvergedError("not yet optimal", partial={"all_infeasible": False})), [WIDE, LOW]
    )
    assert isinstance(undecided, NotConvergedError) and "remains open" in undecided.what
    assert "the nearest height by 3 m" in undecided.what
    assert InfeasibleError("too heavy").reason == "cannot be flown"


def test_the_limit_that_the_nearest_extremal_breaks_is_named_and_no_equation_of_motion() -> None:
    """Whose error, in a least miss that is no flight, tells nothing to who stated a limit of the load."""
    coarse = Coarse(Indirect(), load_file(EXAMPLES / "capsule_return.toml").problem, [])
    partial = {"violations": ["the dynamics of vz in entry is missed by 362.7 m/s"], "all_infeasible": False}
    coarse.refusal = NotConvergedError("no trajectory was found", partial=partial)
    broken = ConstraintViolation(
        name="load_left", text="load left falls to -23 m/s^2 on the way", miss=23.0, unit="m/s^2", canonical=3.0,
        path=True, limit="load left",
    )  # fmt: skip
    worse = replace(broken, text="load left falls to -40 m/s^2 on the way", miss=40.0, canonical=5.0)
    error = explain_refusal(coarse, [worse, broken])
    assert isinstance(error, NotConvergedError) and error.partial["violations"] == partial["violations"]
    assert (
        "the nearest load left (limits.load) by 23 m/s^2, and" in error.what
        and error.got.startswith(broken.text)
        and "dynamics" not in str(error)
    )
    assert error.expected == "load left never below 0" and error.advice.startswith("relax limits.load")


def hurried(most: float) -> Problem:
    """1 m in 1 s from rest to rest, no faster than `most`, with least integral of a^2/2."""
    phase = Phase(
        name="go",
        states=(
            Variable(name="x", unit="m"),
            Variable(name="v", unit="m/s", upper=most),
            Variable(name="e", unit="m^2/s^3"),
        ),
        controls=(ScalarControl(name="a", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.a, 0.5 * u.a * u.a),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.far, x.v), place="m", rest="m/s"),
    )
    return Problem(
        name="hurried",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given={"far": Parameter(value=1.0, unit="m"), "T": Parameter(value=1.0, unit="s")},
        free=(),
        objective=lambda x, p, xp: x.e,
        objective_unit="m^2/s^3",
    )


def test_what_only_a_coarse_mesh_misses_is_not_refused() -> None:
    """A steep trapezoid flies it, too steep for the segments of a coarse mesh."""
    with pytest.raises(NotConvergedError) as e:
        solve(hurried(1.01))
    assert e.value.exit_code == 4


def test_where_the_mesh_is_fine_enough_the_bound_is_ridden() -> None:
    """The acceleration falls evenly to 0 in t = 1.5 (1 - 1/V), at the speed V: J = 4 V^2/(3 t)."""
    most = 1.2
    solution = solve(hurried(most), verify=2)
    t = 1.5 * (1 - 1 / most)
    assert solution.objective == pytest.approx(4 * most**2 / (3 * t), abs=1e-10)
    assert [(arc.description, arc.begin, arc.end) for arc in solution.structure] == [
        ("along the upper bound of v", pytest.approx(t, abs=1e-9), pytest.approx(1 - t, abs=1e-9))
    ]
    assert solution.outcome is Outcome.PROVED, str(solution.verification)


def test_extremals_that_break_the_path_refuse_nothing() -> None:
    """They know nothing of it, nor does the direct method's nearest miss: only what cannot be flown refuses."""
    breaks = [replace(WIDE, path=True), replace(LOW, path=True)]
    direct = InfeasibleError("the start is outside its bounds")
    assert explain_refusal(known(direct), breaks) is direct
    nearest = NotConvergedError(NEAREST, partial={"all_infeasible": True, "least_miss": 0.1})
    assert explain_refusal(known(nearest), []) is nearest  # where there is no extremal it says the most
    for tried in (nearest, NotConvergedError("the optimum was not reached")):
        error = explain_refusal(known(tried), breaks)
        assert isinstance(error, NotConvergedError) and error.exit_code == 4 and "remains open" in error.what
        assert f"height falls to -3 m; direct method: {tried.what}" in error.got
    assert explain_refusal(known(NotConvergedError("the optimum was not reached")), []) is None


def test_where_a_flight_keeps_everything_it_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every smooth extremal breaks a glide slope of 25 degrees, the direct method's flight does not; no structure."""
    monkeypatch.setattr(StructureRefinement, "run", lambda self, rough: None)
    tight = load_file(EXAMPLES / "precision_landing.toml", ("corridor.slope=25 deg",)).problem
    with pytest.raises(
        NotConvergedError, match=r"every extremal found violates[\s\S]*direct method: landed mass \d+.* kg, mesh error"
    ) as e:
        solve(tight)
    flight = e.value.flight
    t = np.linspace(0.0, flight.trajectories[0].duration, 301)
    state, control = flight.evaluate(0, t)
    margins = tight.phases[0].evaluate("path", list(state), list(control), flight.parameters)
    assert min(margins[0]) > -5.0 and min(margins[1]) > -0.05  # m, and of a cosine: the error of a coarse mesh
    assert any("direct transcription" in line for line in e.value.partial["attempts"])


def test_no_number_of_searches_says_that_nothing_flies() -> None:
    """Thrust of 0.46 of its weight: from each start the direct method misses by 17 km, yet without a burn it lands."""
    weak = hybrid_landing(
        Vehicle(mass=649.88, thrust=486.82, specific_impulse=361.23),
        Retro(specific_impulse=377.42),
        Orbit(parking_altitude=21880.0, perilune_altitude=16176.6),
        replace(MOON, rotation_rate=-MOON.rotation_rate),
        -1235.3,
    )
    with pytest.raises(NotConvergedError) as e:
        solve(weak, verify=0)
    assert e.value.exit_code == 4 and "the best violates the end condition" in str(e.value)
    mesh = pl.Pseudospectral(nodes=5, segments=20, refine=0, polish=False)
    flight, burnless = None, weak.with_given(retro_delta_v=0.0)
    for thrust in (1.3, 1.1, 1.0):
        flight = mesh.run(burnless.with_given(vehicle_thrust=thrust * 486.82), flight)
    assert flight is not None and flight.statistics.residual < 1e-3 and -flight.objective > 100.0


@pytest.mark.parametrize(("dry", "missed"), [(161.0, 0.381416), (165.0, 4.381416)])
def test_what_must_land_is_more_than_the_best_that_lands(dry: float, missed: float) -> None:
    """The paper's 160.618584 kg are the most; every extremal is listed as too light, and no direct start finds more."""
    heavy = hybrid_landing(
        Vehicle(mass=300.0, thrust=440.0, specific_impulse=310.0, standard_gravity=9.81, dry_mass=dry),
        Retro(specific_impulse=310.0),
        Orbit(parking_altitude=100e3, perilune_altitude=15e3),
        CHO_MOON,
    )
    with pytest.raises(
        InfeasibleError, match=rf"the best of 3 found violates vehicle.dry_mass by {missed:g} kg"
    ) as caught:
        solve(heavy)
    assert caught.value.reason == "the best found violates it" and caught.value.exit_code == 3
    assert caught.value.expected == f"mass (m) at least {dry:g} kg"
    assert caught.value.advice.startswith("lower vehicle.dry_mass to 160.61 kg; or ")  # 160.618584 is not less


def test_the_flight_that_keeps_everything_is_on_disk(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Every extremal would go through the ground; the direct method's flight is kept beside the refusal, unproved."""
    out, weak = tmp_path / "out", ["--set", "vehicle.thrust=200 N", "--set", "retro.delta_v=0 m/s"]
    assert run_command_line(["solve", HYBRID, *weak, "--out", str(out)]) == 4
    assert "every extremal found violates a condition" in capsys.readouterr().err
    kept = read_json((out / "failure.json").read_text(encoding="utf-8"))
    assert snapshot(out).keys() == {"failure.json"} and "PROVED" not in json.dumps(kept["flight"])
    height = [state[0] - 1738140.0 for state in kept["flight"]["phases"][0]["state"]["values"]]
    assert height[0] == pytest.approx(15e3) and abs(height[-1]) < 1.0
    assert -25.0 < min(height) < -15.0 and "height above site violated by 19 m between" in kept["error"]["got"]
    assert "is far from keeping it" in kept["error"]["got"]  # to -1.6e6 m, which says nothing
    assert kept["partial"]["attempts"]


def test_a_broken_path_is_named_and_no_round_off(landing: Problem) -> None:
    """With 50 N no burn's size makes an extremal, but each burn has one, which dives: not its residual of 1e-16."""
    with pytest.raises(NotConvergedError, match=r"every extremal found violates[\s\S]*height above site falls to -"):
        solve(landing.with_given(vehicle_thrust=50.0))


def over_ground(height: Callable[[np.ndarray], np.ndarray], residual: float = 1e-6) -> Solution:
    """A flight by hand with the given heights, which must not be negative."""
    phase = pl.Phase(
        name="over",
        states=(pl.Variable(name="h", unit="m"),),
        controls=(pl.ScalarControl(name="climb", unit="m/s"),),
        dynamics=lambda x, u, p, xp: (u.climb,),
        duration="T",
        path=pl.Conditions(lambda x, u, p, xp: (x.h,), ground="m"),
    )
    problem = pl.Problem(
        name="over",
        phases=(phase,),
        start=lambda p, xp: (p.h0,),
        given={"T": pl.Parameter(value=1.0, unit="s"), "h0": pl.Parameter(value=1.0, unit="m")},
        objective=lambda x, p, xp: x.h,
        objective_unit="m",
    )
    t = np.linspace(0.0, 1.0, 201)
    slope = np.gradient(height(t), t)[:, None]
    flown = Trajectory(
        phase="over",
        state=Curve(time=t, values=height(t)[:, None], rates=slope),
        control=Curve(time=t, values=slope, rates=0 * slope),
    )
    return Solution(
        problem=problem, method="by hand", outcome=Outcome.SOLVED, objective=0.0, free={}, trajectories=(flown,),
        statistics=Statistics(residual=residual),
    )  # fmt: skip


@pytest.mark.parametrize(("at", "ridden"), [(0.0, None), (0.02, None), (0.3, "ground"), (0.93, "ground"), (1.0, None)])
def test_a_condition_that_is_met_at_the_ends_alone_is_not_ridden(at: float, ridden: str | None) -> None:
    flight = over_ground(lambda t: 3.0 * (t - at) ** 2)
    assert active_path_condition(flight.problem, flight) == ridden


@dataclass(frozen=True)
class Again:
    """A direct method whose answer is known."""

    answer: Solution

    def run(self, problem: pl.Problem, guess: Solution | None = None, callback: object = None) -> Solution:
        return self.answer


@pytest.mark.parametrize(
    ("first", "second", "kept"),
    [
        ((0.1, 0.01), (0.2, 0.01), "first"),
        ((-0.01, 0.01), (0.2, 0.01), "second"),  # it breaks the ground by more than a mesh does
        ((0.1, 0.06), (0.2, 0.01), "second"),  # too rough
        ((0.1, 0.06), (0.2, 0.06), None),
    ],
)
def test_a_flight_is_kept_that_is_good_enough_or_becomes_so(
    first: tuple[float, float], second: tuple[float, float], kept: str | None
) -> None:
    """Of lowest height and mesh error: once as it is, and once after another try."""
    flights = {
        name: over_ground(lambda t, low=low: low + 3.0 * (t - 0.5) ** 2, residual)
        for name, (low, residual) in (("first", first), ("second", second))
    }
    again: Any = Again(flights["second"])
    coarse = Coarse(Indirect(transcription=again), flights["first"].problem, [])
    coarse.solution = flights["first"]
    assert coarse.flight is (flights[kept] if kept else None)
