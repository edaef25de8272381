"""Problems restated with their arcs: solved to closed forms, cut and joined without loss, read off coarse answers."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.core import PeriluneError
from perilune.io import solution_document
from perilune.problem import Solution
from perilune.problem.results.arc_sequence import format_arcs
from perilune.structures import Arc, Structure
from perilune.structures.detect_arcs import detect_structures
from perilune.structures.detect_regimes import Stay
from perilune.structures.multiphase import restate
from perilune.structures.revise_regimes import _close_gaps
from perilune.structures.split_join import join_solution, split_solution
from problems.constrained import (
    brachistochrone,
    brachistochrone_truth,
    bryson_denham,
    bryson_denham_truth,
    deorbit,
    mars_glide_slope,
)

COARSE = pl.Pseudospectral(segments=4, nodes=8, refine=0, polish=False)
ONE_MESH = pl.Pseudospectral(refine=0, polish=False)


def riding(name: str) -> Structure:
    return Structure(((Arc(), Arc(along=(name,)), Arc()),))


def touching(name: str) -> Structure:
    return Structure(((Arc(touches=(name,)), Arc()),))


@pytest.mark.parametrize(("as_bound", "name"), [(False, "room"), (True, "x.upper")])
def test_a_restated_problem(as_bound: bool, name: str) -> None:
    """Each arc is a phase; what is ridden is held and entered, and no condition of its arc any more."""
    problem = restate(bryson_denham(1 / 9, as_bound), riding(name))
    own = name.replace(".", "_")
    assert [p.name for p in problem.phases] == ["swing-1", "swing-2", "swing-3"]
    assert problem.duration_names == ("T-1", "T-2", "T-3") == problem.free_names
    assert [c.name for c in problem.phases[0].end_conditions] == [f"enter_{own}", f"enter_{own}_rate"]
    assert [(c.name, c.unit) for c in problem.phases[1].held_conditions] == [(f"{own}_rate_2", "m/s^2")]
    assert [[c.name for c in p.path_conditions] for p in problem.phases] == [[own], [], [own]]
    assert [c.name for c in problem.phases[2].end_conditions] == ["back", "turned", "T"]
    assert all(s.upper == math.inf for p in problem.phases for s in p.states)
    p = problem.parameters({"T-1": 0.2, "T-2": 0.3, "T-3": 0.6})
    x, u = (0.1, 0.4, 0.0), (-2.0,)
    assert problem.phases[0].evaluate("end", x, (), p) == pytest.approx([1 / 9 - 0.1, -0.4])
    assert problem.phases[1].evaluate("held", x, u, p) == [2.0]
    assert problem.phases[2].evaluate("end", x, (), p) == pytest.approx([0.1, 1.4, 0.1])
    replace(problem, title="whose physics is homogeneous")


@pytest.mark.parametrize("as_bound", [False, True])
@pytest.mark.parametrize(("ceiling", "rides"), [(1 / 9, True), (1 / 5, False)])
def test_the_direct_method_finds_the_closed_form_from_a_straight_line(
    ceiling: float, rides: bool, as_bound: bool
) -> None:
    """dJ/dl is the multiplier of entry, or of the touch."""
    name, problem = "x.upper" if as_bound else "room", bryson_denham(ceiling, as_bound)
    structure = riding(name) if rides else touching(name)
    solution = pl.solve(restate(problem, structure), pl.Pseudospectral(), verify=0)
    if rides:  # J has an inflection at the time of entry, and the mesh an error: 1e-5 of it
        assert solution.objective == pytest.approx(bryson_denham_truth(ceiling), abs=5e-5)
        solution = pl.Indirect().run(solution.problem, solution)
    assert solution.objective == pytest.approx(bryson_denham_truth(ceiling), abs=1e-10)
    slope = -4 / (9 * ceiling**2) if rides else -48 * (1 - 4 * ceiling)
    first = next(nu for key, nu in solution.multipliers.items() if "_rate" not in key)
    assert first == pytest.approx(slope, rel=1e-3)  # S >= 0 beside it takes its part
    whole = join_solution(problem, solution, structure)
    assert whole.problem is problem and not whole.free
    assert whole.trajectories[0].duration == pytest.approx(1.0, abs=1e-12)
    ends = np.cumsum([t.duration for t in solution.trajectories])[:-1]
    assert ends == pytest.approx([3 * ceiling, 1 - 3 * ceiling] if rides else [0.5], abs=1e-4)
    assert pl.verify(whole, level=1).verification.passed


def test_a_boundary_arc_by_the_indirect_method() -> None:
    """The times of the joints are simple roots: they are exact where J is."""
    problem, structure = bryson_denham(1 / 9, as_bound=True), riding("x.upper")
    restated = restate(problem, structure)
    solution = pl.Indirect().run(restated, pl.solve(restated, pl.Pseudospectral(), verify=0))
    assert solution.objective == pytest.approx(4.0, abs=1e-12)
    assert [t.duration for t in solution.trajectories] == pytest.approx([1 / 3] * 3, abs=1e-12)
    assert solution.multipliers["swing-1.enter_x_upper"] == pytest.approx(-36.0, abs=1e-10)
    whole = join_solution(problem, solution, structure)
    assert pl.verify(whole, level=1).verification.passed
    assert [arc.text for arc in whole.structure] == ["along the upper bound of x 0.3333 to 0.6667 s"]


def test_a_touch_by_the_indirect_method() -> None:
    """To the last digit; the costate of the place jumps by dJ/dl."""
    problem, structure = bryson_denham(1 / 5), touching("room")
    restated = restate(problem, structure)
    solution = pl.Indirect().run(restated, pl.solve(restated, ONE_MESH, verify=0))
    assert solution.objective == pytest.approx(2.24, abs=1e-12)
    assert solution.multipliers["swing-1.touch_room"] == pytest.approx(-9.6, abs=1e-11)
    proof = pl.verify(
        solution, level=3
    ).verification  # the condition on the durations, 1 s together, stands in no costate
    assert proof.passed and "multipliers" in {c.name for c in proof.checks}
    whole = join_solution(problem, solution, structure)
    assert pl.verify(whole, level=1).verification.passed
    costate = whole.trajectories[0].costate
    assert costate is not None
    at = np.nonzero(np.diff(costate.time) == 0)[0]
    assert costate.time[at] == pytest.approx([0.5])
    assert np.diff(costate.values[at[0] : at[0] + 2, 0])[0] == pytest.approx(-9.6, abs=1e-9)
    assert whole.multipliers.keys() == {"swing.back", "swing.turned"}


def test_the_constrained_brachistochrone() -> None:
    """A condition of the first order; its free duration is a sum, in J too."""
    problem = brachistochrone()
    entered, left, least = brachistochrone_truth()
    coarse = pl.solve(problem, COARSE, verify=0)
    (structure,) = detect_structures(problem, coarse, states_only=True)
    guess = split_solution(coarse, structure)
    solution = pl.solve(guess.problem, ONE_MESH, guess=guess, verify=0)
    whole = join_solution(problem, solution, structure)
    assert whole.objective == pytest.approx(least, abs=1e-9)
    assert whole.free == pytest.approx({"T": least}, abs=1e-9)
    ends = np.cumsum([t.duration for t in solution.trajectories])
    assert [(a.description, a.begin, a.end) for a in whole.structure] == [("along above", *ends[:2])]
    assert ends[:2] == pytest.approx([entered, left], abs=1e-3)
    assert pl.verify(whole, level=1).verification.passed
    exact = pl.Indirect().run(guess.problem, solution)
    assert np.cumsum([t.duration for t in exact.trajectories]) == pytest.approx([entered, left, least], abs=1e-10)


def test_a_touch_at_a_wrong_time_is_no_extremal() -> None:
    """One multiplier of the durations' sum cannot make both stationary."""
    restated = restate(bryson_denham(1 / 5), touching("room"))
    early = restated.with_given(**{"T-1": 0.45})
    solution = pl.Indirect().run(early, pl.solve(early, ONE_MESH, verify=0))
    proof = pl.verify(replace(solution, problem=restated, free={"T-1": 0.45, **solution.free}), level=2).verification
    assert {c.name for c in proof.failed} >= {"stationary_T-1", "stationary_T-2"}


