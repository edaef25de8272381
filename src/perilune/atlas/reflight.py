"""A second flight of an extremal, by another integrator: where it ends, and what it keeps on the way.

The machine code of shooting goes by Dormand and Prince's pair of order 8 with steps of its own choice. Here the
canonical equations are marched in equal steps by extrapolation of Gragg's midpoint rule to order 8, from the unknowns
alone, and the conditions at the ends are evaluated anew. At each step the conditions of the path and the bounds of the
states are looked at, and whether H is less for any of some admissible controls than for the one that is flown. All of
it is one call of machine code for each piece between switches, for one extremal or for many in lanes.

Source: E. Hairer, S. P. Norsett, G. Wanner, *Solving Ordinary Differential Equations I*, 2nd ed., Springer 1993,
section II.9 (9.10), (9.13).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.conditions.canonical import PhaseExtremal, limit_symbols
from perilune.conditions.pontryagin import Conditions
from perilune.kernels import compile_map
from perilune.problem.controls import Bounded, placed
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.symbolic import SYMBOLIC, Unnumbered, column, elements, trace_parameters
from perilune.shooting.newton import Lanes
from perilune.shooting.propagate import engine, equations
from perilune.words.types import Matrix, Vector

STEPS = 48  # of a piece
SLACK = 1e-9  # canonical: what an end, a condition, H or its minimum may be missed by
_SUBSTEPS = (2, 4, 6, 8)
_FAR = 1e30  # stands for infinity: nothing was looked at yet
_NEAR = 0.1  # how far from the control that is flown an unbounded one is tried, canonical


@dataclass(frozen=True, kw_only=True)
class Reflown:
    """What second flights show, in lanes; canonical.

    Attributes
    ----------
    residuals
        Of all conditions, (lanes, conditions); 0 for those of what is held.
    path
        The least of all conditions of the path and distances of states from their bounds; `_FAR` where there is none.
    minimum
        The least of H of another control minus H of the one that is flown.
    drift
        By how much H changes along a phase.
    cost
        J.
    arcs
        (phase, lanes, modes that they go through in it) of all phases and lanes.
    """

    residuals: Matrix
    path: Vector
    minimum: Vector
    drift: Vector
    cost: Vector
    arcs: tuple[tuple[int, Lanes, tuple[int, ...]], ...]

    @property
    def sequence(self) -> NDArray[np.int64]:
        """A number for the modes that each lane goes through, the same in every process."""
        told = [""] * len(self.cost)
        for phase, lanes, modes in self.arcs:
            for lane in lanes.tolist():
                told[lane] += f"{phase}:{modes};"
        known = {text: zlib.crc32(text.encode()) for text in set(told)}
        return np.array([known[text] for text in told], dtype=np.int64)

    @property
    def residual(self) -> Vector:
        """The largest of them."""
        return np.abs(self.residuals).max(axis=1)

    @property
    def good(self) -> NDArray[np.bool_]:
        """Whether nothing speaks against the extremal."""
        kept = (self.residual <= SLACK) & (self.path >= -SLACK)
        return kept & (self.minimum >= -SLACK) & (self.drift <= SLACK)


@dataclass(frozen=True)
class _Piece:
    """Between two switches, of some lanes: the mode, the lengths, and what makes z behind it of z at its end."""

    mode: int
    length: Vector
    jump: Any


class _Kept:
    """A compiled function whose arrays of one lane are kept, as a single query asks for it again and again."""

    def __init__(self, function: ca.Function, times: int = 1) -> None:
        self._map, self._idle = compile_map(function, times=times), list[Any]()  # a list's pop and append are atomic

    def __call__(self, *arguments: Matrix) -> tuple[Matrix, ...]:
        if max(map(len, arguments)) != 1:
            return self._map(*arguments)
        try:
            bound = self._idle.pop()
        except IndexError:
            bound = self._map.bind(*(np.array(a, dtype=float) for a in arguments))
        for own, given in zip(bound.inputs, arguments, strict=True):
            own[:] = given
        bound()
        found = tuple(out.copy() for out in bound.outputs)
        self._idle.append(bound)
        return found


class Reflights:
    """Flies extremals of a problem a second time.

    Parameters
    ----------
    problem, conditions
        Whose extremals; the conditions are those of the problem.
    """

    def __init__(self, problem: Problem, conditions: Conditions) -> None:
        self.problem, self.conditions = problem, conditions
        self._marches: dict[tuple[int, int], _Kept] = {}
        self._jumps: dict[tuple[int, int], _Kept] = {}

    @cached_property
    def _stated(self) -> Problem:
        return Unnumbered(self.problem).problem

    @cached_property
    def _starts(self) -> list[_Kept]:
        return [_Kept(start) for start in self.conditions.starts]

    @cached_property
    def _modes(self) -> list[_Kept]:
        return [_Kept(extremal.mode) for extremal in self.conditions.phases]

    @cached_property
    def _residual(self) -> _Kept:
        return _Kept(self.conditions.residual)

    def __call__(self, y: Matrix, p: Matrix, held: NDArray[np.bool_]) -> Reflown:
        """Fly again.

        Parameters
        ----------
        y
            Unknowns of single shooting, (lanes, n).
        p
            Numbers of the canonical equations, (lanes, np) or (1, np).
        held
            Which free parameters, then ranges, are held, and not chosen, (lanes, k).
        """
        count, conditions = len(y), self.conditions
        free = np.ascontiguousarray(y[:, conditions.free_at])
        looked = np.tile([_FAR, _FAR, _FAR, -_FAR], (count, 1))
        drift = np.zeros(count)
        ends, before, sequence = list[Matrix](), np.zeros((count, 0)), list[tuple[int, Lanes, tuple[int, ...]]]()
        for k in range(len(conditions.phases)):
            z, duration = self._starts[k](y, before, p)
            looked[:, 2:] = _FAR, -_FAR
            state = np.hstack([z, looked])
            for lanes, pieces in self._sequences(k, z, duration[:, 0], p):
                numbers = p if len(p) == 1 else p[lanes]
                sequence += [(k, lanes, tuple(piece.mode for piece in pieces))]
                for piece in pieces:
                    march = self._march(k, piece.mode)
                    flown = march(state[lanes], numbers, free[lanes], piece.length[:, None] / STEPS)[0]
                    if piece.jump is not None:
                        flown[:, :-4] = piece.jump(np.ascontiguousarray(flown[:, :-4]), numbers)[0]
                    state[lanes] = flown
            before, looked = np.ascontiguousarray(state[:, :-4]), state[:, -4:]
            drift = np.fmax(drift, looked[:, 3] - looked[:, 2])
            ends.append(before)
        residual, cost = self._residual(y, np.hstack(ends), p)
        free_count = conditions.free_at.stop - conditions.free_at.start
        residual[:, conditions.stationarity_at] *= ~held[:, :free_count]
        for i, (row, nu) in enumerate(conditions.ranges, free_count):
            residual[:, row] = np.where(held[:, i], 0.0, y[:, nu])  # whether it is in its range is for others to say
        return Reflown(
            residuals=residual,
            path=looked[:, 0],
            minimum=looked[:, 1],
            drift=drift,
            cost=cost[:, 0],
            arcs=tuple(sequence),
        )

    def _sequences(self, k: int, z: Matrix, duration: Vector, p: Matrix) -> Iterator[tuple[Lanes, list[_Piece]]]:
        """Lanes that go through the same modes, and their pieces between switches."""
        extremal = self.conditions.phases[k]
        if not extremal.events:
            yield np.arange(len(z)), [_Piece(0, duration, None)]
            return
        first = self._modes[k](z, p)[0][:, 0]
        whole = equations(extremal, (), ())
        flown = engine(whole).propagate(z, p[:, whole.numbers], duration, mode=first)
        met = flown.event_index
        keys = np.column_stack([first.astype(np.int64), met[:, : max(1, int((met >= 0).sum(axis=1).max()))]])
        for key in np.unique(keys, axis=0):
            lanes = np.nonzero((keys == key).all(axis=1))[0]
            mode, at, pieces = int(key[0]), np.zeros(len(lanes)), list[_Piece]()
            for i, number in enumerate(key[1:][key[1:] >= 0].tolist()):
                event, time = extremal.events[number], flown.event_time[lanes, i]
                if event.jump is not None and (k, number) not in self._jumps:
                    self._jumps[k, number] = _Kept(event.jump)
                jump = self._jumps.get((k, number))
                pieces.append(_Piece(mode, time - at, jump))
                mode, at = event.switches.get(mode, mode), time
            yield lanes, [*pieces, _Piece(mode, duration[lanes] - at, None)]

    def _march(self, k: int, mode: int) -> _Kept:
        if (k, mode) not in self._marches:
            step = _step(self._stated, k, self._stated.phases[k], self.conditions.phases[k], mode)
            self._marches[k, mode] = _Kept(step, times=STEPS)
        return self._marches[k, mode]


def _step(problem: Problem, k: int, phase: Phase, extremal: PhaseExtremal, mode: int) -> ca.Function:
    """One step: (z and what was seen so far, numbers, free parameters, length) -> the same behind it."""
    size = 2 * extremal.half
    numbers = ca.SX.sym("numbers", extremal.modes[mode].size1_in(1))
    free, h = ca.SX.sym("free", len(problem.free)), ca.SX.sym("h")
    state = ca.SX.sym("state", size + 4)
    z = state[:size]
    after = _extrapolated(lambda point: extremal.modes[mode](point, numbers), z, h)
    path, minimum, value = _seen(problem, k, phase, extremal, mode, z, numbers, free)
    seen = [
        ca.fmin(state[size], path),
        ca.fmin(state[size + 1], minimum),
        ca.fmin(state[size + 2], value),
        ca.fmax(state[size + 3], value),
    ]
    out = ca.vertcat(after, *seen)
    return ca.Function("step", [state, numbers, free, h], [ca.cse(out)])


def _extrapolated(rate: Any, z: ca.SX, h: ca.SX) -> ca.SX:
    """A step of order 8: midpoint rules of 2, 4, 6 and 8 parts, extrapolated in the square of their length."""
    first, table = rate(z), list[ca.SX]()
    for j, count in enumerate(_SUBSTEPS):
        part = h / count
        before, here = z, z + part * first
        for _ in range(count - 1):
            before, here = here, before + 2 * part * rate(here)
        row = [here]
        for k in range(1, j + 1):
            ratio = (count / _SUBSTEPS[j - k]) ** 2 - 1.0
            row.append(row[k - 1] + (row[k - 1] - table[k - 1]) / ratio)
        table = row
    return table[-1]


def _seen(
    problem: Problem, k: int, phase: Phase, extremal: PhaseExtremal, mode: int, z: ca.SX, numbers: ca.SX, free: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """At a point the least condition, the least H of another control beyond that of the one flown, and that H."""
    n, p = extremal.state_count, trace_parameters(problem)
    symbols, limits = limit_symbols(problem, p)
    x, u = ca.SX.sym("x", n), ca.SX.sym("u", len(phase.control_names))
    rates = column(phase.rates(elements(x), elements(u), p.record, SYMBOLIC))
    held = column(phase.evaluate("path", elements(x), elements(u), p.record, SYMBOLIC))
    bounds = [v.limits(p.record) for v in phase.states]
    room = [(x[i] - ca.SX(low), ca.SX(high) - x[i]) for i, (low, high) in enumerate(bounds)]
    finite = [ca.SX(e) for pair in room for e in pair if not (ca.SX(e).is_constant() and not np.isfinite(float(e)))]
    conditions = ca.vertcat(ca.SX(0, 1), held, *finite)
    given = numbers[: p.given.numel()]
    plain = numbers[p.given.numel() : p.given.numel() + symbols.numel()]
    known = [p.given, p.free, symbols]
    lam = ca.SX.sym("lam", n)
    value = ca.Function("value", [x, u, lam, *known], [ca.dot(lam, rates), conditions])
    control, _, _ = extremal.reports[mode](z, numbers)
    where, costate = z[:n], z[extremal.half : extremal.half + n]
    best, kept = value(where, control, costate, given, free, plain)
    of_limits = ca.Function(
        "limits", known, [ca.vertcat(ca.SX(0, 1), *(e for pair in limits[k].values() for e in pair))]
    )
    others = []
    for other in _samples(phase, control, of_limits(given, free, plain)):
        there, allowed = value(where, other, costate, given, free, plain)
        gain = there - best
        if allowed.numel() and ca.depends_on(held, u):
            gain = ca.if_else(ca.mmin(allowed[: held.numel()]) >= 0, gain, _FAR)
        others.append(gain)
    least = ca.mmin(ca.vertcat(*others)) if others else ca.SX(_FAR)
    return ca.mmin(kept) if kept.numel() else ca.SX(_FAR), least, best


def _samples(phase: Phase, control: ca.SX, limits: ca.SX) -> Iterator[ca.SX]:
    """Admissible controls all over the set of each phase."""
    choices, at = list[list[ca.SX]](), 0
    for here, kind in placed(phase.controls):
        flown = control[here.start : here.stop]
        if isinstance(kind, Bounded):
            low, high = limits[2 * at], limits[2 * at + 1]
            at += 1
            if kind.bounded:
                choices.append([flown, low, 0.5 * (low + high), high])
            else:
                choices.append([flown, *(ca.fmin(ca.fmax(flown + way * _NEAR, low), high) for way in (-1, 1))])
        else:
            choices.append([flown, *(ca.SX(ca.DM(v)) for v in _directions(len(kind.names)))])
    for number, parts in enumerate(product(*choices)):
        if number:  # the first is the control itself
            yield ca.vertcat(*parts)


@lru_cache(maxsize=4)
def _directions(components: int) -> tuple[tuple[float, ...], ...]:
    """Unit vectors all around: eight in the plane, the faces and corners of a cube in space."""
    if components == 2:
        return tuple((float(np.cos(a)), float(np.sin(a))) for a in np.arange(8) * np.pi / 4)
    whole = [v for v in product((-1.0, 0.0, 1.0), repeat=3) if np.count_nonzero(v) in (1, 3)]
    return tuple(tuple((np.array(v) / np.linalg.norm(v)).tolist()) for v in whole)
