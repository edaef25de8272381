"""The direct method against closed forms, its costates against re-solved problems, its refusals by text."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from perilune.core import NUMERIC, InfeasibleError, NotConvergedError, Outcome, PeriluneError
from perilune.methods.direct.pseudospectral import Pseudospectral
from perilune.methods.indirect.indirect import Indirect
from perilune.models import MOON, Orbit, Retro, Vehicle, hybrid_landing
from perilune.problem import Conditions, FreeParameter, Parameter, Problem, ScalarControl, Variable
from perilune.solve import solve
from problems.ascents import tangent_steering
from problems.integrators import least_energy, least_time
from problems.landings import meditch
from problems.staging import staged_burns

SCHEMES = ("gauss", "radau")
VEHICLE = Vehicle(mass=300.0, thrust=440.0, specific_impulse=310.0, standard_gravity=9.81)
ORBIT = Orbit(parking_altitude=100e3, perilune_altitude=15e3)


def hamiltonian(solution, phase=0, points=40):
    """lambda.f along a phase, where the problem has no running cost."""
    flown, definition = solution.trajectories[phase], solution.problem.phases[phase]
    t = np.linspace(0.0, flown.duration, points)
    rates = definition.rates(flown.state(t).T, flown.control(t).T, solution.parameters)
    return sum(lam * np.broadcast_to(f, t.shape) for lam, f in zip(flown.costate(t).T, rates, strict=True))


def costate(solution, phase=0):
    found = solution.trajectories[phase].costate
    assert found is not None
    return found


@pytest.mark.parametrize("scheme", SCHEMES)
def test_linear_tangent_steering(scheme):
    s = Pseudospectral(scheme=scheme).run(tangent_steering())
    assert s.objective == pytest.approx(0.554570878334603, abs=2e-11)  # measured 1e-12
    assert s.outcome is Outcome.SOLVED
    assert np.abs(hamiltonian(s) + 1.0).max() < 1e-6  # H + 1 = 0 for J = t_f; measured 2e-8
    t = np.linspace(0, s.objective, 7)
    u = s.trajectories[0].control(t)
    assert np.linalg.norm(u, axis=1) == pytest.approx(np.ones(7), abs=1e-8)
    tangent = u[:, 1] / u[:, 0]
    assert np.diff(tangent, 2) == pytest.approx(np.zeros(5), abs=1e-5)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_convergence_is_spectral(scheme):
    errors = [
        abs(Pseudospectral(scheme=scheme, nodes=n, refine=0).run(tangent_steering()).objective - 0.554570878334603)
        for n in (4, 8, 12)
    ]
    assert errors[0] / errors[1] > 50 and errors[1] / errors[2] > 50, errors


@pytest.mark.parametrize("scheme", SCHEMES)
def test_meditch_switches_where_it_must(scheme):
    lines: list[str] = []
    s = Pseudospectral(scheme=scheme).run(meditch(), callback=lambda line: lines.append(str(line)))
    assert s.objective == pytest.approx(1.42031259905, abs=1e-8)
    assert 2.349 * (1 - s.trajectories[0].state.values[-1, 2]) == pytest.approx(s.objective, abs=1e-6)
    assert [line.split(":")[0] for line in lines if "nodes" in line][:2] == ["mesh 0", "mesh 1"]
    told = [line.split(": ", 1) for line in lines if "mesh" not in line.split(":")[0]]
    assert told[0] == ["direct method", told[1][0]] and told[1][1].startswith("solved in")  # before and behind it
    assert s.statistics.residual <= 1e-6 < s.statistics.history[0].residual
    flown = s.trajectories[0]
    jump = flown.time[1:][np.diff(flown.time) == 0]
    before, after = flown.control(jump - 1e-6)[:, 0], flown.control(jump)[:, 0]
    switch = [k for k in range(len(jump)) if after[k] - before[k] > 1.0]
    assert len(switch) == 1
    u = flown.control(np.linspace(0, flown.duration, 501))[:, 0]
    assert np.minimum(np.abs(u), np.abs(u - 1.227)).max() < 1e-9
    assert np.abs(hamiltonian(s)).max() < 1e-5  # measured 4e-6
    # Switching function 1 + lam_v/m - lam_m/c changes sign there.
    lam, x = costate(s)(jump[switch])[0], flown.state(jump[switch])[0]
    assert 1 + lam[1] / x[2] - lam[2] / 2.349 == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_double_integrator_in_closed_form(scheme):
    s = Pseudospectral(scheme=scheme, nodes=8).run(least_energy())
    t = np.linspace(0.0, 1.0, 11)
    assert s.objective == pytest.approx(2.0, abs=1e-12)
    assert s.trajectories[0].state(t)[:, 0] == pytest.approx(t - t * t, abs=1e-11)
    assert s.trajectories[0].control(t)[:, 0] == pytest.approx(-2.0 * np.ones(11), abs=1e-10)
    assert costate(s)(t) == pytest.approx(np.tile([0.0, 2.0, 1.0], (11, 1)), abs=1e-10)
    assert s.multipliers["swing.speed"] == pytest.approx(2.0, abs=1e-10)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_active_state_bound(scheme):
    """Bryson, Denham, Dreyfus 1963, l = 0.1: J = 4/(9 l), lam_x(0) = 2/(9 l^2), x = l from 3 l to 1 - 3 l."""
    s = Pseudospectral(scheme=scheme, segments=4, nodes=8, tolerance=2e-6).run(least_energy(0.1))
    assert s.objective == pytest.approx(4 / 0.9, abs=2e-4)
    lam = costate(s)
    assert lam(0.0)[0] == pytest.approx(2 / 0.09, rel=5e-3)
    assert lam(0.0)[1] == pytest.approx(2 / 0.3, rel=2e-3)
    assert s.trajectories[0].state(np.linspace(0, 1, 301))[:, 0].max() <= 0.1 + 1e-5
    # J hardly notices how close the middle stays to the limit; measured 2e-5.
    assert s.trajectories[0].state(np.linspace(0.4, 0.6, 9))[:, 0] == pytest.approx(np.full(9, 0.1), abs=1e-4)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_two_phases_with_a_mass_drop(scheme):
    s = Pseudospectral(scheme=scheme).run(staged_burns())
    assert -s.objective == pytest.approx(3000 * (math.log(100 / 60) + math.log(40 / 15)), rel=1e-9)
    assert s.free["t_1"] == pytest.approx(60.0, abs=1e-6)
    assert s.free["t_2"] == pytest.approx(150.0, abs=1e-6)
    first, second = s.trajectories
    assert first.state(first.duration)[0] == pytest.approx(second.state(0.0)[0], abs=1e-6)
    assert costate(s)(0.0) == pytest.approx([-1.0, -30.0], rel=1e-6)  # dJ/dm0 = -c/m0
    assert costate(s, 1)(0.0) == pytest.approx([-1.0, -75.0], rel=1e-6)
    assert costate(s, 1)(second.duration) == pytest.approx([-1.0, -200.0], rel=1e-6)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("segments", [1, 3])
def test_lander_costates_are_the_sensitivities(scheme, segments):
    """lambda(0) . dx0/dq = dJ*/dq for parameters q that only move the start."""
    problem = hybrid_landing(VEHICLE, None, ORBIT, MOON)
    method = Pseudospectral(scheme=scheme, segments=segments, nodes=20 if segments == 1 else 12, refine=0)
    s = method.run(problem)
    lam = costate(s)
    for name, step in (
        ("vehicle_mass", 0.02),
        ("orbit_parking_altitude", 100.0),
        ("orbit_perilune_altitude", 5.0),
    ):
        moved = [problem.with_given(**{name: problem.given[name].value + sign * step}) for sign in (1, -1)]
        slope = (method.run(moved[0]).objective - method.run(moved[1]).objective) / (2 * step)
        start = [np.array(q.start(q.parameters(s.free), NUMERIC), dtype=float) for q in moved]
        assert lam(0.0) @ (start[0] - start[1]) / (2 * step) == pytest.approx(slope, rel=1e-5)
    # H = 0 for the free time, against a mass flow term of 0.06 kg/s
    assert np.abs(hamiltonian(s)).max() < 1e-6


def test_hybrid_lander_from_nothing_finds_the_large_retro_burn():
    s = Pseudospectral(refine=0).run(hybrid_landing(VEHICLE, Retro(specific_impulse=310.0), ORBIT, MOON))
    fixed = Pseudospectral(refine=0).run(
        hybrid_landing(VEHICLE, Retro(specific_impulse=310.0, delta_v=s.free["retro_delta_v"]), ORBIT, MOON)
    )
    assert 1195 < s.free["retro_delta_v"] < 1205 and fixed.objective == pytest.approx(s.objective, abs=1e-8)
    lam = costate(s)
    assert abs(lam(0.0)[3] / lam(0.0)[2]) < 1e-6  # equal Isp: lambda_v(0) = 0


def test_any_solution_is_a_guess():
    problem = hybrid_landing(VEHICLE, Retro(specific_impulse=310.0, delta_v=1000.0), ORBIT, MOON)
    first = Pseudospectral(refine=0).run(problem)
    again = Pseudospectral(scheme="radau", segments=2, refine=0, nodes=12).run(problem, guess=first)
    assert again.objective == pytest.approx(first.objective, abs=1e-6)
    assert again.statistics.iterations < first.statistics.iterations
    freed = hybrid_landing(VEHICLE, Retro(specific_impulse=310.0), ORBIT, MOON)
    assert Pseudospectral(refine=0).run(freed, guess=first).objective < first.objective


def test_the_answer_does_not_depend_on_the_scales():
    base = hybrid_landing(VEHICLE, None, ORBIT, MOON)
    other = replace(base, scales=replace(base.scales, length=base.scales.length / 3, mass=base.scales.mass * 2))
    a, b = (Pseudospectral(refine=0).run(q) for q in (base, other))
    assert a.objective == pytest.approx(b.objective, abs=1e-7)
    assert costate(a)(0.0) == pytest.approx(costate(b)(0.0), rel=1e-5, abs=1e-12)


def test_the_mesh_error_exposes_a_coarse_mesh():
    coarse, fine = (Pseudospectral(nodes=n, refine=0).run(hybrid_landing(VEHICLE, None, ORBIT, MOON)) for n in (5, 20))
    assert coarse.statistics.residual > 1e-5 > 1e-7 > fine.statistics.residual
    t = np.linspace(0.0, 1000.0, 50)
    distance = np.abs(coarse.trajectories[0].state(t) - fine.trajectories[0].state(t))[:, 0].max()
    assert distance > 10.0  # metres: the coarse trajectory is wrong by that much, and says so


# refusals


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"scheme": "lobatto"}, "unknown collocation scheme"),
        ({"nodes": 1}, "at least two collocation points"),
        ({"nodes": 201}, "too many collocation points"),
        ({"segments": 0}, "segments is too small"),
        ({"refine": -1}, "refine is too small"),
        ({"iterations": 0}, "iterations is too small"),
        ({"tolerance": 0.0}, "tolerance must lie between 0 and 1"),
        ({"polish": "no"}, "polish must be True or False"),
        ({"nlp_tolerance": math.nan}, "nlp_tolerance must lie between 0 and 1"),
    ],
)
def test_bad_settings(settings, text):
    with pytest.raises(PeriluneError, match=text):
        Pseudospectral(**settings)


def with_state(problem, index, **bounds):
    """The problem with other bounds of one state of its first phase."""
    phase = problem.phases[0]
    states = list(phase.states)
    states[index] = replace(states[index], **bounds)
    return replace(problem, phases=(replace(phase, states=tuple(states)), *problem.phases[1:]))


def test_bounds_that_exclude_the_start_are_named():
    with pytest.raises(InfeasibleError, match=r"the start puts h outside its bounds[\s\S]*1 m[\s\S]*at most 0.5 m"):
        Pseudospectral().run(with_state(meditch(), 0, upper=0.5))


def test_bounds_that_exclude_the_end_are_named():
    with pytest.raises(InfeasibleError, match=r"end condition speed of swing puts v outside its bounds[\s\S]*-1 m/s"):
        Pseudospectral().run(with_state(least_energy(), 1, lower=-0.5))


def test_empty_control_bounds_are_named():
    problem = least_energy()
    with pytest.raises(PeriluneError, match=r"bounds of control u are empty[\s\S]*\[2, 1\] m/s\^2") as refused:
        ScalarControl(name="u", unit="m/s^2", lower=2.0, upper=1.0)
    assert refused.value.exit_code == 2
    crossed = replace(problem.phases[0], controls=(ScalarControl(name="u", unit="m/s^2", lower="least", upper=1.0),))
    given = {**problem.given, "least": Parameter(value=2.0, unit="m/s^2")}
    for method in (Pseudospectral(), Indirect()):
        with pytest.raises(PeriluneError, match="bounds of u are empty") as refused:
            solve(replace(problem, phases=(crossed,), given=given), method)
        assert refused.value.exit_code == 2


def test_a_phase_without_length_is_named():
    with pytest.raises(PeriluneError, match=r"T is the length of a phase[\s\S]*at most -1 s") as refused:
        least_energy().with_given(T=-1.0)
    assert refused.value.exit_code == 2


def test_an_unreachable_end_is_reported_in_physical_units():
    problem = least_energy()
    weak = replace(problem.phases[0], controls=(ScalarControl(name="u", unit="m/s^2", lower=-1.0, upper=1.0),))
    with pytest.raises(NotConvergedError, match=r"no trajectory[\s\S]*swing.\w+ is missed by [\d.]+ m") as e:
        Pseudospectral().run(replace(problem, phases=(weak,)))
    # u = -1 throughout comes nearest: x(1) = 1/2 and v(1) = 0 instead of 0 and -1.
    assert e.value.partial["violations"] == [
        "the end condition swing.speed is missed by 1 m/s",
        "the end condition swing.place is missed by 0.5 m",
    ]
    assert e.value.exit_code == 4
    assert e.value.partial["violations"] and "Restoration" not in str(e.value)


def test_a_lander_out_of_propellant_is_reported_in_physical_units():
    problem = hybrid_landing(VEHICLE, None, ORBIT, MOON)
    free = (FreeParameter(name="flight_time", unit="s", lower=0.0, upper=300.0, guess=200.0),)
    with pytest.raises(
        NotConvergedError,
        match=r"best of 4 found violates the end condition descent.touchdown_transverse_velocity by [\d.]+ m/s",
    ) as caught:
        Pseudospectral(refine=0, iterations=60).run(replace(problem, free=free, parameter_bounds=None))
    assert caught.value.exit_code == 4 and caught.value.flight is not None
    # 300 s of thrust: less than its ideal velocity change of the 1692 m/s is gone, gravity's share apart.
    missed = float(re.search(r"velocity by ([\d.]+) m/s", caught.value.what).group(1))  # type: ignore[union-attr]
    assert missed > 1690 - 310 * 9.81 * math.log(300 / (300 - 300 * 440 / (310 * 9.81)))
    tried = caught.value.partial["attempts"]
    assert len([line for line in tried if line.startswith("nearest miss, straight line")]) == 4


def slow_move(fastest: float) -> Problem:
    """Rest to rest over 1 m in 3 s at most with |u| <= 1 m/s^2: it takes a speed of (3 - sqrt(5))/2 = 0.381966 m/s."""
    base = least_time()
    phase = replace(
        base.phases[0],
        path=Conditions(lambda x, u, p, xp: (p.fastest - x.v,), slower="m/s"),
    )
    given = {**base.given, "fastest": Parameter(value=fastest, unit="m/s")}
    return replace(base, phases=(phase,), given=given, free=(replace(base.free[0], upper=3.0),))


def test_the_least_miss_of_a_path_condition():
    """A metre of the way takes less speed than a metre a second: the limit is missed, by the closed form."""
    coarse = Pseudospectral(nodes=5, segments=8, refine=0)
    assert coarse.run(slow_move(0.4)).free["t_f"] <= 3.0
    with pytest.raises(NotConvergedError, match=r"violates the path condition move.slower \(fastest\) by") as caught:
        coarse.run(slow_move(0.3))
    (told,) = caught.value.partial["violations"]
    missed = float(told.split()[-2])
    assert missed == pytest.approx(0.5 * (3 - math.sqrt(5)) - 0.3, rel=0.02)


def test_a_miss_within_the_error_of_the_mesh_is_no_refusal():
    """Half a millimetre a second too slow is nothing that five nodes can tell."""
    with pytest.raises(NotConvergedError, match="no trajectory was found that meets every condition") as caught:
        Pseudospectral(nodes=5, refine=0).run(slow_move(0.3814))
    assert any("the error of the mesh" in line for line in caught.value.partial["attempts"])


def test_a_large_mesh_is_not_searched_again_for_a_miss_that_two_starts_lead_to(monkeypatch):
    """Both say by how much the way takes more speed; on a small mesh all starts do, and where the mesh may err."""
    coarse, tried = Pseudospectral(nodes=5, segments=8, refine=0), {}
    for limit, large in ((0.3, 1000), (0.3, 100), (0.3814, 100)):
        monkeypatch.setattr("perilune.direct.initialization.LARGE", large)
        with pytest.raises(NotConvergedError) as caught:
            (coarse if limit == 0.3 else Pseudospectral(nodes=5, refine=0)).run(slow_move(limit))
        lines = caught.value.partial["attempts"]
        tried[limit, large] = [line for line in lines if line.startswith("nearest miss")]
        if limit == 0.3:
            assert "violates the path condition move.slower" in caught.value.what
    assert len(tried[0.3, 1000]) == 5 and len(tried[0.3, 100]) == 2 and len(tried[0.3814, 100]) > 2


def test_too_few_refinements_are_reported_with_the_error_of_each_state():
    with pytest.raises(NotConvergedError, match=r"requested accuracy[\s\S]*descent: h [\d.e-]+ m, v "):
        Pseudospectral(refine=1, tolerance=1e-9).run(meditch())


def test_a_jump_is_named_where_the_mesh_cannot_follow_it():
    problem = meditch()
    phase = problem.phases[0]

    def heavier_below(x, u, p, xp):
        rates = list(phase.dynamics(x, u, p, xp))
        rates[1] = rates[1] - xp.where(x.h < 0.5 * p.h, 0.2 * p.g, 0.0 * p.g)
        return rates

    with pytest.raises(NotConvergedError, match=r"requested accuracy[\s\S]*descent switch \(xp.where\)") as e:
        Pseudospectral(refine=1).run(replace(problem, phases=(replace(phase, dynamics=heavier_below),)))
    assert "H_u" not in str(e.value)
    with pytest.raises(NotConvergedError, match="H_u"):
        Pseudospectral(refine=1, tolerance=1e-9).run(problem)


def test_what_is_undefined_on_the_way_is_not_printed(capfd):
    problem = meditch()
    phase = problem.phases[0]

    def rooted(x, u, p, xp):
        rates = list(phase.dynamics(x, u, p, xp))
        rates[1] = rates[1] + p.g - p.g * xp.sqrt(x.h / p.h)  # NaN below the ground, where the search comes by
        return rates

    with suppress(NotConvergedError):
        Pseudospectral(refine=0, iterations=20).run(replace(problem, phases=(replace(phase, dynamics=rooted),)))
    told = capfd.readouterr()
    assert told.out == told.err == ""


def test_a_guess_with_other_phases_or_states_is_refused():
    swing = Pseudospectral(refine=0).run(least_energy())
    with pytest.raises(PeriluneError, match=r"does not fit phase only[\s\S]*3 states and 1 controls"):
        Pseudospectral().run(tangent_steering(), guess=swing)
    with pytest.raises(PeriluneError, match="another number of phases"):
        Pseudospectral().run(least_energy(), guess=replace(swing, trajectories=tuple(swing.trajectories) * 2))


def test_too_few_iterations_are_reported():
    with pytest.raises(NotConvergedError) as e:
        Pseudospectral(iterations=2).run(meditch())
    # Briefly, for the least miss from 4 straight lines and the flight under the first one's controls, and from these;
    # the first of them all is not tried twice.
    assert len(e.value.partial["attempts"]) == 10


def test_state_bounds_hold():
    problem = with_state(least_energy(), 0, upper=0.2)
    s = Pseudospectral(segments=3, nodes=8, tolerance=1e-4).run(problem)
    assert s.trajectories[0].state(np.linspace(0, 1, 201))[:, 0].max() < 0.2 + 1e-4
    assert isinstance(problem.phases[0].states[0], Variable)


def test_as_many_points_as_a_segment_may_have_are_flown() -> None:
    """Looked at on twice as many, which are nobody's setting."""
    assert Pseudospectral(nodes=101, refine=0).run(least_energy()).objective == pytest.approx(2.0, rel=1e-9)