def test_the_range_of_a_duration_is_one_of_the_sum() -> None:
    problem = brachistochrone()
    slow = replace(problem, free=(replace(problem.free[0], lower=2.0),))
    guess = split_solution(pl.solve(slow, COARSE, verify=0), riding("above"))
    solution = pl.solve(guess.problem, ONE_MESH, guess=guess, verify=0)
    assert solution.objective == pytest.approx(2.0, abs=1e-9)
    whole = join_solution(slow, solution, riding("above"))
    assert whole.free == pytest.approx({"T": 2.0}, abs=1e-9)
    assert whole.multipliers.keys() == {"slide.across"}


@pytest.fixture(scope="module")
def glide() -> Solution:
    """The glide slope on a coarse mesh, some metres below it."""
    return pl.solve(mars_glide_slope(), COARSE, verify=0)


def test_a_coarse_landing_is_read_restated_and_solved(glide: Solution, tmp_path: Path) -> None:
    problem = mars_glide_slope()
    (structure,) = detect_structures(problem, glide, states_only=True)
    assert structure.text == "free and touches glide, free"
    guess = split_solution(glide, structure)
    assert sum(guess.free[name] for name in guess.problem.duration_names) == pytest.approx(glide.free["flight_time"])
    rough = pl.solve(guess.problem, ONE_MESH, guess=guess, verify=0)
    solution = join_solution(problem, pl.Indirect().run(guess.problem, rough), structure)
    proof = pl.verify(solution, level=1).verification
    assert proof.passed
    assert solution.results["propellant"].value == pytest.approx(398.069674, abs=1e-5)
    names = {arc.description: arc for arc in solution.structure}
    assert (
        names["contact point of glide"].end
        == pytest.approx(32.826402, abs=1e-5)
        == names["contact point of glide"].begin
    )
    powers = [arc for arc in solution.structure if arc.description.startswith("T ")]
    assert {arc.description for arc in powers} == {"T at its upper bound", "T at its lower bound"}
    assert powers[0].begin == 0.0 and powers[-1].end == pytest.approx(solution.free["flight_time"])
    assert all(a.end == b.begin and a.description != b.description for a, b in itertools.pairwise(powers))
    assert format_arcs(solution.structure).count("contact point of glide at 32.83 s") == 1
    kept = solution.structure
    for k in range(2):  # saved, and for programs
        pl.save(solution, tmp_path / str(k))
        solution = pl.load(tmp_path / str(k))
    assert solution.structure == kept
    assert solution_document(solution)["unverified_claims"] == ["method", "statistics", "structure"]
    assert solution.results["time"].value == solution.free["flight_time"]
    t = np.linspace(0.0, solution.free["flight_time"], 2001)
    assert problem.phases[0].evaluate("path", *solution.evaluate(0, t), solution.parameters)[0].min() > -1e-6


