"""A direct answer made exact: by Newton's method on its structure, from the first mesh where that is near enough."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import perilune as pl
from perilune.cli import run_command_line
from perilune.methods.polish import solve_and_polish
from perilune.models import MERCURY, Orbit, Retro, Vehicle, hybrid_landing
from perilune.problem import Nature, Problem
from perilune.scenario import load_file
from problems import LIBRARY
from problems.constrained import bryson_denham, bryson_denham_truth, mars_glide_slope
from problems.goddard import goddard
from problems.landings import meditch

PRECISION, POLAR = "examples/precision_landing.toml", "examples/polar_descent.toml"
DIRECT, MESH_ALONE = pl.Pseudospectral(), pl.Pseudospectral(polish=False)


@pytest.mark.parametrize("name", ["linear tangent steering", "lunar ascent", "orbit raising", "Meditch's lander"])
def test_problems_of_the_library_are_proved(name: str) -> None:
    """Their meshes alone reach level 0 or 1."""
    answered = next(a for a in LIBRARY if a.name == name)
    problem = answered.make()
    solution = pl.solve(problem, DIRECT)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    allowed = max(1e-8 * abs(answered.objective), answered.uncertainty)
    assert solution.objective == pytest.approx(answered.objective, abs=allowed)
    assert solution.statistics.initialization == "gauss collocation, 20 nodes, then Newton"
    assert solution.statistics.attempts[-1].startswith("polish: by Newton, J = ")
    assert solution.extremals[0].nature is Nature.BEST
    assert not pl.verify(pl.solve(problem, MESH_ALONE, verify=0)).verification.passed


def test_one_mesh_is_enough() -> None:
    """The mesh that is refined three times otherwise misses the jump of the thrust by 5e-3, and leads to the root."""
    lines = list[str]()
    solution = pl.solve(meditch(), DIRECT, verify=0, callback=lambda line: lines.append(str(line)))
    assert sum("mesh " in line and "relative error" in line for line in lines) == 1
    assert any(line.startswith("polish: by Newton") for line in lines)
    assert solution.method == "indirect" and solution.unknowns is not None
    alone = pl.solve(meditch(), MESH_ALONE, verify=0)
    assert alone.method == "pseudospectral" and len(alone.statistics.attempts) > 2


def test_a_touch_is_kept() -> None:
    problem = bryson_denham(1 / 5)
    solution = pl.solve(problem, DIRECT)
    assert solution.verification.level == 3 and solution.verification.passed
    assert solution.objective == pytest.approx(bryson_denham_truth(1 / 5), abs=1e-12)
    assert solution.statistics.initialization == "gauss collocation, 20 nodes, then structure"
    assert [arc.text for arc in solution.structure] == ["contact point of room at 0.5 s"]
    again = pl.solve(problem, guess=solution)
    assert [arc.description for arc in again.structure] == [
        "contact point of room"
    ] and again.outcome is pl.Outcome.PROVED


def test_a_glide_slope_that_no_mesh_of_25_reached() -> None:
    """The mesh alone ends four refinements later, a quarter of a gramme beside it."""
    solution = pl.solve(mars_glide_slope(), DIRECT)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert solution.results["propellant"].value == pytest.approx(398.069674, abs=1e-5)


@pytest.mark.parametrize("degrees", [20, 45])
def test_a_tilt_limit_on_which_refinement_stalls(degrees: int) -> None:
    problem = load_file(PRECISION, (f"corridor.tilt={degrees} deg",)).problem
    solution = pl.solve(problem, DIRECT)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    rival = pl.solve(problem, verify=0)
    assert solution.objective == pytest.approx(rival.objective, rel=1e-10)


def test_a_steering_limit_by_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """PROVED with the polish; without it the mesh stalls, exit code 4, and the best flight is in failure.json."""
    told = ["solve", POLAR, "--method", "direct", "--set", "steering.elevation_upper=25deg", "--json"]
    assert run_command_line(told) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["verification"]["level"] == 3 and "then Newton" in document["statistics"]["initialization"]
    assert run_command_line([*told, "--no-polish", "--out", str(tmp_path / "out")]) == 4
    capsys.readouterr()
    failure = json.loads((tmp_path / "out" / "failure.json").read_text())
    propellant = (found["results"]["propellant"]["value"] for found in (failure["flight"], document))
    assert next(propellant) == pytest.approx(next(propellant), rel=1e-4)
    assert failure["partial"]["objective"] == failure["flight"]["objective"]["value"]


def test_no_polish_is_a_setting_of_the_direct_method(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["solve", POLAR, "--no-polish"]) == 2
    told = capsys.readouterr().err
    assert "the indirect method has no setting polish" in told and "got: --no-polish" in told
    assert "--method direct" in told


def test_what_cannot_be_made_exact_stays_and_says_so() -> None:
    """The direct method follows Goddard's singular arc; an indirect method that knows none leaves its answer alone."""
    direct = pl.solve(goddard(), MESH_ALONE, verify=0)
    solution = solve_and_polish(DIRECT, goddard())
    assert solution.objective == pytest.approx(direct.objective, rel=1e-7)
    if solution.method == "pseudospectral":
        assert solution.statistics.attempts[-1] == "polish: the direct answer is kept unchanged"
        assert any(line.startswith("polish: no extremal") for line in solution.statistics.attempts)


