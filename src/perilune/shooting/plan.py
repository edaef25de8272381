"""Flight plan of a boundary value problem: the legs that are integrated, and the algebra between them.

A *leg* is one arc: a phase, or in multiple shooting a segment of one, whose start is then an unknown and whose gap to
the leg before is a residual. The *opening* of a leg gives its start from the unknowns and the end of the leg before,
with the derivative by the unknowns that can move it, by sparsity; the *closing* turns the ends of all legs into the
residual and Newton's step. A change of the unknowns moves the end of a leg by

    dz(T) = S(T) dz(0) + z'(T) dT,

which goes through the link into the seeds of the next leg, or into the residual's derivative. Where fewer entries of
z(0) move than unknowns move them, the columns flown of a phase that settles are those of z(0) itself, and S(T) dz(0) is
their product.

Free parameters and end conditions that are ranges may be *held*, each lane of a batch having its own choice: the
row is  mask (value - held value) + (1 - mask) row,  with mask and held value among the parameters of the closing.

Unknowns and rows of costates that vanish on every extremal (`OptimalityConditions.silent_rows`) are left out. The legs
of a phase that settles (`perilune.shooting.contracting_phases`) have states only, and its transversality condition is
imposed at its start: lambda(0) - Phi(T)^T mu, with mu what its end makes of lambda(T), and Phi the product of those of
its legs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.conditions import OptimalityConditions
from perilune.core import Matrix, Vector
from perilune.kernels import LANES, Engine, Request
from perilune.shooting.contracting_phases import MOST_STEPS, settling_equations
from perilune.shooting.newton import Columns
from perilune.shooting.propagate import Equations, arc_engine, reduced_equations

#: Up to so many coupled unknowns Newton's step is compiled with the residual; beyond, LAPACK takes over.
COMPILED = 12


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanLeg:
    """One arc of the plan.

    Parameters
    ----------
    equations, arcs
        The equations, and the engine that integrates them with their columns.
    opening
        (parts of Y, p) or (Y, p, end of the leg before) -> z0, duration, mode, slopes of z0, and the numbers among p
        that the arc knows. An end is z, rate and columns; behind them come the slopes of a leg with `seeds`.
    parts
        Of Y: all of it, or a later segment's start and the free parameters, so that one opening serves all of a phase.
    follows
        Whether the opening takes the end of the leg before.
    seeds
        S(0) of an arc whose columns are those of its start, where fewer entries of it move than unknowns move them;
        None where the slopes of z0 by these unknowns are its seeds themselves.
    most_steps
        After which the arc counts as lost.
    """

    equations: Equations
    arcs: Engine
    opening: ca.Function
    parts: tuple[slice, ...]
    follows: bool
    seeds: Matrix | None
    most_steps: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Legs and closing of `conditions` with a number of `segments` for each phase.

    Attributes
    ----------
    at_free
        Where the free parameters begin among the unknowns that Newton moves.
    size, active
        Length of the whole vector of unknowns (y, then the states at the joints), and which of them Newton moves.
    rows
        Which rows of the whole residual are left, in the order of the closing's.
    closing
        (Y, choice, p, inverse, then z, rate and columns of each leg) -> the results of `columns`, where `compiled`;
        otherwise without `inverse` -> residual, Jacobian, and what follows the inverse in `columns`.
    columns
        Where the closing's results lie; after Newton's own dJ/dq of each free parameter, the value of each range,
        and J.
    free, held
        Free parameters, and how many things can be held: these, then ranges.
    """

    conditions: OptimalityConditions
    segments: int
    legs: tuple[PlanLeg, ...]
    at_free: int
    size: int
    active: NDArray[np.int64]
    rows: NDArray[np.int64]
    closing: ca.Function
    columns: Columns
    compiled: bool
    free: int
    held: int

    @cached_property
    def moved(self) -> NDArray[np.bool_]:
        """Return True for those of the whole vector of unknowns that Newton moves, (1, size)."""
        return np.isin(np.arange(self.size), self.active)[None]

    @cached_property
    def held_rows(self) -> NDArray[np.int64]:
        """Rows of what can be held, free parameters and then ranges, among those that are left."""
        c = self.conditions
        free = range(c.stationarity_at.start, c.stationarity_at.stop)
        return self.rows.searchsorted([*free, *(row for row, _ in c.ranges)])

    @property
    def settles(self) -> bool:
        """Return True if any phase settles."""
        return any(phase.settles for phase in self.conditions.phases)

    def hold(self, choice: Vector | Matrix, index: int, value: float | Vector) -> None:
        """Add a held value to a choice, or to each of many: its mask, and the value after all masks.

        Parameters
        ----------
        choice
            Active set, shape (2 k,), or (lanes, 2 k) for many; changed in place.
        index
            Index of the free parameter, or `free` plus the index of the range.
        value
            Value to hold, canonical, one or shape (lanes,).
        """
        choice[..., index], choice[..., self.held + index] = 1.0, value


