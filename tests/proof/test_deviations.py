"""How deviations are carried over pieces, against loops and full systems written out."""

from __future__ import annotations

import numpy as np
import pytest

from perilune.proof.feasible.deviations import PieceMaps, fixed_points, running_products
from perilune.proof.necessary.minimum_principle import product_of, with_own_axes


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 16, 50])
def test_running_products_are_those_of_a_loop(count: int) -> None:
    rng = np.random.default_rng(count)
    matrices, added = rng.normal(size=(count, 3, 3)), rng.normal(size=(count, 3))
    products, moved = running_products(matrices, added)
    product, x = np.eye(3), np.zeros(3)
    for k in range(count):
        product, x = matrices[k] @ product, matrices[k] @ x + added[k]
        assert products[k] == pytest.approx(product, rel=1e-9, abs=1e-12 * np.abs(product).max())
        assert moved[k] == pytest.approx(x, rel=1e-9, abs=1e-12 * np.abs(x).max())


@pytest.mark.parametrize("size", [1e-3, 0.5, 40.0])
def test_equations_of_pieces_are_solved_to_rounding(size: float) -> None:
    """By iteration, and by elimination where that does not converge; what is no number spoils no other piece."""
    rng = np.random.default_rng(5)
    B, right = size * rng.normal(size=(6, 8, 8)), rng.normal(size=(6, 8, 3)) * [1e-12, 1.0, 1.0]
    B[4] *= 1e-3 / size
    B[2, 0, 0] = np.nan
    with np.errstate(all="ignore"):
        found = fixed_points(B, right)
    rest = np.arange(6) != 2
    truth = np.linalg.solve(np.eye(8) - B[rest], right[rest])
    assert np.isnan(found[2]).any()
    assert (np.abs(found[rest] - truth) <= 1e-11 * np.abs(truth).max(axis=1, keepdims=True)).all()


def test_pieces_turned_say_the_same_of_a_flight() -> None:
    """From the end of a piece to what is inside and at its begin; turned twice it is the same again."""
    rng = np.random.default_rng(7)
    maps = PieceMaps(
        rng.normal(size=(5, 3, 4)), rng.normal(size=(5, 3, 4, 3)), rng.normal(size=(5, 3)),
        np.eye(3) + 0.1 * rng.normal(size=(5, 3, 3)),
    )  # fmt: skip
    start = rng.normal(size=3)
    inside, end = maps.own[1] + maps.through[1] @ start, maps.over[1] + maps.past[1] @ start
    turned = maps.turned
    assert (turned.over[3] + turned.past[3] @ end) == pytest.approx(start)
    assert (turned.own[3] + turned.through[3] @ end)[:, ::-1] == pytest.approx(inside)
    for one, other in zip(vars(maps).values(), vars(turned.turned).values(), strict=True):
        assert other == pytest.approx(one)


def test_samples_with_axes_of_their_own_are_every_combination() -> None:
    rng = np.random.default_rng(2)
    parts = [rng.normal(size=(1, 4, 5)), rng.normal(size=(3, 6, 5))]
    every = product_of(parts)
    assert every.shape == (4, 24, 5)
    loop = [
        [np.concatenate([parts[0][:, i, n], parts[1][:, j, n]]) for i in range(4) for j in range(6)] for n in range(5)
    ]
    assert np.array_equal(every, np.array(loop).transpose(2, 1, 0))
    assert [component.shape for component in with_own_axes(parts)] == [(4, 1, 5), *[(1, 6, 5)] * 3]
