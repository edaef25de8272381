"""Open chart: a chart with all that answers at points of it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from perilune.charts.borders import Borders
from perilune.charts.chart import Chart
from perilune.charts.polish import Polisher
from perilune.charts.reintegrate import ChartReintegration
from perilune.charts.sheet import Sheet
from perilune.core import Matrix, Vector
from perilune.methods import ExtremalRoot, Indirect, compose_solution
from perilune.problem import Problem, Solution, Statistics, free_scales
from perilune.shooting import Root
from perilune.structures import join_solution, margins, renumber_restated


class OpenChart:
    """Chart with its sheets, bounds and independent re-integrations: from guesses at points to answers and solutions.

    Parameters
    ----------
    chart
        The chart.
    sheets
        Its branches.
    times
        As of `ChartReintegration`.
    """

    def __init__(self, chart: Chart, sheets: Sequence[Sheet], times: Sequence[int] = ()) -> None:
        self.chart: Chart = chart
        self.sheets: tuple[Sheet, ...] = tuple(sheets)
        self.unknowns: int = len(chart.places)
        self.borders: Borders = Borders(chart)
        self.polish: Polisher = Polisher(chart, self.borders, ChartReintegration(chart, times), self.sheets)
        self._moving: list[bool] = self.polish.moving.tolist()
        self._sizes = free_scales(chart.problem.free, chart.problem)
        names = [name for name, _ in chart.conditions.unknowns]
        self._own_places = np.array([names.index(name) for name, _ in chart.own.unknowns])
        plan = chart.shooting.plan
        self._free = [i for i, name in enumerate(chart.free.free_names) if name not in chart.names]
        kept = [*self._free, *range(plan.free, plan.held)]
        self._own_choice = [*kept, *(plan.held + i for i in kept)]

    @property
    def of_arcs(self) -> bool:
        """Return True if the extremals consist of several arcs."""
        return self.chart.course.structure is not None

    @cached_property
    def rank(self) -> tuple[int, int]:
        """Return the order among charts of equal J, of which the least answers: number of contact points, then of arcs.

        A flight with two contact points in place of a boundary arc has the same J, and no proof of level 3.
        """
        structure = self.chart.course.structure
        if structure is None:
            return 0, 1
        return sum(len(arc.touches) for arcs in structure.phases for arc in arcs), structure.count

    @cached_property
    def breaks_controls_alone(self) -> bool:
        """Return True if extremals can violate only bounds of singular controls, as no other margins exist."""
        return not any(margins(self.chart.user, k) for k in range(len(self.chart.user.phases)))

    @cached_property
    def labels(self) -> list[str]:
        """Return the label of each branch: the arcs of the chart, and the bounds at which the branch is held."""
        return ["; ".join(filter(None, (self.chart.course.text, sheet.label))) for sheet in self.sheets]

    def at_bounds(self, number: int, values: Matrix, y: Matrix) -> tuple[Matrix, NDArray[np.bool_]]:
        """Return unknowns with a Newton step where they miss the bound that their branch holds, and a mask of these.

        Parameters
        ----------
        number
            Number of the branch.
        values
            Values of the parameters, canonical, (lanes, d).
        y
            Unknowns as cells give them, canonical, (lanes, n).
        """
        if not self._moving[number]:
            return y, np.zeros(len(y), dtype=bool)
        if (missed := self.borders.missed(self.sheets[number], values, y)).any():
            holds = self.borders.holds(self.sheets, np.full(len(y), number), values)
            y = np.where(missed[:, None], self.chart.at(values, y, holds).stepped, y)
        return y, missed

    def short(self, values: Matrix, y: Matrix) -> NDArray[np.bool_]:
        """Return True for extremals, as cells give them, that are admissible but for a negative arc duration.

        Parameters
        ----------
        values
            Values of the parameters, canonical, (lanes, d).
        y
            Unknowns, canonical, (lanes, n).
        """
        whole, limits = self.chart.whole(values, y), self.borders.at(values)
        at = np.full((len(y), self.chart.shooting.plan.held), np.nan)
        at[:, : self.chart.shooting.plan.free] = whole[:, self.chart.conditions.free_at]
        return self.borders.short(whole, at, limits)

    def polished_cost(self, number: int, values: Matrix, y: Matrix, cost: Vector) -> Vector:
        """Return J of extremals of a branch, solved by Newton's method from what cells give; `cost` where it fails.

        Cells in which extremals break the path are not cut, so what their corners give is rough.

        Parameters
        ----------
        number
            Number of the branch.
        values
            Values of the parameters, canonical, (lanes, d).
        y, cost
            Unknowns, (lanes, n), and J, (lanes,), as cells give them, canonical.
        """
        if not len(y):
            return cost
        polished = self.polish(values, np.full(len(y), number), y)
        return np.where(polished.reached & np.isfinite(polished.cost), polished.cost, cost)

    def free(self, y: Matrix) -> Matrix:
        """Return the free parameters of the user's problem [SI], (lanes, k), given all unknowns of the chart."""
        chart, own = self.chart, self.own_unknowns(y)[:, self.chart.own.free_at]
        at = {name: value for name, value in zip(chart.problem.free_names, (own * self._sizes).T, strict=True)}
        sums = {} if chart.course.structure is None else chart.course.structure.sums(chart.user)
        return np.column_stack([np.zeros((len(y), 0)), *(
            sum((at[part] for part in sums[name]), np.zeros(len(y))) if name in sums else at[name]
            for name in chart.user.free_names
        )])  # fmt: skip

    def solution(self, problem: Problem, roots: Sequence[ExtremalRoot], statistics: Statistics) -> Solution:
        """Return extremals of the chart as a solution of the user's problem at their values.

        Parameters
        ----------
        problem
            The user's problem at the values of the extremals.
        roots
            Extremals of the chart.
        statistics
            Record of how they were found.
        """
        chart, structure = self.chart, self.chart.course.structure
        if structure is None:
            return compose_solution(Indirect.name, problem, chart.own, roots, statistics)
        found = compose_solution(
            Indirect.name, renumber_restated(chart.problem, problem, structure), chart.own, roots, statistics
        )
        return join_solution(problem, found, structure)

    def own_unknowns(self, y: Matrix) -> Matrix:
        """Return the problem's own unknowns, (lanes, n), of all unknowns of the chart."""
        return y[:, self._own_places]

    def root(self, y: Matrix, choice: Matrix, residual: Vector, cost: Vector) -> Root:
        """Return a polished extremal as a root of the problem itself, in which the axes are given.

        Parameters
        ----------
        y, choice, residual, cost
            Of the extremal, as `Polished.row` has them, of one lane.
        """
        return Root(
            y=self.own_unknowns(y)[0],
            residual=residual,
            inverse=np.full((0, 0), np.nan),
            slopes=np.zeros(len(self._free)),
            ranges=np.zeros(0),
            cost=float(cost[0]),
            choice=choice[0, self._own_choice],
            converged=True,
        )