def plan(conditions: OptimalityConditions, segments: int, most: int | None = None) -> Plan:
    """Derive the plan; its step is compiled for up to `most` coupled unknowns, by default `COMPILED`.

    Parameters
    ----------
    conditions
        The boundary value problem.
    segments
        Arcs of each phase in multiple shooting; 1 for single shooting.
    most
        Most coupled unknowns for which the step is compiled.
    """
    return _Tracing(conditions, segments, COMPILED if most is None else most).plan()


@dataclass(frozen=True, kw_only=True, eq=False)
class _End:
    """Symbols of a leg's end, and its derivatives; those of the integrated vector, another z for a phase that settles.

    Attributes
    ----------
    symbols
        z, rate and columns; the slopes of the start where the columns are those of it.
    slopes
        Factors whose product is dz/dY but for the duration's part, and that of the duration.
    moving
        Unknowns that the first product is for.
    """

    symbols: list[ca.SX]
    slopes: list[ca.SX]
    duration: ca.SX
    moving: list[int]

    @property
    def z(self) -> ca.SX:
        return self.symbols[0]

    def change(self, of: ca.SX) -> ca.SX:
        """Return d(of)/dY through z; from the left, as the conditions on an end are fewer than its rows."""
        by = ca.SX(of.numel(), self.z.numel())
        rows = sorted({*ca.jacobian_sparsity(of, self.z).get_triplet()[0]})
        by[rows, :] = ca.jacobian(of[rows], self.z)  # the same as of all rows, which would trace all of them each time
        change = ca.SX(by.size1(), self.duration.size2())
        product = by
        for factor in self.slopes:
            product = ca.mtimes(product, factor)
        change[:, self.moving] = product
        return ca.sparsify(change) + ca.mtimes(ca.sparsify(ca.mtimes(by, self.symbols[1])), self.duration)


