"""The control keeps conditions of the path in which it acts: held on them where H asks for more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from perilune import Pseudospectral
from perilune.conditions.canonical_equations import extremal_parameters
from perilune.conditions.pontryagin import attainable_conditions, derive
from perilune.methods.indirect.initializers import ColdStarts
from perilune.models.descent.coordinates import variables_of_unit
from perilune.problem import (
    Conditions,
    FreeParameter,
    Parameter,
    Phase,
    Problem,
    ScalarControl,
    UnitVectorControl,
    Variable,
)
from perilune.scenario import load_file
from perilune.solve import solve

EXAMPLE = Path(__file__).parents[2] / "examples" / "precision_landing.toml"
STEEPEST, HEIGHT, DURATION = 0.5, 0.22, 1.0  # sine of the greatest elevation, height to reach [m], time [s]


def _rates(x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
    return x.vx, x.vy, p.push * u.along, p.push * u.up


def _steered(*, path: Any, names: tuple[str, ...], of: str = "1", **given: float) -> Problem:
    """As far as possible in a given time, to a given height, with a thrust of one size: linear tangent steering."""
    phase = Phase(
        name="burn",
        states=(*variables_of_unit("m", "x", "y"), *variables_of_unit("m/s", "vx", "vy")),
        controls=(UnitVectorControl(names=("along", "up")),),
        dynamics=_rates,
        duration="T",
        end=Conditions(lambda x, p, xp: (x.y - p.height,), height="m"),
        path=Conditions(path, *variables_of_unit(of, *names)),
    )
    units = {"push": "m/s^2", "height": "m", "T": "s"}
    values = {"push": 1.0, "height": HEIGHT, "T": DURATION, "steepest": STEEPEST, **given}
    return Problem(
        name="steered",
        phases=(phase,),
        start=lambda p, xp: (0 * p.height, 0 * p.height, 0 * p.push * p.T, 0 * p.push * p.T),
        given={name: Parameter(value=value, unit=units.get(name, "1")) for name, value in values.items()},
        objective=lambda x, p, xp: -x.vx,
        objective_unit="m/s",
    )


def _clipped(least: float = -1.0) -> tuple[float, float, float]:
    """(J, lambda_y, time at which the limit is left) where lambda_vy = lambda_y (T - t) and lambda_vx = -1.

    The thrust is at tan(elevation) = -lambda_vy, or at the limit where that is steeper.
    """
    nodes, weights = np.polynomial.legendre.leggauss(60)

    def flown(slope: float) -> tuple[float, float, float]:
        leaves = DURATION - math.tan(math.asin(STEEPEST)) / slope
        kinks = (DURATION - math.tan(math.asin(sine)) / slope for sine in (STEEPEST, max(least, 0.0)))
        edges = [0.0, *(t for t in kinks if 0 < t < DURATION), DURATION]
        height, speed = 0.0, 0.0
        for left, right in pairwise(edges):
            t = left + 0.5 * (right - left) * (1 + nodes)
            w = 0.5 * (right - left) * weights
            sine = np.clip(np.sin(np.arctan(slope * (DURATION - t))), least, STEEPEST)
            height += float(w @ (sine * (DURATION - t)))
            speed += float(w @ np.sqrt(1 - sine * sine))
        return height, speed, leaves

    slope: Any = brentq(lambda k: flown(k)[0] - HEIGHT, 1e-3, 50.0, xtol=1e-15)
    _, speed, leaves = flown(slope)
    return -speed, -slope, leaves


def test_linear_tangent_steering_under_a_limit_is_its_closed_form() -> None:
    problem = _steered(path=lambda x, u, p, xp: (p.steepest - u.up,), names=("below_steepest",))
    solution = solve(problem, verify=0)
    J, slope, leaves = _clipped()
    assert 0.2 < leaves < 0.8  # the limit holds for a good part of the flight
    assert solution.objective == pytest.approx(J, abs=1e-11)
    flown = solution.trajectories[0]
    assert flown.costate is not None
    assert flown.costate.values[0, 1] == pytest.approx(slope, abs=1e-9)
    breaks = flown.control.time[1:][np.diff(flown.control.time) == 0]
    assert breaks == pytest.approx([leaves], abs=1e-9)
    held = flown.control(np.linspace(0.0, 0.999 * leaves, 50))[:, 1]
    assert held == pytest.approx(STEEPEST, abs=1e-10)


def test_a_limit_that_the_direct_solution_meets_is_kept_where_no_extremal_tells_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As random costates without the limit may find nothing."""
    found = ColdStarts.from_random_costates
    monkeypatch.setattr(ColdStarts, "from_random_costates", lambda self: found(self) if self.keep else iter(()))
    problem = _steered(path=lambda x, u, p, xp: (p.steepest - u.up,), names=("below_steepest",))
    solution = solve(problem, verify=0)
    assert solution.objective == pytest.approx(_clipped()[0], abs=1e-11)
    assert any(line.startswith("random costates keeping steepest") for line in solution.statistics.attempts)


