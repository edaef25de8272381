"""Integrator of a flight plan: its machine code, bound to the arrays of a batch.

A flight goes leg by leg, opening, arc, next leg, and then the closing, each from the arrays of those before into its
own. Many lanes are bound for one evaluation. A solve from a neighbour has one lane at a time, thousands of times in a
table, and few of many are left after some steps of Newton's method: their arrays are kept, and filled again.
The code is the same, and so is every bit of the result.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.conditions import OptimalityConditions
from perilune.core import Matrix, Stack, Vector
from perilune.kernels import LANES, BoundArcs, Engine, Request, compile_map
from perilune.shooting import newton
from perilune.shooting.plan import Plan, plan

# Lanes, and numbers of their rows, whose arrays are kept: to bind new ones takes as long as to fly so many of a large
# system, and longer than to fly hundreds of a small one.
_FEW, _SMALL = 32, 8192
_FINER, _OF_COLUMNS = 1e-2, 1e-7  # of the requested tolerance; the least tolerance of columns
_STEPS_OF_COLUMNS = 400  # at most: at that tolerance a flight to the ground takes 50 to 150


class Code:
    """The openings and the closing of a plan as machine code; `PlanIntegrator` flies it."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        maps = {leg.opening: compile_map(leg.opening) for leg in plan.legs}
        self.openings = [maps[leg.opening] for leg in plan.legs]
        self.closing = compile_map(plan.closing)


class Split:
    """Arcs of a plan in which a phase settles: themselves finer than asked, and their columns no finer than needed.

    The transition matrix of a fall follows its density, which changes by e within a thousandth of the radius: errors of
    the states are a thousand times as large in it. Newton's method needs its derivatives to a few digits only, and they
    are all but a tenth of the work.
    """

    def __init__(self, engine: Engine, asked: Request) -> None:
        fine, rough = (np.empty_like(asked.rtol) for _ in range(2))
        self.accuracy, self.fine, self.rough = asked.rtol, fine, rough
        self._states = engine.bind(replace(asked, seeds=None, rtol=fine, atol=fine))
        few = min(asked.max_steps, _STEPS_OF_COLUMNS)
        columns = replace(asked, rtol=rough, atol=rough, max_steps=few)
        assert asked.seeds is not None, "whose columns are asked"
        shared = asked.seeds.shape[2] > engine.system.nc
        self._columns = Shared(engine, columns) if shared else engine.bind(columns)
        self.z, self.rates, self.columns = self._states.z, self._states.rates, self._columns.columns

    def __call__(self) -> None:
        """Fly both."""
        np.multiply(self.accuracy, _FINER, out=self.fine)
        np.maximum(self.accuracy, _OF_COLUMNS, out=self.rough)
        self._states()
        self._columns()

    @property
    def lost(self) -> NDArray[np.intp]:
        """Lanes of which either is lost."""
        return np.union1d(self._states.lost, self._columns.lost)


