"""Newton in lanes on functions whose roots are known: damping, outcomes, round-off; one lane and many."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from newton_toys import toy
from perilune.core import Iteration
from perilune.shooting.newton import FINEST, Columns, Ends, Evaluate, Lanes, evaluation_rows, newton

ONE = Columns(n=1)
ATAN = toy(np.arctan, lambda y: 1 / (1 + y**2))


def run(function: Evaluate, *starts: float, **settings: Any) -> Ends:
    return newton(function, np.array(starts)[:, None], ONE, **settings)


@pytest.mark.parametrize("starts", [(3.0,), (3.0, -2.0, 0.5, 40.0)], ids=["one", "many"])
def test_damping_brings_back_what_full_steps_lose(starts: tuple[float, ...]) -> None:
    """The arctangent: beyond 1.39 undamped Newton leaves for infinity."""
    ends = run(ATAN, *starts)
    assert ends.converged.all()
    assert ends.y == pytest.approx(0.0, abs=1e-11)


def test_a_lane_of_many_does_what_it_does_alone() -> None:
    together = run(ATAN, 3.0, -2.0, 0.5)
    for i, start in enumerate((3.0, -2.0, 0.5)):
        alone = run(ATAN, start)
        assert (together.y[i], together.evaluations[i]) == (alone.y[0], alone.evaluations[0])
        assert together.iterations[i] == alone.iterations[0] == len(alone.history) < alone.evaluations[0]


def test_iterations_of_one_lane_are_shown() -> None:
    seen: list[Iteration | str] = []
    ends = newton(ATAN, np.array([[3.0]]), ONE, watch=seen.append)
    assert tuple(seen) == ends.history
    assert [i.number for i in ends.history] == list(range(1, len(ends.history) + 1))
    assert ends.history[0].damping < 1.0 == ends.history[-1].damping


def test_rounds_of_many_lanes_are_told() -> None:
    """Newton's step for the arctangent leaves -2/3 y^3 of a small y."""
    seen: list[Iteration | str] = []
    ends = newton(ATAN, np.array([[3.0], [0.1], [1e9]]), ONE, watch=seen.append)
    assert seen[0] == "round 1: 0 of 3 converged, 3 at work, least residual 6.7e-04"
    assert seen[-1] == f"round {ends.evaluations.max() - 1}: {ends.converged.sum()} of 3 converged"
    assert len(seen) == ends.evaluations.max() - 1


@pytest.mark.parametrize("copies", [1, 3])
def test_damping_goes_down_to_a_ten_thousandth(copies: int) -> None:
    """Of the arctangent's step, (pi/2) y^2, about 0.6/y is wanted: 6e-3 at 100, 3e-4 at 2000, 3e-5 at 20000."""
    for start, arrives in ((100.0, True), (2000.0, True), (20000.0, False)):
        assert run(ATAN, *[start] * copies).converged.all() == arrives


@pytest.mark.parametrize("copies", [1, 3])
def test_what_is_led_ever_farther_is_given_up(copies: int) -> None:
    """From 3 the arctangent's first step goes 12 far, and damped ones less; without a root there is no end to them."""
    reach = np.full(copies, 4.0)
    assert run(ATAN, *[3.0] * copies, reach=reach).converged.all()
    rootless = toy(lambda y: y**2 + 1, lambda y: 2 * y)
    ends, followed = (run(rootless, *[0.1] * copies, **more) for more in ({"reach": reach}, {}))
    assert not ends.converged.any() and (ends.evaluations < followed.evaluations).all()


@pytest.mark.parametrize("copies", [1, 3])
def test_it_stops_honestly(copies: int) -> None:
    """No root, a singular derivative, and NaN: each ends without convergence."""
    for function, start in (
        (toy(lambda y: y**2 + 1, lambda y: 2 * y), 0.7),
        (toy(lambda y: y - 1, np.zeros_like), 0.0),
        (toy(lambda y: np.full_like(y, np.nan), np.ones_like), 0.0),
    ):
        ends = run(function, *[start] * copies)
        assert not ends.converged.any()
        assert ends.evaluations.max() <= 100
    assert (ends.evaluations == 1).all()  # a step that is not a number is not tried at any size


def test_one_singular_lane_does_not_stop_the_others() -> None:
    flat = toy(lambda y: np.where(y > 5, 1.0, y - 1), lambda y: np.where(y > 5, 0.0, 1.0))
    ends = run(flat, 0.0, 9.0, 2.0)
    assert ends.converged.tolist() == [True, False, True]
    assert ends.y[[0, 2], 0].tolist() == [1.0, 1.0]


def test_evaluations_are_limited_and_counted() -> None:
    ends = run(ATAN, 40.0, 0.1, limit=4)
    assert ends.converged.tolist() == [False, True]
    assert ends.evaluations[0] == 4


