"""Extremals at many points from one solution, in lanes, each integrated again by another integrator.

A point begins on the tangent plane of the nearest node of a lattice around the known extremal; where Newton's method
does not lead on from there, on that of a finer one. Extremals that hold one bound more or less than the known one are
compared with it. What a point begins with depends on no other point, so that its answer is the same to the last bit in
any batch.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.charts.arc_sequence import ArcSequence, arc_sequence_of, kept_conditions
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
    doubt
        Least J, canonical, of an extremal that is suspected and was not found: one with less answers nothing.
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
    doubt: Vector
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
            if f.name != "doubt":
                getattr(self, f.name)[lanes[its]] = getattr(by, f.name)[its]


@dataclass(frozen=True, kw_only=True)
class KnownExtremal:
    """Extremal from which points are reached, as any process can be given it.

    Parameters
    ----------
    problem, free
        Problem whose extremal it is, and its free parameters [SI].
    sequence, unknowns
        Its arcs, and the unknowns of their problem.
    """

    problem: Problem
    free: Mapping[str, float]
    sequence: ArcSequence
    unknowns: Vector

    @classmethod
    def of(cls, solution: Solution) -> KnownExtremal:
        """Return the extremal of a solution, as the indirect method returns it.

        Raises
        ------
        PeriluneError
            If a chart cannot follow its arcs.
        """
        sequence, extremals = arc_sequence_of(solution, kept_conditions(solution))
        unknowns = np.array(extremals[0].unknowns)
        return cls(problem=solution.problem, free=dict(solution.free), sequence=sequence, unknowns=unknowns)


class PointSolver:
    """Extremals of the form of a known one, at other values of some parameters.

    Parameters
    ----------
    known
        The known extremal.
    names
        Parameters that vary.

    Raises
    ------
    PeriluneError
        If a chart cannot follow it.
    NotConvergedError
        If it is not found again.
    """

    def __init__(self, known: KnownExtremal, names: Sequence[str]) -> None:
        problem, free = known.problem, known.free
        base = np.array([free[n] if n in free else problem.given[n].value for n in names])
        # Nothing of the points enters: canonical units that followed them would change last bits.
        widths = [abs(v) or problem.scales.of(problem.unit_of(n)) for n, v in zip(names, base.tolist(), strict=True)]
        chart = Chart(problem, names, np.array(widths), known.sequence)
        y = chart.from_problem_unknowns(known.unknowns)
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
        found = self._of_first_sheet(values)
        for number, lattice in enumerate(self._lattices[1:], 1):
            nodes = lattice(values)
            with np.errstate(invalid="ignore"):
                better = nodes.cost_at(values) < found.cost + _ROUGH * (0.1 + np.abs(found.cost))
            if (lanes := np.nonzero(nodes.known & (~found.found | better))[0]).size:
                polished = self._polished(number, values[lanes], nodes.of(lanes))
                found.put(lanes, self._extremals(polished))
        return found

    def _of_first_sheet(self, values: Matrix) -> PointExtremals:
        """Return extremals of the sheet of the known solution.

        One that breaks the path casts doubt, as a flight with an arc along it may be better than others; and one that
        is not reached, with what J its tangent plane says.
        """
        found, left = self.none(len(values)), np.arange(len(values))
        doubt = found.doubt
        doubt[:] = self._first.of(np.zeros(len(values), dtype=np.int64)).cost_at(values)
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
        return found

    def _polished(self, number: int, values: Matrix, nodes: LatticeNodes) -> Polished:
        """Return what Newton's method makes of the tangent planes of nodes of a sheet at values, canonical."""
        which, guess = np.full(len(values), number), nodes.unknowns_at(values)
        polished = self.open.polish(values, which, guess)
        if (poor := np.nonzero(polished.reached & polished.doubtful)[0]).size:  # flights longer than the known one
            polished.put(poor, self.open.polish(values[poor], which[poor], guess[poor], finer=_FINER))
        return polished

    def _extremals(self, polished: Polished) -> PointExtremals:
        """Return polished extremals, of which those are found that answer."""
        return PointExtremals(
            found=polished.answers, doubt=np.full(len(polished.y), np.inf), y=polished.y, choice=polished.choice,
            residual=polished.reintegrated.margins.residual, cost=polished.cost, ends=polished.reintegrated.ends,
            slopes=polished.slopes * self.objective_size / self.open.chart.scale, error_bound=polished.bound,
            steps=polished.steps,
        )  # fmt: skip

    @property
    def objective_size(self) -> float:
        """Return the unit of J [SI]."""
        return self.open.chart.problem.objective_size

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
        return PointExtremals(found=np.zeros(count, dtype=bool), doubt=np.full(count, np.inf), **rows)

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
        places = np.cumsum([0, len(phases[0].states), *(len(phase.states) for phase in phases)])
        states = [(found.ends * scale).T[i:j] for i, j in itertools.pairwise(places)]  # at the start, and of each arc
        structure = self.open.chart.course.structure
        arcs = [1] * len(phases) if structure is None else [len(arcs) for arcs in structure.phases]
        last = [states[n] for n in np.cumsum(arcs)]
        p = SimpleNamespace(**{**{name: given.value for name, given in problem.given.items()}, **parameters})
        count, told = len(found.cost), dict[str, Any]()
        with np.errstate(all="ignore"):
            if problem.results is None:
                told["flight_time"] = sum(getattr(p, phase.duration) for phase in problem.phases)
                told["objective"] = found.cost * self.objective_size
            else:
                ends = problem.phases[0].state_record(*states[0]), problem.phases[-1].state_record(*last[-1])
                told |= _named(problem.result_variables, problem.results(*ends, p, NUMERIC))
            for phase, end in zip(problem.phases, last, strict=True):
                told |= _named(phase.end_output_variables, phase.evaluate("end_outputs", end, (), p))
        return {name: np.broadcast_to(np.asarray(value, dtype=float), count) for name, value in told.items()}

    @staticmethod
    def end_results(problem: Problem) -> dict[str, Variable]:
        """Return the results of a problem that depend on the ends of its phases only, by name."""
        variables = problem.result_variables
        if problem.results is None:
            unit = problem.objective_unit
            variables = Variable(name="flight_time", unit="s"), Variable(name="objective", unit=unit, description="J")
        phases = (v for phase in problem.phases for v in phase.end_output_variables)
        return {variable.name: variable for variable in (*variables, *phases)}

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


def _named(variables: Sequence[Variable], values: Sequence[Any]) -> dict[str, Any]:
    return {variable.name: value for variable, value in zip(variables, values, strict=True)}
