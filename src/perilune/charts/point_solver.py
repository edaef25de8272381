"""Extremals at many points from one solution, in lanes, each integrated again by another integrator.

A point begins on the tangent plane of the nearest node of a lattice around the known extremal; where Newton's method
does not lead on from there, on that of a finer one. Extremals that hold one bound more or less than the known one are
compared with it. What a point begins with depends on no other point, so that its answer is the same to the last bit in
any batch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.charts.arc_sequence import arc_sequence_of, kept_conditions
from perilune.charts.chart import Chart
from perilune.charts.continuation import Lanes
from perilune.charts.lattice import LatticeNodes, SheetLattice
from perilune.charts.open_chart import OpenChart
from perilune.charts.polish import Polished
from perilune.charts.reintegrate import ChartReintegration
from perilune.charts.starting_sheets import starting_sheets
from perilune.core import NUMERIC, Matrix, NotConvergedError, Vector
from perilune.methods import ExtremalRoot
from perilune.problem import Phase, Problem, Solution, Statistics, Variable, state_scales

_FINER = 8  # times as many steps, where those that do for the known solution do not
_LEVELS = 2  # of the lattice of the sheet of the known solution
_ROUGH = 0.01  # of 0.1 + |J|: by so much less J may be than tangent planes say


@dataclass(frozen=True, kw_only=True)
class PointExtremals:
    """Extremals at points, in lanes; without meaning where none is `found`.

    Attributes
    ----------
    found
        True where an extremal keeps bounds and path and, integrated independently, meets the end conditions.
    y, choice
        Unknowns of the chart, and what they hold, canonical.
    residual, cost
        Largest residual of the independent re-integration, and J there, canonical.
    ends
        States at the start and at the end of each phase, canonical, as of `ReintegratedExtremals`.
    slopes
        dJ/dp [SI], (lanes, d).
    error_bound
        How far the unknowns can be from those of the extremal, relative.
    steps
        Number of Newton steps.
    """

    found: NDArray[np.bool_]
    y: Matrix
    choice: Matrix
    residual: Vector
    cost: Vector
    ends: Matrix
    slopes: Matrix
    error_bound: Vector
    steps: Vector

    def of(self, lanes: Lanes) -> PointExtremals:
        """Return some of the lanes."""
        return PointExtremals(**{f.name: getattr(self, f.name)[lanes] for f in fields(self)})

    def put(self, lanes: Lanes, by: PointExtremals) -> None:
        """Replace lanes by better extremals that another result found there.

        Parameters
        ----------
        lanes
            Numbers of the lanes that `by` has, in its order.
        by
            Other extremals.
        """
        with np.errstate(invalid="ignore"):
            its = by.found & ~(self.found[lanes] & (self.cost[lanes] <= by.cost))
        for f in fields(self):
            getattr(self, f.name)[lanes[its]] = getattr(by, f.name)[its]


class PointSolver:
    """Extremals of the form of one solution, at other values of some parameters.

    Parameters
    ----------
    problem
        The user's problem.
    solution
        Extremal of it, as the indirect method returns it.
    names
        Parameters that vary.

    Raises
    ------
    PeriluneError
        If a chart cannot follow the arcs of the solution.
    NotConvergedError
        If the extremal of the solution is not found again.
    """

    def __init__(self, problem: Problem, solution: Solution, names: Sequence[str]) -> None:
        course, extremals = arc_sequence_of(solution, kept_conditions(solution))
        base = np.array([solution.free[n] if n in solution.free else problem.given[n].value for n in names])
        # Nothing of the points enters: canonical units that followed them would change last bits.
        widths = [abs(v) or problem.scales.of(problem.unit_of(n)) for n, v in zip(names, base.tolist(), strict=True)]
        chart = Chart(problem, names, np.array(widths), course)
        y = chart.from_problem_unknowns(np.array(extremals[0].unknowns))
        begin = list(starting_sheets(chart, base / chart.scale, y))
        if not begin:
            raise NotConvergedError("the extremal of the guess is not found again", advice="another guess, or none")
        times = ChartReintegration(chart).fine_enough(begin[0].whole, chart.p[None])
        self.open: OpenChart = OpenChart(chart, [one.sheet for one in begin], times)
        self._first: LatticeNodes = begin[0].node
        self._lattices = [
            SheetLattice(self.open, number, one.node, 1 if number else _LEVELS) for number, one in enumerate(begin)
        ]

    def solve(self, points: Matrix) -> PointExtremals:
        """Find the extremals at points.

        Parameters
        ----------
        points
            Values of the parameters [SI], (lanes, d).
        """
        values = points / self.open.chart.scale
        found, doubt = self._of_first_sheet(values)
        for number, lattice in enumerate(self._lattices[1:], 1):
            nodes = lattice(values)
            with np.errstate(invalid="ignore"):
                better = nodes.cost_at(values) < found.cost + _ROUGH * (0.1 + np.abs(found.cost))
            if (lanes := np.nonzero(nodes.known & (~found.found | better))[0]).size:
                polished = self._polished(number, values[lanes], nodes.of(lanes))
                found.put(lanes, self._extremals(polished))
        found.found[found.found & (doubt < found.cost)] = False
        return found

    def _of_first_sheet(self, values: Matrix) -> tuple[PointExtremals, Vector]:
        """Return extremals of the sheet of the known solution, and J of those that cast doubt, inf for none.

        One that breaks the path does, as a flight with an arc along it may be better than others; and one that is not
        reached, with what J its tangent plane says.
        """
        found, left = self.none(len(values)), np.arange(len(values))
        doubt = self._first.of(np.zeros(len(values), dtype=np.int64)).cost_at(values)
        for level in range(_LEVELS):
            if not left.size:
                break
            nodes = self._lattices[0](values[left], level)
            if not (has := np.nonzero(nodes.known)[0]).size:
                continue
            some, nodes = left[has], nodes.of(has)
            polished = self._polished(0, values[some], nodes)
            found.put(some, self._extremals(polished))
            broken = np.where(polished.breaking, polished.cost, np.inf)
            doubt[some] = np.where(polished.reached, broken, nodes.cost_at(values[some]))
            left = np.setdiff1d(left, some[polished.reached])
        return found, doubt

    def _polished(self, number: int, values: Matrix, nodes: LatticeNodes) -> Polished:
        """Return what Newton's method makes of the tangent planes of nodes of a sheet at values, canonical."""
        which, guess = np.full(len(values), number), nodes.unknowns_at(values)
        polished = self.open.polish(values, which, guess)
        if (poor := np.nonzero(polished.reached & polished.doubtful)[0]).size:  # flights longer than the known one
            polished.put(poor, self.open.polish(values[poor], which[poor], guess[poor], finer=_FINER))
        return polished

    def _extremals(self, polished: Polished) -> PointExtremals:
        """Return polished extremals, of which those are found that answer."""
        size = self.open.chart.problem.objective_size
        return PointExtremals(
            found=polished.answers, y=polished.y, choice=polished.choice,
            residual=polished.reintegrated.margins.residual, cost=polished.cost, ends=polished.reintegrated.ends,
            slopes=polished.slopes * size / self.open.chart.scale, error_bound=polished.bound, steps=polished.steps,
        )  # fmt: skip

    def nearest_nodes(self, points: Matrix) -> Matrix:
        """Return the coarsest node of the lattice next to each of some points [SI], (lanes, d)."""
        scale = self.open.chart.scale
        return self._lattices[0].nearest(points / scale, 0) * scale

    def none(self, count: int) -> PointExtremals:
        """Return arrays for so many points, of which none is found."""
        plan, d = self.open.chart.shooting.plan, len(self.open.chart.names)
        ends = sum(len(phase.states) for phase in (self._phases[0], *self._phases))
        sizes = {"y": plan.size, "choice": 2 * plan.held, "ends": ends, "slopes": d}
        rows = {name: np.full((count, size), np.nan) for name, size in sizes.items()}
        rows |= {name: np.full(count, np.nan) for name in ("residual", "cost", "error_bound", "steps")}
        return PointExtremals(found=np.zeros(count, dtype=bool), **rows)

    @property
    def _phases(self) -> Sequence[Phase]:
        return self.open.chart.problem.phases

    def free(self, found: PointExtremals) -> Matrix:
        """Return the free parameters of the user's problem that do not vary [SI], (lanes, k)."""
        return self.open.free(found.y)

    def results(self, found: PointExtremals, parameters: Mapping[str, Vector]) -> dict[str, Vector]:
        """Return the results that depend on the ends of the flight only, by name [SI], (lanes,) each.

        Parameters
        ----------
        found
            Extremals, all of them found.
        parameters
            Values of free and varied parameters there [SI], (lanes,) each.
        """
        problem, phases = self.open.chart.user, self._phases
        scale = np.concatenate([state_scales(self.open.chart.problem, phase) for phase in (phases[0], *phases)])
        states = (found.ends * scale).T
        first, last = states[: len(phases[0].states)], states[-len(phases[-1].states) :]
        p = SimpleNamespace(**{**{name: given.value for name, given in problem.given.items()}, **parameters})
        ends = [problem.phases[i].state_record(*x) for i, x in ((0, first), (-1, last))]
        told = list[tuple[Sequence[Variable], Sequence[Any]]]()
        with np.errstate(all="ignore"):
            if problem.results is not None:
                told.append((problem.result_variables, problem.results(*ends, p, NUMERIC)))
            told.append(
                (problem.phases[-1].end_output_variables, problem.phases[-1].evaluate("end_outputs", last, (), p))
            )
        return {
            variable.name: np.broadcast_to(np.asarray(value, dtype=float), len(found.cost))
            for variables, values in told
            for variable, value in zip(variables, values, strict=True)
        }

    def solution(self, problem: Problem, found: PointExtremals, lane: int) -> Solution:
        """Return the extremal of a lane as a solution of the user's problem at its values.

        Parameters
        ----------
        problem
            The user's problem at the values of the point.
        found, lane
            Extremals of which it is one, and its number.
        """
        its, steps = slice(lane, lane + 1), int(found.steps[lane])
        root = self.open.root(found.y[its], found.choice[its], found.residual[its], found.cost[its])
        statistics = Statistics(initialization="guess", iterations=steps, arcs=steps + 1)
        return self.open.solution(problem, [ExtremalRoot(root=root, minimum=True)], statistics)
