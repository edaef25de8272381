"""A solution as named columns over time, of which tables and figures are made.

States, outputs, controls and costates are read from the solution's own curves, a `UnitVectorControl` control
normalised again after interpolation, and the Hamiltonian ``H = lam . f(x, u)`` is evaluated with the
problem's own dynamics (a running cost is a state, so H has no other term). Angles leave in degrees,
everything else in SI. An output that is an angle goes on where its range ends: a flight to the east passes from
179 to 181 degrees, and into the next phase, without a jump.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import NUMERIC, Matrix, Vector
from perilune.problem import Solution, Trajectory, full


@dataclass(frozen=True, kw_only=True)
class Column:
    """Named quantity with its unit at every time of a table, shape (n,)."""

    name: str
    unit: str
    values: Vector

    @property
    def heading(self) -> str:
        """Return name and unit, as in the first row of a table."""
        return f"{self.name} [{self.unit}]"


def hamiltonian(solution: Solution, k: int, t: Vector, control: Matrix | None = None) -> Vector:
    """Evaluate H of phase k at times t, in units of J per second; NaN where the method gives no costates.

    Parameters
    ----------
    solution, k
        The solution, and the number of the phase.
    t
        Times in the phase [s], shape (n,).
    control
        Control in place of the flown one, shape (components, n).
    """
    if solution.trajectories[k].costate is None:
        return np.full(len(t), math.nan)
    return np.sum(hamiltonian_terms(solution, k, t, control), axis=0)


def hamiltonian_terms(solution: Solution, k: int, t: Vector, control: Matrix | None = None) -> list[Vector]:
    """Evaluate the terms ``lam_i x_i'`` of H at times t, one for each state; phase k must have costates.

    Parameters
    ----------
    solution, k
        The solution, and the number of the phase.
    t
        Times in the phase [s], shape (n,).
    control
        Control in place of the flown one, shape (components, n).
    """
    phase, trajectory = solution.problem.phases[k], solution.trajectories[k]
    assert trajectory.costate is not None
    x, u = solution.evaluate(k, t)
    rates = phase.rates(x, u if control is None else control, solution.parameters)
    return [lam * rate for lam, rate in zip(trajectory.costate(t).T, rates, strict=True)]


def required_hamiltonian(solution: Solution, k: int) -> float:
    """Return the value that H of phase k must have, in units of J per second: minus dJ/dT, as its duration T is free.

    It is 0 if J depends on the end state only, -1 if J is the flight time.

    Parameters
    ----------
    solution
        Solution of any method.
    k
        Number of the phase.
    """
    p, name, step = solution.parameters, solution.problem.phases[k].duration, 1e-20
    end = solution.problem.phases[-1].state_record(*solution.trajectories[-1].state.values[-1])
    moved = SimpleNamespace(**{**vars(p), name: getattr(p, name) + 1j * step})
    return 0.0 - float(np.imag(solution.problem.objective(end, moved, NUMERIC))) / step


def phase_columns(solution: Solution, k: int = 0, t: Vector | None = None) -> dict[str, Column]:
    """Return all columns of phase k, by name.

    Parameters
    ----------
    solution, k
        The solution and the number of the phase.
    t
        Times from the phase's ignition [s]; the state's nodes if None, a switch by both its sides.

    Returns
    -------
    dict
        In this order: ``time``, outputs, states, control components, ``lambda_<state>``, ``H``.
    """
    phase, trajectory = solution.problem.phases[k], solution.trajectories[k]
    told, t = (trajectory.time, node_times(trajectory)) if t is None else (t, t)
    state, control = solution.evaluate(k, t)
    outputs = _unwrapped(solution, k, t, phase.evaluate("outputs", state, control, solution.parameters))
    table = [Column(name="time", unit="s", values=told)]
    table += [_display_column(v.name, v.unit, y, t) for v, y in zip(phase.output_variables, outputs, strict=True)]
    table += [_display_column(v.name, v.unit, y, t) for v, y in zip(phase.states, state, strict=True)]
    units = [c.unit for c in phase.controls for _ in c.names]
    table += [_display_column(n, u, y, t) for n, u, y in zip(phase.control_names, units, control, strict=True)]
    if trajectory.costate is not None:
        per = solution.problem.objective_unit
        table += [
            Column(name=f"lambda_{v.name}", unit=per_unit(per, v.unit), values=lam)
            for v, lam in zip(phase.states, trajectory.costate(t).T, strict=True)
        ]
        table.append(Column(name="H", unit=per_unit(per, "s"), values=hamiltonian(solution, k, t)))
    return {column.name: column for column in table}


def _unwrapped(solution: Solution, k: int, t: Vector, outputs: Sequence[Any]) -> list[Any]:
    """Return outputs of phase k at times t, each angle with its whole turns since the begin of the flight."""
    variables, found = solution.problem.phases[k].output_variables, list(outputs)
    angles = {v.name: i for i, v in enumerate(variables) if v.unit == "rad"}
    # A first phase from its begin without a jump is as it is, which is known at once.
    jumps = any(np.any(np.abs(np.diff(full(found[i], t))) > math.pi) for i in angles.values())
    if angles and (k or jumps or t[0] > 0):
        ways = _unwrapped_outputs_before(solution, k, list(angles))
        for name, i in angles.items():
            value = full(found[i], t)
            way = np.interp(t, *ways[name]) if name in ways else value
            turns = np.round((way - value) / (2 * math.pi))
            found[i] = value + 2 * math.pi * np.where(np.isfinite(turns), turns, 0.0)
    return found


def _unwrapped_outputs_before(solution: Solution, last: int, names: Sequence[str]) -> dict[str, tuple[Vector, Vector]]:
    """Return times of phase `last` and each finite output there, unwrapped from the begin of the flight."""
    ends, found = dict[str, float](), dict[str, tuple[Vector, Vector]]()
    for k, phase in enumerate(solution.problem.phases[: last + 1]):
        here = [i for i, v in enumerate(phase.output_variables) if v.name in names]
        if not here:
            continue
        trajectory = solution.trajectories[k]
        t = np.union1d(display_times(trajectory), trajectory.time)
        outputs = phase.evaluate("outputs", *solution.evaluate(k, t), solution.parameters)
        for i in here:
            name, values = phase.output_variables[i].name, full(outputs[i], t)
            known = np.isfinite(values)
            if known.any():
                begin = [ends[name]] if name in ends else []
                way = np.unwrap([*begin, *values[known]])[len(begin) :]
                ends[name], found[name] = float(way[-1]), (t[known], way)
        if k < last:
            found.clear()
    return found


def node_times(trajectory: Trajectory) -> Vector:
    """Return times at which to evaluate the state's nodes: the first of two equal ones lies before the switch there."""
    t = trajectory.time.copy()
    first = np.flatnonzero(np.diff(t) == 0)
    t[first] = np.nextafter(t[first], 0.0)
    return t


