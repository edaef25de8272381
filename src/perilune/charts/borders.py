"""Borders of a branch: the bounds, conditions and multipliers within which its extremals are answers."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.charts.bound_status import SLACK, BoundStatus
from perilune.charts.chart import Chart, Extremals, Holds
from perilune.charts.sheet import Sheet
from perilune.core import NUMERIC, Matrix, PeriluneError, Vector
from perilune.kernels import Map, compile_map
from perilune.methods import SIGNED
from perilune.problem import SYMBOLIC, free_scales
from perilune.shooting import ActiveSetBounds

Limits = tuple[Matrix, Matrix]  # lower and upper bounds of what can be held
_SIDES = 1.0, -1.0  # what `Borders.sides` has for what is held at its lower bound, and at its upper one
_DIFFERENCE = 1e-4  # of the range of a parameter: where differences of bounds are taken
_MISSED = 1e-4  # of 1 + its size: a cell that gives a bound by so much wrong gives J so roughly that it shows nothing


class Borders:
    """Bounds of what can be held, at values of the parameters.

    Parameters
    ----------
    chart
        Whose extremals.
    """

    def __init__(self, chart: Chart) -> None:
        self.chart: Chart = chart
        problem = chart.problem
        plan, own = chart.shooting.plan, ActiveSetBounds.of(problem, chart.own)
        free, ends = len(problem.free), [c for phase in problem.phases for c in phase.end_conditions]
        lower, upper = np.full(plan.held, -np.inf), np.full(plan.held, np.inf)
        lower[:free], upper[:free] = own.lower[:free], own.upper[:free]
        lower[plan.free :], upper[plan.free :] = own.lower[free:], own.upper[free:]
        for i, name in enumerate(problem.free_names):
            if name in chart.names:  # what varies is where it was set
                lower[i], upper[i] = -np.inf, np.inf
        self._lower, self._upper = lower, upper
        self.names: list[str] = [*chart.free.free_names, *(ends[row].name for row, _ in chart.conditions.ranges)]
        self._ranged = [ends[row] for row, _ in chart.conditions.ranges]
        self._free_sizes = free_scales(problem.free, problem)
        self._given = {name: given.value for name, given in problem.given.items()}
        self._numbers = np.array([list(self._given.values())]).reshape(1, -1)
        sums = {} if chart.course.structure is None else chart.course.structure.sums(chart.user)
        part_of = {part: name for name, parts in sums.items() for part in parts}
        chosen = [  # what `Problem.parameter_bounds` may say of it, or of what it is a part of
            (i, part_of.get(f.name, f.name), self._free_sizes[i], f.name not in part_of and bool(np.isfinite(lower[i])))
            for i, f in enumerate(problem.free) if f.name not in chart.names
        ] + [
            (i, c.name, problem.size_of(c), bool(np.isfinite(lower[i])))
            for i, c in enumerate(self._ranged, plan.free) if c.name in sums
        ]  # fmt: skip
        self._chosen = chosen if problem.parameter_bounds is not None else []
        self._vary = problem.parameter_bounds is not None or any(
            isinstance(x, str) for c in self._ranged for x in (c.lower, c.upper)
        )
        unknowns = [name for name, _ in chart.conditions.unknowns]
        self.touched: list[int] = [unknowns.index(name) for name in chart.course.touched(chart.user)]

    def at(self, values: Matrix) -> Limits:
        """Return lower and upper bounds of what can be held, canonical, (lanes, k) each."""
        chart, given = self.chart, self._given
        lower, upper = self._lower[None].repeat(len(values), axis=0), self._upper[None].repeat(len(values), axis=0)
        if not self._vary:
            return lower, upper
        if (traced := self._traced) is not None:
            return traced(values, self._numbers)  # pyright: ignore[reportReturnType] - two of them
        values = values * chart.scale
        if len(values) > 1:
            try:  # all lanes at once, where what is stated of the ranges can
                self._state(SimpleNamespace(**{**given, **dict(zip(chart.names, values.T, strict=True))}), lower, upper)
            except (TypeError, ValueError):
                pass
            else:
                return lower, upper
        for lane, row in enumerate(values.tolist()):
            p = SimpleNamespace(**{**given, **dict(zip(chart.names, row, strict=True))})
            with suppress(PeriluneError):  # nothing is said where the values make no sense
                self._state(p, lower[lane : lane + 1], upper[lane : lane + 1])
        return lower, upper

    def bind(self, values: Matrix) -> tuple[Limits, Callable[[], None]]:
        """Return bounds, and a function that fills them for values of the parameters, which it reads at each call."""
        if self._vary and self._traced is not None:
            bound = self._traced.bind(values, self._numbers)
            lower, upper = bound.outputs
            return (lower, upper), bound
        # Not as `at` has them: what stands in the values so far may be anything, which no range need be ready for.
        lower, upper = (bound[None].repeat(len(values), axis=0) for bound in (self._lower, self._upper))

        def fill() -> None:
            if self._vary:
                lower[:], upper[:] = self.at(values)

        return (lower, upper), fill

    @cached_property
    def _traced(self) -> Map | None:
        """Compile (values, canonical, and all given) -> lower and upper bounds, if the stated ranges can be traced."""
        chart = self.chart
        point, given = ca.SX.sym("point", len(chart.names)), ca.SX.sym("given", len(self._given))
        told = {name: given[i] for i, name in enumerate(self._given)}
        told |= {name: point[i] * float(chart.scale[i]) for i, name in enumerate(chart.names)}
        lower, upper = ca.SX(self._lower[None]), ca.SX(self._upper[None])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # of NumPy's functions CasADi warns, and has its own idea of them
                self._state(SimpleNamespace(**told), lower, upper, SYMBOLIC)
        except Exception:  # whatever a user's own function, which may use NumPy only, makes of symbols
            return None
        return compile_map(ca.Function("bounds", [point, given], [lower.T, upper.T]))

    def _state(self, p: Any, lower: Any, upper: Any, xp: Any = NUMERIC) -> None:
        """Fill in the bounds that parameters state, for one lane or all."""
        for k, condition in enumerate(self._ranged, self.chart.shooting.plan.free):
            size = self.chart.problem.size_of(condition)
            lower[:, k], upper[:, k] = (bound / size for bound in condition.limits(p))
        for i, low, high in self._ranges(p, xp):
            upper[:, i] = high
            if low is not None:
                lower[:, i] = low

    def _ranges(self, p: Any, xp: Any = NUMERIC) -> list[tuple[int, Any, Any]]:
        """Return bounds of free parameters that follow from given ones, canonical; None for an absent one."""
        if (problem := self.chart.problem).parameter_bounds is None:
            return []
        found = problem.parameter_bounds(p, xp)
        told = ((i, *found[name][:2], size, bounded) for i, name, size, bounded in self._chosen if name in found)
        return [(i, low / size if bounded else None, high / size) for i, low, high, size, bounded in told]

    def sides(self, sheets: Sequence[Sheet]) -> Matrix:
        """Return the side at which each branch holds each of what can be held, (branches, k); see `BoundStatus`."""
        found = np.zeros((len(sheets), self.chart.shooting.plan.held))
        for row, sheet in zip(found, sheets, strict=True):
            for name, side in sheet.holds.items():
                row[self.names.index(name)] = _SIDES[side == "upper"]
        return found

    def holds(self, sheets: Sequence[Sheet], which: NDArray[np.int64], values: Matrix) -> Holds:
        """Return the active bounds that each lane holds in addition to the parameters.

        Parameters
        ----------
        sheets, which
            The branches, and the number of each lane's, (lanes,).
        values
            Values of the parameters, canonical, (lanes, d).
        """
        sides = self.sides(sheets)[which]
        count = sides.shape[1]
        out = np.zeros((len(values), 2 * count))
        if not sides.any():
            return Holds(out)
        lower, upper = self.at(values)
        out[:, :count] = np.abs(sides)
        np.copyto(out[:, count:], lower, where=sides > 0.0)
        np.copyto(out[:, count:], upper, where=sides < 0.0)
        return Holds(out, self.moves(sides, values))

    def moving(self, sides: Matrix) -> NDArray[np.bool_]:
        """Return True for lanes that hold, at such sides, a bound that moves with the parameters."""
        found = np.zeros(len(sides), dtype=bool)
        for i, upper in self._moving:
            found |= sides[:, i] == _SIDES[upper]
        return found

    def moves(self, sides: Matrix, values: Matrix) -> NDArray[np.float64] | None:
        """Return derivatives by the parameters of bounds held at such sides, (lanes, d, k); None if constant.

        Parameters
        ----------
        sides
            Side of each bound that lanes hold, as `sides` has them, (lanes, k).
        values
            Values of the parameters, canonical, (lanes, d).
        """
        if not self.moving(sides).any():
            return None
        found = np.zeros((len(values), len(self.chart.names), sides.shape[1]))
        for i, upper in self._moving:
            if (here := np.nonzero(sides[:, i] == _SIDES[upper])[0]).size:
                found[here, :, i] = self._rates(values[here], i, upper)
        return found

    @cached_property
    def _moving(self) -> set[tuple[int, int]]:
        """Return (number, 1 for upper) of each bound of what can be held that moves with the varied parameters."""
        found = {
            (k, upper)
            for k, condition in enumerate(self._ranged, self.chart.shooting.plan.free)
            for upper, bound in enumerate((condition.lower, condition.upper)) if bound in self.chart.names
        }  # fmt: skip
        if not self._chosen:
            return found
        several = {n: np.full(2, self._given.get(n, 1.0)) for n in self.chart.names}
        try:  # what follows from arrays is one
            told = self._ranges(SimpleNamespace(**{**self._given, **several}))
        except (TypeError, ValueError, PeriluneError):
            return found | {(i, upper) for i, *_ in self._chosen for upper in (0, 1)}
        return found | {(i, upper) for i, *both in told for upper, bound in enumerate(both) if np.ndim(bound)}

    def _rates(self, values: Matrix, i: int, upper: int) -> Matrix:
        """Differentiate a bound by the parameters, (lanes, d), canonical: differences of fourth order."""
        d, step = values.shape[1], _DIFFERENCE * self.chart.widths
        beside = np.array([-2.0, -1.0, 1.0, 2.0])[:, None, None] * np.diag(step)  # (4, axes, d)
        bounds = self.at((values[:, None, None] + beside).reshape(-1, d))[upper][:, i].reshape(-1, 4, d)
        return np.einsum("k,lkd->ld", np.array([1.0, -8.0, 8.0, -1.0]) / 12.0, bounds) / step

    def missed(self, sheet: Sheet, values: Matrix, y: Matrix) -> NDArray[np.bool_]:
        """Return True where a cell's value of a free parameter that its branch holds misses its moving bound, (lanes,).

        The cell does not see a bound that moves away and back between its corners and its middle.

        Parameters
        ----------
        sheet
            The branch.
        values
            Values of the parameters, canonical, (lanes, d).
        y
            Unknowns as cells give them, canonical, (lanes, n).
        """
        found, free = np.zeros(len(values), dtype=bool), self.chart.shooting.plan.free
        held = [(self.names.index(name), int(side == "upper")) for name, side in sheet.holds.items()]
        if moving := [(i, upper) for i, upper in held if i < free and (i, upper) in self._moving]:
            given, limits = self.chart.whole(values, y)[:, self.chart.conditions.free_at], self.at(values)
            for i, upper in moving:
                found |= ~(np.abs(given[:, i] - limits[upper][:, i]) <= _MISSED * (1.0 + np.abs(given[:, i])))
        return found

    @cached_property
    def bounds(self) -> list[tuple[str, str]]:
        """Return (name, side) of the columns of `beyond`."""
        return [(name, side) for side in ("lower", "upper") for name in self.names]

    @cached_property
    def users(self) -> NDArray[np.bool_]:
        """Return a mask of what can be held that the user states; the bound of an arc's duration at zero is not."""
        user = self.chart.user
        stated = {*user.free_names, *(c.name for phase in user.phases for c in phase.end_conditions)}
        return np.array([name in stated for name in self.names], dtype=bool)

    @cached_property
    def of_arcs(self) -> bool:
        """Return True if anything that can be held is the duration of an arc."""
        return bool((np.isfinite(self._lower) & ~self.users).any())

    def backwards(self, values: Matrix, y: Matrix) -> NDArray[np.bool_]:
        """Return True for extremals, canonical, with a negative arc duration, whatever else they violate.

        Parameters
        ----------
        values
            Values of the parameters, canonical, (lanes, d).
        y
            Unknowns, canonical, (lanes, n).
        """
        if not self.of_arcs:
            return np.zeros(len(y), dtype=bool)
        free = self.chart.shooting.plan.free
        at, lower = self.chart.whole(values, y)[:, self.chart.conditions.free_at], self.at(values)[0][:, :free]
        with np.errstate(invalid="ignore"):
            return np.any((at < lower - SLACK) & ~self.users[:free], axis=1)

    def short(self, y: Matrix, at: Matrix, limits: Limits) -> NDArray[np.bool_]:
        """Return True for lanes that are answers but for a negative arc duration, judged by values only.

        Arguments as of `margins`; NaN in `at` is ignored.

        Parameters
        ----------
        y, at, limits
            As of `margins`; NaN in `at` is ignored.
        """
        if not self.of_arcs:
            return np.zeros(len(y), dtype=bool)
        return self._maps["short"](at, *limits, y[:, self.touched])[0][:, 0] > 0.0

    def beyond(self, at: Matrix, choice: Matrix, limits: Limits) -> NDArray[np.bool_]:
        """Return True for `bounds`, stated by the user and not held, that lanes lie beyond, (lanes, bounds).

        Parameters
        ----------
        at
            Values of what can be held, canonical, (lanes, k).
        choice
            What is held, (lanes, 2 k).
        limits
            Lower and upper bounds, canonical, (lanes, k) each.
        """
        return self._maps["beyond"](at, choice[:, : self.chart.shooting.plan.held], *limits)[0] > 0.0

    @cached_property
    def symbols(self) -> BoundStatus:
        """Return symbols for tracing one lane."""
        return BoundStatus.symbols(self.chart.shooting.plan.held, len(self.touched))

    @cached_property
    def _maps(self) -> dict[str, Map]:
        """Compile the verdicts of `BoundStatus` for lanes."""
        s = self.symbols
        asked = {
            "short": ([s.at, s.lower, s.upper, s.touched], s.short(self.users)),
            "beyond": ([s.at, s.held, s.lower, s.upper], s.beyond(self.users)),
            "margin": (list(s), s.margin),
        }
        return {name: compile_map(ca.Function(name, given, [ca.cse(found)])) for name, (given, found) in asked.items()}

    def crossed(self, sheets: Sequence[Sheet], which: NDArray[np.int64], found: Extremals) -> NDArray[np.bool_]:
        """Return True for user's `bounds` that lanes cross, (lanes, bounds): they lie beyond, or gain by leaving.

        Parameters
        ----------
        sheets, which
            The branches, and the number of each lane's, (lanes,).
        found
            The extremals.
        """
        at, rises = self.chart.shooting.held_values(found.roots)
        out = self.beyond(at, found.roots.choice, self.at(found.values))
        for number in set(which.tolist()):
            for name, side in sheets[number].holds.items():
                i, upper = self.names.index(name), side == "upper"
                if self.users[i]:
                    gains = (rises[:, i] if upper else -rises[:, i]) > SLACK
                    out[:, i + upper * len(self.names)] |= (which == number) & gains
        return out

    def margins_of(self, sheets: Sequence[Sheet], which: NDArray[np.int64], found: Extremals) -> Vector:
        """Return the `margins` of extremals, or of points that need not be extremals.

        Parameters
        ----------
        sheets, which
            All branches, and the number of each lane's, (lanes,).
        found
            Points with the residuals and derivatives of the extremals of the chart.

        Returns
        -------
        Vector
            Canonical, (lanes,).
        """
        at, rises = self.chart.shooting.held_values(found.roots)
        return self.margins(sheets, which, found.roots.y, at, rises, found.roots.choice, self.at(found.values))

    def margins(
        self,
        sheets: Sequence[Sheet],
        which: NDArray[np.int64],
        y: Matrix,
        at: Matrix,
        rises: Matrix,
        choice: Matrix,
        limits: Limits,
    ) -> Vector:
        """Evaluate `BoundStatus.margin` of each lane.

        Parameters
        ----------
        sheets, which
            All branches, and the number of each lane's.
        y, choice
            All unknowns, and what is held of them.
        at, rises
            Values of what can be held, and dJ/d(value), as `Shooting.held_values` has them.
        limits
            Bounds of these.
        """
        held, sides = choice[:, : self.chart.shooting.plan.held], self.sides(sheets)[which]
        return self._maps["margin"](at, rises, held, sides, *limits, y[:, self.touched])[0][:, 0]


def held_at(borders: Borders, values: Vector, y: Vector) -> dict[str, str]:
    """Return the free parameters and ranges that an extremal holds at a bound, each with its side.

    Parameters
    ----------
    borders
        The bounds of its chart.
    values, y
        Of the parameters, (d,), and its unknowns there, (n,), canonical.
    """
    chart, found = borders.chart, dict[str, str]()
    lower, upper = (bound[0] for bound in borders.at(values[None]))
    whole = chart.whole(values[None], y[None])[0]
    for i, at in enumerate(whole[chart.conditions.free_at].tolist()):
        for side, bound in (("lower", lower[i]), ("upper", upper[i])):
            if abs(at - bound) <= SLACK:
                found[borders.names[i]] = side
    for i, (_, nu) in enumerate(chart.conditions.ranges, chart.shooting.plan.free):
        if abs(whole[nu]) > SIGNED:  # J rises into its range by -nu
            found[borders.names[i]] = "lower" if whole[nu] < 0 else "upper"
    return found
