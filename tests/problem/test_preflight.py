"""Pre-flight: its bounds hold for flights it knows nothing of.

And what is impossible is refused in plain words.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from perilune import sweep
from perilune.core import NUMERIC, InfeasibleError, Outcome, PeriluneError
from perilune.models import (
    MARS,
    MOON,
    Approach,
    Body,
    Corridor,
    Ignition,
    Orbit,
    Retro,
    Site,
    Vehicle,
    hybrid_landing,
    powered_descent,
    precision_landing,
)
from perilune.problem.controls import UnitVectorControl
from perilune.problem.phase import Phase
from perilune.problem.presolve import Finding, is_possible, preflight, refuse_impossible, select_findings
from perilune.problem.problem import Problem
from perilune.problem.variables import Parameter, Variable
from perilune.solve import solve


def lander(
    thrust: float = 440.0, delta_v: float | None = None, dry_mass: float | None = None, body: Body = MOON
) -> Problem:
    """A lander of 300 kg."""
    return hybrid_landing(
        Vehicle(mass=300.0, thrust=thrust, specific_impulse=310.0, dry_mass=dry_mass),
        Retro(specific_impulse=310.0, delta_v=delta_v),
        Orbit(parking_altitude=100e3, perilune_altitude=15e3),
        body,
    )


def finding(problem: Problem, name: str) -> Finding:
    """The finding of a name."""
    return next(f for f in preflight(problem) if f.name == name)


def test_the_papers_lander_may_fly_with_a_warning() -> None:
    # Cho et al. 2015: feasible, although thrust is less than weight at ignition.
    found = preflight(lander())
    assert [f.name for f in found if not f.passed] == ["thrust-to-weight ratio at ignition"]
    assert finding(lander(), "thrust-to-weight ratio at ignition").value == pytest.approx(440 / 300 / 1.6243, rel=1e-3)


@pytest.mark.parametrize(("delta_v", "landed"), [(None, 160.6186), (0.0, 154.5413), (1200.9011, 160.6186)])
def test_the_rocket_equation_bounds_the_papers_landings(delta_v: float | None, landed: float) -> None:
    # Landed masses printed in Table 1; g0 and the Moon of the paper differ from ours by less than 0.1 %.
    bound = finding(lander(delta_v=delta_v), "landed mass by the rocket equation").value
    assert landed < bound < 1.12 * landed


@pytest.mark.parametrize(("main", "retro"), [(310.0, 220.0), (220.0, 310.0)])
def test_each_burn_is_charged_at_its_own_engine(main: float, retro: float) -> None:
    """Tsiolkovsky's equation burn by burn; with no burn stated, the better engine does it all."""
    g0, mu, radius = 9.80665, MOON.gravitational_parameter, MOON.radius
    r0, parking = radius + 15e3, radius + 100e3
    vehicle, orbit = (
        Vehicle(mass=300.0, thrust=440.0, specific_impulse=main),
        Orbit(parking_altitude=100e3, perilune_altitude=15e3),
    )
    speed = math.sqrt(2 * mu / r0 - 2 * mu / (r0 + parking))

    def left(delta_v: float | None) -> float:
        problem = hybrid_landing(vehicle, Retro(specific_impulse=retro, delta_v=delta_v), orbit, MOON)
        return finding(problem, "landed mass by the rocket equation").value

    rest = math.sqrt((speed - 800.0) ** 2 + 2 * mu / radius - 2 * mu / r0) - MOON.rotation_rate * radius
    assert left(800.0) == pytest.approx(300.0 * math.exp(-800.0 / (retro * g0) - rest / (main * g0)), rel=1e-12)
    whole = math.sqrt(speed**2 + 2 * mu / radius - 2 * mu / r0) - MOON.rotation_rate * radius
    assert left(None) == pytest.approx(300.0 * math.exp(-whole / (310.0 * g0)), rel=1e-12)


