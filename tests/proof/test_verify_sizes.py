"""Limits follow the size and the conditioning of a problem: right answers of every size pass, wrong ones do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import perilune as pl
from perilune.models import Body, Orbit, Retro, Vehicle, hybrid_landing
from perilune.proof.feasible.deviations import MOST_GROWTH, Passage, PieceJoints, PieceMaps
from perilune.proof.feasible.reintegration import reintegrate

PHOBOS = Body(name="phobos", gravitational_parameter=7.087e5, radius=11.1e3, rotation_rate=2.28e-4)


@pytest.mark.parametrize("height", [5.0, 50.0, 1000.0])
def test_a_lander_that_begins_low_is_proved(landing: pl.Problem, height: float) -> None:
    """The flight stays within a millionth of the Moon's radius of the ground, and bends within metres."""
    solution = pl.solve(landing.with_given(orbit_perilune_altitude=height))
    assert solution.verification.level == 3, str(solution.verification)
    assert solution.free["retro_delta_v"] > 1500


@pytest.mark.parametrize("acceleration", [0.02, 0.1])
def test_a_lander_on_a_small_moon_is_proved(acceleration: float) -> None:
    lander = Vehicle(mass=500.0, thrust=500.0 * acceleration, specific_impulse=300.0)
    orbit = Orbit(parking_altitude=8e3, perilune_altitude=1.5e3)
    solution = pl.solve(hybrid_landing(lander, Retro(specific_impulse=280.0), orbit, PHOBOS))
    assert solution.verification.level == 3, str(solution.verification)


def runaway(rate: float) -> pl.Problem:
    """x' = rate x + u for 1 s from 1 m to 0 with least integral of u^2/2: errors grow by e^rate."""
    phase = pl.Phase(
        name="hold",
        states=(pl.Variable(name="x", unit="m"), pl.Variable(name="e", unit="m^2/s")),
        controls=(pl.ScalarControl(name="u", unit="m/s"),),
        dynamics=lambda x, u, p, xp: (p.rate * x.x + u.u, 0.5 * u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x,), rest="m"),
    )
    return pl.Problem(
        name="runaway",
        phases=(phase,),
        start=lambda p, xp: (p.x0, 0.0),
        given={
            "rate": pl.Parameter(value=rate, unit="1/s"),
            "x0": pl.Parameter(value=1.0, unit="m"),
            "T": pl.Parameter(value=1.0, unit="s"),
        },
        free=(),
        objective=lambda x, p, xp: x.e,
        objective_unit="m^2/s",
    )


def test_growth_is_that_of_the_closed_form() -> None:
    """An error of x grows by e^rate; in e it shows through nothing, as u is read from the table."""
    solution = pl.solve(runaway(3.0), verify=0)
    assert solution.objective == pytest.approx(3.0 / (1 - np.exp(-6.0)), rel=1e-9)  # rate x0^2 / (1 - e^(-2 rate T))
    (_, flight) = reintegrate(solution)[0]
    assert flight.growth == pytest.approx([np.exp(3.0), 1.0], rel=1e-6)


def test_a_phase_inherits_the_growth_of_those_before() -> None:
    """The same flight in two halves: an error at the start of the first grows by e^3 until the end of the second."""
    whole = runaway(3.0)
    first = replace(whole.phases[0], name="first", end=None)
    problem = replace(
        whole,
        phases=(first, replace(whole.phases[0], name="second")),
        links=(lambda x, p, xp: (x.x, x.e),),
        given={**whole.given, "T": pl.Parameter(value=0.5, unit="s")},
    )
    (_, early), (_, late) = reintegrate(pl.solve(problem, verify=0))
    assert early.growth == pytest.approx([np.exp(1.5), 1.0], rel=1e-6)
    assert late.growth == pytest.approx([np.exp(3.0), 1.0], rel=1e-6)


@pytest.mark.parametrize("jumps", [False, True])
@pytest.mark.parametrize("peak", ["early", "late"])
def test_growth_is_the_most_of_all_stretches_from_the_start_or_to_the_end(peak: str, jumps: bool) -> None:
    """Against the products of the pieces' matrices written out, which do not commute, with a jump between two."""
    random = np.random.default_rng(3)
    sizes = np.array([6.0, 3.0, 0.2, 0.1, 0.5] if peak == "early" else [0.1, 0.2, 0.5, 6.0, 3.0])
    past = random.normal(size=(5, 3, 3)) * sizes[:, None, None]
    over = {1: np.eye(3) + random.normal(size=(3, 3))} if jumps else {}
    links = [over[i] @ each if i in over else each for i, each in enumerate(past)]
    stretches = [links[:k] for k in range(1, 6)] + [links[k:] for k in range(5)]
    products = [np.linalg.multi_dot([np.eye(3), *stretch[::-1]]) for stretch in stretches]
    most = np.max([np.abs(product).sum(axis=1) for product in products], axis=0)
    maps = PieceMaps(np.zeros((5, 3, 4)), np.zeros((5, 3, 4, 3)), np.zeros((5, 3)), past)
    found = Passage.over_pieces(maps, PieceJoints(np.zeros(3), np.zeros((3, 4)), over))
    assert found.growth == pytest.approx(np.clip(most, 1.0, MOST_GROWTH), rel=1e-12)
    assert (most > 1).all() and (most < MOST_GROWTH).all()