def test_a_return_touches_its_shell_in_a_leg_of_a_shared_duration() -> None:
    """The legs stay equal, whatever the first is made of. The touch lasts no time; its time is free."""
    problem = deorbit()
    coarse = pl.solve(problem, pl.Pseudospectral(refine=0, segments=4, nodes=6, polish=False), verify=0)
    (structure,) = detect_structures(problem, coarse, states_only=True)
    assert structure.text == "free and touches above, free; free; free"
    guess = split_solution(coarse, structure)
    assert guess.problem.duration_names == ("leg.leg1-1", "leg.leg1-2", "leg", "fall")
    solution = pl.Indirect().run(guess.problem, pl.solve(guess.problem, ONE_MESH, guess=guess, verify=0))
    whole = join_solution(problem, solution, structure)
    assert pl.verify(whole, level=1).verification.passed
    assert whole.objective == pytest.approx(2 * whole.free["leg"] + whole.free["fall"], abs=1e-9)
    assert whole.trajectories[0].duration == pytest.approx(whole.trajectories[1].duration, abs=1e-7)
    assert whole.objective == pytest.approx(4443.89648, abs=1e-4)
    # The fall multiplies errors of the costates by more than 1e3: at its end they are known to 1e-8 at best.
    proof = pl.verify(whole, level=3, tolerance=pl.Tolerance(optimality=1e-6)).verification
    assert proof.passed and proof.level == 3
    kappa = next(check.value for check in proof.checks if check.name == "conjugate_point")
    assert 0.1 < kappa < 0.5


