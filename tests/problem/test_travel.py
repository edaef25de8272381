"""Solutions cross borders: copies are equal, read-only, and prove again; a curve keeps to its time."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from perilune.core import Outcome, PeriluneError
from perilune.problem.problem import Problem
from perilune.problem.results.solution import Solution
from perilune.problem.results.trajectory import Curve
from perilune.solve import solve
from perilune.verify import verify


def test_a_copy_is_equal_and_proves_again(ordinary: Solution) -> None:
    """By its expressions, in NumPy, and it says so."""
    there = pickle.loads(pickle.dumps(ordinary))
    assert there == ordinary
    assert hash(there) == hash(ordinary)
    proved = verify(there, 3)
    assert proved.outcome is Outcome.PROVED
    assert proved.verification.source == "expressions from a copy"
    assert verify(ordinary, 1).verification.source == "the problem's own Python functions"
    assert copy.deepcopy(ordinary) == ordinary


def test_solutions_differ_where_anything_does(ordinary: Solution) -> None:
    assert ordinary != replace(ordinary, objective=0.0)
    assert ordinary != replace(ordinary, trajectories=())
    assert ordinary != replace(ordinary, unknowns=np.zeros(3))
    assert ordinary != replace(ordinary, unknowns=None) and replace(ordinary, unknowns=None) != ordinary
    assert ordinary != "a solution"


def test_a_copy_in_a_new_process_solves_alike(landing: Problem) -> None:
    """Spawned, so that nothing is inherited."""
    fixed = landing.with_given(retro_delta_v=0.0)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        there = pool.submit(solve, fixed, verify=0).result()
    here = solve(fixed, verify=0)
    assert there.problem == fixed
    assert there.objective == here.objective
    np.testing.assert_array_equal(there.unknowns, here.unknowns)


def straight(**changes: Any) -> Curve:
    ends = {"time": np.array([0.0, 2.0]), "values": np.array([[0.0], [4.0]]), "rates": np.full((2, 1), 2.0)}
    return Curve(**{**ends, **changes})


def test_curves_are_read_only() -> None:
    """Copies too; and the array that a curve was made of is its owner's."""
    own = np.array([[0.0], [4.0]])
    curve = straight(values=own)
    own[1] = 7.0
    assert curve(2.0) == [4.0]
    for flown in (curve, pickle.loads(pickle.dumps(curve)), copy.deepcopy(curve)):
        assert flown == curve
        with pytest.raises(ValueError, match="read-only"):
            flown.values[0] = 1.0
    window = np.broadcast_to(own, (2, 1))  # not writable itself, but its base is
    assert straight(values=window).values is not window


@pytest.mark.parametrize("time", [1e9, -1e-6, 2.0001, np.array([0.5, 3.0])])
def test_a_curve_asked_outside_its_time_says_so(time: Any) -> None:
    with pytest.raises(PeriluneError, match=r"outside its time(.|\n)*got: (.|\n)*expected: 0 to 2 s"):
        straight()(time)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ((), "curve needs t"),
        ((0.0, 1.0), r"(?s)at most 1 of its arguments.*curve\(t\)"),
        (("soon",), "(?s)not a time.*'soon'"),
        (([[0.0, 1.0]],), "(?s)not a time.*a number, or a list"),
    ],
)
def test_what_is_no_time_of_a_curve_is_refused(asked: tuple[Any, ...], words: str) -> None:
    with pytest.raises(PeriluneError, match=words):
        straight()(*asked)


def test_rounding_at_the_ends_is_no_fault() -> None:
    assert straight()(2.0 + 1e-10) == pytest.approx([4.0])
    assert straight()(np.array([-1e-10, 1.0])) == pytest.approx(np.array([[0.0], [2.0]]), abs=1e-9)
    assert straight().extrapolate(3.0) == pytest.approx([6.0])


def test_the_landing_ends_where_it_ends(ordinary: Solution) -> None:
    flown = ordinary.trajectories[0]
    with pytest.raises(PeriluneError, match="outside its time"):
        flown.state(1e9)
    assert flown.state(ordinary.free["flight_time"]) == pytest.approx(flown.state.values[-1])