@pytest.mark.parametrize("rate", [0.1, 3.0, 6.0])
def test_an_error_is_found_however_a_flight_multiplies_it(rate: float) -> None:
    """A right answer is proved; the same with 1e-7 of its control added is not."""
    solution = pl.solve(runaway(rate))
    assert solution.verification.level == 3, str(solution.verification)
    flown = solution.trajectories[0]
    control = replace(flown.control, values=flown.control.values * (1 + 1e-7))
    wrong = replace(solution, trajectories=(replace(flown, control=control),))
    assert pl.verify(wrong).verification.level == 0


def arrival(clock: float) -> pl.Problem:
    """10 m from rest to rest with least time of arrival and effort, by a clock that does not begin at 0."""
    phase = pl.Phase(
        name="go",
        states=tuple(
            pl.Variable(name=name, unit=unit) for name, unit in (("x", "m"), ("v", "m/s"), ("t", "s"), ("e", "m^2/s^3"))
        ),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 1.0, 0.5 * u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.distance, x.v), place="m", rest="m/s"),
    )
    return pl.Problem(
        name="arrival",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, p.clock, 0.0),
        given={
            "distance": pl.Parameter(value=10.0, unit="m"),
            "clock": pl.Parameter(value=clock, unit="s"),
            "worth": pl.Parameter(value=1.0, unit="s^4/m^2"),
        },
        free=(pl.FreeParameter(name="T", unit="s", lower=0.1, upper=100.0, guess=5.0),),
        objective=lambda x, p, xp: x.t + p.worth * x.e,
        objective_unit="s",
        scales=pl.Scales(length=10.0, time=5.0),
    )


@pytest.mark.parametrize("clock", [0.0, 1.7e9])
def test_a_constant_in_the_objective_loosens_no_limit(clock: float) -> None:
    """J = clock + T + 6 d^2/T^3 is least at T = (18 d^2)^(1/4), whatever the clock says."""
    problem = arrival(clock)
    best = pl.solve(problem)
    assert best.outcome is pl.Outcome.PROVED, str(best.verification)
    assert best.free["T"] == pytest.approx(1800.0**0.25, rel=1e-9)
    late = 1.1 * best.free["T"]
    held = pl.solve(problem.with_given(T=late), verify=0)
    claim = pl.verify(replace(held, problem=problem, free={"T": late})).verification
    assert [c.name for c in claim.failed if c.level == 2] == ["stationary_T"]
    early = replace(best, objective=best.objective - 0.01)
    assert [c.name for c in pl.verify(early, level=1).verification.failed] == ["objective"]


@pytest.mark.parametrize("scales", [pl.Scales(length=1e12), pl.Scales(length=1e12, time=1e9, mass=1e12)])
def test_scales_loosen_no_limit(hybrid: pl.Solution, scales: pl.Scales) -> None:
    """A file states them too: a landing that misses by some metres fails level 1 whatever it says of sizes."""
    flown = hybrid.trajectories[0]
    turned = replace(flown, control=replace(flown.control, values=flown.control.values + 1e-3))
    of_size = replace(hybrid, problem=replace(hybrid.problem, scales=scales))
    assert pl.verify(replace(of_size, trajectories=(turned,)), level=1).verification.level == 0
    assert pl.verify(replace(of_size, objective=hybrid.objective - 1.0), level=1).verification.level == 0


@pytest.mark.parametrize("late", [0.5, 1e-3])
def test_a_clock_that_begins_late_hides_nothing_in_its_table(late: float) -> None:
    """A clock of 1.7e9 s rounds at 2e-7 s; in a flight of 7 s it may be no more off than that."""
    best = pl.solve(arrival(1.7e9))
    assert best.verification.level == 3, str(best.verification)
    assert [c.name for c in pl.verify(moved_by(best, 2, late)).verification.failed] == ["state_t"]


def moved_by(solution: pl.Solution, state: int, amount: float) -> pl.Solution:
    """The same with one state of its table shifted."""
    flown = solution.trajectories[0]
    values = flown.state.values.copy()
    values[:, state] += amount
    return replace(solution, trajectories=(replace(flown, state=replace(flown.state, values=values)),))


