"""Answers by hand: tables of flights that are known in closed form, arc by arc."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

import perilune as pl
from perilune.problem import Curve, Solution

NODES = 400  # of an arc
Formula = Callable[[Any], Any]


@dataclass(frozen=True)
class Piece:
    """One arc: how long it lasts, and rows of functions of the time since it began, with their derivatives."""

    length: float
    state: Sequence[tuple[Formula, Formula]]
    control: Sequence[tuple[Formula, Formula]]
    costate: Sequence[tuple[Formula, Formula]]


def polynomial(*coefficients: float) -> tuple[Formula, Formula]:
    """A polynomial in time, lowest order first, and its derivative."""
    whole = Polynomial(coefficients)
    return whole, whole.deriv()


def by_hand(
    problem: pl.Problem, *pieces: Sequence[Piece], free: dict[str, float] | None = None, nodes: int = NODES
) -> Solution:
    """The pieces of each phase as tables of an answer."""
    flown = tuple(_flown(phase.name, own, nodes) for phase, own in zip(problem.phases, pieces, strict=True))
    solution = Solution(problem=problem, method="by hand", outcome=pl.Outcome.SOLVED, objective=0.0, free=free or {},
                        trajectories=flown)  # fmt: skip
    end = problem.phases[-1].state_record(*flown[-1].state.values[-1].tolist())
    return replace(solution, objective=float(problem.objective(end, solution.parameters, math)))


def _flown(name: str, pieces: Sequence[Piece], nodes: int) -> pl.Trajectory:
    rows: dict[tuple[str, int], list[Any]] = {}
    begins = np.concatenate([[0.0], np.cumsum([piece.length for piece in pieces])])
    times = [np.linspace(0.0, piece.length, nodes) for piece in pieces]
    for piece, t in zip(pieces, times, strict=True):
        for table in ("state", "control", "costate"):
            for kind in (0, 1):
                values = [np.broadcast_to(f[kind](t), t.shape) for f in getattr(piece, table)]
                rows.setdefault((table, kind), []).append(np.stack(values, axis=1))
    time = np.concatenate([begin + t for begin, t in zip(begins[:-1], times, strict=True)])
    curves = {
        table: Curve(time=time, values=np.vstack(rows[table, 0]), rates=np.vstack(rows[table, 1]))
        for table in ("state", "control", "costate")
    }
    return pl.Trajectory(phase=name, **curves)


def parted(pieces: Sequence[Piece], times: Sequence[float]) -> list[Piece]:
    """The same flight in pieces that end at these times too."""
    found, begin = [], 0.0
    for piece in pieces:
        inside = [t - begin for t in sorted(times) if 1e-9 < t - begin < piece.length - 1e-9]
        for left, right in pairwise([0.0, *inside, piece.length]):
            tables = ([_later(f, left) for f in getattr(piece, of)] for of in ("state", "control", "costate"))
            found.append(Piece(right - left, *tables))
        begin += piece.length
    return found


def _later(pair: tuple[Formula, Formula], begin: float) -> tuple[Formula, Formula]:
    value, rate = pair
    return lambda t: value(begin + t), lambda t: rate(begin + t)
