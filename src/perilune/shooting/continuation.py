"""Continuation along a family of roots: predict by the sensitivity, correct by Newton, halve failing steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from perilune.core import Vector
from perilune.shooting.shooting_function import Root

Correct = Callable[[Vector, float], Root]  # (predicted Y, value) -> root
Tangent = Callable[[Root, float], Vector]  # dY/dvalue at a root


@dataclass(frozen=True, kw_only=True)
class Member:
    """One member of a family: the parameter's value and the root there."""

    value: float
    root: Root


def follow_family(
    first: Member, values: Sequence[float], correct: Correct, tangent: Tangent, halvings: int = 6
) -> Iterator[Member | None]:
    """Yield the member at each value in turn, starting from `first`; None where it could not be reached.

    A correction much longer than the prediction that led to it has landed on another branch and is refused. After a
    failure the walk goes on from the last member reached, with the remaining values.

    Parameters
    ----------
    first
        Member to start from.
    values
        Values of the parameter to reach, in order.
    correct
        (predicted Y, value) -> root.
    tangent
        (root, value) -> dY/dvalue.
    halvings
        How often a step that fails is halved.
    """
    here = first
    for target in values:
        reached = _advance(here, target, correct, tangent, halvings)
        yield reached
        here = reached or here


def _advance(here: Member, target: float, correct: Correct, tangent: Tangent, halvings: int) -> Member | None:
    whole = target - here.value
    step = whole
    while here.value != target:
        value = target if abs(target - here.value) <= abs(step) * (1 + 1e-12) else here.value + step
        slope = tangent(here.root, here.value)
        predicted = here.root.y + slope * (value - here.value)
        root = correct(predicted, value) if np.all(np.isfinite(predicted)) else None
        if root is not None and root.converged and _same_branch(here.root.y, predicted, root.y):
            here = Member(value=value, root=root)
            step *= 2.0
            continue
        step *= 0.5
        if abs(step) < abs(whole) * 0.5**halvings * 0.999:
            return None
    return here


def _same_branch(start: Vector, predicted: Vector, corrected: Vector) -> bool:
    scale = 0.02 * (1.0 + float(np.linalg.norm(start)))
    return float(np.linalg.norm(corrected - predicted)) <= 0.5 * float(np.linalg.norm(predicted - start)) + scale
