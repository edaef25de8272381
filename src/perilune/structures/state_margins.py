"""Margins S >= 0 of conditions on states only along a phase, and where they are broken."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import NUMERIC, Matrix, Vector
from perilune.problem import Expression, Problem, Solution, TracedProblem, full
from perilune.structures.detect_regimes import runs_by_kind
from perilune.structures.state_constraints import margins, plain_bounds

POINTS = 2000  # of a phase, in addition to the nodes of its tables
ROUNDING = 1e-8  # of what S goes through: less below 0 is not broken
_CLOSER = 33  # times between the neighbours of a look at which S is least: 16 times as close, 256 times as exact
_ROUNDED = 1e-12  # of the times looked at: those nearer to each other are one
EXACTLY = 1e-9  # of the size of S, to which an answer is judged


def is_constant_condition(problem: Problem, k: int, name: str) -> bool:
    """Return True if a condition does not change along phase k, as no state in it does: that of a mass on a coast.

    Parameters
    ----------
    problem, k
        The problem and the number of the phase.
    name
        Name of the condition, as `margins` has it.
    """
    return _is_constant(problem.form, k, problem.phases[k].state_names, margins(problem, k)[name][1])


@lru_cache(maxsize=256)
def _is_constant(form: TracedProblem, k: int, names: tuple[str, ...], value: Expression) -> bool:
    tape = form.expressions[k, "dynamics"].tape
    rates = [tape.instructions[at] for at in tape.outputs]
    moved = {n for n, op in zip(names, rates, strict=True) if op[0] != "const" or float(op[1]) != 0.0}
    return not any(op[0] == "x" and op[1] in moved for op in value.tape.instructions)


def broken_intervals(t: Vector, room: Vector, size: float) -> Iterator[tuple[float, float, float]]:
    """Yield where a condition is broken by more than rounding: from when to when, and when the most [s].

    `size` is that of S.

    Parameters
    ----------
    t
        Times [s], (n,).
    room
        S at these times [SI], (n,).
    size
        Size of S [SI].
    """
    for first, last in runs_by_kind(room < -margin_rounding(room, size)):
        yield float(t[first]), float(t[last]), float(t[first + int(np.argmin(room[first : last + 1]))])


def refine_minima(t: Vector, room: Vector, slack: float) -> Vector:
    """Return times around each minimum of S at which S may still vanish unseen: more of them, between the looks.

    Between looks a smooth S is less than at the least of them by an eighth of what it rises to the farther neighbour,
    about; where that is nothing, or S is far above it, there is nothing to see.

    Parameters
    ----------
    t, room
        Times, in order, and S there.
    slack
        By which S may fall below zero.

    Returns
    -------
    Vector
        Times; none where the looks were close enough.
    """
    if len(t) < 2:
        return t[:0]
    # Of two times that rounding parts neither is the other's neighbour: what lies behind them would go unseen.
    apart = np.append(True, np.diff(t) > _ROUNDED * (t[-1] - t[0]))
    t, room = t[apart], room[apart]
    before, behind = np.append(room[0], room[:-1]), np.append(room[1:], room[-1])
    rise = np.maximum(before, behind) - room
    low = (room <= before) & (room <= behind) & (rise > slack) & (room < rise)
    around = [np.linspace(t[max(i - 1, 0)], t[min(i + 1, len(t) - 1)], _CLOSER) for i in np.nonzero(low)[0]]
    return np.concatenate([*around, t[:0]])


def margin_rounding(room: Vector, size: float) -> float:
    """Return what counts as rounding of S along a phase; that of its `size` where S goes through little.

    Parameters
    ----------
    room
        S along a phase [SI], (n,).
    size
        Size of S [SI].
    """
    return max(ROUNDING * float(np.ptp(room)), EXACTLY * size)


def margin_along(solution: Solution, k: int, name: str) -> tuple[Vector, Vector]:
    """Return times of a phase [s] and S there [SI].

    Parameters
    ----------
    solution, k
        The solution and the number of the phase.
    name
        Name of a condition on states only, as `margins` has it.
    """
    flown = solution.trajectories[k]
    t = np.union1d(flown.time, np.linspace(0.0, flown.duration, POINTS))
    return t, margin_at(solution.problem, solution.parameters, k, name, t, np.asarray(flown.state(t)).T)


def margin_at(problem: Problem, p: Any, k: int, name: str, t: Vector, x: Matrix) -> Vector:
    """Return S of a condition on states only at times of phase k [SI], from the states there, (n, times).

    Parameters
    ----------
    problem
        The problem.
    p
        Record of its parameters in SI.
    k
        Number of the phase.
    name
        Name of a condition on states only, as `margins` has it.
    t
        Times [s], (times,).
    x
        States at these times [SI], (n, times).
    """
    phase, value = problem.phases[k], margins(problem, k)[name][1]
    bounds = {given: g.value for given, g in plain_bounds(problem).items()}
    known: Any = SimpleNamespace(**vars(p), **bounds)
    u = np.zeros(len(phase.control_names))  # which stands in none
    return full(value(phase.state_record(*x), phase.control_record(*u), known, NUMERIC)[0], t)