def test_a_limit_that_does_not_bind_changes_nothing() -> None:
    """It is not even derived: the control keeps only what an extremal broke."""
    path = {"path": lambda x, u, p, xp: (p.steepest - u.up,), "names": ("below_steepest",)}
    free, bound = solve(_steered(**path, steepest=2.0), verify=0), solve(_steered(**path, steepest=0.97), verify=0)
    assert free.objective == pytest.approx(bound.objective, abs=1e-12)


@pytest.mark.parametrize("met", ["pointing_margin", "throttle"])
def test_a_flight_that_begins_with_a_switch_begins_in_a_mode_that_has_it_ahead(met: str) -> None:
    """H is the same in both to within rounding, which chose: a quarter of these began behind a switch, for good.

    Thrust on the rim of its greatest tilt, and a switching function of zero, both to the last digits.
    """
    problem = load_file(EXAMPLE, ("corridor.tilt=40 deg",)).problem
    extremal, p = derive(problem, ("pointing_margin",)).phases[0], extremal_parameters(problem)
    tilt, rng, begun = math.radians(40.0), np.random.default_rng(1), list[int]()
    for _ in range(200):
        z, around = rng.uniform(0.5, 1.5, 14), rng.uniform(0.0, 2 * math.pi)
        z[10:13] = -np.array([math.sin(tilt) * math.cos(around), math.sin(tilt) * math.sin(around), math.cos(tilt)])
        if met == "throttle":  # whose switching function is linear in the costate of the mass; the tilt is kept
            z[12] *= 1.5
            S = [float(extremal.events[0].function([*z[:13], lam], p)) for lam in (0.0, 1.0)]
            for _ in range(4):
                z[13] -= float(extremal.events[0].function(z, p)) / (S[1] - S[0])
        z[12 if met == "pointing_margin" else 13] *= 1.0 + rng.integers(-3, 4) * np.finfo(float).eps
        mode = int(extremal.mode(z, p))
        begun.append(mode)
        ahead = z + 1e-6 * np.array(extremal.modes[mode](z, p)).ravel()
        for event in (event for event in extremal.events if mode in event.switches):
            assert event.direction * (float(event.function(z, p)) or float(event.function(ahead, p))) <= 0.0
    assert len({*begun}) > 1


def test_two_limits_at_once() -> None:
    """A limit on the other side, met at the end: the same closed form, clipped twice."""
    problem = _steered(
        path=lambda x, u, p, xp: (p.steepest - u.up, u.up - p.flattest), names=("below", "above"), flattest=0.2
    )
    assert attainable_conditions(problem) == ("below", "above")
    solution = solve(problem, verify=0)
    J, _, _ = _clipped(least=0.2)
    assert solution.objective == pytest.approx(J, abs=1e-11)
    assert solution.objective > _clipped()[0] + 1e-4


