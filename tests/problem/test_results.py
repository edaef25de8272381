"""What a problem asks of its solution: where the velocity change has gone, by an independent quadrature; views."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.integrate import quad

import perilune as pl
from perilune import Indirect, Pseudospectral
from perilune.core import Outcome, PeriluneError
from perilune.io import extremals_document, solution_document
from perilune.problem.display.views import ComparisonFlight, Views
from perilune.problem.results.extremal import Nature
from perilune.problem.results.solution import Result, Solution
from perilune.report.figures import label, solution_figures
from perilune.report.summary import solution_markdown, solution_summary
from perilune.scenario import load_file
from perilune.solve import solve
from perilune.verify import verify
from perilune_papers.peng2012.case import peng_descent, problem_of_the_paper
from problems.ascents import tangent_steering

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def flights(hybrid: Solution, ordinary: Solution) -> dict[str, Solution]:
    """One flight of each model; of the descent in both coordinate systems."""
    precision = load_file(EXAMPLES / "precision_landing.toml").problem
    return {
        "hybrid": hybrid,
        "ordinary": ordinary,
        "cartesian": solve(peng_descent(), verify=0),
        "spherical": Pseudospectral(nodes=50, refine=0).run(problem_of_the_paper()),
        "precision": solve(precision, verify=0),
    }


MODELS = ("hybrid", "ordinary", "cartesian", "spherical", "precision")


def over_ground(solution: Solution, t: float) -> tuple[Any, Any, Any]:
    """Velocity over the ground, thrust acceleration and felt gravity, from the inertial view and Newton's law alone."""
    p = solution.parameters
    r, v, push = (vector[:, 0] for vector in solution.inertial(0, np.array([t])))
    omega = np.array([0.0, 0.0, p.body_rotation_rate])
    gravity = -p.body_gravitational_parameter * r / np.linalg.norm(r) ** 3
    return v - np.cross(omega, r), push, gravity - np.cross(omega, np.cross(omega, r))


@pytest.mark.parametrize("name", MODELS)
def test_velocity_change_is_split_without_a_rest(flights: dict[str, Solution], name: str) -> None:
    """dv = speed lost + gravity loss + steering loss; each alone by adaptive quadrature in inertial axes."""
    solution = flights[name]
    found = {key: result.value for key, result in solution.results.items()}
    end = solution.trajectories[0].duration
    time = solution.trajectories[0].time
    switches = time[1:][np.diff(time) == 0]  # a node that is there twice
    assert (len(switches) > 0) == (name == "precision")

    def integral(rate: Any) -> float:
        pieces = pairwise([0.0, *switches, end])
        return sum(quad(rate, a, b, epsabs=1e-9, epsrel=1e-11, limit=400)[0] for a, b in pieces if b > a)

    def falling(t: float) -> float:
        v, _, pull = over_ground(solution, t)
        return float(pull @ v / np.linalg.norm(v))

    def astray(t: float) -> float:
        v, push, _ = over_ground(solution, t)
        return float(np.linalg.norm(push) + push @ v / np.linalg.norm(v))

    assert found["gravity_loss"] == pytest.approx(integral(falling), abs=2e-7)
    assert found["steering_loss"] == pytest.approx(integral(astray), abs=2e-7)
    first, last = (np.linalg.norm(over_ground(solution, t)[0]) for t in (0.0, end))
    split = first - last + found["gravity_loss"] + found["steering_loss"]
    assert found["main_delta_v"] == pytest.approx(split, abs=2e-7)


@pytest.mark.parametrize("name", MODELS)
def test_velocity_change_by_the_rocket_equation(flights: dict[str, Solution], name: str) -> None:
    """Tsiolkovsky: one exhaust speed, whatever the throttle did."""
    solution, p = flights[name], flights[name].parameters
    masses = solution.trajectories[0].state.values[[0, -1], -1]
    expected = p.vehicle_specific_impulse * p.vehicle_standard_gravity * math.log(masses[0] / masses[1])
    assert solution.results["main_delta_v"].value == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("name", MODELS)