def test_a_stated_retro_burn_is_charged_at_its_own_engine() -> None:
    """Tsiolkovsky: 220 s take 180 kg of 300 kg away by no more than 1102.1 m/s, whatever the main engine does."""
    vehicle = Vehicle(mass=300.0, thrust=440.0, specific_impulse=310.0, dry_mass=180.0)
    problem = hybrid_landing(
        vehicle,
        Retro(specific_impulse=220.0, delta_v=1200.0),
        Orbit(parking_altitude=100e3, perilune_altitude=15e3),
        MOON,
    )
    burn = 220.0 * 9.80665 * math.log(300.0 / 180.0)
    assert min(f.limit for f in preflight(problem) if f.name == "retro.delta_v") == pytest.approx(burn, rel=1e-12)
    with pytest.raises(InfeasibleError, match="more propellant than there is") as caught:
        refuse_impossible(preflight(problem))
    assert caught.value.expected == f"at most {burn:.6g} m/s"


@settings(max_examples=25, deadline=None)
@given(st.floats(0.3, 8.0), st.floats(-8.0, 8.0), st.floats(-0.02, 0.02), st.floats(0.0, 1600.0))
def test_no_steering_law_beats_the_rocket_equation(
    acceleration: float, angle: float, turning: float, retro: float
) -> None:
    """Fly anything with another integrator until the ground.

    The ideal velocity change is never below the drop of w.
    """
    body, thrust = MOON, acceleration * 300.0
    p = lander(thrust=thrust, delta_v=retro).parameters({})
    exhaust = 310.0 * p.vehicle_standard_gravity

    def rates(t: float, y: np.ndarray) -> list[float]:
        r, u, v, m = y
        a, beta = thrust / m, angle + turning * t
        return [
            v,
            -u * v / r + a * math.cos(beta),
            u * u / r - body.gravitational_parameter / r**2 + a * math.sin(beta),
            -thrust / exhaust,
        ]

    r0 = body.radius + 15e3
    speed = math.sqrt(body.gravitational_parameter * (2 / r0 - 2 / (2 * body.radius + 115e3)))
    m0 = 300.0 * math.exp(-retro / exhaust)
    ground = lambda t, y: y[0] - body.radius  # noqa: E731
    ground.terminal = True  # type: ignore[attr-defined]
    flown = solve_ivp(
        rates,
        (0.0, 0.9 * m0 * exhaust / thrust),
        [r0, speed - retro, 0.0, m0],
        "DOP853",
        events=ground,
        rtol=1e-10,
    )
    r, u, v, m = flown.y
    w = np.sqrt(np.maximum(u**2 + v**2 + 2 * body.gravitational_parameter * (1 / body.radius - 1 / r), 0.0))
    start = math.sqrt(speed**2 + 2 * body.gravitational_parameter * (1 / body.radius - 1 / r0))
    assert (exhaust * np.log(300.0 / m) >= start - w - 1e-4).all()


def test_the_mass_that_thrust_can_hold() -> None:
    # By hand: 440 N / (1.62422 m/s^2 - (2.6617e-6 rad/s)^2 * 1737.4 km) = 270.9 kg.
    assert finding(lander(), "landed mass that the thrust can hold").value == pytest.approx(270.9, abs=0.05)


@pytest.mark.parametrize(
    ("problem", "what"),
    [
        (lander(thrust=4.4, dry_mass=30.0), "too weak"),
        (lander(thrust=440.0, dry_mass=280.0), "too weak"),
        (lander(thrust=4400.0, dry_mass=280.0), "not enough propellant"),
        (lander(delta_v=1650.0, dry_mass=180.0), "more propellant than there is"),
        (lander(delta_v=1700.0), "fly backwards"),
        (
            lander(
                body=Body(name="earth", gravitational_parameter=3.986e14, radius=6.378e6, rotation_rate=7.29e-5),
                thrust=9e3,
                dry_mass=30.0,
            ),
            "not enough propellant",
        ),
    ],
)
def test_the_impossible_is_refused(problem: Problem, what: str) -> None:
    with pytest.raises(InfeasibleError) as caught:
        refuse_impossible(preflight(problem))
    error = caught.value
    assert what in error.what
    assert error.got and error.expected and error.advice
    assert error.exit_code == 3


