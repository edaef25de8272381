"""Cho, Kim, Leeghim 2015 against its printed values and against independently computed ones."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from cho import CHO_MOON, cho_landing
from perilune import Indirect
from perilune.core import NUMERIC, InfeasibleError, Outcome, PeriluneError
from perilune.models.landing.problem import Orbit, Retro, Vehicle, hybrid_landing, perilune_speed
from perilune.problem import Nature, Parameter, Problem, Solution
from perilune.report.summary import solution_summary
from perilune.solve import solve


def test_perilune_speed(landing: Problem) -> None:
    """(25), printed to 1e-5 m/s."""
    assert perilune_speed(landing.parameters({}), NUMERIC) == pytest.approx(1691.96926, abs=1e-5)


def test_ordinary_landing(ordinary: Solution) -> None:
    """Table 1 and its independent recomputation."""
    assert -ordinary.objective == pytest.approx(154.54135, abs=1e-5)
    assert ordinary.free["flight_time"] == pytest.approx(1005.3507, abs=1e-3)


def test_hybrid_landing(hybrid: Solution) -> None:
    """Table 1, (26) recomputed."""
    assert -hybrid.objective == pytest.approx(160.618584, abs=1e-6)
    assert hybrid.free["retro_delta_v"] == pytest.approx(1200.944, abs=1e-3)
    assert hybrid.free["flight_time"] == pytest.approx(286.864, abs=1e-3)


def test_ignition_is_straight_retro(hybrid: Solution) -> None:
    """Equal Isp, H = 0 and (19) together give lambda_v(0) = 0: beta(0) is 180 degrees exactly."""
    angle = math.degrees(hybrid.outputs(0, np.array([0.0]))["thrust_angle"][0])
    assert angle == pytest.approx(180.0, abs=1e-9)


def test_claims_of_the_figures(hybrid: Solution, ordinary: Solution) -> None:
    """Figs 2-7: the ordinary landing climbs first, the hybrid never does, and takes under a third of the time."""
    assert hybrid.free["flight_time"] < ordinary.free["flight_time"] / 3
    radial = hybrid.trajectories[0].state(np.linspace(0, hybrid.free["flight_time"], 500))[:, 3]
    assert radial.max() <= 1e-9
    angle = hybrid.outputs(0, np.linspace(0, hybrid.free["flight_time"], 500))["thrust_angle"]
    assert np.degrees(angle).max() <= 180.0 + 1e-9
    altitude = ordinary.outputs(0, np.linspace(0, 400, 200))["altitude"]
    assert altitude.max() > 15e3 + 100.0


def test_every_extremal_is_found(hybrid: Solution) -> None:
    """The global maximum of landed mass, delta_v = 0 as a local one, and the local minimum between them."""
    found = {e.nature: e for e in hybrid.extremals}
    assert len(hybrid.extremals) == 3
    assert found[Nature.BEST].free["retro_delta_v"] == pytest.approx(1200.944, abs=1e-3)
    assert found[Nature.LOCAL_OPTIMUM_AT_BOUND].free["retro_delta_v"] == 0.0
    assert found[Nature.WORST].free["retro_delta_v"] == pytest.approx(130.0, abs=5.0)
    assert found[Nature.WORST].objective > found[Nature.LOCAL_OPTIMUM_AT_BOUND].objective


def test_the_best_from_low_over_the_site_is_found(landing: Problem) -> None:
    """From 1 m over it nearly all speed is best lost by the burn; the costates of that flight are in the hundreds.

    Against fixed burns beside the one that is found, and against what no flight can land: the rocket equation's.
    """
    low = landing.with_given(orbit_perilune_altitude=1.0)
    found = solve(low, verify=0)
    burn, landed = found.free["retro_delta_v"], -found.objective
    assert [round(e.free["retro_delta_v"]) for e in found.extremals] == [1694, 0, 212]
    assert found.extremals[0].nature is Nature.BEST and landed == pytest.approx(171.5345, abs=1e-4)
    beside = [-solve(low.with_given(retro_delta_v=burn + change), verify=0).objective for change in (-1.0, 1.0)]
    assert landed > max(beside) > landed - 0.02
    p = low.parameters(found.free)
    least = perilune_speed(p, NUMERIC) - p.body_rotation_rate * p.body_radius
    assert landed < 300.0 * math.exp(-least / (310.0 * 9.81)) < landed + 0.12
    assert found.statistics.attempts[0] == "a family along retro.delta_v from 0 to 1702.81 m/s: 3 extremals"


@pytest.mark.parametrize("height", [0.3, 0.03, 0.01, 0.003])
def test_the_best_from_a_hand_over_the_site_is_found(landing: Problem, height: float) -> None:
    """So short a flight costs in proportion to its time, as the root of the height; from 3 cm on it is proved."""
    far, near = (-solve(landing.with_given(orbit_perilune_altitude=h), verify=0).objective for h in (1.0, 0.1))
    low = solve(landing.with_given(orbit_perilune_altitude=height))
    slope = (near - far) / (1.0 - math.sqrt(0.1))
    assert -low.objective == pytest.approx(near + slope * (math.sqrt(0.1) - math.sqrt(height)), abs=1e-3)
    assert len(low.extremals) == 3 and all(e.free["flight_time"] > 0 for e in low.extremals)
    if height >= 0.03:
        assert low.outcome is Outcome.PROVED, str(low.verification)


@pytest.mark.parametrize("seed", [1, 3])
def test_where_a_walk_begins_does_not_decide_what_is_found(landing: Problem, seed: int) -> None:
    """From 5 mm over the site costates grow to 1e4 within the last of 33 steps: each start has to come through."""
    found = solve(landing.with_given(orbit_perilune_altitude=0.005), Indirect(seed=seed), verify=0)
    assert -found.objective == pytest.approx(171.6279, abs=1e-4) and len(found.extremals) == 3


def test_a_fixed_burn_that_leaves_a_short_flight_is_no_refusal(landing: Problem) -> None:
    """2.8 s where the same lander without a burn takes 1000: direct starts that shrink to nothing say nothing of it."""
    short = landing.with_given(orbit_perilune_altitude=1.0, retro_delta_v=1692.81)
    assert -solve(short, verify=0).objective == pytest.approx(171.5296, abs=1e-4)


def test_a_guess_at_a_bound_was_compared_with_nothing(landing: Problem, ordinary: Solution) -> None:
    """154.54 kg is proved a local optimum; 160.62 kg is best, which a search says and a guess does not."""
    near = solve(landing, guess=ordinary)
    assert near.outcome is Outcome.PROVED and -near.objective == pytest.approx(154.5413, abs=1e-4)
    assert [e.nature.value for e in near.extremals] == ["an extremal near the guess, at a bound"]
    assert "best" not in solution_summary(near)


@pytest.mark.parametrize(("isp", "retro_burn"), [(277.95, True), (277.85, False)])
def test_retro_burn_stops_paying(isp: float, retro_burn: bool) -> None:
    """Figs 9, 10: the global optimum jumps to delta_v = 0 below an impulsive Isp of 277.9 s."""
    solution = solve(cho_landing(isp), verify=0)
    if retro_burn:
        assert solution.free["retro_delta_v"] == pytest.approx(1086.0, abs=1.0)
        assert solution.extremals[0].nature is Nature.BEST
    else:
        assert solution.free["retro_delta_v"] == 0.0
        assert solution.extremals[0].nature is Nature.BEST_AT_BOUND


def test_initial_costate_is_the_gradient(landing: Problem, ordinary: Solution) -> None:
    """The sign convention: lambda(t0) = dJ*/dx0, here for mass and height, by re-solved neighbours."""
    lam = ordinary.trajectories[0].costate
    assert lam is not None
    fixed = landing.with_given(retro_delta_v=0.0)

    def slope(name: str, step: float) -> float:
        value = fixed.given[name].value
        plus, minus = (solve(fixed.with_given(**{name: value + s}), guess=ordinary, verify=0) for s in (step, -step))
        return (plus.objective - minus.objective) / (2 * step)

    assert slope("vehicle_mass", 1e-2) == pytest.approx(lam.values[0, 4], rel=1e-6)
    # Perilune height moves the speed too: the chain rule with Cho et al. (7).
    step = 10.0
    p = [fixed.with_given(orbit_perilune_altitude=15e3 + s).parameters({}) for s in (step, -step)]
    dv_dh = (perilune_speed(p[0], NUMERIC) - perilune_speed(p[1], NUMERIC)) / (2 * step)
    expected = lam.values[0, 0] + lam.values[0, 2] * dv_dh
    assert slope("orbit_perilune_altitude", step) == pytest.approx(expected, rel=1e-5)


def test_more_thrust_never_costs_propellant(landing: Problem, ordinary: Solution) -> None:
    """More thrust lands more mass, from half a newton to a tenth more."""
    fixed = landing.with_given(retro_delta_v=0.0)
    before = ordinary
    for thrust in (440.5, 460.0, 484.0):
        after = solve(fixed.with_given(vehicle_thrust=thrust), guess=before, verify=0)
        assert after.objective < before.objective
        before = after


def test_units_do_not_matter(hybrid: Solution) -> None:
    """The same lander a thousand times heavier with a thousand times the thrust flies the same path."""
    heavy = hybrid_landing(
        Vehicle(mass=300e3, thrust=440e3, specific_impulse=310.0, standard_gravity=9.81),
        Retro(specific_impulse=310.0),
        Orbit(parking_altitude=100e3, perilune_altitude=15e3),
        CHO_MOON,
    )
    solution = solve(heavy, guess=hybrid, verify=0)
    assert solution.objective == pytest.approx(1000 * hybrid.objective, rel=1e-10)
    assert solution.free["retro_delta_v"] == pytest.approx(hybrid.free["retro_delta_v"], rel=1e-9)


def test_restart_from_a_midpoint(landing: Problem, ordinary: Solution) -> None:
    """Bellman: the rest of an optimal landing is optimal from where it begins."""
    fixed, total = landing.with_given(retro_delta_v=0.0), ordinary.free["flight_time"]
    names, units = zip(*((f"begin_{s.name}", s.unit) for s in fixed.phases[0].states), strict=True)
    x = ordinary.trajectories[0].state(0.4 * total)
    rest = replace(
        fixed,
        start=lambda p, xp: tuple(getattr(p, name) for name in names),
        given={**fixed.given, **{n: Parameter(value=v, unit=u) for n, v, u in zip(names, x, units, strict=True)}},
    )
    solution = solve(rest, verify=0)
    assert solution.objective == pytest.approx(ordinary.objective, rel=1e-9)
    assert solution.free["flight_time"] == pytest.approx(0.6 * total, rel=1e-8)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mass": -300.0}, r"vehicle.mass is out of range\n  got: -300 kg\n  expected: > 0 kg"),
        ({"mass": float("nan")}, "vehicle.mass is not finite"),
        ({"thrust": 0.0}, "vehicle.thrust is out of range"),
        ({"specific_impulse": float("inf")}, "vehicle.specific_impulse is not finite"),
        ({"specific_impulse": 3041.0}, "an exhaust velocity in m/s, divided by"),
        ({"dry_mass": 300.0}, "vehicle.dry_mass leaves no propellant"),
    ],
)
def test_impossible_vehicles(change: dict[str, float], words: str) -> None:
    """Each is refused with its name."""
    with pytest.raises(PeriluneError, match=words):
        Vehicle(**{"mass": 300.0, "thrust": 440.0, "specific_impulse": 310.0, **change})


def test_impossible_orbits() -> None:
    """Perilune above the parking orbit, or below the site."""
    lander = Vehicle(mass=300.0, thrust=440.0, specific_impulse=310.0)
    for parking, perilune, site, words in (
        (15e3, 100e3, 0.0, "perilune lies above the parking orbit"),
        (100e3, 5e3, 6e3, "perilune lies below the landing site"),
    ):
        orbit = Orbit(parking_altitude=parking, perilune_altitude=perilune)
        with pytest.raises(InfeasibleError, match=words):
            solve(hybrid_landing(lander, None, orbit, CHO_MOON, landing_altitude=site))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"vehicle_mass": -1.0}, r"vehicle.mass is out of range\n  got: -1 kg\n  expected: > 0 kg"),
        ({"retro_delta_v": -1.0}, "retro.delta_v is out of range(.|\n)*omit delta_v"),
        ({"vehicle_specific_impulse": 3041.0}, "more than 20 and at most 1000 s(.|\n)*an exhaust velocity"),
        ({"vehicle_standard_gravity": 1.62}, "the same on every body"),
        ({"landing_altitude": math.inf}, "landing_altitude is not finite"),
    ],
)
def test_a_range_holds_for_every_value_that_is_given(landing: Problem, values: dict[str, float], words: str) -> None:
    """Declared once, in the record; asked of `with_given` and of each member of a sweep."""
    with pytest.raises(PeriluneError, match=words):
        landing.with_given(**values)