def test_inertial_view_obeys_newton(flights: dict[str, Solution], name: str) -> None:
    """r' = v and v' = -mu r/r^3 + thrust: no turning axes left."""
    solution, p, step = flights[name], flights[name].parameters, 1e-2
    for share in (0.2, 0.7):
        t = share * solution.trajectories[0].duration + step * np.array([-1.0, 0.0, 1.0])
        r, v, push = solution.inertial(0, t)
        slope, bend = (r[:, 2] - r[:, 0]) / (2 * step), (v[:, 2] - v[:, 0]) / (2 * step)
        newton = push[:, 1] - p.body_gravitational_parameter * r[:, 1] / np.linalg.norm(r[:, 1]) ** 3
        assert slope == pytest.approx(v[:, 1], abs=1e-4)
        assert bend == pytest.approx(newton, abs=2e-5)


def test_masses_count_what_the_retro_burn_took(hybrid: Solution, ordinary: Solution) -> None:
    """Propellant is counted from the vehicle's mass on; Cho et al. Table 1."""
    found = hybrid.results
    assert found["landed_mass"].value + found["propellant"].value == pytest.approx(300.0, abs=1e-12)
    assert found["propellant"].value == pytest.approx(139.3814, abs=5e-5)
    assert hybrid.trajectories[0].state.values[0, 4] < 210.0
    assert found["delta_v"].value == hybrid.free["retro_delta_v"]
    assert ordinary.results["delta_v"].value == 0.0
    assert all(result.description for result in found.values())


def test_a_problem_that_asks_nothing_has_flight_time_and_objective() -> None:
    """Any problem has results, JSON, extremals and figures: each state, control and costate."""
    plain = tangent_steering()
    solution = solve(plain, verify=0)
    assert list(solution.results) == ["flight_time", "objective"]
    assert solution.results["objective"] == Result(value=solution.objective, unit=plain.objective_unit, description="J")
    document = solution_document(solution)
    assert set(document["results"]) == {"flight_time", "objective"}
    assert document["extremals"][0]["objective"] == solution.objective
    drawn = solution_figures(solution)
    phase = plain.phases[0]
    assert set(drawn) == {"states", "controls", "costates", "hamiltonian"}
    assert len(drawn["states"].axes) == len(phase.states)
    assert len(drawn["controls"].axes) == len(phase.control_names)


def test_phases_add_to_one_integral() -> None:
    """Constant acceleration spends a times t, in one phase or in two."""
    stated = tangent_steering(split=True)
    spent = {"integrals": pl.Quantities(lambda x, u, p, xp: (p.a,), spent="m/s")}
    solution = solve(replace(stated, phases=tuple(replace(phase, **spent) for phase in stated.phases)), verify=0)
    whole = sum(trajectory.duration for trajectory in solution.trajectories)
    assert len(solution.trajectories) == 2
    assert solution.results["spent"].value == pytest.approx(solution.parameters.a * whole, rel=1e-12)
    for name, figure in solution_figures(solution).items():  # every phase is drawn
        assert max(float(np.asarray(line.get_xdata())[-1]) for line in figure.axes[0].lines) == pytest.approx(
            whole, rel=1e-2
        ), name


# -- what is stated wrongly
# ------------------------------------------------------------------------------------------------------


def test_a_result_of_another_dimension_is_refused(landing: Any) -> None:
    """As the dynamics are, when the problem is made."""
    with pytest.raises(PeriluneError, match="results, landed_mass"):
        replace(
            landing,
            results=pl.Quantities(lambda first, last, p, xp: (last.m * last.r,), landed_mass="kg"),
            views=Views(),
        )


def test_a_number_too_few_is_refused(landing: Any) -> None:
    """Results, integrals and views return what they name."""
    with pytest.raises(PeriluneError, match="results returns the wrong number of values"):
        replace(landing, results=pl.Quantities.of(lambda first, last, p, xp: (last.m,), landing.result_variables))
    phase = landing.phases[0]
    nothing = pl.Quantities.of(lambda x, u, p, xp: (), phase.integral_variables)
    for wrong in ({"integrals": nothing}, {"inertial": lambda x, u, t, p, xp: (x.r,)}):
        with pytest.raises(PeriluneError, match="wrong number of values"):
            replace(landing, phases=(replace(phase, **wrong),))


