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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.atlas.march import FAR, NOTHING_SEEN, Kept, step_along, step_settling
from perilune.conditions.canonical import hamiltonian_at
from perilune.conditions.pontryagin import Conditions
from perilune.problem.problem import Problem
from perilune.problem.symbolic import Unnumbered
from perilune.shooting.newton import Lanes
from perilune.shooting.propagate import engine, equations
from perilune.shooting.settling import settling
from perilune.words.types import Batch, Matrix, Vector

STEPS = 48  # of a piece, or a multiple of it
_MOST, _EXACT = 32, 1e-11  # times as many, and what the end of a phase may be wrong by, where they are chosen
_FINER, _NEARLY = 4, 1e-3  # times as many for a lane that misses something by so little, canonical
SLACK = 1e-9  # canonical: what an end, a condition, H or its minimum may be missed by


@dataclass(frozen=True, kw_only=True)
class Reflown:
    """What second flights show, in lanes; canonical.

    Attributes
    ----------
    residuals
        Of all conditions, (lanes, conditions); 0 for those of what is held.
    path
        The least of all conditions of the path and distances of states from their bounds; `FAR` where there is none.
    minimum
        The least of H of another control minus H of the one that is flown.
    drift
        By how much H changes along a phase.
    cost
        J.
    rates
        dJ/dq of each free parameter along the family of extremals, held or not, (lanes, k).
    ranges
        Value of each end condition that is a range, (lanes, r).
    arcs
        (phase, lanes, modes that they go through in it) of all phases and lanes.
    """

    residuals: Matrix
    path: Vector
    minimum: Vector
    drift: Vector
    cost: Vector
    rates: Matrix
    ranges: Matrix
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

    @property
    def nearly(self) -> NDArray[np.bool_]:
        """Whether something speaks against it by as little as rounding or coarse steps may."""
        return ~self.good & (np.fmax(self.residual, -np.fmin(self.path, self.minimum)) <= _NEARLY)

    def replace(self, lanes: Lanes, by: Reflown) -> None:
        """Put other flights of the same arcs in the place of some."""
        for name in ("residuals", "path", "minimum", "drift", "cost", "rates", "ranges"):
            getattr(self, name)[lanes] = getattr(by, name)


@dataclass(frozen=True)
class _Piece:
    """Between two switches, of some lanes: the mode, the lengths, and what makes z behind it of z at its end."""

    mode: int
    length: Vector
    jump: Any


@dataclass(frozen=True)
class _Leg:
    """One phase of all lanes.

    Attributes
    ----------
    begin, end
        z at its ends; of a phase that settles x alone, and (x, 0).
    through
        Phi of a phase that settles, (lanes, n, n).
    seen
        As `NOTHING_SEEN`.
    arcs
        Lanes, and the modes that they go through.
    """

    begin: Matrix
    end: Matrix
    through: Batch | None
    seen: Matrix
    arcs: list[tuple[Lanes, tuple[int, ...]]]