def display_times(trajectory: Trajectory, count: int = 601) -> Vector:
    """Return evenly spaced times and both sides of every switch, so that a jump shows as a step, not a ramp.

    Parameters
    ----------
    trajectory
        The trajectory of a phase.
    count
        Number of evenly spaced times.
    """
    return np.union1d(np.linspace(0.0, trajectory.duration, count), times_around_switches(trajectory))


def times_around_switches(trajectory: Trajectory) -> Matrix:
    """Return the times before and behind every switch of any curve."""
    curves = (trajectory.state, trajectory.control, *filter(None, (trajectory.costate,)))
    switches = np.concatenate([curve.time[1:][np.diff(curve.time) == 0] for curve in curves])
    return np.array([np.nextafter(switches, 0.0), switches])


def per_unit(objective_unit: str, unit: str) -> str:
    """Return the unit of J per another unit: for a costate per unit of its state, for H per second.

    Parameters
    ----------
    objective_unit
        SI unit of J.
    unit
        The other SI unit.
    """
    if unit == "1":
        return objective_unit
    if unit == objective_unit:
        return "1"
    return f"{objective_unit}/({unit})" if "/" in unit else f"{objective_unit}/{unit}"


def flight_columns(solution: Solution, name: str) -> list[tuple[Vector, Column]]:
    """Return (time from the start of the flight [s], column) for each phase that has the column, as `display_times`.

    Parameters
    ----------
    solution
        The solution.
    name
        Name of the column.
    """
    found, begin = [], 0.0
    for k, trajectory in enumerate(solution.trajectories):
        t = display_times(trajectory)
        table = phase_columns(solution, k, t)
        if name in table:
            found.append((begin + t, table[name]))
        begin += trajectory.duration
    return found


def _display_column(name: str, unit: str, values: Any, t: Vector) -> Column:
    factor, unit = display_unit(unit)
    return Column(name=name, unit=unit, values=full(values, t) * factor)


def display_unit(unit: str) -> tuple[float, str]:
    """Return the factor from an SI unit to the display unit, and that unit: degrees for radians."""
    return (180 / math.pi, "deg") if unit == "rad" else (1.0, unit)


def round_degrees(value: float, unit: str) -> float:
    """Return a value in its display unit without the rounding of pi: 30 degrees, not 29.999999999999996.

    Parameters
    ----------
    value
        Value in its display unit.
    unit
        Display unit, of which "deg" is rounded to 15 digits.
    """
    return float(f"{value:.15g}") if unit == "deg" else float(value)