def test_an_unknown_result_cannot_be_maximised(landing: Any) -> None:
    """The name is looked up where the results are named."""
    with pytest.raises(PeriluneError, match="did you mean 'landed_mass'"):
        replace(landing, maximised="landed_mas")


@pytest.mark.parametrize(
    ("views", "message"),
    [
        (Views(label="{delta_w:.1f}"), "no result of this name"),
        (Views(radius="body_radios"), "did you mean 'body_radius'"),
        (Views(comparison=ComparisonFlight(given=(("retro", 0.0),), label="plain")), "no parameter of this name"),
        (Views(height="altitud"), "did you mean 'altitude'"),
    ],
)
def test_views_name_what_is_there(landing: Any, views: Views, message: str) -> None:
    """Refused when the problem is made, not when it is drawn."""
    with pytest.raises(PeriluneError, match=message):
        replace(landing, views=views)


def test_times_may_be_a_list_as_elsewhere(hybrid: Solution) -> None:
    view = cast("Any", hybrid.inertial)(0, [0.0, 1.0])
    assert all(np.array_equal(*both) for both in zip(view, hybrid.inertial(0, np.array([0.0, 1.0])), strict=True))


def test_no_inertial_view_is_said(hybrid: Solution) -> None:
    """By name, with what to state."""
    blind = replace(hybrid.problem, phases=(replace(hybrid.problem.phases[0], inertial=None),))
    with pytest.raises(PeriluneError, match=r"no inertial view[\s\S]*Phase\(inertial"):
        replace(hybrid, problem=blind).inertial(0, np.zeros(1))


# -- words that claim no more than was done
# ------------------------------------------------------------------------------------------------------


def test_a_lone_extremal_from_a_guess_is_not_called_best(landing: Any, hybrid: Solution, ordinary: Solution) -> None:
    """It was compared with no other."""
    again = solve(landing, guess=hybrid, verify=0)
    assert again.statistics.initialization == "guess"
    assert [e.nature for e in again.extremals] == [Nature.NEAR_GUESS]
    assert hybrid.extremals[0].nature is Nature.BEST
    assert "global" not in " ".join(nature.value for nature in Nature)


def test_older_words_are_still_read() -> None:
    """Saved solutions of before say "global optimum"."""
    assert Nature("global optimum") is Nature.BEST
    assert Nature("global optimum, at a bound") is Nature.BEST_AT_BOUND
    with pytest.raises(ValueError, match="nice"):
        Nature("nice")


def test_extremals_are_told_by_what_their_parameters_decide(hybrid: Solution) -> None:
    """The retro burn and the flight time of each; the mass from J, whose negative it is."""
    rows = extremals_document(hybrid)
    assert [round(row["delta_v"]) for row in rows] == [1201, 0, 129]
    assert [row["landed_mass"] for row in rows] == [-e.objective for e in hybrid.extremals]
    assert rows[0]["flight_time"] == hybrid.free["flight_time"]
    assert "propellant" not in rows[0]  # it needs the flight


def test_results_receive_the_records_that_all_physics_does(hybrid: Solution) -> None:
    """Of an extremal the states at its ends are not known: NaN in a record of the same type, and not of another."""
    stated = hybrid.problem.results
    assert stated is not None

    def asked(first: Any, last: Any, p: Any, xp: Any) -> Any:
        assert last._fields == hybrid.problem.phases[-1].state_names
        return stated(first._replace(m=first.m), SimpleNamespace(**last._asdict()), p, xp)

    by_record = replace(
        hybrid, problem=replace(hybrid.problem, results=pl.Quantities.of(asked, hybrid.problem.result_variables))
    )
    assert extremals_document(by_record) == extremals_document(hybrid)
    assert by_record.results == hybrid.results