def far(origin: float, length: float, gravity: float = 0.0) -> pl.Problem:
    """10 m up from rest to rest in 5 s with least effort, the height counted from a far place."""
    phase = pl.Phase(
        name="rise",
        states=tuple(pl.Variable(name=n, unit=unit) for n, unit in (("x", "m"), ("v", "m/s"), ("e", "m^2/s^3"))),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u - p.g * (p.x0 + p.R) ** 2 / (x.x + p.R) ** 2, 0.5 * u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.x1, x.v), place="m", rest="m/s"),
    )
    numbers = {"x0": (origin, "m"), "x1": (origin + 10.0, "m"), "R": (1.7e6 - origin, "m"), "T": (5.0, "s")}
    numbers["g"] = (gravity, "m/s^2")
    return pl.Problem(
        name="far",
        phases=(phase,),
        start=lambda p, xp: (p.x0, 0.0, 0.0),
        given={name: pl.Parameter(value=value, unit=unit) for name, (value, unit) in numbers.items()},
        objective=lambda x, p, xp: x.e,
        objective_unit="m^2/s^3",
        scales=pl.Scales(length=length, time=5.0),
    )


@pytest.mark.parametrize("gravity", [0.0, 1.62])
@pytest.mark.parametrize("length", [10.0, 1e3, 1.7e6])
@pytest.mark.parametrize("origin", [0.0, 1.7e6])
def test_where_a_state_is_counted_from_changes_no_proof(origin: float, length: float, gravity: float) -> None:
    """6 d^2/T^3 and what holding against gravity takes, within 1e-4; 1e-4 m in the table is seen."""
    best = pl.solve(far(origin, length, gravity))
    assert best.verification.level == 3, str(best.verification)
    assert best.objective == pytest.approx(6 * 10.0**2 / 5.0**3 + 0.5 * gravity**2 * 5.0, rel=1e-4)
    assert "state_x" in [c.name for c in pl.verify(moved_by(best, 0, 1e-4), level=1).verification.failed]


def fall_after_an_instant() -> pl.Problem:
    """Pushed for 1 s, left alone for 1 us, then for 5 s on a saddle with rates 1/s and -2/s, to x = 0: least effort."""
    states = tuple(pl.Variable(name=n, unit=unit) for n, unit in (("x", "m"), ("v", "m/s"), ("e", "m^2/s^3")))
    push = pl.Phase(
        name="push", states=states, controls=(pl.ScalarControl(name="u", unit="m/s^2"),), duration="T",
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u),
    )  # fmt: skip
    instant = replace(push, name="instant", controls=(), duration="moment", dynamics=lambda x, u, p, xp: (x.v, 0, 0))
    fall = pl.Phase(
        name="fall", states=states, duration="falls", end=pl.Conditions(lambda x, p, xp: (x.x,), *states[:1]),
        dynamics=lambda x, u, p, xp: (x.v, (2 * x.x / p.T - x.v) / p.T, 0), 
    )  # fmt: skip

    def link(x, p, xp):
        return x.x, x.v, x.e

    given = {"T": (1.0, "s"), "moment": (1e-6, "s"), "falls": (5.0, "s"), "far": (1.0, "m")}
    return pl.Problem(
        name="fall_after_an_instant",
        phases=(push, instant, fall),
        links=(link, link),
        start=lambda p, xp: (p.far, 0.0, 0.0),
        given={n: pl.Parameter(value=v, unit=unit) for n, (v, unit) in given.items()},
        objective=lambda x, p, xp: x.e,
        objective_unit="m^2/s^3",
    )


@pytest.mark.parametrize(("error", "passes"), [(1e-10, True), (1e-8, False)])
def test_before_an_instant_costates_are_known_as_those_behind_it(error: float, passes: bool) -> None:
    """An error of lam as the fall ends is 150 times as large as it begins, and all that the instant moves is 1e-6."""
    solution = pl.solve(fall_after_an_instant())
    fall = solution.trajectories[2]
    assert solution.verification.level == 3 and fall.costate is not None
    time = fall.costate.time
    grown = error * np.exp(time[-1] - time)[:, None] * np.array([2.0, 1.0, 0.0])  # lam' = -A'lam, lam ~ e^-t
    costate = replace(fall.costate, values=fall.costate.values + grown, rates=fall.costate.rates - grown)
    moved = replace(solution, trajectories=(*solution.trajectories[:2], replace(fall, costate=costate)))
    failed = {check.name for check in pl.verify(moved, level=2).verification.failed}
    assert failed == set() if passes else {"instant_transversality", "fall_transversality"} <= failed
