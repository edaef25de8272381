"""From a neighbour whose arcs are known: Newton's method alone, and the same answer as from its curves."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import pytest

import perilune as pl
from perilune.conditions.pontryagin import derive
from perilune.core import Deferred
from perilune.methods.indirect.refinement import structure_search as structured
from perilune.problem import Solution, move_start, with_start_offsets
from perilune.structures import detect_arcs as reading
from perilune.structures.detect_arcs import detect_structures
from perilune.structures.split_join import JoinedTrajectories
from problems.constrained import bryson_denham, bryson_denham_truth, timed_bryson_denham


@pytest.fixture(scope="module")
def touching() -> Solution:
    return pl.solve(bryson_denham(1 / 5), verify=0)


@pytest.mark.parametrize("ceiling", [0.21, 1 / 5.5, 1 / 9, 0.3])
def test_arcs_that_are_known_are_left_where_they_are_none(touching: Solution, ceiling: float) -> None:
    """A touch stays one for 1/6 <= l < 1/4; below that it is ridden, and above there is none (J = 2)."""
    solution = pl.solve(touching.problem.with_given(ceiling=ceiling), guess=touching)
    assert solution.objective == pytest.approx(bryson_denham_truth(ceiling) if ceiling < 1 / 4 else 2.0, rel=1e-10)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    words = {1 / 9: ["along room"], 0.3: []}
    assert [arc.description for arc in solution.structure] == words.get(ceiling, ["contact point of room"])


def test_known_arcs_are_neither_read_nor_restated(touching: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor are the curves of a guess made, or those of the answer, before they are looked at."""
    guess = pl.solve(touching.problem.with_given(ceiling=0.22), guess=touching, verify=0)
    problem = touching.problem.with_given(ceiling=0.23)
    plain = replace(guess, trajectories=(*guess.trajectories,))
    from_curves = pl.solve(problem, guess=plain, verify=0)
    guess = pl.solve(touching.problem.with_given(ceiling=0.22), guess=touching, verify=0)
    for name in ("restate", "detect_structures", "split_solution"):
        monkeypatch.setattr(structured, name, None)
    solution = pl.solve(problem, guess=guess, verify=0)
    for known in (guess.trajectories, solution.trajectories):
        assert isinstance(known, JoinedTrajectories) and not known.made
    monkeypatch.undo()
    assert solution.objective == pytest.approx(from_curves.objective, rel=1e-13)
    assert solution.statistics.initialization == from_curves.statistics.initialization == "structure"
    assert solution.statistics.attempts == from_curves.statistics.attempts
    (arc,), (other,) = solution.structure, from_curves.structure
    assert (arc.description, arc.begin) == (other.description, pytest.approx(other.begin, abs=1e-12))
    times = from_curves.trajectories[0].time
    reached = [s.trajectories[0].state(times) for s in (solution, from_curves)]
    assert reached[0] == pytest.approx(reached[1], abs=1e-11)


def test_arcs_of_other_conditions_are_not_taken_over(touching: Solution) -> None:
    """A bound of the same flight is no value of a parameter; of another form nothing is known at all."""
    bounded, tilted = bryson_denham(1 / 5, as_bound=True), replace(touching.problem, objective_scale=2.0)
    x, *others = bounded.phases[0].states
    phase = replace(bounded.phases[0], states=(replace(x, upper=0.21), *others))
    assert bounded.differs_in_values(bounded.with_given(speed=2.0))
    assert not bounded.differs_in_values(replace(bounded, phases=(phase,)))
    assert not touching.problem.differs_in_values(bounded)
    assert not touching.problem.differs_in_values(tilted)


def test_what_is_made_later_is_what_it_holds() -> None:
    """Equal to a tuple, printed as one, sent away as one; of unknown length before."""
    made = list[int]()

    def make() -> tuple[int, ...]:
        made.append(1)
        return (1, 2)

    later = Deferred(None, make)
    assert not made
    assert later == (1, 2) and (1, 2) == later and later != (1, 3) and len(later) == 2 and bool(later)
    assert repr(later) == "(1, 2)" and hash(later) == hash((1, 2)) and made == [1]
    assert not Deferred(None, tuple)


def test_arcs_that_are_known_last_as_long_as_is_stated_now() -> None:
    """The range of a duration that they share is stated of their sum: it was that of the guess, and T stayed at 1 s."""
    shorter, longer = (timed_bryson_denham(0.12, 0.5, longest, 1.0) for longest in (1.0, 1.2))
    solution = pl.solve(longer, guess=pl.solve(shorter, verify=0))
    assert solution.free["T"] == pytest.approx(1.2, rel=1e-14) and solution.verification.level == 3


def test_arcs_are_known_where_a_range_moves_that_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the longest flight of a return does with the area of its drag: all of it was read and restated anew."""
    first, moved, narrow = (timed_bryson_denham(0.12, 0.5, longest, -8 / 9) for longest in (0.8, 0.9, 0.58))
    guess, best = pl.solve(first, verify=0), pl.solve(moved, verify=0)
    assert isinstance(guess.trajectories, JoinedTrajectories) and guess.free["T"] == pytest.approx(0.6)
    for name in ("restate", "detect_structures", "split_solution"):
        monkeypatch.setattr(structured, name, None)
    solution = pl.solve(moved, guess=guess, verify=0)
    assert solution.objective == pytest.approx(best.objective, rel=1e-12)
    monkeypatch.undo()
    assert pl.solve(narrow, guess=guess).free["T"] == pytest.approx(0.58, rel=1e-14)


def test_a_guess_is_read_once_for_all_its_neighbours(touching: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is kept is of this very solution, and is gone with it."""
    read = list[int]()
    detect = reading._detect_structures
    monkeypatch.setattr(reading, "_detect_structures", lambda *of: read.append(1) or detect(*of))
    one, other = (replace(touching, objective=touching.objective) for _ in range(2))
    problem = one.problem
    first = detect_structures(problem, one, 1e-7)
    assert detect_structures(problem, one, 1e-7) == first == detect(problem, one, 1e-7) and len(read) == 1
    assert detect_structures(problem, other, 1e-7) == first and len(read) == 2
    assert detect_structures(problem, one, 1e-2) and len(read) == 3
    kept = weakref.ref(one)
    del one
    gc.collect()
    assert kept() is None


def test_a_start_is_moved_without_asking_for_anything_anew(touching: Solution) -> None:
    """The same as with other given values; what is derived of it is what is derived of the problem."""
    problem = with_start_offsets(touching.problem)
    ahead = move_start(problem, offset_v=1e-3)
    assert ahead == problem.with_given(offset_v=1e-3) and ahead.structure == problem.structure
    assert derive(ahead) is derive(touching.problem)