@pytest.mark.parametrize(
    ("altitudes", "what"),
    [
        ((-1e3, 100e3, -2e3), "below the surface"),
        ((15e3, 10e3, 0.0), "above the parking orbit"),
        ((15e3, 100e3, 16e3), "below the landing site"),
        ((15e3, 100e3, 15e3), "below the landing site"),
    ],
)
def test_an_orbit_that_hits_the_ground_is_refused(altitudes: tuple[float, float, float], what: str) -> None:
    names = ("orbit_perilune_altitude", "orbit_parking_altitude", "landing_altitude")
    problem = lander().with_given(**dict(zip(names, altitudes, strict=True)))
    with pytest.raises(InfeasibleError, match=what):
        refuse_impossible(preflight(problem))


@pytest.mark.parametrize(
    ("problem", "name"),
    [
        (lander(thrust=65.0), "braking distance without gravity"),
        (lander().with_given(vehicle_mass=1000.0), "mass after braking"),
        (lander(body=replace(MOON, rotation_rate=1.5e-4)), "speed of the ground"),
        (
            lander().with_given(orbit_parking_altitude=500e3, orbit_perilune_altitude=400e3),
            "perilune altitude",
        ),
    ],
)
def test_the_odd_is_warned_of_and_not_refused(problem: Problem, name: str) -> None:
    assert finding(problem, name).verdict == "warning"
    refuse_impossible(preflight(problem))


def test_an_assumed_dry_mass_makes_nothing_impossible() -> None:
    """A stated dry mass does: 24.6 kg are held by 40 N over the Moon."""
    weak = preflight(lander(thrust=40.0))
    refuse_impossible(weak)
    warned = next(f for f in weak if f.name == "landed mass that the thrust can hold")
    assert warned.verdict == "warning" and warned.lasting and "assumed" in warned.meaning
    assert warned.formatted == ("24.6274 kg", "at least 30 kg")
    refuse_impossible(preflight(lander(thrust=40.0, dry_mass=5.0)))
    with pytest.raises(InfeasibleError, match="too weak"):
        refuse_impossible(preflight(lander(thrust=40.0, dry_mass=30.0)))


@pytest.mark.parametrize(
    ("value", "limit", "unit", "told"),
    [
        (1.8e-26, 13e3, "m", ("0 m", "at most 13000 m")),
        (30.0, -0.0, "m/s", ("30 m/s", "at most 0 m/s")),
        (-1e-20, 0.0, "m", ("-1e-20 m", "at most 0 m")),  # of what, is not known
        (math.inf, math.pi, "rad", ("inf deg", "at most 180 deg")),
    ],
)
def test_a_comparison_is_told_without_round_off(value: float, limit: float, unit: str, told: tuple[str, str]) -> None:
    one = Finding(name="n", value=value, limit=limit, at_least=False, unit=unit, binding=True, meaning="too far")
    assert one.formatted == told


def test_braking_distance_has_its_simple_limit() -> None:
    # For a strong engine little mass is lost, and the distance is V^2/(2 a).
    problem = lander(thrust=300.0 * 400.0)
    speed = 1691.7
    value = finding(problem, "braking distance without gravity").value
    assert value == pytest.approx(speed**2 / (2 * 400.0) / 1e3 * (1 - speed / 3 / 3040.0), rel=0.05)


def test_nan_never_passes() -> None:
    f = finding(lander(), "speed of the ground")
    assert not replace(f, value=math.nan).passed
    assert replace(f, value=math.nan, binding=True).verdict == "impossible"


def test_another_body_is_another_bound() -> None:
    on_mars = finding(lander(body=MARS, thrust=2000.0), "landed mass by the rocket equation").value
    assert on_mars < finding(lander(), "landed mass by the rocket equation").value


def test_a_problem_without_comparisons_has_none() -> None:
    phase = Phase(
        name="p",
        states=(Variable(name="x"),),
        controls=(UnitVectorControl(names=("a", "b")),),
        dynamics=lambda x, u, p, xp: (x.x / p.T,),
        duration="T",
    )
    other = Problem(
        name="other",
        phases=(phase,),
        start=lambda p, xp: (1.0,),
        objective=lambda x, p, xp: x.x,
        given={"T": Parameter(value=1.0, unit="s")},
    )
    assert preflight(other) == ()
    assert is_possible(preflight(other))


