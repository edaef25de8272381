"""Without a guess: what no smooth arc keeps is touched or ridden along, and proved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.methods.direct.pseudospectral import Pseudospectral
from perilune.models import CERES, MERCURY, Orbit, Retro, Vehicle, hybrid_landing
from perilune.problem import Curve, Solution
from perilune.report.summary import solution_summary
from perilune.scenario import load_file
from perilune.structures.state_margins import broken_intervals
from problems.constrained import (
    brachistochrone,
    brachistochrone_truth,
    bryson_denham,
    bryson_denham_truth,
    mars_glide_slope,
    parked,
    timed_bryson_denham,
    timed_bryson_denham_truth,
)


def slope(degrees: float) -> pl.Problem:
    return load_file("examples/precision_landing.toml", (f"corridor.slope={degrees} deg",)).problem


@pytest.fixture(scope="module")
def touching() -> Solution:
    return pl.solve(bryson_denham(1 / 5))


def test_a_touch_is_found_and_proved(touching: Solution) -> None:
    """J = 2 + 6 (1 - 4 l)^2 = 2.24 (Bryson, Denham, Dreyfus 1963)."""
    assert touching.objective == pytest.approx(2.24, abs=1e-12)
    assert touching.outcome is pl.Outcome.PROVED and touching.verification.level == 3
    assert [arc.text for arc in touching.structure] == ["contact point of room at 0.5 s"]
    assert touching.extremals[0].nature.value == "best of the extremals found"
    assert "contact point of room at 0.5 s" in solution_summary(touching)
    assert {"swing-1_touch", "swing-1_touch_jump", "swing-1_strict_touch"} <= {
        c.name for c in touching.verification.checks
    }


def test_a_touch_of_a_flight_that_would_be_longer_is_proved() -> None:
    """J falls with the time there is, which both parts of the flight share: its multiplier is that of their sum."""
    solution = pl.solve(timed_bryson_denham(1 / 5, 0.5, 1.0))
    assert solution.objective == pytest.approx(2.24, abs=1e-12) and solution.free["T"] == 1.0
    assert solution.verification.level == 3, str(solution.verification)
    guesses = list[Solution]()

    def noted(problem: pl.Problem, guess: Solution) -> Solution:
        guesses.append(guess)
        return guess

    pl.verify(solution, resolve=noted)
    assert guesses[0].multipliers["swing-2.T"] == pytest.approx(0.32, rel=1e-6)  # -d/dT (2 + 6 (1 - 4 l/T)^2)/T


@pytest.mark.parametrize(
    ("ceiling", "low", "high", "price", "at", "words"),
    [
        (0.12, 1.0, 1.0, 0.0, 1.0, "along room"),  # a range of one value is the user's: no neighbour of an answer
        (0.2, 1.0, 1.0, 0.0, 1.0, "contact point of room"),
        (0.12, 1.0, 2.0, 1.0, 2.0, "along room"),  # read as two touches, between which it never leaves
        (0.12, 0.9, 2.0, -1.0, 0.9, "along room"),
    ],
)
def test_a_duration_on_a_bound_is_that_of_all_its_arcs(
    ceiling: float, low: float, high: float, price: float, at: float, words: str
) -> None:
    solution = pl.solve(timed_bryson_denham(ceiling, low, high, price))
    assert solution.objective == pytest.approx(timed_bryson_denham_truth(ceiling, at, price), rel=1e-11)
    assert solution.free["T"] == pytest.approx(at, rel=1e-14)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert [arc.description for arc in solution.structure] == [words]


def test_a_boundary_arc_is_found_and_proved() -> None:
    """J = 4/(9 l) = 4."""
    solution = pl.solve(bryson_denham(1 / 9))
    assert solution.objective == pytest.approx(4.0, abs=1e-10)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    (arc,) = solution.structure
    assert arc.description == "along room"
    assert (arc.begin, arc.end) == (pytest.approx(1 / 3, abs=1e-9), pytest.approx(2 / 3, abs=1e-9))


@pytest.mark.parametrize("ceiling", [1 / 9, 0.3])
def test_an_arc_to_the_end_is_found_and_proved(ceiling: float) -> None:
    """J = 2/(9 l): the end conditions say again what holds all along the arc, and have no multipliers of their own."""
    solution = pl.solve(parked(ceiling))
    assert solution.objective == pytest.approx(2 / (9 * ceiling), rel=1e-12)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert [arc.begin for arc in solution.structure] == [pytest.approx(3 * ceiling, abs=1e-9)]


def test_a_lander_may_ride_along_the_ground_to_its_end(tmp_path: Path) -> None:
    """A weak engine over Ceres, without a retro burn; saved and proved again. The direct method lands as much."""
    problem = hybrid_landing(
        Vehicle(mass=12e3, thrust=2.82e3, specific_impulse=371.0), None,
        Orbit(parking_altitude=138e3, perilune_altitude=14.4e3), CERES, 3.5e3,
    )  # fmt: skip
    solution = pl.solve(problem)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert [arc.description for arc in solution.structure] == ["along height above site"]
    assert solution.structure[0].end == pytest.approx(solution.trajectories[0].duration)
    direct = Pseudospectral(segments=8, nodes=5, refine=0).run(problem)
    assert solution.objective == pytest.approx(direct.objective, rel=1e-6)
    pl.save(solution, tmp_path)
    assert pl.verify(pl.load(tmp_path)).outcome is pl.Outcome.PROVED


def test_the_better_extremal_is_the_constrained_one() -> None:
    """Random costates find a curve that keeps clear and takes 3.07 s; the one that slides on the line takes 1.83 s."""
    entered, left, least = brachistochrone_truth()
    solution = pl.solve(brachistochrone())
    assert solution.objective == pytest.approx(least, abs=1e-9)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert [(arc.begin, arc.end) for arc in solution.structure] == [
        (pytest.approx(entered, abs=1e-6), pytest.approx(left, abs=1e-6))
    ]
    first, *others = [e.nature.value for e in solution.extremals]
    assert first == "best of the extremals found" and set(others) == {"local optimum"}


def test_a_glide_slope_is_touched_once() -> None:
    """As the direct method has it from a coarse mesh refined: 398.06967 kg of propellant."""
    solution = pl.solve(mars_glide_slope())
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert solution.results["propellant"].value == pytest.approx(398.069674, abs=1e-5)


@pytest.mark.parametrize("degrees", [25.0, 26.0, 28.0])
def test_a_precision_landing_touches_its_glide_slope(degrees: float) -> None:
    problem = slope(degrees)
    solution = pl.solve(problem)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    wider = pl.solve(slope(degrees - 0.5), verify=0).objective
    assert wider < solution.objective < wider + 0.1  # a steeper slope costs, and not much
    again = pl.solve(problem, guess=solution, verify=2)
    assert again.objective == pytest.approx(solution.objective, rel=1e-10)
    assert again.extremals[0].nature.value == "an extremal near the guess"


def test_arcs_that_break_a_bound_of_the_control_are_no_answer() -> None:
    """A light lander brakes backwards at first, out of bounds of an angle that no law can hold: by 117 deg, and said.

    Its steering between the bounds chatters the more the finer a mesh is, so that nothing of few arcs is best.
    """
    problem = load_file("examples/polar_descent.toml", ("vehicle.mass=12375 kg",)).problem
    with pytest.raises(pl.NotConvergedError, match="every extremal found violates a condition") as caught:
        pl.solve(problem)
    said = "structure free and touches height_above_site, free: an extremal, but azimuth above lower falls to -117.061"
    assert any(line.startswith(said) for line in caught.value.partial["attempts"])


def test_arcs_keep_a_bound_of_the_control_that_a_law_can_hold(tmp_path: Path) -> None:
    """The elevation of the same lander, whose azimuth is free: on its bound before the ground is touched."""
    lines = [line for line in Path("examples/polar_descent.toml").read_text().splitlines() if "azimuth" not in line]
    (tmp_path / "free.toml").write_text("\n".join(lines))
    bounds = ("vehicle.mass=12375 kg", "steering.elevation_lower=-46 deg")
    solution = pl.solve(load_file(str(tmp_path / "free.toml"), bounds).problem, verify=1)
    words = [arc.description for arc in solution.structure]
    assert words == ["along elevation above lower", "contact point of height above site"]
    assert solution.outcome is pl.Outcome.PROVED


def jumped(solution: Solution, amount: float) -> Solution:
    """The costate of x after its jump raised by a share of the jump, as if the touch held the flight back more."""
    flown = solution.trajectories[0]
    assert flown.costate is not None
    at = int(np.nonzero(np.diff(flown.costate.time) == 0)[0][0]) + 1
    values, rates = flown.costate.values.copy(), flown.costate.rates.copy()
    jump = values[at, 0] - values[at - 1, 0]
    values[at:, 0] += amount * jump
    costate = Curve(time=flown.costate.time, values=values, rates=rates)
    return replace(solution, trajectories=(replace(flown, costate=costate),))


@pytest.mark.parametrize("rounding", [0.0, 5e-13, -5e-13])
def test_rounding_in_a_sum_of_durations_is_not_its_size(touching: Solution, rounding: float) -> None:
    """Taken for one it drowned all other end conditions: what a flight of several phases may vary was not known."""
    from perilune.proof.feasible.phase_data import PhaseData
    from perilune.proof.necessary.contact_points import restate_with_contacts

    parts, _ = restate_with_contacts(touching)
    parts = replace(parts, free={**parts.free, "T-1": parts.free["T-1"] + rounding})
    last = PhaseData(solution=parts, index=1)
    size = dict(zip((c.name for c in last.phase.end_conditions), last.end_scale.tolist(), strict=True))
    assert size["T"] > 9e-5


def test_a_guess_of_another_problem_leads_to_the_answer_of_this_one(touching: Solution) -> None:
    lower = pl.solve(bryson_denham(0.19), guess=touching, verify=2)
    assert lower.objective == pytest.approx(bryson_denham_truth(0.19), abs=1e-12)
    assert lower.outcome is pl.Outcome.PROVED


@pytest.mark.parametrize("amount", [1e-6, -1e-6, -1.0, -2.0])
def test_another_jump_of_the_costates_is_none(touching: Solution, amount: float) -> None:
    assert not pl.verify(jumped(touching, amount), level=2).verification.passed


def test_a_touch_that_gains_by_leaving_is_no_extremal() -> None:
    """Forced to touch a ceiling that the best flight stays below, J would fall by leaving it: the sign says so."""
    from perilune.structures import Arc, Structure
    from perilune.structures.multiphase import restate
    from perilune.structures.split_join import join_solution

    problem: Any = bryson_denham(0.3)  # the free flight rises to 1/4
    structure = Structure(((Arc(touches=("room",)), Arc()),))
    restated = restate(problem, structure)
    forced = pl.Indirect().run(restated, pl.solve(restated, pl.Pseudospectral(refine=0), verify=0))
    whole = join_solution(problem, forced, structure)
    assert pl.verify(whole, level=1).verification.passed
    failed = {c.name for c in pl.verify(whole, level=2).verification.failed}
    assert "swing-1_touch" in failed


def at_the_maximum() -> Solution:
    """Along h = 0 by u = 0, where H = -u^2 has its maximum: a sawtooth lands J = -0.475."""
    from perilune.models.descent.coordinates import variables_of_unit

    phase = pl.Phase(
        name="go",
        states=(*variables_of_unit("m", "h"), *variables_of_unit("m^2/s", "c")),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (u.u, -0.5 * u.u * u.u),
        duration="T",
        path=pl.Conditions(lambda x, u, p, xp: (x.h,), above="m"),
    )
    problem = pl.Problem(
        name="at_the_maximum", phases=(phase,), start=lambda p, xp: (0 * p.T * p.v, 0 * p.T * p.v * p.v),
        given={"T": pl.Parameter(value=1.0, unit="s"), "v": pl.Parameter(value=1.0, unit="m/s")},
        objective=lambda x, p, xp: x.c, objective_unit="m^2/s",
    )  # fmt: skip
    time = np.array([0.0, 0.4, 0.4, 1.0])
    still = Curve(time=time, values=np.zeros((4, 2)), rates=np.zeros((4, 2)))
    costate = Curve(time=time, values=np.tile([0.0, 1.0], (4, 1)), rates=np.zeros((4, 2)))
    control = Curve(time=time, values=np.zeros((4, 1)), rates=np.zeros((4, 1)))
    flown = pl.Trajectory(phase="go", state=still, control=control, costate=costate)
    return Solution(
        problem=problem, method="by hand", outcome=pl.Outcome.SOLVED, objective=0.0, free={}, trajectories=(flown,)
    )


def test_riding_along_a_condition_at_a_maximum_of_the_hamiltonian_is_no_extremal() -> None:
    """Against every control, and not only that which rides."""
    failed = {c.name for c in pl.verify(at_the_maximum(), level=3).verification.failed}
    assert {"along_minimum", "along_sufficient"} <= failed


def test_a_ceiling_that_is_missed_by_little_is_not_touched() -> None:
    """The answer for a ceiling 1.5e-8 m lower, shown as one for the ceiling."""
    lower = pl.solve(bryson_denham(1 / 5 - 1.5e-8), verify=0)
    wrong = replace(lower, problem=bryson_denham(1 / 5))
    assert "swing-1_met" in {c.name for c in pl.verify(wrong, level=2).verification.failed}


def test_a_phase_of_no_length_breaks_nothing_by_rounding() -> None:
    """In a millisecond before its end at a limit a height falls by 20 cm, and ends some micrometres below it."""
    t = np.linspace(0.0, 1e-3, 50)
    assert not list(broken_intervals(t, 0.2 * (1 - t / 1e-3) - 3e-6, 6.4e6))
    assert list(broken_intervals(t, 0.2 * (1 - t / 1e-3) - 0.1, 6.4e6)) == [(t[27], 1e-3, 1e-3)]
    assert len(list(broken_intervals(t, 0.2 * (1 - t / 1e-3) - 3e-6, 1.0))) == 1


def test_what_is_broken_just_before_its_touch_is_ridden() -> None:
    """A heavy lander on Mercury skims the ground: broken from 428 to 478.2 s, touched at 478.7 s (random lander 72)."""
    problem = hybrid_landing(
        Vehicle(mass=154.3876831394529, thrust=174.5308161412424, specific_impulse=322.68904626453923),
        Retro(specific_impulse=304.05725231747493),
        Orbit(parking_altitude=90651.43049123246, perilune_altitude=8118.463553784256),
        MERCURY,
    )
    solution = pl.solve(problem, verify=2)
    assert solution.outcome is pl.Outcome.PROVED
    (arc,) = solution.structure
    assert arc.description == "along height above site" and arc.end - arc.begin == pytest.approx(18.0, abs=0.5)
    direct = Pseudospectral(nodes=5, segments=16, refine=0).run(problem, solution)
    assert direct.objective == pytest.approx(solution.objective, rel=1e-4)
