"""Neighbouring extremals of a solution at other values of given parameters, by Newton's method, many at once.

Values of given parameters are numbers that the shooting function takes. So nothing is stated, traced, derived or
tabulated again: a family is one call in lanes. Whether an extremal keeps the rest of its conditions, and whether it is
the best one, is for others to say.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from perilune.conditions import extremal_parameters
from perilune.core import NUMERIC, Matrix, PeriluneError, unknown_name
from perilune.methods.indirect.newton_trials import found_at
from perilune.methods.indirect.result import Curves, compose_solution
from perilune.problem import Problem, Solution, Statistics, with_given_unchecked
from perilune.shooting import ActiveSetBounds, Root, Roots, Shooting
from perilune.structures import JoinedTrajectories, join_solution, renumber_restated


class Nearby:
    """Extremals near that of a solution, which differ from it in values of given parameters.

    Parameters
    ----------
    solution
        Of the indirect method, as it was found here: one that was saved or sent away is solved again first.

    Raises
    ------
    PeriluneError
        If nothing but its curves is known of it.
    """

    def __init__(self, solution: Solution) -> None:
        known = solution.trajectories
        self.solution, self.arcs = solution, known if isinstance(known, JoinedTrajectories) else None
        curves = known.restated.trajectories if isinstance(known, JoinedTrajectories) else known
        if not isinstance(curves, Curves):
            raise PeriluneError(
                "only the curves of this solution are known",
                got=f"a solution of the method {solution.method}",
                expected="a solution of Indirect() as it was returned",
                advice="perilune.solve(solution.problem, guess=solution)",
            )
        self.problem: Problem = curves.problem
        self.root, self.shooting = curves.root, Shooting(curves.conditions)
        self.limits = ActiveSetBounds.of(self.problem, curves.conditions)
        self._places = {name: i for i, name in enumerate(self.problem.given)}

    def numbers(self, values: Mapping[str, ArrayLike]) -> Matrix:
        """Return canonical numbers for the shooting function, (lanes, numbers), from SI values or arrays (lanes,).

        Raises
        ------
        PeriluneError
            If a name is no given parameter, or that of a bound between which an end condition has to lie, or moves an
            end away from the arc on which the solution ends.
        """
        bounds = {limit for phase in self.problem.phases for c in phase.end_conditions for limit in (c.lower, c.upper)}
        for name in values:
            if name not in self.solution.problem.given:
                raise unknown_name("given parameter", name, sorted(self.solution.problem.given))
            if name in bounds:
                raise PeriluneError(
                    f"{name} bounds an end condition, which may or may not be active",
                    expected="a parameter of the equations",
                    advice="perilune.solve(problem.with_given(...), guess=solution), one by one",
                )
        if self.arcs is not None:
            self.arcs.refuse_unstated_ends(self.solution.problem, tuple(values))
        arrays = np.broadcast_arrays(np.zeros(1), *(np.asarray(value, dtype=float) for value in values.values()))[1:]
        found = np.tile(extremal_parameters(self.problem), (len(arrays[0]) if arrays else 1, 1))
        for name, array in zip(values, arrays, strict=True):
            found[:, self._places[name]] = array / self.problem.scales.of(self.problem.unit_of(name))
        return found

    def roots(self, values: Mapping[str, ArrayLike], begin: Matrix | None = None) -> Roots:
        """Solve by Newton's method at values of given parameters, in lanes.

        Parameters
        ----------
        values
            As for `numbers`.
        begin
            Unknowns to begin with, (lanes, unknowns), such as those of neighbours; by default those of the solution.

        Returns
        -------
        Roots
            Each with what it holds; `converged` says which are extremals.
        """
        p = self.numbers(values)
        Y = np.tile(self.root.y, (len(p), 1)) if begin is None else begin
        each = self._limits(values, len(p))
        choice = np.array([limits.taken_over(self.root.choice, self.limits) for limits in each])
        limits = ActiveSetBounds(
            lower=np.array([one.lower for one in each]), upper=np.array([one.upper for one in each])
        )
        return limits.solve(self.shooting, Y, p, choice)

    def _limits(self, values: Mapping[str, ArrayLike], lanes: int) -> list[ActiveSetBounds]:
        """Return the limits of each lane: ranges of free parameters may follow from the given ones."""
        if self.solution.problem.parameter_bounds is None:
            return [self.limits] * lanes
        columns = [np.broadcast_to(np.asarray(value, dtype=float), lanes).tolist() for value in values.values()]
        rows = zip(*columns, strict=True) if columns else [()] * lanes
        return [self._limits_at(dict(zip(values, row, strict=True))) for row in rows]

    def _limits_at(self, values: Mapping[str, float]) -> ActiveSetBounds:
        known, found = self.solution.problem, dict[str, tuple[Any, ...]]()
        assert known.parameter_bounds is not None, "they were asked for"
        with suppress(PeriluneError):  # nothing is said where the values make no sense
            found = known.parameter_bounds(SimpleNamespace(**{**vars(known.parameters({})), **values}), NUMERIC)
        if all(found.get(f.name, (f.lower, f.upper))[:2] == (f.lower, f.upper) for f in known.free):
            return self.limits
        return ActiveSetBounds.of(self._own(with_given_unchecked(known, values)), self.shooting.conditions)

    def _own(self, problem: Problem) -> Problem:
        """Return the user's problem at other values as it is solved: with a phase for each arc."""
        return problem if self.arcs is None else renumber_restated(self.problem, problem, self.arcs.structure)

    def at(self, root: Root, values: Mapping[str, float]) -> Solution:
        """Return an extremal that was found as a solution of the problem with these values, unverified.

        Parameters
        ----------
        root
            Root of the shooting function of this solution at the values given.
        values
            Values of given parameters by name [SI].
        """
        problem = self.solution.problem.with_given(**values)
        own = self._own(problem)
        statistics = Statistics(initialization="guess", iterations=len(root.history))
        extremal = found_at(self.shooting, own, root)
        found = compose_solution(self.solution.method, own, self.shooting.conditions, [extremal], statistics)
        if self.arcs is None:
            return found
        whole = join_solution(problem, found, self.arcs.structure)
        return replace(
            whole, statistics=replace(whole.statistics, initialization=self.solution.statistics.initialization)
        )
