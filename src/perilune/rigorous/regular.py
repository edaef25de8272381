"""Regularity of X, the states of enclosed tangents: all along a step, or not proved."""

from __future__ import annotations

from collections.abc import Sequence
from operator import mul
from typing import Any

from flint import arb, arb_mat

from perilune.rigorous.flight import ball_identity
from perilune.rigorous.flow import EnclosedStep
from perilune.rigorous.taylor import Ball

_DEEPEST = 16  # halvings of a step


def first_irregular_time(proved: EnclosedStep, half: int) -> Ball | None:
    """A time at which X is not seen to be regular; None where it is all along the step."""
    order, waiting = len(proved.tangents) - 1, [(0.0, 1.0, 0)]
    *polynomial, last = (arb_mat(own.tolist()[:half]) for own in proved.tangents)
    while waiting:
        a, b, depth = waiting.pop()
        middle, away = proved.length * arb(0.5 * (a + b)), proved.length * arb(0.5 * (b - a))
        missing = last * (proved.length * arb(a).union(arb(b))) ** order
        if _is_regular_about(_shifted_coefficients(polynomial, middle), missing, away.abs_upper()):
            continue
        if depth == _DEEPEST:
            return proved.begin + middle
        waiting += [(a, 0.5 * (a + b), depth + 1), (0.5 * (a + b), b, depth + 1)]
    return None


def _shifted_coefficients(polynomial: Sequence[Any], middle: Ball) -> list[Any]:
    """The coefficients of a polynomial about another time."""
    c = list(polynomial)
    for i in range(len(c) - 1):
        for k in range(len(c) - 2, i - 1, -1):
            c[k] = c[k] + c[k + 1] * middle
    return c


def _is_regular_about(c: Sequence[Any], missing: Any, away: Ball) -> bool:
    """Return True if X = sum of c[k] s^k + missing is regular for all |s| <= away.

    X C = 1 + E with C about the inverse of its centre. From this side, and for each coefficient by itself, E is as
    small as what the control does, though X is nearly singular: costates may grow together without moving anything.
    |E|^k 1 < 1 in every row makes 1 + E regular, whatever units its rows have.
    """
    try:
        inverse = c[0].mid().inv().mid()
    except ZeroDivisionError:
        return False
    size = inverse.nrows()
    unit = ball_identity(size)
    parts = [(c[0] + missing) * inverse - unit, *(own * inverse * away**k for k, own in enumerate(c[1:], start=1))]
    E = [sum(entry.abs_upper() for entry in entries) for entries in zip(*(p.entries() for p in parts), strict=True)]
    sums = [arb(1)] * size
    for _ in range(size):
        sums = [sum(map(mul, E[i * size : (i + 1) * size], sums)) for i in range(size)]
        if all(total < 1 for total in sums):
            return True
    return False
