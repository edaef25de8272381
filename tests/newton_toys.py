"""Scalar functions as Newton takes them: one equation in one unknown in each lane."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from perilune.shooting.newton import Evaluate, Lanes, evaluation_rows


def toy(value: Callable[[np.ndarray], np.ndarray], slope: Callable[[np.ndarray], np.ndarray]) -> Evaluate:
    """h(y) and h'(y), given as functions of all lanes at once, (lanes, 1)."""

    def evaluate(lanes: Lanes, y: np.ndarray, accuracy: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        return evaluation_rows(y, value(y), slope(y)[:, :, None], inverse, np.zeros((len(y), 0)))

    return evaluate