def test_the_best_of_a_family_is_found() -> None:
    """The mesh ends at a retro burn of nothing, 3 % of the mass worse; along the burn there is the better extremal."""
    vehicle = Vehicle(mass=290.0, thrust=640.0, specific_impulse=296.0)
    orbit = Orbit(parking_altitude=111e3, perilune_altitude=11.5e3)
    problem = hybrid_landing(vehicle, Retro(specific_impulse=291.0), orbit, MERCURY)
    alone = pl.solve(problem, MESH_ALONE, verify=0)
    assert alone.free["retro_delta_v"] == pytest.approx(0.0, abs=1e-3)
    solution, rival = pl.solve(problem, DIRECT), pl.solve(problem, verify=0)
    assert solution.outcome is pl.Outcome.PROVED and solution.objective < alone.objective - 0.03 * 290.0
    assert solution.objective == pytest.approx(rival.objective, rel=1e-10)
    assert [e.nature for e in solution.extremals] == [e.nature for e in rival.extremals]
    # A guess is another matter: what lies near it was asked for.
    near = pl.solve(problem, DIRECT, guess=alone, verify=0)
    assert near.objective == pytest.approx(alone.objective, rel=1e-6) and len(near.extremals) == 1


class Worse(pl.Pseudospectral):
    """A direct method whose first mesh claims to be far better than anything is."""

    def meshes(self, problem, guess=None, watch=None):
        for mesh in super().meshes(problem, guess, watch):
            yield replace(mesh, objective=mesh.objective - 1.0)


def test_another_extremal_that_is_worse_is_not_taken() -> None:
    solution = solve_and_polish(Worse(), meditch())
    assert solution.method == "pseudospectral"
    assert sum("another extremal, which is worse" in line for line in solution.statistics.attempts) >= 1


def test_a_guess_stays_a_guess() -> None:
    rough = pl.solve(meditch(), MESH_ALONE, verify=0)
    assert pl.solve(meditch(), DIRECT, guess=rough, verify=0).extremals[0].nature is Nature.NEAR_GUESS


def stalled() -> tuple[pl.NotConvergedError, Problem]:
    problem = load_file(POLAR, ("steering.elevation_upper=25deg",)).problem
    with pytest.raises(pl.NotConvergedError, match="mesh did not reach") as caught:
        DIRECT.run(problem)
    return caught.value, problem


def test_the_best_flight_of_a_mesh_that_stalls_is_kept() -> None:
    """It lands, and its mesh error is the one that the refusal names: the least of all meshes, not that of the last."""
    error, problem = stalled()
    flight = error.flight
    errors = [
        float(line.split("relative error ")[1].split(" ")[0]) for line in error.partial["attempts"] if "nodes" in line
    ]
    assert flight.statistics.residual == pytest.approx(min(errors), rel=0.1)
    assert f"relative error {flight.statistics.residual:.2g}" in error.got
    assert error.partial["free"] == dict(flight.free)
    landed = pl.verify(flight, level=1).verification
    ends = [c for c in landed.checks if c.name in {v.name for v in problem.phases[-1].end_conditions}]
    assert ends and all(c.value <= 1e3 * c.limit for c in ends)
    assert pl.solve(problem, guess=flight).outcome is pl.Outcome.PROVED


def test_the_nearest_miss_is_kept_without_costates() -> None:
    """A flight that meets no condition has multipliers of nothing."""
    with pytest.raises(pl.NotConvergedError) as caught:
        pl.Pseudospectral(iterations=2).run(meditch())
    flight = caught.value.flight
    assert flight.trajectories[0].costate is None
    assert np.isfinite(flight.trajectories[0].state.values).all()
    assert pl.solve(meditch(), pl.Pseudospectral(), guess=flight).outcome is pl.Outcome.PROVED
