"""Scales of single variables: another size to compute in, the same answer."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune import Pseudospectral
from perilune.conditions.pontryagin import derive
from perilune.core import NUMERIC, NotConvergedError, PeriluneError
from perilune.methods.evolutionary.fitness import ControlFitness
from perilune.methods.indirect.unknowns import residual_scales
from perilune.problem.casadi_trace import state_scales
from perilune.problem.problem import Problem
from perilune.verify import verify
from problems import LIBRARY
from problems.entry import cool_entry

KNOWN = {answered.name: answered for answered in LIBRARY}


def sized(problem: Problem, **scales: float) -> Problem:
    """The problem with scales of its states, as multiples of the size of their units."""

    def own(states: tuple[pl.Variable, ...]) -> tuple[pl.Variable, ...]:
        return tuple(
            replace(v, scale=scales[v.name] * problem.scales.of(v.unit)) if v.name in scales else v for v in states
        )

    return replace(problem, phases=tuple(replace(phase, states=own(phase.states)) for phase in problem.phases))


# -- the same answer --------------------------------------------------------------------------------------------------


CASES = [
    ("least energy", "cost"),  # the last state is J
    ("least time, bang-bang", "x"),  # switches
    ("linear tangent steering, two phases", "vx"),  # a link
    ("lunar ascent", "m"),
    ("ordinary landing", "u"),  # a path condition
]


@pytest.mark.parametrize("factor", [1e-3, 1e3])
@pytest.mark.parametrize(("name", "state"), [*CASES, ("hybrid landing", "r")])  # a start that depends on what is free
def test_absurd_sizes_change_no_extremal(name: str, state: str, factor: float) -> None:
    """In SI: J, free parameters, the costates; and it is proved."""
    _agree(name, pl.Indirect(), state, factor, 1e-10)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
@pytest.mark.parametrize(("name", "state"), CASES)
def test_absurd_sizes_change_no_direct_answer(name: str, state: str, factor: float) -> None:
    _agree(name, Pseudospectral(), state, factor, 1e-7)


def _agree(name: str, method: Any, state: str, factor: float, accuracy: float) -> None:
    problem = KNOWN[name].make()
    natural, absurd = (pl.solve(p, method, verify=3) for p in (problem, sized(problem, **{state: factor})))
    assert absurd.objective == pytest.approx(natural.objective, rel=accuracy)
    assert absurd.free == pytest.approx(natural.free, rel=1e2 * accuracy)
    for one, other in zip(natural.trajectories, absurd.trajectories, strict=True):
        assert one.costate is not None and other.costate is not None
        size = np.abs(one.costate.values).max(axis=0)
        error = np.abs(other.costate.values[0] - one.costate.values[0])
        assert (error <= 1e3 * accuracy * size + 1e-12).all()
    assert absurd.verification.level == natural.verification.level, str(absurd.verification)
    assert isinstance(method, Pseudospectral) or natural.verification.level == 3


def test_sizes_of_conditions_and_of_the_objective_change_no_answer() -> None:
    """Multipliers are in SI too."""
    problem = KNOWN["lunar ascent"].make()
    phase = problem.phases[0]
    ends = tuple(replace(c, scale=7.0 * problem.scales.of(c.unit)) for c in phase.end_conditions)
    other = replace(
        problem,
        phases=(replace(phase, end=pl.Conditions.of(phase.end, ends)),),
        objective_scale=20.0 * problem.scales.of(problem.objective_unit),
    )
    natural, changed = (pl.solve(p, verify=3) for p in (problem, other))
    assert changed.objective == pytest.approx(natural.objective, rel=1e-11)
    assert changed.multipliers == pytest.approx(natural.multipliers, rel=1e-8)
    assert natural.verification.level == changed.verification.level == 3, str(changed.verification)


def test_a_heat_load_beside_kilometres() -> None:
    """1e7 J/m^2 where the unit of mass, length and time makes 0.2 J/m^2: the same method fails, and is at once proved.

    With its usual settings it fails too, after half a minute.
    """
    method = pl.Indirect(starts=10, transcription=Pseudospectral(nodes=20, refine=0, iterations=100))
    with pytest.raises(NotConvergedError):
        pl.solve(cool_entry(), method)
    solution = pl.solve(cool_entry(heat=1e7), method, verify=3)
    assert solution.outcome is pl.Outcome.PROVED, str(solution.verification)
    direct = pl.solve(cool_entry(heat=1e7), Pseudospectral(tolerance=1e-5), guess=solution, verify=0)
    assert solution.objective == pytest.approx(direct.objective, rel=1e-6)


def test_a_population_is_judged_alike() -> None:
    """The flights of `fitness.py`, which are NumPy's."""
    problem = KNOWN["lunar ascent"].make()
    judges = [ControlFitness(p) for p in (problem, sized(problem, y=1e-2, vx=30.0, m=5.0))]
    genes = np.random.default_rng(1).uniform(judges[0].lower, judges[0].upper, (20, len(judges[0].lower)))
    np.testing.assert_allclose(judges[1](genes), judges[0](genes), rtol=1e-9)
    one, other = (judge.guess(genes[3]).trajectories[0].state.values for judge in judges)
    np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-6)


