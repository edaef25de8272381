"""What casts doubt on an answer of an atlas."""

from __future__ import annotations

from typing import Any

import numpy as np

from perilune.atlas.offers import outdoing, unanswered


class _Chart:
    breaks_controls_alone = False


def test_each_well_vouches_for_one_extremal_that_breaks_the_path() -> None:
    """Lane by lane: one of each of two charts beside one answer, two of one chart beside one, beside two, and none."""
    one: Any = _Chart()
    other: Any = _Chart()
    better = [(one, np.array([0, 1, 2, 3])), (one, np.array([1, 2])), (other, np.array([0]))]
    vouching = {id(other): np.array([1, 1, 2, 0])}
    told = unanswered(better, vouching, np.array([True, True, True, False]))
    assert [left.tolist() for left in told] == [[False, True, False, True], [True, False], [True]]


def test_what_is_no_better_or_breaks_bounds_of_singular_controls_outdoes_no_answer() -> None:
    """Beside no answer at all everything outdoes what is known."""
    chart: Any = _Chart()
    singular: Any = type("Singular", (), {"breaks_controls_alone": True})()
    best = np.array([2.0, 1.0, np.inf])
    assert outdoing(chart, np.array([1.0, 1.0, 9.0]), best).tolist() == [True, False, True]
    assert outdoing(singular, np.array([1.0, 1.0, 9.0]), best).tolist() == [False, False, True]
