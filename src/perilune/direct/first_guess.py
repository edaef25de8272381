"""First guess of a direct method: straight lines, or the trajectories of any solution.

The straight line runs from the start to `Phase.end_guess`, or along the `Problem.initial_guess`; its control is the
one whose rates come nearest to its slope in the least-squares sense, with the dynamics linearised in u (exact for a
thrust direction).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from perilune.core import NUMERIC, Matrix, PeriluneError, Vector
from perilune.direct.collocated_solution import Sampler
from perilune.problem import (
    Phase,
    Problem,
    Solution,
    Trajectory,
    Unnumbered,
    canonical_free,
    canonical_given,
    control_scales,
    control_slices,
    fitting_guess,
    state_scales,
    trace_parameters,
    trace_rates,
)

# First durations tried without an initial guess, as multiples of the typical ones.
STRETCHES = (1.0, 1.6, 0.6, 2.8)
# Points at which a straight line's control is fitted.
FITTED = 21


def first_guesses(problem: Problem, guess: Solution | None) -> Iterator[tuple[Vector, list[Sampler], str]]:
    """Yield free parameters (canonical), one sampler [SI] for each phase, and what the start is called.

    Parameters
    ----------
    problem
        The problem to transcribe.
    guess
        Trajectory to start from, the only start if it is given; None for straight lines.
    """
    if guess is not None:
        yield _from_solution(problem, fitting_guess(problem, guess))
        return
    problem = without_misleading_ends(problem)
    for stretch in STRETCHES if set(problem.duration_names) & set(problem.free_names) else (1.0,):
        free = {
            f.name: float(np.clip(f.guess * (stretch if f.name in problem.duration_names else 1.0), f.lower, f.upper))
            for f in problem.free
        }
        yield (
            canonical_free(problem, free),
            _straight_lines(problem, free),
            f"straight line, durations x {stretch:g}",
        )


def without_misleading_ends(problem: Problem) -> Problem:
    """Return the problem without its rough ends where these are worse than none.

    They are if they miss end conditions and bounds by more than a flight does that stays where it starts.

    Raises
    ------
    PeriluneError
        If a rough end is not a number.
    """
    if all(phase.end_guess is None for phase in problem.phases):
        return problem
    if _ends_missed(problem, _end_guess) <= _ends_missed(problem, lambda phase, begin, p: begin):
        return problem
    bare = tuple(replace(phase, end_guess=None) for phase in problem.phases)
    return problem.changed(phases=bare, form=None)


def _ends_missed(problem: Problem, end_of: Callable[[Phase, Vector, Any], Vector]) -> float:
    """Return by how much rough ends of the phases miss end conditions and bounds, in canonical units."""
    p = problem.parameters({f.name: f.guess for f in problem.free})
    missed, before = 0.0, None
    for k, phase in enumerate(problem.phases):
        before = end_of(phase, phase_start(problem, k, before, p), p)
        conditions = zip(phase.end_conditions, phase.evaluate("end", before, (), p), strict=True)
        missed += sum(
            abs(condition.missed(float(value), p)) / problem.size_of(condition) for condition, value in conditions
        )
        for state, value in zip(phase.states, before.tolist(), strict=True):
            lower, upper = state.limits(p)
            missed += max(lower - value, value - upper, 0.0) / problem.size_of(state)
    return missed


def _end_guess(phase: Phase, begin: Vector, p: Any) -> Vector:
    """Return the guess of the state at the end of a phase [SI]; its begin, if none is stated."""
    if phase.end_guess is None:
        return begin
    end = np.array(phase.end_guess(p, NUMERIC), dtype=float)
    if not np.isfinite(end).all():
        raise PeriluneError(
            f"end_guess of {phase.name} is not a number",
            got=", ".join(f"{name} {value:g}" for name, value in zip(phase.state_names, end, strict=True)),
            expected="a rough end state in SI",
            advice="leave end_guess out if it is not known",
        )
    return end


def _from_solution(problem: Problem, guess: Solution) -> tuple[Vector, list[Sampler], str]:
    for phase, flown in zip(problem.phases, guess.trajectories, strict=True):
        if (flown.state.values.shape[1], flown.control.values.shape[1]) != (
            len(phase.states),
            len(phase.control_names),
        ):
            raise PeriluneError(
                f"the guess does not fit phase {phase.name}",
                got=f"{flown.state.values.shape[1]} states and {flown.control.values.shape[1]} controls",
                expected=f"{len(phase.states)} and {len(phase.control_names)}",
                advice="give a solution of a problem with the same phases, or none",
            )
    # A parameter that is free now may have been given there.
    free = {f.name: float(getattr(guess.parameters, f.name, f.guess)) for f in problem.free}
    return (
        canonical_free(problem, free),
        [_trajectory_sampler(t) for t in guess.trajectories],
        f"start from a guess ({guess.method})",
    )


def _trajectory_sampler(trajectory: Trajectory) -> Sampler:
    def sample(fraction: Vector) -> tuple[Matrix, Matrix]:
        t = np.asarray(fraction) * trajectory.duration
        return trajectory.state(t), trajectory.control(t)

    return sample


def phase_start(problem: Problem, k: int, before: Vector | None, p: Any) -> Vector:
    """Return the state at which phase k begins [SI].

    Parameters
    ----------
    problem, k
        The problem and the number of the phase.
    before
        State at the end of the phase before [SI]; None for the first phase.
    p
        Record of all parameters in SI.
    """
    if before is None:
        return np.array(problem.start(p, NUMERIC), dtype=float)
    ended = problem.phases[k - 1].state_record(*before)
    return np.array(problem.links[k - 1](ended, p, NUMERIC), dtype=float)


def _straight_lines(problem: Problem, free: dict[str, float]) -> list[Sampler]:
    p = problem.parameters(free)
    if problem.initial_guess is not None:
        pictures = problem.initial_guess(p)
        return [
            _interpolating_sampler(problem, k, np.asarray(states, dtype=float), free)
            for k, states in enumerate(pictures)
        ]
    samplers: list[Sampler] = []
    before: Vector | None = None
    for k, phase in enumerate(problem.phases):
        start = phase_start(problem, k, before, p)
        before = _end_guess(phase, start, p)
        samplers.append(_interpolating_sampler(problem, k, np.array([start, before]), free))
    return samplers


def _interpolating_sampler(problem: Problem, k: int, states: Matrix, free: dict[str, float]) -> Sampler:
    """Interpolate states [SI] evenly apart along a phase by straight lines, with the controls that fit best."""
    phase, knots, times = problem.phases[k], np.linspace(0.0, 1.0, FITTED), np.linspace(0.0, 1.0, len(states))
    slopes = np.gradient(states, times, axis=0) / getattr(problem.parameters(free), phase.duration)
    controls = _fitted_controls(
        problem, phase, _interpolate_columns(knots, times, states), _interpolate_columns(knots, times, slopes), free
    )

    def sample(fraction: Vector) -> tuple[Matrix, Matrix]:
        at = np.asarray(fraction)
        return _interpolate_columns(at, times, states), _interpolate_columns(at, knots, controls)

    return sample


def _interpolate_columns(at: Vector, times: Vector, values: Matrix) -> Matrix:
    """Interpolate columns of values linearly at times."""
    found = np.empty((len(at), values.shape[1]))
    for j, column in enumerate(values.T):
        found[:, j] = np.interp(at, times, column)
    return found


def _fitted_controls(problem: Problem, phase: Phase, states: Matrix, slope: Matrix, free: dict[str, float]) -> Matrix:
    """Fit controls (points, nu) in SI to the slopes at the states, both (points, nx) in SI."""
    x_scale, u_scale = state_scales(problem, phase), control_scales(phase.controls, problem.scales)
    middle, reach = _control_middle(problem, phase)
    if not len(middle):
        return np.empty((len(states), 0))
    model = _linear_in_control(Unnumbered(problem), problem.phases.index(phase))
    at = (states / x_scale).T, middle, canonical_free(problem, free), canonical_given(problem)
    rates, slopes = (np.array(v).T for v in model(*at))
    # One matrix (states, controls) for each point, which CasADi has side by side.
    slopes = slopes.reshape(len(states), len(middle), -1).transpose(0, 2, 1)
    wanted = slope / x_scale * problem.scales.time - rates
    found = np.tile(middle, (len(states), 1))
    known = np.isfinite(wanted).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
    step = np.linalg.pinv(slopes[known], rcond=1e-10) @ wanted[known][:, :, None]
    found[known] += np.clip(step[:, :, 0], -reach, reach)
    controls = (found * u_scale).T
    for here, control in control_slices(phase.controls):
        controls[here] = control.rough(controls[here], problem.parameters({}))
    return controls.T


@lru_cache(maxsize=32)
def _linear_in_control(unnumbered: Unnumbered, index: int) -> ca.Function:
    """Return the rates and their slopes in u at the fitted points, side by side."""
    p, phase = trace_parameters(unnumbered.problem), unnumbered.problem.phases[index]
    x, u = ca.SX.sym("x", len(phase.states)), ca.SX.sym("u", len(phase.control_names))
    rates = trace_rates(phase, x, u, p.record)
    one = ca.Function("linear", [x, u, p.free, p.given], [rates, ca.densify(ca.jacobian(rates, u))])
    return one.map("fitted", "serial", FITTED, [1, 2, 3], [])


def _control_middle(problem: Problem, phase: Phase) -> tuple[Vector, Vector]:
    """Return the middle of each control's range and how far it may go from there, in canonical units."""
    p, scale = problem.parameters({}), control_scales(phase.controls, problem.scales)
    both = [control.middle(p) for control in phase.controls for _ in control.names]
    middle, reach = np.array(both).reshape(-1, 2).T / scale
    return middle, reach
