"""The population search on functions with known minima, and hybrids that start from nothing but bounds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from perilune.core import NotConvergedError, PeriluneError
from perilune.methods.direct.pseudospectral import Pseudospectral
from perilune.methods.evolutionary.fitness import ControlFitness, CostateFitness
from perilune.methods.evolutionary.genetic import Generation, Genetic
from perilune.methods.evolutionary.hybrid import Hybrid
from perilune.methods.indirect.indirect import Indirect
from perilune.problem import Conditions, ScalarControl
from problems.peng import PENG_STEERING, peng
from test_indirect import impossible_steering, tangent_steering

BOX = np.full(2, 5.0)
HIMMELBLAU = np.array([[3.0, 2.0], [-2.805118, 3.131312], [-3.779310, -3.283186], [3.584428, -1.848126]])


def himmelblau(x: np.ndarray) -> np.ndarray:
    """Four minima of value 0 (Himmelblau 1972)."""
    return (x[:, 0] ** 2 + x[:, 1] - 11) ** 2 + (x[:, 0] + x[:, 1] ** 2 - 7) ** 2


def rastrigin(x: np.ndarray) -> np.ndarray:
    """About 11^n local minima around the one at 0."""
    return (x**2 - 10 * np.cos(2 * np.pi * x) + 10).sum(axis=1)


# -- the search
# -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_the_best_distinct_individuals_are_the_four_minima(seed: int) -> None:
    """One of each, not four of the best."""
    found = Genetic(seed=seed, best=4, distinct=0.2, population=200).search(himmelblau, -BOX, BOX)
    nearest = np.linalg.norm(found.points[:, None] - HIMMELBLAU[None], axis=2)
    assert sorted(nearest.argmin(axis=1)) == [0, 1, 2, 3]
    assert nearest.min(axis=1).max() < 0.15
    assert np.all(np.diff(found.values) >= 0)
    assert found.values == pytest.approx(himmelblau(found.points))


def test_a_global_minimum_among_many_local_ones() -> None:
    """Rastrigin in six dimensions: in the right one of two million basins, where random search is far off."""
    settings = Genetic(seed=1, population=200, generations=120)
    found = settings.search(rastrigin, np.full(6, -5.12), np.full(6, 5.12))
    chance = np.random.default_rng(1).uniform(-5.12, 5.12, size=(200 * 121, 6))
    assert np.sum(np.round(found.points[0]) == 0) >= 5
    assert found.values[0] < 0.2 * rastrigin(chance).min()


def test_the_same_seed_gives_the_same_answer_and_another_does_not() -> None:
    """Every random number comes from the seed."""
    first, again, other = (Genetic(seed=s).search(rastrigin, -BOX, BOX).points for s in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_elitism_and_bounds() -> None:
    """The least objective never rises, and nobody is ever judged outside the box, whose edge is reached."""
    seen: list[np.ndarray] = []

    def judge(x: np.ndarray) -> np.ndarray:
        seen.append(x)
        return x.sum(axis=1)

    found = Genetic(generations=30).search(judge, np.array([1.0, -2.0]), np.array([3.0, -2.0]))
    assert np.all(np.diff([g.least for g in found.generations]) <= 0)
    everyone = np.vstack(seen)
    assert everyone[:, 0].min() >= 1.0 and everyone[:, 0].max() <= 3.0
    assert np.all(everyone[:, 1] == -2.0)
    assert found.points[0] == pytest.approx([1.0, -2.0], abs=1e-3)


def test_what_is_not_finite_loses() -> None:
    """Half of the box cannot be judged; the best is found in the other half."""
    found = Genetic().search(lambda x: np.where(x[:, 0] < 0, np.nan, himmelblau(x)), -BOX, BOX)
    assert np.all(np.isfinite(found.values)) and np.all(found.points[:, 0] >= 0)
    lost = Genetic(generations=2).search(lambda x: np.full(len(x), np.inf), -BOX, BOX)
    assert lost.points.shape == (1, 2) and np.isinf(lost.values[0])


def test_an_interrupted_search_keeps_what_it_has() -> None:
    """The user stops it in the fifth generation."""

    def stop(generation: Generation) -> None:
        if generation.number == 5:
            raise KeyboardInterrupt

    found = Genetic().search(himmelblau, -BOX, BOX, stop)
    assert found.interrupted
    assert [g.number for g in found.generations] == list(range(6))
    assert found.values[0] == found.generations[-1].least
    assert found.values[0] == pytest.approx(himmelblau(found.points[:1])[0])


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"population": 2}, "population is too small"),
        ({"generations": -1}, "generations is too small"),
        ({"best": 0}, "best is too small"),
        ({"best": 200}, "more individuals are requested than exist"),
        ({"elite": 1.5}, "elite must lie between 0 and 1"),
        ({"spread": -1.0}, "spread must not be negative"),
        ({"mutation": float("nan")}, "mutation must not be negative"),
    ],
)
def test_bad_settings_are_named(settings: dict[str, Any], text: str) -> None:
    """On construction."""
    with pytest.raises(PeriluneError, match=text):
        Genetic(**settings)


@pytest.mark.parametrize(
    ("objective", "lower", "upper", "text"),
    [
        (himmelblau, -BOX, np.array([5.0, np.inf]), "bounds of gene 1"),
        (himmelblau, BOX, -BOX, "bounds of gene 0"),
        (himmelblau, -BOX, np.full(3, 5.0), "different lengths"),
        (lambda x: 0.0, -BOX, BOX, "one value for each individual"),
    ],
)
def test_bad_problems_are_named(objective: Any, lower: np.ndarray, upper: np.ndarray, text: str) -> None:
    """Before or while searching."""
    with pytest.raises(PeriluneError, match=text):
        Genetic().search(objective, lower, upper)


# -- what a population is judged by
# -----------------------------------------------------------------------------------


def test_the_fitness_of_the_answer_is_the_least() -> None:
    """Initial costates of an extremal have no residual, whatever their length; its neighbours have one."""
    problem = tangent_steering(split=True)
    solution = Indirect().run(problem)
    fitness = CostateFitness(problem)
    assert solution.unknowns is not None
    answer = solution.unknowns[: len(fitness.lower)]
    count = fitness.conditions.free_at.start
    longer = answer * np.where(np.arange(len(answer)) < count, 3.7, 1.0)
    near = answer + 0.01 * np.random.default_rng(0).normal(size=(5, len(answer)))
    values = fitness(np.vstack([answer, longer, near]))
    assert values[:2] == pytest.approx(0.0, abs=1e-5)
    assert values[2:].min() > 1e-3
    # Costates of the wrong sign belong to a maximum, and the length cannot be negative.
    assert fitness(-answer[None] * np.where(np.arange(len(answer)) < count, 1.0, -1.0))[0] > 0.1
    again = fitness.guess(longer)
    assert again.unknowns == pytest.approx(solution.unknowns, abs=1e-4)


def test_controls_at_nodes_come_near_the_optimum() -> None:
    """The optimum's control sampled at nine nodes: nearly J, and the guess flies as the solution does."""
    problem = tangent_steering()
    solution = Indirect().run(problem)
    fitness = ControlFitness(problem, nodes=9)
    duration = solution.free["t2"]
    nodes = solution.trajectories[0].control(np.linspace(0.0, duration, 9)).ravel()
    genes = np.concatenate([[duration / problem.scales.time], nodes])
    least = solution.objective / problem.scales.of("s")
    assert fitness(genes[None])[0] == pytest.approx(least, abs=0.06)
    late = genes * np.where(np.arange(len(genes)) == 0, 1.5, 1.0)
    assert fitness(late[None])[0] > least + 1.0
    guess = fitness.guess(genes)
    assert guess.free["t2"] == pytest.approx(duration)
    t = np.linspace(0.0, duration, 30)
    ends = np.abs(guess.trajectories[0].state(t) - solution.trajectories[0].state(t)).max(axis=0)
    assert np.all(ends < [0.1, 0.5, 0.5])