# -- in the library


@pytest.mark.parametrize(
    ("problem", "what"),
    [
        (lander(dry_mass=200.0), "not enough propellant"),  # 160.6 kg land at best
        (lander(thrust=4.0, dry_mass=30.0), "too weak"),
        (lander(delta_v=9999.0), "fly backwards"),
    ],
)
def test_solve_refuses_at_once(problem: Problem, what: str) -> None:
    began = time.perf_counter()
    with pytest.raises(InfeasibleError, match=what) as caught:
        solve(problem)
    assert time.perf_counter() - began < 0.1  # 0.2 ms measured; the search that it spares takes seconds
    assert caught.value.reason == "cannot be flown"
    for f in preflight(problem):
        assert f.verdict in ("ok", "warning", "impossible")


def test_a_sweep_refuses_member_by_member() -> None:
    family = sweep(lander(), {"retro_delta_v": [1200.0, 9999.0]})
    assert [point.outcome for point in family.points] == [Outcome.SOLVED, Outcome.INFEASIBLE]
    assert "fly backwards" in family.points[1].message


def test_many_are_judged_at_once_as_one_by_one() -> None:
    rng = np.random.default_rng(7)
    over = {
        "vehicle_thrust": np.exp(rng.uniform(math.log(20.0), math.log(2e4), 200)),
        "retro_delta_v": rng.uniform(0.0, 2500.0, 200),
        "orbit_perilune_altitude": rng.uniform(-5e3, 120e3, 200),
    }
    problem = lander(dry_mass=60.0)
    together = preflight(problem, over)
    verdicts = is_possible(together)
    assert 20 < verdicts.sum() < 180
    for i in range(0, 200, 9):
        alone = preflight(problem.with_given(**{name: float(values[i]) for name, values in over.items()}))
        assert is_possible(alone) == verdicts[i]
        # Behind them stands what others of them miss at their start.
        for one, other in zip(alone, select_findings(together, i), strict=False):
            assert (one.name, one.verdict) == (other.name, other.verdict)
            assert one.value == pytest.approx(other.value, rel=1e-12)
            assert one.limit == pytest.approx(other.limit, rel=1e-12)


# -- the stopping distance


def descent(speed: float, height: float, **changes: float) -> Problem:
    """A 2 t lander straight above its site."""
    return precision_landing(
        Vehicle(mass=2000.0, thrust=8000.0, specific_impulse=310.0),
        Approach(east=0.0, north=0.0, up=height, up_speed=-speed),
        Site(altitude=0.0, longitude=0.0, latitude=0.3),
        Corridor(tilt=0.8, slope=0.2),
        (changes.get("lower", 0.1), changes.get("upper", 0.9)),
    )


@settings(max_examples=40, deadline=None)
@given(st.floats(20.0, 400.0), st.floats(100.0, 4000.0), st.floats(0.2, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 0.8))
def test_no_flight_stops_where_the_bound_says_none_does(
    speed: float, height: float, upper: float, delay: float, tilt: float
) -> None:
    """Flown by SciPy with other throttles and directions: what comes to rest above the site was not refused."""
    problem = descent(speed, height, upper=upper)
    fall = finding(problem, "stopping distance at full thrust")
    p, phase = problem.parameters({}), problem.phases[0]

    def rates(t: float, x: np.ndarray) -> list[float]:
        u = (math.sin(tilt), 0.0, math.cos(tilt), upper if t > 30.0 * delay else 0.1)
        return list(phase.rates(list(x), u, p))

    rest = lambda t, x: x[5]  # noqa: E731
    ground = lambda t, x: x[2]  # noqa: E731
    rest.terminal = ground.terminal = True  # type: ignore[attr-defined]
    x0 = np.array(problem.start(p, NUMERIC), dtype=float)
    flown = solve_ivp(rates, (0.0, 400.0), x0, "DOP853", events=[rest, ground], rtol=1e-10, atol=1e-8)
    # In one long step it may fall through the ground and come back, which no event tells.
    if len(flown.t_events[0]) and flown.y_events[0][0][2] >= 0:
        assert fall.passed, flown.y_events[0][0][2]
        # The way that was fallen is never shorter than the bound.
        assert height - flown.y_events[0][0][2] >= fall.value - 1e-6