# -- what a size is ---------------------------------------------------------------------------------------------------


def test_canonical_physics_is_the_users_in_other_units() -> None:
    problem = sized(KNOWN["hybrid landing"].make(), r=0.25, m=3.0)
    phase, scales = problem.phases[0], problem.scales
    sizes = state_scales(problem, phase)
    assert sizes[0] == 0.25 * scales.length and sizes[4] == 3.0 * scales.mass and sizes[2] == scales.of("m/s")
    x = np.array([1.75e6, 3.2, 1500.0, -20.0, 250.0])
    u = (0.6, 0.8)
    known = problem.parameters({f.name: f.guess for f in problem.free})
    p = type(known)(**{n: v / scales.of(problem.unit_of(n)) for n, v in vars(known).items()})
    inside = problem.canonical
    rates = np.array(inside.phases[0].rates(x / sizes, u, p))
    np.testing.assert_allclose(rates * sizes / scales.time, phase.rates(x, u, known), rtol=1e-12)
    np.testing.assert_allclose(np.array(inside.start(p, NUMERIC)) * sizes, problem.start(known, NUMERIC), rtol=1e-12)
    J = inside.objective(phase.state_record(*(x / sizes)), p, NUMERIC)
    assert J * problem.objective_size == pytest.approx(-250.0)
    residuals = residual_scales(problem, derive(problem))
    plain = residual_scales(KNOWN["hybrid landing"].make(), derive(KNOWN["hybrid landing"].make()))
    assert (plain / residuals)[3:8] == pytest.approx([0.25, 1.0, 1.0, 1.0, 3.0])  # transversality, J per state


def test_without_scales_nothing_is_done() -> None:
    problem = KNOWN["hybrid landing"].make()
    assert problem.canonical is problem


def test_derivations_are_shared_by_equal_sizes_only() -> None:
    """The physics is the same, and has the same address; what is computed with is not."""
    problem = KNOWN["least energy"].make()
    one, same, other = sized(problem, x=5.0), sized(problem, x=5.0), sized(problem, x=6.0)
    assert problem.form == one.form == other.form
    assert one == same and hash(one) == hash(same) and one not in (problem, other)
    assert derive(one) is derive(same)
    assert derive(one) is not derive(other) and derive(one) is not derive(problem)


def test_a_state_and_a_condition_of_one_name_are_two() -> None:
    phase = KNOWN["lunar ascent"].make().phases[0]
    sizes = ((1e5, None), (None, 1e5))
    both = [
        replace(
            KNOWN["lunar ascent"].make(),
            phases=(
                replace(
                    phase,
                    states=(replace(phase.states[0], scale=state), *phase.states[1:]),
                    end=pl.Conditions.of(
                        phase.end, (replace(phase.end_conditions[0], name="y", scale=end), *phase.end_conditions[1:])
                    ),
                ),
            ),
        )
        for state, end in sizes
    ]
    assert both[0] != both[1] and derive(both[0]) is not derive(both[1])


def test_a_guess_of_other_sizes_is_taken_as_a_flight() -> None:
    """Its own unknowns are of another size."""
    problem = KNOWN["lunar ascent"].make()
    guess = pl.solve(problem, verify=0)
    again = pl.solve(sized(problem, m=40.0), guess=guess, verify=0)
    assert again.statistics.initialization == "guess"
    assert again.objective == pytest.approx(guess.objective, rel=1e-11)


