"""Returns with a coast on the orbit, a burn, a coast to the interface and an entry: what the proof says of them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune import Indirect
from perilune.core import ignore_events
from perilune.methods.indirect.diagnosis import active_path_condition
from perilune.methods.indirect.newton_trials import Trials
from perilune.methods.indirect.random_costates import active_set_of_guess
from perilune.models.deorbit.initial_guess import impulsive_deorbit
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.records import (
    Atmosphere,
    Interface,
    Landing,
    Manoeuvre,
    Returner,
    ReturnOrbit,
    Separation,
    Transition,
)
from perilune.models.physics.bodies import EARTH
from perilune.problem import Nature
from perilune.scenario import load_file
from perilune.shooting.contracting_phases import costate_error_growth
from perilune.verify import verify

NEIGHBOUR_B = Path(__file__).parents[2] / "examples" / "minimum_duration_return.toml"
FREE_IGNITION = (
    'orbit.longest_coast="5000 s"', 'transition.longest_coast="3000 s"', 'vehicle.thrust="400 N"',
    'problem.minimise="propellant"', 'interface.angle_upper="-2 deg"', 'vehicle.dry_mass="350 kg"',
)  # fmt: skip


def returning(folder: Path, ballistic_coefficient: int, *changes: str) -> pl.Problem:
    """Neighbour B with a free ignition and another ballistic coefficient [kg/m^2]."""
    text, light = NEIGHBOUR_B.read_text(encoding="utf-8"), f'ballistic_coefficient = "{ballistic_coefficient} kg/m^2" #'
    (folder / "light.toml").write_text(text.replace('drag_area = "0.6 m^2" ', light), encoding="utf-8")
    return load_file(folder / "light.toml", (*FREE_IGNITION, *changes)).problem


def test_a_return_of_four_phases_is_proved() -> None:
    """The terms of H on its coast are 18 times J over the flight: errors of all costates add up in it."""
    solution = pl.solve(load_file(NEIGHBOUR_B, FREE_IGNITION).problem)
    assert solution.verification.passed and solution.verification.level == 3
    assert [flown.phase for flown in solution.trajectories] == ["coast", "burn", "drift", "entry"]
    checks = {check.name: check for check in solution.verification.checks}
    constant = checks["coast_hamiltonian_constant"]
    assert constant.limit == 1e-9 and 1e-12 < constant.value < 8e-10
    assert solution.objective == pytest.approx(-478.397229, abs=1e-6)


def test_costates_of_a_fall_follow_from_its_end(tmp_path: Path) -> None:
    """A fall of 177 kg/m^2 forgets its speed by a factor of a million; a costate that is told wrongly still fails.

    Flown from the interface on, errors of the last digits of its costates grow by as much.
    """
    light = NEIGHBOUR_B.read_text(encoding="utf-8").replace(
        'drag_area = "0.6 m^2" ', 'ballistic_coefficient = "177 kg/m^2" #'
    )
    (tmp_path / "light.toml").write_text(light, encoding="utf-8")
    solution = pl.solve(load_file(tmp_path / "light.toml", FREE_IGNITION).problem, verify=0)
    assert not [check for check in verify(solution, level=2).verification.failed]
    for column in (0, 3):
        entry = solution.trajectories[-1]
        assert entry.costate is not None
        values = entry.costate.values.copy()
        values[len(values) // 2, column] += 1e-6 * np.abs(values[:, column]).max()
        wrong = replace(entry, costate=replace(entry.costate, values=values))
        failed = verify(
            replace(solution, trajectories=(*solution.trajectories[:-1], wrong)), level=2
        ).verification.failed
        assert {check.name for check in failed} & {
            f"entry_costate_{name}" for name in ("x", "y", "z", "vx", "vy", "vz")
        }


COASTING: dict[str, Any] = {
    "vehicle": Returner(mass=1000.0, thrust=300.0, exhaust_velocity=3000.0, dry_mass=700.0, drag_area=3.0),
    "interface": Interface(altitude=120e3, angle=math.radians(-1.8)),
    "transition": Transition(longest_coast=4000.0),
    "air": Atmosphere(model="us1976"),
    "manoeuvre": Manoeuvre(longitude=0.3, latitude=0.4, going="ascending"),
}
LOW = ReturnOrbit(radius=EARTH.radius + 300e3, inclination=1.0)
PERIOD = 2 * math.pi * math.sqrt((EARTH.radius + 300e3) ** 3 / EARTH.gravitational_parameter)


@pytest.mark.parametrize(
    ("turns", "longest"), [(0.02, 3.0), (0.6, 3.0), (0.97, 3.0), (1.95, 3.0), (2.5, 3.0), (0.97, 1.0), (1.06, 1.0)]
)
def test_a_rough_coast_ends_at_the_pass_that_comes_nearest_to_the_site(turns: float, longest: float) -> None:
    """Where a rough flight ends that begins so many turns later: that from t = 0 waits for it, or flies on to it."""
    anywhere = deorbit_entry(orbit_=replace(LOW, longest_coast=3.0 * PERIOD), site=Landing(altitude=10e3), **COASTING)
    assert anywhere.initial_guess is not None
    known = {f.name: f.guess for f in anywhere.free}
    end = anywhere.initial_guess(anywhere.parameters({**known, "coast_time": turns * PERIOD}))[-1][-1, :3]
    site = Landing(
        longitude=math.atan2(end[1], end[0]), latitude=math.asin(end[2] / np.linalg.norm(end)), altitude=10e3
    )
    there = deorbit_entry(orbit_=replace(LOW, longest_coast=longest * PERIOD), site=site, **COASTING)
    rough = {f.name: f.guess for f in there.free}
    coast, drift = rough["coast_time"], rough["drift_time"] - known["drift_time"]
    assert coast == pytest.approx(min(turns, longest) * PERIOD, abs=0.025 * PERIOD)
    assert drift == pytest.approx(max(turns - longest, 0.0) * PERIOD, abs=0.01 * PERIOD)


@pytest.mark.parametrize(("thrust", "turns"), [(120.0, 1.0), (1000.0, 0.0)])
def test_a_rough_burn_without_a_coast_goes_on_to_the_next_pass(thrust: float, turns: float) -> None:
    """To a site that is 20 deg aside at first, and below the orbit a turn later: where burn and drift last so long."""
    low = {**COASTING, "vehicle": replace(COASTING["vehicle"], thrust=thrust)}
    anywhere = deorbit_entry(orbit_=replace(LOW, longest_coast=3.0 * PERIOD), site=Landing(altitude=10e3), **low)
    assert anywhere.initial_guess is not None
    known = {f.name: f.guess for f in anywhere.free}
    end = anywhere.initial_guess(anywhere.parameters({**known, "coast_time": PERIOD}))[-1][-1, :3]
    site = Landing(
        longitude=math.atan2(end[1], end[0]), latitude=math.asin(end[2] / np.linalg.norm(end)), altitude=10e3
    )
    rough = {f.name: f.guess for f in deorbit_entry(orbit_=LOW, site=site, **low).free}
    later = rough["burn_time"] + rough["drift_time"] - known["burn_time"] - known["drift_time"]
    assert later == pytest.approx(turns * PERIOD, abs=0.1 * PERIOD) and rough["drift_time"] <= 3600.0


def test_a_rough_burn_of_low_thrust_comes_down_at_the_angle_that_is_stated() -> None:
    """Longer by a fifth than the velocity change of an impulse, as it goes round a part of the body."""
    low = {**COASTING, "vehicle": replace(COASTING["vehicle"], thrust=100.0)}
    low |= {"interface": Interface(altitude=120e3, angle=math.radians(-2.8))}
    radius = EARTH.radius + 713e3
    problem = deorbit_entry(orbit_=replace(LOW, radius=radius), site=Landing(altitude=10e3), **low)
    rough = {f.name: f.guess for f in problem.free}
    assert problem.initial_guess is not None
    x = problem.initial_guess(problem.parameters(rough))[1][-1]
    angle = math.asin(x[:3] @ x[3:6] / np.linalg.norm(x[:3]) / np.linalg.norm(x[3:6]))
    assert math.degrees(angle) == pytest.approx(-2.8, abs=0.15)
    change = impulsive_deorbit(
        radius, EARTH.radius + 120e3, math.radians(-2.8), EARTH.gravitational_parameter
    ).velocity_change
    assert rough["burn_time"] > 1.15 * 1000.0 * 3000.0 / 100.0 * (1 - math.exp(-change / 3000.0))


def test_propellant_is_that_of_the_whole_vehicle_whatever_enters_the_air() -> None:
    """What is left behind at the interface is no propellant: the best burn is that of a flight which ends there."""
    stated = {
        "vehicle": Returner(mass=7000.0, thrust=3190.0, specific_impulse=302.0, dry_mass=6000.0, drag_area=5.8),
        "orbit_": ReturnOrbit(radius=EARTH.radius + 432.7e3, inclination=math.radians(51.6)),
        "interface": Interface(altitude=100e3, angle=math.radians(-1.6)),
        "manoeuvre": Manoeuvre(longitude=0.0, latitude=math.radians(-45.0), going="ascending"),
        "transition": Transition(longest_coast=3000.0),
        "minimise": "propellant",
    }
    air = Atmosphere(model="us1976")
    landed, above = (
        pl.solve(deorbit_entry(**stated, **more))
        for more in ({"air": air, "site": Landing(altitude=10.8e3), "separation": Separation(mass=2900.0)}, {})
    )
    assert landed.verification.passed and landed.verification.level == 3
    assert landed.trajectories[-1].state.values[-1, 6] == pytest.approx(2900.0)
    assert landed.objective == pytest.approx(above.objective, rel=1e-9)
    assert -landed.objective == pytest.approx(7000.0 - landed.results["propellant"].value, rel=1e-12)


def test_a_fall_that_forgets_everything_is_solved_and_proved(tmp_path: Path) -> None:
    """Of 15 kg/m^2: its speed at the interface is forgotten by exp(180), and of its costates nothing can be shot."""
    solution = pl.solve(returning(tmp_path, 15))
    assert solution.verification.passed and solution.verification.level == 3
    landing = {c.name: c.value for c in solution.verification.checks if c.name.startswith("entry_")}
    assert landing["entry_costate_vx"] < 1e-10


@pytest.mark.parametrize("coefficient", [40, 100])
def test_a_limit_of_a_speed_that_nothing_moves_hinders_no_answer(tmp_path: Path, coefficient: int) -> None:
    """Whether J curves down along a speed at which everything falls is chance, and was taken for a maximum."""
    limited = pl.solve(returning(tmp_path, coefficient, 'site.speed_upper="300 m/s"'), verify=0)
    assert limited.results["landing_speed"].value < 100.0
    assert limited.objective == pytest.approx(-478.5, abs=0.1)


def test_the_jacobian_of_a_phase_that_settles(tmp_path: Path) -> None:
    """By central differences of the residual, at a root and beside it."""
    problem = returning(tmp_path, 177)
    solution = pl.solve(problem, verify=0)
    trials = Trials(problem, ignore_events)
    assert [phase.settles for phase in trials.conditions.phases] == [False, False, False, True]
    shooting, choice = trials.shooting, active_set_of_guess(trials, np.array(solution.unknowns))
    active = shooting.plan.active
    assert shooting.plan.legs[-1].seeds is not None  # its start has fewer entries than there are unknowns before it
    for y in (np.array(solution.unknowns), 1.01 * np.array(solution.unknowns)):
        jacobian = shooting.jacobians(y[None], trials.p, choice)[0]
        for column, at in enumerate(active):
            step = 1e-6 * np.eye(len(y))[at]
            ends = shooting.at(np.array([y + step, y - step]), trials.p, choice)
            change = (ends[0].residual - ends[1].residual)[shooting.plan.rows] / 2e-6
            np.testing.assert_allclose(jacobian[:, column], change, rtol=1e-5, atol=2e-5 * np.abs(jacobian).max())


def test_costates_of_a_state_that_is_lost_on_the_way_grow_beyond_all() -> None:
    """One of random_returns.py ended in an error of the linear algebra."""
    assert (
        costate_error_growth(np.diag([1.0, 0.0])) == math.inf and costate_error_growth(np.diag([1.0, math.nan])) == 0.0
    )
    assert costate_error_growth(np.array([[2.0, 1.0], [0.0, 0.1]])) == pytest.approx(
        np.linalg.norm(np.linalg.inv([[2.0, 1.0], [0.0, 0.1]]), 2), rel=1e-14
    )


def of_a_fixed_sweep(folder: Path) -> pl.Problem:
    """Neighbour B with speed and angle at the interface fixed: from a place to a place, under thrust all the way."""
    lines = NEIGHBOUR_B.read_text(encoding="utf-8").splitlines()
    fixed = [line for line in lines if not line.startswith(("speed_upper", "angle_upper"))]
    text = "\n".join(fixed).replace("speed_lower", "speed").replace('angle_lower = "-9 deg"', 'angle = "-6 deg"')
    (folder / "fixed.toml").write_text(text, encoding="utf-8")
    return load_file(folder / "fixed.toml").problem


def test_a_fixed_sweep_has_two_extremals_and_one_is_a_time_maximum(tmp_path: Path) -> None:
    """Between the two lie all flight times in which the site can be reached: none from the longest on is flown."""
    problem = of_a_fixed_sweep(tmp_path)
    shortest, longest = pl.solve(problem), pl.solve(pl.opposite(problem))
    for found in (shortest, longest):
        assert found.verification.passed and found.verification.level == 3
    assert shortest.objective == pytest.approx(4443.8964813, rel=1e-9)
    assert -longest.objective == pytest.approx(4902.28707, abs=1e-4)
    # Claimed to be the least it meets every condition but those of the time, which tell the sign of J's multiplier.
    claimed = replace(longest, problem=problem, objective=-longest.objective)
    failed = {check.name for check in verify(claimed, level=2).verification.failed}
    assert failed == {"stationary_burn_time", "stationary_entry_time"}
    direct = pl.Pseudospectral(nodes=8, segments=10, polish=False).run(pl.opposite(problem))
    assert direct.objective == pytest.approx(longest.objective, rel=1e-6)


def test_the_direct_method_flies_neighbour_b_alike() -> None:
    """Refined and not made exact: another transcription of the same flight."""
    problem = load_file(NEIGHBOUR_B).problem
    indirect = pl.solve(problem, verify=0)
    direct = pl.Pseudospectral(nodes=10, segments=12, tolerance=1e-9, polish=False).run(problem)
    assert direct.objective == pytest.approx(indirect.objective, rel=1e-9)
    for name, value in indirect.free.items():
        assert direct.free[name] == pytest.approx(value, abs=1e-8 * indirect.objective)


def test_an_engine_that_burns_all_the_way_leaves_no_drift() -> None:
    """The least time from low thrust: as without a drift, but for the thousandth of a second that it lasts at least.

    The direct method stays 23 us inside that bound, from where it is held: without, Newton's method ends nowhere.
    """

    def down(transition: Transition | None) -> pl.Problem:
        return deorbit_entry(
            Returner(mass=500.0, thrust=100.0, exhaust_velocity=3000.0, dry_mass=350.0),
            ReturnOrbit(radius=6678.14e3, inclination=math.radians(50)),
            Interface(altitude=120e3, angle=math.radians(-1.5)),
            EARTH,
            manoeuvre=Manoeuvre(longitude=math.radians(16), latitude=math.radians(39.5), going="descending"),
            transition=transition,
            minimise="transition_time",
        )

    rough = pl.Pseudospectral(nodes=5, segments=8, refine=0, nlp_tolerance=1e-6).run(
        down(Transition(longest_coast=3e3))
    )
    assert 2e-5 < rough.free["drift_time"] - 1e-3 < 1e-4
    assert active_path_condition(rough.problem, rough) is None
    solution = Indirect().run(rough.problem, rough)
    assert solution.free["drift_time"] == 1e-3
    assert 0 < solution.objective - pl.solve(down(None), verify=0).objective < 1e-3


def test_costates_of_a_fall_that_nearly_leaves_the_air_are_those_that_grow_less() -> None:
    """At -0.85 deg it falls for 22 minutes: errors of its costates grow 1e5 times ahead, and 1e4 times back.

    Both are beyond what limits follow, and it is flown back. Another costate is still none.
    """

    def to(site: Landing, degrees: float = -0.85) -> pl.Problem:
        problem = deorbit_entry(
            Returner(mass=500.0, thrust=500.0, exhaust_velocity=3000.0, dry_mass=350.0, ballistic_coefficient=345.0),
            ReturnOrbit(radius=6878.14e3, inclination=math.radians(50)),
            Interface(altitude=120e3, angle=math.radians(degrees)),
            EARTH,
            manoeuvre=Manoeuvre(longitude=math.radians(16), latitude=math.radians(39.5), going="descending"),
            minimise="propellant",
            transition=Transition(longest_coast=4000.0),
            air=Atmosphere(model="exponential", density=1.225, scale_height=7200.0),
            site=site,
        )
        *above, entry = problem.phases  # so near to leaving, the direct method does not find it with the condition
        return problem.changed(phases=(*above, replace(entry, path=None)), form=None)

    anywhere = pl.solve(to(Landing(altitude=10e3), -1.3), verify=0)
    for degrees in (-1.0, -0.88, -0.85):  # from nothing it is found on some machines alone
        anywhere = pl.solve(to(Landing(altitude=10e3), degrees), guess=anywhere, verify=0)
    place = {name: anywhere.results[f"landing_{name}"].value for name in ("longitude", "latitude")}
    place["longitude"] += 0.02
    solution = pl.solve(to(Landing(altitude=10e3, **place)), guess=anywhere, verify=2)
    assert solution.verification.level == 2 and solution.free["entry_time"] > 1300
    entry = solution.trajectories[-1]
    assert entry.costate is not None
    moved = replace(entry.costate, values=(1 + 1e-5) * entry.costate.values, rates=(1 + 1e-5) * entry.costate.rates)
    falsified = replace(solution, trajectories=(*solution.trajectories[:-1], replace(entry, costate=moved)))
    failed = {check.name for check in verify(falsified, level=2).verification.failed}
    assert {"drift_transversality", "entry_transversality"} <= failed


@pytest.mark.parametrize("drifts", [True, False])
def test_the_least_time_from_low_thrust_is_found_without_a_guess(drifts: bool) -> None:
    """0.13 m/s^2 burn all the way: no extremal has a drift, and those without one are found where it is held at least.

    The direct method's program for it is not solved in 300 iterations from any of its starts.
    """
    problem = deorbit_entry(
        Returner(mass=1e3, thrust=130.0, exhaust_velocity=3000.0, dry_mass=700.0, ballistic_coefficient=430.0),
        ReturnOrbit(radius=EARTH.radius + 263e3, inclination=math.radians(31)),
        Interface(altitude=120e3, angle_lower=math.radians(-3.5), angle_upper=math.radians(-1.8)),
        EARTH,
        manoeuvre=Manoeuvre(longitude=0.0, latitude=0.0, going="descending"),
        transition=Transition(longest_coast=4000.0) if drifts else None,
        air=Atmosphere(model="exponential", density=1.225, scale_height=7200.0),
        site=Landing(altitude=10e3),
    )
    solution = pl.solve(problem, verify=2)
    assert solution.verification.passed and solution.statistics.initialization == "random costates"
    assert solution.objective == pytest.approx(1697.381, abs=1e-3)
    assert solution.free.get("drift_time", 1e-3) == 1e-3
    if drifts:  # the direct method leaves it by some thousandths of a second
        trials = Trials(problem, ignore_events)
        y, index = np.array(solution.unknowns), problem.free_names.index("drift_time")
        y[trials.conditions.free_at.start + index] += 3e-3 / problem.scales.time
        assert active_set_of_guess(trials, y)[index] == 1.0


def test_an_extremal_that_is_no_minimum_leads_on_to_the_direct_method() -> None:
    """Random costates find one extremal alone, whose second variation is negative: 208 kg more are left."""
    problem = deorbit_entry(
        Returner(
            mass=5372.35, thrust=3768.415, exhaust_velocity=3000.0, dry_mass=3760.645, ballistic_coefficient=469.5
        ),
        ReturnOrbit(radius=7042169.5, inclination=1.0227133, longest_coast=5881.264),
        Interface(altitude=120e3, angle_lower=math.radians(-3.5), angle_upper=math.radians(-1.75)),
        EARTH,
        manoeuvre=Manoeuvre(longitude=0.341998778, latitude=0.148204695, going="descending"),
        transition=Transition(longest_coast=4000.0),
        air=Atmosphere(model="exponential", density=1.225, scale_height=7200.0),
        site=Landing(longitude=-2.611376568, latitude=0.533727884, altitude=10e3),
        minimise="propellant",
    )
    solution = pl.solve(problem)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert -solution.objective == pytest.approx(5026.62, abs=0.05)
    best, other = solution.extremals[:2]
    assert best.nature is Nature.BEST
    assert other.nature is Nature.UNPROVED and -other.objective == pytest.approx(4818.7, abs=0.5)
    direct = pl.solve(problem, pl.Pseudospectral(polish=False), verify=0)
    assert direct.objective == pytest.approx(solution.objective, rel=1e-5)
