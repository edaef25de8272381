"""Switching surfaces: where a flight crosses a kink or jump of the physics, and how costates pass them.

At a zero of a guard s(x) the rates change from f- to f+. A neighbouring flight crosses at another time, so that a
deviation d of the state, and the costate, pass by

    d+ = S d-,   lam- = S' lam+,   S = I + (f+ - f-) s_x' / (s_x f-),

which is to say lam- - lam+ = nu s_x with nu = (f+ - f-).lam- / (s_x f+), and H is the same on both sides. That holds
where the crossing is transversal: s_x f- and s_x f+ of one sign. For a flight that slides along s = 0, that leaves a
corner of two guards, or whose guard a control moves, S is not a number here, and every check that needs it fails.
Source: Bryson and Ho (1975), section 3.7; Leine and Nijmeijer (2004), section 7.1 (saltation matrix).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector, complex_step_jacobian
from perilune.problem import Phase, Trajectory, normalised
from perilune.proof.feasible.branch_guards import watched_rates
from perilune.proof.feasible.sample_points import (
    ENDS,
    IN_HALVES,
    POINTS,
    Pieces,
    ends_and_turning_points,
    interpolating_cubics,
    polynomial,
    time_just_before,
)

# A guard this close to zero, in canonical units of the state, vanishes: by so much a table may differ from the flight.
_SMALL = 3e-10
SAME_TIME = 1e-11  # of the duration: crossings that lie closer are one
_CONTINUOUS = 1e-12  # rates that change less, against their size, do not
_SECTIONS, _ROUNDS = 16, 14  # 16^14 is beyond the digits of a number
_DOUBT = 4.0  # a guard may be so many times farther from its cubic elsewhere than it is where that is compared
_HALVINGS, _MOST_OPEN = 40, 4000
_LAST_DIGITS = 1e-15  # of a state: what a guard changes with them is rounding


@dataclass(frozen=True, kw_only=True)
class GuardCrossing:
    """Crossing of a guard. Vectors are scaled: states by their canonical units, rates per second.

    Attributes
    ----------
    time
        In the phase [s].
    guard
        Number of a guard that vanishes there.
    before, after
        Answers of all guards on either side.
    size
        Of ds/dx: its largest component [unit of s per canonical unit of a state].
    normal
        ds/dx over `size`, (n,).
    jump
        f+ - f-, (n,); exactly 0 where the rates are continuous.
    speeds
        Rates of s before and after, over `size`; NaN where the crossing is not of a supported kind.
    """

    time: float
    guard: int
    before: Vector
    after: Vector
    size: float
    normal: Vector
    jump: Vector
    speeds: tuple[float, float]

    @cached_property
    def saltation(self) -> Matrix:
        """S: how a deviation of the state passes, (n, n)."""
        return np.eye(len(self.jump)) + np.outer(self.jump, self.normal) / self.speeds[0]

    @cached_property
    def adjoint(self) -> Matrix:
        """Return the matrix by which a costate passes the crossing, (n, n)."""
        return np.eye(len(self.jump)) - np.outer(self.normal, self.jump) / self.speeds[1]

    def multiplier(self, lam: Vector) -> float:
        """nu over `size` for the costate before, (n,)."""
        return float(self.jump @ lam / self.speeds[1])


@dataclass(frozen=True, kw_only=True)
class Guarded:
    """Guards along the tables of one phase.

    Attributes
    ----------
    phase, p, trajectory, duration
        The phase, its parameters, tables and length [s].
    scale
        Canonical units of the states [SI], (n,).
    """

    phase: Phase
    p: Any
    trajectory: Trajectory
    duration: float
    scale: Vector

    def state(self, t: Vector) -> Matrix:
        """States (n, times)."""
        return self.trajectory.state.extrapolate(t).T

    def control(self, t: Vector) -> Matrix:
        """Controls (components, times)."""
        return normalised(self.phase.controls, self.trajectory.control.extrapolate(t).T)

    def guards(self, x: Matrix, u: Matrix) -> tuple[Matrix, Matrix]:
        """Values and answers of all guards, (guards, ...).

        Parameters
        ----------
        x, u
            States, shape (n, ...), and controls, shape (components, ...) [SI].

        Returns
        -------
        values, answers
            Differences that are compared [SI], and the results of the comparisons.
        """
        _, differences, answers = watched_rates(self.phase, x, u, self.p)
        return differences.real, answers

    def answers(self, t: float) -> Vector:
        """Answers of all guards at a time, (guards,)."""
        if not self.count:
            return np.zeros(0, dtype=bool)
        at = np.array([t])
        return self.guards(self.state(at), self.control(at))[1][:, 0]

    def along(self, t: Vector, guard: int) -> Vector:
        """Return the values of one guard at times.

        Parameters
        ----------
        t
            Times from the start of the phase [s], shape (N,).
        guard
            Index of the guard, in the order of the comparisons.
        """
        return self.guards(self.state(t), self.control(t))[0][guard]

    @cached_property
    def count(self) -> int:
        """Return the number of guards."""
        start = np.zeros(1)
        return len(self.guards(self.state(start), self.control(start))[0])

    def off(self, t: Vector) -> Vector:
        """Return those times at which no guard is zero."""
        values = self.guards(self.state(t), self.control(t))[0] if self.count else np.zeros((0, len(t)))
        small = [self._small(t, guard) for guard in range(self.count)]
        return t[(np.abs(values) > np.array(small).reshape(values.shape)).all(axis=0)]

    def crossings(self, pieces: Pieces) -> tuple[GuardCrossing, ...]:
        """Return all crossings in order, found inside every piece of the tables."""
        if not self.count:
            return ()
        pieces, inside = self._resolved(pieces)
        found = sorted(
            (time, guard, low, high)
            for guard, values in enumerate(inside)
            for low, high in self._brackets(pieces, values, guard)
            for time in self._located(low, high, guard)
        )
        groups: list[list[tuple[float, int, float, float]]] = []
        for entry in found:
            if groups and entry[0] - groups[-1][0][0] <= SAME_TIME * self.duration:
                groups[-1].append(entry)
            else:
                groups.append([entry])
        return tuple(self._crossing(group) for group in groups)

    def _resolved(self, pieces: Pieces) -> tuple[Pieces, Matrix]:
        """Pieces so small that every guard has the signs of the cubic through its values there, and those values.

        Else it may dip through zero between the points, and the piece is halved: while the cubic is as close to zero as
        it is to the guard, at the ends of the piece or at the points of both halves.
        """
        found, values, own = [], [], self.guards(*self._read(pieces))[0]
        for left in range(_HALVINGS, -1, -1):
            halves, ends = pieces.halves, self.guards(*self._read(pieces, ENDS))[0]
            x, u = self._read(halves)
            finer = self.guards(x, u)[0]
            fit = interpolating_cubics(own)[:, :, None]
            known = np.concatenate([ends, finer.reshape(*own.shape[:2], 8)], axis=2)
            error = np.abs(polynomial(fit, np.concatenate([ENDS, IN_HALVES])) - known).max(axis=2)
            doubtful = np.abs(polynomial(fit, ends_and_turning_points(fit[:, :, 0]))).min(axis=2) < _DOUBT * error
            again = doubtful.any(axis=0) & (left > 0) & (len(pieces) < _MOST_OPEN)
            if again.any():
                both = np.repeat(again, 2)
                changes = np.abs(self._slopes(x[:, both], u[:, both]) * np.concatenate([x, u])[:, both])
                rounding = _LAST_DIGITS * changes.sum(axis=1).reshape(len(own), -1, 8).max(axis=2)
                again[again] = (doubtful[:, again] & (error[:, again] > rounding)).any(axis=0)
            found.append(pieces[~again])
            values.append(own[:, ~again])
            if not again.any():
                break
            pieces, own = halves[np.repeat(again, 2)], finer[:, np.repeat(again, 2)]
        pieces, own = Pieces.joined(found), np.concatenate(values, axis=1)
        order = np.argsort(pieces.left, kind="stable")
        return pieces[order], own[:, order]

    def _read(self, pieces: Pieces, shares: Vector = POINTS) -> tuple[Matrix, Matrix]:
        """States and controls on pieces, (components, N, shares)."""
        control = pieces.read(self.trajectory.control, shares)
        return pieces.read(self.trajectory.state, shares), normalised(self.phase.controls, control)

    def _brackets(self, pieces: Pieces, values: Matrix, guard: int) -> Iterator[tuple[float, float]]:
        """Neighbouring times between which a guard changes its sign, at points of the pieces or extremes of cubics."""
        fit = interpolating_cubics(values)
        shares = ends_and_turning_points(fit)
        others = pieces.left[:, None] + pieces.width[:, None] * shares
        others[:, 1] = time_just_before(np.append(pieces.left[1:], self.duration))
        others = others[(polynomial(fit[:, None], shares) > 0) != (values[:, :1] > 0)]
        times, values = np.append(pieces.times(), others), np.append(values, self.along(others, guard))
        order = np.argsort(times, kind="stable")
        times, values = times[order], values[order]
        if ((values[1:] > 0) != (values[:-1] > 0)).any():
            # What is zero but for rounding is on no side.
            clear = np.abs(values) > self._small(times, guard)
            times, above = times[clear], values[clear] > 0
            for k in np.nonzero(above[1:] != above[:-1])[0]:
                yield float(times[k]), float(times[k + 1])

    def _located(self, low: float, high: float, guard: int) -> Iterator[float]:
        """The time of a change of sign: a break of the tables that it belongs to, or the zero itself."""
        for curve in (self.trajectory.state, self.trajectory.control):
            breaks = curve.time[1:][np.diff(curve.time) == 0]
            for time in breaks[(breaks > low) & (breaks <= high)]:
                before, after = self.along(np.array([time_just_before(time), time]), guard)
                if min(abs(before), abs(after)) <= self._small(np.array([time]), guard)[0]:
                    yield float(time)
                    return
                if (before > 0) != (after > 0):
                    return  # the control jumps, and the guard with it: it chooses at a time of its own
        for _ in range(_ROUNDS):
            t = np.linspace(low, high, _SECTIONS + 1)
            above = self.along(t, guard) > 0
            k = max(int(np.argmax(above != above[0])), 1)
            low, high = t[k - 1], t[k]
        yield float(high)

    def _slopes(self, x: Matrix, u: Matrix) -> Matrix:
        """Derivatives of all guards by states and controls, (guards, n + k, ...)."""
        n = len(x)
        return complex_step_jacobian(
            lambda z: watched_rates(self.phase, z[:n], z[n:], self.p)[1], np.concatenate([x, u]), np.ones(n + len(u))
        )

    def _gradient(self, t: Vector, guard: int) -> tuple[Matrix, Matrix]:
        """ds/dx by canonical units of the states, (n, times), and ds/du."""
        slopes = self._slopes(self.state(t), self.control(t))[guard]
        n = len(self.scale)
        return slopes[:n] * self.scale[:, None], slopes[n:]

    def _small(self, t: Vector, guard: int) -> Vector:
        """Values of a guard at times that are none."""
        return _SMALL * np.abs(self._gradient(t, guard)[0]).max(axis=0)

    def _crossing(self, group: list[tuple[float, int, float, float]]) -> GuardCrossing:
        """Return the crossing at the zero of one guard, or of several at the same time."""
        time, guard, *_ = group[0]
        sides = np.array([time_just_before(time), time])
        x, u = self.state(sides), self.control(sides)
        before, after = (self.guards(x, u)[1][:, k].copy() for k in (0, 1))
        for _, other, *ends in group:
            t = np.array(ends)
            before[other], after[other] = self.guards(self.state(t), self.control(t))[1][other]
        rates = [
            watched_rates(self.phase, x[:, k : k + 1], u[:, k : k + 1], self.p, held)[0].real[:, 0] / self.scale
            for k, held in ((0, before), (1, after))
        ]
        jump = rates[1] - rates[0]
        if np.abs(jump).max() <= _CONTINUOUS * np.abs(rates).max():
            jump[:] = 0.0
        gradients = [[part[:, 0] for part in self._gradient(np.array([time]), other)] for _, other, *_ in group]
        normals = [slope / np.abs(slope).max() for slope, _ in gradients]
        speeds = float(normals[0] @ rates[0]), float(normals[0] @ rates[1])
        # Parallel vectors have no cross products.
        corner = any(np.abs(np.outer(n, normals[0]) - np.outer(normals[0], n)).max() > 1e-9 for n in normals[1:])
        by_control = any(by_u.any() for _, by_u in gradients)
        if not jump.any():
            speeds = 1.0, 1.0
        elif corner or by_control or not speeds[0] * speeds[1] > 0:
            speeds = np.nan, np.nan
        return GuardCrossing(
            time=time, guard=guard, before=before, after=after, size=float(np.abs(gradients[0][0]).max()),
            normal=normals[0], jump=jump, speeds=speeds,
        )  # fmt: skip
