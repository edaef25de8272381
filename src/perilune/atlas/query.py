"""Reading an atlas: the answer at a point of the region, polished by Newton's method and flown again.

The cells in which a point lies say what the unknowns of each sheet are there, to the fourth order in their size; a step or
two of Newton's method makes that exact, and what is reached has to be of its sheet and to keep its bounds. Then the extremal
is flown again by another integrator. Of several sheets the best is the answer, and all that were polished are its
extremals. Nothing is extrapolated: outside of the region, in a cell in which a sheet ends, or where Newton's method leaves
the cell, there is no answer, and it is said why.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.brick import WHOLE, Status
from perilune.atlas.build import cell_type, node_type, sheets_of
from perilune.atlas.chart import Chart, Extremals
from perilune.atlas.hermite import interpolated
from perilune.atlas.region import Axis, Region
from perilune.atlas.reflight import Reflights
from perilune.atlas.sheets import Borders, Sheet
from perilune.atlas.store import Store
from perilune.conditions.pontryagin import Conditions, derive
from perilune.io.reload import read_problem
from perilune.methods.answer import composed
from perilune.problem.preflight import preflight, refuse_impossible
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution, Statistics
from perilune.shooting.extremals import Found
from perilune.shooting.function import Root
from perilune.shooting.newton import FINEST
from perilune.words.asked import demand_path
from perilune.words.declared import parameter_name
from perilune.words.outcome import PeriluneError, unknown_name
from perilune.words.types import Matrix, Vector

_MOST = 8  # evaluations of Newton's method
_SLACK = 1e-9  # canonical: what a bound, a condition of the path or the end of a second flight may be missed by
_AWAY = 4.0  # how much further from what the cell gives a root may lie than the cell's own error, and 1e-6 of 1 + |y|


@dataclass(frozen=True, kw_only=True)
class Query:
    """How an answer was read.

    Parameters
    ----------
    sheets
        Labels of the sheets that reach the point, the answer's first.
    cell
        Size of the answer's cell along each axis, as a share of the region.
    guess_error
        By how much what the cell gives is wrong, relative.
    steps
        Of Newton's method for the answer.
    error_bound
        How far the unknowns can be from those of the exact extremal, relative: by the last two steps of Newton's method,
        its steps shrinking as squares do (Kantorovich). It is as good as the numbers that it is computed with are.
    residual, path, minimum, drift
        What the second flight shows (`perilune.atlas.reflight.Reflown`), canonical.
    cost_slopes
        dJ/dp of each axis [SI].
    latency
        Time that it took [s].
    """

    sheets: tuple[str, ...]
    cell: tuple[float, ...]
    guess_error: float
    steps: int
    error_bound: float
    residual: float
    path: float
    minimum: float
    drift: float
    cost_slopes: Mapping[str, float]
    latency: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Mapped(Solution):
    """A solution that was read from an atlas; `query` says how."""

    query: Query


class _Brick:
    """What is looked at of a brick: its cells as lists, which Python reads fastest, and its nodes as they lie on disk."""

    def __init__(self, nodes: NDArray[Any], cells: NDArray[Any]) -> None:
        self.nodes, self.cells = nodes, cells
        self.axis, self.child, self.status = (cells[name].tolist() for name in ("axis", "child", "status"))
        first = np.nonzero((cells["size"] == WHOLE).all(axis=1))[0]
        self.roots = {int(cells["sheet"][i]): int(i) for i in first}
        second = np.where(cells["child"] >= 0, cells["child"] + 1, 0)
        at = np.take_along_axis(cells["low"][second], np.maximum(cells["axis"], 0)[:, None], axis=1)[:, 0]
        self.split = at.tolist()
        self._terms: dict[int, NDArray[np.float64]] = {}

    def leaf(self, sheet: int, place: Sequence[float]) -> int:
        """The cell of a sheet in which a place lies, -1 where it has none."""
        cell = self.roots.get(sheet, -1)
        axis, child, split = self.axis, self.child, self.split
        while cell >= 0 and child[cell] >= 0:
            cell = child[cell] + (place[axis[cell]] >= split[cell])
        return cell

    def terms(self, cell: int) -> NDArray[np.float64]:
        """Values and derivatives at its corners."""
        found = self._terms.get(cell)
        if found is None:
            found = self._terms[cell] = self.nodes["terms"][self.cells["corners"][cell]][None]
            if len(self._terms) > 4096:
                self._terms.pop(next(iter(self._terms)))
        return found


class _Charted:
    """One chart of an atlas, as queries need it."""

    def __init__(self, problem: Problem, region: Region, said: Mapping[str, Any]) -> None:
        keep = tuple(said["keep"])
        self.sheets, self.unknowns = sheets_of(said), int(said["unknowns"])
        self.chart = Chart(problem, region.names, region.high - region.low, keep)
        self.borders = Borders(self.chart)
        self.reflights = Reflights(self.chart.free, self.chart.conditions)
        self.own: Conditions = derive(problem, keep)
        names = [name for name, _ in self.chart.conditions.unknowns]
        self.back = np.array([names.index(name) for name, _ in self.own.unknowns])


@dataclass(frozen=True)
class _Reached:
    """An extremal of one sheet at the point."""

    charted: _Charted
    sheet: Sheet
    found: Extremals
    flown: Any
    steps: int
    bound: float
    guess_error: float
    cell: tuple[float, ...]


class Atlas:
    """An atlas that is read; it may grow meanwhile. Use `perilune.atlas.open`.

    Attributes
    ----------
    problem
        What is mapped.
    region
        The axes, SI.
    """

    def __init__(self, directory: Path, problem_from_scenario: Callable[[str], Problem]) -> None:
        self.store = Store(directory)
        header = self.store.header()
        self.problem = read_problem(header, problem_from_scenario)
        self.region = Region(tuple(Axis(**axis) for axis in header["axes"]))
        self.tolerance = float(header["tolerance"])
        self._bricks: dict[tuple[int, ...], _Brick] = {}
        self.damaged: dict[str, str] = {}
        self.refresh()

    def refresh(self) -> None:
        """Look again at what the manifest says."""
        lines = list(self.store.lines())
        self.survey: dict[str, Any] = next((line for line in lines if line.get("kind") == "survey"), {"charts": []})
        ours = [line for line in lines if line.get("kind") == "brick" and line.get("survey") == self.survey.get("digest")]
        self._said = {(line["chart"], *line["brick"]): line for line in ours}
        self.__dict__.pop("charted", None)

    @cached_property
    def charted(self) -> list[_Charted]:
        """Its charts."""
        return [_Charted(self.problem, self.region, said) for said in self.survey["charts"]]

    def query(self, **values: float) -> Mapped:
        """The answer at values of the axes.

        Parameters
        ----------
        **values
            Of every axis, SI.

        Returns
        -------
        Mapped
            A solution, its trajectories and results made when they are looked at.

        Raises
        ------
        PeriluneError
            If a value is missing or outside of the region.
        InfeasibleError
            If physics refuses the point.
        PeriluneError
            If the map has no answer there: why, and what is near.
        """
        began = time.perf_counter()
        at = self._point(values)
        reached = [found for number in range(len(self.charted)) for found in self._reached(number, at)]
        good = [found for found in reached if found.sheet.minimum]
        if not good:
            raise self._nothing(at)
        good.sort(key=lambda found: float(found.found.cost[0]))
        return self._answer(at, good, [found for found in reached if not found.sheet.minimum], began)

    # -- where it is ----------------------------------------------------------------------------------------------

    def _point(self, values: Mapping[str, float]) -> Vector:
        told = {parameter_name(name): value for name, value in values.items()}
        names = self.region.names
        for name in told:
            if name not in names:
                raise unknown_name("axis", name, list(names))
        missing = [name for name in names if name not in told]
        if missing:
            raise PeriluneError("a value of every axis is needed", got=f"none of {', '.join(missing)}", expected=", ".join(names))
        try:
            at = np.array([float(told[name]) for name in names])
        except (TypeError, ValueError):
            raise PeriluneError("the values of axes are numbers in SI", got=str(told)[:80]) from None
        if not np.isfinite(at).all():
            raise PeriluneError("the values of axes are finite", got=str(told)[:80])
        if (outside := self.region.outside(at.tolist())) is not None:
            raise PeriluneError(
                "the point lies outside of the atlas", got=outside,
                advice="perilune solve answers anywhere; or build an atlas over a larger region",
            )  # fmt: skip
        return at

    def _brick(self, number: int, brick: tuple[int, ...]) -> _Brick | None:
        key = (number, *brick)
        if key not in self._bricks:
            said = self._said.get(key)
            if said is None:
                return None
            d, n = len(self.region.axes), self.charted[number].unknowns
            try:
                nodes = self.store.shard(said["nodes"], node_type(d, n))
                cells = self.store.shard(said["cells"], cell_type(d))
            except PeriluneError as error:
                self.damaged[str(said["name"])] = error.what
                return None
            self._bricks[key] = _Brick(nodes, cells)
        return self._bricks[key]

    def _reached(self, number: int, at: Vector) -> list[_Reached]:
        """Extremals of all sheets of a chart at a point that may be answers, or are known not to be minima."""
        charted, place = self.charted[number], self.region.brick_of(at)
        brick = self._brick(number, place)
        if brick is None:
            return []
        low, high = self.region.box(place)
        inside = ((at - low) / (high - low) * WHOLE).tolist()
        found = []
        for sheet in brick.roots:
            cell = brick.leaf(sheet, inside)
            if brick.status[cell] in (Status.ONE_STEP, Status.MORE_STEPS):
                extremal = self._polished(charted, sheet, brick, cell, np.array(inside), at, (high - low) / WHOLE)
                if extremal is not None:
                    found.append(extremal)
        return found

    def _polished(
        self, charted: _Charted, number: int, brick: _Brick, cell: int, place: Vector, at: Vector, step: Vector
    ) -> _Reached | None:
        """The extremal of a sheet, from what its cell gives; None where Newton's method leaves it, or it is no answer."""
        chart, sheet, said = charted.chart, charted.sheets[number], brick.cells[cell]
        size = said["size"]
        terms = brick.terms(cell)
        share = (place - said["low"]) / size
        values = (at / chart.scale)[None]
        guess = interpolated(terms, share[None], (size * step / chart.scale)[None])[:, :-1]
        which = np.zeros(1, dtype=np.int64)
        holds = charted.borders.holds([sheet], which, values)
        found = chart.solve(values, guess, holds, limit=_MOST)
        if not found.converged[0] or found.orientation[0] != sheet.orientation:
            return None
        spread = float(np.linalg.norm(np.ptp(terms[0, :, 0, :-1], axis=0)))
        length = float(np.linalg.norm(found.y[0] - guess[0]))
        size_of = 1.0 + float(np.linalg.norm(found.y[0]))
        if length > 0.5 * spread + 1e-6 * size_of:
            return None
        if charted.borders.margins([sheet], which, found)[0] < -_SLACK:
            return None
        held = found.roots.choice[:, : chart.shooting.plan.held] > 0
        flown = charted.reflights(found.roots.y, chart.p[None], held)
        if sheet.minimum and not (
            flown.residual[0] <= _SLACK and flown.path[0] >= -_SLACK and flown.minimum[0] >= -_SLACK and flown.drift[0] <= _SLACK
        ):
            return None
        return _Reached(
            charted=charted, sheet=sheet, found=found, flown=flown, steps=int(found.roots.evaluations[0]) - 1,
            bound=2.0 * float(found.length[0]), guess_error=length / size_of,
            cell=tuple((size / (WHOLE * self.region.parts)).tolist()),
        )  # fmt: skip

    # -- the answer, or why there is none -------------------------------------------------------------------------

    def _answer(self, at: Vector, good: list[_Reached], others: list[_Reached], began: float) -> Mapped:
        names = self.region.names
        problem = self.problem.with_given(**dict(zip(names, at.tolist(), strict=True)))
        best = good[0]
        roots = [Found(root=self._root(r), minimum=r.sheet.minimum) for r in (*good, *others)]
        statistics = Statistics(rung="atlas", iterations=best.steps, arcs=sum(r.steps + 1 for r in (*good, *others)))
        answer = composed("indirect", problem, best.charted.own, roots, statistics)
        unit = self.problem.objective_size
        slopes = best.found.cost_slopes[0] * unit / best.charted.chart.scale
        query = Query(
            sheets=tuple(r.sheet.label for r in (*good, *others)),
            cell=best.cell,
            guess_error=best.guess_error,
            steps=best.steps,
            error_bound=best.bound,
            residual=float(best.flown.residual[0]),
            path=float(best.flown.path[0]),
            minimum=float(best.flown.minimum[0]),
            drift=float(best.flown.drift[0]),
            cost_slopes=dict(zip(names, slopes.tolist(), strict=True)),
            latency=time.perf_counter() - began,
        )
        return Mapped(**{**answer.__dict__, "query": query})

    @staticmethod
    def _root(reached: _Reached) -> Root:
        """As a root of the problem itself, where the axes are given."""
        root, charted = reached.found.roots[0], reached.charted
        plan = charted.chart.shooting.plan
        free = [i for i, name in enumerate(charted.chart.free.free_names) if name not in charted.chart.names]
        kept = [*free, *range(plan.free, plan.held)]
        return replace(
            root,
            y=root.y[charted.back],
            inverse=np.full((0, 0), np.nan),
            slopes=root.slopes[free],
            choice=np.concatenate([root.choice[kept], root.choice[[plan.held + i for i in kept]]]),
        )

    def _nothing(self, at: Vector) -> PeriluneError:
        """Why there is no answer at a point of the region."""
        values = dict(zip(self.region.names, at.tolist(), strict=True))
        refuse_impossible(preflight(self.problem.with_given(**values)))
        place = self.region.brick_of(at)
        if not any((number, *place) in self._said for number in range(len(self.charted))):
            return PeriluneError("this part of the atlas is not built", got=str(values)[:120], advice="perilune atlas build ... --resume")
        if self.damaged:
            return PeriluneError("this part of the atlas is damaged", got=", ".join(self.damaged), advice="perilune atlas verify DIR")
        nearest = self._nearest(at)
        return PeriluneError(
            "the atlas has no answer here: its sheets end in this cell, or change",
            got=str(values)[:160],
            expected=f"for instance {nearest}" if nearest else "another point",
            advice="perilune solve answers at single points",
        )

    def _nearest(self, at: Vector) -> str:
        """The nearest node that is an answer, in words."""
        place, found, least = self.region.brick_of(at), "", np.inf
        for number, charted in enumerate(self.charted):
            brick = self._brick(number, place)
            if brick is None:
                continue
            minimum = np.array([sheet.minimum for sheet in charted.sheets])
            nodes = brick.nodes
            good = (nodes["margin"] >= 0) & minimum[nodes["sheet"]] & (nodes["residual"] <= _SLACK) & (nodes["path"] >= -_SLACK)
            if not good.any():
                continue
            values = nodes["values"][good]
            away = np.abs((values - at) / (self.region.high - self.region.low)).max(axis=1)
            if away.min() < least:
                least = float(away.min())
                row = values[away.argmin()].tolist()
                found = ", ".join(f"{a.name} {v:.6g} {a.unit}" for a, v in zip(self.region.axes, row, strict=True))
        return found


def open_atlas(directory: str | Path, problem_from_scenario: Callable[[str], Problem] | None = None) -> Atlas:
    """Read an atlas.

    Parameters
    ----------
    directory
        As `perilune.atlas.build` made it.
    problem_from_scenario
        Makes the problem of a scenario's text; `perilune.scenario.load_text` if None.

    Raises
    ------
    PeriluneError
        If there is none, or it is of another format.
    """
    if problem_from_scenario is None:
        from perilune.scenario import load_text as problem_from_scenario
    return Atlas(demand_path(directory, "the directory of an atlas"), problem_from_scenario)
