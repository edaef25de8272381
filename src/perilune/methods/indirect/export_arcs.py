"""Exported flight of a root: in one piece, or in several where errors grow too much.

A root of single shooting satisfies the end conditions to rounding of its own flight. Integrated again, with another
tolerance, it misses them by that rounding times the growth of errors in states and costates together: 1e-15 times
1e7 on an entry with much lift. Where that shows, the root is found again by multiple shooting, and each piece is flown
from its own start; what is left is a gap of rounding between two pieces. Where the phases are too many to be cut, as
those of a flight along a limit are, the root is moved by its last digits instead (`correct_last_digits`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from perilune.conditions import OptimalityConditions, extremal_parameters
from perilune.core import Matrix, NotConvergedError, Vector
from perilune.kernels import DenseArc
from perilune.problem import Problem, state_scales
from perilune.shooting import FINEST, Root, Shooting, propagate_arc, propagate_settling_phase

_FINE = {"rtol": 1e-13, "atol": 1e-13}  # of the arcs that are exported
_FINEST = {"rtol": 1e-14, "atol": 1e-14}  # the same where a phase settles (`perilune.shooting.integrate_plan.Split`)
_MISSED = 2e-11  # canonical, of what a flight leaves at its end: five times below the limit of the proof
_MENDED = 0.1  # of that, which the flight in pieces may leave
_SEGMENTS = 6
_STEPS = 12  # of Newton's method on the flight as it is exported: at rounding each is a draw, and a few are bad ones
_ASTRAY = 100.0  # times the least: more than rounding, which spans a factor of ten to twenty
_JOINED = 350  # unknowns at joints, which cost their number cubed


@dataclass(frozen=True, kw_only=True)
class PropagatedPhase:
    """One phase, flown in one piece or in several.

    Attributes
    ----------
    arcs
        Each from a time 0 of its own.
    begins
        When each begins.
    duration
        Length of the phase.
    """

    arcs: tuple[DenseArc, ...]
    begins: Vector
    duration: float

    @property
    def z(self) -> Matrix:
        """States at all nodes, (nodes, nz)."""
        return np.concatenate([arc.z for arc in self.arcs])

    @property
    def switches(self) -> list[float]:
        """Times of the events, in order."""
        parts = zip(self.begins, self.arcs, strict=True)
        return [float(begin + t) for begin, arc in parts for t in arc.end.event_time[0] if np.isfinite(t)]

    @property
    def complete(self) -> bool:
        """Return True if it was flown to its end: its tables are nothing beyond where it was stuck."""
        return all(bool(arc.end.succeeded.all()) for arc in self.arcs)

    def modes(self, t: Vector) -> NDArray[np.int64]:
        """Return the mode of the step in which each time lies; at a switch, the one after it."""
        pieces, found = self._piece(t), np.zeros(len(t), dtype=np.int64)
        for i in np.unique(pieces):
            arc, here = self.arcs[i], pieces == i
            step = np.searchsorted(arc.t, t[here] - self.begins[i], side="right") - 1
            found[here] = arc.mode[np.clip(step, 0, len(arc.mode) - 1)]
        return found

    def __call__(self, t: Vector) -> Matrix:
        """Return z at times, (n, nz)."""
        if len(self.arcs) == 1:
            return self.arcs[0](t)
        pieces = self._piece(t)
        values = np.empty((len(t), self.arcs[0].z.shape[1]))
        for i in np.unique(pieces):
            here = pieces == i
            values[here] = self.arcs[i](t[here] - self.begins[i])
        return values

    def states(self, t: Vector, count: int) -> Matrix:
        """Return the first entries of z at times, (n, count), of a phase that is flown in one piece.

        Parameters
        ----------
        t
            Times from the start of the phase, shape (n,), canonical.
        count
            Number of leading entries of z = (states, costates).
        """
        (arc,) = self.arcs
        return arc(t, count)

    def _piece(self, t: Vector) -> NDArray[np.int64]:
        return np.clip(np.searchsorted(self.begins, t, side="right") - 1, 0, len(self.arcs) - 1)


def propagate_in_one_piece(
    problem: Problem, conditions: OptimalityConditions, y: Vector, **settings: float
) -> list[PropagatedPhase]:
    """Propagate from the unknowns y, whatever events occur; a phase that settles is in several pieces.

    Parameters
    ----------
    problem, conditions
        The problem and its boundary value problem.
    y
        Unknowns, canonical, with or without the states at the joints.
    settings
        As for `propagate_arc`.
    """
    p, before, flown = extremal_parameters(problem), np.zeros(0), list[PropagatedPhase]()
    y, settings = y[: len(conditions.unknowns)], {**_export_accuracy(conditions), **settings}
    for k, (extremal, start) in enumerate(zip(conditions.phases, conditions.starts, strict=True)):
        z0, duration = (np.array(out).ravel() for out in start(y, before, p))
        if extremal.settles:
            flown.append(_propagate_settling(conditions, k, y, z0, p, float(duration[0]), **settings))
        else:
            arc = propagate_arc(extremal, z0, p, float(duration[0]), **settings)
            flown.append(PropagatedPhase(arcs=(arc,), begins=np.zeros(1), duration=float(duration[0])))
        before = flown[-1].arcs[-1].z[-1]
    return flown


@dataclass
class PropagatedStates:
    """The flight from the unknowns y as far as its states are looked at, phase by phase.

    Of a phase that settles they are flown without its costates, which are flown from its end.
    """

    problem: Problem
    conditions: OptimalityConditions
    y: Vector

    def __post_init__(self) -> None:
        self._p = extremal_parameters(self.problem)
        self._starts: dict[int, tuple[Vector, float]] = {}
        self._flown: dict[int, PropagatedPhase] = {}

    def start(self, k: int) -> tuple[Vector, float]:
        """Return z at the start of phase k, and its length, canonical."""
        if k not in self._starts:
            before = self._end(k - 1) if k else np.zeros(0)
            z, duration = (np.array(out).ravel() for out in self.conditions.starts[k](self.y, before, self._p))
            self._starts[k] = z, float(duration[0])
        return self._starts[k]

    def at(self, k: int, shares: Vector) -> Matrix:
        """Return the states of phase k (n, times) at shares of its length, SI; its start takes no integration.

        Parameters
        ----------
        k
            Index of the phase.
        shares
            Times as fractions of the duration of the phase, 0 to 1, shape (times,).
        """
        scales = state_scales(self.problem, self.problem.phases[k])
        if not shares.any():
            return np.repeat((self.start(k)[0][: len(scales)] * scales)[:, None], len(shares), axis=1)
        return self._phase(k).states(shares * self.start(k)[1], len(scales)).T * scales[:, None]

    def _phase(self, k: int) -> PropagatedPhase:
        if k not in self._flown:
            extremal, (z, duration) = self.conditions.phases[k], self.start(k)
            fine = _export_accuracy(self.conditions)
            arc = propagate_arc(extremal, z, self._p, duration, extremal.settles, **fine)
            self._flown[k] = PropagatedPhase(arcs=(arc,), begins=np.zeros(1), duration=duration)
        return self._flown[k]

    def _end(self, k: int) -> Vector:
        extremal, end = self.conditions.phases[k], self._phase(k).arcs[-1].z[-1]
        return np.concatenate([end[: extremal.half], np.zeros(extremal.half)]) if extremal.settles else end


def _export_accuracy(conditions: OptimalityConditions) -> dict[str, float]:
    return _FINEST if any(extremal.settles for extremal in conditions.phases) else _FINE


def _propagate_settling(
    conditions: OptimalityConditions, k: int, y: Vector, z0: Vector, p: Vector, duration: float, **settings: float
) -> PropagatedPhase:
    """Propagate a phase that settles, its costates back from its end, where its conditions give them."""
    half, places = conditions.phases[k].half, np.cumsum([0, *(2 * e.half for e in conditions.phases)])
    at = conditions.costate_at[k]
    rows = slice(conditions.transversality_at + at.start, conditions.transversality_at + at.stop)

    def end(x: Vector) -> Vector:
        ends = np.zeros(places[-1])
        ends[places[k] : places[k] + half] = x
        return -np.array(conditions.residual(y, ends, p)[0]).ravel()[rows]

    arcs, begins = propagate_settling_phase(conditions.phases[k], z0[:half], p, duration, end, **settings)
    return PropagatedPhase(arcs=tuple(arcs), begins=begins, duration=duration)


def propagate_for_export(
    problem: Problem, conditions: OptimalityConditions, root: Root, allowed: float = _MISSED, **settings: float
) -> list[PropagatedPhase]:
    """Propagate a root, in pieces where a single one leaves more at its ends than is allowed, canonical.

    Parameters
    ----------
    problem, conditions
        The problem and its boundary value problem.
    root
        A root of it.
    allowed
        Largest residual at the ends, canonical, with which one piece is kept.
    settings
        As for `propagate_arc`.

    Raises
    ------
    NotConvergedError
        If it is stuck on its way, as where a switching function vanishes twice at once, at this accuracy and at that
        of Newton's method.
    """
    whole = propagate_in_one_piece(problem, conditions, root.y, **settings)
    if not all(flown.complete for flown in whole):
        whole = propagate_in_one_piece(problem, conditions, root.y, **{**settings, "rtol": FINEST, "atol": FINEST})
        _refuse_stuck(problem, whole)
    missed = _largest_end_residual(problem, conditions, root, whole)
    if missed <= allowed or not can_use_multiple_shooting(conditions):
        return whole
    pieces = _propagate_in_pieces(problem, conditions, root, whole)
    # What large numbers round, as those of places far from their origin, no pieces mend.
    mended = pieces is not None and _largest_end_residual(problem, conditions, root, pieces) <= _MENDED * missed
    return pieces if pieces is not None and mended else whole


def _refuse_stuck(problem: Problem, flown: Sequence[PropagatedPhase]) -> None:
    for phase, own in zip(problem.phases, flown, strict=True):
        if not own.complete:
            stuck = next(i for i, arc in enumerate(own.arcs) if not arc.end.succeeded.all())
            at = (float(own.begins[stuck]) + float(own.arcs[stuck].end.time[0])) * problem.scales.time
            raise NotConvergedError(
                "an extremal was found, but its flight cannot be integrated to its end",
                got=f"it stops {at:.9g} s into {phase.name}, of {own.duration * problem.scales.time:.9g} s",
                expected="steps up to the end, which do not exist for a control that switches back and forth at one"
                " time",
                advice="the direct method (--method direct, Pseudospectral()); another value of what was changed last",
            )


def can_use_multiple_shooting(conditions: OptimalityConditions, segments: int = _SEGMENTS) -> bool:
    """Return True if multiple shooting with so many segments for each phase is worth its unknowns.

    Parameters
    ----------
    conditions
        Boundary conditions of the shooting problem, with the numbers of states of each phase.
    segments
        Number of segments of each phase.
    """
    return (segments - 1) * sum((2 - e.settles) * e.half for e in conditions.phases) <= _JOINED


def correct_last_digits(
    problem: Problem, conditions: OptimalityConditions, root: Root, rows: NDArray[np.int64], active: NDArray[np.int64]
) -> tuple[Root, float]:
    """Correct a root by its last digits until its exported flight ends where it should; return what is missed too.

    Parameters
    ----------
    problem, conditions, root
        Of single shooting.
    rows, active
        Conditions and unknowns of its Jacobian.
    """
    best, least = root, np.inf
    for _ in range(_STEPS):
        left = _end_residual(
            problem, conditions, root, propagate_in_one_piece(problem, conditions, root.y), stationary=True
        )
        size = float(np.abs(left).max(initial=0.0))
        if size < least:
            best, least = root, size
        elif least <= _MISSED or not size <= _ASTRAY * least:
            break
        y = root.y.copy()
        y[active] -= root.inverse @ left[rows]
        root = replace(root, y=y)
    return best, least


def ends_well(problem: Problem, conditions: OptimalityConditions, root: Root) -> bool:
    """Return True if a root flown in one piece leaves so little at its ends that it is exported as it is.

    Parameters
    ----------
    problem, conditions, root
        As for `propagate_for_export`.
    """
    return (
        _largest_end_residual(problem, conditions, root, propagate_in_one_piece(problem, conditions, root.y)) <= _MISSED
    )


def _largest_end_residual(
    problem: Problem, conditions: OptimalityConditions, root: Root, flown: Sequence[PropagatedPhase]
) -> float:
    """Return the largest residual at the ends of a flight, not counting ranges and free parameters."""
    return float(np.abs(_end_residual(problem, conditions, root, flown)).max(initial=0.0))


def _end_residual(
    problem: Problem,
    conditions: OptimalityConditions,
    root: Root,
    flown: Sequence[PropagatedPhase],
    *,
    stationary: bool = False,
) -> Vector:
    """Return the residual at the ends; 0 for ranges, and for free parameters that are held, or all of them.

    NaN of one that was not flown to its end.
    """
    ends = np.concatenate([arc.z[-1] for arc in flown])
    residual = np.array(conditions.residual(root.y, ends, extremal_parameters(problem))[0]).ravel()
    free = conditions.free_at.stop - conditions.free_at.start
    residual[conditions.stationarity_at] *= stationary & (root.choice[:free] == 0)
    residual[[row for row, _ in (*conditions.ranges, *conditions.silent_rows)]] = 0.0
    return residual if all(own.complete for own in flown) else np.full_like(residual, np.nan)


def _propagate_in_pieces(
    problem: Problem, conditions: OptimalityConditions, root: Root, whole: Sequence[PropagatedPhase]
) -> list[PropagatedPhase] | None:
    """Solve for the same root by multiple shooting, each piece from its own start."""
    shooting, p = Shooting(conditions, segments=_SEGMENTS), extremal_parameters(problem)
    shares = np.arange(1, _SEGMENTS) / _SEGMENTS
    joints = [arc(shares * arc.duration).ravel() for arc in whole]
    found = shooting.root(np.concatenate([root.y, *joints]), p, root.choice, accuracy=FINEST)
    if not found.converged:
        return None
    y = found.y[: len(root.y)].copy()
    y[conditions.free_at] = root.y[conditions.free_at]  # as they are reported; Newton moves them by rounding
    flown, before, at, fine = list[PropagatedPhase](), np.zeros(0), len(root.y), _export_accuracy(conditions)
    for k, (extremal, start) in enumerate(zip(conditions.phases, conditions.starts, strict=True)):
        z, duration = (np.array(out).ravel() for out in start(y, before, p))
        if extremal.settles:
            flown.append(
                _propagate_settling(conditions, k, y[: len(conditions.unknowns)], z, p, float(duration[0]), **fine)
            )
            before, at = flown[-1].arcs[-1].z[-1], at + len(z) * len(shares)
            continue
        length, kept = float(duration[0]) / _SEGMENTS, shooting.plan.legs[k * _SEGMENTS].equations.kept
        arcs = [propagate_arc(extremal, z, p, length, **fine)]
        for _ in shares:
            z = arcs[-1].z[-1].copy()
            z[kept] = found.y[at : at + len(z)][kept]
            arcs.append(propagate_arc(extremal, z, p, length, **fine))
            at += len(z)
        flown.append(
            PropagatedPhase(arcs=tuple(arcs), begins=length * np.arange(_SEGMENTS), duration=float(duration[0]))
        )
        before = arcs[-1].z[-1]
    return flown
