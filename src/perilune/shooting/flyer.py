"""What flies a plan: all lanes of a batch in machine code, or one lane through buffers of its own.

Both do the same, leg by leg: opening, arc, next leg; then the closing. One lane at a time is what a solve from a
neighbour does, thousands of times in a table, so it goes through arrays that are allocated once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from perilune.conditions.pontryagin import Conditions
from perilune.kernels import compile_map, compile_single
from perilune.shooting import newton
from perilune.shooting.plan import Plan, plan
from perilune.words.types import Matrix, Vector

PATIENCE = 25  # runs of one lane before code of its own is built for it
_FLOWN = (0, 1)  # ArcStatus.REACHED, ArcStatus.EVENT


def _without_empty(function: ca.Function) -> tuple[ca.Function, list[int]]:
    """The function of those of its arguments that have entries, and which these are."""
    symbols = [ca.SX.sym(f"a{i}", function.size1_in(i)) for i in range(function.n_in())]
    kept = [i for i, symbol in enumerate(symbols) if symbol.numel()]
    return ca.Function(function.name(), [symbols[i] for i in kept], function.call(symbols)), kept


class ManyLanes:
    """Flies a plan for any number of lanes; holds no state between calls."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.openings = [_mapped(leg.opening) for leg in plan.legs]
        self.closing = _mapped(plan.closing)

    def __call__(self, Y: Matrix, choice: Matrix, p: Matrix, accuracy: Vector, inverse: Matrix) -> Matrix:
        """Rows of an evaluation; arguments (lanes, ...) or, for `choice` and `p`, (1, ...)."""
        flights: list[Matrix] = []
        flown = np.ones(len(Y), dtype=bool)
        for leg, opening in zip(self.plan.legs, self.openings, strict=True):
            opened = opening(Y, p, *(flights[-3:] if leg.follows else []))
            nz, nc = leg.arcs.system.nz, leg.arcs.system.nc
            arcs = leg.arcs.propagate(
                opened[:, :nz],
                p[:, leg.flown.numbers],
                opened[:, nz],
                opened[:, nz + 2 :].reshape(-1, nz, nc),
                mode=opened[:, nz + 1],
                rtol=accuracy,
                atol=accuracy,
            )
            flights += [arcs.z, arcs.rates, arcs.columns.reshape(len(Y), -1)]
            flown &= arcs.succeeded
        if self.plan.compiled:
            rows = self.closing(Y, choice, p, inverse, *flights)
        else:
            rows = _by_lapack(self.plan, self.closing(Y, choice, p, *flights), Y, inverse)
        rows[~flown] = np.nan
        return rows


class OneLane:
    """Flies a plan for one lane at a time, in arrays of its own: for one thread at a time."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.closing = _single(plan.closing)
        self.ends: list[Vector] = []  # of all legs, where each flight leaves them
        self.legs = []
        for leg in plan.legs:
            opening, fly = _single(leg.opening), leg.arcs.single(columns=True)
            before = self.ends[-3:] if leg.follows else []
            self.legs.append((leg.flown.numbers, opening, fly, before))
            self.ends += [fly.z, fly.rate, fly.S.reshape(-1)]

    def __call__(self, Y: Matrix, choice: Matrix, p: Matrix, accuracy: Vector, inverse: Matrix) -> Matrix:
        """Rows of an evaluation; every argument has one row."""
        y, numbers, tolerance = Y[0], p[0], accuracy[0]
        for known, opening, fly, before in self.legs:
            z0, duration, mode, seeds = opening(y, numbers, *before)
            fly.demand(tolerance)
            if fly(z0[:, 0], numbers[known], duration[0, 0], seeds, int(mode[0, 0])) not in _FLOWN:
                return np.full((1, self.plan.columns.width), np.nan)
        if self.plan.compiled:
            return self.closing(y, choice[0], numbers, inverse[0], *self.ends)[0].T.copy()
        return _by_lapack(self.plan, self.closing(y, choice[0], numbers, *self.ends)[0].T, Y, inverse)


class Fleet:
    """A plan and what flies it, made when first needed and shared by all threads."""

    def __init__(self, plan: Plan, patience: int = PATIENCE) -> None:
        self.plan = plan
        self._many: ManyLanes | None = None
        self._patience = patience
        self._idle: list[OneLane] = []  # a list's pop and append are atomic

    @contextmanager
    def flyer(self, lanes: int) -> Iterator[ManyLanes | OneLane]:
        """What flies so many lanes, for the caller alone."""
        if lanes != 1 or self._waits():
            self._many = self._many or ManyLanes(self.plan)
            yield self._many
            return
        try:
            one = self._idle.pop()
        except IndexError:
            one = OneLane(self.plan)
        try:
            yield one
        finally:
            self._idle.append(one)

    def _waits(self) -> bool:
        """Whether one lane goes with the code for many, as building its own costs more than it saves at first."""
        if not self._patience or self._idle:
            return False
        arcs = [leg.arcs for leg in self.plan.legs]
        if all(a.at_hand(single=True) for a in arcs) or not all(a.at_hand(single=False) for a in arcs):
            self._patience = 0
            return False
        self._patience -= 1
        return True


@lru_cache(maxsize=64)
def fleet(conditions: Conditions, segments: int) -> Fleet:
    """The fleet of a boundary value problem, made once."""
    return Fleet(plan(conditions, segments))


def _by_lapack(plan: Plan, closed: Matrix, Y: Matrix, inverse: Matrix) -> Matrix:
    n = plan.columns.n
    h, J, extra = closed[:, :n], closed[:, n : n + n * n].reshape(-1, n, n), closed[:, n + n * n :]
    return newton.rows(Y, h, J, inverse, extra)


def _mapped(function: ca.Function) -> Callable[..., Matrix]:
    """The function over lanes, its results side by side, matrices row by row."""
    lean, kept = _without_empty(function)
    symbols = [ca.SX.sym(f"a{i}", lean.size1_in(i)) for i in range(lean.n_in())]
    flat = ca.vertcat(*(ca.vec(ca.densify(result).T) for result in lean.call(symbols)))
    mapped = compile_map(ca.Function(function.name(), symbols, [flat]))
    return lambda *arguments: mapped(*[arguments[i] for i in kept])


def _single(function: ca.Function) -> Callable[..., Sequence[Any]]:
    """The function at one point, its results as matrices that the next call overwrites."""
    lean, kept = _without_empty(function)
    evaluate = compile_single(lean)
    if len(kept) == function.n_in():
        return evaluate
    return lambda *arguments: evaluate(*[arguments[i] for i in kept])
