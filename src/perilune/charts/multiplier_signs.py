"""Signs of multipliers on re-integrated boundary arcs: leaving such an arc must not lower J.

Along an arc of order q the control minimises L = H - eta S^(q) among all that are admissible, and S >= 0 itself has the
multiplier

    mu = (-1)^q d^q eta/dt^q >= 0.

The costates of S itself are those of the canonical equations - eta dS/dx at q = 1, - eta dS'/dx + eta' dS/dx at q = 2.
Where an arc begins or ends they may fall only by nu dS/dx with nu <= 0, and by multiples of the end conditions' slopes
at the end of a user's phase, or at the start of the flight by all that no free parameter moves. Here eta is an
expression of state and costate, and so are its derivatives along the flight; `perilune.proof.sufficient.boundary_arcs`
takes them from tables.

Source: Bryson and Ho (1975), section 3.11; Hartl, Sethi, Vickson (1995), sections 4 and 5.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from perilune.charts.chart import Chart
from perilune.conditions import OptimalityConditions, PhaseExtremal, minimising_control_at, select_by_mode
from perilune.problem import (
    SYMBOLIC,
    Expression,
    Parameters,
    Problem,
    Unnumbered,
    column,
    elements,
    trace_at_end,
    trace_parameters,
)
from perilune.structures import Condition, conditions_of, part_name

NOTHING = 1e-7  # of 1 + |eta|: a multiplier so little below zero is rounding
_VANISHES = 1e-9  # of a slope: what end conditions leave of it is nothing


@dataclass(frozen=True, kw_only=True)
class BoundaryArcCondition:
    """Condition on a boundary arc along a phase of the restated problem.

    Parameters
    ----------
    name
        Of the condition.
    row
        Its place among what the phase holds.
    rates
        S, ..., S^(q - 1).
    entered
        Names of the multipliers of S = 0, ..., S^(q - 1) = 0 where it is entered inside one of the user's phases.
    """

    name: str
    row: int
    rates: tuple[Expression, ...]
    entered: tuple[str, ...]

    @property
    def order(self) -> int:
        """Return the order: the number of derivatives until a control appears."""
        return len(self.rates)


class ChartBoundaryArcs:
    """Boundary arcs of the extremals of a chart.

    Parameters
    ----------
    chart
        The chart.
    """

    def __init__(self, chart: Chart) -> None:
        self.chart: Chart = chart
        self.conditions: OptimalityConditions = chart.conditions
        structure = chart.course.structure
        self._arcs = (
            () if structure is None else tuple((k, arc) for k, arcs in enumerate(structure.phases) for arc in arcs)
        )
        self.boundary_arcs: tuple[tuple[BoundaryArcCondition, ...], ...] = tuple(
            tuple(self._of(part)) for part in range(len(self.conditions.phases))
        )

    @cached_property
    def user(self) -> Problem:
        """Return the user's problem with the parameters of the chart free, as it is traced."""
        return Unnumbered(self.chart.user_free).problem

    @cached_property
    def stated(self) -> Problem:
        """Return the problem of the chart, as it is traced."""
        return Unnumbered(self.chart.free).problem

    @cached_property
    def _sums(self) -> dict[str, tuple[str, ...]]:
        """Return the user's durations that are sums of the durations of parts."""
        structure = self.chart.course.structure
        return {} if structure is None else structure.sums(self.user)

    @property
    def _begins(self) -> set[int]:
        """Return the numbers of the parts with which the user's phases begin."""
        return {i for i, (k, _) in enumerate(self._arcs) if i == 0 or self._arcs[i - 1][0] != k}

    def _of(self, part: int) -> Iterator[BoundaryArcCondition]:
        if not self._arcs or not self._arcs[part][1].along:
            return
        k, arc = self._arcs[part]
        structure = self.chart.course.structure
        assert structure is not None, "it has arcs"
        held = [c.name for c in self.stated.phases[part].held_conditions]
        first = min(i for i, (user, _) in enumerate(self._arcs) if user == k)
        for name, condition in self._conditions(part, arc.along).items():
            q, entered = condition.order, tuple[str, ...]()
            if part > first and name not in self._arcs[part - 1][1].along:
                before = part_name(self.user.phases[k].name, part - 1 - first, len(structure.phases[k]))
                entered = tuple(f"{before}.nu_{condition.rated(i, 'enter_', 1.0).name}" for i in range(q))
            yield BoundaryArcCondition(
                name=name,
                row=held.index(condition.rated(q, "", 1.0).name),
                rates=condition.values[:-1],
                entered=entered,
            )

    def singular(self, part: int) -> bool:
        """Return True if a control is singular along a part."""
        return bool(self._arcs) and any(regime == "singular" for _, regime in self._arcs[part][1].regimes)

    # -- along an arc -------------------------------------------------------------------------------------------------

    def arc_multipliers(self, part: int, mode: int, z: ca.SX, numbers: ca.SX) -> list[ca.SX]:
        """Return the multiplier mu of the condition of each boundary arc, over 1 + |eta|.

        Parameters
        ----------
        part, mode
            Numbers of the phase, and of its mode between two switches.
        z, numbers
            State and costate, and numbers of the canonical equations, canonical.
        """
        extremal, found = self.conditions.phases[part], list[ca.SX]()
        for ride in self.boundary_arcs[part]:
            rates = self._eta(extremal, ride, mode, z, numbers)
            found.append((-1) ** ride.order * rates[ride.order] / (1 + ca.fabs(rates[0])))
        return found

    def multipliers(self, part: int, mode: int, z: ca.SX, numbers: ca.SX) -> ca.SX:
        """Return eta of all conditions that a phase holds; zero for those that the user states as held.

        Parameters
        ----------
        part, mode
            Numbers of the phase, and of its mode between two switches.
        z, numbers
            State and costate, and numbers of the canonical equations, canonical.
        """
        extremal, rows = self.conditions.phases[part], [ride.row for ride in self.boundary_arcs[part]]
        found = ca.SX.zeros(len(self.stated.phases[part].held_conditions), 1)
        if rows:
            found[rows] = extremal.multipliers[mode](z, numbers)[rows]
        return found

    def held_places(self, part: int) -> list[int]:
        """Return the places of the user's held conditions among all that a phase holds."""
        ridden = {ride.row for ride in self.boundary_arcs[part]}
        return [i for i in range(len(self.stated.phases[part].held_conditions)) if i not in ridden]

    def _eta(
        self, extremal: PhaseExtremal, ride: BoundaryArcCondition, mode: int, z: ca.SX, numbers: ca.SX
    ) -> list[ca.SX]:
        """Return eta and its first q derivatives along the flight."""
        symbol = ca.SX.sym("z", z.numel())
        found, rate = [extremal.multipliers[mode](symbol, numbers)[ride.row]], extremal.modes[mode](symbol, numbers)
        for _ in range(ride.order):
            found.append(ca.jtimes(found[-1], symbol, rate))
        return [ca.substitute(each, symbol, z) for each in found]

    # -- where a boundary arc begins and ends --------------------------------------------------------------------------

    def turns(self, y: ca.SX, begins: Sequence[ca.SX], ends: Sequence[ca.SX], p: ca.SX) -> ca.SX:
        """Return terms that are not negative if S is not, just before and behind a boundary arc or contact point.

        There S is as its first derivative with a control in it, of order q, times (t - t0)^q. Arguments as of `jumps`.

        Parameters
        ----------
        y, begins, ends, p
            As of `jumps`.
        """
        found = list[ca.SX]()
        for joint in (j for j in range(1, len(self._arcs)) if j not in self._begins):
            before, after = (self._arcs[part][1] for part in (joint - 1, joint))
            met = {*before.touches, *(name for name in after.along if name not in before.along)}
            left = {*before.touches, *(name for name in before.along if name not in after.along)}
            for part, names, z in ((joint - 1, met, ends[joint - 1]), (joint, left, begins[joint])):
                way = -1 if part < joint else 1
                for condition in self._conditions(part, tuple(names)).values():
                    found.append(way**condition.order * self._rate(part, condition.values[-1], z, y, p))
        return ca.vertcat(ca.SX(0, 1), *found)

    def _conditions(self, part: int, names: Sequence[str]) -> dict[str, Condition]:
        """Return conditions of the user's phase of a part, with the sums of durations that the chart has."""
        known = conditions_of(self.user, self._arcs[part][0], names)
        return {name: condition.with_sums(self._sums) for name, condition in known.items()}

    def _rate(self, part: int, rate: Expression, z: ca.SX, y: ca.SX, p: ca.SX) -> ca.SX:
        """Evaluate a rate with a control in it, where an arc begins or ends."""
        phase, known = self.stated.phases[part], trace_parameters(self.stated)
        x, u = ca.SX.sym("x", len(phase.states)), ca.SX.sym("u", len(phase.control_names))
        records = phase.state_record(*elements(x)), phase.control_record(*elements(u))
        value = rate(*records, known.record, SYMBOLIC)[0]
        at = [z[: x.numel()], minimising_control_at(self.conditions.phases[part], z, p)]
        return self._at([x, u], at, known, [ca.SX(value)], y, p)[0]

    def jumps(self, y: ca.SX, begins: Sequence[ca.SX], ends: Sequence[ca.SX], p: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the least -nu of all jumps, each over 1 + its size, and the parts of jumps outside the slopes.

        Parameters
        ----------
        y, p
            Unknowns and numbers.
        begins, ends
            z at the start and at the end of each phase.
        """
        least, aside = list[ca.SX](), list[ca.SX]()
        for joint in range(len(ends) + 1):
            before = self.boundary_arcs[joint - 1] if joint else ()
            after = self.boundary_arcs[joint] if joint < len(ends) else ()
            if before or after:
                nu, left = self._jump(joint, y, begins, ends, p)
                least += [-ca.mmax(nu / (1 + ca.fabs(nu)))] if nu.numel() else []
                aside.append(ca.norm_inf(left))
        return (ca.mmin(ca.vertcat(*least)) if least else ca.SX(np.inf)), ca.mmax(ca.vertcat(ca.SX(0.0), *aside))

    def _jump(
        self, joint: int, y: ca.SX, begins: Sequence[ca.SX], ends: Sequence[ca.SX], p: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        """Return the nu of boundary arcs on either side of a joint, and the part of the jump not explained by them."""
        first, last = joint == 0, joint == len(ends)
        x_of = [(begins[0] if first else ends[joint - 1])[: len(self.stated.phases[max(joint - 1, 0)].states)]]
        if not first and not last:
            x_of.append(begins[joint][: len(self.stated.phases[joint].states)])
        n, inner = x_of[0].numel(), not (first or last or joint in self._begins)
        fall, cones = ca.SX.zeros(n, 1), dict[str, ca.SX]()
        if not first:
            for ride in self.boundary_arcs[joint - 1]:
                slopes = self._slopes(joint - 1, ride, x_of[0], y, p)
                fall += self._own_costate_terms(joint - 1, ride, slopes, ends[joint - 1], p)
                cones[ride.name] = slopes[0]
        if not last:
            back = ca.SX.eye(n) if first or inner else self._back(joint, x_of[0], y, p)
            for ride in self.boundary_arcs[joint]:
                slopes = [ca.mtimes(back.T, s) for s in self._slopes(joint, ride, x_of[-1], y, p)]
                fall -= self._own_costate_terms(joint, ride, slopes, begins[joint], p)
                for name, slope in zip(ride.entered, slopes, strict=False):
                    fall += y[[known for known, _ in self.conditions.unknowns].index(name)] * slope
                if not inner or ride.name not in cones:
                    cones[f"{ride.name} behind" if ride.name in cones else ride.name] = slopes[0]
        share = ca.SX.eye(n) if inner else self._unexplained(joint, x_of[0], y, p)
        columns = [ca.mtimes(share, cone) for cone in cones.values()]
        columns = _independent_columns(
            [c for c, whole in zip(columns, cones.values(), strict=True) if not _is_zero_column(c, whole)]
        )
        fall = ca.mtimes(share, fall)
        if not columns:
            return ca.SX(0, 1), fall
        C = ca.horzcat(*columns)
        nu = ca.solve(ca.mtimes(C.T, C), ca.mtimes(C.T, fall))
        return nu, fall - ca.mtimes(C, nu)

    def _own_costate_terms(
        self, part: int, ride: BoundaryArcCondition, slopes: Sequence[ca.SX], z: ca.SX, p: ca.SX
    ) -> ca.SX:
        """Return the terms of the costates of S itself in addition to the others."""
        extremal = self.conditions.phases[part]
        each = [self._eta(extremal, ride, mode, z, p) for mode in range(len(extremal.modes))]
        number = extremal.mode(z, p) if len(each) > 1 else ca.SX(0)
        rates = [select_by_mode([rates[i] for rates in each], number) for i in range(ride.order)]
        return -rates[0] * slopes[0] if ride.order == 1 else rates[1] * slopes[0] - rates[0] * slopes[1]

    def _slopes(self, part: int, ride: BoundaryArcCondition, at: ca.SX, y: ca.SX, p: ca.SX) -> list[ca.SX]:
        """Return d(S^(i))/dx, i < q, in columns."""
        phase, known = self.stated.phases[part], trace_parameters(self.stated)
        x = ca.SX.sym("x", len(phase.states))
        u = phase.control_record(*([ca.SX(0.0)] * len(phase.control_names)))
        S = [ca.SX(value(phase.state_record(*elements(x)), u, known.record, SYMBOLIC)[0]) for value in ride.rates]
        return self._at([x], [at], known, [ca.gradient(value, x) for value in S], y, p)

    def _back(self, joint: int, at: ca.SX, y: ca.SX, p: ca.SX) -> ca.SX:
        """Return the Jacobian of the states behind a joint between the user's phases by those before it."""
        phase, known = self.stated.phases[joint - 1], trace_parameters(self.stated)
        x = ca.SX.sym("x", len(phase.states))
        behind = column(self.stated.links[joint - 1](phase.state_record(*elements(x)), known.record, SYMBOLIC))
        return self._at([x], [at], known, [ca.jacobian(behind, x)], y, p)[0]

    def _unexplained(self, joint: int, at: ca.SX, y: ca.SX, p: ca.SX) -> ca.SX:
        """Return the projection that removes the part of a costate jump that the user's conditions explain."""
        if joint == 0:  # only what a free parameter moves at the start has to be satisfied
            known = trace_parameters(self.stated)
            own = [known.free[i] for i, name in enumerate(self.stated.free_names) if name not in self.chart.names]
            start = column(self.stated.start(known.record, SYMBOLIC))
            moved = ca.jacobian(start, ca.vertcat(ca.SX(0, 1), *own))
            moved = moved[:, [j for j in range(moved.size2()) if not moved[:, j].is_zero()]]
            return _projection_onto(self._at([], [], known, [ca.densify(moved)], y, p)[0])
        k = self._arcs[joint - 1][0]
        phase, known = self.user.phases[k], trace_parameters(self.user)
        x = ca.SX.sym("x", len(phase.states))
        psi = trace_at_end(phase, x, known.record)
        stated = [i for i, c in enumerate(phase.end_conditions) if not c.ranged]
        slopes = ca.jacobian(psi[stated], x).T
        slopes = slopes[:, [j for j in range(slopes.size2()) if not slopes[:, j].is_zero()]]
        free = self._users_free(y)
        given = self._given_and_free(y, p)[0]
        names = list(self.stated.given)
        own = given[[names.index(name) for name in self.user.given]]
        slopes = ca.Function("psi", [x, known.given, known.free], [ca.densify(slopes)])(at, own, free)
        return ca.SX.eye(at.numel()) - _projection_onto(slopes)

    def _at(
        self,
        symbols: Sequence[ca.SX],
        values: Sequence[ca.SX],
        known: Parameters,
        expressions: Sequence[ca.SX],
        y: ca.SX,
        p: ca.SX,
    ) -> list[ca.SX]:
        """Evaluate expressions in symbols and the parameters of the chart's problem."""
        traced = ca.Function("at", [*symbols, known.given, known.free], list(expressions))
        return list(traced.call([*values, *self._given_and_free(y, p)]))

    def _given_and_free(self, y: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the given numbers and the free parameters of the problem of the chart."""
        return p[: len(self.stated.given)], y[self.conditions.free_at]

    def _users_free(self, y: ca.SX) -> ca.SX:
        """Return the free parameters of the user's problem; a duration is the sum of its parts."""
        names, free, sums = self.stated.free_names, y[self.conditions.free_at], self._sums
        own = [sum((free[names.index(part)] for part in sums.get(n, (n,))), ca.SX(0.0)) for n in self.user.free_names]
        return ca.vertcat(ca.SX(0, 1), *own)


def _projection_onto(columns: ca.SX) -> ca.SX:
    """Return the projection onto the space that columns span."""
    if not columns.size2():
        return ca.SX.zeros(columns.size1(), columns.size1())
    return ca.mtimes(columns, ca.solve(ca.mtimes(columns.T, columns), columns.T))


def _independent_columns(columns: Sequence[ca.SX]) -> list[ca.SX]:
    """Return the columns parallel to no earlier one, as those of one condition on both sides of a user's joint are."""
    found = list[ca.SX]()
    for one in columns:
        way = one / ca.norm_2(one)
        if not any(_is_zero_column(way - other / ca.norm_2(other), way) for other in found):
            found.append(one)
    return found


def _is_zero_column(part: ca.SX, whole: ca.SX) -> bool:
    """Return True if a column is zero relative to another for any values of its symbols, judged at a few points."""
    symbols = ca.symvar(ca.vertcat(part, whole))
    evaluate = ca.Function("left", [ca.vertcat(ca.SX(0, 1), *symbols)], [ca.norm_2(part), ca.norm_2(whole)])
    rng, shares = np.random.default_rng(0), list[float]()
    for _ in range(30):
        left, size = (float(value) for value in evaluate(rng.uniform(0.5, 1.5, len(symbols))))
        if np.isfinite(left) and size > 0:
            shares.append(left / size)
    return not shares or max(shares) <= _VANISHES