class _Tracing:
    """Traces the legs in order of flight."""

    def __init__(self, conditions: OptimalityConditions, segments: int, most: int) -> None:
        self.conditions, self.segments, self.most = conditions, segments, most
        self.settling = [settling_equations(phase) if phase.settles else None for phase in conditions.phases]
        parts = zip(conditions.phases, conditions.needed, conditions.silent, self.settling, strict=True)
        self.equations = [
            s.equations if s else reduced_equations(phase, needed, silent) for phase, needed, silent, s in parts
        ]
        count, silent = len(conditions.unknowns), {unknown for _, unknown in conditions.silent_rows}
        active, size = [i for i in range(count) if i not in silent], count
        self.nodes: dict[tuple[int, int], list[int]] = {}  # where the start of a later segment lies in the whole Y
        for k, (phase, flown) in enumerate(zip(conditions.phases, self.equations, strict=True)):
            for j in range(1, segments):
                self.nodes[k, j] = [size + i for i in flown.kept.tolist()]
                active += self.nodes[k, j]
                size += 2 * phase.half
        self.size, self.active = size, active
        self.later: dict[int, ca.Function] = {}  # the opening of all segments of a phase but the first
        self.Y, self.whole = ca.SX.sym("Y", len(active)), ca.SX.zeros(size, 1)
        self.whole[active] = self.Y
        self.y = self.whole[:count]
        self.p = ca.SX.sym("p", conditions.residual.size1_in(2))

    def plan(self) -> Plan:
        """Trace legs and closing."""
        legs, ends, gaps = [], [], []
        before: _End | None = None
        for k in range(len(self.equations)):
            for j in range(self.segments):
                leg, end = self._leg(k, j, before)
                if j and before is not None:
                    node = self.whole[self.nodes[k, j]]
                    count = node.numel()
                    gaps.append((before.z[:count] - node, before.change(before.z[:count]) - ca.jacobian(node, self.Y)))
                legs.append(leg)
                ends.append(end)
                before = end
        closing, columns, compiled = self._closing(ends, gaps)
        c = self.conditions
        count, silent = len(c.residuals), {row for row, _ in c.silent_rows}
        rows = [i for i in range(count) if i not in silent] + [i for at in self.nodes.values() for i in at]
        return Plan(
            conditions=c,
            segments=self.segments,
            legs=tuple(legs),
            at_free=self.active.index(c.free_at.start) if c.free_at.stop > c.free_at.start else 0,
            size=self.size,
            active=np.array(self.active),
            rows=np.array(rows),
            closing=closing,
            columns=columns,
            compiled=compiled,
            free=c.free_at.stop - c.free_at.start,
            held=c.free_at.stop - c.free_at.start + len(c.ranges),
        )

    def _leg(self, k: int, j: int, before: _End | None) -> tuple[PlanLeg, _End]:
        extremal, flown = self.conditions.phases[k], self.equations[k]
        kept = flown.kept.tolist()
        whole_before = ca.SX.zeros(2 * self.conditions.phases[k - 1].half, 1) if k else ca.SX(0, 1)
        if before is not None and k and not j:  # a later segment begins at an unknown of its own
            whole_before = self._whole(k - 1, before)
        z0, duration = self.conditions.starts[k](self.y, whole_before, self.p)
        if j:
            z0 = ca.SX.zeros(*z0.shape)
            z0[kept] = self.whole[self.nodes[k, j]]
        start, duration = z0[kept], duration / self.segments
        settles = self.settling[k]
        start = settles.start(start) if settles else start
        slope = ca.jacobian(start, self.Y)
        follows = before is not None and k > 0 and j == 0
        if follows and before is not None:
            slope += before.change(start)
        slope = ca.sparsify(slope)
        moved, moving = (sorted(set(places)) for places in slope.sparsity().get_triplet())
        # Elsewhere not: where conditions are redundant, a product of rounded factors has another rank.
        by_start = settles is not None and len(moved) < len(moving)
        slopes = ca.densify(slope[moved, moving]) if by_start else slope[:, moving]
        parts = self._parts(k, j)
        opening = self.later.get(k) if j else None
        if opening is None:
            symbols = [*(self.Y[part] for part in parts), self.p, *(before.symbols if follows and before else [])]
            known = self.p[flown.numbers.tolist()]
            results = [ca.densify(start), duration, extremal.mode(z0, self.p), ca.densify(slopes), known]
            opening = ca.Function("opening", symbols, ca.cse([ca.SX(r) for r in results]))
        if j:
            self.later[k] = opening
        seeds = np.eye(start.numel())[:, moved]
        pattern = np.array(seeds if by_start else ca.DM.ones(slopes.sparsity()).full(), dtype=bool)
        count = pattern.shape[1]
        shared = settles is not None and count > 1  # each of the lanes that fly together takes a share of the columns
        if shared:
            pattern = np.repeat(pattern.max(axis=1, keepdims=True), -(-count // LANES), axis=1)
        arcs = arc_engine(flown, tuple(tuple(row) for row in pattern.tolist()))
        leg = PlanLeg(
            equations=flown,
            arcs=arcs,
            opening=opening,
            parts=parts,
            follows=follows,
            seeds=seeds if by_start else None,
            most_steps=MOST_STEPS if settles else Request.max_steps,
        )
        slopes = ca.SX.sym("D", len(moved), len(moving)) if by_start else None
        changed = arcs.system.pattern
        if shared:
            changed = ca.horzcat(*[ca.DM(changed, 1.0)[:, 0]] * count).sparsity()
        return leg, self._end(moving, changed, duration, slopes)

    def _parts(self, k: int, j: int) -> tuple[slice, ...]:
        """Return where the opening reads Y: everywhere, or at a later segment's start and the free parameters."""
        free = self.conditions.free_at
        read = [self.nodes[k, j], range(free.start, free.stop)] if j else [self.active]
        return tuple(slice(i := self.active.index(at[0]), i + len(at)) for at in read if len(at))

    def _end(self, moving: list[int], pattern: ca.Sparsity, duration: ca.SX, slopes: ca.SX | None) -> _End:
        size, width = pattern.shape
        z, rate, columns = (
            ca.SX.sym(name, count) for name, count in (("z", size), ("rate", size), ("S", size * width))
        )
        factors = [ca.project(ca.reshape(columns, width, size).T, pattern), *([] if slopes is None else [slopes])]
        symbols = [z, rate, columns, *([] if slopes is None else [ca.vec(slopes.T)])]
        return _End(symbols=symbols, slopes=factors, duration=ca.sparsify(ca.jacobian(duration, self.Y)), moving=moving)

    def _whole(self, k: int, end: _End) -> ca.SX:
        """Return all of z at the end of phase k: zero where it is not flown."""
        z, kept = ca.SX.zeros(2 * self.conditions.phases[k].half, 1), self.equations[k].kept.tolist()
        z[kept] = end.z[: len(kept)]
        return z

    def _residual(self, ends: list[_End]) -> tuple[ca.SX, ca.SX]:
        """Return the residual of the ends of all legs, and J."""
        c, last = self.conditions, ends[self.segments - 1 :: self.segments]
        whole = [self._whole(k, end) for k, end in enumerate(last)]
        plain, cost = c.residual(self.y, ca.vertcat(*whole), self.p)
        if not any(self.settling):
            return plain, cost
        met = ca.SX(plain)
        for k, (settles, at) in enumerate(zip(self.settling, c.costate_at, strict=True)):
            if settles:  # where lambda(T) is left out, its row is the value that the end gives it, up to the sign
                rows = slice(c.transversality_at + at.start, c.transversality_at + at.stop)
                whole[k][c.phases[k].half :] = -plain[rows]
                back = plain[rows]
                for end in reversed(ends[k * self.segments : (k + 1) * self.segments]):
                    back = ca.mtimes(settles.transition(end.z).T, back)
                met[rows] = self.y[at] + back
        met[c.stationarity_at] = c.residual(self.y, ca.vertcat(*whole), self.p)[0][c.stationarity_at]
        return met, cost

    def _closing(self, ends: list[_End], gaps: list[tuple[ca.SX, ca.SX]]) -> tuple[ca.Function, Columns, bool]:
        c, Y, n = self.conditions, self.Y, len(self.active)
        plain, cost = self._residual(ends)
        free = list(range(c.free_at.start, c.free_at.stop))
        masks, values = (ca.SX.sym(name, len(free) + len(c.ranges)) for name in ("mask", "value"))
        held = [(c.stationarity_at.start + i, self.y[at]) for i, at in enumerate(free)]
        residual = ca.SX(plain)
        for i, (row, value) in enumerate(held):
            residual[row] = masks[i] * (value - values[i]) + (1 - masks[i]) * plain[row]
        for i, (row, nu) in enumerate(c.ranges, start=len(free)):
            residual[row] = masks[i] * (plain[row] - values[i]) + (1 - masks[i]) * self.y[nu]
        silent = {row for row, _ in c.silent_rows}
        residual = ca.simplify(residual[[i for i in range(residual.numel()) if i not in silent]])
        slope = ca.jacobian(residual, Y)
        for end in ends:
            slope += end.change(residual)
        h = ca.densify(ca.vertcat(residual, *(gap for gap, _ in gaps)))
        J = ca.sparsify(ca.vertcat(slope, *(gap_slope for _, gap_slope in gaps)))
        extra = ca.vertcat(plain[c.stationarity_at], plain[[row for row, _ in c.ranges]], cost)
        columns = Columns(n=n, extra=extra.numel())
        order = _decoupled_unknowns(J)
        compiled = n - len(order) <= self.most
        arguments = [Y, ca.vertcat(masks, values), self.p]
        flights = [s for end in ends for s in end.symbols]
        if not compiled:
            results = ca.densify(ca.vertcat(h, ca.vec(ca.densify(J).T), extra))
            return ca.Function("closing", [*arguments, *flights], [ca.cse(results)]), columns, False
        old = ca.SX.sym("inverse", n * n)
        inverse = _invert_symbolically(J, order)
        step = -ca.mtimes(inverse, h)
        simplified = ca.mtimes(ca.reshape(old, n, n).T, h)
        size = ca.fabs(h[0])
        for i in range(1, n):
            size = ca.fmax(size, ca.fabs(h[i]))
        head = ca.vertcat(size, *(ca.sqrt(ca.sumsqr(v)) for v in (simplified, step, Y)))
        results = ca.vertcat(head, h, step, ca.vec(ca.densify(inverse).T), extra)
        closing = ca.Function("closing", [*arguments, old, *flights], [ca.cse(ca.densify(results))])
        return closing, columns, True


def _decoupled_unknowns(J: ca.SX) -> list[tuple[int, int]]:
    """Return (row, column) of unknowns in only one row, then of those that are so once these are gone, and so on."""
    pattern = np.array(ca.DM.ones(J.sparsity()).full(), dtype=bool)
    rows, found = np.ones(len(pattern), dtype=bool), []
    left = set(range(pattern.shape[1]))
    while alone := [c for c in sorted(left) if pattern[rows, c].sum() == 1]:
        row = int(np.nonzero(pattern[:, alone[0]] & rows)[0][0])
        found.append((row, alone[0]))
        rows[row] = False
        left.discard(alone[0])
    return found


def _invert_symbolically(J: ca.SX, peeled: list[tuple[int, int]]) -> ca.SX:
    """Return J^-1: of the coupled core by an orthogonal factorisation, then row by row of what was peeled off it."""
    n = J.size1()
    rows = [i for i in range(n) if i not in {row for row, _ in peeled}]
    known = [i for i in range(n) if i not in {column for _, column in peeled}]
    inverse, unit = ca.SX(n, n), ca.SX.eye(n)
    if rows:
        inverse[known, rows] = ca.inv(ca.densify(J[rows, known]))
    for row, column in reversed(peeled):
        rest = ca.sparsify(ca.mtimes(J[row, known], inverse[known, :])) if known else ca.SX(1, n)
        inverse[column, :] = (unit[row, :] - rest) / J[row, column]
        known.append(column)
    return ca.sparsify(inverse)