def test_cut_and_joined_again_nothing_is_lost(glide: Solution) -> None:
    structure = Structure(((Arc(until=20.0), Arc(until=32.0), Arc(until=glide.free["flight_time"])),))
    pieces = split_solution(glide, structure)
    assert [t.duration for t in pieces.trajectories][:2] == [20.0, pytest.approx(12.0)]
    assert pieces.multipliers["descent-3.down"] == glide.multipliers["descent.down"]
    whole = join_solution(glide.problem, pieces, structure)
    assert whole.free == pytest.approx(dict(glide.free)) and whole.multipliers == glide.multipliers
    t = np.linspace(0.0, glide.free["flight_time"], 777)
    for name in ("state", "control", "costate"):
        before, after = (getattr(s.trajectories[0], name)(t) for s in (glide, whole))
        np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-9)


MESHES = [{"segments": 4, "nodes": 8}, {"segments": 8, "nodes": 5}, {"nodes": 20}, {"segments": 10, "nodes": 4}]


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: bryson_denham(1 / 9), "free, along room, free"),
        (lambda: bryson_denham(1 / 9, as_bound=True), "free, along x.upper, free"),
        (lambda: bryson_denham(1 / 5), "free and touches room, free"),
        (lambda: bryson_denham(1 / 3), None),
        (brachistochrone, "free, along above, free"),
        (mars_glide_slope, "free and touches glide, free"),
    ],
)
def test_structures_are_read_off_coarse_meshes(make: Any, text: str | None, mesh: Any) -> None:
    """What falls below its limit between the points of a mesh, and bulges above it."""
    problem = make()
    coarse = pl.solve(problem, pl.Pseudospectral(refine=0, polish=False, **mesh), verify=0)
    structures = detect_structures(problem, coarse, states_only=True)
    assert [structure.text for structure in structures] == ([] if text is None else [text])


def test_what_cannot_be_restated_is_named() -> None:
    problem = brachistochrone()
    with pytest.raises(PeriluneError, match="no condition of slide of this name") as unknown:
        restate(problem, riding("abvoe"))
    assert "'above'" in unknown.value.advice
    with pytest.raises(PeriluneError, match="above allows a boundary arc, but no contact point"):
        restate(problem, touching("above"))
    with pytest.raises(PeriluneError, match="at least one arc for each phase"):
        restate(problem, Structure(((Arc(),), (Arc(),))))
    with pytest.raises(PeriluneError, match="an arc of slide has no length"):
        split_solution(
            pl.solve(problem, COARSE, verify=0), Structure(((Arc(until=1.0), Arc(until=1.0), Arc(until=1.0)),))
        )


def test_neighbours_of_one_regime_are_one_and_no_time_is_left_between() -> None:
    """Wherever they stand among the others."""
    kinds = ["lower", "upper", "upper", "singular", "singular", "singular"]
    stays = [Stay(control="u", regime=kind, begin=i + 0.1, end=i + 0.9) for i, kind in enumerate(kinds)]
    found = [(stay.regime, stay.begin, stay.end) for stay in _close_gaps(stays, 7.0)]
    assert found == [("lower", 0.0, 0.9), ("upper", 0.9, 2.9), ("singular", 2.9, 7.0)]
    assert _close_gaps([], 7.0) == []