def test_steps_are_limited() -> None:
    """No component of y moves by more than asked."""
    at: list[float] = []

    def noted(lanes: Lanes, y: np.ndarray, accuracy: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        at.append(float(y[0, 0]))
        return evaluation_rows(y, y - 10, np.ones((1, 1, 1)), inverse, np.zeros((1, 0)))

    assert run(noted, 0.0, max_step=3.0).converged.all()
    assert np.abs(np.diff(at)).max() <= 3.0


@pytest.mark.parametrize("copies", [1, 2])
def test_a_residual_that_is_round_off_is_a_root(copies: int) -> None:
    """A function that is only known to 3e-13, and so steep an inverse that its noise is a long step.

    Beside it the same noise a thousand times larger: that is no root.
    """

    def noisy(size: float) -> Evaluate:
        def evaluate(lanes: Lanes, y: np.ndarray, accuracy: np.ndarray, inverse: np.ndarray) -> np.ndarray:
            return evaluation_rows(
                y, np.full_like(y, size), np.full((len(y), 1, 1), 1e-8), inverse, np.zeros((len(y), 0))
            )

        return evaluate

    assert run(noisy(3e-13), *[0.0] * copies, accuracy=FINEST).converged.all()
    assert not run(noisy(3e-10), *[0.0] * copies, accuracy=FINEST).converged.any()


@pytest.mark.parametrize("copies", [1, 4])
def test_no_root_is_claimed_from_a_rough_evaluation(copies: int) -> None:
    """h = y - 1 with an error of the accuracy that was asked for: the root is found to the finest."""
    asked: list[float] = []

    def rough(lanes: Lanes, y: np.ndarray, accuracy: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        asked.append(float(accuracy.max()))
        return evaluation_rows(y, y - 1 + accuracy[:, None], np.ones((len(y), 1, 1)), inverse, np.zeros((len(y), 0)))

    ends = run(rough, *[0.0] * copies)
    assert ends.converged.all()
    assert ends.y == pytest.approx(1.0, abs=2 * FINEST)
    assert asked[0] > 1e3 * FINEST and asked[-1] == FINEST


@pytest.mark.parametrize("copies", [1, 3])
def test_a_rough_evaluation_that_leads_nowhere_is_made_again(copies: int) -> None:
    """A slope whose rough value has the wrong sign: no damping helps, another look does, and it is kept to."""
    asked: list[float] = []

    def misleading(lanes: Lanes, y: np.ndarray, accuracy: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        asked.append(float(accuracy.max()))
        slope = np.where(accuracy > FINEST, -1.0, 1.0)
        return evaluation_rows(y, y - 1, slope[:, None, None], inverse, np.zeros((len(y), 0)))

    ends = run(misleading, *[0.0] * copies)
    assert ends.converged.all()
    assert ends.y == pytest.approx(1.0, abs=1e-12)
    assert set(asked[asked.index(FINEST) :]) == {FINEST}


@pytest.mark.parametrize("copies", [1, 3])
def test_amplified_round_off_is_a_root_where_y_cannot_be_better(copies: int) -> None:
    """1e5 (y^2 - 2) with errors of 2e-10: y is right to 1e-15. With errors of 2e-6 it is not, and that is no root."""

    def amplified(size: float) -> Evaluate:
        state = np.random.default_rng(1)

        def evaluate(lanes: Lanes, y: np.ndarray, accuracy: np.ndarray, inverse: np.ndarray) -> np.ndarray:
            h = 1e5 * (y**2 - 2) + size * (1 + state.random(y.shape))
            return evaluation_rows(y, h, (2e5 * y)[:, :, None], inverse, np.zeros((len(y), 0)))

        return evaluate

    ends = run(amplified(2e-10), *[1.0] * copies)
    assert ends.converged.all()
    assert ends.y == pytest.approx(np.sqrt(2), abs=1e-14)
    assert not run(amplified(2e-6), *[1.0] * copies).converged.any()


@pytest.mark.parametrize("copies", [1, 3])
def test_a_root_is_as_good_as_its_step_however_small_the_residual(copies: int) -> None:
    """1e-6 (y^2 - 2): the residual is below the tolerance while y is right to 2e-6 only."""
    ends = run(toy(lambda y: 1e-6 * (y**2 - 2), lambda y: 2e-6 * y), *[1.0] * copies)
    assert ends.converged.all()
    assert ends.y == pytest.approx(np.sqrt(2), abs=1e-15)


@pytest.mark.parametrize("copies", [1, 3])
def test_small_steps_do_not_make_a_root_of_a_residual_above_the_tolerance(copies: int) -> None:
    """A slope stated as twice the true one halves the error in each step: the steps are small before the residual."""
    ends = run(toy(lambda y: y - 1, lambda y: np.full(y.shape, 2.0)), *[0.0] * copies)
    assert ends.converged.all()
    assert ends.y == pytest.approx(1.0, abs=1e-11)
    assert (np.abs(ends.rows[:, 0]) <= 1e-11).all()
