"""Unknowns of shooting: their sizes in SI, and their values from any `Solution`."""

from __future__ import annotations

import numpy as np

from perilune.conditions import OptimalityConditions
from perilune.core import PeriluneError, Vector
from perilune.problem import Curve, Phase, Problem, Solution, canonical_free, free_scales, scalars, state_scales

_NO_TIME = 1e-6  # of its typical duration: what a phase takes that the optimum does without


def objective_scale(problem: Problem) -> float:
    """Return the SI size of the canonical unit of J."""
    return problem.objective_size


def residual_scales(problem: Problem, conditions: OptimalityConditions) -> Vector:
    """Return the SI size of the canonical unit of each residual.

    Parameters
    ----------
    problem, conditions
        The problem and its boundary value problem.

    Returns
    -------
    Vector
        One size [SI] for each residual, in their order.
    """
    J, free = problem.objective_size, free_scales(problem.free, problem)
    states = [
        np.concatenate([state_scales(problem, phase), free[list(extremal.constants)]])
        for phase, extremal in zip(problem.phases, conditions.phases, strict=True)
    ]
    return np.concatenate([_end_scales(problem), *(J / size for size in states), J / free])


def _end_scales(problem: Problem) -> Vector:
    """Return the SI size of the canonical unit of each end condition, phase by phase."""
    return np.array([problem.size_of(c) for phase in problem.phases for c in phase.end_conditions])


def free_values(problem: Problem, conditions: OptimalityConditions, y: Vector) -> dict[str, float]:
    """Return the free parameters in SI.

    Parameters
    ----------
    problem, conditions
        The problem and its boundary value problem.
    y
        Unknowns, canonical.
    """
    of, values = problem.scales.of, y[conditions.free_at].tolist()
    return {f.name: value * of(f.unit) for f, value in zip(problem.free, values, strict=True)}


def scaled_end_multipliers(problem: Problem, conditions: OptimalityConditions, y: Vector) -> dict[str, float]:
    """Return the multipliers nu of the end conditions in J per unit.

    Parameters
    ----------
    problem, conditions, y
        As for `free_values`.

    Returns
    -------
    dict
        Multiplier by ``phase.condition``.
    """
    names = [f"{phase.name}.{c.name}" for phase in problem.phases for c in phase.end_conditions]
    values = y[conditions.free_at.stop : len(conditions.unknowns)] * problem.objective_size / _end_scales(problem)
    return dict(zip(names, values.tolist(), strict=True))


def unknowns_from_solution(problem: Problem, conditions: OptimalityConditions, guess: Solution) -> Vector:
    """Return canonical unknowns y of `problem`, from a solution of any method for it or one of its form.

    The guess has as many phases (`perilune.problem.initial_guess.fitting_guess`).

    Parameters
    ----------
    problem, conditions
        The problem and its boundary value problem.
    guess
        A solution with costates.

    Raises
    ------
    PeriluneError
        If the guess has other states, or no costates.
    """
    lam0 = [
        _initial_costate(problem, phase, extremal.half, flown.costate)
        for phase, extremal, flown in zip(problem.phases, conditions.phases, guess.trajectories, strict=True)
    ]
    values = {f.name: guess.free.get(f.name, _given_value(guess.problem, f.name, f.guess)) for f in problem.free}
    names = [f"{phase.name}.{c.name}" for phase in problem.phases for c in phase.end_conditions]
    nu = np.array([guess.multipliers.get(n, 0.0) for n in names]) * _end_scales(problem) / problem.objective_size
    return np.concatenate([*lam0, canonical_free(problem, values), nu])


def joints_from_solution(problem: Problem, conditions: OptimalityConditions, guess: Solution, segments: int) -> Vector:
    """Return canonical z at the joints of multiple shooting, read off a solution's curves.

    Parameters
    ----------
    problem, conditions, guess
        As for `unknowns_from_solution`.
    segments
        Arcs of each phase.
    """
    joints = [np.zeros(0)]
    for phase, extremal, flown in zip(problem.phases, conditions.phases, guess.trajectories, strict=True):
        scale = state_scales(problem, phase)
        for share in np.arange(1, segments) / segments:
            t = share * flown.duration
            lam = flown.costate(t) if flown.costate is not None else np.zeros(len(scale))
            constants = np.zeros(len(extremal.constants))
            joints.append(
                np.concatenate([flown.state(t) / scale, constants, lam * scale / objective_scale(problem), constants])
            )
    return np.concatenate(joints)


def unreachable_by_shooting(rough: Solution, conditions: OptimalityConditions) -> tuple[str, str] | None:
    """Return what no indirect extremal can do and a direct solution does, and what to try; None if nothing.

    A throttle that stays well between its bounds on a tenth of a phase is no polynomial's overshoot at a switch but a
    singular arc. A state at its bound has a multiplier that Pontryagin's conditions without bounds do not know. A phase
    of no length has no arc.

    Parameters
    ----------
    rough
        Trajectory of the direct method.
    conditions
        Boundary conditions of shooting, with the regimes that its control law has in each phase.

    Returns
    -------
    tuple or None
        Two sentences for a message: the reason, and the advice.
    """
    typical = {f.name: f.guess for f in rough.problem.free}
    for phase, flown, extremal in zip(rough.problem.phases, rough.trajectories, conditions.phases, strict=True):
        if flown.duration <= _NO_TIME * typical.get(phase.duration, 0.0):
            return (
                f"in the direct solution {phase.duration} goes to 0 s: the optimal flight has no {phase.name}",
                f"give {phase.duration} a lower bound above 0, or leave the phase {phase.name} out",
            )
        t = np.linspace(0.0, 1.0, 401)[20:] * flown.duration
        control = flown.control(t)
        for number, (at, bounded) in enumerate(scalars(phase.controls)):
            if bounded.bounded and not any(regimes[number] == "interior" for regimes in extremal.regimes):
                part = bounded.share(control[:, at], rough.parameters)
                share = float(np.mean((part > 0.2) & (part < 0.8)))
                if share > 0.1:
                    what = f"in the direct solution {bounded.name} of {phase.name} stays between its bounds"
                    return f"{what} for {share * flown.duration:.3g} s: a singular arc", "Pseudospectral()"
        for state, values, scale in zip(
            phase.states, flown.state(t).T, state_scales(rough.problem, phase), strict=True
        ):
            lower, upper = rough.problem.bounds(state)
            if min(np.min(values) - lower, upper - np.max(values)) <= 1e-6 * scale:
                return (
                    f"in the direct solution {state.name} of {phase.name} reaches its bound",
                    "Pseudospectral(), or an end condition in place of the bound",
                )
    return None


def _given_value(problem: Problem, name: str, otherwise: float) -> float:
    return problem.given[name].value if name in problem.given else otherwise


def _initial_costate(problem: Problem, phase: Phase, half: int, costate: Curve | None) -> Vector:
    if costate is None:
        raise PeriluneError(
            f"the guess has no costates for {phase.name}",
            expected="a solution of a method that returns costates",
            advice="solve with Pseudospectral() or Indirect() first",
        )
    if costate.values.shape[1] != len(phase.states):
        raise PeriluneError(
            f"the guess has other states than {phase.name}",
            got=f"{costate.values.shape[1]} states",
            expected=f"{len(phase.states)}",
        )
    lam = costate.values[0] * state_scales(problem, phase) / objective_scale(problem)
    return np.concatenate([lam, np.zeros(half - len(lam))])