def test_legends_come_from_the_problem(hybrid: Solution, ordinary: Solution) -> None:
    """By the results' values, or the words for the plainer flight."""
    assert label(hybrid) == "hybrid, ΔV = 1200.9 m/s"
    assert label(ordinary) == "ordinary, no retro burn"
    plain: Any = replace(hybrid.problem, views=replace(hybrid.problem.views, label="", comparison=None))
    assert label(replace(hybrid, problem=plain)) == hybrid.problem.title


def test_of_a_loaded_solution_how_it_was_found_is_the_files_word(hybrid: Solution) -> None:
    """Named in the document, and not repeated in words; a solution made here claims nothing."""
    loaded = replace(hybrid, outcome=Outcome.SOLVED, statistics=replace(hybrid.statistics, from_file=True))
    assert solution_document(loaded)["unverified_claims"] == ["method", "statistics"]
    assert "unverified_claims" not in solution_document(hybrid)
    for words in (solution_summary, solution_markdown):
        assert "method indirect" not in words(loaded) and "method indirect" in words(hybrid)
        assert "those listed in the file, each recomputed" in words(loaded)
        assert "found again" not in words(hybrid)


# -- what is no guess, and no time
# ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", [Indirect(), Pseudospectral()])
@pytest.mark.parametrize("guess", [3, {"retro_delta_v": 1200.0}, np.zeros(4), [None]])
def test_a_guess_is_a_solution(landing: Any, method: Any, guess: Any) -> None:
    """Anything else is refused in one sentence that says what it was."""
    with pytest.raises(PeriluneError, match=rf"the guess is not a solution\s+got: {type(guess).__name__}"):
        method.run(landing, guess)


@pytest.mark.parametrize("t", [np.nan, np.array([1.0, np.nan])])
def test_a_curve_is_not_asked_at_no_time(hybrid: Solution, t: Any) -> None:
    """NaN is a time outside; it would come out as NaN in silence."""
    with pytest.raises(PeriluneError, match=r"outside its time\s+got: nan s"):
        hybrid.trajectories[0].state(t)


def endless(time: float) -> pl.Problem:
    """From rest to rest with the least int (u^2 - k^2 x^2)/2: in time enough x swings without limit, and J falls."""
    phase = pl.Phase(
        name="swing",
        states=tuple(pl.Variable(name=n, unit=unit) for n, unit in (("x", "m"), ("v", "m/s"), ("e", "m^2/s^3"))),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * (u.u * u.u - p.k * p.k * x.x * x.x)),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.L, x.v), place="m", rest="m/s"),
    )
    numbers = {"T": (time, "s"), "L": (1.0, "m"), "k": (1.0, "1/s^2")}
    return pl.Problem(
        name="endless", phases=(phase,), start=lambda p, xp: (0.0, 0.0, 0.0),
        given={name: pl.Parameter(value=value, unit=unit) for name, (value, unit) in numbers.items()},
        objective=lambda x, p, xp: x.e, objective_unit="m^2/s^3",
    )  # fmt: skip


@pytest.mark.parametrize(("time", "nature"), [(4.0, Nature.BEST), (5.5, Nature.UNPROVED), (8.0, Nature.UNPROVED)])
def test_what_is_not_proved_is_called_no_optimum(time: float, nature: Nature, tmp_path: Path) -> None:
    """There is none beyond cos(kT) cosh(kT) = 1, at 4.73 s, and no search that ends has found the best of anything."""
    solution = solve(endless(time))
    assert (solution.outcome is Outcome.PROVED) == (nature is Nature.BEST)
    assert [e.nature for e in solution.extremals] == [nature]
    assert ("conjugate_point" in [c.name for c in solution.verification.failed]) == (nature is Nature.UNPROVED)
    pl.save(solution, tmp_path / "endless")
    again = verify(pl.load(tmp_path / "endless"), 3)
    assert again.outcome is solution.outcome and "best" not in again.extremals[0].nature.value


@pytest.mark.parametrize("split", [False, True])
def test_a_flight_says_how_long_all_of_it_takes(split: bool) -> None:
    """In one phase and in two, of which each is shorter."""
    found = solve(tangent_steering(split), Indirect(), verify=0)
    assert found.duration == pytest.approx(0.554570878334603, rel=1e-12)
    assert len(found.trajectories) == 1 + split
