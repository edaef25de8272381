"""What a direct run begins with: a straight line, or the flight under its controls where that winds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import perilune as pl
from perilune.core import NUMERIC
from perilune.direct.collocated_solution import Sampler
from perilune.direct.first_guess import first_guesses
from perilune.direct.propagated_guess import NODES, fitting_segments, simulate_guess, winds_repeatedly
from perilune.models import MOON, Orbit, Vehicle, hybrid_landing
from perilune.problem import Problem, admissible
from problems import LIBRARY
from problems.ascents import TWO_STAGES, staged_launch
from problems.constrained import deorbit, mars_glide_slope
from problems.landings import meditch
from problems.transfers import dionysus


def flown(problem: Problem) -> list[Sampler]:
    free, lines, _ = next(first_guesses(problem, None))
    found = simulate_guess(problem, free, lines)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def transfer() -> pl.Solution:
    return pl.solve(dionysus(), pl.Pseudospectral(), verify=2)


def test_five_revolutions_by_default(transfer: pl.Solution) -> None:
    """No setting, no guess; the indirect method and the mesh alone, refined, lead to the same twelve switches."""
    assert transfer.outcome is pl.Outcome.PROVED and transfer.verification.level == 2
    for rival in (pl.solve(dionysus(), verify=0), pl.Pseudospectral(tolerance=1e-8, refine=40).run(dionysus())):
        assert transfer.objective == pytest.approx(rival.objective, rel=1e-8)
    switches = np.diff(transfer.trajectories[0].time) == 0
    assert int(switches.sum()) == 12
    assert sum("integrated under its controls" in line for line in transfer.statistics.attempts) == 1


def test_a_flight_that_winds_keeps_the_dynamics_and_gives_the_mesh() -> None:
    problem = dionysus()
    (guess,) = flown(problem)
    (segments,) = fitting_segments([guess])
    assert winds_repeatedly([guess])
    assert segments == 10 and segments * NODES == 80
    p, phase, duration = problem.parameters({}), problem.phases[0], problem.given["flight_time"].value

    def flow(at: float, x: np.ndarray) -> np.ndarray:
        return duration * np.array(
            phase.rates(list(x), list(admissible(phase.controls, guess(np.array([at]))[1].T, p)[:, 0]), p)
        )

    t = np.linspace(0.0, 1.0, 40)
    exact = solve_ivp(flow, (0.0, 1.0), guess(np.zeros(1))[0][0], "RK45", t_eval=t, rtol=1e-8, max_step=0.01).y
    assert guess(t)[0].T == pytest.approx(exact, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("name", [a.name for a in LIBRARY])
def test_what_does_not_wind_is_left_alone(name: str) -> None:
    problem = next(a for a in LIBRARY if a.name == name).make()
    assert not winds_repeatedly(flown(problem))


def test_three_quarters_round_in_one_leg() -> None:
    """No straight line is a picture of 275 degrees; 4443.896 s is known from two legs that say where they end."""
    coarse = pl.Pseudospectral(segments=8, nodes=5, refine=0).run(deorbit(1))
    assert coarse.objective == pytest.approx(4443.89648, abs=1.0)
    assert any("nearest miss, integrated under its controls: solved" in line for line in coarse.statistics.attempts)


def test_phases_are_flown_one_after_the_other() -> None:
    problem = staged_launch(TWO_STAGES, 60e3, 1700.0)
    first, second = flown(problem)
    p = problem.parameters({f.name: f.guess for f in problem.free})
    ended = problem.phases[0].state_record(*first(np.array([1.0]))[0][0])
    assert second(np.array([0.0]))[0][0] == pytest.approx(problem.links[0](ended, p, NUMERIC), rel=1e-9)


def test_what_cannot_be_flown_to_the_end_is_no_guess() -> None:
    """A mass that runs out on the way."""
    problem = meditch().with_given(m=0.2)
    free, lines, _ = next(first_guesses(problem, None))
    assert simulate_guess(problem, free, [lambda at: (lines[0](at)[0], np.full((len(at), 1), 1.2))]) is None


def test_an_ordinary_problem_is_solved_from_the_straight_line_alone() -> None:
    tried = pl.Pseudospectral().run(mars_glide_slope()).statistics.attempts
    assert tried[0].startswith("straight line, durations x 1: solved")
    assert not any("flown" in line for line in tried)


def test_a_flight_of_too_many_turns_is_given_up() -> None:
    """A thrust that brakes for a million years, which a thrust of a million times as much does in one."""
    orbit = Orbit(parking_altitude=100e3, perilune_altitude=15e3)
    heavy, light = (Vehicle(mass=mass, thrust=440.0, specific_impulse=310.0) for mass in (4e9, 3e3))
    assert flown(hybrid_landing(light, None, orbit, MOON))
    problem = hybrid_landing(heavy, None, orbit, MOON)
    free, lines, _ = next(first_guesses(problem, None))
    assert simulate_guess(problem, free, lines) is None


def test_a_straight_line_is_drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the first attempt fails it is looked at whether the flight under its controls winds."""
    from perilune.direct import first_guess

    drawn = list[int]()
    straight = first_guess._straight_lines

    def counted(problem: Problem, free: dict[str, float]) -> list[Sampler]:
        drawn.append(1)
        return straight(problem, free)

    monkeypatch.setattr(first_guess, "_straight_lines", counted)
    with pytest.raises(pl.PeriluneError):
        pl.Pseudospectral(iterations=1).run(meditch())
    assert len(drawn) == len(first_guess.STRETCHES)


def test_starts_that_lead_nowhere_share_the_iterations_of_one() -> None:
    """Each search for the least miss fails within 5 iterations, and so do the 5 that all starts have together.

    The first start, of which as many iterations were seen before, is not tried again.
    """
    with pytest.raises(pl.PeriluneError) as caught:
        pl.Pseudospectral(iterations=5).run(meditch())
    partial = caught.value.partial  # type: ignore[attr-defined]
    first, *last = [line for line in partial["attempts"] if not line.startswith(("nearest miss", "from there"))]
    assert first.endswith("not solved in 5 iterations")
    assert len(last) == 4 and all(line.endswith("not solved in 1 iterations") for line in last)
    assert first.partition(":")[0] not in {line.partition(":")[0] for line in last}
    assert not partial["converged"]