class Reflights:
    """Flies extremals of a problem a second time.

    Parameters
    ----------
    problem, conditions
        Whose extremals; the conditions are those of the problem.
    times
        For each phase how many times `STEPS` a piece of it has, as `fine_enough` finds them; once by default.
    """

    def __init__(self, problem: Problem, conditions: Conditions, times: Sequence[int] = ()) -> None:
        self.problem, self.conditions = problem, conditions
        self.times = tuple(times) or (1,) * len(conditions.phases)
        self._marches: dict[tuple[int, int], Kept] = {}
        self._jumps: dict[tuple[int, int], Kept] = {}

    @cached_property
    def _stated(self) -> Problem:
        return Unnumbered(self.problem).problem

    @cached_property
    def _starts(self) -> list[Kept]:
        return [Kept(start) for start in self.conditions.starts]

    @cached_property
    def _modes(self) -> list[Kept]:
        return [Kept(extremal.mode) for extremal in self.conditions.phases]

    @cached_property
    def _values(self) -> list[Kept]:
        """H at a point of each phase."""
        found = list[Kept]()
        for extremal in self.conditions.phases:
            z, numbers = ca.SX.sym("z", 2 * extremal.half), ca.SX.sym("numbers", extremal.modes[0].size1_in(1))
            found.append(Kept(ca.Function("value", [z, numbers], [hamiltonian_at(extremal, z, numbers)])))
        return found

    @cached_property
    def _ranges(self) -> list[int]:
        """Rows of the end conditions that are ranges."""
        return [row for row, _ in self.conditions.ranges]

    @cached_property
    def _residual(self) -> Kept:
        return Kept(self.conditions.residual)

    def __call__(self, y: Matrix, p: Matrix, choice: Matrix) -> Reflown:
        """Fly again.

        Parameters
        ----------
        y
            Unknowns of single shooting, (lanes, n).
        p
            Numbers of the canonical equations, (lanes, np) or (1, np).
        choice
            Which free parameters, then ranges, are held, and not chosen, and their values, (lanes, 2 k).
        """
        return self._flown(y, p, choice, self.times)

    def finer(self, y: Matrix, p: Matrix, choice: Matrix) -> Reflown:
        """The same, and by finer steps where these miss by as little as coarse ones may."""
        found = self._flown(y, p, choice, self.times)
        if (poor := np.nonzero(found.nearly)[0]).size:
            numbers = p if len(p) == 1 else p[poor]
            found.replace(poor, self._flown(y[poor], numbers, choice[poor], [_FINER * times for times in self.times]))
        return found

    def _flown(self, y: Matrix, p: Matrix, choice: Matrix, times: Sequence[int]) -> Reflown:
        count, conditions = len(y), self.conditions
        free = np.ascontiguousarray(y[:, conditions.free_at])
        path, minimum, drift = np.full(count, FAR), np.full(count, FAR), np.zeros(count)
        legs, ends, before = list[_Leg](), list[Matrix](), np.zeros((count, 0))
        for k in range(len(conditions.phases)):
            leg = self._along(k, y, before, p, free, times[k])
            path, minimum = np.fmin(path, leg.seen[:, 0]), np.fmin(minimum, leg.seen[:, 1])
            if leg.through is None:
                drift = np.fmax(drift, leg.seen[:, 3] - leg.seen[:, 2])
            legs.append(leg)
            ends.append(before := leg.end)
        residual, cost = self._residual(y, np.hstack(ends), p)
        if settled := [(k, leg.begin, leg.through) for k, leg in enumerate(legs) if leg.through is not None]:
            rows = [_rows_of(conditions, k) for k, _, _ in settled]
            for (k, _, _), own in zip(settled, rows, strict=True):
                ends[k][:, conditions.phases[k].half :] = -residual[:, own]  # the costates that its end asks for
            residual, cost = self._residual(y, np.hstack(ends), p)
            for (k, begin, through), own in zip(settled, rows, strict=True):
                lam, half = y[:, conditions.costate_at[k]], conditions.phases[k].half
                residual[:, own] = lam - np.einsum("lij,li->lj", through, ends[k][:, half:])
                values = [self._values[k](z, p)[0] for z in (np.hstack([begin, lam]), ends[k])]
                drift = np.fmax(drift, np.abs(values[1] - values[0])[:, 0])
        rates, ranges = residual[:, conditions.stationarity_at].copy(), residual[:, self._ranges]
        held, values = choice[:, : choice.shape[1] // 2], choice[:, choice.shape[1] // 2 :]
        residual[:, conditions.stationarity_at] *= held[:, : free.shape[1]] == 0
        for i, (row, nu) in enumerate(conditions.ranges, free.shape[1]):  # one that is not held has no multiplier
            residual[:, row] = np.where(held[:, i] > 0, residual[:, row] - values[:, i], y[:, nu])
        arcs = tuple((k, *arc) for k, leg in enumerate(legs) for arc in leg.arcs)
        return Reflown(
            residuals=residual, path=path, minimum=minimum, drift=drift, cost=cost[:, 0], rates=rates, ranges=ranges,
            arcs=arcs,
        )  # fmt: skip

    def fine_enough(self, y: Matrix, p: Matrix) -> tuple[int, ...]:
        """How many times `STEPS` each phase needs, so that twice as many end at the same; for extremals, (lanes, n)."""
        free, before, found = np.ascontiguousarray(y[:, self.conditions.free_at]), np.zeros((len(y), 0)), list[int]()
        for k in range(len(self.conditions.phases)):
            times, wrong = 1, np.inf
            end = self._along(k, y, before, p, free, times).end
            while wrong > _EXACT and times < _MOST:
                coarse, times = end, 2 * times
                end = self._along(k, y, before, p, free, times).end
                wrong = float(np.fmax.reduce(np.abs(end - coarse) / (1.0 + np.abs(end)), axis=None))
            found.append(times // 2 if wrong <= _EXACT else times)
            before = end
        return tuple(found)

    def _along(self, k: int, y: Matrix, before: Matrix, p: Matrix, free: Matrix, times: int) -> _Leg:
        """Fly one phase."""
        z, duration = self._starts[k](y, before, p)
        extremal, arcs = self.conditions.phases[k], list[tuple[Lanes, tuple[int, ...]]]()
        made = settling(extremal) if extremal.settles else None
        flown = z if made is None else np.hstack([z[:, : extremal.half], np.tile(made.seeds, (len(z), 1))])
        state, last = np.hstack([flown, np.tile(NOTHING_SEEN, (len(z), 1))]), flown.shape[1]
        for lanes, pieces in self._sequences(k, z, duration[:, 0], p):
            numbers, chosen = p if len(p) == 1 else p[lanes], free[lanes]
            arcs.append((lanes, tuple(piece.mode for piece in pieces)))
            here = state[lanes]
            for piece in pieces:
                march, length = self._march(k, piece.mode), piece.length[:, None] / (STEPS * times)
                for _ in range(times):
                    here = march(here, numbers, chosen, length)[0]
                if piece.jump is not None:
                    here[:, :last] = piece.jump(np.ascontiguousarray(here[:, :last]), numbers)[0]
            state[lanes] = here
        end, seen = np.ascontiguousarray(state[:, :last]), state[:, last:]
        if made is None:
            return _Leg(z, end, None, seen, arcs)
        n = extremal.half
        through = np.tile(np.eye(n), (len(z), 1, 1))
        through[:, list(made.rows)] = end[:, n:].reshape(len(z), -1, n)
        return _Leg(z[:, :n], np.hstack([end[:, :n], np.zeros((len(z), n))]), through, seen, arcs)

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
                    self._jumps[k, number] = Kept(event.jump)
                jump = self._jumps.get((k, number))
                pieces.append(_Piece(mode, time - at, jump))
                mode, at = event.switches.get(mode, mode), time
            yield lanes, [*pieces, _Piece(mode, duration[lanes] - at, None)]

    def _march(self, k: int, mode: int) -> Kept:
        if (k, mode) not in self._marches:
            stated, extremal = (self._stated, k, self._stated.phases[k]), self.conditions.phases[k]
            if extremal.settles:
                step = step_settling(*stated, extremal, settling(extremal), mode)
            else:
                step = step_along(*stated, extremal, mode)
            self._marches[k, mode] = Kept(step, times=STEPS)
        return self._marches[k, mode]


def _rows_of(conditions: Conditions, k: int) -> slice:
    """Of the residual: the transversality conditions of a phase."""
    at, first = conditions.costate_at[k], conditions.transversality_at
    return slice(first + at.start, first + at.stop)