def test_a_broken_path_condition_costs() -> None:
    """A ceiling that the flight breaks is added to its fitness, and a wide one is not."""
    base = tangent_steering()
    phase = base.phases[0]

    def below(height: float) -> Any:
        limited = replace(
            phase,
            path=Conditions(lambda x, u, p, xp: (height * p.height - x.y,), room="m"),
        )
        return ControlFitness(replace(base, phases=(limited,)))

    rng = np.random.default_rng(2)
    fitness = ControlFitness(base)
    genes = fitness.lower + rng.random((20, len(fitness.lower))) * (fitness.upper - fitness.lower)
    assert below(1e6)(genes) == pytest.approx(fitness(genes), rel=1e-12)
    assert np.all(below(-1e3)(genes) > fitness(genes) + 1.0)


def test_an_unbounded_control_is_refused() -> None:
    """A population needs bounds to be drawn from."""
    base = tangent_steering()
    steered = replace(
        base.phases[0],
        controls=(ScalarControl(name="angle"),),
        dynamics=lambda x, u, p, xp: (x.vy, p.a * xp.cos(u.angle), p.a * xp.sin(u.angle)),
    )
    with pytest.raises(PeriluneError, match="control angle has none"):
        ControlFitness(replace(base, phases=(steered,)))


# -- hybrids
# ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("second", [Indirect(), Pseudospectral(nodes=12, refine=0)], ids=lambda s: type(s).__name__)
@pytest.mark.parametrize("split", [False, True])
def test_hybrid_on_a_closed_form(second: Indirect | Pseudospectral, split: bool) -> None:
    """Linear tangent steering, in one phase and in two."""
    solution = Hybrid(Genetic(seed=2, population=64, generations=30, best=1), second).run(tangent_steering(split))
    assert solution.objective == pytest.approx(0.554570878334603, rel=1e-8)
    assert solution.statistics.initialization.startswith("genetic search, then ")