@pytest.mark.parametrize(
    ("path", "names", "of"),
    [
        (lambda x, u, p, xp: (p.steepest * p.height - x.y,), ("low",), "m"),  # of a state alone
        (lambda x, u, p, xp: (p.steepest - u.up * u.up,), ("bent",), "1"),  # not linear
    ],
)
def test_what_the_control_cannot_keep_so(path: Any, names: tuple[str, ...], of: str) -> None:
    problem = _steered(path=path, names=names, of=of)
    assert attainable_conditions(problem) == ()
    assert len(derive(problem, names).phases[0].modes) == 1


def test_limits_about_one_axis_never_hold_together() -> None:
    """An elevation cannot be at both of its limits; about two axes there is a corner of each pair."""
    problem = load_file("examples/polar_descent.toml").problem
    keep = attainable_conditions(problem)
    assert keep == ("elevation_above_lower", "elevation_below_upper")
    assert set(derive(problem, keep).phases[0].held) == {(), (keep[0],), (keep[1],)}


@pytest.mark.parametrize("tilt", [45.0, 40.0, 30.0, 20.0])
def test_a_precision_landing_keeps_its_tilt(tilt: float) -> None:
    """As good as the direct method's flight, which keeps it at the points of its mesh."""
    problem = load_file("examples/precision_landing.toml", (f"corridor.tilt={tilt} deg",)).problem
    solution = solve(problem, verify=1)
    assert solution.verification is not None and solution.verification.passed
    rough = Pseudospectral(nodes=5, segments=12, refine=0).run(problem)
    assert solution.objective == pytest.approx(rough.objective, rel=2e-5)
    if tilt == 30.0:
        near = solve(problem.with_given(vehicle_mass=2010.0), guess=solution, verify=1)
        assert near.objective == pytest.approx(solve(near.problem, verify=0).objective, rel=1e-11)


def test_a_descent_keeps_an_elevation_that_turns_with_the_vertical() -> None:
    """The condition knows the place, so its multiplier acts on the costates."""
    problem = load_file("examples/polar_descent.toml", ("steering.elevation_upper=25 deg",)).problem
    solution = solve(problem, verify=1)
    assert solution.verification is not None and solution.verification.passed
    rough = Pseudospectral(nodes=5, segments=12, refine=0).run(problem)
    assert solution.objective == pytest.approx(rough.objective, rel=2e-6)


def test_a_free_parameter_in_a_condition_is_chosen_with_its_multiplier() -> None:
    """A steeper limit may be bought: at the optimum dJ/ds = 0, as differences of J over the limit say."""
    price = 0.05

    def at(steepest: float) -> float:
        problem = _steered(path=lambda x, u, p, xp: (p.steepest - u.up,), names=("below",), steepest=steepest)
        return solve(problem, verify=0).objective + price * steepest

    base = _steered(path=lambda x, u, p, xp: (p.steepest - u.up,), names=("below",))
    given = {name: g for name, g in base.given.items() if name != "steepest"}
    problem = Problem(
        name="bought",
        phases=base.phases,
        start=base.start,
        given=given,
        free=(FreeParameter(name="steepest", unit="1", guess=0.5),),
        objective=lambda x, p, xp: -x.vx + price * p.steepest * p.push * p.T,
        objective_unit="m/s",
    )
    guess = solve(base, verify=0)
    solution = solve(problem, guess=guess, verify=0)
    best = solution.free["steepest"]
    assert 0.35 < best < 0.9
    assert solution.objective == pytest.approx(at(best), abs=1e-9)
    assert min(at(best - 1e-3), at(best + 1e-3)) > solution.objective


def test_bounded_controls_beside_a_kept_condition() -> None:
    """A throttle beside it: regimes of both, each combination a mode."""
    problem = load_file("examples/precision_landing.toml").problem
    phase = derive(problem, attainable_conditions(problem)).phases[0]
    assert [*zip(phase.held, phase.regimes, strict=True)] == [
        ((), ("lower",)), ((), ("upper",)), (("pointing_margin",), ("lower",)), (("pointing_margin",), ("upper",)),
    ]  # fmt: skip
    assert ScalarControl in {type(control) for control in problem.phases[0].controls}
    assert Variable in {type(condition) for condition in problem.phases[0].path_conditions}