def test_the_bound_is_near_the_best_flight() -> None:
    # Full thrust straight up from the start: the greatest speed that it stops from 1 km, against that of the bound.
    def stops(speed: float) -> Any:
        c, a = 310.0 * 9.80665, 0.9 * 8000.0 / 2000.0
        t = np.linspace(0.0, 200.0, 200_001)
        v = -speed - c * np.log1p(-a / c * t) - 1.62 * t
        at = int(np.argmax(v >= 0))
        return 1000.0 + np.trapezoid(v[:at], t[:at]) > 0

    def passed(speed: float) -> Any:
        return finding(descent(speed, 1000.0), "stopping distance at full thrust").passed

    truth, bound = (max(s for s in range(40, 120) if may(float(s))) for may in (stops, passed))
    assert truth <= bound < 1.03 * truth


def falls_that_land(draws: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Starts whose flight to rest on the ground is known: it was flown backwards from there, straight up or tilted."""
    mu, rs, c, steps = MOON.gravitational_parameter, MOON.radius, 3000.0, 400
    thrust = mu / rs**2 * np.exp(rng.uniform(0.0, math.log(4.0), draws))  # for 1 kg on the ground
    last = c / thrust * np.exp(rng.uniform(-4.0, 0.0, draws))  # s
    tilts = rng.uniform(0.0, 1.5, draws) * rng.choice([0.0, 1.0], draws), rng.uniform(-0.8, 0.8, draws)
    floor = rng.choice([1.0, 0.7], draws)

    def rates(s: float, y: np.ndarray) -> np.ndarray:
        r, up, across, m = y
        throttle = np.where(np.sin(7 * s) > 0, 1.0, floor)
        tilt, push = tilts[0] * s + tilts[1] * (1 - s) * (tilts[0] > 0), throttle * thrust / m
        lifted = push * np.cos(tilt) + across**2 / r - mu / r**2
        return -last * np.array([up, lifted, -push * np.sin(tilt) - up * across / r, -throttle * thrust / c])

    y = np.array([[rs], [0.0], [0.0], [1.0]]) * np.ones(draws)
    above = np.full(draws, fill_value=True)
    for i in range(steps):
        s, h = i / steps, 1 / steps
        k = [rates(s, y)]
        for part in (0.5, 0.5, 1.0):
            k.append(rates(s + part * h, y + part * h * k[-1]))
        y = y + h / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
        above &= y[0] >= rs
    start = {"start_altitude": y[0] - rs, "start_vertical_speed": y[1], "start_forward_speed": y[2]}
    start |= {"vehicle_mass": y[3], "vehicle_thrust": thrust}
    kept = above & (y[1] < 0) & (y[0] > rs + 10.0)
    return {name: values[kept] for name, values in start.items()}


def test_no_fall_is_refused_that_is_known_to_land() -> None:
    """Thousands of them, full thrust straight up and the lift of a speed across among them: the bound is near both."""
    over = falls_that_land(20_000, np.random.default_rng(41))
    start = Ignition(altitude=1e3, longitude=0.0, latitude=0.0, heading=0.5 * math.pi, forward_speed=0.0)
    vehicle = Vehicle(mass=1.0, thrust=1.0, specific_impulse=3000.0 / 9.80665)
    problem = powered_descent(vehicle, start, Site(), replace(MOON, rotation_rate=0.0), target="anywhere")
    fall = next(f for f in preflight(problem, over) if f.name == "stopping distance at full thrust")
    assert len(fall.value) > 5_000
    share, across = fall.value / fall.limit, np.abs(over["start_forward_speed"]) / 1680.0
    assert np.max(share) <= 1.0
    assert np.max(share) > 0.99
    assert np.max(share[across > 0.3]) > 0.75


def test_a_fall_too_fast_for_the_thrust_is_refused_in_words() -> None:
    """Nothing is burnt to search for it: 21 % more thrust than weight, 38 m/s downwards, 2.1 km above Ceres."""
    ceres = Body(name="ceres", gravitational_parameter=62.6274e9, radius=470e3, rotation_rate=0.0)
    vehicle = Vehicle(mass=1000.0, thrust=594.0, specific_impulse=438.0)
    start = Ignition(
        altitude=2132.0, longitude=0.0, latitude=0.0, heading=0.0, forward_speed=10.8, vertical_speed=-37.8
    )
    with pytest.raises(InfeasibleError, match="even full thrust straight up cannot stop it"):
        solve(powered_descent(vehicle, start, Site(), ceres, target="anywhere", throttle=(0.2, 1.0)))


def test_the_throttle_counts() -> None:
    # 0.5 of 8 kN under 2 t on the Moon: 4000/(2000 * 1.62).
    half = descent(30.0, 1000.0, upper=0.5)
    assert finding(half, "thrust-to-weight ratio at ignition").value == pytest.approx(4000 / (2000 * 1.624), rel=1e-3)
    assert finding(descent(60.0, 1000.0), "stopping distance at full thrust").passed
    assert not finding(descent(60.0, 1000.0, upper=0.3), "stopping distance at full thrust").passed


@settings(max_examples=20, deadline=None)
@given(st.floats(-3e-4, 3e-4), st.floats(0.0, 6.28), st.floats(-1.5, 1.5), st.floats(0.0, 0.02))
def test_turning_bodies_keep_the_bound_of_the_rocket_equation(
    rotation: float, heading: float, elevation: float, turning: float
) -> None:
    """Flown by SciPy in axes that turn with a body, by any thrust: no ideal velocity change is below the fall of w."""
    body = replace(MOON, rotation_rate=rotation)
    start = Ignition(
        altitude=40e3, longitude=0.4, latitude=0.6, heading=heading, forward_speed=1200.0, vertical_speed=-40.0
    )
    lander = Vehicle(mass=2000.0, thrust=8000.0, specific_impulse=310.0, dry_mass=500.0)
    problem = powered_descent(lander, start, Site(altitude=0.0, longitude=0.5, latitude=0.5), body, target="anywhere")
    p, phase, c = problem.parameters({}), problem.phases[0], 310.0 * 9.80665
    r_site, omega = body.radius, np.array([0.0, 0.0, rotation])

    def rates(t: float, x: np.ndarray) -> list[float]:
        a, b = elevation + turning * t, heading + 0.01 * t
        u = (math.cos(a) * math.cos(b), math.cos(a) * math.sin(b), math.sin(a))
        return list(phase.rates(list(x), u, p))

    x0 = np.array(problem.start(p, NUMERIC), dtype=float)
    flown = solve_ivp(rates, (0.0, 400.0), x0, "DOP853", rtol=1e-10, atol=1e-6)
    r = np.linalg.norm(flown.y[:3], axis=0)
    above = np.logical_and.accumulate(r >= r_site)
    speed = np.linalg.norm(flown.y[3:6] + np.cross(omega, flown.y[:3].T).T, axis=0)
    w = np.sqrt(np.maximum(speed**2 + 2 * body.gravitational_parameter * (1 / r_site - 1 / r), 0.0))
    spent = c * np.log(2000.0 / flown.y[6])
    assert (spent >= w[0] - w - 1e-4)[above].all()
    found = finding(problem, "speed to be removed")
    assert found.value == pytest.approx(w[0] - abs(rotation) * r_site, rel=1e-9)
    assert found.limit == pytest.approx(1.02 * c * math.log(4.0), rel=1e-9)


@pytest.mark.parametrize("wrong", [{"name": 3}, {"advice": None}, {"binding": 1}, {"at_least": "yes"}])
def test_what_a_comparison_says_beside_its_numbers_is_texts_and_sides(wrong: dict[str, Any]) -> None:
    """Of these an atlas was built whole, and could not be opened."""
    said: dict[str, Any] = {"name": "way", "unit": "m", "meaning": "too far", "binding": np.bool_(True)}
    assert Finding(value=1.0, limit=2.0, at_least=False, **said).binding is True
    with pytest.raises(PeriluneError, match=f"{next(iter(wrong))} (of|in) a comparison"):
        Finding(value=1.0, limit=2.0, **{"at_least": False, **said, **wrong})
