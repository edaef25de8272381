"""The shooting function of a boundary value problem and its Jacobian by the state-transition matrix.

Entries of z on which no condition depends are not flown; a costate that vanishes on every extremal has the condition
that it vanishes in place of its flight.

Single shooting as in Cho et al. 2015 (20)-(24): fly every phase from its start, evaluate the residual at the ends.
With several segments to a phase, the states at the joints are further unknowns and continuity is a further residual
(multiple shooting), for arcs on which errors grow too much.

The derivative of an arc's end by all unknowns is carried from arc to arc: S(T) dz0 + z'(T) dT.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from perilune.conditions.pontryagin import Conditions, PhaseExtremal
from perilune.kernels import compile_single
from perilune.shooting.propagate import Equations, engine, equations, flight, mode_at
from perilune.shooting.rootfind import Root, Watch, damped_newton
from perilune.words.types import Matrix, Vector

_FLOWN = (0, 1)  # ArcStatus.REACHED, ArcStatus.EVENT


class Shooting:
    """Shooting function of `conditions` over Y = (y, states at the joints). One object for each thread.

    Parameters
    ----------
    conditions
        The boundary value problem.
    segments
        Arcs for each phase; 1 is single shooting.

    Attributes
    ----------
    arcs
        How many arcs were flown so far.
    """

    def __init__(self, conditions: Conditions, segments: int = 1) -> None:
        self.conditions, self.segments, self.arcs = conditions, segments, 0
        self._size = len(conditions.unknowns)
        self._last: tuple[Vector, Vector, list[Vector]] | None = None  # what Newton ended with is asked for again
        plain = segments == len(conditions.phases) == len(conditions.phases[0].modes) == 1
        self._fused = _fused(conditions, threading.get_ident()) if plain else None

    @cached_property
    def _steps(self) -> tuple[_Step, ...]:
        return _steps(self.conditions, self.segments, threading.get_ident())

    @cached_property
    def _residual(self) -> Callable[..., Sequence[Matrix]]:
        return _lean(self.conditions.residual, threading.get_ident())

    def __call__(self, Y: Vector, p: Vector, held: Mapping[int, float]) -> tuple[Vector, Matrix]:
        """Residual and Jacobian.

        Parameters
        ----------
        Y
            Unknowns, canonical.
        p
            Parameters of the canonical equations (`extremal_parameters`).
        held
            Free parameters (by index) held at a value: their stationarity row is replaced by ``q - value``.

        Returns
        -------
        residual, jacobian
            NaN where an arc could not be flown.
        """
        found = self._assembled(Y, p) if self._fused is None else self._fused(Y, p)
        if found is None:
            return np.full(len(Y), np.nan), np.full((len(Y), len(Y)), np.nan)
        h, J, ends = found
        self.arcs += self._fused is not None
        self._last, y = (Y, p, ends), Y
        first, free = self.conditions.stationarity_at.start, self.conditions.free_at.start
        replaced = [(first + index, free + index, value) for index, value in held.items()]
        for row, unknown, value in (*replaced, *((row, unknown, 0.0) for row, unknown in self.conditions.silent_rows)):
            h[row] = y[unknown] - value
            J[row] = 0.0
            J[row, unknown] = 1.0
        return h, J

    def _assembled(self, Y: Vector, p: Vector) -> tuple[Vector, Matrix, list[Vector]] | None:
        """Residual, Jacobian and ends from the arcs, one after another."""
        flown = self._fly(Y, p)
        if flown is None:
            return None
        ends, end_jacobians, gaps, gap_jacobians = flown
        h, h_y, h_z = self._residual(Y[: self._size], np.concatenate(ends), p)
        J = h_z @ np.vstack(end_jacobians)
        J[:, : self._size] += h_y
        return np.concatenate([h[:, 0], *gaps]), np.vstack([J, *gap_jacobians]), ends

    def root(
        self, Y: Vector, p: Vector, held: Mapping[int, float], watch: Watch | None = None, **settings: Any
    ) -> Root:
        """Damped Newton from Y, with the free parameters `held` at exactly their values."""
        at = self.conditions.free_at.start
        Y = np.array(Y, dtype=float)
        for index, value in held.items():
            Y[at + index] = value
        root = damped_newton(lambda y: self(y, p, held), Y, watch=watch, **settings)
        for index, value in held.items():
            root.y[at + index] = value  # Newton leaves the last bit of it
        return root

    def stationarity(self, Y: Vector, p: Vector) -> Vector:
        """dJ/dq of each free parameter q along the family of extremals, canonical, held or not."""
        return self(Y, p, {})[0][self.conditions.stationarity_at]

    def ends(self, y: Vector, p: Vector) -> list[Vector]:
        """Canonical z at the end of each phase, flown from y, zero where it is not needed; NaN where an arc is lost."""
        if self._last is not None and np.array_equal(self._last[0], y) and np.array_equal(self._last[1], p):
            return self._last[2]
        lost = [np.full(2 * e.half, np.nan) for e in self.conditions.phases]
        if self._fused is not None:
            found = self._fused(y, p)
            return lost if found is None else found[2]
        flown = self._fly(y, p)
        return lost if flown is None else flown[0]

    def joints(self, y: Vector, p: Vector) -> Vector | None:
        """Y for this number of segments from y alone: the states at the joints are those of a flight in one piece."""
        before, nodes = np.zeros(0), [y]
        for step, extremal in zip(self._steps, self.conditions.phases, strict=True):
            z0, duration = (out.ravel() for out in step.start(y, before, p)[:2])
            curve = flight(extremal, z0, p, float(duration[0]))
            at = curve(np.linspace(0.0, float(duration[0]), self.segments + 1))
            if not np.all(np.isfinite(at)):
                return None
            nodes.extend(at[1:-1])
            before = at[-1]
        return np.concatenate(nodes)

    def _fly(self, Y: Vector, p: Vector) -> tuple[list[Vector], list[Matrix], list[Vector], list[Matrix]] | None:
        """Ends, their derivatives by Y, gaps at the joints, their derivatives; None where an arc is lost."""
        y, total = Y[: self._size], len(Y)
        ends, end_jacobians, gaps, gap_jacobians = [], [], [], []
        z, dz, at = np.zeros(0), np.zeros((0, total)), self._size
        for k, step in enumerate(self._steps):
            z0, duration, z0_y, z0_before, T_y = step.start(y, z, p)
            T, dT = float(duration[0, 0]) / self.segments, T_y[0] / self.segments
            dz = z0_before @ dz if k else np.zeros((len(z0), total))
            dz[:, : self._size] += z0_y
            z = z0[:, 0].copy()
            for j in range(self.segments):
                if j:
                    node, selector = Y[at : at + len(z)], np.zeros((len(z), total))
                    selector[:, at : at + len(z)] = np.eye(len(z))
                    at += len(z)
                    gaps.append(z - node)
                    gap_jacobians.append(dz - selector)
                    z, dz = node, selector
                end = self._arc(step, j, z, dz, T, dT, p)
                if end is None:
                    return None
                z, dz = end
            ends.append(z)
            end_jacobians.append(dz)
        return ends, end_jacobians, gaps, gap_jacobians

    def _arc(self, step: _Step, j: int, z: Vector, dz: Matrix, T: float, dT: Vector, p: Vector) -> Any:
        """End of an arc and its derivative by all unknowns, or None."""
        numbers, mode = p[step.flown.numbers], mode_at(step.extremal, z, p)
        fly, block = step.arcs[j], step.blocks[j]
        self.arcs += 1
        if fly(z[step.flown.kept], numbers, T, dz[block], mode) not in _FLOWN:
            return None
        end, out = np.zeros_like(z), np.zeros_like(dz)
        end[step.flown.kept] = fly.z
        out[block] = fly.S
        if dT.any():
            rate = step.rates[fly.mode](fly.z, numbers)[0]
            out[step.flown.kept, : self._size] += rate * dT
        return end, out


@dataclass(frozen=True, kw_only=True, eq=False)
class _Step:
    """What flies one phase: its start, and for each segment an arc and the block of dz that moves it."""

    start: Callable[..., Sequence[Matrix]]
    flown: Equations
    extremal: PhaseExtremal
    rates: tuple[Callable[..., Sequence[Matrix]], ...]
    arcs: tuple[Any, ...]
    blocks: tuple[Any, ...]


@lru_cache(maxsize=64)
def _steps(conditions: Conditions, segments: int, thread: int) -> tuple[_Step, ...]:
    """The flight plan. Columns that cannot move an arc, by the sparsity of the start, are not carried along it."""
    steps, at, moving = [], len(conditions.unknowns), set[int]()
    for k, (extremal, start) in enumerate(zip(conditions.phases, conditions.starts, strict=True)):
        flown = equations(extremal, conditions.needed[k], conditions.silent[k])
        kept, size = flown.kept.tolist(), extremal.modes[0].size1_in(0)
        rows, columns = start.sparsity_out(2).get_triplet()
        moving = (moving if k else set()) | {c for r, c in zip(rows, columns, strict=True) if r in kept}
        arcs, blocks = [], []
        for j in range(segments):
            if j:
                moving = {at + i for i in kept}
                at += size
            arcs.append(engine(flown, len(moving)).single(columns=True))
            blocks.append(np.ix_(kept, sorted(moving)))
            moving = moving | set(start.sparsity_out(4).get_triplet()[1])
        steps.append(
            _Step(
                start=_lean(start, thread),
                flown=flown,
                extremal=extremal,
                rates=tuple(_lean(mode, thread) for mode in flown.modes),
                arcs=tuple(arcs),
                blocks=tuple(blocks),
            )
        )
    return tuple(steps)


@lru_cache(maxsize=256)
def _lean(function: ca.Function, thread: int) -> Callable[..., Sequence[Matrix]]:
    """The function as machine code for one point; arguments without entries are left out of the call."""
    symbols = [ca.SX.sym(f"a{i}", function.size1_in(i)) for i in range(function.n_in())]
    kept = [i for i in range(function.n_in()) if function.size1_in(i)]
    evaluate = compile_single(ca.Function("lean", [symbols[i] for i in kept], function.call(symbols)))
    if len(kept) == len(symbols):
        return evaluate
    return lambda *arguments: evaluate(*[arguments[i] for i in kept])


Fused = Callable[[Vector, Vector], "tuple[Vector, Matrix, list[Vector]] | None"]


@lru_cache(maxsize=64)
def _fused(conditions: Conditions, thread: int) -> Fused:
    """Single shooting of one smooth phase with all algebra around its one arc in machine code.

    The same as `Shooting._assembled`, which the tests hold it to; the arc's columns go straight from the start's
    derivative and into the residual's.
    """
    extremal, start = conditions.phases[0], conditions.starts[0]
    flown = equations(extremal, conditions.needed[0], conditions.silent[0])
    kept, size, whole = flown.kept.tolist(), len(conditions.unknowns), extremal.modes[0].size1_in(0)
    y, p, z = (ca.SX.sym(n, k) for n, k in (("y", size), ("p", extremal.modes[0].size1_in(1)), ("z", len(kept))))
    z0, duration, z0_y, _, T_y = start(y, ca.SX(0, 1), p)
    moving = sorted({c for r, c in zip(*z0_y.sparsity().get_triplet(), strict=True) if r in kept})
    known = p[flown.numbers.tolist()]
    opening = compile_single(ca.Function("opening", [y, p], [z0[kept], duration, z0_y[kept, moving], known]))

    S, end, dz = ca.SX.sym("S", len(kept) * len(moving)), ca.SX.zeros(whole, 1), ca.SX.zeros(len(kept), size)
    end[kept] = z
    dz[:, moving] = ca.reshape(S, len(moving), len(kept)).T
    dz += ca.mtimes(flown.modes[0](z, known), T_y)
    h, h_y, h_z = conditions.residual(y, end, p)
    outputs = ca.cse([h, h_y + ca.mtimes(h_z[:, kept], dz)])
    closing = compile_single(ca.Function("closing", [y, z, S, p], outputs))
    fly = engine(flown, len(moving)).single(columns=True)

    def shoot(Y: Vector, numbers: Vector) -> tuple[Vector, Matrix, list[Vector]] | None:
        z0, duration, seeds, used = opening(Y, numbers)
        if fly(z0[:, 0], used[:, 0], float(duration[0, 0]), seeds) not in _FLOWN:
            return None
        h, J = closing(Y, fly.z, fly.S.ravel(), numbers)
        end = np.zeros(whole)
        end[kept] = fly.z
        return h[:, 0].copy(), J.copy(), [end]

    return shoot