# -- saved ------------------------------------------------------------------------------------------------------------


def test_scales_travel_and_are_saved(tmp_path: Path) -> None:
    solution = pl.solve(cool_entry(heat=1e7), verify=0)
    pl.save(solution, tmp_path / "entry")
    back = pl.load(tmp_path / "entry")
    assert back.problem == solution.problem == pickle.loads(pickle.dumps(solution.problem))
    assert back.problem.phases[0].states[3].scale == back.problem.objective_scale == 1e7
    assert verify(back, 3).outcome is pl.Outcome.PROVED
    again = pl.solve(back.problem, guess=back, verify=0)
    assert again.objective == pytest.approx(solution.objective, rel=1e-12)


@pytest.mark.parametrize("scale", [0.0, -3.0, "big", True, 1e999])
def test_a_file_with_no_size_is_refused(scale: object, tmp_path: Path) -> None:
    pl.save(pl.solve(KNOWN["least energy"].make(), verify=0), tmp_path / "s")
    file = tmp_path / "s" / "solution.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    document["problem"]["phases"][0]["states"][0]["scale"] = scale
    file.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(PeriluneError, match=r"scale|not finite"):
        pl.load(tmp_path / "s")


# -- mistakes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [0, 0.0, -1.0, math.nan, math.inf, "1 km", True, 1j], ids=repr)
@pytest.mark.parametrize(
    "state",
    [lambda s: pl.Variable(name="Q", unit="J/m^2", scale=s), lambda s: replace(cool_entry(), objective_scale=s)],
    ids=["state", "objective"],
)
def test_what_is_no_size_is_refused(state: Callable[[Any], Any], scale: Any) -> None:
    with pytest.raises(PeriluneError, match="is not a magnitude") as caught:
        state(scale)
    assert caught.value.got == repr(scale)


@pytest.mark.parametrize("scale", [2, np.float64(2.0), 2.0])
def test_numbers_are_sizes(scale: float) -> None:
    assert pl.Variable(name="h", unit="m", scale=scale).scale == 2.0


def test_a_scale_without_effect_is_refused() -> None:
    problem = KNOWN["least energy"].make()
    phase = replace(
        problem.phases[0],
        outputs=pl.Quantities(
            lambda x, u, p, xp: (x.x,), pl.Variable(name="place", unit=problem.phases[0].states[0].unit, scale=2.0)
        ),
    )
    with pytest.raises(PeriluneError, match="place has a scale"):
        replace(problem, phases=(phase,))


# -- the proof --------------------------------------------------------------------------------------------------------


def test_no_stated_size_loosens_the_proof_at_will() -> None:
    """A file may state any scale: a table that is wrong, or an end that is missed, shows all the same."""
    solution = pl.solve(KNOWN["lunar ascent"].make(), verify=0)
    problem, flown = solution.problem, solution.trajectories[0]
    phase = problem.phases[0]
    ends = pl.Conditions.of(phase.end, (replace(v, scale=1e30) for v in phase.end_conditions))
    huge = replace(phase, states=tuple(replace(v, scale=1e30) for v in phase.states), end=ends)
    stated = replace(problem, phases=(huge,), objective_scale=1e30)
    honest = pl.verify(replace(solution, problem=stated), level=2).verification
    assert honest.passed, str(honest)
    values = flown.state.values.copy()
    values[len(values) // 2, 0] *= 1.0 + 1e-6
    bent = replace(flown, state=replace(flown.state, values=values))
    short = replace(flown, control=_turned(flown.control, 1e-5))
    for trajectory, name in ((bent, "state_y"), (short, "height")):
        checks = pl.verify(replace(solution, problem=stated, trajectories=(trajectory,)), level=1).verification.checks
        assert name in {c.name for c in checks if not c.passed}
    claimed = replace(solution, problem=stated, objective=solution.objective * (1 + 1e-6))
    assert "objective" in {c.name for c in pl.verify(claimed, level=1).verification.checks if not c.passed}


def _turned(control: Any, angle: float) -> Any:
    """The direction turned all along."""
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    return replace(control, values=control.values @ turn, rates=control.rates @ turn)
