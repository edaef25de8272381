"""From values of the parameters to a flight: out of an atlas, or from the last flight as a neighbour."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

from perilune.atlas.query import Atlas, Mapped
from perilune.conditions.canonical import extremal_parameters
from perilune.methods.answer import Curves
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution
from perilune.shooting.function import Shooting
from perilune.solve import solve
from perilune.words.outcome import InfeasibleError, PeriluneError

_SAME = 1e-12  # relative: a value that was not moved
_FAMILY = 24  # extremals of a family to either side


@dataclass(frozen=True, kw_only=True)
class Flown:
    """A flight, where it is from, and how long it took.

    Parameters
    ----------
    solution
        The flight.
    source
        ``map``, ``neighbour``, or ``nothing``.
    words
        The same for people.
    latency
        Until it was there [s].
    """

    solution: Solution
    source: str
    words: str
    latency: float


@dataclass
class Answering:
    """Answers one client.

    Parameters
    ----------
    problem
        What is explored.
    atlas
        Where it is mapped, if it is.
    last
        The flight from which neighbours begin.
    """

    problem: Problem
    atlas: Atlas | None = None
    last: Solution | None = field(default=None)

    def at(self, values: Mapping[str, float]) -> Flown:
        """The flight at values of given parameters [SI]; all others are as the problem has them.

        Raises
        ------
        PeriluneError
            If there is none: why.
        """
        began = time.perf_counter()
        try:
            found = self._mapped(values)
        except InfeasibleError:
            raise
        except PeriluneError:
            found = None  # the map ends here; a neighbour may know more
        if found is None:
            found = self._near(values)
        self.last = found[0]
        return Flown(solution=found[0], source=found[1], words=found[2], latency=time.perf_counter() - began)

    def _mapped(self, values: Mapping[str, float]) -> tuple[Solution, str, str] | None:
        atlas = self.atlas
        if atlas is None:
            return None
        axes = set(atlas.region.names)
        for name, value in values.items():
            if name not in axes and abs(value - self.problem.given[name].value) > _SAME * (1.0 + abs(value)):
                return None
        asked = {name: values.get(name, self._middle(atlas, name)) for name in axes}
        found: Mapped = atlas.query(**asked)
        steps = "step" if found.query.steps == 1 else "steps"
        words = f"from the map, polished in {found.query.steps} {steps}, flown twice"
        return found, "map", words

    def _middle(self, atlas: Atlas, name: str) -> float:
        if name in self.problem.given:
            return float(self.problem.given[name].value)
        axis = next(axis for axis in atlas.region.axes if axis.name == name)
        return 0.5 * (float(axis.low) + float(axis.high))

    def _near(self, values: Mapping[str, float]) -> tuple[Solution, str, str]:
        given = {name: value for name, value in values.items() if name in self.problem.given}
        problem = self.problem.with_given(**given)
        if self.last is not None:
            try:
                return solve(problem, guess=self.last, level=0), "neighbour", "an extremal near the flight before"
            except InfeasibleError:
                raise
            except PeriluneError:
                pass  # a family that ends here: from nothing there may be another
        found = solve(problem, level=0)
        return found, "nothing", "found from nothing"


def family(solution: Solution) -> dict[str, object] | None:
    """J of the extremals along which the first free parameter is held, to either side of the answer.

    None where nothing is free, or the answer has arcs: {"name", "unit", "values", "objective"}, SI.
    """
    curves = solution.trajectories
    if not isinstance(curves, Curves) or not solution.problem.free:
        return None
    shooting, root, problem = Shooting(curves.conditions), curves.root, curves.problem
    scale, first = problem.scales.of(problem.free[0].unit), curves.conditions.free_at.start
    limits = [limit / scale for limit in (problem.free[0].lower, problem.free[0].upper)]
    here = float(root.y[first])
    reach = 0.3 * max(abs(here), 0.1 * min(abs(limits[1] - limits[0]), 10.0))
    points = [(here, root.cost)]
    p = extremal_parameters(problem)
    for way in (-1, 1):
        y = root.y
        for step in range(1, _FAMILY + 1):
            value = min(max(here + way * reach * step / _FAMILY, limits[0]), limits[1])
            choice = shooting.holding({0: value})
            found = shooting.root(y, p, choice, limit=20)
            if not found.converged or value in limits:
                break
            y = found.y
            points.append((value, found.cost))
    points.sort()
    return {
        "name": problem.free[0].name,
        "unit": problem.free[0].unit,
        "values": [value * scale for value, _ in points],
        "objective": [cost * problem.objective_size for _, cost in points],
    }