class Shared:
    """Columns of arcs shared out among the lanes that fly together: each flies the same arc with some of them.

    One lane would leave the others idle, and of many the one that flies longest would keep three others waiting.
    """

    def __init__(self, engine: Engine, asked: Request) -> None:
        assert asked.seeds is not None, "whose columns are asked"
        self.asked, (lanes, nz), width = asked, asked.seeds.shape[:2], engine.system.nc
        names = ("z0", "duration", "rtol", "mode", *(("p",) if len(asked.p) > 1 else ()))
        own = {name: np.empty((lanes * LANES, *getattr(asked, name).shape[1:])) for name in names}
        seeds = np.zeros((lanes * LANES, nz, width))
        self._arcs = engine.bind(replace(asked, seeds=seeds, **own, atol=own["rtol"]))
        self._given = [(of.reshape(lanes, LANES, -1), getattr(asked, name)) for name, of in own.items()]
        self._side_by_side = np.zeros((lanes, nz, LANES * width))
        self._shares = [array.reshape(lanes, LANES, nz, width) for array in (seeds, self._arcs.columns)]
        self.columns: Stack = np.empty(asked.seeds.shape)

    def __call__(self) -> None:
        """Fly them."""
        for own, given in self._given:
            own[:] = given.reshape(len(own), 1, -1)
        together, (seeds, columns), count = self._side_by_side, self._shares, self.columns.shape[2]
        together[:, :, :count] = self.asked.seeds
        seeds[:] = together.reshape(*together.shape[:2], LANES, -1).transpose(0, 2, 1, 3)
        self._arcs()
        self.columns[:] = columns.transpose(0, 2, 1, 3).reshape(together.shape)[:, :, :count]

    @property
    def lost(self) -> NDArray[np.intp]:
        """Lanes that are lost."""
        return np.unique(self._arcs.lost // LANES)


class PlanIntegrator:
    """A plan bound to arrays, which are read at each call: (lanes, ...) or, for `choice` and `p`, (1, ...)."""

    def __init__(self, code: Code, Y: Matrix, choice: Matrix, p: Matrix, accuracy: Vector, inverse: Matrix) -> None:
        self.plan, self.Y, self.inverse = code.plan, Y, inverse
        self.legs, ends, end = list[tuple[Any, BoundArcs | Split]](), list[Matrix](), list[Matrix]()
        for leg, opening in zip(code.plan.legs, code.openings, strict=True):
            opened = opening.bind(*(Y[:, part] for part in leg.parts), p, *(end if leg.follows else []))
            z0, duration, mode, slopes, numbers = opened.outputs
            seeds, nz = slopes if leg.seeds is None else np.tile(leg.seeds.ravel(), (len(Y), 1)), leg.arcs.system.nz
            asked = Request(
                z0=z0,
                p=numbers,
                duration=duration[:, 0],
                seeds=seeds.reshape(len(Y), nz, seeds.shape[1] // nz),
                rtol=accuracy,
                atol=accuracy,
                mode=mode[:, 0],
                max_steps=leg.most_steps,
            )
            arcs = Split(leg.arcs, asked) if code.plan.settles else leg.arcs.bind(asked)
            self.legs.append((opened, arcs))
            end = [arcs.z, arcs.rates, arcs.columns.reshape(len(Y), -1), *([] if leg.seeds is None else [slopes])]
            ends += end
        known = [Y, choice, p, inverse] if self.plan.compiled else [Y, choice, p]
        self.closing = code.closing.bind(*known, *ends)

    def __call__(self) -> Matrix:
        """Return the rows of an evaluation, NaN where an arc was lost; the next call may overwrite them."""
        rows = self.evaluate()
        if not self.plan.compiled:
            n = self.plan.columns.n
            h, J, extra = rows[:, :n], rows[:, n : n + n * n].reshape(-1, n, n), rows[:, n + n * n :]
            rows = newton.evaluation_rows(self.Y, h, J, self.inverse, extra)
        return rows

    def evaluate(self) -> Matrix:
        """Fly all legs and return the values of the closing, NaN where an arc was lost."""
        for opened, arcs in self.legs:
            opened()
            arcs()
        self.closing()
        rows = self.closing.outputs[0]
        for _, arcs in self.legs:
            if len(arcs.lost):
                rows[arcs.lost] = np.nan
        return rows


class FewLanes:
    """A flight of some lanes in arrays of its own: for one thread at a time."""

    def __init__(self, code: Code, lanes: int) -> None:
        plan = code.plan
        n, numbers = plan.columns.n, plan.conditions.residual.size1_in(2)
        shapes = (lanes, n), (lanes, 2 * plan.held), (lanes, numbers), (lanes,), (lanes, n * n)
        self.arrays = [np.zeros(shape) for shape in shapes]
        self.flight = PlanIntegrator(code, *self.arrays)

    def __call__(self, *arguments: Matrix) -> Matrix:
        """Return the rows of an evaluation; arguments as for `PlanIntegrator`."""
        for own, given in zip(self.arrays, arguments, strict=True):
            own[:] = given
        return self.flight().copy()


class Fleet:
    """A plan and its integrators, made when first needed and shared by all threads."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._few = max(_FEW, _SMALL // plan.columns.width)
        self._idle = [list[FewLanes]() for _ in range(self._few + 1)]  # a list's pop and append are atomic

    @cached_property
    def code(self) -> Code:
        """The plan as machine code."""
        return Code(self.plan)

    def bind(self, Y: Matrix, choice: Matrix, p: Matrix, accuracy: Vector, inverse: Matrix) -> PlanIntegrator:
        """Bind a flight to arrays that live as long.

        Parameters
        ----------
        Y
            Unknowns that Newton moves, shape (lanes, n), canonical.
        choice
            Active set (`Shooting.holding`), shape (lanes, 2 k) or (1, 2 k).
        p
            Parameters of the canonical equations, shape (lanes, np) or (1, np), canonical.
        accuracy
            Relative and absolute tolerance of the integration, shape (lanes,).
        inverse
            Inverse Jacobian of the iterate before, row by row, shape (lanes, n^2).
        """
        return PlanIntegrator(self.code, Y, choice, p, accuracy, inverse)

    def fly(self, Y: Matrix, choice: Matrix, p: Matrix, accuracy: Vector, inverse: Matrix) -> Matrix:
        """Return the rows of an evaluation; arguments as for `PlanIntegrator`.

        Parameters
        ----------
        Y, choice, p, accuracy, inverse
            As for `bind`.

        Returns
        -------
        Matrix
            One row a lane, laid out as `Plan.columns` says; NaN where an arc was lost.
        """
        arguments, lanes = (Y, choice, p, accuracy, inverse), len(Y)
        if not 0 < lanes <= self._few:
            return self.bind(*arguments)()
        try:
            few = self._idle[lanes].pop()
        except IndexError:
            few = FewLanes(self.code, lanes)
        rows = few(*arguments)
        self._idle[lanes].append(few)
        return rows


@lru_cache(maxsize=64)
def fleet(conditions: OptimalityConditions, segments: int) -> Fleet:
    """Return the fleet of a boundary value problem, which is made once.

    Parameters
    ----------
    conditions
        The boundary value problem.
    segments
        Arcs of each phase; 1 is single shooting.
    """
    return Fleet(plan(conditions, segments))


def jacobians(
    conditions: OptimalityConditions, segments: int, Y: Matrix, p: Matrix, choice: Matrix
) -> NDArray[np.float64]:
    """Return the Jacobians (lanes, n, n) themselves, as a singular one has no inverse.

    Parameters
    ----------
    conditions, segments
        The boundary value problem, and the arcs of each phase.
    Y
        Unknowns that Newton's method moves, (lanes, n).
    p
        Given parameters, canonical, (lanes, np) or (1, np).
    choice
        Active set: masks, then values, (lanes, ...) or (1, ...).
    """
    code, count = _plan_without_step(conditions, segments), len(Y)
    n = code.plan.columns.n
    flight = PlanIntegrator(code, Y, choice, p, np.full(count, newton.FINEST), np.zeros((count, n * n)))
    return flight.evaluate()[:, n : n + n * n].reshape(count, n, n).copy()


@lru_cache(maxsize=16)
def _plan_without_step(conditions: OptimalityConditions, segments: int) -> Code:
    return Code(plan(conditions, segments, most=-1))