@pytest.mark.parametrize("seed", range(2))
def test_peng_from_random_values(seed: int) -> None:
    """GA and GPM in the paper's own coordinates; GA and shooting in Cartesian ones: the same flight time."""
    genetic = Genetic(seed=seed, best=1)
    direct = Hybrid(genetic, Pseudospectral(nodes=30, refine=0)).run(
        peng(coordinates="spherical", steering=PENG_STEERING)
    )
    indirect = Hybrid(genetic, Indirect()).run(peng())
    assert indirect.free["flight_time"] == pytest.approx(472.796, abs=2e-3)
    assert direct.free["flight_time"] == pytest.approx(indirect.free["flight_time"], abs=1e-6)


def test_every_start_is_told_and_different_answers_are_listed() -> None:
    """One line for each generation; what became of each individual stands in the statistics."""
    lines: list[Any] = []
    settings = Genetic(seed=0, population=64, generations=10, best=2)
    solution = Hybrid(settings, Indirect()).run(tangent_steering(), callback=lines.append)
    assert sum(str(line).startswith("generation") for line in lines) == 11
    assert sum(line.startswith("individual") for line in solution.statistics.attempts) == 2
    assert len(solution.extremals) == 1  # both starts reach the same extremal


def test_a_hybrid_that_fails_says_what_was_tried() -> None:
    """A condition that nothing can meet: the second method's own words, and the search before it."""
    with pytest.raises(NotConvergedError) as caught:
        Hybrid(Genetic(population=32, generations=3, best=2), Indirect()).run(impossible_steering())
    assert caught.value.partial["attempts"][0].startswith("generation 3")
    assert caught.value.partial["attempts"][1].startswith("individual 1")


def test_an_interrupted_hybrid_stops() -> None:
    """The user's interruption ends the run, after the best so far was told."""
    lines: list[Any] = []

    def watch(line: Any) -> None:
        lines.append(line)
        if str(line).startswith("generation 3"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Hybrid(Genetic(population=32), Indirect()).run(tangent_steering(), callback=watch)
    assert str(lines[-1]).startswith("interrupted; generation 3")


@pytest.mark.parametrize("first, second", [(Genetic(), Genetic()), (Indirect(), Indirect())])
def test_hybrid_of_something_else_is_refused(first: Any, second: Any) -> None:
    """A search first, a method second."""
    with pytest.raises(PeriluneError, match="a hybrid consists of a genetic search and another method"):
        Hybrid(first, second)
