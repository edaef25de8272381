"""Initial guesses: a solution of any method, or a flight written down by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from perilune.core import Matrix, Outcome, PeriluneError, Vector, check_call, require_type, unknown_name
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.results.solution import Solution
from perilune.problem.results.trajectory import Curve, Trajectory

BY_HAND = "by hand"


@check_call
def guess(problem: Problem, times: Any, states: Any, controls: Any = None, **free: float) -> Solution:
    """Make a guess of a flight by hand, for `solve` to start from. It need not meet the dynamics.

    Parameters
    ----------
    problem
        Whose states and controls they are.
    times
        Times [s] from the beginning of the phase, increasing, shape (n,); in a problem of several phases one such array
        for each. The last is the length of the phase where that is free.
    states
        States [SI] at those times, shape (n, states); or one such array for each phase.
    controls
        Controls likewise; None: in the middle of their ranges, directions along their first axis.
    **free
        Values [SI] of free parameters that are no durations; their typical values where they are left out.

    Returns
    -------
    Solution
        Without costates: the indirect method starts from what the direct one makes of it.

    Raises
    ------
    PeriluneError
        If shapes do not fit, a number is not finite, or a name is no free parameter.
    """
    require_type(problem, Problem, "a problem to guess a flight of")
    for name in free:
        if name not in problem.free_names:
            raise unknown_name("free parameter", name, sorted(problem.free_names))
    values = {f.name: f.guess for f in problem.free} | {
        name: float(_check_guess_array(value, (), name)) for name, value in free.items()
    }
    count, flown = len(problem.phases), list[Trajectory]()
    split = [_by_phase(given, count, what) for given, what in ((times, "times"), (states, "states"))]
    steered = [None] * count if controls is None else _by_phase(controls, count, "controls")
    for phase, t, x, u in zip(problem.phases, *split, steered, strict=True):
        trajectory = _guess_trajectory(problem, phase, t, x, u)
        flown.append(trajectory)
        if phase.duration in problem.free_names and phase.duration not in free:
            values[phase.duration] = trajectory.duration
    return Solution(
        problem=problem, method=BY_HAND, outcome=Outcome.SOLVED, objective=float("nan"), free=values,
        trajectories=tuple(flown),
    )  # fmt: skip


def _by_phase(given: Any, count: int, what: str) -> Sequence[Any]:
    """Return one array for each phase."""
    if count == 1:
        return [given]
    if isinstance(given, (list, tuple)) and len(given) == count:
        return given
    raise PeriluneError(
        f"{what} of a guess are given phase by phase", got=type(given).__name__, expected=f"a list of {count} arrays"
    )


def _guess_trajectory(problem: Problem, phase: Phase, times: Any, states: Any, controls: Any) -> Trajectory:
    t = _check_guess_array(times, (None,), f"times of {phase.name}")
    if len(t) < 2 or t[0] != 0 or not (np.diff(t) > 0).all():
        raise PeriluneError(
            f"times of {phase.name} do not describe a flight",
            got=f"{len(t)} times" + (f" from {t[0]:g} to {t[-1]:g} s" if len(t) else ""),
            expected="at least two, from 0 on, increasing",
        )
    x = _check_guess_array(
        states, (len(t), len(phase.states)), f"states of {phase.name} ({', '.join(phase.state_names)})"
    )
    names = f"controls of {phase.name} ({', '.join(phase.control_names)})"
    u = _middle_controls(problem, phase, len(t)) if controls is None else controls
    return Trajectory(
        phase=phase.name,
        state=_curve(t, x),
        control=_curve(t, _check_guess_array(u, (len(t), len(phase.control_names)), names)),
    )


def _check_guess_array(given: Any, shape: tuple[int | None, ...], what: str) -> Any:
    try:
        found = np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        found = np.array(np.nan)
    expected = str(tuple("n" if size is None else size for size in shape)).replace("'", "")
    if found.ndim != len(shape) or any(size not in (None, got) for size, got in zip(shape, found.shape, strict=True)):
        raise PeriluneError(f"a guess has the wrong shape: {what}", got=str(found.shape), expected=expected)
    if not np.isfinite(found).all():
        raise PeriluneError(
            f"a guess has a value that is not a number: {what}", got="NaN or infinity", expected="numbers in SI"
        )
    return found


def _middle_controls(problem: Problem, phase: Phase, count: int) -> Matrix:
    """Return controls in the middle of their ranges; a direction has none, and takes its first axis."""
    p, columns = problem.parameters({f.name: f.guess for f in problem.free}), list[float]()
    for control in phase.controls:
        middle = control.middle(p)[0]
        columns += [middle] if control.scalar else [1.0] + [0.0] * (len(control.names) - 1)
    return np.tile(columns, (count, 1))


def _curve(t: Vector, values: Matrix) -> Curve:
    return Curve(time=t, values=values, rates=np.gradient(values, t, axis=0))


def fitting_guess(problem: Problem, guess: object) -> Solution:
    """Return the guess, where it is a solution with as many phases as the problem.

    Parameters
    ----------
    problem
        Problem to solve.
    guess
        What the user gave.

    Raises
    ------
    PeriluneError
        If it is anything else.
    """
    if not isinstance(guess, Solution):
        raise PeriluneError(
            "the guess is not a solution",
            got=f"{type(guess).__name__}",
            expected="a Solution, as solve() returns it and load() reads it",
            advice="perilune.guess(problem, times, states, controls) builds one from arrays; or omit it",
        )
    if len(guess.trajectories) != len(problem.phases):
        raise PeriluneError(
            "the guess has another number of phases",
            got=str(len(guess.trajectories)),
            expected=str(len(problem.phases)),
            advice="give a solution of a problem with the same phases, or none",
        )
    return guess
