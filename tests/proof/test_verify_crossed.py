"""Level 4: two methods agree on the paper's landing and on Meditch's, and every kind of disagreement is seen."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import pytest

from perilune import Indirect, Pseudospectral
from perilune.core import Outcome, PeriluneError
from perilune.methods.indirect.refinement.structure_search import StructureRefinement
from perilune.problem import Check, Curve, Nature, Problem, Solution, Verification
from perilune.proof.cross_check import check_agreement
from perilune.solve import solve
from perilune.verify import verify
from problems.integrators import CEILING, least_energy
from problems.landings import meditch


@dataclass(frozen=True, kw_only=True)
class Says:
    """A method that knows its answer, whatever the problem."""

    answer: Solution

    def run(self, problem: Problem, guess: Solution | None = None, callback: object = None) -> Solution:
        return self.answer


@dataclass(frozen=True, kw_only=True)
class Refuses:
    def run(self, problem: Problem, guess: Solution | None = None, callback: object = None) -> Solution:
        raise PeriluneError("the engine is cold")


def crossed(solution: Solution, other: object = None) -> dict[str, Check]:
    return {c.name: c for c in check_agreement(solution, other)}  # type: ignore[arg-type]


def disagreements(solution: Solution, other: object = None) -> set[str]:
    return {name for name, c in crossed(solution, other).items() if not c.passed}


@pytest.fixture(scope="module")
def direct(landing: Problem) -> Solution:
    return Pseudospectral().run(landing)


def test_the_papers_landing_is_cross_checked(landing: Problem) -> None:
    solution = solve(landing, verify=4)
    assert solution.outcome is Outcome.PROVED
    verification: Verification = solution.verification
    assert verification.level == 4, str(verification)
    names = [c.name for c in verification.checks]
    assert len(set(names)) == len(names)
    meaning = next(c for c in verification.checks if c.name == "cross_objective").meaning
    assert "-160.61858" in meaning.split("by indirect")[0]
    assert "-160.61858" in meaning.split("by indirect")[1].split("by pseudospectral")[0]
    best = next(c for c in verification.checks if c.name == "best_extremal").meaning
    assert best.index("-160.61858") < best.index("-154.54134") < best.index("-154.50197")


def test_a_direct_answer_is_crossed_with_the_extremal_next_to_it(direct: Solution) -> None:
    checks = crossed(direct)
    assert all(c.passed for c in checks.values()), [c for c in checks.values() if not c.passed]
    assert "by pseudospectral" in checks["cross_flight_time"].meaning
    assert "by indirect" in checks["cross_flight_time"].meaning


def test_meditchs_lander_is_cross_checked() -> None:
    assert solve(meditch(), verify=4).verification.level == 4


def test_a_local_optimum_is_not_the_best_that_is_found(landing: Problem, ordinary: Solution, direct: Solution) -> None:
    """delta_v = 0 passes level 3 in the problem with delta_v free; the direct method lands 6.077 kg more."""
    claimed = solve(landing, guess=ordinary, verify=0)
    verification = verify(claimed, level=4, other=Says(answer=direct)).verification
    assert verification.level == 3
    worse = next(c for c in verification.failed if c.name == "best_extremal")
    assert worse.value == pytest.approx(160.618584 - 154.541347, abs=2e-6)
    assert "J = -160.618584 by pseudospectral (retro_delta_v 1200.94 m/s" in worse.meaning
    assert "J = -154.541347 by indirect (retro_delta_v 0 m/s" in worse.meaning
    assert {"cross_objective", "cross_retro_delta_v", "cross_flight_time"} <= {c.name for c in verification.failed}


def test_the_solver_itself_finds_that_a_local_optimum_is_not_the_best(landing: Problem, ordinary: Solution) -> None:
    claimed = solve(landing, guess=ordinary, verify=4)
    assert claimed.outcome is Outcome.NOT_PROVED
    assert claimed.verification.level == 3
    best = replace(claimed, extremals=(replace(claimed.extremals[0], nature=Nature.BEST_AT_BOUND),))
    assert verify(best, 4).extremals[0].nature is Nature.LOCAL_OPTIMUM_AT_BOUND


def test_a_worse_optimum_of_the_other_method_refutes_nothing(
    hybrid: Solution, ordinary: Solution, landing: Problem, direct: Solution
) -> None:
    """Where it ends badly from no guess it is asked again from this answer, and both are listed."""
    poor = replace(ordinary, problem=landing, free={**ordinary.free, "retro_delta_v": 0.0}, extremals=())

    @dataclass(frozen=True, kw_only=True)
    class Lazy:
        def run(self, problem: Problem, guess: Solution | None = None, callback: object = None) -> Solution:
            return direct if guess is hybrid else poor

    checks = crossed(hybrid, Lazy())
    assert all(c.passed for c in checks.values())
    assert checks["best_extremal"].meaning.count("by indirect") == 4  # three of its own, and the poor one
    assert {"cross_objective", "cross_retro_delta_v"} <= disagreements(hybrid, Says(answer=poor))
    assert "best_extremal" not in disagreements(hybrid, Says(answer=poor))


def shifted(curve: Curve, column: int, amount: float) -> Curve:
    values = curve.values.copy()
    values[:, column] += amount
    return replace(curve, values=values)


@pytest.mark.parametrize(
    ("which", "column", "name"), [("state", 2, "cross_state_u"), ("costate", 0, "cross_costate_r")]
)
def test_curves_that_differ_by_more_than_the_mesh_error_disagree(
    hybrid: Solution, direct: Solution, which: str, column: int, name: str
) -> None:
    flown = direct.trajectories[0]
    size = abs(getattr(flown, which).values[:, column]).max()
    other = replace(flown, **{which: shifted(getattr(flown, which), column, 1e-4 * size)})
    assert disagreements(hybrid, Says(answer=replace(direct, trajectories=(other,)))) == {name}
    said = crossed(hybrid, Says(answer=replace(direct, trajectories=(other,))))[name].meaning
    assert "by indirect" in said
    assert "by pseudospectral" in said


def test_a_coarse_mesh_promises_less(hybrid: Solution, direct: Solution) -> None:
    near = replace(direct, objective=direct.objective + 1e-3)
    assert {"cross_objective"} == disagreements(hybrid, Says(answer=near))
    coarse = replace(near, statistics=replace(near.statistics, residual=1e-4))
    assert not disagreements(hybrid, Says(answer=coarse))


def test_another_method_that_fails_is_a_failed_check(hybrid: Solution) -> None:
    (check,) = crossed(hybrid, Refuses()).values()
    assert not check.passed
    assert math.isnan(check.value)
    assert "Refuses does not: the engine is cold" in check.meaning


def test_a_flight_along_a_ceiling_is_crossed_in_states_and_objective() -> None:
    """Its costates are told in two ways: by the direct method with the multiplier of x <= l itself, here of x'' = 0."""
    checks = crossed(Pseudospectral(tolerance=1e-4).run(least_energy(CEILING)), Indirect())
    assert all(checks[name].passed for name in ("cross_solved", "cross_objective", "best_extremal", "cross_state_x"))
    assert not checks["cross_costate_x"].passed


def test_an_extremal_that_breaks_the_path_confirms_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Riding along a ceiling, a direct answer is better than what the indirect method does without a structure."""
    monkeypatch.setattr(StructureRefinement, "run", lambda self, rough: None)
    (check,) = crossed(Pseudospectral(tolerance=1e-4).run(least_energy(CEILING)), Indirect()).values()
    assert not check.passed
    assert "does not" in check.meaning
